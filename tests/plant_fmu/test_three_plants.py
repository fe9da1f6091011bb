"""The three plants side by side (docs/results/plants.md): rigid, slip, and MuJoCo's, which nobody here wrote."""

import functools
import math
from collections.abc import Mapping
from typing import Any

import pytest

import hil
import plant_fmu
from hil.plant.fmu import FmuPlant
from tests.support.mujoco_testbed import FMU as MUJOCO
from tools.plant_experiments import (
    DIRECTIONS,
    Geometry,
    Start,
    acceleration,
    coasting_ratio,
    rolling_ratio,
    slip_onset_n_m,
)

M, R, L, J, YAW, GRIP = 20.0, 0.075, 0.6, 0.005, 0.56, 0.7
K = 4 * J / R**2
GEOMETRY = Geometry(R, L)
CARRIED_N_M = GRIP * M * 9.81 * R / (4 * math.sqrt(2))
"""Torque of a wheel at which a quarter of the weight slips along its roller."""

WITHIN_THE_GRIP_S = {"paper_circle": 6.5, "paper_circle_dsc": 11.0}
"""How long a controller with little torque takes to reach the circle, and the 5 s after that."""


def start(plant: str) -> Start:
    fmu, values = {
        "rigid": (plant_fmu.path(), {}),
        "slip": (plant_fmu.path(), {"contact": "slip", "roller_friction_coefficient": 0.0}),
        "mujoco": (MUJOCO, {}),
    }[plant]
    return lambda parameters: FmuPlant(fmu, {**values, **parameters})


@pytest.mark.parametrize(
    ("plant", "direction", "least"),
    [
        *(("rigid", direction, 1 - 1e-6) for direction in DIRECTIONS),
        *(("slip", direction, 1 - 1e-4) for direction in DIRECTIONS),
        ("mujoco", "forward", 0.999),
        ("mujoco", "left", 0.985),  # sin(pi/12)/(pi/12) = 0.989 of it is geometry
        ("mujoco", "turn", 0.990),
    ],
)
def test_wheels_that_roll_move_the_robot_as_the_kinematics_say(plant: str, direction: str, least: float) -> None:
    assert least <= rolling_ratio(start(plant), GEOMETRY, direction, 5.0) < 1.0 + 1e-6


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize(("plant", "tolerance"), [("rigid", 1e-9), ("slip", 1e-3), ("mujoco", 0.05)])
def test_a_torque_below_the_grip_accelerates_as_the_masses_say(plant: str, tolerance: float, direction: str) -> None:
    torque = 1.25  # crosses the plant port in single precision
    expected = 4 * torque / R * (L / (YAW + K * L**2) if direction == "turn" else 1 / (M + K))
    assert acceleration(start(plant), direction, torque) == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("plant", ["slip", "mujoco"])
@pytest.mark.parametrize("direction", ["forward", "left"])
def test_slip_begins_where_a_quarter_of_the_weight_ends(plant: str, direction: str) -> None:
    """A little later, because the loss is not seen at once, and the loaded axle still carries."""
    onset = slip_onset_n_m(start(plant), direction, highest_n_m=6.0)
    assert onset is not None
    assert CARRIED_N_M < onset < 1.15 * CARRIED_N_M


def test_a_rigid_robot_never_slips() -> None:
    assert slip_onset_n_m(start("rigid"), "forward", highest_n_m=12.0) is None


def test_in_the_turn_both_slip_plants_hold_longer_as_wheels_take_most_of_the_torque() -> None:
    onsets = [slip_onset_n_m(start(plant), "turn", highest_n_m=12.0) for plant in ("slip", "mujoco")]
    for onset in onsets:
        assert onset is not None
        assert onset == pytest.approx(CARRIED_N_M * (YAW + K * L**2) / YAW, rel=0.1)


@pytest.mark.parametrize(("plant", "tolerance"), [("rigid", 1e-9), ("slip", 1e-4), ("mujoco", 0.05)])
def test_coasting_in_a_turn_decides_the_coriolis_term(plant: str, tolerance: float) -> None:
    """k / (m + k) = 0.151; the paper's term gives 1."""
    assert coasting_ratio(start(plant), 1.0, 2.0) == pytest.approx(K / (M + K), rel=tolerance)


@functools.cache
def circle_within_the_grip(plant: str, scenario: str) -> Mapping[str, Any]:
    chosen: dict[str, dict[str, Any]] = {
        "rigid": {},
        "slip": {"plant.start.contact": "slip", "plant.start.roller_friction_coefficient": 0.0},
        "mujoco": {"plant.fmu": "mecanum_mujoco"},
    }
    limit = {"robot.torque_limit_n_m": 1.8, "firmware.torque_limit_n_m": 1.8}
    short = {"loop.duration_s": WITHIN_THE_GRIP_S[scenario], "expect": []}
    return hil.run(scenario, set={**limit, **short, **chosen[plant]}).metrics


@pytest.mark.parametrize("scenario", WITHIN_THE_GRIP_S)
@pytest.mark.parametrize("plant", ["slip", "mujoco"])
def test_a_controller_within_the_grip_tracks_the_circle_on_each_plant(plant: str, scenario: str) -> None:
    rigid, other = circle_within_the_grip("rigid", scenario), circle_within_the_grip(plant, scenario)
    assert other["steady_rms_m"] == pytest.approx(rigid["steady_rms_m"], abs=0.0001)
    assert other["tracked_s"] == pytest.approx(rigid["tracked_s"], rel=0.15)


@pytest.mark.parametrize(
    "chosen", [{"plant.start.contact": "slip"}, {"plant.fmu": "mecanum_mujoco"}], ids=["slip", "mujoco"]
)
def test_the_papers_torque_spins_the_wheels_until_the_firmware_stops_them(chosen: dict[str, object]) -> None:
    free = {"limiter.torque_speed": "off", "limiter.slip_m_s": math.inf}
    result = hil.run("paper_circle", set={**chosen, **free, "expect": []})
    assert not result.passed
    assert "OVERSPEED" in str(result.failure)


def test_the_slippery_scenario_passes() -> None:
    assert hil.run("circle_slip").passed
