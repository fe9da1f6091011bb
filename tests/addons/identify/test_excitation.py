"""The drives of hil identify as scenarios: each within grip, torque, speed and room, for robots limited by each."""

import math
from pathlib import Path
from typing import Any

import pytest

from hil.addons.identify.excitation import STEPS, Plan, plan_step
from hil.core.errors import BadInputError
from hil.core.options import format_value
from hil.scenario import Scenario

ROBOT = {
    "mass_kg": 14.0, "inertia_kg_m2": 0.7, "wheel_radius_m": 0.06, "half_length_m": 0.24, "half_width_m": 0.17,
    "wheel_inertia_kg_m2": 0.004, "torque_limit_n_m": 6.0, "speed_limit_rad_s": 60.0,
}  # fmt: skip
K_KG = 4.0 * 0.004 / 0.06**2  # the mass that the wheels' inertia is worth
PLAN = Plan(room_m=2.5, grip=0.4, blocks_s=21.0, floor_s=31.0, held_out_s=11.0, seed=5)


def scenario_of(folder: Path, extra: str = "", **robot: float) -> Path:
    path = folder / "my_robot.toml"
    lines = [f"{name} = {format_value(value)}" for name, value in (ROBOT | robot).items()]
    firmware = ("[firmware]", "overspeed_rad_s = 70.0", "torque_limit_n_m = 15.0")
    text = "\n".join(['extends = "circle_speed"', extra, *firmware, "[robot]", *lines, ""])
    path.write_text(text, encoding="utf-8")
    return path


def planned(name: str, folder: Path, extra: str = "", **robot: float) -> Scenario:
    return plan_step(name, scenario_of(folder, extra, **robot), PLAN).scenario


def gains(scenario: Scenario) -> dict[str, Any]:
    return dict(scenario.controller.gains)


@pytest.mark.parametrize(
    ("robot", "speed", "turning", "force_n"),
    [
        # As fast as rooms allow, and as strong as the grip does: 0.8 of it, in a corner of which forces add up.
        ({}, 0.8, 2.0, 0.8 * 0.4 * 14.0 * 9.81 / math.sqrt(2.0)),
        # At 0.6 of the wheels' speed, of which turning has 0.4; with half of the motors' torque.
        (
            {"speed_limit_rad_s": 20.0, "torque_limit_n_m": 0.5},
            0.6 * 0.6 * 20.0 * 0.06 / math.sqrt(2.0),
            0.4 * 0.6 * 20.0 * 0.06 / 0.41,
            0.5 * 4.0 * 0.5 / 0.06,
        ),
    ],
    ids=["by grip and room", "by the motors"],
)
@pytest.mark.parametrize(
    ("name", "lowest_hz", "highest_hz", "seed", "duration_s"),
    [("floor", 0.03, 2.6, 5, 31.0), ("held_out", 0.08, 1.8, 1005, 11.0)],
)
def test_on_the_floor_all_axes_are_driven_within_what_floor_motors_and_room_give(
    tmp_path: Path, robot: dict[str, float], speed: float, turning: float, force_n: float,
    name: str, lowest_hz: float, highest_hz: float, seed: int, duration_s: float,
) -> None:  # fmt: skip
    scenario = planned(name, tmp_path, **robot)
    assert scenario.reference.kind == "multisine"
    assert scenario.reference.options == pytest.approx(
        {
            "speed_m_s": speed, "acceleration_m_s2": 0.6 * force_n / (14.0 + K_KG), "yaw_rate_rad_s": turning,
            "yaw_acceleration_rad_s2": 0.4 * force_n * 0.41 / (0.7 + K_KG * 0.41**2), "room_m": 2.5,
            "lowest_hz": lowest_hz, "highest_hz": highest_hz, "seed": seed,
        }
    )  # fmt: skip
    felt = (14.0 + K_KG) * 0.06**2 / 4.0
    assert gains(scenario) == pytest.approx(
        {"kp_1_s": 4.0, "ki_1_s2": 0.0, "wheel_kp_n_m_s_rad": 20.0 * felt, "wheel_ki_n_m_rad": 200.0 * felt}
    )
    assert (scenario.loop.rate_hz, scenario.loop.duration_s) == (200, duration_s)
    assert (scenario.controller.law, scenario.controller.command) == ("pid", "torque")
    assert (scenario.expect, scenario.fault) == ((), ())


@pytest.mark.parametrize(("limit_rad_s", "fastest_rad_s"), [(60.0, 12.0), (15.0, 9.0)])
def test_on_blocks_the_wheels_turn_without_a_gyro(tmp_path: Path, limit_rad_s: float, fastest_rad_s: float) -> None:
    scenario = planned("blocks", tmp_path, speed_limit_rad_s=limit_rad_s)
    speed = fastest_rad_s * 0.06 / math.sqrt(2.0)
    assert scenario.reference.options == pytest.approx(
        {
            "speed_m_s": speed, "acceleration_m_s2": 25.0 * speed, "yaw_rate_rad_s": 0.0, "room_m": 1000.0,
            "lowest_hz": 0.3, "highest_hz": 3.0, "seed": 5, "rest_s": 1.0,
        }
    )  # fmt: skip
    assert gains(scenario) == pytest.approx(
        {"kp_1_s": 2.0, "ki_1_s2": 0.0, "wheel_kp_n_m_s_rad": 0.08, "wheel_ki_n_m_rad": 0.8}
    )
    assert [scenario.plant.start[f"wheel.{wheel}.lifted"] for wheel in ("fl", "fr", "rr", "rl")] == [1.0] * 4
    (no_gyro,) = scenario.fault
    assert (no_gyro.kind, no_gyro.target, no_gyro.value) == ("override", "robot.yaw_rate_rad_s", 0.0)
    assert (no_gyro.start_s, scenario.estimator.source, scenario.loop.duration_s) == (0.0, "odometry", 21.0)


@pytest.mark.parametrize(
    ("wheel_inertia", "torque_limit", "ki"), [(0.004, 6.0, 6.4), (0.04, 6.0, 15.0)], ids=["by inertia", "by torque"]
)
def test_a_squeeze_turns_the_sides_against_one_another_until_a_wheel_slides(
    tmp_path: Path, wheel_inertia: float, torque_limit: float, ki: float
) -> None:
    scenario = planned("squeeze", tmp_path, wheel_inertia_kg_m2=wheel_inertia, torque_limit_n_m=torque_limit)
    told = {one.target: (one.kind, one.start_s, one.value) for one in scenario.fault}
    assert told == {
        f"wheel.{wheel}.speed_command_rad_s": ("override", 1.0, value)
        for wheel, value in (("fl", 0.2), ("fr", 0.2), ("rr", -0.2), ("rl", -0.2))
    }
    # The loop of a wheel that slides alone; its integral part takes two seconds to the limit, or less time.
    assert scenario.firmware.speed_kp_n_m_s_rad == pytest.approx(40.0 * wheel_inertia)
    assert scenario.firmware.speed_ki_n_m_rad == pytest.approx(ki)
    assert (scenario.reference.kind, scenario.controller.command) == ("hold", "speed")
    assert (scenario.estimator.source, scenario.loop.duration_s) == ("odometry", 8.0)


def test_a_board_keeps_its_gains_in_a_squeeze(tmp_path: Path) -> None:
    base = scenario_of(tmp_path)
    own = plan_step("floor", base, PLAN).scenario.firmware
    there = plan_step("squeeze", base, PLAN, link="serial:/dev/ttyNone", mode="realtime").scenario.firmware
    assert (there.speed_kp_n_m_s_rad, there.speed_ki_n_m_rad) == (own.speed_kp_n_m_s_rad, own.speed_ki_n_m_rad)


@pytest.mark.parametrize(("believed", "source"), [("truth", "fused"), ("fused", "fused"), ("odometry", "odometry")])
def test_a_drive_begins_at_the_middle_and_does_not_know_the_truth(tmp_path: Path, believed: str, source: str) -> None:
    names = ("start_x_m", "start_y_m", "start_heading_rad")
    start = "\n".join(f"{name} = 0.5" for name in names)
    scenario = planned("floor", tmp_path, f'[estimator]\nsource = "{believed}"\n[plant.start]\n{start}')
    assert scenario.estimator.source == source
    assert [scenario.plant.start[name] for name in names] == [0.0, 0.0, 0.0]


def test_what_cannot_be_planned_is_refused(tmp_path: Path) -> None:
    for room_m, grip in ((0.5, 0.05), (100.0, 2.0)):
        assert (Plan(room_m, grip).room_m, Plan(room_m, grip).grip) == (room_m, grip)
    for values, words in (
        ((0.49, 0.5), r"^--room 0\.49: expected 0\.5 to 100 m, the side of a square$"),
        ((101.0, 0.5), "^--room 101: "),
        ((3.0, 0.04), r"^--grip 0\.04: expected 0\.05 to 2; rubber on a clean floor has 0\.5 to 0\.9$"),
        ((3.0, 2.1), r"^--grip 2\.1: "),
    ):
        with pytest.raises(BadInputError, match=words):
            Plan(*values)
    with pytest.raises(BadInputError, match=r"^step 'swim': expected blocks, floor, squeeze, held_out$"):
        plan_step("swim", scenario_of(tmp_path), PLAN)
    assert [STEPS[name][0].split()[0] for name in STEPS] == ["Put", "Put", "Leave", "Put"]
