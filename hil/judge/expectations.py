"""Expectations and allowances: claims about figures and stops, what ``[allow]`` permits, and the outcomes.

No side effects. They are judged when a run is over; claims about signals are in ``hil.judge.claims``.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.core.options import options_of
from hil.judge.claims import WITHOUT_VALUE, Outcome, against, claim_of, margin
from hil.judge.figures import figures, number
from hil.judge.measure import Figure
from hil.scenario import Scenario
from hil.scenario.baseline import Baseline
from hil.scenario.trial import AllowTable, ExpectTable, FaultTable, most, span_s


class Stop(NamedTuple):
    """A robot that left ACTIVE by itself: the time [s], and a sentence with its reason."""

    t_s: float
    why: str


def figures_by_key() -> dict[str, Figure]:
    """Return every figure that a run can be judged by, by the name that users give it."""
    return {figure.key: figure for figure in figures() if figure.name != "expect"}


def check_figures(scenario: Scenario) -> None:
    """Raise BadInputError for an expectation of a figure that no run has; it says where and suggests similar names."""
    known = figures_by_key() if any(row.figure is not None for row in scenario.expect) else {}
    for i, row in enumerate(scenario.expect, start=1):
        if row.figure is not None and row.figure not in known:
            where = scenario.provenance[key := f"expect.{i}.figure"]
            hint = nearest(row.figure, known, otherwise="; `hil list figures` prints them all")
            place = where if where.startswith("--") else f"scenario {where}"
            raise BadInputError(f'{place}: {key} = "{row.figure}"; expected the name of a figure{hint}')


def figure_outcome(
    expect: ExpectTable, metrics: Mapping[str, Any], cut_s: float | None = None, baseline: Baseline | None = None
) -> Outcome:
    """Judge a claim about a figure of a run, from the run's JSON; ``baseline`` is that of its scenario.

    It fails where the run has no such figure, or the baseline that it is relative to has none. It is not judged where
    the run ended early, or cannot be compared with the baseline.
    """
    figure = figures_by_key()[str(expect.figure)]
    if expect.baseline is not None:
        of = f"{figure.key} within {expect.baseline} of the baseline"
        if cut_s is not None:
            return Outcome(None, f"{of}: not judged, the run ended at t = {cut_s:.6g} s")
        if baseline is None:
            return Outcome(False, f"{of}: failed, there is none; `hil baseline` makes it", margin=WITHOUT_VALUE)
        if (why := (metrics.get("baseline") or {}).get("why")) is not None:
            return Outcome(None, f"{of}: not judged against the baseline: {why}")
        if (band := baseline.figure.get(figure.key)) is None:
            return Outcome(False, f"{of}: failed, the baseline has no such figure", margin=WITHOUT_VALUE)
        expect = replace(expect, baseline=None, equals=band.value, tolerance=size_of(expect.baseline, band.value))
    claim = claim_of(expect)
    subject = f"{figure.key} {claim.text}"
    if cut_s is not None:
        return Outcome(None, f"{subject}: not judged, the run ended at t = {cut_s:.6g} s")
    value = number(metrics, figure.name)
    if value is None:
        why = why_none(figure, metrics)
        text = f"{subject}: failed, the run has no such figure" + (f": {why}" if why else "")
        return Outcome(False, text, margin=WITHOUT_VALUE)
    found = margin(expect, value, value)
    if claim.holds(value):
        return Outcome(True, f"{subject}: held, {against(value, claim.text, 6)}", margin=found)
    return Outcome(False, f"{subject}: failed, {against(value, claim.text, 6)}", worst_value=value, margin=found)


def stop_outcome(
    expect: ExpectTable, stops: Sequence[Stop], cut_s: float | None = None, faults: Sequence[FaultTable] = ()
) -> Outcome:
    """Judge a claim that the robot stops by itself in its time, and gives its reason.

    ``stops`` are all stops of the run, of which one is enough. ``cut_s`` is the time at which the run ended early, or
    None; a claim whose time was not over by then is not judged. ``faults`` are those of the scenario.
    """
    from_s, to_s = span_s(expect, faults)
    claim = f"the robot stops because of {expect.stops} from {from_s:g} s to {to_s:g} s"
    held = [one for one in stops if from_s <= one.t_s <= to_s and str(expect.stops) in one.why]
    if held:
        left = (to_s - held[0].t_s) / (to_s - from_s) if from_s < to_s < math.inf else 1.0
        return Outcome(True, f"{claim}: held, {held[0].why}", margin=max(left, sys.float_info.min))
    if cut_s is not None and cut_s < to_s:
        return Outcome(None, f"{claim}: not judged, the run ended at t = {cut_s:.6g} s")
    found = "; ".join(one.why for one in stops) or "it did not stop"
    return Outcome(
        False, f"{claim}: failed, {found}", violation_s=stops[0].t_s if stops else None, margin=WITHOUT_VALUE
    )


def why_none(figure: Figure, metrics: Mapping[str, Any]) -> str | None:
    """Return the reason why a run has no value of a figure, or None where its JSON gives none."""
    reason = metrics.get("reasons", {}).get(figure.name.partition(".")[0])
    return None if reason is None else str(reason)


def size_of(share: float | str, value: float) -> float:
    """Return the size of a share of a value, such as "10%", or the number itself."""
    return float(share.rstrip("% ")) / 100.0 * abs(value) if isinstance(share, str) else float(share)


def outcome_figures(expect: ExpectTable, outcome: Outcome) -> dict[str, Any]:
    """Return an expectation's outcome, in words and numbers, as a run's JSON has it."""
    fields = outcome._asdict()
    text = fields.pop("text")
    return {"signal": expect.signal, "figure": expect.figure, "stops": expect.stops, **fields, "text": text}


class Count(NamedTuple):
    """How many events of a kind a run had, and how many of them no fault of the scenario explains."""

    all: int
    unexplained: int


def rejected_and_unmatched(by_cause: Mapping[str, int]) -> tuple[int, int]:
    """Return how many frames were rejected, and how many torque feedforwards came without their command.

    ``by_cause`` is ``frames.rejected`` of a run's JSON.
    """
    unmatched = by_cause.get("robot_feedforward_unmatched", 0)
    return sum(by_cause.values()) - unmatched, unmatched


def allow_figures(allow: AllowTable, counts: Mapping[str, Count], ticks: int) -> list[dict[str, Any]]:
    """Return the outcome of each limit of ``[allow]``, in its order, in words and numbers, as a run's JSON has it.

    Keys of the table that ``counts`` does not have are left out; ``ticks`` is the number of ticks of the run.
    """
    found = []
    for name, option in options_of(AllowTable).items():
        if name not in counts:
            continue
        limit, count = getattr(allow, name), counts[name]
        allowed = most(limit, ticks)
        passed = count.unexplained <= allowed
        of = f" of {ticks}" if option.meaning.startswith("ticks") else ""
        share = f"{allowed}, {limit}" if isinstance(limit, str) else f"{allowed}"
        text = (
            f"{name}: {count.unexplained}{of} {option.meaning}; no fault of the scenario explains them, and "
            f"allow.{name} permits {share}: {'as allowed' if passed else 'find the cause, or raise it'}"
        )
        left = 1.0 - count.unexplained / (allowed + 0.5)
        found.append({"name": name, "passed": passed, **count._asdict(), "limit": limit, "margin": left, "text": text})
    return found
