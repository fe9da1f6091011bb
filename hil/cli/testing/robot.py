"""A virtual robot in its own process (``hil device``), and a link to it without a controller, for tests."""

import contextlib
import queue
import subprocess
import tempfile
import threading
import time
from collections import deque
from typing import IO, TypeVar

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import Message
from hil.cli.testing.overrides import Overrides
from hil.core.errors import BadInputError, DeviceError
from hil.core.subprocesses import away_from_terminal, child_environment, module_command
from hil.scenario import Scenario
from hil.wire.url import parse_link

Answer = TypeVar("Answer", bound=Message)

_READY_S = 60.0
_END_S = 10.0
_READY = "ready "


class RobotProcess:
    """A virtual robot that is ready. It ends with ``close``, and also when this process ends in any way.

    Raises BadInputError when the scenario cannot run in a process of its own, DeviceError when it is never ready.

    Attributes:
        scenario: the robot's scenario.
        link: URL of the host's end of its link, such as ``serial:/dev/pts/3``.
        truth: URL of its truth socket, such as ``tcp://127.0.0.1:40123``.
        pid: process id.
    """

    def __init__(self, scenario: Scenario, overrides: Overrides) -> None:
        self.scenario = scenario
        self._ended_by_us = False
        name = scenario.name if scenario.path is None else str(scenario.path)
        with contextlib.ExitStack() as resources:
            self._errors: IO[bytes] = resources.enter_context(tempfile.TemporaryFile())
            self._process = subprocess.Popen(
                module_command("hil.cli.main", "device", name, "--until-eof", *overrides.arguments()),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env=child_environment(),
                **away_from_terminal(),
            )
            resources.callback(self._end)
            self._output: queue.SimpleQueue[str] = queue.SimpleQueue()
            self._reader = threading.Thread(target=self._read, name="robot's output", daemon=True)
            self._reader.start()
            ready = self._wait_until_ready()
            resources.pop_all()
        self.link = ready["link"]
        self.truth = ready["truth"]
        self.pid = self._process.pid

    @property
    def mode(self) -> str:
        """``lockstep`` or ``realtime``."""
        return self.scenario.loop.mode

    @property
    def is_running(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def kill(self) -> None:
        """Kill the process without warning, like a power cut."""
        self._ended_by_us = True
        self._process.kill()
        self._process.wait()

    def close(self) -> str | None:
        """End the robot; return a sentence that it printed last, or None. Closing twice is allowed.

        Raises DeviceError when it had ended by itself before.
        """
        if self._errors.closed:
            return None
        code = self._process.poll()
        try:
            self._end()
            if code is not None and not self._ended_by_us:
                raise DeviceError(f"the virtual robot of {self.scenario.name} ended by itself: {self._last_error()}")
            while not self._output.empty():
                if line := self._output.get():
                    return line
            return None
        finally:
            self._errors.close()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._output.put(line.decode(errors="replace").rstrip())
        self._output.put("")

    def _wait_until_ready(self) -> dict[str, str]:
        """Wait for the line that reports the robot ready, and return its fields."""
        try:
            line = self._output.get(timeout=_READY_S)
        except queue.Empty:
            raise DeviceError(
                f"the virtual robot of {self.scenario.name} was not ready within {_READY_S:g} s; try hil device"
            ) from None
        if not line.startswith(_READY):
            code = self._process.wait()
            kind = BadInputError if code == BadInputError.exit_code else DeviceError
            raise kind(f"the virtual robot of {self.scenario.name} did not start: {line or self._last_error()}")
        return dict(part.split("=", 1) for part in line.removeprefix(_READY).split(" ", 3))

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(_END_S)
        for pipe in filter(None, (self._process.stdin, self._process.stdout)):
            pipe.close()

    def _last_error(self) -> str:
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1].removeprefix("hil: ") if lines else f"exit status {self._process.returncode}"


class RobotLink:
    """An open link to a virtual robot. It sends messages of wheel.dbc, or any frame made by hand.

    In lockstep the robot's time stands still until a Step is sent. Raises LinkError when the link cannot be opened.

    Attributes:
        robot: the robot at the other end.
    """

    def __init__(self, robot: RobotProcess) -> None:
        self.robot = robot
        self._link = parse_link(robot.link).open_host()
        self._waiting: deque[Frame] = deque()

    def send(self, what: Message | Frame) -> None:
        """Send a message or a frame.

        Raises ValueError when a message's value does not fit its field, or when the serial framing does not allow the
        id or length of a frame; LinkError when the link is lost.
        """
        self._link.send(what if isinstance(what, Frame) else codec.encode(what))

    def receive(self, timeout_s: float = 1.0) -> Frame | None:
        """Return the next valid frame, or None after ``timeout_s``. Raises LinkError when the link is lost."""
        if not self._waiting and (received := self._link.receive(round(timeout_s * 1e9))) is not None:
            self._waiting.extend(received.frames)
        return self._waiting.popleft() if self._waiting else None

    def ask(self, what: Message | Frame, answer: type[Answer], timeout_s: float = 2.0) -> Answer:
        """Send, and return the next message of the type ``answer``; other messages are skipped.

        Raises DeviceError when none comes within ``timeout_s``, and the errors of ``send``.
        """
        self.send(what)
        deadline_s = time.monotonic() + timeout_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            frame = self.receive(left_s)
            message = None if frame is None else codec.decode(frame)
            if isinstance(message, answer):
                return message
        raise DeviceError(f"the robot sent no {answer.__name__} within {timeout_s:g} s")

    def rejected(self) -> dict[str, int]:
        """Return the number of the robot's frames that this side has dropped, by cause."""
        return self._link.rejected()

    def close(self) -> None:
        """Release the link. Closing twice is allowed."""
        self._link.close()
