"""What ``hil init`` asks, writes and says, without the runs of its baseline."""

import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml

from hil.addons.init import COMMANDS, init_command, new_robot
from hil.addons.init.init_command import FILES, ROBOT_FILE, SCENARIO_FILE, TESTS_FILE, WORKFLOW, begin, init
from hil.addons.init.new_robot import PROJECT_QUESTIONS
from hil.core.errors import BadInputError
from hil.judge import baselines
from hil.runtime import assembly
from hil.scenario import load
from tests.support.addon_commands import flags_that_are_on

MASS_KG = 12.5


@pytest.fixture
def baselines_of(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The scenarios that would have got a baseline."""
    scenarios: list[Path] = []
    monkeypatch.setattr(init_command, "_write_baseline", scenarios.append)
    return scenarios


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for question in PROJECT_QUESTIONS:
        found[question.key] = MASS_KG if question.parameter == "mass_kg" else question.proposed(found)
    return found


def test_no_flag_of_its_command_is_on_by_itself() -> None:
    assert flags_that_are_on(COMMANDS) == []


@pytest.mark.parametrize("is_set", [True, False])
def test_it_lists_what_is_written_and_what_to_type_next(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    baselines_of: list[Path],
    is_set: bool,
) -> None:
    monkeypatch.setattr(init_command, "is_address_set", lambda: is_set)
    (tmp_path / ".git").mkdir()
    mine = tmp_path / "robots" / "My Robot 2"
    init(mine, mass_kg=MASS_KG, defaults=True)
    assert baselines_of == [mine / SCENARIO_FILE]
    printed = capsys.readouterr()
    begin_, *rows, next_, run, test = printed.out.splitlines()
    paths = {name: mine / name for name in FILES} | {
        WORKFLOW: tmp_path / WORKFLOW,
        TESTS_FILE: mine / "test_my_robot_2.py",
    }
    assert (begin_, next_) == ("Written:", "Next:")
    shown = {row.rpartition("  ")[0].strip(): row.rpartition("  ")[2] for row in rows}
    assert shown == {str(paths[name]): meaning for name, meaning in FILES.items()}
    assert (run, test) == (f"  hil run '{mine / SCENARIO_FILE}'", f"  pytest '{mine}'")
    note = f"hil: note: the address in {WORKFLOW} is not set yet; put the owner of mecanum-hil's repository there\n"
    assert printed.err == ("" if is_set else note)
    steps = yaml.safe_load((tmp_path / WORKFLOW).read_text("utf-8"))["jobs"]["scenarios"]["steps"]
    assert steps[-1]["with"] == {"path": "robots/My Robot 2"}
    assert all(path.is_file() for name, path in paths.items() if name != "first_circle.baseline.toml")
    with pytest.raises(BadInputError, match="the file exists already"):
        init(mine, defaults=True)
    init(mine, mass_kg=21.0, defaults=True, force=True)
    assert tomllib.loads((mine / ROBOT_FILE).read_text("utf-8"))["robot"]["mass_kg"] == 21.0


def test_a_person_is_asked_for_what_no_flag_gives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], baselines_of: list[Path]
) -> None:
    asked: list[tuple[str, str]] = []
    typed = {"robot.wheel_radius_m": ["75", "wide", "0.06"], "firmware.counts_per_revolution": ["4096.5", "1000"]}

    def prompt(text: str, default: str) -> str:
        asked.append((text, default))
        left = typed.get(text.partition(":")[0])
        return left.pop(0) if left else default

    monkeypatch.setattr("typer.prompt", prompt)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    init(tmp_path, mass_kg=MASS_KG)
    assert asked[:4] == [
        *[("robot.wheel_radius_m: to where a roller touches the floor", "0.075")] * 3,
        ("robot.half_length_m: half the distance of front and rear axle", "0.3"),
    ]
    assert {text.partition(":")[0] for text, _ in asked} == {one.key for one in PROJECT_QUESTIONS} - {"robot.mass_kg"}
    problem, number, whole, *_ = capsys.readouterr().out.splitlines()
    assert problem.startswith("robot.wheel_radius_m = 75.0; expected a number from 0.001 to 1")
    assert (number, whole) == ("'wide' is not a number", "'4096.5' is not a number")
    robot = tomllib.loads((tmp_path / ROBOT_FILE).read_text("utf-8"))
    assert (robot["robot"]["mass_kg"], robot["robot"]["wheel_radius_m"]) == (MASS_KG, 0.06)
    assert robot["firmware"]["counts_per_revolution"] == 1000
    asked.clear()
    init(tmp_path / "other", defaults=True)
    assert asked == [], "on a terminal too"


def test_a_bad_day_has_lost_commands_and_a_push_of_a_twentieth_of_the_weight(
    tmp_path: Path, answers: dict[str, Any]
) -> None:
    written = begin(tmp_path / "new", answers)
    duration_s = load(written[SCENARIO_FILE]).loop.duration_s
    day = tomllib.loads(written["bad_day.hil.toml"].read_text("utf-8"))
    assert day["extends"] == SCENARIO_FILE
    middle_s = round(duration_s / 2.0, 1)
    push_n = float(f"{MASS_KG * 9.80665 / 20.0:.3g}")
    assert day["fault"] == [
        {"kind": "drop", "target": "command", "value": 1.0 / 50.0, "start_s": 1.0},
        {"kind": "push", "target": "force_x_n", "value": push_n, "start_s": middle_s, "end_s": middle_s + 0.2},
    ]
    assert day["expect"] == [{"signal": "error.planar_m", "after_fault": "push", "within_s": 2.0, "below": 0.05}]
    assert len(load(written["bad_day.hil.toml"]).fault) == 2
    tests = written[TESTS_FILE].read_text("utf-8")
    assert f'HEAVIER = {{"plant.start.mass_kg": {1.2 * MASS_KG:g}}}' in tests
    assert written[WORKFLOW] == tmp_path / "new" / WORKFLOW, "where there is no repository"
    assert "runs/" in written[".gitignore"].read_text("utf-8").splitlines()
    assert "class MyLaw" in written["my_law.py"].read_text("utf-8")


def test_a_bad_days_push_is_in_the_middle() -> None:
    (_, push) = tomllib.loads(init_command.bad_day_text(200.0, 12.66))["fault"]
    assert (push["value"], push["start_s"], push["end_s"]) == (98.1, 6.3, 6.5)


def test_a_circle_is_made_slower_by_quarters_until_the_robot_can_follow_it(
    monkeypatch: pytest.MonkeyPatch, answers: dict[str, Any]
) -> None:
    tried: list[float] = []
    most = 3

    def scenario_text(given: dict[str, Any], slowness: float) -> str:
        assert given is answers
        tried.append(slowness)
        return 'extends = "circle_speed"\n' + f"# {len(tried)}\n"

    monkeypatch.setattr(new_robot, "scenario_text", scenario_text)
    monkeypatch.setattr(
        assembly, "check_scenario", lambda _: SimpleNamespace(sentences=() if len(tried) > most else ("too fast",))
    )
    assert init_command._feasible(answers).endswith("# 4\n")
    assert tried == [1.0, 1.25, 1.25**2, 1.25**3]
    tried.clear()
    most = 100
    with pytest.raises(BadInputError) as none:
        init_command._feasible(answers)
    torque, speed = answers["robot.torque_limit_n_m"], answers["robot.speed_limit_rad_s"]
    assert str(none.value) == (
        f"no circle is slow enough for a torque limit of {torque} N·m and a speed limit of {speed} rad/s; check these "
        "and the mass"
    )
    assert len(tried) == 40


def test_a_baseline_is_of_the_scenarios_seed_and_the_two_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path := tmp_path / "mine.toml").write_text('extends = "circle_speed"\nloop.seed = 7\nexpect = []\n')
    kept: list[bool] = []

    def run_scenario(scenario: Any, options: Any) -> Any:
        kept.append(options.keep_signals)
        return SimpleNamespace(passed=True, run=("run", scenario.loop.seed))

    monkeypatch.setattr(assembly, "run_scenario", run_scenario)
    monkeypatch.setattr(baselines, "baseline_of", lambda scenario, runs: (scenario.loop.seed, runs))
    monkeypatch.setattr("hil.scenario.baseline.text_of", str)
    init_command._write_baseline(path)
    written = (tmp_path / "mine.baseline.toml").read_text("utf-8")
    assert written == str((7, {seed: ("run", seed) for seed in (7, 8, 9)}))
    assert kept == [False] * 3


@pytest.mark.parametrize(("owner", "is_set"), [("OWNER", False), ("OWNERS", True), ("somebody", True)])
def test_the_action_is_that_of_the_packages_repository(
    monkeypatch: pytest.MonkeyPatch, owner: str, is_set: bool
) -> None:
    urls = ["Documentation, https://example.org/a, b", f"Repository, https://github.com/{owner}/mecanum-hil"]
    monkeypatch.setattr("importlib.metadata.metadata", lambda _: SimpleNamespace(get_all={"Project-URL": urls}.get))
    monkeypatch.setattr(init_command, "__version__", "1.2.3")
    assert init_command.action() == f"{owner}/mecanum-hil/tools/action@v1.2.3"
    assert init_command.is_address_set() is is_set
