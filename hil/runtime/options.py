"""The options of a run that are not part of its scenario."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from hil.core.outputs import Existing
from hil.record import Recording, Rotation, RunRecording
from hil.robot.virtual import MakeNode, MakeRobot, new_robot
from hil.runtime.loop import Loop

Watch = Callable[[Loop], AbstractContextManager[object]]


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of a run that are not part of the scenario.

    Attributes:
        truth, rotate, trace, stream, allow_motion, lenient: as for ``run``.
        record: the file of a recording, or None.
        existing: what to do when ``record`` exists already. A ``trace`` is never numbered: "number" counts as "refuse"
            there.
        live_port: serves live viewers on this port of 127.0.0.1.
        watch: a context manager made from the loop, entered while the loop runs.
        warn: called with each warning: what the robot cannot follow, before anything is opened, and the robot's own
            warnings, before it is armed.
        linger: called when everything is recorded, while live viewers are still served.
        on_stuck: called with a sentence, in its own thread, before this process is ended because the law takes too long
            and cannot be interrupted (``hil.core.tick_watch``).
        make_robot: makes a robot in this process; make_node: its firmware; make_recording: the recording.
        keep_signals: False leaves signals out of the result, so that memory does not grow with the run. Extra signals
            are then computed only if something else reads them.
    """

    truth: str | None = None
    record: Path | None = None
    rotate: Rotation = Rotation()  # noqa: RUF009 -- immutable
    trace: Path | None = None
    existing: Existing = "refuse"
    live_port: int | None = None
    stream: str | None = None
    allow_motion: bool = False
    lenient: bool = False
    watch: Watch | None = None
    warn: Callable[[str], None] | None = None
    linger: Callable[[], None] | None = None
    on_stuck: Callable[[str], None] | None = None
    make_node: MakeNode | None = None
    make_robot: MakeRobot = new_robot
    make_recording: Callable[..., RunRecording] = Recording
    keep_signals: bool = True

    @property
    def is_recorded(self) -> bool:
        """Whether the run is recorded, in a file or only for live viewers."""
        return self.record is not None or self.live_port is not None
