"""The tables of a scenario: each key with the unit in its name, its range, default and meaning.

[robot] is in ``hil.core.model``, [estimator] in ``hil.estimation``. A key without a default must be given: facts about
the robot and the run are never guessed. Ranges refuse values in a wrong unit: a wheel radius of 75 is in millimetres.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from hil.core.errors import BadInputError
from hil.core.model import RobotModel
from hil.core.motion_limits import SLIP_M_S, TorqueSpeed
from hil.core.options import OTHERS, OptionsError, Problem, Range
from hil.core.types import WHEEL_NAMES, CommandMode
from hil.core.wheel_map import IMU_AXES
from hil.core.wheel_speed import BANDWIDTH_RAD_S
from hil.estimation.estimators import EstimatorOptions
from hil.robot.driver_registry import EXTENSIONS as DRIVERS
from hil.robot.driver_registry import OUR_DRIVER, make_settings
from hil.scenario.commission import CommissionTable
from hil.scenario.plant import PlantTable
from hil.scenario.trial import AllowTable, ExpectTable, FaultTable
from hil.scenario.values import (
    AnyOption,
    Axes3,
    Milliseconds,
    Setting,
    Text,
    Wheel,
    at_most_once,
    check,
    each_once,
    right_handed,
)
from hil.wire.url import parse_link

TICKS_PER_SECOND = 1000  # the firmware loop
LOWEST_RATE_HZ = 20  # two commands within the longest watchdog
RATES_HZ = tuple(rate for rate in range(LOWEST_RATE_HZ, 1001) if TICKS_PER_SECOND % rate == 0)
LEAST_TICK_LIMIT_S = 0.05  # the thread that watches it looks several times within it
PRIORITY = 40
"""Default priority of SCHED_FIFO: below the 50 of a real-time kernel's interrupt threads, such as the serial port's."""


def _driver(driver: str) -> str:
    if driver not in DRIVERS:
        raise ValueError(DRIVERS.unknown(driver, "expected the name of a driver"))
    return driver


def _link(url: str) -> str:
    try:
        parse_link(url)
    except BadInputError as error:
        raise ValueError(str(error)) from error
    return url


_rate = check(RATES_HZ.__contains__, f"one of {', '.join(map(str, RATES_HZ))}, a whole number of ms a period")
_tick_limit = check(
    lambda s: s == 0.0 or s >= LEAST_TICK_LIMIT_S, f"at least {LEAST_TICK_LIMIT_S:g} s, or 0 for no limit"
)


def _rotate(text: str) -> str:
    from hil.record.files import rotation  # only for a service

    try:
        rotation(text)
    except BadInputError as error:
        raise ValueError(str(error)) from error
    return text


_processors = check(
    lambda cpus: min(cpus, default=0) >= 0 and len(set(cpus)) == len(cpus), "processor numbers, from 0, each once"
)


@dataclass(frozen=True)
class FirmwareTable:
    """``[firmware]``: the firmware's parameters. Those of a real board are compared with these by hash."""

    counts_per_revolution: Annotated[int, Range(ge=4, le=32768), "encoder counts of one turn of a wheel"]
    torque_limit_n_m: Annotated[float, Range(gt=0, le=15.99609375), "of one wheel; all four are scaled together"]
    torque_constant_n_m_a: Annotated[
        float, Range(ge=0.001, le=100), "torque at the wheel per ampere, back-EMF per rad/s"
    ]
    motor_resistance_ohm: Annotated[float, Range(ge=0.001, le=1000), "that the current loop assumes"] = 0.6
    motor_inductance_h: Annotated[float, Range(ge=1e-06, le=10), "that the current loop assumes"] = 5e-4
    current_limit_a: Annotated[float, Range(ge=0, le=21), "of a motor: all four are scaled; 1.5 times is a fault"] = (
        20.0
    )
    current_bandwidth_rad_s: Annotated[float, Range(ge=10, le=5000), "of the current loop"] = 1000.0
    temperature_limit_degc: Annotated[
        float, Range(ge=0, le=200), "winding temperature that is a fault; from 15 K below it all four wheels are scaled"
    ] = 120.0
    undervoltage_v: Annotated[float, Range(ge=0, le=200), "a battery voltage below this is a fault; 0 for never"] = 0.0
    tracking_bandwidth_rad_s: Annotated[
        float, Range(ge=1, le=500), "of the filter that estimates speed; less below 1024 counts"
    ] = BANDWIDTH_RAD_S
    speed_kp_n_m_s_rad: Annotated[float, Range(ge=0, le=100), "speed loop, proportional; less below 1024 counts"] = 1.1
    speed_ki_n_m_rad: Annotated[float, Range(ge=0, le=10000), "speed loop, integral; less below 1024 counts"] = 12.0
    watchdog_s: Annotated[
        Milliseconds, Range(ge=0.02, le=0.1), "silence that stops the wheels; by default 5 command periods"
    ] = 0.1
    ramp_s: Annotated[Milliseconds, Range(ge=0.001, le=2), "duration of the ramp from the set point to zero"] = 0.2
    overspeed_rad_s: Annotated[float, Range(ge=1, le=127), "wheel speed that is a fault"] = 100.0
    encoder_fault_s: Annotated[float, Range(ge=0.02, le=1), "time an encoder may stand still or count backward"] = 0.1


@dataclass(frozen=True)
class DeviceTable:
    """``[device]``: how the robot is reached and wired. ``settings`` is ``motors`` as the driver read it."""

    driver: Annotated[Text, _driver, "the driver that talks to the motor controllers"] = OUR_DRIVER
    wheels: Annotated[tuple[Wheel, ...], each_once, "the wheel at each motor output, in order"] = WHEEL_NAMES
    reversed: Annotated[tuple[Wheel, ...], at_most_once, "wheels whose motor turns the other way"] = ()
    imu: Annotated[
        Axes3,
        right_handed,
        "the robot's axis along each axis of the IMU: x forward, y left, z up, and -x, -y, -z their opposites",
    ] = IMU_AXES
    guardian_s: Annotated[
        float, Range(ge=0.1, le=2), "silence of the host after which a guardian process stops the motors (GUARDIAN.md)"
    ] = 0.3
    motors: Annotated[
        Mapping[Text, Setting], "settings of the driver for third-party motor controllers (DRIVERS.md)"
    ] = field(default_factory=dict)
    settings: Any = field(init=False, default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Make the settings once, because a driver may read files for them."""
        try:
            if self.is_makers:
                object.__setattr__(self, "settings", make_settings(self.driver, self.motors, "motors"))
            elif self.motors:
                raise BadInputError("only for third-party motor controllers; set device.driver, or leave it out")
        except OptionsError:
            raise
        except BadInputError as error:
            raise OptionsError([Problem(("motors",), "value", str(error))]) from error

    @property
    def is_makers(self) -> bool:
        """Whether the robot has third-party motor controllers instead of our firmware."""
        return self.driver != OUR_DRIVER


@dataclass(frozen=True)
class LinkTable:
    """``[link]``: the wire, and the latency added to it, in robot time."""

    url: Annotated[Text, _link, "memory:, serial:PATH or can:INTERFACE/CHANNEL"] = "memory:"
    command_latency_s: Annotated[Milliseconds, Range(ge=0, le=1), "added on the way to the firmware"] = 0.0
    feedback_latency_s: Annotated[Milliseconds, Range(ge=0, le=1), "added on the way back"] = 0.0

    @property
    def command_latency_ns(self) -> int:
        """Latency on the way to the firmware [ns]."""
        return round(self.command_latency_s * 1e9)

    @property
    def feedback_latency_ns(self) -> int:
        """Latency on the way back [ns]."""
        return round(self.feedback_latency_s * 1e9)


@dataclass(frozen=True)
class ControllerTable:
    """``[controller]``: the control law. The law itself checks its gains when it is made."""

    law: Annotated[Text, "a shipped name, ./my_law.py:MyLaw or package.module:Class"]
    command: Annotated[Literal["speed", "torque"], "the command of the wheels; fixed at arming"] = "speed"
    gains: Annotated[Mapping[Text, AnyOption], "the parameters of the law"] = field(default_factory=dict)

    @property
    def mode(self) -> CommandMode:
        """``command`` as the enum that the tick and the wire use."""
        return CommandMode[self.command.upper()]


@dataclass(frozen=True)
class ReferenceTable:
    """``[reference]``: the path to follow. Keys other than ``kind`` belong to the kind, which checks them."""

    kind: Annotated[Text, "circle, hold, ...; `hil list references` prints them all"]
    options: Annotated[Mapping[Text, AnyOption], OTHERS] = field(default_factory=dict)


@dataclass(frozen=True)
class LoopTable:
    """``[loop]``: the controller's tick."""

    rate_hz: Annotated[int, _rate, "a command period is a whole number of 1 ms firmware ticks"]
    duration_s: Annotated[float, Range(gt=0, le=86_400), "duration from the first ACTIVE tick"]
    mode: Annotated[Literal["lockstep", "realtime"], "the host steps time, or both follow the wall clock"] = "lockstep"
    seed: Annotated[int, Range(ge=0, le=2**32 - 1), "of all random numbers of the run"] = 1
    rearm: Annotated[bool, "reconnect and arm again after a lost link or a stop of the robot"] = False
    tick_limit_s: Annotated[
        float,
        Range(ge=0, infinite=True),
        _tick_limit,
        "of a tick's work by the wall clock, ends the run; 0 or inf for none",
    ] = 10.0

    @property
    def period_ns(self) -> int:
        """Command period [ns]."""
        return 1_000_000_000 // self.rate_hz

    @property
    def substeps(self) -> int:
        """Firmware ticks of 1 ms in a command period (DBC STEP.substeps)."""
        return TICKS_PER_SECOND // self.rate_hz


@dataclass(frozen=True)
class RealtimeTable:
    """``[realtime]``: requests to the operating system in mode realtime; a run reports those refused."""

    priority: Annotated[int, Range(ge=0, le=98), "of SCHED_FIFO, 0 for none; interrupt threads have 50"] = PRIORITY
    cpus: Annotated[tuple[int, ...], _processors, "processors to run on; by default the isolated ones, if any"] = ()
    lock_memory: Annotated[bool, "keep memory from being swapped out"] = True


@dataclass(frozen=True)
class RecordTable:
    """``[record]``: what a recording of a run has besides its signals and events."""

    frames: Annotated[bool, "also what the robot and its sensors told, so that `hil replay` can repeat the run"] = True


@dataclass(frozen=True)
class ServiceTable:
    """``[service]``: settings of `hil serve`; the limits are those of twists and of the way to a pose."""

    port: Annotated[int, Range(ge=0, le=65_535), "of the API on 127.0.0.1; 0 takes a free one"] = 8770
    twist_timeout_s: Annotated[float, Range(ge=0.02, le=2), "time without a new twist that stops the robot"] = 0.2
    error_limit_m: Annotated[float, Range(gt=0, le=100), "distance from its path at which the robot is held"] = 0.5
    speed_m_s: Annotated[float, Range(gt=0, le=20), "of the robot's centre"] = 0.5
    acceleration_m_s2: Annotated[float, Range(gt=0, le=50), "of the robot's centre"] = 1.0
    jerk_m_s3: Annotated[float, Range(gt=0, le=1000), "of the robot's centre, on the way to a pose"] = 5.0
    yaw_rate_rad_s: Annotated[float, Range(gt=0, le=50), "of the heading"] = 1.0
    yaw_acceleration_rad_s2: Annotated[float, Range(gt=0, le=500), "of the heading"] = 3.0
    yaw_jerk_rad_s3: Annotated[float, Range(gt=0, le=10_000), "of the heading, on the way to a pose"] = 15.0
    recordings: Annotated[Text, "folder of all its recordings, as seen from where the service is started"] = "runs"
    rotate: Annotated[Text, _rotate, "size or time at which a recording continues in the next file: 1GB or 1h"] = "none"
    recordings_gb: Annotated[float, Range(ge=0), "that the recordings in the folder may take; 0 for no limit"] = 0.0
    when_full: Annotated[
        Literal["stop_recording", "stop_robot"], "when the disk is full, the limit is reached or the recorder fails"
    ] = "stop_recording"


@dataclass(frozen=True)
class LimiterTable:
    """``[limiter]``: what limits a law's commands beside ``[robot]``, in TORQUE mode by the robot's measured motion."""

    torque_speed: Annotated[
        TorqueSpeed, "wheel speed below which torques keep: the robot's overspeed, robot.speed_limit_rad_s, or none"
    ] = "protection"
    slip_m_s: Annotated[
        float, Range(gt=0, infinite=True), "how much faster than the floor a rim may be driven; inf for no limit"
    ] = SLIP_M_S

    def most_slip_m_s(self, source: str) -> float:
        """Return the limit of slip [m/s] with an estimate of this ``estimator.source``.

        Odometry trusts the wheels' speed: a difference from the floor's speed is then only lag, and is not limited.
        """
        return math.inf if source == "odometry" else self.slip_m_s


@dataclass(frozen=True, kw_only=True)
class Tables:
    """All tables of a scenario, in the order in which they are written and shown."""

    robot: RobotModel
    plant: PlantTable = field(default_factory=PlantTable)
    firmware: FirmwareTable
    device: DeviceTable = DeviceTable()
    link: LinkTable = LinkTable()
    controller: ControllerTable
    limiter: LimiterTable = LimiterTable()
    reference: ReferenceTable
    estimator: EstimatorOptions = field(default_factory=EstimatorOptions)
    loop: LoopTable
    realtime: RealtimeTable = RealtimeTable()
    service: ServiceTable = ServiceTable()
    record: RecordTable = RecordTable()
    allow: AllowTable = field(default_factory=AllowTable)
    commission: CommissionTable = field(default_factory=CommissionTable)
    fault: tuple[FaultTable, ...] = ()
    expect: tuple[ExpectTable, ...] = ()
