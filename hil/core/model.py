"""The controller's model of the robot: inverse dynamics of a rigid platform on four Mecanum wheels.

    M q̈ + C + B ξ = B τ,    M = diag(m + k, m + k, I + k L²),    C = k θ̇ (ẏ, -ẋ, 0),    k = 4 Ib / r²

in the world frame, q = (x, y, θ). Nguyen Minh et al. 2023, AFDSC, equation 15, prints m + k in place of k in
C (and equation 14 ẋ in place of ẏ). That error comes from Lagrange's equation on four wheel angles that are
not independent. Only the rotating wheels contribute to C: their momentum turns with the body, that of the mass
m does not. See I. Zeidis and K. Zimmermann, "Dynamics of a four-wheeled mobile robot with Mecanum
wheels", ZAMM 99 (2019).
"""

from dataclasses import dataclass, field
from math import cos, sin, tanh
from typing import Annotated, Any

from hil.core.kinematics import body_twist, to_world, wheel_speeds
from hil.core.options import Range, require_ranges
from hil.core.tuples import wheel_torques
from hil.core.types import Axes, FourWheels, Twist, Wheels

GRAVITY_M_S2 = 9.81
FRICTION_SPEED_RAD_S = 0.3
"""Friction uses tanh(ω / this speed) in place of sign(ω), so that its compensation does not chatter."""


@dataclass(frozen=True, slots=True)
class RobotModel:
    """``[robot]`` of a scenario: the parameters of the controller's model, and quantities computed from them.

    Symbols are those of the paper. The speed and torque limits are at most what WHEEL_COMMAND and TORQUE_COMMAND can
    carry; the other bounds detect a wrong unit. Raises OptionsError for a number out of its range.
    """

    mass_kg: Annotated[float, Range(gt=0, le=10_000), "mass with wheels"]
    inertia_kg_m2: Annotated[float, Range(gt=0, le=100_000), "yaw inertia of the whole robot, I"]
    wheel_radius_m: Annotated[float, Range(ge=0.001, le=1), "r"]
    half_length_m: Annotated[float, Range(ge=0.001, le=3.9), "centre to axle, forward, l1"]
    half_width_m: Annotated[float, Range(ge=0.001, le=3.9), "centre to wheel, sideways, l2"]
    wheel_inertia_kg_m2: Annotated[float, Range(ge=0, le=100), "of one wheel and its motor about its axle, Ib"]
    friction_coefficient: Annotated[float, Range(ge=0, le=2), "rolling friction, mu in xi"] = 0.0
    torque_limit_n_m: Annotated[float, Range(gt=0, le=15.99609375), "of one wheel"] = field(kw_only=True)
    speed_limit_rad_s: Annotated[
        float, Range(gt=0, le=63.984375), "of one wheel; the robot's own limit applies if it is smaller"
    ] = field(kw_only=True)
    lever_m: float = field(init=False, repr=False)
    """L = l1 + l2 [m]."""
    wheels_mass_kg: float = field(init=False, repr=False)
    """k = 4 Ib / r² [kg]: the mass that is equivalent to the wheels' rotational inertia."""
    effective_mass_kg: float = field(init=False, repr=False)
    """m + k [kg]."""
    effective_inertia_kg_m2: float = field(init=False, repr=False)
    """I + k L² [kg·m²]."""
    wheel_friction_n_m: float = field(init=False, repr=False)
    """μ m g r / 4 [N·m]: friction torque of one wheel."""
    _for_torques: Any = field(init=False, repr=False)
    """What ``wheel_torques`` in C takes of the robot: m + k, k and I + k L²; r and L."""

    def __post_init__(self) -> None:
        require_ranges(self, "robot")
        lever = self.half_length_m + self.half_width_m
        k = 4.0 * self.wheel_inertia_kg_m2 / self.wheel_radius_m**2
        friction = self.friction_coefficient * self.mass_kg * GRAVITY_M_S2 * self.wheel_radius_m / 4.0
        object.__setattr__(self, "lever_m", lever)
        object.__setattr__(self, "wheels_mass_kg", k)
        object.__setattr__(self, "effective_mass_kg", self.mass_kg + k)
        object.__setattr__(self, "effective_inertia_kg_m2", self.inertia_kg_m2 + k * lever**2)
        object.__setattr__(self, "wheel_friction_n_m", friction)
        inertia = self.effective_mass_kg, k, self.effective_inertia_kg_m2
        object.__setattr__(self, "_for_torques", (inertia, (self.wheel_radius_m, lever)))

    def wheel_speeds(self, twist: Axes, heading_rad: float) -> FourWheels:
        """Return the wheel speeds [rad/s] of a world twist at this heading: ω = H Rᵀ q̇ / r."""
        vx, vy, yaw_rate = twist
        c, s = cos(heading_rad), sin(heading_rad)
        body = c * vx + s * vy, c * vy - s * vx, yaw_rate
        return wheel_speeds(body, self.wheel_radius_m, self.lever_m)

    def twist(self, wheel_speed_rad_s: Wheels, heading_rad: float) -> Twist:
        """Return the world twist of wheel speeds [rad/s] at this heading."""
        return to_world(body_twist(wheel_speed_rad_s, self.wheel_radius_m, self.lever_m), heading_rad)

    def wheel_torques(self, acceleration: Axes, twist: Axes, heading_rad: float, moving: Axes) -> FourWheels:
        """Return the wheel torques [N·m] for a world acceleration, without limits: τ = B⁺ (M q̈ + C) + ξ.

        ``twist`` is the world twist in C. Friction ξ (``friction_torques``) is computed for the wheel speeds of the
        world twist ``moving``: pass the intended twist, because a measured one would feed its noise back.
        """
        inertia, geometry = self._for_torques
        torque = wheel_torques(inertia, geometry, acceleration, twist, heading_rad)
        if self.wheel_friction_n_m == 0.0:
            return torque
        to_fl, to_fr, to_rr, to_rl = torque
        fl, fr, rr, rl = self.friction_torques(self.wheel_speeds(moving, heading_rad))
        return to_fl + fl, to_fr + fr, to_rr + rr, to_rl + rl

    def friction_torques(self, speed_rad_s: FourWheels) -> FourWheels:
        """Return the friction torque [N·m] of each wheel at these speeds: ξ = (μ m g r / 4) tanh(ω / 0.3 rad/s)."""
        fl, fr, rr, rl = speed_rad_s
        friction = self.wheel_friction_n_m
        return (
            friction * tanh(fl / FRICTION_SPEED_RAD_S),
            friction * tanh(fr / FRICTION_SPEED_RAD_S),
            friction * tanh(rr / FRICTION_SPEED_RAD_S),
            friction * tanh(rl / FRICTION_SPEED_RAD_S),
        )
