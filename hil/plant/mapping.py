"""Maps the signals of the bridge to variables of an FMU, and finds out which signals have to be derived from others.

A row of ``[plant.map]`` names one signal and one variable, with

    bridge value = sign * scale * FMU value + offset

for outputs; the value of an input is computed from the same equation. A signal without a row uses the variable of
the same name. plant_fmu/FOREIGN.md lists what is required and how a missing signal is derived (in ``derive.c``).
Without accelerometer, battery or temperatures the firmware reports that it has no such sensor.

There are no patterns for names: a third-party FMU rarely calls its wheels fl, fr, rr and rl, and some of them turn in
the opposite direction. So each wheel needs its own row.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.core.plant_signals import (
    ANGLES,
    COUNTS,
    CURRENTS,
    DERIVABLE,
    DUTIES,
    ENABLED,
    INPUTS,
    OUTPUTS,
    POSE,
    SPEEDS,
    TORQUES,
)
from hil.core.printable import command
from hil.plant.units import conversion

FLOATS = frozenset({"Real", "Float64", "Float32"})
INTEGERS = frozenset({"Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))})
_ELEMENT = re.compile(r"(?P<array>.+)\[(?P<places>\d+(?:,\d+)*)\]")
_LONGEST_LIST = 60
_MOVING = frozenset({*POSE, *SPEEDS, *COUNTS, *ANGLES})

Variables = Mapping[str, Any]  # FMPy's ModelVariable by name


class Row(NamedTuple):
    """The variable of one signal: bridge value = sign * scale * FMU value + offset.

    ``scale`` is positive, ``sign`` is 1 or -1. If ``scale`` is None, it follows from ``unit``, by default the FMU's own
    unit of the variable. An empty ``unit`` is not compared. ``name[2]`` is the second element of an FMI 3.0 array,
    ``name[2,1]`` one of a matrix; they are counted from 1.
    """

    name: str
    scale: float | None = None
    offset: float = 0.0
    sign: int = 1
    unit: str | None = None


@dataclass(frozen=True)
class SignalMap:
    """Rows by signal, and the constants that derived signals need; None if no signal needs them.

    ``step_s`` is the communication step in place of the one that the FMU's description leads to (``communication.py``).
    """

    rows: Mapping[str, Row] = field(default_factory=dict)
    counts_per_revolution: float | None = None
    torque_constant_n_m_a: float | None = None
    step_s: float | None = None


class Connection(NamedTuple):
    """One signal and the element of the variable that carries it: bridge value = factor * FMU value + offset."""

    signal: int  # the index in INPUTS or OUTPUTS
    variable: Any
    element: int  # 0 where the variable is a scalar
    factor: float
    offset: float


class Wiring(NamedTuple):
    """A map applied to an FMU. ``derived`` are the indices in OUTPUTS of the signals derived from others.

    ``notices`` report how units were converted.
    """

    inputs: tuple[Connection, ...]
    outputs: tuple[Connection, ...]
    derived: frozenset[int]
    notices: tuple[str, ...]


def resolve(signal_map: SignalMap, fmu: Path, variables: Variables, units: Mapping[str, Any]) -> Wiring:
    """Find the variable of every signal. ``units`` are FMPy's definitions of the FMU's units, by name.

    Raises BadInputError with a line for each row and each signal that does not fit.
    """
    return _Resolver(signal_map, fmu, variables, units).wiring()


class _Direction(NamedTuple):
    """The variables that may carry the ``signals`` of one direction, and how messages describe them."""

    signals: tuple[str, ...]
    causalities: tuple[str, ...]
    types: frozenset[str]
    expected_causality: str
    expected_type: str

    def misfit(self, variable: Any) -> str | None:
        """Return why a variable does not fit, as the end of a sentence; None if it does."""
        if variable.clocks:
            return "is clocked, and can be used in event mode only, which is not used here; expected one without clocks"
        if variable.causality not in self.causalities:
            return f"is of causality {variable.causality}; expected {self.expected_causality}"
        return None if variable.type in self.types else f"is of type {variable.type}; expected {self.expected_type}"


_INPUT = _Direction(INPUTS, ("input",), FLOATS, "an input", "Real, Float64 or Float32")
_OUTPUT = _Direction(OUTPUTS, ("output", "local"), FLOATS | INTEGERS, "an output or a local variable", "a number")


class _Resolver:
    """Applies one map; collects all problems instead of stopping at the first."""

    def __init__(self, signal_map: SignalMap, fmu: Path, variables: Variables, units: Mapping[str, Any]) -> None:
        self._map = signal_map
        self._fmu = fmu
        self._variables = variables
        self._units = units
        self._problems: list[str] = []
        self._notices: list[str] = []

    def wiring(self) -> Wiring:
        inputs, outputs = self._connections(_INPUT), self._connections(_OUTPUT)
        derived = {signal for signal in DERIVABLE if signal not in outputs}
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
            tuple(self._notices),
        )

    def _connections(self, direction: _Direction) -> dict[str, Connection]:
        found = {}
        for place, signal in enumerate(direction.signals):
            row = self._map.rows.get(signal) or Row(signal)
            if signal not in self._map.rows and signal not in self._variables:
                continue
            try:
                variable, element = self._find(row.name, direction)
                if signal in _MOVING and variable.variability in ("constant", "fixed", "tunable"):
                    raise BadInputError(
                        f"{row.name!r} of {self._fmu.name} is {variable.variability}, so it never moves; name another"
                    )
                became = conversion(signal, row, variable, self._units)
            except BadInputError as error:
                self._problems.append(f'plant.map."{signal}": {error}')
            else:
                self._notices += [became.notice] if became.notice else []
                found[signal] = Connection(place, variable, element, row.sign * became.factor, became.offset)
        return found

    def _find(self, name: str, direction: _Direction) -> tuple[Any, int]:
        """Return the variable of this name and the element of it. Raises BadInputError with part of a sentence."""
        variable, element = self._variables.get(name), 0
        match = _ELEMENT.fullmatch(name)
        if variable is None and match is not None and match["array"] in self._variables:
            variable = self._variables[match["array"]]
            element = _element([int(place) for place in match["places"].split(",")], name, variable.shape)
        elif variable is not None and variable.shape:
            first = ",".join("1" for _ in variable.shape)
            raise BadInputError(f"{name!r} is an array; name one element of it, such as '{name}[{first}]'")
        if variable is None:
            fitting = [name for name, variable in self._variables.items() if direction.misfit(variable) is None]
            raise BadInputError(f"{self._fmu.name} has no variable {name!r}{nearest_of(name, fitting, self._fmu)}")
        if (problem := direction.misfit(variable)) is not None:
            raise BadInputError(f"{name!r} of {self._fmu.name} {problem}")
        return variable, element

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
                f"[plant.map] each, {command('hil', 'fmu', 'info', self._fmu)} lists what it has"
            )

    def _require_numbers(self, derived: set[str]) -> None:
        for group, name in ((COUNTS, "counts_per_revolution"), (CURRENTS, "torque_constant_n_m_a")):
            if (which := ", ".join(sorted(derived & set(group)))) and getattr(self._map, name) is None:
                self._problems.append(f"{name} = None; expected a positive number, since {which} is not mapped")

    def _refuse_shared(self, inputs: Iterable[Connection]) -> None:
        used: dict[tuple[int, int], Connection] = {}
        for connection in inputs:
            other = used.setdefault((connection.variable.valueReference, connection.element), connection)
            if other is not connection:
                self._problems.append(
                    f'plant.map."{INPUTS[connection.signal]}": {connection.variable.name!r} already takes '
                    f"{INPUTS[other.signal]}; each needs its own input"
                )


def nearest_of(name: str, known: list[str], fmu: Path) -> str:
    """Return a hint after an unknown name: similar names, the known ones, or for a long list where to find it."""
    listed = f"; {command('hil', 'fmu', 'info', fmu)} lists what it has"
    return nearest(name, known, listed if len(known) > _LONGEST_LIST else None)


def _element(places: list[int], name: str, shape: tuple[int, ...]) -> int:
    """Return the place of an element in row-major order (FMI 3.0 section 2.2.9.1), counted from 0."""
    if len(places) != len(shape) or not all(1 <= place <= size for place, size in zip(places, shape, strict=True)):
        sizes = " x ".join(map(str, shape)) or "no"
        raise BadInputError(f"{name!r} is not there: the array has {sizes} elements, counted from 1")
    element = 0
    for place, size in zip(places, shape, strict=True):
        element = element * size + place - 1
    return element
