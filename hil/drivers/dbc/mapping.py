"""Reads the tables of [device.motors] against the DBC, and refuses every name, unit or value that it does not have.

All functions raise ValueError with a sentence that begins with the key below [device.motors].
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from hil.core.errors import nearest
from hil.core.types import WHEEL_NAMES
from hil.drivers.dbc.file import Dbc, Message, Signal
from hil.drivers.dbc.units import Unit, unit

Table = Mapping[str, object]


class Bound(NamedTuple):
    """A signal that carries a quantity of a ``dimension`` of units.SI, in a ``unit``, with a ``sign``."""

    signal: Signal
    sign: int
    unit: Unit
    dimension: str


class Quantity(NamedTuple):
    """A quantity and its signals: one per wheel, per axis, or one. ``wraps_at``: of positions, in the signal's unit."""

    bounds: tuple[Bound, ...]
    wraps_at: float = 0.0


class Condition(NamedTuple):
    """A signal and the raw values that meet the condition."""

    signal: Signal
    raws: frozenset[float]


class ErrorSignal(NamedTuple):
    """A signal that reports an error of a wheel or of the robot (``where``); the raw values ``none`` are no error."""

    where: str
    signal: Signal
    none: frozenset[float]


class Watchdog(NamedTuple):
    """The watchdog: a fixed ``timeout_s`` that the user gives, or a time that is set by a signal and read from one."""

    timeout_s: float | None = None
    set: Bound | None = None
    read: Bound | None = None


Step = Mapping[str, Mapping[str, float]]
"""Raw values, by message and signal, that are sent together."""


def _each_wheel(dimension: str) -> Mapping[str, str]:
    return dict.fromkeys(WHEEL_NAMES, dimension)


_TWIST = {"forward": "velocity", "left": "velocity", "yaw_rate": "yaw rate"}
COMMANDS: Mapping[str, Mapping[str, str]] = {
    "speed": _each_wheel("speed"),
    "torque": _each_wheel("torque"),
    "twist": _TWIST,
    "feedforward": _each_wheel("torque"),
}
FEEDBACK: Mapping[str, Mapping[str, str]] = {
    "speed": _each_wheel("speed"),
    "twist": _TWIST,
    "position": _each_wheel("position"),
    "current": _each_wheel("current"),
    "temperature": _each_wheel("temperature"),
    "battery_voltage": {"signal": "voltage"},
    "battery_current": {"signal": "current"},
    "yaw_rate": {"signal": "yaw rate"},
    "acceleration": dict.fromkeys(("x", "y", "z"), "acceleration"),
}


def table(value: object, key: str, known: Iterable[str] | None = None) -> Table:
    """Return the value if it is a table. With ``known``, its names must be among these."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{key} = {value!r}: expected a table")
    names = None if known is None else list(known)
    for name in value:
        if names is not None and name not in names:
            raise ValueError(f"{key}.{name}: unknown{nearest(name, names)}")
    return value


def quantities(dbc: Dbc, value: object, key: str, known: Mapping[str, Mapping[str, str]]) -> dict[str, Quantity]:
    """Return the quantities of ``command`` or ``feedback``, in the order of ``known``."""
    given = table(value, key, known)
    return {
        name: _quantity(dbc, given[name], f"{key}.{name}", parts, wraps=name == "position")
        for name, parts in known.items()
        if name in given
    }


def _quantity(dbc: Dbc, value: object, key: str, parts: Mapping[str, str], *, wraps: bool) -> Quantity:
    if isinstance(value, str) and len(parts) == 1:
        value = dict.fromkeys(parts, value)
    given = table(value, key, (*parts, "unit", "scale", *(["wraps_at"] if wraps else [])))
    if missing := [name for name in parts if name not in given]:
        raise ValueError(f"{key}: {', '.join(missing)} missing; name a signal for each of {', '.join(parts)}")
    bounds = tuple(bound(dbc, given, name, key, dimension) for name, dimension in parts.items())
    _once((one.signal for one in bounds), key)
    wraps_at = positive(given["wraps_at"], f"{key}.wraps_at") if "wraps_at" in given else 0.0
    return Quantity(bounds, wraps_at)


def bound(dbc: Dbc, given: Table, name: str, key: str, dimension: str) -> Bound:
    """Return the signal with this name in a table, with the table's unit or scale, or else the DBC's unit."""
    spec = given[name]
    sign, bare = (-1, spec[1:]) if isinstance(spec, str) and spec.startswith("-") else (1, spec)
    try:
        signal = dbc.signal(bare)
        if "scale" in given:
            if "unit" in given:
                raise ValueError("give unit or scale, not both")
            return Bound(signal, sign, Unit(positive(given["scale"], f"{key}.scale")), dimension)
        text = given.get("unit", signal.unit)
        if not isinstance(text, str):
            raise ValueError(f"unit = {text!r}: expected text")
        return Bound(signal, sign, unit(dimension, text), dimension)
    except ValueError as error:
        raise ValueError(f"{key}.{name} = {spec!r}: {error}") from error


def values(dbc: Dbc, value: object, key: str) -> Iterator[tuple[str, Signal, list[float]]]:
    """Yield key, signal and raw values of each ``MESSAGE.Signal = value``, where a value may be an array."""
    for message, signals in table(value, key).items():
        for name, given in table(signals, f"{key}.{message}").items():
            where = f"{key}.{message}.{name}"
            try:
                signal = dbc.signal_of(message, name)
                many = given if isinstance(given, list | tuple) else [given]
                if not many:
                    raise ValueError("expected at least one value")
                yield where, signal, [signal.raw(one) for one in many]
            except ValueError as error:
                raise ValueError(f"{where} = {given!r}: {error}") from error


def constants(dbc: Dbc, value: object, key: str) -> dict[str, dict[str, float]]:
    """Return the raw values that are the same in every frame, by message and signal."""
    fixed: dict[str, dict[str, float]] = {}
    for where, signal, raws in values(dbc, value, key):
        if len(raws) > 1:
            raise ValueError(f"{where}: expected one value, as it is the same in every frame")
        fixed.setdefault(signal.message, {})[signal.name] = raws[0]
    return fixed


def steps(dbc: Dbc, value: object, key: str) -> tuple[Step, ...]:
    """Return the steps of a phase. Arrays have a value for each step, and all have the same length."""
    found = list(values(dbc, value, key))
    lengths = {len(raws): where for where, _, raws in found if len(raws) > 1}
    if len(lengths) > 1:
        (a, first), (b, second) = sorted(lengths.items())[:2]
        raise ValueError(f"{second}: {b} values, but {first} has {a}; each is one step, give as many to each")
    made: list[dict[str, dict[str, float]]] = [{} for _ in range(max((*lengths, 1)) if found else 0)]
    for _, signal, raws in found:
        for number, step in enumerate(made):
            step.setdefault(signal.message, {})[signal.name] = raws[number if len(raws) > 1 else 0]
    return tuple(made)


def conditions(dbc: Dbc, value: object, key: str) -> tuple[Condition, ...]:
    """Return the conditions; any value of an array meets one."""
    return tuple(Condition(signal, frozenset(raws)) for _, signal, raws in values(dbc, value, key))


def errors(dbc: Dbc, value: object, key: str) -> tuple[ErrorSignal, ...]:
    """Return the signals that report errors of each wheel and of the robot."""
    given = table(value, key, (*WHEEL_NAMES, "robot", "none"))
    none = given.get("none", 0)
    fine = none if isinstance(none, list | tuple) else [none]
    found = []
    for where, specs in given.items():
        for spec in () if where == "none" else specs if isinstance(specs, list | tuple) else [specs]:
            name = f"{key}.{where} = {spec!r}"
            try:
                signal = dbc.signal(spec)
                name = f"{key}.none = {none!r} for {signal}"
                found.append(ErrorSignal(where, signal, frozenset(signal.raw(one) for one in fine)))
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
    return tuple(found)


def counters(dbc: Dbc, value: object, key: str) -> tuple[Signal, ...]:
    """Return the rolling counters."""
    if not isinstance(value, list | tuple):
        raise ValueError(f'{key} = {value!r}: expected an array of signals, such as ["DRIVE_FL.Alive"]')
    found = []
    for spec in value:
        try:
            signal = dbc.signal(spec)
            if signal.is_float or signal.high <= signal.low:
                raise ValueError("a counter is a whole number that has more than one value")
        except ValueError as error:
            raise ValueError(f"{key}: {spec!r}: {error}") from error
        found.append(signal)
    _once(found, key)
    return tuple(found)


def watchdog(dbc: Dbc, value: object, key: str) -> Watchdog:
    """Return the watchdog that stops the wheels when commands end."""
    given = table(value, key, ("timeout_s", "set", "read", "unit", "scale"))
    if "timeout_s" in given:
        if len(given) > 1:
            raise ValueError(f"{key}: give timeout_s, where it is fixed, or set and read, where it is not")
        return Watchdog(timeout_s=positive(given["timeout_s"], f"{key}.timeout_s"))
    if not given:
        return Watchdog()
    if missing := [name for name in ("set", "read") if name not in given]:
        raise ValueError(
            f"{key}.{missing[0]} is missing: a watchdog is set and read back; give one that cannot be read back "
            "in [device.motors.enable], and its time as timeout_s"
        )
    found = [bound(dbc, given, name, key, "time") for name in ("set", "read")]
    return Watchdog(set=found[0], read=found[1])


def cycle_times(value: object, key: str) -> dict[str, float]:
    """Return the periods of messages [s]; 0 for those that are sent only on a change."""
    found = {}
    for message, given in table(value, key).items():
        if isinstance(given, bool) or not isinstance(given, int | float) or not 0.0 <= given < float("inf"):
            raise ValueError(f"{key}.{message} = {given!r}: expected seconds, or 0 for one sent on a change alone")
        found[message] = float(given)
    return found


def positive(value: object, key: str) -> float:
    """Return a number of more than zero."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < float("inf"):
        raise ValueError(f"{key} = {value!r}: expected a number, more than zero")
    return float(value)


def by_message(dbc: Dbc, signals: Iterable[Signal]) -> dict[str, Message]:
    """Return the messages of these signals by name, each once."""
    return {name: dbc.message(name) for name in dict.fromkeys(signal.message for signal in signals)}


def _once(signals: Iterable[Signal], key: str) -> None:
    seen = set()
    for signal in signals:
        if str(signal) in seen:
            raise ValueError(f"{key}: {signal} is named twice; each has a signal of its own")
        seen.add(str(signal))
