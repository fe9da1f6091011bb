"""The charts of a review's page, of one run or of two over the same axes."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.addons.report.charts import Band, Chart, Line, Panel
from hil.addons.report.difference import SignalDifference
from hil.addons.report.shown import Shown, Stretches, faults, lanes, marks, planned_s, violations
from hil.core.signals import unit_of
from hil.core.types import WHEEL_NAMES
from hil.judge.claims import signals_of
from hil.judge.recorded import expected, fault_span_s, read_for_figures
from hil.pages.plots import ESTIMATE_COLOUR, REFERENCE_COLOUR, Colour, colour_of
from hil.record.contents import Series
from hil.record.reader import RecordedRun

_ERRORS = {
    "error.planar_m": ("planar error", "mm", 1e3),
    "error.x_m": ("error in x", "mm", 1e3),
    "error.y_m": ("error in y", "mm", 1e3),
    "error.heading_rad": ("heading error", "mrad", 1e3),
}
_LINK = {
    "link.feedback_age_ms": ("feedback age", "ms"),
    "link.rtt_ms": ("round trip", "ms"),
    "link.load_percent": ("load", "%"),
}
_COUNTS = {"link.rejected": "rejected", "link.lost": "snapshots lost"}
_AXES = ("x", "y", "heading")
_GAINS = {gain: [f"gain.{gain}_{axis}_1_s" for axis in _AXES] for gain in ("k1", "k2")}
_OF_WHEELS = ("speed_rad_s", "speed_command_rad_s", "torque_command_n_m", "current_a")
_PLACES = ("reference", "pose", "truth")
_POSITION, _HEADING = "estimator.sigma_position_m", "estimator.sigma_heading_rad"
_OF = {"x_m": ("x", "mm", _POSITION), "y_m": ("y", "mm", _POSITION), "heading_rad": ("heading", "mrad", _HEADING)}
BELIEVED_SIGNALS = (*(f"{group}.{name}" for group in ("pose", "truth") for name in _OF), _POSITION, _HEADING)
"""The signals that the chart of the believed pose needs."""
SIGNALS = (
    *("loop.t_s", "guard.saturated", *_COUNTS, *_ERRORS, *_LINK, *_GAINS["k1"], *_GAINS["k2"]),
    *(f"{group}.{name}" for group in _PLACES for name in ("x_m", "y_m")),
    *BELIEVED_SIGNALS,
    *(f"wheel.{wheel}.{quantity}" for quantity in _OF_WHEELS for wheel in WHEEL_NAMES),
)
"""The signals that the charts need of every run."""
_PATH_POINTS = 2000
_INK: Colour = (51, 51, 51)
_PALE: Colour = (150, 150, 150)


def read_for_page(path: Path, more: Collection[str] = ()) -> RecordedRun:
    """Read a recording: the signals for its figures and its page, and those of ``more``. Raises BadInputError."""
    run = read_for_figures(path, {*SIGNALS, *more})
    wanted = {name for row in expected(run) for name in signals_of(row)}
    further = (wanted & set(run.held)) - run.signals.keys()
    return read_for_figures(path, {*SIGNALS, *more, *further}) if further else run


def charts(runs: Sequence[Shown], compared: Sequence[SignalDifference] = ()) -> list[Chart]:
    """Return the charts that have something to show; ``compared`` are signals of the second run minus the first."""
    if not any(len(shown.all_t_s) for shown in runs):
        return []
    spans = [planned_s(one.run) for one in runs]
    x_range = min(begin_s for begin_s, _ in spans), max(end_s for _, end_s in spans)
    made = [
        *_compared(runs, compared),
        _what_happened(runs, [one.name for one in compared]),
        _path(runs),
        believed(runs),
    ]
    made += [*_wheels(runs), *_gains(runs), *_link(runs)]
    return [
        replace(chart, bands=_bands(runs), x_range=x_range) if chart.is_over_time else chart
        for chart in made
        if chart.panels
    ]


def _bands(runs: Sequence[Shown]) -> list[Band]:
    """Return what is shaded behind the first run: the time after its early end, and the faults in force."""
    _, end_s = planned_s(runs[0].run)
    last_s = float(runs[0].run.signals["loop.t_s"][-1])
    bands = [Band(last_s, end_s, "not run")] if last_s < end_s and len(runs) == 1 else []
    return bands + [Band(*fault_span_s(fault, end_s), "fault") for fault in faults(runs[0].found) if fault.applied]


def _compared(runs: Sequence[Shown], compared: Sequence[SignalDifference]) -> Iterator[Chart]:
    """Yield the differences of signals."""
    panels = []
    for one in compared:
        title, unit, scale = _ERRORS.get(one.name, (one.name, one.unit, 1.0))
        found = one.figures()
        stretches = Stretches(one.t_s, [] if found["max_s"] is None else [found["max_s"]])
        rms = "no value" if found["rms"] is None else f"rms {scale * found['rms']:.3g}"
        line = Line("difference", stretches.t_s, scale * stretches(one.values), _INK)
        panels.append(Panel(f"{title}, difference ({rms})", unit, [line]))
    if panels:
        yield Chart("Difference", f"{runs[1].label} minus {runs[0].label}.", panels)


def _what_happened(runs: Sequence[Shown], more: Sequence[str]) -> Chart:
    """Return what was judged, and ``more`` signals, over the time: a reader looks here first."""
    failed = [row.signal for one in runs for row in one.found.expect if row.passed is False and row.signal is not None]
    claimed = [row.signal for one in runs for row in expected(one.run) if row.signal is not None]
    names = list(dict.fromkeys([*failed, *_ERRORS, *claimed, *more]))
    panels = [_judged(runs, name) for name in names if name != "loop.t_s" and any(one.has(name) for one in runs)]
    words = []
    if claimed:
        words.append("Red dotted line: the bound of an expectation, over its time. Red cross: its first violation.")
        words.append("An axis opens at what was judged; a double click shows all.")
    bands = _bands(runs)
    words += ["Orange: a fault is in force."] * any(band.kind == "fault" for band in bands)
    words += ["Grey: the run had ended."] * any(band.kind == "not run" for band in bands)
    for one in runs:
        if len(one.t_s) < len(one.all_t_s):
            shown = f"minimum and maximum of each {one.longest_s:.2g} s; all rows around what happened"
            words.append(f"{one.label}: {shown}.")
    ended = [float(one.all_t_s[-1]) for one in runs if one.found.failure is not None and len(one.all_t_s)]
    return Chart(
        "What happened",
        " ".join(words),
        panels,
        lanes=[
            lane if len(runs) == 1 else lane._replace(text=f"{one.label}: {lane.text}")
            for one in runs
            for lane in lanes(one.run, one.found)
        ],
        instants=[*ended, *(mark.x for panel in panels for mark in panel.marks)][:4],
    )


def _judged(runs: Sequence[Shown], name: str) -> Panel:
    """Return a signal with the first run's bounds, with when it was outside them, and with each first violation."""
    title, unit, scale = _ERRORS.get(name, (name, unit_of(name), 1.0))
    lines = [one.line(name, one.label, one.colour, scale) for one in runs if one.has(name)]
    first, bounds = runs[0], list(runs[0].bounds(name, scale))
    of = {row.of for row in expected(first.run) if row.signal == name and row.of in first.run.signals}
    others = [first.line(other, other, REFERENCE_COLOUR, scale) for other in of if other is not None]
    found = [
        mark if len(runs) == 1 else mark._replace(text=f"{one.label}: {mark.text}")
        for one in runs
        if one.has(name)
        for mark in marks(one.run, one.found, name, scale)
    ]
    bands = violations(first.run, first.found, name) if len(runs) == 1 and lines else []
    return Panel(title, unit, [*lines, *bounds, *others], found, bands, y_range=_while_judged(lines, bounds))


def _while_judged(lines: Sequence[Line], bounds: Sequence[Line]) -> tuple[float, float] | None:
    """Return the range of signals while they have a bound, with the bounds, and some room; None without a bound.

    What came before, such as a start beside the reference, would hide it.
    """
    times = np.concatenate([bound.x[np.isfinite(bound.y)] for bound in bounds]) if bounds else np.empty(0)
    if not len(times):
        return None
    each = [line.y[(line.x >= times.min()) & (line.x <= times.max())] for line in (*lines, *bounds)]
    values = np.concatenate(each)
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    room = 0.15 * (high - low) or 1.0
    return low - room, high + room


def _path(runs: Sequence[Shown]) -> Chart:
    def trail(one: Shown, group: str, label: str, colour: Colour, **style: Any) -> Line:
        x_m, y_m = one.series(f"{group}.x_m"), one.series(f"{group}.y_m")
        step = -(-len(x_m) // _PATH_POINTS) or 1
        return Line(label, x_m[::step], y_m[::step], colour, **style)

    lines = [trail(runs[0], "reference", "reference", REFERENCE_COLOUR, width_px=5.0, opacity=0.6)]
    for one in runs:
        if len(runs) == 1 and is_estimated(one):
            lines.append(trail(one, "pose", "believed", ESTIMATE_COLOUR, width_px=1.0))
        group = "truth" if one.has("truth.x_m") else "pose"
        lines.append(trail(one, group, one.label if len(runs) > 1 else group, one.colour))
    lines = [line for line in lines if np.isfinite(line.y).any()]
    panels = [Panel("y", "m", lines, height_px=380, is_true_to_scale=True)] if lines else []
    return Chart("Path", "From above.", panels, x_title="x [m]")


def _wheels(runs: Sequence[Shown]) -> Iterator[Chart]:
    """Yield speeds and torques of the wheels, each over its command and within its limit."""
    two = len(runs) > 1
    panels = []
    for wheel in WHEEL_NAMES:
        names = f"wheel.{wheel}.speed_rad_s", f"wheel.{wheel}.speed_command_rad_s"
        lines = [line for one in runs for line in _command_and_measured(one, names, 1.0, two)]
        lines += runs[0].limits("robot.speed_limit_rad_s") if lines else ()
        panels += [Panel(wheel.upper(), "rad/s", lines, height_px=100)] if lines else []
    caption = "As the firmware measures them. Broad and pale: the command. Red dots: the limit."
    yield Chart("Wheel speeds", caption, panels)
    panels = []
    for wheel in WHEEL_NAMES:
        lines = []
        for one in runs:
            names = f"wheel.{wheel}.current_a", f"wheel.{wheel}.torque_command_n_m"
            lines += _command_and_measured(one, names, one.torque_n_m_a(wheel), two)
        lines += runs[0].limits("robot.torque_limit_n_m") if lines else ()
        panels += [Panel(wheel.upper(), "N·m", lines, height_px=100)] if lines else []
    yield Chart("Wheel torques", "By the motor currents. Broad and pale: the command. Red dots: the limit.", panels)


def _command_and_measured(one: Shown, names: tuple[str, str], scale: float | None, two: bool) -> Iterator[Line]:
    measured, command = names
    if one.has(command):
        label = f"{one.label} command" if two else "command"
        colour = one.colour if two else _PALE
        yield one.line(command, label, colour, width_px=4.0, opacity=0.4, in_title=not two)
    if scale is not None and one.has(measured):
        yield one.line(measured, one.label if two else "measured", one.colour, scale)


def _gains(runs: Sequence[Shown]) -> Iterator[Chart]:
    """Yield the gains of a single run: of two, their laws' gains are among the changes."""
    if len(runs) > 1:
        return
    panels = []
    for gain, names in _GAINS.items():
        named = zip(_AXES, names, strict=True)
        lines = [runs[0].line(name, axis, colour_of(n)) for n, (axis, name) in enumerate(named) if runs[0].has(name)]
        panels += [Panel(gain.upper(), "1/s", lines, height_px=100)] if lines else []
    yield Chart("Gains", "As the law applied them.", panels)


def _link(runs: Sequence[Shown]) -> Iterator[Chart]:
    panels = []
    for name, (title, unit) in _LINK.items():
        lines = [one.line(name, one.label, one.colour) for one in runs if one.has(name)]
        panels += [Panel(title, unit, lines, height_px=80)] if lines else []
    lines = []
    two = len(runs) > 1
    for dash, (name, word) in zip(("solid", "dot"), _COUNTS.items(), strict=True):
        for one in (one for one in runs if one.has(name)):
            label = f"{one.label} {word}" if two else word
            lines.append(one.line(name, label, one.colour, dash=dash, in_title=not two or dash == "solid"))
    panels += [Panel("frames since the start", "", lines, height_px=80)] if lines else []
    yield Chart(
        "Link",
        "Values at each tick; frames that were rejected, and dotted the snapshots that were lost, since the start.",
        panels,
    )


def is_estimated(run: Shown) -> bool:
    """Return whether the truth is known, and the law acted on another pose."""
    apart = _apart(run, "x_m")
    return bool(np.any(np.abs(apart[np.isfinite(apart)]) > 0.0))


def believed(runs: Sequence[Shown]) -> Chart:
    """Return believed minus true pose, within twice the standard deviation that the estimator believed of it.

    Without panels if the laws acted on the truth, or the truth is not known.
    """
    estimated = [run for run in runs if is_estimated(run)]
    panels = []
    for name, (title, unit, deviation) in _OF.items():
        lines = [run.curve(1e3 * _apart(run, name), run.label, run.colour) for run in estimated]
        style: dict[str, Any] = {"dash": "dot", "width_px": 1.0, "in_title": False}
        lines += [
            run.line(deviation, "twice the deviation", run.colour, scale, **style)
            for run in estimated
            if run.has(deviation)
            for scale in (-2e3, 2e3)
        ]
        panels += [Panel(f"{title}, believed minus true", unit, lines, height_px=120)] if lines else []
    caption = "The pose that the law acted on, minus the true one. Dots: twice the deviation that the estimator told."
    return Chart("Believed and true pose", caption, panels)


def _apart(run: Shown, name: str) -> Series:
    apart: Series = run.series(f"pose.{name}") - run.series(f"truth.{name}")
    return np.remainder(apart + np.pi, 2.0 * np.pi) - np.pi if name == "heading_rad" else apart
