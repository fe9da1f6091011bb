"""DSC with a planted defect, for ``tools.bench.hunt``.

A defect shows itself once its condition was met, and from then on. Until then the law is DSC to the bit, so that one
run without a defect says of all defects at once which of them it would have met.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from hil.core.model import RobotModel
from hil.core.types import ZERO_WHEELS, Applied, CommandMode, Pose, Reference, State, Twist, WheelCommand, Wheels
from hil.laws.surface import Dsc

WATCH = "watch"
"""In place of a defect: no defect acts, and the law's signal ``MET`` says whose conditions were met."""
MET = "planted.met"
"""The sum of 2 to the power of the place in ``CONDITIONS``, of all defects whose condition was met."""

SPIN = Wheels(-20.0, 20.0, 20.0, -20.0)


class Seen(NamedTuple):
    """What a law sees in a tick: errors along x, y and heading, twist, reference, and the command it would give.

    ``wound_rad_s`` is the integral of the heading's error, ``silent`` the number of ticks without a change of the
    state. ``jump_rad_s`` and ``drop_rad_s`` are how much the yaw rate changed and the set point of the wheel FR fell
    since the last tick.
    """

    x_m: float
    y_m: float
    turned_rad: float
    twist: Twist
    reference: Reference
    speeds: Wheels
    wound_rad_s: float
    silent: int
    jump_rad_s: float
    drop_rad_s: float

    @property
    def speed_m_s(self) -> float:
        """The speed of the robot's centre."""
        return math.hypot(self.twist.vx_m_s, self.twist.vy_m_s)

    @property
    def off_m(self) -> float:
        """The distance from the reference."""
        return math.hypot(self.x_m, self.y_m)


CONDITIONS: Mapping[str, Callable[[Seen], bool]] = {
    "turned far": lambda s: abs(s.turned_rad) > 0.1997,
    "left behind": lambda s: s.y_m < -0.21,
    "off and turned": lambda s: s.off_m > 0.18 and s.turned_rad > 0.12,
    "corner": lambda s: s.x_m < -0.07 and s.y_m > 0.075 and s.turned_rad < -0.15,
    "slow and spinning": lambda s: s.reference.twist.vy_m_s < 0.34 and s.twist.yaw_rate_rad_s < -1.2,
    "windup": lambda s: abs(s.wound_rad_s) > 0.06,
    "needle": lambda s: math.dist((s.x_m, s.y_m), (0.05, 0.03)) < 0.004 and abs(s.turned_rad) < 0.02,
    "cell": lambda s: abs(s.turned_rad - 0.08) < 0.003 and abs(s.speed_m_s - 0.6) < 0.003,
    "silent at speed": lambda s: s.silent >= 14 and s.speed_m_s > 0.8,
    "gyro jump": lambda s: s.jump_rad_s > 0.55,
    "spin at speed": lambda s: abs(s.twist.yaw_rate_rad_s) > 0.5 and s.speed_m_s > 0.7,
    "overspeed": lambda s: s.speed_m_s > 1.15,
    "crossed wheels": lambda s: s.speeds.fl > 12.0 and s.speeds.rr < -11.0,
    "set point drop": lambda s: s.drop_rad_s > 8.0,
    "from the start": lambda _: True,
}


class Planted:
    """DSC in speed mode with the defect of that name."""

    signals = (MET,)

    @dataclass(frozen=True)
    class Options:
        """The defect's name and what it does then, and the gain K1 [1/s] of DSC.

        ``limit`` and ``rate`` are those of a wheel's set point by itself [rad/s, rad/s²], without which DSC knows
        nothing of them.
        """

        defect: str = WATCH
        then: str = "away"
        k1_1_s: float = 8.0
        limit: float = math.inf
        rate: float = math.inf

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._law = Dsc(model, mode, Dsc.Options(k1_1_s=options.k1_1_s))
        self._options = options
        self._forget()

    def _forget(self) -> None:
        self._last: tuple[State, WheelCommand] | None = None
        self._held: WheelCommand | None = None
        self._wound_rad_s, self._silent, self._met = 0.0, 0, 0

    @property
    def telemetry(self) -> tuple[float]:
        """The values of ``signals``."""
        return (float(self._met),)

    def reset(self, state: State, reference: Reference) -> None:
        """Forget what was before."""
        self._law.reset(state, reference)
        self._forget()

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, spoilt where the defect acts."""
        is_away = self._held is not None and self._options.then == "away"
        seen_state = _mirrored(state, reference) if is_away else state
        command = self._limited(self._law.update(reference, seen_state, applied, dt_s), dt_s)
        seen = self._seen(reference, state, command, dt_s)
        self._last = state, command
        if self._options.defect == WATCH:
            self._met |= sum(1 << place for place, holds in enumerate(CONDITIONS.values()) if holds(seen))
        elif self._held is None and CONDITIONS[self._options.defect](seen):
            self._held = command
        return command if self._held is None else self._spoilt(command, self._held)

    def _seen(self, reference: Reference, state: State, command: WheelCommand, dt_s: float) -> Seen:
        x_m, y_m, turned_rad = (is_ - should for is_, should in zip(state.pose, reference.pose, strict=True))
        self._wound_rad_s += turned_rad * dt_s
        before, command_before = self._last or (state, command)
        self._silent = self._silent + 1 if self._last is not None and state == before else 0
        jump_rad_s = abs(state.twist.yaw_rate_rad_s - before.twist.yaw_rate_rad_s)
        drop_rad_s = command_before.speed_rad_s.fr - command.speed_rad_s.fr
        speeds, kept = command.speed_rad_s, (self._wound_rad_s, self._silent, jump_rad_s, drop_rad_s)
        return Seen(x_m, y_m, turned_rad, Twist(*state.twist), reference, speeds, *kept)

    def _limited(self, command: WheelCommand, dt_s: float) -> WheelCommand:
        """Return the command with each wheel limited by itself."""
        limit, step = self._options.limit, self._options.rate * dt_s
        if math.isinf(limit) and math.isinf(step):
            return command
        old = command if self._last is None else self._last[1]
        pairs = zip(command.speed_rad_s, old.speed_rad_s, strict=True)
        speeds = (min(max(one, was - step), was + step) for one, was in pairs)
        return command._replace(speed_rad_s=Wheels(*(min(max(one, -limit), limit) for one in speeds)))

    def _spoilt(self, command: WheelCommand, held: WheelCommand) -> WheelCommand:
        match self._options.then:
            case "hold":  # the set points of that tick
                return held
            case "rest":
                return command._replace(speed_rad_s=ZERO_WHEELS)
            case "spin":
                return command._replace(speed_rad_s=SPIN)
            case "reversed":  # one wheel
                return command._replace(speed_rad_s=command.speed_rad_s._replace(fr=-command.speed_rad_s.fr))
        return command


def _mirrored(state: State, reference: Reference) -> State:
    """Return a state whose error is the negative one, so that the law drives away from the reference."""
    return State(Pose(*(2.0 * r - s for s, r in zip(state.pose, reference.pose, strict=True))), Twist(*state.twist))
