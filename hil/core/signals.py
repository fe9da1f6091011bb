"""All signals of a run: expectations, recordings and exports use these names.

A sample is one row of floats in the order of ``SIGNALS``. The names and their order come from the fields of the
groups below, so each signal is defined once; its name ends with the unit. A run may add signals after these
(``hil.core.ports.OwnSignals``); their names end with the unit too.
"""

from array import array
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from hil.core.errors import UnknownSignalError
from hil.core.types import WHEEL_NAMES, CommandMode, Gains, Pose, Twist, Wheels

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

Series: TypeAlias = "npt.NDArray[np.float64]"
"""A signal over time."""

QUANTITY = {CommandMode.SPEED: "speed_command_rad_s", CommandMode.TORQUE: "torque_command_n_m"}
"""The last word of the signals of set points."""


class LoopSignals(NamedTuple):
    t_s: float
    tick: int
    lateness_us: float
    tick_us: float
    deadline_misses: float


class ReferenceSignals(NamedTuple):
    x_m: float
    y_m: float
    heading_rad: float
    vx_m_s: float
    vy_m_s: float
    yaw_rate_rad_s: float
    ax_m_s2: float
    ay_m_s2: float
    yaw_acceleration_rad_s2: float


class ErrorSignals(NamedTuple):
    x_m: float
    y_m: float
    heading_rad: float
    planar_m: float


class RobotSignals(NamedTuple):
    time_s: float
    state: float
    command_age_ms: float
    yaw_rate_rad_s: float
    acceleration_x_m_s2: float
    acceleration_y_m_s2: float
    acceleration_z_m_s2: float


class BatterySignals(NamedTuple):
    voltage_v: float
    current_a: float


class EstimatorSignals(NamedTuple):
    sigma_position_m: float
    sigma_heading_rad: float
    gyro_bias_rad_s: float
    wheel_scale: float
    left_scale: float
    gyro_scale: float
    fix_noise: float
    fixes_accepted: float
    fixes_rejected: float
    fix_restarts: float
    fix_age_ms: float
    slip: float
    health: float
    fix_time_s: float
    fix_x_m: float
    fix_y_m: float
    fix_heading_rad: float


class GuardSignals(NamedTuple):
    saturated: float
    held: float
    limit: float
    taken_n_m: float


class LinkSignals(NamedTuple):
    sent: float
    received: float
    rejected: float
    feedback_age_ms: float
    lost: float
    sent_bytes: float
    received_bytes: float
    load_percent: float
    rtt_ms: float
    latency_ms: float
    clock_offset_us: float
    clock_drift_ppm: float


class Sample(NamedTuple):
    """The signal groups of a row, in order; ``hil.runtime.row`` fills them. NaN marks a missing value."""

    loop: LoopSignals
    reference: ReferenceSignals
    pose: Pose
    twist: Twist
    truth: Pose
    error: ErrorSignals
    gain: Gains
    wheel_speed: Wheels
    wheel_speed_command: Wheels
    wheel_torque_command: Wheels
    wheel_current: Wheels
    wheel_temperature: Wheels
    robot: RobotSignals
    battery: BatterySignals
    estimator: EstimatorSignals
    guard: GuardSignals
    link: LinkSignals


class Signal(NamedTuple):
    """A signal. Its name is dotted and ends with the unit."""

    name: str
    unit: str
    meaning: str


_MEANING = {
    "loop.t_s": "time since the first ACTIVE tick, the scenario's time",
    "loop.tick": "number of the tick",
    "loop.lateness_us": "how late the tick began; 0 in lockstep",
    "loop.tick_us": "wall-clock time that the previous tick's work took",
    "loop.deadline_misses": "ticks skipped so far because the one before ran over",
    "reference.*": "pose, twist and acceleration that the robot should have, world frame",
    "pose.*": "pose that the controller acts on, world frame",
    "twist.*": "twist that the controller acts on, world frame",
    "truth.*": "true pose, not sent over the link to the robot; no value without a source",
    "error.*": "truth minus reference; no value without truth",
    "error.planar_m": "distance between truth and reference; no value without truth",
    "gain.*": "gain in force; no value where the law has none",
    "wheel.*.speed_rad_s": "wheel speed as the firmware estimates it",
    "wheel.*.speed_command_rad_s": "speed set point after the guard; no value in torque mode",
    "wheel.*.torque_command_n_m": "torque set point or feedforward after the guard",
    "wheel.*.current_a": "motor current; of our own firmware the mean over the feedback period",
    "robot.time_s": "sampling instant of the newest feedback, on the robot's own clock",
    "robot.state": "state of the firmware (DBC TICK.state)",
    "robot.command_age_ms": "age of the command in force when the feedback was sampled",
    "robot.yaw_rate_rad_s": "gyro",
    "robot.acceleration_x_m_s2": "accelerometer, forward; no value where the robot has none",
    "robot.acceleration_y_m_s2": "accelerometer, left; no value where the robot has none",
    "robot.acceleration_z_m_s2": "accelerometer, up, 9.81 at rest; no value where the robot has none",
    "battery.*": "as the robot measures it, our own firmware over a feedback period; no value where it does not",
    "wheel.*.temperature_degc": "of the motor winding; no value where the robot does not measure it",
    "estimator.sigma_position_m": "standard deviation of the estimated position, its worst direction; only fused",
    "estimator.sigma_heading_rad": "standard deviation of the estimated heading; only fused",
    "estimator.gyro_bias_rad_s": "bias of the gyro as estimated; only fused",
    "estimator.wheel_scale": "true way forward over that of the wheels, as estimated; only fused",
    "estimator.left_scale": "true way to the left over that of the wheels, as estimated; only fused",
    "estimator.gyro_scale": "true turn over that of the gyro, as estimated; only fused",
    "estimator.fix_noise": "how many times noisier pose fixes are than they tell, as estimated, at least 1; only fused",
    "estimator.fixes_accepted": "pose fixes accepted so far; only fused",
    "estimator.fixes_rejected": "pose fixes rejected so far, as too far from the estimate; only fused",
    "estimator.fix_restarts": "rows of rejected pose fixes that were believed so far: the pose jumped; only fused",
    "estimator.fix_age_ms": "age of the newest accepted pose fix; only fused",
    "estimator.slip": "1 when wheels, gyro and accelerometer disagree; no value with true poses",
    "estimator.health": "0 good, 1 degraded: no fix for too long, 2 lost: the robot is held at rest; only fused",
    "estimator.fix_time_s": "stamp on the robot's clock of the pose fix that came in this tick; only fused",
    "estimator.fix_x_m": "the fix as it came, world frame; no value in ticks without one",
    "estimator.fix_y_m": "the fix as it came, world frame; no value in ticks without one",
    "estimator.fix_heading_rad": "the fix as it came, world frame; no value in ticks without one",
    "guard.saturated": "1 when the guard scaled the four wheels at a limit",
    "guard.held": "1 when the law was not called: no usable state, the robot held at rest, or the robot not there",
    "guard.limit": "what the limiter of motion took most torque for: 0 nothing, 1 wheel speed, 2 slip, 3 body",
    "guard.taken_n_m": "torque that the limiter of motion took from the command, sum of the four wheels",
    "link.sent": "frames sent so far, without HELLO",
    "link.received": "valid frames received so far, without HELLO",
    "link.rejected": "received frames dropped so far, for any cause; updated every 100 ticks",
    "link.feedback_age_ms": "age of the newest feedback at the tick: time since it arrived, and the link's latency",
    "link.lost": "feedback snapshots so far that never came (a gap in the robot's count) or came incomplete",
    "link.sent_bytes": "bytes sent since t = 0; on CAN those of the data fields",
    "link.received_bytes": "bytes received since t = 0; on CAN those of the data fields",
    "link.load_percent": "load of the wire in the last 100 ms; no value on memory:",
    "link.rtt_ms": "from sending a command to the first feedback that reports it as applied; no value before the first",
    "link.latency_ms": "from a sampling instant to the firmware tick that uses the command, as passed to the law",
    "link.clock_offset_us": "robot's clock minus the run's, from TIME_SYNC; no value before the first answer",
    "link.clock_drift_ppm": "how much faster the robot's clock runs than the run's; no value in the first second",
}

_WHEEL_GROUPS = {
    "wheel_speed": "speed_rad_s",
    "wheel_speed_command": "speed_command_rad_s",
    "wheel_torque_command": "torque_command_n_m",
    "wheel_current": "current_a",
    "wheel_temperature": "temperature_degc",
}

# Longest ending first: "rad_s" must win over "s".
_UNITS = {
    "_rad_s2": "rad/s²", "_m_s2": "m/s²", "_rad_s": "rad/s", "_m_s": "m/s", "_n_m": "N·m", "_1_s": "1/s",
    "_rad": "rad", "_us": "µs", "_ms": "ms", "_m": "m", "_s": "s", "_a": "A", "_v": "V", "_degc": "°C",
    "_bytes": "B", "_percent": "%", "_ppm": "ppm",
}  # fmt: skip


def pack_row(values: Iterable[float]) -> bytes:
    """Return a row as sinks take it: the values as doubles, one after the other, in this machine's byte order."""
    return array("d", values).tobytes()


def unit_of(name: str) -> str:
    """Return the unit at the end of a signal's name, or ``""`` for a count or a state."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")


def _meaning_of(name: str) -> str:
    parts = name.split(".")
    patterns = (name, ".".join([parts[0], *["*"] * (len(parts) - 2), parts[-1]]), f"{parts[0]}.*")
    return next(_MEANING[p] for p in patterns if p in _MEANING)


def _names() -> list[str]:
    names: list[str] = []
    for group, kind in Sample.__annotations__.items():
        if group in _WHEEL_GROUPS:
            names += [f"wheel.{wheel}.{_WHEEL_GROUPS[group]}" for wheel in WHEEL_NAMES]
        else:
            names += [f"{group}.{field}" for field in kind._fields]
    return names


SIGNALS: tuple[Signal, ...] = tuple(Signal(n, unit_of(n), _meaning_of(n)) for n in _names())
SIGNAL_NAMES: tuple[str, ...] = tuple(s.name for s in SIGNALS)
INDEX: dict[str, int] = {name: i for i, name in enumerate(SIGNAL_NAMES)}
GROUPS: frozenset[str] = frozenset(name.partition(".")[0] for name in SIGNAL_NAMES)
WHEEL_SPEEDS: tuple[str, ...] = tuple(f"wheel.{wheel}.speed_rad_s" for wheel in WHEEL_NAMES)
TRUE_POSE: tuple[str, ...] = tuple(f"truth.{name}" for name in Pose._fields)


class Signals(Mapping[str, Series]):
    """The signals of a run by name, each of shape (ticks,); a wrong name raises UnknownSignalError with near ones."""

    def __init__(self, series: Mapping[str, Series]) -> None:
        self._series = series

    def __getitem__(self, name: str) -> Series:
        try:
            return self._series[name]
        except KeyError:
            raise UnknownSignalError(name, self._series) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._series)

    def __len__(self) -> int:
        return len(self._series)

    def __repr__(self) -> str:
        ticks = len(next(iter(self._series.values()), ()))
        return f"<{len(self)} signals of {ticks} ticks>"
