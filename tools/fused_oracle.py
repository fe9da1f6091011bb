"""What any filter could make of a run's measurements and fixes, in NumPy: the oracles of ``tools.fused_errors``.

Wheels, gyro and fixes err by known white noises alone, so that a Kalman filter is best. Its states are x, y, heading,
gyro bias and wheel scale. It shares nothing with the filter under test but how a motion is read from two measurements.

Sources: R. E. Kalman, 1960; H. E. Rauch, F. Tung and C. T. Striebel, Maximum likelihood estimates of linear dynamic
systems, AIAA Journal 3, 1965.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.model import RobotModel
from hil.core.types import MeasuredPose, Pose
from hil.estimation.measurement import Measurement
from hil.estimation.wheel_motion import Motion, MotionReader

Array = npt.NDArray[np.float64]
Given = tuple[Measurement, Sequence[MeasuredPose]]
"""A measurement, and the fixes that arrived with it."""

_STATES = 5


class Noises(NamedTuple):
    """Standard deviations: of the start's five states, of a position after 1 m rolled, of one sample of the gyro."""

    start: tuple[float, float, float, float, float]
    rolled_m: float
    gyro_rad_s: float


class Best(NamedTuple):
    """Of each measurement: the variance [m²] of the best causal filter's position, and the smoothed states."""

    causal_m2: Array
    smoothed: Array


class _Instant(NamedTuple):
    """Of a measurement or a fix: how the state before led here, what was predicted, and what the fix made of it."""

    transition: Array
    noise: Array
    predicted: tuple[Array, Array]
    filtered: tuple[Array, Array]


def best(model: RobotModel, start: Pose, counts: int, given: Sequence[Given], noises: Noises) -> Best:
    """Return the bounds of a run whose first measurement was made at ``start``."""
    reader = MotionReader(model, counts)
    measured = [measurement for measurement, _ in given]
    fixes = sorted(fix for _, arrived in given for fix in arrived)
    begin_ns = measured[0].robot_time_ns
    state, covariance = np.array([*start, 0.0, 1.0]), np.diag(np.square(noises.start))
    first = state, covariance
    instants = [_Instant(np.eye(_STATES), np.zeros((_STATES, _STATES)), first, first)]
    ends, at = [0], {begin_ns: 0}
    for last, now in itertools.pairwise(measured):
        span_ns = now.robot_time_ns - last.robot_time_ns
        motion = reader.between(last, now) if span_ns else None
        while motion is not None and begin_ns < now.robot_time_ns:
            fix = next((fix for fix in fixes if begin_ns < fix.time_ns <= now.robot_time_ns), None)
            to_ns = fix.time_ns if fix else now.robot_time_ns
            state, transition, noise = _moved(state, motion, (to_ns - begin_ns) / span_ns, model.lever_m, noises)
            covariance = transition @ covariance @ transition.T + noise
            predicted = state, covariance
            if fix:
                state, covariance = _corrected(state, covariance, fix)
            instants.append(_Instant(transition, noise, predicted, (state, covariance)))
            at[to_ns] = len(instants) - 1
            begin_ns = to_ns
        ends.append(len(instants) - 1)
    newest, causal_m2 = 0, []
    for (_, arrived), end in zip(given, ends, strict=True):
        newest = max([newest, *(at[fix.time_ns] for fix in arrived if fix.time_ns in at)])
        covariance = instants[newest].filtered[1]
        for one in instants[newest + 1 : end + 1]:
            covariance = one.transition @ covariance @ one.transition.T + one.noise
        causal_m2.append(covariance[0, 0] + covariance[1, 1])
    return Best(np.array(causal_m2), _smoothed(instants)[ends])


def _moved(state: Array, motion: Motion, share: float, lever_m: float, noises: Noises) -> tuple[Array, Array, Array]:
    """Return state, transition and noise after this share of a motion, turned by half of its own turn."""
    _, _, heading, bias, scale = state
    biased_s = share * motion.dt_s
    turned = share * motion.gyro_rad - bias * biased_s
    cos, sin = math.cos(heading + 0.5 * turned), math.sin(heading + 0.5 * turned)
    rolled = share * np.array([[cos, -sin], [sin, cos]]) @ (motion.forward_m, motion.left_m)
    transition = np.eye(_STATES)
    transition[:2, 2] = scale * np.array([-rolled[1], rolled[0]])
    transition[:2, 3] = -0.5 * biased_s * transition[:2, 2]
    transition[:2, 4] = rolled
    transition[2, 3] = -biased_s
    way_m = math.hypot(motion.forward_m, motion.left_m) + lever_m * abs(motion.turned_rad)
    position_m2, heading_rad2 = noises.rolled_m**2 * way_m, (noises.gyro_rad_s * motion.dt_s) ** 2
    noise = share * np.diag([position_m2, position_m2, heading_rad2, 0.0, 0.0])
    return state + np.array([*(scale * rolled), turned, 0.0, 0.0]), transition, noise


def _corrected(state: Array, covariance: Array, fix: MeasuredPose) -> tuple[Array, Array]:
    told = np.zeros((3, 3))
    told[np.triu_indices(3)] = fix.covariance
    told += np.triu(told, 1).T
    apart = np.array(fix.pose) - state[:3]
    apart[2] = math.remainder(apart[2], math.tau)
    gain = np.linalg.solve(covariance[:3, :3] + told, covariance[:3]).T
    return state + gain @ apart, covariance - gain @ covariance[:3]


def _smoothed(instants: Sequence[_Instant]) -> Array:
    states = [instants[-1].filtered[0]]
    for before, after in zip(instants[-2::-1], instants[:0:-1], strict=True):
        state, covariance = before.filtered
        predicted, grown = after.predicted
        gain = np.linalg.solve(grown, after.transition @ covariance).T
        states.append(state + gain @ (states[-1] - predicted))
    return np.array(states[::-1])


def slip_bound_m(accelerometer_m_s2: float, slip_s: float = 0.88, bias_m_s2: float = 0.05) -> float:
    """Return the deviation [m] along one axis at the end of slip of a filter that knows all but the bias's value.

    It knows start, noises, latency and the deviation of the accelerometer's bias; its states are position, velocity and
    that bias, and the last fix to have come is 0.1 s old.
    """
    dt_s, every, latency = 0.005, 20, 20
    ticks = round(slip_s / dt_s)
    moves = np.array([[1.0, dt_s, 0.0], [0.0, 1.0, -dt_s], [0.0, 0.0, 1.0]])
    noise = np.diag([0.0, (accelerometer_m_s2 * dt_s) ** 2, 0.0])
    covariance = np.diag([0.0, 0.0, bias_m_s2**2])
    for tick in range(1, ticks + 1):
        covariance = moves @ covariance @ moves.T + noise
        if tick % every == 0 and tick <= ticks - latency:
            gain = covariance[:, 0] / (covariance[0, 0] + 0.02**2)
            covariance = covariance - np.outer(gain, covariance[0])
    return float(np.sqrt(covariance[0, 0]))
