"""``hil verify`` measures a suite, goes on after an interruption, and what it suggests for a survivor notices it."""

import json
import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from hil.addons.batch.job import ENDED, FAILED, PASSED, REFUSED, Outcome
from hil.addons.batch.pool import run_jobs
from hil.addons.batch.store import ROWS, read_rows
from hil.addons.verify import results
from hil.addons.verify import verify as engine
from hil.addons.verify.catalogue import Entry, read_catalogue
from hil.addons.verify.mutation.mutant import Mutant
from hil.addons.verify.run import run, run_tests
from hil.addons.verify.suite import read_suite
from hil.core.errors import BadInputError
from hil.core.subprocesses import module_command
from hil.scenario.baseline import SUFFIX, this_platform
from hil.scenario.load import SHIPPED_DIRECTORY
from tests.support.processes import environment, hil, wait_for

ENTRIES = {entry.id: entry for entry in read_catalogue().mutants}


SCENARIO = """
extends = "circle_speed"

[loop]
duration_s = 1.5

[[expect]]
signal = "{signal}"
{claim}
"""
HEAVY, ELSEWHERE, GYRO, OTHER_GAIN = (
    Entry("plant", "it is heavier", "20 %", Mutant("plant.heavy", start={"mass_kg": "*1.2"})),
    Entry("plant", "it stands elsewhere", "0.3 m", Mutant("plant.elsewhere", start={"start_y_m": "+0.3"})),
    Entry("plant", "the gyro has a bias", "0.05 rad/s", Mutant("plant.gyro", start={"gyro_bias_z_rad_s": 0.05})),
    Entry(
        "plant",
        "a gain of another law is halved",
        "factor 2",
        Mutant("plant.other_gain", wrap={"port": "law", "of": "gains", "ki_1_s2": "*0.5"}),
    ),
)
HEAVIER = {"a little heavier": {"mass_kg": "*1.01"}}


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    """A folder with two scenarios."""
    folder = tmp_path / "suite"
    folder.mkdir()
    near = SCENARIO.format(signal="error.planar_m", claim="below = 0.52")
    quick = SCENARIO.format(signal="robot.state", claim="above = 2.0")
    (folder / "near.toml").write_text(near, encoding="utf-8")
    (folder / "quick.toml").write_text(quick, encoding="utf-8")
    return folder


def request(suite: Path, **given: Any) -> engine.Request:
    fields: Mapping[str, Any] = {"folder": suite.parent / "out", "healthy": 4, "workers": 2} | given
    return engine.Request(read_suite([str(suite)]), [HEAVY, ELSEWHERE, GYRO, OTHER_GAIN], HEAVIER, **fields)


def test_a_suite_is_measured_and_what_is_suggested_notices(suite: Path) -> None:
    told: list[tuple[int, int, str | None, int]] = []
    found = engine.verify(request(suite), lambda *now: told.append(now))
    assert told[-1] == (4, 4, "plant.other_gain: nothing noticed that a gain of another law is halved", 3)
    verdicts = {one.entry.id.removeprefix("plant."): one for one in found.verdicts}
    assert {name: one.verdict for name, one in verdicts.items()} == {
        "heavy": "survived",
        "elsewhere": "noticed",
        "gyro": "survived",
        "other_gain": "unreached",
    }
    assert verdicts["elsewhere"].by == str(suite / "near.toml")
    assert not found.passed
    assert not found.alarms
    assert found.healthy == 2 + 4
    for least, passed in ((0.25, True), (0.26, False)):
        assert found._replace(least=least).passed is passed, "one of four was noticed"
    table = results.as_json(found)
    jsonschema.validate(table, json.loads((Path(results.__file__).parent / "verify.schema.json").read_text()))
    assert table["noticed_part"] == 0.25
    shown = "\n".join(line.strip() for line in results.lines(found))
    for name in ("heavy", "gyro"):
        suggestion = verdicts[name].suggestion
        assert suggestion is not None
        assert suggestion.toml in shown
        file = Path(suggestion.member)
        file.write_text(file.read_text(encoding="utf-8") + "\n" + suggestion.toml, encoding="utf-8")
    again = engine.verify(request(suite, folder=suite.parent / "again"))
    assert {one.entry.id: one.verdict for one in again.verdicts if one.verdict == "survived"} == {}
    assert not again.alarms, "what was suggested holds in healthy runs too"


def test_a_verification_that_was_killed_goes_on(suite: Path) -> None:
    out = suite.parent / "out"
    ids = [f"--mutant={name}" for name in ("plant.mass_more", "plant.gyro_degrees", "estimator.fix_offset")]
    words = ["verify", str(suite), *ids, "--out", str(out), "--jobs=1"]
    killed = subprocess.Popen(
        module_command("hil.cli.main", *words, "--json"), env={**os.environ, **environment()}, stdout=subprocess.PIPE
    )
    wait_for(lambda: (out / ROWS).exists() and (out / ROWS).stat().st_size > 0, 60.0)
    killed.kill()
    killed.communicate()
    before = {key: row["details"] for key, row in read_rows(out).items()}
    assert before
    done = hil(*words, "--json")
    assert done.returncode == 1, done.stderr
    rows = read_rows(out)
    assert {key: row["details"] for key, row in rows.items()}.items() >= before.items()
    assert len((out / ROWS).read_bytes().splitlines()) == len(rows), "nothing was done twice"
    assert json.loads(done.stdout)["counts"]["unreached"] == 1


def test_a_file_of_tests_notices_a_mutant(tmp_path: Path) -> None:
    tests = tmp_path / "test_mine.py"
    tests.write_text(
        "def test_that_holds(hil_run):\n"
        '    hil_run("circle_speed", set={"loop.duration_s": 0.1, "expect": []}, record=False)\n\n'
        "def test_effort(hil_run):\n"
        '    result = hil_run("circle_speed", set={"loop.duration_s": 1.0, "expect": []}, record=False)\n'
        '    assert result.metrics["effort_n_m_s"] < 5.0\n',
        encoding="utf-8",
    )
    (tmp_path / "near.hil.toml").write_text(SCENARIO.format(signal="error.planar_m", claim="below = 0.52"))
    members = read_suite([str(tests)])
    mutants = [ENTRIES["plant.mass_more"], ENTRIES["estimator.fix_offset"]]
    found = engine.verify(engine.Request(members, mutants, {}, 0, tmp_path / "out", workers=2))
    heavy, other = found.verdicts
    assert (heavy.verdict, heavy.by) == ("noticed", str(tests))
    assert str(heavy.reason).startswith("test_effort: ")
    assert other.verdict == "unreached", "the bytes of its run are the same"


@pytest.mark.parametrize(
    ("code", "report", "said", "outcome"),
    [
        *((number, "", "bad\n", (REFUSED, f"pytest ended with {number}: bad")) for number in (2, 3)),
        (1, "", "gone\n", (FAILED, "pytest ended with 1: gone")),
        (5, "", "no tests ran in 0.01s\n", (REFUSED, "pytest ended with 5: no tests ran in 0.01s")),
        (4, "", "", (REFUSED, "pytest ended with 4: no word")),
        (-9, "", "", (FAILED, "pytest ended with -9: no word")),
        (1, '<testcase name="test_one"/>', "1 passed\n", (FAILED, "pytest ended with 1: 1 passed")),
        (1, '<testcase name="a"><skipped/></testcase><testcase name="b"><properties/><failure/></testcase>',
         "", (FAILED, "b: failure")),
        (1, '<testcase name="test_one"><error message="no&#10;way"/></testcase>', "", (FAILED, "test_one: no")),
    ],
)  # fmt: skip
def test_why_a_file_of_tests_did_not_pass_is_what_pytest_says(
    code: int, report: str, said: str, outcome: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ended(command: list[str], **_: object) -> "subprocess.CompletedProcess[str]":
        if report:
            (option,) = (word for word in command if word.startswith("--junitxml="))
            Path(option.partition("=")[2]).write_text(f"<testsuites>{report}</testsuites>", encoding="utf-8")
        return subprocess.CompletedProcess(command, code, said, "")

    (tests := tmp_path / "test_mine.py").touch()
    (member,) = read_suite([str(tests)])
    monkeypatch.setattr(subprocess, "run", ended)
    assert run_tests(member.job(), member.scenario)[1:3] == outcome


def test_the_wire_of_the_lockstep_runs_of_tests_is_what_a_mutant_may_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[list[str]] = []

    def ended(command: list[str], **_: object) -> "subprocess.CompletedProcess[str]":
        asked.append(command)
        (option,) = (word for word in command if word.startswith("--junitxml="))
        rows = {"a.wire_sha256": "1f", "a.mode": "lockstep", "b.wire_sha256": "2f", "b.mode": "realtime", "a.x": "3"}
        told = "".join(f'<property name="{name}" value="{value}"/>' for name, value in rows.items())
        report = f'<testsuites><testcase name="one"><properties>{told}</properties></testcase></testsuites>'
        Path(option.partition("=")[2]).write_text(report, encoding="utf-8")
        return subprocess.CompletedProcess(command, 0, "", "")

    (tests := tmp_path / "test_mine.py").touch()
    (member,) = read_suite([str(tests)])
    monkeypatch.setattr(subprocess, "run", ended)
    job = member.job(HEAVY.mutant)
    assert run_tests(job, member.scenario) == Outcome(job.key, PASSED, None, {"one a.wire_sha256": "1f"})
    assert asked[0][-3:] == ["hil.addons.verify.plugin", "--hil-mutant", HEAVY.mutant.to_text()]
    run_tests(member.job(), member.scenario)
    assert asked[1][-1] == str(tests)


@pytest.mark.parametrize(
    ("claim", "status", "reason"), [("above = 2.0", PASSED, None), ("below = 2.0", FAILED, "robot.")]
)
def test_a_run_tells_figures_wire_and_extremes(claim: str, status: str, reason: str | None, tmp_path: Path) -> None:
    scenario = tmp_path / "quick.toml"
    scenario.write_text(SCENARIO.format(signal="robot.state", claim=claim).replace("1.5", "0.2"), encoding="utf-8")
    (member,) = read_suite([str(scenario)])
    job = member.job()
    found = run(job, member.scenario)
    assert (found.key, found.status) == (job.key, status)
    assert reason is None if found.reason is None else str(reason) in found.reason
    assert {"wire_sha256", "applied", "effort_n_m_s"} <= set(found.figures)
    assert set(found.details) == {"extremes"}
    assert found.details["extremes"]["robot.state"][1] == 3.0
    heavier = run(member.job(HEAVY.mutant), member.scenario)
    assert heavier.figures["wire_sha256"] != found.figures["wire_sha256"]


def test_a_law_that_is_wrong_ends_the_run(tmp_path: Path) -> None:
    (tmp_path / "law.py").write_text(
        "class Broken:\n"
        "    def reset(self, state, reference):\n        pass\n"
        "    def update(self, reference, state, applied, dt_s):\n        return 1.0 / 0.0\n"
    )
    scenario = 'extends = "circle_speed"\nexpect = []\n[controller]\nlaw = "./law.py:Broken"\n'
    (tmp_path / "broken.toml").write_text(scenario, encoding="utf-8")
    (member,) = read_suite([str(tmp_path / "broken.toml")])
    assert run(member.job(), member.scenario).status == ENDED


def test_a_baseline_notices_other_bytes(tmp_path: Path) -> None:
    mutants = [ENTRIES["plant.gyro_noise"], ENTRIES["plant.mass_more"]]
    (judged,) = read_suite(["circle_speed"])
    (bare,) = read_suite(["circle_speed"], baselines=False)
    assert judged.scenario.baseline is not None
    assert bare.scenario.baseline is None
    assert judged.varied(7, {}).scenario.baseline is judged.scenario.baseline
    assert judged.varied(7, {"mass_kg": "*1.01"}).scenario.baseline is None
    assert judged.job().key != bare.job().key
    with_it = engine.verify(engine.Request([judged], mutants, {}, 0, tmp_path / "with", workers=1))
    is_here = judged.scenario.baseline.platform == this_platform()
    assert [one.verdict for one in with_it.verdicts] == ["noticed" if is_here else "survived", "noticed"]
    without = engine.verify(engine.Request([bare], mutants[:1], {}, 0, tmp_path / "without", workers=1))
    assert [one.verdict for one in without.verdicts] == ["survived"]


def test_a_baseline_that_a_shell_names_with_its_scenario_is_left_out_and_refused_alone(tmp_path: Path) -> None:
    (tmp_path / "near.toml").write_text('extends = "circle_speed"\n', encoding="utf-8")
    (tmp_path / "far.hil.toml").write_text('extends = "circle_speed"\n', encoding="utf-8")
    for stem in ("near", "far"):
        shutil.copy(SHIPPED_DIRECTORY / f"circle_speed{SUFFIX}", tmp_path / f"{stem}{SUFFIX}")
    named = sorted(map(str, tmp_path.glob("*.toml")))
    assert len(named) == 4
    members = read_suite(named)
    assert [member.name for member in members] == [str(tmp_path / "far"), str(tmp_path / "near.toml")]
    assert all(member.scenario.baseline is not None for member in members)
    checked = hil("check", *named)
    assert checked.returncode == 0, checked.stderr
    told = [line for line in checked.stdout.splitlines() if not line.startswith(" ")]
    assert told == [name for name in named if not name.endswith(SUFFIX)]
    for alone in ([str(tmp_path / f"near{SUFFIX}")], [str(tmp_path / f"near{SUFFIX}"), str(tmp_path / "far.hil.toml")]):
        with pytest.raises(BadInputError, match="this is the baseline of a scenario; name the scenario that stands"):
            read_suite(alone)


def test_healthy_runs_that_fail_are_false_alarms(suite: Path) -> None:
    (quick,) = read_suite([str(suite / "quick.toml")])
    varied = quick.varied(7, {"mass_kg": "*1.5", "no_such_value": 1.0}).scenario
    assert (varied.plant.start["mass_kg"], varied.loop.seed) == (30.0, 7)
    (usual,) = run_jobs([quick.job()], 1)
    most = usual.details["extremes"]["error.planar_m"][1]
    narrow = SCENARIO.format(signal="error.planar_m", claim=f"below = {1.01 * most}")
    (suite / "quick.toml").write_text(narrow, encoding="utf-8")
    variations = {"set down elsewhere": {"start_x_m": "-0.2"}}
    members = read_suite([str(suite / "quick.toml")])
    found = engine.verify(engine.Request(members, [], variations, 2, suite.parent / "out", workers=1))
    assert [alarm[:2] for alarm in found.alarms] == [(quick.name, "seed 1000001, set down elsewhere")]
    assert found.healthy == 1 + 2
    assert not found.passed


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--room=motor"], "--room motor: expected one of"),
        (
            ["--mutant=plant.mas_more"],
            "--mutant plant.mas_more: the catalogue has no such mutant; did you mean 'plant.mass_more'",
        ),
        (["empty"], "suite empty: it has neither scenarios (*.toml) nor tests (test_*.py)"),
        (
            ["real.toml"],
            "suite real.toml: its robot is behind serial:/dev/ttyACM0; mutants are put into a virtual robot, so give a "
            "scenario with link.url = memory:",
        ),
        ([], "no suite is named; give scenarios, pytest files, or folders of them"),
        (["no_such_scenario"], "no_such_scenario"),
    ],
)
def test_bad_input_is_refused_before_anything_starts(tmp_path: Path, words: list[str], said: str) -> None:
    (tmp_path / "empty").mkdir()
    real = 'extends = "circle_speed"\nlink.url = "serial:/dev/ttyACM0"\nestimator.source = "odometry"\n'
    (tmp_path / "real.toml").write_text(real, encoding="utf-8")
    done = hil("verify", *words, "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_suite_that_is_red_without_a_mutant_is_refused(suite: Path) -> None:
    red = SCENARIO.format(signal="truth.y_m", claim="below = -5.0")
    (suite / "near.toml").write_text(red, encoding="utf-8")
    with pytest.raises(BadInputError, match=r"near.toml: it does not pass without any mutant"):
        engine.verify(request(suite))
