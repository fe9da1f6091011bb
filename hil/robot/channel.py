"""Sends, decodes, counts and hashes the messages of our protocol on a link; exchanges STEP and its answer."""

from collections.abc import Callable

from firmware_protocol.codec import Message, decode, encode
from firmware_protocol.framing import PackedFrames, pack, packed_frame
from firmware_protocol.generated import messages as m
from hil.core.ports import Received
from hil.robot.link_times import RoundTrip
from hil.robot.snapshot import Feedback, SnapshotReader
from hil.robot.stepping import Stepping
from hil.robot.wheel_map import WheelMap
from hil.robot.wire_hash import WireHash
from hil.wire.conditions import ConditionedLink

_STEP_DONE_BYTES = len(pack([encode(m.StepDone(0))]))
_FIRST_UNCOUNTED = m.HelloRequest.ID  # the number of HELLO messages depends on the wall clock


class Channel:
    """Sends and receives messages on a link to a robot with our firmware. ``on_message`` gets every message except
    snapshots and the answers to STEP, with its time of arrival.

    Attributes:
        link: the link that was given.
        hash: of all frames in both directions, except HELLO and repeated STEPs: their number depends on the wall clock.
        feedback: the newest snapshot, with the wheels in our order. None before the first, and once ``Stm32.leave``
            has cleared it.
        sent, received: number of messages, without HELLO.
        lost: snapshots that never came (a gap in TICK.snapshot) or came incomplete.
    """

    def __init__(
        self,
        link: ConditionedLink,
        wheel_map: WheelMap,
        round_trip: RoundTrip,
        on_message: Callable[[Message, int], None],
    ) -> None:
        self._map = wheel_map
        self._round_trip = round_trip
        self._on_message = on_message
        self._stepping = Stepping()
        self._reader = SnapshotReader()
        self._snapshot: Feedback | None = None  # the newest, in the robot's order of channels
        self._others = 0  # counted messages that are not part of a snapshot
        self._out_of_range = 0
        self.link = link
        self.hash = WireHash(pack, b"".join)
        self.feedback: Feedback | None = None
        self.sent = self.received = self.lost = 0

    def restart(self) -> None:
        """Start again with a robot that may have been reset."""
        self._reader.restart()

    def send(self, message: Message) -> None:
        """Send a message. Raises ValueError for one that cannot be encoded, LinkError when the link is lost."""
        frame = encode(message)
        self.link.send(frame)
        if message.ID < _FIRST_UNCOUNTED:
            self.sent += 1
            self.hash.sent(frame)

    @property
    def tick(self) -> int:
        """In lockstep: the firmware tick that the robot has reached."""
        return self._stepping.tick

    def step(self, tick: int, substeps: int) -> None:
        """Send a STEP and process all frames until its answer; 0 substeps only ask for the robot's tick.

        Raises RobotStoppedError when no answer comes, or the answer has an unexpected tick.
        """
        step = m.Step(tick, substeps)
        self.send(step)
        self._stepping.exchange(self.link, step, self.receive)

    def receive(self, received: Received) -> None:
        """Process frames that arrived together. Raises RobotStoppedError for a step that ended at a wrong tick."""
        frames, stamp_ns = received
        packed = frames.packed if type(frames) is PackedFrames else pack(frames)
        reader, begin, size = self._reader, 0, len(packed)
        try:
            while begin < size:
                end = reader.read(packed, begin)
                for sequence in reader.sequences:
                    self._round_trip.echoed(sequence, stamp_ns)
                if (snapshot := reader.feedback) is not self._snapshot and snapshot is not None:
                    self._snapshot = snapshot
                    self.feedback = self._map.feedback_from_wire(snapshot)
                if (tick := reader.step_done) is not None:
                    before = end - _STEP_DONE_BYTES
                    self.hash.received(packed[begin:before])
                    if self._stepping.answered(tick):  # only one answer, even if STEP was repeated
                        self.hash.received(packed[before:end])
                elif end > begin:
                    self.hash.received(packed[begin:end])
                else:
                    end = self._receive_other(packed, begin, stamp_ns)
                begin = end
        finally:
            self.received = reader.frames + self._others
            self.lost = reader.lost + reader.incomplete

    def _receive_other(self, packed: bytes, begin: int, stamp_ns: int) -> int:
        """Process a frame that is neither part of a snapshot nor a STEP_DONE; return the offset of the next frame."""
        frame, end = packed_frame(packed, begin)
        message = decode(frame)
        if message is None:
            self._out_of_range += 1
            return end
        if message.ID < _FIRST_UNCOUNTED:
            self._others += 1
            self.hash.received(packed[begin:end])
        self._on_message(message, stamp_ns)
        return end

    def rejected(self) -> dict[str, int]:
        """Return the number of received frames that this side dropped, by cause."""
        return self.link.rejected() | {"range": self._out_of_range, "incomplete_snapshot": self._reader.incomplete}
