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

from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.outputs import Existing, write_whole
from hil.core.types import WHEEL_NAMES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Series = npt.NDArray[np.float64]
Colour = tuple[int, int, int]

REFERENCE_COLOUR: Colour = (230, 103, 0)
TRUTH_COLOUR: Colour = (2, 61, 240)
ESTIMATE_COLOUR: Colour = (11, 180, 123)
X_COLOUR: Colour = (196, 15, 103)
Y_COLOUR: Colour = (0, 187, 0)
HEADING_COLOUR: Colour = (213, 120, 255)
PLAIN_COLOUR: Colour = (159, 159, 159)
ALARM_COLOUR: Colour = (181, 30, 0)
WHEEL_COLOURS: tuple[Colour, ...] = ((86, 180, 233), (230, 159, 0), (0, 190, 140), (214, 117, 176))

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
    "axes.formatter.limits": (-6, 6),  # 0.5 and not 5e-1
    "axes.formatter.useoffset": False,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.dpi": 130.0,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",  # text stays text, which can be searched and is no larger
    "svg.hashsalt": "mecanum-hil",
}
_LEAST_ERROR_MM = 0.01  # below the encoders' resolution a logarithmic scale shows noise alone
FORMATS = ("png", "svg", "pdf")
"""The formats of a picture, by the ending of its file."""
_LETTER_IN, _KEY_IN = 0.062, 0.55  # of a legend: a letter at its size, and the sign before each entry with its gaps
_FEW_DECADES = 2.0
_MOST_ALONG_X = 7


class Curve(NamedTuple):
    """Points in the order in which they are joined; ``x`` and ``y`` of one shape (n,), NaN leaves a gap.

    With ``colour`` None the curve takes the next colour of the cycle.
    """

    label: str
    x: Series
    y: Series
    colour: Colour | None = None
    dashed: bool = False


@contextmanager
def drawing(
    file: Path | BytesIO,
    *,
    rows: int = 1,
    columns: int = 1,
    size_in: tuple[float, float] = (6.4, 4.0),
    existing: Existing = "refuse",
) -> Iterator[list["Axes"]]:
    """Yield axes to draw on, row by row, then write the picture: in the format of the path's ending; a buffer gets SVG.

    ``existing`` says what to do if the file exists; ``size_in`` is the size of the whole picture [inch]. Everything
    drawn inside has the style of this module, and what has a label is in one legend below. Raises BadInputError
    when the file has another ending or cannot be written. If the caller raises, nothing is written.
    """
    kind = "svg" if isinstance(file, BytesIO) else picture_format(file)
    need("plots", "a picture")
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=size_in, layout="constrained")
        FigureCanvasAgg(figure)
        yield list(figure.subplots(rows, columns, squeeze=False).flat)
        for axes in figure.get_axes():
            _say_plainly(axes)
        _legend(figure)
        buffer = file if isinstance(file, BytesIO) else BytesIO()
        # Without the time, so that the same data give the same bytes.
        figure.savefig(buffer, format=kind, metadata={"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind))
        if not isinstance(file, BytesIO):
            write_whole(file, buffer.getvalue(), "picture", existing)


def picture_format(file: Path) -> str:
    """Return the format of a picture by the ending of its file: png, svg or pdf. Raises BadInputError for another."""
    kind = file.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise BadInputError(f"picture {file}: its name must end in .png, .svg or .pdf, which tells its format")
    return kind


def check_format(option: str, kind: str) -> str:
    """Return the format that an option names. Raises BadInputError if there is no such format."""
    if kind not in FORMATS:
        raise BadInputError(f"{option} {kind}: expected png, svg or pdf")
    return kind


def _say_plainly(axes: "Axes") -> None:
    """Write the numbers of logarithmic axes as 0.5 and 200, and no more along x than have room.

    Between the decades of a logarithmic axis there are numbers too where the decades are few.
    """
    from matplotlib.ticker import AutoLocator, FuncFormatter, LogLocator, MaxNLocator, NullFormatter

    if isinstance(axes.xaxis.get_major_locator(), AutoLocator):
        axes.xaxis.set_major_locator(MaxNLocator(_MOST_ALONG_X, steps=[1, 2, 5, 10]))

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if axis.get_scale() == "log":
            plain = FuncFormatter(lambda value, _: f"{value:g}")
            axis.set_major_formatter(plain)
            few = np.log10(high / low) < _FEW_DECADES
            axis.set_minor_locator(LogLocator(subs=(2.0, 5.0) if few else "auto"))
            axis.set_minor_formatter(plain if few else NullFormatter())


def colour_of(number: int) -> Colour:
    """Return the colour of item ``number`` of a comparison, such as a law."""
    return _CYCLE[number % len(_CYCLE)]


def is_dashed(number: int) -> bool:
    """Return whether the curve of this number is dashed, because another one has its colour."""
    return number >= len(_CYCLE)


def draw_curves(
    axes: "Axes", curves: Sequence[Curve], *, title: str = "", x_label: str = "t [s]", y_label: str = ""
) -> None:
    """Draw curves; from the tenth on, where the colours repeat, they are dashed."""
    for number, curve in enumerate(curves):
        dashed = curve.dashed or (curve.colour is None and is_dashed(number))
        colour = rgb(curve.colour or colour_of(number))
        axes.plot(curve.x, curve.y, label=curve.label, color=colour, linestyle=_DASHES[dashed])
    axes.set(title=title, xlabel=x_label, ylabel=y_label)


def _legend(figure: "Figure") -> None:
    """Show one legend below all axes, where it hides nothing, with each of their labels once."""
    each = [axes.get_legend_handles_labels() for axes in figure.get_axes()]
    keys = {label: handle for handles, labels in each for handle, label in zip(handles, labels, strict=True) if label}
    if keys:
        longest_in = _KEY_IN + _LETTER_IN * max(map(len, keys))
        columns = max(1, min(len(keys), int(figure.get_figwidth() / longest_in)))
        figure.legend(keys.values(), keys.keys(), loc="outside lower center", ncols=columns)


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
    scaled = [curve._replace(y=curve.y * 1e3) for curve in curves]
    if any(np.any(curve.y < _LEAST_ERROR_MM) for curve in scaled):
        title += f", drawn from {_LEAST_ERROR_MM:g} mm"
    scaled = [curve._replace(y=np.maximum(curve.y, _LEAST_ERROR_MM)) for curve in scaled]
    axes.set_yscale("log")
    axes.axhline(10.0, color=rgb(ALARM_COLOUR), linewidth=0.8, linestyle=":")
    draw_curves(axes, scaled, title=title, y_label="planar error [mm]")


def draw_wheels(axes: "Axes", t_s: Series, wheels: Mapping[str, Series], *, title: str, y_label: str) -> None:
    """Draw a quantity of the four wheels over time; ``wheels`` has it by wheel, as in ``WHEEL_NAMES``."""
    each = zip(WHEEL_NAMES, WHEEL_COLOURS, strict=True)
    curves = [Curve(wheel.upper(), t_s, wheels[wheel], colour) for wheel, colour in each]
    draw_curves(axes, curves, title=title, y_label=y_label)


def rgb(colour: Colour) -> tuple[float, float, float]:
    """Return a colour as matplotlib takes it."""
    red, green, blue = (channel / 255 for channel in colour)
    return red, green, blue
