"""``hil fmu info`` and ``hil fmu check`` as a user types them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.broken_fmu import lag, pack
from tests.support.processes import environment, hil


def test_info_prints_a_table_of_the_variables_that_were_asked_for(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", 3)
    done = hil("fmu", "info", fmu)
    assert done.returncode == 0
    rows = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert "w output continuous Float64[2]" in rows
    assert "gain parameter fixed Float64 2 0.5 to 5" in rows
    assert "shape parameter fixed Enumeration 1 1 linear | 2 squared" in rows
    assert "default experiment start 0.5, stop 1.5, step 0.01" in rows
    some = hil("fmu", "info", fmu, "*a*").stdout
    assert ("gain" in some, "count" in some) == (True, False)


def test_info_prints_one_json_object(tmp_path: Path) -> None:
    about = json.loads(hil("fmu", "info", pack(tmp_path / "a.fmu", 3), "w", "--json").stdout)
    assert about["interfaces"] == {"CoSimulation": "lag"}
    (variable,) = about["variables"]
    assert (variable["name"], variable["type"], variable["dimensions"]) == ("w", "Float64", [2])


def test_what_an_fmu_says_of_itself_does_not_steer_the_terminal(tmp_path: Path) -> None:
    words = "&#x9b;31m[bold]what&#10;is followed"
    fmu = pack(tmp_path / "a.fmu", 2, lambda _, data: data.replace(b"what is followed", words.encode()))
    out = hil("fmu", "info", fmu).stdout
    assert " 31m[bold]what is followed" in out
    assert "\x9b" not in out


def test_a_name_that_no_variable_has_is_answered_with_the_nearest(tmp_path: Path) -> None:
    done = hil("fmu", "info", pack(tmp_path / "a.fmu", 2), "gian")
    assert (done.returncode, done.stdout) == (2, "")
    assert "no variable fits 'gian'; did you mean 'gain'?" in done.stderr


def test_check_prints_every_part_and_then_the_problems(tmp_path: Path) -> None:
    fmu = lag(tmp_path, 3, "SILENT_AFTER_TERMINATE")
    done = hil("fmu", "check", fmu)
    lines = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert done.returncode == 1
    assert {"functions pass", "termination fail", "reset pass"} <= set(lines)
    assert [line for line in lines[-3:] if not line.startswith("note: ")] == [
        "violation: termination: fmi3GetFloat64 returns error (the lag says no, for once)",
        f"{fmu}: 1 violation of the standard",
    ]
    result = json.loads(hil("fmu", "check", fmu, "--json").stdout)
    assert result["passed"] is False
    found = [(part["name"], finding["kind"]) for part in result["parts"] for finding in part["findings"]]
    assert found == [("bridge step", "note"), ("termination", "violation")]


def test_fmus_that_cannot_be_run_here_are_bad_input_alike(tmp_path: Path) -> None:
    """FMI 1.0, another interface: in a check as in a run."""
    for old, new, words in (
        (b'fmiVersion="2.0"', b'fmiVersion="1.0"', "FMI version 1.0; expected 2.0 or 3.0"),
        (b"CoSimulation", b"ScheduledExecution", "its interface is ScheduledExecution; expected co-simulation"),
    ):
        fmu = pack(tmp_path / "a.fmu", 2, lambda _, data, old=old, new=new: data.replace(old, new))
        for command in (
            ("fmu", "check", fmu),
            ("run", "circle_speed", "--set", f"plant.fmu={fmu}", "--record", "none"),
        ):
            done = hil(*command)
            assert (done.returncode, done.stdout) == (2, "")
            assert words in done.stderr


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            ["--all-platforms"],
            "--all-platforms makes FMUs for other machines; name a folder for them with --out FOLDER",
        ),
        (["--all-platforms", "--mujoco"], "--mujoco is built for this machine only; leave out --all-platforms"),
    ],
)
def test_what_cannot_be_built_is_said_before_anything_is(options: list[str], sentence: str) -> None:
    done = hil("fmu", "build", *options)
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"hil: {sentence}\n")


def test_check_of_a_good_fmu_exits_with_0(tmp_path: Path) -> None:
    fmu = lag(tmp_path, 2)
    done = hil("fmu", "check", fmu)
    assert done.returncode == 0
    assert done.stdout.splitlines()[-1] == f"{fmu}: no violations of the standard"
    assert json.loads(hil("fmu", "check", fmu, "--json").stdout)["passed"] is True


def test_the_json_of_a_run_is_alone_on_stdout_where_fmpy_lacks_its_own_library() -> None:
    """As on ARM64. FMPy says so on stdout when it is imported."""
    without = (
        "import sys; sys.modules['fmpy.logging'] = None; from hil.cli.main import main; sys.argv[0] = 'hil'; main()"
    )
    words = ["run", "circle_speed", "--set", "loop.duration_s=0.1", "--set", "expect=[]", "--record", "none", "--json"]
    done = subprocess.run(
        [sys.executable, "-c", without, *words], capture_output=True, text=True, check=False, env=environment()
    )
    assert json.loads(done.stdout)["scenario"] == "circle_speed", done.stderr
