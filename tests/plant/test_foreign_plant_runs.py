"""Whole runs with an FMU that is not the shipped one: as good when it is sound, and ended in order when it is not."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hil as bridge
from hil.core.errors import BadInputError
from hil.record.reader import read
from tests.support.flawed_fmu import build_flawed
from tests.support.foreign_fmu import foreign_fmu
from tests.support.processes import HIL, ROOT, device, environment, hil, run_json, wait_for

START = ("start_x_m=0.8", "start_y_m=-0.2", "start_heading_rad=0.0")  # those of paper_circle
LAST_WORDS = "SIGSEGV (Segmentation fault); its last words: 'the last words of a crash'"
FAILED = re.compile(r"hil: the plant flawed\.fmu failed at (?P<at>[\d.]+) s: (?P<why>.*)\n")
REAL_TIME = pytest.param("realtime", marks=pytest.mark.alone)
FLAWS = {
    "segfault": LAST_WORDS,
    "hang": "it gave no answer within 0.5 s and was ended",
    "error": "doStep: communication step -0.001 s; expected a positive number",
    "nan": "pose.x_m is not a number; expected a finite number",
    "exit": "its process exited with code 0",
}


@pytest.fixture(scope="module")
def flawed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_flawed(tmp_path_factory.mktemp("flawed"))


def sets(fmu: Path, *more: str) -> tuple[str, ...]:
    keys = (f"plant.fmu={fmu}", "plant.timeout_s=0.5", *(f"plant.start.{value}" for value in START), *more)
    return tuple(word for key in keys for word in ("--set", key))


def rows(recording: Path) -> int:
    """Return how many rows are in the recording by now."""
    try:
        return len(read(recording).signals.get("loop.t_s", ()))
    except BadInputError:
        return 0  # not begun


def test_a_sound_foreign_fmu_gives_the_bytes_of_the_shipped_one(flawed: Path) -> None:
    """It is the shipped one with other bytes, so that it runs in a process of its own."""
    short = {"loop.duration_s": 2.0, "expect": []}
    shipped = bridge.run("paper_circle", set=short)
    start = {f"plant.start.{key}": value for key, value in shipped.scenario.plant.start.items()}
    there = bridge.run("paper_circle", set=short | {"plant.fmu": flawed} | start)
    assert there.failure is None
    assert there.metrics["wire_sha256"] == shipped.metrics["wire_sha256"]
    for name in ("truth.x_m", "truth.y_m", "truth.heading_rad"):
        assert np.array_equal(there.signals[name], shipped.signals[name])


def test_a_longer_step_is_the_same_in_both_processes_and_is_told(flawed: Path, tmp_path: Path) -> None:
    short = {"loop.duration_s": 1.0, "expect": []}
    by_tick = bridge.run("paper_circle", set=short)
    start = {f"plant.start.{key}": value for key, value in by_tick.scenario.plant.start.items()}
    wires = {by_tick.metrics["wire_sha256"]}
    for fmu in ({}, {"plant.fmu": flawed} | start):
        recording = tmp_path / f"{len(fmu)}.mcap"
        run = bridge.run("paper_circle", set=short | {"plant.step_s": 0.005} | fmu, record=recording)
        assert run.failure is None
        wires.add(run.metrics["wire_sha256"])
        told = [event.text for event in read(recording).events if event.text.startswith("the plant says: ")]
        late = "an input acts up to 4 ms late, and an output is up to 4 ms old"
        assert told == [f"the plant says: stepped by 0.005 s, 5 ticks (as plant.step_s says): {late}"]
    assert len(wires) == 2


def test_the_example_of_the_page_runs_as_written(tmp_path: Path) -> None:
    page = (ROOT / "plant_fmu" / "FOREIGN.md").read_text("utf-8")
    (example,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    scenario = tmp_path / "my_robot.toml"
    scenario.write_text(example, "utf-8")
    assert foreign_fmu(tmp_path, 2).name == "wheels2.fmu"
    result = bridge.run(scenario)
    assert result.passed
    assert result.metrics["steady_max_m"] < 0.001
    wrong = bridge.run(scenario, set=["plant.map.wheel.fl.torque_n_m.sign=-1", "loop.duration_s=3", "expect=[]"])
    assert wrong.failure is not None or np.max(wrong.signals["error.planar_m"][-100:]) > 0.1


@pytest.mark.parametrize("mode", ["lockstep", REAL_TIME])
@pytest.mark.parametrize("flaw", FLAWS)
def test_a_foreign_fmu_takes_down_the_run_in_order(
    flawed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flaw: str, mode: str
) -> None:
    recording = tmp_path / "run.mcap"
    monkeypatch.setenv("FLAW", f"{flaw} 0.5")  # after the first torque
    done = hil("run", "circle_speed", *sets(flawed), "--mode", mode, "--record", str(recording))
    assert done.returncode == 3
    told = FAILED.fullmatch(done.stderr)
    assert told is not None, done.stderr
    assert FLAWS[flaw] in told["why"]
    run = read(recording)
    assert run.summary is not None
    assert run.summary["failure"] == done.stderr.removeprefix("hil: ").rstrip("\n")
    assert (run.summary["passed"], run.rows_dropped) == (False, 0)
    assert len(run.signals["loop.t_s"]) == run.summary["ticks"] > 50
    failed_at_s, last_s = float(told["at"]), run.signals["robot.time_s"][-1]
    assert last_s <= failed_at_s + 1e-9
    if mode == "lockstep":
        assert last_s == pytest.approx(failed_at_s, abs=0.0051), "every tick until then"
    (event,) = (event for event in run.events if event.text.startswith("the plant flawed.fmu failed"))
    assert event.level == "ERROR"


def test_a_foreign_fmu_that_hangs_in_a_step_of_one_call_is_ended_too(
    flawed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a step is one call of the library, the threads that watch the plant still get their turn."""
    monkeypatch.setenv("FLAW", "hang 0.5")
    done = hil("run", "paper_circle", *sets(flawed), "--record", "none")
    assert done.returncode == 3
    assert FLAWS["hang"] in done.stderr


def test_what_a_chatty_fmu_prints_is_recorded_in_part_and_disturbs_nothing(
    flawed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some 40,000 lines: the first and the newest ones are in the recording, and how many there were between them."""
    short = {"loop.duration_s": 0.4, "expect": [], "plant.fmu": flawed}
    quiet = bridge.run("circle_speed", set=short)
    monkeypatch.setenv("FLAW", "print 0")
    recording = tmp_path / "run.mcap"
    chatty = bridge.run("circle_speed", set=short, record=recording)
    assert chatty.failure is None
    assert chatty.metrics["wire_sha256"] == quiet.metrics["wire_sha256"]
    told = [event.text for event in read(recording).events if event.text.startswith("the plant says: ")]
    assert 100 < len(told) <= 122  # one of them may not have come whole
    assert told[0].endswith(" s: all is well, and this line is there to fill the pipe of whoever reads it")
    left_out = re.fullmatch(r"the plant says: (\d+) lines are left out here", told[100])
    assert left_out is not None
    assert int(left_out[1]) > 20_000
    assert float(told[-2].removeprefix("the plant says: ").split()[0]) > 0.3


def test_a_plant_that_failed_is_not_waited_for(flawed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With loop.rearm a robot that is silent is waited for, but this one cannot come back."""
    monkeypatch.setenv("FLAW", "error 0.5")
    changes = [f"plant.fmu={flawed}", *(f"plant.start.{value}" for value in START), "loop.rearm=true", "expect=[]"]
    result = bridge.run("circle_speed", set=changes, link="serial:pty", mode="lockstep")
    assert "the plant flawed.fmu failed" in str(result.failure)


@pytest.mark.parametrize("flaw", ["segfault -1", "exit -1"])
def test_an_fmu_that_cannot_be_opened_ends_with_exit_code_3(
    flawed: Path, monkeypatch: pytest.MonkeyPatch, flaw: str
) -> None:
    monkeypatch.setenv("FLAW", flaw)
    for command in ("run", "device"):
        done = hil(command, "circle_speed", *sets(flawed), *(("--record", "none") if command == "run" else ()))
        assert done.returncode == 3
        assert done.stderr.startswith("hil: the plant flawed.fmu could not be opened: its process ")
        assert done.stderr.count("\n") == 1


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")
@pytest.mark.parametrize(
    ("mode", "flaw", "truth"),
    [
        ("lockstep", "segfault", True),
        ("lockstep", "hang", True),
        ("lockstep", "nan", False),
        pytest.param("realtime", "segfault", True, marks=pytest.mark.alone),
        pytest.param("realtime", "hang", False, marks=pytest.mark.alone),
    ],
)
def test_in_two_processes_both_end_with_exit_code_3(
    flawed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: str, flaw: str, truth: bool
) -> None:
    monkeypatch.setenv("FLAW", f"{flaw} 0.5")
    recording = tmp_path / "run.mcap"
    common = ("circle_speed", *sets(flawed), "--mode", mode)
    with device(*common, "--link", "serial:pty") as robot:
        by_truth = ("--truth", robot.truth) if truth else ("--set", "estimator.source=odometry")
        run = hil("run", *common, "--link", robot.link, *by_truth, "--record", recording)
        assert robot.process.wait(30) == 3
        assert robot.process.stderr is not None
        words = robot.process.stderr.read()
        assert robot.process.stdout is not None
        said = robot.process.stdout.read()
    assert ("the plant says: the last words of a crash\n" in said) == (flaw == "segfault")
    told = FAILED.fullmatch(words)
    assert told is not None, words
    assert FLAWS[flaw] in told["why"]
    assert run.returncode == 3
    assert re.fullmatch(r"hil: .*\b(lost|closed|ended|FAULT|silent|no answer|did not answer)\b.*\n", run.stderr)
    recorded = read(recording)
    assert len(recorded.signals["loop.t_s"]) > 50
    assert any(event.level == "ERROR" for event in recorded.events)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("plant.start.mas_kg=3", "plant.start.mas_kg: flawed.fmu has no such"),
        ("plant.start.mass_kg=heavy", "plant.start.mass_kg"),
        ("plant.map.pose.x_m=pose.x", 'plant.map."pose.x_m"'),
        ("plant.fmu=./missing.fmu", "missing.fmu"),
    ],
)
def test_a_wrong_name_in_the_fmu_is_bad_input(flawed: Path, change: str, sentence: str) -> None:
    done = hil("run", "circle_speed", *sets(flawed), "--set", change, "--record", "none")
    assert done.returncode == 2
    assert sentence in done.stderr
    assert "Traceback" not in done.stderr


def test_odometry_begins_at_the_true_pose_that_only_the_fmu_knows(tmp_path: Path, flawed: Path) -> None:
    """Of its start the scenario says one coordinate alone; the others are the FMU's own."""
    short = {"loop.duration_s": 0.5, "expect": [], "estimator.source": "odometry", "plant.fmu": flawed}
    result = bridge.run("circle_speed", set=short | {"plant.start.start_y_m": 0.25})
    assert result.failure is None
    assert result.signals["pose.y_m"][0] == result.signals["truth.y_m"][0] == 0.25
    assert result.signals["pose.x_m"][0] == 0.0


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")
def test_odometry_of_a_robot_in_another_process_begins_there_too(flawed: Path) -> None:
    short = ("--set", "loop.duration_s=0.5", "--set", "expect=[]", "--set", "estimator.source=odometry")
    common = ("circle_speed", "--set", f"plant.fmu={flawed}", "--set", "plant.start.start_y_m=0.25")
    for truth_is_given in (True, False):
        with device(*common, "--link", "serial:pty") as robot:
            truth = ("--truth", robot.truth) if truth_is_given else ()
            recording = flawed.with_name(f"{truth_is_given}.mcap")
            run_json(*common, *short, "--link", robot.link, *truth, "--record", recording)
            assert read(recording).signals["pose.y_m"][0] == (0.25 if truth_is_given else 0.0)


@pytest.mark.skipif(sys.platform == "win32", reason="process groups need a POSIX system")
@pytest.mark.parametrize("mode", ["lockstep", REAL_TIME])
def test_ctrl_c_stops_the_robot_while_its_plant_goes_on(flawed: Path, tmp_path: Path, mode: str) -> None:
    """The signal goes to the whole group, as from a terminal, in the middle of the run."""
    recording = tmp_path / "run.mcap"
    options = ("--mode", mode, "--record", str(recording), *sets(flawed, "loop.duration_s=3600"))
    run = subprocess.Popen(
        [*HIL, "run", "circle_speed", *options],
        env=environment(),
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(lambda: rows(recording) > 200)
    os.killpg(run.pid, signal.SIGINT)
    _, errors = run.communicate(timeout=60)
    assert run.returncode == 130
    assert errors == f"hil: interrupted; the robot was told to stop; recorded until then: {recording}\n"
    assert rows(recording) > 200
