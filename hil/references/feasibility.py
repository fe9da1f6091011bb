"""Whether a robot can follow a reference: the wheel speeds and torques that it needs, compared with the limits."""

import functools
import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.core.errors import apart
from hil.core.model import RobotModel
from hil.core.types import WHEEL_NAMES, FourWheels
from hil.references.source import ReferenceSource

FINEST_S = 0.01
MOST_SAMPLES = 20_000


class Requirement(NamedTuple):
    """What a reference needs of the wheels in one quantity (its absolute value).

    Attributes:
        unit: unit of the quantity. limit: limit of a wheel.
        worst: largest value needed, by the wheel ``worst_wheel`` (``fl``) at the scenario's time ``worst_s`` [s].
        first: first value beyond the limit, by ``first_wheel`` at ``first_s``; all three None where the limit is kept.
    """

    unit: str
    limit: float
    worst: float
    worst_wheel: str
    worst_s: float
    first: float | None
    first_wheel: str | None
    first_s: float | None

    @property
    def sentence(self) -> str | None:
        """The warning for the user; None where the limit is kept."""
        if self.first is None:
            return None
        first, most, unit = apart(self.first, self.limit), apart(self.worst, self.limit), self.unit
        worst = f"; at most wheel {self.worst_wheel} {most} {unit} at t = {self.worst_s:.3g} s" * (most != first)
        return (
            f"wheel {self.first_wheel} would need {first} {unit} at t = {self.first_s:.3g} s, its limit is "
            f"{self.limit:g} {unit}{worst}: the robot cannot follow this reference, make it slower"
        )


class Feasibility(NamedTuple):
    """What a reference needs of the wheels within a run: speed [rad/s] and torque [N·m].

    ``ends_s`` is the time [s] at which the reference ends, None where it has no end. ``duration_s`` is the run's [s].
    """

    speed: Requirement
    torque: Requirement
    ends_s: float | None
    duration_s: float

    def figures(self) -> dict[str, Any]:
        """Return the values by name, for JSON."""
        return {
            "speed": self.speed._asdict(),
            "torque": self.torque._asdict(),
            "ends_s": self.ends_s,
            "warnings": list(self.sentences),
            "notes": list(self.notes),
        }

    @property
    def sentences(self) -> tuple[str, ...]:
        """Warnings about the parts that the robot cannot follow; empty if it can follow the reference."""
        return tuple(sentence for sentence in (self.speed.sentence, self.torque.sentence) if sentence is not None)

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on a possible mistake: a reference that ends later or earlier than the run."""
        if self.ends_s is None or abs(self.ends_s - self.duration_s) < FINEST_S:
            return ()
        lasts = f"the reference ends at t = {self.ends_s:.4g} s, the run at {self.duration_s:.4g} s"
        if self.ends_s > self.duration_s:
            return (f"{lasts}: the robot does not come to the end; make loop.duration_s longer to see all of it",)
        return (f"{lasts}: in between the robot is to stand at the end",)


@functools.lru_cache(maxsize=8)
def feasibility(source: ReferenceSource, model: RobotModel, duration_s: float, period_s: float) -> Feasibility:
    """Return what a reference needs of the wheels until ``duration_s`` [s], by inverse kinematics and dynamics.

    It is sampled at the loop's period ``period_s`` [s], but at least every 10 ms and at most 20,000 times. A periodic
    reference is sampled over its start and one period. A jump of the reference does not count, such as that of a circle
    without a ramp at t = 0. A robot that starts away from the reference has to catch up in any case.

    The newest results are cached, because many runs of a process have the same reference and robot.
    """
    until_s = min(duration_s, source.span_s)
    step_s = max(period_s, FINEST_S, until_s / MOST_SAMPLES)
    speeds, torques = [], []
    for number in range(math.floor(until_s / step_s + 1e-9) + 1):
        pose, twist, acceleration = source.at(number * step_s)
        speeds.append(model.wheel_speeds(twist, pose.heading_rad))
        torques.append(model.wheel_torques(acceleration, twist, pose.heading_rad, twist))
    speed = _requirement("rad/s", model.speed_limit_rad_s, speeds, step_s)
    torque = _requirement("N·m", model.torque_limit_n_m, torques, step_s)
    return Feasibility(speed, torque, source.span_s if source.ends else None, duration_s)


def _requirement(unit: str, limit: float, wheels: Sequence[FourWheels], step_s: float) -> Requirement:
    """Return what the values of the wheels, one row for each step, need of one quantity."""
    # From plain floats: NumPy takes five times as long to look into each row.
    sizes = np.abs(np.fromiter(itertools.chain.from_iterable(wheels), np.float64).reshape(-1, len(WHEEL_NAMES)))
    largest = sizes.max(axis=1)

    def at(row: int) -> tuple[float, str, float]:
        return float(largest[row]), WHEEL_NAMES[int(sizes[row].argmax())], row * step_s

    beyond = np.flatnonzero(largest > limit)
    first = at(int(beyond[0])) if len(beyond) else (None, None, None)
    return Requirement(unit, limit, *at(int(largest.argmax())), *first)
