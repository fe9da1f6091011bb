"""The rows of a scenario that make it a test: ``[[fault]]``, what goes wrong, and ``[[expect]]``, what must hold."""

import math
from typing import Any

from pydantic import Field, model_validator

from hil.faults.kind import NEVER_NS, NS_PER_S, FaultRow
from hil.faults.kinds import find
from hil.scenario.fields import Table, Text

_NUMBERS = ("value", "burst_frames", "x_m", "y_m", "radius_m")


class FaultTable(Table):
    """``[[fault]]``: one fault in start_s <= t < end_s of the scenario's time; hil/faults/FAULTS.md has every kind."""

    kind: Text = Field(description="of the fault; `hil list faults` prints them all")
    target: Text = Field(description="what it acts on; may be left out where the kind has but one")
    start_s: float = Field(default=0.0, ge=0, le=1e6)
    end_s: float = Field(default=math.inf, gt=0, allow_inf_nan=True)
    value: float | None = Field(default=None, description="how much, in the kind's unit")
    burst_frames: float | None = Field(default=None, description="of burst_loss: mean length of a burst")
    x_m: float | None = Field(default=None, description="of slip_patch: centre of the circle, world frame")
    y_m: float | None = Field(default=None, description="of slip_patch: centre of the circle, world frame")
    radius_m: float | None = Field(default=None, description="of slip_patch: radius of the circle")

    @model_validator(mode="before")
    @classmethod
    def _filled(cls, given: Any) -> Any:
        """Give a row the target and the numbers that its kind has by default."""
        if not isinstance(given, dict):
            return given
        if not isinstance(given.get("kind"), str):
            return {"target": "?"} | given  # of the kind alone there is something to say
        target = given.get("target")
        try:
            kind = find(given["kind"], target if isinstance(target, str) else None)
        except ValueError:
            return {"target": "?"} | given  # of the kind alone there is something to say
        defaults: dict[str, object] = {
            quantity.name: quantity.default
            for quantity in (kind.value, *kind.further)
            if quantity is not None and quantity.default is not None
        }
        if len(kind.targets) == 1:
            defaults["target"] = kind.targets[0]
        return defaults | given

    @model_validator(mode="after")
    def _consistent(self) -> "FaultTable":
        kind = find(self.kind, self.target)
        kind.check_target(self.target, self.value)
        kind.check_numbers({name: getattr(self, name) for name in _NUMBERS})
        if kind.is_instant and self.end_s != math.inf:
            raise ValueError(f"end_s = {self.end_s}: {kind.name} happens at start_s and has no end; remove end_s")
        if math.isnan(self.end_s) or self.end_s <= self.start_s:
            raise ValueError(f"end_s = {self.end_s} is not after start_s = {self.start_s}")
        return self

    @property
    def row(self) -> FaultRow:
        """The row as what applies it needs it."""
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
        """What the row's account counts."""
        return find(self.kind, self.target).counts

    @property
    def words(self) -> str:
        """The row in a few words, for reports."""
        end = "" if self.end_s == math.inf else f" to {self.end_s:g} s"
        value = "" if self.value is None else f" {self.value:g}"
        return f"{self.kind} {self.target}{value} from {self.start_s:g} s{end}"


class ExpectTable(Table):
    """``[[expect]]``: what holds of a signal in from_s <= t <= to_s of the run.

    One of: ``below`` or ``above`` or both; ``within`` = [low, high], both included; ``equals`` with a ``tolerance``;
    ``settles_to`` with a ``tolerance``: from some time on it stays that near, until to_s.
    """

    signal: Text = Field(description="a dotted name, of the vocabulary or an extra one of the run")
    from_s: float = Field(default=0.0, ge=0)
    to_s: float = Field(default=math.inf, gt=0, allow_inf_nan=True)
    below: float | None = None
    above: float | None = None
    within: tuple[float, float] | None = Field(default=None, description="lowest and highest value that pass")
    equals: float | None = None
    settles_to: float | None = None
    tolerance: float | None = Field(default=None, ge=0, description="of equals (by default 0) and settles_to")

    @model_validator(mode="after")
    def _consistent(self) -> "ExpectTable":
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
        if math.isnan(self.to_s) or self.to_s < self.from_s:
            raise ValueError(f"to_s = {self.to_s} is before from_s = {self.from_s}")
        return self
