"""What the two processes of a service tell each other, one JSON text a line: orders one way, answers and status back.

The API process checks the form of what comes from outside; whether an order makes sense now, only the control process
knows, and it refuses with a sentence.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any


class Phase(StrEnum):
    """Where the robot is on its way, as the service sees it."""

    AWAY = "away"
    """No link or no answer: it is being reconnected."""
    DISARMED = "disarmed"
    ARMING = "arming"
    ACTIVE = "active"
    """Armed: it moves, or is held at rest."""
    STOPPING = "stopping"
    """Ramping down, to be disarmed."""
    FAULT = "fault"
    """Latched; ``clear`` leads out of it when the cause is gone."""
    ESTOP = "estop"
    """Latched; ``clear`` leads out of it."""


class Task(StrEnum):
    """What an ACTIVE robot is doing."""

    HOLD = "hold"
    """At rest, where it is."""
    TRACK = "track"
    GO = "go"
    TWIST = "twist"


class Action(StrEnum):
    """What may be asked of the control process, and with which ``arguments``."""

    ARM = "arm"
    DISARM = "disarm"
    """Ramp down, and to IDLE."""
    ESTOP = "estop"
    CLEAR = "clear"
    """Leave FAULT or ESTOP; arms nothing."""
    TRACK = "track"
    """``reference``: kind and options as in ``[reference]``, or None for the configuration's. ``here``: begin it where
    the robot stands; else the robot drives to its begin first."""
    GO = "go"
    """``x_m``, ``y_m``, ``heading_rad``: a pose in the world frame, by the shorter turn."""
    TWIST = "twist"
    """``vx_m_s``, ``vy_m_s``, ``yaw_rate_rad_s``: in the body frame, in force for ``service.twist_timeout_s``."""
    STOP = "stop"
    """Ramp down to rest, and hold; the robot stays armed."""
    GAINS = "gains"
    """``gains``: the law's own numbers, over those of the configuration; None reads ``[controller]`` again from its
    file."""
    RECORD = "record"
    """``path``: an .rrd or .mcap file, None for a name by scenario and time."""
    STOP_RECORDING = "stop_recording"
    SHUTDOWN = "shutdown"
    """Ramp down, disarm, close the recording and end."""


LONG = frozenset({Action.RECORD, Action.STOP_RECORDING, Action.TRACK, Action.GAINS})
"""What reads files, or starts or ends a recorder, and is answered when that is done; the ticks go on meanwhile."""


MOVING = frozenset({Action.ARM, Action.CLEAR, Action.TRACK, Action.GO, Action.TWIST, Action.GAINS})
"""What can make the robot move, now or later: never done of an order that has waited through a stall."""


SILENT_S = 1.0
"""An API process that gives no sign of life for so long, where one comes each 0.1 s, can stop nothing."""


@dataclass(frozen=True, slots=True)
class Order:
    """Something asked of the control process. ``number`` is that of the answer."""

    number: int
    action: Action
    arguments: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of an order: accepted, or ``refused`` with a sentence; ``result`` where there is more to say."""

    number: int
    refused: str | None = None
    result: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Status:
    """The service at one instant; what is not known is None. Sent 20 times a second, and at each change of phase.

    Attributes:
        time_unix_s: when it was taken. phase, task: see there; ``task`` only while ACTIVE. why: the last thing that
            went wrong, as a sentence, or None since the last success.
        scenario, law, command: what is served. link, robot: in words. power_stage: whether the robot has motors; None
            before it has answered.
        pose: x [m], y [m], heading [rad]; twist: in the world frame [m/s, rad/s]; reference: pose, while ACTIVE.
        speed_rad_s: of the four wheels. battery_v. gains: of the law, by name. health: of the estimator.
        ticks: since the service began. deadline_misses. lateness_us: p50, p99 and p99.9 since the service began, by
            these names. feedback_age_ms, round_trip_ms.
        frames: sent, received, and rejected by cause. recoveries: losses that were recovered from.
        recording: path of the file being written, or None. rows_dropped. twist_age_s: age of the twist in force.
        realtime: what was asked of the operating system and what was granted, by name, as sentences.
    """

    time_unix_s: float
    phase: Phase
    task: Task | None
    why: str | None
    scenario: str
    law: str
    command: str
    link: str
    robot: str | None
    power_stage: bool | None
    pose: tuple[float, float, float] | None
    twist: tuple[float, float, float] | None
    reference: tuple[float, float, float] | None
    speed_rad_s: tuple[float, float, float, float] | None
    battery_v: float | None
    gains: Mapping[str, float]
    health: str | None
    ticks: int
    deadline_misses: int
    lateness_us: Mapping[str, float]
    feedback_age_ms: float | None
    round_trip_ms: float | None
    frames: Mapping[str, Any]
    recoveries: int
    recording: str | None
    rows_dropped: int
    twist_age_s: float | None
    realtime: Mapping[str, str]


def to_line(message: Order | Answer | Status) -> dict[str, Any]:
    """Return a message as the record of one line, by its kind: ``{"order": {...}}`` and so on."""
    # Not asdict, which copies deep: the control process does this in a tick.
    return {type(message).__name__.lower(): {one.name: getattr(message, one.name) for one in fields(message)}}


def from_line(record: Mapping[str, Any]) -> Order | Answer | Status:
    """Return the message of a line. Raises ValueError for what is none."""
    ((kind, values),) = record.items()
    if kind == "order":
        return Order(values["number"], Action(values["action"]), values["arguments"])
    if kind == "answer":
        return Answer(**values)
    if kind == "status":
        task = None if values["task"] is None else Task(values["task"])
        return Status(**{**values, "phase": Phase(values["phase"]), "task": task})
    raise ValueError(f"{kind!r} is no message of a service")
