"""Laws of the guard: never beyond a limit, the direction kept, nothing that is not a number let through."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.guard import Guard
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand, Wheels

finite = st.floats(allow_nan=False, allow_infinity=False)
usual = st.floats(-200.0, 200.0)
wheels = st.builds(Wheels, *[st.one_of(usual, finite)] * 4)
commands = st.builds(WheelCommand, st.sampled_from(CommandMode), wheels, wheels)
limit = st.floats(0.1, 60.0)
broken = st.sampled_from([math.nan, math.inf, -math.inf])


@given(commands, limit, limit)
def test_never_beyond_a_limit(command, speed_limit, torque_limit):
    result, _ = Guard(speed_limit, torque_limit).apply(command)
    assert max(map(abs, result.speed_rad_s)) <= speed_limit
    assert max(map(abs, result.torque_n_m)) <= torque_limit
    assert result.mode is command.mode


@given(commands, limit, limit)
def test_applying_it_twice_changes_nothing(command, speed_limit, torque_limit):
    guard = Guard(speed_limit, torque_limit)
    once, _ = guard.apply(command)
    assert guard.apply(once) == (once, False)


@given(commands, limit, limit)
def test_the_direction_is_kept(command, speed_limit, torque_limit):
    result, saturated = Guard(speed_limit, torque_limit).apply(command)
    pairs = [(command.torque_n_m, result.torque_n_m)]
    if command.mode is CommandMode.SPEED:
        pairs.append((command.speed_rad_s, result.speed_rad_s))
    scaled = False
    for wanted, given_out in pairs:
        wanted_size, size = max(map(abs, wanted)), max(map(abs, given_out))
        scaled |= wanted_size != size
        for a, b in zip(wanted, given_out, strict=True):
            if wanted_size > 0.0:
                assert b / size == pytest.approx(a / wanted_size, rel=1e-12, abs=1e-300)
    assert saturated == scaled


@given(commands, st.sampled_from(["torque_n_m", "speed_rad_s"]), st.integers(0, 3), broken)
def test_what_is_not_a_number_becomes_a_stop_and_is_counted(command, field, wheel, value):
    values = list(getattr(command, field))
    values[wheel] = value
    guard = Guard(20.0, 5.0)
    result, saturated = guard.apply(command._replace(**{field: Wheels(*values)}))
    if command.mode is CommandMode.TORQUE and field == "speed_rad_s":
        assert guard.refused == 0  # a speed means nothing there
        assert result.speed_rad_s == ZERO_WHEELS
    else:
        assert result == (command.mode, ZERO_WHEELS, ZERO_WHEELS)
        assert guard.refused == 1
        assert not saturated


def test_within_the_limits_nothing_is_touched():
    command = WheelCommand(CommandMode.SPEED, Wheels(20.0, -3.0, 0.0, 1e-9), Wheels(-5.0, 5.0, 1.0, 0.0))
    assert Guard(20.0, 5.0).apply(command) == (command, False)


def test_speed_and_feedforward_are_scaled_apart():
    command = WheelCommand(CommandMode.SPEED, Wheels(40.0, -20.0, 0.0, 10.0), Wheels(1.0, 2.0, 3.0, 4.0))
    result, saturated = Guard(20.0, 5.0).apply(command)
    assert result == (CommandMode.SPEED, (20.0, -10.0, 0.0, 5.0), (1.0, 2.0, 3.0, 4.0))
    assert saturated


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_limit_must_be_a_limit(value):
    with pytest.raises(BadInputError, match=f"robot.speed_limit_rad_s = {value}: expected"):
        Guard(value, 5.0)
    with pytest.raises(BadInputError, match=f"robot.torque_limit_n_m = {value}: expected"):
        Guard(20.0, value)


@pytest.mark.proves("R-LIM-5")
@given(commands, limit, limit | st.just(math.inf) | st.floats(-5.0, 0.0))
def test_what_the_robot_takes_is_a_limit_too_and_the_last_word_counts(command, own, robot):
    guard = Guard(own, 5.0)
    guard.limit_to(0.1)
    guard.limit_to(robot)
    result, _ = guard.apply(command)
    assert robot < own or result == Guard(own, 5.0).apply(command)[0]
    assert max(map(abs, result.speed_rad_s)) <= min(own, max(robot, 0.0))
