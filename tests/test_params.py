"""`hil params`: the firmware's parameters over a real line, from a process of its own."""

import json
from pathlib import Path

import pytest

from tests.processes import device, hil


def test_parameters_are_shown_changed_and_kept(tmp_path: Path) -> None:
    with device("paper_circle", "--mode", "realtime", "--link", f"serial:pty?symlink={tmp_path}/robot") as robot:
        before = json.loads(hil("params", robot.link, "--json").stdout)
        assert before["speed_kp_n_m_s_rad"] == 1.100000023841858, "in single precision"
        changes = ("speed_kp_n_m_s_rad=1.5", "counts_per_revolution=2048", "watchdog_s=0.1")
        after = json.loads(hil("params", robot.link, *changes, "--store", "--json").stdout)
        assert (after["speed_kp_n_m_s_rad"], after["counts_per_revolution"]) == (1.5, 2048)
        assert "speed_kp_n_m_s_rad        1.5" in hil("params", robot.link).stdout
        restored = json.loads(hil("params", robot.link, "--restore", "--json").stdout)
        assert restored == before


@pytest.mark.parametrize("link", ["serial:pty", "memory:", "can:virtual/x"])
def test_a_link_that_reaches_no_robot_elsewhere_is_one_sentence(link) -> None:
    done = hil("params", link)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert f"link '{link}' reaches no robot outside this process" in done.stderr
    assert "serial:/dev/ttyACM0, or the link that 'hil device' prints" in done.stderr


def test_a_wrong_parameter_is_one_sentence(tmp_path: Path) -> None:
    with device("paper_circle", "--mode", "realtime", "--link", f"serial:pty?symlink={tmp_path}/robot") as robot:
        for change, words in (
            ("speed_kp=1", "did you mean 'speed_kp_n_m_s_rad'?"),
            ("watchdog_s=5", "expected a number from 0.02 to 0.1"),
            ("speed_kp_n_m_s_rad=1e39", "speed_kp_n_m_s_rad = 1e+39; expected a number from 0 to"),
            ("counts_per_revolution=1e39", "expected a number from"),
            ("counts_per_revolution=7.5", "expected a whole number"),
            ("ramp_s", "expected NAME=NUMBER"),
            ("ramp_s=nan", "expected NAME=NUMBER"),
        ):
            done = hil("params", robot.link, change)
            assert done.returncode == 2
            assert words in done.stderr
            assert done.stderr.count("\n") == 1
