"""The travel of a robot whose wheels spin, by its inertial sensors: laws of the motion, on exact sensor values."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.types import NAN
from hil.estimation.inertial import Inertial
from hil.estimation.wheel_motion import Motion
from tests.support.examples import share_of_examples

DT_S = 0.005
TOLD_AFTER_S = 0.08


def motions(yaw_rate, seconds, spin_from_s, bias=(0.0, 0.0), accelerates=0.6):
    """Yield motions of a robot that accelerates along x and turns, and its true displacement in the body frame.

    The wheels say twice the speed from ``spin_from_s`` on.
    """
    before = 0.0, 0.0
    for tick in range(1, round(seconds / DT_S) + 1):
        speed, heading = accelerates * (tick - 0.5) * DT_S, yaw_rate * (tick - 0.5) * DT_S
        now = speed * math.cos(heading), -speed * math.sin(heading)
        turned = yaw_rate * DT_S if tick > 1 else 0.5 * yaw_rate * DT_S
        # What an accelerometer that turns with the robot feels: the change of velocity, and the turn of its own axes.
        gains = now[0] - before[0] - turned * before[1], now[1] - before[1] + turned * before[0]
        size = 2.0 if tick * DT_S > spin_from_s else 1.0
        true = now[0] * DT_S, now[1] * DT_S
        gained = gains[0] + bias[0] * DT_S, gains[1] + bias[1] * DT_S
        yield Motion(DT_S, size * true[0], size * true[1], turned, turned, 0.0, *gained), true
        before = now


def held(velocity, seconds):
    """Yield motions, and displacements by wheels at this velocity, of a robot that feels no acceleration."""
    way = velocity[0] * DT_S, velocity[1] * DT_S
    for _ in range(round(seconds / DT_S)):
        yield Motion(DT_S, *way, 0.0, 0.0, 0.0, 0.0, 0.0), way


@share_of_examples(0.3)
@given(st.floats(-1.0, 1.0), st.floats(0.3, 1.0))
def test_what_the_wheels_spoilt_before_slip_was_told_is_done_again(yaw_rate, spin_from_s):
    """The travels that are given again and the later ones are true, whatever the wheels say from the spin on."""
    inertial, travels, true = Inertial(), [], []
    for motion, displacement in motions(yaw_rate, spin_from_s + 0.5, spin_from_s):
        true.append(displacement)
        told = len(true) * DT_S > spin_from_s + TOLD_AFTER_S
        found = inertial.update(motion, 0.0, 1.0 if told else 0.0)
        del travels[len(travels) + 1 - len(found) :]
        travels += found
        assert inertial.is_inertial == told
    for travel, (forward_m, left_m) in zip(travels, true, strict=True):
        assert (travel.motion.forward_m, travel.motion.left_m) == pytest.approx((forward_m, left_m), abs=2e-5)
    rolled = [travel.is_rolled for travel in travels]
    assert rolled == sorted(rolled, reverse=True)
    assert rolled.count(True) * DT_S <= spin_from_s, "none of the motions with slip is the wheels'"


def test_an_inertial_velocity_is_doubted_more_the_longer_it_lasts_and_no_more_after_it():
    inertial, sigmas = Inertial(), []
    for motion, _ in motions(0.0, 1.0, 0.0):
        sigmas.append(inertial.update(motion, 0.0, 1.0)[-1].sigma_m_s)
    assert sigmas == sorted(sigmas)
    assert sigmas[-1] == pytest.approx(0.02 + 0.1 * 1.0)
    for motion, _ in held(inertial.velocity, 1.0):
        (after,) = inertial.update(motion, 0.0, 0.0)
    assert (after.is_rolled, after.sigma_m_s) == (True, 0.0)


@share_of_examples(0.3)
@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(0.5, 5.0))
def test_wheels_that_spin_on_at_a_constant_speed_still_slip_until_they_agree_or_the_inertial_velocity_is_no_better(
    forward, left, faster_m_s
):
    """No sensor of accelerations contradicts them, so slip is told no more while the robot goes at another speed."""
    inertial = Inertial()
    inertial.restart((forward, left))
    wheels = forward + faster_m_s, left
    for motion, _ in held(wheels, 0.2):
        inertial.update(motion, 0.0, 1.0)
    *_, (motion, _) = held(wheels, 1.0)
    seconds = 0.2
    while inertial.update(motion, 0.0, 0.0)[-1].is_rolled is False:
        assert inertial.velocity == pytest.approx((forward, left), abs=1e-9)
        seconds += DT_S
    # Within three deviations: 0.02 m/s, and 0.1 m/s a second.
    assert seconds == pytest.approx(max(0.2, (faster_m_s / 3.0 - 0.02) / 0.1), abs=0.02)
    inertial.restart((forward, left))
    for motion, _ in held(wheels, 0.2):
        inertial.update(motion, 0.0, 1.0)
    again = sum(not inertial.update(motion, 0.0, 0.0)[-1].is_rolled for motion, _ in held((forward, left), 1.0))
    assert again * DT_S < 0.6, "wheels that hold again are believed"


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
@share_of_examples(0.3)
def test_a_bias_of_the_accelerometer_is_learnt_while_wheels_roll(forward, left):
    """A lean of the floor too: after 10 s a second of slip is wrong by 1 % of the way that the bias would make."""
    inertial = Inertial()
    for motion, _ in motions(0.0, 10.0, 10.0, (forward, left), accelerates=0.05):
        inertial.update(motion, 0.0, 0.0)
    begun = inertial.velocity
    rest = Motion(DT_S, 0.0, 0.0, 0.0, 0.0, 0.0, forward * DT_S, left * DT_S)
    for _ in range(200):
        inertial.update(rest, 0.0, 1.0)
    assert inertial.velocity == pytest.approx(begun, abs=0.01 * (1.0 + math.hypot(forward, left)))


@pytest.mark.parametrize("missing", ["gyro_rad", "gained_left_m_s"])
def test_without_gyro_or_accelerometer_the_wheels_stay_and_are_doubted_by_the_speed_of_the_slip(missing):
    inertial = Inertial()
    for motion, _ in motions(0.0, 0.5, 0.2):
        (travel,) = inertial.update(motion._replace(**{missing: NAN}), 0.0, 0.4)
        assert (travel.is_rolled, travel.sigma_m_s) == (True, 0.4)
        assert travel.motion.forward_m == motion.forward_m
        assert not inertial.is_inertial


def test_what_fixes_refute_is_not_believed_until_slip_is_told_no_more_and_the_bias_is_learnt_meanwhile():
    inertial, off_m_s2 = Inertial(), 3.0
    wrong = Motion(DT_S, 0.0, 0.0, 0.0, 0.0, 0.0, off_m_s2 * DT_S, 0.0)
    for _ in range(100):
        inertial.update(wrong, 0.0, 0.6)
    assert inertial.is_inertial
    assert inertial.velocity[0] == pytest.approx(off_m_s2 * 100 * DT_S, rel=0.01)
    inertial.refute()
    for _ in range(2000):
        (travel,) = inertial.update(wrong, 0.0, 0.6)
        assert (travel.is_rolled, travel.sigma_m_s, travel.motion) == (True, 0.6, wrong)
        assert not inertial.is_inertial
    assert inertial.velocity[0] == pytest.approx(0.0, abs=0.01)
    assert inertial.bias_m_s2[0] == pytest.approx(off_m_s2, rel=0.02)
    inertial.update(wrong, 0.0, 0.0)
    inertial.update(wrong, 0.0, 0.6)
    assert inertial.is_inertial, "the next slip is a new one"


def test_velocity_and_bias_follow_their_equations_while_wheels_roll():
    """The error of the velocity and the bias are a linear recursion: its power, by NumPy, with 0.1 s and 2 s."""
    inertial, felt_m_s2, dt_s = Inertial(), np.array([0.3, -0.1]), 0.008
    rolls = Motion(dt_s, 0.5 * dt_s, 0.2 * dt_s, 0.0, 0.0, 0.0, *(felt_m_s2 * dt_s).tolist())
    inertial.restart((0.5, 0.2))
    for _ in range(300):
        inertial.update(rolls, 0.0, 0.0)
    kept, learns = math.exp(-dt_s / 0.1), dt_s / (0.1 * 2.0)
    tick = np.array(
        [
            [kept, -kept * dt_s, kept * dt_s],
            [kept * learns, 1.0 - kept * learns * dt_s, kept * learns * dt_s],
            [0, 0, 1],
        ]
    )
    apart, bias, _ = np.linalg.matrix_power(tick, 300) @ np.stack([np.zeros(2), np.zeros(2), felt_m_s2])
    assert inertial.velocity == pytest.approx(np.array([0.5, 0.2]) + apart, abs=1e-12)
    assert inertial.bias_m_s2 == pytest.approx(bias, abs=1e-12)
    assert bias == pytest.approx(felt_m_s2, rel=0.4), "half of it is learnt"
    # The last 0.1 s, 13 motions of 8 ms, are done again from what was believed before them.
    assert len(inertial.update(rolls, 0.0, 1.0)) == 13 + 1


def test_the_bias_of_the_gyro_is_no_turn():
    """A robot that slides along x and turns not at all: a gyro that says more turns its velocity by that."""
    velocities = []
    for bias_rad_s in (0.0, 0.25):
        inertial = Inertial()
        inertial.restart((1.0, 0.0))
        for _ in range(100):
            inertial.update(Motion(DT_S, 0.0, 0.0, 0.0, bias_rad_s * DT_S, 0.0, 0.0, 0.0), bias_rad_s, 1.0)
        velocities.append(inertial.velocity)
    assert velocities[0] == velocities[1] == (1.0, 0.0)
