"""Drives motor controllers by their DBC and a mapping, both given in the scenario; it has no rules of any maker."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, count
from typing import get_args

from firmware_protocol.framing import Frame
from hil.addons.motors.dbc.dbc_file import Message, Signal
from hil.addons.motors.dbc.dbc_mapping import Step
from hil.addons.motors.dbc.dbc_settings import PHASES, Settings, check_robot, gains, warnings, watchdog_raw
from hil.addons.motors.dbc.received import Received
from hil.core.errors import BadInputError
from hil.core.kinematics import body_twist, wheel_speeds
from hil.core.types import NAN, CommandMode, FourWheels
from hil.robot.driver import NO_CHANNELS, Capabilities, Dialect, Driver, RobotFacts, Sample, Sensor, clamp, four

_AGAIN_NS = 250_000_000
"""After this time the steps of arming are repeated: one of their frames may have been lost."""
_MEASURES = {"gyro": "yaw_rate", "accelerometer": "acceleration"}
"""What sensors measure, if the quantity has another name."""


class _Packer:
    """Makes the frames of one message. Raises BadInputError if one of its signals has no value.

    ``fixed``: raw values by signal, in place of the DBC's initial ones. ``moving``: signals that carry a value of the
    command, each with the value's index, gain and bias: raw = gain × value + bias. ``counters``: signals that count the
    frames cyclically, from their lowest to their highest number, and how many frames there were.
    """

    def __init__(
        self,
        message: Message,
        fixed: Mapping[str, float],
        moving: Sequence[tuple[Signal, int, float, float]],
        counters: Sequence[tuple[Signal, Iterator[int]]],
    ) -> None:
        self._message, self._moving, self._counters = message, moving, counters
        self._raws = {name: one.initial for name, one in message.signals.items() if one.initial is not None}
        self._raws.update(fixed)
        changing = {one[0].name for one in moving} | {one[0].name for one in counters}
        if lacking := [one for name, one in message.signals.items() if name not in self._raws and name not in changing]:
            others = f", and so for {', '.join(one.name for one in lacking[1:])}" if lacking[1:] else ""
            raise BadInputError(
                f"device.motors.constants.{lacking[0]} is missing: no table names this signal of a message that is "
                f"sent, its DBC has no start value, and 0 is none of its values ({lacking[0].limits()}); give the "
                f"value that it shall have in every frame{others}"
            )

    def frame(self, values: Sequence[float]) -> Frame:
        """Return a frame with these values; each is limited to the range of its signal."""
        raws = self._raws
        for signal, index, gain, bias in self._moving:
            raw = clamp(values[index] * gain + bias, signal.high, signal.low)
            raws[signal.name] = raw if signal.is_float else round(raw)
        for signal, frames in self._counters:
            low = int(signal.low)
            raws[signal.name] = low + next(frames) % (int(signal.high) - low + 1)
        return Frame(self._message.id, self._message.codec.encode(raws, scaling=False, strict=False))


class DbcDriver(Driver):
    """See ``hil.robot.driver.Driver``. Raises BadInputError if the mapping does not fit the robot."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        plan = self._plan = settings.plan
        self._robot = robot
        gain = self._gain = gains(settings, robot.wheel_radius_m, robot.torque_constant_n_m_a)
        check_robot(plan, robot, gain)
        self._counters = [(signal, count()) for signal in plan.counters]
        bounds = [bound for quantity in plan.commands.values() for bound in quantity.bounds]
        self._moving = [
            (one.signal, index, 1.0 / (gain(one) * one.signal.factor), -one.signal.offset / one.signal.factor)
            for index, one in enumerate(bounds)
        ]
        self._still = [0.0] * len(bounds)
        self._watchdog_raw = watchdog_raw(plan, robot, gain)
        commanded = {bound.signal.message for bound in bounds}
        self._commands = {name: self._packer(name, {}) for name in plan.sent if name in commanded}
        self._phases = {phase: [self._packers(phase, step) for step in plan.phases[phase]] for phase in PHASES}
        bound = plan.watchdog.set
        self._watchdog = None if bound is None else self._packers("watchdog", {bound.signal.message: {}})
        self._capabilities = Capabilities(
            modes=frozenset({CommandMode.TORQUE if plan.motion == "torque" else CommandMode.SPEED}),
            is_twist=plan.motion == "twist",
            feedback_hz=plan.feedback_hz,
            sensors=frozenset(sensor for sensor in get_args(Sensor) if _MEASURES.get(sensor, sensor) in plan.feedback),
            adds_torque="feedforward" in plan.commands,
            watchdog="set" if plan.watchdog.set else "fixed" if plan.watchdog.timeout_s else "none",
            latches_estop=settings.estop_latches,
        )
        self._warnings = warnings(plan, robot)
        self.restart()

    def restart(self) -> None:
        self._restart_arming()
        self._received = Received(self._plan, self._gain)

    def _restart_arming(self) -> None:
        self._step = 0
        self._stepped_ns = 0
        self._watchdog_ns: int | None = None  # when the watchdog's time was first sent
        self._is_armed = False
        self._ended_by: list[str] = []  # errors that ended closed loop, kept although they may have ended

    # Frames to send

    def _packers(self, phase: str, step: Step) -> Mapping[str, _Packer]:
        """Return the packers of a step by message. All phases but ``enable`` also send the fields of ``disable``."""
        disabled = {} if phase == "enable" else (self._plan.phases["disable"] or ({},))[-1]
        return {name: self._packer(name, {**disabled.get(name, {}), **fields}) for name, fields in step.items()}

    def _packer(self, message: str, fields: Mapping[str, float]) -> _Packer:
        """Return the packer of a message with its constants and the watchdog's time; ``fields`` replace constants."""
        fixed = {**self._plan.constants.get(message, {}), **fields}
        watchdog = self._plan.watchdog.set
        if watchdog is not None and watchdog.signal.message == message:
            fixed[watchdog.signal.name] = self._watchdog_raw
        moving = [one for one in self._moving if one[0].message == message]
        counters = [one for one in self._counters if one[0].message == message]
        return _Packer(self._plan.dbc.message(message), fixed, moving, counters)

    def _frames(self, steps: Sequence[Mapping[str, _Packer]]) -> list[Frame]:
        return [packer.frame(self._still) for packer in chain.from_iterable(step.values() for step in steps)]

    def _standstill(self, steps: Sequence[Mapping[str, _Packer]] = ()) -> list[Frame]:
        """Return the commands of standstill, where the first step replaces those of its messages; then the rest."""
        first, *rest = steps or ({},)
        return self._frames([{**self._commands, **first}, *rest])

    # A session

    def ask(self) -> Sequence[Frame]:
        return self._frames(self._phases["ask"]) if self.missing else ()

    @property
    def identity(self) -> str | None:
        if self._received.missing():
            return None
        values = self._received.identity()
        return f"controllers of {self._plan.dbc.name}" + (values and f" with {values}")

    @property
    def missing(self) -> str:
        names = self._received.missing()
        return names and (
            f"nothing received of {names}; check power, wiring and bit rate, and the identifiers in "
            f"{self._plan.dbc.name}"
        )

    def arm(self, now_ns: int) -> Sequence[Frame]:
        if self._watchdog and not self._watchdog_is_set():
            self._step, self._is_armed = 0, False
            if self._watchdog_ns is None:
                self._watchdog_ns = now_ns
            return self._frames([self._watchdog])
        steps = self._phases["enable"]
        if self._step < len(steps):
            self._step += 1
            self._stepped_ns = now_ns
            return self._standstill(steps[self._step - 1 : self._step])
        self._is_armed = not self.missing and self._received.follows()
        if not self._is_armed and now_ns - self._stepped_ns >= _AGAIN_NS:
            self._step = 0
        return self._standstill()

    def _watchdog_is_set(self) -> bool:
        written, read = self._plan.watchdog.set, self._plan.watchdog.read
        if self._watchdog_ns is None or written is None or read is None:
            return False
        expected_s = self._gain(written) * written.signal.physical(self._watchdog_raw)
        half_a_step_s = abs(self._gain(read) * read.signal.factor) / 2
        return abs(self._received.watchdog_s(self._watchdog_ns) - expected_s) <= half_a_step_s + 1e-9

    @property
    def is_armed(self) -> bool:
        return self._is_armed and self._received.follows()

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        values: Sequence[float] = torque_n_m
        if self._plan.motion == "twist":
            values = body_twist(speed_rad_s, self._robot.wheel_radius_m, self._robot.lever_m)
        elif self._plan.motion == "speed":
            values = speed_rad_s + torque_n_m
        return [packer.frame(values) for packer in self._commands.values()]

    def disarm(self) -> Sequence[Frame]:
        self._restart_arming()
        return self._standstill(self._phases["disable"])

    def estop(self) -> Sequence[Frame]:
        steps = self._phases["estop"]
        if not steps:
            return self.disarm()
        self._restart_arming()
        return self._frames(steps)

    def clear(self) -> Sequence[Frame]:
        return self._frames(self._phases["clear"])

    # Received frames

    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        why = self._received.feed(frame, stamp_ns)
        # Checked here, as the next frame may already report that all is well.
        if self._is_armed and not self._received.is_healthy:
            self._ended_by = self._received.errors()
            self._is_armed = False
        return why

    @property
    def sample(self) -> Sample | None:
        stamp_ns = self._received.stamp_ns()
        if stamp_ns is None:
            return None
        quantity = self._received.quantity
        speeds = four(quantity("speed") or NO_CHANNELS)
        if self._plan.measures_twist:
            forward, left, yaw_rate = quantity("twist") or ()
            speeds = wheel_speeds((forward, left, yaw_rate), self._robot.wheel_radius_m, self._robot.lever_m)
        x, y, z = quantity("acceleration") or (NAN, NAN, NAN)
        [battery_v], [battery_a], [yaw_rate_rad_s] = (
            quantity(name) or (NAN,) for name in ("battery_voltage", "battery_current", "yaw_rate")
        )
        position_rad, current_a, temperature_degc = (
            four(quantity(name) or NO_CHANNELS) for name in ("position", "current", "temperature")
        )
        wheels = speeds, position_rad, current_a, temperature_degc
        return Sample(stamp_ns, *wheels, battery_v, battery_a, (x, y, z), yaw_rate_rad_s)

    @property
    def errors(self) -> Sequence[str]:
        errors = self._received.errors()
        ended_by = [error for error in self._ended_by if error not in errors]
        return errors + ended_by + self._received.silent()


DIALECT = Dialect(
    title="a device of your own, by its DBC and a mapping",
    wires=frozenset({"can"}),
    settings=Settings,
    make=DbcDriver,
    emulated="hil.addons.motors.dbc.emulated_dbc:EmulatedDbc",
)
