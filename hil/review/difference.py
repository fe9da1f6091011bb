"""Comparison of two runs: the difference of every figure, which is better, and how their scenarios and code differ."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hil.judge.figures import figures, number
from hil.judge.measure import Figure
from hil.record.properties import HASHES, PROPERTY_WORDS, hash_text
from hil.review.figures import json_object, scenario_of
from hil.review.reader import RecordedRun

_SAME = 1e-9


class Difference(NamedTuple):
    """A figure of both runs; ``difference`` is second minus first, in the unit in which the figure is stored.

    ``verdict`` says whether the second run is better, worse or the same. It is None for a figure of which neither more
    nor less is better, when a run ended early, and when a run lacks the figure (``notes`` has the reason). Runs that
    differ by less than the figure's resolution are the same. ``of_machine``: whether it depends on how fast this
    machine is.
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
    of_machine: bool = False


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
        nothing, text = ("not recorded", hash_text) if is_hash else ("not given", str)
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
            verdict = _verdict(figure, one, other) if both_ended else None
        rows.append(Difference(label, name, unit, scale, one, other, difference, verdict, notes, figure.of_machine))
    return rows


def changes(first: RecordedRun, second: RecordedRun) -> list[Change]:
    """Return what differs between the two runs.

    First come the law's code and gains, the FMU, the firmware, the map, the seed and the link; then the other values of
    the scenario; then versions, commit and machine. Code and files go by their hashes. What only follows from another
    change is left out.
    """
    left_out = {"scenario", "scenario_sources", "started", "gains", *HASHES}
    scenarios, others = [], []
    for run in (first, second):
        gains = {f"controller.gains.{name}": value for name, value in json_object(run, "gains").items()}
        scenarios.append(gains | scenario_of(run))
        others.append({name: text for name, text in run.properties.items() if name not in left_out})
    if all(scenarios):
        others = [{name: text for name, text in one.items() if name not in _IN_SCENARIO} for one in others]
    hashes = [one for one in _unequal(first.properties, second.properties, HASHES) if not _follows(one, first, second)]
    found = [*hashes, *_unequal(scenarios[0], scenarios[1])]
    return [*sorted(found, key=_group), *_unequal(others[0], others[1])]


_IN_SCENARIO = ("scenario_sha256", "seed", "law", "mode", "link", "command")
_GROUPS = (
    ("law_", "shadow_laws_", "controller."),
    ("fmu_", "cosim_", "plant.fmu"),
    ("wheel_host_", "motors_file_", "firmware."),
    ("map_", "plant.map."),
    ("loop.seed",),
    ("link.",),
)
"""What is told first of the changes, by how their keys begin."""


def _group(change: Change) -> int:
    return next((place for place, begins in enumerate(_GROUPS) if change.key.startswith(begins)), len(_GROUPS))


def _follows(change: Change, first: RecordedRun, second: RecordedRun) -> bool:
    """Whether a native library is another one because its sources are."""
    sources = change.key.replace("_sha256", "_sources_sha256")
    hashes = {run.properties.get(sources) for run in (first, second)}
    return sources != change.key and None not in hashes and len(hashes) == 2


def _verdict(figure: Figure, first: float, second: float) -> str | None:
    if figure.better is None:
        return None
    if abs(second - first) < figure.resolution or math.isclose(first, second, rel_tol=_SAME):
        return "same"
    return "better" if (second < first) == (figure.better == "less") else "worse"


def _unequal(first: Mapping[str, Any], second: Mapping[str, Any], keys: Sequence[str] = ()) -> Iterator[Change]:
    for key in keys or dict.fromkeys([*first, *second]):
        if first.get(key) != second.get(key):
            yield Change(key, first.get(key), second.get(key))
