"""The cases of hil compare --robust: a case is its number's, goes where it says, and is a scenario."""

import json
import tomllib

from hil.addons.batch.comparison.random_cases import COUNTS, FIXES, cases
from hil.estimation.fix_errors import SimulatedOptions
from hil.faults.kinds import BATTERY_V, BATTERY_VARIABLE
from hil.scenario import load, set_texts
from tests.support.processes import ROOT

SCENARIO = "compare_circle"


def test_a_case_is_the_same_among_ten_as_among_fifty_and_another_with_another_seed() -> None:
    base = load(SCENARIO)
    few, many = cases(base, 10, 3, []), cases(base, 50, 3, [])
    assert many[:10] == few
    assert len({json.dumps(case.sets) for case in many}) == 50
    assert cases(base, 10, 4, [])[0] != few[0]


def test_cases_go_where_they_say_and_each_is_a_scenario() -> None:
    base = load(SCENARIO, set={"loop.duration_s": 0.5, "expect": []})
    drawn = cases(base, 120, 1, [])
    scenarios = [load(SCENARIO, set=case.sets) for case in drawn]
    start = [one.plant.start for one in scenarios]
    masses = [float(one["mass_kg"]) / base.robot.mass_kg for one in start]
    assert 0.5 <= min(masses) < 0.6
    assert 1.8 < max(masses) <= 2.0
    slips = [one for one in start if one["contact"] == "slip"]
    assert 45 <= len(slips) <= 75
    assert all(0.3 <= float(one["grip_coefficient"]) <= 1.0 for one in slips)
    hidden = [one.fault[0].value for one in scenarios if one.fault]
    assert 45 <= len(hidden) <= 75
    assert max(hidden) <= 0.02
    assert {one.controller.mode.name for one in scenarios} == {"SPEED", "TORQUE"}
    assert {one.reference.kind for one in scenarios} == {"circle", "figure_eight", "rounded_square", "spin"}
    assert {one.device.driver for one in scenarios} == {"stm32", "odrive", "vesc"}
    ideal = [one["drive"] == "torque" for one in start]
    assert [one.robot.speed_limit_rad_s for one in scenarios] == [20.0 if is_ideal else 17.28 for is_ideal in ideal]
    assert 60 <= sum(case.can_follow for case in drawn) < 120
    assert {one.firmware.counts_per_revolution for one in scenarios} == set(COUNTS) == {64 * 2**n for n in range(8)}
    fused = [one for one in scenarios if one.estimator.source == "fused"]
    assert 45 <= len(fused) <= 75
    assert len({one.estimator.simulated_fix for one in fused}) == len(FIXES)
    told = [(one.estimator.filter, one.estimator.simulated_fix) for one in fused]
    assert {(one.fix_held_share, one.fix_map_share) for one, _ in told} == {(0.0, 0.0), (1.0, 0.0), (0.0, 0.5)}
    assert all((one.fix_held_share, one.fix_map_share) == (fix.held_share, fix.map_share) for one, fix in told)
    assert {one.estimator.simulated_fix for one in scenarios if one not in fused} == {SimulatedOptions()}
    radii = [float(one[f"wheel.{wheel}.radius_factor"]) for one in start for wheel in ("fl", "fr", "rr", "rl")]
    assert 0.98 <= min(radii) < 0.981 < 1.019 < max(radii) <= 1.02
    for name, most in (("sideways_loss", 0.05), ("com_x_m", 0.05), ("com_y_m", 0.05)):
        sizes = [abs(float(one[name])) for one in start]
        assert 0.9 * most < max(sizes) <= most
    ours = [one.plant.start for one in scenarios if not one.device.is_makers]
    noises = [float(one["gyro_noise_rad_s"]) for one in ours]
    assert 0.001 <= min(noises) < 0.002 < 0.01 < max(noises) <= 0.02
    assert [one for one in start if "gyro_scale" in one] == ours, "motors of other makers have no IMU"


def test_what_was_drawn_is_in_a_cases_axes_by_the_same_names_in_each() -> None:
    drawn = cases(load(SCENARIO), 30, 1, ["plant.start.com_x_m", "estimator"])
    (names,) = {tuple(case.axes) for case in drawn}
    assert "com_y_m" in names
    assert not {"com_x_m", "state"} & set(names), "what is given was not drawn"
    for case in drawn:
        assert case.axes["counts_per_revolution"] == case.sets["firmware.counts_per_revolution"]
        assert case.axes["floor"] == case.sets["plant.start.contact"]
        mass_kg = float(case.axes["mass_factor"]) * load(SCENARIO).robot.mass_kg
        assert case.sets["plant.start.mass_kg"] == round(mass_kg, 3)


def test_the_battery_that_is_believed_is_that_of_the_shipped_plant() -> None:
    tables = tomllib.loads((ROOT / "plant_fmu" / "variables.toml").read_text(encoding="utf-8"))
    [start] = [one["start"] for one in tables["variable"] if one["name"] == BATTERY_VARIABLE]
    assert start == BATTERY_V


def test_what_is_given_is_not_drawn() -> None:
    given = ["plant.start.contact", "reference.radius_m", "fault", "controller.command"]
    for case in cases(load(SCENARIO), 20, 1, given):
        assert not {"plant.start.contact", "reference", "fault", "controller.command"} & set(case.sets)


def test_set_texts_of_a_case_are_what_the_command_line_takes() -> None:
    (case,) = cases(load(SCENARIO), 1, 2, [])
    assert load(SCENARIO, set=set_texts(case.sets)) == load(SCENARIO, set=case.sets)
