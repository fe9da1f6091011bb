"""The robot's file and the first circle that ``hil init`` writes: proposals and numbers by hand, and comments."""

import math
import tomllib
from types import SimpleNamespace
from typing import Any

import pytest

from hil.addons.init import new_robot
from hil.addons.init.new_robot import PROJECT_QUESTIONS, QUESTIONS, found_text, problem_with, robot_text, scenario_text
from hil.core.errors import BadInputError
from hil.robot.driver import Found

SIZES = {"mass_kg": 10.0, "wheel_radius_m": 0.05, "half_length_m": 0.2, "half_width_m": 0.15}


def answers(**known: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for question in PROJECT_QUESTIONS:
        found[question.key] = known.get(question.parameter, question.proposed(found))
    return found


def three_digits(value: float) -> float:
    return float(f"{value:.3g}")


def test_proposals_follow_from_mass_and_sizes() -> None:
    proposed = answers(**SIZES)
    torque = three_digits(0.7 * 10.0 * 9.80665 / 4.0 * 0.05 / math.sqrt(2.0))
    assert proposed == {
        **{f"robot.{name}": value for name, value in SIZES.items()},
        "robot.inertia_kg_m2": three_digits(10.0 * (0.2**2 + 0.15**2) / 3.0),
        "robot.wheel_inertia_kg_m2": three_digits(0.09 * 10.0 * 0.05**2 / 2.0),
        "robot.torque_limit_n_m": torque,
        "robot.speed_limit_rad_s": 30.0,
        "firmware.counts_per_revolution": 4096,
        "firmware.torque_constant_n_m_a": three_digits(0.7 * torque),
        "link.url": "memory:",
        "device.driver": "stm32",
        "loop.rate_hz": 200,
    }
    assert answers(wheel_radius_m=0.01)["robot.speed_limit_rad_s"] == 60.0
    assert answers(mass_kg=2000.0)["robot.torque_limit_n_m"] == 15.0
    assert answers(torque_limit_n_m=0.001)["firmware.torque_constant_n_m_a"] == 0.001


def test_a_robots_file_has_gains_for_its_inertia_and_each_comment_in_its_column() -> None:
    given = answers(**SIZES, speed_limit_rad_s=8.0)
    text = robot_text(given)
    robot = tomllib.loads(text)
    kp = three_digits(33.0 * (10.0 * 0.05**2 / 4.0 + given["robot.wheel_inertia_kg_m2"]))
    firmware = robot["firmware"]
    assert (firmware["speed_kp_n_m_s_rad"], firmware["speed_ki_n_m_rad"]) == (kp, three_digits(11.0 * kp))
    assert (firmware["overspeed_rad_s"], firmware["torque_limit_n_m"]) == (16.0, given["robot.torque_limit_n_m"])
    assert (robot["device"]["wheels"], robot["device"]["reversed"]) == (["fl", "fr", "rr", "rl"], [])
    rows = [line for line in text.splitlines() if " = " in line and " # " in line]
    assert len(rows) >= 15
    assert {line.index(" # ") for line in rows if len(line.split(" # ")[0].rstrip()) < 39} == {39}
    slow = tomllib.loads(robot_text(answers(**SIZES, speed_limit_rad_s=0.4)))
    assert slow["firmware"]["overspeed_rad_s"] == 1.0, "the least that a firmware takes"
    heavy = tomllib.loads(robot_text(answers(mass_kg=2000.0, wheel_radius_m=0.3)))
    assert heavy["firmware"]["speed_kp_n_m_s_rad"] == 100.0, "the most that a firmware takes"


@pytest.mark.parametrize(("torque_n_m", "slowness"), [(5.0, 1.0), (0.02, 1.0), (0.02, 1.7)])
def test_a_first_circle_takes_three_tenths_of_speed_and_torque_and_5_s_at_least(
    torque_n_m: float, slowness: float
) -> None:
    given = answers(**SIZES, torque_limit_n_m=torque_n_m)
    inertia_kg_m2 = 10.0 * 0.05**2 / 4.0 + given["robot.wheel_inertia_kg_m2"]
    by_speed_rad_s = 0.3 * 30.0 * 0.05 / math.sqrt(2.0)
    by_torque_rad_s = math.sqrt(0.3 * torque_n_m * 0.05 / math.sqrt(2.0) / inertia_kg_m2)
    assert (by_torque_rad_s < by_speed_rad_s) is (torque_n_m < 1.0)
    period_s = max(5.0, 2.0 * math.pi / min(by_speed_rad_s, by_torque_rad_s)) * slowness
    scenario = tomllib.loads(scenario_text(given, slowness))
    written_s = scenario["reference"]["period_s"]
    assert period_s <= written_s < period_s + 0.5
    assert (2.0 * written_s) % 1.0 == 0.0
    assert (scenario["loop"]["duration_s"], scenario["expect"][0]["from_s"]) == (written_s, written_s / 2.0)
    assert (scenario["reference"]["radius_m"], scenario["plant"]["start"]["start_x_m"]) == (1.0, 0.9)
    assert scenario["expect"][0]["below"] == 0.05


@pytest.mark.parametrize(("most_hz", "proposed"), [(200, 200), (199, 100), (100, 100), (99, 50), (49, 20), (20, 20)])
def test_commands_come_as_fast_as_the_drivers_feedback_allows(
    monkeypatch: pytest.MonkeyPatch, most_hz: int, proposed: int
) -> None:
    watchdogs_s = {200: 0.025, 100: 0.05, 50: 0.1, 20: 0.1}

    def loaded(_: str, *, set: dict[str, Any]) -> None:  # noqa: A002 - the name of the option
        assert set["device.driver"] == "odrive"
        assert set["firmware.watchdog_s"] == pytest.approx(watchdogs_s[set["loop.rate_hz"]])
        if set["loop.rate_hz"] > most_hz:
            raise BadInputError(f"at most {most_hz} Hz")

    monkeypatch.setattr(new_robot, "load", loaded)
    assert new_robot._fastest("odrive") == proposed
    most_hz = 19
    with pytest.raises(BadInputError, match="at most 19 Hz"):
        new_robot._fastest("odrive")


def test_a_robot_of_a_driver_whose_settings_cannot_be_proposed_is_refused() -> None:
    (driver,) = (question for question in PROJECT_QUESTIONS if question.key == "device.driver")
    assert problem_with(driver, "odrive") is problem_with(driver, "stm32") is None
    assert str(problem_with(driver, "dbc")).startswith(
        "hil init cannot write a robot for 'dbc', because nothing can be proposed for device.motors.file"
    )
    assert problem_with(driver, "odrve") == "there is no driver 'odrve'; did you mean 'odrive'?"


def test_a_first_circle_says_what_it_goes_by(monkeypatch: pytest.MonkeyPatch) -> None:
    def first_line(driver: str, sensors: tuple[str, ...] = ()) -> str:
        can = SimpleNamespace(sensors=sensors)
        monkeypatch.setattr(new_robot, "make_driver", lambda _: SimpleNamespace(capabilities=can))
        return scenario_text(answers(driver=driver), 1.0).splitlines()[0]

    both = "# A first circle: from 0.1 m beside it, by the wheels and the gyro alone, as a real robot begins"
    assert first_line("stm32") == first_line("odrive", ("gyro",)) == both, "our own board has a gyro"
    assert first_line("odrive", ("current",)) == both.replace(" and the gyro", "")


def test_what_a_driver_says_of_its_settings_is_in_comments_of_118_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    class Settings:
        """``[device.motors]``:"""

    Settings.__doc__ = f"{Settings.__doc__}\n\n{' '.join(['xx'] * 60)}"
    monkeypatch.setattr(new_robot, "dialect", lambda _: SimpleNamespace(settings=Settings, title="yyyy"))
    _, first, second, table = new_robot._motors_text("odrive", {}).splitlines()
    assert (first, table) == (f"# yyyy: {' '.join(['xx'] * 37)}", "[device.motors]")
    assert second == f"# {' '.join(['xx'] * 23)}"


def test_a_fast_robots_circle_takes_5_s() -> None:
    fast = answers(mass_kg=10.0, wheel_radius_m=0.3, speed_limit_rad_s=60.0, torque_limit_n_m=15.0)
    assert tomllib.loads(scenario_text(fast, 1.0))["loop"]["duration_s"] == 5.0


def test_a_file_for_devices_that_were_found_says_what_was_not_measured() -> None:
    found = Found(
        ["a controller"],
        {"node_ids": [1, 2, 3, 4]},
        {"firmware.counts_per_revolution": 2048.0, "robot.wheel_radius_m": 0.0456789},
        ["robot.mass_kg", "device.motors.gear_ratio"],
    )
    text = found_text(found, "odrive", "can:socketcan/can0")
    robot = tomllib.loads(text)
    assert (robot["robot"]["wheel_radius_m"], robot["firmware"]["counts_per_revolution"]) == (0.0456789, 2048)
    assert (robot["link"]["url"], robot["device"]["driver"]) == ("can:socketcan/can0", "odrive")
    assert robot["device"]["motors"] == {"node_ids": [1, 2, 3, 4]}
    assert robot["robot"]["speed_limit_rad_s"] == three_digits(1.5 / 0.0456789), "what follows from it follows"
    lines = text.splitlines()
    paper = "the paper's robot; replace before anything moves"
    assert lines[lines.index("[robot]") - 2 : lines.index("[robot]")] == [
        f"# not measured, except wheel_radius_m: {paper}",
        "# cannot be asked for: mass_kg",
    ]
    assert lines[lines.index("[firmware]") - 1] == f"# not measured, except counts_per_revolution: {paper}"
    asked = "# cannot be asked for: gear_ratio; write them here, or the defaults hold"
    assert lines[lines.index("[device.motors]") - 1] == asked
    assert tomllib.loads(found_text(Found([], None), "odrive", "memory:")).keys() == {
        *("robot", "firmware", "device", "link")
    }


def test_options_of_the_command_are_named_like_the_keys() -> None:
    assert {question.key: question.flag for question in QUESTIONS}["robot.wheel_radius_m"] == "--wheel-radius-m"
    assert {question.flag for question in QUESTIONS if question.key == "link.url"} == {"--link"}
