"""hil campaign: no run twice or lost, whatever is killed; the same run gives the same row; a failure is a row."""

import contextlib
import json
import math
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pandas
import psutil
import pytest
from typer.testing import CliRunner

import hil as bridge
from hil.addons.batch.campaign.campaign import Campaign
from hil.addons.batch.campaign.judged import Judged, duel_words
from hil.addons.batch.columns import run_columns
from hil.addons.batch.pool import MODULE
from hil.addons.batch.store import ABOUT, RECORDINGS, ROWS
from hil.cli.main import app
from hil.core.errors import BadInputError, LinkError
from hil.record.reader import read
from hil.robot.virtual import KeptRobot
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.support.campaigns import do, in_process, of_the_runs, rows_of, rows_written, write_plan
from tests.support.flawed_fmu import build_flawed
from tests.support.processes import HIL, environment, wait_for

MASSES = "[axes]\nrobot.mass_kg = { grid = [16, 20, 24] }\n"
FRICTION = '"plant.start.friction_coefficient" = { uniform = [0, 0.1] }'
LAWS = """
import os
import pathlib
import time

from hil.core.types import WheelCommand, Wheels

REST = Wheels(0.0, 0.0, 0.0, 0.0)
IS_ILL = pathlib.Path(__file__).with_name("ill")


class Light:
    def __init__(self, model, mode):
        self.mass_kg, self.mode = model.mass_kg, mode

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        if self.mass_kg == 21.0 and IS_ILL.exists():
            os._exit(7)
        if self.mass_kg == 22.0:
            raise ZeroDivisionError("too heavy")
        while self.mass_kg == 23.0 and IS_ILL.exists():
            time.sleep(0.1)
        return WheelCommand(self.mode, REST, Wheels(float("nan") if self.mass_kg == 24.0 else 0.0, 0.0, 0.0, 0.0))
"""


def start(*arguments: str | Path) -> "subprocess.Popen[str]":
    """Start the command, which takes Ctrl-C as in a terminal of its own."""
    return subprocess.Popen(
        [*HIL, "campaign", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
        start_new_session=True,
    )


HELD_UP_IN_C = """
import pathlib
import re


class Stuck:
    def __init__(self, model, mode):
        pass

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        pathlib.Path(__file__).with_name("begun").touch()
        re.match("(a+)+$", "a" * 64 + "b")  # for ages, and no other thread runs meanwhile
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no signal at the end of a pipe")
def test_with_a_killed_campaign_its_workers_end_whatever_they_do_and_no_folder_of_it_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary, out = tmp_path / "temporary", tmp_path / "out"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    (tmp_path / "laws.py").write_text(HELD_UP_IN_C)
    plan = write_plan(tmp_path, 'laws = ["./laws.py:Stuck"]\nkeep = "all"')
    campaign = start(plan, "--out", out, "--jobs", "1")
    wait_for((tmp_path / "begun").exists)
    family = psutil.Process(campaign.pid).children(recursive=True)
    assert any(MODULE in process.cmdline() for process in family)
    campaign.kill()
    campaign.communicate()
    assert psutil.wait_procs(family, timeout=30)[1] == []
    assert list(temporary.iterdir()) == []
    assert list((out / RECORDINGS).iterdir())
    (tmp_path / "laws.py").unlink()
    plan = write_plan(tmp_path, 'laws = ["dsc"]')
    assert [row["outcome"] for row in do(plan, out)] == ["passed"]


def test_a_campaign_that_was_stopped_or_killed_goes_on_with_no_run_twice_or_lost(
    tmp_path: Path,
) -> None:
    more = 'laws = ["afdsc", "dsc"]\nseeds = 2\nsamples = {}\nkeep = "none"'
    plan, out = write_plan(tmp_path, more.format(10), MASSES + FRICTION), tmp_path / "out"
    stopped = start(plan, "--out", out, "--jobs", "1")
    wait_for(lambda: rows_written(out) >= 1)
    stopped.send_signal(signal.SIGINT)
    _, told = stopped.communicate(timeout=60)
    assert stopped.returncode == 130, told
    done = rows_written(out)
    assert (
        told == f"hil: interrupted; {done} of 120 runs are done and saved in {out}; run the same command to continue\n"
    )
    files = rows_written(out)
    killed = start(plan, "--out", out, "--jobs", "1")
    wait_for(lambda: rows_written(out) > files)
    killed.kill()
    killed.communicate()
    dry = json.loads(in_process("campaign", plan, "--out", out, "--dry-run", "--json"))
    assert (dry["runs"], dry["left"]) == (120, 120 - rows_written(out))
    assert done < rows_written(out) < 120
    assert dry["total_s"] == pytest.approx(dry["run_s"] * math.ceil(dry["left"] / dry["workers"]))
    write_plan(tmp_path, more.format(1), MASSES + FRICTION)  # the first twelve of the same runs
    before = rows_of(plan, out)
    rows = do(plan, out)
    assert [row["outcome"] for row in rows] == ["passed"] * 12
    assert [row for row in rows if row in before] == before  # they were not run again
    assert len({row["wire_sha256"] for row in rows}) == 12
    assert len(set(pandas.read_json(out / ROWS, lines=True)["key"])) == rows_written(out), "no run was done twice"
    write_plan(tmp_path, more.format(10), MASSES + FRICTION)
    assert Campaign(plan).left(out) <= dry["left"]  # the others are not forgotten
    write_plan(tmp_path, more.format(1), MASSES + FRICTION)
    assert (rows[4]["robot.mass_kg"], rows[4]["law"]) == (24.0, "afdsc")
    for row, run in list(zip(rows, Campaign(plan).runs, strict=True))[::3]:
        of_one = run_columns(bridge.run("circle_speed", set=run.point.sets).run)
        assert of_the_runs([row | of_one]) == of_the_runs([row])


@pytest.fixture(scope="module")
def flawed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU that misbehaves."""
    return build_flawed(tmp_path_factory.mktemp("flawed"))


def test_a_run_that_fails_is_a_row_with_its_reason_which_can_be_done_again(
    tmp_path: Path, flawed: Path, monkeypatch
) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    (tmp_path / "ill").touch()
    monkeypatch.setenv("FLAW", "start 25")
    fmus = ["mecanum"] * 3 + [str(flawed)] * 2 + ["mecanum"] * 2
    axes = f"[axes]\nrobot.mass_kg = {{ list = [20, 22, 24, 25, 19, 23, 21] }}\nplant.fmu = {{ list = {fmus} }}"
    plan = write_plan(tmp_path, 'laws = ["./laws.py:Light"]\nkeep = "none"', axes)
    rows = do(plan, tmp_path / "out", 4.0)
    assert [row["outcome"] for row in rows] == ["passed", "ended", "failed", "ended", "passed", "lost", "lost"]
    reasons = [row["reason"] for row in rows]
    assert "ZeroDivisionError: too heavy" in reasons[1]
    assert "commands of the law that were not finite" in reasons[2]
    assert "SIGSEGV (Segmentation fault); its last words: 'the last words of a crash'" in reasons[3]
    assert reasons[5] == "hung: it was ended after 4.0 s"
    assert reasons[6] == "crashed: exit code 7"
    (tmp_path / "ill").unlink()
    again = do(plan, tmp_path / "out", redo=["lost"])
    assert [row["outcome"] for row in again] == ["passed", "ended", "failed", "ended", "passed", "passed", "passed"]
    assert again[:5] == rows[:5]


def test_a_foreign_fmu_is_opened_anew_for_each_run_for_its_reset_may_leave_something(flawed: Path, monkeypatch) -> None:
    monkeypatch.setenv("FLAW", "forgetful 0")
    scenario = load(
        "circle_speed", set={"plant.fmu": flawed, "loop.duration_s": 0.2, "loop.rate_hz": 200, "expect": []}
    )
    with contextlib.closing(KeptRobot()) as kept:
        first, second = (
            run_scenario(scenario, RunOptions(make_robot=kept.robot, keep_signals=False)) for _ in range(2)
        )
    assert first.metrics["wire_sha256"] == second.metrics["wire_sha256"]


def test_failures_are_recorded_and_a_report_tells_how_to_repeat_them(tmp_path: Path) -> None:
    more = 'keep = "failures"\nseeds = [5]\nlaws = ["afdsc", { law = "dsc", gains = { k1_1_s = 9.0 } }]'
    faults = '[[fault]]\nname = "none"\n[[fault]]\nname = "lossy"\n'
    faults += 'rows = [{ kind = "drop", target = "command", value = 0.3 }]\n'
    tables = faults + MASSES + '[[expect]]\nsignal = "error.planar_m"\nfrom_s = 0.15\nbelow = 0.48253'
    plan, out = write_plan(tmp_path, more, tables), tmp_path / "out"
    rows = do(plan, out)
    (failed,) = (row for row in rows if row["outcome"] != "passed")
    assert failed["reason"].startswith("error.planar_m below 0.48253 from 0.15 s to the end: failed")
    (recording,) = (out / RECORDINGS).iterdir()
    assert recording.stem == failed["key"]
    assert read(recording).summary["wire_sha256"] == failed["wire_sha256"]
    assert do(plan, out) == rows
    done = CliRunner().invoke(app, ["campaign", str(plan), "--out", str(out), "--json"])  # all are done
    outcomes = {"passed": 11, "failed": 1}
    assert json.loads(done.stdout) == {"passed": False, "folder": str(out), "runs": 12, "outcomes": outcomes}
    told = CliRunner().invoke(app, ["campaign", str(plan), "--out", str(out)])
    assert (done.exit_code, told.exit_code) == (1, 1)
    assert told.stdout.splitlines() == ["12 runs: 11 passed, 1 failed", f"hil campaign report {out}"]
    report = json.loads(in_process("campaign", "report", out, "--json", "--pictures", "pdf"))
    names = [Path(file).name for file in report["pictures"]]
    assert names == ["distributions.pdf", "effects.pdf"]
    axes = {"robot.mass_kg": {"kind": "grid", "values": [16, 20, 24]}}
    assert report["campaign"] == {
        "name": "plan",
        "scenario": "circle_speed",
        "laws": ["afdsc", "dsc,k1_1_s=9.0"],
        "faults": ["none", "lossy"],
        "seeds": 1,
        "samples": 1,
        "axes": axes,
        "keep": "failures",
        "runs": 12,
    }
    assert all(Path(file).read_bytes().startswith(b"%PDF") for file in report["pictures"])
    first = report["worst"][0]
    assert (first["key"], first["recording"]) == (failed["key"], f"{RECORDINGS}/{recording.name}")
    words = shlex.split(first["repeat"])
    assert words[:2] == ["hil", "run"]
    again = CliRunner().invoke(app, [*words[1:], "--lenient", "--record", "none", "--json"])
    assert json.loads(again.stdout)["wire_sha256"] == failed["wire_sha256"]
    page = Path(report["html"]).read_text(encoding="utf-8")
    assert "11 of 12 runs passed" in page
    assert "dsc,k1_1_s=9.0" in page
    assert "://" not in page.replace("http://www.w3.org/", "")  # it needs nothing else


def test_another_campaigns_folder_or_a_damaged_one_is_a_sentence_and_stays_as_it_is(tmp_path: Path) -> None:
    plan, out = write_plan(tmp_path, 'seeds = 2\nkeep = "none"'), tmp_path / "out"
    do(plan, out)

    def refused(*arguments: str | Path) -> str:
        done = CliRunner().invoke(app, ["campaign", *map(str, arguments)])
        assert isinstance(done.exception, BadInputError), done.output
        return str(done.exception)

    other = write_plan(tmp_path, "seeds = 2", name="other.toml")
    assert "its name is 'plan', and that of this campaign is 'other'" in refused(other, "--out", out, "--dry-run")
    assert "it holds no results" in refused("report", tmp_path)
    assert "it is a file; name a folder" in refused(plan, "--out", plan)
    assert "'lots' is not an outcome; did you mean 'lost'?" in refused(plan, "--out", out, "--redo", "lots")
    rows = out / ROWS
    whole = rows.read_bytes()
    spoilt = whole.replace(b'"law": "dsc"', b'"law": "dsd"', 1)  # still JSON, but its check value tells
    assert spoilt != whole
    for data in (b"{}\n" + whole, whole[40:], spoilt):
        rows.write_bytes(data)
        for arguments in ((plan, "--out", out), (plan, "--out", out, "--dry-run")):
            assert f"file {rows}: line 1 is damaged; remove it" in refused(*arguments)
        [sentence] = Judged(out).damaged
        assert sentence.endswith("it is left out")
        assert sentence in Judged(out).sentences()
        assert rows.read_bytes() == data
    assert next(Judged(out).sentences()) == "1 runs: 1 passed (1 of 2 are not done yet, or are damaged)"
    rows.write_bytes(whole)
    for make, why in (
        ((out / ABOUT).unlink, "No such file or directory"),
        (lambda: (out / ABOUT).write_bytes(b"{}"), "it has other content"),
    ):
        make()
        assert refused("report", out) == (
            f"file {out / ABOUT}: it cannot be read ({why}); remove it if it is there, and give hil campaign with its "
            "plan once more, which writes it anew"
        )
    (out / ABOUT).unlink()
    assert len(do(plan, out)) == 2  # which writes it anew


def test_a_worker_that_would_do_another_run_ends_the_campaign_and_leaves_no_row(tmp_path: Path) -> None:
    law = tmp_path / "laws.py"
    law.write_text(LAWS, encoding="utf-8")
    campaign = Campaign(write_plan(tmp_path, 'laws = ["./laws.py:Light"]'))
    law.write_text(f"{LAWS}\n# another", encoding="utf-8")
    with pytest.raises(LinkError, match="a law or a reference file of a run was changed since it was planned"):
        for _ in campaign.perform(tmp_path / "out", 1):
            pass
    assert rows_written(tmp_path / "out") == 0


ON_A_SMALL_DISK = """
import sys
from pathlib import Path

from hil.robot.virtual import KeptRobot
from hil.core.errors import BadInputError
from tests.support.campaigns import do

plan, disk = map(Path, sys.argv[1:])
ballast = disk / "ballast"
ballast.write_bytes(bytes(580 * 1024))
try:
    do(plan, disk / "out")
except BadInputError as error:
    print(error)
ballast.unlink()
print(*(row["outcome"] for row in do(plan, disk / "out")))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a disk in a namespace, as Linux can")
def test_a_full_disk_ends_a_campaign_in_order_and_it_goes_on_where_there_is_room(tmp_path: Path) -> None:
    plan = write_plan(tmp_path, 'seeds = 24\nkeep = "none"')
    disk = tmp_path / "disk"
    disk.mkdir()
    own = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
    mounted = 'mount -t tmpfs -o size=600k tmpfs "$1" || exit 77; shift; exec "$@"'
    words = [*own, "sh", "-c", mounted, "sh", disk, sys.executable, "-c", ON_A_SMALL_DISK, plan, disk]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment(), timeout=120)
    if done.returncode == 77 or done.stderr.startswith("unshare"):
        pytest.skip(f"no disk may be mounted here: {done.stderr}")
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert "it cannot be written to (No space left on device); what was written is safe: make room" in first
    assert second == " ".join(["passed"] * 24)


def test_a_report_has_no_figures_of_runs_that_ended_early_and_the_plans_names(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    laws = 'seeds = 2\nlaws = [{{ law = "dsc", name = "{}" }}, "./laws.py:Light"]'
    do(write_plan(tmp_path, laws.format("one")), tmp_path / "out")
    axis = "[axes]\nrobot.mass_kg = { grid = [20, 22] }"  # 20 is as it was, so these runs are there; 22 ends the law
    rows = do(write_plan(tmp_path, laws.format("other"), axis), tmp_path / "out")
    kept = {recording.stem for recording in (tmp_path / "out" / RECORDINGS).iterdir()}
    assert [row["outcome"] for row in rows if row["key"] in kept] == ["ended", "ended"]
    judged = Judged(tmp_path / "out")
    assert [rate[:5] for rate in judged.rates] == [
        ("all", "", 8, 6, 2),
        ("robot.mass_kg", "20", 4, 4, 2),
        ("robot.mass_kg", "22", 4, 2, 2),
        ("law", "other", 4, 4, 2),
        ("law", "Light", 4, 2, 2),
    ]
    (effort,) = (duel for duel in judged.duels if duel.figure == "effort_n_m_s")
    assert (effort.first, effort.second, effort.pairs, effort.left_out, effort.units) == ("other", "Light", 2, 2, 2)
    assert effort.difference.low is None
    assert "from 2 draws: too few for an interval" in "".join(duel_words(effort))
