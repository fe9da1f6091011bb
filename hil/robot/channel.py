"""Messages of our protocol over a link, both ways: sent, taken apart, counted and hashed; STEP and its answer."""

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
_FIRST_UNCOUNTED = m.HelloRequest.ID  # how often HELLO is asked depends on the wall clock


class Channel:
    """Both directions of a link to a robot of ours. ``on_message`` gets each message that is not of a snapshot or step,
    with its stamp.

    Attributes:
        link: as given.
        hash: of every frame that counts, both directions.
        feedback: the newest snapshot in our order of wheels; None before the first, and where its user clears it.
        sent, received: messages, HELLO's not counted.
        lost: snapshots that are missing in the robot's count (TICK.snapshot), or came in part.
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
        self._snapshot: Feedback | None = None  # the newest, as it came
        self._others = 0  # that were received and counted, and are not of a snapshot
        self._out_of_range = 0
        self.link = link
        self.hash = WireHash(pack, b"".join)
        self.feedback: Feedback | None = None
        self.sent = self.received = self.lost = 0

    def restart(self) -> None:
        """Begin with a robot that may have been reset."""
        self._reader.restart()

    def send(self, message: Message) -> None:
        """Send a message. Raises ValueError for one that cannot be sent, LinkError when the link is lost."""
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
        """Send a STEP and take what comes until its answer; 0 substeps only ask for the tick.

        Raises RobotStoppedError when no answer comes, or one with another tick than was expected.
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
                    if self._stepping.answered(tick):  # once, however often STEP was repeated
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
        """Process a frame that is neither of a snapshot nor the end of a step; return where the next one begins."""
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
        """Return the received frames that were dropped on this side, by cause."""
        return self.link.rejected() | {"range": self._out_of_range, "incomplete_snapshot": self._reader.incomplete}
