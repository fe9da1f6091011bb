"""How much of the commanded acceleration a robot has, learnt while it drives: its believed mass over its true one.

Over a window the measured velocity changes by Δv and the commands that acted account for Δu, both along an axis:

    Δv = s Δu - f Δs

with the share s = believed mass / true mass and an unknown friction f [m/s²]. Δs is the effect of a friction of 1 m/s²
on the velocity over the window. Friction acts at the wheels, so against the motion of each pair of them. The motion of
the body has it √2 times where both pairs move. Sums over a window need no derivative, and the noise of a velocity
enters only at its two ends. The method is recursive least squares with forgetting (K. J. Åström and B. Wittenmark,
Adaptive Control, 2nd ed. 1995, section 2.2). The prior is the believed mass and friction. It is returned until
something was learnt.
"""

import math

_WINDOW_S = 0.03  # long against the noise of a velocity, short against the time in which a robot gets up speed
_GATE = 1.0 / 6.0  # least Δu of a window, in units of the largest acceleration times a window
_FORGET = 0.98  # of what was learnt, each window from which something is learnt
_PRIOR_SHARE, _PRIOR_FRICTION = 0.02, 1.0  # weights of s = 1 and the believed f, in the units of the sums below
_LEAST, _MOST = 0.45, 2.2  # a robot from half to twice as heavy as believed
_TRUSTED = 0.4  # sum of the squares of Δu, in the units of _GATE, from which s counts as known


class AccelerationShare:
    """Learns s and f of one or two axes that share them.

    ``share`` is s, within 0.45 to 2.2, ``friction`` is f [m/s² or rad/s²], at least 0, and ``is_known`` says whether
    enough was seen to rely on them. They begin at 1, the believed f, and False. ``was_limited`` says whether a limiter
    took torque away since the reset.

    ``largest`` is the believed acceleration at full torque [m/s² or rad/s²]. Windows with less than a sixth
    of ``largest`` teach nothing: their change may be friction, a slope or noise. Once a limiter took torque away, as
    from wheels that slip, a window can only show a lighter robot, and a heavier share is forgotten. The robot may have
    had less force than the torque stands for, before and after too, but not more.
    """

    __slots__ = ("_believed", "_scale", "_sums", "_window", "friction", "is_known", "share", "was_limited")

    def __init__(self, largest: float, friction: float = 0.0) -> None:
        self._scale = 1.0 / (largest * _WINDOW_S)
        self._believed = friction
        self.reset()

    def reset(self) -> None:
        """Forget everything: a robot that was stopped may have been loaded meanwhile."""
        self._forget()
        self.was_limited = False
        self._begin(())

    def _forget(self) -> None:
        self._sums = 0.0, 0.0, 0.0, 0.0, 0.0
        self.share, self.friction, self.is_known = 1.0, self._believed, False

    def _begin(self, rates: tuple[float, ...]) -> None:
        self._window = 0.0, rates, (0.0,) * len(rates), (0.0,) * len(rates)

    def update(
        self,
        rates: tuple[float, ...],
        changes: tuple[float, ...],
        rubbed: tuple[float, ...],
        dt_s: float,
        *,
        is_limited: bool,
    ) -> None:
        """Add a tick of ``dt_s`` [s]: the measured ``rates`` now, and the ``changes`` that the commands account for.

        ``rubbed`` is how a friction of 1 m/s² or rad/s² would have changed the rates in this tick.
        """
        passed_s, first, moved, slowed = self._window
        if not first:
            self._begin(rates)
            return
        if is_limited and not self.was_limited:
            self.was_limited = True
            if self.share < 1.0:
                self._forget()
        passed_s += dt_s
        moved = tuple(map(float.__add__, moved, changes))
        slowed = tuple(map(float.__add__, slowed, rubbed))
        if passed_s < _WINDOW_S:
            self._window = passed_s, first, moved, slowed
            return
        self._begin(rates)
        gained = sum(u * (end - begin - u) for u, begin, end in zip(moved, first, rates, strict=True))
        if gained > 0.0 or not self.was_limited:
            self._learn(first, rates, moved, slowed)

    def _learn(
        self, first: tuple[float, ...], last: tuple[float, ...], moved: tuple[float, ...], slowed: tuple[float, ...]
    ) -> None:
        scale = self._scale
        if math.hypot(*moved) * scale < _GATE:
            return
        uu, us, ss, uv, sv = (_FORGET * one for one in self._sums)
        for begin, end, change, slower in zip(first, last, moved, slowed, strict=True):
            u, v, s = scale * change, scale * (end - begin), slower / _WINDOW_S
            uu, us, ss, uv, sv = uu + u * u, us + u * s, ss + s * s, uv + u * v, sv + s * v
        self._sums = uu, us, ss, uv, sv
        unit = _WINDOW_S * scale
        a, b = uu + _PRIOR_SHARE, ss + _PRIOR_FRICTION
        y1, y2 = uv + _PRIOR_SHARE, sv + _PRIOR_FRICTION * self._believed * unit
        determinant = a * b - us * us
        self.share = min(max((b * y1 - us * y2) / determinant, _LEAST), _MOST)
        self.friction = max((a * y2 - us * y1) / (determinant * unit), 0.0)
        self.is_known = uu > _TRUSTED
