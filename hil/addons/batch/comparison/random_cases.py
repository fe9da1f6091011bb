"""The random cases of ``hil compare --robust``: robots, sensors, fixes, links and references, drawn from a seed."""

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from hil.core.model import GRAVITY_M_S2, RobotModel
from hil.core.types import WHEEL_NAMES, Pose
from hil.faults.kinds import BATTERY_V, BATTERY_VARIABLE
from hil.references import feasibility, make_reference
from hil.robot.driver_registry import OUR_DRIVER
from hil.scenario import Scenario

RATES_HZ = (100, 200, 250, 500, 1000)
CURRENT_DRIVES = ("current", "voltage")
MAKERS = ("odrive", "vesc")
"""Motors of other makers, half of the cases: each does its speed loop by itself, and acknowledges no command."""
COUNTS = tuple(2**n for n in range(6, 14))
"""Encoder counts of one turn of a wheel: 64 to 8192."""
_FIX, _TOLD = "estimator.simulated_fix.", "estimator.filter.fix_"
FIXES: Mapping[str, Mapping[str, Any]] = {
    "as told": {},
    "lasting": {
        f"{_FIX}held_share": 1.0,
        f"{_FIX}held_s": 2.0,
        f"{_TOLD}held_share": 1.0,
        f"{_TOLD}held_s": 2.0,
    },
    "of two maps": {
        f"{_FIX}sigma_m": 0.0283,
        f"{_FIX}map_share": 0.5,
        f"{_FIX}map_scale_m": 3.0,
        f"{_FIX}map_blend": 0.0,
        f"{_TOLD}map_share": 0.5,
        f"{_TOLD}map_scale_m": 3.0,
    },
    "twice as noisy": {f"{_FIX}noisier": 2.0},
    "in a corridor": {f"{_FIX}corridor_times": 5.0, f"{_FIX}tells": "truth"},
    "outliers in bursts": {f"{_FIX}outlier_probability": 0.1, f"{_FIX}burst_s": 1.5},
    "300 ms late": {f"{_FIX}latency_s": 0.3},
    "none for 5 s": {f"{_FIX}gap_start_s": 5.0, f"{_FIX}gap_end_s": 10.0},
}
"""How pose fixes err (``hil.estimation.fix_errors``): the keys that make them so, and tell the filter what lasts."""
_TORQUE_N_M = 1.5, 5.0
_MASS = 0.5, 2.0
_FRICTION = 0.2, 4.0
_GRIP = 0.3, 1.0
_FAR_M, _LATENCY_S = 1.5, 0.01
_HIDDEN_S = 0.001, 0.02
_SPEED_M_S = 0.1, 0.6
_SIZE_M = 0.5, 1.5
_YAW_RATE_RAD_S = 0.8
_COM_M = 0.05
_RADIUS, _LOSS, _GYRO_SCALE = (0.98, 1.02), 0.05, 0.01
_GYRO_NOISE_RAD_S, _GYRO_BIAS_RAD_S, _ACCELERATION_M_S2 = (0.001, 0.02), 0.02, (0.02, 0.5)
_OF_NO_LOAD = 0.9
_SHARE = 0.8
"""Of torque, speed and grip: a reference that needs no more of the true robot can be followed."""

# Way around a Gerono eight over its half length, and around a square over its side.
_EIGHT, _SQUARE = 6.097, 4.0


class RandomCase(NamedTuple):
    """A case: the keys of the scenario that make it, and whether the true robot's wheels can follow its reference.

    ``axes`` has what was drawn, in words and numbers, for tables and pictures.
    """

    number: int
    sets: Mapping[str, Any]
    can_follow: bool
    axes: Mapping[str, str | float]


class _Draw:
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


def cases(base: Scenario, count: int, seed: int, given: Sequence[str]) -> list[RandomCase]:
    """Return the first ``count`` cases of a seed over a scenario; keys in ``given`` stay as the scenario has them.

    Mass, inertia and friction are times what ``[robot]`` believes, which stays; so do wheels, rollers, centre of mass
    and sensors that are otherwise. Half of the cases have a command mode each, half of them a slippery floor, half an
    unreported latency of commands, and half a state that is estimated.
    """
    return [_case(base, number, _Draw(seed, number), given) for number in range(count)]


def _case(base: Scenario, number: int, draw: _Draw, given: Sequence[str]) -> RandomCase:
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
    start = _start(draw)
    is_fused, fixes = draw.half(), draw.one_of(tuple(FIXES))
    counts = draw.one_of(COUNTS)
    unlike, imu = _unlike(draw), _imu(draw)
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
        "firmware.counts_per_revolution": counts,
        **unlike,
        **({"estimator.source": "fused", **FIXES[fixes]} if is_fused else {"estimator.source": "truth"}),
    }
    if driver != OUR_DRIVER:
        sets["device.driver"] = driver
    if not (base.device.is_makers if "device.driver" in given else driver != OUR_DRIVER):
        sets |= imu  # motors of other makers have none
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
    sets |= _start_of(source.at(0.0).pose, *start)
    sets = {key: value for key, value in sets.items() if not any(_covers(one, key) for one in given)}
    true = _true_robot(base, sets)
    needs = feasibility(source, true, base.loop.duration_s, base.loop.period_ns * 1e-9)
    radii = [unlike[f"plant.start.wheel.{name}.radius_factor"] for name in WHEEL_NAMES]
    axes: dict[str, tuple[str, str | float]] = {  # with the key that makes it
        "mode": ("controller.command", "torque" if is_torque else "speed"),
        "drive": ("plant.start.drive", drive),
        "motors": ("device.driver", "ours" if driver == OUR_DRIVER else driver),
        "floor": ("plant.start.contact", "slip" if slips else "rigid"),
        "reference": ("reference", reference["kind"]),
        "state": ("estimator", f"fixes {fixes}" if is_fused else "true"),
        "rate_hz": ("loop.rate_hz", rate_hz),
        "torque_limit_n_m": ("robot.torque_limit_n_m", torque_n_m),
        "mass_factor": ("plant.start.mass_kg", mass),
        "friction_factor": ("plant.start.friction_coefficient", friction),
        "told_latency_s": ("link", sum(told_s)),
        "hidden_latency_s": ("fault", hidden_s if is_hidden else 0.0),
        "start_distance_m": ("plant.start.start_x_m", start[0]),
        "counts_per_revolution": ("firmware.counts_per_revolution", counts),
        "radius_difference": ("plant.start.wheel", round(max(radii) - min(radii), 5)),
        **{name.removeprefix("plant.start."): (name, unlike[name]) for name in unlike if ".wheel." not in name},
    }
    shown = {name: value for name, (key, value) in axes.items() if not any(_covers(one, key) for one in given)}
    return RandomCase(number, sets, not needs.sentences, shown)


def _unlike(draw: _Draw) -> dict[str, float]:
    """Return where the true robot's wheels, rollers and centre of mass are not as believed."""
    radii = {f"plant.start.wheel.{name}.radius_factor": draw.within(*_RADIUS, 5) for name in WHEEL_NAMES}
    return radii | {
        "plant.start.sideways_loss": draw.within(-_LOSS, _LOSS, 5),
        "plant.start.com_x_m": draw.within(-_COM_M, _COM_M, 5),
        "plant.start.com_y_m": draw.within(-_COM_M, _COM_M, 5),
    }


def _imu(draw: _Draw) -> dict[str, float]:
    """Return how the inertial sensors err."""
    return {
        "plant.start.gyro_scale": draw.within(1.0 - _GYRO_SCALE, 1.0 + _GYRO_SCALE, 5),
        "plant.start.gyro_bias_z_rad_s": draw.within(-_GYRO_BIAS_RAD_S, _GYRO_BIAS_RAD_S, 5),
        "plant.start.gyro_noise_rad_s": round(draw.factor(*_GYRO_NOISE_RAD_S), 5),
        "plant.start.accelerometer_noise_m_s2": round(draw.factor(*_ACCELERATION_M_S2), 4),
    }


def _motor_speed_rad_s(base: Scenario) -> float:
    """Return the speed limit of a robot whose motors have a battery: beyond their no-load speed they only brake."""
    battery_v = float(base.plant.start.get(BATTERY_VARIABLE, BATTERY_V))
    no_load_rad_s = battery_v / base.firmware.torque_constant_n_m_a
    return min(base.robot.speed_limit_rad_s, round(_OF_NO_LOAD * no_load_rad_s, 2))


def _covers(given: str, key: str) -> bool:
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


def _start(draw: _Draw) -> tuple[float, float, float]:
    """Return how far from the reference's start [m], in which direction, and how far turned [rad]."""
    return draw.within(0.0, _FAR_M), draw.within(-math.pi, math.pi), draw.within(-math.pi, math.pi)


def _start_of(first: Pose, far_m: float, way_rad: float, turned_rad: float) -> dict[str, float]:
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
