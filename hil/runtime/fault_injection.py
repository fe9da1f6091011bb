"""The faults of one run: gives each row to the part that applies it, and collects how often it was applied."""

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

from hil.core.errors import BadInputError, HilError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Clock
from hil.faults.rows import FaultRow, ScenarioTime
from hil.wire.streams import HostStream

if TYPE_CHECKING:
    from hil.faults.link_faults import ByteFault, LinkFault
    from hil.runtime.signal_faults import SignalFaults
    from hil.wire.byte_faults import BusFaults
    from hil.wire.link import LinkUrl


class RobotWithFaults(Protocol):
    """A virtual robot, in this process or behind its truth socket."""

    def arm(self, rows: Sequence[FaultRow]) -> None:
        """Take the rows. Raises BadInputError when the robot cannot apply one of them."""

    def begin(self, tick: int) -> None:
        """Set the firmware tick at which the scenario's time began."""

    def applied(self) -> list[int]:
        """Return how often each row was applied so far. Raises DeviceError when the robot is gone."""


class RunFaults:
    """Gives every row to the part that applies it: link, signals of the tick, or the robot with its plant.

    ``names`` are the names of the run's signals.

    Attributes:
        time: the scenario's time.
        of_frames: the rows that act on whole frames of the link.
        signals: the rows that act on signals, or None.
    """

    of_frames: "list[LinkFault]"
    signals: "SignalFaults | None"
    _of_link: "list[LinkFault]"
    _of_bytes: "list[ByteFault]"

    def __init__(
        self,
        rows: Sequence[FaultRow],
        seed: int,
        clock: Clock,
        names: Sequence[str],
        protocol: LinkProtocol = WHEEL_DBC,
    ) -> None:
        self._rows = rows
        self._robot: RobotWithFaults | None = None
        self._of_robot = [row for row in rows if row.acts_on in ("device", "plant")]
        self._of_link, self.of_frames, self._of_bytes = [], [], []
        if of_link := [row for row in rows if row.acts_on == "link"]:
            from hil.faults.kinds import link_faults
            from hil.faults.link_faults import ByteFault

            self._of_link = link_faults(of_link, seed, protocol)
            self.of_frames = [fault for fault in self._of_link if not isinstance(fault, ByteFault)]
            self._of_bytes = [fault for fault in self._of_link if isinstance(fault, ByteFault)]
        self._protocol = protocol
        of_signals = [row for row in rows if row.acts_on == "signal"]
        self.time = ScenarioTime(clock)
        self.signals = None
        if of_signals:
            from hil.runtime.signal_faults import SignalFaults

            self.signals = SignalFaults(of_signals, names, seed)

    def line(self, stream: HostStream) -> HostStream:
        """Return the host's end of a serial line, wrapped with the faults of its bytes if there are any."""
        if not self._of_bytes:
            return stream
        from hil.wire.byte_faults import FaultLine

        return FaultLine(stream, self.time, self._of_bytes, self._protocol)

    def bus(self, url: "LinkUrl") -> "BusFaults | None":
        """Return the faults of a link's bus; None for a link that is no bus, or without such faults.

        Raises BadInputError for frames in memory, which have no bits, LinkError when the node of another sender cannot
        be opened.
        """
        if not self._of_bytes or not (url.is_bus or self._protocol.make_framing is None):
            return None
        if not url.is_bus:
            row = self._of_bytes[0].row
            raise BadInputError(f"fault {row.kind}: a bus in memory has no bits; use --link can:virtual/NAME for it")
        from hil.wire.byte_faults import BusFaults

        needs_node = any(fault.is_sender for fault in self._of_bytes)
        return BusFaults(self._of_bytes, url.open_host(protocol=self._protocol) if needs_node else None)

    def arm(self, robot: RobotWithFaults | None) -> None:
        """Give the robot the faults of the robot and its plant.

        Raises BadInputError when the robot cannot apply a row, or when no robot can be reached for them.
        """
        if not self._of_robot:
            return
        if robot is None:
            row = self._of_robot[0]
            raise BadInputError(
                f"fault {row.kind} {row.target}: it acts inside a virtual robot, and nothing reaches into this one; "
                "add --truth URL as hil device prints it, or leave the fault out on a real board"
            )
        robot.arm(self._of_robot)
        self._robot = robot

    def begin(self, origin_ns: int, tick: int) -> None:
        """Set the start of the scenario's time: on the clock, and in firmware ticks."""
        self.time.begin(origin_ns)
        if self._robot is not None:
            self._robot.begin(tick)

    def applied(self) -> list[int | None]:
        """Return how often each row of the run was applied; None if the robot that counted is gone.

        Also None if the robot has another number of rows by now: it was restarted, or another client set its faults.
        """
        of_robot: Sequence[int | None] = [None] * len(self._of_robot)
        with contextlib.suppress(HilError):
            counts = self._robot.applied() if self._robot is not None else []
            if len(counts) == len(self._of_robot):
                of_robot = counts
        by_part = {
            "link": iter([fault.applied for fault in self._of_link]),
            "robot": iter(of_robot),
            "signal": iter(self.signals.applied() if self.signals is not None else ()),
        }
        return [next(by_part[row.acts_on if row.acts_on in by_part else "robot"]) for row in self._rows]
