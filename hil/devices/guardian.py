"""A process that stops a robot when the host dies: for bases whose firmware drives on when commands end.

The host holds the only writing end of a pipe to it. When that closes without a goodbye, the host is gone, by SIGKILL,
by the system's killer of processes, by a crash of the interpreter or an exception that nobody caught: then the guardian
opens the port, as soon as the system has given it back, and sends the stop a few times. GUARDIAN.md says which ways to
die it does not cover: it lives on the same computer and uses the same cable.
"""

import contextlib
import json
import signal
import subprocess
import sys
import threading
import time

from hil.child import away_from_terminal, child_environment, module_command
from hil.errors import DeviceError, LinkError
from hil.links.serial_port import SerialStream

_READY = b"ready\n"
_GOODBYE = b"goodbye\n"
_TIMES = 5
_BITS_PER_BYTE = 10  # on the line, with start and stop
_GAP_S = 0.04
_RETRY_S = 0.02
_START_LIMIT_S = 10.0
_EXIT_TIMEOUT_S = 10.0
# What ends a whole group of processes in order, such as a service's, must not end this one before the host.
_OUTLIVED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")


class Guardian:
    """Watches over the process that makes it until ``dismiss``; returns when it does.

    ``stop`` are the bytes that stop whatever is behind ``port``; they must be right at any time, also in the middle of
    a frame that the host has not finished. A port that is still not free ``patience_s`` after the host's death belongs
    to somebody else, whose business the robot then is. Raises DeviceError when the process does not start.
    """

    def __init__(self, port: str, baud: int, stop: bytes, *, patience_s: float = 3.0) -> None:
        try:
            self._process = subprocess.Popen(
                module_command("hil.devices.guardian"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                env=child_environment(),
                **away_from_terminal(),
            )
        except OSError as error:
            raise DeviceError(f"the guardian of serial port {port!r} could not be started: {error}") from error
        order = {"port": port, "baud": baud, "stop": stop.hex(), "patience_s": patience_s}
        self._tell(json.dumps(order).encode() + b"\n")
        out = self._process.stdout
        assert out is not None
        patience = threading.Timer(_START_LIMIT_S, self._process.kill)
        patience.start()
        try:
            is_ready = out.readline() == _READY
        except BaseException:  # Ctrl-C: nothing has moved yet that it would have to stop
            self.dismiss()
            raise
        finally:
            patience.cancel()
        if not is_ready:
            self.dismiss()
            raise DeviceError(
                f"the guardian of serial port {port!r} did not start (exit status {self._process.returncode}); without "
                "it nothing would stop the robot if this process is killed"
            )

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def is_watching(self) -> bool:
        """Whether it is there: somebody may have killed it."""
        return self._process.poll() is None

    def dismiss(self) -> None:
        """Say goodbye, after the host's own stop: the port is left alone. Dismissing twice is allowed."""
        self._tell(_GOODBYE)
        self._part()

    def leave_it_to(self) -> None:
        """Have the robot stopped by the guardian, when the host could not and has closed the port."""
        self._part()

    def _part(self) -> None:
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._process.wait(_EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _tell(self, line: bytes) -> None:
        pipe = self._process.stdin
        # One that has been killed cannot be told anything; ``is_watching`` says so.
        with contextlib.suppress(OSError):
            if pipe is not None and not pipe.closed:
                pipe.write(line)


def _watch() -> int:
    """Be the process. Returns its exit status: 0 when nothing had to be done, or the stop was sent."""
    for name in _OUTLIVED:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    line = sys.stdin.buffer.readline()
    if not line:
        return 0  # the host was gone before it had opened anything
    order = json.loads(line)
    sys.stdout.buffer.write(_READY)
    sys.stdout.buffer.flush()
    if sys.stdin.buffer.read().endswith(_GOODBYE):
        return 0
    port = order["port"]
    try:
        _send(port, order["baud"], bytes.fromhex(order["stop"]), order["patience_s"])
    except LinkError as error:
        _say(f"the host has died, and the robot could not be stopped: {error}")
        return 3
    _say(f"the host has died without a stop; the guardian has sent it to {port!r} {_TIMES} times")
    return 0


def _send(port: str, baud: int, stop: bytes, patience_s: float) -> None:
    """Open the port and send, anew until it works. Raises LinkError when the time is over."""
    deadline = time.monotonic() + patience_s
    while True:
        try:
            stream = SerialStream(port, baud)
            try:
                for _ in range(_TIMES):
                    stream.write(stop)
                    # One that the line damages is not the only one, and all are out when it closes.
                    time.sleep(max(_GAP_S, len(stop) * _BITS_PER_BYTE / baud))
            finally:
                stream.close()
            return
        except LinkError:
            if time.monotonic() > deadline:
                raise
            time.sleep(_RETRY_S)


def _say(sentence: str) -> None:
    # Whoever read the host's errors may be gone with it.
    with contextlib.suppress(OSError):
        print(sentence, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(_watch())
