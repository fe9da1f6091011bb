"""The process that answers HTTP for a service; ``hil.service.api_child`` starts it and is its only parent.

stdin brings the config and then answers and statuses, stdout takes orders, stderr the log. The end of stdin means that
the control process has gone: clients are told so, and this process ends. It owns nothing that moves.
"""

import asyncio
import os
import signal
import socket
import sys
from pathlib import Path
from typing import Any, cast

import uvicorn

from hil.errors import BadInputError
from hil.json_lines import LineReader, LineWriter
from hil.service import logs
from hil.service.api.access import Gate
from hil.service.api.control import Control
from hil.service.api.routes import make_app
from hil.service.api_config import ApiConfig
from hil.service.discovery import make_token, own_token_file, read_token

_PING_S = 5.0
_LONGEST_MESSAGE_BYTES = 64 * 1024
_LAST_ANSWERS_S = 1


def main() -> int:
    """Serve until the control process goes; 0 then, 2 when the API cannot be served as it was asked for."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the control process's business
    writer = LineWriter(os.dup(1))
    os.dup2(2, 1)  # what a library prints must not get between the orders
    lines = LineReader(0)
    record = lines.read()
    if record is None:
        return 0
    config = ApiConfig.from_record(cast(dict[str, Any], record["config"]))
    logs.configure(config.log, "api")
    try:
        listener = _listen(config)
        port = listener.getsockname()[1]
        path = _token_file(config, port)
        token = read_token(path)
    except BadInputError as error:
        writer.send({"refused": str(error)})
        return error.exit_code
    ready = {"url": f"http://{config.host}:{port}", "token_file": str(path)}
    asyncio.run(_serve(config, listener, token, lines, writer, ready))
    return 0


def _listen(config: ApiConfig) -> socket.socket:
    try:
        return socket.create_server((config.host, config.port))
    except OSError as error:
        raise BadInputError(
            f"the API cannot listen on {config.host}:{config.port} ({error.strerror}); end the program that does, or "
            "choose another port in service.port"
        ) from error


def _token_file(config: ApiConfig, port: int) -> Path:
    """Return the file with the token, which is made where there is none, or where it is to be a new one."""
    if config.token_file is None:
        path = own_token_file(port)
        make_token(path)
    else:
        path = Path(config.token_file).absolute()
        if not path.exists():
            make_token(path)
    return path


class _Server(uvicorn.Server):
    """Uvicorn, which tells the control process when it listens, and ends when that ends."""

    def __init__(self, config: uvicorn.Config, writer: LineWriter, ready: dict[str, str]) -> None:
        super().__init__(config)
        self._writer = writer
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._writer.send({"ready": self._ready})


async def _serve(
    config: ApiConfig,
    listener: socket.socket,
    token: str,
    lines: LineReader,
    writer: LineWriter,
    ready: dict[str, str],
) -> None:
    control = Control(lines, writer)
    port = listener.getsockname()[1]
    hosts = frozenset(f"{name}:{port}".encode() for name in (config.host, "localhost"))
    server = _Server(
        uvicorn.Config(
            Gate(make_app(config, control), token=token, hosts=hosts),
            http="h11",
            ws="websockets-sansio",
            loop="asyncio",
            lifespan="off",
            ws_ping_interval=_PING_S,
            ws_ping_timeout=_PING_S,
            ws_max_size=_LONGEST_MESSAGE_BYTES,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=_LAST_ANSWERS_S,
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
        ),
        writer,
        ready,
    )
    serving = asyncio.create_task(server.serve([listener]))
    gone = asyncio.create_task(control.gone.wait())
    await asyncio.wait((serving, gone), return_when=asyncio.FIRST_COMPLETED)
    server.should_exit = True
    await serving
    gone.cancel()
    logs.info("API ends")


if __name__ == "__main__":
    sys.exit(main())
