"""The status of a service, made in a tick from its parts."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hil.robot.port import Identity
from hil.runtime.bench import Bench
from hil.runtime.lateness import Lateness
from hil.runtime.realtime import RealTime
from hil.service.messages import Status
from hil.service.pilot import Pilot
from hil.service.records import Records

_HEALTH = ("good", "degraded", "lost")


class Counts:
    """Counters of a service's ticks."""

    def __init__(self) -> None:
        self.ticks = 0
        self.deadline_misses = 0
        self.lateness = Lateness()


class StatusMaker:
    """Makes statuses in a tick; the constant part is made once. ``without_bench`` is for a service whose link is not
    open.
    """

    def __init__(self, constant: Status, records: Records, counts: Counts) -> None:
        self._records = records
        self._counts = counts
        self._info: Identity | None = None
        self._granted: RealTime | None = None
        self._constant = constant

    def without_bench(self, why: str | None) -> Status:
        """Return the status of a service whose link cannot be opened."""
        return replace(self._constant, why=why, **self._recording())

    def status(self, pilot: Pilot, bench: Bench, granted: RealTime) -> Status:
        """Return the status of a service that ticks."""
        device, counts, parts, conduct = bench.device, self._counts, pilot.parts, pilot.conduct
        state, feedback = pilot.state, device.feedback
        if device.info is not self._info or granted is not self._granted:
            self._describe(device.info, granted)
        return replace(
            self._constant,
            **self._recording(),
            phase=pilot.phase,
            task=conduct.task,
            why=pilot.why,
            link=device.describe_link(),
            pose=None if state is None else _known(state.pose),
            twist=None if state is None else _known(state.twist),
            reference=None if conduct.reference is None else _known(conduct.reference.pose),
            speed_rad_s=None if feedback is None else _known(feedback.speed_rad_s),
            battery_v=_finite(device.report.health.battery_v),
            gains={name: value for name, value in parts.controller.gains._asdict().items() if math.isfinite(value)},
            health=_health(parts.estimator.status.health),
            ticks=counts.ticks,
            deadline_misses=counts.deadline_misses,
            lateness_us=counts.lateness.percentiles_us(),
            feedback_age_ms=pilot.feedback_age_ms,
            round_trip_ms=_finite(device.round_trip.ms),
            frames={"sent": device.sent, "received": device.received, "rejected": device.rejected()},
            recoveries=pilot.recoveries,
            twist_age_s=conduct.twist_age_s,
        )

    def _recording(self) -> dict[str, Any]:
        path = self._records.path
        recording = None if path is None else str(path)
        return {"time_unix_s": time.time(), "recording": recording, "rows_dropped": self._records.rows_dropped}

    def _describe(self, info: Identity | None, granted: RealTime) -> None:
        """Store the robot's identity and the real-time settings that were granted or refused."""
        self._info, self._granted = info, granted
        self._constant = replace(
            self._constant,
            robot=None if info is None else info.describe(),
            power_stage=None if info is None else info.has_power_stage,
            realtime={setting.name: setting.sentence for setting in granted.settings},
        )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _known(values: Sequence[float]) -> Any:
    """Return the values as a tuple; None when one of them is unknown (NaN)."""
    return tuple(values) if math.isfinite(sum(values)) else None


def _health(value: float) -> str | None:
    return _HEALTH[int(value)] if math.isfinite(value) else None
