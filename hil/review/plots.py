"""Pictures of runs, in one style, with the colours that recordings have.

    with drawing(Path("circle.png"), columns=2) as (left, right):
        draw_path(left, reference, [Curve("afdsc", x_m, y_m)])
        draw_error(right, [Curve("afdsc", t_s, planar_m)])

matplotlib is imported when something is drawn, not before, and always without pyplot: no display and no window. Two
drawings of the same data are the same bytes.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.outputs import Existing, write_whole
from hil.core.types import WHEEL_NAMES
from hil.record.layout import ALARM_COLOUR, REFERENCE_COLOUR, WHEEL_COLOURS, Colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Series = npt.NDArray[np.float64]

# The colours of Okabe and Ito, which colour-blind readers can tell apart, without the yellow, which is hard to see on
# white.
_CYCLE: tuple[Colour, ...] = (
    (0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233),
    (230, 159, 0), (90, 90, 90), (120, 60, 160), (120, 80, 40),
)  # fmt: skip
_DASHES = ("-", (0, (5, 2)))
_INK = "#333333"
_STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    **dict.fromkeys(("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color"), _INK),
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.dpi": 130.0,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",  # text stays text, which can be searched and is no larger
    "svg.hashsalt": "mecanum-hil",
}
_LEAST_ERROR_MM = 0.01  # below the encoders' resolution a logarithmic scale shows noise alone
_BAR_SHARE = 0.8
_MOST_INSIDE = 5  # entries of a legend within the axes; a longer one is beside them


class Curve(NamedTuple):
    """Points in the order in which they are joined; ``x`` and ``y`` of one shape (n,), NaN leaves a gap.

    With ``colour`` None the curve takes the next colour of the cycle.
    """

    label: str
    x: Series
    y: Series
    colour: Colour | None = None
    dashed: bool = False


class Bar(NamedTuple):
    """The bars of one label, one for each group: the nominal value in full colour, the worst one lighter.

    Where the nominal value is None, a cross takes the place of the bar.
    """

    label: str
    nominal: Sequence[float | None]
    worst: Sequence[float | None]


@contextmanager
def drawing(
    file: Path | BytesIO,
    *,
    rows: int = 1,
    columns: int = 1,
    size_in: tuple[float, float] = (6.4, 4.0),
    existing: Existing = "refuse",
) -> Iterator[list["Axes"]]:
    """Yield axes to draw on, row by row, then write the picture: as PNG to a path, or as SVG to a buffer.

    ``existing`` says what to do if the file exists; ``size_in`` is the size of the whole picture [inch]. Everything
    drawn inside has the style of this module. Raises BadInputError when the file cannot be written. If the caller
    raises, nothing is written.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=size_in, layout="constrained")
        FigureCanvasAgg(figure)
        yield list(figure.subplots(rows, columns, squeeze=False).flat)
        if isinstance(file, BytesIO):
            figure.savefig(file, format="svg", metadata={"Date": None})
            return
        png = BytesIO()
        figure.savefig(png, format="png")
        write_whole(file, png.getvalue(), "picture", existing)


def thinned(curve: Curve, points: int = 1200) -> Curve:
    """Return a curve over time with about this many points that looks the same: minimum and maximum of each stretch.

    Gaps (NaN) stay where a whole stretch is empty. A curve that has no more points is returned unchanged.
    """
    count = len(curve.x)
    if count <= points:
        return curve
    size = -(-2 * count // points)
    x, y = (np.pad(series, (0, -count % size), mode="edge").reshape(-1, size) for series in (curve.x, curve.y))
    known = np.isfinite(y)
    extremes = np.argmin(np.where(known, y, np.inf), axis=1), np.argmax(np.where(known, y, -np.inf), axis=1)
    places = np.sort(np.stack(extremes, axis=1), axis=1)
    kept_x, kept_y = (np.take_along_axis(series, places, axis=1).ravel() for series in (x, y))
    return curve._replace(x=kept_x, y=kept_y)


def colour_of(number: int) -> Colour:
    """Return the colour of item ``number`` of a comparison, such as a law."""
    return _CYCLE[number % len(_CYCLE)]


def is_dashed(number: int) -> bool:
    """Return whether the curve of this number is dashed, because another one has its colour."""
    return number >= len(_CYCLE)


def draw_curves(
    axes: "Axes", curves: Sequence[Curve], *, title: str = "", x_label: str = "t [s]", y_label: str = ""
) -> None:
    """Draw curves with a legend; from the tenth on, where the colours repeat, they are dashed."""
    for number, curve in enumerate(curves):
        dashed = curve.dashed or (curve.colour is None and is_dashed(number))
        colour = rgb(curve.colour or colour_of(number))
        axes.plot(curve.x, curve.y, label=curve.label, color=colour, linestyle=_DASHES[dashed])
    axes.set(title=title, xlabel=x_label, ylabel=y_label)
    if any(curve.label for curve in curves):
        _legend(axes)


def _legend(axes: "Axes", **inside: Any) -> None:
    """Show the legend within the axes, or beside them when it is so long that it would hide what they show."""
    is_long = len(axes.get_legend_handles_labels()[1]) > _MOST_INSIDE
    axes.legend(**({"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if is_long else inside))


def draw_path(axes: "Axes", reference: Curve, curves: Sequence[Curve], *, title: str = "Path") -> None:
    """Draw where robots went, x and y in m on one scale, over the reference; a dot marks where each began."""
    colour = rgb(reference.colour or REFERENCE_COLOUR)
    axes.plot(reference.x, reference.y, label=reference.label, color=colour, linewidth=4.0, alpha=0.5)
    draw_curves(axes, curves, title=title, x_label="x [m]", y_label="y [m]")
    for number, curve in enumerate(curves):
        known = np.flatnonzero(np.isfinite(curve.x) & np.isfinite(curve.y))[:1]
        axes.plot(curve.x[known], curve.y[known], "o", color=rgb(curve.colour or colour_of(number)), markersize=4.0)
    axes.set_aspect("equal", adjustable="datalim")


def draw_error(axes: "Axes", curves: Sequence[Curve], *, title: str = "Planar error") -> None:
    """Draw the planar error over time, given in s and m and shown in mm, on a logarithmic scale.

    A line marks 10 mm, the error of t10. Errors below 0.01 mm are drawn at 0.01 mm.
    """
    label = "planar error [mm]"
    scaled = [curve._replace(y=curve.y * 1e3) for curve in curves]
    if any(np.any(curve.y < _LEAST_ERROR_MM) for curve in scaled):
        label += f", less than {_LEAST_ERROR_MM:g} shown as that"
    scaled = [curve._replace(y=np.maximum(curve.y, _LEAST_ERROR_MM)) for curve in scaled]
    axes.set_yscale("log")
    axes.axhline(10.0, color=rgb(ALARM_COLOUR), linewidth=0.8, linestyle=":")
    draw_curves(axes, scaled, title=title, y_label=label)


def draw_wheels(axes: "Axes", t_s: Series, wheels: Mapping[str, Series], *, title: str, y_label: str) -> None:
    """Draw a quantity of the four wheels over time; ``wheels`` has it by wheel, as in ``WHEEL_NAMES``."""
    each = zip(WHEEL_NAMES, WHEEL_COLOURS, strict=True)
    curves = [Curve(wheel.upper(), t_s, wheels[wheel], colour) for wheel, colour in each]
    draw_curves(axes, curves, title=title, y_label=y_label)


def draw_bars(
    axes: "Axes", groups: Sequence[str], bars: Sequence[Bar], *, title: str, y_label: str, log: bool = False
) -> None:
    """Draw groups of bars, those of one label in one colour: the nominal value in full, the worst behind it lighter.

    A logarithmic scale has no zero for a bar to start from: there the two values are dots, joined by a line. If a value
    is zero or less, the scale is linear.

    Raises ValueError when a bar does not have one value for each group.
    """
    values = [value for bar in bars for value in (*bar.nominal, *bar.worst) if value is not None]
    log = log and min(values, default=0.0) > 0.0
    width = _BAR_SHARE / max(1, len(bars))
    for number, bar in enumerate(bars):
        colour = rgb(colour_of(number))
        for group, nominal, worst in zip(range(len(groups)), bar.nominal, bar.worst, strict=True):
            place = group + (number - (len(bars) - 1) / 2) * width
            label = bar.label if group == 0 else None
            if log:
                both = [np.nan if value is None else value for value in (nominal, worst)]
                axes.plot([place, place], both, "-", color=colour, alpha=0.35)
                axes.plot(place, both[1], "o", color=colour, alpha=0.35, markersize=5.0)
                axes.plot(place, both[0], "o", color=colour, markersize=5.0, label=label)
            else:
                axes.bar(place, worst or 0.0, width * 0.9, color=colour, alpha=0.35)
                axes.bar(place, nominal or 0.0, width * 0.9, color=colour, label=label)
            if nominal is None:
                foot = axes.get_xaxis_transform()
                axes.plot(place, 0.0, "x", color=colour, markersize=5.0, clip_on=False, transform=foot)
    if any(nominal is None for bar in bars for nominal in bar.nominal):
        axes.plot([], [], "x", color=_INK, markersize=5.0, label="refused, or no figure")
    axes.set_xticks(range(len(groups)), groups)
    axes.grid(visible=False, axis="x")
    axes.set(title=title, ylabel=y_label)
    if log:
        axes.set_yscale("log")
    else:
        axes.margins(y=0.3)  # for the legend above the bars
        axes.set_ylim(bottom=0.0)
    _legend(axes, ncols=3, loc="upper center")


def rgb(colour: Colour) -> tuple[float, float, float]:
    """Return a colour as matplotlib takes it."""
    red, green, blue = (channel / 255 for channel in colour)
    return red, green, blue
