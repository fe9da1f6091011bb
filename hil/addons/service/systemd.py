"""A service under systemd: its unit, and its messages to the manager (sd_notify(3)) over a datagram socket.

Without ``NOTIFY_SOCKET`` in the environment all this does nothing, so that the same program runs by hand.
"""

import getpass
import os
import re
import shutil
import socket
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from hil.core.errors import BadInputError
from hil.core.extensions import code_is_refused
from hil.core.printable import printable

_UNIT = Path(__file__).with_name("hil-serve.service")


class Notifier:
    """Tells systemd when the service is ready, its status, that it is alive, and when it ends.

    ``environment`` has ``NOTIFY_SOCKET``, and ``WATCHDOG_USEC`` if the unit has a watchdog. No method waits: when the
    manager's socket is full a message is lost, except the beat, which is sent at the next call.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._socket: socket.socket | None = None
        address = environment.get("NOTIFY_SOCKET", "")
        if sys.platform == "linux" and address[:1] in ("/", "@"):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
            try:
                # A name that begins with @ is an abstract one: its first byte is zero.
                self._socket.connect("\0" + address[1:] if address[0] == "@" else address)
            except OSError:
                self.close()  # the manager that started this process is gone
        own_pid, watchdog_us = str(os.getpid()), environment.get("WATCHDOG_USEC", "0")
        is_meant = environment.get("WATCHDOG_PID", own_pid) == own_pid and watchdog_us.isdecimal()
        # A third of the period, so that one beat may be lost.
        self._beat_ns = int(watchdog_us) * 1000 // 3 if is_meant and self._socket is not None else 0
        # Without a watchdog the next beat is never due.
        self._next_beat_ns = 0 if self._beat_ns else sys.maxsize

    def ready(self) -> None:
        """Report that the service has started: units that wait for it may start."""
        self._send("READY=1")

    def status(self, sentence: str) -> None:
        """Show a sentence in ``systemctl status``."""
        self._send("STATUS=" + printable(sentence).replace("\n", " "))

    def beat(self, now_ns: int) -> None:
        """Feed the watchdog; called in each tick (0.1 µs when no beat is due). ``now_ns``: by any monotonic clock."""
        if now_ns >= self._next_beat_ns and self._send("WATCHDOG=1"):
            self._next_beat_ns = now_ns + self._beat_ns

    def stopping(self) -> None:
        """Report that the service is ending, so that its silence is no failure."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Close the socket; nothing is sent any more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, assignment: str) -> bool:
        if self._socket is None:
            return False
        try:
            self._socket.send(assignment.encode())
        except OSError:
            return False
        return True


def unit(config: str, options: Sequence[str] = ()) -> str:
    """Return the unit that serves a configuration (a file, or a shipped name) as the present user.

    ``options`` are options of hil serve, such as ``--allow-motion``; relative paths in them start from the unit's
    working directory, which is the present one. Raises BadInputError for words that systemd cannot take in a unit.
    """
    path = Path(config)
    what = str(path.absolute()) if path.suffix == ".toml" else config
    for word in (what, *options):
        if any(character in word for character in "\n\r\0"):
            raise BadInputError(f"{word!r}: a unit cannot hold a line break; leave it out, or rename the file")
    hil = shutil.which("hil", path=str(Path(sys.executable).parent))
    command = [hil] if hil else [sys.executable, "-P", "-m", "hil.cli.main"]
    command += ["--no-code"] if code_is_refused() else []
    filled = {
        "@CONFIG@": _quoted(what),
        "@HIL@": " ".join(_quoted(word) for word in command),
        "@OPTIONS@": " ".join(_quoted(word) for word in ("--log", "json", *options)),
        "@USER@": getpass.getuser(),
        "@FOLDER@": str(Path.cwd()).replace("%", "%%"),
    }
    return re.sub("@[A-Z]+@", lambda place: filled[place.group()], _UNIT.read_text(encoding="utf-8"))


def _quoted(word: str) -> str:
    """Return a word of a command line quoted for a unit, with ``%`` and ``$`` escaped (systemd.service(5))."""
    escaped = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{escaped}"' if escaped != word or " " in word or "'" in word else word
