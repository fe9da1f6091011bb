"""Tests of a law with the fixtures of the pytest plugin, which pytest finds by itself: run `pytest` in this folder."""

import numpy as np
import pytest

LAW = {"controller.law": "./my_law.py:MyLaw", "controller.gains": {}, "loop.duration_s": 4.0, "expect": []}


def test_the_law_reaches_the_circle_and_stays_there(hil_run):
    result = hil_run("circle_speed", set=LAW)  # fails the test with a report when the run does not pass
    t_s, error_m = result.signals["loop.t_s"], result.signals["error.planar_m"]
    assert np.max(error_m[t_s > 3.0]) < 0.05


@pytest.mark.parametrize("mass_kg", [16.0, 24.0])
def test_the_law_does_not_need_to_know_the_mass(hil_run, mass_kg):
    result = hil_run("circle_speed", set=LAW | {"plant.start.mass_kg": mass_kg})
    assert result.signals["error.planar_m"][-1] < 0.05


def test_a_lost_link_stops_the_robot(hil_run):
    lost = {"kind": "mute", "target": "WHEEL_COMMAND", "start_s": 1.0}
    result = hil_run("circle_speed", set=LAW | {"fault": [lost]}, check=False)  # judged by this test itself
    assert "COMMAND_TIMEOUT" in str(result.failure)
