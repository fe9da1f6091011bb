"""The plots of a review's page as SVG, of one run or of two over the same axes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.types import WHEEL_NAMES
from hil.record.layout import ALARM_COLOUR
from hil.review.figures import scenario_of, torque_constant_n_m_a
from hil.review.html_page import Picture, picture
from hil.review.plots import Curve, colour_of, draw_curves, draw_error, draw_path, rgb, thinned
from hil.review.reader import RecordedRun
from hil.review.spectrum import spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Series = npt.NDArray[np.float64]

SIGNALS = (
    *("loop.t_s", "loop.lateness_us", "loop.tick_us", "reference.x_m", "reference.y_m"),
    *(f"{group}.{name}" for group in ("pose", "truth") for name in ("x_m", "y_m")),
    *("error.x_m", "error.y_m", "error.planar_m", "error.heading_rad", "guard.saturated"),
    *(f"gain.{gain}_{axis}_1_s" for gain in ("k1", "k2") for axis in ("x", "y", "heading")),
    *(
        f"wheel.{wheel}.{quantity}"
        for quantity in ("speed_rad_s", "speed_command_rad_s", "torque_command_n_m", "current_a")
        for wheel in WHEEL_NAMES
    ),
    *("link.feedback_age_ms", "link.rtt_ms", "link.load_percent", "link.rejected", "link.lost"),
)
"""The signals that the plots need."""

_PATH_POINTS = 2000
_BINS = 60
_ERRORS = (
    ("error.x_m", "x [mm]"),
    ("error.y_m", "y [mm]"),
    ("error.planar_m", "planar [mm]"),
    ("error.heading_rad", "heading [mrad]"),
)
_LINK = (
    ("link.feedback_age_ms", "feedback age [ms]"),
    ("link.rtt_ms", "round trip [ms]"),
    ("link.load_percent", "load [%]"),
    ("link.rejected", "frames so far"),
)


class Shown(NamedTuple):
    """A run on a page: its label there, and its recording."""

    label: str
    run: RecordedRun

    def series(self, name: str) -> Series:
        """Return a signal from t = 0 on; only NaN if the recording lacks it."""
        t_s = self.run.signals["loop.t_s"]
        return self.run.signals.get(name, np.full(len(t_s), np.nan))[t_s >= 0.0]

    def curve(self, name: str, label: str | None = None, scale: float = 1.0) -> Curve:
        """Return a signal over time, with no more points than a plot can show."""
        return thinned(Curve(label or self.label, self.series("loop.t_s"), scale * self.series(name)))

    def limit(self, key: str) -> float | None:
        """Return a limit of the run's scenario."""
        value = scenario_of(self.run).get(key)
        return float(value) if isinstance(value, int | float) else None

    def has(self, name: str) -> bool:
        """Whether the signal has a value anywhere."""
        return bool(np.isfinite(self.series(name)).any())


def pictures(runs: Sequence[Shown], faults: Sequence[Mapping[str, Any]]) -> Iterator[Picture]:
    """Yield the plots that have something to show; ``faults`` of the first run are shaded in its errors."""
    if not any(len(shown.series("loop.t_s")) for shown in runs):
        return
    yield _picture("Path", "Broad orange line: the reference. Dot: where a robot began.", 3.6, 2, _path, runs)
    caption = "Truth minus reference. The dotted line is at 10 mm." + " Shaded: a fault is in force." * bool(faults)
    yield _picture("Errors", caption, 5.6, 1, partial(_errors, faults=faults), runs, rows=4)
    caption = "Thin: measured by the firmware. Broad and pale: the command. Dotted: the limit."
    yield _picture("Wheel speeds", caption, 4.3, 2, _speeds, runs, rows=2)
    caption = "Thin: torque by the motor currents. Broad and pale: the command. Dotted: the limit."
    yield _picture("Wheel torques", caption, 4.3, 2, _torques, runs, rows=2)
    if gains := [gain for gain in ("k1", "k2") if any(shown.has(f"gain.{gain}_x_1_s") for shown in runs)]:
        height_in = 2.1 * len(gains)
        draw = partial(_gains, gains=gains)
        yield _picture("Gains", "The gains that the law applied.", height_in, 3, draw, runs, rows=len(gains))
    if any(_torque(shown, wheel) is not None for shown in runs for wheel in WHEEL_NAMES):
        caption = "Amplitude spectral density by Welch's method, Hann window, without the mean. " + _resolution(runs)
        yield _picture("Spectra of the wheel torques", caption, 4.3, 2, _spectra, runs, rows=2)
    is_late = any(np.any(shown.series("loop.lateness_us") > 0.0) for shown in runs)
    caption = "How late ticks began, and how long their work took."
    if not is_late:
        caption = "How long the work of a tick took. No tick was late: in lockstep none can be."
    yield _picture("Lateness", caption, 2.4, 2, _lateness, runs)
    yield _picture("Link", "Values at each tick; counters since the start.", 4.4, 2, _link, runs, rows=2)


def _picture(
    title: str,
    caption: str,
    height_in: float,
    columns: int,
    draw: "Callable[[list[Axes], Sequence[Shown]], None]",
    runs: Sequence[Shown],
    rows: int = 1,
) -> Picture:
    return picture(title, caption, lambda axes: draw(axes, runs), height_in=height_in, rows=rows, columns=columns)


def _path(axes: "list[Axes]", runs: Sequence[Shown]) -> None:
    path, error = axes

    def trail(shown: Shown, label: str, group: str) -> Curve:
        x_m, y_m = shown.series(f"{group}.x_m"), shown.series(f"{group}.y_m")
        step = -(-len(x_m) // _PATH_POINTS) or 1
        return Curve(label, x_m[::step], y_m[::step])

    curves = [trail(shown, shown.label, "truth" if shown.has("truth.x_m") else "pose") for shown in runs]
    coloured = [_coloured(curve, number) for number, curve in enumerate(curves)]
    draw_path(path, trail(runs[0], "reference", "reference"), coloured)
    draw_error(error, [_coloured(shown.curve("error.planar_m"), number) for number, shown in enumerate(runs)])


def _errors(axes: "list[Axes]", runs: Sequence[Shown], *, faults: Sequence[Mapping[str, Any]]) -> None:
    for panel, (name, label) in zip(axes, _ERRORS, strict=True):
        curves = [_coloured(shown.curve(name, scale=1e3), number) for number, shown in enumerate(runs)]
        draw_curves(panel, curves, y_label=label, x_label="t [s]" if name == "error.heading_rad" else "")
        if name == "error.planar_m":
            panel.axhline(10.0, color=rgb(ALARM_COLOUR), linewidth=0.8, linestyle=":")
        end_s = max(float(shown.series("loop.t_s")[-1]) for shown in runs if len(shown.series("loop.t_s")))
        for fault in faults:
            stop_s = end_s if fault["end_s"] is None else min(fault["end_s"], end_s)
            panel.axvspan(fault["start_s"], stop_s, color=rgb(ALARM_COLOUR), alpha=0.12, linewidth=0.0)


def _speeds(axes: "list[Axes]", runs: Sequence[Shown]) -> None:
    for panel, wheel in zip(axes, WHEEL_NAMES, strict=True):
        for number, shown in enumerate(runs):
            _draw_command(panel, shown.curve(f"wheel.{wheel}.speed_command_rad_s"), number)
            measured = _coloured(shown.curve(f"wheel.{wheel}.speed_rad_s"), number)
            draw_curves(panel, [measured], title=wheel.upper(), y_label="speed [rad/s]")
        _limits(panel, runs, "robot.speed_limit_rad_s")


def _torques(axes: "list[Axes]", runs: Sequence[Shown]) -> None:
    for panel, wheel in zip(axes, WHEEL_NAMES, strict=True):
        for number, shown in enumerate(runs):
            _draw_command(panel, shown.curve(f"wheel.{wheel}.torque_command_n_m"), number)
            torque_n_m = _torque(shown, wheel)
            if torque_n_m is not None:
                curve = thinned(Curve(shown.label, shown.series("loop.t_s"), torque_n_m, colour_of(number)))
                draw_curves(panel, [curve], title=wheel.upper(), y_label="torque [N·m]")
        panel.set(title=wheel.upper(), ylabel="torque [N·m]", xlabel="t [s]")
        _limits(panel, runs, "robot.torque_limit_n_m")


def _gains(axes: "list[Axes]", runs: Sequence[Shown], *, gains: Sequence[str]) -> None:
    places = [(gain, axis) for gain in gains for axis in ("x", "y", "heading")]
    for panel, (gain, axis) in zip(axes, places, strict=True):
        name = f"gain.{gain}_{axis}_1_s"
        curves = [_coloured(shown.curve(name), number) for number, shown in enumerate(runs) if shown.has(name)]
        draw_curves(panel, curves, title=f"{gain.upper()} {axis}", y_label="[1/s]")


def _spectra(axes: "list[Axes]", runs: Sequence[Shown]) -> None:
    for panel, wheel in zip(axes, WHEEL_NAMES, strict=True):
        for number, shown in enumerate(runs):
            torque_n_m = _torque(shown, wheel)
            found = None if torque_n_m is None else spectrum(shown.series("loop.t_s"), torque_n_m)
            # A wheel that was never commanded has nothing to show on a logarithmic scale.
            if found is not None and found.density[1:].any():
                amplitude = np.sqrt(found.density[1:])
                panel.loglog(found.frequency_hz[1:], amplitude, color=rgb(colour_of(number)), label=shown.label)
                panel.legend()
        panel.set(title=wheel.upper(), xlabel="f [Hz]", ylabel="torque [N·m/√Hz]")


def _lateness(axes: "list[Axes]", runs: Sequence[Shown]) -> None:
    for panel, name, label in zip(
        axes, ("loop.lateness_us", "loop.tick_us"), ("lateness [µs]", "work of a tick [µs]"), strict=True
    ):
        values = [one[one > 0.0] for one in (shown.series(name) for shown in runs)]
        there = np.concatenate(values)
        if len(there):
            bins = np.geomspace(there.min(), max(there.max(), there.min() * 1.01), _BINS).tolist()
            for number, (shown, one) in enumerate(zip(runs, values, strict=True)):
                panel.hist(one, bins, histtype="step", color=rgb(colour_of(number)), label=shown.label)
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.legend()
        else:
            panel.text(0.5, 0.5, "none", transform=panel.transAxes, ha="center")
        panel.set(xlabel=label, ylabel="ticks")


def _link(axes: "list[Axes]", runs: Sequence[Shown]) -> None:
    for panel, (name, label) in zip(axes, _LINK, strict=True):
        suffix = " rejected" if name == "link.rejected" else ""
        curves = [_coloured(shown.curve(name, shown.label + suffix), number) for number, shown in enumerate(runs)]
        if suffix:
            lost = [shown.curve("link.lost", f"{shown.label} snapshots lost") for shown in runs]
            curves += [_coloured(curve._replace(dashed=True), number) for number, curve in enumerate(lost)]
        draw_curves(panel, curves, y_label=label)
        if not any(np.isfinite(curve.y).any() for curve in curves):
            panel.text(0.5, 0.5, "no value on this link", transform=panel.transAxes, ha="center")


def _coloured(curve: Curve, number: int) -> Curve:
    return curve._replace(colour=colour_of(number))


def _draw_command(axes: "Axes", curve: Curve, number: int) -> None:
    """Draw a command broad and pale, below what was measured."""
    axes.plot(curve.x, curve.y, color=rgb(colour_of(number)), linewidth=4.0, alpha=0.3)


def _limits(axes: "Axes", runs: Sequence[Shown], key: str) -> None:
    for limit in {shown.limit(key) for shown in runs}:
        for sign in (-1.0, 1.0) if limit is not None else ():
            axes.axhline(sign * (limit or 0.0), color=rgb(ALARM_COLOUR), linewidth=0.9, linestyle=":")


def _torque(shown: Shown, wheel: str) -> Series | None:
    """Return the torque of a motor by its current [N·m]; None where that is not known."""
    constant_n_m_a = torque_constant_n_m_a(shown.run)
    name = f"wheel.{wheel}.current_a"
    return None if constant_n_m_a is None or not shown.has(name) else constant_n_m_a * shown.series(name)


def _resolution(runs: Sequence[Shown]) -> str:
    """Return a sentence that says how many stretches the spectra are averages of."""
    words = []
    for shown in runs:
        torque_n_m = _torque(shown, WHEEL_NAMES[0])
        found = None if torque_n_m is None else spectrum(shown.series("loop.t_s"), torque_n_m)
        if found is not None:
            words.append(f"{shown.label}: {found.stretches} stretches of {found.stretch_s:.3g} s")
    return f"{'; '.join(words)}." if words else "The run is too short for one."
