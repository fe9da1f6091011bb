"""The inputs of a law in a recording: the scenario's values, and those of every tick."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.errors import BadInputError
from hil.core.model import RobotModel
from hil.core.types import (
    WHEEL_NAMES,
    ZERO_WHEELS,
    Acceleration,
    Applied,
    CommandMode,
    Pose,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.laws.shadows import QUANTITY, short_name
from hil.review import RecordedRun

Series = npt.NDArray[np.float64]

_BLOCK = 10_000
_POSE, _TWIST = ("x_m", "y_m", "heading_rad"), ("vx_m_s", "vy_m_s", "yaw_rate_rad_s")
_ACCELERATION = ("ax_m_s2", "ay_m_s2", "yaw_acceleration_rad_s2")
_INPUTS = (
    "loop.t_s",
    "loop.tick",
    "loop.deadline_misses",
    "guard.held",
    "guard.saturated",
    "link.latency_ms",
    *(f"reference.{name}" for name in (*_POSE, *_TWIST, *_ACCELERATION)),
    *(f"pose.{name}" for name in _POSE),
    *(f"twist.{name}" for name in _TWIST),
    *(f"wheel.{wheel}.{quantity}" for quantity in QUANTITY.values() for wheel in WHEEL_NAMES),
)


def check_signals(run: RecordedRun) -> None:
    """Raise BadInputError for a recording that lacks a signal which a law needs."""
    missing = [name for name in _INPUTS if name not in run.signals]
    if missing:
        raise BadInputError(f"{run.path}: it has no signal {missing[0]!r}, which a law needs; record the run again")


def scenario_of(run: RecordedRun) -> dict[str, Any]:
    """Return the values of the run's scenario by their dotted keys. Raises BadInputError where it is not there."""
    try:
        scenario: dict[str, Any] = dict(json.loads(run.properties["scenario"]))
        known = str(scenario["controller.law"]) and int(scenario["loop.rate_hz"]) > 0
        known = known and float(scenario["firmware.watchdog_s"]) > 0.0
        CommandMode[str(scenario["controller.command"]).upper()]
    except (KeyError, TypeError, ValueError):
        known = False
    if not known:
        raise BadInputError(
            f"{run.path}: it does not hold the scenario of its run; replay needs a recording made by 'hil run'"
        )
    return scenario


def _below(scenario: Mapping[str, Any], table: str) -> dict[str, Any]:
    """Return the values of a table by their keys; JSON's lists are arrays again."""
    values = {key.removeprefix(f"{table}."): value for key, value in scenario.items() if key.startswith(f"{table}.")}
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}


def model_of(run: RecordedRun, scenario: Mapping[str, Any]) -> RobotModel:
    """Return the robot model of the recorded law. Raises BadInputError for a recording of another version."""
    try:
        return RobotModel(**_below(scenario, "robot"))
    except (TypeError, ValueError) as error:
        raise BadInputError(f"{run.path}: its [robot] is that of another version ({error})") from error


def recorded_gains(scenario: Mapping[str, Any], spec: str) -> dict[str, object]:
    """Return the gains that the recording has for a law."""
    if _is_same(spec, scenario["controller.law"]):
        return _below(scenario, "controller.gains")
    for shadow in scenario.get("controller.shadow", ()):
        if _is_same(spec, shadow):
            return _below(scenario, f"controller.shadow_gains.{short_name(shadow)}")
    return {}


def _is_same(spec: str, other: str) -> bool:
    """Tell whether two texts name the same law; of a file only its name counts: paths start from different folders."""
    (file, _, name), (other_file, _, other_name) = spec.rpartition(":"), other.rpartition(":")
    return (PurePath(file).name, name) == (PurePath(other_file).name, other_name)


class Row(NamedTuple):
    """One recorded tick; with ``is_away`` the robot was away (its link was lost), and nothing was commanded."""

    tick: int
    is_away: bool
    is_held: bool
    reference: Reference
    state: State
    applied: Applied


def rows(run: RecordedRun, mode: CommandMode) -> Iterator[Row]:
    """Yield the ticks of a recording."""

    def group(prefix: str, names: Sequence[str]) -> Iterator[tuple[float, ...]]:
        return tuples([run.signals[f"{prefix}.{name}"] for name in names])

    def wheels(quantity: str) -> Iterator[tuple[float, ...]]:
        return tuples([run.signals[f"wheel.{wheel}.{quantity}"] for wheel in WHEEL_NAMES])

    loop = [run.signals[name] for name in ("loop.tick", "guard.held", "guard.saturated", "link.latency_ms")]
    for (tick, held, saturated, latency_ms), refer, twist_d, acceleration, pose, twist, speed, torque in zip(
        tuples(loop),
        group("reference", _POSE),
        group("reference", _TWIST),
        group("reference", _ACCELERATION),
        group("pose", _POSE),
        group("twist", _TWIST),
        *map(wheels, QUANTITY.values()),
        strict=True,
    ):
        speed_rad_s = ZERO_WHEELS if mode is CommandMode.TORQUE else Wheels(*speed)
        yield Row(
            int(tick),
            math.isnan(torque[0]),
            held != 0.0,
            Reference(Pose(*refer), Twist(*twist_d), Acceleration(*acceleration)),
            State(Pose(*pose), Twist(*twist)),
            Applied(WheelCommand(mode, speed_rad_s, Wheels(*torque)), saturated != 0.0, latency_ms / 1e3),
        )


def tuples(columns: Sequence[Series]) -> Iterator[tuple[float, ...]]:
    """Yield the rows of some columns, converted by blocks: Python's floats take four times the memory of an array's."""
    for start in range(0, len(columns[0]), _BLOCK):
        yield from zip(*(column[start : start + _BLOCK].tolist() for column in columns), strict=True)
