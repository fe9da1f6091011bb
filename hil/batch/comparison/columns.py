"""The columns of a comparison: how each figure is called, in what unit it is shown, and what it means."""

from typing import NamedTuple

from hil.batch.comparison.runs import FIGURES

_NONE = "-"


class Column(NamedTuple):
    """How a figure is shown."""

    name: str
    head: str
    unit: str
    scale: float
    digits: int
    meaning: str
    is_instant: bool = False  # of the run, from which on something stays so

    def text(self, value: float | None) -> str:
        """Return the figure in the column's unit."""
        return _NONE if value is None else f"{value * self.scale:.{self.digits}f}"


COLUMNS = (
    Column("t10_s", "t10", "s", 1.0, 3, "first time from which the planar error stays below 10 mm", is_instant=True),
    Column(
        "tracked_s",
        "tracked",
        "s",
        1.0,
        3,
        "first time from which it stays below 2 % of its initial value",
        is_instant=True,
    ),
    Column("steady_rms_m", "rms", "mm", 1e3, 3, "planar error over the last 5 s, root mean square"),
    Column("steady_max_m", "max", "mm", 1e3, 3, "planar error over the last 5 s, largest"),
    Column("overshoot_m", "overshoot", "mm", 1e3, 1, "how far past the reference, along the line of the initial error"),
    Column("effort_n_m_s", "effort", "N·m·s", 1.0, 1, "∫ Σ abs(τ) dt over the four wheels, by the measured currents"),
    Column("torque_variation_n_m_per_s", "variation", "N·m/s", 1.0, 2, "mean absolute slew of a wheel's torque"),
    Column("saturation_s", "saturated", "s", 1.0, 2, "how long a wheel's command was at its limit"),
)
assert tuple(column.name for column in COLUMNS) == FIGURES
