"""Types of values that are more than a number: texts, options of unknown type, start values, milliseconds."""

import math
import re
from collections.abc import Mapping
from pathlib import PurePath
from typing import Annotated, Any

Scalar = float | int | bool | str
OptionValue = Scalar | tuple[Scalar, ...]
StartValue = float | bool | str


def is_path(name: str) -> bool:
    """Return whether a name is the path of a file, and not a shipped name."""
    return "/" in name or "\\" in name or PurePath(name).suffix != ""


def _text(value: str) -> str:
    if not value or re.search(r"[\x00-\x1f\x7f]", value):
        raise ValueError("expected text of one line, not empty")
    return value


def _option(value: object) -> OptionValue:
    """Accept any option; its law or reference checks the names, types and ranges."""
    if isinstance(value, list | tuple):
        return tuple(map(_scalar, value))
    return _scalar(value)


def _scalar(value: object) -> Scalar:
    if isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise ValueError("expected a finite number, text, true or false, or an array of these")


def _start(value: object) -> StartValue:
    """Accept any start value; the FMU's description has the type and range."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int) and -(2**63) <= value < 2**64:
        return float(value) if abs(value) <= 2**53 else value  # 24 and 24.0 give the same scenario
    if isinstance(value, float) and math.isfinite(value):
        return value
    raise ValueError("expected a finite number, a whole one within 64 bits, true or false, or text")


def _setting(value: object) -> object:
    """Accept any setting of a driver: an option, or a table of settings."""
    if isinstance(value, Mapping):
        return {_text(str(key)): _setting(item) for key, item in value.items()}
    return _option(value)


def _milliseconds(value: float) -> float:
    if abs(value * 1000.0 - round(value * 1000.0)) > 1e-6:
        raise ValueError("expected a whole number of milliseconds, such as 0.025")
    return value


Text = Annotated[str, _text]
Milliseconds = Annotated[float, _milliseconds]
AnyOption = Annotated[Any, _option]
Setting = Annotated[Any, _setting]
Start = Annotated[StartValue, _start]
