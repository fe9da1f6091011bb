"""``[device.motors]`` of the driver ``dbc``: which signal of the user's DBC means what. See DBC.md."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from hil.core.errors import nearest
from hil.core.options import POSITIVE
from hil.drivers.dbc import mapping
from hil.drivers.dbc.file import Dbc, Message, Signal, load
from hil.drivers.dbc.mapping import Condition, ErrorSignal, Quantity, Step, Table, Watchdog
from hil.drivers.port import late_ns

PHASES = ("ask", "enable", "disable", "estop", "clear")
_UNKNOWN_LATE_NS = 250_000_000
"""Age at which the values of a message are too old if its cycle time is not known."""


class Plan(NamedTuple):
    """A mapping with its signals as found in the DBC. ``phases`` has all of PHASES, some of them without steps.

    ``feedback_hz``: rate of the slowest message that carries a speed. ``cycle_time_s``: periods that the user gives, by
    message; 0 for messages that are sent only on a change.
    """

    dbc: Dbc
    commands: Mapping[str, Quantity]
    feedback: Mapping[str, Quantity]
    feedback_hz: float
    cycle_time_s: Mapping[str, float]
    constants: Mapping[str, Mapping[str, float]]
    counters: tuple[Signal, ...]
    phases: Mapping[str, tuple[Step, ...]]
    armed_when: tuple[Condition, ...]
    identity: tuple[Condition, ...]
    errors: tuple[ErrorSignal, ...]
    watchdog: Watchdog

    @property
    def motion(self) -> str:
        """The commanded quantity: ``speed``, ``torque`` or ``twist``."""
        return next(iter(self.commands))

    @property
    def measured(self) -> str:
        """The measured quantity that odometry uses: ``speed`` or ``twist``."""
        return next(iter(self.feedback))

    def commanded(self) -> Iterator[Signal]:
        """Yield the signals of the command."""
        return (bound.signal for quantity in self.commands.values() for bound in quantity.bounds)

    def sent(self) -> dict[str, Message]:
        """Return the messages that the host sends."""
        names = dict.fromkeys(name for steps in self.phases.values() for step in steps for name in step)
        signals = [*self.commanded(), *([self.watchdog.set.signal] if self.watchdog.set else [])]
        return mapping.by_message(self.dbc, signals) | {name: self.dbc.message(name) for name in names}

    def late_ns(self, message: Message) -> int | None:
        """Return the age at which the values of a message are too old; None if they are valid until the next ones.

        Also None for the speeds, which are used together with their stamp.
        """
        if message.name in (bound.signal.message for bound in self.feedback[self.measured].bounds):
            return None
        period_s = self.cycle_time_s.get(message.name, message.period_s)
        if period_s is None:
            return _UNKNOWN_LATE_NS
        return late_ns(period_s) if period_s else None

    def received(self) -> dict[str, Message]:
        """Return the messages that the device sends."""
        signals = [bound.signal for quantity in self.feedback.values() for bound in quantity.bounds]
        signals += [condition.signal for condition in (*self.armed_when, *self.identity)]
        signals += [error.signal for error in self.errors]
        signals += [self.watchdog.read.signal] if self.watchdog.read else []
        return mapping.by_message(self.dbc, signals)


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. A signal is written ``"MESSAGE.Signal"``, with a minus before it to invert its sign.

    ``gear_ratio``: motor turns per turn of the wheel. ``estop_latches``: commands do not end an ``estop``. ``plan`` is
    the mapping, which ``__post_init__`` builds. Raises ValueError if the DBC lacks something or tables contradict.
    """

    file: str
    command: Table
    feedback: Table
    gear_ratio: Annotated[float, POSITIVE] = 1.0
    constants: Table = field(default_factory=dict)
    counters: tuple[str, ...] = ()
    ask: Table = field(default_factory=dict)
    enable: Table = field(default_factory=dict)
    armed_when: Table = field(default_factory=dict)
    disable: Table = field(default_factory=dict)
    estop: Table = field(default_factory=dict)
    estop_latches: bool = False
    clear: Table = field(default_factory=dict)
    identity: Table = field(default_factory=dict)
    errors: Table = field(default_factory=dict)
    watchdog: Table = field(default_factory=dict)
    cycle_time_s: Table = field(default_factory=dict)
    plan: Plan = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        dbc = load(self.file)
        plan = Plan(
            dbc,
            mapping.quantities(dbc, self.command, "command", mapping.COMMANDS),
            mapping.quantities(dbc, _without(self.feedback, "rate_hz"), "feedback", mapping.FEEDBACK),
            0.0,
            mapping.cycle_times(self.cycle_time_s, "cycle_time_s"),
            mapping.constants(dbc, self.constants, "constants"),
            mapping.counters(dbc, self.counters, "counters"),
            {phase: mapping.steps(dbc, getattr(self, phase), phase) for phase in PHASES},
            mapping.conditions(dbc, self.armed_when, "armed_when"),
            mapping.conditions(dbc, self.identity, "identity"),
            mapping.errors(dbc, self.errors, "errors"),
            mapping.watchdog(dbc, self.watchdog, "watchdog"),
        )
        _check_choices(plan)
        _check_roles(plan)
        _check_cycle_times(plan)
        if self.estop_latches and not self.estop:
            raise ValueError("estop_latches = true: nothing is sent for an e-stop; give [device.motors.estop] too")
        plan = plan._replace(feedback_hz=_feedback_hz(plan, self.feedback))
        object.__setattr__(self, "plan", plan)


def _without(value: object, name: str) -> object:
    return {key: one for key, one in value.items() if key != name} if isinstance(value, Mapping) else value


def _check_choices(plan: Plan) -> None:
    motions = [name for name in plan.commands if name != "feedforward"]
    if len(motions) != 1:
        found = " and ".join(motions) or "none"
        raise ValueError(
            f"command has {found}: expected one of speed, torque and twist; each is a robot file of its own"
        )
    if "feedforward" in plan.commands and motions != ["speed"]:
        raise ValueError(f"command.feedforward: torques are added to speeds, and the command is {motions[0]}")
    measured = [name for name in ("speed", "twist") if name in plan.feedback]
    if len(measured) != 1:
        found = " and ".join(measured) or "neither"
        raise ValueError(f"feedback has {found}: expected speed or twist, as odometry rests on one of them")


def _check_roles(plan: Plan) -> None:
    """Raise ValueError if a message is both sent and received, or if a signal has two roles."""
    sent, received = plan.sent(), plan.received()
    if both := [name for name in sent if name in received]:
        raise ValueError(f"the message {both[0]} is sent by one table and awaited by another; it is one or the other")
    identifiers: dict[int, str] = {}
    for message in (*sent.values(), *received.values()):
        if (other := identifiers.setdefault(message.id, message.name)) != message.name:
            raise ValueError(f"{other} and {message.name} of {plan.dbc.name} have the same identifier; use one of them")
    roles: dict[str, str] = {}
    for signal in plan.commanded():
        if str(signal) in roles:
            raise ValueError(f"command: {signal} is named twice; each has a signal of its own")
        roles[str(signal)] = "command"
    for signal in plan.counters:
        _take_role(roles, str(signal), "counters")
        _check_sent(sent, signal.message, f"counters: {str(signal)!r}")
    if plan.watchdog.set is not None:
        _take_role(roles, str(plan.watchdog.set.signal), "watchdog.set")
    for name, fields in plan.constants.items():
        _check_sent(sent, name, f"constants.{name}")
        for one in fields:
            _check_role(roles, f"{name}.{one}", "constants")
    for phase, steps in plan.phases.items():
        for step in steps:
            for name, fields in step.items():
                for one in fields:
                    _check_role(roles, f"{name}.{one}", phase)


def _take_role(roles: dict[str, str], signal: str, role: str) -> None:
    _check_role(roles, signal, role)
    roles[signal] = role


def _check_role(roles: Mapping[str, str], signal: str, role: str) -> None:
    if signal in roles:
        raise ValueError(f"{role}: {signal} is already {roles[signal]}; a signal is one of them")


def _check_sent(sent: Mapping[str, Message], message: str, what: str) -> None:
    if message not in sent:
        raise ValueError(
            f"{what}: no table sends {message}; it goes out once command, enable, disable or another names it"
        )


def _check_cycle_times(plan: Plan) -> None:
    """Raise ValueError for the cycle time of a message that is not received, or whose rate is given elsewhere."""
    received = plan.received()
    speeds = {bound.signal.message for bound in plan.feedback[plan.measured].bounds}
    for name in plan.cycle_time_s:
        if name not in received:
            raise ValueError(f"cycle_time_s.{name}: no table awaits such a message{nearest(name, received)}")
        if name in speeds:
            raise ValueError(f"cycle_time_s.{name}: it carries the {plan.measured}; say feedback.rate_hz")


def _feedback_hz(plan: Plan, feedback: Table) -> float:
    if "rate_hz" in feedback:
        return mapping.positive(feedback["rate_hz"], "feedback.rate_hz")
    signals = [bound.signal for bound in plan.feedback[plan.measured].bounds]
    periods = {name: message.period_s for name, message in mapping.by_message(plan.dbc, signals).items()}
    silent = [name for name, period_s in periods.items() if period_s is None]
    if silent:
        raise ValueError(
            f"feedback.rate_hz is missing: {plan.dbc.name} has no cycle time (GenMsgCycleTime) for "
            f"{', '.join(silent)}; say how often in a second the speeds come"
        )
    return 1.0 / max(period_s for period_s in periods.values() if period_s is not None)
