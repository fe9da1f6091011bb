"""Motion summed between two instants, with its derivatives by everything that the filter estimates of the sensors.

Source: C. Forster et al., On-Manifold Preintegration for Real-Time Visual-Inertial Odometry, IEEE Trans. Robotics 33,
2017, here in the plane, with wheels in place of the accelerometer.
"""

from cmath import rect
from typing import NamedTuple


class Step(NamedTuple):
    """The step from one measurement to the next: motion in the body frame, and variances of its errors.

    ``turned_rad`` is by the gyro if ``biased_s`` is the step's duration; by the wheels if that is 0, and then neither
    bias nor scale of the gyro matter. ``is_rolled``: forward and left are the wheels'. ``yaw_m`` is the wheels' turn
    times the lever, ``disagreement_m`` that of ``Motion``; NaN where the wheels slip. ``erred_m`` is how far the robot
    may have come off its wheels and its gyro unnoticed.
    """

    forward_m: float
    left_m: float
    turned_rad: float
    biased_s: float
    position_m2: float
    heading_rad2: float
    bias_rad2_s2: float
    is_rolled: bool = True
    yaw_m: float = 0.0
    disagreement_m: float = 0.0
    erred_m: float = 0.0


class MotionSums:
    """The motion of many steps, in the body frame at their begin; a complex number is forward + left j.

    At the turn α since the begin, a step of forward f, left l and (by the wheels) yaw y adds e^{jα} f to ``forward``,
    e^{jα} j l to ``left`` and e^{jα} y to ``yaw``; what is not the wheels' goes into ``unrolled``. ``by_turn`` and
    ``by_time`` are sums of the displacement times the gyro's turn and time before it: a gyro with another scale or
    bias would have turned the displacement by so much more. The turn in the middle of a step counts for all of it.

    ``ways`` are the sums of f, l and y as they are, and ``disagreement_m`` that of the wheels' disagreement.
    """

    __slots__ = (
        "bias_rad2_s2", "biased_s", "by_time", "by_turn", "disagreement_m", "erred_m", "forward", "forward_m",
        "gyro_rad", "heading_rad2", "left", "left_m", "position_m2", "turned_rad", "unrolled", "yaw", "yaw_m",
    )  # fmt: skip

    def __init__(self) -> None:
        self.turned_rad = self.gyro_rad = self.biased_s = 0.0
        self.forward = self.left = self.yaw = self.unrolled = self.by_turn = self.by_time = 0j
        self.forward_m = self.left_m = self.yaw_m = self.disagreement_m = self.erred_m = 0.0
        self.position_m2 = self.heading_rad2 = self.bias_rad2_s2 = 0.0

    def add(self, step: Step, share: float = 1.0) -> None:
        """Add this share of a step."""
        forward_m, left_m, turned_rad, biased_s, position_m2, heading_rad2, bias_rad2_s2, is_rolled, *rest = step
        if share != 1.0:
            forward_m, left_m, turned_rad, biased_s = (
                share * forward_m, share * left_m, share * turned_rad, share * biased_s
            )  # fmt: skip
        yaw_m, disagreement_m, erred_m = rest
        along = rect(1.0, self.turned_rad + 0.5 * turned_rad)
        displaced = along * complex(forward_m, left_m)
        if is_rolled:
            ahead = along * forward_m
            self.forward += ahead
            self.left += displaced - ahead
            self.yaw += share * yaw_m * along
        else:
            self.unrolled += displaced
        before_s = self.biased_s
        if biased_s:
            self.by_turn += (self.gyro_rad + 0.5 * turned_rad) * displaced
            self.by_time += (before_s + 0.5 * biased_s) * displaced
            self.gyro_rad += turned_rad
            self.biased_s = before_s + biased_s
        else:
            self.by_turn += self.gyro_rad * displaced
            self.by_time += before_s * displaced
        self.turned_rad += turned_rad
        self.forward_m += forward_m
        self.left_m += left_m
        self.yaw_m += share * yaw_m
        self.disagreement_m += share * disagreement_m
        self.erred_m += share * erred_m
        self.position_m2 += share * position_m2
        self.heading_rad2 += share * heading_rad2
        self.bias_rad2_s2 += share * bias_rad2_s2
