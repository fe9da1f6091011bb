"""The tables of a reproduction's summary, and the paper's figures with our runs in them, in the paper's layout."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.addons.batch.job import Signals
from hil.addons.batch.reproduction import published
from hil.addons.batch.reproduction.paper_claims import CaseResults
from hil.addons.batch.reproduction.section_iv import DRIVEN, EXPERIMENT_PERIOD_S, FILTERS, LAWS, LIMITS
from hil.addons.batch.results_page import Plot, Table, as_markdown
from hil.core.types import WHEEL_NAMES
from hil.pages.plots import Curve, colour_of, draw_curves, draw_path, draw_wheels, rgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Summary = Mapping[str, Any]
Shown = Mapping[str, Signals]
Rows = list[tuple[str, ...]]

_UNIT = {"s": ("s", 1.0, 2), "m": ("mm", 1e3, 2), "rad": ("mrad", 1e3, 2), "Hz": ("Hz", 1.0, 1)}
_BLUE, _RED, _GREEN = (0, 90, 200), (210, 40, 40), (40, 150, 60)
"""Fig. 10: blue is the reference, red the robot; the x axis is red and the y axis green, as Rviz has them."""
_GREY = (150, 150, 150)
_ERRORS = (
    ("error.x_m", "(b) X axis", "mm"),
    ("error.y_m", "(c) Y axis", "mm"),
    ("error.heading_rad", "(d) angle of direction", "mrad"),
)
_STEADY_FROM_S, _AXIS_M = 5.0, 0.3
_JOINED = 4
"""From so many latencies on, the points are joined by a line."""
_DSC, _AFDSC, _EXPERIMENT = "dsc common together", "afdsc common together", "experiment"


def circle(summary: Summary) -> Table:
    """Return the figures of section IV.A, ours and the paper's."""
    printed = {(row["law"], row["figure"]): row["value"] for row in summary["paper"]}
    rows: Rows = [("law", "filter", "limit", "tracked", "the paper", "steady error", "the paper", "within 10 mm")]
    for row in summary["circle"]:
        # The paper's figures appear once, beside the runs that are nearest to its description.
        law = row["law"] if (row["filter"], row["limit"]) == ("common", "together") else None
        rows.append(
            _line(
                row,
                (LAWS[row["law"]][1].words, FILTERS[row["filter"]].words, LIMITS[row["limit"]].words),
                number(row["tracked_s"], "s"),
                number(printed.get((law, "tracked_s")), "s", 1, missing=""),
                number(row["steady_rms_m"], "m"),
                number(printed.get((law, "steady_rms_m")), "m", missing=""),
                number(row["t10_s"], "s"),
            )
        )
    return Table("Section IV.A: the circle", rows)


def delay(summary: Summary) -> Table:
    """Return the oscillation for each latency."""
    rows: Rows = [("command", "latency", "amplitude", "frequency", "steady error", "largest", "transition")]
    figures = (("amplitude_m", "m"), ("frequency_hz", "Hz"), ("steady_rms_m", "m"), ("steady_max_m", "m"))
    for row in summary["delay"]:
        cells = (number(row[name], unit) for name, unit in (*figures, ("transition_s", "s")))
        rows.append(_line(row, (DRIVEN[row["driven"]].words, f"{row['latency_ms']:g} ms"), *cells))
    return Table("Section IV.B: oscillation over latency", rows)


def transition(summary: Summary) -> Table:
    """Return the time that the robot takes to the path, for each start and top speed."""
    rows: Rows = [("command", "case", "distance", "transition")]
    for row in summary["transition"]:
        words = (DRIVEN[row["driven"]].words, row["name"], "-" if row["from_m"] is None else f"{row['from_m']:.2f} m")
        rows.append(_line(row, words, number(row["transition_s"], "s")))
    return Table("Section IV.B: the transition", rows)


def _line(row: Mapping[str, Any], words: tuple[str, ...], *figures: str) -> tuple[str, ...]:
    """Return a line of a table: the run, then its figures or the reason for its end."""
    return (*words, *figures) if row["failure"] is None else (*words, row["failure"], *[""] * (len(figures) - 1))


def claims(summary: Summary) -> Table:
    """Return the verdicts on the paper's results."""
    rows = [("place", "result", "the paper", "ours", "tolerance", "verdict", "why")]
    for row in summary["verdicts"]:
        figures = (number(row[name], row["unit"]) for name in ("paper", "ours", "tolerance"))
        rows.append((row["place"], row["claim"], *figures, row["verdict"], row["why"]))
    return Table("Verdicts", rows)


def assumptions(summary: Summary) -> Table:
    """Return the quantities that the paper leaves out, with our values."""
    head = ("section", "left out", "ours", "why")
    rows = [(row["place"], row["what"], row["value"] or "-", row["why"]) for row in summary["assumptions"]]
    return Table("What the paper leaves out", [head, *rows])


def number(value: float | None, unit: str, digits: int | None = None, missing: str = "-") -> str:
    """Return a figure with its unit, errors in mm and mrad; ``missing`` for None."""
    shown, scale, usual = _UNIT[unit]
    return missing if value is None else f"{value * scale:.{usual if digits is None else digits}f} {shown}"


def tables(summary: Summary) -> list[Table]:
    """Return the tables of a summary that have rows, the verdicts first."""
    found = [one(summary) for one in (claims, circle, delay, transition, assumptions)]
    return [table for table in found if len(table.rows) > 1]


def markdown(summary: Summary) -> str:
    """Return the tables of a summary in Markdown."""
    return "\n".join(line for table in tables(summary) for line in as_markdown(table, "###"))[1:] + "\n"


def plots(results: CaseResults, signals: Shown) -> Iterator[Plot]:
    """Yield the pictures whose runs are there; ``signals`` are those of each run by its name."""
    for name, (draw, needed, rows, columns, size_in) in PLOTS.items():
        if name == "delay":
            if any(results.rows("delay")):
                yield Plot(name, partial(draw_delay, results=results), rows, columns, size_in)
        elif all(signals.get(run) for run in needed):
            yield Plot(name, partial(draw, shown=signals), rows, columns, size_in)


def draw_circle(axes: "list[Axes]", shown: Shown) -> None:
    """Draw Fig. 8: (a) the trajectory, (b) to (d) the errors of x, y and heading, with the late part inset."""
    dsc = shown[_DSC]
    runs = (("DSC", dsc), ("AFDSC", shown[_AFDSC]))
    reference = Curve("reference", dsc["reference.x_m"], dsc["reference.y_m"], _GREY)
    ways = [Curve(label, s["truth.x_m"], s["truth.y_m"]) for label, s in runs]
    draw_path(axes[0], reference, ways, title="(a) trajectory")
    for panel, (name, title, unit) in zip(axes[1:], _ERRORS, strict=True):
        curves = [Curve(label, s["loop.t_s"], s[name] * 1e3) for label, s in runs]
        draw_curves(panel, curves, title=title, y_label=f"error [{unit}]")
        late = panel.inset_axes((0.42, 0.1, 0.54, 0.4))  # at a scale of its own
        for place, curve in enumerate(curves):
            later = curve.x >= _STEADY_FROM_S
            late.plot(curve.x[later], curve.y[later], color=rgb(colour_of(place)), linewidth=1.0)
        late.set_title(f"from {_STEADY_FROM_S:g} s [{unit}]", fontsize=8)
        late.tick_params(labelsize=7)


def draw_path_in_plane(axes: "list[Axes]", shown: Shown) -> None:
    """Draw Fig. 10: the reference and the robot's way from the origin to it."""
    (panel,), run = axes, shown[_EXPERIMENT]
    reference = Curve("reference", run["reference.x_m"], run["reference.y_m"], _BLUE)
    draw_path(panel, reference, [Curve("robot", run["truth.x_m"], run["truth.y_m"], _RED)], title="Fig. 10, ours")
    for (x_m, y_m), colour in (((_AXIS_M, 0.0), _RED), ((0.0, _AXIS_M), _GREEN)):
        arrow = {"arrowstyle": "-|>", "color": rgb(colour), "linewidth": 2.0}
        panel.annotate("", (x_m, y_m), (0.0, 0.0), arrowprops=arrow)


def draw_control_signals(axes: "list[Axes]", shown: Shown) -> None:
    """Draw Fig. 11: the commanded torques of the wheels, none while nobody commands, and the error below them."""
    (above, below), run = axes, shown[_EXPERIMENT]
    silent_s, driven_s = published.SILENT_FROM_S, published.SILENT_TO_S
    there_s = driven_s + published.TRANSITION_S
    t_s = run["loop.t_s"] + silent_s  # section IV.B counts from when the robot's computer was started
    wheels = {wheel: run[f"wheel.{wheel}.torque_command_n_m"] for wheel in WHEEL_NAMES}
    draw_wheels(above, t_s, wheels, title="Fig. 11, ours: control signals", y_label="torque [N·m]")
    draw_curves(below, [Curve("", t_s, run["error.planar_m"])], title="Distance to the reference", y_label="[m]")
    for panel in axes:
        panel.axvspan(silent_s, driven_s, color="#eeeeee")
        panel.axvspan(driven_s, there_s, color="#fff3d6", zorder=0)
        panel.set_xlim(t_s[0], t_s[-1])
    place = ((silent_s + driven_s) / 2, 0.5)
    above.annotate("nobody commands", place, xycoords=("data", "axes fraction"), ha="center", fontsize=8)
    place = (there_s + 0.1, 0.5)
    below.annotate("the paper's transition", place, xycoords=("data", "axes fraction"), fontsize=8)


def draw_delay(axes: "list[Axes]", results: CaseResults) -> None:
    """Draw the amplitude and the frequency of the oscillation over latency."""
    left, right = axes
    left.set_yscale("log")
    for panel, name, scale, label in (
        (left, "amplitude_m", 1e3, "amplitude [mm]"),
        (right, "frequency_hz", 1.0, "frequency [Hz]"),
    ):
        curves = []
        for driven, choice in DRIVEN.items():
            if found := sorted(results.delay(driven).items()):
                values = [np.nan if (value := f.get(name)) is None else value * scale for _, f in found]
                curves.append(Curve(choice.words, np.array([ms for ms, _ in found]), np.array(values)))
        draw_curves(panel, curves, title=f"Oscillation: {label.split()[0]}", x_label="latency [ms]", y_label=label)
        for line in panel.get_lines():
            line.set_marker("o")
            if np.size(line.get_xdata()) < _JOINED:
                line.set_linestyle("none")
    left.set_ylim(top=1e3)
    for place, (k1_1_s, k2_1_s) in enumerate((published.FUZZY_CENTRE, published.DSC_GAINS)):
        margin = published.delay_margin(k1_1_s, k2_1_s, published.COMMON_FILTER_S, EXPERIMENT_PERIOD_S)
        colour = rgb(colour_of(place))
        left.axvline(margin.latency_s * 1e3, color=colour, linestyle=":")
        text = f"unstable by the equations, K1 = {k1_1_s:g}"
        at = {"xycoords": ("data", "axes fraction"), "rotation": 90, "ha": "right", "va": "top", "fontsize": 8}
        left.annotate(text, (margin.latency_s * 1e3, 0.98), color=colour, **at)  # type: ignore[arg-type]


PLOTS: Mapping[str, tuple[Callable[..., None], tuple[str, ...], int, int, tuple[float, float]]] = {
    "figure_8": (draw_circle, (_DSC, _AFDSC), 2, 2, (10.0, 8.0)),
    "figure_10": (draw_path_in_plane, (_EXPERIMENT,), 1, 1, (5.6, 5.6)),
    "figure_11": (draw_control_signals, (_EXPERIMENT,), 2, 1, (8.0, 6.0)),
    "delay": (draw_delay, (), 1, 2, (10.0, 4.5)),
}
"""By name: what draws a picture, the runs that it needs, its panels and its size [inch]."""
