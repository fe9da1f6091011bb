"""Extended state observer of one axis: position, rate, and the acceleration that no command explains.

The axis is ẍ = u + d with a commanded acceleration u that is known and a disturbance d that changes slowly:
friction, a wrong mass, a force from outside. The observer uses the measured x alone, so late or noisy
wheel speeds do not disturb it. It predicts exactly for a piecewise constant u and a constant d, and then corrects its
estimates by the innovation ε = x - x̂:

    x̂ += (1 - β³) ε,    v̂ += 3/2 (1 - β)² (1 + β) / T ε,    d̂ += (1 - β)³ / T² ε,    β = exp(-ωo T)

This puts the three poles of its error at β, as (s + ωo)³ does in continuous time (J. Han, "From PID to active
disturbance rejection control", IEEE Trans. Ind. Electron. 56, 2009; the gains in discrete time: R. Miklosovic,
A. Radke and Z. Gao, "Discrete implementation and generalization of the extended state observer", ACC 2006).
"""

import math


class ExtendedStateObserver:
    """Observes one axis. Its unit is m or rad, and so are those of its rate (per s) and acceleration (per s²).

    ``bandwidth_rad_s`` is ωo. The disturbance is limited to ±``disturbance_limit``. Raises ValueError unless both are
    finite and greater than zero. ``position``, ``rate`` and ``disturbance`` are the estimates at the last measurement.
    """

    __slots__ = ("_bandwidth_rad_s", "_dt_s", "_gains", "_limit", "disturbance", "position", "rate")

    def __init__(self, bandwidth_rad_s: float, disturbance_limit: float) -> None:
        for value in (bandwidth_rad_s, disturbance_limit):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"observer: {value!r}: expected a finite number, more than zero")
        self._bandwidth_rad_s = bandwidth_rad_s
        self._limit = disturbance_limit
        self._dt_s = 0.0
        self._gains = (0.0, 0.0, 0.0)
        self.reset(0.0, 0.0)

    def reset(self, position: float, rate: float) -> None:
        """Start at this position and rate with zero disturbance."""
        self.position = position
        self.rate = rate
        self.disturbance = 0.0

    def update(self, measured: float, displacement: float, rate_change: float, dt_s: float) -> None:
        """Predict over ``dt_s`` [s], then correct by the position ``measured`` now.

        ``displacement`` and ``rate_change`` are the motion that the commanded acceleration alone causes over that
        time from rest. ``hil.laws.prediction.PendingCommands`` computes them for delayed commands.
        """
        if dt_s != self._dt_s:
            self._dt_s = dt_s
            self._gains = observer_gains(self._bandwidth_rad_s, dt_s)
        to_position, to_rate, to_disturbance = self._gains
        disturbed = self.disturbance * dt_s
        position = self.position + dt_s * (self.rate + 0.5 * disturbed) + displacement
        innovation = measured - position
        self.position = position + to_position * innovation
        self.rate += disturbed + rate_change + to_rate * innovation
        disturbance = self.disturbance + to_disturbance * innovation
        limit = self._limit
        self.disturbance = limit if disturbance > limit else -limit if disturbance < -limit else disturbance


def observer_gains(bandwidth_rad_s: float, dt_s: float) -> tuple[float, float, float]:
    """Return the gains of position [1], rate [1/s] and disturbance [1/s²] that put all poles at exp(-ωo T)."""
    rest = -math.expm1(-bandwidth_rad_s * dt_s)
    beta = 1.0 - rest
    return 1.0 - beta**3, 1.5 * rest * rest * (1.0 + beta) / dt_s, rest**3 / (dt_s * dt_s)
