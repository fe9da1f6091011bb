"""The host's side of the wheel-command protocol: handshake, arming, commands, feedback, lockstep.

The robot behind the link may be a board with motors, a board connected to the simulated plant, or the host library.
This code works the same with each; only HELLO tells them apart.
"""

import contextlib
import math
from collections.abc import Iterator

from firmware_protocol.codec import Message
from firmware_protocol.generated import messages as m
from hil.core.errors import DeviceError, HilError, RobotStoppedError
from hil.core.ports import Clock
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand
from hil.robot import handshake
from hil.robot.channel import Channel
from hil.robot.handshake import Expected, RobotInfo
from hil.robot.link_times import SYNC_PERIOD_NS
from hil.robot.port import LinkedDevice
from hil.robot.robot_report import RobotReport
from hil.robot.session import Session, Step
from hil.robot.snapshot import Feedback
from hil.robot.wheel_map import WheelMap
from hil.wire.conditions import ConditionedLink

_MOST_A_POLL = 200  # frames; a robot sends at most some ten a tick
_ESTOP_BY_HOST = 1
_AT_REST = (m.State.IDLE, m.State.FAULT, m.State.ESTOP)


class Stm32(LinkedDevice):
    """A robot with the protocol of wheel.dbc, at the other end of a link. See ``hil.robot.port.Device``.

    ``nonces`` are the session nonces to use, in order. Raises DeviceError when the robot does not answer, refuses
    or stops; BadInputError when it does not match the scenario.
    """

    def __init__(
        self,
        link: ConditionedLink,
        mode: CommandMode,
        expected: Expected,
        nonces: Iterator[int],
        wheel_map: WheelMap,
    ) -> None:
        super().__init__(link, is_lockstep=expected.lockstep)
        self._mode = mode
        self._expected = expected
        self._map = wheel_map
        self._session = Session(nonces, mode, expected)
        self.report = RobotReport(wheel_map)
        self._channel = self._line = Channel(link, wheel_map, self.round_trip, self._on_message)
        self._next_sync_ns = 0

    # Connecting

    def connect(self) -> RobotInfo:
        """Request HELLO and check the answer against the scenario."""
        info = handshake.greet(self._link, self._channel.send)
        self._session.accept(info)
        self._synchronise_tick()
        return info

    @property
    def info(self) -> RobotInfo | None:
        return self._session.info

    @property
    def speed_limit_rad_s(self) -> float:
        """The robot's limit of commanded speeds (DBC HELLO_LIMITS); infinity in TORQUE mode and before HELLO."""
        if self.info is None or self._mode is CommandMode.TORQUE:
            return math.inf
        return self.info.limits.speed_limit_rad_s

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about a bad cause of the last reset, and about a speed limit below the scenario's."""
        if self.info is None:
            return ()
        cause = None if self.report.status is None else m.ResetCause(self.report.status.reset_cause)
        ours_rad_s = 0.0 if self._mode is CommandMode.TORQUE else self._expected.speed_limit_rad_s
        return self.info.warnings(cause, ours_rad_s)

    # Reconnection after a loss, in steps that do not wait, because the control loop keeps running

    @property
    def keeps_counts(self) -> bool:
        """True: the encoders keep counting while the link is lost, unless the robot is reset."""
        return True

    def leave(self) -> None:
        self._session.leave()
        self._channel.feedback = None
        self.report.status = None
        self.clock_sync.give_up()
        self._discard()

    def begin_again(self) -> None:
        """Start again with a new nonce and a handshake. Raises RobotStoppedError if the robot is silent in lockstep."""
        self.leave()
        self._channel.restart()
        self.report.restart()
        self.round_trip.restart()
        self._session.begin_again()
        self._synchronise_tick()

    def greeted(self) -> bool:
        """Request HELLO when it is due; return whether the robot has answered."""
        assert self._clock is not None
        if (hello := self._session.hello(self._clock.now_ns())) is not None:
            self._channel.send(hello)
        self.poll()
        return self._session.is_greeted

    # Arming and stopping

    def armed(self) -> bool:
        """Do the session's next step; return whether the robot is ACTIVE in our session."""
        feedback, status = self.poll(), self.report.status
        step = self._session.next_step(None if feedback is None else feedback.state, status)
        match step:
            case Step.HOLD:
                self.send(WheelCommand(self._mode, ZERO_WHEELS, ZERO_WHEELS))
            case Step.ARM | Step.ARM_ANEW:
                if step is Step.ARM_ANEW:
                    self.report.status = None
                    self._session.renew()
                self._request(m.Request.IDLE)
                self._request(m.Request.ARM)
            case Step.STRANGER:
                raise RobotStoppedError("the robot has not answered HELLO since the link was lost; it is not armed")
            case Step.REFUSED:
                assert status is not None
                refusal = m.ArmRefusal(status.arm_refusal).name
                raise DeviceError(f"the robot refused to arm: {refusal}; see the arming rules in PROTOCOL.md")
            case Step.LATCHED:
                raise DeviceError(self.why_not_active())
        return step is Step.DONE

    def why_not_active(self) -> str:
        return self.report.why_not_active(None if self.feedback is None else self.feedback.state)

    def disarm(self) -> None:
        if self._session.request is not m.Request.IDLE:
            with contextlib.suppress(HilError):  # called after failures: it must not raise
                self._request(m.Request.IDLE)
                self._link.flush()

    def estop(self) -> None:
        self._session.request = m.Request.IDLE
        self._channel.send(m.Estop(_ESTOP_BY_HOST, 0))
        self._link.flush()

    def clear(self) -> None:
        self._session.renew()  # the robot ignores a CLEAR with the nonce of the last one
        self._request(m.Request.CLEAR)

    def stop(self, period_ns: int, limit_ns: int) -> bool:
        if self._clock is None:
            return True
        self._request(m.Request.IDLE)
        begin_ns = self._clock.now_ns()
        for t_ns in range(period_ns, limit_ns + 1, period_ns):
            self.wait_until(begin_ns + t_ns)
            feedback = self.poll()
            if feedback is not None and feedback.state in _AT_REST:
                return True
        return False

    def close(self) -> None:
        """Request IDLE if the last request was another. The link stays open: whoever opened it closes it."""
        self.disarm()

    # One tick

    def _receive_until(self, clock: Clock, t_ns: int) -> None:
        """Wait for the answer to TIME_SYNC: if read only at the next tick, its time of arrival would be unknown."""
        while not self._is_lockstep and self.clock_sync.awaiting and (left_ns := t_ns - clock.now_ns()) > 0:
            received = self._link.receive(left_ns)
            if received is None:
                return
            self._channel.receive(received)

    def poll(self) -> Feedback | None:
        """Read what has arrived; return the newest snapshot. Sends heartbeat and TIME_SYNC when they are due.

        In lockstep only ``step`` reads, because what has arrived between steps depends on the wall clock.
        """
        taken = 0
        if not self._is_lockstep:
            # The rest is read in the next tick: a host that is slower than its robot would never finish.
            while taken < _MOST_A_POLL and (received := self._link.receive(0)) is not None:
                self._channel.receive(received)
                taken += len(received.frames)
        self._channel.hash.keep_up()
        if self._clock is not None:
            now_ns = self._clock.now_ns()
            if self._session.is_heartbeat_due(now_ns):
                self._request(self._session.request)
            if now_ns >= self._next_sync_ns:
                self._synchronise(now_ns)
            if not self._is_lockstep:
                self._poll_age.record_poll(now_ns, everything=taken < _MOST_A_POLL)
        return self._channel.feedback

    @property
    def feedback(self) -> Feedback | None:
        return self._channel.feedback

    def send(self, command: WheelCommand) -> int:
        sequence = self._sequence = (self._sequence + 1) & 0xFF
        if self._clock is not None:
            self.round_trip.sent(sequence, self._clock.now_ns())
        mode, speed_rad_s, torque_n_m = command
        session = self._session.nonce & 0xF
        torque = self._map.to_wire(torque_n_m)
        if mode is CommandMode.TORQUE:
            self._channel.send(m.TorqueCommand(*torque, sequence, session))
            return sequence
        if any(torque):
            self._channel.send(m.TorqueFeedforward(*torque, sequence, session))
        self._channel.send(m.WheelCommand(*self._map.to_wire(speed_rad_s), sequence, session))
        return sequence

    def step(self, ticks: int) -> None:
        self._channel.step(self._channel.tick, ticks)

    @property
    def tick(self) -> int:
        return self._channel.tick

    # Messages

    def _synchronise_tick(self) -> None:
        """Lockstep: ask for the robot's current firmware tick."""
        if self._is_lockstep:
            self._channel.step(0, 0)

    def _synchronise(self, now_ns: int) -> None:
        self._next_sync_ns = now_ns + SYNC_PERIOD_NS
        self._channel.send(m.TimeSyncRequest(self.clock_sync.request(now_ns)))
        if self._is_lockstep and self._link.next_due_ns() is None:
            # A step of 0 ticks, so that the answer gets the time of this tick, not of the next step's end.
            self._channel.step(self.tick, 0)

    def _request(self, request: m.Request) -> None:
        now_ns = None if self._clock is None else self._clock.now_ns()
        self._channel.send(self._session.heartbeat(request, now_ns))

    def _on_message(self, message: Message, stamp_ns: int) -> None:
        if self._session.feed(message):
            return
        if isinstance(message, m.TimeSyncResponse):
            self.clock_sync.answered(message.sequence, message.received_us, message.held_us, stamp_ns)
        else:
            self.report.feed(message)

    # Counters

    @property
    def snapshots_lost(self) -> int:
        return self._channel.lost

    def rejected(self) -> dict[str, int]:
        robot = {f"robot_{cause}": count for cause, count in self.report.rejected.items()}
        return {cause: count for cause, count in (self._channel.rejected() | robot).items() if count}
