"""The decision of commissioning: which of all wirings fits the response to pulses, and the questions to a person."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.identify.commission.wirings import (
    Candidate,
    MotionSeen,
    Responses,
    WheelSeen,
    decide,
    direction_of,
    laid_upright,
    pattern,
    response,
    rows,
    telling,
    turned_axes,
)
from hil.core.model import RobotModel
from hil.core.wheel_map import ImuMount
from tests.robot.test_wiring import frames
from tests.support.examples import share_of_examples
from tests.support.plant_testbed import TWIST, WHEELS, robot, wheels

MODEL = RobotModel(20.0, 0.9, 0.075, 0.3, 0.22, 0.005, torque_limit_n_m=1.8, speed_limit_rad_s=20.0)
SQUARE = RobotModel(20.0, 0.9, 0.075, 0.3, 0.3, 0.005, torque_limit_n_m=1.8, speed_limit_rad_s=20.0)
CANDIDATES = st.builds(
    lambda order, signs, rollers, turns: Candidate(tuple(order), signs, rollers, turns),
    st.permutations(range(4)),
    st.tuples(*[st.sampled_from((1, -1))] * 4),
    st.sampled_from(("x", "o")),
    st.integers(0, 3),
)


def seen(model: RobotModel, true: Candidate, *, accelerometer: bool = True, gyro: bool = True) -> Responses:
    """Return what ideal sensors see of a robot of this wiring, by the twist of its body alone."""
    body, _ = response(model, true.rollers)
    h = rows(model, true.rollers)
    acceleration, yaw, wheel = np.zeros((4, 2)), np.zeros(4), np.zeros((4, 4))
    angle = true.quarter_turns * np.pi / 2
    into_imu = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    for channel, (place, sign) in enumerate(zip(true.wheels, true.signs, strict=True)):
        motion = sign * body[place]
        acceleration[channel] = into_imu @ motion[:2]
        yaw[channel] = motion[2]
        turned = h @ motion / model.wheel_radius_m
        wheel[channel] = [s * turned[w] for w, s in zip(true.wheels, true.signs, strict=True)]
    nothing = np.nan
    return Responses(acceleration if accelerometer else acceleration * nothing, yaw if gyro else yaw * nothing, wheel)


def told(true: Candidate) -> WheelSeen:
    return WheelSeen(0, true.wheels[0], true.signs[0])


@pytest.mark.parametrize("rollers", ["x", "o"])
@pytest.mark.parametrize("contact", [1, 2], ids=["rigid", "slip"])
def test_the_predicted_response_is_that_of_the_plant(rollers: str, contact: int) -> None:
    body, rims = response(MODEL, rollers)  # type: ignore[arg-type]
    start = {
        "half_width_m": 0.22, "inertia_kg_m2": 0.9, "rollers": "xo".index(rollers) + 1, "contact": contact,
        "roller_friction_coefficient": 0.0,
    }  # fmt: skip
    seconds = 0.05
    for driven in range(4):
        with robot(start) as plant:
            plant.torque([0.2 * (i == driven) for i in range(4)])
            plant.step(count=50)
            scale = 0.2 * seconds
            assert plant.read(TWIST) == pytest.approx(body[driven] * scale, rel=0.05, abs=0.02 * scale)
            speeds = plant.read(wheels("speed_rad_s")) * MODEL.wheel_radius_m
            assert speeds == pytest.approx(rims[driven] * scale, rel=0.05, abs=0.02 * scale)
    assert len(WHEELS) == 4


@share_of_examples(0.3)
@given(CANDIDATES, st.floats(0.2, 5.0), st.integers(0, 2**31))
def test_accelerometer_and_gyro_leave_one_wiring_after_one_question(true: Candidate, gear: float, seed: int) -> None:
    """Also with a tenth of noise, and counts of a turn that are wrong by a factor of five."""
    clean = seen(MODEL, true)
    noise = np.random.default_rng(seed).normal(0.0, 0.1, clean.acceleration_m_s2.shape)
    noisy = clean._replace(
        acceleration_m_s2=clean.acceleration_m_s2 + noise * np.abs(clean.acceleration_m_s2).max(),
        wheels_rad_s2=clean.wheels_rad_s2 * gear,
    )
    decision = decide(MODEL, noisy, [told(true)])
    assert decision.is_clear
    assert decision.best == true


@share_of_examples(0.4)
@given(CANDIDATES, st.booleans())
def test_without_an_accelerometer_one_more_question_settles_it(true: Candidate, gyro: bool) -> None:
    evidence: list[WheelSeen | MotionSeen] = [told(true)]
    measured = seen(MODEL, true, accelerometer=False, gyro=gyro)
    decision = decide(MODEL, measured, evidence)
    assert not decision.is_clear
    torques = telling(MODEL, decision)
    assert torques is not None
    evidence.append(MotionSeen(torques, direction_of(MODEL, true, torques)))
    decision = decide(MODEL, measured, evidence)
    assert decision.is_clear
    assert decision.best == true._replace(quarter_turns=0)


def test_how_many_wirings_the_sensors_leave() -> None:
    """With an IMU in any heading four, one for each side that may be the front; without one many more."""
    true = Candidate((2, 0, 3, 1), (1, -1, -1, 1), "x", 3)
    assert len(decide(MODEL, seen(MODEL, true)).rivals) == 3
    assert len(decide(MODEL, seen(MODEL, true, accelerometer=False), [told(true)]).rivals) == 1
    assert decide(MODEL, seen(MODEL, true), [told(true)]).is_clear


def test_a_square_robot_with_rollers_o_cannot_be_told_apart_but_its_rollers_are() -> None:
    """No motion distinguishes the wheels of a diagonal: they push along one line, and none turns the robot."""
    true = Candidate((0, 1, 2, 3), (1, 1, 1, 1), "o", 0)
    decision = decide(SQUARE, seen(SQUARE, true), [told(true)])
    assert not decision.is_clear
    assert decision.rollers == "o"
    assert telling(SQUARE, decision) is None


def test_what_no_wiring_explains_does_not_fit() -> None:
    nonsense = Responses(np.full((4, 2), 1.0), np.full(4, 1.0), np.full((4, 4), 1.0))
    assert not decide(MODEL, nonsense).fits
    with pytest.raises(ValueError, match="nothing was measured"):
        decide(MODEL, Responses(np.zeros((4, 2)), np.zeros(4), np.zeros((4, 4))))


def test_a_person_who_contradicts_the_sensors_is_not_believed_blindly() -> None:
    true = Candidate((0, 1, 2, 3), (1, 1, 1, 1), "x", 0)
    lies = [WheelSeen(0, 0, 1), WheelSeen(1, 0, 1)]  # one wheel on two outputs
    with pytest.raises(ValueError, match="no wiring agrees"):
        decide(MODEL, seen(MODEL, true), lies)


@given(CANDIDATES.filter(lambda one: one.rollers == "x"))
def test_patterns_move_a_robot_where_they_say(candidate: Candidate) -> None:
    for direction in ("forward", "backward", "left", "right", "turned left", "turned right"):
        assert direction_of(MODEL, candidate, pattern(candidate, direction)) == direction


def test_gravity_and_a_number_of_quarter_turns_give_every_mount() -> None:
    found = set()
    for axes in frames():
        mount = ImuMount(axes)
        gravity = [0.0, 0.0, 0.0]
        up = mount.axis.index(2)
        gravity[up] = 9.81 * mount.sign[up]
        laid = laid_upright(gravity)
        assert laid is not None
        options = [turned_axes(laid, turns) for turns in range(4)]
        assert axes in options
        found |= set(options)
    assert len(found) == 24


def test_an_imu_askew_is_not_upright() -> None:
    assert laid_upright((6.0, 6.0, 5.0)) is None
    assert all(laid_upright(gravity) is None for gravity in itertools.permutations((0.0, 7.0, 7.0)))
