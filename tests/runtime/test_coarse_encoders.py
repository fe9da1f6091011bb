"""Runs of robots with coarse encoders: on their path as with fine ones, and told what they cannot show."""

from typing import Any

import numpy as np
import pytest

import hil
from hil.core.types import WHEEL_NAMES


def driven(counts: int, law: str, **more: Any) -> hil.RunResult:
    sets = {"firmware.counts_per_revolution": counts, "controller.law": law, "controller.gains": {}, "expect": []}
    sets |= {"loop.duration_s": 3.0} | {key.replace("__", "."): value for key, value in more.items()}
    return hil.run("compare_circle", set=sets, lenient=True)


@pytest.mark.parametrize(("counts", "law", "limit_n_m"), [(64, "profile", 5.0), (64, "pid", 1.8), (256, "afdsc", 1.8)])
def test_torque_of_wheels_that_roll_is_left_alone_at_any_resolution(counts: int, law: str, limit_n_m: float) -> None:
    """At 256 counts a fixed limit of 0.3 m/s had the robot on its path after 12.2 s in place of 0.4 s."""
    limit = {"robot__torque_limit_n_m": limit_n_m, "firmware__torque_limit_n_m": limit_n_m}
    coarse, fine = (driven(one, law, **limit) for one in (counts, 4096))
    assert coarse.metrics["t10_s"] == pytest.approx(fine.metrics["t10_s"], abs=0.02)
    assert coarse.metrics["saturation_s"] == pytest.approx(fine.metrics["saturation_s"], abs=0.02)
    assert coarse.metrics["taken_n_m_s"] == 0.0
    assert not [event.text for event in coarse.run.events if "torque is taken" in event.text]


def test_a_speed_loop_that_follows_its_encoder_is_calm_and_as_fast() -> None:
    """With the gains of 4096 counts the torque varies by 312 N·m/s a wheel at 64."""
    fine, coarse = (driven(counts, "profile", controller__command="speed") for counts in (4096, 64))
    given = {"tracking_bandwidth_rad_s": 150.0, "speed_kp_n_m_s_rad": 1.1, "speed_ki_n_m_rad": 12.0}
    rough = driven(
        64, "profile", controller__command="speed", **{f"firmware__{key}": one for key, one in given.items()}
    )
    varies = [run.metrics["torque_variation_n_m_per_s"] for run in (coarse, rough)]
    assert varies[0] < 25.0 < 250.0 < varies[1]
    assert coarse.metrics["t10_s"] < 1.2 * fine.metrics["t10_s"]


def test_wheels_that_slip_lose_their_torque_at_64_counts_too() -> None:
    floor = {"plant__start__contact": "slip", "plant__start__grip_coefficient": 0.35}
    limit = {"robot__torque_limit_n_m": 1.8, "firmware__torque_limit_n_m": 1.8}
    kept, free = (driven(64, "pid", **floor, **limit, limiter__slip_m_s=slip_m_s) for slip_m_s in (0.3, float("inf")))
    fastest = [
        max(np.abs(run.signals[f"wheel.{wheel}.speed_rad_s"]).max() for wheel in WHEEL_NAMES) for run in (kept, free)
    ]
    assert fastest[0] < 35.0 < 70.0 < fastest[1]
    taken_n_m, t_s = kept.signals["guard.taken_n_m"], kept.signals["loop.t_s"]
    assert kept.metrics["taken_n_m_s"] == pytest.approx(float(taken_n_m[:-1] @ np.diff(t_s)), rel=1e-9)
    assert kept.metrics["taken_n_m_s"] > 0.5
    assert set(kept.signals["guard.limit"][taken_n_m > 0.0]) == {2.0}
    noted = [event for event in kept.run.events if event.text.startswith("torque is taken from ")]
    assert 1 <= len(noted) <= 3
    assert noted[0].t_s == pytest.approx(t_s[np.flatnonzero(taken_n_m)[0]])
    assert "(limiter.slip_m_s)" in noted[0].text
    assert set(free.signals["guard.limit"]) <= {0.0, 1.0}, "only for the speed of a wheel"
    assert kept.metrics["torque_variation_n_m_per_s"] < 20.0
