"""Compares the unit that an FMU declares for a variable with the unit of its signal.

What FMI itself has suffices where the FMU defines the unit: exponents of the base units, factor and offset (FMI 2.0.5
section 2.2.2, FMI 3.0 section 2.4.3). A unit that is a name alone is looked up by pint, which is imported only then.
"""

import functools
import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from hil.core.errors import BadInputError
from hil.plant.child_output import one_line

_BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_OF_PINT = ("kilogram", "meter", "second", "ampere", "kelvin", "mole", "candela", "radian")
_ROUNDING = 1e-3  # relative: a scale in a scenario may be rounded, and no two units are nearer to each other
_LONGEST = 40  # letters of a unit's name
_ONE = ("1", "-")
_TIMES = re.compile(r"(?<=[\w)])[.·⋅](?=[^\W\d_(])")
_EXPONENT = re.compile(r"([^\W\d_])(-?\d)")
_POWER_OF_NUMBER = re.compile(r"\d\s*(\^|\*\*)|\d{3}")


class Unit(NamedTuple):
    """A unit: value in SI = factor * value + offset. ``exponents`` are those of kg, m, s, A, K, mol, cd and rad."""

    exponents: tuple[int, ...]
    factor: float = 1.0
    offset: float = 0.0


def _si(offset: float = 0.0, **exponents: int) -> Unit:
    return Unit(tuple(exponents.get(base, 0) for base in _BASES), 1.0, offset)


_NAMED = {  # by the end of the name of a signal or a parameter; the first that fits
    "_kg": ("kg", _si(kg=1)),
    "_kg_m2": ("kg·m²", _si(kg=1, m=2)),
    "_n_m_a": ("N·m/A", _si(kg=1, m=2, s=-2, A=-1)),
    "_ohm": ("Ω", _si(kg=1, m=2, s=-3, A=-2)),
    "_h": ("H", _si(kg=1, m=2, s=-2, A=-2)),
    "_n_m": ("N·m", _si(kg=1, m=2, s=-2)),
    "_rad_s": ("rad/s", _si(rad=1, s=-1)),
    "_m_s2": ("m/s²", _si(m=1, s=-2)),
    "_m_s": ("m/s", _si(m=1, s=-1)),
    "_rad": ("rad", _si(rad=1)),
    "_m": ("m", _si(m=1)),
    "_degc": ("°C", _si(273.15, K=1)),
    "_a": ("A", _si(A=1)),
    "_v": ("V", _si(kg=1, m=2, s=-3, A=-1)),
    "": ("1", _si()),  # duty, counts, whether it is enabled
}


class Conversion(NamedTuple):
    """Signal = factor * variable + offset, except for the sign; ``notice`` reports a conversion, or is empty."""

    factor: float
    offset: float
    notice: str = ""


def conversion(signal: str, row: Any, variable: Any, definitions: Mapping[str, Any]) -> Conversion:
    """Return how the FMU's variable becomes the signal, by a row of the map and the variable's unit.

    ``definitions`` are FMPy's units by name. A scale that the row leaves out follows from the unit. Raises
    BadInputError with the end of a sentence when both are there and differ, and for a unit of another dimension.
    """
    name = one_line(row.unit if row.unit is not None else _unit_name(variable))[:_LONGEST]
    scale = 1.0 if row.scale is None else row.scale
    if not name:
        return Conversion(scale, row.offset)
    label, here = _named(signal)
    unit = _unit(name, definitions, here)
    if unit is None:
        if row.unit is not None:
            raise BadInputError(f"unit = {name!r} is no unit that is known; expected one such as deg, rev/min or N.cm")
        words = f"{variable.name} is in {name!r}, which is no unit that is known: it is taken for {scale:g} {label}"
        return Conversion(scale, row.offset, f"{signal}: {words}")
    if unit.exponents != here.exponents:
        raise BadInputError(
            f"{variable.name!r} is in {name}; expected a unit of the dimension of {label}. Name another variable, or "
            "write its true unit into the row, such as unit = 'rad/s'"
        )
    factor, shift = unit.factor / here.factor, (unit.offset - here.offset) / here.factor
    if here.offset and _is_difference(variable):
        raise BadInputError(f"{variable.name!r} is a difference (relativeQuantity); expected a temperature")
    if row.scale is not None and not math.isclose(row.scale, factor, rel_tol=_ROUNDING):
        raise BadInputError(
            f"scale = {row.scale:g}, but {variable.name!r} is in {name}, and 1 {name} is {factor:.10g} {label}; leave "
            "scale out, or write unit = '' to have no unit compared, as for a gear"
        )
    if shift and row.offset and not math.isclose(row.offset, shift, rel_tol=_ROUNDING):
        raise BadInputError(
            f"offset = {row.offset:g}, but {variable.name!r} is in {name}, and 0 {name} is {shift:.10g} {label}; leave "
            "offset out, or write unit = '' to have no unit compared"
        )
    offset = row.offset or shift
    is_converted = (row.scale is None and factor != 1.0) or offset != row.offset
    equation = f"{factor:.10g} * {variable.name}" + (f" + {offset:.10g}" if offset else "")
    return Conversion(
        factor if row.scale is None else row.scale,
        offset,
        f"{signal} = {equation}, which is in {name}" if is_converted else "",
    )


def misfit(name: str, variable: Any, definitions: Mapping[str, Any]) -> str | None:
    """Return the end of a sentence where the FMU's variable is in another unit than our name for it ends in, else None.

    An angle in it counts for nothing: a motor's N·m/A are V·s/rad, too.
    """
    declared = one_line(_unit_name(variable))[:_LONGEST]
    label, here = _named(name)
    unit = _unit(declared, definitions, here) if declared else None
    if unit is None or (unit.exponents[:-1] == here.exponents[:-1] and math.isclose(unit.factor, here.factor)):
        return None
    return f"is in {declared}, not in {label}"


def _named(name: str) -> tuple[str, Unit]:
    return next(unit for end, unit in _NAMED.items() if name.endswith(end))


def _unit_name(variable: Any) -> str:
    return variable.unit or getattr(variable.declaredType, "unit", None) or ""


def _is_difference(variable: Any) -> bool:
    own = variable.relativeQuantity
    return bool(getattr(variable.declaredType, "relativeQuantity", False) if own is None else own)


def _unit(name: str, definitions: Mapping[str, Any], expected: Unit) -> Unit | None:
    """Return a unit as the FMU defines it, else as its name says it; None where neither is known.

    A definition without any number says nothing. One without rad may be of a tool to which rad is 1: then the name
    counts if it says the same otherwise.
    """
    definition = definitions.get(name)
    base = definition and definition.baseUnit
    defined = base and Unit(tuple(getattr(base, part) for part in _BASES), base.factor, base.offset)
    if not defined or (defined == _si() and name not in _ONE):
        return _meant_by(name)
    if defined.exponents[:-1] == expected.exponents[:-1] and expected.exponents[-1] and not defined.exponents[-1]:
        meant = _meant_by(name)
        is_same = meant and math.isclose(meant.factor, defined.factor, rel_tol=_ROUNDING)
        if meant and is_same and meant.exponents == expected.exponents:
            return meant
    return defined


@functools.cache
def _meant_by(name: str) -> Unit | None:
    """Return what pint knows of a unit, which may be written as Modelica does: N.m, kg.m2, rad.s-1."""
    if name in _ONE:
        return _si()
    if len(name) > _LONGEST or _POWER_OF_NUMBER.search(name):  # pint would work out 9^9^9
        return None
    text = _EXPONENT.sub(r"\1**\2", _TIMES.sub("*", name))
    try:
        zero, one, two = (_pint().Quantity(value, text).to_base_units() for value in (0.0, 1.0, 2.0))
        offset, factor = float(zero.magnitude), float(one.magnitude - zero.magnitude)
        exponents = dict(one.unit_items())
        numbers = [exponents.pop(base, 0) for base in _OF_PINT]
    except Exception:  # noqa: BLE001 - pint raises whatever its parser meets
        return None
    is_linear = math.isclose(float(two.magnitude), 2.0 * factor + offset, rel_tol=1e-9)  # not so with a dB
    if exponents.keys() - {"count"} or any(number != int(number) for number in numbers) or not is_linear:
        return None
    return Unit(tuple(map(int, numbers)), factor, offset)


@functools.cache
def _pint() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(cache_folder=None)
    for words in ("rev = turn", "Nm = newton * meter", "@alias ohm = Ohm", "@alias percent = pct"):
        registry.define(words)
    return registry
