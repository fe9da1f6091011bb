"""The status of a service, as of now."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from hil.core.types import Gains, Wheels
from hil.robot.port import Identity
from hil.runtime.bench import Bench
from hil.runtime.lateness import Lateness
from hil.runtime.realtime import RealTime
from hil.scenario import Scenario
from hil.service.messages import Phase, Status
from hil.service.pilot import Pilot
from hil.service.records import Records

_HEALTH = ("good", "degraded", "lost")


class Counts:
    """What a service counts of its ticks."""

    def __init__(self) -> None:
        self.ticks = 0
        self.deadline_misses = 0
        self.lateness = Lateness()


class Now:
    """Makes statuses; ``without_bench`` while the link has not been opened yet.

    What stays the same is made once: this is done in a tick.
    """

    def __init__(self, scenario: Scenario, records: Records, counts: Counts) -> None:
        self._records = records
        self._counts = counts
        self._info: Identity | None = None
        self._granted: RealTime | None = None
        self._constant = Status(
            time_unix_s=0.0,
            phase=Phase.AWAY,
            task=None,
            why=None,
            scenario=scenario.name,
            law=scenario.controller.law,
            command=scenario.controller.command,
            link=scenario.link.url,
            robot=None,
            power_stage=None,
            pose=None,
            twist=None,
            reference=None,
            speed_rad_s=None,
            battery_v=None,
            gains={},
            health=None,
            ticks=0,
            deadline_misses=0,
            lateness_us={},
            feedback_age_ms=None,
            round_trip_ms=None,
            frames={"sent": 0, "received": 0, "rejected": {}},
            recoveries=0,
            recording=None,
            rows_dropped=0,
            twist_age_s=None,
            realtime={},
        )

    def without_bench(self, why: str | None) -> Status:
        """Return the status of a service whose link cannot be opened."""
        return replace(self._constant, why=why, **self._of_any())

    def status(self, pilot: Pilot, bench: Bench, granted: RealTime) -> Status:
        """Return the status of a service that ticks."""
        device, counts, parts = bench.device, self._counts, pilot.parts
        state, feedback = pilot.state, device.feedback
        if device.info is not self._info or granted is not self._granted:
            self._describe(device.info, granted)
        return replace(
            self._constant,
            **self._of_any(),
            phase=pilot.phase,
            task=pilot.conduct.task,
            why=pilot.why,
            link=device.describe_link(),
            pose=None if state is None else _three(state.pose),
            twist=None if state is None else _three(state.twist),
            reference=None if pilot.conduct.reference is None else _three(pilot.conduct.reference.pose),
            speed_rad_s=None if feedback is None else _four(feedback.speed_rad_s),
            battery_v=_known(device.report.health.battery_v),
            gains=_gains(parts.controller.gains),
            health=_health(parts.estimator.status.health),
            ticks=counts.ticks,
            deadline_misses=counts.deadline_misses,
            lateness_us=counts.lateness.percentiles_us(),
            feedback_age_ms=pilot.feedback_age_ms,
            round_trip_ms=_known(device.round_trip.ms),
            frames={"sent": device.sent, "received": device.received, "rejected": device.rejected()},
            recoveries=pilot.recoveries,
            twist_age_s=pilot.conduct.twist_age_s,
        )

    def _of_any(self) -> dict[str, Any]:
        path = self._records.path
        return {
            "time_unix_s": time.time(),
            "recording": None if path is None else str(path),
            "rows_dropped": self._records.rows_dropped,
        }

    def _describe(self, info: Identity | None, granted: RealTime) -> None:
        """Take note of the robot, once it has said what it is, and of what the operating system granted."""
        self._info, self._granted = info, granted
        self._constant = replace(
            self._constant,
            robot=None if info is None else info.describe(),
            power_stage=None if info is None else info.has_power_stage,
            realtime={setting.name: setting.sentence for setting in granted.settings},
        )


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _three(values: Sequence[float]) -> tuple[float, float, float] | None:
    x, y, heading = values
    return (x, y, heading) if math.isfinite(x + y + heading) else None


def _four(wheels: Wheels) -> tuple[float, float, float, float] | None:
    fl, fr, rr, rl = wheels
    return (fl, fr, rr, rl) if math.isfinite(sum(wheels)) else None


def _gains(gains: Gains) -> Mapping[str, float]:
    return {name: value for name, value in gains._asdict().items() if math.isfinite(value)}


def _health(value: float) -> str | None:
    return _HEALTH[int(value)] if math.isfinite(value) else None
