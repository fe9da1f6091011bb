"""The data of one tick. Plain floats with the unit in the name; time is integer nanoseconds.

Frames: the world frame is fixed, x and y in the plane, heading counted from x to y. The body frame is x forward,
y left. Wheels are FL, FR, RR, RL everywhere (the paper's 1 to 4).
"""

from collections.abc import Callable
from enum import IntEnum
from types import MethodType
from typing import NamedTuple

NAN = float("nan")
WHEEL_NAMES = ("fl", "fr", "rr", "rl")


class Wheels(NamedTuple):
    """One number a wheel; the name of the field that holds it gives the quantity and the unit."""

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
"""A Pose, a Twist or another triple along x, y and heading, where a class of its own would cost a law its time."""

Pairs = tuple[float, float, float, float, float, float]
"""Two quantities along x, y and heading: the three of the first, such as errors, then the three of the second, such as
their rates. For laws too: a plain tuple is made in a tenth of the time that a named one takes."""

FourWheels = tuple[float, float, float, float]
"""One number a wheel, as ``Wheels``, on its way between the functions of a law."""


class State(NamedTuple):
    """What the controller believes of the robot's motion."""

    pose: Pose
    twist: Twist


class Reference(NamedTuple):
    """Where the robot should be, how it should move there, and how that changes."""

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
    """What was really commanded at the last tick, after the guard, and how late it takes effect.

    ``latency_s`` is the time from the sampling instant to the first firmware tick that uses the command, both
    directions together: that of the scenario in lockstep, in real time what was measured of late. ``saturated`` says
    that the guard scaled the wheels.
    """

    command: WheelCommand
    saturated: bool
    latency_s: float


class Gains(NamedTuple):
    """Gains in force, for telemetry: K1 and K2 of x, y and heading [1/s]; NaN where a law has none."""

    k1_x_1_s: float
    k1_y_1_s: float
    k1_heading_1_s: float
    k2_x_1_s: float
    k2_y_1_s: float
    k2_heading_1_s: float


class PoseFix(NamedTuple):
    """Ground truth: robot time of the sample, the pose, and, if known, the twist."""

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
    """A pose fix by a localisation of the robot's, such as a lidar's: robot time of its sample, pose, covariance."""

    time_ns: int
    pose: Pose
    covariance: PoseCovariance


# What a tick makes of a tuple, in half the time that calling the class takes: bound methods, as a functools.partial
# makes a tuple of its own on the way. Of fields that are checked by name the class itself is the better maker.
make_wheels: Callable[[FourWheels], Wheels] = MethodType(tuple.__new__, Wheels)
make_pose: Callable[[Axes], Pose] = MethodType(tuple.__new__, Pose)
make_twist: Callable[[Axes], Twist] = MethodType(tuple.__new__, Twist)
make_acceleration: Callable[[Axes], Acceleration] = MethodType(tuple.__new__, Acceleration)
make_state: Callable[[tuple[Pose, Twist]], State] = MethodType(tuple.__new__, State)
make_reference: Callable[[tuple[Pose, Twist, Acceleration]], Reference] = MethodType(tuple.__new__, Reference)
make_command: Callable[[tuple[CommandMode, Wheels, Wheels]], WheelCommand] = MethodType(tuple.__new__, WheelCommand)
make_gains: Callable[[Pairs], Gains] = MethodType(tuple.__new__, Gains)
make_fix: Callable[[tuple[int, Pose, Twist]], PoseFix] = MethodType(tuple.__new__, PoseFix)

ZERO_WHEELS = Wheels(0.0, 0.0, 0.0, 0.0)
NAN_WHEELS = Wheels(NAN, NAN, NAN, NAN)
NAN_POSE = Pose(NAN, NAN, NAN)
NO_GAINS = Gains(NAN, NAN, NAN, NAN, NAN, NAN)
