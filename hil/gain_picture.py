"""A picture of the fuzzy tuner's two gain surfaces."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.fuzzy import RULES, FuzzyBlock, Rules, Tables
from hil.plots import Series, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SETS = ("NB", "NS", "Z", "PS", "PB")
_PEAKS = np.linspace(-1.0, 1.0, len(_SETS))
_POINTS = 201
_BEYOND = 1.25  # of the range, to show that the inputs saturate


def draw_gains(tables: Tables, path: Path) -> None:
    """Write a PNG of K1 and K2 [1/s] over error and rate, both in units of their ranges, with the rules at the peaks.

    Raises BadInputError when the file cannot be written.
    """
    across = np.linspace(-_BEYOND, _BEYOND, _POINTS)
    error, rate = np.meshgrid(across, across)
    surfaces = FuzzyBlock.from_tables(tables, 1.0, 1.0).gains_batch(error, rate)
    with drawing(path, columns=2, size_in=(10.0, 4.6)) as both:
        for axes, name, surface, rules in zip(both, ("K1", "K2"), surfaces, RULES[tables], strict=True):
            _draw(axes, f"{name}, tables {tables}", across, surface, rules)


def _draw(axes: "Axes", title: str, across: Series, surface: Series, rules: Rules) -> None:
    from matplotlib.patheffects import withStroke

    outline = [withStroke(linewidth=2.0, foreground="#333333")]
    shades = axes.pcolormesh(across, across, surface, cmap="viridis", shading="nearest", rasterized=True)
    axes.contour(across, across, surface, levels=8, colors="white", linewidths=0.5, alpha=0.6)
    for row, place in zip(rules, _PEAKS, strict=True):
        for level, peak in zip(row, _PEAKS, strict=True):
            axes.text(peak, place, level, ha="center", va="center", color="white", path_effects=outline)
    axes.set_xticks(_PEAKS, _SETS)
    axes.set_yticks(_PEAKS, _SETS)
    axes.grid(visible=False)
    axes.set(title=title, xlabel="error, NB and PB at its range", ylabel="rate of the error", aspect="equal")
    axes.figure.colorbar(shades, ax=axes, label="gain [1/s]")
