"""Values that a scenario gives to its plant, and the robot's start in it."""

import hypothesis.strategies as st
import pytest
from hypothesis import given

from hil.core.types import Pose
from hil.plant.archive import read_header
from hil.plant.mapping import Row
from hil.runtime.robots import plant_start, signal_map, start_pose
from hil.scenario import load
from tests.support.plant_testbed import FMU

SHIPPED = read_header(FMU).parameters


def test_the_shipped_fmu_has_every_parameter_that_the_scenario_believes() -> None:
    scenario = load("paper_circle")
    start = plant_start(scenario, SHIPPED)
    assert {"mass_kg", "counts_per_revolution", "motor_constant_n_m_a", "start_x_m"} <= set(start) <= SHIPPED
    assert start["mass_kg"] == scenario.robot.mass_kg


@given(st.sets(st.sampled_from(sorted(SHIPPED))))
def test_what_an_fmu_lacks_is_not_passed_on_unless_the_scenario_asks_for_it(known: set[str]) -> None:
    scenario = load("paper_circle", set=["plant.start.only_in_the_plant=1"])
    start = plant_start(scenario, known)
    assert set(start) - known <= {"start_x_m", "start_y_m", "start_heading_rad", "only_in_the_plant"}
    assert start["only_in_the_plant"] == 1.0
    assert ("mass_kg" in start) == ("mass_kg" in known)


def test_the_plant_start_wins_over_what_is_believed() -> None:
    assert plant_start(load("paper_circle", set=["plant.start.mass_kg=30"]), SHIPPED)["mass_kg"] == 30.0


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        ([], 1.25),
        (["plant.start.gear_ratio=20"], 0.0625),
        (["plant.start.gear_ratio=20", "plant.start.motor_constant_n_m_a=0.07"], 0.07),
        (["plant.start.gear_ratio=0"], 1.25),
        (["plant.start.gear_ratio=many"], 1.25),
    ],
)
def test_the_motor_constant_is_at_the_shaft_the_firmwares_at_the_wheel(sets: list[str], expected: float) -> None:
    """A gear ratio that is none is left to the FMU to refuse."""
    start = plant_start(load("paper_circle", set=sets), SHIPPED)
    assert start["motor_constant_n_m_a"] == pytest.approx(expected, rel=1e-15)


def test_the_map_carries_what_the_missing_signals_follow_from() -> None:
    mapping = signal_map(
        load("paper_circle", set={"plant.map": {"pose.x_m": {"name": "x", "sign": -1}}, "plant.step_s": 0.0005})
    )
    assert mapping.rows == {"pose.x_m": Row("x", None, 0.0, -1)}
    assert (mapping.counts_per_revolution, mapping.torque_constant_n_m_a, mapping.step_s) == (4096.0, 1.25, 0.0005)


ELSEWHERE = [f"plant.start.start_{name}={value}" for name, value in zip(Pose._fields, (1.5, -2.0, 0.25), strict=True)]


@pytest.mark.parametrize(
    ("sets", "pose"),
    [
        ([], Pose(0.8, -0.2, 0.0)),
        (["plant.fmu=mecanum_fmi3"], Pose(0.8, -0.2, 0.0)),
        (["plant.start.start_y_m=2"], Pose(0.8, 2.0, 0.0)),
        (["plant.fmu=./x.fmu"], None),
        (["plant.fmu=./x.fmu", "plant.start.start_x_m=1"], None),
        (["plant.fmu=./x.fmu", *ELSEWHERE], Pose(1.5, -2.0, 0.25)),
        (["plant.fmu=./x.fmu", *ELSEWHERE, "plant.start.start_y_m=here"], None),
    ],
)
def test_where_a_foreign_fmu_starts_only_that_knows(sets: list[str], pose: Pose | None) -> None:
    assert start_pose(load("paper_circle", set=sets)) == pose
