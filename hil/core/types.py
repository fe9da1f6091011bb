"""The data of one tick. Plain floats with the unit in the name; time is integer nanoseconds.

Frames: the world frame is fixed, x and y in the plane, heading positive from x to y. In the body frame x is forward
and y left. The order of wheels is FL, FR, RR, RL everywhere (the paper's 1 to 4).
"""

from enum import IntEnum
from typing import Final, NamedTuple

NAN = float("nan")
WHEEL_NAMES: Final = ("fl", "fr", "rr", "rl")


class Wheels(NamedTuple):
    """One number per wheel. The name of the variable that holds it gives quantity and unit."""

    fl: float
    fr: float
    rr: float
    rl: float


class Pose(NamedTuple):
    """Position and heading in the world frame. The heading is not wrapped."""

    x_m: float
    y_m: float
    heading_rad: float


class Twist(NamedTuple):
    """Velocity of the robot's centre in the world frame, and yaw rate."""

    vx_m_s: float
    vy_m_s: float
    yaw_rate_rad_s: float


class Acceleration(NamedTuple):
    """Acceleration of the robot's centre in the world frame, and yaw acceleration."""

    ax_m_s2: float
    ay_m_s2: float
    yaw_rad_s2: float


Axes = tuple[float, float, float]
"""Three numbers along x, y and heading, such as a Pose or a Twist. Laws use plain tuples: they are faster to make."""

Pairs = tuple[float, float, float, float, float, float]
"""Two quantities along x, y and heading: three numbers of the first (errors, for example), then three of the second
(their rates). Laws use it because a plain tuple is made in a tenth of the time of a named one."""

FourWheels = tuple[float, float, float, float]
"""One number per wheel, as in ``Wheels``; a plain tuple is faster to make."""


class State(NamedTuple):
    """The robot's motion as the controller knows it: measured or estimated."""

    pose: Pose
    twist: Twist


class Reference(NamedTuple):
    """Pose, twist and acceleration that the robot should have, in the world frame."""

    pose: Pose
    twist: Twist
    acceleration: Acceleration


class CommandMode(IntEnum):
    """What a wheel command means; fixed at arming (DBC HOST_HEARTBEAT.mode)."""

    SPEED = 0
    TORQUE = 1


class WheelCommand(NamedTuple):
    """A law's output: set points of the four wheels.

    In SPEED mode ``speed_rad_s`` holds the set points and ``torque_n_m`` the torque feedforward. In TORQUE mode
    ``torque_n_m`` holds the set points and ``speed_rad_s`` is ignored.
    """

    mode: CommandMode
    speed_rad_s: Wheels
    torque_n_m: Wheels


class Applied(NamedTuple):
    """The command of the last tick, after the guard, and its latency.

    ``latency_s`` is the time from the sampling instant to the first firmware tick that uses the command, both
    directions together: the scenario's value in lockstep, a recent measurement in real time. ``saturated`` is true if
    the guard scaled the command.
    """

    command: WheelCommand
    saturated: bool
    latency_s: float


class Limit(IntEnum):
    """What the limiter of motion takes torque for."""

    NONE = 0
    WHEEL_SPEED = 1
    SLIP = 2
    BODY = 3


class Guarded(NamedTuple):
    """What a guard did in a tick, for telemetry.

    ``held``: the law was not called. ``limit``: what the limiter of motion took most torque for, in all ``taken_n_m``
    of the four wheels.
    """

    held: bool
    limit: Limit
    taken_n_m: float


class Gains(NamedTuple):
    """The law's current gains, for telemetry: K1 and K2 of x, y and heading [1/s]; NaN if the law has none."""

    k1_x_1_s: float
    k1_y_1_s: float
    k1_heading_1_s: float
    k2_x_1_s: float
    k2_y_1_s: float
    k2_heading_1_s: float


class PoseFix(NamedTuple):
    """A true pose: robot time of the sample, the pose, and the twist if known."""

    time_ns: int
    pose: Pose
    twist: Twist


class PoseCovariance(NamedTuple):
    """Covariance of a measured pose in the world frame: the upper triangle, row by row; h is the heading."""

    xx_m2: float
    xy_m2: float
    xh_m_rad: float
    yy_m2: float
    yh_m_rad: float
    hh_rad2: float


class MeasuredPose(NamedTuple):
    """A pose fix of the robot's localisation (a lidar's, for example): robot time of the sample, pose, covariance."""

    time_ns: int
    pose: Pose
    covariance: PoseCovariance


ZERO_WHEELS = Wheels(0.0, 0.0, 0.0, 0.0)
NAN_WHEELS = Wheels(NAN, NAN, NAN, NAN)
NAN_POSE = Pose(NAN, NAN, NAN)
DRIVEN, HELD = (Guarded(held, Limit.NONE, 0.0) for held in (False, True))
NO_GAINS = Gains(NAN, NAN, NAN, NAN, NAN, NAN)
