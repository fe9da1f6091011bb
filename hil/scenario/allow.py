"""``[allow]``: how much may go wrong in a run that no fault of its scenario explains, before the run is not passed."""

import re
from fractions import Fraction
from typing import Annotated, Any

from pydantic import Field, PlainValidator

from hil.scenario.fields import Table

_SHARE = re.compile(r"(\d+(?:\.\d+)?) ?%")


def _limit(value: object) -> int | str:
    """Accept a whole number of ticks, or a share of them as text."""
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    if isinstance(value, str) and (share := _SHARE.fullmatch(value)) is not None and float(share[1]) <= 100.0:
        return value
    raise ValueError('expected a whole number of at least 0, or a share of the ticks such as "5%"')


Limit = Annotated[Any, PlainValidator(_limit)]
"""A whole number, or a share of the run's ticks as in ``"5%"``."""


class AllowTable(Table):
    """``[allow]``: what no fault of the scenario explains, and how much of it a run may have and still pass.

    A key is the name of a figure of the run, its description says of what. These defaults are those of lockstep.
    """

    stale_ticks: Limit = Field(default=0, description="ticks not driven because the feedback or the truth was too old")
    held_ticks: Limit = Field(
        default=0, description="ticks not driven because the state was unknown, the estimator lost, or the robot away"
    )


REALTIME_ALLOW: dict[str, int | str] = {"stale_ticks": "5%", "held_ticks": "5%"}
"""The defaults in real time where they are others: a shared machine stalls now and then."""


def most(limit: int | str, ticks: int) -> int:
    """Return the greatest number that a limit lets be in a run of so many ticks."""
    if isinstance(limit, int):
        return limit
    return int(Fraction(limit.rstrip("% ")) * ticks / 100)
