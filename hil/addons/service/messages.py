"""Messages between the processes of a service, one JSON text per line: orders one way, answers and status back.

The API process checks the form of an order. Only the control process knows whether it is possible now, and refuses it
with a sentence if not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any, Literal, Self

HOST = "127.0.0.1"
"""The address of every service's API: the loopback interface only."""

LogStyle = Literal["text", "json"]


class Phase(StrEnum):
    """The state of the robot, as the service sees it."""

    AWAY = "away"  # no link or no answer; reconnection is being tried
    DISARMED = "disarmed"
    ARMING = "arming"
    ACTIVE = "active"  # armed: it moves, or rests under control
    STOPPING = "stopping"  # ramping down, to be disarmed
    FAULT = "fault"  # latched until ``clear``, which needs the cause to be gone
    ESTOP = "estop"  # latched until ``clear``


class Task(StrEnum):
    """The task of an ACTIVE robot."""

    HOLD = "hold"  # at rest, where it is
    TRACK = "track"
    GO = "go"
    TWIST = "twist"
    WHEELS = "wheels"  # a law elsewhere commands the wheels


class Action(StrEnum):
    """An order to the control process. Its arguments are described in ``hil.addons.service.api.bodies``.

    ``summary`` says what it does, for the help of ``hil ctl`` and the document of the API.
    """

    summary: str

    def __new__(cls, value: str, summary: str = "") -> Self:
        action = str.__new__(cls, value)
        action._value_, action.summary = value, summary
        return action

    ARM = "arm", "Arm the robot: it may move from here on, and is held at rest."
    DISARM = "disarm", "Ramp down, and disarm."
    ESTOP = "estop", "Stop the robot at once, before any other order; `clear` leads out of it."
    CLEAR = "clear", "Leave FAULT or ESTOP when the cause is gone; arms nothing."
    TRACK = "track", "Follow a path."
    GO = "go", "Drive to a pose in the world frame, by the shorter turn."
    TWIST = "twist", "Drive by twist, in the body frame, until it times out."
    WHEELS = "wheels", "Command the four wheels, from a law elsewhere, until it times out."
    STOP = "stop", "Ramp down to rest, and hold; the robot stays armed."
    GAINS = "gains", "Change gains of the law, and make it anew; the file of a law is read again."
    RECORD = "record", "Begin a recording."
    STOP_RECORDING = "stop_recording", "End the recording."
    SHUTDOWN = "shutdown", "Ramp down, disarm, close the recording, and end the service."


def route(action: Action) -> tuple[str, str]:
    """Return the HTTP method and path of an order."""
    return ("DELETE", "/v1/record") if action is Action.STOP_RECORDING else ("POST", f"/v1/{action.value}")


ORDERS = {route(action): action for action in Action}
"""The orders by HTTP method and path."""

LONG = frozenset({Action.RECORD, Action.STOP_RECORDING, Action.TRACK, Action.GAINS})
"""Orders that read files or start or end a recorder. They are answered when that is done; the ticks go on meanwhile."""

STREAMED = frozenset({Action.TWIST, Action.WHEELS})
"""Orders that a client repeats many times a second; each is in force for the service's twist timeout."""

MOVING = frozenset({Action.ARM, Action.CLEAR, Action.TRACK, Action.GO, Action.GAINS}) | STREAMED
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
        recording: path of the file being written, or None. recording_trouble: why it cannot be written, or why it was
            ended early; None if all is well. rows_dropped: dropped since the service began, as a recorder was full.
            rows_lost: rows that a recorder could not write. twist_age_s: age of the twist in force.
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
    recording_trouble: str | None = None
    rows_dropped: int = 0
    rows_lost: int = 0
    twist_age_s: float | None = None
    realtime: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The robot's motion at one sampling instant, for clients that ask for it; an unknown value is None.

    Attributes:
        time_unix_s: of the sample.
        pose: x [m], y [m], heading [rad]; twist: in the world frame [m/s, rad/s].
        sigma: standard deviations of position [m] and heading [rad], where the estimator knows them.
        angle_rad, speed_rad_s, current_a: of the four wheels. torque_n_m: the currents times the torque constant.
        yaw_rate_rad_s, acceleration_m_s2: as the IMU measures them, along the robot's axes.
        truth, true_twist: of a simulated robot, in the world frame.
        sequence: of the wheel command in force, if it has one.
    """

    time_unix_s: float
    pose: tuple[float, float, float] | None = None
    twist: tuple[float, float, float] | None = None
    sigma: tuple[float, float] | None = None
    angle_rad: tuple[float, float, float, float] | None = None
    speed_rad_s: tuple[float, float, float, float] | None = None
    current_a: tuple[float, float, float, float] | None = None
    torque_n_m: tuple[float, float, float, float] | None = None
    yaw_rate_rad_s: float | None = None
    acceleration_m_s2: tuple[float, float, float] | None = None
    truth: tuple[float, float, float] | None = None
    true_twist: tuple[float, float, float] | None = None
    sequence: int | None = None


@dataclass(frozen=True, slots=True)
class Limits:
    """Largest values that an order may ask for. The API refuses larger ones before the control process sees them.

    ``speed_m_s`` is along each axis of the robot's body, ``distance_m`` along each axis of the world, from its origin
    to a target pose. ``wheel`` is for the command of one wheel [rad/s or N·m, by the service's command]. A twist is in
    force for ``twist_timeout_s``; one that has waited longer in the API is refused.
    """

    speed_m_s: float
    yaw_rate_rad_s: float
    distance_m: float
    wheel: float
    twist_timeout_s: float


@dataclass(frozen=True, slots=True)
class ApiConfig:
    """The API of one service.

    Attributes:
        title: the scenario's name. device: URL of the link. port: TCP port; 0 picks a free one.
        token_file: file that holds the access token, made if missing; None makes a new token at each start.
        clients_file: file with further tokens and their roles, or None. audit: file of the audit log; None is one in
            the state folder, named after the port.
        log: format of the lines on stderr.
    """

    title: str
    device: str
    limits: Limits
    port: int = 8770
    token_file: str | None = None
    clients_file: str | None = None
    audit: str | None = None
    log: LogStyle = "text"


def to_line(message: Order | Answer | Status | Motion) -> dict[str, Any]:
    """Return a message as the record of one line, such as ``{"order": {...}}``."""
    # asdict copies deeply, which is too slow: the control process does this in a tick.
    return {type(message).__name__.lower(): {one.name: getattr(message, one.name) for one in fields(message)}}
