"""A robot by PROTOCOL.md, in Python: what it must do with each frame and in each tick.

The oracle of ``test_conversations.py``; it shares no code with the firmware.
"""

from typing import Any, NamedTuple

import numpy as np

from firmware_protocol.capabilities import Capability
from firmware_protocol.codec import Message, decode
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import ArmRefusal, Fault, Mode, State, StopReason
from tests.suite.robot_feedback import Feedback, Sense
from tests.suite.robot_parameters import Parameters
from tests.suite.wheel_model import (
    STILL_RAD_S,
    CurrentLoop,
    EncoderWatch,
    Four,
    SpeedLoop,
    Trackers,
    scaled,
    speed_limit,
    ticks,
    torque_limit,
    zeros,
)

# Transitions by event, from state to state; any other event does nothing.
_NEXT: dict[tuple[str, State], State] = {
    ("arm", State.IDLE): State.ARMED,
    ("command", State.ARMED): State.ACTIVE,
    ("disarm", State.ARMED): State.IDLE,
    ("disarm", State.ACTIVE): State.STOPPING,
    ("timeout", State.ARMED): State.IDLE,
    ("timeout", State.ACTIVE): State.STOPPING,
    ("stopped", State.STOPPING): State.IDLE,
    ("clear", State.FAULT): State.IDLE,
    ("clear", State.ESTOP): State.IDLE,
    **{("estop", state): State.ESTOP for state in State if state is not State.BOOT},
    **{("fault", state): State.FAULT for state in State if state is not State.ESTOP},
}
_DRIVING = (State.ACTIVE, State.STOPPING)


class Drive(NamedTuple):
    """What the drives get for a tick."""

    enabled: bool
    torque_n_m: Four
    duty: list[float]


class RobotModel:
    """The robot, which begins in IDLE with its first sample; ``out`` is its messages."""

    def __init__(
        self,
        values: dict[str, float],
        capabilities: Capability,
        first: Sense,
        kept: dict[str, float] | None = None,
        reset_cause: m.ResetCause = m.ResetCause.POWER_ON,
    ) -> None:
        self.parameters = Parameters(values, kept)
        self.reset_cause = reset_cause
        self.capabilities = capabilities
        self.out: list[Message] = []
        self.counts = dict.fromkeys((*m.LinkCounters._fields, *m.PortCounters._fields), 0)
        self.tick = self.now_us = 0
        self.state, self.mode, self.stop_reason = State.BOOT, Mode.SPEED, StopReason.NONE
        self.fault, self.fault_wheel, self.refusal = Fault.NONE, 0, ArmRefusal.NONE
        self.session = self.announced = self.cleared = 0
        self.step_to: int | None = None
        self.target, self.ahead, self.sequence = zeros(), zeros(), 0
        self.staged: tuple[int, Four] | None = None
        self.age: int | None = None
        self.trackers = Trackers()
        self.watches = [EncoderWatch() for _ in range(4)]
        self.loop, self.current_loop = SpeedLoop(), CurrentLoop()
        self.speed, self.set_point, self.torque, self.ramp_from = (zeros() for _ in range(4))
        self.state_ticks = self.rest_ticks = self.limited = self.overcurrent = self.undervoltage = 0
        self.braking = False
        self.sensed, self.is_plausible = first, True
        self.feedback = Feedback(self)
        self._become(State.IDLE)
        self.sense(first)

    @property
    def values(self) -> dict[str, float]:
        """The parameters in force."""
        return self.parameters.values

    # States

    def event(self, name: str, reason: StopReason | None = None) -> None:
        """Do what an event does in this state; the reason is kept where it does something."""
        after = _NEXT.get((name, self.state), self.state)
        if after is not self.state:
            self.stop_reason = self.stop_reason if reason is None else reason
            self._become(after)

    def _become(self, after: State) -> None:
        self.braking = after is State.ESTOP and self.state in _DRIVING
        self.state, self.state_ticks, self.announced = after, 0, 0
        if after is State.ARMED:  # a session begins with nothing of the one before
            self.target, self.ahead, self.staged = zeros(), zeros(), None
            self.sequence, self.age, self.stop_reason = 0, None, StopReason.NONE
            self.loop, self.current_loop = SpeedLoop(), CurrentLoop()
            self.watches = [EncoderWatch(speed) for speed in self.speed.tolist()]
        elif after in (State.STOPPING, State.ESTOP):
            self.loop = SpeedLoop()
            nearer = np.where(abs(self.speed) < abs(self.set_point), self.speed, self.set_point)
            self.ramp_from = np.where(self.set_point * self.speed > 0.0, nearer, zeros())
        elif after is State.IDLE:
            self.fault, self.fault_wheel = Fault.NONE, 0
        self.feedback.status()

    def fail(self, cause: Fault, wheel: int = 0) -> None:
        """Find a fault; the first one is told until it is cleared."""
        if self.fault is Fault.NONE:
            self.fault, self.fault_wheel = cause, wheel
        self.braking = False
        self.event("fault", StopReason.FAULT)

    # What it hears

    def receive(self, frame: Frame) -> None:
        """Take a frame of the host."""
        take, length = _TAKES.get(frame.id), len(frame.payload)
        if take is None and length <= 8:
            self.counts["unknown_id"] += 1
        elif take is None or length != m.LENGTHS[frame.id]:
            self.counts["length"] += 1
        elif (message := decode(frame)) is None:
            self.counts["range"] += 1
        else:
            take(self, message)

    def _on_estop(self, _message: m.Estop) -> None:
        self.event("estop", StopReason.ESTOP)

    def _on_heartbeat(self, beat: m.HostHeartbeat) -> None:
        if beat.request == m.Request.IDLE:
            self.event("disarm", StopReason.HOST_REQUEST)
            if self.state is State.IDLE:
                self.announced = beat.nonce
        elif beat.request == m.Request.ARM:
            self._on_arm(beat)
        elif not self.braking:
            is_new, self.cleared = beat.nonce != self.cleared, beat.nonce
            if is_new:
                self.event("clear")

    def _on_arm(self, beat: m.HostHeartbeat) -> None:
        if self.state in (State.ARMED, State.ACTIVE) and beat.nonce == self.session:
            return
        refusal = self._refusal(beat)
        is_news, self.refusal, self.announced = refusal is not self.refusal, refusal, 0
        if refusal is ArmRefusal.NONE:
            self.session, self.mode = beat.nonce, Mode(beat.mode)
            self.event("arm")
        elif is_news:
            self.feedback.status()

    def _refusal(self, beat: m.HostHeartbeat) -> ArmRefusal:
        wanted = Capability.TORQUE if beat.mode == Mode.TORQUE else Capability.SPEED
        reasons = {
            ArmRefusal.NONCE_USED: beat.nonce == self.session,
            ArmRefusal.NOT_IDLE: self.state is not State.IDLE,
            ArmRefusal.NOT_ANNOUNCED: beat.nonce != self.announced,
            ArmRefusal.SESSION_USED: self.session != 0 and beat.nonce & 0xF == self.session & 0xF,
            ArmRefusal.SCHEMA: beat.schema_hash != m.SCHEMA_HASH,
            ArmRefusal.PARAMETERS: beat.parameter_check != self.parameters.hash() & 0xFF,
            ArmRefusal.MODE: not self.capabilities & wanted,
        }
        return next((reason for reason, holds in reasons.items() if holds), ArmRefusal.NONE)

    def _is_fresh(self, mode: Mode, session: int, sequence: int) -> bool:
        if self.state not in (State.ARMED, State.ACTIVE) or mode is not self.mode:
            self.counts["state"] += 1
        elif session != self.session & 0xF:
            self.counts["session"] += 1
        elif self.state is State.ACTIVE and not 1 <= (sequence - self.sequence) % 256 <= 20:
            self.counts["stale"] += 1
        else:
            return True
        return False

    def _on_command(self, command: m.WheelCommand | m.TorqueCommand) -> None:
        mode = Mode.SPEED if isinstance(command, m.WheelCommand) else Mode.TORQUE
        target = np.array(command[:4], np.float32)
        if not self._is_fresh(mode, command.session, command.sequence):
            return
        if self.state is State.ARMED and target.any():
            self.counts["state"] += 1
            return
        self.target, self.ahead = target, zeros()
        if self.staged is not None:
            if self.staged[0] == command.sequence:
                self.ahead = self.staged[1]
            else:
                self.counts["feedforward_unmatched"] += 1
        self.staged, self.sequence, self.age = None, command.sequence, 0
        self.event("command")

    def _on_feedforward(self, ahead: m.TorqueFeedforward) -> None:
        if self.state is not State.ACTIVE:
            self.counts["state"] += 1
        elif self._is_fresh(Mode.SPEED, ahead.session, ahead.sequence):
            self.counts["feedforward_unmatched"] += self.staged is not None
            self.staged = ahead.sequence, np.array(ahead[:4], np.float32)

    def _on_time_sync(self, request: m.TimeSyncRequest) -> None:
        self.out.append(m.TimeSyncResponse(self.now_us, 0, request.sequence))

    def _on_hello(self, _request: m.HelloRequest) -> None:
        self.refusal = ArmRefusal.NONE
        self.feedback.hello()

    def _on_step(self, step: m.Step) -> None:
        if not self.capabilities & Capability.LOCKSTEP or self.capabilities & Capability.POWER_STAGE:
            self.counts["state"] += 1
        else:
            self.step_to = self.tick + step.substeps if step.tick == self.tick else self.tick

    def _on_parameter(self, asked: m.ParameterRequest) -> None:
        storage = bool(self.capabilities & Capability.STORAGE)
        self.out.append(self.parameters.answer(asked, idle=self.state is State.IDLE, storage=storage))

    # A tick

    def drive(self) -> Drive:
        """Return what the drives get for this tick, and end it."""
        p, enabled, limited = self.values, self.state in _DRIVING, False
        torque, ahead = zeros(), zeros()
        limit = torque_limit(p, max(self.sensed.temperature_degc))
        if self.state is State.ACTIVE and self.mode is Mode.TORQUE:
            self.set_point = self.speed  # where a stop begins
            torque, limited = scaled(self.target, limit)
        elif self.state is State.ACTIVE:
            self.set_point, limited = scaled(self.target, speed_limit(p))
            ahead = self.ahead
        elif self.state is State.STOPPING:
            ramp = ticks(p["ramp_s"])
            self.set_point = self.ramp_from * np.float32(max(0, ramp - self.state_ticks - 1) / ramp)
        else:
            self.set_point = zeros()
            self.braking = self.braking and self.state_ticks < 1000 and self.rest_ticks < 50
            enabled = self.braking
        if enabled and not (self.state is State.ACTIVE and self.mode is Mode.TORQUE):
            torque, scaled_down = self.loop.update(self.set_point, self.speed, ahead, p, limit)
            limited = limited or scaled_down
        duty = [0.0] * 4
        if enabled and self.is_plausible:
            duty = self.current_loop.update(
                torque.tolist(), self.sensed.current_a, self.speed.tolist(), self.sensed.battery_v, p
            )
        else:
            self.current_loop = CurrentLoop()
        self.torque = torque
        self.limited += limited
        self.age = None if self.age is None else self.age + 1
        self.state_ticks += 1
        self.tick += 1
        return Drive(enabled, torque, duty)

    def sense(self, sensed: Sense, *, plant_failed: bool = False) -> None:
        """Begin a tick with what was sampled: estimate, supervise, tell."""
        self.now_us = self.tick * 1000 & 0xFFFF_FFFF
        if plant_failed:
            self.fail(Fault.SENSOR)
        self.speed = self.trackers.update(sensed.counts, self.values)
        self.sensed, self.is_plausible = sensed, sensed.is_plausible()
        self._supervise()
        self.feedback.tell()

    def _supervise(self) -> None:
        p, sensed, speeds = self.values, self.sensed, self.speed.tolist()
        self.rest_ticks = self.rest_ticks + 1 if max(map(abs, speeds)) < STILL_RAD_S else 0
        if not self.is_plausible:
            self.fail(Fault.SENSOR)
        for wheel, speed in enumerate(speeds):
            if abs(speed) > p["overspeed_rad_s"]:
                self.fail(Fault.OVERSPEED, wheel + 1)
        over = [i + 1 for i, current in enumerate(sensed.current_a) if abs(current) > 1.5 * p["current_limit_a"]]
        self.overcurrent = self.overcurrent + 1 if over else 0
        if self.overcurrent >= 5:
            self.fail(Fault.OVERCURRENT, over[-1])
        hottest = max(range(4), key=lambda i: sensed.temperature_degc[i])
        if sensed.temperature_degc[hottest] >= p["temperature_limit_degc"]:
            self.fail(Fault.OVERTEMPERATURE, hottest + 1)
        self.undervoltage = self.undervoltage + 1 if sensed.battery_v < p["undervoltage_v"] else 0
        if self.undervoltage >= 20 and (self.state in _DRIVING or self.braking):
            self.fail(Fault.UNDERVOLTAGE)
        if self.state in _DRIVING or self.braking:
            self._watch_encoders(torque_limit(p, max(sensed.temperature_degc)))
        if self.state is State.ACTIVE and self.age is not None and self.age >= ticks(p["watchdog_s"]):
            self.event("timeout", StopReason.COMMAND_TIMEOUT)
        if self.state is State.ARMED and self.state_ticks >= 1000:
            self.event("timeout", StopReason.ARM_TIMEOUT)
        after_ramp = self.state_ticks - ticks(p["ramp_s"])
        if self.state is State.STOPPING and after_ramp >= 0 and (self.rest_ticks >= 50 or after_ramp >= 1000):
            self.event("stopped")

    def _watch_encoders(self, strong: float) -> None:
        speeds, targets, torques = self.speed.tolist(), self.set_point.tolist(), self.torque.tolist()
        for i, watch in enumerate(self.watches):
            target = None if self.mode is Mode.TORQUE else targets[i]
            if watch.is_stuck(i, speeds, target, torques[i], strong, self.values):
                self.fail(Fault.ENCODER_STUCK, i + 1)
            by_loop = self.mode is Mode.SPEED or self.state is not State.ACTIVE
            if watch.is_backward(i, speeds, targets[i], torques[i], strong, by_loop, self.values):
                self.fail(Fault.WRONG_DIRECTION, i + 1)


_TAKES: dict[int, Any] = {
    m.Estop.ID: RobotModel._on_estop,
    m.HostHeartbeat.ID: RobotModel._on_heartbeat,
    m.TorqueFeedforward.ID: RobotModel._on_feedforward,
    m.WheelCommand.ID: RobotModel._on_command,
    m.TorqueCommand.ID: RobotModel._on_command,
    m.TimeSyncRequest.ID: RobotModel._on_time_sync,
    m.ParameterRequest.ID: RobotModel._on_parameter,
    m.Step.ID: RobotModel._on_step,
    m.HelloRequest.ID: RobotModel._on_hello,
}
