"""The safety judge of third-party motor controllers, by their torques at the plant port and the host's commands.

Their protocols have neither sessions nor sequences, so what is allowed follows from the commands of the run alone:

1. No wheel is driven away from its recent commands: one that turns faster than every command of the last
   ``watchdog + ramp``, or against all of them, gets no torque that drives it further. A speed loop may overshoot, so a
       wheel counts only when it is off by more than 1 rad/s and a tenth, is driven by more than a twentieth of the
       torque limit, and that for longer than 50 ms. Before the first command and once the host is gone, the command is
       zero.
2. From a second after that on, the drives give no torque but what holds a wheel at rest: a twentieth of the limit.
3. Every torque is finite, and within the limit.

In torque mode rule 1 applies only to the time after the host has gone.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hil.core.types import WHEEL_NAMES, CommandMode, FourWheels
from hil.drivers.emulated import EmulatedMotors
from hil.scenario import FirmwareTable

_BEYOND_RAD_S = 1.0
_BEYOND_PART = 0.1
_DRIVEN_PART = 0.05
_DRIVEN_TICKS = 50  # some controllers catch up the angle by which they lag, and overshoot for so long
_HOLD_S = 1.0
_ROUNDING = 1e-5

Signals = Mapping[str, np.ndarray]


class MotorsJudge:
    """Records what the emulated controllers do, and judges it once the run's signals are there."""

    silent_rad_s = silent_ticks = None  # set points are not known here, unlike in ``SafetyJudge``

    def __init__(self, firmware: FirmwareTable, mode: CommandMode) -> None:
        self._firmware = firmware
        self._mode = mode
        self._ticks: list[tuple[FourWheels, FourWheels]] = []  # torque [N·m], and speed [rad/s] when the tick begins

    @property
    def left_alone_ticks(self) -> int:
        """How many ticks the robot has to run without a host, so that rule 2 can be judged."""
        return round((self._patience_s + 2 * _HOLD_S) * 1000)

    @property
    def _patience_s(self) -> float:
        return self._firmware.watchdog_s + self._firmware.ramp_s

    def hold(self, node: EmulatedMotors[Any]) -> None:
        """Record a tick; called in each tick."""
        fl, fr, rr, rl = (shaft.speed_rad_s for shaft in node.shafts)
        self._ticks.append((node.torque_n_m, (fl, fr, rr, rl)))

    def complaints(self, signals: Signals) -> Sequence[str]:
        """Return a sentence for each rule that was broken: the first tick and how many; empty when none was."""
        torque, speed = (np.array(column) for column in zip(*self._ticks, strict=True))
        if not np.isfinite(torque).all():
            return ["the drives were given a torque that is no number"]
        begin, end, low, high = self._commanded(signals, len(torque))
        found = []
        limit = self._firmware.torque_limit_n_m
        found += _first(np.abs(torque).max(axis=1) > limit * (1.0 + _ROUNDING), f"the torque is beyond {limit:g} N·m")
        driven = _DRIVEN_PART * limit
        too_fast = (speed > high + _BEYOND_RAD_S + _BEYOND_PART * np.abs(high)) & (torque > driven)
        too_slow = (speed < low - _BEYOND_RAD_S - _BEYOND_PART * np.abs(low)) & (torque < -driven)
        if self._mode is CommandMode.TORQUE:
            too_fast[:end] = too_slow[:end] = False
        for place, wheel in enumerate(WHEEL_NAMES):
            for away in (too_fast[:, place], too_slow[:, place]):
                found += _first(_lasting(away), f"{wheel} is driven away from what was asked")
        gone = min(len(torque), end + round(_HOLD_S * 1000))
        after = np.zeros(len(torque), dtype=bool)
        after[gone:] = np.abs(torque[gone:]).max(axis=1) > driven
        found += _first(after, "the drives still give torque though the host has been gone for more than a second")
        if not (np.abs(torque[begin:end]) > 0.0).any() or gone >= len(torque):
            found.append("the robot was never driven or never left alone, so nothing is shown")
        return found

    def _commanded(self, signals: Signals, ticks: int) -> tuple[int, int, np.ndarray, np.ndarray]:
        """Return the run's first tick, that at which its last command expires, and the lowest and highest commands.

        The latter are those still in force, for each tick and wheel, of shape (ticks, 4).
        """
        t_s = signals["loop.t_s"]
        origin_s = float(np.nanmedian(signals["robot.time_s"] - t_s)) if len(t_s) else 0
        at = np.rint((t_s + origin_s) * 1000).astype(int)
        period = int(np.median(np.diff(at))) if len(at) > 1 else 1
        patience = round(self._patience_s * 1000)
        low, high = np.zeros((ticks, 4)), np.zeros((ticks, 4))
        for place, wheel in enumerate(WHEEL_NAMES):
            commands = np.nan_to_num(signals[f"wheel.{wheel}.speed_command_rad_s"])
            for tick, value in zip(at, commands, strict=True):
                window = slice(max(tick, 0), tick + patience + period)
                np.maximum(high[window, place], value, out=high[window, place])
                np.minimum(low[window, place], value, out=low[window, place])
        first, last = (int(at[0]), int(at[-1])) if len(at) else (0, 0)
        return first, min(ticks, last + patience), low, high


def _lasting(away: np.ndarray) -> np.ndarray:
    """Return the ticks in which something has lasted for more ticks in a row than it may."""
    count, marks = 0, np.zeros(len(away), dtype=bool)
    for place, is_away in enumerate(away):
        count = count + 1 if is_away else 0
        marks[place] = count > _DRIVEN_TICKS
    return marks


def _first(marks: np.ndarray, what: str) -> list[str]:
    places = np.flatnonzero(marks)
    return [f"at {places[0]} ms of the robot's time, in {len(places)} ticks: {what}"] if len(places) else []
