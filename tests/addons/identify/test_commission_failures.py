"""``hil commission``: the failures of its steps, provoked at a virtual robot, and the sentence that names each."""

import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil.addons.identify.commission.commissioning
from hil.addons.identify.commission.commission_session import Record, Session
from hil.addons.identify.commission.commissioning import changed, commission
from hil.addons.identify.commission.person import Onlooker, Person
from hil.addons.identify.commission.pulses import StepError
from hil.core.errors import DeviceError, RunInterruptedError
from hil.core.types import WHEEL_NAMES, Pose
from hil.faults.rows import NEVER_NS, FaultRow
from tests.addons.identify.test_commission import WIRED, Doing, before, stop, the_table
from tools.commission_wirings import robot_file

STEPS = ("blocks", "floor", "check", "push")
FOUND: dict[str, object] = {
    "device.wheels": ("rl", "fl", "fr", "rr"),
    "device.reversed": ("fl",),
    "device.imu": ("-y", "x", "z"),
    "commission.state": "begun",
    "commission.virtual": True,
    "commission.encoders": (1, 2, 3, 4),
    "commission.encoder_signs": (1, 1, 1, 1),
    "commission.first_wheel": "rl",
    "commission.first_way": "forward",
    "commission.rollers": "x",
}
"""What the steps on blocks and on the floor find of the robot of ``WIRED``."""
FREE = "plant.start.friction_coefficient=0"


def found_before(folder: Path, step: str, **changes: object) -> Path:
    """Return the file of a robot whose next step is ``step``; ``changes`` of its tables are wrong in it."""
    file = robot_file(folder)
    values = FOUND | {"commission.steps": STEPS[: STEPS.index(step)]}
    values |= {name.replace("__", "."): value for name, value in changes.items()}
    file.write_text(changed(file.read_text(encoding="utf-8"), values), encoding="utf-8")
    return file


def let_sensors_show(monkeypatch: pytest.MonkeyPatch, change: Callable[[Record], Record]) -> None:
    """Let the sensors of all drives show something else."""
    record = Session._record
    monkeypatch.setattr(
        Session, "_record", lambda session, rows, was_cut: change(record(session, rows, was_cut=was_cut))
    )


def put(**variables: float) -> Callable[[Session], None]:
    """Return what sets variables of the plant."""

    def set_variables(session: Session) -> None:
        assert session.bench.local is not None
        session.bench.local.set_variables({name.replace("__", "."): value for name, value in variables.items()})

    return set_variables


def break_down(kind: str, *wheels: str) -> Callable[[Session], None]:
    """Return what lets encoders or motors fail for good."""

    def fail(session: Session) -> None:
        local = session.bench.local
        assert local is not None
        local.arm([FaultRow(kind, "device", wheel, 0, NEVER_NS) for wheel in wheels])
        local.begin(0)

    return fail


def turned_back(seen: Record) -> Record:
    return seen._replace(yaw_rate_rad_s=-seen.yaw_rate_rad_s)


def on_one_wheel(seen: Record) -> Record:
    """Count what the second input counts at the first too."""
    turned = seen.turned_rad.copy()
    turned[:, 0] += turned[:, 1]
    turned[:, 1] = 0.0
    return seen._replace(turned_rad=turned)


def without_current(seen: Record) -> Record:
    return seen._replace(current_a=seen.current_a * np.nan)


def one_input_further(seen: Record) -> Record:
    return seen._replace(turned_rad=np.roll(seen.turned_rad, 1, axis=1))


@pytest.mark.parametrize(
    ("changes", "driven", "what"),
    [
        ({"device__imu": ("y", "-x", "z")}, "forward", "the IMU saw the robot go backward"),
        ({"device__imu": ("y", "x", "-z")}, "left", "the IMU saw the robot go right"),
        ({"commission__encoder_signs": (1, 1, -1, 1)}, "forward", "not every wheel turned as it should"),
        ({"commission__encoders": (1, 2, 4, 3)}, "left", "not every wheel turned as it should"),
        ({}, "turned left", "the IMU saw the robot go turned right"),
    ],
)  # fmt: skip
def test_the_check_before_motion_refuses_a_robot_that_is_not_as_its_file_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, object], driven: str, what: str
) -> None:
    if not changes:
        let_sensors_show(monkeypatch, turned_back)
    file, said = found_before(tmp_path, "check", **changes), list[str]()
    with pytest.raises(StepError, match=f"^driven {driven}, {what}: commission the robot anew$"):
        commission(file, sets=WIRED, say=said.append)
    passed = ("forward", "left", "turned left")[: ("forward", "left", "turned left").index(driven)]
    assert said[1:] == [
        "rest: nothing moves, the sensors are read for a second",
        "blocks: done before",
        "floor: done before",
        *(f"{direction}: all wheels turned as they should, and the IMU agrees" for direction in passed),
    ]
    assert the_table(file)["state"] == "begun"
    assert the_table(file)["steps"] == ["blocks", "floor"]


@pytest.mark.parametrize("kind", ["stuck_encoder", "dead_motor"])
def test_the_check_before_motion_refuses_a_wheel_that_stands_still(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    before(monkeypatch, "check", break_down(kind, "rr"))
    file = found_before(tmp_path, "check")
    with pytest.raises(StepError, match=r"or one does not turn: .* each is driven and counted"):
        commission(file, sets=WIRED)
    assert the_table(file)["steps"] == ["blocks", "floor"]


@pytest.mark.parametrize(
    ("step", "key", "action", "sets", "words"),
    [
        (
            "blocks", "blocks_others", lambda session: session.lift(lifted=False), [],
            "output 2 turned the wheels of the encoders 2 and 1: only one may turn",
        ),
        ("floor", "floor", put(push__force_x_n=4.0), [FREE], "the robot rolls by itself: the floor slopes"),
        (
            "floor", "floor", put(), ["plant.start.friction_coefficient=0.3", "robot.torque_limit_n_m=0.4"],
            r"the wheels do not turn with 0\.4 N·m on the floor, the limit: look at robot\.torque_limit_n_m",
        ),
        ("check", "check", put(push__force_x_n=8.0), [FREE], "the wheels do not come to rest although nothing drives"),
    ],
    ids=["not on blocks", "rolls", "too weak", "does not rest"],
)  # fmt: skip
def test_what_happens_to_the_robot_in_a_step_is_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    step: str,
    key: str,
    action: Callable[[Session], None],
    sets: list[str],
    words: str,
) -> None:
    before(monkeypatch, key, action)
    file = found_before(tmp_path, step)
    with pytest.raises((StepError, DeviceError), match=f"^{words}"):
        commission(file, sets=[*WIRED, *sets])
    assert the_table(file).get("steps", []) == list(STEPS[: STEPS.index(step)])


@pytest.mark.parametrize(
    ("step", "change", "sets", "words"),
    [
        ("blocks", on_one_wheel, [], "the outputs 1 to 4 turn the encoders 1, 1, 3, 4: expected each once"),
        (
            "blocks", without_current, ["plant.start.friction_coefficient=2"],
            r"output 1 turned nothing with 1\.1 N·m: its wheel is blocked, or its motor or its encoder",
        ),
        ("floor", one_input_further, [], r"no wiring explains what .*scores 0\.\d+, expected at least 0\.85\)"),
    ],
    ids=["two motors on one wheel", "no current is measured", "nonsense"],
)  # fmt: skip
def test_what_the_sensors_show_in_a_step_is_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    step: str,
    change: Callable[[Record], Record],
    sets: list[str],
    words: str,
) -> None:
    let_sensors_show(monkeypatch, change)
    with pytest.raises(StepError, match=f"^{words}"):
        commission(found_before(tmp_path, step), sets=[*WIRED, *sets])


def test_wirings_that_nothing_tells_apart_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wheels of a diagonal differ only in how they turn a robot, which is believed to turn hardly at all."""
    let_sensors_show(monkeypatch, lambda seen: seen._replace(yaw_rate_rad_s=seen.yaw_rate_rad_s * np.nan))
    with pytest.raises(StepError) as failed:
        commission(found_before(tmp_path, "floor"), sets=[*WIRED, FREE, "robot.inertia_kg_m2=100"])
    assert str(failed.value) == (
        "the wiring cannot be decided: the wheels of the outputs are rl, fl, fr, rr; reversed: fl; rollers: X, or rl, "
        "rr, fr, fl; reversed: rr; rollers: X; correct mass, inertia and size in [robot]"
    )


@pytest.mark.parametrize(
    ("during", "words"),
    [
        (
            "drive",
            "the feedback is 105 ms old: the link was lost; the drives were told to switch off, but nothing confirms "
            "it: cut the motors' power if a wheel turns",
        ),
        ("rest", "the robot did not come to rest within 5 s; cut the motors' power"),
    ],
)
def test_feedback_that_ends_is_a_reason_to_cut_the_power(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, during: str, words: str
) -> None:
    def end_feedback(session: Session) -> None:
        device, called = session.bench.device, getattr(session, during)

        def calls(*arguments: Any, **options: Any) -> Any:
            if during == "rest":
                called()
            newest = device.poll()
            monkeypatch.setattr(device, "poll", lambda: newest)
            return called(*arguments, **options) if during == "drive" else None

        monkeypatch.setattr(session, during, calls)

    before(monkeypatch, "floor", end_feedback)
    with pytest.raises(DeviceError) as failed:
        commission(found_before(tmp_path, "floor"), sets=WIRED)
    assert str(failed.value) == words


def test_an_imu_on_its_side_is_found_without_its_yaw_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before(monkeypatch, "push_forward", lambda _: stop())
    file, said = found_before(tmp_path, "floor", device__imu=("x", "y", "z")), list[str]()
    with pytest.raises(RunInterruptedError):
        commission(file, sets=[*WIRED[:2], 'plant.wiring.imu=["-z","x","-y"]'], say=said.append)
    assert "the third axis of the IMU is not upright: there is no yaw rate" in said
    assert tomllib.loads(file.read_text())["device"]["imu"] == ["-z", "x", "-y"]
    assert "forward: all wheels turned as they should" in said


def without_acceleration(seen: Record) -> Record:
    return seen._replace(acceleration_m_s2=seen.acceleration_m_s2 * np.nan)


def test_what_no_accelerometer_sees_is_settled_by_a_move_of_a_few_centimetres(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It speeds up by 0.5 m/s² for 0.25 s, and brakes for as long."""
    let_sensors_show(monkeypatch, without_acceleration)
    at: list[Pose] = []
    asked: dict[str, str] = {}
    monkeypatch.setattr(Onlooker, "confirm", lambda _, key, sentence: asked.update({key: sentence}))

    def look(session: Session) -> None:
        assert session.bench.truth is not None
        fix = session.bench.truth.poll()
        assert fix is not None
        assert max(map(abs, fix.twist)) < 0.02
        at.append(fix.pose)

    before(monkeypatch, "move_1", look)
    before(monkeypatch, "check", lambda session: (look(session), stop()))
    file = found_before(tmp_path, "floor", device__wheels=("fl", "fr", "rr", "rl"), device__reversed=())
    said: list[str] = []
    with pytest.raises(RunInterruptedError):
        commission(file, sets=[*WIRED, FREE], say=said.append)
    assert "no accelerometer: more questions will be asked" in said
    assert asked["move_1"] == "The sensors alone cannot tell. The robot will move by a few centimetres; look where to."
    begin, end = at
    way_m = math.hypot(end.x_m - begin.x_m, end.y_m - begin.y_m)
    assert way_m + abs(end.heading_rad - begin.heading_rad) * 0.52 == pytest.approx(0.031, abs=0.006)
    device = tomllib.loads(file.read_text())["device"]
    assert (device["wheels"], device["reversed"]) == (["rl", "fl", "fr", "rr"], ["fl"])
    assert device["imu"] == ["-y", "x", "z"]


def test_a_robot_that_does_not_move_is_asked_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_sensors_show(monkeypatch, without_acceleration)
    before(monkeypatch, "move_1", break_down("dead_motor", *WHEEL_NAMES))
    with pytest.raises(
        StepError, match=r"^the robot does not move with 1\.8 N·m on each wheel: look at what brakes it$"
    ):
        commission(found_before(tmp_path, "floor"), sets=[*WIRED, FREE])


# The push


class Misreading(Doing):
    """A person who reads the tape wrong by a factor."""

    def __init__(self, inner: Person, factors: dict[str, float]) -> None:
        super().__init__(inner, "", lambda: None)
        self._factors = factors

    def measure(self, key: str, question: str) -> float | None:
        true = super().measure(key, question)
        return None if true is None else true * self._factors[key]


def misread(monkeypatch: pytest.MonkeyPatch, forward: float, left: float = 1.0, turns: float = 1.0) -> None:
    person = hil.addons.identify.commission.commissioning._person
    factors = {"pushed_forward_m": forward, "pushed_left_m": left, "pushed_turns": turns}
    monkeypatch.setattr(
        hil.addons.identify.commission.commissioning,
        "_person",
        lambda session: Misreading(person(session), factors),
    )


def test_each_figure_of_the_push_follows_from_its_own_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forward half as far as the wheels say, less 2 %; to the left and round 10 % and 5 % further than that."""
    misread(monkeypatch, forward=0.49, left=0.49 * 1.1, turns=0.49 / 1.05)
    said: list[str] = []
    done = commission(found_before(tmp_path, "push"), sets=WIRED, say=said.append)
    assert done.values == {
        "firmware.counts_per_revolution": 8192,
        "robot.wheel_radius_m": pytest.approx(0.075 * 0.98, rel=1e-3),
        "robot.half_length_m": pytest.approx(0.3 * 1.05, rel=2e-3),
        "robot.half_width_m": pytest.approx(0.22 * 1.05, rel=2e-3),
    }
    assert done.table.lateral_scale == pytest.approx(1.1, rel=1e-3)
    figures = [float(number) for sentence in said for number in re.findall(r"\d+\.\d+|\b8192\b", sentence)]
    assert figures[-6:-2] == pytest.approx([done.values["robot.wheel_radius_m"], 8192, 1.1, 0.52 * 1.05], rel=2e-3)


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ((0.75,), r"by the wheels the robot went (\S+) m, by the tape (\S+) m: no usual .* a factor of 1\.33;"),
        ((1.0, 1.0, 0.8), r"the robot turned (\S+) times and its wheels say (\S+): look at robot\.half_length_m"),
    ],
)
def test_wheels_and_tape_that_do_not_go_together_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factors: tuple[float, ...], words: str
) -> None:
    misread(monkeypatch, *factors)
    file = found_before(tmp_path, "push")
    with pytest.raises(StepError, match=words) as failed:
        commission(file, sets=WIRED)
    found: Any = re.search(words, str(failed.value))
    one, other = map(float, found.groups())
    assert min(one, other) / max(one, other) == pytest.approx(factors[-1], rel=0.01)
    assert (one < other) == ("turned" in str(failed.value))
    assert "firmware" not in the_table(file)
