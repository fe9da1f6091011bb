"""A figure of a run, and a measure: the class that computes figures from the run's rows, block by block."""

from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

RESOLUTION_M = 0.001
NO_TRUTH = "the run has no ground truth"


class Figure(NamedTuple):
    """A number by which a run is judged, and how it is shown.

    Attributes:
        name: its key in the JSON of a run; ``table.key`` for a number in a table, as ``tick_us.p99``.
        label: what reports call it.
        unit: the unit in which it is shown: the stored value times ``scale``.
        meaning: one line that defines it.
        better: "less" or "more"; None where neither is better.
        column: its column in tables of many runs (campaigns, comparisons); None if it has none there.
        of_end: whether it describes the run's end; a run that ended early then lacks the figure.
        printed: whether reports print it on a line of its own.
        resolution: the smallest meaningful difference, in the stored unit.
        resolution_ticks: the same where chance matters, in periods of the loop, for a time that is found tick by tick.
        of_machine: whether it depends on how fast this machine is, so that no baseline has it.
    """

    name: str
    label: str
    unit: str
    scale: float
    meaning: str
    better: str | None = "less"
    column: str | None = None
    of_end: bool = False
    printed: bool = True
    resolution: float = 0.0
    resolution_ticks: float = 0.0
    of_machine: bool = False

    @property
    def key(self) -> str:
        """What users call it in ``[[expect]]``, and tables in their columns: its column, or its name without one."""
        return self.column or self.name


class CommandLimits(NamedTuple):
    """The largest command of one wheel that ``[robot]`` allows: the speed in SPEED mode, the torque in TORQUE mode."""

    speed_rad_s: float
    torque_n_m: float


class RunSetup(NamedTuple):
    """Facts about the run that a measure may use.

    Attributes:
        torque_constant_n_m_a: torque at the wheel per motor current [N·m/A]; None where it is not known.
        limits: the limits of a wheel's command; None where they are not known.
    """

    torque_constant_n_m_a: float | None = None
    limits: CommandLimits | None = None


class Measure(Protocol):
    """Computes one figure, or several that share their work, from a run's rows in bounded memory.

    An instance is made for each run, as ``Class(setup)``. If a run lacks one of the ``signals``, its figures are None.
    """

    figures: ClassVar[tuple[Figure, ...]]
    signals: ClassVar[tuple[str, ...]]
    """The signals that it reads."""

    def __init__(self, setup: RunSetup, /) -> None: ...

    def add(self, signals: Mapping[str, Series], /) -> None:
        """Add the next rows: each signal by name, shape (n,), NaN for a gap. Rows before t = 0 are included."""

    def value(self, name: str, /) -> Any:
        """Return the figure of this key: a number, or for names ``table.key`` the table of numbers.

        Raises NoFigureError where the figure is not defined for this run.
        """


def since_start(signals: Mapping[str, Series]) -> Mapping[str, Series]:
    """Return the rows from t = 0 on; nearly always that is all of them, and nothing is copied."""
    active = signals["loop.t_s"] >= 0.0
    return signals if active.all() else {name: values[active] for name, values in signals.items()}


class NoFigureError(Exception):
    """A figure is not defined for this run; the text says why."""


class TruthGaps:
    """Checks that the ground truth was there in every row."""

    def __init__(self) -> None:
        self._rows = 0
        self._missing = 0
        self._first_s = 0.0

    def add(self, t_s: Series, value: Series) -> None:
        """Add the times of rows and a value of the truth, NaN where there was none, both of shape (n,)."""
        gaps = np.flatnonzero(~np.isfinite(value))
        if len(gaps) and not self._missing:
            self._first_s = float(t_s[gaps[0]])
        self._rows += len(t_s)
        self._missing += len(gaps)

    def require_truth(self) -> None:
        """Raise NoFigureError unless there were rows, and all of them had the truth."""
        if not self._rows:
            raise NoFigureError("the run has no samples")
        if self._missing == self._rows:
            raise NoFigureError(NO_TRUTH)
        if self._missing:
            raise NoFigureError(f"the ground truth is missing at t = {self._first_s:.6g} s")
