"""Values of an FMU that may be set: at its start (``[plant.start]``), and between two ticks."""

import math
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.plant.mapping import FLOATS, INTEGERS, Variables, nearest_of

Value = float | int | bool | str


def count(variable: Any) -> int:
    """Return how many values a variable has: 1 unless it is an array."""
    return math.prod(variable.shape or ())


def limits(variable: Any) -> tuple[float, float]:
    """Return the range of a variable, its own or its type's; infinite where there is none. Integers stay integers.

    Raises BadInputError when the description gives a text that is no number.
    """
    texts = (getattr(variable, name) or getattr(variable.declaredType, name, None) for name in ("min", "max"))
    low, high = (_typed(variable, name, text) for name, text in zip(("min", "max"), texts, strict=True))
    return -math.inf if low is None else low, math.inf if high is None else high


def elements_at_start(variable: Any) -> list[Any] | None:
    """Return the start of a variable in its type, all elements of it; None when its description gives none.

    Raises BadInputError when the description gives a text that is not of this type.
    """
    if variable.start is None:
        return None
    words = (
        variable.start.split() if variable.type in FLOATS | INTEGERS | {"Boolean", "Enumeration"} else [variable.start]
    )
    values = [_typed(variable, "start", word) for word in words]
    return values * count(variable) if len(values) == 1 else values


def start_of(variable: Any) -> Value | None:
    """Return the start of a scalar in its type; None when its description gives none, and for an array.

    Raises BadInputError as ``elements_at_start``.
    """
    return None if variable.shape else next(iter(elements_at_start(variable) or ()), None)


_BOOLEANS = {"true": True, "1": True, "false": False, "0": False}  # xs:boolean


def _typed(variable: Any, attribute: str, text: str | None) -> Any:
    """Return a text of the description in the type of its variable; Binary stays hexadecimal digits, None is None."""
    kind = variable.type
    if text is None:
        return None
    try:
        if kind == "Boolean":
            return _BOOLEANS[text]
        if kind in FLOATS:
            return float(text)
        return int(text) if kind in INTEGERS | {"Enumeration"} else text
    except (KeyError, ValueError):
        expected = {"Boolean": "true or false"}.get(kind, "a number" if kind in FLOATS else "a whole number")
        raise BadInputError(
            f"the FMU's modelDescription.xml gives {variable.name} of type {kind} {attribute} = {text!r}; expected "
            f"{expected}"
        ) from None


def items_of(variable: Any) -> dict[str, int]:
    """Return the items of an enumeration, by name. Raises BadInputError for one whose value is no number."""
    items = variable.declaredType.items if variable.declaredType else ()
    return {item.name: _typed(variable, f"the item {item.name}", item.value) for item in items}


class Start(NamedTuple):
    """A variable and its start value in the type of the variable."""

    variable: Any  # FMPy's ModelVariable
    value: Value


def start_values(start: Mapping[str, Value], fmu: Path, variables: Variables) -> tuple[Start, ...]:
    """Return what to set before the initialization: parameters, inputs, and whatever has a start that may be set.

    An item of an enumeration may be given by name or number. Raises BadInputError with a line for each bad value.
    """
    values, problems = [], []
    for name, value in start.items():
        try:
            values.append(_checked(name, value, fmu, variables))
        except BadInputError as error:
            problems.append(str(error))
    if problems:
        raise BadInputError("\n".join(problems))
    return tuple(values)


def resize(starts: Iterable[Start], variables: Variables) -> None:
    """Set the sizes of arrays that structural parameters start with (FMI 3.0 section 2.4.7.3)."""
    sizes = {start.variable.valueReference: start.value for start in starts}
    for variable in variables.values():
        variable.shape = tuple(
            int(sizes.get(dimension.valueReference, dimension.variable.start))
            if dimension.start is None
            else dimension.start
            for dimension in variable.dimensions
        )


def _has_start(variable: Any) -> bool:
    """Return whether the importer may set the start of a variable (FMI 2.0 section 2.2.7, FMI 3.0 section 2.4.7.5)."""
    return variable.variability != "constant" and variable.initial in ("exact", "approx")


def _checked(name: str, value: Value, fmu: Path, variables: Variables) -> Start:
    variable = variables.get(name)
    if variable is None:
        known = [name for name, variable in variables.items() if _has_start(variable)]
        raise BadInputError(f"plant.start.{name}: {fmu.name} has no such variable{nearest_of(name, known, fmu)}")
    if not _has_start(variable):
        kind = variable.variability if variable.variability == "constant" else variable.causality
        raise BadInputError(
            f"plant.start.{name}: {fmu.name} gives this {kind} its value itself; expected a parameter, an input, or "
            "a variable with initial = exact or approx"
        )
    if variable.shape:
        raise BadInputError(f"plant.start.{name}: this variable is an array, which [plant.start] cannot set")
    return Start(variable, _converted(f"plant.start.{name} = {_written(value)}", value, variable))


def _converted(given: str, value: Value, variable: Any) -> Value:
    kind = variable.type
    if kind in ("Boolean", "String"):
        if not isinstance(value, bool if kind == "Boolean" else str):
            raise BadInputError(f"{given}; expected {'true or false' if kind == 'Boolean' else 'a text'}")
        return value
    if kind == "Enumeration":
        return _item(given, value, variable)
    if kind not in FLOATS | INTEGERS:
        raise BadInputError(f"{given}; its type {kind} cannot be set here")
    if isinstance(value, bool | str) or not math.isfinite(value):
        raise BadInputError(f"{given}; expected a finite number")
    if kind in INTEGERS:
        value = _whole(given, value, kind)
    low, high = limits(variable)
    if not low <= value <= high:
        at_least, at_most = f"at least {low:.10g}", f"at most {high:.10g}"
        between = f"a number from {low:.10g} to {high:.10g}"
        expected = at_least if math.isinf(high) else at_most if math.isinf(low) else between
        raise BadInputError(f"{given}; expected {expected}")
    return value if kind in INTEGERS else float(value)


def _whole(given: str, value: float | int, kind: str) -> int:
    bits = 32 if kind == "Integer" else int(kind.rpartition("Int")[2])
    low, high = (0, 2**bits) if kind.startswith("U") else (-(2 ** (bits - 1)), 2 ** (bits - 1))
    if value != int(value) or not low <= value < high:
        unsigned = "unsigned " if kind.startswith("U") else ""
        raise BadInputError(f"{given}; expected a whole number of {bits} bits, {unsigned}as {kind} is")
    return int(value)


def _item(given: str, value: Value, variable: Any) -> int:
    items = items_of(variable)
    if isinstance(value, str):
        if value in items:
            return items[value]
        raise BadInputError(f"{given}; expected an item of the enumeration{nearest(value, items)}")
    if isinstance(value, bool) or value not in items.values():
        choice = ", ".join(f"{name!r} ({number})" for name, number in items.items())
        raise BadInputError(f"{given}; expected one of {choice}")
    return int(value)


def _written(value: Value) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else f"{value:.10g}"
    return repr(value)


class Settable(NamedTuple):
    """A variable that may be set: its place for the shim, its value at the start, and its range in the FMU's unit."""

    place: int
    start: float
    low: float
    high: float


def settable_variables(variables: Variables, driven: Collection[str]) -> dict[str, Any]:
    """Return the scalars of a floating-point type that may be set in step mode, by name.

    FMI 2.0 section 2.2.7, FMI 3.0 section 2.4.7.4: tunable parameters, and inputs (here those not ``driven`` by us).
    """
    found = {}
    for name, variable in variables.items():
        is_tunable = variable.causality == "parameter" and variable.variability == "tunable"
        may_change = is_tunable or (variable.causality == "input" and name not in driven)
        if may_change and variable.type in FLOATS and not variable.shape and name == variable.name:
            found[name] = variable
    return found
