"""What an order says, checked for form: names, types, finite numbers, ranges; not whether it makes sense now.

The same models check HTTP bodies and the arguments on the WebSocket, and make up the OpenAPI document.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, StrictBool, StrictInt, StrictStr, create_model

from hil.service.api_config import Limits
from hil.service.messages import Action

Scalar = StrictBool | StrictInt | FiniteFloat | StrictStr
Option = Scalar | list[Scalar]


class Body(BaseModel):
    """An order without arguments. Names that it does not know are refused, and so are numbers as strings."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class Reference(BaseModel):
    """A path to follow, as in the scenario's ``[reference]``: keys other than ``kind`` are the kind's own."""

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)
    __pydantic_extra__: dict[str, Option] = Field(init=False)

    kind: str = Field(min_length=1, max_length=100, description="circle, hold, ...; `hil list references` prints all")


class Track(Body):
    """Follow a path."""

    reference: Reference | None = Field(default=None, description="null for that of the configuration")
    here: bool = Field(default=False, description="begin it where the robot stands; else it drives to its begin first")


class Gains(Body):
    """Change the law's own numbers."""

    gains: dict[str, Option] | None = Field(
        default=None, description="by name, over those of the configuration; null reads its file again"
    )


class Record(Body):
    """Record to a file."""

    path: str | None = Field(
        default=None,
        min_length=5,
        max_length=1000,
        pattern=r"\.(rrd|mcap)$",
        description="an .rrd or .mcap file, as the service's user sees it; null for a name by scenario and time",
    )


def bodies(limits: Limits) -> Mapping[Action, type[Body]]:
    """Return the body of every action, with the ranges of this service."""

    def within(limit: float, description: str) -> Any:
        return (float, Field(ge=-limit, le=limit, description=description))

    twist = create_model(
        "Twist",
        __base__=Body,
        __doc__="Drive by twist, in the body frame, for as long as the service's twist timeout.",
        vx_m_s=within(limits.speed_m_s, "forward [m/s]"),
        vy_m_s=within(limits.speed_m_s, "to the left [m/s]"),
        yaw_rate_rad_s=within(limits.yaw_rate_rad_s, "counter-clockwise [rad/s]"),
    )
    go = create_model(
        "Go",
        __base__=Body,
        __doc__="Drive to a pose in the world frame, by the shorter turn.",
        x_m=within(limits.distance_m, "[m]"),
        y_m=within(limits.distance_m, "[m]"),
        heading_rad=within(_MOST_HEADING_RAD, "[rad]"),
    )
    with_arguments: dict[Action, type[Body]] = {
        Action.TWIST: twist,
        Action.GO: go,
        Action.TRACK: Track,
        Action.GAINS: Gains,
        Action.RECORD: Record,
    }
    return {action: with_arguments.get(action, Body) for action in Action}


def sentence(errors: Iterable[Mapping[str, Any]]) -> str:
    """Return what pydantic found wrong, as a sentence."""
    return "; ".join(_part(error) for error in errors)


def _part(error: Mapping[str, Any]) -> str:
    where = ".".join(str(part) for part in error["loc"] if part != "body")
    if error["type"] == "extra_forbidden":
        return f"{where}: there is no such name"
    if error["type"] == "json_invalid":
        return f"the body is no JSON: {error['ctx']['error']}"
    if error["type"] == "missing":
        return f"{where or 'the body'} is missing"
    value = error["input"]
    given = f" = {value!r}" if isinstance(value, bool | int | float | str) else ""
    return f"{where}{given}: {re.sub('^(Input|String) ', 'it ', error['msg'])}"


_MOST_HEADING_RAD = 1000.0
