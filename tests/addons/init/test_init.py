"""``hil init`` writes a robot and a scenario that run, whatever the robot."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import MISSING
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.addons.init.init_command import FILES, ROBOT_FILE, SCENARIO_FILE, TESTS_FILE, WORKFLOW, begin, init
from hil.addons.init.new_robot import PROJECT_QUESTIONS
from hil.core.errors import BadInputError
from hil.core.options import options_of
from hil.robot.driver_registry import OUR_DRIVER, dialect, driver_names
from hil.runtime.assembly import check_scenario
from hil.scenario import load
from hil.scenario.motor_checks import make_driver
from tests.support.examples import share_of_examples
from tests.support.plugin_suites import run as run_suite
from tests.support.processes import HIL, ROOT, environment


def _answers(**known: Any) -> dict[str, Any]:
    """Return answers to all questions: those known, and else what is proposed."""
    answers: dict[str, Any] = {}
    for question in PROJECT_QUESTIONS:
        name = question.key.partition(".")[2]
        answers[question.key] = known.get(name, question.proposed(answers))
    return answers


@share_of_examples(0.08)
@given(
    st.floats(0.5, 2000.0),
    st.floats(0.02, 0.3),
    st.floats(0.05, 1.5),
    st.floats(0.05, 1.5),
)
def test_whatever_the_robot_its_first_circle_is_one_that_it_can_drive(
    tmp_path_factory: pytest.TempPathFactory, mass: float, radius: float, length: float, width: float
) -> None:
    folder = tmp_path_factory.mktemp("robot")
    answers = _answers(mass_kg=mass, wheel_radius_m=radius, half_length_m=length, half_width_m=width)
    path = begin(folder, answers)[SCENARIO_FILE]
    scenario = load(path)
    assert check_scenario(scenario).sentences == ()
    assert scenario.robot.mass_kg == mass
    assert scenario.provenance["robot.mass_kg"].endswith(f"{ROBOT_FILE}:4")


@pytest.mark.parametrize(
    "sizes",
    [(1.2, 0.03, 0.08, 0.09), (20.0, 0.075, 0.3, 0.3), (400.0, 0.2, 0.8, 0.5)],
    ids=["desk", "paper", "pallet"],
)
def test_the_first_circle_is_driven_and_passes(tmp_path: Path, sizes: tuple[float, ...]) -> None:
    names = ("mass_kg", "wheel_radius_m", "half_length_m", "half_width_m")
    path = begin(tmp_path, _answers(**dict(zip(names, sizes, strict=True))))[SCENARIO_FILE]
    (expected,) = load(path).expect
    run = hil.run(path, set={"loop.duration_s": expected.from_s + 1.0})
    assert run.passed, run.metrics["expect"]


def test_by_flags_the_files_are_written_and_never_over_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "new"
    init(folder, mass_kg=12.0, link="serial:/dev/ttyACM0", defaults=True)
    robot = tomllib.loads((folder / ROBOT_FILE).read_text("utf-8"))
    assert robot["robot"]["mass_kg"] == 12.0
    assert robot["link"]["url"] == "serial:/dev/ttyACM0"
    assert f"  hil run {folder / SCENARIO_FILE}" in capsys.readouterr().out.splitlines()
    assert load(folder / SCENARIO_FILE).link.url == "memory:"
    assert load("paper_circle", robot=folder / ROBOT_FILE).robot.mass_kg == 12.0
    with pytest.raises(BadInputError, match="the file exists already; choose another name, or replace it with --force"):
        init(folder, defaults=True)
    init(folder, defaults=True, force=True)
    assert tomllib.loads((folder / ROBOT_FILE).read_text("utf-8"))["robot"]["mass_kg"] == 20.0


def test_a_wrong_flag_is_answered_as_the_scenario_answers_it(tmp_path: Path) -> None:
    with pytest.raises(BadInputError) as wrong:
        init(tmp_path, wheel_radius_m=75.0, defaults=True)
    expected = "expected a number from 0.001 to 1; 75 m? if you mean millimetres, write 0.075"
    assert str(wrong.value) == f"--wheel-radius-m: robot.wheel_radius_m = 75.0; {expected}"
    with pytest.raises(BadInputError, match="stdin is not a terminal; give --wheel-radius-m, "):
        init(tmp_path, mass_kg=12.0)
    assert list(tmp_path.iterdir()) == []


def test_a_driver_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"^--driver: there is no driver 'odrve'; did you mean 'odrive'\?$"):
        init(tmp_path, driver="odrve", defaults=True)


def test_a_robot_that_is_too_weak_for_its_weight_gets_no_baseline(tmp_path: Path) -> None:
    with pytest.raises(BadInputError) as failed:
        init(tmp_path, mass_kg=1000.0, torque_limit_n_m=2.0, wheel_radius_m=0.05, rate_hz=20, defaults=True)
    assert re.fullmatch(
        rf"{re.escape(str(tmp_path / SCENARIO_FILE))}: the virtual robot does not pass it with seed 1: "
        r"error\.planar_m below 0\.05 from 18\.75 s to the end: failed, .* s in all; check the limits",
        str(failed.value),
    )
    assert not list(tmp_path.glob("*.baseline.toml"))


@pytest.mark.parametrize("driver", driver_names())
def test_what_it_writes_for_a_driver_passes_or_it_says_why_not(tmp_path: Path, driver: str) -> None:
    folder = tmp_path / "robot"
    required = [] if driver == OUR_DRIVER else list(options_of(dialect(driver).settings).values())
    if any(option.default is MISSING for option in required):
        with pytest.raises(BadInputError, match=f"cannot write a robot for '{driver}', because .*device.motors.file"):
            init(folder, driver=driver, defaults=True)
        assert not folder.exists()
        return
    init(folder, driver=driver, defaults=True)
    written = load(folder / SCENARIO_FILE)
    sensors = {"gyro"} if driver == OUR_DRIVER else make_driver(written).capabilities.sensors
    assert ("gyro" in (folder / SCENARIO_FILE).read_text("utf-8")) == ("gyro" in sensors)
    rows = (folder / ROBOT_FILE).read_text("utf-8").partition("[device.motors]")[2].partition("[link]")[0]
    assert re.findall(r"(?m)^#? ?(\w+) = ", rows) == [option.name for option in required]
    if required:
        assert written.device.settings == dialect(driver).settings()
    assert hil.run(folder / SCENARIO_FILE).passed
    assert hil.run(folder / "bad_day.hil.toml").passed


@pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal stands for the person")
def test_a_person_is_asked_again_until_the_answer_is_one(tmp_path: Path) -> None:
    import pty

    pid, terminal = pty.fork()
    if pid == 0:
        os.execve(sys.executable, [*HIL, "init", str(tmp_path), "--mass-kg", "12"], environment())
    os.write(terminal, b"75\nwide\n0.06\n" + b"\n" * len(PROJECT_QUESTIONS))
    said = b""
    while True:
        try:
            said += os.read(terminal, 4096)
        except OSError:  # how a pseudo-terminal ends
            break
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0, said.decode()
    text = said.decode()
    assert "robot.wheel_radius_m: to where a roller touches the floor [0.075]" in text
    assert "robot.wheel_radius_m = 75.0; expected a number from 0.001 to 1" in text
    assert "'wide' is not a number" in text
    robot = tomllib.loads((tmp_path / ROBOT_FILE).read_text("utf-8"))["robot"]
    assert (robot["mass_kg"], robot["wheel_radius_m"]) == (12.0, 0.06)


@pytest.mark.skipif(sys.platform == "win32", reason="the steps are bash's")
def test_all_that_it_writes_passes_at_once_and_the_action_shows_it(tmp_path: Path) -> None:
    """The steps of the action are run as they stand, in the order of its file."""
    (tmp_path / ".git").mkdir()
    mine = tmp_path / "robots" / "mine"
    init(mine, speed_limit_rad_s=40.0, driver="wheeltec", link="serial:/dev/ttyACM0", defaults=True)
    names = {Path(name).name for name in FILES} - {"robot.yml", TESTS_FILE} | {"test_mine.py"}
    assert {path.name for path in mine.iterdir()} == names
    workflow = yaml.safe_load((tmp_path / WORKFLOW).read_text("utf-8"))
    *_, step = workflow["jobs"]["scenarios"]["steps"]
    assert step["with"] == {"path": "robots/mine"}
    place, _, version = step["uses"].partition("@")
    assert (place.split("/")[2:], version) == (["tools", "action"], f"v{hil.__version__}")

    action = yaml.safe_load((ROOT / "tools" / "action" / "action.yml").read_text("utf-8"))
    values = {name: one["default"] for name, one in action["inputs"].items()} | step["with"]
    values["package"] = str(_package(tmp_path))
    summary = tmp_path / "summary.md"
    given = {"GITHUB_ACTION_PATH": str(ROOT / "tools" / "action"), "GITHUB_STEP_SUMMARY": str(summary)}
    installed = {"PIP_TARGET": str(tmp_path / "installed"), "PIP_NO_INDEX": "1"}
    found = environment() | given | installed | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    steps = [one for one in action["runs"]["steps"] if "run" in one]
    assert [one["name"] for one in steps] == ["Install", "Run", "Summarise"]
    for one in steps:
        filled = {
            name: re.sub(r"\$\{\{ inputs\.(\w+) \}\}", lambda m: values[m[1]], text)
            for name, text in one["env"].items()
        }
        done = subprocess.run(
            ["bash", "-e", "-c", one["run"]],
            cwd=tmp_path,
            env=found | filled,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "installed" / "robot_package.py").is_file()
    text = summary.read_text("utf-8")
    assert "5 in all, 0 failed" in text
    pages = {path.name for path in (tmp_path / "hil-results").rglob("*.html")}
    assert pages
    assert all(f"`{name}`" in text for name in pages)


def test_pytest_takes_two_robots_that_are_side_by_side(suite: pytest.Pytester) -> None:
    for name in ("robot-1", "robot-2"):
        begin(suite.path / name, _answers())
    found = run_suite(suite, "--collect-only", "-q").stdout.str()
    assert "10 tests collected" in found
    assert "robot-2/test_robot_2.py::test_my_law_survives_a_bad_day" in found


def _package(folder: Path) -> Path:
    """Return a wheel that pip can install without a network: it stands for ours, which test_install.py builds."""
    wheel = folder / "mecanum_hil-1-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("robot_package.py", "")
        archive.writestr(
            "mecanum_hil-1.dist-info/METADATA",
            "Metadata-Version: 2.1\nName: mecanum-hil\nVersion: 1\nProvides-Extra: plots\n",
        )
        archive.writestr(
            "mecanum_hil-1.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        archive.writestr("mecanum_hil-1.dist-info/RECORD", "")
    return wheel
