"""Whole runs with faults over each link in one process: effect, account, and the same run from the same seed."""

import functools
import tempfile
from pathlib import Path

import numpy as np
import pytest

from hil.faults.kinds import KINDS
from hil.record.reader import read
from hil.runtime.assembly import RunResult
from tests.support.fault_runs import LINKS, applied, run_with, write

BYTES = ("bit_errors", "truncation", "babble")
WINDOW = {"start_s": 0.15, "end_s": 0.25}

# One row of every kind, and what it has to leave behind.
ROWS = {
    "drop": {"target": "command", "value": 0.5},
    "burst_loss": {"target": "feedback", "value": 0.3, "burst_frames": 4.0},
    "delay": {"target": "command", "value": 0.01},
    "jitter": {"target": "feedback", "value": 0.004},
    "duplicate": {"target": "command"},
    "reorder": {"target": "WHEEL_COMMAND", "value": 0.5},
    "bit_errors": {"target": "feedback", "value": 0.001},
    "truncation": {"target": "command", "value": 0.3},
    "disconnect": {},
    "mute": {"target": "GYRO"},
    "freeze": {"target": "feedback"},
    "babble": {"target": "command", "value": 100.0},
    "estop": {"target": "command"},
    "reset": {"target": "robot"},
    "stuck_encoder": {"target": "fl"},
    "lost_counts": {"target": "rl", "value": 0.1},
    "dead_motor": {"target": "rr"},
    "low_battery": {"value": 15.0},
    "gyro_bias": {"value": 0.5},
    "slow_clock": {"value": 50_000.0},
    "parameter": {"target": "friction_coefficient", "value": 0.5},
    "push": {"target": "force_y_n", "value": 60.0},
    "slip_patch": {"value": 0.05},
    "payload": {"value": 8.0, "x_m": 0.1},
    "lifted_wheel": {"target": "fl"},
    "bias": {"target": "truth.x_m", "value": 0.05},
    "override": {"target": "wheel.fl.speed_command_rad_s", "value": 0.0},
}
CHANGES = ("expect=[]", "firmware.watchdog_s=0.1", "plant.start.contact=slip", "plant.start.drive=current")
ENDS_THE_RUN = {"disconnect", "estop", "reset"}


def fault(kind: str) -> dict[str, str | float]:
    window = {"start_s": WINDOW["start_s"]} if kind in ("reset", "estop") else WINDOW
    return {"kind": kind, **ROWS[kind], **window}


@functools.cache
def result(kind: str | None, link: str, seed: int = 1) -> RunResult:
    with tempfile.TemporaryDirectory() as folder:
        rows = [fault(kind)] if kind else []
        return run_with(Path(folder), *rows, link=link, seed=seed, duration_s=0.4, changes=CHANGES)


def test_every_kind_is_here() -> None:
    assert set(ROWS) == {kind.name for kind in KINDS}


# Quick: of each kind one link, each link in turn.
ON_LINKS = [
    pytest.param(kind, link, marks=() if (place + turn) % len(LINKS) == 0 else pytest.mark.slow)
    for place, kind in enumerate(ROWS)
    for turn, link in enumerate(LINKS)
]


@pytest.mark.parametrize(("kind", "link"), ON_LINKS)
def test_every_kind_is_applied_and_seen_on_every_link(kind, link) -> None:
    clean, faulty = result(None, link), result(kind, link)
    (count,) = applied(faulty)
    assert count > 0
    assert (faulty.failure is not None) == (kind in ENDS_THE_RUN)
    assert faulty.passed == (kind not in ENDS_THE_RUN)
    before = clean.signals["loop.t_s"] < WINDOW["start_s"] - 1e-9
    rows = before.sum()
    for name in ("truth.x_m", "truth.y_m", "wheel.fl.speed_rad_s", "robot.yaw_rate_rad_s"):
        assert np.array_equal(clean.signals[name][:rows], faulty.signals[name][:rows], equal_nan=True), name
    if kind in ("bit_errors", "babble") and link.startswith("can"):
        assert sum(faulty.metrics["frames"]["rejected"].values()) >= count
    unseen = kind == "bit_errors" and link.startswith("can")  # the controllers make up for it
    assert (clean.metrics["wire_sha256"] == faulty.metrics["wire_sha256"]) is unseen


@pytest.mark.slow
@pytest.mark.parametrize("kind", ROWS)
def test_the_same_seed_gives_the_same_run_on_every_transport(kind) -> None:
    runs = [result(kind, link) for link in LINKS]
    compared = runs[:2] if kind in BYTES else runs
    assert len({run.metrics["wire_sha256"] for run in compared}) == 1
    assert len({tuple(applied(run)) for run in compared}) == 1


def test_the_same_scenario_again_is_the_same_run_and_another_seed_is_not(tmp_path) -> None:
    def once(seed: int) -> tuple[str, list[int]]:
        run = run_with(tmp_path, fault("drop"), fault("bit_errors"), seed=seed, duration_s=0.3)
        return run.metrics["wire_sha256"], applied(run)

    assert once(1) == once(1)
    assert once(1)[0] != once(2)[0]


def test_rows_do_not_change_each_other(tmp_path) -> None:
    drop, gyro = fault("drop"), fault("mute")
    both = run_with(tmp_path, gyro, drop, duration_s=0.3)
    alone = run_with(tmp_path, drop, duration_s=0.3)
    assert applied(both)[1] == applied(alone)[0]
    assert np.array_equal(both.signals["truth.x_m"], alone.signals["truth.x_m"])


def test_a_fault_that_never_happened_fails_the_run(tmp_path) -> None:
    late = run_with(tmp_path, {"kind": "drop", "target": "command", "start_s": 50.0}, duration_s=0.1)
    assert applied(late) == [0]
    assert late.exit_code == 1


def test_windows_of_links_are_exact_to_the_tick(tmp_path) -> None:
    row = {"kind": "mute", "target": "TORQUE_COMMAND", "start_s": 0.05, "end_s": 0.062}
    run = run_with(tmp_path, row, base="paper_circle", duration_s=0.1, changes=["expect=[]"])
    assert applied(run) == [12]
    age_ms = run.signals["robot.command_age_ms"]
    # The command of tick 49 is the last one; each tick samples the age before the next one comes.
    assert age_ms[50] == age_ms[49]
    assert (age_ms[51:63] - age_ms[50]).tolist() == list(range(1, 13))
    assert age_ms[63] == age_ms[49]


def test_the_recording_tells_when_a_fault_began_and_what_it_did(tmp_path) -> None:
    from hil.runtime.assembly import run

    path = write(tmp_path, [fault("drop"), {"kind": "gyro_bias", "value": 0.1}], duration_s=0.3)
    recorded = run(path, record=tmp_path / "faulty.mcap", set=["expect=[]"])
    assert recorded.metrics["recorded"]["error"] is None
    text = [event for event in read(tmp_path / "faulty.mcap").events if "fault" in event.text]
    assert [event.text.split(":")[0] for event in text].count("fault begins") == 2
    assert any(f"applied {applied(recorded)[0]} times (frames lost)" in event.text for event in text)


def test_a_fault_latched_while_the_link_was_cut_is_told_with_wheel_and_way_out(tmp_path) -> None:
    cut = {"kind": "disconnect", "start_s": 0.25, "end_s": 0.35}
    stuck = {"kind": "stuck_encoder", "target": "fl", "start_s": 0.2}
    wired = ("device.wheels=['rr','rl','fl','fr']", "loop.rearm=true", "expect=[]")
    ended = run_with(tmp_path, cut, stuck, changes=wired)
    assert ended.exit_code == 3
    assert "it is FAULT because of ENCODER_STUCK of wheel fl; it is latched; find the cause" in str(ended.failure)
    assert "CLEAR" in str(ended.failure)
