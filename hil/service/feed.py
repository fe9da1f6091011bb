"""The robot's motion as a service sends it to clients that ask for it, more often than the status."""

import math
import time

from hil.core.types import PoseFix
from hil.estimation.measurement import Counts
from hil.scenario import Scenario
from hil.service.messages import Motion
from hil.service.pilot import Pilot
from hil.service.status import known

_WRAP = 1 << 16  # of an encoder's counts (DBC ENCODERS)


class MotionFeed:
    """Makes a ``Motion`` of a pilot's newest tick, as often as it is wanted."""

    def __init__(self, scenario: Scenario, pilot: Pilot) -> None:
        self._pilot = pilot
        self._tick_hz = scenario.loop.rate_hz
        self._rad_a_count = 2.0 * math.pi / scenario.firmware.counts_per_revolution
        self._n_m_a = scenario.firmware.torque_constant_n_m_a
        self._before: Counts | None = None
        self._counted = (0, 0, 0, 0)

    def motion(self, rate_hz: float, tick: int, truth: PoseFix | None) -> Motion | None:
        """Return the motion at a tick that has just been done; None when ``rate_hz`` (0 for never) asks for none."""
        if not rate_hz or tick % max(1, round(self._tick_hz / rate_hz)):
            return None
        return self.at(time.time() - 1e-3 * (self._pilot.feedback_age_ms or 0.0), truth)

    def at(self, time_s: float, truth: PoseFix | None) -> Motion:
        """Return the motion of the newest tick, whose sample was taken at ``time_s``."""
        pilot = self._pilot
        state, feedback = pilot.state, pilot.parts.device.feedback
        status = pilot.parts.estimator.status
        values = {}
        if feedback is not None:
            angle = self._angle_rad(feedback.encoder_count)
            current = known(feedback.current_a)
            values = {
                "angle_rad": angle,
                "speed_rad_s": known(feedback.speed_rad_s),
                "current_a": current,
                "torque_n_m": current and tuple(self._n_m_a * one for one in current),
                "yaw_rate_rad_s": known((feedback.yaw_rate_rad_s,)) and feedback.yaw_rate_rad_s,
                "acceleration_m_s2": known(feedback.acceleration_m_s2),
            }
        return Motion(
            time_unix_s=time_s,
            pose=state and known(state.pose),
            twist=state and known(state.twist),
            sigma=known((status.sigma_position_m, status.sigma_heading_rad)),
            truth=truth and known(truth.pose),
            true_twist=truth and known(truth.twist),
            sequence=None if pilot.conduct.wheels is None else pilot.conduct.sequence,
            **values,
        )

    def _angle_rad(self, counts: Counts) -> tuple[float, ...]:
        """Return how far each wheel has turned since the first call; it may turn eight times between two calls."""
        if self._before is not None:
            half = _WRAP // 2
            self._counted = tuple(  # type: ignore[assignment]
                total + (now - before + half) % _WRAP - half
                for total, now, before in zip(self._counted, counts, self._before, strict=True)
            )
        self._before = counts
        return tuple(self._rad_a_count * count for count in self._counted)
