"""The figures of a run as text: pairs of a label and a text, for the terminal and for pages. No side effects."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from hil.judge.figures import figures
from hil.judge.judged_run import JudgedRun

Row = tuple[str, str]


def figure_rows(run: JudgedRun, *, machine: bool = True) -> Iterator[Row]:
    """Yield the figures that are printed, and the reason for each one that is None.

    ``machine``: also those that depend on how fast this machine is, and the counts of frames.
    """
    for figure in figures():
        if not figure.printed or (figure.of_machine and not machine):
            continue
        if (value := run.number(figure.name)) is not None:
            yield figure.label, f"{value * figure.scale:.5g} {figure.unit}".rstrip()
        elif (reason := run.why_none(figure.name)) is not None:
            yield figure.label, f"-      {reason}"
    if machine:
        yield from _machine_rows(run)
        yield from frame_rows(run)


def _machine_rows(run: JudgedRun) -> Iterator[Row]:
    if (tick := run.figures.get("tick_us")) is not None:
        yield "tick p50, p99", f"{tick['p50']:.1f}, {tick['p99']:.1f} µs"
    late = run.figures.get("lateness_us")
    if late is not None and late["max"] > 0.0:  # in lockstep no tick can be late
        shown = ", ".join(f"{late[name]:.0f}" for name in ("p50", "p99", "p99.9", "max"))
        yield "late p50, 99, 99.9, max", f"{shown} µs"
    if run.realtime is not None:
        yield "granted", "; ".join(run.realtime["granted"].values()) or "nothing"
        yield from (("not granted", sentence) for sentence in run.realtime["refused"].values())


def frame_rows(run: JudgedRun) -> Iterator[Row]:
    if (frames := run.figures.get("frames")) is not None:
        rejected = _by_cause(frames["rejected"]) or "none"
        traffic = f"{frames['sent']} sent, {frames['received']} received since connecting, without HELLO"
        yield "frames", f"{traffic}; rejected: {rejected}"


def link_rows(run: JudgedRun) -> Iterator[Row]:
    """Yield the statistics of the link (hil/wire/STATISTICS.md), as far as there are some."""
    if (link := run.figures.get("link_statistics")) is None:
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
        yield "lost", _by_cause(lost)
    for label, name in (("feedback age p50, p99", "feedback_age_ms"), ("round trip p50, p99", "round_trip_ms")):
        if (figure := link.get(name)) is not None:
            yield label, f"{figure['p50']:.3g}, {figure['p99']:.3g} ms"
    if (clock := link.get("clock")) is not None:
        drift_ppm = clock["drift_ppm"]  # NaN, or null in a recording, while the run is too short for it
        drift = "" if drift_ppm is None or math.isnan(drift_ppm) else f", drift {drift_ppm:+.1f} ppm"
        yield "robot's clock", f"{clock['offset_us'] * 1e-3:+.3f} ms{drift}"
        way = clock["round_trip_us"]
        yield "TIME_SYNC p50, p99", f"{way['p50']:.0f}, {way['p99']:.0f} µs"


def is_rejected_or_lost(run: JudgedRun) -> bool:
    """Whether frames were rejected, or feedback was lost."""
    rejected = (run.figures.get("frames") or {}).get("rejected") or {}
    lost = (run.figures.get("link_statistics") or {}).get("lost") or {}
    return any((*rejected.values(), *lost.values()))


def belief_rows(run: JudgedRun) -> Iterator[Row]:
    """Yield the estimate's error, the pose fixes, and the ticks in which the robot was not driven."""
    error = run.figures.get("estimation_error")
    if error is not None and error["rms_m"] > 0.0:
        yield "estimate's error", f"{error['rms_m'] * 1e3:.3g} mm rms, {error['max_m'] * 1e3:.3g} mm max"
    if (fixes := run.figures.get("pose_fixes")) is not None:
        counts = [
            f"{name}: {_by_cause(count)}" if isinstance(count, Mapping) else f"{count} {name.replace('_', ' ')}"
            for name, count in fixes.items()
            if count
        ]
        yield "pose fixes", ", ".join(counts) or "none came"
    if refused := run.counts.commands_refused:
        yield "law", f"its command was not finite {refused} times, and the robot was held at rest"
    if stale := run.counts.stale_ticks:
        yield "stale", f"{stale} ticks, in which the feedback or the truth was too old: the robot was not driven"
    if held := run.counts.held_ticks:
        yield "held", f"{held} ticks, in which the state was unknown, the estimator lost, or the robot away"
    if slipped := run.robot_slipped_ticks:
        yield "virtual robot", f"lost {slipped} ms of its time to stalls of this machine"


def _by_cause(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} {count}" for cause, count in counts.items())


def _traffic(link: Mapping[str, Any], way: str) -> str:
    return f"{way} {link[way]['frames']} frames, {link[way]['bytes'] * 1e-3:.1f} kB"
