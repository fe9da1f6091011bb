"""The chart of the pose that a law acted on against the true one."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.review.charts import Chart, Panel
from hil.review.contents import Series
from hil.review.shown import Shown

_POSITION, _HEADING = "estimator.sigma_position_m", "estimator.sigma_heading_rad"
_OF = {"x_m": ("x", "mm", _POSITION), "y_m": ("y", "mm", _POSITION), "heading_rad": ("heading", "mrad", _HEADING)}
BELIEVED_SIGNALS = (*(f"{group}.{name}" for group in ("pose", "truth") for name in _OF), _POSITION, _HEADING)
"""The signals that the chart needs."""


def is_estimated(run: Shown) -> bool:
    """Return whether the truth is known, and the law acted on another pose."""
    apart = _apart(run, "x_m")
    return bool(np.any(np.abs(apart[np.isfinite(apart)]) > 0.0))


def believed(runs: Sequence[Shown]) -> Chart:
    """Return believed minus true pose, within twice the standard deviation that the estimator believed of it.

    Without panels if the laws acted on the truth, or the truth is not known.
    """
    estimated = [run for run in runs if is_estimated(run)]
    panels = []
    for name, (title, unit, deviation) in _OF.items():
        lines = [run.curve(1e3 * _apart(run, name), run.label, run.colour) for run in estimated]
        style: dict[str, Any] = {"dash": "dot", "width_px": 1.0, "in_title": False}
        lines += [
            run.line(deviation, "twice the deviation", run.colour, scale, **style)
            for run in estimated
            if run.has(deviation)
            for scale in (-2e3, 2e3)
        ]
        panels += [Panel(f"{title}, believed minus true", unit, lines, height_px=120)] if lines else []
    caption = "The pose that the law acted on, minus the true one. Dots: twice the deviation that the estimator told."
    return Chart("Believed and true pose", caption, panels)


def _apart(run: Shown, name: str) -> Series:
    apart: Series = run.series(f"pose.{name}") - run.series(f"truth.{name}")
    return np.remainder(apart + np.pi, 2.0 * np.pi) - np.pi if name == "heading_rad" else apart
