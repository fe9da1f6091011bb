"""``[device.motors]`` of the driver ``dbc``: which signal of the user's DBC means what. See DBC.md."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

from hil.core.errors import nearest
from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.drivers.dbc import mapping
from hil.drivers.dbc.file import Dbc, Message, Signal, load
from hil.drivers.dbc.mapping import Condition, ErrorSignal, Fields, Quantity, Step, Table, Watchdog
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
        return self.dbc.messages(signals) | {name: self.dbc.message(name) for name in names}

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
        signals += [condition.signal for condition in self.armed_when + self.identity]
        signals += [error.signal for error in self.errors]
        signals += [self.watchdog.read.signal] if self.watchdog.read else []
        return self.dbc.messages(signals)


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. A signal is written ``"MESSAGE.Signal"``, with a minus before it to invert its sign.

    ``gear_ratio``: motor turns per turn of the wheel. ``estop_latches``: commands do not end an ``estop``. ``plan`` is
    the mapping, which ``__post_init__`` builds. Raises ValueError if the DBC lacks something or tables contradict.
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
    cycle_time_s: Mapping[str, Annotated[float, NOT_NEGATIVE]] = field(default_factory=dict)
    plan: Plan = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        dbc = load(self.file)
        commands = mapping.quantities(dbc, self.command, "command", mapping.COMMANDS)
        measured = {name: one for name, one in self.feedback.items() if name != "rate_hz"}
        feedback = mapping.quantities(dbc, measured, "feedback", mapping.FEEDBACK)
        _check_choices(commands, feedback)
        plan = Plan(
            dbc,
            commands,
            feedback,
            0.0,
            self.cycle_time_s,
            mapping.constants(dbc, self.constants, "constants"),
            mapping.counters(dbc, self.counters, "counters"),
            {phase: mapping.steps(dbc, getattr(self, phase), phase) for phase in PHASES},
            mapping.conditions(dbc, self.armed_when, "armed_when"),
            mapping.conditions(dbc, self.identity, "identity"),
            mapping.errors(dbc, self.errors, "errors"),
            mapping.watchdog(dbc, self.watchdog, "watchdog"),
        )
        _check_roles(plan)
        if self.estop_latches and not self.estop:
            raise ValueError("estop_latches = true: nothing is sent for an e-stop; give [device.motors.estop] too")
        object.__setattr__(self, "plan", plan._replace(feedback_hz=_feedback_hz(dbc, feedback, self.feedback)))


def _check_choices(commands: Mapping[str, Quantity], feedback: Mapping[str, Quantity]) -> None:
    motions = [name for name in commands if name != "feedforward"]
    if len(motions) != 1:
        found = " and ".join(motions) or "none"
        raise ValueError(
            f"command has {found}: expected one of speed, torque and twist; each is a robot file of its own"
        )
    if "feedforward" in commands and motions != ["speed"]:
        raise ValueError(f"command.feedforward: torques are added to speeds, and the command is {motions[0]}")
    measured = [name for name in ("speed", "twist") if name in feedback]
    if len(measured) != 1:
        found = " and ".join(measured) or "neither"
        raise ValueError(f"feedback has {found}: expected speed or twist, as odometry rests on one of them")


def _feedback_hz(dbc: Dbc, feedback: Mapping[str, Quantity], given: Table) -> float:
    if "rate_hz" in given:
        return mapping.positive(given["rate_hz"], "feedback.rate_hz")
    messages = dbc.messages(bound.signal for bound in next(iter(feedback.values())).bounds).values()
    if unknown := [message.name for message in messages if message.period_s is None]:
        raise ValueError(
            f"feedback.rate_hz is missing: {dbc.name} has no cycle time (GenMsgCycleTime) for {', '.join(unknown)}; "
            "give the number of speed messages per second"
        )
    return 1.0 / max(message.period_s or 0.0 for message in messages)


def _check_roles(plan: Plan) -> None:
    """Raise ValueError if a message or a signal has two roles, or one that no other table gives it."""
    sent, received = plan.sent(), plan.received()
    if both := [name for name in sent if name in received]:
        raise ValueError(f"the message {both[0]} is sent by one table and received by another; it is one or the other")
    identifiers: dict[int, str] = {}
    for message in (*sent.values(), *received.values()):
        if (other := identifiers.setdefault(message.id, message.name)) != message.name:
            raise ValueError(f"{other} and {message.name} of {plan.dbc.name} have the same identifier; use one of them")
    watchdog = [plan.watchdog.set.signal] if plan.watchdog.set else []
    roles: dict[str, str] = {}
    for role, signals in (("command", plan.commanded()), ("counters", plan.counters), ("watchdog.set", watchdog)):
        for signal in signals:
            _check_free(roles, str(signal), role)
            roles[str(signal)] = role
    for role, step in [("constants", plan.constants)] + [
        (phase, one) for phase in PHASES for one in plan.phases[phase]
    ]:
        for name, fields in step.items():
            for one in fields:
                _check_free(roles, f"{name}.{one}", role)
    used = [(signal.message, f"counters: {str(signal)!r}") for signal in plan.counters]
    for name, what in (*used, *((name, f"constants.{name}") for name in plan.constants)):
        if name not in sent:
            raise ValueError(f"{what}: {name} is never sent; name it in command, enable or disable too")
    speeds = {bound.signal.message for bound in plan.feedback[plan.measured].bounds}
    for name in plan.cycle_time_s:
        if name not in received:
            raise ValueError(f"cycle_time_s.{name}: no table reads such a message{nearest(name, received)}")
        if name in speeds:
            raise ValueError(f"cycle_time_s.{name}: it carries the {plan.measured}; give feedback.rate_hz instead")


def _check_free(roles: Mapping[str, str], signal: str, role: str) -> None:
    if signal in roles:
        raise ValueError(f"{role}: {signal} is already used in {roles[signal]}; give each signal one use")
