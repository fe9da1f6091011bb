"""The figures of runs in batches: how a table of many runs shows each, and the columns of a row.

The figures themselves, those of other packages among them, are registered in ``hil.judge.figures``.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from hil.batch.job import FAILED, PASSED, Outcome
from hil.judge.figures import check_figure as check_name
from hil.judge.figures import number, table_figures
from hil.judge.words import in_order

KEY = "key"
MACHINE = "machine."
"""The prefix of columns that depend on the machine and not on the run."""
_COUNTS = ("ticks", "stale_ticks", "held_ticks", "deadline_misses")
_TEXTS = (KEY, "law", "fault", "outcome", "reason", "failed_expectation", "wire_sha256")
_WHOLE = ("seed", "sample", "faults_applied", "recoveries", *_COUNTS)
_OF_MACHINE = {"wall_s": float, "worker": str, "commit": str, "tick_p50_us": float}


class Column(NamedTuple):
    """How tables and pictures of many runs show a figure; of each less is better.

    Attributes:
        name: the column in rows. head: the head of a table's column. title: what pictures call it.
        unit: the unit shown: the stored value times ``scale``. digits: the decimals shown.
        meaning: one line that defines it.
        is_instant: whether it is a time in the run from which on a condition holds, such as a settling time.
    """

    name: str
    head: str
    title: str
    unit: str
    scale: float
    digits: int
    meaning: str
    is_instant: bool

    @property
    def labelled(self) -> str:
        """The title with the unit."""
        return f"{self.title} [{self.unit}]"

    def shown(self, value: float | None) -> float | None:
        """Return a value in the shown unit."""
        return None if value is None else value * self.scale

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
_INSTANTS = ("t10_s", "tracked_s")


def shown_columns() -> list[Column]:
    """Return the figures that tables of laws show, in their order. Raises BadInputError as ``measures``."""
    figures = {name: figure for name, figure in table_figures().items() if figure.printed}
    columns = []
    for name in sorted(figures, key=[*_SHOWN, *figures].index):
        figure = figures[name]
        head, title, digits = _SHOWN.get(name, (figure.label, figure.label, 3))
        unit = figure.unit.removesuffix(" a wheel")
        columns.append(Column(name, head, title, unit, figure.scale, digits, figure.meaning, name in _INSTANTS))
    return columns


def column_of(name: str) -> Column:
    """Return how a figure of a row is shown, also one that tables of laws do not show."""
    other = Column(name, name, name, "", 1.0, 3, "", False)
    return next((column for column in shown_columns() if column.name == name), other)


def row_columns() -> dict[str, type]:
    """Return the columns of a campaign's row with their types, besides those of its axes."""
    return {
        **dict.fromkeys(_TEXTS, str),
        **dict.fromkeys(_WHOLE, int),
        **dict.fromkeys(table_figures(), float),
        **{MACHINE + name: kind for name, kind in _OF_MACHINE.items()},
    }


def run_columns(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns that follow from the figures of a run (``hil run --json``)."""
    failed = (row["text"] for row in in_order(metrics["expect"]) if row["passed"] is False)
    return {
        **{column: number(metrics, figure.name) for column, figure in table_figures().items()},
        **{name: metrics[name] for name in (*_COUNTS, "wire_sha256")},
        "faults_applied": sum(fault["applied"] or 0 for fault in metrics["fault"]),
        "recoveries": len(metrics["recoveries"]),
        "failed_expectation": next(failed, None),
        f"{MACHINE}tick_p50_us": number(metrics, "tick_us.p50"),
    }


def row_of(outcome: Outcome) -> dict[str, Any]:
    """Return an outcome as a row, without its details and recording."""
    machine = {f"{MACHINE}wall_s": outcome.wall_s, f"{MACHINE}worker": outcome.worker}
    return {KEY: outcome.key, "outcome": outcome.status, "reason": outcome.reason, **outcome.figures, **machine}


def outcome_of(row: Mapping[str, Any]) -> Outcome:
    """Return the outcome from a row of ``row_of``, so that a plan can continue from it."""
    figures = dict(row)
    wall_s, worker = (figures.pop(f"{MACHINE}{name}") for name in ("wall_s", "worker"))
    key, status, reason = (figures.pop(name) for name in (KEY, "outcome", "reason"))
    return Outcome(key, status, reason, figures, wall_s=wall_s, worker=worker)


def as_judged(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row, without figures if its run ended early: that lowers effort and overshoot undeservedly."""
    missing: dict[str, Any] = dict.fromkeys(table_figures())
    return {**missing, **row} if row["outcome"] in (PASSED, FAILED) else {**row, **missing}


def check_figure(name: str, where: str) -> None:
    """Raise BadInputError unless ``name`` is a figure of a row."""
    check_name(name, where, table_figures())
