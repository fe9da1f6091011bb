"""Comparison of two runs: the difference of every figure, which is better, and how their scenarios and code differ."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hil.judge.figures import figures, number
from hil.record.properties import HASHES, PROPERTY_WORDS, hash_text
from hil.review.figures import json_object, scenario_of
from hil.review.reader import RecordedRun

_SAME = 1e-9


class Difference(NamedTuple):
    """A figure of both runs; ``difference`` is second minus first, in the unit in which the figure is stored.

    ``verdict`` says whether the second run is better, worse or the same. It is None for a figure of which neither more
    nor less is better, when a run ended early, and when a run lacks the figure (``notes`` has the reason).
    """

    label: str
    name: str
    unit: str
    scale: float
    first: float | None
    second: float | None
    difference: float | None
    verdict: str | None
    notes: tuple[str, ...]


class Change(NamedTuple):
    """A value of the scenario, or a property of the run, that differs; None where a run lacks it."""

    key: str
    first: object
    second: object

    def words(self) -> tuple[str, str, str]:
        """Return the key and both values as text; of a hash a label and the first digits.

        Older recordings lack some hashes: they are "not recorded".
        """
        is_hash = self.key in HASHES
        nothing, text = ("not recorded", hash_text) if is_hash else ("-", str)
        first, second = (nothing if value is None else text(str(value)) for value in (self.first, self.second))
        return PROPERTY_WORDS[self.key] if is_hash else self.key, first, second


def differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[Difference]:
    """Return every figure that one of two runs has, from their figures as ``hil.review.review`` returns them."""
    both_ended = all(run.get("failure") is None for run in (first, second))
    rows = []
    for figure in figures():
        name, label, unit, scale = figure[:4]
        one, other = number(first, name), number(second, name)
        if one is None and other is None:
            continue
        notes = tuple(
            f"{which} has none: {reason}"
            for which, value, run in (("the first", one, first), ("the second", other, second))
            if value is None and (reason := run.get("reasons", {}).get(name.partition(".")[0])) is not None
        )
        difference = verdict = None
        if one is not None and other is not None:
            difference = other - one
            verdict = _verdict(figure.better, one, other) if both_ended else None
        rows.append(Difference(label, name, unit, scale, one, other, difference, verdict, notes))
    return rows


def changes(first: RecordedRun, second: RecordedRun) -> list[Change]:
    """Return what differs between the two runs.

    First come code, FMU, map and native libraries, by their hashes; then the scenario with all options of the law; then
    seed, versions, commit and machine.
    """
    left_out = {"scenario", "scenario_sources", "started", "gains", *HASHES}
    scenarios, others = [], []
    for run in (first, second):
        gains = {f"controller.gains.{name}": value for name, value in json_object(run, "gains").items()}
        scenarios.append(gains | scenario_of(run))
        others.append({name: text for name, text in run.properties.items() if name not in left_out})
    hashes = _unequal(first.properties, second.properties, HASHES)
    return [*hashes, *_unequal(scenarios[0], scenarios[1]), *_unequal(others[0], others[1])]


def _verdict(better: str | None, first: float, second: float) -> str | None:
    if better is None:
        return None
    if math.isclose(first, second, rel_tol=_SAME):
        return "same"
    return "better" if (second < first) == (better == "less") else "worse"


def _unequal(first: Mapping[str, Any], second: Mapping[str, Any], keys: Sequence[str] = ()) -> Iterator[Change]:
    for key in keys or dict.fromkeys([*first, *second]):
        if first.get(key) != second.get(key):
            yield Change(key, first.get(key), second.get(key))
