"""The fault catalogue: every kind has a case, a sound robot passes, an unsafe one, a hung and a crashed run do not."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.built import FLAGS, HERE, SOURCES
from hil.addons.batch.catalogue.fault_cases import CASES, DURATION_S, Ending
from hil.addons.batch.catalogue.trial_run import RecordingHere
from hil.addons.batch.catalogue.trials import Request, alone, in_pairs, run_trials, scenarios
from hil.addons.batch.pool import run_jobs
from hil.cli.output import RunsProgress
from hil.core.errors import BadInputError
from hil.core.options import build
from hil.faults.kinds import KINDS, find
from hil.record.reader import read
from hil.record.recording import Recording
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import Scenario, load
from hil.scenario.trial import FaultTable
from tests.support import once
from tests.support.processes import hil
from tests.support.trials import done_here
from tools.build.compiler import compile_shared, compiler

# Changes in the firmware's sources, and the faults that show them.
UNSAFE = {
    "the watchdog never fires": (
        "supervise.c",
        "node->setting.age_ticks >= wheel_ticks(node->parameters.watchdog_s)",
        "node->setting.age_ticks == UINT32_MAX",
        ("disconnect",),
    ),
    "an old sequence is taken": (
        "receive.c",
        "if (distance == 0u || distance > WHEEL_SEQUENCE_WINDOW) {",
        "if (distance > 255u) {",
        ("freeze",),
    ),
    "the CRC is not compared": (
        "framing.c",
        "if (wheel_crc16(body, length - CRC) != load16(body + length - CRC)) {",
        "if (length == 0u) {",
        ("bit_errors",),
    ),
    "the ramp does not fall": (
        "node.c",
        "node->ramp_from_rad_s[i] * left",
        "node->ramp_from_rad_s[i]",
        ("duplicate",),
    ),
    "it drives on after a stop": (
        "states.c",
        "{WP_STATE_STOPPING, WHEEL_EVENT_STOPPED, WP_STATE_IDLE},",
        "{WP_STATE_STOPPING, WHEEL_EVENT_STOPPED, WP_STATE_ACTIVE},",
        ("disconnect",),
    ),
    "the speed loop does not hear its set point": (
        "control.c",
        "const float error = target_rad_s[i] - speed_rad_s[i];",
        "const float error = 12.0f - speed_rad_s[i];",
        ("duplicate",),
    ),
    "a stop drives on with a set point of zero": (
        "node.c",
        "wheel_speed_loop_update(&node->speed_loop, node->set_point_rad_s,",
        "wheel_speed_loop_update(&node->speed_loop, node->setting.target,",
        ("disconnect",),
    ),
    "the torque outlives the stop": (
        "node.c",
        "ramp_set_point(node);\n        limited = drive_by_speed(node, none, drive);",
        "ramp_set_point(node);\n        memcpy(drive->torque_n_m, node->setting.target, sizeof node->torque_n_m);",
        ("disconnect",),
    ),
    "drives that are off keep their torque": (
        "node.c",
        "memset(&node->current_loop, 0, sizeof node->current_loop);\n        return;",
        "memcpy(drive->torque_n_m, node->torque_n_m, sizeof node->torque_n_m);\n        return;",
        ("disconnect",),
    ),
    "the set point is no number": ("node.c", "float left = 0.0f;", 'float left = __builtin_nanf("");', ("duplicate",)),
}  # fmt: skip
UNSAFE_FLAGS = ("-w", "-O0", f"-I{HERE / 'firmware'}")
ONCE = ("--link", "memory", "--jobs", "1")
LAWS = """
import os


class Hangs:
    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        while True:
            pass


class Crashes(Hangs):
    def update(self, reference, state, applied, dt_s):
        os._exit(7)
"""


def catalogue(*arguments: str, cwd: Path, code: int) -> list[dict[str, Any]]:
    """Run ``hil catalogue --json`` and return its runs."""
    done = hil("catalogue", *arguments, "--json", cwd=cwd)
    assert done.returncode == code, done.stderr + done.stdout
    answer = json.loads(done.stdout)
    assert answer["passed"] == (code == 0)
    return answer["runs"]


def test_every_kind_has_a_case_and_a_place_in_the_pairs() -> None:
    def kinds(cases) -> set[tuple[str, str]]:
        rows = [case.rows[-1] for case in cases]
        return {(row["kind"], find(row["kind"], row["target"]).acts_on) for row in rows}

    assert kinds(CASES) == {(kind.name, kind.acts_on) for kind in KINDS}
    assert kinds(case for case in CASES if case.in_pairs) == kinds(CASES)
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_case_is_over_before_its_run_is(case) -> None:
    for row in case.rows:
        table = build(FaultTable, row)
        assert table.start_s < DURATION_S / 2
        assert case.kind in ("reset", "estop") or table.end_s < DURATION_S / 2 + 1e-9


def test_a_sound_robot_passes_over_every_link(tmp_path) -> None:
    """`make catalogue` runs every kind; here one that is re-armed from."""
    runs = catalogue("--kind", "disconnect", cwd=tmp_path, code=0)
    assert {run["link"].partition(":")[0] for run in runs} == {"memory", "serial", "can"}
    for run in runs:
        assert run["verdict"] == "ok"
        assert min(run["applied"]) > 0
        assert run["silent_rad_s"] == 0.0
        assert run["silent_ticks"] > 0
        assert (run["outcome"] == Ending.REARMS) == (run["recoveries"] > 0)
    assert {run["outcome"] for run in runs if not run["rearm"]} == {Ending.ENDS}
    assert not list((tmp_path / "runs").iterdir()), "recordings of good runs are not kept"


@pytest.mark.alone
def test_a_pair_in_torque_mode_and_a_run_in_real_time_are_judged_too(tmp_path) -> None:
    changes = ("--set", "controller.command=torque", "--set", "controller.gains.k1_1_s=4.0")
    few = ("--pairs", "--sample", "4", "--seed", "1", "--jobs", "1")
    runs = catalogue("--kind", "push", *few, "--link", "memory", *changes, cwd=tmp_path, code=0)
    assert len(runs) == 1 + 4
    runs = catalogue("--kind", "disconnect", "--link", "serial", "--realtime", cwd=tmp_path, code=0)
    assert [run["mode"] for run in runs] == ["lockstep", "lockstep", "realtime"]


def test_a_sample_of_the_pairs_is_chosen_by_its_seed_and_all_seeds_together_take_all(tmp_path) -> None:
    def names(sample: int | None, seed: int = 0) -> list[str]:
        return [trial.fault for trial in in_pairs(Request("circle_speed", [], [], [], tmp_path, sample, seed))]

    everything = names(None)
    assert names(60, 3) == names(60, 3) != names(60, 4)
    assert [name for name in everything if name in names(60, 3)] == names(60, 3), "in order, each once"
    assert len(names(60)) == 60
    assert set().union(*(names(60, seed) for seed in range(60))) == set(everything)
    assert names(10_000) == everything
    assert names(0) == []


def _compiled(folder: Path) -> dict[str, Path]:
    """Return the object file of each source of the firmware, by the source's name."""
    made = {source.name: folder / f"{source.stem}.o" for source in SOURCES}
    for source in SOURCES:
        words = [*compiler(), *FLAGS, *UNSAFE_FLAGS, "-fPIC", "-c", str(source), "-o", str(made[source.name])]
        subprocess.run(words, check=True)
    return made


@pytest.mark.parametrize("flaw", UNSAFE)
def test_an_unsafe_firmware_is_caught(flaw, tmp_path, monkeypatch) -> None:
    name, before, after, kinds = UNSAFE[flaw]
    text = (HERE / "firmware" / name).read_text(encoding="utf-8")
    assert text.count(before) == 1
    changed = tmp_path / name
    changed.write_text(text.replace(before, after).replace('"../generated/', f'"{HERE}/generated/'), encoding="utf-8")
    sound = [made for source, made in once.made("objects of the firmware", _compiled).items() if source != name]
    library = tmp_path / "libunsafe.so"
    compile_shared([changed, *sound], library, flags=UNSAFE_FLAGS)
    request = Request("circle_speed", [], ["memory"], kinds, tmp_path)
    trial = alone(request)[0]
    [scenario] = scenarios(request, [trial])
    assert isinstance(scenario, Scenario)
    monkeypatch.setenv("WHEEL_HOST_LIBRARY", str(library))
    [outcome] = run_jobs([trial.job(scenario)], 1)
    assert str(outcome.reason).startswith("unsafe"), outcome


def test_a_run_that_hangs_is_ended_and_one_that_crashes_is_told(tmp_path) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    hung, *_ = catalogue("--law", "laws.py:Hangs", "--kind", "push", "--limit", "1", *ONCE, cwd=tmp_path, code=1)
    assert hung["verdict"].startswith("hung")
    assert hung["outcome"] is None
    crashed, *_ = catalogue("--law", "laws.py:Crashes", "--kind", "push", *ONCE, cwd=tmp_path, code=1)
    assert crashed["verdict"].startswith("crashed: exit code 7")


@pytest.mark.parametrize(
    "words",
    [["/no/such/program"], [sys.executable, "-c", "print('{}')"], [sys.executable, "-c", "print('no JSON')"]],
    ids=["cannot be started", "answers with too little", "answers with anything"],
)
def test_a_worker_that_is_none_is_a_verdict_on_each_job_and_a_line_of_progress(
    words, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr("hil.addons.batch.pool.module_command", lambda *_: words)
    request = Request("circle_speed", [], ["memory"], ["push", "mute"], tmp_path)
    trials = alone(request)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    verdicts = run_trials(request, trials, 2, 60.0, RunsProgress())
    shown = capsys.readouterr().err.replace("\r", "\n").split("\n")
    counts = [line for line in shown if f" of {len(trials)} runs" in line]
    assert [line.partition(" of ")[0] for line in counts] == [str(done) for done in range(1, len(trials) + 1)]
    said = [verdict.words for verdict in verdicts]
    assert said[0] == f"{trials[0].fault} over memory:: {verdicts[0].verdict}"
    assert sorted({line.strip() for line in set(shown) - set(counts)} - {""}) == sorted(set(said))
    assert [verdict.trial for verdict in verdicts] == trials
    assert all(verdict.verdict.startswith("crashed: ") for verdict in verdicts)


def test_a_run_that_ends_otherwise_or_whose_fault_did_nothing_is_not_as_it_should_be(tmp_path) -> None:
    request = Request("circle_speed", [], ["memory"], ["stuck_encoder"], tmp_path)
    (trial,) = alone(request)
    assert done_here(request, trial).is_ok
    trial = trial._replace(recording=str(tmp_path / "other.rrd"))
    other = done_here(request, trial._replace(causes=["OVERSPEED"], causes_of_end=["OVERSPEED"]))
    assert "the robot was lost, but not for OVERSPEED" in other.verdict
    idle = {"kind": "mute", "target": "ESTOP", "start_s": 0.2}
    trial = trial._replace(recording=str(tmp_path / "idle.rrd"))
    assert "was never applied" in done_here(request, trial._replace(rows=[idle, *trial.rows])).verdict


def test_a_recording_that_lacks_a_row_or_an_event_is_not_as_it_should_be(tmp_path, monkeypatch) -> None:
    request = Request("circle_speed", [], ["memory"], ["stuck_encoder"], tmp_path)
    (trial,) = alone(request)
    assert trial.records_here
    put, missed = RecordingHere.put, iter([True])
    monkeypatch.setattr(RecordingHere, "put", lambda self, row: None if next(missed, False) else put(self, row))
    assert re.match(r"the recording has (\d+) rows of (?!\1)\d+, 0 dropped", done_here(request, trial).verdict)
    monkeypatch.setattr(RecordingHere, "put", put)
    monkeypatch.setattr(RecordingHere, "event", lambda *_: None)
    deaf = done_here(request, trial._replace(recording=str(tmp_path / "deaf.rrd")))
    assert "the recording has no event of stuck_encoder" in deaf.verdict
    assert "the recording has no event of what ended the run" in deaf.verdict
    assert Path(str(deaf.done.recording)).exists()


def test_a_recording_made_in_the_process_of_the_run_is_that_of_a_recorder(tmp_path) -> None:
    ways = {"here.rrd": RecordingHere, "there.rrd": Recording}
    short = load("circle_speed", set={"loop.duration_s": 0.2, "expect": []})
    for name, make in ways.items():
        run_scenario(short, RunOptions(record=tmp_path / name, make_recording=make))
    here, there = (read(tmp_path / name) for name in ways)
    assert here.events == there.events
    assert list(here.signals) == list(there.signals)
    of_clock = ("loop.lateness_us", "loop.tick_us")
    for name in set(there.signals) - set(of_clock):
        assert here.signals[name].tobytes() == there.signals[name].tobytes(), name


def test_a_trial_that_the_scenario_cannot_have_is_refused_and_the_others_are_done(tmp_path) -> None:
    request = Request("circle_speed", [], ["memory"], ["stuck_encoder"], tmp_path)
    (trial,) = alone(request)
    unknown = trial._replace(fault="no such", rows=[{"kind": "no_such", "target": "command"}])
    good, refused = run_trials(request, [trial, unknown], 1, 60.0)
    assert good.is_ok
    assert refused.verdict.startswith("refused: ")
    assert "no_such" in refused.verdict
    with pytest.raises(BadInputError, match="no_such"):
        run_trials(request, [unknown, trial], 1, 60.0)


def test_a_wrong_outcome_is_a_row_of_the_table_and_its_recording_is_kept(tmp_path) -> None:
    # With a watchdog of 20 ms the same loss of frames stops the robot.
    shown = ("--html", "page.html", "--pictures", "svg")
    done = hil("catalogue", "--kind", "burst_loss", *ONCE, "--set", "firmware.watchdog_s=0.02", *shown, cwd=tmp_path)
    assert done.returncode == 1, done.stdout
    _, head, *rows = done.stdout.splitlines()
    assert " ".join(head.split()) == "fault link re-arm outcome applied recoveries after silence wall s verdict"
    assert rows[0].startswith("burst_loss command")
    assert "expected goes on, but it re-arms" in rows[0]
    (folder,) = (tmp_path / "runs").iterdir()
    recording = folder / "burst_loss-command-memory-lockstep-rearm.rrd"
    assert recording.exists()
    assert str(recording.relative_to(tmp_path)) in done.stdout
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "expected goes on, but it re-arms" in page
    assert "<svg" in page
    assert ">re-arms</text>" in (tmp_path / "outcomes.svg").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--kind", "mut"), "did you mean 'mute'?"),
        (("--kind", "mute", "--set", "device.driver=moteus"), "this fault cannot act on 'moteus' as it is set up"),
        (("--link", "usb"), "known: can, memory, serial"),
        (("no_such_scenario",), "no_such_scenario"),
    ],
)
def test_bad_input_is_one_sentence(arguments, words, tmp_path) -> None:
    done = hil("catalogue", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
