"""The plots of a review's page as SVG, of one run or of two over the same axes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hil.core.types import WHEEL_NAMES
from hil.record.layout import ALARM_COLOUR, Colour
from hil.review.figures import scenario_number
from hil.review.html_page import Picture, picture
from hil.review.plots import Curve, Series, draw_curves, draw_error, draw_path, rgb, thinned
from hil.review.reader import RecordedRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ERRORS = {
    "error.x_m": "x [mm]",
    "error.y_m": "y [mm]",
    "error.planar_m": "planar [mm]",
    "error.heading_rad": "heading [mrad]",
}
_TIMES = {"loop.lateness_us": "lateness [µs]", "loop.tick_us": "work of a tick [µs]"}
_LINK = {
    "link.feedback_age_ms": "feedback age [ms]",
    "link.rtt_ms": "round trip [ms]",
    "link.load_percent": "load [%]",
    "link.rejected": "frames so far",
}
_GAINS = {gain: [f"gain.{gain}_{axis}_1_s" for axis in ("x", "y", "heading")] for gain in ("k1", "k2")}
_OF_WHEELS = ("speed_rad_s", "speed_command_rad_s", "torque_command_n_m", "current_a")
SIGNALS = (
    *("loop.t_s", "guard.saturated", "link.lost", *_TIMES, *_ERRORS, *_LINK, *_GAINS["k1"], *_GAINS["k2"]),
    *(f"{group}.{name}" for group in ("reference", "pose", "truth") for name in ("x_m", "y_m")),
    *(f"wheel.{wheel}.{quantity}" for quantity in _OF_WHEELS for wheel in WHEEL_NAMES),
)
"""The signals that the plots need."""
LEAST_SAMPLES = 64
"""The least number of samples of which ``spectrum`` makes one."""
_LONGEST_STRETCH = 4096
_STRETCHES = 8
_PATH_POINTS = 2000
_BINS = 60
_ALARM_LINE: Any = {"color": rgb(ALARM_COLOUR), "linestyle": ":"}


class Spectrum(NamedTuple):
    """One-sided power spectral density [signal's unit² / Hz] over frequency [Hz], both of shape (n,).

    It is the average of ``stretches`` periodograms, each of ``stretch_s``.
    """

    frequency_hz: Series
    density: Series
    stretches: int
    stretch_s: float


class Shown(NamedTuple):
    """A run on a page: its label and colour there, and its recording."""

    label: str
    run: RecordedRun
    colour: Colour

    def series(self, name: str) -> Series:
        """Return a signal from t = 0 on; only NaN if the recording lacks it."""
        t_s = self.run.signals["loop.t_s"]
        return self.run.signals.get(name, np.full(len(t_s), np.nan))[t_s >= 0.0]

    def curve(self, name: str, label: str | None = None, scale: float = 1.0) -> Curve:
        """Return a signal over time, with no more points than a plot can show."""
        return thinned(Curve(label or self.label, self.series("loop.t_s"), scale * self.series(name), self.colour))

    def has(self, name: str) -> bool:
        """Whether the signal has a value anywhere."""
        return bool(np.isfinite(self.series(name)).any())

    def torque_n_m_a(self, wheel: str) -> float | None:
        """Return the torque constant of a wheel's motor; None if it, or the motor's current, is not known."""
        return scenario_number(self.run, "firmware.torque_constant_n_m_a") if self.has(_current(wheel)) else None


def pictures(runs: Sequence[Shown], faults: Sequence[Mapping[str, Any]]) -> Iterator[Picture]:
    """Yield the plots that have something to show; ``faults`` of the first run are shaded in its errors."""
    if not any(len(shown.series("loop.t_s")) for shown in runs):
        return

    def plot(title: str, caption: str, draw: Callable[..., None], height_in: float, columns: int, rows: int) -> Picture:
        return picture(title, caption, partial(draw, runs), height_in=height_in, rows=rows, columns=columns)

    yield plot("Path", "Broad orange line: the reference. Dot: where a robot began.", _path, 3.6, 2, 1)
    caption = "Truth minus reference. The dotted line is at 10 mm." + " Shaded: a fault is in force." * bool(faults)
    yield plot("Errors", caption, partial(_errors, faults), 5.6, 1, 4)
    caption = "Thin: measured by the firmware. Broad and pale: the command. Dotted: the limit."
    yield plot("Wheel speeds", caption, _speeds, 4.3, 2, 2)
    caption = "Thin: torque by the motor currents. Broad and pale: the command. Dotted: the limit."
    yield plot("Wheel torques", caption, _torques, 4.3, 2, 2)
    if gains := [gain for gain, names in _GAINS.items() if any(shown.has(names[0]) for shown in runs)]:
        draw = partial(_gains, gains)
        yield plot("Gains", "The gains that the law applied.", draw, 2.1 * len(gains), 3, len(gains))
    if any(shown.torque_n_m_a(wheel) is not None for shown in runs for wheel in WHEEL_NAMES):
        caption = "Amplitude spectral density by Welch's method, Hann window, without the mean. " + _resolution(runs)
        yield plot("Spectra of the wheel torques", caption, _spectra, 4.3, 2, 2)
    caption = "How late ticks began, and how long their work took."
    if not any(np.any(shown.series("loop.lateness_us") > 0.0) for shown in runs):
        caption = "How long the work of a tick took. No tick was late: in lockstep none can be."
    yield plot("Lateness", caption, _lateness, 2.4, 2, 1)
    yield plot("Link", "Values at each tick; counters since the start.", _link, 4.4, 2, 2)


def _current(wheel: str) -> str:
    return f"wheel.{wheel}.current_a"


def _path(runs: Sequence[Shown], axes: "list[Axes]") -> None:
    path, error = axes

    def trail(shown: Shown, group: str) -> Curve:
        x_m, y_m = shown.series(f"{group}.x_m"), shown.series(f"{group}.y_m")
        step = -(-len(x_m) // _PATH_POINTS) or 1
        return Curve(shown.label, x_m[::step], y_m[::step], shown.colour)

    reference = trail(runs[0], "reference")._replace(label="reference", colour=None)
    draw_path(path, reference, [trail(shown, "truth" if shown.has("truth.x_m") else "pose") for shown in runs])
    draw_error(error, [shown.curve("error.planar_m") for shown in runs])


def _errors(faults: Sequence[Mapping[str, Any]], runs: Sequence[Shown], axes: "list[Axes]") -> None:
    end_s = max(float(t_s[-1]) for t_s in (shown.series("loop.t_s") for shown in runs) if len(t_s))
    for panel, (name, label) in zip(axes, _ERRORS.items(), strict=True):
        curves = [shown.curve(name, scale=1e3) for shown in runs]
        draw_curves(panel, curves, y_label=label, x_label="t [s]" if name == "error.heading_rad" else "")
        if name == "error.planar_m":
            panel.axhline(10.0, linewidth=0.8, **_ALARM_LINE)
        for fault in faults:
            stop_s = end_s if fault["end_s"] is None else min(fault["end_s"], end_s)
            panel.axvspan(fault["start_s"], stop_s, color=rgb(ALARM_COLOUR), alpha=0.12, linewidth=0.0)


def _speeds(runs: Sequence[Shown], axes: "list[Axes]") -> None:
    for panel, wheel in zip(axes, WHEEL_NAMES, strict=True):
        for shown in runs:
            _draw_command(panel, shown.curve(f"wheel.{wheel}.speed_command_rad_s"))
            draw_curves(panel, [shown.curve(f"wheel.{wheel}.speed_rad_s")])
        _finish_wheel(panel, runs, wheel, "speed [rad/s]", "robot.speed_limit_rad_s")


def _torques(runs: Sequence[Shown], axes: "list[Axes]") -> None:
    for panel, wheel in zip(axes, WHEEL_NAMES, strict=True):
        for shown in runs:
            _draw_command(panel, shown.curve(f"wheel.{wheel}.torque_command_n_m"))
            if (constant_n_m_a := shown.torque_n_m_a(wheel)) is not None:
                draw_curves(panel, [shown.curve(_current(wheel), scale=constant_n_m_a)])
        _finish_wheel(panel, runs, wheel, "torque [N·m]", "robot.torque_limit_n_m")


def _draw_command(panel: "Axes", curve: Curve) -> None:
    """Draw a command broad and pale, below what was measured."""
    assert curve.colour is not None
    panel.plot(curve.x, curve.y, color=rgb(curve.colour), linewidth=4.0, alpha=0.3)


def _finish_wheel(panel: "Axes", runs: Sequence[Shown], wheel: str, label: str, limit_key: str) -> None:
    panel.set(title=wheel.upper(), ylabel=label, xlabel="t [s]")
    for limit in {scenario_number(shown.run, limit_key) for shown in runs} - {None}:
        for sign in (-1.0, 1.0):
            panel.axhline(sign * (limit or 0.0), linewidth=0.9, **_ALARM_LINE)


def _gains(gains: Sequence[str], runs: Sequence[Shown], axes: "list[Axes]") -> None:
    for panel, name in zip(axes, (name for gain in gains for name in _GAINS[gain]), strict=True):
        gain, axis = name.removeprefix("gain.").split("_")[:2]
        curves = [shown.curve(name) for shown in runs if shown.has(name)]
        draw_curves(panel, curves, title=f"{gain.upper()} {axis}", y_label="[1/s]")


def _spectra(runs: Sequence[Shown], axes: "list[Axes]") -> None:
    for panel, wheel in zip(axes, WHEEL_NAMES, strict=True):
        for shown in runs:
            constant_n_m_a = shown.torque_n_m_a(wheel)
            found = spectrum(shown.series("loop.t_s"), shown.series(_current(wheel)))
            # A wheel that was never commanded has nothing to show on a logarithmic scale.
            if constant_n_m_a is not None and found is not None and found.density[1:].any():
                amplitude = constant_n_m_a * np.sqrt(found.density[1:])
                panel.loglog(found.frequency_hz[1:], amplitude, color=rgb(shown.colour), label=shown.label)
                panel.legend()
        panel.set(title=wheel.upper(), xlabel="f [Hz]", ylabel="torque [N·m/√Hz]")


def _resolution(runs: Sequence[Shown]) -> str:
    """Return a sentence that says how many stretches the spectra are averages of."""
    wheel = WHEEL_NAMES[0]
    words = [
        f"{shown.label}: {found.stretches} stretches of {found.stretch_s:.3g} s"
        for shown in runs
        if shown.torque_n_m_a(wheel) is not None
        and (found := spectrum(shown.series("loop.t_s"), shown.series(_current(wheel)))) is not None
    ]
    return f"{'; '.join(words)}." if words else "The run is too short for one."


def _lateness(runs: Sequence[Shown], axes: "list[Axes]") -> None:
    for panel, (name, label) in zip(axes, _TIMES.items(), strict=True):
        values = [series[series > 0.0] for series in (shown.series(name) for shown in runs)]
        everything = np.concatenate(values)
        if len(everything):
            least = everything.min()
            bins = np.geomspace(least, max(everything.max(), least * 1.01), _BINS).tolist()
            for shown, series in zip(runs, values, strict=True):
                panel.hist(series, bins, histtype="step", color=rgb(shown.colour), label=shown.label)
            panel.set(xscale="log", yscale="log")
            panel.legend()
        else:
            panel.text(0.5, 0.5, "none", transform=panel.transAxes, ha="center")
        panel.set(xlabel=label, ylabel="ticks")


def _link(runs: Sequence[Shown], axes: "list[Axes]") -> None:
    for panel, (name, label) in zip(axes, _LINK.items(), strict=True):
        is_count = name == "link.rejected"
        curves = [shown.curve(name, shown.label + " rejected" * is_count) for shown in runs]
        if is_count:
            lost = (shown.curve("link.lost", f"{shown.label} snapshots lost") for shown in runs)
            curves += [curve._replace(dashed=True) for curve in lost]
        draw_curves(panel, curves, y_label=label)
        if not any(np.isfinite(curve.y).any() for curve in curves):
            panel.text(0.5, 0.5, "no value on this link", transform=panel.transAxes, ha="center")


def spectrum(t_s: Series, values: Series) -> Spectrum | None:
    """Return the spectrum of the longest part of a signal without a gap; None where that is too short for one.

    A gap is a missing value or a missing tick. By Welch's method (IEEE Transactions on Audio and Electroacoustics 15,
    1967, 70-73): averaged periodograms of overlapping stretches under a Hann window, each without its mean.
    """
    if len(t_s) < LEAST_SAMPLES:
        return None
    period_s = float(np.median(np.diff(t_s)))
    values = values[_longest_part(t_s, values, period_s)]
    if len(values) < LEAST_SAMPLES:
        return None
    from matplotlib import mlab

    size = min(_LONGEST_STRETCH, 2 ** int(np.log2(max(LEAST_SAMPLES, 2 * len(values) // _STRETCHES))), len(values))
    step = size // 2
    hann = np.hanning(size + 1)[:-1]
    density, frequency_hz = mlab.psd(values, size, 1.0 / period_s, "mean", hann, size - step)
    return Spectrum(np.asarray(frequency_hz), np.asarray(density), (len(values) - size) // step + 1, size * period_s)


def _longest_part(t_s: Series, values: Series, period_s: float) -> slice:
    """Return the longest run of values that are finite and one period apart."""
    broken = np.ones(len(t_s) + 1, dtype=bool)
    broken[1:-1] = np.abs(np.diff(t_s) - period_s) > period_s / 2
    gaps = ~np.isfinite(values)
    broken[:-1] |= gaps
    broken[1:] |= gaps
    edges = np.flatnonzero(broken)
    longest = int(np.argmax(np.diff(edges)))
    begin, end = int(edges[longest]), int(edges[longest + 1])
    return slice(begin, end) if not gaps[begin:end].any() else slice(0, 0)
