"""Whether there is any limit to keep."""

import math

import pytest

from hil.core.model import RobotModel
from hil.core.motion_limits import BodyLimits, MotionLimits
from hil.core.types import Pose, State, Twist, Wheels

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
