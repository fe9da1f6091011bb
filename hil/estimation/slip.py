"""Slip detection: the motion by the wheels contradicts itself, the gyro or the accelerometer."""

import math

from hil.estimation.wheel_motion import Motion

# One count within 1 ms is 0.1 m/s, so faster measurements are combined to 200 Hz, the rate of GYRO.
_SHORTEST_S = 0.0049
_WINDOW_S = 0.1
_ACCELEROMETER_WINDOW_S = 0.2
# A contradiction of the accelerometer up to this many times its usual size is noise.
_USUAL_TIMES = 4.0
# The usual contradiction is learnt over this time.
_USUAL_S = 5.0
# A contradiction counts as at most this many times the usual one, so lasting slip raises the usual one only slowly.
_MOST_UNUSUAL = 2.0
# Of a count: root mean square of a displacement in the plane by four angles, each with two errors spread evenly.
_COUNTED = math.sqrt(1.0 / 12.0)
# After more than this many usual intervals, measurements were lost.
_LOST = 1.5
# The usual interval is the mean of this many, fewer at the start. A longer one than 4 usual ones enters it as 4.
_USUAL_OF, _MOST_INTERVALS = 100, 4.0


class SlipDetector:
    """Compares, as speeds [m/s] over a short window, three pairs that agree while the wheels roll.

    - Front and rear wheels: the one combination of the four speeds that is 0 whenever a rigid robot rolls.
    - Wheels and gyro: the difference of the yaw rates times ``lever_m``, half the length plus half the width.
    - Wheels and accelerometer: the difference of the changes of velocity; only this shows four wheels that spin alike.

    Each difference goes through a leaky integrator of 0.1 s (0.2 s for the accelerometer), in which quantisation
    cancels out. Slip begins when one exceeds its threshold and ends when each is below half of its own. An unknown bias
    of the gyro adds to its difference, times ``lever_m``, and one of the accelerometer times 0.2 s.

    The threshold is ``threshold_m_s``, or as much as wheels that roll may differ by where their encoders move on by
    ``count_m`` at once. That of the accelerometer is four times the usual root mean square of its difference, if that
    is larger: it may shake. Its value is the mean of the last interval alone, so over lost measurements the
    accelerometer is not compared.
    """

    def __init__(self, lever_m: float, threshold_m_s: float, count_m: float = 0.0) -> None:
        self._lever_m = lever_m
        # Each of four angles is wrong by up to half a count, now and when the sum began.
        self._threshold_m_s = max(threshold_m_s, count_m / _WINDOW_S)
        self._least_m2_s2 = self._usual_m2_s2 = (threshold_m_s / _USUAL_TIMES) ** 2
        self._count_m = _COUNTED * count_m
        self.restart()

    def restart(self) -> None:
        """Start again, without slip."""
        self.is_slipping = False
        self._found_m_s = 0.0
        self._together: Motion | None = None
        self._disagreement_m = 0.0
        self._yaw_m = 0.0
        self._forward_m_s = 0.0
        self._left_m_s = 0.0
        self._last_m_s: tuple[float, float] | None = None
        self._usual_dt_s = 0.0
        self._intervals = 0

    def update(
        self, motion: Motion, gyro_bias_rad_s: float = 0.0, bias_m_s2: tuple[float, float] = (0.0, 0.0)
    ) -> float:
        """Add the next motion, of which gyro and accelerometer have these biases; return the speed of the slip [m/s].

        It is 0 without slip.
        """
        if self._together is not None:
            motion = self._together.and_then(motion)
        if motion.dt_s < _SHORTEST_S:
            self._together = motion
        else:
            self._together = None
            self._compare(motion, gyro_bias_rad_s, bias_m_s2)
        return self._found_m_s if self.is_slipping else 0.0

    def _compare(self, motion: Motion, gyro_bias_rad_s: float, bias_m_s2: tuple[float, float]) -> None:
        dt_s, gyro_rad, turned_rad = motion.dt_s, motion.gyro_rad, motion.turned_rad
        kept = math.exp(-dt_s / _WINDOW_S)
        self._disagreement_m = kept * (self._disagreement_m + motion.disagreement_m)
        if not math.isnan(gyro_rad):
            gyro_rad -= gyro_bias_rad_s * dt_s
            self._yaw_m = kept * (self._yaw_m + self._lever_m * (gyro_rad - turned_rad))
            turned_rad = gyro_rad
        found_m_s = max(abs(self._disagreement_m), abs(self._yaw_m)) / _WINDOW_S
        shaken_m_s = self._against_accelerometer(motion, turned_rad, bias_m_s2)
        self._found_m_s = max(found_m_s, shaken_m_s)
        share = 0.5 if self.is_slipping else 1.0
        noise_m_s = _USUAL_TIMES * math.sqrt(self._usual_m2_s2)
        self.is_slipping = found_m_s > share * self._threshold_m_s or shaken_m_s > share * noise_m_s

    def _against_accelerometer(self, motion: Motion, turned_rad: float, bias_m_s2: tuple[float, float]) -> float:
        dt_s = motion.dt_s
        forward_m_s, left_m_s = motion.forward_m / dt_s, motion.left_m / dt_s
        last, self._last_m_s = self._last_m_s, (forward_m_s, left_m_s)
        kept = math.exp(-dt_s / _ACCELEROMETER_WINDOW_S)
        self._forward_m_s *= kept
        self._left_m_s *= kept
        if self._has_lost(dt_s) or math.isnan(motion.gained_forward_m_s + motion.gained_left_m_s):
            # How the velocity changed is not known, and not how it will change from this interval's mean to the next.
            self._last_m_s = None
        elif last is not None:
            # In the turning body frame the velocity changes by the acceleration minus the yaw rate crossed with it.
            forward = motion.gained_forward_m_s - bias_m_s2[0] * dt_s + turned_rad * left_m_s - (forward_m_s - last[0])
            left = motion.gained_left_m_s - bias_m_s2[1] * dt_s - turned_rad * forward_m_s - (left_m_s - last[1])
            self._forward_m_s += kept * forward
            self._left_m_s += kept * left
        self._learn_usual(dt_s)
        return math.hypot(self._forward_m_s, self._left_m_s)

    def _has_lost(self, dt_s: float) -> bool:
        """Return whether measurements were lost in an interval, and learn from it which are usual."""
        usual_dt_s = self._usual_dt_s or dt_s
        self._intervals = min(self._intervals + 1, _USUAL_OF)
        self._usual_dt_s = usual_dt_s + (min(dt_s, _MOST_INTERVALS * usual_dt_s) - usual_dt_s) / self._intervals
        return dt_s > _LOST * usual_dt_s

    def _learn_usual(self, dt_s: float) -> None:
        usual_m2_s2 = self._usual_m2_s2
        found_m2_s2 = min(self._forward_m_s**2 + self._left_m_s**2, _MOST_UNUSUAL**2 * usual_m2_s2)
        learnt_m2_s2 = usual_m2_s2 + min(dt_s / _USUAL_S, 1.0) * (found_m2_s2 - usual_m2_s2)
        self._usual_m2_s2 = max(learnt_m2_s2, self._least_m2_s2, (self._count_m / dt_s) ** 2)
