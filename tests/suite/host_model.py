"""The host's half of the wire by PROTOCOL.md and ``wheel_client.h``, in Python: its messages, and its knowledge.

The oracle of ``test_conversations.py``; it shares no code with the client. Wheels are FL, FR, RR, RL.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from firmware_protocol.codec import Message, decode, encode
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import ArmRefusal, Mode, Request, State
from tests.suite.snapshot_model import Snapshots

DONE, WAIT, HOLD, ASKED, NEW_NONCE, STRANGER, REFUSED, LATCHED = range(8)  # WHEEL_ARMING_...
NONE, AWAITED, ANSWERED, ELSEWHERE = range(4)  # WHEEL_STEP_...
ROOM = 1024
"""Bytes of packed frames that may wait to be sent."""
_HEARTBEAT_NS, _HELLO_NS = 100_000_000, 200_000_000
_PAGES = range(m.HelloIdentity.ID, m.HelloFaultAddress.ID + 1)
_REST = (0.0, 0.0, 0.0, 0.0)
_HELPS = (ArmRefusal.NONCE_USED, ArmRefusal.SESSION_USED, ArmRefusal.NOT_IDLE, ArmRefusal.NOT_ANNOUNCED)


class Waiting(NamedTuple):
    """A frame that waits to be sent; HELLO and repeated STEPs are not ``counted``."""

    frame: Frame
    counted: bool

    @property
    def size(self) -> int:
        """How many bytes it takes, packed."""
        return len(pack([self.frame]))


def on_wire(value: float, limit: float, step: float) -> float | None:
    """Return the nearest value that the wire carries, halves away from zero; None for one that cannot be sent."""
    if not -limit <= value <= limit:
        return None
    return math.copysign(math.floor(abs(value) / step + 0.5) * step, value)


class HostModel:
    """The host's session with one robot. ``capacity``: bytes that each direction's log holds, None without logs.

    The attributes are named as those of ``wheel_view``.
    """

    def __init__(self, mode: Mode, check: int, nonce: int, capacity: int | None) -> None:
        self.mode, self.check, self.nonce = mode, check, nonce
        self._capacity = capacity
        self.logs = bytearray(), bytearray()  # sent, received
        self.log_is_due = False
        self._logged_trips = 0
        self.snapshots = Snapshots()
        self.request = Request.IDLE
        self.is_greeted = False
        self.waiting: list[Waiting] = []
        self.sent = self.received = self.out_of_range = 0
        self.tick = self.step_target = self.step_done_tick = 0
        self.step = NONE
        self._step = m.Step(0, 0)
        self._asked = self._owed = 0  # how often the newest STEP was sent; answers to earlier ones that may still come
        self.round_trips_ns: list[int] = []
        self._sequence = 0
        self._commanded: dict[int, int] = {}  # time of each sequence that no TICK has told yet
        self._reported: int | None = None
        self._status: m.Status | None = None
        self._identity: m.HelloIdentity | None = None
        self._pages: set[int] = set()
        self._is_asking = False
        self._hello_ns = 0
        self._heartbeat_ns: int | None = None

    # What it sends

    def _waits(self) -> int:
        return sum(one.size for one in self.waiting)

    def _has_room(self, size: int, counted: bool) -> bool:
        return self._waits() + size <= ROOM and (not counted or self._log_has_room(0, size))

    def _add(self, frame: Frame, counted: bool = True) -> bool:
        one = Waiting(frame, counted)
        if not self._has_room(one.size, counted):
            return False
        self.waiting.append(one)
        if counted:
            self.sent += 1
            self._log(0, frame)
        return True

    def _log(self, direction: int, frame: Frame) -> None:
        if self._capacity is not None:
            self.logs[direction].extend(pack([frame]))
            self.log_is_due = self.log_is_due or 4 * len(self.logs[direction]) >= self._capacity

    def _log_has_room(self, direction: int, size: int) -> bool:
        return self._capacity is None or len(self.logs[direction]) + size <= self._capacity

    def _replace_all(self, frame: Frame) -> None:
        self.unsend()
        if not self._add(frame):
            self._add(frame, counted=False)

    def add(self, frame: Frame) -> bool:
        """Add a message of another kind."""
        is_one = m.LENGTHS.get(frame.id) == len(frame.payload)
        return is_one and self._add(frame, frame.id < m.HelloRequest.ID)

    def send(self) -> None:
        """Forget what waited: it was sent."""
        self.waiting.clear()

    def unsend(self) -> None:
        """Forget what waited: it was not sent, and is neither counted nor logged."""
        sizes = [one.size for one in self.waiting if one.counted]
        self.sent -= len(sizes)
        if sizes and self._capacity is not None:
            del self.logs[0][-sum(sizes) :]
        self.waiting.clear()

    def take_logs(self) -> tuple[int, int]:
        """Empty the logs; return how much was in them."""
        sizes = len(self.logs[0]), len(self.logs[1])
        self.logs[0].clear()
        self.logs[1].clear()
        self.log_is_due, self._logged_trips = False, len(self.round_trips_ns)
        return sizes

    def command(self, speeds: Sequence[float], torques: Sequence[float], now_ns: int) -> int:
        """Add a command; return its sequence, -1 when it cannot be sent."""
        self._sequence = sequence = (self._sequence + 1) & 0xFF
        is_torque, ends = self.mode is Mode.TORQUE, (sequence, self.nonce & 0xF)
        wires = self.snapshots.wires
        torque = [on_wire(sign * torques[wheel], 15.99609375, 1 / 256) for wheel, sign in wires]
        speed = [on_wire(sign * speeds[wheel], 63.984375, 1 / 64) for wheel, sign in wires]
        if None in torque or (None in speed and not is_torque) or not self._has_room(22, True):
            return -1
        self._commanded.pop(sequence, None)
        if now_ns >= 0:
            self._commanded[sequence] = now_ns
        if is_torque:
            self._add(encode(m.TorqueCommand._make((*torque, *ends))))
            return sequence
        if any(torques):
            self._add(encode(m.TorqueFeedforward._make((*torque, *ends))))
        self._add(encode(m.WheelCommand._make((*speed, *ends))))
        return sequence

    def wish(self, request: Request, now_ns: int) -> bool:
        """Set what the heartbeats ask for, and add the first one."""
        if not 1 <= self.nonce <= 0xFFFF:
            return False
        frame = encode(m.HostHeartbeat(self.nonce, m.SCHEMA_HASH, request, self.mode, self.check))
        if not self._add(frame):
            if request is not Request.IDLE:
                return False
            self._replace_all(frame)
        self.request = request
        if now_ns >= 0:
            self._heartbeat_ns = now_ns + _HEARTBEAT_NS
        return True

    def poll(self, now_ns: int) -> bool:
        """Add HELLO and the heartbeat when they are due; return whether one was."""
        before = self._waits()
        if self._is_asking and not self.is_greeted and now_ns >= self._hello_ns:
            self._hello_ns = now_ns + _HELLO_NS
            self._add(encode(m.HelloRequest(m.PROTOCOL_VERSION)), counted=False)
        if self._heartbeat_ns is not None and now_ns >= self._heartbeat_ns:
            self.wish(self.request, now_ns)
        return before != self._waits()

    def estop(self) -> None:
        """Add ESTOP, in the place of all that waits if there is no room."""
        self.request = Request.IDLE
        frame = encode(m.Estop(1, 0))
        if not self._add(frame):
            self._replace_all(frame)

    def ask(self, ticks: int) -> bool:
        """Add a STEP."""
        step = m.Step(self.tick, ticks)
        if ticks > 1000 or not self._add(encode(step)):
            return False
        self._step, self.step, self._asked = step, AWAITED, 1
        self.step_target = (self.tick + ticks) & 0xFFFF_FFFF
        return True

    def ask_again(self) -> bool:
        """Add the same STEP again."""
        if not self._add(encode(self._step), counted=False):
            return False
        self._asked += 1
        return True

    def arm(self, now_ns: int) -> int:
        """Take the next step towards ACTIVE, and return it."""
        step = self._next_step()
        if step == HOLD:
            self.command(_REST, _REST, now_ns)
        elif step == ASKED:
            self.wish(Request.IDLE, now_ns)
            self.wish(Request.ARM, now_ns)
        elif step == NEW_NONCE:
            self._status = None
        return step

    def _next_step(self) -> int:
        status, state = self._status, self.snapshots.state
        refusal = ArmRefusal.NONE if status is None else status.arm_refusal
        if not self.snapshots.has_feedback:
            return WAIT
        if state in (State.ACTIVE, State.ARMED):
            is_ours = status is not None and status.nonce == self.nonce
            return WAIT if not is_ours else DONE if state == State.ACTIVE else HOLD
        if state in (State.FAULT, State.ESTOP):
            return LATCHED if status is not None and status.state == state else WAIT
        if state != State.IDLE:
            return WAIT
        if not self.is_greeted:
            return STRANGER
        if self.request is Request.IDLE:
            return ASKED
        if refusal in _HELPS:
            return NEW_NONCE
        return WAIT if refusal == ArmRefusal.NONE else REFUSED

    # The session

    def leave(self) -> None:
        """Leave the robot."""
        self.request, self.step, self._owed = Request.IDLE, NONE, 0
        self.is_greeted = self.snapshots.has_feedback = self._is_asking = False
        self._heartbeat_ns = self._status = None
        self._pages.clear()
        self.unsend()

    def begin(self, nonce: int) -> None:
        """Leave the robot, and begin again with an unknown one."""
        self.leave()
        self._is_asking, self._hello_ns, self.nonce, self.tick = True, 0, nonce, 0
        self._commanded.clear()
        self.snapshots.restart()

    def renew(self, nonce: int) -> None:
        """Begin another session with the same robot."""
        self.request, self.nonce = Request.IDLE, nonce

    # What it receives

    def take(self, frames: Sequence[Frame], now_ns: int) -> tuple[int, bool, Message | None]:
        """Take frames; return how many, whether it stopped there, and the message behind which it did, if one."""
        for place, frame in enumerate(frames):
            if not self._log_has_room(1, len(pack([frame]))):
                return place, True, None
            message = decode(frame)
            if message is None:
                self.out_of_range += 1
                continue
            is_hello = frame.id >= m.HelloRequest.ID
            is_logged, is_told = self._take(message, now_ns)
            self.received += not is_hello
            if is_logged and not is_hello:
                self._log(1, frame)
            if is_told or self.step == ELSEWHERE:
                return place + 1, True, message if is_told else None
        return len(frames), False, None

    def _take(self, message: Message, now_ns: int) -> tuple[bool, bool]:
        """Take a message; return whether it is logged, and whether the caller is told of it."""
        if isinstance(message, m.Tick):
            self._take_tick(message, now_ns)
        if self.snapshots.take(message):
            return True, False
        if isinstance(message, m.StepDone):
            return self._ends_step(message.tick), False
        if isinstance(message, m.Status):
            self._status = message
        elif message.ID in _PAGES:
            self._pages.add(message.ID)
            self._identity = message if isinstance(message, m.HelloIdentity) else self._identity
            ours: Any = (m.PROTOCOL_VERSION, m.SCHEMA_HASH)
            theirs = self._identity and (self._identity.protocol_version, self._identity.schema_hash)
            self.is_greeted = self.is_greeted or (len(self._pages) == len(_PAGES) and theirs == ours)
        return True, True

    def _take_tick(self, tick: m.Tick, now_ns: int) -> None:
        if tick.sequence == self._reported:
            return
        self._reported = tick.sequence
        if (commanded := self._commanded.pop(tick.sequence, None)) is not None:
            self.round_trips_ns.append(now_ns - commanded)
            is_much = self._capacity is not None and len(self.round_trips_ns) - self._logged_trips >= 128
            self.log_is_due = self.log_is_due or is_much

    def _ends_step(self, tick: int) -> bool:
        self.step_done_tick = tick
        is_second = tick == self._step.tick if self._step.substeps else self._owed > 0
        if self.step != AWAITED or is_second:
            self._owed = max(0, self._owed - 1)
            return False
        if self._step.substeps and tick != self.step_target:
            self.step = ELSEWHERE
            return False
        self.tick, self.step, self._owed = tick, ANSWERED, self._asked - 1
        return True
