"""The part of a service's status that a robot on a bench gives, made in a tick."""

import math
from collections.abc import Sequence
from typing import Any

from hil.core.types import Gains
from hil.runtime.bench import Bench
from hil.runtime.realtime import RealTime
from hil.service.pilot import Pilot

_HEALTH = ("good", "degraded", "lost")


def bench_status(pilot: Pilot, bench: Bench, granted: RealTime) -> dict[str, Any]:
    """Return values of a ``Status`` by name; ``granted`` are the real-time settings that were granted or refused."""
    device, conduct = bench.device, pilot.conduct
    state, feedback, info = pilot.state, device.feedback, device.info
    gains, health = pilot.parts.controller.gains, pilot.parts.estimator.status.health
    return {
        "phase": pilot.phase,
        "task": conduct.task,
        "why": pilot.why,
        "link": device.describe_link(),
        "robot": None if info is None else info.describe(),
        "power_stage": None if info is None else info.has_power_stage,
        "pose": None if state is None else known(state.pose),
        "twist": None if state is None else known(state.twist),
        "reference": None if conduct.reference is None else known(conduct.reference.pose),
        "speed_rad_s": None if feedback is None else known(feedback.speed_rad_s),
        "battery_v": _finite(device.report.health.battery_v),
        "gains": {name: value for name, value in zip(Gains._fields, gains, strict=True) if math.isfinite(value)},
        "health": _HEALTH[int(health)] if math.isfinite(health) else None,
        "feedback_age_ms": pilot.feedback_age_ms,
        "round_trip_ms": _finite(device.link_figures()[3]),
        "frames": {"sent": device.sent, "received": device.received, "rejected": device.rejected()},
        "recoveries": pilot.recoveries,
        "twist_age_s": conduct.twist_age_s,
        "realtime": {setting.name: setting.sentence for setting in granted.settings},
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def known(values: Sequence[float]) -> Any:
    """Return the values as a tuple; None when one of them is unknown (NaN)."""
    return tuple(values) if math.isfinite(sum(values)) else None
