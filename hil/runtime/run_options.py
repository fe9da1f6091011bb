"""The options of a run that are not part of its scenario."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from hil.core.link_protocol import LinkProtocol
from hil.core.ports import Clock, FixSource, Link, PoseSource
from hil.robot.virtual import MakeNode, MakeRobot, new_robot
from hil.runtime.loop import Loop
from hil.runtime.tick import TickParts
from hil.scenario import Scenario
from hil.wire.conditions import ConditionedLink

if TYPE_CHECKING:
    from hil.core.outputs import Existing
    from hil.record.files import Rotation
    from hil.record.recording import RunRecording

Watch = Callable[[Loop], AbstractContextManager[object]]


class Instrument(Protocol):
    """Changes parts of a run, to measure who notices: ``hil verify`` passes one. Such a run moves no real motors."""

    @property
    def properties(self) -> Mapping[str, str]:
        """What a recording of the run says about it, by name."""

    def link(self, link: Link) -> Link:
        """Return the link below latency and faults."""

    def parts(self, scenario: Scenario, parts: TickParts) -> TickParts:
        """Return the parts of a tick."""


class Replayed(Protocol):
    """What a controller is told in place of a robot: ``hil replay`` passes a recorded run. Nothing can move.

    Attributes:
        clock: the clock in real time; in lockstep the run has its own.
        nonces: the session nonces that the recorded run used, in order.
        advance: lets a number of ticks pass, in lockstep; None in real time.
    """

    clock: Clock
    nonces: Iterator[int]
    advance: Callable[[int], None] | None

    def link(self, clock: Clock) -> Link:
        """Return the link, whose other end is the recorded robot."""

    def conditioned(self, link: Link, clock: Clock, protocol: LinkProtocol) -> ConditionedLink:
        """Return the link as the session uses it."""

    def truth(self) -> PoseSource | None:
        """Return the source of the recorded true poses, if the run had one."""

    def fixes(self) -> FixSource | None:
        """Return the source of the recorded pose fixes, if the run had one."""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of a run that are not part of the scenario.

    Attributes:
        truth, rotate, trace, allow_motion, lenient: as for ``run``.
        record: the file of a recording, or None.
        existing: what to do when ``record`` exists already. A ``trace`` is never numbered: "number" counts as "refuse"
            there.
        live_port: serves live viewers on this port of 127.0.0.1.
        watch: a context manager made from the loop, entered while the loop runs.
        warn: called with each warning: what the robot cannot follow, before anything is opened, and the robot's own
            warnings, before it is armed.
        linger: called when the run is over and recorded, while live viewers are still served.
        on_stuck: called with a sentence, in its own thread, before this process is ended because the law takes too long
            and cannot be interrupted (``hil.core.tick_watch``).
        instrument: changes parts of the run, None for none.
        replayed: takes the place of the robot, None for none.
        make_robot, make_node: make a robot in this process, and its firmware. make_recording: makes the recording.
        keep_signals: False leaves signals out of the result, so that memory does not grow with the run. Extra signals
            are then computed only if something else reads them.
    """

    truth: str | None = None
    record: Path | None = None
    rotate: "Rotation | None" = None
    trace: Path | None = None
    existing: "Existing" = "refuse"
    live_port: int | None = None
    allow_motion: bool = False
    lenient: bool = False
    watch: Watch | None = None
    warn: Callable[[str], None] | None = None
    linger: Callable[[], None] | None = None
    on_stuck: Callable[[str], None] | None = None
    instrument: Instrument | None = None
    replayed: Replayed | None = None
    make_node: MakeNode | None = None
    make_robot: MakeRobot = new_robot
    make_recording: "Callable[..., RunRecording] | None" = None
    keep_signals: bool = True

    @property
    def is_recorded(self) -> bool:
        """Whether the run is recorded, in a file or only for live viewers."""
        return self.record is not None or self.live_port is not None
