"""Where each signal is in a recording: few entities, each a vector of signals of one kind.

The number of entities, not of signals, drives a recording's size and cost. The file says which signals an entity holds,
so a reader needs no table of its own, and an old file stays readable when signals are added.
"""

import itertools
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from hil.core.signals import unit_of
from hil.core.types import WHEEL_NAMES
from hil.pages.plots import (
    ALARM_COLOUR,
    ESTIMATE_COLOUR,
    HEADING_COLOUR,
    PLAIN_COLOUR,
    REFERENCE_COLOUR,
    TRUTH_COLOUR,
    WHEEL_COLOURS,
    X_COLOUR,
    Y_COLOUR,
    Colour,
)

MORE_PATH = "/more"
NO_UNIT = "number"
_MORE_COLOURS = (*WHEEL_COLOURS, X_COLOUR, HEADING_COLOUR, PLAIN_COLOUR, TRUTH_COLOUR)
# A unit as part of a path.
_UNIT_PATHS = {"m/s²": "m_s2", "rad/s": "rad_s", "m/s": "m_s", "N·m": "n_m", "1/s": "1_s", "°C": "degc", "%": "percent"}
_AXES = ("x", "y", "heading")
_OF_AXES = {
    "pose": ("x_m", "y_m", "heading_rad"),
    "twist": ("vx_m_s", "vy_m_s", "yaw_rate_rad_s"),
    "acceleration": ("ax_m_s2", "ay_m_s2", "yaw_acceleration_rad_s2"),
}
_AXIS_COLOURS = (X_COLOUR, Y_COLOUR, HEADING_COLOUR)


class Series(NamedTuple):
    """One signal as it is drawn: its name, its label in the legend, and its colour."""

    signal: str
    label: str
    colour: Colour


class Entity(NamedTuple):
    """A path of the recording and the signals that it holds, in the order of its vector."""

    path: str
    series: tuple[Series, ...]
    width_px: float = 1.5
    plot: str | None = None
    """The path of the entity with which it is drawn, if that is another one."""


def _entity(path: str, *series: tuple[str, str, Colour]) -> Entity:
    return Entity(path, tuple(itertools.starmap(Series, series)))


def _wheels(path: str, quantity: str) -> Entity:
    each = zip(WHEEL_NAMES, WHEEL_COLOURS, strict=True)
    return _entity(path, *((f"wheel.{wheel}.{quantity}", wheel.upper(), colour) for wheel, colour in each))


def _wide_wheels(path: str, quantity: str) -> Entity:
    """Wheels drawn wide and dim, so that the same wheels of another entity show on top of them."""
    series = [
        Series(signal, f"{label} cmd", dimmed(colour)) for signal, label, colour in _wheels(path, quantity).series
    ]
    return Entity(path, tuple(series), width_px=5.0)


def dimmed(colour: Colour) -> Colour:
    """Return a darker tone of a colour."""
    red, green, blue = colour
    return red // 2, green // 2, blue // 2


def _axes(path: str, pattern: str) -> Entity:
    """Return an entity of x, y and heading; ``pattern`` is a name with ``{}`` for the axis, or a group of signals."""
    names = _AXES if "{}" in pattern else _OF_AXES[path.split("/")[2]]
    signals = [pattern.format(name) if "{}" in pattern else f"{pattern}.{name}" for name in names]
    return _entity(path, *zip(signals, _AXES, _AXIS_COLOURS, strict=True))


_ENTITIES = (
    _entity("/loop/clock", ("loop.t_s", "t", PLAIN_COLOUR), ("loop.tick", "tick", PLAIN_COLOUR)),
    _entity(
        "/loop/timing", ("loop.tick_us", "work of a tick", TRUTH_COLOUR),
        ("loop.lateness_us", "lateness", REFERENCE_COLOUR),
    ),
    _entity("/loop/deadline_misses", ("loop.deadline_misses", "deadline misses", ALARM_COLOUR)),
    _axes("/ctrl/pose/reference", "reference"),
    _axes("/ctrl/twist/reference", "reference"),
    _axes("/ctrl/acceleration/reference", "reference"),
    _axes("/ctrl/pose/estimate", "pose"),
    _axes("/ctrl/twist/estimate", "twist"),
    _axes("/ctrl/pose/truth", "truth"),
    _entity(
        "/ctrl/error/position", ("error.x_m", "x", X_COLOUR), ("error.y_m", "y", Y_COLOUR),
        ("error.planar_m", "planar", PLAIN_COLOUR),
    ),
    _entity("/ctrl/error/heading", ("error.heading_rad", "heading", HEADING_COLOUR)),
    _axes("/ctrl/gain/k1", "gain.k1_{}_1_s"),
    _axes("/ctrl/gain/k2", "gain.k2_{}_1_s"),
    # "command" sorts before "speed": the viewer draws in the order of the paths.
    _wide_wheels("/ctrl/wheel/command/speed", "speed_command_rad_s"),
    _wheels("/ctrl/wheel/speed", "speed_rad_s"),
    _wheels("/ctrl/wheel/command/torque", "torque_command_n_m"),
    _wheels("/ctrl/wheel/current", "current_a"),
    _wheels("/ctrl/wheel/temperature", "temperature_degc"),
    _entity(
        "/ctrl/estimator/sigma", ("estimator.sigma_position_m", "position [m]", PLAIN_COLOUR),
        ("estimator.sigma_heading_rad", "heading [rad]", HEADING_COLOUR),
    ),
    _entity("/ctrl/estimator/gyro_bias", ("estimator.gyro_bias_rad_s", "gyro bias", HEADING_COLOUR)),
    _entity(
        "/ctrl/estimator/factors", ("estimator.wheel_scale", "true way forward", PLAIN_COLOUR),
        ("estimator.left_scale", "true way to the left", REFERENCE_COLOUR),
        ("estimator.gyro_scale", "true turn", HEADING_COLOUR),
        ("estimator.fix_noise", "noise of fixes", ESTIMATE_COLOUR),
    ),
    _entity(
        "/ctrl/estimator/fixes", ("estimator.fixes_accepted", "accepted", ESTIMATE_COLOUR),
        ("estimator.fixes_rejected", "rejected", ALARM_COLOUR),
        ("estimator.fix_restarts", "restarts", PLAIN_COLOUR),
    ),
    _entity(
        "/ctrl/estimator/fix", ("estimator.fix_x_m", "x", X_COLOUR), ("estimator.fix_y_m", "y", Y_COLOUR),
        ("estimator.fix_heading_rad", "heading", HEADING_COLOUR), ("estimator.fix_time_s", "stamp", PLAIN_COLOUR),
    ),
    _entity("/ctrl/estimator/fix_age", ("estimator.fix_age_ms", "fix age", PLAIN_COLOUR)),
    _entity(
        "/ctrl/estimator/state", ("estimator.slip", "slip", REFERENCE_COLOUR),
        ("estimator.health", "health", ALARM_COLOUR),
    ),
    _entity("/ctrl/guard", ("guard.saturated", "saturated", ALARM_COLOUR), ("guard.held", "held", REFERENCE_COLOUR)),
    _entity("/ctrl/limiter", ("guard.taken_n_m", "taken", ALARM_COLOUR), ("guard.limit", "limit", REFERENCE_COLOUR)),
    _entity("/robot/clock", ("robot.time_s", "robot time", PLAIN_COLOUR)),
    _entity("/robot/state_code", ("robot.state", "state", PLAIN_COLOUR)),
    _entity(
        "/robot/acceleration", ("robot.acceleration_x_m_s2", "forward", X_COLOUR),
        ("robot.acceleration_y_m_s2", "left", Y_COLOUR), ("robot.acceleration_z_m_s2", "up", PLAIN_COLOUR),
    ),
    _entity(
        "/robot/battery", ("battery.voltage_v", "voltage", TRUTH_COLOUR),
        ("battery.current_a", "current", REFERENCE_COLOUR),
    ),
    _entity("/robot/gyro", ("robot.yaw_rate_rad_s", "yaw rate", HEADING_COLOUR)),
    _entity(
        "/link/age", ("robot.command_age_ms", "command", REFERENCE_COLOUR),
        ("link.feedback_age_ms", "feedback", TRUTH_COLOUR),
    ),
    _entity(
        "/link/frames", ("link.sent", "sent", REFERENCE_COLOUR), ("link.received", "received", TRUTH_COLOUR),
        ("link.rejected", "rejected", ALARM_COLOUR), ("link.lost", "snapshots lost", HEADING_COLOUR),
    ),
    _entity(
        "/link/bytes", ("link.sent_bytes", "sent", REFERENCE_COLOUR), ("link.received_bytes", "received", TRUTH_COLOUR),
    ),
    _entity("/link/load", ("link.load_percent", "load", PLAIN_COLOUR)),
    _entity(
        "/link/delay", ("link.rtt_ms", "round trip", PLAIN_COLOUR), ("link.latency_ms", "latency", REFERENCE_COLOUR),
    ),
    _entity("/link/clock/offset", ("link.clock_offset_us", "offset", PLAIN_COLOUR)),
    _entity("/link/clock/drift", ("link.clock_drift_ppm", "drift", PLAIN_COLOUR)),
)  # fmt: skip


def layout(signals: Sequence[str]) -> tuple[Entity, ...]:
    """Return the entities that hold exactly these signals.

    A signal that is not in ``_ENTITIES`` goes to ``/more/GROUP/UNIT``. GROUP is the first part of its name. A
    quantity that each axis has, such as ``fuzzy.x.rule``, gets a group of its own, ``fuzzy/rule``, because its scale
    differs from that of other quantities.
    """
    missing = dict.fromkeys(signals)
    placed = []
    for entity in _ENTITIES:
        series = tuple(one for one in entity.series if one.signal in missing)
        if series:
            placed.append(entity._replace(series=series))
            for one in series:
                del missing[one.signal]
    return (*placed, *_remaining(missing))


def _remaining(signals: Iterable[str]) -> list[Entity]:
    groups: dict[str, list[Series]] = {}
    for signal in signals:
        group, label = _group(signal)
        path = f"{MORE_PATH}/{group}/{_UNIT_PATHS.get(unit := unit_of(signal), unit) or NO_UNIT}"
        groups.setdefault(path, []).append(Series(signal, label or signal, PLAIN_COLOUR))
    return [Entity(path, _coloured(series)) for path, series in groups.items()]


def _group(signal: str) -> tuple[str, str]:
    """Return the group of a signal's name, and its label within that group."""
    parts = signal.split(".")
    if len(parts) > 2 and parts[-2] in _AXES:
        return "/".join((*parts[:-2], parts[-1])), parts[-2]
    return parts[0], ".".join(parts[1:])


def _coloured(series: Sequence[Series]) -> tuple[Series, ...]:
    """Give each series a colour: that of its wheel or axis, if it names one, else the next one."""
    named = dict(zip((*WHEEL_NAMES, *_AXES), (*WHEEL_COLOURS, *_AXIS_COLOURS), strict=True))
    return tuple(
        one._replace(colour=next((named[word] for word in re.split(r"[._]", one.label) if word in named), other))
        for one, other in zip(series, itertools.cycle(_MORE_COLOURS), strict=False)
    )
