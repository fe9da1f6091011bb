"""The judge of third-party motors, rule by rule, on made-up ticks: what it catches, and the last that it lets pass.

A command every 10 ms from 300 ms to 490 ms of the robot's time; the newest is in force for 100 ms and a period.
"""

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil.addons.batch.catalogue.safety import MotorsJudge
from hil.core.types import WHEEL_NAMES, CommandMode
from hil.robot.virtual import EmulatedDevice
from hil.scenario import FirmwareTable

WHEELS = ("fl", "fr", "rr", "rl")
COMMAND = (4.0, -2.0, 0.0, 1.0)
FIRST, LAST, PERIOD, PATIENCE, TICKS = 300, 490, 10, 100, 1800
END, GONE = LAST + PATIENCE, LAST + PATIENCE + 1000
LIMIT_N_M = 4.0
AWAY, STILL = "is driven away from what was asked", "though the host has been gone for more than a second"
SHORT = "the robot was never driven or never left alone, so nothing is shown"


def firmware() -> FirmwareTable:
    own = {"torque_limit_n_m": LIMIT_N_M, "watchdog_s": 0.06, "ramp_s": 0.04}
    return FirmwareTable(counts_per_revolution=4096, torque_constant_n_m_a=1.0, **own)


def signals() -> dict[str, np.ndarray]:
    t_s = np.arange(0, LAST - FIRST + 1, PERIOD) / 1000.0
    robot_s = t_s + FIRST / 1000.0
    robot_s[3] = math.nan  # a tick without feedback
    commands = {f"wheel.{wheel}.speed_command_rad_s": np.full(len(t_s), COMMAND[n]) for n, wheel in enumerate(WHEELS)}
    commands["wheel.fl.speed_command_rad_s"][2] = math.nan
    return {"loop.t_s": t_s, "robot.time_s": robot_s, **commands}


def node(speed_rad_s: Sequence[float], torque_n_m: Sequence[float]) -> EmulatedDevice:
    shafts = [SimpleNamespace(speed_rad_s=one) for one in speed_rad_s]
    return cast(EmulatedDevice, SimpleNamespace(shafts=shafts, torque_n_m=tuple(torque_n_m)))


def with_other(sound: EmulatedDevice, wheel: int, speed: float, torque: float) -> EmulatedDevice:
    speeds, torques = [shaft.speed_rad_s for shaft in sound.shafts], list(sound.torque_n_m)
    speeds[wheel], torques[wheel] = speed, torque
    return node(speeds, torques)


def complaints(
    begin: int = 0,
    end: int = 0,
    wheel: int = 0,
    *,
    speed: float = 0.0,
    torque: float = 0.0,
    mode: CommandMode = CommandMode.SPEED,
    ticks: int = TICKS,
    driven: float = 0.5,
) -> list[str]:
    """Judge a robot that does as it is told, but for one wheel in the ticks from ``begin`` to before ``end``."""
    judge = MotorsJudge(firmware(), mode)
    rest, moves = node((0.0,) * 4, (0.0,) * 4), node(COMMAND, (driven, 0.0, 0.0, 0.0))
    for tick in range(ticks):
        sound = moves if FIRST <= tick < END else rest
        judge.hold(with_other(sound, wheel, speed, torque) if begin <= tick < end else sound)
    return list(judge.complaints(signals()))


def test_the_wheels_have_the_order_of_the_signals() -> None:
    assert WHEEL_NAMES == WHEELS


def test_motors_that_do_as_they_are_told_pass_if_they_were_driven_and_then_left_alone() -> None:
    assert complaints() == []
    assert complaints(ticks=GONE + 1) == []
    assert complaints(ticks=GONE) == complaints(driven=0.0) == [SHORT]
    assert MotorsJudge(firmware(), CommandMode.SPEED).left_alone_ticks == PATIENCE + 2000


@pytest.mark.parametrize(
    ("wheel", "speed", "torque"),
    [
        (0, 4.0 + 1.0 + 0.4, 0.2),
        (1, -2.0 - 1.0 - 0.2, -0.2),
        (1, 1.0, 0.2),
        (2, 1.0, 0.2),
        (2, -1.0, -0.2),
        (3, 1.0 + 1.0 + 0.1, 0.2),
        (3, -1.0, -0.2),
    ],
)
def test_a_wheel_is_driven_away_beyond_a_speed_and_a_torque_for_longer_than_50_ms(
    wheel: int, speed: float, torque: float
) -> None:
    begin, long = 400, 400 + 51
    beyond = {"speed": speed + math.copysign(0.01, torque), "torque": torque + math.copysign(0.001, torque)}
    name = WHEELS[wheel]
    assert complaints(begin, long, wheel, **beyond) == [f"at 450 ms of the robot's time, in 1 ticks: {name} {AWAY}"]
    assert complaints(begin, long + 3, wheel, **beyond) == [f"at 450 ms of the robot's time, in 4 ticks: {name} {AWAY}"]
    assert complaints(begin, long - 1, wheel, **beyond) == []
    assert complaints(begin, long, wheel, **beyond | {"speed": speed - math.copysign(0.01, torque)}) == []
    assert complaints(begin, long, wheel, **beyond | {"torque": torque - math.copysign(0.001, torque)}) == []
    assert complaints(begin, long, wheel, **beyond | {"torque": -beyond["torque"]}) == [], "it is braked"


@pytest.mark.parametrize(("end", "found"), [(FIRST, 1), (FIRST + 1, 0), (END + PERIOD + 50, 0), (END + PERIOD + 51, 1)])
def test_a_command_is_in_force_from_its_tick_until_watchdog_ramp_and_period_are_over(end: int, found: int) -> None:
    assert len(complaints(end - 51, end, 0, speed=4.0, torque=0.3)) == found


def test_in_torque_mode_speeds_are_judged_once_the_host_is_gone() -> None:
    torque_mode: dict[str, Any] = {"speed": 9.0, "torque": 0.3, "mode": CommandMode.TORQUE}
    assert complaints(END - 60, END + 50, **torque_mode) == []
    assert complaints(END - 60, END + 51, **torque_mode) == [
        f"at {END + 50} ms of the robot's time, in 1 ticks: fl {AWAY}"
    ]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_second_after_the_host_is_gone_a_wheel_gets_a_twentieth_of_the_limit_at_most(sign: int) -> None:
    assert complaints(GONE - 5, GONE, 3, torque=sign * 0.201) == []
    assert complaints(GONE, GONE + 5, 3, torque=sign * 0.199) == []
    (told,) = complaints(GONE - 5, GONE + 2, 3, torque=sign * 0.201)
    assert told == f"at {GONE} ms of the robot's time, in 2 ticks: the drives still give torque {STILL}"


@pytest.mark.parametrize("sign", [1, -1])
def test_a_torque_beyond_the_limit_or_that_is_none_is_told(sign: int) -> None:
    assert complaints(400, 402, 1, speed=-2.0, torque=sign * 4.00003) == []
    (told,) = complaints(400, 402, 1, speed=-2.0, torque=sign * 4.0001)
    assert told == "at 400 ms of the robot's time, in 2 ticks: the torque is beyond 4 N·m"
    assert complaints(400, 401, 1, torque=math.nan) == ["the drives were given a torque that is no number"]
