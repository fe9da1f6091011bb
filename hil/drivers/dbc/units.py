"""Units as DBC files write them, and their conversion to SI units at the wheel."""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from hil.core.errors import nearest

_TURN = math.tau
_RPM = math.tau / 60.0
_DEGREE = math.pi / 180.0
_STANDARD_GRAVITY = 9.80665


class Unit(NamedTuple):
    """A unit of a signal: ``factor`` SI units, measured at ``place``.

    Places: the motor's shaft, before the gear; the ground under the wheel; the phase current of the motor; the wheel.
    """

    factor: float
    place: Literal["shaft", "ground", "phase", "wheel"] = "wheel"


def _same(unit: Unit, *names: str) -> dict[str, Unit]:
    return dict.fromkeys(names, unit)


_SPEED = {
    **_same(Unit(1.0, "shaft"), "rad/s"),
    **_same(Unit(_RPM, "shaft"), "rpm", "r/min", "rev/min", "1/min", "U/min"),
    **_same(Unit(_TURN, "shaft"), "rev/s", "turn/s", "turns/s", "rps"),
    **_same(Unit(_DEGREE, "shaft"), "deg/s", "°/s"),
    **_same(Unit(1.0, "ground"), "m/s"),
    **_same(Unit(1e-3, "ground"), "mm/s"),
}
_YAW_RATE = {"rad/s": Unit(1.0), "mrad/s": Unit(1e-3), "deg/s": Unit(_DEGREE), "°/s": Unit(_DEGREE)}
_CURRENT = {"A": 1.0, "mA": 1e-3}
UNITS: Mapping[str, Mapping[str, Unit]] = {
    "speed": _SPEED,
    "torque": {
        **_same(Unit(1.0, "shaft"), "Nm", "N·m", "N*m", "N.m"),
        **_same(Unit(1e-3, "shaft"), "mNm"),
        **{name: Unit(factor, "phase") for name, factor in _CURRENT.items()},
    },
    "position": {
        **_same(Unit(1.0, "shaft"), "rad"),
        **_same(Unit(_TURN, "shaft"), "rev", "turn", "turns"),
        **_same(Unit(_DEGREE, "shaft"), "deg", "°"),
        **_same(Unit(1.0, "ground"), "m"),
        **_same(Unit(1e-3, "ground"), "mm"),
    },
    "current": {name: Unit(factor) for name, factor in _CURRENT.items()},
    "temperature": _same(Unit(1.0), "degC", "°C", "C", "deg C"),
    "voltage": {"V": Unit(1.0), "mV": Unit(1e-3)},
    "velocity": {"m/s": Unit(1.0), "mm/s": Unit(1e-3), "km/h": Unit(1.0 / 3.6)},
    "yaw rate": _YAW_RATE,
    "acceleration": {**_same(Unit(1.0), "m/s^2", "m/s2", "m/s²"), "g": Unit(_STANDARD_GRAVITY)},
    "time": {"s": Unit(1.0), "ms": Unit(1e-3)},
}
SI = {
    "speed": "rad/s of the wheel",
    "torque": "N·m at the wheel",
    "position": "rad of the wheel",
    "current": "A",
    "temperature": "°C",
    "voltage": "V",
    "velocity": "m/s",
    "yaw rate": "rad/s",
    "acceleration": "m/s²",
    "time": "s",
}


def unit(dimension: str, text: str) -> Unit:
    """Return a unit by its name. Raises ValueError when the dimension has none of this name."""
    known = UNITS[dimension]
    if text in known:
        return known[text]
    folded = {name.casefold(): found for name, found in known.items()}
    # Upper and lower case are the same, unless that is the only difference between two units.
    if text.casefold() in folded and len(folded) == len(known):
        return folded[text.casefold()]
    what = f"the unit {text!r} is not known for a {dimension}" if text else "the DBC gives it no unit"
    near = nearest(text, known) if text else f"; known: {', '.join(known)}"
    raise ValueError(
        f"{what}{near}; give unit in the same table, or scale, which is what 1 of the signal is in {SI[dimension]}"
    )


def at_wheel(
    one: Unit, dimension: str, *, gear_ratio: float, wheel_radius_m: float, torque_constant_n_m_a: float
) -> float:
    """Return the size of a unit in the unit of ``SI``; the torque constant is that at the wheel."""
    if one.place == "shaft":
        return one.factor * gear_ratio if dimension == "torque" else one.factor / gear_ratio
    if one.place == "ground":
        return one.factor / wheel_radius_m
    return one.factor * torque_constant_n_m_a if one.place == "phase" else one.factor
