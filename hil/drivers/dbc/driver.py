"""Drives motor controllers by their DBC and a mapping, both given in the scenario; it has no rules of any maker."""

from collections.abc import Mapping, Sequence
from itertools import chain

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.kinematics import body_twist, wheel_speeds
from hil.core.types import NAN, CommandMode, FourWheels
from hil.drivers.dbc.coding import Moving, Packer, RollingCounter
from hil.drivers.dbc.file import Message
from hil.drivers.dbc.mapping import Bound, Step
from hil.drivers.dbc.received import Received
from hil.drivers.dbc.robot import check_limits, check_wheels, gains, warnings, watchdog_raw
from hil.drivers.dbc.settings import PHASES, Settings
from hil.drivers.port import EXTENDED, NO_CHANNELS, Capabilities, Dialect, Driver, RobotFacts, Sample, Sensor, four

_NONE: Mapping[str, float] = {}
_NO_STEP: Mapping[str, Packer] = {}
_AGAIN_NS = 250_000_000
"""After this time the steps of arming are repeated: one of their frames may have been lost."""
_SENSORS: Mapping[str, Sensor] = {
    "position": "position",
    "current": "current",
    "temperature": "temperature",
    "battery_voltage": "battery_voltage",
    "battery_current": "battery_current",
    "yaw_rate": "gyro",
    "acceleration": "accelerometer",
}


class DbcDriver(Driver):
    """See ``hil.drivers.port.Driver``. Raises BadInputError if the mapping does not fit the robot."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        plan = self._plan = settings.plan
        self._robot = robot
        self._gain = gains(settings, robot.wheel_radius_m, robot.torque_constant_n_m_a)
        check_wheels(plan, robot)
        check_limits(plan, robot, self._gain)
        self._received = Received(plan, self._gain)
        self._is_twist = plan.motion == "twist"
        self._measures_twist = plan.measured == "twist"
        self._adds_torque = "feedforward" in plan.commands
        self._counters = [RollingCounter(signal) for signal in plan.counters]
        bounds = [bound for quantity in plan.commands.values() for bound in quantity.bounds]
        self._moving = [self._moving_signal(index, bound) for index, bound in enumerate(bounds)]
        self._still = [0.0] * len(bounds)
        self._watchdog_raw = watchdog_raw(plan, robot, self._gain)
        self._commands = {name: self._packer(name) for name in plan.sent() if self._moves(name)}
        self._phases = {phase: [self._packers(phase, step) for step in plan.phases[phase]] for phase in PHASES}
        bound = plan.watchdog.set
        self._watchdog = None if bound is None else self._packers("watchdog", {bound.signal.message: {}})
        self._restart_arming()
        self._capabilities = Capabilities(
            modes=frozenset({CommandMode.TORQUE if plan.motion == "torque" else CommandMode.SPEED}),
            is_twist=self._is_twist,
            feedback_hz=plan.feedback_hz,
            sensors=frozenset(sensor for name, sensor in _SENSORS.items() if name in plan.feedback),
            adds_torque=self._adds_torque,
            watchdog="set" if plan.watchdog.set else "fixed" if plan.watchdog.timeout_s else "none",
            latches_estop=settings.estop_latches,
        )
        self._warnings = tuple(warnings(plan, robot))

    # Preparation

    def _moving_signal(self, index: int, bound: Bound) -> Moving:
        signal = bound.signal
        return Moving(signal, index, 1.0 / (self._gain(bound) * signal.factor), -signal.offset / signal.factor)

    def _moves(self, message: str) -> bool:
        return any(one.signal.message == message for one in self._moving)

    def _packers(self, phase: str, step: Step) -> Mapping[str, Packer]:
        """Return the packers of a step by message. All phases but ``enable`` also send the fields of ``disable``."""
        disabled = {} if phase == "enable" else (self._plan.phases["disable"] or ({},))[-1]
        return {name: self._packer(name, {**disabled.get(name, {}), **fields}) for name, fields in step.items()}

    def _packer(self, message: str, fields: Mapping[str, float] = _NONE) -> Packer:
        """Return the packer of a message with its constants, the watchdog's time, and these fields, which go first."""
        fixed = {**self._plan.constants.get(message, {}), **fields}
        watchdog = self._plan.watchdog.set
        if watchdog is not None and watchdog.signal.message == message:
            fixed[watchdog.signal.name] = self._watchdog_raw
        moving = [one for one in self._moving if one.signal.message == message]
        counters = [one for one in self._counters if one.signal.message == message]
        return Packer(self._plan.dbc.message(message), fixed, moving, counters)

    def _restart_arming(self) -> None:
        self._step = 0
        self._stepped_ns = 0
        self._watchdog_ns: int | None = None  # when the watchdog's time was first sent
        self._is_armed = False
        self._ended_by: list[str] = []  # errors that ended closed loop, kept although they may have ended

    # A session

    def ask(self) -> Sequence[Frame]:
        return self._all_of("ask") if self.missing else ()

    @property
    def identity(self) -> str | None:
        if self._received.missing():
            return None
        name = self._plan.dbc.name
        values = []
        for condition, raw in self._received.identity():
            signal = condition.signal
            if raw not in condition.raws:
                known = ", ".join(sorted(signal.word(one) for one in condition.raws))
                raise BadInputError(
                    f"{signal} of the device is {signal.word(raw)}, and this mapping is for {known} "
                    f"(device.motors.identity); take the DBC of the device's firmware, or the firmware of the DBC"
                )
            values.append(f"{signal} {signal.word(raw)}")
        return f"controllers of {name}" + (f" with {', '.join(values)}" if values else "")

    @property
    def missing(self) -> str:
        missing = self._received.missing()
        if not missing:
            return ""
        names = ", ".join(map(_named, missing))
        return (
            f"nothing received of {names}; check power, wiring and bit rate, and the identifiers in "
            f"{self._plan.dbc.name}"
        )

    def arm(self, now_ns: int) -> Sequence[Frame]:
        if self._watchdog is not None and not self._watchdog_is_set():
            self._step, self._is_armed = 0, False
            if self._watchdog_ns is None:
                self._watchdog_ns = now_ns
            return self._frames([self._watchdog])
        steps = self._phases["enable"]
        if self._step < len(steps):
            frames = self._standstill(steps[self._step])
            self._step += 1
            self._stepped_ns = now_ns
            return frames
        self._is_armed = not self.missing and self._received.follows()
        if not self._is_armed and now_ns - self._stepped_ns >= _AGAIN_NS:
            self._step = 0
        return self._standstill()

    def _watchdog_is_set(self) -> bool:
        """Return whether the time was sent in this arming and, if a signal reports it, read back since."""
        if self._watchdog_ns is None:
            return False
        written, read = self._plan.watchdog.set, self._plan.watchdog.read
        if written is None or read is None:
            return True
        expected_s = self._gain(written) * written.signal.physical(self._watchdog_raw)
        half_a_step_s = abs(self._gain(read) * read.signal.factor) / 2
        return abs(self._received.watchdog_s(self._watchdog_ns) - expected_s) <= half_a_step_s + 1e-9

    @property
    def is_armed(self) -> bool:
        return self._is_armed and self._received.follows()

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        values: Sequence[float] = torque_n_m
        if self._is_twist:
            robot = self._robot
            values = body_twist(speed_rad_s, robot.wheel_radius_m, robot.lever_m)
        elif self._plan.motion == "speed":
            values = speed_rad_s + torque_n_m if self._adds_torque else speed_rad_s
        return [packer.frame(values) for packer in self._commands.values()]

    def disarm(self) -> Sequence[Frame]:
        self._restart_arming()
        steps = self._phases["disable"]
        if not steps:
            return self._standstill()
        return [*self._standstill(steps[0]), *self._frames(steps[1:])]

    def estop(self) -> Sequence[Frame]:
        steps = self._phases["estop"]
        if not steps:
            return self.disarm()
        self._restart_arming()
        return self._frames(steps)

    def clear(self) -> Sequence[Frame]:
        return self._all_of("clear")

    def _all_of(self, phase: str) -> Sequence[Frame]:
        return self._frames(self._phases[phase])

    def _frames(self, steps: Sequence[Mapping[str, Packer]]) -> list[Frame]:
        return [packer.frame(self._still) for packer in chain.from_iterable(step.values() for step in steps)]

    def _standstill(self, step: Mapping[str, Packer] = _NO_STEP) -> list[Frame]:
        """Return the commands of standstill, with the messages of a step in place of those of the same name."""
        return [packer.frame(self._still) for packer in {**self._commands, **step}.values()]

    # Received frames

    def feed(self, frame: Frame, stamp_ns: int) -> None:
        is_healthy = self._received.feed(frame.id, frame.payload, stamp_ns)
        if self._is_armed and not is_healthy:  # checked here, as the next frame may already report that all is well
            self._ended_by = self._reported()
            self._is_armed = False

    @property
    def sample(self) -> Sample | None:
        stamp_ns = self._received.stamp_ns()
        if stamp_ns is None:
            return None
        if self._measures_twist:
            forward, left, yaw_rate = self._received.quantity("twist") or ()
            speeds = wheel_speeds((forward, left, yaw_rate), self._robot.wheel_radius_m, self._robot.lever_m)
        else:
            speeds = self._four("speed")
        x, y, z = self._received.quantity("acceleration") or (NAN, NAN, NAN)
        return Sample(
            stamp_ns,
            speeds,
            self._four("position"),
            self._four("current"),
            self._four("temperature"),
            self._one("battery_voltage"),
            self._one("battery_current"),
            (x, y, z),
            self._one("yaw_rate"),
        )

    def _four(self, name: str) -> FourWheels:
        return four(self._received.quantity(name) or NO_CHANNELS)

    def _one(self, name: str) -> float:
        (value,) = self._received.quantity(name) or (NAN,)
        return value

    @property
    def errors(self) -> Sequence[str]:
        errors = self._reported()
        errors += [error for error in self._ended_by if error not in errors]
        silent = [
            f"nothing received of {_named(message)}, which reports errors or states, for more than {late_s:g} s (its "
            "period is device.motors.cycle_time_s)"
            for message, late_s in self._received.silent()
        ]
        return errors + silent

    def _reported(self) -> list[str]:
        return [
            f"{'the robot' if error.where == 'robot' else f'wheel {error.where}'}: {error.signal} is "
            f"{error.signal.word(raw)}"
            for error, raw in self._received.errors()
        ]

    def restart(self) -> None:
        self._restart_arming()
        self._received = Received(self._plan, self._gain)


def _named(message: Message) -> str:
    return f"{message.name} ({message.id & ~EXTENDED:#x})"


DIALECT = Dialect(
    title="a device of your own, by its DBC and a mapping",
    wires=frozenset({"can"}),
    settings=Settings,
    make=DbcDriver,
    emulated="hil.drivers.dbc.emulated:EmulatedDbc",
)
