"""The figures of runs in batches: how a table of many runs shows each, and the columns of a row.

The figures themselves, those of other packages among them, are registered in ``hil.judge.figures``.
"""

from typing import Any, NamedTuple

from hil.judge.figures import table_figures
from hil.judge.judged_run import JudgedRun, in_order

KEY = "key"
MACHINE = "machine."
"""The prefix of columns that depend on the machine and not on the run."""
_COUNTS = ("ticks", "stale_ticks", "held_ticks", "deadline_misses")


class Column(NamedTuple):
    """How tables and pictures of many runs show a figure; of each less is better.

    Attributes:
        name: the column in rows. head: the head of a table's column. title: what pictures call it.
        unit: the unit shown: the stored value times ``scale``. digits: the decimals shown.
        meaning: one line that defines it.
    """

    name: str
    head: str
    title: str
    unit: str
    scale: float
    digits: int
    meaning: str

    @property
    def labelled(self) -> str:
        """The title with the unit."""
        return f"{self.title} [{self.unit}]"

    def text(self, value: float | None) -> str:
        """Return a value in the shown unit as text, or a dash for None."""
        return "-" if value is None else f"{value * self.scale:.{self.digits}f}"


_SHOWN = {
    "t10_s": ("t10", "to 10 mm", 3),
    "tracked_s": ("tracked", "tracked", 3),
    "steady_rms_m": ("rms", "steady rms", 3),
    "steady_max_m": ("max", "steady max", 3),
    "overshoot_m": ("overshoot", "overshoot", 1),
    "effort_n_m_s": ("effort", "effort", 1),
    "torque_variation_n_m_per_s": ("variation", "torque variation", 2),
    "saturation_s": ("saturated", "saturated", 2),
}
"""Head, title and decimals by name, in the order of a table; other packages' figures: their label and three."""


def shown_columns() -> list[Column]:
    """Return the figures that tables of laws show, in their order. Raises BadInputError as ``measures``."""
    figures = {name: figure for name, figure in table_figures().items() if figure.printed}
    columns = []
    for name in sorted(figures, key=[*_SHOWN, *figures].index):
        figure = figures[name]
        head, title, digits = _SHOWN.get(name, (figure.label, figure.label, 3))
        unit = figure.unit.removesuffix(" a wheel")
        columns.append(Column(name, head, title, unit, figure.scale, digits, figure.meaning))
    return columns


def column_of(name: str) -> Column:
    """Return how a figure of a row is shown, also one that tables of laws do not show."""
    other = Column(name, name, name, "", 1.0, 3, "")
    return next((column for column in shown_columns() if column.name == name), other)


def run_columns(run: JudgedRun) -> dict[str, Any]:
    """Return the columns that follow from a run."""
    failed = (row.text for row in in_order(run.expect) if row.passed is False)
    counts = {"ticks": run.figures["ticks"], "deadline_misses": run.figures["deadline_misses"], **run.counts._asdict()}
    return {
        **{column: run.number(figure.name) for column, figure in table_figures().items()},
        **{name: counts[name] for name in _COUNTS},
        "wire_sha256": run.wire_sha256,
        "faults_applied": sum(fault.applied or 0 for fault in run.faults),
        "recoveries": len(run.recoveries),
        "failed_expectation": next(failed, None),
        f"{MACHINE}tick_p50_us": run.number("tick_us.p50"),
    }
