"""hil campaign: no run twice or lost, whatever is killed; the same run gives the same row; a failure is a row."""

import contextlib
import gc
import json
import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import dask
import distributed
import pandas
import psutil
import pytest
from typer.testing import CliRunner

import hil as bridge
from hil.batch import dask_pool
from hil.batch.campaign.campaign import Campaign, Place
from hil.batch.campaign.judged import duel_words, judge
from hil.batch.figures import run_columns
from hil.batch.keys import make_job
from hil.batch.plan import FixedPlan, run_plan
from hil.batch.pool import MODULE
from hil.batch.store import RECORDINGS, ROWS, read_rows
from hil.cli.main import app
from hil.core.errors import BadInputError, LinkError
from hil.core.subprocesses import MEMORY_IS_KNOWN
from hil.review import read
from hil.robot.virtual import KeptRobot
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.campaigns import LIMIT_S, do, of_the_runs, rows_of, write_plan
from tests.flawed_fmu import build_flawed
from tests.processes import HIL, device, environment, wait_for

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


def in_process(*arguments: str | Path) -> str:
    """Do a command here, which saves its imports, and return what it prints."""
    done = CliRunner().invoke(app, list(map(str, arguments)))
    assert done.exit_code == 0, done.output
    return done.stdout


def rows_written(folder: Path) -> int:
    rows = folder / ROWS
    return len(list(rows.glob("*.parquet"))) if rows.is_dir() else 0


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
    assert list(out.glob("*.unfinished"))
    (tmp_path / "laws.py").unlink()
    plan = write_plan(tmp_path, 'laws = ["dsc"]')
    assert [row["outcome"] for row in do(plan, out)] == ["passed"]
    assert not list(out.glob("*.unfinished"))


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
    done = read_rows(out).num_rows
    assert (
        told == f"hil: interrupted; {done} of 120 runs are done and saved in {out}; run the same command to continue\n"
    )
    files = rows_written(out)
    killed = start(plan, "--out", out, "--jobs", "1")
    wait_for(lambda: rows_written(out) > files)
    killed.kill()
    killed.communicate()
    dry = json.loads(in_process("campaign", plan, "--out", out, "--dry-run", "--json"))
    assert (dry["runs"], dry["left"]) == (120, 120 - read_rows(out).num_rows)
    assert done < read_rows(out).num_rows < 120
    assert dry["total_s"] == pytest.approx(dry["run_s"] * math.ceil(dry["left"] / dry["workers"]))
    write_plan(tmp_path, more.format(1), MASSES + FRICTION)  # the first twelve of the same runs
    before = rows_of(plan, out)
    rows = do(plan, out)
    assert [row["outcome"] for row in rows] == ["passed"] * 12
    assert [row for row in rows if row in before] == before  # they were not run again
    assert len({row["wire_sha256"] for row in rows}) == 12
    assert sorted(pandas.read_parquet(out / ROWS)["key"]) == sorted(row["key"] for row in rows)
    write_plan(tmp_path, more.format(10), MASSES + FRICTION)
    assert Campaign(plan).left(out) <= dry["left"]  # the others were set aside, and are not forgotten
    write_plan(tmp_path, more.format(1), MASSES + FRICTION)
    assert (rows[4]["robot.mass_kg"], rows[4]["law"]) == (24.0, "afdsc")
    for row, run in list(zip(rows, Campaign(plan).runs, strict=True))[::3]:
        of_one = run_columns(bridge.run("circle_speed", set=run.point.sets).metrics)
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
    rows = do(plan, tmp_path / "out", Place(None, 1, 4.0))
    assert [row["outcome"] for row in rows] == ["passed", "ended", "failed", "ended", "passed", "lost", "lost"]
    reasons = [row["reason"] for row in rows]
    assert "ZeroDivisionError: too heavy" in reasons[1]
    assert "commands of the law that were not finite" in reasons[2]
    assert "SIGSEGV (Segmentation fault); its last words: 'the last words of a crash'" in reasons[3]
    assert reasons[5] == "hung: it was ended after 4.0 s"
    assert reasons[6] == "its process ended twice, at last: crashed: exit code 7"
    (tmp_path / "ill").unlink()
    again = do(plan, tmp_path / "out", redo=["lost"])
    assert [row["outcome"] for row in again] == ["passed", "ended", "failed", "ended", "passed", "passed", "passed"]
    assert again[:5] == rows[:5]


@pytest.mark.skipif(not MEMORY_IS_KNOWN, reason="this system does not tell how much memory a process takes")
def test_a_run_that_takes_more_memory_than_it_may_is_lost_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    (tmp_path / "ill").touch()
    plan = write_plan(tmp_path, 'laws = ["./laws.py:Light"]\nkeep = "none"', "robot.mass_kg = 23")
    (row,) = do(plan, tmp_path / "out", Place(None, 1, LIMIT_S, memory_mb=10.0))
    assert row["outcome"] == "lost"
    assert row["reason"].endswith("MB of memory, more than the limit of 10 MB")


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


def test_failures_and_the_worst_are_recorded_and_a_report_tells_how_to_repeat_them(tmp_path: Path) -> None:
    more = '{}\nseeds = [5]\nlaws = ["afdsc", {{ law = "dsc", gains = {{ k1_1_s = 9.0 }} }}]'
    faults = '[[fault]]\nname = "none"\n[[fault]]\nname = "lossy"\n'
    faults += 'rows = [{ kind = "drop", target = "command", value = 0.3 }]\n'
    tables = faults + MASSES + '[[expect]]\nsignal = "error.planar_m"\nfrom_s = 0.15\nbelow = 0.48253'
    plan, out = write_plan(tmp_path, more.format('keep = "failures"'), tables), tmp_path / "out"
    rows = do(plan, out)
    (failed,) = (row for row in rows if row["outcome"] != "passed")
    assert failed["reason"].startswith("error.planar_m below 0.48253 from 0.15 s to the end: failed")
    (recording,) = (out / RECORDINGS).iterdir()
    assert recording.stem == failed["key"]
    assert read(recording).summary["wire_sha256"] == failed["wire_sha256"]
    write_plan(tmp_path, more.format('keep = { worst = 1, by = "effort_n_m_s" }'), tables)
    assert do(plan, out) == rows
    report = json.loads(in_process("campaign", "report", out, "--json", "--pictures", "pdf"))
    names = [Path(file).name for file in report["pictures"]]
    assert names == ["report-differences.pdf", "report-distributions.pdf", "report-effects.pdf"]
    assert all(Path(file).read_bytes().startswith(b"%PDF") for file in report["pictures"])
    worst = report["worst"]
    assert worst[0]["key"] == failed["key"]
    passed = sorted((row["effort_n_m_s"] for row in rows if row is not failed), reverse=True)
    assert [one["effort_n_m_s"] for one in worst[1:]] == passed
    most = max(rows, key=lambda row: row["effort_n_m_s"])
    (recording,) = (out / RECORDINGS).iterdir()
    assert recording.stem == most["key"]
    (kept,) = (one for one in worst if one["recording"] is not None)
    assert (kept["key"], kept["recording"]) == (most["key"], f"{RECORDINGS}/{recording.name}")
    words = shlex.split(kept["repeat"])
    assert words[:2] == ["hil", "run"]
    again = json.loads(in_process(*words[1:], "--record", "none", "--json"))
    assert (again["wire_sha256"], again["effort_n_m_s"]) == (most["wire_sha256"], most["effort_n_m_s"])
    page = Path(report["html"]).read_text(encoding="utf-8")
    assert "11 of 12 runs passed" in page
    assert "dsc,k1_1_s=9.0" in page
    assert "://" not in page.replace("http://www.w3.org/", "")  # it needs nothing else


def test_what_is_wrong_with_a_plan_is_a_sentence_with_its_line_before_anything_runs(tmp_path: Path) -> None:
    axes = "[axes]\n{}"
    for more, tables, sentence in (
        ("", axes.format("robot.mas_kg = { grid = [1] }"), "plan.toml:9: unknown key robot.mas_kg; did you mean"),
        ("", axes.format('"robot.mass_kg" = { grid = [20, -3] }'), "plan.toml:9: robot.mass_kg = -3"),
        ("", axes.format('"robot.mass_kg" = { gird = [20] }'), "did you mean 'axes.robot.mass_kg.grid'?"),
        ("", axes.format('"robot.mass_kg" = { uniform = [20, 3] }\n'), "expected [low, high] with low < high"),
        ("", axes.format('"robot.mass_kg" = { uniform = [3, 20] }\n'), "say with samples = N how often to draw"),
        ("", axes.format('"robot.mass_kg" = { grid = [3, 3] }\n'), "plan.toml:9: axes.robot.mass_kg: grid: a value is"),
        ("", axes.format("a.b = { list = [1, 2] }\nc.d = { list = [1] }"), "but a.b has 2, c.d has 1"),
        ("", axes.format('"loop.seed" = { grid = [1, 2] }'), "axes loop.seed: give seeds instead"),
        ("seeds = 0", "", "plan.toml:3: seeds = 0; expected how many, from 1 to"),
        ("sceds = 3", "", "plan.toml:3: unknown key sceds; did you mean 'seeds'?"),
        ('keep = "some"', "", 'plan.toml:3: keep = "some"; expected "none", "failures", "all" or'),
        ('keep = { worst = 3, by = "rms" }', "", "plan.toml:3: keep.by: unknown figure 'rms'"),
        ('laws = ["afdcs"]', "", "controller.law = 'afdcs': unknown; did you mean 'afdsc'?"),
        (
            'laws = ["dsc", { law = "dsc", name = "other" }]',
            "",
            "two runs are the same: dsc, seed 1; and other, seed 1",
        ),
        ("", '[[fault]]\nname = "x"\nrows = [{ kind = "dorp" }]', "did you mean 'drop'?"),
        ("", axes.format("robt.mass_kg = { grid = [1] }"), "plan.toml:9: unknown key robt; did you mean 'robot'?"),
        ("", axes.format('"plant.start.mas_kg" = { grid = [1] }'), "has no such variable; did you mean 'mass_kg'?"),
        ("", axes.format('"plant.start.mass_kg" = { grid = ["a"] }'), "plant.start.mass_kg = 'a'; expected a finite"),
        ('laws = [{ law = "dsc", gains = { k1 = 9.0 } }]', "", "unknown key controller.gains.k1"),
        (
            'laws = ["./a/law.py:Law", "./b/law.py:Law"]',
            "",
            "plan.toml:3: two laws are both called 'Law', and a report",
        ),
        ("seeds = 2", "loop.seed = 7", "loop.seed is in [set], and there are seeds"),
        (
            'laws = [{ law = "dsc", gains = { k1_1_s = 9.0 } }]',
            axes.format("controller.gains.k1_1_s = { grid = [1, 2] }"),
            "controller.gains.k1_1_s is in laws and in [axes]",
        ),
        ('laws = "dsc"', "", 'plan.toml:3: laws = "dsc"; expected an array'),
    ):
        plan = write_plan(tmp_path, more, tables)
        with pytest.raises(BadInputError) as refused:
            Campaign(plan)
        assert sentence in str(refused.value)
    with pytest.raises(BadInputError, match=r"no\.toml: there is no such file; give the path of a \.toml file"):
        Campaign(tmp_path / "no.toml")


def test_what_is_behind_a_link_is_asked_what_it_cannot_do_before_anything_runs(tmp_path: Path) -> None:
    url, odometry = 'link.url = "can:socketcan/can0"\n', 'estimator.source = "odometry"\n'
    makers = f'{url}{odometry}device.driver = "c620"\n'
    for tables, sentence in (
        (url, 'estimator.source = "truth", and of a robot behind a link no truth is known'),
        (makers, "the protocol of 'c620' has no STEP"),
        (f'{makers}loop.mode = "realtime"', "real motors would move; add --allow-motion"),
    ):
        plan = write_plan(tmp_path, 'keep = "none"', tables)
        done = CliRunner().invoke(app, ["campaign", str(plan), "--dry-run", "--jobs", "1"])
        assert isinstance(done.exception, BadInputError)
        assert sentence in str(done.exception)
    assert Campaign(plan, allow_motion=True).on_bench
    bench = write_plan(tmp_path, 'keep = "none"', f"{url}{odometry}", name="bench.toml")
    for more in ([], ["--scheduler", "tcp://127.0.0.1:1"]):  # one run at a time needs no --jobs 1
        dry = json.loads(in_process("campaign", bench, "--dry-run", "--json", "--out", tmp_path / "out", *more))
        assert dry["workers"] == 1
    fixes = 'loop.mode = "realtime"\nestimator.source = "fused"\nestimator.fix = "udp://127.0.0.1:5000"'
    plan = write_plan(tmp_path, 'keep = "none"', fixes)
    done = CliRunner().invoke(app, ["campaign", str(plan), "--dry-run", "--jobs", "2"])
    assert "there is one bench behind the link or the pose fixes" in str(done.exception)


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
    assert "and no campaign; name an empty or a new one" in refused(plan, "--out", tmp_path)
    assert "it is a file; name a folder" in refused(plan, "--out", plan)
    assert "'lots' is not an outcome; did you mean 'lost'?" in refused(plan, "--out", out, "--redo", "lots")
    part = next((out / ROWS).iterdir())
    whole = part.read_bytes()
    spoilt = bytearray(whole)
    spoilt[40] ^= 1  # in a page, of which the checksum tells
    for data in (b"", whole[:500], bytes(spoilt)):
        part.write_bytes(data)
        for arguments in ((plan, "--out", out), (plan, "--out", out, "--dry-run")):
            assert f"file {part}: it is damaged" in refused(*arguments)
        [sentence] = judge(out).damaged
        assert sentence.startswith(f"file {part}: it is damaged")
        assert sentence.endswith("left out")
        assert sentence in judge(out).sentences()
        assert part.read_bytes() == data
    part.write_bytes(whole)
    for name in ("plan.parquet", "campaign.json"):
        (out / name).write_bytes(b"{}")
        assert f"file {out / name}: it " in refused("report", out)
        (out / name).unlink()
        assert f"file {out / name}: " in refused("report", out)
        assert len(do(plan, out)) == 2  # which writes it anew


def test_a_cluster_that_others_could_listen_to_is_refused(tmp_path: Path, monkeypatch) -> None:
    plan = write_plan(tmp_path)
    for address, sentence in (
        ("tcp://192.0.2.1:8786", "over tcp anybody on the way could run programs on the workers; use tls://192.0.2.1:"),
        ("127.0.0.1:8786", "expected tls://HOST:PORT, or tcp://127.0.0.1:PORT on this machine"),
    ):
        done = CliRunner().invoke(app, ["campaign", str(plan), "--scheduler", address])
        assert isinstance(done.exception, BadInputError)
        assert sentence in str(done.exception)
    with pytest.raises(BadInputError, match="TLS needs certificates; name them in"):
        do(plan, tmp_path / "out", Place("tls://127.0.0.1:1", 0, LIMIT_S))
    monkeypatch.setattr(dask_pool, "CONNECT_S", 0.2)
    starts = distributed.utils.asyncio_run
    # The collector may run at any time: here in the worst one.
    monkeypatch.setattr(
        distributed.utils, "asyncio_run", lambda *given, **by_name: [gc.collect(), starts(*given, **by_name)]
    )
    with pytest.raises(LinkError, match=r"--scheduler tcp://127\.0\.0\.1:1: no scheduler of Dask answers there"):
        do(plan, tmp_path / "out", Place("tcp://127.0.0.1:1", 0, LIMIT_S))


def test_a_worker_that_would_do_another_run_ends_the_campaign_and_leaves_no_row(tmp_path: Path) -> None:
    law = tmp_path / "laws.py"
    law.write_text(LAWS, encoding="utf-8")
    campaign = Campaign(write_plan(tmp_path, 'laws = ["./laws.py:Light"]'))
    law.write_text(f"{LAWS}\n# another", encoding="utf-8")
    with pytest.raises(LinkError, match="its version of this package, or its FMU, law or reference file, is not that"):
        for _ in campaign.perform(tmp_path / "out", Place(None, 1, LIMIT_S)):
            pass
    assert read_rows(tmp_path / "out").num_rows == 0


ON_A_SMALL_DISK = """
import sys
from pathlib import Path

from hil.robot.virtual import KeptRobot
from hil.core.errors import BadInputError
from tests.campaigns import do

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
    plan = write_plan(tmp_path, 'seeds = 8\nkeep = "none"')
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
    assert second == " ".join(["passed"] * 8)


class Cluster:
    """Dask's own commands as processes on loopback; with TLS, where OpenSSL can make a certificate."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._tls = folder / "tls.pem" if shutil.which("openssl") else None
        if self._tls is not None:
            make = "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=mecanum-hil -keyout tls.pem -out cert.pem"
            subprocess.run(["openssl", *make.split()], check=True, capture_output=True, cwd=folder)
            self._tls.write_text(self._tls.read_text() + (folder / "cert.pem").read_text())
        self.processes: list[subprocess.Popen[bytes]] = []
        self.address = ""

    def scheduler(self) -> "subprocess.Popen[bytes]":
        """Start the scheduler, another one where the first was, and wait until it can be asked."""
        file = self._folder / f"scheduler-{len(self.processes)}.json"
        port = self.address.rpartition(":")[2] or "0"
        process = self._start("scheduler", "--port", port, "--scheduler-file", str(file))
        wait_for(lambda: file.exists() and file.read_text(encoding="utf-8").endswith("}"))
        self.address = json.loads(file.read_text(encoding="utf-8"))["address"]
        return process

    def worker(self, *more: str) -> "subprocess.Popen[bytes]":
        """Start a worker."""
        return self._start("worker", self.address, "--nthreads", "1", "--no-nanny", *more)

    def _start(self, name: str, *arguments: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "dask", name, "--host", "127.0.0.1", "--no-dashboard", *arguments]
        command += [word for key in self._keys for word in (f"--tls-{key}", str(self._tls))]
        command += ["--protocol", "tls"] if self._keys else []
        self.processes.append(
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment())
        )
        return self.processes[-1]

    @property
    def _keys(self) -> tuple[str, ...]:
        return () if self._tls is None else ("ca-file", "cert", "key")

    def of_client(self) -> dict[str, str]:
        """Return what DASK_DISTRIBUTED__COMM__TLS__... say to a client."""
        names = {"ca-file": "ca-file", "cert": "client.cert", "key": "client.key"}
        return {f"distributed.comm.tls.{names[key]}": str(self._tls) for key in self._keys}

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler and two workers, of which one has the bench; the last test of this module kills some of them."""
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    cluster.scheduler()
    cluster.worker("--name", "without")
    cluster.worker("--name", "with", "--resources", "bench=1")
    with dask.config.set(cluster.of_client()):
        yield cluster
    cluster.close()


def test_runs_behind_a_link_are_done_one_at_a_time_where_the_bench_is(tmp_path: Path, cluster: Cluster) -> None:
    with device("circle_speed", "--mode", "lockstep", "--link", "serial:pty", "--set", "loop.rate_hz=200") as robot:
        link = f'link.url = "{robot.link}"\nestimator.source = "odometry"'
        plan = write_plan(tmp_path, 'laws = ["afdsc", "dsc"]\nkeep = "none"', link)
        rows = do(plan, tmp_path / "out", Place(cluster.address, 0, LIMIT_S))
        assert [row["outcome"] for row in rows] == ["passed", "passed"], rows
        assert {row["machine.worker"].split()[1] for row in rows} == {"with"}
        refused = CliRunner().invoke(app, ["campaign", str(plan), "--jobs", "2"])
        assert "--jobs 2: there is one bench behind the link" in str(refused.exception)


def test_two_campaigns_share_a_cluster_and_leave_no_process_there(tmp_path: Path, cluster: Cluster) -> None:
    plan, other = (write_plan(tmp_path, f'seeds = {n}\nkeep = "none"', name=f"{n}.toml") for n in (12, 3))
    place = Place(cluster.address, 0, LIMIT_S)
    batches = Campaign(plan).perform(tmp_path / "out", place)
    while not next(batches):
        pass
    assert [row["outcome"] for row in do(other, tmp_path / "other", place)] == ["passed"] * 3  # while the first goes on
    for _ in batches:
        pass
    assert [row["outcome"] for row in rows_of(plan, tmp_path / "out")] == ["passed"] * 12
    workers = [psutil.Process(process.pid) for process in cluster.processes[1:]]
    wait_for(lambda: not [one for worker in workers for one in worker.children() if MODULE in one.cmdline()])


def test_a_dask_worker_without_room_for_temporary_files_ends_the_campaign_in_a_sentence(
    tmp_path: Path, monkeypatch
) -> None:
    here = distributed.LocalCluster(
        n_workers=1, processes=False, protocol="tcp", host="127.0.0.1", dashboard_address=None, silence_logs=50
    )
    with here, contextlib.closing(dask_pool.DaskPool(here.scheduler_address)) as pool:
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))  # Dask itself has begun in another
        job = make_job(load("circle_speed", set={"loop.duration_s": 0.1}))
        with pytest.raises(LinkError, match=r"a worker of Dask cannot do runs: .*No such file"):
            list(run_plan(FixedPlan([job]), pool))


def test_a_campaign_on_this_machine_listens_on_nothing_and_needs_no_dask(tmp_path: Path) -> None:
    plan = write_plan(tmp_path, 'keep = "none"')
    without = "import sys; sys.modules['dask'] = sys.modules['distributed'] = None; sys.argv[0] = 'hil'; "
    words = [sys.executable, "-c", f"{without}from hil.cli.main import main; main()", "campaign", plan]
    more = ["--out", tmp_path / "out"]
    alone = subprocess.Popen([*words, *more], stdout=subprocess.PIPE, text=True, env=environment())
    heard: set[str] = set()
    process = psutil.Process(alone.pid)

    def is_done() -> bool:
        with contextlib.suppress(psutil.Error):
            for one in (process, *process.children(recursive=True)):
                heard.update(at.laddr.ip for at in one.net_connections("inet") if at.status == "LISTEN")
        return alone.poll() is not None

    wait_for(is_done)
    assert alone.communicate()[0].startswith("1 runs: 1 passed")
    assert not heard
    asked = [*words, "--scheduler", "tcp://127.0.0.1:1"]
    refused = subprocess.run(asked, capture_output=True, text=True, check=False, env=environment())
    assert refused.returncode == 2
    assert "--scheduler needs distributed, which is not installed; run: " in refused.stderr


def test_a_report_has_no_figures_of_runs_that_ended_early_and_the_plans_names(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    laws = 'keep = {}\nseeds = 2\nlaws = [{{ law = "dsc", name = "{}" }}, "./laws.py:Light"]'
    do(write_plan(tmp_path, laws.format('"none"', "one")), tmp_path / "out")
    axis = "[axes]\nrobot.mass_kg = { grid = [20, 22] }"  # 20 is as it was, so these runs are there; 22 ends the law
    worst = '{ worst = 1, by = "effort_n_m_s" }'
    rows = do(write_plan(tmp_path, laws.format(worst, "other"), axis), tmp_path / "out")
    (kept,) = (tmp_path / "out" / RECORDINGS).iterdir()
    assert [row["outcome"] for row in rows if row["key"] == kept.stem] == ["ended"]
    judged = judge(tmp_path / "out")
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


def test_a_killed_worker_and_a_scheduler_that_comes_back_lose_no_run(
    tmp_path: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    (gate := tmp_path / "ill").touch()  # the runs with 23 kg wait for it to go, so no machine is too fast for the kills
    held_back = "[axes]\nrobot.mass_kg = { grid = [20, 23] }"
    plan = write_plan(tmp_path, 'seeds = 15\nlaws = ["./laws.py:Light"]\nkeep = "none"', held_back)
    scheduler, first = cluster.processes[:2]
    troubles: set[str] = set()
    done, kills = 0, [first.kill, scheduler.kill, gate.unlink]

    def on_trouble(trouble: str | None) -> None:
        if done and kills:
            kills.pop(0)()
        if trouble is not None and trouble not in troubles:
            troubles.add(trouble)
            if "cannot be reached" in trouble:
                scheduler.wait()
                cluster.scheduler()
                cluster.worker()

    for rows in Campaign(plan).perform(tmp_path / "out", Place(cluster.address, 0, LIMIT_S), on_trouble):
        done += len(rows)
    assert not kills
    assert any("cannot be reached; waiting for it" in trouble for trouble in troubles)
    rows = rows_of(plan, tmp_path / "out")
    assert [row["outcome"] for row in rows] == ["passed"] * 30
    monkeypatch.chdir(tmp_path)
    of_one = run_columns(bridge.run("circle_speed", set=Campaign(plan).runs[29].point.sets).metrics)
    assert of_the_runs([rows[29] | of_one]) == of_the_runs(rows[29:])
