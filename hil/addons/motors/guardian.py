"""The host's side of the guardian, a process that stops the robot when the host dies or is silent for too long.

It is for motor controllers whose firmware drives on when commands end. With each command the host sends a beat through
a pipe that it alone writes to. The guardian sends the stop when the beats or the pipe end, and reports that to the
host. Only its start is waited for. GUARDIAN.md says what it does not cover; ``guardian_process.py`` is the process.
"""

import contextlib
import enum
import json
import os
import subprocess
import sys
import threading
import time
from typing import TYPE_CHECKING

from hil.core.errors import DeviceError
from hil.core.subprocesses import away_from_terminal, child_environment, module_command

if TYPE_CHECKING:  # the guardian's process imports this module, and starts in half the time without these
    from hil.robot.driver import Dialect, Driver
    from hil.wire.link import LinkUrl

BEAT = b"beat"
HOLD = b"hold"
REST = b"rest"
WATCH = b"watch"  # with the number of the session
READY = b"ready"
ALIVE = b"alive"
WATCHING = b"watching"  # with the number of the session, as the next two
STOPPED = b"stopped"
REFUSED = b"refused"  # and why

ALIVE_EVERY_S = 0.5
_HUNG_NS = 1_500_000_000  # three answers that did not come
_LEAST_GAP_NS = 5_000_000  # between two beats: each wakes the guardian, and 200 in a second are enough
_START_LIMIT_S = 10.0
_EXIT_TIMEOUT_S = 10.0
_CHUNK = 4096


def sees_silence(port: str) -> bool:
    """Return whether a second process can write to a serial port that the host has open.

    Under POSIX it can: pyserial locks with ``flock``, which binds only programs that lock too. Windows opens a port
    once, and what a URL of pyserial stands for mostly serves one client.
    """
    return sys.platform != "win32" and "://" not in port


class HostWatch:
    """Watches this process from the arming of the robot until its wheels rest.

    No call waits for anything, but ``begin`` while it starts a guardian in place of one that died.

    This class itself watches nothing. It is used for a robot in this process, for one with its own watchdog, and for
    one whose link a second process cannot use.
    """

    def __init__(self, warning: str | None = None) -> None:
        self._warning = warning

    @property
    def warning(self) -> str | None:
        """A warning of the cases that are not covered, shown before anything moves; None without one."""
        return self._warning

    def begin(self) -> bool:
        """Ask for the watch, before the robot is armed; return whether it is confirmed. Call this until it is.

        Raises DeviceError when the watch is refused or impossible.
        """
        return True

    @property
    def failure(self) -> str | None:
        """Why the robot must not be driven further: it was stopped because of our silence, or the watch has failed.

        None if neither is so. ``begin`` clears it.
        """
        return None

    def beat(self) -> None:
        """Report that a command or a step of a stop was just sent."""

    def hold(self) -> None:
        """Report that the stop was sent and no command follows for a while. Our death is still watched for."""

    def rest(self) -> None:
        """Report that the wheels rest: nothing has to be stopped until ``begin``."""

    def release(self) -> None:
        """End the watch, after the link was closed; unless the wheels rest, it stops the robot. May be called twice."""


class _Phase(enum.Enum):
    REST = "nothing has to be stopped"
    ASKED = "asked to watch, not confirmed yet"
    WATCHED = "each command sends a beat"
    HELD = "the stop was sent: beats are not expected, and only our death is watched for"


class Guardian(HostWatch):
    """Watches this process from another one, which stops the motors when this one dies or hangs.

    ``stop``: the bytes that stop the motors behind ``port`` at any time, even after a part of a frame. They are sent
    after ``silence_s`` without a beat. If the port is not free ``patience_s`` after the host's death, another program
    has taken the robot over, and nothing is sent. ``priority``: the host's real-time priority, 0 for none. In place of
    a process that died or hung, ``begin`` starts another one, which takes a third of a second. Raises DeviceError when
    the process does not start.
    """

    def __init__(
        self, port: str, baud: int, stop: bytes, *, silence_s: float, priority: int = 0, patience_s: float = 3.0
    ) -> None:
        self._port = port
        self._silence_s = silence_s
        self._silence_ns = round(silence_s * 1e9)
        order = {"port": port, "baud": baud, "stop": stop.hex(), "silence_s": silence_s}
        self._order = json.dumps(order | {"patience_s": patience_s, "priority": priority}).encode()
        self._phase = _Phase.REST
        self._session = 0
        self._beat_ns = 0
        self._failure: str | None = None
        # Set by the thread that reads the answers; each is one assignment.
        self._watching = self._stopped = 0  # sessions
        self._refused = (0, "")
        self._answered_ns = 0
        self._lock = threading.Lock()  # of phase and process; held only briefly
        self._process: subprocess.Popen[bytes] | None = None
        self._start()

    @property
    def pid(self) -> int | None:
        """Its process id; None after it has ended."""
        process = self._process
        return None if process is None else process.pid

    @property
    def warning(self) -> str | None:
        if sees_silence(self._port):
            return (
                f"a guardian process stops the robot if this program dies or sends nothing for {self._silence_s:g} s "
                "(device.guardian_s), but if both are killed or stopped together, as with a whole container or group "
                "of processes, nothing stops it"
            )
        return (
            "a guardian process stops the robot if this program dies, but if it hangs, or both are killed together, "
            f"nothing stops it: {self._port} lets no second process in"
        )

    # Called by the tick

    def begin(self) -> bool:
        if self._phase is _Phase.WATCHED and self.failure is None:
            return True
        if self._phase is not _Phase.ASKED or self._process is None:
            if self._process is None:
                self._start()
            self._session += 1
            self._failure = None
            self._answered_ns = time.monotonic_ns()
            self._enter(_Phase.ASKED)
        number, why = self._refused
        if number == self._session:
            raise DeviceError(
                f"the guardian cannot open serial port {self._port!r} beside this program ({why}), and nothing is "
                "armed without it; close whatever else uses the port"
            )
        if self._watching == self._session:
            with self._lock:
                self._write(BEAT)  # its time has run since its answer, and our next beat may be a period away
            self._beat_ns = time.monotonic_ns()
            self._phase = _Phase.WATCHED
            return True
        self._end_if_hung(time.monotonic_ns())
        return False

    @property
    def failure(self) -> str | None:
        if self._phase is _Phase.WATCHED:
            why: str | None = None
            if (silent_ns := time.monotonic_ns() - self._beat_ns) > self._silence_ns:
                why = (
                    f"no command went out for {silent_ns * 1e-9:.2f} s, and the guardian stops the robot after "
                    f"{self._limit}"
                )
            elif self._stopped == self._session:
                why = f"no command reached the guardian in time, and it stopped the robot after {self._limit}"
            elif self._process is None:
                why = "the guardian died, and without it nothing would stop the robot if this program did (GUARDIAN.md)"
            elif self._end_if_hung(self._beat_ns):
                why = "the guardian has not answered for 1.5 s, and was ended (GUARDIAN.md)"
            if why is not None:
                self._failure = why
                self._enter(_Phase.HELD)
        return self._failure

    def beat(self) -> None:
        if self._phase is not _Phase.WATCHED:
            return
        now_ns = time.monotonic_ns()
        silent_ns = now_ns - self._beat_ns
        # After too long a silence no beat may hide the failure.
        if _LEAST_GAP_NS <= silent_ns <= self._silence_ns:
            with self._lock:
                self._write(BEAT)
            self._beat_ns = now_ns
            if silent_ns >= ALIVE_EVERY_S * 1e9:  # it answers only beats, so our pause is not its silence
                self._answered_ns = now_ns

    def hold(self) -> None:
        if self._phase in (_Phase.ASKED, _Phase.WATCHED):
            self._enter(_Phase.HELD)

    def rest(self) -> None:
        if self._phase is not _Phase.REST:
            self._enter(_Phase.REST)

    def release(self) -> None:
        if (process := self._process) is not None:
            _close(process)
        self._reader.join(_EXIT_TIMEOUT_S)

    @property
    def _limit(self) -> str:
        return f"{self._silence_s:g} s of silence (device.guardian_s)"

    def _enter(self, phase: _Phase) -> None:
        watch = WATCH + b" %d" % self._session
        with self._lock:
            self._phase = phase
            self._write({_Phase.ASKED: watch, _Phase.REST: REST}.get(phase, HOLD))

    def _write(self, line: bytes) -> None:
        process = self._process
        if process is None or process.stdin is None or process.stdin.closed:
            return
        # A dead or hung guardian takes no line; ``failure`` reports that.
        with contextlib.suppress(OSError):
            process.stdin.write(line + b"\n")

    def _end_if_hung(self, written_ns: int) -> bool:
        process = self._process
        if process is None or written_ns - self._answered_ns < _HUNG_NS:
            return False
        process.kill()
        self._answered_ns = time.monotonic_ns()  # the time of the next one begins
        return True

    # The process, and the thread that waits for its answers and its death

    def _start(self) -> None:
        self._process = process = self._started()
        self._answered_ns = time.monotonic_ns()
        reader = threading.Thread(target=self._read, args=(process,), name="guardian", daemon=True)
        try:
            reader.start()
        except RuntimeError as error:
            self._process = None
            _close(process)
            raise self._not_started(error) from error
        self._reader = reader

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        rest = b""
        with process.stdout as answers:
            while data := os.read(answers.fileno(), _CHUNK):
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    self._take(line)
        with self._lock:  # no other thread is writing to it
            self._process = None
            process.stdin.close()
        process.kill()  # it may only have closed its pipe
        process.wait()

    def _take(self, line: bytes) -> None:
        kind, _, words = line.partition(b" ")
        number, _, why = words.partition(b" ")
        self._answered_ns = time.monotonic_ns()
        if kind == WATCHING:
            self._watching = int(number)
        elif kind == STOPPED:
            self._stopped = int(number)
        elif kind == REFUSED:
            self._refused = (int(number), why.decode())

    def _started(self) -> subprocess.Popen[bytes]:
        """Start the process and wait until it is ready. Raises DeviceError."""
        try:
            process = subprocess.Popen(
                module_command("hil.addons.motors.guardian_process"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                env=child_environment(),
                **away_from_terminal(),
            )
        except OSError as error:
            raise self._not_started(error) from error
        assert process.stdin is not None
        assert process.stdout is not None
        patience = threading.Timer(_START_LIMIT_S, process.kill)
        try:
            patience.start()
            with contextlib.suppress(OSError):  # it will not become ready then
                process.stdin.write(self._order + b"\n")
            if process.stdout.readline() != READY + b"\n":
                _close(process)
                raise DeviceError(
                    f"the guardian of serial port {self._port!r} did not start (exit status {process.returncode}); "
                    "without it nothing would stop the robot if this process is killed"
                )
        except BaseException as error:  # Ctrl-C: nothing has moved yet that would have to be stopped
            _close(process)
            process.stdout.close()
            if isinstance(error, (OSError, RuntimeError)):  # no thread could be started
                raise self._not_started(error) from error
            raise
        finally:
            patience.cancel()
        if sys.platform != "win32":
            os.set_blocking(process.stdin.fileno(), False)  # a hung guardian must not delay a tick
        return process

    def _not_started(self, error: Exception) -> DeviceError:
        return DeviceError(f"the guardian of serial port {self._port!r} could not be started: {error}")


def watch_over(made: "Dialect", driver: "Driver", url: "LinkUrl", silence_s: float, priority: int) -> HostWatch:
    """Return the watch over motors elsewhere; a guardian process if they have no watchdog and a serial line.

    ``silence_s`` is the silence after which it stops them; ``priority`` is this process's real-time priority, 0 for
    none. Raises DeviceError when the guardian does not start.
    """
    if driver.capabilities.watchdog != "none":
        return HostWatch()
    if url.serial_port is None or made.make_framing is None:
        return HostWatch(
            "nothing that is known to us stops the robot if this program dies or hangs: a guardian process watches "
            "over serial lines alone; keep a switch that cuts the motors' power within reach"
        )
    framing = made.make_framing()
    stop = b"".join(framing.encode(frame) for frame in driver.last_stop())
    return Guardian(*url.serial_port, stop, silence_s=silence_s, priority=priority)


def _close(process: subprocess.Popen[bytes]) -> None:
    """Close the pipe, at which the process stops the robot if it has to, and wait for its end."""
    if process.stdin is not None:
        process.stdin.close()
    try:
        process.wait(_EXIT_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
