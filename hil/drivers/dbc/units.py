"""Units as DBC files write them, and their sizes in SI units."""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from hil.core.errors import nearest

Place = Literal["wheel", "shaft", "shaft torque", "ground", "phase"]
"""Where a quantity is measured: at the wheel's axle, at the motor's shaft before the gear (a speed or position, or a
torque), on the ground under the wheel, or as the phase current of the motor."""


class Unit(NamedTuple):
    """A unit of a signal: ``factor`` SI units, measured at ``place``."""

    factor: float
    place: Place = "wheel"


_DEGREE = math.pi / 180.0
_CURRENTS = {"A": 1.0, "mA": 1e-3}
_SIZES: Mapping[str, Mapping[Place, Mapping[str, float]]] = {
    "speed": {
        "shaft": {
            "rad/s": 1.0,
            "rpm, r/min, rev/min, 1/min, U/min": math.tau / 60.0,
            "rev/s, turn/s, turns/s, rps": math.tau,
            "deg/s, °/s": _DEGREE,
        },
        "ground": {"m/s": 1.0, "mm/s": 1e-3},
    },
    "torque": {"shaft torque": {"Nm, N·m, N*m, N.m": 1.0, "mNm": 1e-3}, "phase": _CURRENTS},
    "position": {
        "shaft": {"rad": 1.0, "rev, turn, turns": math.tau, "deg, °": _DEGREE},
        "ground": {"m": 1.0, "mm": 1e-3},
    },
    "current": {"wheel": _CURRENTS},
    "temperature": {"wheel": {"degC, °C, C, deg C": 1.0}},
    "voltage": {"wheel": {"V": 1.0, "mV": 1e-3}},
    "velocity": {"wheel": {"m/s": 1.0, "mm/s": 1e-3, "km/h": 1.0 / 3.6}},
    "yaw rate": {"wheel": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s, °/s": _DEGREE}},
    "acceleration": {"wheel": {"m/s^2, m/s2, m/s²": 1.0, "g": 9.80665}},
    "time": {"wheel": {"s": 1.0, "ms": 1e-3}},
}
UNITS: Mapping[str, Mapping[str, Unit]] = {
    dimension: {
        name: Unit(factor, place)
        for place, sizes in places.items()
        for names, factor in sizes.items()
        for name in names.split(", ")
    }
    for dimension, places in _SIZES.items()
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
