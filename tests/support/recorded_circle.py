"""Rows of a made-up run for the recorder: a circle, entered from the side, at 1 kHz.

The numbers are no robot's; they have all their bits in use, and gaps where a run has gaps.
"""

import math
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.core.signals import (
    INDEX,
    SIGNAL_NAMES,
    BatterySignals,
    ErrorSignals,
    EstimatorSignals,
    GuardSignals,
    LinkSignals,
    LoopSignals,
    ReferenceSignals,
    RobotSignals,
    Sample,
)
from hil.core.types import NAN, NAN_WHEELS, Gains, Pose, Twist, Wheels
from hil.record import viewing
from hil.record.ring import RingReader, RingWriter, SharedBlock, ring_bytes
from hil.record.run_files import RunFiles

PERIOD_S = 0.001
ACTIVE, STOPPING = 3.0, 4.0
STOP_TICK = 1400
_RATE_RAD_S = 2 * math.pi / 15


def circle_rows(count: int) -> Iterator[tuple[float, ...]]:
    """Yield the first rows of the run; it stops at tick ``STOP_TICK``."""
    for tick in range(count):
        yield _row(tick, tick * PERIOD_S, STOPPING if tick >= STOP_TICK else ACTIVE)


def circle_table(count: int) -> npt.NDArray[np.float64]:
    """Return the same rows, shape (count, signals)."""
    return np.array(list(circle_rows(count))).reshape(count, len(SIGNAL_NAMES))


def column(table: npt.NDArray[np.float64], signal: str) -> npt.NDArray[np.float64]:
    """Return one signal of a table."""
    return table[:, INDEX[signal]]


def _row(tick: int, t_s: float, state: float) -> tuple[float, ...]:
    x, y = math.cos(_RATE_RAD_S * t_s), math.sin(_RATE_RAD_S * t_s)
    error_x, error_y, error_heading = (-size * math.exp(-6 * t_s) for size in (0.2, 0.15, 0.785))
    truth = Pose(x + error_x, y + error_y, math.pi / 4 + error_heading)
    estimate = Pose(truth.x_m + 0.01, truth.y_m - 0.02, truth.heading_rad + 0.03)
    speed = Wheels(*(8 * math.cos(_RATE_RAD_S * t_s + phase) for phase in (0.0, 1.5, 0.7, 2.2)))
    sample = Sample(
        LoopSignals(t_s, float(tick), 50 + 20 * math.sin(tick), NAN if tick == 0 else 120 + math.sin(tick), 0.0),
        ReferenceSignals(
            x, y, math.pi / 4, -_RATE_RAD_S * y, _RATE_RAD_S * x, 0.0, -(_RATE_RAD_S**2) * x, -(_RATE_RAD_S**2) * y, 0.0
        ),
        estimate,
        Twist(-_RATE_RAD_S * y, _RATE_RAD_S * x, 0.0),
        truth,
        ErrorSignals(error_x, error_y, error_heading, math.hypot(error_x, error_y)),
        Gains(15.0, 15.1, 20 + math.exp(-3 * t_s), 40.0, 40.1, 35.0),
        speed,
        NAN_WHEELS,
        Wheels(*(0.1 * one for one in speed)),
        Wheels(*(0.08 * one for one in speed)),
        Wheels(*(25 + 0.1 * t_s + phase for phase in (0.0, 0.1, 0.2, 0.3))),
        RobotSignals(t_s + 0.02, state, 1.0, 0.01, 0.1, -0.1, 9.81),
        BatterySignals(24 - 0.01 * t_s, 2.0),
        EstimatorSignals(
            *(0.01, 0.02, 1e-3, 1.001, 0.999, 1.002, 1.0),
            *(float(tick // 100), 1.0, 0.0, float(tick % 100), 0.0, 0.0, *[math.nan] * 4),
        ),
        GuardSignals(float(t_s < 0.2), 0.0, 0.0, 0.0),
        LinkSignals(2.0 * tick, 5.0 * tick, 0.0, 1.0, 0.0, 28.0 * tick, 70.0 * tick, 40.0, 5.0, 6.0, 20e3 - t_s, -1.0),
    )
    return tuple(chain.from_iterable(sample))


class Memory:
    """What a run and its recorder share, without the processes."""

    def __init__(self, path: Path) -> None:
        width = len(SIGNAL_NAMES)
        self._block = SharedBlock.reserve().allocate(ring_bytes(512, width))
        self.writer = RingWriter(self._block, 512, width)
        self.ring = RingReader(self._block)
        self._config: dict[str, Any] = {"path": str(path), "properties": {}, "signals": list(SIGNAL_NAMES)}
        self._config |= {"recording_id": "one", "zero_unix_ns": 0, "rotate": [None, None], "quota_bytes": None}
        self._config["viewer"] = viewing.places()

    def files(self, restarts: int = 0) -> RunFiles:
        return RunFiles({**self._config, "restarts": restarts}, self.ring)

    def copy(self) -> bytes:
        return bytes(self._block.buffer)

    def restore(self, content: bytes) -> None:
        self._block.buffer[:] = content

    def close(self) -> None:
        self.ring.close()
        self.writer.close()
        self._block.close()
