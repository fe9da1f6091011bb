"""The tables that make a scenario a test: ``[[fault]]``, ``[[expect]]`` and ``[allow]``."""

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any

from hil.core.options import Expected, OptionsError, Problem, Range
from hil.faults.kind import NEVER_NS, NS_PER_S, FaultRow
from hil.faults.kinds import find, names
from hil.scenario.values import Text

_NUMBERS = ("value", "burst_frames", "x_m", "y_m", "radius_m")
_SHARE = re.compile(r"(\d+(?:\.\d+)?) ?%")


@dataclass(frozen=True)
class FaultTable:
    """``[[fault]]``: one fault in start_s <= t < end_s of the scenario's time; hil/faults/FAULTS.md has every kind."""

    kind: Annotated[Text, Expected(f"a kind of fault, one of {', '.join(names())}"), "`hil list faults` prints all"]
    target: Annotated[Text, "what it acts on; may be left out if the kind has only one target"] = ""
    start_s: Annotated[float, Range(ge=0, le=1000000.0)] = 0.0
    end_s: Annotated[float, Range(gt=0, infinite=True)] = math.inf
    value: Annotated[float | None, "size of the fault, in the unit of its kind"] = None
    burst_frames: Annotated[float | None, "of burst_loss: mean length of a burst"] = None
    x_m: Annotated[float | None, "of slip_patch: centre of the circle, world frame"] = None
    y_m: Annotated[float | None, "of slip_patch: centre of the circle, world frame"] = None
    radius_m: Annotated[float | None, "of slip_patch: radius of the circle"] = None

    def __post_init__(self) -> None:
        """Fill in the defaults of the kind; raise ValueError for values that the kind does not take."""
        kind = find(self.kind, self.target or None)
        defaults: dict[str, Any] = {
            quantity.name: quantity.default for quantity in (kind.value, *kind.further) if quantity is not None
        }
        if len(kind.targets) == 1:
            defaults["target"] = kind.targets[0]
        for name, default in defaults.items():
            if getattr(self, name) in (None, ""):
                object.__setattr__(self, name, default)
        if not self.target:
            expected = f"expected what {self.kind} acts on: {kind.target_words.replace('`', '')}"
            raise OptionsError([Problem(("target",), "missing", expected)])
        kind = find(self.kind, self.target)
        kind.check_target(self.target, self.value)
        kind.check_numbers({name: getattr(self, name) for name in _NUMBERS})
        if kind.is_instant and self.end_s != math.inf:
            raise ValueError(f"end_s = {self.end_s}: {kind.name} happens at start_s and has no end; remove end_s")
        if self.end_s <= self.start_s:
            raise ValueError(f"end_s = {self.end_s} is not after start_s = {self.start_s}")

    @property
    def row(self) -> FaultRow:
        """The row as numbers, for the code that applies it."""
        return FaultRow(
            self.kind,
            find(self.kind, self.target).acts_on,
            self.target,
            round(self.start_s * NS_PER_S),
            NEVER_NS if self.end_s > 1e9 else round(self.end_s * NS_PER_S),
            *(0.0 if (value := getattr(self, name)) is None else float(value) for name in _NUMBERS),
        )

    @property
    def counts(self) -> str:
        """The unit of the count of this fault in a report."""
        return find(self.kind, self.target).counts

    @property
    def words(self) -> str:
        """The row in a few words, for reports."""
        end = "" if self.end_s == math.inf else f" to {self.end_s:g} s"
        value = "" if self.value is None else f" {self.value:g}"
        return f"{self.kind} {self.target}{value} from {self.start_s:g} s{end}"


@dataclass(frozen=True)
class ExpectTable:
    """``[[expect]]``: a claim about a signal in from_s <= t <= to_s of the run.

    One of: ``below`` or ``above`` or both; ``within`` = [low, high], both included; ``equals`` with a ``tolerance``;
    ``settles_to`` with a ``tolerance``: from some time on it stays within it, until to_s.
    """

    signal: Annotated[
        Text,
        Expected("the name of a signal; `hil list signals` prints them all"),
        "dotted name of a built-in signal, or of a signal of the law",
    ]
    from_s: Annotated[float, Range(ge=0)] = 0.0
    to_s: Annotated[float, Range(gt=0, infinite=True)] = math.inf
    below: float | None = None
    above: float | None = None
    within: Annotated[tuple[float, float] | None, "lowest and highest value that pass"] = None
    equals: float | None = None
    settles_to: float | None = None
    tolerance: Annotated[float | None, Range(ge=0), "of equals (by default 0) and settles_to"] = None

    def __post_init__(self) -> None:
        bounds = self.below is not None or self.above is not None
        claims = [name for name in ("within", "equals", "settles_to") if getattr(self, name) is not None]
        if bounds + len(claims) != 1:
            raise ValueError("needs one claim: below or above or both, within, equals, or settles_to")
        if self.below is not None and self.above is not None and self.above >= self.below:
            raise ValueError(f"above = {self.above} is not less than below = {self.below}: no value can pass")
        if self.within is not None and self.within[0] > self.within[1]:
            raise ValueError(f"within = {list(self.within)}: the first is more than the second; give [low, high]")
        if self.tolerance is not None and (bounds or self.within is not None):
            raise ValueError("tolerance belongs to equals and settles_to; remove it")
        if self.settles_to is not None and not self.tolerance:
            raise ValueError("settles_to needs a tolerance of more than 0: how near is settled")
        if self.to_s < self.from_s:
            raise ValueError(f"to_s = {self.to_s} is before from_s = {self.from_s}")


def _limit(value: object) -> int | str:
    """Accept a whole number of ticks, or a share of them as text."""
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    if isinstance(value, str) and (share := _SHARE.fullmatch(value)) is not None and float(share[1]) <= 100.0:
        return value
    raise ValueError('expected a whole number of at least 0, or a share of the ticks such as "5%"')


Limit = Annotated[Any, _limit]
"""A whole number, or a share of the run's ticks as in ``"5%"``."""


@dataclass(frozen=True)
class AllowTable:
    """``[allow]``: how many events that no fault of the scenario explains a passing run may have.

    A key is the name of a figure of the run. The defaults are those of lockstep.
    """

    stale_ticks: Annotated[Limit, "ticks not driven because the feedback or the truth was too old"] = 0
    held_ticks: Annotated[
        Limit, "ticks not driven because the state was unknown, the estimator lost, or the robot away"
    ] = 0


REALTIME_ALLOW: dict[str, int | str] = {"stale_ticks": "5%", "held_ticks": "5%"}
"""The defaults in real time, where they differ: a shared machine stalls now and then."""


def most(limit: int | str, ticks: int) -> int:
    """Return the greatest number that a limit allows in a run of ``ticks``."""
    return limit if isinstance(limit, int) else int(Fraction(limit.rstrip("% ")) * ticks / 100)
