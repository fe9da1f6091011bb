"""Whether there is any limit to keep."""

import math

from hil.core.model import RobotModel
from hil.core.motion_limits import BodyLimits, MotionLimits

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
