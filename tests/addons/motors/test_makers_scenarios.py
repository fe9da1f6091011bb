"""Scenarios with motors of other makers: what is refused, what has no effect, and what the wiring does."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil
from hil.cli import main as program
from hil.core.errors import BadInputError
from hil.scenario import load
from hil.scenario.unreached import without_effect

SUITE = Path(__file__).parents[2] / "suite"


def message(name: object, **options: object) -> str:
    with pytest.raises(BadInputError) as caught:
        load(name, **options)  # type: ignore[arg-type]
    return str(caught.value)


def test_a_table_from_two_places_is_told_with_both(tmp_path: Path) -> None:
    mine = tmp_path / "my.toml"
    mine.write_text('extends = "paper_circle"\n[device]\ndriver = "odrive"\nmotors = {gear_ratio = 8.0}\n')
    refused = message(mine, set=["device.motors.firmware=0.5"])
    assert refused == '--set: device.motors.firmware = 0.5; expected text in quotation marks: "0.5"'
    contradiction = message(mine, set=['device.motors.firmware="0.5"', "device.motors.watchdog_endpoints=[419, 420]"])
    assert "my.toml:4 and --set: device.motors: watchdog_endpoints: firmware 0.5" in contradiction
    alone = message("paper_circle", set=["device.driver=odrive", "device.motors.nod_ids=[1]"])
    assert alone.startswith("--set: unknown key device.motors.nod_ids; did you mean 'device.motors.node_ids'?")


def test_a_guardian_that_would_take_a_late_command_for_silence_is_refused() -> None:
    sets = {"device.driver": "rosmaster", "device.guardian_s": 0.1, "loop.rate_hz": 20}
    refused = "device.guardian_s = 0.1; expected at least 3 command periods of 0.05 s, or a command that"
    assert refused in message("paper_circle", set=sets)


@pytest.mark.parametrize(
    ("name", "driver", "is_refused"),
    [
        ("gyro_noise_rad_s", "odrive", True),
        ("gyro_bias_z_rad_s", "c620", True),
        ("accelerometer_noise_m_s2", "moteus", True),
        ("gyro_noise_rad_s", "rosmaster", False),
        ("gyro_noise_rad_s", "stm32", False),
    ],
)
def test_the_noise_of_a_sensor_that_a_robot_lacks_is_refused(name: str, driver: str, is_refused: bool) -> None:
    sets = {f"plant.start.{name}": 0.01, "device.driver": driver, "loop.rate_hz": 20}
    if not is_refused:
        assert load("circle_speed", set=sets).plant.start[name] == 0.01
        return
    with pytest.raises(BadInputError, match=rf"plant\.start\.{name} = 0\.01; .* has no (gyro|accelerometer)"):
        load("circle_speed", set=sets)
    assert load("circle_speed", set=sets | {f"plant.start.{name}": 0.0})


@pytest.mark.parametrize(
    ("sets", "sentences"),
    [
        (
            ["device.driver='wheeltec'", "firmware.watchdog_s=0.05"],
            ["expected more than the 0.05 s between two feedbacks of WHEELTEC C50X, or the robot would always be held"],
        ),
        (
            [
                *(
                    "device.driver='vesc'",
                    "plant.start.gyro_noise_rad_s=0.1",
                    "plant.start.accelerometer_bias_x_m_s2=1",
                ),
                "fault=[{kind='gyro_bias',target='gyro',value=1}]",
            ],
            [
                "plant.start.gyro_noise_rad_s = 0.1; VESC as it is set up has no gyro; remove the row, or give 0",
                "bias_x_m_s2 = 1.0; VESC as it is set up has no accelerometer; remove the row, or give 0",
                'fault.1.kind = "gyro_bias"; VESC as it is set up has no gyro to act on; remove the row',
            ],
        ),
    ],
)
def test_a_value_that_its_motor_controllers_contradict_is_refused(sets: list[str], sentences: list[str]) -> None:
    told = message("circle_speed", set=sets).splitlines()
    assert len(told) == len(sentences)
    for line, sentence in zip(told, sentences, strict=True):
        assert line.endswith(sentence)


def test_firmware_of_ours_is_no_robot_with_motor_controllers_of_others() -> None:
    words = ["device", "circle_speed", "--set", "device.driver='vesc'", "--target", "unicorn", "--link", "serial:pty"]
    with pytest.raises(BadInputError) as refused:
        CliRunner().invoke(program.app, words, catch_exceptions=False)
    assert str(refused.value) == "--target unicorn runs this project's firmware, not 'vesc'; leave --target out"


@pytest.mark.parametrize("driver", ["c620", "moteus", "odrive", "rosmaster", "vesc", "wheeltec"])
def test_parameters_that_only_our_firmware_reads_are_told_for_other_controllers(driver: str) -> None:
    changes = {"firmware.current_limit_a": 0.01, "firmware.encoder_fault_s": 0.02, "firmware.undervoltage_v": 200.0}
    short = {"loop.duration_s": 0.3, "fault": [], "expect": []}
    plain, changed = (
        hil.run(SUITE / f"driver_{driver}.toml", set=short | more, lenient=True) for more in ({}, changes)
    )
    assert changed.scenario is not None
    reasons = dict(without_effect(changed.scenario))
    assert set(reasons) >= set(changes)
    assert reasons["firmware.undervoltage_v"].endswith("other motor controllers are set with their tools")
    assert plain.metrics["wire_sha256"] == changed.metrics["wire_sha256"] is not None


def test_a_wiring_that_the_bridge_knows_changes_nothing_and_one_that_it_does_not_know_ruins_the_run() -> None:
    short = {"loop.duration_s": 1.0, "expect": [], "device.driver": "odrive", "estimator.source": "odometry"}
    hidden = {"plant.wiring.wheels": ["rl", "fl", "fr", "rr"], "plant.wiring.reversed": ["fl", "rl"]}
    told = {key.replace("plant.wiring", "device"): value for key, value in hidden.items()}
    plain, known, ruined = (
        hil.run("circle_speed", set=short | more, record=None).signals for more in ({}, hidden | told, hidden)
    )
    for signal in ("wheel.fr.speed_rad_s", "error.planar_m"):
        assert known[signal] == pytest.approx(plain[signal], abs=1e-9)
    assert ruined["error.planar_m"][-1] > 2 * plain["error.planar_m"][-1]
