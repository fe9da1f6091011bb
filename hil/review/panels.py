"""The charts of a review's page, of one run or of two over the same axes."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.core.signals import unit_of
from hil.core.types import WHEEL_NAMES
from hil.judge.claims import signals_of
from hil.judge.shadows import shadow_differences, shadow_signals
from hil.record.layout import ESTIMATE_COLOUR, REFERENCE_COLOUR, Colour
from hil.review.alignment import SignalDifference
from hil.review.believed import BELIEVED_SIGNALS, believed, is_estimated
from hil.review.charts import Band, Chart, Lane, Line, Mark, Panel
from hil.review.figures import expected, read_for_figures
from hil.review.judged import fault_band, faults, lanes, marks, planned_s, violations
from hil.review.plots import colour_of
from hil.review.reader import RecordedRun
from hil.review.shown import Shown
from hil.review.spectra import spectrum
from hil.review.stretches import Stretches

_ERRORS = {
    "error.planar_m": ("planar error", "mm", 1e3),
    "error.x_m": ("error in x", "mm", 1e3),
    "error.y_m": ("error in y", "mm", 1e3),
    "error.heading_rad": ("heading error", "mrad", 1e3),
}
_TIMES = {"loop.lateness_us": "how late a tick began", "loop.tick_us": "work of a tick"}
_LINK = {
    "link.feedback_age_ms": ("feedback age", "ms"),
    "link.rtt_ms": ("round trip", "ms"),
    "link.load_percent": ("load", "%"),
}
_COUNTS = {"link.rejected": "rejected", "link.lost": "snapshots lost"}
_GAINS = {gain: [f"gain.{gain}_{axis}_1_s" for axis in ("x", "y", "heading")] for gain in ("k1", "k2")}
_OF_WHEELS = ("speed_rad_s", "speed_command_rad_s", "torque_command_n_m", "current_a")
_PLACES = ("reference", "pose", "truth")
SIGNALS = (
    *("loop.t_s", "guard.saturated", *_COUNTS, *_TIMES, *_ERRORS, *_LINK, *_GAINS["k1"], *_GAINS["k2"]),
    *(f"{group}.{name}" for group in _PLACES for name in ("x_m", "y_m")),
    *BELIEVED_SIGNALS,
    *(f"wheel.{wheel}.{quantity}" for quantity in _OF_WHEELS for wheel in WHEEL_NAMES),
)
"""The signals that the charts need of every run."""
_PATH_POINTS = 2000
_BINS = 60
_INK: Colour = (51, 51, 51)
_PALE: Colour = (150, 150, 150)


def read_for_page(path: Path, more: Collection[str] = ()) -> RecordedRun:
    """Read a recording: the signals for its figures and its page, and those of ``more``. Raises BadInputError."""
    run = read_for_figures(path, {*SIGNALS, *more})
    wanted = {name for row in expected(run) for name in signals_of(row)}
    wanted |= {name for names in shadow_signals(run.held).values() for name in names.values()}
    further = (wanted & set(run.held)) - run.signals.keys()
    return read_for_figures(path, {*SIGNALS, *more, *further}) if further else run


def charts(runs: Sequence[Shown], compared: Sequence[SignalDifference] = ()) -> list[Chart]:
    """Return the charts that have something to show; ``compared`` are signals of the second run minus the first."""
    if not any(len(shown.all_t_s) for shown in runs):
        return []
    spans = [(begin_s + one.shift_s, end_s + one.shift_s) for one in runs for begin_s, end_s in [planned_s(one.run)]]
    x_range = min(begin_s for begin_s, _ in spans), max(end_s for _, end_s in spans)
    made = [
        *_compared(runs, compared),
        _what_happened(runs, [one.name for one in compared]),
        *_shadows(runs),
        _path(runs),
        believed(runs),
    ]
    made += [*_wheels(runs), *_gains(runs), *_link(runs), *_spectra(runs), *_lateness(runs)]
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
    return bands + [fault_band(fault, end_s) for fault in faults(runs[0].found) if fault["applied"]]


def _compared(runs: Sequence[Shown], compared: Sequence[SignalDifference]) -> Iterator[Chart]:
    """Yield the differences of signals with their tolerances, each marked where it is first outside."""
    panels = []
    for one in compared:
        title, unit, scale = _ERRORS.get(one.name, (one.name, one.unit, 1.0))
        found = one.figures()
        stretches = Stretches(
            one.t_s, [at_s for at_s in (found["first_outside_s"], found["max_s"]) if at_s is not None]
        )
        line = Line("difference", stretches.t_s, scale * stretches(one.values), _INK)
        size = None if one.tolerance is None else scale * one.tolerance
        marks_, rms = [], "no value" if found["rms"] is None else f"rms {scale * found['rms']:.3g}"
        if (at_s := found["first_outside_s"]) is not None:
            value = scale * float(one.values[np.searchsorted(one.t_s, at_s)])
            marks_ = [Mark(at_s, value, f"outside from {at_s:.4g} s")]
        title = f"{title}, difference ({rms})" if size is None else f"{title}, difference ({rms}, tolerance ±{size:g})"
        panels.append(Panel(title, unit, [line], marks_, tolerance=None if size is None else (-size, size)))
    if panels:
        caption = f"{runs[1].label} minus {runs[0].label}. Green: within the tolerance. Red cross: first outside."
        yield Chart("Difference", caption, panels)


def _what_happened(runs: Sequence[Shown], more: Sequence[str]) -> Chart:
    """Return what was judged, and ``more`` signals, over the time: a reader looks here first."""
    failed = [
        row["signal"] for one in runs for row in one.found["expect"] or () if row["passed"] is False and row["signal"]
    ]
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
    ended = [float(one.all_t_s[-1]) + one.shift_s for one in runs if one.found["failure"] and len(one.all_t_s)]
    return Chart(
        "What happened",
        " ".join(words),
        panels,
        lanes=[lane for one in runs for lane in _lanes_of(one, f"{one.label}: " if len(runs) > 1 else "")],
        instants=[*ended, *(mark.x for panel in panels for mark in panel.marks)][:4],
    )


def _lanes_of(one: Shown, prefix: str) -> Iterator[Lane]:
    """Yield the lanes of a run at its times on the page."""
    for lane in lanes(one.run, one.found):
        moved = [Band(band.begin + one.shift_s, band.end + one.shift_s, band.kind) for band in lane.bands]
        yield Lane(prefix + lane.text, moved)


def _judged(runs: Sequence[Shown], name: str) -> Panel:
    """Return a signal with the first run's bounds, with when it was outside them, and with each first violation."""
    title, unit, scale = _ERRORS.get(name, (name, unit_of(name), 1.0))
    lines = [one.line(name, one.label, one.colour, scale) for one in runs if one.has(name)]
    first, bounds = runs[0], list(runs[0].bounds(name, scale))
    of = {row.of for row in expected(first.run) if row.signal == name and row.of in first.run.signals}
    others = [first.line(other, other, REFERENCE_COLOUR, scale) for other in of if other is not None]
    found = [
        Mark(mark.x + one.shift_s, mark.y, mark.text if len(runs) == 1 else f"{one.label}: {mark.text}")
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


def _shadows(runs: Sequence[Shown]) -> Iterator[Chart]:
    """Yield the shadows of each run beside the command, wheel by wheel, with their differences to it."""
    for one in runs:
        panels = []
        shadows, apart_by = shadow_signals(one.run.signals), shadow_differences(one.run.signals)
        for command in dict.fromkeys(command for names in shadows.values() for command in names):
            wheel, unit = command.split(".")[1].upper(), unit_of(command)
            driving = one.line(command, f"command, {one.found['law']}", _INK, width_px=2.5, opacity=0.5)
            lines = [
                one.line(names[command], f"shadow {shadow}", colour_of(n), dash="dash")
                for n, (shadow, names) in enumerate(shadows.items())
            ]
            apart = []
            for n, (shadow, names) in enumerate(shadows.items()):
                if (found := apart_by.get(shadow, {}).get(command)) is not None:
                    label = f"{shadow}, rms {found.rms:.3g}"
                    values = one.series(names[command]) - one.series(command)
                    apart.append(one.curve(values, label, colour_of(n)))
            panels += [
                Panel(wheel, unit, [driving, *lines]),
                Panel(f"{wheel} difference", unit, apart, height_px=80),
            ]
        if panels:
            name = f" of {one.label}" if len(runs) > 1 else ""
            caption = "What other laws would have commanded at each tick. They did not drive the robot."
            yield Chart(f"Shadows{name}", caption, panels)


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
    panels = []
    for gain, names in _GAINS.items():
        axes = {name: name.removeprefix(f"gain.{gain}_").removesuffix("_1_s") for name in names}
        if len(runs) == 1:
            lines = [runs[0].line(name, axes[name], colour_of(n)) for n, name in enumerate(names) if runs[0].has(name)]
            panels += [Panel(gain.upper(), "1/s", lines, height_px=100)] if lines else []
            continue
        for name in names:
            lines = [one.line(name, one.label, one.colour) for one in runs if one.has(name)]
            panels += [Panel(f"{gain.upper()} {axes[name]}", "1/s", lines, height_px=80)] if lines else []
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


def _spectra(runs: Sequence[Shown]) -> Iterator[Chart]:
    panels, words = [], {}
    for wheel in WHEEL_NAMES:
        lines = []
        for one in runs:
            constant_n_m_a = one.torque_n_m_a(wheel)
            found = spectrum(one.all_t_s, one.series(f"wheel.{wheel}.current_a"))
            # A wheel that was never commanded has nothing to show on a logarithmic scale.
            if constant_n_m_a is not None and found is not None and found.density[1:].any():
                amplitude = constant_n_m_a * np.sqrt(found.density[1:])
                lines.append(Line(one.label, found.frequency_hz[1:], amplitude, one.colour))
                words[one.label] = f"{one.label}: {found.stretches} stretches of {found.stretch_s:.3g} s."
        panels += [Panel(wheel.upper(), "N·m/√Hz", lines, is_logarithmic=True)] if lines else []
    caption = "Amplitude spectral density by Welch's method, Hann window, without the mean."
    title = "Spectra of the wheel torques"
    yield Chart(title, " ".join([caption, *words.values()]), panels, x_title="f [Hz]", is_logarithmic=True)


def _lateness(runs: Sequence[Shown]) -> Iterator[Chart]:
    panels = []
    for name, title in _TIMES.items():
        values = [series[series > 0.0] for series in (one.series(name) for one in runs)]
        everything = np.concatenate(values)
        if len(everything):
            least = everything.min()
            edges = np.geomspace(least, max(everything.max(), least * 1.01), _BINS + 1)
            middles = np.sqrt(edges[1:] * edges[:-1])
            counts = (np.histogram(series, edges)[0].astype(float) for series in values)
            lines = [
                Line(one.label, middles, np.where(count > 0, count, np.nan), one.colour)
                for one, count in zip(runs, counts, strict=True)
            ]
            panels.append(Panel(f"ticks by {title}", "", lines, is_logarithmic=True))
    caption = "How many ticks began so late, and had so much work."
    if not any(one.has("loop.lateness_us") and (one.series("loop.lateness_us") > 0.0).any() for one in runs):
        caption = "How many ticks had so much work. No tick was late: in lockstep none can be."
    yield Chart("Lateness", caption, panels, x_title="time [µs]", is_logarithmic=True)
