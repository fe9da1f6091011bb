"""Prometheus metrics of a service: base units, ``_total`` for counters, one family per quantity."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from prometheus_client import CollectorRegistry
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from hil.core.types import WHEEL_NAMES
from hil.service.api.control import Control
from hil.service.messages import Phase, Task


class ServiceMetrics(Collector):
    """The metrics of a service, made from its newest status at each request.

    ``dropped`` are the numbers of connections that were dropped, by cause.
    """

    def __init__(self, control: Control, dropped: Mapping[str, int]) -> None:
        self._control = control
        self._dropped = dropped
        self._registry = CollectorRegistry()
        self._registry.register(self)

    def text(self, accept: str) -> tuple[bytes, str]:
        """Return the metrics and their content type, in the format that a client accepts."""
        encode, content_type = choose_encoder(accept)
        return encode(self._registry), content_type

    def describe(self) -> Iterable[Metric]:
        """Return nothing, because the families depend on the status."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Yield the families."""
        control = self._control
        documentation = "Age of the control process's last status; it sends 20 a second."
        yield GaugeMetricFamily("hil_status_age_seconds", documentation, control.status_age_s)
        yield GaugeMetricFamily("hil_api_live_clients", "Clients on the WebSocket.", len(control.watchers))
        orders = CounterMetricFamily("hil_api_orders", "Orders to the control process.", labels=("action", "outcome"))
        for (action, outcome), number in sorted(control.outcomes.items()):
            orders.add_metric((action.value, outcome), number)
        yield orders
        dropped = CounterMetricFamily(
            "hil_api_connections_dropped", "Connections that were dropped, by cause.", labels=("cause",)
        )
        for cause in ("late", "crowded", "flood", "unknown", "not_accepted"):
            dropped.add_metric((cause,), self._dropped.get(cause, 0))
        yield dropped
        documentation = "Lines that the audit log could not take."
        yield CounterMetricFamily("hil_api_audit_failures", documentation, control.audit.failures)
        if control.status is not None:
            yield from _of_status(control.status)


def _of_status(status: Mapping[str, Any]) -> Iterator[Metric]:
    """Yield the families of a status; an unknown value is left out, as is usual for Prometheus."""
    served = {name: status[name] for name in ("scenario", "law", "command", "link")}
    yield InfoMetricFamily("hil_service", "What is served.", served)
    for name, documentation, kind in (
        ("phase", "State of the robot.", Phase),
        ("task", "Task of an active robot.", Task),
    ):
        yield StateSetMetricFamily(f"hil_{name}", documentation, {one.value: one == status[name] for one in kind})
    frames = status["frames"]
    for name, documentation, number in (
        ("hil_ticks", "Ticks of the control loop.", status["ticks"]),
        ("hil_deadline_misses", "Ticks that began after their deadline.", status["deadline_misses"]),
        ("hil_recoveries", "Losses of the robot that were recovered from.", status["recoveries"]),
        ("hil_rows_dropped", "Rows that the recorder had no room for.", status["rows_dropped"]),
        ("hil_rows_lost", "Rows that the recorder could not write.", status["rows_lost"]),
        ("hil_frames_sent", "Frames to the robot.", frames["sent"]),
        ("hil_frames_received", "Frames from the robot.", frames["received"]),
    ):
        yield CounterMetricFamily(name, documentation, number)
    rejected = CounterMetricFamily(
        "hil_frames_rejected", "Frames from the robot that were not valid, by cause.", labels=("cause",)
    )
    for cause, number in sorted(frames["rejected"].items()):
        rejected.add_metric((cause,), number)
    yield rejected
    for name, documentation, value, unit in (
        ("feedback_age_seconds", "Age of the feedback that the last tick used.", status["feedback_age_ms"], 1e-3),
        ("round_trip_seconds", "From a command to the feedback that shows it.", status["round_trip_ms"], 1e-3),
        ("battery_volts", "Battery of the robot.", status["battery_v"], 1.0),
        ("twist_age_seconds", "Age of the twist in force.", status["twist_age_s"], 1.0),
        ("power_stage", "1 when the robot has motors.", status["power_stage"], 1.0),
        ("recording", "1 while a recording is written.", status["recording"] is not None, 1.0),
        ("recording_trouble", "1 when a recording cannot be written.", status["recording_trouble"] is not None, 1.0),
    ):
        if value is not None:
            yield GaugeMetricFamily(f"hil_{name}", documentation, value * unit)
    if status["speed_rad_s"] is not None:
        speeds = GaugeMetricFamily("hil_wheel_speed_radians_per_second", "Speed of a wheel.", labels=("wheel",))
        for wheel, speed in zip(WHEEL_NAMES, status["speed_rad_s"], strict=True):
            speeds.add_metric((wheel,), speed)
        yield speeds
    # The library has no family for quantiles that were computed elsewhere.
    lateness = Metric("hil_lateness_seconds", "Start of a tick after its deadline, since the service began.", "summary")
    for name, value_us in status["lateness_us"].items():
        if value_us is not None:
            quantile = {"quantile": f"{float(name[1:]) / 100.0:g}"}
            lateness.add_sample("hil_lateness_seconds", quantile, value_us / 1e6)
    lateness.add_sample("hil_lateness_seconds_count", {}, status["ticks"])
    yield lateness
