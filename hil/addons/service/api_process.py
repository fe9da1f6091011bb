"""The process that answers HTTP for a service; ``hil.addons.service.api_child`` starts it.

It reads the config and then answers and statuses from stdin, and writes orders to stdout and the log to stderr. When
stdin ends, the control process has ended; then it informs its clients and ends too. It controls nothing that moves.
"""

import asyncio
import os
import signal
import socket
import sys
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.service import logs
from hil.addons.service.api.access import Access, ClientsFile
from hil.addons.service.api.audit import Audit
from hil.addons.service.api.control import Control
from hil.addons.service.discovery import Service, running
from hil.addons.service.messages import HOST, ApiConfig, Limits
from hil.core.errors import BadInputError
from hil.core.json_lines import LineReader, LineWriter
from hil.core.tokens import clear_tokens, make_token, read_token, state_folder, token_file

LONGEST_QUEUE = 4096
"""Connections that the system keeps until they are accepted."""


def main() -> int:
    """Serve until the control process ends, and return 0. Return 2 when the API cannot be served as configured."""
    if (begun := begin("api")) is None:
        return 0
    config, _, writer = begun
    try:
        listener = listen(config.port)
        port = listener.getsockname()[1]
        services = running()
        clear_tokens("services", [service.port for service in services])
        path = _token_file(config, port, services)
        audit_file = state_folder("audit") / f"{port}.jsonl" if config.audit is None else Path(config.audit).absolute()
        taken = OrderPort(*begun, listener, *known(config, path), Audit(audit_file))
    except BadInputError as error:
        writer.send({"refused": str(error)})
        return error.exit_code
    # Imported late: it takes a second, and a refusal should be quick.
    from hil.addons.service.api.server import serve

    ready = {"url": f"http://{HOST}:{port}", "token_file": str(path), "audit": str(audit_file)}
    asyncio.run(serve(taken, ready))
    return 0


class OrderPort(NamedTuple):
    """A port that takes orders: its pipes to the control process, its socket, the access rights and the audit log.

    ``clients`` keeps ``access`` as the file of further clients says; None without such a file.
    """

    config: ApiConfig
    lines: LineReader
    writer: LineWriter
    listener: socket.socket
    access: Access
    clients: ClientsFile | None
    audit: Audit

    @property
    def number(self) -> int:
        """The port's number."""
        return int(self.listener.getsockname()[1])

    def control(self) -> Control:
        """Return the way to the control process, for the running event loop."""
        return Control(self.lines, self.writer, self.config.limits.twist_timeout_s, self.audit)

    def tasks(self, control: Control) -> list[Coroutine[Any, Any, None]]:
        """Return the tasks to run next to the server, until cancelled."""
        keeping = [] if self.clients is None else [self.clients.keep(self.access)]
        return [control.live(), self.audit.keep(), *keeping]


def begin(process: str) -> tuple[ApiConfig, LineReader, LineWriter] | None:
    """Return the config and the pipes of a process that takes orders; None where the control process has ended.

    ``process`` is its name in the log.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the control process handles it
    writer = LineWriter(os.dup(1))
    os.dup2(2, 1)  # a library's prints must not mix with the orders
    lines = LineReader(0)
    if (record := lines.read()) is None:
        return None
    values: Any = record["config"]
    config = ApiConfig(**{**values, "limits": Limits(**values["limits"])})
    logs.configure(config.log, process)
    return config, lines, writer


def known(config: ApiConfig, token: Path) -> tuple[Access, ClientsFile | None]:
    """Return who has access, and the file of further clients. Raises BadInputError."""
    clients = None if config.clients_file is None else ClientsFile(Path(config.clients_file))
    return Access(read_token(token), {} if clients is None else clients.others), clients


def listen(port: int) -> socket.socket:
    """Return a listening socket at a port of the loopback address; 0 picks one. Raises BadInputError."""
    try:
        listener = socket.create_server((HOST, port))
    except OSError as error:
        why = os.strerror(error.errno or 0)  # without the address, which Python's message repeats
        raise BadInputError(
            f"the service cannot listen on {HOST}:{port} ({why}); end the program that uses it, or choose "
            "another port in service.port"
        ) from error
    # Connections inherit it. Without it an answer's body waits 40 ms, until the client acknowledges its header; asyncio
    # sets it only on sockets that it makes itself.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener


def _token_file(config: ApiConfig, port: int, services: Sequence[Service]) -> Path:
    """Return the file with the token. Make it if it does not exist, or if each start has a new token.

    Raises BadInputError when one of the running services has the port elsewhere, whose token this one would replace.
    """
    path = token_file("services", port) if config.token_file is None else Path(config.token_file).absolute()
    if config.token_file is None and any(service.port == port for service in services):
        raise BadInputError(
            f"port {port}: a service in another network namespace (a container) has it, and its token in {path}; "
            "choose another service.port, or a state folder of its own (XDG_STATE_HOME)"
        )
    if config.token_file is None or not path.exists():
        make_token(path)
    return path


if __name__ == "__main__":
    sys.exit(main())
