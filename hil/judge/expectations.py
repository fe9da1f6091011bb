"""Expectations and allowances: claims about figures and stops, what ``[allow]`` permits, and the outcomes.

No side effects. They are judged when a run is over; claims about signals are in ``hil.judge.claims``.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.core.options import options_of
from hil.judge.claims import WITHOUT_VALUE, against, claim_of, margin, result_of
from hil.judge.figures import figures
from hil.judge.judged_run import ExpectationResult, JudgedRun, LimitResult, decided
from hil.judge.measure import Figure
from hil.scenario import Scenario
from hil.scenario.baseline import Baseline
from hil.scenario.trial import AllowTable, ExpectTable, FaultTable, most, span_s


class Stop(NamedTuple):
    """A robot that left ACTIVE on its own: the time [s], and a sentence with its reason."""

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


def figure_result(
    expect: ExpectTable, run: JudgedRun, cut_s: float | None = None, baseline: Baseline | None = None
) -> ExpectationResult:
    """Judge a claim about a figure of a run; ``baseline`` is that of its scenario.

    It fails where the run has no such figure, or the baseline that it is relative to has none. It is not judged where
    the run ended early, or cannot be compared with the baseline.
    """
    result = partial(result_of, expect)
    figure = figures_by_key()[str(expect.figure)]
    if expect.baseline is not None:
        of = f"{figure.key} within {expect.baseline} of the baseline"
        if cut_s is not None:
            return result(None, f"{of}: not judged, the run ended at t = {cut_s:.6g} s")
        if baseline is None:
            return result(False, f"{of}: failed, there is none; `hil baseline` makes it", margin=WITHOUT_VALUE)
        if (why := None if run.baseline is None else run.baseline.why) is not None:
            return result(None, f"{of}: not judged against the baseline: {why}")
        if (band := baseline.figure.get(figure.key)) is None:
            return result(False, f"{of}: failed, the baseline has no such figure", margin=WITHOUT_VALUE)
        expect = replace(expect, baseline=None, equals=band.value, tolerance=size_of(expect.baseline, band.value))
    claim = claim_of(expect)
    subject = f"{figure.key} {claim.text}"
    if cut_s is not None:
        return result(None, f"{subject}: not judged, the run ended at t = {cut_s:.6g} s")
    value = run.number(figure.name)
    if value is None:
        why = run.why_none(figure.name)
        text = f"{subject}: failed, the run has no such figure" + (f": {why}" if why else "")
        return result(False, text, margin=WITHOUT_VALUE)
    found = margin(expect, value, value)
    if claim.holds(value):
        return result(True, f"{subject}: held, {against(value, claim.text, 6)}", margin=found)
    return result(False, f"{subject}: failed, {against(value, claim.text, 6)}", worst_value=value, margin=found)


def stop_result(
    expect: ExpectTable, stops: Sequence[Stop], cut_s: float | None = None, faults: Sequence[FaultTable] = ()
) -> ExpectationResult:
    """Judge a claim that the robot stops on its own in time, and gives its reason.

    ``stops`` are all stops of the run, of which one is enough. ``cut_s`` is the time at which the run ended early, or
    None; a claim whose time was not over by then is not judged. ``faults`` are those of the scenario.
    """
    result = partial(result_of, expect)
    from_s, to_s = span_s(expect, faults)
    claim = f"the robot stops because of {expect.stops} from {from_s:g} s to {to_s:g} s"
    held = [one for one in stops if from_s <= one.t_s <= to_s and str(expect.stops) in one.why]
    if held:
        left = (to_s - held[0].t_s) / (to_s - from_s) if from_s < to_s < math.inf else 1.0
        return result(True, f"{claim}: held, {held[0].why}", margin=max(left, sys.float_info.min))
    if cut_s is not None and cut_s < to_s:
        return result(None, f"{claim}: not judged, the run ended at t = {cut_s:.6g} s")
    found = "; ".join(one.why for one in stops) or "it did not stop"
    violation = (stops[0].t_s if stops else None, None)
    return result(False, f"{claim}: failed, {found}", violation, margin=WITHOUT_VALUE)


def size_of(share: float | str, value: float) -> float:
    """Return the size of a share of a value, such as "10%", or the number itself."""
    return float(share.rstrip("% ")) / 100.0 * abs(value) if isinstance(share, str) else float(share)


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


def limit_results(allow: AllowTable, counts: Mapping[str, Count], ticks: int) -> list[LimitResult]:
    """Return the outcome of each limit of ``[allow]``, in its order.

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
        found.append(LimitResult(name, passed, *count, limit, left, text))
    return found


def with_lost_rows(run: JudgedRun, allow: AllowTable, lost: int) -> JudgedRun:
    """Return a run whose recording lacks ``lost`` rows, judged again."""
    limits = [row for row in run.allow if row.name != "lost_rows"]
    limits += limit_results(allow, {"lost_rows": Count(lost, lost)}, run.figures["ticks"])
    counts = run.counts._replace(lost_rows=lost)
    return decided(replace(run, counts=counts, allow=limits, unknown=run.unknown - {"allow"}))
