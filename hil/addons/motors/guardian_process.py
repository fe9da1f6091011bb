"""The guardian's process: waits for the host's silence or death, and then sends the stop.

The host writes lines to its stdin: first an order, then ``watch``, ``beat``, ``hold`` and ``rest`` (``guardian.py``).
Its answers go to stdout. While it watches it has the port open as the host has, so that neither a lock nor a changed
name of the port can prevent the stop.
"""

import contextlib
import enum
import json
import os
import select
import signal
import sys
import time
from typing import Any, NamedTuple

from hil.addons.motors import guardian
from hil.addons.motors.guardian import ALIVE_EVERY_S, sees_silence
from hil.core.errors import LinkError
from hil.wire.serial_port import SerialStream

_TIMES = 5
_BITS_PER_BYTE = 10  # on the line, with start and stop
_GAP_S = 0.04
_RETRY_S = 0.02
_WRITE_TIMEOUT_S = 1.0
_CHUNK = 4096
# Signals that end a group of processes, such as a service's, must not end this one before the host.
_OUTLIVED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
_STDIN, _STDOUT = 0, 1


class _Order(NamedTuple):
    port: str
    baud: int
    stop: bytes
    silence_s: float
    patience_s: float
    priority: int


class _State(enum.Enum):
    RESTS = "the host may end"
    WATCHES = "stops the robot when the host is silent or ends"
    HAS_STOPPED = "has sent the stop, and sends it again after each further command of the host"
    STANDS_BY = "stops the robot when the host ends"


class _Beside:
    """A second handle of a serial port that the host has open. It leaves the port's settings alone.

    Raises LinkError when the port cannot be opened, or accepts no bytes.
    """

    def __init__(self, port: str) -> None:
        self._port = port
        try:
            self._descriptor = os.open(port, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise LinkError(error.strerror or str(error)) from error

    def write(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                if not select.select([], [self._descriptor], [], _WRITE_TIMEOUT_S)[1]:
                    raise LinkError(f"serial port {self._port!r} took no byte for {_WRITE_TIMEOUT_S:g} s") from None
            except OSError as error:
                raise LinkError(f"serial port {self._port!r} was lost: {error.strerror}") from error

    @property
    def is_gone(self) -> bool:
        """Whether the port was unplugged: an open handle would keep its name from being used again."""
        return not os.isatty(self._descriptor)

    def close(self) -> None:
        os.close(self._descriptor)


class _Watcher:
    def __init__(self, order: _Order, received: bytes) -> None:
        self._order = order
        self._rest = received
        self._sees_silence = sees_silence(order.port)
        self._state = _State.RESTS
        self._session = 0
        self._due_s = self._alive_s = 0.0
        self._beside: _Beside | None = None

    def run(self) -> int:
        """Watch until the host ends. Return the exit status: 0 if the robot is at rest or was stopped, else 3."""
        while True:
            *lines, self._rest = self._rest.split(b"\n")
            for line in lines:
                self._obey(line)
            if self._is_silent():
                self._stop_silent_host()
                continue
            data = os.read(_STDIN, _CHUNK)
            if not data:
                return self._outlive()
            self._rest += data

    def _is_silent(self) -> bool:
        """Wait for a line or for the end of ``silence_s``. A line that came while this process slept counts too."""
        if self._state is not _State.WATCHES or not self._sees_silence:
            return False
        left_s = self._due_s - time.monotonic()
        return not select.select([_STDIN], [], [], max(0.0, left_s))[0]

    def _obey(self, line: bytes) -> None:
        kind, _, number = line.partition(b" ")
        if kind == guardian.BEAT:
            self._take_beat()
        elif kind == guardian.WATCH:
            self._session = int(number)
            self._begin()
        elif kind in (guardian.HOLD, guardian.REST):
            self._state = _State.STANDS_BY if kind == guardian.HOLD else _State.RESTS
            self._close_port()

    def _begin(self) -> None:
        """Open the port and watch from now on; if the port cannot be opened, that is known before anything moves."""
        self._close_port()
        self._state = _State.STANDS_BY
        if self._sees_silence:
            try:
                self._beside = _Beside(self._order.port)
            except LinkError as error:
                _answer(guardian.REFUSED, b"%d %s" % (self._session, str(error).encode()))
                return
        self._state = _State.WATCHES
        self._due_s = time.monotonic() + self._order.silence_s
        _answer(guardian.WATCHING, b"%d" % self._session)

    def _take_beat(self) -> None:
        now_s = time.monotonic()
        if self._state is _State.HAS_STOPPED:
            # The host goes on until it has read our answer STOPPED.
            with contextlib.suppress(LinkError):
                if self._beside is not None:
                    self._beside.write(self._order.stop)
        elif self._state is _State.WATCHES:
            self._due_s = now_s + self._order.silence_s
            if now_s > self._alive_s + ALIVE_EVERY_S:
                self._alive_s = now_s
                _answer(guardian.ALIVE)
                if self._beside is not None and self._beside.is_gone:
                    self._close_port()

    def _stop_silent_host(self) -> None:
        self._state = _State.HAS_STOPPED
        _answer(guardian.STOPPED, b"%d" % self._session)
        silence = f"no command has come from the host for {self._order.silence_s:g} s"
        try:
            self._send(host_lives=True)
        except LinkError as error:
            _print(f"{silence}, and the robot could not be stopped: {error}")
        else:
            _print(f"{silence}; the guardian has sent the stop to {self._order.port!r} {_TIMES} times")

    def _outlive(self) -> int:
        """Stop the robot after the host has ended, if it has to be stopped; return the exit status."""
        if self._state is _State.RESTS:
            return 0
        try:
            self._send(host_lives=False)
        except LinkError as error:
            _print(f"the host has ended without a stop, and the robot could not be stopped: {error}")
            return 3
        _print(f"the host has ended without a stop; the guardian has sent it to {self._order.port!r} {_TIMES} times")
        return 0

    def _send(self, *, host_lives: bool) -> None:
        """Send the stop, with retries for ``patience_s``. Raises LinkError when none succeeded."""
        deadline = time.monotonic() + self._order.patience_s
        while True:
            try:
                return self._send_once(host_lives=host_lives)
            except LinkError:
                if time.monotonic() > deadline:
                    raise
            time.sleep(_RETRY_S)

    def _send_once(self, *, host_lives: bool) -> None:
        if self._beside is not None:
            try:
                return self._repeat(self._beside)
            except LinkError:
                self._close_port()
        try:
            stream = SerialStream(self._order.port, self._order.baud)
        except LinkError:
            if not (host_lives and self._sees_silence):
                raise
            # The host itself has the port open, so that its settings are right.
            self._beside = _Beside(self._order.port)
            return self._repeat(self._beside)
        with contextlib.closing(stream):
            return self._repeat(stream)

    def _repeat(self, writer: SerialStream | _Beside) -> None:
        stop = self._order.stop
        for _ in range(_TIMES):
            writer.write(stop)
            # The line may damage one of them; and all bytes must be out before the port is closed.
            time.sleep(max(_GAP_S, len(stop) * _BITS_PER_BYTE / self._order.baud))

    def _close_port(self) -> None:
        if self._beside is not None:
            self._beside.close()
            self._beside = None


def _answer(kind: bytes, words: bytes = b"") -> None:
    with contextlib.suppress(OSError):  # the host has ended
        os.write(_STDOUT, b" ".join(filter(None, (kind, words))) + b"\n")


def _print(sentence: str) -> None:
    # The reader of the host's stderr may have ended with it.
    with contextlib.suppress(OSError):
        print(sentence, file=sys.stderr, flush=True)


def _take_priority(priority: int) -> None:
    """Take the host's priority: otherwise a law that never returns would keep this process from running."""
    if sys.platform == "linux" and priority:
        with contextlib.suppress(OSError):  # the host was refused it too
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def _main() -> int:
    for name in _OUTLIVED:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    received = b""
    while b"\n" not in received:
        data = os.read(_STDIN, _CHUNK)
        if not data:
            return 0  # the host ended before it had opened anything
        received += data
    line, _, received = received.partition(b"\n")
    fields: dict[str, Any] = json.loads(line)
    order = _Order(**fields | {"stop": bytes.fromhex(fields["stop"])})
    _take_priority(order.priority)
    _answer(guardian.READY)
    return _Watcher(order, received).run()


if __name__ == "__main__":
    sys.exit(_main())
