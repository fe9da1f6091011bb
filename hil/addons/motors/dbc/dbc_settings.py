"""The settings of the driver ``dbc``: the meaning of the signals in the user's DBC, checked against the robot."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

from hil.addons.motors.dbc import dbc_mapping as mapping
from hil.addons.motors.dbc.dbc_file import Message, Signal, load
from hil.addons.motors.dbc.dbc_mapping import SI, Bound, Fields, Place, Table
from hil.addons.motors.driver_parts import late_ns, torques_dropped
from hil.core.errors import BadInputError
from hil.core.options import POSITIVE
from hil.core.types import WHEEL_NAMES
from hil.robot.driver import RobotFacts

_KEY = "device.motors"
_WHOLE = 1e-9

Gain = Callable[[Bound], float]
"""Returns the size of one unit of a signal in the SI unit of its dimension, with its sign."""
PHASES = ("ask", "enable", "disable", "estop", "clear")
_UNKNOWN_LATE_NS = 250_000_000
"""Age at which the values of a message are too old if its cycle time is not known."""


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. A signal is written ``"MESSAGE.Signal"``, with a minus before it to invert its sign.

    ``gear_ratio``: motor turns per turn of the wheel. ``estop_latches``: commands do not end an ``estop``. ``plan``:
    the mapping, built here. Raises ValueError if the DBC lacks something, or if tables contradict each other.
    """

    file: str
    command: Fields
    feedback: Table
    gear_ratio: Annotated[float, POSITIVE] = 1.0
    constants: Fields = field(default_factory=dict)
    counters: tuple[str, ...] = ()
    ask: Fields = field(default_factory=dict)
    enable: Fields = field(default_factory=dict)
    armed_when: Fields = field(default_factory=dict)
    disable: Fields = field(default_factory=dict)
    estop: Fields = field(default_factory=dict)
    estop_latches: bool = False
    clear: Fields = field(default_factory=dict)
    identity: Fields = field(default_factory=dict)
    errors: Table = field(default_factory=dict)
    watchdog: Table = field(default_factory=dict)
    plan: "Plan" = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "plan", Plan(self))


class Plan:
    """A mapping with its signals as found in the DBC. Raises ValueError as ``Settings`` does.

    Attributes:
        commands, feedback: the quantities by name.
        motion: the commanded quantity, ``speed``, ``torque`` or ``twist``.
        measures_twist: whether odometry uses a measured twist, not wheel speeds.
        measured: the signals of this twist, or of the speeds.
        feedback_hz: rate of the slowest message that carries one of these signals.
        phases: the steps of each of PHASES; a phase may have none.
        sent, received: the messages that the host sends, and those that the device sends, by name.
    """

    def __init__(self, settings: Settings) -> None:
        dbc = self.dbc = load(settings.file)
        self.commands = mapping.quantities(dbc, settings.command, "command", mapping.COMMANDS)
        measured = {name: one for name, one in settings.feedback.items() if name != "rate_hz"}
        self.feedback = mapping.quantities(dbc, measured, "feedback", mapping.FEEDBACK)
        self.motion, self.measures_twist = _motion(self.commands), _measures_twist(self.feedback)
        self.measured = [bound.signal for bound in self.feedback["twist" if self.measures_twist else "speed"].bounds]
        self.constants = mapping.constants(dbc, settings.constants, "constants")
        self.counters = mapping.counters(dbc, settings.counters, "counters")
        self.phases = {phase: mapping.steps(dbc, getattr(settings, phase), phase) for phase in PHASES}
        self.armed_when = mapping.conditions(dbc, settings.armed_when, "armed_when")
        self.identity = mapping.conditions(dbc, settings.identity, "identity")
        self.errors = mapping.errors(dbc, settings.errors, "errors")
        self.watchdog = mapping.watchdog(dbc, settings.watchdog, "watchdog")

        written = [self.watchdog.set.signal] if self.watchdog.set else []
        commanded = [bound.signal for quantity in self.commands.values() for bound in quantity.bounds]
        steps = [step for phase in self.phases.values() for step in phase]
        self.sent = dbc.messages(signal.message for signal in commanded + written)
        self.sent |= dbc.messages(name for step in steps for name in step)
        signals = [bound.signal for quantity in self.feedback.values() for bound in quantity.bounds]
        signals += [condition.signal for condition in self.armed_when + self.identity + self.errors]
        signals += [self.watchdog.read.signal] if self.watchdog.read else []
        self.received = dbc.messages(signal.message for signal in signals)
        self._check_messages()
        self._check_roles({"command": commanded, "counters": self.counters, "watchdog.set": written})
        if settings.estop_latches and not self.phases["estop"]:
            raise ValueError("estop_latches = true: nothing is sent for an e-stop; give [device.motors.estop] too")
        self.feedback_hz = self._feedback_hz(settings.feedback)
        quantities = (*self.commands.values(), *self.feedback.values())
        places = {bound.unit.place for quantity in quantities for bound in quantity.bounds}
        if settings.gear_ratio != 1.0 and not places & {"shaft", "shaft torque"}:
            raise ValueError(
                f"gear_ratio = {settings.gear_ratio:g}: it would change nothing, as no signal has a unit of the "
                "motor's shaft, and a scale is of the wheel; leave it out, or give unit"
            )

    def late_ns(self, message: Message) -> int | None:
        """Return the age at which the values of a message are too old; None for speeds, used with their stamp."""
        if message.name in (signal.message for signal in self.measured):
            return None
        return _UNKNOWN_LATE_NS if message.period_s is None else late_ns(message.period_s)

    def _check_messages(self) -> None:
        """Raise ValueError if a message is used in two ways, or is named in a table but used nowhere."""
        if both := [name for name in self.sent if name in self.received]:
            raise ValueError(
                f"the message {both[0]} is sent by one table and received by another; it is one or the other"
            )
        names: dict[int, str] = {}
        for message in (*self.sent.values(), *self.received.values()):
            if (other := names.setdefault(message.id, message.name)) != message.name:
                raise ValueError(
                    f"{other} and {message.name} of {self.dbc.name} have the same identifier; use one of them"
                )
        used = {f"counters: {str(signal)!r}": signal.message for signal in self.counters}
        for what, name in (used | {f"constants.{name}": name for name in self.constants}).items():
            if name not in self.sent:
                raise ValueError(f"{what}: {name} is never sent; name it in command, enable or disable too")

    def _check_roles(self, roles: Mapping[str, Sequence[Signal]]) -> None:
        """Raise ValueError if a signal has two roles, or a role and a value in ``constants`` or a phase."""
        role_of: dict[str, str] = {}

        def check(signal: str, role: str) -> None:
            if signal in role_of:
                raise ValueError(f"{role}: {signal} is already used in {role_of[signal]}; give each signal one use")

        for role, signals in roles.items():
            for signal in map(str, signals):
                check(signal, role)
                role_of[signal] = role
        for role, steps in {"constants": (self.constants,), **self.phases}.items():
            for name, field_name in [(name, one) for step in steps for name, fields in step.items() for one in fields]:
                check(f"{name}.{field_name}", role)

    def _feedback_hz(self, given: Table) -> float:
        if "rate_hz" in given:
            return mapping.positive(given["rate_hz"], "feedback.rate_hz")
        periods = {signal.message: self.received[signal.message].period_s for signal in self.measured}
        if unknown := [name for name, period_s in periods.items() if period_s is None]:
            raise ValueError(
                f"feedback.rate_hz is missing: {self.dbc.name} has no cycle time (GenMsgCycleTime) for "
                f"{', '.join(unknown)}; give the number of speed messages per second"
            )
        return 1.0 / max(period_s or 0.0 for period_s in periods.values())


def _motion(commands: Collection[str]) -> str:
    """Return the commanded quantity. Raises ValueError unless there is exactly one."""
    motions = [name for name in commands if name != "feedforward"]
    if len(motions) != 1:
        found = " and ".join(motions) or "none"
        raise ValueError(
            f"command has {found}: expected one of speed, torque and twist; each is a robot file of its own"
        )
    if "feedforward" in commands and motions != ["speed"]:
        raise ValueError(f"command.feedforward: torques are added to speeds, and the command is {motions[0]}")
    return motions[0]


def _measures_twist(feedback: Collection[str]) -> bool:
    if ("speed" in feedback) == ("twist" in feedback):
        found = "speed and twist" if "speed" in feedback else "neither"
        raise ValueError(f"feedback has {found}: expected speed or twist, as odometry rests on one of them")
    return "twist" in feedback


def gains(settings: Settings, wheel_radius_m: float, torque_constant_n_m_a: float) -> Gain:
    """Return the gains of a mapping on a robot; the torque constant is that at the wheel."""
    at_wheel: Mapping[Place, tuple[float, float]] = {
        "wheel": (1.0, 1.0),
        "shaft": (1.0, settings.gear_ratio),
        "shaft torque": (settings.gear_ratio, 1.0),
        "ground": (1.0, wheel_radius_m),
        "phase": (torque_constant_n_m_a, 1.0),
    }

    def gain(bound: Bound) -> float:
        multiplier, divisor = at_wheel[bound.unit.place]
        return bound.sign * bound.unit.factor * multiplier / divisor

    return gain


def check_robot(plan: Plan, robot: RobotFacts, gain: Gain) -> None:
    """Raise BadInputError if a robot does not fit.

    It does not if [device] gives an order or direction of the wheels, which the mapping already gives, or if a
    commanded signal cannot carry a limit of the robot, or has no raw number for zero.
    """
    names = [WHEEL_NAMES[wheel] for wheel in robot.wheel_of_channel]
    if names != list(WHEEL_NAMES):
        raise BadInputError(
            f"device.wheels = {names}: {_KEY} names the signals of each wheel itself; remove device.wheels, and "
            "give each wheel its signals there"
        )
    if (plan.motion == "twist" or plan.measures_twist) and -1 in robot.sign_of_channel:
        raise BadInputError(
            "device.reversed is not empty: controllers that take or report a body twist know the direction of their "
            "wheels; remove it"
        )

    ground_m_s = robot.speed_limit_rad_s * robot.wheel_radius_m
    limits = {
        "speed": ("robot.speed_limit_rad_s", robot.speed_limit_rad_s),
        "torque": ("firmware.torque_limit_n_m", robot.torque_limit_n_m),
        "velocity": ("robot.speed_limit_rad_s", ground_m_s),
        "yaw rate": ("robot.speed_limit_rad_s", ground_m_s / robot.lever_m),
    }
    for bound in (bound for quantity in plan.commands.values() for bound in quantity.bounds):
        name, limit = limits[bound.dimension]
        signal = bound.signal
        zero = -signal.offset / signal.factor
        if not signal.is_float and abs(zero - round(zero)) > _WHOLE * max(1.0, abs(zero)):
            raise BadInputError(
                f"{_KEY}.command: {signal} goes in steps of {signal.factor:g} from an offset of {signal.offset:g}, and "
                f"so has no zero: the nearest is {signal.physical(round(zero)):.4g}, by which a robot at rest would "
                "creep; take a signal that has one, or correct factor and offset in the DBC"
            )
        low, high = sorted(gain(bound) * signal.physical(raw) for raw in (signal.low, signal.high))
        if -limit < low or limit > high:
            raise BadInputError(
                f"{_KEY}.command: {signal} goes from {low:.4g} to {high:.4g} {SI[bound.dimension]}, and {name} "
                f"asks for {limit:.4g} both ways; lower that, or correct unit, scale or gear_ratio"
            )


def watchdog_raw(plan: Plan, robot: RobotFacts, gain: Gain) -> float:
    """Return the raw value that sets the watchdog to the robot's time; 0 if no signal sets it.

    Raises BadInputError if the signal cannot carry it.
    """
    bound = plan.watchdog.set
    if bound is None:
        return 0.0
    signal = bound.signal
    exact = (robot.watchdog_s / gain(bound) - signal.offset) / signal.factor
    raw = exact if signal.is_float else round(exact)
    if not signal.low <= raw <= signal.high:
        raise BadInputError(
            f"{_KEY}.watchdog: {signal} takes {signal.limits()}, and firmware.watchdog_s = {robot.watchdog_s:g} is "
            "outside; change that, or correct unit or scale"
        )
    return raw


def warnings(plan: Plan, robot: RobotFacts) -> tuple[str, ...]:
    """Return the sentences that the user must know before anything moves."""
    found = []
    timeout_s = plan.watchdog.timeout_s
    if timeout_s is None and plan.watchdog.set is None:
        found.append(
            f"{_KEY}.watchdog is empty: nothing that is known stops the wheels when commands end; keep an e-stop that "
            "cuts the motors' power within reach"
        )
    elif timeout_s is not None and timeout_s > robot.watchdog_s:
        found.append(
            f"when commands end the wheels go on for {timeout_s:g} s ({_KEY}.watchdog.timeout_s), longer than the "
            f"{robot.watchdog_s:g} s of firmware.watchdog_s"
        )
    if not plan.armed_when:
        found.append(f"{_KEY}.armed_when is empty: whether the controllers follow commands is not known")
    if plan.motion == "twist":
        found.append(torques_dropped(f"a base of {plan.dbc.name}"))
    elif plan.motion == "speed" and "feedforward" not in plan.commands:
        found.append(torques_dropped(f"{_KEY}.command without feedforward"))
    return tuple(found)
