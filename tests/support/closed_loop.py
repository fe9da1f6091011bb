"""A robot for the laws to drive: written on its own, from the equations of motion, with plain floats."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from hil.core.kinematics import body_twist, to_world
from hil.core.model import RobotModel
from hil.core.types import ZERO_WHEELS, Applied, CommandMode, Pose, State, Twist, WheelCommand, Wheels
from hil.references.shapes import Circle

PAPER_ROBOT = RobotModel(
    mass_kg=20.0,
    inertia_kg_m2=0.56,
    wheel_radius_m=0.075,
    half_length_m=0.3,
    half_width_m=0.3,
    wheel_inertia_kg_m2=0.005,
    friction_coefficient=0.0,
    torque_limit_n_m=5.0,
    speed_limit_rad_s=60.0,
)
PAPER_CIRCLE = Circle(radius_m=1.0, period_s=15.0, heading_rad=math.pi / 4)
PAPER_START = Pose(0.8, -0.2, 0.0)
AT_REST = Applied(WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, ZERO_WHEELS), False, 0.0)

Limit = Callable[[WheelCommand], WheelCommand]
Motion = tuple[float, float, float, float, float, float]


class Outcome(NamedTuple):
    """When the planar error fell below 2 % of its first value for good, and what it was at the end."""

    tracked_s: float
    steady_m: float


def derivative(robot: RobotModel, motion: Motion, torque: Wheels) -> Motion:
    """Return the rates of (x, y, heading, vx, vy, yaw rate) under wheel torques [N·m], without friction."""
    _, _, heading, vx, vy, yaw_rate = motion
    fl, fr, rr, rl = torque
    r, lever = robot.wheel_radius_m, robot.half_length_m + robot.half_width_m
    k = 4.0 * robot.wheel_inertia_kg_m2 / r**2
    forward, left, turning = (
        (fl + fr + rr + rl) / r,
        (-fl + fr - rr + rl) / r,
        lever * (-fl + fr + rr - rl) / r,
    )
    c, s = math.cos(heading), math.sin(heading)
    ax = (c * forward - s * left - k * yaw_rate * vy) / (robot.mass_kg + k)
    ay = (s * forward + c * left + k * yaw_rate * vx) / (robot.mass_kg + k)
    return vx, vy, yaw_rate, ax, ay, turning / (robot.inertia_kg_m2 + k * lever**2)


def after(robot: RobotModel, motion: Motion, torque: Wheels, dt_s: float) -> Motion:
    """Return the motion after one Runge-Kutta step of fourth order with the torque held."""

    def moved(rates: Motion, by: float) -> Any:
        return tuple(a + by * b for a, b in zip(motion, rates, strict=True))

    k1 = derivative(robot, motion, torque)
    k2 = derivative(robot, moved(k1, dt_s / 2), torque)
    k3 = derivative(robot, moved(k2, dt_s / 2), torque)
    k4 = derivative(robot, moved(k3, dt_s), torque)
    mean: Any = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
    return moved(mean, dt_s)  # type: ignore[no-any-return]


def each_wheel_by_itself(limit_n_m: float) -> Limit:
    """Return a limit as of four motors that know nothing of each other: the force changes its direction."""

    def limited(command: WheelCommand) -> WheelCommand:
        return command._replace(torque_n_m=Wheels(*(min(max(t, -limit_n_m), limit_n_m) for t in command.torque_n_m)))

    return limited


def run_torque(law: Any, limit: Limit, duration_s: float, dt_s: float = 1e-3) -> Outcome:
    """Let a law drive the paper's robot onto the paper's circle by torque."""
    motion: Motion = (*PAPER_START, 0.0, 0.0, 0.0)
    errors = []
    for n in range(round(duration_s / dt_s) + 1):
        reference = PAPER_CIRCLE.at(n * dt_s)
        errors.append(math.hypot(motion[0] - reference.pose.x_m, motion[1] - reference.pose.y_m))
        state = State(Pose(*motion[:3]), Twist(*motion[3:]))
        if n == 0:
            law.reset(state, reference)
        command = limit(law.update(reference, state, AT_REST, dt_s))
        motion = after(PAPER_ROBOT, motion, command.torque_n_m, dt_s)
    last_outside = max(n for n, error in enumerate(errors) if error >= 0.02 * errors[0])
    return Outcome((last_outside + 1) * dt_s, errors[-1])


def run_speed(law: Any, limit: Limit, start: Pose, duration_s: float, dt_s: float) -> tuple[float, float]:
    """Let a law drive wheels that have their set points at once; return the last planar, heading error."""
    robot = PAPER_ROBOT
    pose, twist = start, Twist(0.0, 0.0, 0.0)
    for n in range(round(duration_s / dt_s) + 1):
        reference = PAPER_CIRCLE.at(n * dt_s)
        error = [a - b for a, b in zip(pose, reference.pose, strict=True)]
        if n == 0:
            law.reset(State(pose, twist), reference)
        command = limit(law.update(reference, State(pose, twist), AT_REST, dt_s))
        body = body_twist(command.speed_rad_s, robot.wheel_radius_m, robot.lever_m)
        middle = pose.heading_rad + body.yaw_rate_rad_s * dt_s / 2
        twist = to_world(body, middle)
        pose = Pose(*(a + b * dt_s for a, b in zip(pose, twist, strict=True)))
    return math.hypot(error[0], error[1]), abs(error[2])
