"""Reads the tables of [device.motors] against the DBC, and refuses every name, unit or value that it does not have.

All functions raise ValueError with a sentence that begins with ``key``, the key below [device.motors].
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Literal, NamedTuple

from hil.addons.motors.dbc.dbc_file import Dbc, Signal
from hil.core.errors import nearest
from hil.core.types import WHEEL_NAMES

Table = Mapping[str, object]
Fields = Mapping[str, Mapping[str, object]]
"""A value, or an array of values, for each ``MESSAGE.Signal``."""
Step = Mapping[str, Mapping[str, float]]
"""Raw values, by message and signal, that are sent together."""


Place = Literal["wheel", "shaft", "shaft torque", "ground", "phase"]
"""Where a quantity is measured: at the wheel's axle, at the motor's shaft before the gear (a speed or position, or a
torque), on the ground under the wheel, or as the phase current of the motor."""


class Unit(NamedTuple):
    """A unit of a signal: ``factor`` SI units, measured at ``place``."""

    factor: float
    place: Place = "wheel"


_DEGREE = math.pi / 180.0
_CURRENTS = {"A": 1.0, "mA": 1e-3}
_ANGLES = {"rad": 1.0, "rev, turn, turns": math.tau, "deg, °": _DEGREE}
_SPEEDS = {
    "rad/s": 1.0,
    "rpm, r/min, rev/min, 1/min, U/min": math.tau / 60.0,
    "rev/s, turn/s, turns/s, rps": math.tau,
    "deg/s, °/s": _DEGREE,
}
_DIMENSIONS: Mapping[str, tuple[str, Mapping[Place, Mapping[str, float]]]] = {
    "speed": ("rad/s of the wheel", {"shaft": _SPEEDS, "ground": {"m/s": 1.0, "mm/s": 1e-3}}),
    "torque": ("N·m at the wheel", {"shaft torque": {"Nm, N·m, N*m, N.m": 1.0, "mNm": 1e-3}, "phase": _CURRENTS}),
    "position": ("rad of the wheel", {"shaft": _ANGLES, "ground": {"m": 1.0, "mm": 1e-3}}),
    "current": ("A", {"wheel": _CURRENTS}),
    "temperature": ("°C", {"wheel": {"degC, °C, C, deg C": 1.0}}),
    "voltage": ("V", {"wheel": {"V": 1.0, "mV": 1e-3}}),
    "velocity": ("m/s", {"wheel": {"m/s": 1.0, "mm/s": 1e-3, "km/h": 1.0 / 3.6}}),
    "yaw rate": ("rad/s", {"wheel": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s, °/s": _DEGREE}}),
    "acceleration": ("m/s²", {"wheel": {"m/s^2, m/s2, m/s²": 1.0, "g": 9.80665}}),
    "time": ("s", {"wheel": {"s": 1.0, "ms": 1e-3}}),
}
UNITS: Mapping[str, Mapping[str, Unit]] = {
    dimension: {
        name: Unit(factor, place)
        for place, sizes in places.items()
        for names, factor in sizes.items()
        for name in names.split(", ")
    }
    for dimension, (_, places) in _DIMENSIONS.items()
}
SI = {dimension: words for dimension, (words, _) in _DIMENSIONS.items()}
"""The SI unit of each dimension, in words."""


class Bound(NamedTuple):
    """A signal that carries a quantity of a ``dimension`` of SI, in a ``unit``, with a ``sign``."""

    signal: Signal
    sign: int
    unit: Unit
    dimension: str


class Quantity(NamedTuple):
    """A quantity and its signals: one per wheel, per axis, or one.

    ``spans``: for positions, the number of units after which each signal begins again; 0 for one that never does.
    """

    bounds: tuple[Bound, ...]
    spans: tuple[float, ...] = ()


class Condition(NamedTuple):
    """A signal and the raw values that meet the condition. ``where``: a signal that reports errors, of what.

    An error is a value that does not meet the condition.
    """

    signal: Signal
    raws: frozenset[float]
    where: str = ""


class Watchdog(NamedTuple):
    """The watchdog: a fixed ``timeout_s`` that the user gives, or a time that is set by a signal and read from one."""

    timeout_s: float | None = None
    set: Bound | None = None
    read: Bound | None = None


_TWIST = {"forward": "velocity", "left": "velocity", "yaw_rate": "yaw rate"}
_WHEELS = {name: dict.fromkeys(WHEEL_NAMES, name) for name in ("speed", "torque", "position", "current", "temperature")}
COMMANDS = {name: _WHEELS[name] for name in ("speed", "torque")} | {"twist": _TWIST, "feedforward": _WHEELS["torque"]}
"""The dimension of each signal of the commanded quantities."""
FEEDBACK = {name: _WHEELS[name] for name in ("speed", "position", "current", "temperature")} | {
    "twist": _TWIST,
    "battery_voltage": {"signal": "voltage"},
    "battery_current": {"signal": "current"},
    "yaw_rate": {"signal": "yaw rate"},
    "acceleration": dict.fromkeys(("x", "y", "z"), "acceleration"),
}
"""The dimension of each signal of the measured quantities."""


@contextmanager
def _named(words: str) -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{words}: {error}") from error


def _array(value: object) -> list[object] | tuple[object, ...]:
    return value if isinstance(value, list | tuple) else [value]


def _check_names(given: Table, key: str, known: Iterable[str]) -> None:
    for name in given:
        if name not in known:
            raise ValueError(f"{key}.{name}: unknown{nearest(name, known)}")


def quantities(dbc: Dbc, given: Table, key: str, known: Mapping[str, Mapping[str, str]]) -> dict[str, Quantity]:
    """Return the quantities of ``command`` or ``feedback``, in the order of ``known``."""
    _check_names(given, key, known)
    return {
        name: _quantity(dbc, given[name], f"{key}.{name}", dimensions, wraps=name == "position")
        for name, dimensions in known.items()
        if name in given
    }


def _quantity(dbc: Dbc, given: object, key: str, dimensions: Mapping[str, str], *, wraps: bool) -> Quantity:
    if isinstance(given, str) and len(dimensions) == 1:
        given = dict.fromkeys(dimensions, given)
    if not isinstance(given, Mapping):
        raise ValueError(f"{key} = {given!r}: expected a table")
    _check_names(given, key, (*dimensions, "unit", "scale", *(["wraps_at"] if wraps else [])))
    if missing := [name for name in dimensions if name not in given]:
        raise ValueError(f"{key}: {', '.join(missing)} missing; name a signal for each of {', '.join(dimensions)}")
    bounds = tuple(_bound(dbc, given, name, key, dimension) for name, dimension in dimensions.items())
    signals = [str(bound.signal) for bound in bounds]
    if twice := [signal for signal in signals if signals.count(signal) > 1]:
        raise ValueError(f"{key}: {twice[0]} is named twice; each has a signal of its own")
    if not wraps:
        return Quantity(bounds)
    if "wraps_at" in given:
        return Quantity(bounds, (positive(given["wraps_at"], f"{key}.wraps_at"),) * len(bounds))
    return Quantity(bounds, tuple(_span(bound, key) for bound in bounds))


def _span(bound: Bound, key: str) -> float:
    """Return the number of units after which a position begins again: at the end of its bits; 0 for floats.

    Where the DBC has narrower limits, they do not tell whether they are the same angle or one step apart.
    """
    signal = bound.signal
    if signal.is_float:
        return 0.0
    if signal.has_limits:
        raise ValueError(
            f"{key}: {signal} goes from {signal.limits()}, and the DBC does not tell after how much it begins again; "
            "give wraps_at, or for one that never begins again a number above its range"
        )
    return abs(signal.factor) * (signal.high - signal.low + 1)


def _bound(dbc: Dbc, given: Table, name: str, key: str, dimension: str) -> Bound:
    """Return the signal with this name in a table, with the table's unit or scale, or else the DBC's unit."""
    spec = given[name]
    sign, bare = (-1, spec[1:]) if isinstance(spec, str) and spec.startswith("-") else (1, spec)
    with _named(f"{key}.{name} = {spec!r}"):
        signal = dbc.signal(bare)
        if "scale" in given:
            if "unit" in given:
                raise ValueError("give unit or scale, not both")
            return Bound(signal, sign, Unit(positive(given["scale"], f"{key}.scale")), dimension)
        text = given.get("unit", signal.unit)
        if not isinstance(text, str):
            raise ValueError(f"unit = {text!r}: expected text")
        return Bound(signal, sign, _unit(dimension, text), dimension)


def _unit(dimension: str, text: str) -> Unit:
    """Return a unit by its name. Raises ValueError when the dimension has none of this name."""
    known = UNITS[dimension]
    if text in known:
        return known[text]
    what = f"the unit {text!r} is not known for a {dimension}" if text else "the DBC gives it no unit"
    near = nearest(text, known) if text else f"; known: {', '.join(known)}"
    raise ValueError(
        f"{what}{near}; give unit in the same table, or scale, which is what 1 of the signal is in {SI[dimension]}"
    )


def _raw_values(
    dbc: Dbc, fields: Fields, key: str, raws_of: Callable[[Signal, object], list[float]]
) -> Iterator[tuple[str, Signal, list[float]]]:
    """Yield the key of each field, its signal, and the raw values of its items."""
    for message, values in fields.items():
        if not values:
            with _named(f"{key}.{message}"):
                names = ", ".join(dbc.message(message).signals)
                raise ValueError(f"names no signal; give at least one of {names}" if names else "it has no signals")
        for name, given in values.items():
            where = f"{key}.{message}.{name}"
            with _named(f"{where} = {given!r}"):
                signal = dbc.signal(f"{message}.{name}")
                if not (raws := [raw for one in _array(given) for raw in raws_of(signal, one)]):
                    raise ValueError("expected at least one value")
            yield where, signal, raws


def _sent(signal: Signal, value: object) -> list[float]:
    return [signal.raw(value)]


def constants(dbc: Dbc, fields: Fields, key: str) -> dict[str, dict[str, float]]:
    """Return the raw values that are the same in every frame, by message and signal."""
    fixed: dict[str, dict[str, float]] = {}
    for where, signal, raws in _raw_values(dbc, fields, key, _sent):
        if len(raws) > 1:
            raise ValueError(f"{where}: expected one value, as it is the same in every frame")
        fixed.setdefault(signal.message, {})[signal.name] = raws[0]
    return fixed


def steps(dbc: Dbc, fields: Fields, key: str) -> tuple[Step, ...]:
    """Return the steps of a phase. Arrays have a value for each step, and all have the same length.

    A message without signals is sent as it is, in each step.
    """
    bare = []
    for name in (name for name, values in fields.items() if not values):
        with _named(f"{key}.{name}"):
            if not dbc.message(name).signals:
                bare.append(name)
    found = list(_raw_values(dbc, {name: one for name, one in fields.items() if name not in bare}, key, _sent))
    lengths = {len(raws): where for where, _, raws in found if len(raws) > 1}
    if len(lengths) > 1:
        (a, first), (b, second) = sorted(lengths.items())[:2]
        raise ValueError(f"{second}: {b} values, but {first} has {a}; each is one step, give as many to each")
    number_of_steps = max((*lengths, 1)) if fields else 0
    made: list[dict[str, dict[str, float]]] = [{name: {} for name in bare} for _ in range(number_of_steps)]
    for _, signal, raws in found:
        for number, step in enumerate(made):
            step.setdefault(signal.message, {})[signal.name] = raws[number if len(raws) > 1 else 0]
    return tuple(made)


def conditions(dbc: Dbc, fields: Fields, key: str) -> tuple[Condition, ...]:
    """Return the conditions; any value of an array meets one."""
    found = _raw_values(dbc, fields, key, Signal.raws)
    return tuple(Condition(signal, frozenset(raws)) for _, signal, raws in found)


def errors(dbc: Dbc, given: Table, key: str) -> tuple[Condition, ...]:
    """Return the signals that report errors of each wheel and of the robot, with the values that are no error."""
    _check_names(given, key, (*WHEEL_NAMES, "robot", "none"))
    none = given.get("none", 0)
    found = []
    for where, specs in given.items():
        if where == "none":
            continue
        if not _array(specs):
            raise ValueError(f"{key}.{where} = []: expected a signal, or an array of them")
        for spec in _array(specs):
            with _named(f"{key}.{where} = {spec!r}"):
                signal = dbc.signal(spec)
            with _named(f"{key}.none = {none!r} for {signal}"):
                raws = frozenset(raw for one in _array(none) for raw in signal.raws(one))
                if not raws:
                    raise ValueError("expected at least one value")
            found.append(Condition(signal, raws, where))
    if given and not found:
        raise ValueError(f"{key}.none: no signal of errors is named; give one for {', '.join(WHEEL_NAMES)} or robot")
    return tuple(found)


def counters(dbc: Dbc, specs: Iterable[str], key: str) -> tuple[Signal, ...]:
    """Return the rolling counters."""
    found = []
    for spec in specs:
        with _named(f"{key}: {spec!r}"):
            signal = dbc.signal(spec)
            if signal.is_float or signal.high <= signal.low:
                raise ValueError("a counter is a whole number that has more than one value")
        found.append(signal)
    return tuple(found)


def watchdog(dbc: Dbc, given: Table, key: str) -> Watchdog:
    """Return the watchdog that stops the wheels when commands end."""
    _check_names(given, key, ("timeout_s", "set", "read", "unit", "scale"))
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
    return Watchdog(None, *(_bound(dbc, given, name, key, "time") for name in ("set", "read")))


def positive(value: object, key: str) -> float:
    """Return a number of more than zero."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < float("inf"):
        raise ValueError(f"{key} = {value!r}: expected a number, more than zero")
    return float(value)
