"""The tables of a hunt's file, and the cases that they allow: values of the scenario's keys, and faults."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

from hil.core.options import POSITIVE, Range, build
from hil.scenario.values import AnyOption, Text

FAULT_NUMBERS = ("start_s", "duration_s", "value", "burst_frames", "x_m", "y_m", "radius_m")
"""The numbers of a fault, each of which may have a range."""
_MS = 0.001
_STEPS = 4
"""By default a number has this many decimal digits within its range."""
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

    @property
    def options(self) -> Sequence[Any]:
        """The single values; without any, it is the numbers from low to high."""
        return self.one_of or ()

    @property
    def low(self) -> float:
        """The least number."""
        return (self.uniform or self.log_uniform or (0.0, 1.0))[0]

    @property
    def high(self) -> float:
        """The greatest number."""
        return (self.uniform or self.log_uniform or (0.0, 1.0))[1]

    def at(self, share: float) -> Any:
        """Return the value at a share of the range, from 0 to 1."""
        if self.options:
            return self.options[min(int(share * len(self.options)), len(self.options) - 1)]
        if self.log_uniform:
            return self.rounded(math.exp(math.log(self.low) + share * math.log(self.high / self.low)))
        return self.rounded(self.low + share * (self.high - self.low))

    def rounded(self, value: float) -> float:
        """Return the nearest number that is allowed; with a logarithm at least four digits are kept."""
        step = self.step or 10.0 ** (math.floor(math.log10(self.high - self.low)) - _STEPS)
        if self.log_uniform:
            step = min(step, 10.0 ** (math.floor(math.log10(value)) - _STEPS))
        return min(max(float(f"{round(value / step) * step:.12g}"), self.low), self.high)

    def share(self, value: float) -> float:
        """Return at which share of the range a number is, from 0 to 1."""
        value = min(max(value, self.low), self.high)
        if self.log_uniform:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


def _span(value: object) -> SpanTable:
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
        """The values that its numbers may have, by name; times are multiples of 1 ms by default."""
        given = {name: getattr(self, name) for name in FAULT_NUMBERS}
        spans = {
            name: _span(value) if isinstance(value, float) else value
            for name, value in given.items()
            if value is not None
        }
        return {
            name: replace(span, step=span.step or _MS) if name.endswith("_s") and not span.options else span
            for name, span in spans.items()
        }


@dataclass(frozen=True)
class HuntTables:
    """A hunt's file."""

    runs: Annotated[int, Range(ge=1, le=1_000_000), "the most that the search does; shrinking takes some more"] = 1000
    seed: Annotated[int, Range(ge=0, le=2**32 - 1), "of the search"] = 1
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


class Chosen(NamedTuple):
    """A fault of a case: which of the file's it is, and its target and numbers."""

    offer: int
    given: Mapping[str, Any]


class Change(NamedTuple):
    """A run that a hunt may do: what differs from the scenario; ``values`` are keys of it."""

    values: Mapping[str, Any] = {}
    faults: tuple[Chosen, ...] = ()


Params = Mapping[str, float | int]
"""A case as the optimiser sees it: by name a share from 0 to 1, or the number of an option; all have the same names."""
Suggest = Callable[[str, int], float | int]
"""Chooses one of n options by its number, or, if n is 0, a share from 0 to 1."""


class Space:
    """All cases of a hunt. ``nominal`` are the scenario's own values of the keys with a range, where it has them.

    A case has places for as many faults as it may have; each has a choice, 0 for no fault, and the numbers of a fault.
    """

    def __init__(self, tables: HuntTables, nominal: Mapping[str, Any]) -> None:
        self.ranges: Mapping[str, SpanTable] = tables.range
        self.nominal = {key: nominal[key] for key in self.ranges if key in nominal}
        self.kinds = [offer.kind for offer in tables.fault]
        self.offers = [offer.spans for offer in tables.fault]
        self._choices = [(offer, target) for offer, one in enumerate(tables.fault) for target in one.target]
        self._slots = [f"fault {slot}" for slot in range(tables.at_once if tables.fault else 0)]
        self._numbers = list(dict.fromkeys(itertools.chain.from_iterable(self.offers)))

    def suggested(self, suggest: Suggest) -> Params:
        """Return a case that ``suggest`` chooses name by name."""
        params: dict[str, float | int] = {key: suggest(key, len(one.options)) for key, one in self.ranges.items()}
        for slot in self._slots:
            params[slot] = suggest(slot, 1 + len(self._choices))
            params |= {f"{slot} {name}": suggest(f"{slot} {name}", 0) for name in self._numbers}
        return params

    def options(self, name: str) -> int:
        """Return how many options a name of ``Params`` has; 0 for a share."""
        if name in self.ranges:
            return len(self.ranges[name].options)
        return 1 + len(self._choices) if name in self._slots else 0

    def case(self, params: Params) -> Change:
        """Return the case of these parameters. Two slots with the same fault at the same time are one fault."""
        values = {
            key: dimension.options[int(params[key])] if dimension.options else dimension.at(params[key])
            for key, dimension in self.ranges.items()
        }
        changed = {key: value for key, value in values.items() if key not in self.nominal or value != self.nominal[key]}
        faults = {repr(one): one for slot in self._slots if (one := self._chosen(params, slot)) is not None}
        return Change(changed, tuple(faults[text] for text in sorted(faults)))

    def _chosen(self, params: Params, slot: str) -> Chosen | None:
        if not params[slot]:
            return None
        offer, target = self._choices[int(params[slot]) - 1]
        numbers = {name: one.at(params[f"{slot} {name}"]) for name, one in self.offers[offer].items()}
        return Chosen(offer, {"target": target, **numbers})

    def coincident(self, params: Params, *, at_end: bool) -> Params:
        """Return a case whose second fault begins just as the first one begins, or, with ``at_end``, as it ends."""
        first, second = [*(self._chosen(params, slot) for slot in self._slots[:2]), None, None][:2]
        if first is None or second is None or (start := self.offers[second.offer]["start_s"]).options:
            return params
        at_s = first.given["start_s"] + (first.given.get("duration_s", 0.0) if at_end else 0.0)
        return {**params, f"{self._slots[1]} start_s": start.share(at_s)}

    @cached_property
    def nominal_params(self) -> Params:
        """The parameters nearest to the scenario as it is, without faults."""
        params: dict[str, float | int] = {}
        for key, dimension in self.ranges.items():
            value = self.nominal.get(key)
            if dimension.options:
                params[key] = dimension.options.index(value) if value in dimension.options else 0
            else:
                is_number = isinstance(value, int | float) and not isinstance(value, bool)
                params[key] = dimension.share(float(value)) if is_number else 0.5  # type: ignore[arg-type]
        for slot in self._slots:
            params |= {slot: 0, **{f"{slot} {name}": 0.5 for name in self._numbers}}
        return params

    def singles(self) -> list[list[Params]]:
        """Return cases in which one thing alone differs: for each key those at its ends, for each fault some.

        A fault is tried at its strongest and longest, early and late.
        """
        found: list[list[Params]] = []
        for key, dimension in self.ranges.items():
            ends: Sequence[float | int] = range(len(dimension.options)) or (0.0, 1.0)
            found.append([{**self.nominal_params, key: end} for end in ends if end != self.nominal_params[key]])
        for choice, (offer, _) in enumerate(self._choices if self._slots else (), 1):
            slot = self._slots[0]
            strongest = {f"{slot} {name}": 1.0 for name in self.offers[offer]}
            starts = (0.0,) if self.offers[offer]["start_s"].options else (0.2, 0.7)
            found.append([{**self.nominal_params, slot: choice, **strongest, f"{slot} start_s": at} for at in starts])
        return found

    def combined(self, params: Sequence[Params]) -> Params:
        """Return the case that has what differs in all of these, the first first; there may be too many faults."""
        result = dict(self.nominal_params)
        slots = iter(self._slots)
        for one in params:
            changed = {name: value for name, value in one.items() if value != self.nominal_params[name]}
            if not self._slots or not one[self._slots[0]]:
                result |= changed
            elif (slot := next(slots, None)) is not None:
                result |= {f"{slot}{name.removeprefix(self._slots[0])}": value for name, value in changed.items()}
        return result
