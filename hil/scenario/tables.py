"""The tables of a scenario: every key once, with the unit in its name, its range, default and meaning.

A key without a default has to be given: what describes the robot, its firmware and the run is never guessed.
Ranges are physical sense and keep a value in the wrong unit out: a wheel radius of 75 is one in millimetres.
The bounds of robot.speed_limit_rad_s and robot.torque_limit_n_m are what DBC WHEEL_COMMAND and TORQUE_COMMAND
can carry; those of [firmware] are the firmware's own.
"""

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, PrivateAttr, ValidationInfo, field_validator

from hil.core.errors import BadInputError, nearest
from hil.core.options import build
from hil.core.types import WHEEL_NAMES, CommandMode
from hil.drivers.registry import OUR_DRIVER, dialect, driver_names
from hil.estimation.localisation.address import parse_address
from hil.laws.own_signals import short_name
from hil.plant.signals import INPUTS, OUTPUTS
from hil.scenario.allow import AllowTable
from hil.scenario.fields import Milliseconds, Option, OptionValue, Setting, Start, Table, Text, is_path
from hil.scenario.process_tables import RealtimeTable, ServiceTable
from hil.scenario.rows import ExpectTable, FaultTable
from hil.wire.url import parse_link
from plant_fmu import SHIPPED

TICKS_PER_SECOND = 1000  # the firmware loop
LOWEST_RATE_HZ = 20  # two commands within the longest watchdog
RATES_HZ = tuple(rate for rate in range(LOWEST_RATE_HZ, 1001) if TICKS_PER_SECOND % rate == 0)
LEAST_TICK_LIMIT_S = 0.05  # a thread looks several times within it
SHIPPED_FMUS = tuple(SHIPPED)

PLANT_SIGNALS = (*INPUTS, *OUTPUTS)
# The signals of the four wheels as one.
_PATTERNS = sorted({re.sub(r"^wheel\.\w+", "wheel.*", signal) for signal in PLANT_SIGNALS})

Wheel = Literal["fl", "fr", "rr", "rl"]


class RobotTable(Table):
    """``[robot]``: what the controller believes; the letters are those of Nguyen Minh et al. 2023, AFDSC."""

    mass_kg: float = Field(gt=0, le=10_000, description="mass with wheels")
    inertia_kg_m2: float = Field(gt=0, le=100_000, description="yaw inertia of the whole robot, I")
    wheel_radius_m: float = Field(ge=0.001, le=1, description="r")
    half_length_m: float = Field(ge=0.001, le=3.9, description="centre to axle, forward, l1")
    half_width_m: float = Field(ge=0.001, le=3.9, description="centre to wheel, sideways, l2")
    wheel_inertia_kg_m2: float = Field(ge=0, le=100, description="of one wheel and its motor about its axle, Ib")
    friction_coefficient: float = Field(default=0.0, ge=0, le=2, description="rolling friction, mu in xi")
    torque_limit_n_m: float = Field(gt=0, le=15.99609375, description="of one wheel")
    speed_limit_rad_s: float = Field(
        gt=0, le=63.984375, description="of one wheel; the robot's own limit counts where that is smaller"
    )


def _signal_of_plant(name: str) -> str:
    if name not in PLANT_SIGNALS:
        hint = nearest(name, PLANT_SIGNALS)
        known = hint if "did you mean" in hint else f"; known: {', '.join(_PATTERNS)}"
        raise ValueError(f"the plant has no such signal{known}")
    return name


class MapRow(Table):
    """A row of ``[plant.map]``: the FMU's variable of a signal; signal = sign * scale * variable + offset."""

    name: Text = Field(description="of the FMU's variable; by default the signal's own")
    scale: float = Field(default=1.0, gt=0, description="units of the signal in one of the variable's")
    offset: float = Field(default=0.0, description="the signal where the variable is 0")
    sign: Literal[1, -1] = Field(default=1, description="-1 where the FMU counts the other way")

    @field_validator("sign", mode="before")
    @classmethod
    def _no_truth(cls, sign: object) -> object:
        if isinstance(sign, bool):  # which Python counts as a number
            raise ValueError("expected 1 or -1")
        return sign


class PlantTable(Table):
    """``[plant]``: what stands behind the wire when no motors do."""

    fmu: Text = Field(default="mecanum", description="a shipped name, or a path relative to this file")
    timeout_s: float = Field(default=2.0, ge=0.05, le=3600, description="silence of a foreign FMU that counts as hung")
    memory_limit_mb: float = Field(
        default=2000.0, ge=50, le=1e6, description="memory of a foreign FMU's process at which it is ended"
    )
    map: Mapping[Annotated[str, AfterValidator(_signal_of_plant)], MapRow] = Field(
        default_factory=dict,
        description="the FMU's variables of the signals that it does not have by their own names",
    )
    start: Mapping[Text, Start] = Field(
        default_factory=dict,
        description="FMU variables where the truth differs from [robot], or that only the plant has",
    )

    @field_validator("map", mode="before")
    @classmethod
    def _named(cls, rows: object) -> object:
        """Give a row without a name the signal's own; a signal that does not exist is complained of elsewhere."""
        if not isinstance(rows, Mapping):
            return rows
        return {
            signal: {"name": signal} | dict(row) if isinstance(row, Mapping) and isinstance(signal, str) else row
            for signal, row in rows.items()
        }

    @field_validator("fmu")
    @classmethod
    def _known(cls, fmu: str) -> str:
        if not is_path(fmu) and fmu not in SHIPPED_FMUS:
            raise ValueError(f"expected a shipped FMU or a path to one{nearest(fmu, SHIPPED_FMUS)}")
        return fmu


class FirmwareTable(Table):
    """``[firmware]``: what the firmware runs with. A real board's values are compared with these by hash."""

    counts_per_revolution: int = Field(ge=4, le=32_768, description="encoder counts of one turn of a wheel")
    torque_limit_n_m: float = Field(gt=0, le=15.99609375, description="of one wheel; all four are scaled together")
    torque_constant_n_m_a: float = Field(
        ge=0.001, le=100, description="torque at the wheel for one ampere, and back-EMF for one rad/s"
    )
    motor_resistance_ohm: float = Field(default=0.6, ge=0.001, le=1000, description="what the current loop believes")
    motor_inductance_h: float = Field(default=5e-4, ge=1e-6, le=10, description="what the current loop believes")
    current_limit_a: float = Field(
        default=20.0,
        ge=0,
        le=21,
        description="of one motor; all four are scaled together, 1.5 times is a fault",
    )
    current_bandwidth_rad_s: float = Field(default=1000.0, ge=10, le=5000, description="of the current loop")
    temperature_limit_degc: float = Field(
        default=120.0, ge=0, le=200, description="of a winding: a fault; from 15 below all four wheels are scaled"
    )
    undervoltage_v: float = Field(default=0.0, ge=0, le=200, description="a battery below this is a fault; 0 for never")
    tracking_bandwidth_rad_s: float = Field(
        default=150.0, ge=1, le=500, description="of the filter that estimates speed"
    )
    speed_kp_n_m_s_rad: float = Field(default=1.1, ge=0, le=100, description="speed loop, proportional")
    speed_ki_n_m_rad: float = Field(default=25.0, ge=0, le=10_000, description="speed loop, integral")
    watchdog_s: Milliseconds = Field(
        default=0.1,
        ge=0.02,
        le=0.1,
        description="silence that stops the wheels; by default 5 command periods",
    )
    ramp_s: Milliseconds = Field(default=0.2, ge=0.001, le=2, description="from the set point in force to zero")
    overspeed_rad_s: float = Field(default=100.0, ge=1, le=127, description="wheel speed that is a fault")
    encoder_fault_s: float = Field(
        default=0.1, ge=0.02, le=1, description="an encoder that stands still or counts backward for so long is a fault"
    )


class DeviceTable(Table):
    """``[device]``: how the robot is reached and wired."""

    driver: Text = Field(default="stm32", description="who speaks to the board")
    wheels: tuple[Wheel, ...] = Field(
        default=("fl", "fr", "rr", "rl"), description="the wheel at each motor output, in order"
    )
    reversed: tuple[Wheel, ...] = Field(default=(), description="wheels whose motor turns the other way")
    guardian_s: float = Field(
        default=0.3,
        ge=0.1,
        le=2,
        description="silence of the host after which another process stops motors that drive on (GUARDIAN.md)",
    )
    motors: Mapping[Text, Setting] = Field(
        default_factory=dict, description="what the driver has to know of another maker's controllers (DIALECTS.md)"
    )
    _settings: Any = PrivateAttr(default=None)

    @property
    def is_makers(self) -> bool:
        """Whether the robot has motor controllers of another maker's, and not our firmware."""
        return self.driver != OUR_DRIVER

    @property
    def settings(self) -> Any:
        """``motors`` as the driver has it; None for our own firmware."""
        return self._settings

    def model_post_init(self, _context: object) -> None:
        """Make the settings once: a driver may have files to read for them."""
        if self.is_makers:
            self._settings = build(dialect(self.driver).settings, self.motors, "device.motors")

    @field_validator("driver")
    @classmethod
    def _known(cls, driver: str) -> str:
        if driver not in driver_names():
            raise ValueError(f"expected the name of a driver{nearest(driver, driver_names())}")
        return driver

    @field_validator("motors")
    @classmethod
    def _understood(cls, motors: Mapping[str, object], info: ValidationInfo) -> Mapping[str, object]:
        if "driver" not in info.data:
            return motors  # that one is wrong, which is what has to be said
        driver = info.data["driver"]
        if driver == OUR_DRIVER:
            if motors:
                raise ValueError("belongs to the drivers of other makers; set device.driver, or leave it out")
            return motors
        try:
            build(dialect(driver).settings, motors, "device.motors")
        except BadInputError as error:
            raise ValueError(re.sub(r"^device\.motors(: |\.)", "", str(error))) from error
        return motors

    @field_validator("wheels")
    @classmethod
    def _all_four(cls, wheels: tuple[Wheel, ...]) -> tuple[Wheel, ...]:
        if sorted(wheels) != sorted(WHEEL_NAMES):
            raise ValueError('expected each of "fl", "fr", "rr" and "rl" once')
        return wheels

    @field_validator("reversed")
    @classmethod
    def _no_doubles(cls, wheels: tuple[Wheel, ...]) -> tuple[Wheel, ...]:
        if len(set(wheels)) != len(wheels):
            raise ValueError("expected each wheel at most once")
        return wheels


class LinkTable(Table):
    """``[link]``: the wire, and the latency added to it, in robot time."""

    url: Text = Field(default="memory:", description="memory:, serial:PATH or can:INTERFACE/CHANNEL")
    command_latency_s: Milliseconds = Field(default=0.0, ge=0, le=1, description="added on the way to the firmware")
    feedback_latency_s: Milliseconds = Field(default=0.0, ge=0, le=1, description="added on the way back")

    @field_validator("url")
    @classmethod
    def _readable(cls, url: str) -> str:
        try:
            parse_link(url)
        except BadInputError as error:
            raise ValueError(str(error)) from error
        return url

    @property
    def command_latency_ns(self) -> int:
        """Latency on the way to the firmware [ns]."""
        return round(self.command_latency_s * 1e9)

    @property
    def feedback_latency_ns(self) -> int:
        """Latency on the way back [ns]."""
        return round(self.feedback_latency_s * 1e9)


class ControllerTable(Table):
    """``[controller]``: the law. Its gains are its own and are checked against the law when it is made."""

    law: Text = Field(description="a shipped name, ./my_law.py:MyLaw or package.module:Class")
    command: Literal["speed", "torque"] = Field(
        default="speed", description="what the wheels are told; fixed at arming"
    )
    gains: Mapping[Text, Option] = Field(default_factory=dict, description="the law's own numbers")
    shadow: tuple[Text, ...] = Field(default=(), description="laws that are computed beside it and drive nothing")
    shadow_gains: Mapping[Text, Mapping[Text, Option]] = Field(
        default_factory=dict, description="of each shadow by its name; that of a class is its own, without the file"
    )

    @property
    def shadow_names(self) -> tuple[str, ...]:
        """What the signals of the shadows and their gains go by."""
        return tuple(short_name(spec) for spec in self.shadow)

    @property
    def mode(self) -> CommandMode:
        """``command`` as the tick and the wire have it."""
        return CommandMode[self.command.upper()]


class ReferenceTable(Table):
    """``[reference]``: the path to follow. Keys other than ``kind`` are the kind's own; it checks them."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Option] = Field(init=False)

    kind: Text = Field(description="circle, hold, ...; `hil list references` prints them all")

    @property
    def options(self) -> Mapping[str, OptionValue]:
        """Every key but ``kind``."""
        return dict(self.__pydantic_extra__)


class FilterTable(Table):
    """``[estimator.filter]``: the filter of source "fused". Sigmas are standard deviations."""

    begin: Literal["start", "fix"] = Field(default="start", description="at the scenario's start pose, or unknown")
    start_sigma_m: float = Field(default=0.01, ge=0, le=100, description="of the start pose, each axis")
    start_sigma_rad: float = Field(default=0.01, ge=0, le=10, description="of the start pose's heading")
    wheels_sigma_m: float = Field(default=0.01, gt=0, le=10, description="of each axis after 1 m rolled")
    wheels_sigma_rad: float = Field(default=0.02, gt=0, le=10, description="of the heading after 1 m, without gyro")
    gyro_noise_rad_s: float = Field(default=0.01, gt=0, le=10, description="of one sample of the gyro")
    gyro_bias_sigma_rad_s: float = Field(default=0.02, ge=0, le=10, description="of the gyro's bias at the start")
    gyro_bias_walk_rad_s: float = Field(default=0.001, ge=0, le=10, description="of the bias's wandering in 1 s")
    gate_probability: float = Field(default=0.999, ge=0.5, le=0.999999, description="of a right fix to be accepted")
    restart_after: int = Field(
        default=10,
        ge=2,
        le=1000,
        description="rejected fixes that agree, in a row, to be believed",
    )
    fix_timeout_s: float = Field(default=0.5, gt=0, le=3600, description="age of the newest fix that is degraded")
    lost_sigma_m: float = Field(
        default=0.25, gt=0, le=1000, description="of the position, beyond which the robot is held at rest"
    )
    history_s: float = Field(default=1.0, ge=0.01, le=10, description="how late a fix may come")
    release_s: float = Field(
        default=0.2, ge=0, le=10, description="time constant with which the pose follows a correction; 0: it jumps"
    )


class SimulatedFixTable(Table):
    """``[estimator.simulated_fix]``: a lidar's SLAM, simulated from the truth in robot time."""

    rate_hz: float = Field(default=10.0, ge=0.1, le=1000, description="fixes a second")
    latency_s: float = Field(default=0.1, ge=0, le=10, description="from the scan to the fix")
    sigma_m: float = Field(default=0.02, ge=1e-5, le=100, description="noise of each axis")
    sigma_rad: float = Field(default=0.01, ge=1e-5, le=10, description="noise of the heading")
    outlier_probability: float = Field(default=0.0, ge=0, le=1, description="of a fix to be wrong")
    outlier_m: float = Field(default=1.0, ge=0, le=1000, description="how far off; turned by at most as many rad")
    dropout_probability: float = Field(default=0.0, ge=0, le=1, description="of a fix to be missing")
    gap_start_s: float = Field(default=0.0, ge=0, le=86_400, description="from here on, since t = 0, there are none")
    gap_end_s: float = Field(default=0.0, ge=0, le=86_400, description="up to here")


class EstimatorTable(Table):
    """``[estimator]``: where the state that the controller acts on comes from."""

    source: Literal["truth", "odometry", "fused"] = Field(
        default="truth", description="true pose, wheels and gyro alone, or these with pose fixes"
    )
    twist: Literal["source", "wheels"] = Field(
        default="source", description="the source's own, or that of wheels and gyro even where the truth has one"
    )
    slip_threshold_m_s: float = Field(
        default=0.1, gt=0, le=100, description="contradiction of wheels, gyro and accelerometer that is slip"
    )
    fix: Text = Field(default="simulated", description='pose fixes of "fused": simulated, or udp://127.0.0.1:PORT')
    filter: FilterTable = FilterTable()
    simulated_fix: SimulatedFixTable = SimulatedFixTable()

    @field_validator("fix")
    @classmethod
    def _reachable(cls, fix: str) -> str:
        if fix != "simulated":
            try:
                parse_address(fix)
            except BadInputError as error:
                raise ValueError(str(error).removeprefix(f"estimator.fix = {fix!r}: ")) from error
        return fix


class LoopTable(Table):
    """``[loop]``: the controller's tick."""

    rate_hz: int = Field(description="a command period is a whole number of 1 ms firmware ticks")
    duration_s: float = Field(gt=0, le=86_400, description="from the first ACTIVE tick")
    mode: Literal["lockstep", "realtime"] = Field(default="lockstep", description="whose time passes")
    seed: int = Field(default=1, ge=0, le=2**32 - 1, description="of everything random in the run")
    rearm: bool = Field(default=False, description="reconnect and arm anew after a lost link or a stop of the robot")
    tick_limit_s: float = Field(
        default=10.0,
        ge=0,
        allow_inf_nan=True,
        description="wall-clock time of a tick's own work, beyond which the run is ended; 0 or inf for no limit",
    )

    @field_validator("tick_limit_s")
    @classmethod
    def _no_spin(cls, tick_limit_s: float) -> float:
        if 0.0 < tick_limit_s < LEAST_TICK_LIMIT_S:
            raise ValueError(f"expected at least {LEAST_TICK_LIMIT_S:g} s, or 0 for no limit")
        return tick_limit_s

    @field_validator("rate_hz")
    @classmethod
    def _whole_ticks(cls, rate_hz: int) -> int:
        if rate_hz not in RATES_HZ:
            raise ValueError(f"expected one of {', '.join(map(str, RATES_HZ))}, a whole number of ms a period")
        return rate_hz

    @property
    def period_ns(self) -> int:
        """Command period [ns]."""
        return 1_000_000_000 // self.rate_hz

    @property
    def substeps(self) -> int:
        """Firmware ticks of 1 ms in a command period (DBC STEP.substeps)."""
        return TICKS_PER_SECOND // self.rate_hz


class Tables(Table):
    """All tables of a scenario, in the order in which they are written and shown."""

    robot: RobotTable
    plant: PlantTable = PlantTable()
    firmware: FirmwareTable
    device: DeviceTable = DeviceTable()
    link: LinkTable = LinkTable()
    controller: ControllerTable
    reference: ReferenceTable
    estimator: EstimatorTable = EstimatorTable()
    loop: LoopTable
    realtime: RealtimeTable = RealtimeTable()
    service: ServiceTable = ServiceTable()
    allow: AllowTable = AllowTable()
    fault: tuple[FaultTable, ...] = ()
    expect: tuple[ExpectTable, ...] = ()
