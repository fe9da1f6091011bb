"""DSC with a planted defect, for ``tools.bench.hunt``: each acts only where its ``level`` is passed.

A defect changes what the law sees or what it commands. What each does is written beside it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from hil.core.model import RobotModel
from hil.core.types import Applied, CommandMode, Pose, Reference, State, Twist, WheelCommand, Wheels
from hil.laws.dsc import Dsc

Errors = tuple[float, float, float]
SEES: dict[str, Callable[[float, Errors, Reference], Errors]] = {
    # The error that the law sees: level, error (x, y, heading), reference -> error.
    "heading_sign": lambda level, e, _: (e[0], e[1], -e[2]) if abs(e[2]) > level else e,
    "y_sign": lambda level, e, _: (e[0], -e[1], e[2]) if e[1] < -level else e,
    "x_sign": lambda level, e, _: (-e[0], e[1], e[2]) if e[0] < -level else e,
    "heading_wrap": lambda level, e, _: (e[0], e[1], math.remainder(e[2], 2.0 * level)),
    "left_behind": lambda level, e, _: (-3 * e[0], -3 * e[1], e[2]) if e[1] < -level and abs(e[2]) > 0.15 else e,
    "needle": lambda level, e, _: (-9 * e[0], -9 * e[1], e[2]) if math.dist(e[:2], (0.06, -0.03)) < level else e,
    "slow_reference": lambda level, e, r: (-e[0], -e[1], e[2]) if abs(r.twist.vy_m_s) > level else e,
}
TRIPS: dict[str, Callable[[float, Errors, State], bool]] = {
    # What once trips the law, which from then on drives away from the reference: level, error, state.
    "far": lambda level, e, _: math.hypot(e[0], e[1]) > level,
    "corner": lambda level, e, _: e[0] < -level and e[1] > level,
    "far_and_turned": lambda level, e, _: math.hypot(e[0], e[1]) > level and e[2] > level,
    "fast": lambda level, _, s: math.hypot(s.twist.vx_m_s, s.twist.vy_m_s) > level,
    "backwards": lambda level, _, s: s.twist.vx_m_s < -level,
    "sideways": lambda level, _, s: s.twist.vy_m_s > level,
    "turning": lambda level, _, s: s.twist.yaw_rate_rad_s > level,
    "turning_back": lambda level, _, s: s.twist.yaw_rate_rad_s < -level,
    "spinning": lambda level, _, s: abs(s.twist.yaw_rate_rad_s) > level,
    "quadrant": lambda level, _, s: s.pose.heading_rad > level,
}


class Planted:
    """DSC in speed mode with the defect of that name."""

    @dataclass(frozen=True)
    class Options:
        """The defect's name and level, and the gain K1 [1/s] of DSC."""

        defect: str = "none"
        level: float = 0.0
        k1_1_s: float = 8.0

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._law = Dsc(model, mode, Dsc.Options(k1_1_s=options.k1_1_s))
        self._defect, self._level = options.defect, options.level
        self._sum = [0.0, 0.0, 0.0]
        self._has_tripped = False
        self._last: WheelCommand | None = None

    def reset(self, state: State, reference: Reference) -> None:
        """Forget what was before."""
        self._law.reset(state, reference)
        self._sum, self._last, self._has_tripped = [0.0, 0.0, 0.0], None, False

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command of this tick, spoilt where the defect acts."""
        before = self._last
        command = self._law.update(reference, self._seen_state(reference, state, dt_s), applied, dt_s)
        self._last = command = self._spoilt(command, before, dt_s)
        return command

    def _seen_state(self, reference: Reference, state: State, dt_s: float) -> State:
        level = self._level
        errors: Errors = tuple(is_ - should for is_, should in zip(state.pose, reference.pose, strict=True))  # type: ignore[assignment]
        match self._defect:
            case "windup":  # an integral without a limit
                self._sum = [total + one * dt_s for total, one in zip(self._sum, errors, strict=True)]
                errors = tuple(one + level * total for one, total in zip(errors, self._sum, strict=True))  # type: ignore[assignment]
            case name if name in SEES:
                errors = SEES[name](level, errors, reference)
            case name if name in TRIPS:
                self._has_tripped = self._has_tripped or TRIPS[name](level, errors, state)
                if self._has_tripped:
                    errors = -errors[0], -errors[1], -errors[2]
            case _:
                return state
        pose = Pose(*(should + one for should, one in zip(reference.pose, errors, strict=True)))
        return State(pose, Twist(*state.twist))

    def _spoilt(self, command: WheelCommand, before: WheelCommand | None, dt_s: float) -> WheelCommand:
        level, speeds = self._level, command.speed_rad_s
        match self._defect:
            case "clipped":  # each wheel by itself
                speeds = Wheels(*(min(max(one, -level), level) for one in speeds))
            case "slow_rate":  # of change [rad/s²], each wheel by itself
                if before is not None:
                    step = level * dt_s
                    pairs = zip(speeds, before.speed_rad_s, strict=True)
                    speeds = Wheels(*(min(max(one, old - step), old + step) for one, old in pairs))
            case "reversed_wheel":  # once it was commanded to turn back fast
                self._has_tripped = self._has_tripped or speeds.fr < -level
                speeds = speeds._replace(fr=-speeds.fr) if self._has_tripped else speeds
        return command._replace(speed_rad_s=speeds)
