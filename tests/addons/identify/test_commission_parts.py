"""Parts of commissioning by themselves: a tape, pulses on a mass, what is kept in the file, and who answers."""

import io
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import typer

from hil.addons.identify import identify_command
from hil.addons.identify.commission import commissioning
from hil.addons.identify.commission.commission_findings import Findings
from hil.addons.identify.commission.commission_session import Encoders, Record, Session
from hil.addons.identify.commission.person import Onlooker, Terminal
from hil.addons.identify.commission.pulses import StepError, expected_rad_s2, move, shake
from hil.addons.identify.commission.push import push
from hil.addons.identify.commission.wirings import Candidate, WheelSeen, named_direction, response
from hil.core.errors import RunInterruptedError
from hil.core.model import RobotModel
from hil.core.types import Pose
from hil.core.wheel_map import WheelMap, Wiring
from hil.robot.snapshot import Feedback
from hil.scenario.commission import CommissionTable
from hil.scenario.tables import DeviceTable
from tests.support.formula_drives import ROBOT, wheel_angles

WIRED = Candidate((3, 0, 1, 2), (1, -1, 1, -1), "x", 0)
INPUTS, SIGNS = (2, 0, 3, 1), (1, 1, -1, -1)


class Tape:
    """A real robot that is pushed by hand: its wheels turn as they roll, and its encoders are wired somehow.

    ``ways`` are where it goes at each push: forward [m], left [m], turned [rad], by the floor.
    """

    def __init__(self, ways: Sequence[Sequence[float]], counts: int = 4096, radius_m: float = 0.06,
                 lever_m: float = 0.41, sideways: float = 1.0) -> None:  # fmt: skip
        self.scenario = SimpleNamespace(robot=ROBOT, firmware=SimpleNamespace(counts_per_revolution=4096))
        self.bench = SimpleNamespace(local=None, truth=None)
        self.encoders = Encoders(INPUTS, SIGNS)
        self.asked: list[str] = []
        self._share = counts / 4096
        self._rolled = [wheel_angles(np.array([way]) / [1.0, sideways, 1.0], radius_m, lever_m)[0] for way in ways]
        self._turned = np.zeros(4)

    def listen_while(self, ask: Callable[[], None]) -> None:
        ask()

    def angles(self) -> tuple[float, ...]:
        return tuple(self._turned)

    def confirm(self, key: str, _: str) -> None:
        self.asked.append(key)
        rolled = self._rolled.pop(0) if self._rolled else np.zeros(4)
        for channel, (wheel, sign) in enumerate(zip(WIRED.wheels, WIRED.signs, strict=True)):
            self._turned[INPUTS[channel]] += SIGNS[channel] * sign * rolled[wheel] * self._share


class Reader:
    """A person who pushes and reads the tape."""

    def __init__(self, tape: Tape, *read: float | None) -> None:
        self._read, self.confirm = list(read), tape.confirm
        self.keys: list[str] = []

    def choose(self, key: str, question: str, choices: Sequence[str]) -> str:
        raise AssertionError(key)

    def measure(self, key: str, question: str) -> float | None:
        self.keys.append(key)
        assert question == ("How many turns?" if key == "pushed_turns" else "How far by the tape, in m?")
        return self._read.pop(0)


def pushed(tape: Tape, *read: float | None) -> tuple[Findings, list[str]]:
    said: list[str] = []
    findings = Findings(candidate=WIRED)
    push(cast(Session, tape), Reader(tape, *read), findings, said.append)
    return findings, said


@pytest.mark.parametrize(("counts", "sign"), [(4096, 1.0), (2048, -1.0), (16384, 1.0)])
def test_a_tape_gives_counts_radius_lever_and_the_scale_to_the_left(counts: int, sign: float) -> None:
    ways = [(sign * 0.8, 0.0, 0.0), (0.0, sign * 0.7, 0.0), (0.0, 0.0, sign * 2.0 * math.tau)]
    tape = Tape(ways, counts, radius_m=0.0615, lever_m=0.43, sideways=0.97)
    findings, said = pushed(tape, 0.8, 0.7, 2.0)
    expected = {"robot.wheel_radius_m": 0.0615, "robot.half_length_m": 0.24 * 0.43 / 0.41,
                "robot.half_width_m": 0.17 * 0.43 / 0.41}  # fmt: skip
    if counts != 4096:
        expected["firmware.counts_per_revolution"] = counts
    assert findings.values == pytest.approx(expected, rel=2e-5)
    assert findings.table.lateral_scale == pytest.approx(0.97, rel=2e-5)
    assert said[0] == f"wheel radius 0.0615 m, {counts} counts a turn of a wheel"
    assert said[1].startswith("to the left the robot goes 0.970 times as far as its wheels say (commission.lateral_")
    assert said[-1] == "half length and half width together 0.4300 m"
    assert tape.asked == ["push_forward", "push_left", "push_turns"]


def test_pushes_that_are_left_out_leave_what_was_believed() -> None:
    ways = [(0.8, 0.0, 0.0), (0.0, 0.7, 0.0), (0.0, 0.0, math.tau)]
    findings, said = pushed(Tape(ways), None)
    assert (findings.values, said) == ({}, ["left out: the wheel radius and the counts stay as they were believed"])
    findings, _ = pushed(Tape(ways), 0.8, None, None)
    assert findings.values == pytest.approx({"robot.wheel_radius_m": 0.06})
    assert findings.table.lateral_scale is None


@pytest.mark.parametrize(
    ("tape", "read", "words"),
    [
        (Tape([(0.6, 0.0, 0.0)]), (0.4,), r"^by the wheels the robot went 0\.600 m, by the tape 0\.400 m: .* of 1\.50"),
        (Tape([(0.049, 0.0, 0.0)]), (0.5,), "^the encoders hardly saw the robot move; were the wheels on the floor"),
        (
            Tape([(0.6, 0.0, 0.0), (0.0, 0.6, 0.0), (0.0, 0.0, math.tau)], lever_m=0.34),
            (0.6, 0.6, 1.0),
            r"^the robot turned 1\.000 times and its wheels say 0\.829: look at robot.half_length_m and",
        ),
    ],
)  # fmt: skip
def test_wheels_and_tape_that_do_not_go_together_are_told(tape: Tape, read: tuple[float, ...], words: str) -> None:
    if len(read) == 3:
        findings, _ = pushed(Tape([(0.6, 0.0, 0.0), (0.0, 0.6, 0.0), (0.0, 0.0, math.tau)], lever_m=0.35), *read)
        assert findings.values["robot.half_length_m"] == pytest.approx(0.24 * 0.35 / 0.41, rel=2e-5)
    with pytest.raises(StepError, match=words):
        pushed(tape, *read)


@pytest.mark.parametrize(
    ("ratio", "counts"),
    [(1.07, 4096), (1.09, None), (0.93, 4096), (0.91, None), (2.1, 8192), (8.0, 32768), (15.9, None), (1 / 1024, None)],
)
def test_counts_are_the_usual_ones_within_eight_percent(ratio: float, counts: int | None) -> None:
    tape = Tape([(1.0, 0.0, 0.0)], round(4096 * 1000 * ratio) / 1000)  # type: ignore[arg-type]
    if counts is None:
        with pytest.raises(StepError, match=r"no usual encoder|hardly saw"):
            pushed(tape, 1.0, None, None)
    else:
        assert pushed(tape, 1.0, None, None)[0].values.get("firmware.counts_per_revolution", 4096) == counts


# Pulses on a mass


class Mass:
    """A robot on the floor whose motors, IMU and encoders are ideal, and late by some periods."""

    def __init__(self, late: int, friction: float = 0.0) -> None:
        firmware = SimpleNamespace(counts_per_revolution=4096, torque_constant_n_m_a=1.3)
        self.scenario, self.torque_limit_n_m, self.period_s = (
            SimpleNamespace(robot=ROBOT, firmware=firmware),
            2.0,
            0.005,
        )
        self.encoders, self.late, self.friction, self.torques = Encoders(INPUTS, SIGNS), late, friction, list[float]()

    def rest(self) -> None:
        """It stands anyway."""

    def drive(self, command: Callable[..., Sequence[float]], seconds: float, **_: float) -> Record:
        rows = round(seconds / self.period_s)
        time_s = np.arange(rows) * self.period_s
        torque = np.array([command(t, cast(Feedback, None)) for t in time_s])
        self.torques.append(float(np.abs(torque).max()))
        body, rims = response(ROBOT, "x")
        by_wheel = np.zeros((rows, 4))
        for channel, (wheel, sign) in enumerate(zip(WIRED.wheels, WIRED.signs, strict=True)):
            by_wheel[:, wheel] += sign * np.where(np.abs(torque[:, channel]) > self.friction, torque[:, channel], 0.0)
        late = np.concatenate([np.zeros((self.late, 4)), by_wheel[: rows - self.late]])
        motion, turning = late @ body, late @ rims / ROBOT.wheel_radius_m
        speed = (np.cumsum(turning, axis=0) - 0.5 * turning) * self.period_s
        angle = np.cumsum(speed, axis=0) * self.period_s
        by_input = [np.zeros((rows, 4)), np.zeros((rows, 4))]
        for channel, (wheel, sign) in enumerate(zip(WIRED.wheels, WIRED.signs, strict=True)):
            for one, series in zip(by_input, (speed, angle), strict=True):
                one[:, INPUTS[channel]] = SIGNS[channel] * sign * series[:, wheel]
        yaw_rate = (np.cumsum(motion[:, 2]) - 0.5 * motion[:, 2]) * self.period_s
        acceleration = np.column_stack([motion[:, :2], np.full(rows, 9.81)]) + np.array([0.1, -0.2, 0.0])
        return Record(time_s, torque, by_input[1], by_input[0], torque / 1.3, acceleration, yaw_rate + 0.02, False)


@pytest.mark.parametrize("late", [0, 4, 11])
@pytest.mark.parametrize("channel", range(4))
def test_a_pulse_tells_what_one_newton_metre_does_whatever_the_delay(channel: int, late: int) -> None:
    mass = Mass(late)
    session = cast(Session, mass)
    found = shake(session, [float(one == channel) for one in range(4)], expected_rad_s2(session))
    body, rims = response(ROBOT, "x")
    wheel, sign = WIRED.wheels[channel], WIRED.signs[channel]
    assert found.acceleration_m_s2 == pytest.approx([*(sign * body[wheel, :2]), 0.0], abs=1e-9)
    assert found.yaw_rad_s2 == pytest.approx(sign * body[wheel, 2])
    seen = session.encoders.of_motors(list(found.wheels_rad_s2))
    expected = [
        sign * other * rims[wheel, there] / ROBOT.wheel_radius_m
        for there, other in zip(WIRED.wheels, WIRED.signs, strict=True)
    ]
    assert seen == pytest.approx(expected, rel=1e-6)
    # 2.5 rad/s of the driven wheel in 0.15 s.
    assert mass.torques == pytest.approx([2.5 / 0.15 / expected_rad_s2(session)])
    assert expected_rad_s2(session) == pytest.approx(rims[0, 0] / ROBOT.wheel_radius_m)


def test_a_pulse_grows_by_half_until_the_wheels_turn_or_the_limit_is_reached() -> None:
    session = cast(Session, Mass(0, friction=0.9))
    with_friction = cast(Mass, session)
    shake(session, [1.0, 0.0, 0.0, 0.0], expected_rad_s2(session))
    first = 2.5 / 0.15 / expected_rad_s2(session)
    grown = [first * 1.5**number for number in range(len(with_friction.torques))]
    assert with_friction.torques == pytest.approx(grown)
    assert grown[-1] > 0.9 > grown[-2]
    stuck = Mass(0, friction=3.0)
    with pytest.raises(StepError, match=r"^the wheels do not turn with 2 N·m on the floor, the limit: look at robot"):
        shake(cast(Session, stuck), [1.0, 0.0, 0.0, 0.0], expected_rad_s2(session))
    assert stuck.torques[-1] == 2.0


class Spinning(Mass):
    """A robot with a wheel that does not touch the floor: each drive is cut before the robot has moved."""

    def drive(self, command: Callable[..., Sequence[float]], seconds: float, **_: float) -> Record:
        self.torques.append(max(command(0.0, SimpleNamespace(speed_rad_s=(0.0,) * 4))))
        each = np.zeros((2, 4))
        return Record(np.zeros(2), each, each, each, each, np.zeros((2, 3)), np.zeros(2), True)


def test_a_robot_whose_wheels_spin_is_not_moved_with_more_torque() -> None:
    spinning = Spinning(0)
    with pytest.raises(StepError, match=r"^the robot does not move with 0\.14 N·m on each wheel"):
        move(cast(Session, spinning), [1.0] * 4)
    assert len(spinning.torques) == 1


# What is kept


def test_what_is_kept_in_the_file_is_what_was_found() -> None:
    findings = Findings()
    assert findings.told is None
    assert findings.encoders.inputs == [None] * 4
    findings.saw(Encoders(INPUTS, SIGNS), "rl", "backward")
    assert (findings.table.encoders, findings.table.encoder_signs) == ((3, 1, 4, 2), SIGNS)
    assert findings.told == WheelSeen(0, 3, -1)
    assert (findings.encoders.inputs, findings.encoders.signs) == (list(INPUTS), list(SIGNS))
    findings.decided(WIRED._replace(rollers="o"), ("-y", "x", "z"))
    assert findings.table.todo == (
        "the encoder of rl, motor output 1, is at input 3: connect it to 1",
        "the encoder of fl, motor output 2, is at input 1: connect it to 2",
        "the encoder of fr, motor output 3, is at input 4: connect it to 3",
        "the encoder of fr counts against its motor: exchange its lines A and B",
        "the encoder of rr, motor output 4, is at input 2: connect it to 4",
        "the encoder of rr counts against its motor: exchange its lines A and B",
        "the rollers form an O, seen from above, and the bridge drives an X: exchange the left and the right wheel of "
        "each axle",
    )
    findings.finish("floor", "2026-01-02", "wheel 1.0")
    document = findings.document()
    assert document["device.wheels"] == ("rl", "fl", "fr", "rr")
    assert document["device.reversed"] == ("fl", "rr")
    assert (document["device.imu"], findings.imu) == (("-y", "x", "z"),) * 2
    assert [document[f"commission.{name}"] for name in ("state", "steps", "date", "firmware", "rollers")] == [
        "rewire", ("floor",), "2026-01-02", "wheel 1.0", "o"
    ]  # fmt: skip
    assert document["commission.lateral_scale"] is None


def test_a_robot_is_done_with_its_last_step() -> None:
    findings = Findings()
    for step, state in (("blocks", "begun"), ("floor", "begun"), ("check", "begun"), ("push", "done")):
        findings.finish(step, "2026-01-02", "")
        assert (findings.table.state, findings.table.firmware) == (state, None)
    assert findings.table.steps == ("blocks", "floor", "check", "push")


def test_findings_of_a_robot_that_was_begun_are_taken_up_and_others_are_not() -> None:
    device = DeviceTable(wheels=("rl", "fl", "fr", "rr"), reversed=("fl", "rr"), imu=("-y", "x", "z"))
    begun = CommissionTable("begun", steps=("blocks", "floor"), rollers="x", encoders=(3, 1, 4, 2), encoder_signs=SIGNS)
    kept = Findings.kept(begun, device)
    assert (kept.candidate, kept.table, kept.imu) == (WIRED, begun, ("-y", "x", "z"))
    assert kept.encoders.inputs == list(INPUTS)
    assert Findings.kept(replace(begun, steps=("blocks",)), device).candidate is None
    for state in ("none", "rewire", "done"):
        other = Findings.kept(replace(begun, state=state), device)  # type: ignore[arg-type]
        assert (other.candidate, other.table.steps, other.imu) == (None, (), ("-y", "x", "z"))


# Who answers


def test_a_terminal_asks_until_the_answer_is_one(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    def typed(*lines: str) -> Terminal:
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        return Terminal()

    assert typed("up", " LEFT ").choose("way", "Where to?", ("left", "right")) == "left"
    assert capsys.readouterr().err.endswith("'up': expected one of left, right\nWhere to? (left, right): ")
    assert typed("far", "0", "-1", "0,75").measure("way", "How far?") == 0.75
    assert capsys.readouterr().err.count("expected a number above 0") == 3
    assert typed("").measure("way", "How far?") is None
    for answer in ("y", "YES"):
        typed(answer).confirm("floor", "Put it there.")
    for answer in ("no", "yep"):
        with pytest.raises(RunInterruptedError, match=r"^stopped before the step floor; nothing was moved for it"):
            typed(answer).confirm("floor", "Put it there.")
    with pytest.raises(RunInterruptedError, match=r"^the input has ended"):
        typed().measure("way", "How far?")


@pytest.mark.parametrize("heading_rad", [0.0, 1.2, -2.5])
@pytest.mark.parametrize(
    ("moved", "seen"),
    [
        ((0.1, 0.02, 0.0), "forward"), ((-0.1, 0.02, 0.0), "backward"), ((0.02, 0.1, 0.0), "left"),
        ((0.02, -0.1, 0.1), "right"), ((0.01, 0.0, 0.3), "turned left"), ((0.0, 0.05, -0.3), "turned right"),
        ((0.1, 0.0, 0.45), "forward"),
    ],
)  # fmt: skip
def test_an_onlooker_sees_where_a_robot_moved_in_its_own_frame(
    moved: tuple[float, float, float], seen: str, heading_rad: float
) -> None:
    at = [Pose(1.0, 2.0, heading_rad)]
    wiring = Wiring.of(WheelMap(("rr", "fl", "fr", "rl"), ("rr",)))
    onlooker = Onlooker(wiring, lambda: at[0])
    assert onlooker.choose("first_wheel", "", ()) == "rr"
    assert onlooker.choose("first_way", "", ()) == "backward"
    ahead = (moved[0] + 1j * moved[1]) * np.exp(1j * heading_rad)
    at[0] = Pose(1.0 + ahead.real, 2.0 + ahead.imag, heading_rad + moved[2])
    assert onlooker.choose("moved_1", "", ()) == seen
    assert onlooker.measure("pushed_forward_m", "") == pytest.approx(math.hypot(moved[0], moved[1]))
    assert onlooker.measure("pushed_turns", "") == pytest.approx(abs(moved[2]) / math.tau)
    onlooker.confirm("next", "")
    assert onlooker.measure("pushed_left_m", "") == 0.0


def test_directions_are_named_by_their_largest_part() -> None:
    for parts, name in (((0.0, 0.0, -0.1), "turned right"), ((-0.3, 0.2, 0.25), "backward"), ((0.1, 0.2, 0.1), "left")):
        assert named_direction(parts) == name


def test_the_response_of_a_wheel_has_the_inertia_of_all() -> None:
    """By Lagrange's equations of a free body that four rims of inertia J / r² follow."""
    model = RobotModel(14.0, 0.7, 0.06, 0.24, 0.17, 0.004, torque_limit_n_m=1.0, speed_limit_rad_s=9.0)
    for rollers, lever_m in (("x", 0.41), ("o", 0.07)):
        body, rims = response(model, rollers)  # type: ignore[arg-type]
        k = 4.0 * 0.004 / 0.06**2
        assert np.abs(body) == pytest.approx(
            np.tile([1.0 / (14.0 + k), 1.0 / (14.0 + k), lever_m / (0.7 + k * lever_m**2)], (4, 1)) / 0.06
        )
        assert rims == pytest.approx(rims.T)
        assert np.diag(rims) == pytest.approx(2.0 / 0.06 / (14.0 + k) + lever_m**2 / 0.06 / (0.7 + k * lever_m**2))


# What the command prints


@pytest.mark.parametrize(
    ("state", "todo", "values", "lines", "code"),
    [
        ("done", (), {"device.wheels": ("fl", "fr", "rr", "rl")}, ["mine.toml: state done"], 0),
        (
            "rewire",
            ("exchange A and B", "connect it to 2"),
            {"firmware.counts_per_revolution": 2048},
            [
                "mine.toml: state rewire", "to do: exchange A and B", "to do: connect it to 2",
                "then commission the robot again, with the same command",
                "our firmware holds some of these values too: hil params LINK NAME=VALUE --store",
            ],
            1,
        ),
        (
            "begun",
            (),
            {"robot.wheel_radius_m": 0.06},
            [
                "mine.toml: state begun",
                "our firmware holds some of these values too: hil params LINK NAME=VALUE --store",
            ],
            1,
        ),
    ],
)  # fmt: skip
def test_the_command_prints_the_state_and_what_is_left_to_do(
    state: str, todo: tuple[str, ...], values: dict[str, object], lines: list[str], code: int,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").touch()
    table = CommissionTable(state, steps=("blocks",), todo=todo)  # type: ignore[arg-type]
    done = commissioning.Commissioned(table, values, 0.1, 2.0)
    monkeypatch.setattr(commissioning, "commission", lambda *_, **__: done)
    monkeypatch.setattr(identify_command, "end_in_order", lambda: None)
    for as_json in (False, True):
        with pytest.raises(typer.Exit) as ended:
            identify_command.commission(Path("mine.toml"), as_json=as_json)
        assert ended.value.exit_code == code
        out = capsys.readouterr().out
        if as_json:
            found = json.loads(out)
            assert (found["state"], found["steps"], found["todo"]) == (state, ["blocks"], list(todo))
            assert list(found["found"]) == list(values)
        else:
            assert out.splitlines() == lines
