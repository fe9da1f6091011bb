"""Comparison of two runs: the difference of every figure, which is better, and how their scenarios and code differ."""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from hil.judge.figures import figures, number
from hil.record.properties import HASHES, PROPERTY_WORDS, hash_text
from hil.review.figures import scenario_of
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
        if self.key not in HASHES:
            return self.key, _text(self.first, "-"), _text(self.second, "-")
        first, second = (
            "not recorded" if value is None else hash_text(str(value)) for value in (self.first, self.second)
        )
        return PROPERTY_WORDS[self.key], first, second


def _text(value: object, nothing: str) -> str:
    return nothing if value is None else str(value)


def differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[Difference]:
    """Return every figure that one of two runs has, from their figures as ``hil.review.review`` returns them."""
    return list(_differences(first, second))


def changes(first: RecordedRun, second: RecordedRun) -> list[Change]:
    """Return what differs between the two runs.

    First come code, FMU, map and native libraries, by their hashes; then the scenario with all options of the law; then
    seed, versions, commit and machine.
    """
    runs = first, second
    hashes = [{name: run.properties[name] for name in HASHES if name in run.properties} for run in runs]
    scenarios = [_gains_of(run) | scenario_of(run) for run in runs]
    left_out = {"scenario", "scenario_sources", "started", "gains", *HASHES}
    about = [{name: text for name, text in run.properties.items() if name not in left_out} for run in runs]
    return [*sorted(_unequal(*hashes), key=_place), *_unequal(*scenarios), *_unequal(*about)]


def _gains_of(run: RecordedRun) -> dict[str, object]:
    """Return every option of a run's law, defaults included, by its key in the scenario."""
    try:
        gains = json.loads(run.properties.get("gains", "{}"))
    except ValueError:
        return {}
    return {f"controller.gains.{name}": value for name, value in gains.items()} if isinstance(gains, dict) else {}


def _place(change: Change) -> int:
    return HASHES.index(change.key)


def _differences(first: Mapping[str, Any], second: Mapping[str, Any]) -> Iterator[Difference]:
    both_ended = all(run.get("failure") is None for run in (first, second))
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
        if one is None or other is None:
            yield Difference(label, name, unit, scale, one, other, None, None, notes)
            continue
        verdict = _verdict(figure.better, one, other) if both_ended else None
        yield Difference(label, name, unit, scale, one, other, other - one, verdict, notes)


def _verdict(better: str | None, first: float, second: float) -> str | None:
    if better is None:
        return None
    if math.isclose(first, second, rel_tol=_SAME):
        return "same"
    return "better" if (second < first) == (better == "less") else "worse"


def _unequal(first: Mapping[str, Any], second: Mapping[str, Any]) -> Iterator[Change]:
    for key in dict.fromkeys([*first, *second]):
        if first.get(key) != second.get(key):
            yield Change(key, first.get(key), second.get(key))
