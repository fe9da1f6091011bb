"""The host's side of the wheel-command protocol: handshake, arming, commands, feedback, lockstep.

The robot behind the link may be a board with motors, a board connected to the simulated plant, or the host library.
This code works the same with each; only HELLO tells them apart. The protocol itself is in C
(``firmware_protocol.client``); this is what connects it to a link, a clock and the words for a person.
"""

import contextlib
import math
from collections.abc import Callable, Iterator
from functools import partial

from firmware_protocol.built import BuildError
from firmware_protocol.client import NO_TIME, Client
from firmware_protocol.codec import Message, encode
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import packed_of
from hil.core.errors import BadInputError, DeviceError, HilError, RobotStoppedError
from hil.core.ports import Clock
from hil.core.types import CommandMode, WheelCommand, Wheels
from hil.core.wheel_map import ImuMount, WheelMap
from hil.robot import handshake
from hil.robot.channel import open_channel
from hil.robot.handshake import Expected, Greeting, RobotInfo
from hil.robot.link_times import SYNC_PERIOD_NS, RoundTrip
from hil.robot.port import Device
from hil.robot.robot_report import RobotReport
from hil.robot.snapshot import Feedback, mounted
from hil.wire.conditions import ConditionedLink

_AT_REST = (m.State.IDLE, m.State.FAULT, m.State.ESTOP)
_ARMING_DONE, _ARMING_NEW_NONCE, _ARMING_REFUSED, _ARMING_LATCHED = 0, 4, 6, 7


class Stm32(Device):
    """A robot with the protocol of wheel.dbc, at the other end of a link.

    ``nonces`` are the session nonces to use, in order. ``keep`` gets the packed frames that were sent and received,
    piece by piece. Raises DeviceError when the robot does not answer, refuses or stops; BadInputError when it does not
    match the scenario, or the host library cannot be loaded.
    """

    report: RobotReport
    keeps_counts = True

    def __init__(
        self,
        link: ConditionedLink,
        mode: CommandMode,
        expected: Expected,
        nonces: Iterator[int],
        wheel_map: WheelMap,
        imu: ImuMount | None = None,
        keep: Callable[[bytes, bytes], None] | None = None,
    ) -> None:
        super().__init__(link, is_lockstep=expected.lockstep)
        self._mode = mode
        self._expected = expected
        self._map = wheel_map
        self._nonces = nonces
        self._now_ns: Callable[[], int] = _no_time
        try:
            self._client = Client(m.Mode(mode), expected.parameter_hash & 0xFF, next(nonces), Feedback, Wheels)
        except BuildError as error:
            raise BadInputError(str(error)) from error
        self._client.keep = keep
        self._client.wire(wheel_map.wheel_of_channel, wheel_map.sign_of_channel)
        self.link_figures = self._client.link_figures
        self._channel = channel = open_channel(link, self._client, self._on_message)
        self.step = channel.step
        self._feedback: Callable[[], Feedback | None] = self._client.feedback
        if imu is not None and not imu.is_identity:
            self._feedback = partial(_mounted, self._client.feedback, imu)
        self._greeting: Greeting | None = None
        self._info: RobotInfo | None = None
        self._is_accepted = False  # since the link was opened, or lost
        self._next_sync_ns = 0
        self.report = RobotReport(wheel_map)

    # Connecting

    def connect(self) -> RobotInfo:
        greeting = Greeting()
        self._accept(handshake.greet(self._link, greeting), greeting)
        for page in greeting.frames:
            self._client.take(packed_of([page]), 0, 0)
        self._synchronise_tick()
        assert self._info is not None
        return self._info

    def _accept(self, info: RobotInfo, greeting: Greeting) -> None:
        """Accept the answer to HELLO. Raises BadInputError if the scenario or the run is of another robot."""
        handshake.check(info, self._expected)
        if self._info is not None and not self._info.is_same_robot(info):
            raise BadInputError(
                f"another robot answers on the link: {info.describe()}; the run began with {self._info.describe()}; "
                "plug in the first one, or start a new run"
            )
        if self._client.keep is not None:  # its log has no HELLO
            self._client.keep(b"", packed_of(greeting.frames))
        self._info = info  # the fault record and reset cause may be new
        self._is_accepted = True

    @property
    def info(self) -> RobotInfo | None:
        return self._info

    @property
    def speed_limit_rad_s(self) -> float:
        return math.inf if self.info is None else self.info.limits.speed_limit_rad_s

    @property
    def overspeed_rad_s(self) -> float:
        return math.inf if self.info is None else self.info.limits.overspeed_rad_s

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about a bad cause of the last reset, and about a speed limit below the scenario's."""
        if self.info is None:
            return ()
        cause = None if self.report.status is None else m.ResetCause(self.report.status.reset_cause)
        ours_rad_s = 0.0 if self._mode is CommandMode.TORQUE else self._expected.speed_limit_rad_s
        return self.info.warnings(cause, ours_rad_s)

    # Reconnection after a loss, in steps that do not wait, because the control loop keeps running

    def leave(self) -> None:
        self._is_accepted = False
        self._client.leave()
        self.report.status = None
        self.clock_sync.give_up()
        self._discard()

    def begin_again(self) -> None:
        """Start again with a new nonce and a handshake. Raises RobotStoppedError if the robot is silent in lockstep."""
        self.leave()
        self._client.begin(next(self._nonces))
        self._greeting = Greeting()
        self.report.restart()
        self._synchronise_tick()

    def greeted(self) -> bool:
        self.poll()
        return self._greeting is None

    # Arming and stopping

    def attend(self, clock: Clock) -> None:
        super().attend(clock)
        self._now_ns = clock.now_ns

    def armed(self) -> bool:
        """Do the session's next step; return whether the robot is ACTIVE in our session."""
        feedback = self.poll()
        if not self._is_accepted and feedback is not None and feedback.state is m.State.IDLE:
            raise RobotStoppedError("the robot has not answered HELLO since the link was lost; it is not armed")
        step = self._client.arm(self._now_ns())
        if step == _ARMING_NEW_NONCE:
            self.report.status = None
            self._client.renew(next(self._nonces))
            step = self._client.arm(self._now_ns())
        self._channel.flush()
        if step == _ARMING_REFUSED:
            assert self.report.status is not None
            refusal = m.ArmRefusal(self.report.status.arm_refusal).name
            raise DeviceError(f"the robot refused to arm: {refusal}; see the arming rules in PROTOCOL.md")
        if step == _ARMING_LATCHED:
            raise DeviceError(self.why_not_active())
        return step == _ARMING_DONE

    def why_not_active(self) -> str:
        return self.report.why_not_active(None if self.feedback is None else self.feedback.state)

    def disarm(self) -> None:
        if self._client.view.request != m.Request.IDLE:
            with contextlib.suppress(HilError):  # called after failures: it must not raise
                self._request(m.Request.IDLE)
                self._link.flush()

    def estop(self) -> None:
        self._client.estop()
        self._channel.flush()
        self._link.flush()

    def clear(self) -> None:
        self._client.renew(next(self._nonces))  # the robot ignores a CLEAR with the nonce of the last one
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
        while self.clock_sync.awaiting and (left_ns := t_ns - clock.now_ns()) > 0:
            received = self._link.receive(left_ns)
            if received is None:
                return
            self._channel.take(received)

    def poll(self) -> Feedback | None:
        """Read what has arrived; return the newest snapshot. Sends heartbeat and TIME_SYNC when they are due.

        In lockstep only ``step`` reads, because what has arrived between steps depends on the wall clock.
        """
        clock, read_feedback = self._clock, self._feedback
        if self._is_lockstep:
            if clock is not None:
                now_ns = clock.now_ns()
                if self._client.poll(now_ns):
                    self._channel.flush()
                if now_ns >= self._next_sync_ns:
                    self._synchronise(now_ns)
            return read_feedback()
        emptied_ns = self._channel.receive()
        if clock is not None:
            now_ns = clock.now_ns() if emptied_ns is None else emptied_ns
            if now_ns >= self._next_sync_ns:
                self._synchronise(now_ns)
            self._poll_age.record_poll(now_ns, everything=emptied_ns is not None)
        return read_feedback()

    @property
    def feedback(self) -> Feedback | None:
        return self._feedback()

    def send(self, command: WheelCommand) -> int:
        _, speed_rad_s, torque_n_m = command
        sequence = self._client.command(speed_rad_s, torque_n_m, self._now_ns())
        if sequence < 0:
            sequence = self._send_behind_the_rest(command)
        if not self._channel.is_carried:
            self._channel.flush()
        return sequence

    def _send_behind_the_rest(self, command: WheelCommand) -> int:
        """Send what waits, then the command. Raises ValueError for a command that the wire cannot carry."""
        _, speed_rad_s, torque_n_m = command
        if self._mode is CommandMode.TORQUE:
            encode(m.TorqueCommand(*self._map.to_wire(torque_n_m), 0, 0))
        else:
            encode(m.TorqueFeedforward(*self._map.to_wire(torque_n_m), 0, 0))
            encode(m.WheelCommand(*self._map.to_wire(speed_rad_s), 0, 0))
        self._channel.flush(everything=True)
        return self._client.command(speed_rad_s, torque_n_m, self._now_ns())

    @property
    def tick(self) -> int:
        return int(self._client.view.tick)

    # Messages

    def _synchronise_tick(self) -> None:
        if self._is_lockstep:
            self.step(0)

    def _synchronise(self, now_ns: int) -> None:
        self._next_sync_ns = now_ns + SYNC_PERIOD_NS
        frame = encode(m.TimeSyncRequest(self.clock_sync.request(now_ns)))
        self._client.add(frame.id, frame.payload)
        self._channel.flush()
        if self._is_lockstep and self._link.next_due_ns() is None:
            # A step of 0 ticks, so that the answer gets the time of this tick, not of the next step's end.
            self.step(0)

    def _request(self, request: m.Request) -> None:
        self._client.request(request, self._now_ns())
        self._channel.flush()

    def _on_message(self, message: Message, stamp_ns: int) -> None:
        if self._greeting is not None and (info := self._greeting.feed(message)) is not None:
            self._accept(info, self._greeting)
            self._greeting = None
        elif isinstance(message, m.TimeSyncResponse):
            self.clock_sync.answered(message.sequence, message.received_us, message.held_us, stamp_ns)
        else:
            self.report.feed(message)

    # Counters

    @property
    def sent(self) -> int:
        return int(self._client.view.sent)

    @property
    def received(self) -> int:
        return int(self._client.view.received)

    @property
    def snapshots_lost(self) -> int:
        view = self._client.view
        return int(view.lost + view.incomplete)

    def wire_sha256(self) -> str:
        return self._client.hexdigest()

    @property
    def round_trip(self) -> RoundTrip:
        return self._channel.round_trip

    def rejected(self) -> dict[str, int]:
        robot = {f"robot_{cause}": count for cause, count in self.report.rejected.items()}
        return {cause: count for cause, count in (self._channel.rejected() | robot).items() if count}


def _no_time() -> int:
    return NO_TIME


def _mounted(read: Callable[[], Feedback | None], imu: ImuMount) -> Feedback | None:
    feedback = read()
    return None if feedback is None else mounted(feedback, imu)
