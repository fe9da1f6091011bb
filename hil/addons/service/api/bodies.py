"""The arguments of orders, checked for form: names, types, finite numbers, ranges.

Only the control process knows whether an order is possible now. The same models check HTTP bodies and the arguments on
the WebSocket, and make up the OpenAPI document.
"""

import json
import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    Field,
    FiniteFloat,
    StrictBool,
    StrictInt,
    StrictStr,
    model_validator,
)

from hil.addons.service.messages import Action, Limits

Scalar = StrictBool | StrictInt | FiniteFloat | StrictStr
Option = Scalar | list[Scalar]

_MOST_HEADING_RAD = 1000.0
_LONGEST_ECHO = 80
_OF_OURS = "Value error, "  # pydantic's prefix of a ValueError's text


class Body(BaseModel, extra="forbid", strict=True, allow_inf_nan=False):
    """An order without arguments. Unknown names are refused, and so are numbers written as strings."""

    @model_validator(mode="before")
    @classmethod
    def _of_characters(cls, values: object) -> object:
        """Refuse bytes, and a lone surrogate: JSON can carry it, but no file, log or answer can."""
        try:
            json.dumps(values, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("a text in it is not Unicode: it has a lone surrogate") from None
        except TypeError:
            raise ValueError("it was not sent as JSON") from None
        except RecursionError:
            raise ValueError("it is nested too deeply") from None
        return values


class Reference(BaseModel, extra="allow", strict=True, allow_inf_nan=False):
    """A path to follow, as in the scenario's ``[reference]``: keys other than ``kind`` are the kind's own."""

    __pydantic_extra__: dict[str, Option] = Field(init=False)

    kind: str = Field(min_length=1, max_length=100, description="circle, hold, ...; `hil list references` prints all")


class Track(Body):
    """Follow a path."""

    reference: Reference | None = Field(default=None, description="null for that of the configuration")
    here: bool = Field(
        default=False, description="start it at the robot's pose; otherwise the robot first drives to its start"
    )


class Gains(Body):
    """Change gains of the law, which is made anew: a law in a file is read again."""

    gains: dict[str, Option] = Field(default={}, description="changes by name")


class Record(Body):
    """Record to a file."""

    name: str | None = Field(
        default=None,
        min_length=5,
        max_length=200,
        pattern=r"\.(rrd|mcap)$",
        description="a new .rrd or .mcap file in the service's folder; null for a name by scenario and time",
    )


def bodies(limits: Limits) -> Mapping[Action, type[Body]]:
    """Return the body of every action, with the ranges of this service."""

    def within(limit: float, description: str) -> Any:
        return Field(ge=-limit, le=limit, description=description)

    class Twist(Body):
        """Drive by twist, in the body frame, for as long as the service's twist timeout."""

        vx_m_s: float = within(limits.speed_m_s, "forward [m/s]")
        vy_m_s: float = within(limits.speed_m_s, "to the left [m/s]")
        yaw_rate_rad_s: float = within(limits.yaw_rate_rad_s, "counter-clockwise [rad/s]")

    class Go(Body):
        """Drive to a pose in the world frame, by the shorter turn."""

        x_m: float = within(limits.distance_m, "[m]")
        y_m: float = within(limits.distance_m, "[m]")
        heading_rad: float = within(_MOST_HEADING_RAD, "[rad]")

    class Wheels(Body):
        """Command the wheels for as long as the service's twist timeout, in place of its law."""

        command: Literal["speed", "torque"] = Field(description="as controller.command of the configuration")
        values: list[Annotated[float, Field(ge=-limits.wheel, le=limits.wheel)]] = Field(
            min_length=4, max_length=4, description="FL, FR, RR, RL [rad/s or N·m]"
        )
        sequence: int | None = Field(
            default=None, ge=0, le=2**53, description="grows with each command, so that a late one is dropped"
        )

    return {
        **dict.fromkeys(Action, Body),
        Action.TWIST: Twist,
        Action.WHEELS: Wheels,
        Action.GO: Go,
        Action.TRACK: Track,
        Action.GAINS: Gains,
        Action.RECORD: Record,
    }


def sentence(errors: Iterable[Mapping[str, Any]]) -> str:
    """Return pydantic's errors as a sentence."""
    return "; ".join(map(_part, errors))


def _part(error: Mapping[str, Any]) -> str:
    where = ".".join(str(part) for part in error["loc"] if part != "body")
    if error["type"] == "extra_forbidden":
        return f"{where}: unknown name"
    if error["type"] == "json_invalid":
        return f"the body is not JSON: {error['ctx']['error']}"
    if error["type"] == "missing":
        return f"{where or 'the body'} is missing"
    given = ""
    if isinstance(error["input"], bool | int | float | str):
        value = repr(error["input"])
        given = f" = {value[:_LONGEST_ECHO]}{'…' * (len(value) > _LONGEST_ECHO)}"
    return f"{where or 'the body'}{given}: {re.sub('^(Input|String) ', 'it ', error['msg'].removeprefix(_OF_OURS))}"
