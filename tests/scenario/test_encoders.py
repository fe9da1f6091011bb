"""Filter and gains that follow a coarse encoder, and the sentences about one that is too coarse."""

import json
import re

import pytest

from hil.core.wheel_speed import slower
from hil.scenario import Scenario, load
from hil.scenario.encoders import coarse
from tests.support.processes import hil as run_hil

KEYS = {"tracking_bandwidth_rad_s": 1, "speed_kp_n_m_s_rad": 1, "speed_ki_n_m_rad": 2}
FIRMWARE = """
[firmware]
counts_per_revolution = {counts}
torque_limit_n_m = 5.0
torque_constant_n_m_a = 1.25
"""


def gains(scenario: Scenario) -> list[float]:
    return [getattr(scenario.firmware, key) for key in KEYS]


@pytest.mark.parametrize("counts", [64, 128, 512, 1023, 1024, 4096, 32768])
@pytest.mark.parametrize(("name", "ki"), [("circle_speed", 25.0), ("compare_circle", 12.0)])
def test_filter_and_gains_of_a_shipped_scenario_follow_the_encoder(name: str, ki: float, counts: int) -> None:
    scenario, factor = load(name, set={"firmware.counts_per_revolution": counts}), slower(counts)
    assert gains(scenario) == pytest.approx([150.0 * factor, 1.1 * factor, ki * factor**2], rel=5e-4)
    if counts >= 1024:
        assert gains(scenario) == [150.0, 1.1, ki]
    where = scenario.provenance["firmware.speed_kp_n_m_s_rad"]
    assert where == "paper_circle.toml:29" + ("" if counts >= 1024 else f", for {counts} counts a turn")


def test_a_users_own_gain_stays_and_what_nobody_gives_follows(tmp_path) -> None:
    own = tmp_path / "own.toml"
    own.write_text('extends = "circle_speed"\n' + FIRMWARE.format(counts=64) + "speed_kp_n_m_s_rad = 0.9\n")
    assert gains(load(own)) == pytest.approx([150.0 * slower(64), 0.9, 25.0 * slower(64) ** 2], rel=1e-3)
    assert gains(load(own, set={"firmware.speed_ki_n_m_rad": 7.0}))[2] == 7.0
    copied = tmp_path / "paper_circle.toml"
    copied.write_text('extends = "circle_speed"\n' + FIRMWARE.format(counts=64) + "speed_kp_n_m_s_rad = 0.9\n")
    assert gains(load(copied))[1] == 0.9, "given beside the counts"


@pytest.mark.parametrize("name", ["paper_circle", "circle_speed", "compare_circle", "circle_slip", "paper_experiment"])
def test_of_a_shipped_scenario_there_is_nothing_to_say(name: str) -> None:
    assert not list(coarse(load(name)))
    assert not list(coarse(load(name, set={"firmware.counts_per_revolution": 512})))


FAST = {
    "firmware.tracking_bandwidth_rad_s": 150.0,
    "firmware.speed_kp_n_m_s_rad": 1.1,
    "firmware.speed_ki_n_m_rad": 12.0,
}


def test_what_is_told_to_set_is_enough() -> None:
    """Each sentence says what to set; with it the sentence is gone."""
    sets = {"firmware.counts_per_revolution": 64, **FAST}
    (loop,) = coarse(load("circle_speed", set=sets))
    assert "evenly moves by up to 5.6 rad/s, and speed_kp_n_m_s_rad makes 6.2 N·m of it, where the limit is 1.8" in loop
    told = dict(re.findall(r"(firmware\.\w+)=([\d.]+)", loop))
    assert told == {
        "firmware.tracking_bandwidth_rad_s": "49.5",
        "firmware.speed_kp_n_m_s_rad": "0.363",
        "firmware.speed_ki_n_m_rad": "1.31",
    }
    assert not list(coarse(load("circle_speed", set={**sets, **{key: float(value) for key, value in told.items()}})))
    (slip,) = coarse(load("compare_circle", set=sets))
    assert (
        "0.42 m/s at the rim, and of a change to come 2.5 m/s is not seen: wheels that slip lose their torque at "
        in slip
    )
    assert "at 0.42 m/s to 0.57 m/s, but later than limiter.slip_m_s = 0.3 asks for" in slip
    counts, limit = re.findall(r"needs (\d+) counts, or a limit of ([\d.]+)", slip)[0]
    for enough in ({"firmware.counts_per_revolution": int(counts)}, {"limiter.slip_m_s": float(limit) + 0.05}):
        assert not list(coarse(load("compare_circle", set={**sets, **enough})))
    assert (
        len(list(coarse(load("compare_circle", set={**sets, "firmware.counts_per_revolution": int(counts) - 9})))) == 1
    )


@pytest.mark.parametrize("felt", [{"estimator.source": "fused"}, {"estimator.twist": "wheels"}])
def test_a_law_that_acts_on_the_wheels_speed_is_told_of_its_noise(felt: dict[str, str]) -> None:
    *_, noise = coarse(load("compare_circle", set={"firmware.counts_per_revolution": 64, **felt}))
    assert "0.14 m/s at the rim, and a law that commands torques acts on it: set controller.command=" in noise
    speed = {"firmware.counts_per_revolution": 64, "controller.command": "speed", **felt}
    assert not list(coarse(load("compare_circle", set=speed)))


def test_of_other_motor_controllers_nothing_is_said() -> None:
    sets = {"device.driver": "vesc", "loop.rate_hz": 100, "firmware.counts_per_revolution": 64, **FAST}
    assert not list(coarse(load("circle_speed", set=sets)))


def test_check_prints_it_and_is_content(capsys: pytest.CaptureFixture[str]) -> None:
    shown = run_hil("check", "compare_circle", "--set", "firmware.counts_per_revolution=64")
    assert shown.returncode == 0
    assert re.search(r"\n  encoder +with 64 counts a turn the measured speed", shown.stdout)
    found = json.loads(
        run_hil("check", "compare_circle", "--set", "firmware.counts_per_revolution=64", "--json").stdout
    )
    assert len(found["encoder"]) == 1
