"""How near our firmware's speed loop is to a limit cycle, from the gains and the robot alone."""

import math
from typing import NamedTuple

from hil.core.model import RobotModel
from hil.scenario.tables import FirmwareTable

_DELAY_S = 1.5e-3
"""A tick of 1 ms until the torque acts, and half a tick that it is held."""
LEAST_MARGIN_RAD = math.radians(3.0)
"""Below it only friction keeps the loop from a limit cycle; the defaults have 6 degrees."""


class Margin(NamedTuple):
    """Where the loop crosses over [rad/s], and how much phase is left there [rad]."""

    crossover_rad_s: float
    phase_rad: float


def yaw_margin(robot: RobotModel, firmware: FirmwareTable) -> Margin:
    """Return the margin of the loop around yaw, where a wheel has least to accelerate.

    The open loop is (kp + ki / s) / (J s) · b² / (s + b)² · exp(-s 1.5 ms), with the filter's bandwidth b and
    J = r² (I + k L²) / (4 L²). Its gain falls with the frequency, so there is one crossover.
    """
    inertia = robot.effective_inertia_kg_m2 * (robot.wheel_radius_m / (2.0 * robot.lever_m)) ** 2
    kp, ki, band = firmware.speed_kp_n_m_s_rad, firmware.speed_ki_n_m_rad, firmware.tracking_bandwidth_rad_s

    def gain(w: float) -> float:
        return math.hypot(kp, ki / w) / (inertia * w * (1.0 + (w / band) ** 2))

    low, high = 1e-6, 1e6
    for _ in range(100):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if gain(middle) > 1.0 else (low, middle)
    phase = 0.5 * math.pi - math.atan2(ki, kp * low) - 2.0 * math.atan(low / band) - _DELAY_S * low
    return Margin(low, phase)
