"""A comparison in pictures: the figures of all laws, and for each condition path, error and torques."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from hil.batch.comparison.conditions import Condition
from hil.batch.comparison.page import OVERVIEW, names
from hil.batch.comparison.result import Comparison, Curves
from hil.batch.figures import shown_columns
from hil.core.types import WHEEL_NAMES
from hil.review.plots import (
    Bar,
    Curve,
    Series,
    colour_of,
    draw_bars,
    draw_error,
    draw_path,
    draw_wheels,
    drawing,
    is_dashed,
)

_APPROACH_S = 3.0
_PANELS = 3
_LOGARITHMIC = ("steady_rms_m", "steady_max_m", "torque_variation_n_m_per_s")
_TITLE, _SMALL_TITLE = 64, 42
"""How many letters fit on a line above half or a third of a picture."""


def draw(comparison: Comparison, folder: Path, kind: str, files: list[Path]) -> None:
    """Draw into a folder that exists, as png, svg or pdf (``kind``), and add each file to ``files``.

    Raises BadInputError when a file cannot be written.
    """
    files.append(_figures(comparison, folder / f"{OVERVIEW}.{kind}"))
    for condition, rows in comparison.tables().items():
        runs = [(row.entry.label, row.curves) for row in rows if row.curves is not None]
        if runs:
            files.extend(_condition(comparison, condition, runs, folder, kind))


def _figures(comparison: Comparison, file: Path) -> Path:
    columns = shown_columns()
    labels = list(dict.fromkeys(row.entry.label for row in comparison.rows))
    groups = [condition.words.replace(", ", "\n") for condition in comparison.tables()]
    with drawing(file, rows=-(-len(columns) // 2), columns=2, size_in=(12.0, 2.0 * len(columns))) as axes:
        for panel, column in zip(axes, columns, strict=False):
            bars = []
            for label in labels:
                rows = [row for row in comparison.rows if row.entry.label == label]
                over = ("nominal", "worst")
                bars.append(Bar(label, *([column.shown(row.worst(column.name, o)) for row in rows] for o in over)))
            worst = "; lighter the worst" if len(comparison.rows[0].runs) > 1 else ""
            title = textwrap.fill(f"{column.head}: {column.meaning}{worst}", _TITLE)
            log = column.name in _LOGARITHMIC
            draw_bars(panel, groups, bars, title=title, y_label=f"{column.head} [{column.unit}]", log=log)
    return file


def _condition(
    comparison: Comparison, condition: Condition, runs: Sequence[tuple[str, Curves]], folder: Path, kind: str
) -> Iterator[Path]:
    # A law that has no curves here keeps its colour for the other pictures.
    numbers = {label: n for n, label in enumerate(dict.fromkeys(row.entry.label for row in comparison.rows))}
    reference = runs[0][1]
    error_file, torque_file = (folder / f"{name}.{kind}" for name in names(condition))
    with drawing(error_file, columns=2, size_in=(12.0, 4.5)) as (path, error):
        paths = [_curve(numbers, label, curves["truth.x_m"], curves["truth.y_m"]) for label, curves in runs]
        draw_path(path, Curve("reference", reference["reference.x_m"], reference["reference.y_m"]), paths)
        errors = [_curve(numbers, label, curves["loop.t_s"], curves["error.planar_m"]) for label, curves in runs]
        draw_error(error, errors, title=textwrap.fill(f"Planar error, {condition.words}", _TITLE))
    yield error_file
    columns = min(_PANELS, len(runs))
    lines = -(-len(runs) // columns)
    with drawing(torque_file, rows=lines, columns=columns, size_in=(12.0, 0.4 + 2.6 * lines)) as axes:
        state = "" if condition.estimator is not None else f", state as {comparison.scenario} has it"
        figure = axes[0].get_figure(root=True)
        assert figure is not None
        figure.suptitle(f"Torques of the wheels, {condition.words}{state}")
        for panel, (label, curves) in zip(axes, runs, strict=False):
            shown = curves["loop.t_s"] <= _APPROACH_S
            torques = {wheel: curves[f"torque.{wheel}"][shown] for wheel in WHEEL_NAMES}
            title = textwrap.fill(label, _SMALL_TITLE)
            draw_wheels(panel, curves["loop.t_s"][shown], torques, title=title, y_label="torque [N·m]")
        for panel in axes[len(runs) :]:
            panel.set_axis_off()
    yield torque_file


def _curve(numbers: Mapping[str, int], label: str, x: Series, y: Series) -> Curve:
    return Curve(label, x, y, colour_of(numbers[label]), dashed=is_dashed(numbers[label]))
