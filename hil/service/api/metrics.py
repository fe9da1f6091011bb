"""Prometheus metrics of a service: base units, ``_total`` for counters, one family per quantity."""

from collections.abc import Iterable, Iterator
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
from hil.service.messages import Phase, Status, Task

_QUANTILES = {"p50": "0.5", "p99": "0.99", "p99.9": "0.999"}


class ServiceMetrics(Collector):
    """The metrics of a service, made from its newest status at each request."""

    def __init__(self, control: Control) -> None:
        self._control = control
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
        yield GaugeMetricFamily(
            "hil_status_age_seconds",
            "Age of the control process's last status; it sends 20 a second.",
            control.status_age_s,
        )
        yield GaugeMetricFamily("hil_api_live_clients", "Clients on the WebSocket.", len(control.watchers))
        orders = CounterMetricFamily("hil_api_orders", "Orders to the control process.", labels=("action", "outcome"))
        for (action, outcome), number in sorted(control.orders.items()):
            orders.add_metric((action.value, outcome), number)
        yield orders
        if control.received is not None:
            yield from _of_status(control.received)


def _of_status(status: Status) -> Iterator[Metric]:
    yield InfoMetricFamily(
        "hil_service",
        "What is served.",
        {"scenario": status.scenario, "law": status.law, "command": status.command, "link": status.link},
    )
    yield StateSetMetricFamily(
        "hil_phase", "State of the robot.", {phase.value: phase is status.phase for phase in Phase}
    )
    yield StateSetMetricFamily(
        "hil_task", "Task of an active robot.", {task.value: task is status.task for task in Task}
    )
    yield CounterMetricFamily("hil_ticks", "Ticks of the control loop.", status.ticks)
    yield CounterMetricFamily("hil_deadline_misses", "Ticks that began after their deadline.", status.deadline_misses)
    yield _lateness(status)
    yield from _gauges(status)
    yield from _frames(status.frames)
    yield CounterMetricFamily("hil_recoveries", "Losses of the robot that were recovered from.", status.recoveries)
    yield CounterMetricFamily("hil_rows_dropped", "Rows that the recorder had no room for.", status.rows_dropped)


def _lateness(status: Status) -> Metric:
    """Return the quantiles as a summary; the library has no family for quantiles computed elsewhere."""
    lateness = Metric("hil_lateness_seconds", "Start of a tick after its deadline, since the service began.", "summary")
    for name, quantile in _QUANTILES.items():
        if name in status.lateness_us:
            seconds = status.lateness_us[name] / 1e6
            lateness.add_sample("hil_lateness_seconds", {"quantile": quantile}, seconds)
    lateness.add_sample("hil_lateness_seconds_count", {}, status.ticks)
    return lateness


def _gauges(status: Status) -> Iterator[Metric]:
    """Yield the gauges; an unknown value is left out, as is usual for Prometheus."""
    for name, documentation, value in (
        ("hil_feedback_age_seconds", "Age of the feedback that the last tick used.", _seconds(status.feedback_age_ms)),
        ("hil_round_trip_seconds", "From a command to the feedback that shows it.", _seconds(status.round_trip_ms)),
        ("hil_battery_volts", "Battery of the robot.", status.battery_v),
        ("hil_twist_age_seconds", "Age of the twist in force.", status.twist_age_s),
        ("hil_power_stage", "1 when the robot has motors.", status.power_stage),
        ("hil_recording", "1 while a recording is written.", float(status.recording is not None)),
    ):
        if value is not None:
            yield GaugeMetricFamily(name, documentation, value)
    if status.speed_rad_s is not None:
        speeds = GaugeMetricFamily("hil_wheel_speed_radians_per_second", "Speed of a wheel.", labels=("wheel",))
        for wheel, speed in zip(WHEEL_NAMES, status.speed_rad_s, strict=True):
            speeds.add_metric((wheel,), speed)
        yield speeds


def _frames(frames: Any) -> Iterator[Metric]:
    for name, documentation in (("sent", "Frames to the robot."), ("received", "Frames from the robot.")):
        yield CounterMetricFamily(f"hil_frames_{name}", documentation, frames.get(name, 0))
    rejected = CounterMetricFamily(
        "hil_frames_rejected", "Frames from the robot that were not valid, by cause.", labels=("cause",)
    )
    for cause, number in sorted(frames.get("rejected", {}).items()):
        rejected.add_metric((cause,), number)
    yield rejected


def _seconds(milliseconds: float | None) -> float | None:
    return None if milliseconds is None else milliseconds / 1e3
