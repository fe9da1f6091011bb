"""hil campaign: no run twice or lost, whatever is killed; the same run gives the same row; a failure is a row."""

import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil as bridge
from hil.campaign import cluster as cluster_of_dask
from hil.campaign.campaign import Campaign
from hil.campaign.cluster import Place
from hil.campaign.dataset import RECORDINGS, ROWS, read_rows
from hil.cli import app
from hil.errors import BadInputError, LinkError
from hil.review import read
from tests.campaigns import LIMIT_S, do, of_the_runs, rows_of, write_plan
from tests.flawed_fmu import build_flawed
from tests.processes import HIL, device, environment, hil, wait_for

MASSES = '[axes]\nrobot.mass_kg = { grid = [16, 20, 24] }\n"plant.start.friction_coefficient" = { uniform = [0, 0.1] }'
LAWS = """
import os
import time

from hil.types import WheelCommand, Wheels

REST = Wheels(0.0, 0.0, 0.0, 0.0)


class Light:
    def __init__(self, model, mode):
        self.mass_kg, self.mode = model.mass_kg, mode

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        if self.mass_kg == 21.0:
            os._exit(7)
        if self.mass_kg == 22.0:
            raise ZeroDivisionError("too heavy")
        while self.mass_kg == 23.0:
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


def test_a_campaign_that_is_killed_goes_on_without_a_run_twice_or_lost_and_the_rows_are_those_of_any_other(
    tmp_path: Path,
) -> None:
    more = 'laws = ["afdsc", "dsc"]\nseeds = {}\nsamples = {}\nkeep = "none"'
    plan = write_plan(tmp_path, more.format(2, 20), MASSES)
    out = tmp_path / "out"
    killed = start(plan, "--out", out, "--workers", "1")
    wait_for(lambda: rows_written(out) >= 2)
    killed.kill()
    killed.wait()
    before = rows_of(plan, out)
    assert 2 <= len(before) < 240
    write_plan(tmp_path, more.format(2, 1), MASSES)  # the first twelve of the same runs
    before = rows_of(plan, out)
    assert before
    rows = do(plan, out)
    assert [row["outcome"] for row in rows] == ["passed"] * 12
    assert [row for row in rows if row in before] == before  # they were not run again
    other = do(plan, tmp_path / "other", Place(None, 2, LIMIT_S))
    assert of_the_runs(rows) == of_the_runs(other)
    assert len({row["wire_sha256"] for row in rows}) == 12
    row = rows[4]
    metrics = bridge.run("circle_speed", set=Campaign(plan).runs[4].point.sets).metrics
    for name in ("wire_sha256", "effort_n_m_s", "overshoot_m", "ticks"):
        assert row[name] == metrics[name]
    assert (row["robot.mass_kg"], row["law"]) == (24.0, "afdsc")


def test_an_interrupted_campaign_keeps_what_is_done_and_says_how_to_go_on(tmp_path: Path) -> None:
    plan = write_plan(tmp_path, 'seeds = 400\nkeep = "none"')
    out = tmp_path / "out"
    running = start(plan, "--out", out, "--workers", "1")
    wait_for(lambda: rows_written(out) >= 1)
    running.send_signal(signal.SIGINT)
    _, told = running.communicate(timeout=60)
    assert running.returncode == 130, told
    done = read_rows(out).num_rows
    assert f"interrupted; {done} of 400 runs are done and safe in {out}; the same command goes on" in told
    assert "Traceback" not in told
    dry = json.loads(in_process("campaign", plan, "--out", out, "--dry-run", "--json"))
    assert (dry["runs"], dry["left"]) == (400, 400 - done)
    assert dry["total_s"] == pytest.approx(dry["run_s"] * dry["left"] / dry["workers"])


def test_a_run_that_fails_is_a_row_with_its_reason_and_the_others_go_on(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    axis = "[axes]\nrobot.mass_kg = { grid = [20, 21, 22] }"
    expect = '[[expect]]\nsignal = "error.planar_m"\nbelow = 1e-9'
    plan = write_plan(tmp_path, 'laws = ["./laws.py:Light"]', f"{axis}\n{expect}")
    rows = do(plan, tmp_path / "out")
    told = {row["robot.mass_kg"]: (row["outcome"], row["reason"]) for row in rows}
    assert told[20.0][0] == "failed"
    assert told[20.0][1].startswith("error.planar_m below 1e-09 from 0 s to the end: failed")
    assert told[21.0] == ("lost", "its process ended twice, at last: crashed: exit code 7")
    assert told[22.0][0] == "ended"
    assert "ZeroDivisionError: too heavy" in told[22.0][1]
    # What failed is recorded, and the recording is of that very run.
    recordings = {path.stem: path for path in (tmp_path / "out" / RECORDINGS).iterdir()}
    of_mass = {row["robot.mass_kg"]: row["key"] for row in rows}
    assert recordings.keys() == {of_mass[mass] for mass in (20.0, 22.0)}
    assert read(recordings[of_mass[20.0]]).summary["wire_sha256"] == rows[0]["wire_sha256"]


def test_a_run_that_hangs_is_ended_once_and_is_a_row(tmp_path: Path) -> None:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    axis = "[axes]\nrobot.mass_kg = { grid = [20, 23, 24] }"
    plan = write_plan(tmp_path, 'laws = ["./laws.py:Light"]\nkeep = "none"', axis)
    rows = do(plan, tmp_path / "out", Place(None, 1, 2.0))
    assert [row["outcome"] for row in rows] == ["passed", "lost", "failed"]
    assert rows[1]["reason"] == "hung: it was ended after 2.0 s"
    assert rows[2]["reason"].endswith("times, and the robot was held still")


def test_an_fmu_that_crashes_on_some_parameters_costs_those_runs_alone(tmp_path: Path, monkeypatch) -> None:
    build_flawed(tmp_path)
    monkeypatch.setenv("FLAW", "start 24")
    fmu = '"plant.fmu" = "flawed.fmu"\n[axes]\nplant.start.mass_kg = { grid = [20, 24, 28] }'
    rows = do(write_plan(tmp_path, 'keep = "none"', fmu), tmp_path / "out")
    assert [row["outcome"] for row in rows] == ["passed", "ended", "passed"]
    assert "SIGSEGV (Segmentation fault); its last words: 'the last words of a crash'" in rows[1]["reason"]


def test_the_worst_are_recorded_and_a_report_tells_how_to_repeat_them(tmp_path: Path) -> None:
    keep = 'keep = { worst = 1, by = "overshoot_m" }\nlaws = ["afdsc", { law = "dsc", gains = { k1_1_s = 9.0 } }]\n'
    faults = '[[fault]]\nname = "none"\n[[fault]]\nname = "lossy"\n'
    faults += 'rows = [{ kind = "drop", target = "command", value = 0.3 }]'
    plan = write_plan(
        tmp_path, f"{keep}seeds = [3, 5]", f"{faults}\n{MASSES.splitlines()[0]}\n{MASSES.splitlines()[1]}"
    )
    rows = do(plan, tmp_path / "out")
    assert len(rows) == 24
    report = json.loads(in_process("campaign", "report", tmp_path / "out", "--json"))
    worst = report["worst"]
    assert [one["overshoot_m"] for one in worst] == sorted((row["overshoot_m"] for row in rows), reverse=True)[:20]
    kept = {f"{RECORDINGS}/{path.name}" for path in (tmp_path / "out" / RECORDINGS).iterdir()}
    assert {worst[0]["recording"]} == kept
    assert [one["recording"] for one in worst[1:]] == [None] * 19
    words = shlex.split(worst[0]["repeat"])
    assert words[:2] == ["hil", "run"]
    again = json.loads(in_process(*words[1:], "--record", "none", "--json"))
    row = next(row for row in rows if row["key"] == worst[0]["key"])
    assert (again["wire_sha256"], again["overshoot_m"]) == (row["wire_sha256"], row["overshoot_m"])
    page = Path(report["html"]).read_text(encoding="utf-8")
    assert "24 of 24 runs passed" in page
    assert "dsc,k1_1_s=9.0" in page
    assert "://" not in page.replace("http://www.w3.org/", "")  # it needs nothing else


def test_what_is_wrong_with_a_plan_is_a_sentence_with_its_line_before_anything_runs(tmp_path: Path) -> None:
    axes = "[axes]\n{}"
    for more, tables, sentence in (
        ("", axes.format("robot.mas_kg = { grid = [1] }"), "plan.toml:9: unknown key robot.mas_kg; did you mean"),
        ("", axes.format('"robot.mass_kg" = { grid = [20, -3] }'), "plan.toml:9: robot.mass_kg = -3"),
        ("", axes.format('"robot.mass_kg" = { gird = [20] }'), "did you mean 'grid'?"),
        ("", axes.format('"robot.mass_kg" = { uniform = [20, 3] }\n'), "expected [low, high] with low < high"),
        ("", axes.format('"robot.mass_kg" = { uniform = [3, 20] }\n'), "say with samples = N how often to draw"),
        ("", axes.format('"robot.mass_kg" = { grid = [3, 3] }\n'), "plan.toml:9: axes.robot.mass_kg: grid: a value is"),
        ("", axes.format("a.b = { list = [1, 2] }\nc.d = { list = [1] }"), "but a.b has 2, c.d has 1"),
        ("", axes.format('"loop.seed" = { grid = [1, 2] }'), "axes loop.seed: give seeds instead"),
        ("seeds = 0", "", "plan.toml:3: seeds: expected how many, from 1 to"),
        ("sceds = 3", "", "plan.toml:3: unknown key sceds; did you mean 'seeds'?"),
        ('keep = "some"', "", 'plan.toml:3: keep; expected "none", "failures", "all" or'),
        ('keep = { worst = 3, by = "rms" }', "", "plan.toml:3: keep.by: unknown figure 'rms'"),
        ('laws = ["afdcs"]', "", "controller.law = 'afdcs': unknown; did you mean 'afdsc'?"),
        (
            'laws = ["dsc", { law = "dsc", name = "other" }]',
            "",
            "two runs are the same: dsc, seed 1; and other, seed 1",
        ),
        ("", '[[fault]]\nname = "x"\nrows = [{ kind = "dorp" }]', "did you mean 'drop'?"),
    ):
        plan = write_plan(tmp_path, more, tables)
        with pytest.raises(BadInputError) as refused:
            Campaign(plan)
        assert sentence in str(refused.value)
    done = hil("campaign", tmp_path / "no.toml")
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr == f"hil: campaign {tmp_path / 'no.toml'}: there is no such file; give the path of a .toml file\n"
    )
    assert hil("campaign", "report", tmp_path).returncode == 2


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
    monkeypatch.setattr(cluster_of_dask, "_CONNECT_S", 0.2)
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
mount -t tmpfs -o size=600k tmpfs "$1" || exit 77
dd if=/dev/zero of="$1/ballast" bs=1k count="$3" 2> /dev/null
shift; out="$1"; shift; shift
"$@"; echo "first $?" >&2
rm "$(dirname "$out")/ballast"
"$@"; echo "second $?" >&2
"""


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a disk in a namespace, as Linux can")
def test_a_full_disk_ends_a_campaign_in_order_and_it_goes_on_where_there_is_room(tmp_path: Path) -> None:
    plan = write_plan(tmp_path, 'seeds = 8\nkeep = "none"')
    disk = tmp_path / "disk"
    disk.mkdir()
    own = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
    command = [*HIL, "campaign", plan, "--out", disk / "out", "--workers", "1"]
    words = [*own, "sh", "-c", ON_A_SMALL_DISK, "sh", disk, disk / "out", "540", *command]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=environment(), timeout=120)
    if done.returncode == 77 or done.stderr.startswith("unshare"):
        pytest.skip(f"no disk may be mounted here: {done.stderr}")
    first, second = done.stderr.split("first ")
    assert "it cannot be written to (No space left on device); what was written is safe: make room" in first
    assert "Traceback" not in done.stderr
    assert second == "2\nsecond 0\n"
    assert "8 runs: 8 passed" in done.stdout


class Cluster:
    """Dask's own commands as processes on loopback."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
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
        self.processes.append(
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment())
        )
        return self.processes[-1]

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
    yield cluster
    cluster.close()


def test_runs_behind_a_link_are_done_one_at_a_time_where_the_bench_is(tmp_path: Path, cluster: Cluster) -> None:
    with device("circle_speed", "--mode", "lockstep", "--link", "serial:pty", "--set", "loop.rate_hz=200") as robot:
        link = f'link.url = "{robot.link}"\nestimator.source = "odometry"'
        plan = write_plan(tmp_path, 'laws = ["afdsc", "dsc"]\nkeep = "none"', link)
        rows = do(plan, tmp_path / "out", Place(cluster.address, 0, LIMIT_S))
        assert [row["outcome"] for row in rows] == ["passed", "passed"], rows
        assert {row["machine.worker"].split()[1] for row in rows} == {"with"}
        refused = CliRunner().invoke(app, ["campaign", str(plan), "--workers", "2"])
        assert "--workers 2: there is one bench behind its link" in str(refused.exception)


def test_a_worker_that_is_killed_and_a_scheduler_that_goes_and_comes_back_lose_no_run(
    tmp_path: Path, cluster: Cluster
) -> None:
    plan = write_plan(tmp_path, 'seeds = 30\nkeep = "none"')
    scheduler, first = cluster.processes[:2]
    troubles: set[str] = set()
    done, kills = 0, [first.kill, scheduler.kill]

    def tell(told) -> None:
        if told.trouble is not None and told.trouble not in troubles:
            troubles.add(told.trouble)
            if "has gone" in told.trouble:
                scheduler.wait()
                cluster.scheduler()
                cluster.worker()

    for rows in Campaign(plan).perform(tmp_path / "out", Place(cluster.address, 0, LIMIT_S), tell):
        done += len(rows)
        if kills and done >= 6 * (3 - len(kills)):
            kills.pop(0)()
    assert not kills
    assert any("has gone; waiting for it" in trouble for trouble in troubles)
    rows = rows_of(plan, tmp_path / "out")
    assert [row["outcome"] for row in rows] == ["passed"] * 30
    assert len({row["machine.worker"] for row in rows}) >= 2
    assert of_the_runs(rows[:2]) == of_the_runs(do(write_plan(tmp_path, 'seeds = 2\nkeep = "none"', name="few.toml"),
                                                   tmp_path / "few"))  # fmt: skip
