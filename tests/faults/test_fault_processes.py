"""Faults of a robot in another process: they go through its truth socket, act as in one process, and are counted."""

import contextlib
import sys
from pathlib import Path

import pytest

from hil.core.clock import WallClock
from hil.core.errors import BadInputError
from hil.core.signals import SIGNAL_NAMES
from hil.robot.truth_client import TruthClient
from hil.runtime.assembly import run
from hil.runtime.fault_injection import RunFaults
from hil.scenario import load
from tests.support.fault_runs import applied, write
from tests.support.processes import device, hil, hil_process, run_json

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")

ROWS = (
    {"kind": "dead_motor", "target": "fl", "start_s": 0.1, "end_s": 0.2},
    {"kind": "push", "target": "moment_n_m", "start_s": 0.15, "end_s": 0.25, "value": 5.0},
    {"kind": "drop", "target": "command", "start_s": 0.1, "value": 0.2},
)


def test_in_lockstep_it_is_the_run_of_one_process(tmp_path: Path) -> None:
    path = write(tmp_path, ROWS, duration_s=0.4)
    here = run(path, set=["expect=[]"])
    options = ("--set", "expect=[]", "--record", "none")
    with device(str(path), "--mode", "lockstep", "--link", "serial:pty") as robot:
        there = [run_json(str(path), *options, "--link", robot.link, "--truth", robot.truth) for _ in range(2)]
        other = write(tmp_path, [{"kind": "gyro_bias", "start_s": 0.1, "end_s": 0.2, "value": 0.2}], duration_s=0.4)
        biased = run_json(str(other), *options, "--link", robot.link, "--truth", robot.truth)
        refused = hil("run", str(path), *options, "--link", robot.link, "--set", "estimator.source=odometry")
    for figures in there:
        assert figures["wire_sha256"] == here.metrics["wire_sha256"]
        assert [row["applied"] for row in figures["fault"]] == applied(here)
    assert [row["applied"] for row in biased["fault"]] == [100]
    assert refused.returncode == 2
    assert "fault gyro_bias gyro" in refused.stderr
    assert "--truth" in refused.stderr


def test_what_the_robot_there_has_no_part_for_is_refused_before_anything_moves(tmp_path: Path) -> None:
    path = write(tmp_path, [{"kind": "parameter", "target": "friction", "value": 0.1}])
    with device(str(path), "--mode", "lockstep", "--link", "serial:pty") as robot:
        refused = hil("run", str(path), "--record", "none", "--link", robot.link, "--truth", robot.truth, "--json")
    assert refused.returncode == 2
    assert "no tunable parameter or free input 'friction'" in refused.stderr
    with pytest.raises(BadInputError, match="'friction'"):
        run(path)


def test_a_robot_that_was_given_other_faults_meanwhile_does_not_know_of_ours(tmp_path: Path) -> None:
    path = write(tmp_path, ROWS)
    scenario = load(path)
    with device(str(path), "--mode", "lockstep", "--link", "serial:pty") as robot, contextlib.ExitStack() as resources:
        ours, others = (TruthClient(robot.truth, scenario.hash, reset=False) for _ in range(2))
        resources.callback(ours.close)
        resources.callback(others.close)
        faults = RunFaults([table.row for table in scenario.fault], 1, WallClock(), SIGNAL_NAMES)
        faults.arm(ours)
        assert faults.applied() == [0, 0, 0]
        others.arm([])
        assert faults.applied() == [None, None, 0], "the link's own is known here"


@pytest.mark.alone
@pytest.mark.parametrize("kind", ["gyro_bias", "slow_clock"])
def test_in_real_time_faults_begin_when_the_scenario_does(tmp_path: Path, kind: str) -> None:
    value = 50_000.0 if kind == "slow_clock" else 0.2
    path = write(tmp_path, [{"kind": kind, "start_s": 0.1, "end_s": 0.3, "value": value}], duration_s=0.5)
    with device(str(path), "--mode", "realtime", "--link", "serial:pty") as robot:
        there = ("--link", robot.link, "--truth", robot.truth, "--mode", "realtime", "--set", "expect=[]")
        figures = run_json(path, *there, "--record", "none", by=hil_process)
    assert figures["fault"][0]["applied"] == (10 if kind == "slow_clock" else 200)
