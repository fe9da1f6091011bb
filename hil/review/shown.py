"""A run as a page shows it: its signals over time, with no more points than a plot can show."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hil.record.layout import ALARM_COLOUR, Colour
from hil.review.charts import Line
from hil.review.contents import Series
from hil.review.figures import scenario_number
from hil.review.judged import bounds, instants
from hil.review.reader import RecordedRun
from hil.review.stretches import Stretches


class Shown:
    """A run on a page: its label and colour there, its recording from t = 0 on, and its figures.

    ``shift_s`` is added to its times, so that it lies over another run. Stretches around what happened are shown row by
    row, and around ``more_s`` too.
    """

    def __init__(
        self, label: str, run: RecordedRun, found: Mapping[str, Any], colour: Colour, shift_s: float = 0.0
    ) -> None:
        self.label, self.run, self.found, self.colour, self.shift_s = label, run, found, colour, shift_s
        self._kept = run.signals["loop.t_s"] >= 0.0
        self.all_t_s: Series = run.signals["loop.t_s"][self._kept]
        self._stretches = Stretches(self.all_t_s, instants(found))
        self.t_s: Series = self._stretches.t_s + shift_s

    @property
    def longest_s(self) -> float:
        """The longest stretch of which only minimum and maximum are shown [s]."""
        return self._stretches.longest_s

    def series(self, name: str) -> Series:
        """Return a signal from t = 0 on; only NaN if the recording lacks it."""
        values = self.run.signals.get(name)
        return np.full(len(self.all_t_s), np.nan) if values is None else values[self._kept]

    def has(self, *names: str) -> bool:
        """Whether one of the signals has a value anywhere."""
        return any(bool(np.isfinite(self.series(name)).any()) for name in names)

    def line(self, name: str, label: str, colour: Colour, scale: float = 1.0, **style: Any) -> Line:
        """Return a signal over time as a page shows it."""
        return self.curve(scale * self.series(name), label, colour, **style)

    def curve(self, values: Series, label: str, colour: Colour, **style: Any) -> Line:
        """Return values at every row from t = 0 on as a page shows them."""
        return Line(label, self.t_s, self._stretches(values), colour, **style)

    def bounds(self, name: str, scale: float = 1.0) -> Iterator[Line]:
        """Yield the limits of a signal, each over its time."""
        for label, values in bounds(self.run, name):
            yield self.curve(scale * values[self._kept], label, ALARM_COLOUR, dash="dot", width_px=1.2, in_title=False)

    def limits(self, key: str) -> Iterator[Line]:
        """Yield a limit of the scenario in both directions, if it has that."""
        if (limit := scenario_number(self.run, key)) is not None:
            for sign in (-1.0, 1.0):
                values = np.full(len(self.all_t_s), sign * limit)
                yield self.curve(values, "limit", ALARM_COLOUR, dash="dot", width_px=1.0, in_title=False)

    def torque_n_m_a(self, wheel: str) -> float | None:
        """Return the torque constant of a wheel's motor; None if it, or the motor's current, is not known."""
        known = self.has(f"wheel.{wheel}.current_a")
        return scenario_number(self.run, "firmware.torque_constant_n_m_a") if known else None
