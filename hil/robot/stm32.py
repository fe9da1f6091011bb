"""The host's side of the wheel-command protocol: handshake, arming, commands, feedback, lockstep.

The robot behind the link may be a board with motors, a board with the plant, or the host library: nothing here
can tell, except by what HELLO says.
"""

import contextlib
import math
from collections.abc import Callable, Iterator
from types import MethodType

from firmware_protocol.codec import Message, decode, encode
from firmware_protocol.framing import PackedFrames, pack, packed_frame
from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError, DeviceError, HilError, RobotStoppedError
from hil.core.ports import Clock, Received
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand
from hil.robot import handshake
from hil.robot.handshake import RETRY_NS, Expected, Greeting, RobotInfo
from hil.robot.link_times import SYNC_PERIOD_NS, ClockSync, RoundTrip
from hil.robot.reset_words import reset_warning
from hil.robot.robot_report import RobotReport
from hil.robot.snapshot import Feedback, SnapshotReader
from hil.robot.stepping import Stepping
from hil.robot.unread import Unread
from hil.robot.wheel_map import WheelMap
from hil.robot.wire_hash import WireHash
from hil.wire.conditions import ConditionedLink

_MOST_A_POLL = 200  # frames; a robot sends at most some ten a tick
_HEARTBEAT_NS = 100_000_000
_START_LIMIT_NS = 4_000_000_000
_ESTOP_BY_HOST = 1
_STEP_DONE_BYTES = len(pack([encode(m.StepDone(0))]))
_TORQUE = CommandMode.TORQUE  # a member of an enumeration takes longer to look up than a global name
_Command = tuple[float, float, float, float, int, int]
_make_torque_command: Callable[[_Command], m.TorqueCommand] = MethodType(tuple.__new__, m.TorqueCommand)
_make_feedforward: Callable[[_Command], m.TorqueFeedforward] = MethodType(tuple.__new__, m.TorqueFeedforward)
_make_wheel_command: Callable[[_Command], m.WheelCommand] = MethodType(tuple.__new__, m.WheelCommand)
_make_step: Callable[[tuple[int, int]], m.Step] = MethodType(tuple.__new__, m.Step)
_FIRST_UNCOUNTED = m.HelloRequest.ID  # how often HELLO is asked depends on the wall clock
_ANOTHER_NONCE_HELPS = (
    m.ArmRefusal.NONCE_USED,
    m.ArmRefusal.SESSION_USED,
    m.ArmRefusal.NOT_IDLE,
    m.ArmRefusal.NOT_ANNOUNCED,
)


class Stm32:
    """A robot that speaks wheel.dbc, at the other end of a link.

    ``nonces`` gives the session nonces to try, in order. Raises DeviceError when the robot does not answer, refuses
    or stops; BadInputError when it is not the robot that the scenario describes.

    Attributes:
        sent, received: messages, HELLO's not counted.
        snapshots_lost: feedback snapshots that are missing in the robot's count (TICK.snapshot), or came in part.
    """

    def __init__(
        self,
        link: ConditionedLink,
        mode: CommandMode,
        expected: Expected,
        nonces: Iterator[int],
        wheel_map: WheelMap,
    ) -> None:
        # Python 3.11 finds an attribute at once in an object that has less than 30: one more costs a tick 3 % here.
        self._link = link
        self._mode = mode
        self._expected = expected
        self._nonces = nonces
        self._map = wheel_map
        self._reader = SnapshotReader()
        self._snapshot: Feedback | None = None  # the newest, as it came
        self._clock: Clock | None = None
        self._feedback: Feedback | None = None
        self._info: RobotInfo | None = None
        self._is_known = False  # since the link was opened it has said that it is the robot of the scenario
        self._greeting: Greeting | None = None
        self._greet_again_ns = 0
        self._stepping = Stepping()
        self._sequence = 0
        self._nonce = next(nonces)
        self._request = m.Request.IDLE
        # None until something was asked for: a host that only looks must not disarm another one's robot.
        self._next_heartbeat_ns: int | None = None
        self._hash = WireHash(pack, b"".join)
        self._out_of_range = 0
        self.report = RobotReport(wheel_map)
        self.round_trip = RoundTrip()
        self.clock_sync = ClockSync()
        self._next_sync_ns = 0
        self._unread = Unread()
        self.sent = 0
        self.received = 0
        self.snapshots_lost = 0
        self._others = 0  # that were received and counted, and are not of a snapshot

    # Connecting

    @property
    def is_lockstep(self) -> bool:
        """Whether robot time passes by STEP only, so that it stands still without the robot."""
        return self._expected.lockstep

    def connect(self) -> RobotInfo:
        """Ask for HELLO and check the answer against what the scenario expects."""
        info = handshake.greet(self._link, self._send)
        handshake.check(info, self._expected)
        self._info = info
        self._is_known = True
        if self._expected.lockstep:
            self._exchange(m.Step(0, 0))
        return info

    @property
    def info(self) -> RobotInfo | None:
        """What the robot said of itself, None before it has."""
        return self._info

    @property
    def speed_limit_rad_s(self) -> float:
        """To what the robot scales speeds (DBC HELLO_LIMITS); infinite in TORQUE mode, and before it has told it."""
        if self._info is None or self._mode is _TORQUE:
            return math.inf
        return self._info.limits.speed_limit_rad_s

    @property
    def warnings(self) -> tuple[str, ...]:
        """What trouble led to its last reset, and that it takes less speed than the scenario's limit."""
        return (*self._reset_warnings(), *self._limit_warnings())

    def _reset_warnings(self) -> tuple[str, ...]:
        status, info = self.report.status, self._info
        if info is None:
            return ()
        cause = info.reset_cause if status is None else m.ResetCause(status.reset_cause)
        warning = None if cause is None else reset_warning(cause, info.processor_fault)
        return () if warning is None else (warning,)

    def _limit_warnings(self) -> tuple[str, ...]:
        limit_rad_s, ours_rad_s = self.speed_limit_rad_s, self._expected.speed_limit_rad_s
        if self._info is None or limit_rad_s >= ours_rad_s:
            return ()
        overspeed_rad_s = self._info.limits.overspeed_rad_s
        return (
            f"the robot takes wheel speeds of at most {limit_rad_s:.4g} rad/s, as {overspeed_rad_s:.4g} rad/s are a "
            f"fault there; commands are scaled to that and not to robot.speed_limit_rad_s = {ours_rad_s:g}",
        )

    # Coming back after a loss, in steps that do not wait: the tick of the loop goes on meanwhile

    @property
    def keeps_counts(self) -> bool:
        """The encoders of a robot that was not reset count on while its link is lost."""
        return True

    def leave(self) -> None:
        """Command nothing any more: the link or the robot was lost, and what is held is not for the next session."""
        self._request = m.Request.IDLE
        self._is_known = False
        self._next_heartbeat_ns = None
        self._feedback = None
        self._unread.forget()
        self.report.status = None
        self.clock_sync.give_up()
        self._link.discard()

    def reopen(self) -> None:
        """Close and open the link anew. Raises LinkError while that is not possible."""
        self._link.reopen()

    def begin_again(self) -> None:
        """Begin with a robot that may have been reset meanwhile, or exchanged: a new nonce, and the handshake.

        Raises RobotStoppedError when it does not answer in lockstep.
        """
        self.leave()
        self._reader.restart()
        self.report.restart()
        self.round_trip.restart()
        self._nonce = next(self._nonces)
        self._greeting = Greeting()
        self._greet_again_ns = 0
        if self._expected.lockstep:
            self._exchange(m.Step(0, 0))

    def _check_same(self, info: RobotInfo) -> None:
        handshake.check(info, self._expected)
        if self._info is None:
            self._info = info
        if not self._info.is_same_robot(info):
            raise BadInputError(
                f"another robot answers on the link: {info.describe()}; the run began with {self._info.describe()}; "
                "plug in the first one, or start a new run"
            )
        self._info = info  # it may have been reset
        self._is_known = True

    def greeted(self) -> bool:
        """Return whether the robot has answered HELLO, asking for it when that is due.

        Raises BadInputError when it is not the robot that the scenario describes.
        """
        clock = self._clock
        assert clock is not None
        if self._greeting is not None and clock.now_ns() >= self._greet_again_ns:
            self._send(m.HelloRequest(m.PROTOCOL_VERSION))
            self._greet_again_ns = clock.now_ns() + RETRY_NS
        self.poll()
        return self._greeting is None

    # The way to ACTIVE and back

    def attend(self, clock: Clock) -> None:
        """Be there on this clock; nothing is asked of the robot yet."""
        self._clock = clock

    def start(self, clock: Clock, period_ns: int) -> int:
        """Arm and begin with zero commands; return the clock's time of the first ACTIVE tick [ns].

        The robot must be seen in IDLE first: arming is an edge.
        """
        self.attend(clock)
        try:
            return self._start(clock.now_ns(), period_ns)
        except BaseException:
            self.disarm()
            raise

    def disarm(self) -> None:
        """Wish for IDLE if anything else was wished for; at best effort, for use when something has failed already."""
        if self._request is not m.Request.IDLE:
            with contextlib.suppress(HilError):
                self._wish(m.Request.IDLE)
                self._link.flush()

    def estop(self) -> None:
        """Stop the robot at once and latch that; to be repeated until its feedback says ESTOP."""
        self._request = m.Request.IDLE
        self._send(m.Estop(_ESTOP_BY_HOST, 0))
        self._link.flush()

    def clear(self) -> None:
        """Ask for the way out of a latched FAULT or ESTOP, until ``disarm``; arms nothing, and waits for the cause."""
        self._nonce = next(self._nonces)  # each CLEAR is an edge of its own
        self._wish(m.Request.CLEAR)

    def _start(self, begin_ns: int, period_ns: int) -> int:
        n = 0
        while True:
            now_ns = begin_ns + n * period_ns
            if now_ns - begin_ns > _START_LIMIT_NS:
                raise DeviceError(self.why_not_active())
            self.wait_until(now_ns)
            if self.armed():
                return now_ns
            n += 1

    def armed(self) -> bool:
        """Take one step of the way to ACTIVE; return whether the robot is there, in our session.

        Raises DeviceError when it refuses, or has latched FAULT or ESTOP.
        """
        feedback = self.poll()
        state = feedback.state if feedback is not None else None
        # STATUS tells whose session it is: another host may have armed the robot meanwhile.
        ours = self.report.status is not None and self.report.status.nonce == self._nonce
        if state is m.State.ACTIVE and ours:
            return True
        if state is m.State.IDLE:
            self._ask_to_arm()
        elif state is m.State.ARMED and ours:
            self.send(WheelCommand(self._mode, ZERO_WHEELS, ZERO_WHEELS))
        elif state in (m.State.FAULT, m.State.ESTOP) and self.report.explains(state):
            raise DeviceError(self.why_not_active())
        return False

    def _ask_to_arm(self) -> None:
        if not self._is_known:
            raise RobotStoppedError("the robot has not said what it is since the link was lost; it is not armed")
        if self._request is m.Request.IDLE:
            self._announce_and_arm()
            return
        refusal = self.report.status.arm_refusal if self.report.status is not None else m.ArmRefusal.NONE
        if refusal in _ANOTHER_NONCE_HELPS:
            self.report.status = None
            self._nonce = next(self._nonces)
            self._announce_and_arm()
        elif refusal != m.ArmRefusal.NONE:
            raise DeviceError(
                f"the robot refused to arm: {m.ArmRefusal(refusal).name}; see the arming rules in PROTOCOL.md"
            )

    def _announce_and_arm(self) -> None:
        self._wish(m.Request.IDLE)
        self._wish(m.Request.ARM)

    def why_not_active(self) -> str:
        """Return what keeps the robot from being driven, and what to do."""
        return self.report.why_not_active(self._feedback.state if self._feedback is not None else None)

    def stop(self, period_ns: int, limit_ns: int) -> bool:
        """Ask for IDLE and wait for it, at most ``limit_ns`` on the clock; return whether the robot got there."""
        clock = self._clock
        if clock is None:
            return True
        self._wish(m.Request.IDLE)
        begin_ns = clock.now_ns()
        n = 1
        while n * period_ns <= limit_ns:
            self.wait_until(begin_ns + n * period_ns)
            feedback = self.poll()
            if feedback is not None and feedback.state in (m.State.IDLE, m.State.FAULT, m.State.ESTOP):
                return True
            n += 1
        return False

    # One tick

    def wait_until(self, t_ns: int) -> int:
        """Let time pass on the clock; commands that the link delays go out on their way. Returns the lateness [ns]."""
        clock, link = self._clock, self._link
        assert clock is not None
        if link.may_hold:
            link.hand_over_until(clock, t_ns)
        if self.clock_sync.awaiting and not self._expected.lockstep:
            self._await_clock(clock, t_ns)
        late_ns = clock.wait_until(t_ns)
        if link.may_hold:
            link.service()
        return late_ns

    def _await_clock(self, clock: Clock, t_ns: int) -> None:
        """Wait for TIME_SYNC's answer on the link itself: what is found at the next tick has no stamp of its own."""
        while self.clock_sync.awaiting and (left_ns := t_ns - clock.now_ns()) > 0:
            received = self._link.receive(left_ns)
            if received is None:
                return
            self._take(received)

    def poll(self) -> Feedback | None:
        """Take what has arrived; return the newest snapshot so far. Sends heartbeat and TIME_SYNC when they are due.

        In real time what was taken may have lain there for ``unread_ns``: since the link was last found empty. In
        lockstep ``step`` alone takes: what else the line already has of an answer depends on the wall clock.
        """
        taken = 0
        if not self._expected.lockstep:
            # The rest is for the next tick: a host that is slower than its robot would never be done.
            while taken < _MOST_A_POLL and (received := self._link.receive(0)) is not None:
                self._take(received)
                taken += len(received.frames)
        self._hash.keep_up()
        if self._clock is not None:
            now_ns = self._clock.now_ns()
            due_ns = self._next_heartbeat_ns
            if due_ns is not None and now_ns >= due_ns:
                self._wish(self._request)
            if now_ns >= self._next_sync_ns:
                self._synchronise(now_ns)
            if not self._expected.lockstep:
                self._unread.polled(now_ns, everything=taken < _MOST_A_POLL)
        return self._feedback

    @property
    def unread_ns(self) -> int:
        """How long what the newest poll took may have lain on the link; 0 in lockstep."""
        return self._unread.ns

    @property
    def feedback(self) -> Feedback | None:
        """The newest snapshot that was taken; None after a loss, until the next one."""
        return self._feedback

    def _synchronise(self, now_ns: int) -> None:
        self._next_sync_ns = now_ns + SYNC_PERIOD_NS
        self._send(m.TimeSyncRequest(self.clock_sync.request(now_ns)))
        if self._expected.lockstep and self._link.next_due_ns() is None:
            # No time passes here, so that the answer has the stamp of its tick, not that of the next step's end.
            self._exchange(m.Step(self.tick, 0))

    def send(self, command: WheelCommand) -> int:
        """Send a command that the guard has passed; return its sequence. Raises ValueError for what cannot be sent."""
        self._sequence = (self._sequence + 1) & 0xFF
        if self._clock is not None:
            self.round_trip.sent(self._sequence, self._clock.now_ns())
        mode, speed_rad_s, torque_n_m = command
        sequence, session = self._sequence, self._nonce & 0xF
        torque = torque_n_m if self._map.is_identity else self._map.to_wire(torque_n_m)
        if mode is _TORQUE:
            self._send(_make_torque_command((*torque, sequence, session)))
            return sequence
        if any(torque):
            self._send(_make_feedforward((*torque, sequence, session)))
        self._send(_make_wheel_command((*self._map.to_wire(speed_rad_s), sequence, session)))
        return sequence

    def step(self, ticks: int) -> None:
        """Lockstep: let so many firmware ticks pass, and take what the robot sends meanwhile."""
        self._exchange(_make_step((self._stepping.tick, ticks)))

    def _exchange(self, step: m.Step) -> None:
        """Send a STEP and take what comes until its answer. 0 substeps only ask for the tick."""
        self._send(step)
        self._stepping.exchange(self._link, step, self._take)

    @property
    def tick(self) -> int:
        """In lockstep: the firmware tick that the robot has reached."""
        return self._stepping.tick

    # Frames

    def _wish(self, request: m.Request) -> None:
        self._request = request
        if self._clock is not None:
            self._next_heartbeat_ns = self._clock.now_ns() + _HEARTBEAT_NS
        mode = m.Mode.TORQUE if self._mode is CommandMode.TORQUE else m.Mode.SPEED
        check = self._expected.parameter_hash & 0xFF
        self._send(m.HostHeartbeat(self._nonce, m.SCHEMA_HASH, request, mode, check))

    def _send(self, message: Message) -> None:
        frame = encode(message)
        self._link.send(frame)
        if message.ID < _FIRST_UNCOUNTED:
            self.sent += 1
            self._hash.sent(frame)

    def _take(self, received: Received) -> None:
        frames, stamp_ns = received
        packed = frames.packed if type(frames) is PackedFrames else pack(frames)
        reader, begin, size = self._reader, 0, len(packed)
        try:
            while begin < size:
                end = reader.take(packed, begin)
                for sequence in reader.sequences:
                    self.round_trip.echoed(sequence, stamp_ns)
                if (snapshot := reader.feedback) is not self._snapshot and snapshot is not None:
                    self._snapshot = snapshot
                    self._feedback = snapshot if self._map.is_identity else self._map.feedback_from_wire(snapshot)
                if (tick := reader.step_done) is not None:
                    before = end - _STEP_DONE_BYTES
                    self._hash.received(packed[begin:before])
                    if self._stepping.answered(tick):  # once, however often STEP was repeated
                        self._hash.received(packed[before:end])
                elif end > begin:
                    self._hash.received(packed[begin:end])
                else:
                    end = self._take_other(packed, begin, stamp_ns)
                begin = end
        finally:
            self.received = reader.frames + self._others
            self.snapshots_lost = reader.lost + reader.incomplete

    def _take_other(self, packed: bytes, begin: int, stamp_ns: int) -> int:
        """Take a frame that is neither of a snapshot nor the end of a step; return where the next one begins."""
        frame, end = packed_frame(packed, begin)
        message = decode(frame)
        if message is None:
            self._out_of_range += 1
            return end
        if message.ID < _FIRST_UNCOUNTED:
            self._others += 1
            self._hash.received(packed[begin:end])
        self._take_message(message, stamp_ns)
        return end

    def _take_message(self, message: Message, stamp_ns: int) -> None:
        if self._greeting is not None and (info := self._greeting.feed(message)) is not None:
            self._check_same(info)
            self._greeting = None
        elif isinstance(message, m.TimeSyncResponse):
            self.clock_sync.answered(message.sequence, message.received_us, message.held_us, stamp_ns)
        else:
            self.report.feed(message)

    # Accounts

    def wire_sha256(self) -> str:
        """Return the hash of every frame of the session, both directions, in order; the same on every transport.

        HELLO and repeated STEPs are left out: how many there are depends on the wall clock.
        """
        return self._hash.hexdigest()

    def rejected(self) -> dict[str, int]:
        """Return the frames that this host dropped, by cause, and those that the robot reported (``robot_...``)."""
        own = self._link.rejected() | {
            "range": self._out_of_range,
            "incomplete_snapshot": self._reader.incomplete,
        }
        robot = {f"robot_{cause}": count for cause, count in self.report.rejected.items()}
        return {cause: count for cause, count in (own | robot).items() if count}

    def describe_link(self) -> str:
        """Return what the link is, in words for a person."""
        return self._link.describe()

    def close(self) -> None:
        """Wish for IDLE if anything else is still wished for. The link is closed by whoever opened it."""
        self.disarm()
