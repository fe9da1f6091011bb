"""Maps the signals of the bridge to variables of an FMU.

A row of ``[plant.map]`` names one signal and one variable, with

    bridge value = sign * scale * FMU value + offset

for outputs; the value of an input is computed from the same equation. A signal without a row uses the variable of
the same name. Signals that are then still missing are derived from others:

    signal                 from
    wheel.*.count          the wheel's angle, times counts per revolution / 2 pi, rounded down
    wheel.*.speed_rad_s    the difference of the wheel's angle over the tick, divided by the tick
    twist.*                the difference of the pose over the tick, divided by the tick; 0 at the start
    wheel.*.current_a      the wheel's torque divided by the torque constant
    gyro.z_rad_s           twist.yaw_rate_rad_s
    gyro.x_rad_s, y        0: the robot stays level

Required are the pose and, for each wheel, the torque or the duty, and the angle or both count and speed. Without
accelerometer, battery or temperatures the firmware reports that it has no such sensor. A heading or an angle that the
FMU wraps at a whole turn is unwrapped.

There are no patterns for names: a third-party FMU rarely calls its wheels fl, fr, rr and rl, and some of them turn the
other way round, so each wheel needs its own row.
"""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.plant.signals import (
    ACCELEROMETER,
    ANGLES,
    BATTERY,
    COUNTS,
    CURRENTS,
    DUTIES,
    ENABLED,
    GYRO,
    INPUTS,
    OUTPUTS,
    SPEEDS,
    TEMPERATURES,
    TORQUES,
    TWIST,
)

FLOATS = frozenset({"Real", "Float64", "Float32"})
INTEGERS = frozenset({"Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))})
_ELEMENT = re.compile(r"(?P<array>.+)\[(?P<places>\d+(?:,\d+)*)\]")
_LONGEST_LIST = 30

Variables = Mapping[str, Any]  # FMPy's ModelVariable by name


class Row(NamedTuple):
    """The variable of one signal: bridge value = sign * scale * FMU value + offset.

    ``name[2]`` is the second element of an FMI 3.0 array, ``name[2,1]`` one of a matrix; places count from 1.
    """

    name: str
    scale: float = 1.0
    offset: float = 0.0
    sign: int = 1


@dataclass(frozen=True)
class SignalMap:
    """Rows by signal, and the constants that derived signals need; None if no signal needs them."""

    rows: Mapping[str, Row] = field(default_factory=dict)
    counts_per_revolution: float | None = None
    torque_constant_n_m_a: float | None = None


class Connection(NamedTuple):
    """One signal and the element of the variable that carries it: bridge value = factor * FMU value + offset."""

    signal: int  # the place in INPUTS or OUTPUTS
    variable: Any
    element: int  # 0 where the variable is a scalar
    factor: float
    offset: float


class Wiring(NamedTuple):
    """A map applied to an FMU. ``derived`` are the indices in OUTPUTS of the signals derived from others."""

    inputs: tuple[Connection, ...]
    outputs: tuple[Connection, ...]
    derived: frozenset[int]


def resolve(signal_map: SignalMap, fmu: Path, variables: Variables) -> Wiring:
    """Find the variable of every signal.

    Raises BadInputError with a line for each row and each signal that does not fit.
    """
    return _Resolver(signal_map, fmu, variables).wiring()


class _Resolver:
    """Applies one map; collects all problems instead of stopping at the first."""

    def __init__(self, signal_map: SignalMap, fmu: Path, variables: Variables) -> None:
        self._map = signal_map
        self._fmu = fmu
        self._variables = variables
        self._problems: list[str] = []

    def wiring(self) -> Wiring:
        for signal in self._map.rows:
            if signal not in (*INPUTS, *OUTPUTS):
                self._complain(signal, f"the bridge has no such signal{nearest(signal, (*INPUTS, *OUTPUTS))}")
        inputs = self._connections(INPUTS, self._unfit_for_input)
        outputs = self._connections(OUTPUTS, self._unfit_for_output)
        derived = self._derived(outputs)
        self._require_the_rest(inputs, outputs, derived)
        self._require_numbers(derived)
        self._refuse_shared(inputs.values())
        if self._problems:
            raise BadInputError("\n".join(self._problems))
        unused = {angle for angle, *others in zip(ANGLES, COUNTS, SPEEDS, strict=True) if not derived & set(others)}
        return Wiring(
            tuple(inputs.values()),
            tuple(connection for signal, connection in outputs.items() if signal not in unused),
            frozenset(map(OUTPUTS.index, derived)),
        )

    def _complain(self, signal: str, words: str) -> None:
        self._problems.append(f'plant.map."{signal}": {words}')

    def _connections(self, signals: tuple[str, ...], unfit: Callable[[Any], str | None]) -> dict[str, Connection]:
        found = {}
        for place, signal in enumerate(signals):
            row = self._map.rows.get(signal) or Row(signal)
            if signal not in self._map.rows and signal not in self._variables:
                continue
            if (problem := _unfit_numbers(row)) is not None:
                self._complain(signal, problem)
            try:
                variable, element = self._find(row.name, unfit)
            except BadInputError as error:
                self._complain(signal, str(error))
            else:
                found[signal] = Connection(place, variable, element, row.sign * row.scale, row.offset)
        return found

    def _find(self, name: str, unfit: Callable[[Any], str | None]) -> tuple[Any, int]:
        """Return the variable of this name and the place in it. Raises BadInputError with part of a sentence."""
        variable, element = self._variables.get(name), 0
        match = _ELEMENT.fullmatch(name)
        if variable is None and match is not None and match["array"] in self._variables:
            variable = self._variables[match["array"]]
            element = _element([int(place) for place in match["places"].split(",")], name, variable.shape)
        elif variable is not None and variable.shape:
            first = ",".join("1" for _ in variable.shape)
            raise BadInputError(f"{name!r} is an array; name one element of it, such as '{name}[{first}]'")
        if variable is None:
            fitting = [name for name, variable in self._variables.items() if unfit(variable) is None]
            raise BadInputError(f"{self._fmu.name} has no variable {name!r}{self._nearest(name, fitting)}")
        if (problem := unfit(variable)) is not None:
            raise BadInputError(f"{name!r} of {self._fmu.name} {problem}")
        return variable, element

    def _nearest(self, name: str, known: list[str]) -> str:
        words = nearest(name, known)
        is_long = words.startswith("; known") and len(known) > _LONGEST_LIST
        return f"; for its {len(known)} fitting ones run: hil fmu info {self._fmu}" if is_long else words

    def _unfit_for_input(self, variable: Any) -> str | None:
        if variable.causality != "input":
            return f"is of causality {variable.causality}; expected an input"
        if variable.type not in FLOATS:
            return f"is of type {variable.type}; expected Real, Float64 or Float32"
        return None

    def _unfit_for_output(self, variable: Any) -> str | None:
        if variable.causality not in ("output", "local"):
            return f"is of causality {variable.causality}; expected an output or a local variable"
        if variable.type not in FLOATS | INTEGERS:
            return f"is of type {variable.type}; expected a number"
        return None

    def _derived(self, outputs: Mapping[str, Connection]) -> set[str]:
        may_follow = (*TWIST, *SPEEDS, *CURRENTS, *GYRO, *COUNTS, *ACCELEROMETER, *BATTERY, *TEMPERATURES)
        return {signal for signal in may_follow if signal not in outputs}

    def _require_the_rest(self, inputs: Iterable[str], outputs: Iterable[str], derived: set[str]) -> None:
        # A row with a wrong variable has been reported already.
        there = {*inputs, *outputs, *derived, *ANGLES, *DUTIES, *ENABLED, *self._map.rows}
        driven = {torque for torque, duty in zip(TORQUES, DUTIES, strict=True) if duty in there & {*inputs}}
        missing = [signal for signal in (*INPUTS, *OUTPUTS) if signal not in there | driven]
        for angle, count, speed in zip(ANGLES, COUNTS, SPEEDS, strict=True):
            if angle not in {*outputs, *self._map.rows} and derived & {count, speed} - set(self._map.rows):
                missing.append(f"{angle} (or both {count} and {speed})")
        if missing:
            self._problems.append(
                f"{self._fmu.name} has no variable of the name of {', '.join(missing)}; name one in a row of "
                f"[plant.map] each, hil fmu info {self._fmu} lists what it has"
            )

    def _require_numbers(self, derived: set[str]) -> None:
        for signals, name in ((COUNTS, "counts_per_revolution"), (CURRENTS, "torque_constant_n_m_a")):
            value = getattr(self._map, name)
            if derived & set(signals) and not (value is not None and math.isfinite(value) and value > 0):
                which = ", ".join(sorted(derived & set(signals)))
                self._problems.append(f"{name} = {value}; expected a positive number, since {which} is not mapped")

    def _refuse_shared(self, inputs: Iterable[Connection]) -> None:
        taken: dict[tuple[int, int], Connection] = {}
        for connection in inputs:
            other = taken.setdefault((connection.variable.valueReference, connection.element), connection)
            if other is not connection:
                self._complain(
                    INPUTS[connection.signal],
                    f"{connection.variable.name!r} already takes {INPUTS[other.signal]}; each needs its own input",
                )


def _unfit_numbers(row: Row) -> str | None:
    if not (math.isfinite(row.scale) and row.scale > 0):
        return f"scale = {row.scale:g}; expected a positive number, sign = -1 turns the sense round"
    if not math.isfinite(row.offset):
        return f"offset = {row.offset:g}; expected a finite number"
    if row.sign not in (1, -1):
        return f"sign = {row.sign}; expected 1 or -1"
    return None


def _element(places: list[int], name: str, shape: tuple[int, ...]) -> int:
    """Return the place of an element in row-major order (FMI 3.0 section 2.2.9.1), counted from 0."""
    if len(places) != len(shape) or not all(1 <= place <= size for place, size in zip(places, shape, strict=True)):
        sizes = " x ".join(map(str, shape)) or "no"
        raise BadInputError(f"{name!r} is not there: the array has {sizes} elements, counted from 1")
    element = 0
    for place, size in zip(places, shape, strict=True):
        element = element * size + place - 1
    return element
