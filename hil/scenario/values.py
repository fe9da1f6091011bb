"""Types of values that are more than a number: texts, options of unknown type, start values, milliseconds, files."""

import hashlib
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

from hil.core.options import size_words
from hil.core.types import WHEEL_NAMES
from hil.core.wheel_map import ImuMount

Scalar = float | int | bool | str
OptionValue = Scalar | tuple[Scalar, ...]
StartValue = float | bool | str


def is_path(name: str) -> bool:
    """Return whether a name is the path of a file, and not a shipped name."""
    return "/" in name or "\\" in name or PurePath(name).suffix != ""


def check(is_valid: Callable[[Any], bool], expected: str) -> Callable[[Any], Any]:
    """Return a check for ``Annotated``: it returns a valid value, and raises ValueError for another."""

    def checked(value: Any) -> Any:
        if not is_valid(value):
            raise ValueError(f"expected {expected}")
        return value

    return checked


_text = check(lambda text: text and not re.search(r"[\x00-\x1f\x7f]", text), "text of one line, not empty")
_milliseconds = check(
    lambda s: abs(s * 1000.0 - round(s * 1000.0)) <= 1e-6, "a whole number of milliseconds, such as 0.025"
)


def _option(value: object) -> OptionValue:
    """Accept any option; its law or reference checks the names, types and ranges."""
    return tuple(map(_scalar, value)) if isinstance(value, list | tuple) else _scalar(value)


def _scalar(value: object) -> Scalar:
    if isinstance(value, str | int) or (isinstance(value, float) and _is_usable(value)):
        return value
    raise ValueError("expected a finite number, text, true or false, or an array of these")


def _is_usable(number: float) -> bool:
    """Return whether a number is finite. Raises ValueError for a size that nothing has."""
    if math.isfinite(number) and (words := size_words(number)) is not None:
        raise ValueError(f"expected {words}")
    return math.isfinite(number)


def _start(value: object) -> StartValue:
    """Accept any start value; the FMU's description has the type and range."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int) and -(2**63) <= value < 2**64:
        return float(value) if abs(value) <= 2**53 else value  # 24 and 24.0 give the same scenario
    if isinstance(value, float) and _is_usable(value):
        return value
    raise ValueError("expected a finite number, a whole one within 64 bits, true or false, or text")


def _setting(value: object) -> object:
    """Accept any setting of a driver: an option, or a table of settings."""
    if isinstance(value, Mapping):
        return {_text(str(key)): _setting(item) for key, item in value.items()}
    return _option(value)


Wheel = Literal["fl", "fr", "rr", "rl"]
each_once = check(lambda wheels: sorted(wheels) == sorted(WHEEL_NAMES), 'each of "fl", "fr", "rr" and "rl" once')
at_most_once = check(lambda wheels: len(set(wheels)) == len(wheels), "each wheel at most once")


def right_handed(axes: tuple[str, ...]) -> tuple[str, ...]:
    """Check the axes of an IMU; see ``ImuMount``."""
    ImuMount(axes)
    return axes


Axis = Literal["x", "-x", "y", "-y", "z", "-z"]
Axes3 = tuple[Axis, Axis, Axis]
Text = Annotated[str, _text]
Milliseconds = Annotated[float, _milliseconds]
AnyOption = Annotated[Any, _option]
Setting = Annotated[Any, _setting]
Start = Annotated[StartValue, _start]


def sha256_of(path: Path) -> str | None:
    """Return the SHA-256, in hex, of a file; None where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
