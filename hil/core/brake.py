"""What a robot is told while it is held at rest: zero speeds, or torques that brake the wheels."""

import math

from hil.core.guard import Guard
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand, Wheels

# Of the firmware's own speed loop, which is closed at 1 kHz without the link: this one has the link's latency in it.
_SHARE = 0.25


class Brake:
    """Holds the robot at rest. In SPEED mode the firmware does it; in TORQUE mode zero torque would let it roll.

    There each wheel has a torque against its measured speed, with a quarter of the firmware's ``speed_kp_n_m_s_rad``,
    within the guard's limit; zero without a speed to go by.
    """

    def __init__(self, mode: CommandMode, guard: Guard, speed_kp_n_m_s_rad: float) -> None:
        self._rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
        self._guard = guard
        self._gain = _SHARE * speed_kp_n_m_s_rad

    def command(self, speed_rad_s: Wheels | None) -> tuple[WheelCommand, bool]:
        """Return the command and whether it had to be limited; ``speed_rad_s`` is None where it is too old."""
        if self._rest.mode is CommandMode.SPEED or speed_rad_s is None or not math.isfinite(sum(speed_rad_s)):
            return self._rest, False
        fl, fr, rr, rl = speed_rad_s
        gain = -self._gain
        return self._guard.apply(self._rest._replace(torque_n_m=Wheels(gain * fl, gain * fr, gain * rr, gain * rl)))
