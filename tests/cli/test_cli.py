"""The commands as a user types them: their output, and their messages for wrong input."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from hil.cli.commands import shipped
from hil.record.reader import read
from hil.robot import virtual_server
from tests.support.processes import HIL, ROOT, environment, hil, hil_process, run_json

FIGURES = {
    "passed",
    "tracked_s",
    "t10_s",
    "steady_rms_m",
    "steady_max_m",
    "overshoot_m",
    "effort_n_m_s",
    "torque_variation_n_m_per_s",
    "saturation_s",
    "ticks",
    "realtime_factor",
    "tick_us",
    "deadline_misses",
    "lateness_us",
    "frames",
    "wire_sha256",
    "recording",
}
SHORT = ("--set", "loop.duration_s=0.5", "--set", "expect=[]")


def test_the_same_run_in_two_processes_gives_equal_figures_and_bytes(tmp_path: Path):
    short = ("--set", "loop.duration_s=6", "--set", "loop.rate_hz=200", "--set", "expect.1.from_s=5")
    lockstep = ("paper_circle", "--mode", "lockstep", *short)
    one = run_json(*lockstep, cwd=tmp_path)
    two = run_json(*lockstep, cwd=tmp_path, by=hil_process)
    other = run_json(*lockstep, "--seed", "2", "--record", "none", cwd=tmp_path)
    wall_clock = {"tick_us", "realtime_factor", "recording", "recorded", "reasons"}
    assert {k: v for k, v in one.items() if k not in wall_clock} == {
        k: v for k, v in two.items() if k not in wall_clock
    }
    assert one["wire_sha256"] != other["wire_sha256"]
    assert set(one) >= FIGURES
    assert one["passed"] is True
    assert other["recording"] is None
    assert other["reasons"]["recording"]

    reviewed = json.loads(hil("review", tmp_path / one["recording"], "--json").stdout)
    assert {k: reviewed[k] for k in FIGURES - {"recording"}} == {k: one[k] for k in FIGURES - {"recording"}}


def test_run_prints_figures_and_the_next_commands(tmp_path: Path):
    done = hil("run", "paper_circle", *SHORT, cwd=tmp_path)
    assert done.returncode == 0
    (recording,) = (tmp_path / "runs").glob("paper_circle-*.rrd")
    assert f"hil view runs/{recording.name}" in done.stdout
    assert f"hil review runs/{recording.name}" in done.stdout
    assert "hil show paper_circle" in done.stdout
    assert len(read(recording).signals["loop.t_s"]) == 500
    assert done.stderr == ""


def test_failed_expectation_is_exit_code_1(tmp_path: Path):
    done = hil("run", "paper_circle", "--record", "none", "--set", "expect.1.below=0.001", cwd=tmp_path)
    assert done.returncode == 1
    assert "failed" in done.stdout


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "bad.toml"
    path.write_text(f'extends = "paper_circle"\n{text}\n')
    return path


@pytest.mark.parametrize(
    ("scenario", "options", "code", "words"),
    [
        ("[robot]\nmas_kg = 20.0", (), 2, ["mas_kg", "did you mean", "mass_kg", "bad.toml"]),
        ("[robot]\nmass_kg = -3.0", (), 2, ["robot.mass_kg", "-3", "greater than 0"]),
        ('[plant]\nfmu = "./missing.fmu"', (), 2, ["missing.fmu", "does not exist"]),
        ("[plant.start]\nmas_kg = 3.0", (), 2, ["mas_kg", "mass_kg"]),
        ("[robot\n", (), 2, ["bad.toml", "line"]),
        ("", ("--set", "robot.mas_kg=3"), 2, ["mas_kg", "mass_kg"]),
        ("", ("--set", "loop.rate_hz=333"), 2, ["rate_hz", "333"]),
        ("", ("--set", "controller.law=adfsc"), 2, ["adfsc", "afdsc"]),
        ("", ("--set", "controller.gains.filtr_s=1"), 2, ["filtr_s", "filter_s"]),
        ("", ("--set", "reference.kind=cirle"), 2, ["cirle", "circle"]),
        ("", ("--link", "seral:/dev/ttyACM0"), 2, ["seral", "serial"]),
        (
            "",
            ("--link", "serial:/dev/ttyNOPE", "--set", "estimator.source=odometry"),
            3,
            ["/dev/ttyNOPE", "does not exist"],
        ),
        ("", ("--link", "can:socketcna/can0", "--set", "estimator.source=odometry"), 2, ["socketcna", "socketcan"]),
        ("", ("--link", "can:socketcan/nope0", "--set", "estimator.source=odometry"), 3, ["socketcan", "nope0"]),
        ("", ("--record", "/proc/nowhere/run.rrd"), 2, ["/proc/nowhere"]),
        ("", ("--record", "run.txt"), 2, ["run.txt", ".rrd"]),
        ("", ("--robot", "missing.toml"), 2, ["missing.toml"]),
        ("", ("--set", "link.command_latency_s=0.0025"), 2, ["command_latency_s", "whole number of milliseconds"]),
        ("", ("--mode", "lockstpe"), 2, ["lockstpe", "lockstep"]),
        ("", ("--truth", "tcp://127.0.0.1:1"), 2, ["--truth", "leave"]),
        (
            "",
            ("--truth", "tcp://[::1", "--link", "serial:/dev/null"),
            2,
            ["tcp://[::1", "expected tcp://127.0.0.1:PORT"],
        ),
    ],
)
def test_bad_input_is_one_sentence(tmp_path: Path, scenario, options, code, words):
    if "--record" not in options:
        options = (*options, "--record", "none")
    done = hil("run", write(tmp_path, scenario), *options, cwd=tmp_path)
    assert done.returncode == code
    assert done.stdout == ""
    assert done.stderr.startswith("hil: ")
    assert len(done.stderr.splitlines()) == 1, done.stderr
    for word in words:
        assert word in done.stderr


def test_misspelt_scenario_names_the_nearest():
    done = hil("run", "paper_cirle")
    assert done.returncode == 2
    assert "did you mean 'paper_circle'" in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="needs /dev/full's folder")
def test_recording_where_nobody_may_write():
    done = hil("run", "paper_circle", "--record", "/sys/run.rrd")
    assert done.returncode == 2
    assert "/sys" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")
def test_device_on_a_busy_port():
    from hil.wire.pty import PtyStream
    from hil.wire.serial_port import SerialStream

    master = PtyStream()
    holder = SerialStream(master.port, 921_600)
    done = hil("device", "paper_circle", "--link", f"serial:{master.port}")
    holder.close()
    master.close()
    assert done.returncode == 3
    assert "busy" in done.stderr


def test_device_needs_a_link_that_reaches_another_process():
    for link in ("memory:", "can:virtual/x"):
        done = hil("device", "paper_circle", "--link", link)
        assert done.returncode == 2
        assert "--link serial:pty" in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")
def test_a_device_tells_at_its_end_how_much_time_its_robot_lost(monkeypatch: pytest.MonkeyPatch):
    def stalled_for_80_ms() -> int:
        signal.raise_signal(signal.SIGTERM)
        return 80_000_000

    times = iter((lambda: 0, stalled_for_80_ms))
    monkeypatch.setattr(virtual_server, "time", SimpleNamespace(monotonic_ns=lambda: next(times)()))
    done = hil("device", "paper_circle", "--link", "serial:pty", "--mode", "realtime")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "this machine stalled: the robot lost 30 ms of its time"


def test_json_says_why_a_robot_could_not_be_reached():
    done = hil(
        *("run", "paper_circle", "--json", "--record", "none", "--set", "estimator.source=odometry"),
        *("--link", "serial:/dev/ttyNOPE"),
    )
    assert done.returncode == 3
    answer = json.loads(done.stdout)
    assert answer["passed"] is False
    assert "/dev/ttyNOPE" in answer["failure"]


def test_show_prints_every_value_and_where_it_came_from(tmp_path: Path):
    robot = tmp_path / "my_robot.toml"
    robot.write_text("[robot]\nmass_kg = 21.0\n")
    done = hil("show", "paper_circle", "--robot", robot, "--set", "loop.seed=7")
    lines = {line.split()[0]: line for line in done.stdout.splitlines()}
    assert "21.0" in lines["robot.mass_kg"]
    assert "my_robot.toml:2" in lines["robot.mass_kg"]
    assert "paper_circle.toml" in lines["robot.inertia_kg_m2"]
    assert "--set" in lines["loop.seed"]


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("signals", "error.planar_m"),
        ("laws", "afdsc"),
        ("scenarios", "paper_circle"),
        ("links", "memory:"),
        ("drivers", "stm32"),
    ],
)
def test_lists(what, name):
    done = hil("list", what)
    assert name in done.stdout
    rows = json.loads(hil("list", what, "--json").stdout)
    assert name in [next(iter(row.values())) for row in rows]


def test_fmu_commands(tmp_path: Path):
    built = hil("fmu", "build", "--out", tmp_path)
    fmu = tmp_path / "mecanum.fmu"
    assert str(fmu) in built.stdout.splitlines()
    assert "wheel.fl.torque_n_m" in hil("fmu", "info", fmu).stdout
    checked = hil("fmu", "check", fmu)
    assert (checked.returncode, "no violations" in checked.stdout) == (0, True)
    fmu.write_bytes(b"not a zip")
    broken = hil("fmu", "check", fmu)
    assert broken.returncode == 2
    assert str(fmu) in broken.stderr


def test_review_of_what_is_no_recording(tmp_path: Path):
    file = tmp_path / "x.rrd"
    file.write_text("not a recording")
    for name in (file, tmp_path / "missing.rrd"):
        for command in ("review", "view"):
            done = hil(command, name)
            assert done.returncode == 2
            assert str(name) in done.stderr
            assert "Traceback" not in done.stderr


def test_import_is_lean():
    program = "import sys, hil; hil.run; print(sorted({'rerun', 'fmpy', 'pandas', 'serial', 'can'} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, env=environment()
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="needs a git checkout")
def test_no_file_names_a_package_registry():
    tracked = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split(
        "\n"
    )
    hosts = ["pypi" + ".org", "python" + "hosted", "npmjs" + ".org", "deb." + "debian"]
    for name in filter(None, tracked):
        path = ROOT / name
        if path.suffix not in (".png", ".fmu", ".rrd", ".mcap") and path.is_file():
            text = path.read_text(encoding="utf-8")
            assert not [host for host in hosts if host in text], name


def test_progress_bar_is_for_a_person_only(tmp_path: Path):
    """On a terminal a bar; never on stdout."""
    pty = pytest.importorskip("pty", reason="pseudo-terminals need a POSIX system")
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [*HIL, "run", "paper_circle", "--record", "none"],
        stdout=subprocess.PIPE,
        stderr=slave,
        cwd=tmp_path,
        env=environment() | {"TERM": "xterm"},
    )
    os.close(slave)
    shown = b""
    with contextlib.suppress(OSError):  # EIO: the other side was closed
        while chunk := os.read(master, 4096):
            shown += chunk
    os.close(master)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert b"15 s" in shown
    assert b"\x1b" not in output


def test_can_down_is_said_with_the_remedy():
    """The kernel's message for an interface that is down; a real one needs a kernel with CAN."""
    from hil.wire.can_errors import failure
    from hil.wire.can_url import CanUrl

    error = failure(CanUrl("socketcan", "can0"), can.CanOperationError("Network is down", 100))
    assert "is down; bring it up: ip link set can0 up type can bitrate 1000000" in str(error)


LONG = "n" * 300
TOO_LONG = (
    ("run", f"{LONG}.toml"),
    ("serve", f"{LONG}.toml"),
    ("run", "paper_circle", "--record", f"{LONG}.rrd"),
    ("device", "paper_circle", "--link", f"serial:pty?symlink={LONG}"),
    ("fmu", "check", LONG),
    ("campaign", "report", LONG),
    ("verify", LONG),
)


@pytest.mark.parametrize("words", [words for words in TOO_LONG if words[0] in shipped()], ids=lambda words: words[0])
def test_a_name_that_is_too_long_is_one_sentence(words):
    done = hil(*words)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"hil: .*(too long).*\n", done.stderr), done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full, as Linux has it")
def test_a_full_disk_under_the_output_is_one_sentence():
    with Path("/dev/full").open("wb") as full:
        command = [sys.executable, "-m", "hil.cli.main", "list", "signals"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=environment())
    assert done.returncode == 2
    assert done.stderr == "hil: no space is left for the output; free some, or write it elsewhere\n"


def test_a_reader_that_has_left_before_anything_was_printed_is_no_error():
    buffered = environment() | {"PYTHONUNBUFFERED": ""}
    command = [sys.executable, "-m", "hil.cli.main", "list", "links"]  # less than a buffer holds
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=buffered) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == b""
    assert process.returncode == 0
