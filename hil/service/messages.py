"""Messages between the two processes of a service, one JSON text per line: orders one way, answers and status back.

The API process checks the form of an order. Only the control process knows whether it is possible now, and refuses it
with a sentence if not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any, Literal

HOST = "127.0.0.1"

LogStyle = Literal["text", "json"]


class Phase(StrEnum):
    """The state of the robot, as the service sees it."""

    AWAY = "away"
    """No link or no answer; reconnection is being tried."""
    DISARMED = "disarmed"
    ARMING = "arming"
    ACTIVE = "active"
    """Armed: it moves, or rests under control."""
    STOPPING = "stopping"
    """Ramping down, to be disarmed."""
    FAULT = "fault"
    """Latched; ``clear`` leads out of it when the cause is gone."""
    ESTOP = "estop"
    """Latched; ``clear`` leads out of it."""


class Task(StrEnum):
    """The task of an ACTIVE robot."""

    HOLD = "hold"
    """At rest, where it is."""
    TRACK = "track"
    GO = "go"
    TWIST = "twist"


class Action(StrEnum):
    """An order to the control process. ``SUMMARIES`` says what each does; the texts here give its ``arguments``."""

    ARM = "arm"
    DISARM = "disarm"
    ESTOP = "estop"
    CLEAR = "clear"
    TRACK = "track"
    """``reference``: kind and options as in ``[reference]``, or None for the configuration's. ``here``: whether the
    path starts at the robot's present pose; otherwise the robot first drives to the path's start.
    """
    GO = "go"
    """``x_m``, ``y_m``, ``heading_rad``: a pose in the world frame, by the shorter turn."""
    TWIST = "twist"
    """``vx_m_s``, ``vy_m_s``, ``yaw_rate_rad_s``: in the body frame, in force for ``service.twist_timeout_s``."""
    STOP = "stop"
    GAINS = "gains"
    """``gains``: changes to the law's gains; None reads ``[controller]`` again from its file."""
    RECORD = "record"
    """``path``: an .rrd or .mcap file, None for a name from scenario and time. ``force``: whether to replace the
    file.
    """
    STOP_RECORDING = "stop_recording"
    SHUTDOWN = "shutdown"


SUMMARIES = {
    Action.ARM: "Arm the robot: it may move from here on, and is held at rest.",
    Action.DISARM: "Ramp down, and disarm.",
    Action.ESTOP: "Stop the robot at once, before any other order; `clear` leads out of it.",
    Action.CLEAR: "Leave FAULT or ESTOP when the cause is gone; arms nothing.",
    Action.TRACK: "Follow a path.",
    Action.GO: "Drive to a pose in the world frame, by the shorter turn.",
    Action.TWIST: "Drive by twist, in the body frame, until it times out.",
    Action.STOP: "Ramp down to rest, and hold; the robot stays armed.",
    Action.GAINS: "Change gains of the law; without any, read those of the configuration's file again.",
    Action.RECORD: "Begin a recording.",
    Action.STOP_RECORDING: "End the recording.",
    Action.SHUTDOWN: "Ramp down, disarm, close the recording, and end the service.",
}
"""What each order does, for the help of ``hil ctl`` and the document of the API."""


def route(action: Action) -> tuple[str, str]:
    """Return the HTTP method and path of an order."""
    return ("DELETE", "/v1/record") if action is Action.STOP_RECORDING else ("POST", f"/v1/{action.value}")


LONG = frozenset({Action.RECORD, Action.STOP_RECORDING, Action.TRACK, Action.GAINS})
"""Orders that read files or start or end a recorder. They are answered when that is done; the ticks go on meanwhile."""


MOVING = frozenset({Action.ARM, Action.CLEAR, Action.TRACK, Action.GO, Action.TWIST, Action.GAINS})
"""Orders that can make the robot move, now or later. After a stall such an order is refused."""


SILENT_S = 1.0
"""An API process counts as hung after a silence this long [s]; a sign of life is due every 0.1 s."""


@dataclass(frozen=True, slots=True)
class Order:
    """An order to the control process. Its answer has the same ``number``."""

    number: int
    action: Action
    arguments: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Answer:
    """The outcome of an order: accepted, perhaps with a ``result``, or ``refused`` with a sentence."""

    number: int
    refused: str | None = None
    result: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """The service at one instant; an unknown value is None. Sent 20 times a second, and at each change of phase.

    Attributes:
        time_unix_s: when this status was made. phase, task: ``task`` only while ACTIVE. why: the last problem as a
            sentence, or None since the last success.
        scenario, law, command: what is served. link, robot: descriptions. power_stage: whether the robot has motors;
            None before it has answered.
        pose: x [m], y [m], heading [rad]; twist: in the world frame [m/s, rad/s]; reference: pose, while ACTIVE.
        speed_rad_s: of the four wheels. battery_v. gains: of the law, by name. health: of the estimator.
        ticks: since the service began. deadline_misses. lateness_us: p50, p99 and p99.9 since the service began, by
            these names. feedback_age_ms, round_trip_ms.
        frames: sent, received, and rejected by cause. recoveries: how often a lost robot came back.
        recording: path of the file being written, or None. rows_dropped. twist_age_s: age of the twist in force.
        realtime: by setting, a sentence on whether the operating system granted it.
    """

    time_unix_s: float = 0.0
    phase: Phase = Phase.AWAY
    task: Task | None = None
    why: str | None = None
    scenario: str
    law: str
    command: str
    link: str
    robot: str | None = None
    power_stage: bool | None = None
    pose: tuple[float, float, float] | None = None
    twist: tuple[float, float, float] | None = None
    reference: tuple[float, float, float] | None = None
    speed_rad_s: tuple[float, float, float, float] | None = None
    battery_v: float | None = None
    gains: Mapping[str, float] = field(default_factory=dict)
    health: str | None = None
    ticks: int = 0
    deadline_misses: int = 0
    lateness_us: Mapping[str, float] = field(default_factory=dict)
    feedback_age_ms: float | None = None
    round_trip_ms: float | None = None
    frames: Mapping[str, Any] = field(default_factory=lambda: {"sent": 0, "received": 0, "rejected": {}})
    recoveries: int = 0
    recording: str | None = None
    rows_dropped: int = 0
    twist_age_s: float | None = None
    realtime: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Limits:
    """Largest values that an order may ask for. The API refuses larger ones before the control process sees them."""

    speed_m_s: float
    """Along each axis of the robot's body."""
    yaw_rate_rad_s: float
    distance_m: float
    """From the origin of the world to a target pose, along each axis."""
    twist_timeout_s: float
    """How long a twist is in force; one that has waited longer in the API is refused."""


@dataclass(frozen=True, slots=True)
class ApiConfig:
    """The API of one service.

    Attributes:
        title: the scenario's name. device: URL of the link.
        limits: largest values that an order may ask for. host: address to listen on. port: TCP port; 0 picks a free
            one.
        token_file: file that holds the access token, made if missing; None makes a new token at each start.
        log: format of the lines on stderr.
    """

    title: str
    device: str
    limits: Limits
    host: str = HOST
    port: int = 8770
    token_file: str | None = None
    log: LogStyle = "text"


def to_line(message: Order | Answer | Status) -> dict[str, Any]:
    """Return a message as the record of one line, such as ``{"order": {...}}``."""
    # asdict copies deeply, which is too slow: the control process does this in a tick.
    return {type(message).__name__.lower(): {one.name: getattr(message, one.name) for one in fields(message)}}
