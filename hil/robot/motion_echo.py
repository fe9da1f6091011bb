"""The latency of commands, from the motion that they cause: for motors that acknowledge no command.

A torque that a wheel gets shows in how the robot's velocity changes. The force F that the commands stand for, along x
and y of the world, acts one latency d after the instant t_k from which a command was computed, so that

    y_k = (v_k+1 - v_k) - (v_k - v_k-1)  =  g x_k(d),    x_k(d) = C(t_k+1 - d) - 2 C(t_k - d) + C(t_k-1 - d)

with the integral C of F over the time of commands, and an unknown gain g (one over the mass). The second difference
takes away what hardly changes over two ticks: friction, a slope. The d that explains most of y is the latency (least
squares over a grid; of this kind is G. C. Carter, "Coherence and time delay estimation", Proc. IEEE 75, 1987). No I/O.
"""

from collections import deque
from math import cos, isfinite, sin

import numpy as np

from hil.core.kinematics import body_wrench
from hil.core.model import RobotModel
from hil.core.types import State, Wheels

_STEP_S = 0.001
_MORE_S = 0.04
_WINDOW_S = 0.008  # least time between the instants that are compared, so that fast ticks show something too
_FORGET = 0.99  # of what was seen, each tick that shows something
_SHOWS = 0.02  # least second difference of the force that shows something, as a share of the largest force
_TICKS = 16.0  # as many ticks of it, by their squares at twice that share, have to be seen
_EXPLAINED = 0.65  # share of y's squares that the best latency has to explain
_LEAST_GAIN = 0.3  # of a robot that may be so much heavier or lighter than believed
_OLD_NS = 100_000_000


class MotionEcho:
    """Estimates the latency from the sampling instant of a state to the effect of the command that it led to.

    ``s`` is the latency [s]: ``configured_s`` until the motion has shown another one, then that. It is in steps of 1 ms
    and less than 40 ms more: a link adds to what is known of it, and takes nothing away. A lag of the motors counts as
    latency, which is what a law has to compensate for.
    """

    def __init__(self, model: RobotModel, configured_s: float) -> None:
        self._model = model
        self._late_s = np.arange(configured_s, configured_s + _MORE_S + 0.5 * _STEP_S, _STEP_S)
        self._most_s = configured_s + _MORE_S
        force_n = body_wrench(Wheels(*[model.torque_limit_n_m] * 4), model.wheel_radius_m, model.lever_m).forward_n
        self._least_n = _SHOWS * force_n
        self.s = configured_s
        self.restart()

    def restart(self) -> None:
        """Start again, with a robot whose clock may have restarted. ``s`` keeps its value."""
        self._at_ns = -1
        zero = np.zeros_like(self._late_s)
        self._xx, self._xy, self._yy = zero, zero, 0.0
        self._begin()

    def _begin(self) -> None:
        self._times: deque[float] = deque([0.0])
        self._pushed: deque[tuple[float, float]] = deque([(0.0, 0.0)])  # C at these times
        self._force = 0.0, 0.0
        self._was_limited = False
        self._before: list[tuple[float, np.ndarray, tuple[float, float]]] = []  # of two ticks: time, C, velocity

    def update(self, torque_n_m: Wheels, state: State, sampled_ns: int, *, is_limited: bool) -> float:
        """Add a tick: the command that was sent, and the state that it was computed from, at this robot's time [ns].

        From a tick in which a limiter acted, as on wheels that slip, nothing is learnt. Return ``s``.
        """
        (_, _, heading_rad), (vx, vy, _) = state
        passed_ns = sampled_ns - self._at_ns
        if not (0 < passed_ns < _OLD_NS and isfinite(vx + vy + sum(torque_n_m))):
            self._begin()
        else:
            self._advance(passed_ns * 1e-9, (vx, vy), is_limited=is_limited)
        self._at_ns = sampled_ns
        forward, left, _ = body_wrench(torque_n_m, self._model.wheel_radius_m, self._model.lever_m)
        c, s = cos(heading_rad), sin(heading_rad)
        self._force = c * forward - s * left, s * forward + c * left
        return self.s

    def _advance(self, dt_s: float, velocity: tuple[float, float], *, is_limited: bool) -> None:
        now_s = self._times[-1] + dt_s
        (x, y), (fx, fy) = self._pushed[-1], self._force
        self._times.append(now_s)
        self._pushed.append((x + dt_s * fx, y + dt_s * fy))
        while len(self._times) > 2 and self._times[1] < now_s - self._most_s:
            self._times.popleft()
            self._pushed.popleft()
        self._was_limited = self._was_limited or is_limited
        if self._before and now_s - self._before[-1][0] < _WINDOW_S:
            return
        pushed = np.array(self._pushed)
        at_s = now_s - self._late_s
        integral = np.stack([np.interp(at_s, self._times, pushed[:, axis]) for axis in (0, 1)])
        if len(self._before) == 2 and not self._was_limited:
            self._compare(now_s, integral, velocity)
        self._was_limited = False
        self._before = [*self._before[-1:], (now_s, integral, velocity)]

    def _compare(self, now_s: float, integral: np.ndarray, velocity: tuple[float, float]) -> None:
        (t0, c0, v0), (t1, c1, v1) = self._before
        # As accelerations, so that ticks of another length count alike.
        x = (integral - c1) / (now_s - t1) - (c1 - c0) / (t1 - t0)
        if np.abs(x).max() < self._least_n:
            return
        last_s, before_s = now_s - t1, t1 - t0
        y = [(v - v1[axis]) / last_s - (v1[axis] - v0[axis]) / before_s for axis, v in enumerate(velocity)]
        self._xx = _FORGET * self._xx + (x * x).sum(axis=0)
        self._xy = _FORGET * self._xy + x[0] * y[0] + x[1] * y[1]
        self._yy = _FORGET * self._yy + y[0] * y[0] + y[1] * y[1]
        enough = _TICKS * (2.0 * self._least_n) ** 2
        seen = self._xx > enough
        explained = np.where(seen & (self._xy > 0.0), self._xy**2 / np.maximum(self._xx, enough), 0.0)
        best = int(explained.argmax())
        # The last one means that there is none among them, as where wheels slip.
        if best == len(explained) - 1 or not explained[best] >= _EXPLAINED * self._yy > 0.0:
            return
        if _LEAST_GAIN < self._model.effective_mass_kg * self._xy[best] / self._xx[best] < 1.0 / _LEAST_GAIN:
            self.s = float(self._late_s[best])
