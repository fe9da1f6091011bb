"""What a run leaves behind: signals as arrays, figures, and what they mean for the exit code."""

import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hil.errors import HilError
from hil.scenario import Scenario

if TYPE_CHECKING:
    import pandas as pd

Series = npt.NDArray[np.float64]


class MemorySink:
    """Keeps every row in memory; ``names`` are the signals of the run."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._values = array.array("d")

    def put(self, row: tuple[float, ...]) -> None:
        """Take one row in the order of the signals."""
        self._values.extend(row)

    def signals(self) -> dict[str, Series]:
        """Return every signal by name, each of shape (ticks,)."""
        rows = np.frombuffer(self._values, dtype=np.float64).reshape(-1, len(self._names))
        return {name: rows[:, i] for i, name in enumerate(self._names)}


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Attributes:
        scenario: what was run.
        metrics: the figures, as ``hil run --json`` prints them; a figure without a meaning is None, with the reason
            under ``reasons``.
        signals: every signal of the run by name, each of shape (ticks,): those of ``hil list signals``, then the extra
            ones.
        failure: what ended the run early, or None.
    """

    scenario: Scenario
    metrics: Mapping[str, Any] = field(repr=False)
    signals: Mapping[str, Series] = field(repr=False)
    failure: HilError | None

    @property
    def passed(self) -> bool:
        """Whether the run ended as expected."""
        return bool(self.metrics["passed"])

    @property
    def exit_code(self) -> int:
        """0 as expected, 1 when an expectation failed, 2 when the law failed, 3 when the link or the device did."""
        if self.failure is not None:
            return self.failure.exit_code
        return 0 if self.passed else 1

    @cached_property
    def _frame(self) -> "pd.DataFrame":
        import pandas as pd

        return pd.DataFrame(dict(self.signals)).set_index("loop.t_s", drop=False)

    def frame(self) -> "pd.DataFrame":
        """Return the signals as a pandas frame, one row a tick, indexed by ``loop.t_s``."""
        return self._frame
