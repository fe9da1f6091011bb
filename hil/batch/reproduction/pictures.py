"""The paper's figures with our runs in them, in the paper's layout."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hil.batch.reproduction import published
from hil.batch.reproduction.analysis import delay_margin
from hil.batch.reproduction.plan import DRIVEN, EXPERIMENT_PERIOD_S, FILTERS, LAWS
from hil.batch.reproduction.verdicts import Results
from hil.core.types import WHEEL_NAMES
from hil.review.plots import Curve, colour_of, draw_curves, draw_path, draw_wheels, drawing, rgb

Series = npt.NDArray[np.float64]
Signals = Mapping[str, Series]

_BLUE, _RED, _GREEN = (0, 90, 200), (210, 40, 40), (40, 150, 60)
"""Fig. 10: blue is the reference, red the robot; the x axis is red and the y axis green, as Rviz has them."""
_GREY = (150, 150, 150)
_ERRORS = (
    ("error.x_m", "(b) X axis", "mm"),
    ("error.y_m", "(c) Y axis", "mm"),
    ("error.heading_rad", "(d) angle of direction", "mrad"),
)
_STEADY_FROM_S = 5.0
_CONVERGED_S = 3.0
_AXIS_M = 0.3
_JOINED = 4
"""From so many latencies on, the points are joined by a line."""


def circle(path: Path, shown: Mapping[str, Signals]) -> None:
    """Draw Fig. 8: (a) the trajectory, (b) to (d) the errors of x, y and heading, with the late part inset."""
    dsc = shown["dsc"]
    runs = (("DSC", dsc), ("AFDSC", shown["afdsc"]))
    with drawing(path, rows=2, columns=2, size_in=(10.0, 8.0)) as axes:
        reference = Curve("reference", dsc["reference.x_m"], dsc["reference.y_m"], _GREY)
        ways = [Curve(label, s["truth.x_m"], s["truth.y_m"]) for label, s in runs]
        draw_path(axes[0], reference, ways, title="(a) trajectory")
        for panel, (name, title, unit) in zip(axes[1:], _ERRORS, strict=True):
            curves = [Curve(label, s["loop.t_s"], s[name] * 1e3) for label, s in runs]
            draw_curves(panel, curves, title=title, y_label=f"error [{unit}]")
            late = panel.inset_axes((0.42, 0.1, 0.54, 0.4))  # at a scale of its own
            for number, curve in enumerate(curves):
                later = curve.x >= _STEADY_FROM_S
                late.plot(curve.x[later], curve.y[later], color=rgb(colour_of(number)), linewidth=1.0)
            late.set_title(f"from {_STEADY_FROM_S:g} s [{unit}]", fontsize=8)
            late.tick_params(labelsize=7)


def convergence(path: Path, shown: Mapping[str, Signals]) -> None:
    """Draw the planar error over time on a logarithmic scale, beside the paper's steady errors."""
    words = {law: LAWS[law][1].words for law in ("dsc", "afdsc", "constant")}
    words["afdsc short"] = f"AFDSC, filter {FILTERS['short'].words}"
    curves = []
    for run, s in shown.items():
        if run not in words:
            continue
        t_s, error_mm = s["loop.t_s"], s["error.planar_m"] * 1e3
        # A logarithmic scale cannot show zero.
        early = (t_s <= _CONVERGED_S) & (error_mm > 0.0)
        curves.append(Curve(words[run], t_s[early], error_mm[early]))
    with drawing(path, size_in=(8.0, 4.5)) as (axes,):
        axes.set_yscale("log")
        draw_curves(axes, curves, title="Distance to the reference", y_label="planar error [mm]")
        axes.set_xlim(0.0, _CONVERGED_S)
        for printed, number in ((published.DSC_STEADY, 0), (published.AFDSC_STEADY, 1)):
            colour = rgb(colour_of(number))
            axes.axhline(printed.value * 1e3, color=colour, linestyle=":", linewidth=1.0)
            text = f"the paper: {printed.law.upper()} {printed.value * 1e3:g} mm"
            axes.annotate(text, (0.05, printed.value * 1e3), color=colour, fontsize=8, va="bottom")


def path_in_plane(path: Path, shown: Mapping[str, Signals]) -> None:
    """Draw Fig. 10: the reference and the robot's way from the origin to it."""
    run = shown["experiment"]
    with drawing(path, size_in=(5.6, 5.6)) as (axes,):
        reference = Curve("reference", run["reference.x_m"], run["reference.y_m"], _BLUE)
        draw_path(axes, reference, [Curve("robot", run["truth.x_m"], run["truth.y_m"], _RED)], title="Fig. 10, ours")
        for (x_m, y_m), colour in (((_AXIS_M, 0.0), _RED), ((0.0, _AXIS_M), _GREEN)):
            arrow = {"arrowstyle": "-|>", "color": rgb(colour), "linewidth": 2.0}
            axes.annotate("", (x_m, y_m), (0.0, 0.0), arrowprops=arrow)


def control_signals(path: Path, shown: Mapping[str, Signals]) -> None:
    """Draw Fig. 11: the commanded torques of the wheels, none while nobody commands, and the error below them."""
    run = shown["experiment"]
    silent_s, driven_s = published.SILENT_FROM_S, published.SILENT_TO_S
    there_s = driven_s + published.TRANSITION_S
    t_s = run["loop.t_s"] + silent_s  # section IV.B counts from when the robot's computer was started
    wheels = {wheel: run[f"wheel.{wheel}.torque_command_n_m"] for wheel in WHEEL_NAMES}
    with drawing(path, rows=2, size_in=(8.0, 6.0)) as (above, below):
        draw_wheels(above, t_s, wheels, title="Fig. 11, ours: control signals", y_label="torque [N·m]")
        draw_curves(below, [Curve("", t_s, run["error.planar_m"])], title="Distance to the reference", y_label="[m]")
        for axes in (above, below):
            axes.axvspan(silent_s, driven_s, color="#eeeeee")
            axes.axvspan(driven_s, there_s, color="#fff3d6", zorder=0)
            axes.set_xlim(t_s[0], t_s[-1])
        place = ((silent_s + driven_s) / 2, 0.5)
        above.annotate("nobody commands", place, xycoords=("data", "axes fraction"), ha="center", fontsize=8)
        place = (there_s + 0.1, 0.5)
        below.annotate("the paper's transition", place, xycoords=("data", "axes fraction"), fontsize=8)


def delay(path: Path, results: Results) -> None:
    """Draw the amplitude and the frequency of the oscillation over latency."""
    with drawing(path, rows=1, columns=2, size_in=(10.0, 4.5)) as (left, right):
        left.set_yscale("log")
        for axes, name, scale, label in (
            (left, "amplitude_m", 1e3, "amplitude [mm]"),
            (right, "frequency_hz", 1.0, "frequency [Hz]"),
        ):
            curves = []
            for driven, choice in DRIVEN.items():
                found = sorted(results.delay(driven).items())
                if found:
                    values = [np.nan if (value := f.get(name)) is None else value * scale for _, f in found]
                    curves.append(Curve(choice.words, np.array([ms for ms, _ in found]), np.array(values)))
            draw_curves(axes, curves, title=f"Oscillation: {label.split()[0]}", x_label="latency [ms]", y_label=label)
            for line in axes.get_lines():
                line.set_marker("o")
                if np.size(line.get_xdata()) < _JOINED:
                    line.set_linestyle("none")
        left.set_ylim(top=1e3)
        for number, (k1_1_s, k2_1_s) in enumerate((published.FUZZY_CENTRE, published.DSC_GAINS)):
            margin = delay_margin(k1_1_s, k2_1_s, published.COMMON_FILTER_S, EXPERIMENT_PERIOD_S)
            colour = rgb(colour_of(number))
            left.axvline(margin.latency_s * 1e3, color=colour, linestyle=":")
            text = f"unstable by the equations, K1 = {k1_1_s:g}"
            place = (margin.latency_s * 1e3, 0.98)
            at = ("data", "axes fraction")
            left.annotate(text, place, xycoords=at, rotation=90, ha="right", va="top", color=colour, fontsize=8)
