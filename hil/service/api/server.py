"""The server of the API: one process, one event loop, one socket."""

import asyncio
import socket

import uvicorn

from hil.core.json_lines import LineReader, LineWriter
from hil.service import logs
from hil.service.api.access import Gate
from hil.service.api.control import Control
from hil.service.api.routes import make_app
from hil.service.api_config import ApiConfig

_PING_S = 5.0
_LONGEST_MESSAGE_BYTES = 64 * 1024
_LAST_ANSWERS_S = 1


class _Server(uvicorn.Server):
    """Uvicorn, which tells the control process when it listens, and ends when that ends."""

    def __init__(self, config: uvicorn.Config, writer: LineWriter, ready: dict[str, str]) -> None:
        super().__init__(config)
        self._writer = writer
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._writer.send({"ready": self._ready})


async def serve(
    config: ApiConfig,
    listener: socket.socket,
    token: str,
    lines: LineReader,
    writer: LineWriter,
    ready: dict[str, str],
) -> None:
    """Serve the API on a socket that listens, until the control process goes or this one is told to end.

    ``token`` is what clients show, ``ready`` what the control process is told when it is served.
    """
    control = Control(lines, writer, config.limits.twist_timeout_s)
    living = asyncio.create_task(control.live())
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
    living.cancel()
    logs.info("API ends")
