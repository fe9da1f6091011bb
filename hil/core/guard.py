"""The last check before the wire: commands are limited and finite, and a robot that is held at rest brakes."""

import math

from hil.core.errors import BadInputError
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand, Wheels, make_command

# Of the firmware's own speed loop, which is closed at 1 kHz without the link: this one has the link's latency in it.
_SHARE = 0.25


class Guard:
    """Limits the commands of a law; the only place on the host that does.

    All four wheels are scaled by one factor: the direction of motion, or of force, is kept. Speeds are kept within the
    smaller of ``speed_limit_rad_s`` and what the robot says that it takes (``heed``). ``refused`` counts commands that
    were not finite and were replaced by a stop. Raises BadInputError for a limit that is not a finite number above
    zero.
    """

    def __init__(self, speed_limit_rad_s: float, torque_limit_n_m: float) -> None:
        limits = {"speed_limit_rad_s": speed_limit_rad_s, "torque_limit_n_m": torque_limit_n_m}
        for name, value in limits.items():
            if not (math.isfinite(value) and value > 0.0):
                raise BadInputError(f"robot.{name} = {value!r}: expected a finite number, more than zero")
        self._own_speed_limit_rad_s = speed_limit_rad_s
        self.speed_limit_rad_s = speed_limit_rad_s
        self.torque_limit_n_m = torque_limit_n_m
        self.refused = 0

    def heed(self, robot_speed_limit_rad_s: float) -> None:
        """Keep speeds within what the robot says that it takes as well; infinite where it says nothing.

        The robot's limit has the margin for the overshoot of its speed loop in it: our firmware's is 0.8 times the
        speed that is a fault (PROTOCOL.md, "Limits").
        """
        self.speed_limit_rad_s = min(self._own_speed_limit_rad_s, max(0.0, robot_speed_limit_rad_s))

    def apply(self, command: WheelCommand) -> tuple[WheelCommand, bool]:
        """Return the command within the limits, and whether it had to be scaled.

        In SPEED mode set points and torque feedforward are scaled each by a factor of their own. In TORQUE
        mode the speeds, which mean nothing there, are returned as zeros. A command with a NaN or an infinity
        gives a stop (all zero) of the same mode.
        """
        mode, speed, torque = command
        if mode is CommandMode.TORQUE and speed is not ZERO_WHEELS:
            speed = ZERO_WHEELS
            command = make_command((mode, speed, torque))
        if _is_within(torque, self.torque_limit_n_m) and (
            speed is ZERO_WHEELS or _is_within(speed, self.speed_limit_rad_s)
        ):
            return command, False
        if not all(map(math.isfinite, speed + torque)):
            self.refused += 1
            return WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS), False
        limited_speed = _scaled(speed, self.speed_limit_rad_s)
        limited_torque = _scaled(torque, self.torque_limit_n_m)
        return WheelCommand(mode, limited_speed, limited_torque), True


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


def _is_within(value: Wheels, limit: float) -> bool:
    """Whether every wheel is within the limit, which no NaN is."""
    fl, fr, rr, rl = value
    return -limit <= fl <= limit and -limit <= fr <= limit and -limit <= rr <= limit and -limit <= rl <= limit


def _scaled(value: Wheels, limit: float) -> Wheels:
    """Return finite wheels within the limit; the same object when none is beyond it."""
    fl, fr, rr, rl = value
    largest = max(abs(fl), abs(fr), abs(rr), abs(rl))
    if largest <= limit:
        return value
    # First the ratio, which is at most 1: the product then cannot round beyond the limit.
    return Wheels(limit * (fl / largest), limit * (fr / largest), limit * (rr / largest), limit * (rl / largest))
