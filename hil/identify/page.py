"""The picture of a fit: how far each model is off after a second of the held-out drive, and the values found."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.core.outputs import Existing
from hil.identify.fit import Result
from hil.review.plots import Curve, draw_curves, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEAST_MM = 0.01


def draw(result: Result, path: Path, existing: Existing) -> None:
    """Write a picture of the errors before and after over the held-out drive, and of their distribution.

    Raises BadInputError when the file cannot be written.
    """
    predictions = [("before the fit", result.before)]
    predictions += [(f"fitted, {model.contact}", model.held_out) for model in result.models]
    with drawing(path, columns=2, size_in=(10.0, 4.2), existing=existing) as (left, right):
        curves, shares = [], []
        for label, one in predictions:
            error_mm = np.maximum(1e3 * one.error_m, _LEAST_MM)
            named = f"{label}: rms {1e3 * one.rms_m:.3g} mm"
            curves.append(Curve(named, one.time_s - one.time_s[0], error_mm))
            shares.append(Curve(label, np.sort(error_mm), 100.0 * np.arange(1, len(error_mm) + 1) / len(error_mm)))
        _over_time(left, curves, result.before.against)
        right.set_xscale("log")
        draw_curves(right, shares, title="Windows within", x_label="error after a second [mm]", y_label="share [%]")


def _over_time(axes: "Axes", curves: list[Curve], against: str) -> None:
    axes.set_yscale("log")
    draw_curves(
        axes,
        curves,
        title=f"Held-out drive, against {against}",
        x_label="beginning of the window [s]",
        y_label="error after a second [mm]",
    )
