"""Random cases: a robot, a floor, a link, a start and a reference that a law may meet, each repeatable by its number.

All that is random comes from the seed and the number of the case, so case 7 is the same among 10 cases as among 500.
Only ``random()`` is drawn, because Python promises for nothing else that a seed gives the same in every version.
"""

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from hil.core.model import GRAVITY_M_S2, RobotModel
from hil.core.types import Pose
from hil.drivers.registry import OUR_DRIVER
from hil.faults.kinds import BATTERY_V, BATTERY_VARIABLE
from hil.references import feasibility, make_reference
from hil.scenario import Scenario

RATES_HZ = (100, 200, 250, 500, 1000)
CURRENT_DRIVES = ("current", "voltage")
MAKERS = ("odrive", "vesc")
"""Motors of other makers, half of the cases: each does its speed loop by itself, and acknowledges no command."""
_TORQUE_N_M = 1.5, 5.0
_MASS = 0.5, 2.0
_FRICTION = 0.2, 4.0
_GRIP = 0.3, 1.0
_FAR_M, _LATENCY_S = 1.5, 0.01
_HIDDEN_S = 0.001, 0.02
_SPEED_M_S = 0.1, 0.6
_SIZE_M = 0.5, 1.5
_YAW_RATE_RAD_S = 0.8
_OF_NO_LOAD = 0.9
_SHARE = 0.8
"""Of torque, speed and grip: a reference that needs no more of the true robot can be followed."""

# Way around a Gerono eight over its half length, and around a square over its side.
_EIGHT, _SQUARE = 6.097, 4.0


class Case(NamedTuple):
    """A case: the keys of the scenario that make it, and whether the true robot's wheels can follow its reference."""

    number: int
    sets: Mapping[str, Any]
    can_follow: bool


class _Draw:
    """Numbers of one case."""

    def __init__(self, seed: int, number: int) -> None:
        self._random = random.Random(f"{seed} case {number}").random

    def within(self, low: float, high: float, digits: int = 4) -> float:
        return round(low + (high - low) * self._random(), digits)

    def factor(self, low: float, high: float) -> float:
        """Return a factor whose logarithm is uniform, so that a half is as likely as twice."""
        return math.exp(self.within(math.log(low), math.log(high), 12))

    def one_of(self, values: Sequence[Any]) -> Any:
        return values[int(len(values) * self._random())]

    def half(self) -> bool:
        return self._random() < 0.5


def cases(base: Scenario, count: int, seed: int, given: Sequence[str]) -> list[Case]:
    """Return the first ``count`` cases of a seed over a scenario; keys in ``given`` stay as the scenario has them.

    Mass, inertia and friction are times what ``[robot]`` believes, which stays. Half of the cases have a command mode
    each, half of them a floor on which wheels slip, and half of them a latency of commands of which nobody is told.
    """
    return [_case(base, number, _Draw(seed, number), given) for number in range(count)]


def _case(base: Scenario, number: int, draw: _Draw, given: Sequence[str]) -> Case:
    torque_n_m = draw.within(*_TORQUE_N_M, 2)
    is_torque = draw.half()
    drive = draw.one_of(("torque", *CURRENT_DRIVES))
    mass, friction = draw.factor(*_MASS), draw.factor(*_FRICTION)
    slips, grip = draw.half(), draw.within(*_GRIP, 2)
    is_hidden, hidden_s = draw.half(), draw.within(*_HIDDEN_S, 3)
    rate_hz = draw.one_of(RATES_HZ)
    driver = draw.one_of((OUR_DRIVER, OUR_DRIVER, *MAKERS))
    told_s = draw.within(0.0, _LATENCY_S, 3), draw.within(0.0, _LATENCY_S, 3)
    reference = _reference(draw)
    robot = base.robot
    sets: dict[str, Any] = {
        "controller.command": "torque" if is_torque else "speed",
        "robot.torque_limit_n_m": torque_n_m,
        "firmware.torque_limit_n_m": torque_n_m,
        "plant.start.drive": drive,
        "plant.start.mass_kg": round(mass * robot.mass_kg, 3),
        "plant.start.inertia_kg_m2": round(mass * robot.inertia_kg_m2, 4),
        "plant.start.friction_coefficient": round(friction * robot.friction_coefficient, 4),
        "plant.start.contact": "slip" if slips else "rigid",
        "loop.rate_hz": rate_hz,
        "link.command_latency_s": told_s[0],
        "link.feedback_latency_s": told_s[1],
        "reference": reference,
    }
    if driver != OUR_DRIVER:
        sets["device.driver"] = driver
    if slips:
        sets["plant.start.grip_coefficient"] = grip
    if drive in CURRENT_DRIVES:
        limit_a = round(torque_n_m / base.firmware.torque_constant_n_m_a, 3)
        sets |= {"plant.start.current_limit_a": limit_a, "firmware.current_limit_a": limit_a}
        sets["robot.speed_limit_rad_s"] = _motor_speed_rad_s(base)
    if is_hidden:
        sets["fault"] = [{"kind": "delay", "target": "command", "value": hidden_s}]
    if any(_covers(key, "reference") for key in given):
        reference = {"kind": base.reference.kind, **base.reference.options}
    kind = dict(reference)
    source = make_reference(str(kind.pop("kind")), kind, base.directory)
    sets |= _start(draw, source.at(0.0).pose)
    sets = {key: value for key, value in sets.items() if not any(_covers(one, key) for one in given)}
    true = _true_robot(base, sets)
    needs = feasibility(source, true, base.loop.duration_s, base.loop.period_ns * 1e-9)
    return Case(number, sets, not needs.sentences)


def _motor_speed_rad_s(base: Scenario) -> float:
    """Return the speed limit of a robot whose motors have a battery: beyond their no-load speed they only brake."""
    battery_v = float(base.plant.start.get(BATTERY_VARIABLE, BATTERY_V))
    no_load_rad_s = battery_v / base.firmware.torque_constant_n_m_a
    return min(base.robot.speed_limit_rad_s, round(_OF_NO_LOAD * no_load_rad_s, 2))


def _covers(given: str, key: str) -> bool:
    """Return whether a key that was given sets another one, or a part of it."""
    return given == key or given.startswith(f"{key}.") or key.startswith(f"{given}.")


def _reference(draw: _Draw) -> dict[str, Any]:
    """Return a ``[reference]``: a circle, an eight, a square, or a circle on which the robot turns by itself."""
    kind = draw.one_of(("circle", "figure_eight", "rounded_square", "spin"))
    size_m, speed_m_s = draw.within(*_SIZE_M, 2), draw.within(*_SPEED_M_S, 2)
    heading = {"heading": draw.one_of(("fixed", "path")), "heading_rad": draw.within(-math.pi, math.pi, 3)}
    yaw_rate = draw.within(-_YAW_RATE_RAD_S, _YAW_RATE_RAD_S, 2)
    if kind == "circle":
        return {"kind": kind, "radius_m": size_m, "period_s": round(2.0 * math.pi * size_m / speed_m_s, 2), **heading}
    if kind == "figure_eight":
        return {"kind": kind, "half_length_m": size_m, "period_s": round(_EIGHT * size_m / speed_m_s, 2), **heading}
    if kind == "rounded_square":
        square = {"side_m": 2.0 * size_m, "corner_m": round(0.6 * size_m, 3)}
        return {"kind": kind, **square, "period_s": round(_SQUARE * 2.0 * size_m / speed_m_s, 2), **heading}
    return {"kind": kind, "path": "circle", "radius_m": size_m, "speed_m_s": speed_m_s, "yaw_rate_rad_s": yaw_rate}


def _start(draw: _Draw, first: Pose) -> dict[str, float]:
    """Return a start up to 1.5 m from the reference's, and turned by any angle."""
    far_m, way_rad = draw.within(0.0, _FAR_M), draw.within(-math.pi, math.pi)
    turned_rad = draw.within(-math.pi, math.pi)
    return {
        "plant.start.start_x_m": round(first.x_m + far_m * math.cos(way_rad), 4),
        "plant.start.start_y_m": round(first.y_m + far_m * math.sin(way_rad), 4),
        "plant.start.start_heading_rad": round(math.remainder(first.heading_rad + turned_rad, 2.0 * math.pi), 4),
    }


def _true_robot(base: Scenario, sets: Mapping[str, Any]) -> RobotModel:
    """Return the robot as it is, with the part of its limits that a reference may need."""
    start = {**base.plant.start, **{key.removeprefix("plant.start."): value for key, value in sets.items()}}
    robot = base.robot
    mass_kg = float(start.get("mass_kg", robot.mass_kg))
    torque_n_m = float(sets.get("robot.torque_limit_n_m", robot.torque_limit_n_m))
    if start.get("contact") == "slip":
        # A wheel holds along its roller's axis, at 45 degrees, up to the grip times its load.
        grip = float(start.get("grip_coefficient", 0.7))
        torque_n_m = min(torque_n_m, grip * mass_kg * GRAVITY_M_S2 * robot.wheel_radius_m / (4.0 * math.sqrt(2.0)))
    return replace(
        robot,
        mass_kg=mass_kg,
        inertia_kg_m2=float(start.get("inertia_kg_m2", robot.inertia_kg_m2)),
        friction_coefficient=float(start.get("friction_coefficient", robot.friction_coefficient)),
        torque_limit_n_m=_SHARE * torque_n_m,
        speed_limit_rad_s=_SHARE * float(sets.get("robot.speed_limit_rad_s", robot.speed_limit_rad_s)),
    )
