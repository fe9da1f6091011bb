"""The last step before the wire: limits the command, replaces NaN and infinity by a stop, and brakes at rest."""

import math

from hil.core.errors import BadInputError
from hil.core.motion_limits import BodyLimits, MotionLimits
from hil.core.tuples import is_within
from hil.core.types import DRIVEN, ZERO_WHEELS, CommandMode, Guarded, State, WheelCommand, Wheels

# Share of the gain of the firmware's own speed loop. That loop runs at 1 kHz; ours also has the link's latency.
_SHARE = 0.25


class Guard:
    """Limits the commands of a law; nothing else on the host does.

    All four wheels are scaled by one factor, so that the direction of motion, or of force, is kept. The speed limit is
    the smaller of ``speed_limit_rad_s`` and the robot's own, which is set with ``limit_to``. With ``motion``, torques
    are also faded near the limits of a moving robot (``hil.core.motion_limits``). ``refused`` counts
    commands with a NaN or an infinity; a stop replaced them. Raises BadInputError unless limits are finite and above 0.
    """

    def __init__(self, speed_limit_rad_s: float, torque_limit_n_m: float, motion: MotionLimits | None = None) -> None:
        limits = {"speed_limit_rad_s": speed_limit_rad_s, "torque_limit_n_m": torque_limit_n_m}
        for name, value in limits.items():
            if not (math.isfinite(value) and value > 0.0):
                raise BadInputError(f"robot.{name} = {value!r}: expected a finite number, more than zero")
        self._own_speed_limit_rad_s = speed_limit_rad_s
        self.speed_limit_rad_s = speed_limit_rad_s
        self.torque_limit_n_m = torque_limit_n_m
        self.refused = 0
        self._motion = motion
        self._has_body = False

    def keep_body(self, limits: BodyLimits) -> None:
        """Keep also the speed and the yaw rate of the body within limits. Raises ValueError without ``motion``."""
        if self._motion is None:
            raise ValueError("this guard knows nothing of the robot's motion")
        self._motion.body = limits
        self._has_body = True

    def limit_to(self, robot_speed_limit_rad_s: float, overspeed_rad_s: float = math.inf) -> None:
        """Apply also the wheel speed that the robot accepts, and the one at which it stops itself; infinity for none.

        The first leaves a margin for the overshoot of the robot's speed loop: our firmware reports 0.8 times the speed
        at which it goes to FAULT (PROTOCOL.md, "Limits").
        """
        self.speed_limit_rad_s = min(self._own_speed_limit_rad_s, max(0.0, robot_speed_limit_rad_s))
        if self._motion is not None:
            self._motion.limit_to(robot_speed_limit_rad_s, overspeed_rad_s)

    @property
    def follows(self) -> bool:
        """Whether torques depend on the robot's motion: whether ``fade`` is to be called for each."""
        return self._motion is not None and self._motion.acts

    def apply(self, command: WheelCommand) -> tuple[WheelCommand, bool]:
        """Return the limited command, and whether it was scaled.

        In SPEED mode the speeds are scaled by one factor and the torque feedforward by another. In TORQUE
        mode the speeds have no meaning and are returned as zeros. A command with a NaN or an infinity
        gives a stop (all zero) in the same mode.
        """
        mode, speed, torque = command
        if speed is not ZERO_WHEELS and mode is CommandMode.TORQUE:
            speed = ZERO_WHEELS
            command = WheelCommand(mode, speed, torque)
        if is_within(torque, self.torque_limit_n_m) and (
            speed is ZERO_WHEELS or is_within(speed, self.speed_limit_rad_s)
        ):
            return (command, False) if not self._has_body else self._within_body(command, False)
        if not all(map(math.isfinite, speed + torque)):
            self.refused += 1
            return WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS), False
        speed = _scaled(speed, self.speed_limit_rad_s)
        return self._within_body(WheelCommand(mode, speed, _scaled(torque, self.torque_limit_n_m)), True)

    def _within_body(self, command: WheelCommand, saturated: bool) -> tuple[WheelCommand, bool]:
        mode, speed, torque = command
        if mode is CommandMode.TORQUE or self._motion is None or (scaled := self._motion.scaled(speed)) is speed:
            return command, saturated
        return WheelCommand(mode, scaled, torque), True

    def fade(
        self,
        command: WheelCommand,
        saturated: bool,
        speed_rad_s: Wheels,
        time_ns: int,
        state: State,
        latency_s: float,
        older_s: float = 0.0,
    ) -> tuple[WheelCommand, bool, Guarded]:
        """Return a command in TORQUE mode as it may act on the moving robot, whether it was limited, and by what.

        ``command`` and ``saturated`` are what ``apply`` returned; the others are as in ``MotionLimits``.
        """
        motion = self._motion
        if motion is None:
            return command, saturated, DRIVEN
        if not motion.is_near(speed_rad_s, time_ns, state, latency_s, older_s):
            return command, saturated, DRIVEN
        torque = motion.faded(command.torque_n_m)
        if torque is command.torque_n_m:
            return command, saturated, DRIVEN
        torque = _scaled(torque, self.torque_limit_n_m)
        return command._replace(torque_n_m=torque), True, motion.taken

    def why(self) -> str:
        """Return whose torque ``fade`` took when it last took some, and why (``MotionLimits.why``)."""
        assert self._motion is not None
        return self._motion.why()


class Brake:
    """Commands that hold the robot at rest. In SPEED mode: zero speed. In TORQUE mode zero torque would let it roll.

    In TORQUE mode each wheel gets a torque against its measured speed. The gain is a quarter of the firmware's
    ``speed_kp_n_m_s_rad``, and the guard limits the torque. Without a measured speed the torque is zero.
    """

    def __init__(self, mode: CommandMode, guard: Guard, speed_kp_n_m_s_rad: float) -> None:
        self._rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
        self._guard = guard
        self._gain = _SHARE * speed_kp_n_m_s_rad

    def command(self, speed_rad_s: Wheels | None) -> tuple[WheelCommand, bool]:
        """Return the command, and whether it was limited. ``speed_rad_s`` is None if the measured speed is too old."""
        if self._rest.mode is CommandMode.SPEED or speed_rad_s is None or not math.isfinite(sum(speed_rad_s)):
            return self._rest, False
        fl, fr, rr, rl = speed_rad_s
        gain = -self._gain
        return self._guard.apply(self._rest._replace(torque_n_m=Wheels(gain * fl, gain * fr, gain * rr, gain * rl)))


def _scaled(value: Wheels, limit: float) -> Wheels:
    """Return the values scaled to the limit; the same object if none exceeds it. All values must be finite."""
    fl, fr, rr, rl = value
    largest = max(abs(fl), abs(fr), abs(rr), abs(rl))
    if largest <= limit:
        return value
    # The ratio first: it is at most 1, so the product cannot round to a value beyond the limit.
    return Wheels(limit * (fl / largest), limit * (fr / largest), limit * (rr / largest), limit * (rl / largest))
