"""The drives of an identification as scenarios: on blocks, on the floor, a squeeze, and one that no fit sees.

Each is a run of the user's scenario with other tables, over its own link and robot. Nothing here is known about the
plant: a virtual robot only gets its wheels lifted where a person would put blocks under a real one.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.identify.squeeze import PATTERN
from hil.core.errors import BadInputError
from hil.core.model import GRAVITY_M_S2, RobotModel
from hil.core.types import WHEEL_NAMES, CommandMode
from hil.runtime.assembly import RunOptions, RunResult, run_scenario
from hil.scenario import Scenario, load
from hil.scenario.motor_checks import make_driver
from hil.wire.url import parse_link

_GRIP_SHARE = 0.8
_LINEAR_SHARE = 0.6  # of the grip; turning has the rest
_TORQUE_SHARE = 0.5
_SPEED_SHARE = 0.6
_FASTEST_M_S = 0.8
_FASTEST_RAD_S = 2.0
_WHEEL_LOOP_1_S = 20.0
_INTEGRAL_1_S = 10.0
_RATE_HZ = 200
_SQUEEZE_RAD_S = 0.2
_SQUEEZE_S = 8.0
_SLIDING_LOOP_1_S = 40.0
_REACHED_S = 2.0  # until the speed loop has wound up to the torque limit
_FLOOR_HZ = (0.03, 2.6)
_HELD_OUT_HZ = (0.08, 1.8)
_WHEELS_RAD_S = 12.0  # on blocks
_OURS = ("mecanum", "mecanum_mujoco")  # the shipped plants, whose start pose and lifted wheels have these names


@dataclass(frozen=True)
class Plan:
    """What the drives may use: the side of the square room [m], the grip of the floor, and durations [s]."""

    room_m: float = 3.0
    grip: float = 0.5
    blocks_s: float = 40.0
    floor_s: float = 120.0
    held_out_s: float = 24.0
    seed: int = 1

    def __post_init__(self) -> None:
        """Raise BadInputError for a room or a grip in which no robot can be driven."""
        if not 0.5 <= self.room_m <= 100.0:
            raise BadInputError(f"--room {self.room_m:g}: expected 0.5 to 100 m, the side of a square")
        if not 0.05 <= self.grip <= 2.0:
            raise BadInputError(f"--grip {self.grip:g}: expected 0.05 to 2; rubber on a clean floor has 0.5 to 0.9")


class Step(NamedTuple):
    """A drive: its name, the sentence for the person beside the robot, and the scenario."""

    name: str
    asks: str
    scenario: Scenario


def plan_step(name: str, base: str | Path, plan: Plan, **where: Any) -> Step:
    """Return a drive of a scenario; ``where`` are further arguments of ``hil.scenario.load``.

    Raises BadInputError for an unknown step, for a robot that takes no torques, and as ``load``.
    """
    if name not in STEPS:
        raise BadInputError(f"step {name!r}: expected {', '.join(STEPS)}")
    scenario = load(base, **where)
    _check_torque(scenario)
    asks, tables = STEPS[name]
    return Step(name, asks, load(base, set=_common(scenario) | tables(scenario, plan), **where))


def _check_torque(scenario: Scenario) -> None:
    """Raise BadInputError for motor controllers that close the loops of the wheels themselves and take speeds alone."""
    device = scenario.device
    if device.is_makers and CommandMode.TORQUE not in make_driver(scenario).capabilities.modes:
        raise BadInputError(
            f'device.driver = "{device.driver}": it takes speeds alone and closes the loops of the wheels itself. '
            "Mass, inertia, friction and grip need torque: they are not identifiable here. Measure the radius of the "
            "wheels and the lever by hand"
        )


def perform(step: Step, recording: Path, options: RunOptions) -> RunResult:
    """Run a drive and record it. Raises as ``hil.run``; a failure on the way is in the result."""
    return run_scenario(step.scenario, replace(options, record=recording, lenient=True))


def _common(scenario: Scenario) -> dict[str, object]:
    start = {f"plant.start.start_{name}": 0.0 for name in ("x_m", "y_m", "heading_rad")}
    return {
        "loop.rate_hz": _RATE_HZ,
        "controller.law": "pid",
        "controller.command": "torque",
        "estimator.source": "fused" if scenario.estimator.source == "truth" else scenario.estimator.source,
        "expect": [],
        **(start if scenario.plant.fmu in _OURS else {}),
    }


def _loop(inertia_kg_m2: float, position_1_s: float) -> dict[str, object]:
    """Return the gains of the law for wheels that each feel this inertia."""
    kp = _WHEEL_LOOP_1_S * inertia_kg_m2
    gains = {"kp_1_s": position_1_s, "ki_1_s2": 0.0, "wheel_kp_n_m_s_rad": kp, "wheel_ki_n_m_rad": _INTEGRAL_1_S * kp}
    return {f"controller.gains.{name}": value for name, value in gains.items()}


def _multisine(**options: object) -> dict[str, object]:
    return {"reference.kind": "multisine"} | {f"reference.{name}": value for name, value in options.items()}


def _blocks(scenario: Scenario, plan: Plan) -> dict[str, object]:
    """No turning, and no gyro: its bias would look like a turn that the wheels do not stop."""
    robot = scenario.robot
    speed = min(_WHEELS_RAD_S, _SPEED_SHARE * robot.speed_limit_rad_s) * robot.wheel_radius_m / math.sqrt(2.0)
    lifted = {f"plant.start.wheel.{wheel}.lifted": 1.0 for wheel in WHEEL_NAMES}
    return {
        **_multisine(
            speed_m_s=speed, acceleration_m_s2=25.0 * speed, yaw_rate_rad_s=0.0, room_m=1000.0,
            lowest_hz=0.3, highest_hz=3.0, seed=plan.seed, rest_s=1.0,
        ),
        **_loop(robot.wheel_inertia_kg_m2, 2.0),
        **(lifted if scenario.plant.fmu in _OURS else {}),
        "estimator.source": "odometry",
        "fault": [{"kind": "override", "target": "robot.yaw_rate_rad_s", "value": 0.0}],
        "loop.duration_s": plan.blocks_s,
    }  # fmt: skip


def _limits(robot: RobotModel, plan: Plan) -> dict[str, object]:
    """Return the limits of a drive on the floor: shares of grip, torque and speed."""
    gripped = _GRIP_SHARE * plan.grip * robot.mass_kg * GRAVITY_M_S2 / math.sqrt(2.0)
    driven = _TORQUE_SHARE * 4.0 * robot.torque_limit_n_m / robot.wheel_radius_m
    force = min(gripped, driven)
    speed = _SPEED_SHARE * robot.speed_limit_rad_s * robot.wheel_radius_m / math.sqrt(2.0)
    return {
        "speed_m_s": min(_FASTEST_M_S, _LINEAR_SHARE * speed),
        "acceleration_m_s2": _LINEAR_SHARE * force / robot.effective_mass_kg,
        "yaw_rate_rad_s": min(_FASTEST_RAD_S, (1.0 - _LINEAR_SHARE) * speed / robot.lever_m * math.sqrt(2.0)),
        "yaw_acceleration_rad_s2": (1.0 - _LINEAR_SHARE) * force * robot.lever_m / robot.effective_inertia_kg_m2,
        "room_m": plan.room_m,
    }


def _floor(scenario: Scenario, plan: Plan) -> dict[str, object]:
    return _on_floor(scenario, plan, _FLOOR_HZ, plan.seed, plan.floor_s)


def _held_out(scenario: Scenario, plan: Plan) -> dict[str, object]:
    return _on_floor(scenario, plan, _HELD_OUT_HZ, plan.seed + 1000, plan.held_out_s)


def _on_floor(
    scenario: Scenario, plan: Plan, tones_hz: tuple[float, float], seed: int, duration_s: float
) -> dict[str, object]:
    robot = scenario.robot
    lowest, highest = tones_hz
    felt = robot.effective_mass_kg * robot.wheel_radius_m**2 / 4.0
    return {
        **_multisine(**_limits(robot, plan), lowest_hz=lowest, highest_hz=highest, seed=seed),
        **_loop(felt, 4.0),
        "loop.duration_s": duration_s,
    }


def _squeeze(scenario: Scenario, plan: Plan) -> dict[str, object]:
    """Speeds that the robot cannot roll are given to the wheels in place of the law's."""
    override = {"kind": "override", "start_s": 1.0}
    faults: list[Mapping[str, object]] = [
        override | {"target": f"wheel.{wheel}.speed_command_rad_s", "value": sign * _SQUEEZE_RAD_S}
        for wheel, sign in zip(WHEEL_NAMES, PATTERN, strict=True)
    ]
    robot = scenario.robot
    firmware: dict[str, object] = {}
    if parse_link(scenario.link.url).is_within_process and not scenario.device.is_makers:
        # A wheel that slides has its own inertia alone; a board keeps the gains that it has.
        firmware = {
            "firmware.speed_kp_n_m_s_rad": _SLIDING_LOOP_1_S * robot.wheel_inertia_kg_m2,
            "firmware.speed_ki_n_m_rad": min(
                robot.torque_limit_n_m / (_REACHED_S * _SQUEEZE_RAD_S),
                _SLIDING_LOOP_1_S**2 * robot.wheel_inertia_kg_m2,
            ),
        }
    return {
        **firmware,
        "reference.kind": "hold",
        "controller.command": "speed",
        "estimator.source": "odometry",
        "fault": faults,
        "loop.duration_s": _SQUEEZE_S,
    }


STEPS: dict[str, tuple[str, Callable[[Scenario, Plan], dict[str, object]]]] = {
    "blocks": (
        "Put blocks under the robot, so that all four wheels turn freely. They will turn at up to 12 rad/s.",
        _blocks,
    ),
    "floor": ("Put the robot on the floor, in the middle of the free square.", _floor),
    "squeeze": (
        "Leave the robot on the floor. Its wheels will turn against one another; it moves by a hand's breadth.",
        _squeeze,
    ),
    "held_out": ("Put the robot into the middle of the free square again.", _held_out),
}
"""Each drive, in order: the sentence for the person beside the robot, and its tables of the scenario."""
