"""The status and the motion of a served robot, as they are sent to clients; made in a tick."""

import math
import time
from collections.abc import Sequence
from typing import Any

from hil.addons.service.messages import Motion
from hil.addons.service.pilot import Pilot
from hil.core.types import Gains, PoseFix
from hil.estimation.measurement import Counts
from hil.runtime.bench import Bench
from hil.runtime.realtime import RealTime
from hil.scenario import Scenario

_HEALTH = ("good", "degraded", "lost")
_WRAP = 1 << 16  # of an encoder's counts (DBC ENCODERS)


def bench_status(pilot: Pilot, bench: Bench, granted: RealTime) -> dict[str, Any]:
    """Return values of a ``Status`` by name; ``granted`` are the real-time settings that were granted or refused."""
    device, tasks = bench.device, pilot.tasks
    state, feedback, info = pilot.state, device.feedback, device.info
    gains, health = pilot.parts.controller.gains, pilot.parts.estimator.status.health
    return {
        "phase": pilot.phase,
        "task": tasks.task,
        "why": pilot.why,
        "link": device.describe_link(),
        "robot": None if info is None else info.describe(),
        "power_stage": None if info is None else info.has_power_stage,
        "pose": None if state is None else _known(state.pose),
        "twist": None if state is None else _known(state.twist),
        "reference": None if tasks.reference is None else _known(tasks.reference.pose),
        "speed_rad_s": None if feedback is None else _known(feedback.speed_rad_s),
        "battery_v": _finite(device.report.health.battery_v),
        "gains": {name: value for name, value in zip(Gains._fields, gains, strict=True) if math.isfinite(value)},
        "health": _HEALTH[int(health)] if math.isfinite(health) else None,
        "feedback_age_ms": pilot.feedback_age_ms,
        "round_trip_ms": _finite(device.link_figures()[3]),
        "frames": {"sent": device.sent, "received": device.received, "rejected": device.rejected()},
        "recoveries": pilot.recoveries,
        "twist_age_s": tasks.twist_age_s,
        "realtime": {setting.name: setting.sentence for setting in granted.settings},
    }


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
            current = _known(feedback.current_a)
            values = {
                "angle_rad": angle,
                "speed_rad_s": _known(feedback.speed_rad_s),
                "current_a": current,
                "torque_n_m": current and tuple(self._n_m_a * one for one in current),
                "yaw_rate_rad_s": _known((feedback.yaw_rate_rad_s,)) and feedback.yaw_rate_rad_s,
                "acceleration_m_s2": _known(feedback.acceleration_m_s2),
            }
        return Motion(
            time_unix_s=time_s,
            pose=state and _known(state.pose),
            twist=state and _known(state.twist),
            sigma=_known((status.sigma_position_m, status.sigma_heading_rad)),
            truth=truth and _known(truth.pose),
            true_twist=truth and _known(truth.twist),
            sequence=None if pilot.tasks.wheels is None else pilot.tasks.sequence,
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


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _known(values: Sequence[float]) -> Any:
    """Return the values as a tuple; None when one of them is unknown (NaN)."""
    return tuple(values) if math.isfinite(sum(values)) else None
