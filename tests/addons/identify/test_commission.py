"""``hil commission``: robots of unknown wiring through the whole bridge, failures, and the written files."""

import io
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil.addons.identify.commission.commissioning
from hil.addons.identify.commission.commission_session import Record, Session
from hil.addons.identify.commission.commissioning import changed, commission
from hil.addons.identify.commission.person import Person, Terminal
from hil.addons.identify.commission.pulses import StepError
from hil.core.errors import BadInputError, DeviceError, LinkError, RunInterruptedError
from hil.scenario import load
from hil.scenario.commission import CommissionTable, require_commissioned
from tests.support.processes import HIL, device, environment, hil_process
from tests.support.processes import hil as run_hil
from tools.commission_wirings import found_right, hidden, robot_file, tried

NOISE = [
    "plant.start.gyro_noise_rad_s=0.01",
    "plant.start.gyro_bias_z_rad_s=0.02",
    "plant.start.accelerometer_noise_m_s2=0.1",
    "plant.start.accelerometer_bias_x_m_s2=0.1",
]
WIRED = ['plant.wiring.wheels=["rl","fl","fr","rr"]', 'plant.wiring.reversed=["fl"]', 'plant.wiring.imu=["-y","x","z"]']


def the_table(file: Path) -> dict[str, Any]:
    return tomllib.loads(file.read_text(encoding="utf-8")).get("commission", {})


@pytest.mark.parametrize(
    ("driver", "plant", "seed", "further"),
    [
        ("stm32", "rigid", 101, NOISE),
        ("stm32", "slip", 24, NOISE),
        ("stm32", "rigid", 29, ()),
        ("stm32", "MuJoCo", 104, ()),
        ("odrive", "rigid", 105, ()),
        ("c620", "slip", 106, ()),
        ("vesc", "rigid", 107, ()),
        ("moteus", "slip", 108, ()),
    ],
)
def test_a_random_wiring_is_found_as_it_is(driver: str, plant: str, seed: int, further: Sequence[str]) -> None:
    if plant == "MuJoCo":
        pytest.importorskip("mujoco")
    outcome = tried(driver, plant, seed, further)
    assert outcome.problem is None
    assert outcome.furthest_m <= 0.1
    assert outcome.fastest_rad_s < 20.0  # robot.speed_limit_rad_s


def test_counts_radius_and_lever_are_found_by_pushing_and_written_with_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, said, drives = robot_file(tmp_path), list[str](), list[Record]()
    record = Session._record

    def noted(session: Session, *rows: Any, **cut: Any) -> Record:
        drives.append(record(session, *rows, **cut))
        return drives[-1]

    monkeypatch.setattr(Session, "_record", noted)
    before = file.read_text(encoding="utf-8")
    true = [
        "plant.start.counts_per_revolution=2048",
        "plant.start.wheel_radius_m=0.0735",
        "plant.start.half_width_m=0.2",
    ]
    done = commission(file, sets=[*WIRED, *true], say=said.append)
    text = file.read_text(encoding="utf-8")
    written = tomllib.loads(text)
    assert done.table.state == written["commission"]["state"] == "done"
    assert written["commission"]["virtual"], "the real robot is not commissioned by that"
    assert written["commission"]["steps"] == ["blocks", "floor", "check", "push"]
    assert written["device"]["wheels"] == ["rl", "fl", "fr", "rr"]
    assert written["device"]["reversed"] == ["fl"]
    assert written["device"]["imu"] == ["-y", "x", "z"]
    assert written["firmware"]["counts_per_revolution"] == 2048
    robot = written["robot"]
    assert robot["wheel_radius_m"] == pytest.approx(0.0735, rel=0.002)
    assert robot["half_length_m"] == pytest.approx(0.3 * 0.5 / 0.52, rel=0.01)
    assert robot["half_width_m"] == pytest.approx(0.22 * 0.5 / 0.52, rel=0.01)
    driven = [one for one in drives if one.torque_n_m.any()]
    way_cm = 7.5 * max(np.abs(one.turned_rad).max() for one in driven)
    speed = max(np.abs(one.speed_rad_s).max() for one in driven)
    furthest = f"the furthest way of a wheel's rim in a pulse was {way_cm:.1f} cm"
    assert said[-1] == f"{furthest}, the largest speed of a wheel {speed:.1f} rad/s"
    assert written["commission"]["lateral_scale"] == pytest.approx(1.0, abs=0.005)
    assert re.findall(r"# .*", text) == re.findall(r"# .*", before)
    assert load("circle_speed", robot=file).device.imu == ("-y", "x", "z")
    with pytest.raises(BadInputError, match=r"this robot is commissioned .*--anew"):
        commission(file)


def test_what_has_to_be_rewired_is_said_and_the_next_try_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = robot_file(tmp_path)
    done = commission(file, sets=['plant.wiring.encoders_reversed=["fr"]', "plant.start.rollers=2"])
    assert done.table.state == "rewire"
    assert any(
        "the encoder of fr counts against its motor: exchange its lines A and B" in one for one in done.table.todo
    )
    assert any("exchange the left and the right wheel" in one for one in done.table.todo)
    assert "push" not in done.table.steps
    assert the_table(file)["todo"]
    before(monkeypatch, "blocks", lambda _: stop())
    with pytest.raises(RunInterruptedError):
        commission(file)
    assert the_table(file) == {"state": "begun", "virtual": True}


class Doing:
    """A person as the onlooker, who does something before agreeing to a step."""

    def __init__(self, inner: Person, key: str, action: Callable[[], None]) -> None:
        self._inner, self._key, self._action = inner, key, action

    def confirm(self, key: str, sentence: str) -> None:
        if key == self._key:
            self._action()
        self._inner.confirm(key, sentence)

    def choose(self, key: str, question: str, choices: Sequence[str]) -> str:
        return self._inner.choose(key, question, choices)

    def measure(self, key: str, question: str) -> float | None:
        return self._inner.measure(key, question)


def before(monkeypatch: pytest.MonkeyPatch, key: str, action: Callable[[Session], None]) -> None:
    """Have something done to the session before a step."""
    person = hil.addons.identify.commission.commissioning._person

    def doing(session: Session) -> Person:
        return Doing(person(session), key, lambda: action(session))

    monkeypatch.setattr(hil.addons.identify.commission.commissioning, "_person", doing)


def stop() -> None:
    raise RunInterruptedError("the person stops")


def test_it_goes_on_where_it_was_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = robot_file(tmp_path)
    with monkeypatch.context() as patch:
        before(patch, "floor", lambda _: stop())
        with pytest.raises(RunInterruptedError):
            commission(file, sets=WIRED)
    assert the_table(file)["state"] == "begun"
    assert the_table(file)["steps"] == ["blocks"]
    assert the_table(file)["first_wheel"] == "rl"
    assert tomllib.loads(file.read_text())["device"]["wheels"] == ["fl", "fr", "rr", "rl"]  # not found yet
    with monkeypatch.context() as patch:
        before(patch, "push_forward", lambda _: stop())
        with pytest.raises(RunInterruptedError):
            commission(file, sets=WIRED)
    assert the_table(file)["steps"] == ["blocks", "floor", "check"]
    said: list[str] = []
    done = commission(file, sets=WIRED, say=said.append)
    assert "blocks: done before" in said
    assert done.table.state == "done"
    assert tomllib.loads(file.read_text())["device"]["wheels"] == ["rl", "fl", "fr", "rr"]


@pytest.mark.parametrize(
    ("changes", "words", "steps"),
    [
        (["plant.start.friction_coefficient=2"], "draws its current, but no encoder turns: its wheel is blocked", None),
        (["plant.start.motor_constant_n_m_a=1000"], "its current sensor shows nothing: it is dead", None),
        (
            ["plant.start.friction_coefficient=2", "plant.start.motor_constant_n_m_a=1000"],
            "draws no current and turns nothing: look at the cable of its motor",
            None,
        ),
        (
            ['plant.start.contact="slip"', "plant.start.grip_coefficient=0.01", "plant.start.friction_coefficient=0"],
            "the wheels slip or spin before the robot moves",
            ["blocks"],
        ),
        (["plant.start.slope_rad=0.1"], "put the robot where the floor does not slope", None),
        (["plant.start.slope_rad=0.6", "plant.start.friction_coefficient=2"], "none of its axes is upright", None),
    ],
    ids=["blocked", "dead current sensor", "dead motor", "slippery", "slope", "IMU askew"],
)
def test_each_failure_is_one_sentence_and_nothing_is_written_that_was_not_found(
    tmp_path: Path, changes: list[str], words: str, steps: list[str] | None
) -> None:
    file = robot_file(tmp_path)
    before = tomllib.loads(file.read_text(encoding="utf-8"))
    with pytest.raises(StepError, match=words) as failed:
        commission(file, sets=[*WIRED, *changes])
    assert failed.value.exit_code == 1
    assert "\n" not in str(failed.value)
    after = tomllib.loads(file.read_text(encoding="utf-8"))
    table = after.pop("commission")
    assert table["state"] == "begun"
    assert table.get("steps") == steps
    assert after == before


def test_a_gyro_that_is_not_mounted_as_the_accelerometer_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = Session._record

    def upside_down(session: Session, *arguments: Any, **options: Any) -> Any:
        seen = record(session, *arguments, **options)
        return seen._replace(yaw_rate_rad_s=-seen.yaw_rate_rad_s)

    monkeypatch.setattr(Session, "_record", upside_down)
    file = robot_file(tmp_path)
    with pytest.raises(StepError, match=r"the gyro turns against .* it is not mounted as the accelerometer is"):
        commission(file, sets=WIRED)
    assert the_table(file)["steps"] == ["blocks"]
    assert tomllib.loads(file.read_text())["device"]["wheels"] == ["fl", "fr", "rr", "rl"]


def test_a_floor_that_slopes_against_where_the_robot_stood_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tilt(session: Session) -> None:
        assert session.bench.local is not None
        session.bench.local.set_variables({"slope_rad": 0.05})

    before(monkeypatch, "floor", tilt)
    with pytest.raises(StepError, match=r"the floor slopes by 2\.\d degrees"):
        commission(robot_file(tmp_path), sets=["plant.start.friction_coefficient=0.1"])


def test_a_lost_link_ends_it_and_the_drives_are_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sessions = []

    def cut(session: Session) -> None:
        sessions.append(session)
        drive = session.drive

        def cut_during(*arguments: Any, **options: Any) -> Any:
            local = session.bench.local
            assert local is not None
            local.link.close()
            return drive(*arguments, **options)

        monkeypatch.setattr(session, "drive", cut_during)

    before(monkeypatch, "floor", cut)
    file = robot_file(tmp_path)
    with pytest.raises((LinkError, DeviceError)) as lost:
        commission(file, sets=WIRED)
    assert lost.value.exit_code == 3
    assert the_table(file)["steps"] == ["blocks"]


def test_an_abort_during_a_pulse_switches_the_drives_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wheels are told to be free at once, by the protocol's e-stop: no brake closes a loop."""
    states = []

    def interrupted(session: Session) -> None:
        local, tick = session.bench.local, session._tick
        assert local is not None
        calls = iter(range(10**6))

        def tick_or_interrupt() -> Any:
            if next(calls) == 12:
                raise KeyboardInterrupt
            return tick()

        monkeypatch.setattr(session, "_tick", tick_or_interrupt)
        close = session.close

        def closed() -> None:
            session.bench.device.step(5)
            states.append(local.robot.node.look())
            close()

        monkeypatch.setattr(session, "close", closed)

    before(monkeypatch, "blocks", interrupted)
    with pytest.raises(KeyboardInterrupt):
        commission(robot_file(tmp_path), sets=WIRED)
    assert states[0].state.name == "ESTOP"
    assert states[0].torque_n_m == (0.0, 0.0, 0.0, 0.0)


def test_the_command_says_how_to_go_on_after_ctrl_c(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_: Session) -> None:
        raise KeyboardInterrupt

    before(monkeypatch, "blocks", interrupt)
    ran = run_hil("commission", robot_file(tmp_path))
    told = "hil: interrupted; the drives were told to switch off; go on with the same command\n"
    assert (ran.returncode, ran.stderr) == (130, told)


def test_nothing_of_the_firmware_closes_a_loop_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held = []

    def look(session: Session) -> None:
        firmware = session.scenario.firmware
        held.append((firmware.speed_kp_n_m_s_rad, firmware.speed_ki_n_m_rad, session.scenario.controller.command))
        stop()

    before(monkeypatch, "blocks", look)
    with pytest.raises(RunInterruptedError):
        commission(robot_file(tmp_path))
    assert held == [(0.0, 0.0, "torque")]
    with pytest.raises(BadInputError, match="gains"):
        commission(robot_file(tmp_path / "other"), sets=["firmware.speed_kp_n_m_s_rad=1"])


@pytest.mark.parametrize("driver", ["rosmaster", "wheeltec"])
def test_a_board_that_closes_its_loops_itself_is_not_taken_and_what_to_do_is_said(tmp_path: Path, driver: str) -> None:
    file = robot_file(tmp_path)
    before = file.read_text(encoding="utf-8")
    ran = run_hil("commission", str(file), "--set", f"device.driver={driver}")
    assert ran.returncode == 2
    assert f'device.driver = "{driver}": hil commission does not take it' in ran.stderr
    assert 'try it on blocks, and write state = "done" under [commission]' in ran.stderr
    assert file.read_text(encoding="utf-8") == before


# The person


ANSWERS = ("yes", "rl", "forward", "yes", "yes", "yes", "yes", "")
"""On blocks, the first wheel and its way, the others; on the floor; the check; a push that is left out."""


def typed(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    """Let a person type lines to all questions of a virtual robot."""
    monkeypatch.setattr(hil.addons.identify.commission.commissioning, "_person", lambda _: Terminal())
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))


def test_a_person_types_the_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    typed(monkeypatch, *ANSWERS[:1], "front", *ANSWERS[1:-1], "a metre", "-1", ANSWERS[-1])
    said: list[str] = []
    assert commission(robot_file(tmp_path), sets=WIRED, say=said.append).table.state == "done"
    assert any("wheels of the outputs: rl, fl, fr, rr" in sentence for sentence in said)
    assert any("left out" in sentence for sentence in said)
    asked = capsys.readouterr().err
    assert "'front': expected one of fl, fr, rr, rl, again" in asked
    assert asked.count("expected a number above 0") == 2


@pytest.mark.parametrize(
    ("answers", "words"),
    [((*ANSWERS[:4], "no"), "stopped before the step floor"), (ANSWERS[:2], "the input has ended")],
)
def test_answers_that_do_not_do_end_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answers: Sequence[str], words: str
) -> None:
    typed(monkeypatch, *answers)
    with pytest.raises(RunInterruptedError, match=words):
        commission(robot_file(tmp_path), sets=WIRED)


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    ran = run_hil("commission", str(tmp_path / "no.toml"))
    assert ran.returncode == 2
    assert "there is no such file; hil init writes one" in ran.stderr


# What the table does to other commands


@pytest.mark.parametrize("state", ["begun", "rewire"])
def test_a_robot_whose_commissioning_is_not_done_is_not_moved(tmp_path: Path, state: str) -> None:
    file = robot_file(tmp_path)
    file.write_text(changed(file.read_text(), {"commission.state": state, "link.url": "serial:/dev/ttyNone"}))
    base = ("run", "circle_speed", "--robot", str(file), "--mode", "realtime", "--record", "none", "--lenient")
    odometry = ("--set", "estimator.source=odometry", "--set", "loop.duration_s=0.1", "--allow-motion")
    refused = run_hil(*base, *odometry)
    assert refused.returncode == 2
    assert f'commission.state = "{state}"' in refused.stderr
    assert "--allow-motion is refused" in refused.stderr
    virtual = run_hil(*base[:4], "--link", "memory:", "--record", "none", "--lenient", "--set", "loop.duration_s=0.1")
    assert "refused" not in virtual.stderr


def test_a_real_robot_that_nobody_has_commissioned_is_warned_of() -> None:
    warning = require_commissioned(CommissionTable())
    assert warning is not None
    assert "nobody has commissioned this robot" in warning
    assert require_commissioned(CommissionTable("done")) is None
    for state in ("begun", "rewire", "done"):
        assert "only a virtual one in its place" in (require_commissioned(CommissionTable(state, virtual=True)) or "")


# The robot's file


def test_values_of_a_file_are_changed_and_everything_else_stays() -> None:
    table = '[device]\nwheels = [\n  "fl", "fr",\n  "rr", "rl",\n] # order\n\n'
    text = f'# mine\n{table}# about the link\n[link]\nurl = "memory:"\n'
    new = changed(
        text, {"device.wheels": ("rl", "fl", "fr", "rr"), "device.imu": ("x", "y", "z"), "commission.state": "done"}
    )
    assert tomllib.loads(new) == {
        "device": {"wheels": ["rl", "fl", "fr", "rr"], "imu": ["x", "y", "z"]},
        "link": {"url": "memory:"},
        "commission": {"state": "done"},
    }
    assert [comment in new for comment in ("# mine", "# order", "# about the link\n[link]")] == [True] * 3
    assert changed(new, {"commission.state": None, "device.imu": None}).count("imu") == 0
    with pytest.raises(BadInputError, match="not valid TOML"):
        changed("[device", {"device.imu": ("x", "y", "z")})
    with pytest.raises(BadInputError) as refused:
        changed("note = '''\n[device]\n'''\n", {"device.imu": ("x", "y", "z")}, "mine.toml")
    assert str(refused.value) == 'mine.toml: device.imu cannot be set to ["x", "y", "z"]; write it there yourself'


def test_the_tool_says_what_was_found_wrong() -> None:
    wired = hidden(3)
    values = {"device.wheels": wired.wheels[::-1], "device.reversed": wired.reversed, "device.imu": wired.imu}
    problem = found_right(wired, values, CommissionTable(rollers="x" if wired.rollers == "o" else "o"))
    assert problem is not None
    assert [word in problem for word in ("wheels: ", "rollers: ", "encoders: ", "imu: ")] == [True, True, True, False]


@pytest.mark.alone
@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals need a POSIX system")
def test_a_robot_at_a_serial_line_is_commissioned_in_real_time_and_its_gains_are_given_back(tmp_path: Path) -> None:
    """The steps on blocks alone: nobody can take a robot in another process from its blocks."""
    file, answers = robot_file(tmp_path), "\n".join((*ANSWERS[:4], "no", ""))
    lifted = [f"plant.start.wheel.{wheel}.lifted=1" for wheel in ("fl", "fr", "rr", "rl")]
    sets = [word for one in (*WIRED, *lifted) for word in ("--set", one)]
    with device("circle_speed", "--robot", str(file), "--mode", "realtime", "--link", "serial:pty", *sets) as robot:
        there = ("--link", robot.link)
        words = [*HIL, "commission", str(file), *there]
        ran = subprocess.run(words, input=answers, env=environment(), capture_output=True, text=True, check=False)
        params = hil_process("params", robot.link, "--json")
    assert ran.returncode == 130, ran.stderr
    assert "stopped before the step floor" in ran.stderr
    assert the_table(file)["steps"] == ["blocks"]
    assert the_table(file)["encoders"] == [1, 2, 3, 4]
    assert json.loads(params.stdout)["speed_kp_n_m_s_rad"] == pytest.approx(
        load("circle_speed", robot=file).firmware.speed_kp_n_m_s_rad
    )
