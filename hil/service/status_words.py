"""The status of a service as rows for a person: what, and how it is."""

import math
from collections.abc import Mapping
from typing import Any


def status_rows(status: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return rows of two words each; what is not known is left out."""
    rows = [
        ("phase", _phase(status)),
        ("why", status["why"]),
        ("serves", f"{status['scenario']}, {status['law']} in {status['command']} mode"),
        ("link", status["link"]),
        ("robot", _robot(status)),
        ("pose", _pose(status["pose"])),
        ("reference", _pose(status["reference"])),
        ("twist", _twist(status["twist"])),
        ("wheels", _numbers(status["speed_rad_s"], ".2f", "rad/s")),
        ("battery", _number(status["battery_v"], ".1f", "V")),
        ("estimator", status["health"]),
        ("gains", ", ".join(f"{name} {value:g}" for name, value in status["gains"].items())),
        ("ticks", f"{status['ticks']}, {status['deadline_misses']} late by a period or more"),
        (
            "lateness",
            ", ".join(f"{name} {_number(value, '.0f', 'µs')}" for name, value in status["lateness_us"].items()),
        ),
        ("feedback age", _number(status["feedback_age_ms"], ".2f", "ms")),
        ("round trip", _number(status["round_trip_ms"], ".2f", "ms")),
        ("frames", _frames(status["frames"])),
        ("recoveries", str(status["recoveries"])),
        ("recording", _recording(status)),
        *((name, sentence.removeprefix(f"{name}: ")) for name, sentence in status["realtime"].items()),
    ]
    return [(name, text) for name, text in rows if text]


def _phase(status: Mapping[str, Any]) -> str:
    task = status["task"]
    return status["phase"] if task is None else f"{status['phase']}, {task}"


def _robot(status: Mapping[str, Any]) -> str | None:
    robot: str | None = status["robot"]
    if robot is None or status["power_stage"] is None:
        return robot
    return f"{robot}, {'with motors' if status['power_stage'] else 'without motors'}"


def _pose(pose: Any) -> str | None:
    if pose is None or None in pose:
        return None
    x_m, y_m, heading_rad = pose
    return f"{x_m:.3f} m, {y_m:.3f} m, {math.degrees(heading_rad):.1f}°"


def _twist(twist: Any) -> str | None:
    if twist is None or None in twist:
        return None
    vx_m_s, vy_m_s, yaw_rate_rad_s = twist
    return f"{vx_m_s:.3f} m/s, {vy_m_s:.3f} m/s, {yaw_rate_rad_s:.3f} rad/s"


def _numbers(values: Any, form: str, unit: str) -> str | None:
    return None if values is None or None in values else f"{', '.join(format(value, form) for value in values)} {unit}"


def _number(value: float | None, form: str, unit: str) -> str | None:
    return None if value is None else f"{value:{form}} {unit}"


def _frames(frames: Mapping[str, Any]) -> str:
    rejected = ", ".join(f"{number} {cause}" for cause, number in frames.get("rejected", {}).items() if number)
    return f"{frames.get('sent', 0)} sent, {frames.get('received', 0)} received, rejected: {rejected or 'none'}"


def _recording(status: Mapping[str, Any]) -> str | None:
    if status["recording"] is None:
        return None
    dropped = f", {status['rows_dropped']} rows dropped" if status["rows_dropped"] else ""
    return f"{status['recording']}{dropped}"
