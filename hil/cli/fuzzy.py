"""``hil fuzzy``: a picture of the fuzzy tuner's two gain surfaces."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from hil.cli.options import Force
from hil.core.errors import BadInputError, nearest
from hil.core.outputs import Existing, check_free, existing_files

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hil.laws.fuzzy import Rules, Tables
    from hil.review.plots import Series

_SETS = ("NB", "NS", "Z", "PS", "PB")
_PEAKS = (-1.0, -0.5, 0.0, 0.5, 1.0)
_POINTS = 201
_BEYOND = 1.25  # times the range, to show that the inputs saturate


def fuzzy(
    tables: Annotated[str, Option(metavar="printed|corrected", help="which of the paper's tables")] = "printed",
    out: Annotated[Path, Option(metavar="FILE.png|.svg|.pdf", help="where the picture goes")] = Path("gains.png"),
    force: Force = False,
) -> None:
    """Draw both gain surfaces of AFDSC's fuzzy block."""
    from hil.laws.fuzzy import RULES
    from hil.review.plots import picture_format

    if tables not in RULES:
        raise BadInputError(f"--tables {tables}: there are no such tables{nearest(tables, RULES)}")
    picture_format(out)
    existing = existing_files(force=force)
    check_free("picture", out, existing)
    draw_gains(tables, out, existing)
    print(out)


def draw_gains(tables: "Tables", path: Path, existing: Existing = "refuse") -> None:
    """Write a picture of K1 and K2 [1/s] over error and rate in units of their ranges, with the rules at the peaks.

    ``existing`` says what to do when the file exists. Raises BadInputError when the file cannot be written.
    """
    import numpy as np

    from hil.laws.fuzzy import K1_1_S, K2_1_S, RULES, FuzzyBlock
    from hil.review.plots import drawing

    across = np.linspace(-_BEYOND, _BEYOND, _POINTS)
    error, rate = np.meshgrid(across, across)
    surfaces = FuzzyBlock.from_tables(tables, 1.0, 1.0).gains_batch(error, rate)
    with drawing(path, columns=2, size_in=(10.0, 4.6), existing=existing) as both:
        for axes, name, levels, surface, rules in zip(
            both, ("K1", "K2"), (K1_1_S, K2_1_S), surfaces, RULES[tables], strict=True
        ):
            _draw(axes, f"{name}, tables {tables}", across, surface, rules, levels)


def _draw(
    axes: "Axes", title: str, across: "Series", surface: "Series", rules: "Rules", levels: Mapping[str, float]
) -> None:
    from matplotlib.patheffects import withStroke

    outline = [withStroke(linewidth=2.0, foreground="#333333")]
    # From the smallest to the largest level, so that the pictures of both tables have the same scale.
    least, most = min(levels.values()), max(levels.values())
    shades = axes.pcolormesh(
        across, across, surface, cmap="viridis", shading="nearest", rasterized=True, vmin=least, vmax=most
    )
    axes.contour(across, across, surface, levels=8, colors="white", linewidths=0.5, alpha=0.6)
    for row, place in zip(rules, _PEAKS, strict=True):
        for level, peak in zip(row, _PEAKS, strict=True):
            axes.text(peak, place, level, ha="center", va="center", color="white", path_effects=outline)
    marks = [f"{name}\n{peak:g}" for name, peak in zip(_SETS, _PEAKS, strict=True)]
    axes.set_xticks(_PEAKS, marks)
    axes.set_yticks(_PEAKS, marks)
    axes.grid(visible=False)
    axes.set(
        title=title,
        xlabel="error, in units of its range",
        ylabel="rate of the error, in units of its range",
        aspect="equal",
    )
    axes.figure.colorbar(shades, ax=axes, label="gain [1/s]")
