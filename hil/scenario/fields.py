"""What the tables of a scenario are made of: the base of all, and the types that are more than a number."""

import math
import re
from collections.abc import Mapping
from pathlib import PurePath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, PlainValidator

Scalar = float | int | bool | str
OptionValue = Scalar | tuple[Scalar, ...]
StartValue = float | bool | str


def is_path(name: str) -> bool:
    """Return whether a name is a path to a file, and not the name of something shipped."""
    return "/" in name or "\\" in name or PurePath(name).suffix != ""


def _text(value: str) -> str:
    if not value or re.search(r"[\x00-\x1f\x7f]", value):
        raise ValueError("expected text of one line, not empty")
    return value


def _whole_milliseconds(value: float) -> float:
    if abs(value * 1000.0 - round(value * 1000.0)) > 1e-6:
        raise ValueError("expected a whole number of milliseconds, such as 0.025")
    return value


def _option(value: object) -> OptionValue:
    """Accept what an option may be at all; its law or reference checks the names, types and ranges."""
    return tuple(map(_scalar, value)) if isinstance(value, tuple) else _scalar(value)


def _scalar(value: object) -> Scalar:
    if isinstance(value, str | int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise ValueError("expected a finite number, text, true or false, or an array of these")


def _setting(value: object) -> object:
    """Accept what a setting of a driver may be at all: an option, or a table of them."""
    if isinstance(value, Mapping):
        return {_text(str(key)): _setting(item) for key, item in value.items()}
    return _option(value)


def _start(value: object) -> StartValue:
    """Accept what a variable of an FMU may start with; the FMU's description tells the type and range."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int) and -(2**63) <= value < 2**64:
        return float(value) if abs(value) <= 2**53 else value  # 24 and 24.0 are one scenario
    if isinstance(value, float) and math.isfinite(value):
        return value
    raise ValueError("expected a finite number, a whole one within 64 bits, true or false, or text")


Text = Annotated[str, AfterValidator(_text)]
Milliseconds = Annotated[float, AfterValidator(_whole_milliseconds)]
Option = Annotated[Any, PlainValidator(_option)]
Setting = Annotated[Any, PlainValidator(_setting)]
Start = Annotated[StartValue, PlainValidator(_start)]


class Table(BaseModel):
    """What all tables share: frozen, no unknown key, finite numbers, no conversion but int to float."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
