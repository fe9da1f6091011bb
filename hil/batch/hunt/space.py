"""The cases of a hunt: which values the keys of the scenario and the numbers of the faults may have."""

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

    def at(self, share: float) -> float:
        """Return the number at a share of the range, from 0 to 1."""
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
"""A case as the optimiser sees it: by name a share from 0 to 1, or the number of an option."""
Suggest = Callable[[str, int], float | int]
"""Chooses one of n options by its number, or, if n is 0, a share from 0 to 1."""


class Space:
    """All cases of a hunt. ``nominal`` are the scenario's own values of the keys with a range, where it has them."""

    def __init__(self, tables: HuntTables, nominal: Mapping[str, Any]) -> None:
        self.ranges = {key: Dimension.of(span) for key, span in tables.range.items()}
        self.nominal = {key: nominal[key] for key in self.ranges if key in nominal}
        self.kinds = [offer.kind for offer in tables.fault]
        self.offers = [
            {"target": Dimension(options=offer.target)}
            | {name: Dimension.of(span, _MS if name.endswith("_s") else None) for name, span in offer.spans.items()}
            for offer in tables.fault
        ]
        self._slots = tables.at_once if tables.fault else 0

    def suggested(self, suggest: Suggest) -> Params:
        """Return a case that ``suggest`` chooses name by name; which names there are depends on the faults chosen."""
        params: dict[str, float | int] = {key: suggest(key, len(one.options)) for key, one in self.ranges.items()}
        for slot in range(self._slots):
            which = f"fault {slot}"
            params[which] = suggest(which, 1 + len(self.offers))
            if (offer := int(params[which]) + NO_FAULT) != NO_FAULT:
                for name, dimension in self.offers[offer].items():
                    if len(dimension.options) != 1:
                        params[f"{which} {offer} {name}"] = suggest(f"{which} {offer} {name}", len(dimension.options))
        return params

    def options(self, name: str) -> int:
        """Return how many options a name of ``Params`` has; 0 for a share."""
        if name in self.ranges:
            return len(self.ranges[name].options)
        _, _, *rest = name.split(" ")
        return len(self.offers[int(rest[0])][rest[1]].options) if rest else 1 + len(self.offers)

    def case(self, params: Params) -> Case:
        """Return the case of these parameters. Two slots with the same fault at the same time are one fault."""
        values = {key: _value(dimension, params[key]) for key, dimension in self.ranges.items()}
        faults: list[Chosen] = []
        for slot in range(self._slots):
            if (offer := int(params[f"fault {slot}"]) + NO_FAULT) != NO_FAULT:
                given = {
                    name: _value(dimension, params.get(f"fault {slot} {offer} {name}", 0))
                    for name, dimension in self.offers[offer].items()
                }
                if (one := Chosen(offer, given)) not in faults:
                    faults.append(one)
        return Case(self._changed(values), tuple(sorted(faults, key=lambda one: (one.offer, repr(one.given)))))

    def _changed(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in values.items() if key not in self.nominal or value != self.nominal[key]}

    @cached_property
    def nominal_params(self) -> Params:
        """The parameters nearest to the scenario as it is, without faults."""
        params: dict[str, float | int] = dict.fromkeys((f"fault {slot}" for slot in range(self._slots)), 0)
        for key, dimension in self.ranges.items():
            value = self.nominal.get(key)
            if dimension.options:
                params[key] = dimension.options.index(value) if value in dimension.options else 0
            else:
                is_number = isinstance(value, int | float) and not isinstance(value, bool)
                params[key] = dimension.share(float(value)) if is_number else 0.5  # type: ignore[arg-type]
        return params

    def singles(self) -> list[list[Params]]:
        """Return cases in which one thing alone differs: for each key those at its ends, for each fault some.

        A fault is tried at its strongest and longest, early and late.
        """
        found: list[list[Params]] = []
        for key, dimension in self.ranges.items():
            ends: Sequence[float | int] = range(len(dimension.options)) or (0.0, 1.0)
            found.append([{**self.nominal_params, key: end} for end in ends if end != self.nominal_params[key]])
        for offer, dimensions in enumerate(self.offers if self._slots else ()):
            starts = (0.2, 0.7) if not dimensions["start_s"].options else (0,)
            for target in range(len(dimensions["target"].options)):
                numbers = {name: 0 if one.options else 1.0 for name, one in dimensions.items()}
                given = [{**numbers, "target": target, "start_s": start} for start in starts]
                named = [{f"fault 0 {offer} {name}": value for name, value in one.items()} for one in given]
                found.append([{**self.nominal_params, "fault 0": 1 + offer, **one} for one in named])
        return found

    def combined(self, params: Sequence[Params]) -> Params:
        """Return the case that has what differs in all of these, the first first; there may be too many faults."""
        result = dict(self.nominal_params)
        slot = 0
        for one in params:
            if not one.get("fault 0"):
                result |= {key: value for key, value in one.items() if value != self.nominal_params[key]}
            elif slot < self._slots:
                here = {name: value for name, value in one.items() if name.startswith("fault 0")}
                result |= {f"fault {slot}{name.removeprefix('fault 0')}": value for name, value in here.items()}
                slot += 1
        return result


def _value(dimension: Dimension, param: float | int) -> Any:
    return dimension.options[int(param)] if dimension.options else dimension.at(float(param))
