"""What ``hil run``, ``hil check`` and ``hil params`` hand on of what is typed, and what they print; nothing runs."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hil.core.errors import DeviceError, HilError, LinkError
from hil.record.files import Rotation
from hil.references import Feasibility
from hil.references.feasibility import Requirement
from hil.runtime import assembly
from hil.runtime.robots import firmware_values
from hil.runtime.run_options import RunOptions
from hil.scenario import Scenario, load
from tests.support.processes import hil


class Asked:
    """In the place of a run: keeps what it is asked for, and ends as it is told."""

    def __init__(self, end: BaseException) -> None:
        self.end = end
        self.scenario: Any = None
        self.options: Any = None

    def __call__(self, scenario: Scenario, options: RunOptions) -> None:
        self.scenario, self.options = scenario, options
        if self.options.record is not None and self.options.record.parent.is_dir():
            self.options.record.touch()
        raise self.end


def asked(monkeypatch: pytest.MonkeyPatch, end: BaseException) -> Asked:
    run = Asked(end)
    monkeypatch.setattr(assembly, "run_scenario", run)

    @contextlib.contextmanager
    def recorder(suffix: str, *, live: bool) -> Iterator[tuple[str, bool]]:
        yield suffix, live

    monkeypatch.setattr("hil.record.recording.early_recorder", recorder)
    return run


def test_a_run_is_asked_for_what_is_typed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run = asked(monkeypatch, DeviceError("enough"))
    done = hil("run", "circle_speed", "--record", "none", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (3, "", "hil: enough\n")
    options = run.options
    nothing = (options.truth, options.record, options.trace, options.live_port, options.watch, options.linger)
    assert nothing == (None,) * 6
    assert (options.allow_motion, options.lenient, options.keep_signals, options.existing) == (
        False,
        False,
        False,
        "refuse",
    )
    assert (options.on_stuck, options.make_recording) == (None, None)
    words = ["--record", "a.mcap", "--truth", "tcp://127.0.0.1:7", "--rotate", "2MB", "--trace", "b.blf", "--force"]
    words += ["--allow-motion", "--lenient", "--seed", "7", "--set", "robot.mass_kg=21.0", "--mode", "realtime"]
    hil("run", "circle_speed", *words, cwd=tmp_path)
    options = run.options
    assert (options.truth, options.record, options.trace) == ("tcp://127.0.0.1:7", Path("a.mcap"), Path("b.blf"))
    assert (options.allow_motion, options.lenient, options.existing) == (True, True, "replace")
    assert options.make_recording == (".mcap", False)
    assert options.rotate == Rotation(size_bytes=2_000_000)
    scenario = run.scenario
    assert (scenario.loop.seed, scenario.robot.mass_kg, scenario.loop.mode) == (7, 21.0, "realtime")


def test_a_recording_without_a_name_is_numbered_and_one_with_a_name_is_not_replaced(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = asked(monkeypatch, DeviceError("enough"))
    hil("run", "circle_speed", cwd=tmp_path)
    assert (run.options.existing, run.options.make_recording) == ("number", (".rrd", False))
    assert (run.options.record.parent.name, run.options.record.suffix) == ("runs", ".rrd")
    hil("run", "circle_speed", "--force", cwd=tmp_path)
    assert run.options.existing == "replace"
    hil("run", "circle_speed", "--record", "a.rrd", cwd=tmp_path)
    assert (run.options.existing, run.options.record) == ("refuse", Path("a.rrd"))


def test_live_viewers_are_served_without_a_recording_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run = asked(monkeypatch, DeviceError("enough"))
    monkeypatch.setattr("hil.record.viewing.live_hint", lambda port: f"look at {port}")
    monkeypatch.setattr("hil.record.viewing.part", lambda _: pytest.fail("stderr is no terminal"))
    done = hil("run", "circle_speed", "--record", "none", "--live", "--live-port", "9001", cwd=tmp_path)
    assert (run.options.live_port, run.options.make_recording) == (9001, (None, True))
    assert done.stderr == "look at 9001\nhil: enough\n"


@pytest.mark.parametrize("is_json", [False, True])
@pytest.mark.parametrize("record", ["a.rrd", "nowhere/a.rrd", "none"])
def test_a_run_that_is_interrupted_says_what_was_recorded(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, record: str, is_json: bool
) -> None:
    asked(monkeypatch, KeyboardInterrupt())
    done = hil("run", "circle_speed", "--record", record, *(["--json"] if is_json else []), cwd=tmp_path)
    more = "; recorded until then: a.rrd" if record == "a.rrd" else ""
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == f"hil: interrupted; the robot was told to stop{more}\n"


@pytest.mark.parametrize("error", [LinkError("gone"), DeviceError("hot")])
def test_json_has_the_failure_of_a_run_that_could_not_begin(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, error: HilError
) -> None:
    run = asked(monkeypatch, error)
    done = hil("run", "circle_speed", "--record", "none", "--json", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (3, f"hil: {error}\n")
    answer = json.loads(done.stdout)
    assert (answer["passed"], answer["failure"]) == (False, str(error))
    assert run.options.on_stuck is not None, "a law that is stuck ends the process, which is then told in JSON too"


# ------------------------------------------------------------------------------------------------- check

SPEED = Requirement("rad/s", 20.0, 12.34567, "fr", 1.23456, None, None, None)
TORQUE = Requirement("N·m", 5.0, 5.0004, "rl", 2.5, 5.0004, "rl", 2.5)


def test_check_tells_each_scenario_by_its_name_and_fails_where_one_cannot_be_followed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def feasible(scenario: Scenario) -> Feasibility:
        return Feasibility(SPEED, TORQUE if scenario.name == "hard" else SPEED, None, 1.0)

    monkeypatch.setattr(assembly, "check_scenario", feasible)
    monkeypatch.setattr("hil.runtime.robots.check_plant", lambda _: None)
    fault = '[[fault]]\nkind = "push"\ntarget = "force_x_n"\nvalue = 9.0\nstart_s = 99.0\n'
    texts = {"easy": "", "hard": "", "late": fault}
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(f'extends = "circle_speed"\n{text}')
    one = hil("check", "easy.toml", cwd=tmp_path)
    assert one.returncode == 0
    first, second, *_ = one.stdout.splitlines()
    assert first == f"  {'wheel speed':<22} at most 12.3 rad/s, of wheel fr at t = 1.23 s; the limit is 20 rad/s"
    assert second.startswith("  wheel torque ")
    assert "easy.toml" not in one.stdout
    two = hil("check", "easy.toml", "hard.toml", cwd=tmp_path)
    assert two.returncode == 1
    lines = two.stdout.splitlines()
    assert [line for line in lines if not line.startswith("  ")] == ["easy.toml", "hard.toml"]
    torque = f"  {'wheel torque':<22} at most 5.0004 N·m, of wheel rl at t = 2.5 s; the limit is 5 N·m"
    assert torque in lines[lines.index("hard.toml") :]
    assert [line for line in lines if line.startswith("  not feasible ")]
    late = hil("check", "late.toml", cwd=tmp_path)
    assert late.returncode == 1
    (told,) = [line for line in late.stdout.splitlines() if line.startswith("  after the end ")]
    assert "late.toml:6: fault.1.start_s: the run ends at loop.duration_s = 15" in told
    alone = json.loads(hil("check", "easy.toml", "--json", cwd=tmp_path).stdout)
    both = json.loads(hil("check", "easy.toml", "late.toml", "--json", cwd=tmp_path).stdout)["scenarios"]
    assert both[0] == alone
    assert [one["scenario"] for one in both] == ["easy", "late"]
    assert [len(one["beyond_the_end"]) for one in both] == [0, 1]


# ------------------------------------------------------------------------------------------------- params


@pytest.fixture
def parameter_steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is done with a robot's parameters, in order."""
    done: list[str] = []

    class Client:
        def __init__(self, opened: object) -> None:
            done.append("open")

        def check(self, values: dict[str, float]) -> dict[str, float]:
            done.append("check")
            return values

        def write(self, values: dict[str, float]) -> None:
            done.extend(f"write {name}={value}" for name, value in values.items())

        def restore(self) -> None:
            done.append("restore")

        def store(self) -> None:
            done.append("store")

        def read(self) -> list[SimpleNamespace]:
            done.append("read")
            kind = SimpleNamespace(name="FLOAT")
            return [SimpleNamespace(name="ramp_s", type=kind, value=0.1234567891, minimum=0.0, maximum=2.5)]

        def greet(self) -> SimpleNamespace:
            return SimpleNamespace(describe=lambda: "a robot")

    @contextlib.contextmanager
    def held(url: object, command: str) -> Iterator[None]:
        done.append(command)
        yield
        done.append("free")

    line = SimpleNamespace(close=lambda: done.append("close"))
    url = SimpleNamespace(is_within_process=False, open_host=lambda: line)
    monkeypatch.setattr("hil.robot.parameters.ParameterClient", Client)
    monkeypatch.setattr("hil.wire.device_lock.device_held", held)
    monkeypatch.setattr("hil.wire.url.parse_link", lambda _: url)
    return done


def test_parameters_of_a_scenario_come_before_those_that_are_typed(parameter_steps: list[str], tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_text("[firmware]\nramp_s = 0.3\nwatchdog_s = 0.05\n")

    def written(*words: str) -> dict[str, float]:
        parameter_steps.clear()
        assert hil("params", "serial:/dev/ttyX", *words, cwd=tmp_path).returncode == 0
        pairs = [step.removeprefix("write ").split("=") for step in parameter_steps if step.startswith("write ")]
        return {name: float(value) for name, value in pairs}

    own = written("--scenario", "circle_speed")
    assert own == {name: float(value) for name, value in firmware_values(load("circle_speed")).items()}
    both = written("--scenario", "circle_speed", "--robot", "robot.toml")
    assert both == own | {"ramp_s": 0.3, "watchdog_s": 0.05}
    alone = written("--robot", "robot.toml", "ramp_s=0.4")
    assert (alone["ramp_s"], alone["watchdog_s"], alone.keys()) == (0.4, 0.05, own.keys())


@pytest.mark.parametrize(
    ("words", "steps"),
    [
        ((), ["read"]),
        (("ramp_s=0.2",), ["write ramp_s=0.2", "read"]),
        (("ramp_s=0.2", "--restore", "--store"), ["restore", "write ramp_s=0.2", "store", "read"]),
        (("--store",), ["store", "read"]),
    ],
)
def test_parameters_are_checked_before_any_changes_and_read_at_the_end(
    parameter_steps: list[str], words: tuple[str, ...], steps: list[str]
) -> None:
    shown = hil("params", "serial:/dev/ttyX", *words)
    assert parameter_steps == ["hil params serial:/dev/ttyX", "open", "check", *steps, "close", "free"]
    assert shown.stdout.splitlines() == [
        "parameter  type   value      range",
        "ramp_s     float  0.1234568  0 to 2.5",
        "a robot",
    ]
    assert json.loads(hil("params", "serial:/dev/ttyX", "--json").stdout) == {"ramp_s": 0.1234567891}
