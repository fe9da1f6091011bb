"""``hil verify`` measures a suite, goes on after an interruption, and what it suggests for a survivor notices it."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from hil.batch.plan import run_jobs
from hil.batch.store import read_rows
from hil.batch.verify import page as pages
from hil.batch.verify import verify as engine
from hil.batch.verify.catalogue import read_catalogue
from hil.batch.verify.suite import read_suite
from hil.core.errors import BadInputError
from hil.core.mutant import VARIABLE
from hil.core.subprocesses import module_command
from hil.scenario.baseline import SUFFIX, this_platform
from hil.scenario.load import SHIPPED_DIRECTORY
from tests.processes import environment, hil, wait_for

ENTRIES = {entry.id: entry for entry in read_catalogue().mutants}


SCENARIO = """
extends = "circle_speed"

[loop]
duration_s = 1.5

[[expect]]
signal = "{signal}"
{claim}
"""
MUTANTS = """
room = "plant"
variation = [{ id = "a little heavier", start = { mass_kg = "*1.01" } }]

[[mutant]]
id = "heavy"
wrong = "it is heavier"
size = "20 %"
start = { mass_kg = "*1.2" }

[[mutant]]
id = "elsewhere"
wrong = "it stands elsewhere"
size = "0.3 m"
start = { start_y_m = "+0.3" }

[[mutant]]
id = "gyro"
wrong = "the gyro has a bias"
size = "0.05 rad/s"
start = { gyro_bias_z_rad_s = 0.05 }

[[mutant]]
id = "pid_sign"
wrong = "another law has a wrong sign"
size = "sign"
patch = { file = "hil/laws/pid.py", before = "vx_d - kp * x - ki * ix", after = "vx_d - kp * x + ki * ix" }

[[mutant]]
id = "lqi"
wrong = "another law has its gains swapped"
size = "order"
equivalent = "no scenario has this law"
patch = { file = "hil/laws/lqi.py", before = "ki, kp, kd = self._feedback", after = "ki, kd, kp = self._feedback" }

[[mutant]]
id = "cap"
wrong = "the host scales torques"
size = "factor 2"
equivalent = "a claim that is wrong"
wrap = { port = "guard", of = "torque", scale = 0.5 }
"""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    """A folder with two scenarios, and a file of mutants beside it."""
    folder = tmp_path / "suite"
    folder.mkdir()
    near = SCENARIO.format(signal="error.planar_m", claim="below = 0.52")
    quick = SCENARIO.format(signal="robot.state", claim="above = 2.0")
    (folder / "near.toml").write_text(near, encoding="utf-8")
    (folder / "quick.toml").write_text(quick, encoding="utf-8")
    (tmp_path / "mutants.toml").write_text(MUTANTS, encoding="utf-8")
    return folder


def request(suite: Path, **given: Any) -> engine.Request:
    # With the shipped catalogue, of which two equivalents are a small part.
    catalogue = read_catalogue([suite.parent / "mutants.toml"])
    mine = [entry for entry in catalogue.mutants if entry.id not in ENTRIES]
    fields: Mapping[str, Any] = {"folder": suite.parent / "out", "healthy": 4, "workers": 2} | given
    return engine.Request(read_suite([str(suite)]), mine, catalogue.variations, **fields)


def test_a_suite_is_measured_and_what_is_suggested_notices(suite: Path) -> None:
    found = engine.verify(request(suite))
    verdicts = {one.entry.id.removeprefix("plant."): one for one in found.verdicts}
    assert {name: one.verdict for name, one in verdicts.items()} == {
        "heavy": "survived",
        "elsewhere": "noticed",
        "gyro": "survived",
        "pid_sign": "unreached",
        "lqi": "equivalent",
        "cap": "not equivalent",
    }
    assert verdicts["elsewhere"].by == str(suite / "near.toml")
    assert not found.passed
    assert not found.alarms
    assert found.healthy == 2 + 4
    only = [one for one in found.verdicts if one.verdict != "not equivalent"]
    for least, passed in ((0.25, True), (0.26, False)):
        assert found._replace(verdicts=only, least=least).passed is passed, "one of four was noticed"
    table = pages.as_json(found)
    jsonschema.validate(table, json.loads((Path(pages.__file__).parent / "verify.schema.json").read_text()))
    assert table["noticed_part"] == 0.2
    page = pages.page(found)
    for name in ("heavy", "gyro"):
        suggestion = verdicts[name].suggestion
        assert suggestion is not None
        assert suggestion.toml in page
        file = Path(suggestion.member)
        file.write_text(file.read_text(encoding="utf-8") + "\n" + suggestion.toml, encoding="utf-8")
    again = engine.verify(request(suite, folder=suite.parent / "again"))
    assert {one.entry.id: one.verdict for one in again.verdicts if one.verdict == "survived"} == {}
    assert not again.alarms, "what was suggested holds in healthy runs too"


def test_a_verification_that_was_killed_goes_on(suite: Path) -> None:
    out = suite.parent / "out"
    ids = [f"--mutant=plant.{name}" for name in ("heavy", "elsewhere", "gyro", "pid_sign")]
    words = ["verify", str(suite), "--mutants", str(suite.parent / "mutants.toml"), *ids, "--out", str(out), "--jobs=1"]
    killed = subprocess.Popen(
        module_command("hil.cli.main", *words, "--json"), env={**os.environ, **environment()}, stdout=subprocess.PIPE
    )
    wait_for(lambda: (out / "rows").is_dir() and any((out / "rows").glob("*.parquet")), 60.0)
    killed.kill()
    killed.communicate()
    before = {row["key"]: row["details"] for row in read_rows(out).to_pylist()}
    assert before
    done = hil(*words, "--json")
    assert done.returncode == 1, done.stderr
    rows = read_rows(out).to_pylist()
    assert {row["key"]: row["details"] for row in rows}.items() >= before.items()
    assert len(rows) == len({row["key"] for row in rows}), "nothing was done twice"
    counts = json.loads(done.stdout)["counts"]
    assert (counts["noticed"], counts["survived"], counts["unreached"]) == (1, 2, 1)
    assert (out / pages.PAGE).read_text(encoding="utf-8").startswith("# What a green run of this suite is worth")


def test_a_file_of_tests_notices_a_mutant_also_in_the_process_of_a_robot(tmp_path: Path) -> None:
    elsewhere = tmp_path / "test_robot.py"
    elsewhere.write_text(
        "def test_it_runs_on_a_robot_in_a_process_of_its_own(hil_run, virtual_robot):\n"
        '    robot = virtual_robot("circle_speed", mode="lockstep", set={"loop.duration_s": 0.5})\n'
        '    result = hil_run("circle_speed", on=robot, set={"loop.duration_s": 0.5, "expect": []}, record=False)\n'
        '    assert abs(result.signals["truth.y_m"][0]) < 0.1\n',
        encoding="utf-8",
    )
    moved = ENTRIES["plant.mass_more"].mutant._replace(id="plant.y", start={"start_y_m": 0.2}).to_text()
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", str(elsewhere)]
    usual = {**os.environ, **environment()}
    for settings, code in ((usual, 0), ({**usual, VARIABLE: moved}, 1)):
        done = subprocess.run(command, env=settings, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stdout
    assert "hil verify has put in the mutant plant.y" in done.stdout
    tests = tmp_path / "test_mine.py"
    tests.write_text(
        "def test_effort(hil_run):\n"
        '    result = hil_run("circle_speed", set={"loop.duration_s": 1.0, "expect": []}, record=False)\n'
        '    assert result.metrics["effort_n_m_s"] < 5.0\n',
        encoding="utf-8",
    )
    members = read_suite([str(tests)])
    mutants = [ENTRIES["plant.mass_more"], ENTRIES["law.pid_integral_sign"]]
    found = engine.verify(engine.Request(members, mutants, {}, 0, tmp_path / "out", workers=2))
    heavy, other = found.verdicts
    assert (heavy.verdict, heavy.by) == ("noticed", str(tests))
    assert str(heavy.reason).startswith("test_effort: ")
    assert other.verdict == "unreached", "the bytes of its run are the same"


def test_a_baseline_notices_and_its_bytes_are_told_apart(tmp_path: Path) -> None:
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
    assert [(one.verdict, one.by_bytes) for one in with_it.verdicts] == [
        ("noticed", True) if is_here else ("survived", False),
        ("noticed", False),
    ]
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
        (["--mutant=plant.mas_more"], "did you mean 'plant.mass_more'"),
        (["no_such_scenario"], "no_such_scenario"),
        (["--mutants=no_such_file.toml"], "it cannot be read"),
    ],
)
def test_bad_input_is_refused_before_anything_starts(tmp_path: Path, words: list[str], said: str) -> None:
    done = hil("verify", *words, "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_suite_that_is_red_without_a_mutant_is_refused(suite: Path) -> None:
    red = SCENARIO.format(signal="truth.y_m", claim="below = -5.0")
    (suite / "near.toml").write_text(red, encoding="utf-8")
    with pytest.raises(BadInputError, match=r"near.toml: it does not pass without any mutant"):
        engine.verify(request(suite))
