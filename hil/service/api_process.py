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

from hil.core.errors import BadInputError
from hil.core.json_lines import LineReader, LineWriter
from hil.service import logs
from hil.service.api_config import ApiConfig
from hil.service.discovery import make_token, own_token_file, read_token


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
    # What is refused is refused at once: these packages take a second to import.
    from hil.service.api.server import serve

    ready = {"url": f"http://{config.host}:{port}", "token_file": str(path)}
    asyncio.run(serve(config, listener, token, lines, writer, ready))
    return 0


def _listen(config: ApiConfig) -> socket.socket:
    try:
        listener = socket.create_server((config.host, config.port))
    except OSError as error:
        why = os.strerror(error.errno or 0)  # Python's own sentence has the address again
        raise BadInputError(
            f"the API cannot listen on {config.host}:{config.port} ({why}); end the program that does, or choose "
            "another port in service.port"
        ) from error
    # Connections inherit it. Else an answer's body waits for the client to acknowledge its head, 40 ms later: asyncio
    # sees to that only for sockets that it has made itself.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener


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


if __name__ == "__main__":
    sys.exit(main())
