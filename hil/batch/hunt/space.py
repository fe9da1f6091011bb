"""The cases of a hunt: which values the keys of the scenario and the numbers of the faults may have."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

from hil.batch.hunt.tables import HuntTables, SpanTable

NO_FAULT = -1
_MS = 0.001
_STEPS = 4
"""By default a number has this many decimal digits within its range."""


class Dimension(NamedTuple):
    """The values of one key: those of ``options``, or, if there are none, the numbers from low to high."""

    low: float = 0.0
    high: float = 1.0
    is_log: bool = False
    step: float = 0.0
    options: Sequence[Any] = ()

    @classmethod
    def of(cls, span: SpanTable, step: float | None = None) -> "Dimension":
        """Return the values that a table gives; ``step`` is that of numbers for which it gives none."""
        if span.one_of is not None:
            return cls(options=span.one_of)
        low, high = span.uniform or span.log_uniform or (0.0, 1.0)
        step = span.step or step or 10.0 ** (math.floor(math.log10(high - low)) - _STEPS)
        return cls(low, high, span.log_uniform is not None, step)

    def at(self, share: float) -> Any:
        """Return the value at a share of the range, from 0 to 1."""
        if self.options:
            return self.options[min(int(share * len(self.options)), len(self.options) - 1)]
        if self.is_log:
            return self.rounded(math.exp(math.log(self.low) + share * math.log(self.high / self.low)))
        return self.rounded(self.low + share * (self.high - self.low))

    def rounded(self, value: float) -> float:
        """Return the nearest number that is allowed; with a logarithm at least four digits are kept."""
        step = min(self.step, 10.0 ** (math.floor(math.log10(value)) - _STEPS)) if self.is_log else self.step
        return min(max(float(f"{round(value / step) * step:.12g}"), self.low), self.high)

    def share(self, value: float) -> float:
        """Return at which share of the range a number is, from 0 to 1."""
        value = min(max(value, self.low), self.high)
        if self.is_log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


class Chosen(NamedTuple):
    """A fault of a case: which of the file's it is, and its target and numbers."""

    offer: int
    given: Mapping[str, Any]


class Case(NamedTuple):
    """A run that a hunt may do: what differs from the scenario.

    ``values`` are keys of the scenario; ``duration_s`` is the run's, None for the scenario's own.
    """

    values: Mapping[str, Any] = {}
    faults: tuple[Chosen, ...] = ()
    duration_s: float | None = None


Params = Mapping[str, float | int]
"""A case as the optimiser sees it: by name a share from 0 to 1, or the number of an option; all have the same names."""
Suggest = Callable[[str, int], float | int]
"""Chooses one of n options by its number, or, if n is 0, a share from 0 to 1."""


class Space:
    """All cases of a hunt. ``nominal`` are the scenario's own values of the keys with a range, where it has them.

    A case has places for as many faults as it may have; each has a choice, 0 for no fault, and the numbers of a fault.
    """

    def __init__(self, tables: HuntTables, nominal: Mapping[str, Any]) -> None:
        self.ranges = {key: Dimension.of(span) for key, span in tables.range.items()}
        self.nominal = {key: nominal[key] for key in self.ranges if key in nominal}
        self.kinds = [offer.kind for offer in tables.fault]
        self.offers = [
            {name: Dimension.of(span, _MS if name.endswith("_s") else None) for name, span in offer.spans.items()}
            for offer in tables.fault
        ]
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

    def case(self, params: Params) -> Case:
        """Return the case of these parameters. Two slots with the same fault at the same time are one fault."""
        values = {
            key: dimension.options[int(params[key])] if dimension.options else dimension.at(params[key])
            for key, dimension in self.ranges.items()
        }
        changed = {key: value for key, value in values.items() if key not in self.nominal or value != self.nominal[key]}
        faults = {repr(one): one for slot in self._slots if (one := self._chosen(params, slot)) is not None}
        return Case(changed, tuple(faults[text] for text in sorted(faults)))

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
