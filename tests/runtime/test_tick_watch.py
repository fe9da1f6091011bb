"""A law that never returns: found by the wall clock, reported, and ended, with the recorded data kept."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

import hil
from hil.addons.service.messages import Phase
from hil.core.errors import BadInputError, OverdueError
from hil.core.subprocesses import module_command
from hil.core.tick_watch import TickOverdue, TickWatch
from hil.judge.recorded import judged_run
from hil.judge.run_json import to_json
from hil.record.reader import read
from hil.scenario import load
from tests.support.pilot_bench import PilotBench, armed_pilot

LIMIT = {"loop.tick_limit_s": 0.2, "loop.duration_s": 1.0, "expect": [], "controller.gains": {}}
_LAW = """
import time
from hil.core.types import CommandMode, WheelCommand, Wheels

STILL = WheelCommand(CommandMode.SPEED, Wheels(0.0, 0.0, 0.0, 0.0), Wheels(0.0, 0.0, 0.0, 0.0))

class Law:
    asked = 0

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        self.asked += 1
        if self.asked == 20:
            {stuck}
        return STILL
"""
LOOP = "while True: pass"
STUBBORN = """
            while True:
                try:
                    time.sleep(0.001)
                except Exception:
                    pass
"""
SLEEP = "time.sleep(60.0)"


def law(folder: Path, stuck: str) -> str:
    (folder / "stuck_law.py").write_text(_LAW.format(stuck=stuck))
    return f"{folder / 'stuck_law.py'}:Law"


@pytest.mark.parametrize(("stuck", "mode"), [(LOOP, "lockstep"), (STUBBORN, "lockstep"), (LOOP, "realtime")])
def test_a_law_that_never_returns_ends_the_run_with_a_sentence(tmp_path: Path, stuck: str, mode: str) -> None:
    result = hil.run(
        "circle_speed", set={**LIMIT, "controller.law": law(tmp_path, stuck)}, mode=mode, record=tmp_path / "run.mcap"
    )
    assert result.exit_code == 3
    assert isinstance(result.failure, OverdueError)
    assert "did not end within 0.2 s of wall-clock time at " in str(result.failure)
    assert "stuck_law.py:" in str(result.failure)
    assert result.metrics["stopped"]
    recorded = len(read(tmp_path / "run.mcap", ["loop.tick"]).signals["loop.tick"])
    assert result.metrics["ticks"] == recorded >= 19


def test_a_law_that_no_exception_gets_to_ends_the_process_and_its_recording_is_kept(tmp_path: Path) -> None:
    sets = [f"--set={key}={json.dumps(value)}" for key, value in LIMIT.items() if key != "controller.gains"]
    command = module_command(
        "hil.cli.main", "run", "circle_speed", "--record", str(tmp_path / "run.mcap"), "--json", *sets
    )
    ran = subprocess.run(
        [*command, "--set", "controller.gains={}", "--set", f"controller.law={law(tmp_path, SLEEP)}"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ran.returncode == 3, ran.stderr
    sentence = ran.stderr.splitlines()[-1].removeprefix("hil: ")
    assert "in update: a law that does not return? loop.tick_limit_s is the limit" in sentence
    assert "time.sleep(60.0)" in ran.stderr
    assert json.loads(ran.stdout) == {"schema": "hil.run/1", "passed": False, "failure": sentence}
    run = read(tmp_path / "run.mcap")
    assert len(run.signals["loop.tick"]) == 19
    found = to_json(judged_run(run))
    assert (found["passed"], found["failure"]) == (False, sentence)
    assert sentence in [event.text for event in run.events]


STUCK_IN_STDERR = """
import sys
from hil.core.tick_watch import TickWatch

with TickWatch(0.1, lambda: 0.0, lambda _: print("last words", flush=True)) as watch:
    watch.turn += 1
    sys.stderr.write("x" * 1_000_000)
"""


def test_a_process_ends_whose_tick_is_stuck_where_the_sentence_is_to_be_written() -> None:
    pipe = subprocess.PIPE  # that of stderr is read by nobody
    with subprocess.Popen([sys.executable, "-c", STUCK_IN_STDERR], stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert process.wait(20) == OverdueError.exit_code
        finally:
            process.kill()
        assert process.stdout is not None
        assert process.stdout.read() == "last words\n"


def test_a_service_whose_law_never_returns_disarms_its_robot_and_goes_on(tmp_path: Path) -> None:
    with PilotBench(**{"controller.law": law(tmp_path, LOOP), "controller.gains": {}}) as bench:
        bench.run_until(Phase.DISARMED)
        bench.pilot.arm()
        with TickWatch(0.2, lambda: 0.0, pytest.fail) as watch:
            watch.turn = 1
            bench.run(1.0)
            watch.turn += 1
        assert "did not end within 0.2 s" in str(bench.pilot.why)
        assert bench.pilot.phase is Phase.DISARMED
        assert bench.series("loop.tick") == list(range(len(bench.rows)))


def test_a_service_goes_on_when_a_tick_is_overdue_outside_its_law(monkeypatch: pytest.MonkeyPatch) -> None:
    with armed_pilot() as bench, TickWatch(0.1, lambda: 0.0, pytest.fail) as watch:
        with monkeypatch.context() as stalled:
            report = type(bench.bench.device.report)  # read in each tick, outside the law
            stalled.setattr(report, "trouble", property(lambda _: time.sleep(0.4)))
            watch.turn += 1
            bench.run(0.01)
            watch.turn += 1
        assert "did not end within 0.1 s" in str(bench.pilot.why)
        bench.run_until(Phase.DISARMED)
        bench.pilot.arm()
        bench.run_until(Phase.ACTIVE)


@pytest.mark.parametrize("limit_s", [0.0, float("inf")])
def test_without_a_limit_nothing_is_watched(limit_s: float) -> None:
    assert load("circle_speed", set={"loop.tick_limit_s": limit_s}).loop.tick_limit_s == limit_s
    with TickWatch(limit_s, lambda: 0.0, pytest.fail) as watch:
        watch.turn += 1
        time.sleep(0.05)


def test_ticks_that_go_on_and_waits_between_them_are_let_be() -> None:
    with TickWatch(0.1, lambda: 0.0, pytest.fail) as watch:
        for _ in range(8):
            watch.turn += 1
            time.sleep(0.03)
            watch.turn += 1
        time.sleep(0.25)


def never_return() -> None:
    with TickWatch(0.1, lambda: 0.0, pytest.fail) as watch:
        watch.turn += 1
        while True:
            pass


def test_what_is_overdue_is_ended_in_the_thread_that_does_it() -> None:
    with pytest.raises(TickOverdue, match=r"did not end within 0\.1 s .* in never_return"):
        never_return()


@pytest.mark.parametrize("limit_s", [-1, 1e-9, 0.049])
def test_no_limit_is_so_short_that_the_watch_would_spin(limit_s: float) -> None:
    with pytest.raises(BadInputError, match=rf"loop\.tick_limit_s = {limit_s}"):
        load("circle_speed", set={"loop.tick_limit_s": limit_s})
    assert load("circle_speed", set={"loop.tick_limit_s": 0.05}).loop.tick_limit_s == 0.05
