"""What a recording tells about the robot's motion, as a fit needs it: wheel angles, currents, yaw rate, pose fixes.

The firmware's speeds come out of a tracking filter, critically damped with the bandwidth b: ω_m = b² / (s + b)² ω. Its
inverse gives the angle of a wheel without the filter's delay:

    θ = ∫ω_m + (2 / b - T / 2) ω_m + (1 / b² - 2 T / b) dω_m/dt

T is the firmware's tick of 1 ms, for which the filter looks ahead (``wheel_tracker_update`` in control.c).
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.core.errors import BadInputError, apart
from hil.core.model import RobotModel
from hil.core.signals import TRUE_POSE, WHEEL_SPEEDS
from hil.core.types import WHEEL_NAMES
from hil.record.properties import scenario_values
from hil.record.reader import read
from hil.robot.driver_registry import OUR_DRIVER

Array = npt.NDArray[np.float64]

_TICK_S = 1e-3
_TORQUE_UNIT_N_M = 1 / 256  # by which TORQUE_COMMAND of wheel.dbc counts a torque
_POSE = ("x_m", "y_m", "heading_rad")
_CURRENTS = tuple(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES)
_COMMANDS = tuple(f"wheel.{wheel}.torque_command_n_m" for wheel in WHEEL_NAMES)
_FIX = ("estimator.fix_time_s", *(f"estimator.fix_{name}" for name in _POSE))
_CLOCK = ("robot.time_s", "robot.yaw_rate_rad_s")
SIGNALS = ("loop.t_s", "loop.tick", *_CLOCK, *WHEEL_SPEEDS, *_CURRENTS, *_COMMANDS, *_FIX, *TRUE_POSE)
"""The signals that a fit reads."""
_LEAST_S = 2.0
_MOST_MISSING = 3


@dataclass(frozen=True)
class Drive:
    """One recording as arrays over n feedbacks with one period between them, all by the robot's own clock.

    Attributes:
        path: the recording.
        robot: the controller's model of the robot when it was made.
        values: all values of its scenario by dotted key.
        period_s: time between two feedbacks.
        time_s: (n,) sampling instants.
        angle_rad: (n, 4) wheel angles since the first, FL, FR, RR, RL.
        current_a: (n, 4) motor currents; a row is the mean since the row before.
        torque_command_n_m: (n, 4) torques that were commanded, as the wire carried them; NaN where none was.
        yaw_rate_rad_s: (n,) gyro.
        fixes: (k, 4) pose fixes in the order of their stamps: stamp [s], x, y [m], heading [rad].
        truth: (n, 3) true poses; NaN without a source of them.
        unused_s: how much longer the recorded feedback is, because of gaps in it.
    """

    path: Path
    robot: RobotModel
    values: Mapping[str, Any]
    period_s: float
    time_s: Array
    angle_rad: Array
    current_a: Array
    torque_command_n_m: Array
    yaw_rate_rad_s: Array
    fixes: Array
    truth: Array
    unused_s: float

    @property
    def speed_rad_s(self) -> Array:
        """Wheel speeds without the delay of the firmware's filter, of shape (n, 4)."""
        speed: Array = np.gradient(self.angle_rad, self.period_s, axis=0)
        return speed

    @property
    def has_currents(self) -> bool:
        """Whether the robot measured its motors' currents, and not only zeros."""
        return bool(np.isfinite(self.current_a).all() and np.abs(self.current_a).max() > 0.0)

    @property
    def has_truth(self) -> bool:
        """Whether the true pose was recorded: the robot was a virtual one, or a motion capture watched it."""
        return bool(np.isfinite(self.truth).all())


def read_drive(path: Path) -> Drive:
    """Read a recording of ``hil run`` as a fit needs it: its longest stretch without a long gap in the feedback.

    Up to three feedbacks that are missing in a row are interpolated, as a line loses one now and then.

    Raises BadInputError when it cannot be read, lacks a signal or a gyro, or is too short.
    """
    run = read(path, SIGNALS)
    missing = [name for name in (*_CLOCK, *WHEEL_SPEEDS) if name not in run.signals]
    if missing:
        raise BadInputError(f"{path}: it lacks the signal {missing[0]}; expected a recording of hil run")
    return drive_of(path, scenario_values(run.properties), run.signals)


def drive_of(path: Path, values: Mapping[str, Any], signals: Mapping[str, Array]) -> Drive:
    """Return a drive from a run's signals, by name, and its scenario's ``values``. Raises as ``read_drive``."""
    nothing = np.full(len(signals["robot.time_s"]), np.nan)

    def table(names: tuple[str, ...]) -> Array:
        return np.stack([signals.get(name, nothing) for name in names], axis=1)

    time_s = signals["robot.time_s"]
    is_known = np.isfinite(table(WHEEL_SPEEDS)).all(axis=1) & np.isfinite(time_s)
    rows = _whole_rows(path, time_s, np.asarray(is_known, dtype=np.bool_))
    period_s = float(np.median(np.diff(time_s[rows])))
    span_s = float(time_s[rows[-1]] - time_s[rows[0]])
    if span_s < _LEAST_S:
        raise BadInputError(
            f"{path}: its longest stretch without a gap in the feedback is {apart(span_s, _LEAST_S, digits=2)} s; "
            f"expected at least {_LEAST_S:g} s"
        )
    places = np.round((time_s[rows] - time_s[rows[0]]) / period_s)

    def whole(series: Array) -> Array:
        return _filled(series[rows], places)

    yaw_rate_rad_s = whole(signals.get("robot.yaw_rate_rad_s", nothing))
    if not np.isfinite(yaw_rate_rad_s).all():
        raise BadInputError(f"{path}: the robot has no gyro; hil identify needs one, for lever and heading")
    fixes = table(_FIX)
    fixes = fixes[np.isfinite(fixes).all(axis=1)]
    bandwidth = _bandwidth_rad_s(values)
    return Drive(
        path,
        _robot(path, values),
        values,
        period_s,
        whole(time_s),
        _angles(whole(table(WHEEL_SPEEDS)), period_s, bandwidth),
        whole(table(_CURRENTS)),
        whole(as_sent(table(_COMMANDS)) if _is_ours(values) else table(_COMMANDS)),
        yaw_rate_rad_s,
        fixes[np.argsort(fixes[:, 0], kind="stable")],
        whole(table(TRUE_POSE)),
        float(np.ptp(time_s[is_known])) - span_s,
    )


def _whole_rows(path: Path, time_s: Array, is_known: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
    """Return the places of the longest run of rows that each came one period after the one before, or a few more."""
    places = np.flatnonzero(is_known)
    # A tick without new feedback repeats the feedback before it.
    places = places[np.concatenate([[True], np.diff(time_s[places]) > 0.0])] if len(places) else places
    if len(places) < 2:
        raise BadInputError(f"{path}: it has no feedback of the robot")
    steps_s = np.diff(time_s[places])
    period_s = np.median(steps_s)
    periods = np.round(steps_s / period_s)
    off = np.abs(steps_s - periods * period_s) > 0.1 * period_s
    ends = np.flatnonzero(off | (periods < 1) | (periods > 1 + _MOST_MISSING)) + 1
    stretches = np.split(places, ends)
    return max(stretches, key=len)


def _filled(series: Array, places: Array) -> Array:
    """Return a series (k,) or (k, n) over all places up to the last, those that are missing interpolated."""
    every = np.arange(places[-1] + 1.0)
    if len(every) == len(places):
        return series
    columns = np.atleast_2d(series.T)
    filled = np.stack([np.interp(every, places, column) for column in columns], axis=1)
    return filled.reshape(len(every), *series.shape[1:])


def integral(rate: Array, period_s: float) -> Array:
    """Return the integral of a rate since its first sample, along the first axis, by the trapezoidal rule."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * period_s
    return np.concatenate([np.zeros_like(rate[:1]), np.cumsum(steps, axis=0)])


def _angles(speed_rad_s: Array, period_s: float, bandwidth_rad_s: float | None) -> Array:
    """Return the angles of the wheels from their filtered speeds."""
    angle = integral(speed_rad_s, period_s)
    if bandwidth_rad_s is None:
        return angle
    rate = np.gradient(speed_rad_s, period_s, axis=0)
    delay_s = 2.0 / bandwidth_rad_s - 0.5 * _TICK_S
    return angle + delay_s * speed_rad_s + (1.0 / bandwidth_rad_s - 2.0 * _TICK_S) / bandwidth_rad_s * rate


def as_sent(torque_n_m: Array) -> Array:
    """Return torques as TORQUE_COMMAND carries them: the nearest count, halves away from zero."""
    counts = np.floor(np.abs(torque_n_m) / _TORQUE_UNIT_N_M + 0.5)
    sent: Array = np.copysign(counts * _TORQUE_UNIT_N_M, torque_n_m)
    return sent


def _is_ours(values: Mapping[str, Any]) -> bool:
    """Return whether our firmware moved the robot, and not motor controllers of other makers."""
    return bool(values.get("device.driver", OUR_DRIVER) == OUR_DRIVER)


def _bandwidth_rad_s(values: Mapping[str, Any]) -> float | None:
    """Return the bandwidth of our firmware's filter; None with motor controllers of other makers."""
    if not _is_ours(values):
        return None
    bandwidth = values.get("firmware.tracking_bandwidth_rad_s")
    return None if bandwidth is None else float(bandwidth)


def _robot(path: Path, values: Mapping[str, Any]) -> RobotModel:
    names = [field.name for field in fields(RobotModel) if field.init]
    try:
        return RobotModel(**{name: float(values[f"robot.{name}"]) for name in names})
    except KeyError as error:
        raise BadInputError(
            f"{path}: it does not say the robot's {error.args[0]}; it is no recording of a run"
        ) from error
