"""The figures of a run as text, for the terminal and for its page.

No side effects: the JSON of a run in, pairs of a label and a text out.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from hil.judge.expectations import Count, allow_figures
from hil.judge.figures import figures, number
from hil.scenario.trial import AllowTable

Row = tuple[str, str]

SCHEMA = "hil.run/1"
"""Name and version of a run's JSON; ``run.schema.json`` beside this file describes it."""
LENIENT = "judged by [[expect]] alone: not by [allow], the baseline, or whether every fault was applied"


def with_page(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON of a run with its rows as ``page``, and ``why`` it did not pass, for what a recording shows."""
    page: list[Row] = []
    if (passed := metrics.get("passed")) is not None:
        page.append(("passed", "yes" if passed else "no"))
    if metrics.get("failure") is not None:
        page.append(("failure", str(metrics["failure"])))
    for rows in (outcome_rows, figure_rows, belief_rows, link_rows):
        page += rows(metrics)
    why = list(why_not_passed(metrics)) if "allow" in metrics else [("failure", metrics["failure"])]
    return {**metrics, "page": page, "why": why}


def figure_rows(metrics: Mapping[str, Any], *, machine: bool = True) -> Iterator[Row]:
    """Yield the figures that are printed, and the reason for each one that is None.

    ``machine``: also those that depend on how fast this machine is, and the counts of frames.
    """
    reasons = metrics.get("reasons", {})
    for figure in figures():
        if not figure.printed or (figure.of_machine and not machine):
            continue
        if (value := number(metrics, figure.name)) is not None:
            yield figure.label, f"{value * figure.scale:.5g} {figure.unit}".rstrip()
        elif (name := figure.name.partition(".")[0]) in reasons:
            yield figure.label, f"-      {reasons[name]}"
    if machine:
        yield from _machine_rows(metrics)
        yield from frame_rows(metrics)


def _machine_rows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield tick times, lateness, and what was granted of real time."""
    tick = metrics.get("tick_us")
    if tick is not None:
        yield "tick p50, p99", f"{tick['p50']:.1f}, {tick['p99']:.1f} µs"
    late = metrics.get("lateness_us")
    if late is not None and late["max"] > 0.0:  # in lockstep no tick can be late
        shown = ", ".join(f"{late[name]:.0f}" for name in ("p50", "p99", "p99.9", "max"))
        yield "late p50, 99, 99.9, max", f"{shown} µs"
    if (realtime := metrics.get("realtime")) is not None:
        yield "granted", "; ".join(realtime["granted"].values()) or "nothing"
        for sentence in realtime["refused"].values():
            yield "not granted", sentence


def frame_rows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield the counts of frames."""
    frames = metrics.get("frames")
    if frames is not None:
        rejected = _by_cause(frames["rejected"]) or "none"
        traffic = f"{frames['sent']} sent, {frames['received']} received since connecting, without HELLO"
        yield "frames", f"{traffic}; rejected: {rejected}"


def link_rows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield the statistics of the link (hil/wire/STATISTICS.md), as far as there are some."""
    link = metrics.get("link_statistics")
    if link is None:
        return
    ways = [way for way in ("sent", "received", "foreign") if (link.get(way) or {}).get("frames")]
    traffic = ", ".join(_traffic(link, way) for way in ways) or "nothing"
    yield "on the wire", f"{traffic}, since the first ACTIVE tick"
    for way, load in (link.get("load") or {}).items():
        if load["mean_percent"] is not None:
            worst = load["worst_100_ms_percent"]
            yield f"load, {way}", f"{load['mean_percent']:.1f} %, in the worst 100 ms {worst:.1f} %"
    lost = {name.replace("_", " "): count for name, count in (link.get("lost") or {}).items() if count}
    if lost:
        yield "lost", ", ".join(f"{name} {count}" for name, count in lost.items())
    for label, name in (("feedback age p50, p99", "feedback_age_ms"), ("round trip p50, p99", "round_trip_ms")):
        if (figure := link.get(name)) is not None:
            yield label, f"{figure['p50']:.3g}, {figure['p99']:.3g} ms"
    if (clock := link.get("clock")) is not None:
        drift_ppm = clock["drift_ppm"]  # NaN, or null in a recording, while the run is too short for it
        drift = "" if drift_ppm is None or math.isnan(drift_ppm) else f", drift {drift_ppm:+.1f} ppm"
        yield "robot's clock", f"{clock['offset_us'] * 1e-3:+.3f} ms{drift}"
        way = clock["round_trip_us"]
        yield "TIME_SYNC p50, p99", f"{way['p50']:.0f}, {way['p99']:.0f} µs"


def belief_rows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield the estimate's error, the pose fixes, and the ticks in which the robot was not driven."""
    error = metrics.get("estimation_error")
    if error is not None and error["rms_m"] > 0.0:
        yield "estimate's error", f"{error['rms_m'] * 1e3:.3g} mm rms, {error['max_m'] * 1e3:.3g} mm max"
    if (fixes := metrics.get("pose_fixes")) is not None:
        counts = [
            f"{name}: {_by_cause(count)}" if isinstance(count, Mapping) else f"{count} {name.replace('_', ' ')}"
            for name, count in fixes.items()
            if count
        ]
        yield "pose fixes", ", ".join(counts) or "none came"
    if refused := metrics.get("commands_refused"):
        yield "law", f"its command was not finite {refused} times, and the robot was held at rest"
    if stale := metrics.get("stale_ticks"):
        yield "stale", f"{stale} ticks, in which the feedback or the truth was too old: the robot was not driven"
    if held := metrics.get("held_ticks"):
        yield "held", f"{held} ticks, in which the state was unknown, the estimator lost, or the robot away"
    if slipped := metrics.get("robot_slipped_ticks"):
        yield "virtual robot", f"lost {slipped} ms of its time to stalls of this machine"


def outcome_rows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield faults, recoveries, expectations (see ``in_order``), broken allowances, and what the recording lacks.

    First the mutant, if ``hil verify`` has put one in.
    """
    if (mutant := metrics.get("mutant")) is not None:
        yield "mutant", f"{mutant}, a known defect that hil verify has put in"
    for row in metrics.get("fault") or ():
        yield "fault", applied_words(row)
    for row in metrics.get("recoveries") or ():
        yield "recovery", f"lost at {row['lost_s']:.3f} s, ACTIVE again at {row['armed_s']:.3f} s: {row['why']}"
    for row in in_order(metrics.get("expect") or ()):
        yield "expect", row["text"]
    for row in metrics.get("allow") or ():
        if not row["passed"]:
            yield "allow", row["text"]
    yield from baseline_rows(metrics)
    if metrics.get("lenient"):
        yield "lenient", LENIENT
    for row in metrics.get("shadows") or ():
        if row["dropped"] is not None:
            yield "shadow", row["dropped"]
    recorded = metrics.get("recorded")
    if recorded is not None and (text := recording_words(recorded, metrics["recording"])):
        yield "recording", text


def why_not_passed(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield kind and sentence for each reason why a run did not pass, causes before their consequences.

    A run without any has passed. Of a recording without a summary only its failure and expectations are known.
    """
    if metrics["failure"] is not None:
        yield "failure", metrics["failure"]
    yield from (("expectation", row["text"]) for row in in_order(metrics["expect"] or ()) if row["passed"] is False)
    if metrics["lenient"]:
        return
    yield from (("allow", row["text"]) for row in metrics["allow"] or () if not row["passed"])
    # A fault that was never applied proves nothing.
    yield from (("fault", applied_words(row)) for row in metrics["fault"] or () if not row["applied"])
    baseline = metrics.get("baseline") or {"figures": (), "frames": None}
    yield from (("baseline", row["text"]) for row in baseline["figures"])
    if (frames := baseline["frames"]) is not None and frames["passed"] is False:
        yield "baseline", frames["text"]


def baseline_rows(metrics: Mapping[str, Any]) -> Iterator[Row]:
    """Yield how a run compares with its scenario's baseline, if there is one."""
    if (baseline := metrics.get("baseline")) is None:
        return
    if baseline["why"] is not None:
        yield "baseline", f"not judged against the baseline: {baseline['why']}"
        return
    yield from (("baseline", row["text"]) for row in baseline["figures"])
    frames = baseline["frames"]
    if frames is not None and not frames["passed"]:
        yield "baseline", frames["text"]
    same = "" if frames is None or not frames["passed"] else ", and the same frames"
    held = baseline["judged"] - len(baseline["figures"])
    yield "baseline", f"{held} of {baseline['judged']} figures as accepted{same}"
    if baseline["figures"] or (frames is not None and frames["passed"] is False):
        yield "baseline", accept_words(metrics)


def accept_words(metrics: Mapping[str, Any]) -> str:
    """Return what to do where a run is not as its baseline has it."""
    explore = "" if metrics.get("lenient") else ", or explore with --lenient"
    return f"find what changed; accept it with `hil baseline --accept`{explore}"


def judged(metrics: dict[str, Any]) -> dict[str, Any]:
    """Set ``passed`` in the JSON of a run that is complete but for it, and return the JSON."""
    metrics["passed"] = next(why_not_passed(metrics), None) is None
    return metrics


def set_lost_rows(metrics: dict[str, Any], allow: AllowTable, lost: int) -> None:
    """Set how many rows the recording of a run lacks, and judge the run anew."""
    metrics["lost_rows"] = lost
    row = allow_figures(allow, {"lost_rows": Count(lost, lost)}, metrics["ticks"])
    metrics["allow"] = [one for one in metrics["allow"] or () if one["name"] != "lost_rows"] + row
    judged(metrics)


def in_order(expect: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the rows of expectations: the failed ones by time, then those not judged, then those that held."""
    return sorted(expect, key=urgency)


def urgency(row: Mapping[str, Any]) -> tuple[int, float]:
    """Return a key to sort rows of expectations by, as ``in_order`` does; a row of an older version may lack a time."""
    passed, at_s = row["passed"], row.get("violation_s")
    return 1 if passed is None else 2 * passed, math.inf if at_s is None else at_s


def applied_words(fault: Mapping[str, Any]) -> str:
    """Return a sentence on what a fault of a run did, from its entry in the run's JSON."""
    if fault["applied"] is None:
        return f"{fault['text']}: not known how often it was applied, because the robot has gone"
    if not fault["applied"]:
        return f"{fault['text']}: never applied, so the run shows nothing about it"
    times = "once" if fault["applied"] == 1 else f"{fault['applied']} times"
    return f"{fault['text']}: applied {times} ({fault['counts']})"


def recording_words(recorded: Mapping[str, Any], path: str | None) -> str:
    """Return what a recording lacks, why, and where the rest is; empty when all is in one file."""
    parts = f" in {len(recorded['parts'])} parts" if len(recorded["parts"]) > 1 else ""
    if (why := why_incomplete(recorded)) is not None:
        path = recorded_at(recorded, path)
        events = f", {recorded['events_lost']} events lost" if recorded["events_lost"] else ""
        rest = "" if path is None else f", {recorded['rows']} are safe in {path}{parts}"
        counts = f"{recorded['dropped']} rows were dropped and {recorded['lost']} lost{events}"
        return f"incomplete: {why}; {counts}{rest}"
    if recorded["troubles"]:
        return f"complete{parts}, though {'; '.join(recorded['troubles'])}"
    return f"complete{parts}" if parts else ""


def why_incomplete(recorded: Mapping[str, Any]) -> str | None:
    """Return why a recording is incomplete, or None for a complete one."""
    if recorded["error"] or recorded["dropped"] or recorded["lost"] or recorded["events_lost"]:
        return recorded["error"] or "the recorder was too slow"
    return None


def recorded_at(recorded: Mapping[str, Any], path: str | None) -> str | None:
    """Return the first file of a recording that is still there; ``path`` is its first file."""
    return path if path in recorded["parts"] else next(iter(recorded["parts"]), None)


def _by_cause(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} {count}" for cause, count in counts.items())


def _traffic(link: Mapping[str, Any], way: str) -> str:
    return f"{way} {link[way]['frames']} frames, {link[way]['bytes'] * 1e-3:.1f} kB"
