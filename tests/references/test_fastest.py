"""The optimum of tools.fastest lies between what can be said without it."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.references import make_reference
from hil.scenario import load
from tools import fastest

MODEL = replace(load("compare_circle").robot, speed_limit_rad_s=60.0)
REST = make_reference("hold", {}, None)


def test_the_least_time_along_a_diagonal_is_between_one_pair_s_and_that_of_both_pairs_all_the_way():
    """A pair of wheels alone does it with its heading kept; no heading has more force than two pairs side by side."""
    away_m, pair = 0.6, 2.0 * math.sqrt(2.0) * MODEL.torque_limit_n_m / MODEL.wheel_radius_m / MODEL.effective_mass_kg
    start = fastest.Start(away_m / math.sqrt(2.0), -away_m / math.sqrt(2.0), 0.0)
    found = fastest.least_time_s(MODEL, REST, start)
    kept, both = (2.0 * math.sqrt(away_m / a) for a in (pair, math.sqrt(2.0) * pair))
    assert both - 0.05 < found < kept


def test_what_counts_is_the_motion_that_the_torques_cause_and_it_keeps_the_limits():
    start = fastest.Start(0.4, 0.1, 0.2)
    motion, missed_m = fastest.motion_within(MODEL, REST, start, 0.45)
    assert missed_m < 2e-4
    assert np.abs(motion.torques_n_m).max() <= MODEL.torque_limit_n_m + 1e-9
    assert np.abs(fastest.wheel_speeds(MODEL, motion.states)).max() < 1.01 * MODEL.speed_limit_rad_s
    state = np.array([*start, 0.0, 0.0, 0.0])
    for torque_n_m, step_s in zip(motion.torques_n_m, motion.steps_s, strict=True):
        for _ in range(50):  # much finer than the program's own steps
            state = fastest.advance(MODEL, state, torque_n_m, np.array(step_s / 50))
    assert math.hypot(*state[:2]) < 0.015
    assert fastest.motion_within(MODEL, REST, start, 0.15)[1] > 0.01, "too short for any torque"


def test_the_table_has_a_row_for_each_torque_and_mass(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(fastest, "MASSES_KG", (20.0,))
    head, *rows = fastest.rows(0, fastest.Optima(tmp_path / "optima.jsonl"))
    assert [row[0] for row in rows] == ["5", "1.8"]
    for row in rows:
        assert float(row[2]) < float(row[3]) < 1.3 * float(row[2])
    assert len(head) == len(rows[0])
    monkeypatch.delattr(fastest, "least_time_s")  # the second time all are in the file
    assert list(fastest.rows(0, fastest.Optima(tmp_path / "optima.jsonl"))) == [head, *rows]
