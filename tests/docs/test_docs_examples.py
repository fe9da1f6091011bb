"""The examples of docs/examples work: each is run unchanged, for a shorter time if it is long."""

import math
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hil import run as hil_run
from hil.addons.init.init_command import law_text
from tests.support.plugin_suites import run
from tests.support.processes import HIL, ROOT, environment, hil, wait_for
from tools.build.compiler import compiler

EXAMPLES = ROOT / "docs" / "examples"


def script(name: str, *arguments: str | Path) -> None:
    """Run a script here, as ``python NAME ARGUMENTS`` does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_every_example_is_short_listed_and_run_here() -> None:
    files = sorted(path.name for path in EXAMPLES.iterdir() if path.is_file() and path.name != "README.md")
    page = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| \[`(\S+)`\]", page, re.MULTILINE) != []
    assert sorted(re.findall(r"^\| \[`(\S+)`\]", page, re.MULTILINE)) == files
    here = Path(__file__).read_text(encoding="utf-8")
    for name in files:
        assert f'"{name}"' in here
        assert 20 <= len((EXAMPLES / name).read_text(encoding="utf-8").splitlines()) <= 60, name


def test_a_run_from_python_prints_figures_and_signals(capsys) -> None:
    script("run_a_scenario.py", "2")
    shown = capsys.readouterr().out
    assert re.search(r"on the path after 0\.\d+ s", shown)
    assert "2000 ticks; the largest error of the last second is 0.00" in shown
    assert "pose.x_m  pose.y_m  error.planar_m" in shown


def test_a_law_of_ones_own_is_the_one_that_init_writes_and_drives() -> None:
    assert (EXAMPLES / "my_law.py").read_text(encoding="utf-8") == law_text()
    run = hil_run("circle_speed", law=f"{EXAMPLES / 'my_law.py'}:MyLaw", set={"loop.duration_s": 3.0, "expect": []})
    assert run.metrics["t10_s"] < 2.0


def test_a_motion_of_ones_own_is_followed(tmp_path, capsys) -> None:
    script("my_reference.py", tmp_path, "3")
    assert (tmp_path / "flower.csv").read_text().splitlines()[0] == "t_s,x_m,y_m,heading_rad"
    shown = capsys.readouterr().out
    assert "PASSED" in shown
    assert "the robot can follow it" in shown


def test_the_tests_and_the_scenario_pass_as_tests(suite) -> None:
    for name in ("my_law.py", "test_my_law.py", "bad_day.hil.toml"):
        shutil.copy(EXAMPLES / name, suite.path)
    run(suite, "--hil-record", "none").assert_outcomes(passed=5)


def test_a_recording_of_the_bad_day_is_read(tmp_path, capsys) -> None:
    recording = tmp_path / "bad.rrd"
    assert hil("run", EXAMPLES / "bad_day.hil.toml", "--record", recording).returncode == 0
    script("read_a_recording.py", recording)
    shown = capsys.readouterr().out
    assert "over 8.00 s" in shown
    assert "fault begins: push force_x_n" in shown
    assert shown.startswith("PASSED  bad_day: ")
    assert shown.endswith("passed: True\n")


def test_the_campaign_passes_for_every_robot(tmp_path) -> None:
    done = hil("campaign", EXAMPLES / "mass_and_friction.toml", "--out", tmp_path / "runs")
    assert (done.returncode, "12 runs: 12 passed" in done.stdout) == (0, True), done.stderr


@pytest.mark.alone
@pytest.mark.skipif(sys.platform == "win32", reason="it opens a POSIX terminal")
def test_a_robot_is_driven_from_c(tmp_path) -> None:
    client, program = ROOT / "firmware_protocol", tmp_path / "drive"
    core = [client / "firmware" / f"{name}.c" for name in ("framing", "cobs", "crc")]
    sources = [EXAMPLES / "drive.c", *sorted((client / "client").glob("*.c")), *core]
    flags = ["-std=gnu11", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-fsanitize=address,undefined", f"-I{client}"]
    words = [*compiler(), *flags, *sources, client / "generated" / "wheel_messages.c", "-lm", "-o", program]
    subprocess.run(words, check=True)
    command = [*HIL, "device", "paper_circle", "--link", "serial:pty", "--mode", "realtime", "--until-eof"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as device:
        assert device.stdout is not None
        [port] = re.findall(r"link=serial:(\S+)", device.stdout.readline())
        driven = subprocess.run([program, port], capture_output=True, text=True, timeout=60, check=False)
        device.communicate()
    assert (driven.returncode, driven.stderr) == (0, "")
    assert re.fullmatch(r"(3\.9|4\.0)\d rad/s\nat rest\n", driven.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="it reads ELF objects")
def test_the_client_allocates_nothing_and_has_no_statics(tmp_path) -> None:
    elffile = pytest.importorskip("elftools.elf.elffile", reason="no pyelftools: pip install pyelftools")
    client = ROOT / "firmware_protocol"
    core = [client / "firmware" / f"{name}.c" for name in ("framing", "cobs", "crc")]
    sources = [*(client / "client").glob("*.c"), *core, client / "generated" / "wheel_messages.c"]
    subprocess.run([*compiler(), "-std=c11", "-O2", "-c", *sources], check=True, cwd=tmp_path)
    objects = [elffile.ELFFile(path.open("rb")) for path in tmp_path.glob("*.o")]
    assert len(objects) == len(sources)
    symbols = [one for each in objects for one in each.get_section_by_name(".symtab").iter_symbols()]
    defined = {one.name for one in symbols if one["st_shndx"] != "SHN_UNDEF"}
    mathematics = {"lrint", "rint", "isfinite", "sin", "cos", "sincos", "expm1", "fabs", "fmin", "fmax"}
    assert {one.name for one in symbols} - defined <= {"memcpy", "memset"} | mathematics
    for each in objects:
        assert [each.get_section_by_name(name)["sh_size"] for name in (".data", ".bss")] == [0, 0]


@pytest.mark.skipif(shutil.which("clang") is None, reason="needs clang as a compiler of C++: apt install clang")
def test_the_client_links_to_a_program_in_cpp(tmp_path) -> None:
    program = """
        #include "client/wheel_client.h"
        #include "client/wheel_line.h"
        static wheel_client client;
        int main() {
            wheel_client_init(&client, WP_MODE_SPEED, 0, 1);
            wheel_client_request(&client, WP_REQUEST_IDLE, 0);
            return client.view.out_frames == 1 && wheel_client_size() == sizeof client ? 0 : 1;
        }
    """
    client = ROOT / "firmware_protocol"
    (tmp_path / "main.cpp").write_text(program, encoding="utf-8")
    core = [client / "firmware" / f"{name}.c" for name in ("framing", "cobs", "crc")]
    sources = [*(client / "client").glob("*.c"), *core, client / "generated" / "wheel_messages.c"]
    strict = ["clang", "-c", "-std=c++17", "-Wall", "-Wextra", "-Werror", f"-I{client}", "main.cpp", "-o", "main.o"]
    subprocess.run(strict, check=True, cwd=tmp_path)
    subprocess.run(["clang", "main.o", *sources, f"-I{client}", "-lm", "-o", "program"], check=True, cwd=tmp_path)
    subprocess.run([tmp_path / "program"], check=True)


@pytest.mark.alone
@pytest.mark.skipif(sys.platform == "win32", reason="its state folder is Linux's")
def test_a_robot_is_driven_over_http(tmp_path) -> None:
    command = [*HIL, "serve", "circle_speed", "--set", "loop.rate_hz=100", "--set", "service.port=0"]
    variables = environment() | {"XDG_STATE_HOME": str(tmp_path)}
    log = tmp_path / "log"
    with log.open("wb") as errors, subprocess.Popen(command, env=variables, cwd=tmp_path, stderr=errors) as service:
        try:
            wait_for(lambda: "phase=disarmed" in log.read_text())
            [token] = tmp_path.glob("mecanum-hil/services/*.token")
            words = [sys.executable, str(EXAMPLES / "drive_over_http.py"), token.stem, str(token)]
            driven = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
        finally:
            service.terminate()
    assert driven.returncode == 0, driven.stderr
    x_m, y_m, heading_rad = map(float, re.findall(r"-?\d+\.\d+", driven.stdout))
    assert heading_rad == pytest.approx(0.5, abs=0.1)
    ahead_m = (x_m - 0.6) * math.cos(0.5) + (y_m - 0.1) * math.sin(0.5)
    left_m = (y_m - 0.1) * math.cos(0.5) - (x_m - 0.6) * math.sin(0.5)
    assert (abs(ahead_m) < 0.05, 0.1 < left_m < 0.4) == (True, True), "sideways is to the left of where it looks"
