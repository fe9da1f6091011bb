"""Options of a law or a reference: a mapping from a scenario, checked against a dataclass.

The dataclass is the only definition: its fields are the names, its annotations the types, its defaults the
defaults, and its ``__post_init__`` raises ValueError for what is out of range.
"""

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Literal, TypeVar, get_args, get_origin, get_type_hints

from hil.core.errors import BadInputError, nearest

T = TypeVar("T")


def build(kind: type[T], options: Mapping[str, object], where: str) -> T:
    """Return ``kind(**options)``; ``where`` is the dotted scenario key of the table, for messages.

    An int is taken for a float. Annotations other than float, int, bool, str, Literal and tuple[int, ...] are not
    checked here. Raises BadInputError for an unknown or missing name, a wrong type, a number that is not finite, and
    for a ValueError of the dataclass itself.
    """
    if not is_dataclass(kind):
        raise BadInputError(f"{where}: {kind.__qualname__} that holds its defaults must be a dataclass")
    known = {f.name: f for f in fields(kind) if f.init}
    hints = get_type_hints(kind)
    values: dict[str, object] = {}
    for name, value in options.items():
        if name not in known:
            hint = nearest(name, known) or "; it takes none"
            raise BadInputError(f"{where}: unknown option {name!r}{hint}")
        values[name] = _checked(value, hints[name], f"{where}.{name}")
    for name, f in known.items():
        if name not in values and f.default is MISSING and f.default_factory is MISSING:
            raise BadInputError(f"{where}.{name} is missing: it has no default, give it a value")
    try:
        return kind(**values)
    except ValueError as error:
        raise BadInputError(f"{where}: {error}") from error


def require_positive(options: object, *names: str) -> None:
    """Raise ValueError unless each named attribute is more than zero; for a ``__post_init__``."""
    for name in names:
        value = getattr(options, name)
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} = {value!r}: expected a finite number, more than zero")


def require_not_negative(options: object, *names: str) -> None:
    """Raise ValueError unless each named attribute is zero or more; for a ``__post_init__``."""
    for name in names:
        value = getattr(options, name)
        if not (math.isfinite(value) and value >= 0.0):
            raise ValueError(f"{name} = {value!r}: expected a finite number, zero or more")


def _checked(value: object, hint: object, where: str) -> object:
    if get_origin(hint) is Literal:
        choice = get_args(hint)
        if value not in choice:
            if not isinstance(value, str) and str(value) in choice:
                raise BadInputError(f'{where} = {value!r}: expected a text, in quotes: "{value}"')
            raise BadInputError(f"{where} = {value!r}: not one of the choices{nearest(str(value), choice)}")
        return value
    if hint is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInputError(f"{where} = {value!r}: expected a number")
        try:
            number = float(value)
        except OverflowError:  # a whole number with more than 308 digits
            number = math.inf
        if not math.isfinite(number):
            raise BadInputError(f"{where} = {str(value)[:20]}: expected a finite number")
        return number
    if hint == tuple[int, ...]:
        if not isinstance(value, list | tuple) or not all(type(item) is int for item in value):
            raise BadInputError(f"{where} = {value!r}: expected a list of whole numbers")
        return tuple(value)
    expected = {int: "a whole number", bool: "true or false", str: "a string"}
    for kind, name in expected.items():
        if hint is kind and (not isinstance(value, kind) or (kind is int and isinstance(value, bool))):
            raise BadInputError(f"{where} = {value!r}: expected {name}")
    return value
