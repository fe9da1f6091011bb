"""A virtual robot in a process of its own: ``hil device``, started and ended by a test."""

import contextlib
import queue
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING

from hil.core.child import away_from_terminal, child_environment, module_command
from hil.core.errors import BadInputError, DeviceError
from hil.testing.overrides import Overrides

if TYPE_CHECKING:
    from hil.scenario import Scenario

_READY_S = 60.0
_END_S = 10.0
_READY = "ready "


class RobotProcess:
    """A virtual robot that is ready.

    It ends with ``close``, and by itself when this process is gone, however that ended.

    Raises BadInputError when the scenario is none for a robot elsewhere, DeviceError when it does not get ready.

    Attributes:
        scenario: whose robot it is.
        link: URL of the host's end of its link, such as ``serial:/dev/pts/3``.
        truth: URL of its truth socket, such as ``tcp://127.0.0.1:40123``.
        pid: process id.
    """

    def __init__(self, scenario: "Scenario", overrides: Overrides) -> None:
        self.scenario = scenario
        self._ended_by_us = False
        name = scenario.name if scenario.path is None else str(scenario.path)
        with contextlib.ExitStack() as resources:
            self._words: IO[bytes] = resources.enter_context(tempfile.TemporaryFile())
            self._process = subprocess.Popen(
                module_command("hil.cli.main", "device", name, "--until-eof", *overrides.arguments()),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._words,
                env=child_environment(),
                **away_from_terminal(),
            )
            resources.callback(self._end)
            self._said: queue.SimpleQueue[str] = queue.SimpleQueue()
            self._listener = threading.Thread(target=self._listen, name="robot's words", daemon=True)
            self._listener.start()
            told = self._ready()
            resources.pop_all()
        self.link = told["link"]
        self.truth = told["truth"]
        self.pid = self._process.pid

    @property
    def mode(self) -> str:
        """``lockstep`` or ``realtime``."""
        return self.scenario.loop.mode

    @property
    def is_running(self) -> bool:
        """Whether the process is there."""
        return self._process.poll() is None

    def kill(self) -> None:
        """End it without warning, as a power cut does."""
        self._ended_by_us = True
        self._process.kill()
        self._process.wait()

    def close(self) -> str | None:
        """End it in order, and return what is worth saying of its end; closing twice is allowed.

        Raises DeviceError when it had ended by itself before.
        """
        if self._words.closed:
            return None
        code = self._process.poll()
        try:
            self._end()
            if code is not None and not self._ended_by_us:
                raise DeviceError(f"the virtual robot of {self.scenario.name} ended by itself: {self._last_words()}")
            return next(self._lines(), None)
        finally:
            self._words.close()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._said.put(line.decode(errors="replace").rstrip())
        self._said.put("")

    def _lines(self) -> Iterator[str]:
        while not self._said.empty():
            if line := self._said.get():
                yield line

    def _ready(self) -> dict[str, str]:
        """Wait for the line that says that the robot is ready, and return what it tells."""
        try:
            line = self._said.get(timeout=_READY_S)
        except queue.Empty:
            raise DeviceError(
                f"the virtual robot of {self.scenario.name} was not ready within {_READY_S:g} s; try hil device"
            ) from None
        if not line.startswith(_READY):
            code = self._process.wait()
            kind = BadInputError if code == BadInputError.exit_code else DeviceError
            raise kind(f"the virtual robot of {self.scenario.name} did not start: {line or self._last_words()}")
        return dict(part.split("=", 1) for part in line.removeprefix(_READY).split(" ", 3))

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._listener.join(_END_S)
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def _last_words(self) -> str:
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").strip().splitlines()
        return lines[-1].removeprefix("hil: ") if lines else f"exit status {self._process.returncode}"
