"""The guardian as the host has it: a process that stops the robot when the host dies, or is silent for too long.

It is for motor controllers whose firmware drives on when commands end. The host beats with each command, through a
pipe of which it holds the only writing end. The guardian sends the stop when the beats cease or the pipe ends, and
tells the host so. Nothing here waits for the guardian but its start. GUARDIAN.md says what it does not cover; what the
process does is in ``guardian_process.py``.
"""

import contextlib
import enum
import json
import os
import subprocess
import sys
import threading
import time

from hil.core.errors import DeviceError
from hil.core.subprocesses import away_from_terminal, child_environment, module_command

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
_HUNG_NS = 1_500_000_000  # without an answer: three that did not come
_LEAST_GAP_NS = 5_000_000  # between two beats: each wakes the guardian, and 200 a second say as much as 1000
_START_LIMIT_S = 10.0
_EXIT_TIMEOUT_S = 10.0
_RETRY_S = 1.0
_CHUNK = 4096


def sees_silence(port: str) -> bool:
    """Tell whether a second process can write to a serial port while the host holds it.

    Under POSIX it can: the lock of pyserial is ``flock``, which keeps out those alone who ask for it. Windows opens a
    port once, and what is behind a URL of pyserial mostly serves one client.
    """
    return sys.platform != "win32" and "://" not in port


class _Phase(enum.Enum):
    REST = "nothing is to be stopped"
    ASKED = "to be watched, which is not confirmed yet"
    WATCHED = "each command beats"
    HELD = "the robot has its stop: no command beats, and our death alone is watched for"


class Guardian:
    """See ``hil.drivers.host_watch.HostWatch``. A guardian that dies or hangs is started anew, beside the ticks.

    ``stop`` are the bytes that stop whatever is behind ``port``; they must be right at any time, also in the middle of
    a frame that the host has not finished. After ``silence_s`` without a beat it sends them. A port that is still not
    free ``patience_s`` after the host's death belongs to somebody else, whose business the robot then is.
    ``priority`` is the host's own in real time, 0 for none. Raises DeviceError when the process does not start.
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
        # What the keeper, which reads the answers, tells the ticks; each is assigned whole.
        self._watching = self._stopped = 0  # sessions
        self._refused = (0, "")
        self._answered_ns = 0
        self._problem: str | None = None
        self._lock = threading.Lock()  # for a moment only: of phase and process together
        self._released = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        process = self._started()
        self._process = process
        self._keeper = threading.Thread(target=self._keep, args=(process,), name="guardian", daemon=True)
        try:
            self._keeper.start()
        except RuntimeError as error:
            _part(process)
            raise self._not_started(error) from error

    @property
    def pid(self) -> int | None:
        """Its process id; None while it is being started anew."""
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

    # Told by the ticks

    def begin(self) -> bool:
        if self._phase is _Phase.WATCHED and self.failure is None:
            return True
        if self._phase is not _Phase.ASKED:
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
                self._tell(BEAT)  # it has counted since its answer, and our next one may be a whole period away
            self._beat_ns = time.monotonic_ns()
            self._phase = _Phase.WATCHED
            return True
        if self._problem is not None:
            raise DeviceError(self._problem)
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
                why = "the guardian has not answered for 1.5 s, and is started anew (GUARDIAN.md)"
            if why is not None:
                self._failure = why
                self._enter(_Phase.HELD)
        return self._failure

    def beat(self) -> None:
        if self._phase is not _Phase.WATCHED:
            return
        now_ns = time.monotonic_ns()
        silent_ns = now_ns - self._beat_ns
        # After a silence that was too long it is the failure that is to be seen, and none of it made good.
        if _LEAST_GAP_NS <= silent_ns <= self._silence_ns:
            with self._lock:
                self._tell(BEAT)
            self._beat_ns = now_ns
            if silent_ns >= ALIVE_EVERY_S * 1e9:  # it answers beats alone: our pause is none of its own
                self._answered_ns = now_ns

    def hold(self) -> None:
        if self._phase in (_Phase.ASKED, _Phase.WATCHED):
            self._enter(_Phase.HELD)

    def rest(self) -> None:
        if self._phase is not _Phase.REST:
            self._enter(_Phase.REST)

    def release(self) -> None:
        with self._lock:
            self._released.set()
            process = self._process
        if process is not None:
            _part(process)
        self._keeper.join(_EXIT_TIMEOUT_S)

    @property
    def _limit(self) -> str:
        return f"{self._silence_s:g} s of silence (device.guardian_s)"

    def _enter(self, phase: _Phase) -> None:
        with self._lock:
            self._phase = phase
            self._tell(self._line_of(phase))

    def _line_of(self, phase: _Phase) -> bytes:
        match phase:
            case _Phase.ASKED:
                return WATCH + b" %d" % self._session
            case _Phase.REST:
                return REST
            case _:
                return HOLD

    def _tell(self, line: bytes) -> None:
        process = self._process
        if process is None or process.stdin is None or process.stdin.closed:
            return
        # One that has died cannot be told anything, and one that hangs takes nothing more: ``failure`` says so.
        with contextlib.suppress(OSError):
            process.stdin.write(line + b"\n")

    def _end_if_hung(self, told_ns: int) -> bool:
        """End a guardian that has not answered what it was told until then, so that another one is started."""
        process = self._process
        if process is None or told_ns - self._answered_ns < _HUNG_NS:
            return False
        process.kill()
        self._answered_ns = time.monotonic_ns()  # the next one has its time
        return True

    # The keeper: a thread that waits for answers, and for the guardian's death

    def _keep(self, process: subprocess.Popen[bytes]) -> None:
        while True:
            self._listen(process)
            assert process.stdin is not None
            with self._lock:  # nobody is writing to it
                self._process = None
                process.stdin.close()
            process.kill()  # one that has but closed its pipe is of no use
            process.wait()
            found = self._started_anew()
            if found is None:
                return
            process = found

    def _listen(self, process: subprocess.Popen[bytes]) -> None:
        """Take answers until there is no guardian to give one."""
        assert process.stdout is not None
        rest = b""
        with process.stdout as answers:
            while data := os.read(answers.fileno(), _CHUNK):
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    self._take(line)

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

    def _started_anew(self) -> "subprocess.Popen[bytes] | None":
        """Return a new process that knows what the old one did; None when the guardian was released meanwhile."""
        while not self._released.is_set():
            try:
                process = self._started()
            except DeviceError as error:
                self._problem = str(error)
                self._released.wait(_RETRY_S)
                continue
            with self._lock:
                self._problem = None
                self._answered_ns = time.monotonic_ns()
                self._process = process
                if self._phase is not _Phase.REST:
                    self._tell(self._line_of(self._phase))
            if self._released.is_set():
                _part(process)
            return process
        return None

    def _started(self) -> "subprocess.Popen[bytes]":
        """Start the process and wait until it is ready. Raises DeviceError."""
        try:
            process = subprocess.Popen(
                module_command("hil.drivers.guardian_process"),
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
            with contextlib.suppress(OSError):  # then it does not become ready
                process.stdin.write(self._order + b"\n")
            is_ready = process.stdout.readline() == READY + b"\n"
        except BaseException as error:  # Ctrl-C: nothing has moved yet that it would have to stop
            _part(process)
            process.stdout.close()
            if isinstance(error, (OSError, RuntimeError)):  # no thread is to be had
                raise self._not_started(error) from error
            raise
        finally:
            patience.cancel()
        if not is_ready:
            _part(process)
            process.stdout.close()
            raise DeviceError(
                f"the guardian of serial port {self._port!r} did not start (exit status {process.returncode}); without "
                "it nothing would stop the robot if this process is killed"
            )
        if sys.platform != "win32":
            os.set_blocking(process.stdin.fileno(), False)  # one that hangs must not hold up a tick
        return process

    def _not_started(self, error: Exception) -> DeviceError:
        return DeviceError(f"the guardian of serial port {self._port!r} could not be started: {error}")


def _part(process: "subprocess.Popen[bytes]") -> None:
    """End the pipe, by which the process does what is left to do, and wait for its end."""
    if process.stdin is not None:
        process.stdin.close()
    try:
        process.wait(_EXIT_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
