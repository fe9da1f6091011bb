"""Whether there is any limit to keep."""

import math

import pytest

from hil.core.model import RobotModel
from hil.core.motion_limits import BodyLimits, MotionLimits
from hil.core.types import Guarded, Limit, Pose, State, Twist, Wheels

MODEL = RobotModel(20.0, 0.56, 0.075, 0.3, 0.2, 0.005, torque_limit_n_m=5.0, speed_limit_rad_s=20.0)


def test_a_limiter_acts_as_soon_as_there_is_a_limit_of_wheels_slip_or_body() -> None:
    none = MotionLimits(MODEL, 0.005, torque_speed="off")
    assert not none.acts
    none.limit_to(32.0, 40.0)
    assert not none.acts, "it keeps no speed of wheels"
    none.body = BodyLimits(1.5, 2.5)
    assert none.acts
    none.body = None
    assert not none.acts
    assert MotionLimits(MODEL, 0.005, slip_m_s=0.3, torque_speed="off").acts
    wheels = MotionLimits(MODEL, 0.005)
    wheels.limit_to(math.inf, math.inf)
    assert not wheels.acts, "the robot reports none"
    wheels.limit_to(32.0, 40.0)
    assert wheels.acts


@pytest.mark.parametrize("heading_rad", [0.0, math.pi / 2, math.pi, -math.pi / 2])
def test_a_body_at_its_limit_is_driven_no_further_whichever_way_it_goes(heading_rad: float) -> None:
    """The direction is one of the robot's own axes; the part of a force across it stays."""
    ahead, left = round(math.cos(heading_rad)), round(math.sin(heading_rad))
    limits = MotionLimits(MODEL, 0.005)
    limits.limit_to(1e3, 1e3)
    limits.body = BodyLimits(1.0, 5.0)
    rolling = MODEL.wheel_speeds((1.2 * ahead, 1.2 * left, 0.0), 0.0)
    state = State(Pose(0.0, 0.0, 0.0), Twist(1.2 * ahead, 1.2 * left, 0.0))
    for tick in range(3):
        limits.is_near(Wheels(*rolling), tick * 5_000_000, state, 0.001, 0.0)
    along, across = (4.0 * ahead, 4.0 * left), (-3.0 * left, 3.0 * ahead)
    pushed = Wheels(
        *MODEL.wheel_torques((along[0] + across[0], along[1] + across[1], 0.0), (0.0, 0.0, 0.0), 0.0, (0.0,) * 3)
    )
    kept = MODEL.wheel_torques((*across, 0.0), (0.0, 0.0, 0.0), 0.0, (0.0,) * 3)
    assert limits.faded(pushed) == pytest.approx(kept)


def faded_at(limits: MotionLimits, speed: Wheels, vx_m_s: float) -> Wheels:
    """Return what is left of 2 N·m a wheel at these speeds, which do not change, and this speed of the body."""
    for tick in range(3):
        limits.is_near(speed, tick * 5_000_000, State(Pose(0.0, 0.0, 0.0), Twist(vx_m_s, 0.0, 0.0)), 0.001, 0.0)
    return limits.faded(Wheels(2.0, 2.0, 2.0, 2.0))


def test_what_is_taken_is_told_with_its_limit_its_size_and_its_reason() -> None:
    slip = MotionLimits(MODEL, 0.005, slip_m_s=0.3, torque_speed="off")
    left = faded_at(slip, Wheels(13.0, 10.0, 14.5, 10.0), 0.75)
    assert left == pytest.approx((1.0, 2.0, 0.0, 2.0))
    assert slip.taken == Guarded(False, Limit.SLIP, pytest.approx(3.0))
    assert slip.why() == (
        "FL, RR, 0.34 m/s over the floor when the command acts: it fades from 0.15 m/s to 0.3 m/s (limiter.slip_m_s)"
    )
    fast = MotionLimits(MODEL, 0.005)
    fast.limit_to(32.0, 40.0)
    assert faded_at(fast, Wheels(34.0, 10.0, 10.0, 10.0), 0.75)[0] == pytest.approx(1.0)
    assert fast.taken == Guarded(False, Limit.WHEEL_SPEED, pytest.approx(1.0))
    assert fast.why() == "FL, 34 rad/s when the command acts: it fades from 32 rad/s to 36 rad/s (limiter.torque_speed)"
    body = MotionLimits(MODEL, 0.005, torque_speed="off")
    body.body = BodyLimits(0.5, 1.0)
    assert faded_at(body, Wheels(10.0, 10.0, 10.0, 10.0), 0.75) == pytest.approx((0.0,) * 4)
    assert body.taken == Guarded(False, Limit.BODY, pytest.approx(8.0))
    assert body.why() == "the body, 0.75 m/s and 0 rad/s when the command acts: its limits are 0.5 m/s and 1 rad/s"
