"""The tables of a hunt's file: every key once, with its default and meaning."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from hil.core.options import POSITIVE, Range, build
from hil.scenario.values import AnyOption, Text

FAULT_NUMBERS = ("start_s", "duration_s", "value", "burst_frames", "x_m", "y_m", "radius_m")
"""The numbers of a fault, each of which may have a range."""
_INSTEAD = {"fault": "[[fault]]", "expect": "the scenario's [[expect]]", "loop.mode": "--mode"}


@dataclass(frozen=True)
class SpanTable:
    """The values that a key may have. Exactly one of the first three is given."""

    uniform: Annotated[tuple[float, float] | None, "[low, high]; the same as [low, high] without a table"] = None
    log_uniform: Annotated[tuple[float, float] | None, "[low, high], searched by the logarithm"] = None
    one_of: Annotated[tuple[AnyOption, ...] | None, "single values, of any type"] = None
    step: Annotated[float | None, POSITIVE, "values are multiples of it; by default a 10,000th of the range"] = None

    def __post_init__(self) -> None:
        given = [one for one in (self.uniform, self.log_uniform, self.one_of) if one is not None]
        if len(given) != 1:
            raise ValueError("expected one of uniform, log_uniform, one_of, or [low, high]")
        if self.one_of is not None and (not self.one_of or self.step is not None):
            raise ValueError("one_of takes at least one value, and no step")
        for name, limits in (("uniform", self.uniform), ("log_uniform", self.log_uniform)):
            if limits is not None and limits[0] >= limits[1]:
                raise ValueError(f"{name} = {list(limits)}; expected [low, high] with low < high")
        if self.log_uniform is not None and self.log_uniform[0] <= 0.0:
            raise ValueError(f"log_uniform = {list(self.log_uniform)}; expected numbers greater than 0")


def _span(value: object) -> SpanTable:
    """Return the values for a table, [low, high], or a single number."""
    if isinstance(value, Mapping):
        return build(SpanTable, value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return SpanTable(one_of=(float(value),))
    if isinstance(value, tuple) and len(value) == 2:
        return build(SpanTable, {"uniform": value})
    raise ValueError("expected [low, high], or one of { uniform = [low, high] }, log_uniform, one_of")


def _targets(value: object) -> tuple[str, ...]:
    targets = (value,) if isinstance(value, str) else value
    if isinstance(targets, tuple) and targets and all(isinstance(one, str) for one in targets):
        return targets
    raise ValueError("expected a target, or an array of targets")


Span = Annotated[Any, _span]


@dataclass(frozen=True)
class OfferTable:
    """``[[fault]]``: a fault that a run may have besides the scenario's own; hil/faults/FAULTS.md has every kind."""

    kind: Annotated[Text, "as in [[fault]] of a scenario"]
    target: Annotated[Any, _targets, "one, or an array of which one is chosen"] = ("",)
    start_s: Annotated[Any, _span, "when it begins"] = 0.0
    duration_s: Annotated[Any, _span, "for how long; by default to the end"] = None
    value: Annotated[Any, _span, "its size"] = None
    burst_frames: Span = None
    x_m: Span = None
    y_m: Span = None
    radius_m: Span = None

    @property
    def spans(self) -> dict[str, SpanTable]:
        """The values that its numbers may have, by name."""
        given = {name: getattr(self, name) for name in FAULT_NUMBERS}
        return {
            name: _span(value) if isinstance(value, float) else value
            for name, value in given.items()
            if value is not None
        }


@dataclass(frozen=True)
class HuntTables:
    """A hunt's file."""

    runs: Annotated[int, Range(ge=1, le=1_000_000), "the most that the search does; shrinking takes some more"] = 1000
    minutes: Annotated[float | None, POSITIVE, "the longest that it takes"] = None
    seed: Annotated[int, Range(ge=0, le=2**32 - 1), "of the search"] = 1
    ends: Annotated[bool, "whether a run that ends early, crashes or hangs is looked for too"] = True
    at_once: Annotated[int, Range(ge=0, le=10), "how many of the faults a run may have"] = 1
    set: Annotated[Mapping[Text, Any], "keys of the scenario that all runs share"] = field(default_factory=dict)
    range: Annotated[Mapping[Text, Span], "by the scenario's dotted keys"] = field(default_factory=dict)
    fault: tuple[OfferTable, ...] = ()

    def __post_init__(self) -> None:
        if not self.range and not self.fault:
            raise ValueError("it has neither [range] nor [[fault]], so that there is nothing to look for; add one")
        for key in self.range:
            if key.partition(".")[0] in _INSTEAD or key in _INSTEAD:
                raise ValueError(f"range {key}: give {_INSTEAD.get(key) or _INSTEAD[key.partition('.')[0]]} instead")
            if key in self.set:
                raise ValueError(f"{key} is in [set] and in [range]; give it once")
