"""Draws how the command of a shadow law differs from that of the law that drives the robot, and the rms of that."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from hil.core.types import WHEEL_NAMES
from hil.record.decimate import Decimator
from hil.record.drawings import Times, indexes
from hil.record.layout import PLAIN_COLOUR, SHADOW_GROUP, SHADOW_PATH, WHEEL_COLOURS, Entity
from hil.record.ring import Rows

_PERIOD_S = 0.005


class ShadowCurves:
    """Draws the command, the differences shadow minus command of the wheels, and their rms over all wheels so far.

    ``entities`` are those of the run, of which the shadows' commands are some. A tick in which either has no command
    does not count.
    """

    def __init__(self, recording: rr.RecordingStream, entities: Sequence[Entity], column: Mapping[str, int]) -> None:
        self._rerun = recording
        self._decimator = Decimator(_PERIOD_S)
        self._pairs: dict[str, tuple[list[int], list[int]]] = {}
        for entity in entities:
            law, _, word = entity.path.removeprefix(f"{SHADOW_PATH}/").rpartition("/")
            signals = [series.signal for series in entity.series]
            driven = [signal.removeprefix(f"{SHADOW_GROUP}.{law}.") for signal in signals]
            if word == "command" and entity.path.startswith(SHADOW_PATH) and all(name in column for name in driven):
                self._pairs[law] = [column[name] for name in signals], [column[name] for name in driven]
        self._sums = dict.fromkeys(self._pairs, (0.0, 0))

    @property
    def laws(self) -> list[str]:
        """The names of the shadow laws."""
        return list(self._pairs)

    def describe(self) -> None:
        """Log what does not change: labels and colours."""
        wheels = [wheel.upper() for wheel in WHEEL_NAMES]
        for law in self._pairs:
            own = rr.SeriesLines(names=[f"{wheel} command" for wheel in wheels], colors=WHEEL_COLOURS, widths=[1.5] * 4)
            self._rerun.log(f"{SHADOW_PATH}/{law}/driven", own, static=True)
            lines = rr.SeriesLines(names=wheels, colors=WHEEL_COLOURS, widths=[1.5] * len(wheels))
            self._rerun.log(f"{SHADOW_PATH}/{law}/difference", lines, static=True)
            rms = rr.SeriesLines(names="rms of all wheels so far", colors=PLAIN_COLOUR, widths=2.0)
            self._rerun.log(f"{SHADOW_PATH}/{law}/rms", rms, static=True)

    def rows(self, rows: Rows, times: Times) -> None:
        """Draw rows of shape (n, signals)."""
        kept = self._decimator.keep(times[:, 0])
        index = indexes(times[kept])
        for law, (shadow, driven) in self._pairs.items():
            difference = rows[:, shadow] - rows[:, driven]
            squares = np.nan_to_num(difference**2).sum(axis=1)
            total, count = self._sums[law]
            totals = total + np.cumsum(squares)
            counts = count + np.cumsum(np.isfinite(difference).sum(axis=1))
            self._sums[law] = float(totals[-1]), int(counts[-1])
            if not len(kept) or not counts[-1]:
                continue
            rms = np.sqrt(np.divide(totals, counts, out=np.full(len(rows), np.nan), where=counts > 0))
            commands = rr.Scalars.columns(scalars=rows[kept][:, driven])
            self._rerun.send_columns(f"{SHADOW_PATH}/{law}/driven", index, commands)
            differences = rr.Scalars.columns(scalars=difference[kept])
            self._rerun.send_columns(f"{SHADOW_PATH}/{law}/difference", index, differences)
            self._rerun.send_columns(f"{SHADOW_PATH}/{law}/rms", index, rr.Scalars.columns(scalars=rms[kept]))

    def rms(self, law: str) -> float | None:
        """Return the rms so far; None without a tick in which both had a command."""
        total, count = self._sums[law]
        return float(np.sqrt(total / count)) if count else None
