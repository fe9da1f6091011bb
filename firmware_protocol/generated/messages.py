"""The messages of the wheel-command protocol: generated from wheel.dbc; do not edit.

Made by `python -m firmware_protocol.generate`. One class a message, with the fields of the DBC, units in
their names; ``firmware_protocol.message`` encodes and decodes them.
"""

from enum import IntEnum
from typing import Annotated, NamedTuple

from firmware_protocol.message import Field, Message


PROTOCOL_VERSION = 2
SCHEMA_HASH = 0x8DC26BB0


class Request(IntEnum):
    """Values of HOST_HEARTBEAT.request."""

    IDLE = 0
    ARM = 1
    CLEAR = 2


class Mode(IntEnum):
    """Values of HOST_HEARTBEAT.mode and STATUS.mode."""

    SPEED = 0
    TORQUE = 1


class State(IntEnum):
    """Values of TICK.state and STATUS.state."""

    BOOT = 0
    IDLE = 1
    ARMED = 2
    ACTIVE = 3
    STOPPING = 4
    FAULT = 5
    ESTOP = 6


class Fault(IntEnum):
    """Values of STATUS.fault."""

    NONE = 0
    SENSOR = 1
    OVERSPEED = 2
    PARAMETERS = 3
    OVERCURRENT = 4
    OVERTEMPERATURE = 5
    UNDERVOLTAGE = 6
    ENCODER_STUCK = 7
    WRONG_DIRECTION = 8


class FaultWheel(IntEnum):
    """Values of STATUS.fault_wheel."""

    NONE = 0
    FL = 1
    FR = 2
    RR = 3
    RL = 4


class StopReason(IntEnum):
    """Values of STATUS.stop_reason."""

    NONE = 0
    HOST_REQUEST = 1
    COMMAND_TIMEOUT = 2
    ARM_TIMEOUT = 3
    ESTOP = 4
    FAULT = 5


class ResetCause(IntEnum):
    """Values of STATUS.reset_cause."""

    UNKNOWN = 0
    POWER_ON = 1
    BROWN_OUT = 2
    PIN = 3
    SOFTWARE = 4
    WATCHDOG = 5
    LOW_POWER = 6
    PROCESSOR_FAULT = 7


class ArmRefusal(IntEnum):
    """Values of STATUS.arm_refusal."""

    NONE = 0
    SCHEMA = 1
    PARAMETERS = 2
    NOT_IDLE = 3
    NONCE_USED = 4
    SESSION_USED = 5
    MODE = 6
    NOT_ANNOUNCED = 7


class Operation(IntEnum):
    """Values of PARAMETER_REQUEST.operation and PARAMETER_RESPONSE.operation."""

    READ = 0
    READ_MINIMUM = 1
    READ_MAXIMUM = 2
    WRITE = 3
    STORE = 4
    RESTORE = 5


class Result(IntEnum):
    """Values of PARAMETER_RESPONSE.result."""

    OK = 0
    PARAMETER = 1
    RANGE = 2
    STATE = 3
    STORAGE = 4


class Type(IntEnum):
    """Values of PARAMETER_RESPONSE.type."""

    FLOAT32 = 0
    UINT32 = 1


class _EstopFields(NamedTuple):
    source: Annotated[int, Field(0, 8, 0, 255)]
    reason: Annotated[int, Field(8, 8, 0, 255)]


class Estop(_EstopFields, Message, number=0x010, length=2, name="ESTOP", sender="HOST"):
    """ESTOP: Stop driving at once and latch. Needs no session; sent on the event and repeated until STATUS
    answers ESTOP.
    """

    __slots__ = ()


class _HostHeartbeatFields(NamedTuple):
    nonce: Annotated[int, Field(0, 16, 1, 65535)]
    schema_hash: Annotated[int, Field(16, 32, 0, 4294967295)]
    request: Annotated[int, Field(48, 4, 0, 2, values=Request)]
    mode: Annotated[int, Field(52, 4, 0, 1, values=Mode)]
    parameter_check: Annotated[int, Field(56, 8, 0, 255)]


class HostHeartbeat(_HostHeartbeatFields, Message, number=0x020, length=8, name="HOST_HEARTBEAT", sender="HOST"):
    """HOST_HEARTBEAT: What the host wishes, sent at 10 Hz and on every change. IDLE announces a nonce, ARM
    with that nonce arms once; repeating it never re-arms.
    nonce: With IDLE: the nonce that the next ARM will have. With ARM: the session nonce, whose low 4 bits
        are the session in every command. With CLEAR: a new one for each.
    schema_hash: The host's schema hash; ARM is refused unless it equals the robot's.
    parameter_check: Low 8 bits of the parameter hash that the host expects; ARM is refused unless it equals
        the robot's.
    """

    __slots__ = ()


class _TorqueFeedforwardFields(NamedTuple):
    fl_n_m: Annotated[float, Field(0, 13, -4095, 4095, 0.00390625, unit="N.m")]
    fr_n_m: Annotated[float, Field(13, 13, -4095, 4095, 0.00390625, unit="N.m")]
    rr_n_m: Annotated[float, Field(26, 13, -4095, 4095, 0.00390625, unit="N.m")]
    rl_n_m: Annotated[float, Field(39, 13, -4095, 4095, 0.00390625, unit="N.m")]
    sequence: Annotated[int, Field(52, 8, 0, 255)]
    session: Annotated[int, Field(60, 4, 0, 15)]


class TorqueFeedforward(_TorqueFeedforwardFields, Message, number=0x030, length=8, name="TORQUE_FEEDFORWARD", sender="HOST"):
    """TORQUE_FEEDFORWARD: Torque feedforward, staged: applied only together with the WHEEL_COMMAND of the
    same session and sequence that follows it.
    """

    __slots__ = ()


class _WheelCommandFields(NamedTuple):
    fl_rad_s: Annotated[float, Field(0, 13, -4095, 4095, 0.015625, unit="rad/s")]
    fr_rad_s: Annotated[float, Field(13, 13, -4095, 4095, 0.015625, unit="rad/s")]
    rr_rad_s: Annotated[float, Field(26, 13, -4095, 4095, 0.015625, unit="rad/s")]
    rl_rad_s: Annotated[float, Field(39, 13, -4095, 4095, 0.015625, unit="rad/s")]
    sequence: Annotated[int, Field(52, 8, 0, 255)]
    session: Annotated[int, Field(60, 4, 0, 15)]


class WheelCommand(_WheelCommandFields, Message, number=0x040, length=8, name="WHEEL_COMMAND", sender="HOST"):
    """WHEEL_COMMAND: Wheel speed set points. In speed mode the only message that feeds the watchdog."""

    __slots__ = ()


class _TorqueCommandFields(NamedTuple):
    fl_n_m: Annotated[float, Field(0, 13, -4095, 4095, 0.00390625, unit="N.m")]
    fr_n_m: Annotated[float, Field(13, 13, -4095, 4095, 0.00390625, unit="N.m")]
    rr_n_m: Annotated[float, Field(26, 13, -4095, 4095, 0.00390625, unit="N.m")]
    rl_n_m: Annotated[float, Field(39, 13, -4095, 4095, 0.00390625, unit="N.m")]
    sequence: Annotated[int, Field(52, 8, 0, 255)]
    session: Annotated[int, Field(60, 4, 0, 15)]


class TorqueCommand(_TorqueCommandFields, Message, number=0x041, length=8, name="TORQUE_COMMAND", sender="HOST"):
    """TORQUE_COMMAND: Wheel torque set points. In torque mode the only message that feeds the watchdog."""

    __slots__ = ()


class _TickFields(NamedTuple):
    time_us: Annotated[int, Field(0, 32, 0, 4294967295, unit="us")]
    sequence: Annotated[int, Field(32, 8, 0, 255)]
    command_age_ms: Annotated[int, Field(40, 8, 0, 255, unit="ms")]
    state: Annotated[int, Field(48, 3, 0, 6, values=State)]
    parts: Annotated[int, Field(51, 5, 0, 31)]
    snapshot: Annotated[int, Field(56, 8, 0, 255)]


class Tick(_TickFields, Message, number=0x080, length=8, name="TICK", sender="ROBOT"):
    """TICK: Opens a feedback snapshot at the loop rate; the parts that it announces follow it.
    time_us: Robot time of the sampling instant, wrapping.
    sequence: Sequence of the command in force.
    command_age_ms: Robot time since the newest accepted command; 255 means 255 or more, or none yet.
    parts: Parts that follow: bit 0 ENCODERS, bit 1 WHEEL_SPEEDS, bit 2 CURRENTS, bit 3 ACCELEROMETER, bit 4
        GYRO.
    snapshot: Counts snapshots, wrapping.
    """

    __slots__ = ()


class _EncodersFields(NamedTuple):
    fl_count: Annotated[int, Field(0, 16, 0, 65535)]
    fr_count: Annotated[int, Field(16, 16, 0, 65535)]
    rr_count: Annotated[int, Field(32, 16, 0, 65535)]
    rl_count: Annotated[int, Field(48, 16, 0, 65535)]


class Encoders(_EncodersFields, Message, number=0x081, length=8, name="ENCODERS", sender="ROBOT"):
    """ENCODERS: Encoder counts, wrapping."""

    __slots__ = ()


class _WheelSpeedsFields(NamedTuple):
    fl_rad_s: Annotated[float, Field(0, 16, -32767, 32767, 0.00390625, unit="rad/s")]
    fr_rad_s: Annotated[float, Field(16, 16, -32767, 32767, 0.00390625, unit="rad/s")]
    rr_rad_s: Annotated[float, Field(32, 16, -32767, 32767, 0.00390625, unit="rad/s")]
    rl_rad_s: Annotated[float, Field(48, 16, -32767, 32767, 0.00390625, unit="rad/s")]


class WheelSpeeds(_WheelSpeedsFields, Message, number=0x082, length=8, name="WHEEL_SPEEDS", sender="ROBOT"):
    """WHEEL_SPEEDS: Wheel speeds as the tracking filter estimates them."""

    __slots__ = ()


class _CurrentsFields(NamedTuple):
    fl_a: Annotated[float, Field(0, 16, -32767, 32767, 0.0009765625, unit="A")]
    fr_a: Annotated[float, Field(16, 16, -32767, 32767, 0.0009765625, unit="A")]
    rr_a: Annotated[float, Field(32, 16, -32767, 32767, 0.0009765625, unit="A")]
    rl_a: Annotated[float, Field(48, 16, -32767, 32767, 0.0009765625, unit="A")]


class Currents(_CurrentsFields, Message, number=0x083, length=8, name="CURRENTS", sender="ROBOT"):
    """CURRENTS: Motor currents, each the mean over the feedback period that ends at time_us."""

    __slots__ = ()


class _AccelerometerFields(NamedTuple):
    x_m_s2: Annotated[float, Field(0, 16, -32767, 32767, 0.00390625, unit="m/s2")]
    y_m_s2: Annotated[float, Field(16, 16, -32767, 32767, 0.00390625, unit="m/s2")]
    z_m_s2: Annotated[float, Field(32, 16, -32767, 32767, 0.00390625, unit="m/s2")]
    tick: Annotated[int, Field(48, 16, 0, 65535)]


class Accelerometer(_AccelerometerFields, Message, number=0x090, length=8, name="ACCELEROMETER", sender="ROBOT"):
    """ACCELEROMETER: Acceleration of the robot's centre without gravity's, in the body frame: at rest z is
    9.81 m/s2. The mean over the feedback period that ends at time_us.
    tick: As in GYRO.
    """

    __slots__ = ()


class _GyroFields(NamedTuple):
    x_rad_s: Annotated[float, Field(0, 16, -32767, 32767, 0.0009765625, unit="rad/s")]
    y_rad_s: Annotated[float, Field(16, 16, -32767, 32767, 0.0009765625, unit="rad/s")]
    z_rad_s: Annotated[float, Field(32, 16, -32767, 32767, 0.0009765625, unit="rad/s")]
    tick: Annotated[int, Field(48, 16, 0, 65535)]


class Gyro(_GyroFields, Message, number=0x091, length=8, name="GYRO", sender="ROBOT"):
    """GYRO: Angular rates in the body frame at time_us, x forward, y left, z up.
    tick: Low 16 bits of TICK.time_us / 1000 of the snapshot that this part belongs to.
    """

    __slots__ = ()


class _StatusFields(NamedTuple):
    state: Annotated[int, Field(0, 4, 0, 6, values=State)]
    mode: Annotated[int, Field(4, 4, 0, 1, values=Mode)]
    fault: Annotated[int, Field(8, 5, 0, 8, values=Fault)]
    fault_wheel: Annotated[int, Field(13, 3, 0, 4, values=FaultWheel)]
    stop_reason: Annotated[int, Field(16, 4, 0, 5, values=StopReason)]
    reset_cause: Annotated[int, Field(20, 4, 0, 7, values=ResetCause)]
    nonce: Annotated[int, Field(24, 16, 0, 65535)]
    arm_refusal: Annotated[int, Field(40, 8, 0, 7, values=ArmRefusal)]
    limited: Annotated[int, Field(48, 16, 0, 65535)]


class Status(_StatusFields, Message, number=0x100, length=8, name="STATUS", sender="ROBOT"):
    """STATUS: State, and why the robot last stopped or refused to arm; 10 Hz and on every change of state.
    fault_wheel: Wheel of the fault, 1 to 4 for FL, FR, RR, RL; 0 when it is not one wheel's.
    reset_cause: Why the robot began anew the last time.
    nonce: Nonce of the last session; 0 when there was none.
    limited: Ticks in which all four wheels were scaled at a limit of torque, current, temperature or speed,
        wrapping.
    """

    __slots__ = ()


class _PowerFields(NamedTuple):
    battery_v: Annotated[float, Field(0, 16, -32767, 32767, 0.0078125, unit="V")]
    battery_a: Annotated[float, Field(16, 16, -32767, 32767, 0.0078125, unit="A")]


class Power(_PowerFields, Message, number=0x101, length=4, name="POWER", sender="ROBOT"):
    """POWER: Battery, the means over the newest feedback period; 10 Hz.
    battery_a: Out of the battery; negative while braking charges it.
    """

    __slots__ = ()


class _TemperaturesFields(NamedTuple):
    fl_degc: Annotated[float, Field(0, 16, -32767, 32767, 0.0078125, unit="degC")]
    fr_degc: Annotated[float, Field(16, 16, -32767, 32767, 0.0078125, unit="degC")]
    rr_degc: Annotated[float, Field(32, 16, -32767, 32767, 0.0078125, unit="degC")]
    rl_degc: Annotated[float, Field(48, 16, -32767, 32767, 0.0078125, unit="degC")]


class Temperatures(_TemperaturesFields, Message, number=0x102, length=8, name="TEMPERATURES", sender="ROBOT"):
    """TEMPERATURES: Temperatures of the motors' windings; 10 Hz."""

    __slots__ = ()


class _LinkCountersFields(NamedTuple):
    cobs: Annotated[int, Field(0, 8, 0, 255)]
    crc: Annotated[int, Field(8, 8, 0, 255)]
    length: Annotated[int, Field(16, 8, 0, 255)]
    unknown_id: Annotated[int, Field(24, 8, 0, 255)]
    range: Annotated[int, Field(32, 8, 0, 255)]
    session: Annotated[int, Field(40, 8, 0, 255)]
    stale: Annotated[int, Field(48, 8, 0, 255)]
    state: Annotated[int, Field(56, 8, 0, 255)]


class LinkCounters(_LinkCountersFields, Message, number=0x103, length=8, name="LINK_COUNTERS", sender="ROBOT"):
    """LINK_COUNTERS: Frames rejected, by cause, each wrapping; 10 Hz.
    length: Frames of a wrong length.
    """

    __slots__ = ()


class _AbsoluteFrontFields(NamedTuple):
    fl_count: Annotated[int, Field(0, 32, 0, 4294967295)]
    fr_count: Annotated[int, Field(32, 32, 0, 4294967295)]


class AbsoluteFront(_AbsoluteFrontFields, Message, number=0x104, length=8, name="ABSOLUTE_FRONT", sender="ROBOT"):
    """ABSOLUTE_FRONT: Encoder counts since power-on in two's complement: whole turns that ENCODERS no longer
    tells; 1 Hz.
    """

    __slots__ = ()


class _AbsoluteRearFields(NamedTuple):
    rr_count: Annotated[int, Field(0, 32, 0, 4294967295)]
    rl_count: Annotated[int, Field(32, 32, 0, 4294967295)]


class AbsoluteRear(_AbsoluteRearFields, Message, number=0x105, length=8, name="ABSOLUTE_REAR", sender="ROBOT"):
    """ABSOLUTE_REAR: As ABSOLUTE_FRONT."""

    __slots__ = ()


class _PortCountersFields(NamedTuple):
    overrun: Annotated[int, Field(0, 8, 0, 255)]
    feedforward_unmatched: Annotated[int, Field(8, 8, 0, 255)]
    transmit_overrun: Annotated[int, Field(16, 8, 0, 255)]
    serial_lost: Annotated[int, Field(24, 8, 0, 255)]
    can_errors: Annotated[int, Field(32, 8, 0, 255)]
    bus_off: Annotated[int, Field(40, 8, 0, 255)]


class PortCounters(_PortCountersFields, Message, number=0x106, length=6, name="PORT_COUNTERS", sender="ROBOT"):
    """PORT_COUNTERS: What the robot's ports lost, each wrapping; 10 Hz.
    overrun: Serial frames too long, and bytes that the port could not take in time.
    feedforward_unmatched: Torque feedforwards without their command.
    transmit_overrun: Frames that the robot could not send in time.
    serial_lost: Frames of the host that are missing in its line count.
    can_errors: CAN error frames seen by the robot's controller.
    bus_off: Times that the robot's controller went off the bus and came back.
    """

    __slots__ = ()


class _TimeSyncRequestFields(NamedTuple):
    sequence: Annotated[int, Field(0, 8, 0, 255)]


class TimeSyncRequest(_TimeSyncRequestFields, Message, number=0x180, length=1, name="TIME_SYNC_REQUEST", sender="HOST"):
    """TIME_SYNC_REQUEST: Asks for the robot's clock; 4 Hz."""

    __slots__ = ()


class _TimeSyncResponseFields(NamedTuple):
    received_us: Annotated[int, Field(0, 32, 0, 4294967295, unit="us")]
    held_us: Annotated[int, Field(32, 16, 0, 65535, unit="us")]
    sequence: Annotated[int, Field(48, 8, 0, 255)]


class TimeSyncResponse(_TimeSyncResponseFields, Message, number=0x181, length=7, name="TIME_SYNC_RESPONSE", sender="ROBOT"):
    """TIME_SYNC_RESPONSE: Answers TIME_SYNC_REQUEST.
    received_us: The robot's clock, that of TICK.time_us, when the request arrived.
    held_us: Time from then until this answer was handed to the port; 65535 or more is 65535.
    """

    __slots__ = ()


class _ParameterRequestFields(NamedTuple):
    parameter: Annotated[int, Field(0, 8, 0, 255)]
    operation: Annotated[int, Field(8, 8, 0, 5, values=Operation)]
    transaction: Annotated[int, Field(16, 8, 0, 255)]
    value: Annotated[int, Field(24, 32, 0, 4294967295)]


class ParameterRequest(_ParameterRequestFields, Message, number=0x200, length=7, name="PARAMETER_REQUEST", sender="HOST"):
    """PARAMETER_REQUEST: Reads or changes one of the firmware's parameters; STORE and RESTORE concern all.
    operation: WRITE, STORE and RESTORE are done in IDLE only. RESTORE takes the values that the firmware was
        built with.
    transaction: Comes back in the answer.
    value: WRITE: the bits of the value, by its type. Otherwise 0.
    """

    __slots__ = ()


class _ParameterResponseFields(NamedTuple):
    parameter: Annotated[int, Field(0, 8, 0, 255)]
    operation: Annotated[int, Field(8, 8, 0, 5, values=Operation)]
    transaction: Annotated[int, Field(16, 8, 0, 255)]
    result: Annotated[int, Field(24, 4, 0, 4, values=Result)]
    type: Annotated[int, Field(28, 4, 0, 1, values=Type)]
    value: Annotated[int, Field(32, 32, 0, 4294967295)]


class ParameterResponse(_ParameterResponseFields, Message, number=0x280, length=8, name="PARAMETER_RESPONSE", sender="ROBOT"):
    """PARAMETER_RESPONSE: Answers PARAMETER_REQUEST.
    result: PARAMETER: no such one. RANGE: not from its minimum to its maximum. STATE: not in IDLE. STORAGE:
        could not be kept.
    value: The bits of the value, or of a limit, as it is now; for STORE and RESTORE, done or refused, the
        parameter hash.
    """

    __slots__ = ()


class _StepFields(NamedTuple):
    tick: Annotated[int, Field(0, 32, 0, 4294967295)]
    substeps: Annotated[int, Field(32, 16, 0, 1000)]


class Step(_StepFields, Message, number=0x300, length=6, name="STEP", sender="HOST"):
    """STEP: Lockstep only. At this tick, run so many 1 ms ticks. Repeating it runs nothing twice; 0 substeps
    asks for the tick.
    """

    __slots__ = ()


class _StepDoneFields(NamedTuple):
    tick: Annotated[int, Field(0, 32, 0, 4294967295)]


class StepDone(_StepDoneFields, Message, number=0x301, length=4, name="STEP_DONE", sender="ROBOT"):
    """STEP_DONE: Lockstep only. The tick reached; sent after the feedback of the step."""

    __slots__ = ()


class _HelloRequestFields(NamedTuple):
    protocol_version: Annotated[int, Field(0, 8, 0, 255)]


class HelloRequest(_HelloRequestFields, Message, number=0x700, length=1, name="HELLO_REQUEST", sender="HOST"):
    """HELLO_REQUEST: Asks for the HELLO pages. Ids 1792-1807 and the layout of page 0 are frozen for ever.
    """

    __slots__ = ()


class _HelloIdentityFields(NamedTuple):
    protocol_version: Annotated[int, Field(0, 8, 0, 255)]
    pages: Annotated[int, Field(8, 8, 0, 255)]
    capabilities: Annotated[int, Field(16, 16, 0, 65535)]
    schema_hash: Annotated[int, Field(32, 32, 0, 4294967295)]


class HelloIdentity(_HelloIdentityFields, Message, number=0x701, length=8, name="HELLO_IDENTITY", sender="ROBOT"):
    """HELLO_IDENTITY: HELLO page 0.
    pages: How many pages follow each other from this id on.
    capabilities: Bit 0 POWER_STAGE, 1 LOCKSTEP, 2 SPEED, 3 TORQUE, 4 FEEDFORWARD, 5 CURRENTS, 6 GYRO, 7
        ACCELEROMETER, 8 POWER, 9 TEMPERATURES, 10 STORAGE.
    """

    __slots__ = ()


class _HelloFirmwareFields(NamedTuple):
    major: Annotated[int, Field(0, 8, 0, 255)]
    minor: Annotated[int, Field(8, 8, 0, 255)]
    patch: Annotated[int, Field(16, 8, 0, 255)]
    board: Annotated[int, Field(24, 8, 0, 255)]
    build: Annotated[int, Field(32, 32, 0, 4294967295)]


class HelloFirmware(_HelloFirmwareFields, Message, number=0x702, length=8, name="HELLO_FIRMWARE", sender="ROBOT"):
    """HELLO_FIRMWARE: HELLO page 1.
    board: 0 is the host library.
    build: First 32 bits of the build's source hash; 0 when unknown.
    """

    __slots__ = ()


class _HelloParametersFields(NamedTuple):
    parameter_hash: Annotated[int, Field(0, 32, 0, 4294967295)]
    watchdog_ms: Annotated[int, Field(32, 16, 0, 65535, unit="ms")]
    feedback_period_ms: Annotated[int, Field(48, 16, 0, 65535, unit="ms")]


class HelloParameters(_HelloParametersFields, Message, number=0x703, length=8, name="HELLO_PARAMETERS", sender="ROBOT"):
    """HELLO_PARAMETERS: HELLO page 2."""

    __slots__ = ()


class _HelloGeometryFields(NamedTuple):
    wheel_radius_m: Annotated[float, Field(0, 16, -32767, 32767, 0.0001220703125, unit="m")]
    half_length_m: Annotated[float, Field(16, 16, -32767, 32767, 0.0001220703125, unit="m")]
    half_width_m: Annotated[float, Field(32, 16, -32767, 32767, 0.0001220703125, unit="m")]
    counts_per_revolution: Annotated[int, Field(48, 16, 0, 65535)]


class HelloGeometry(_HelloGeometryFields, Message, number=0x704, length=8, name="HELLO_GEOMETRY", sender="ROBOT"):
    """HELLO_GEOMETRY: HELLO page 3: the robot's size, as its firmware knows it.
    half_length_m: From the centre to an axle.
    half_width_m: From the centre to a wheel.
    """

    __slots__ = ()


class _HelloLimitsFields(NamedTuple):
    speed_limit_rad_s: Annotated[float, Field(0, 16, -32767, 32767, 0.00390625, unit="rad/s")]
    overspeed_rad_s: Annotated[float, Field(16, 16, -32767, 32767, 0.00390625, unit="rad/s")]
    torque_limit_n_m: Annotated[float, Field(32, 16, -32767, 32767, 0.00390625, unit="N.m")]


class HelloLimits(_HelloLimitsFields, Message, number=0x705, length=6, name="HELLO_LIMITS", sender="ROBOT"):
    """HELLO_LIMITS: HELLO page 4: what the robot keeps its wheels to.
    speed_limit_rad_s: WHEEL_COMMANDs beyond it are scaled to it, all four wheels by one factor.
    overspeed_rad_s: A wheel faster than this is a fault.
    torque_limit_n_m: Of one wheel; beyond it all four are scaled.
    """

    __slots__ = ()


class _HelloFaultStatusFields(NamedTuple):
    cfsr: Annotated[int, Field(0, 32, 0, 4294967295)]
    hfsr: Annotated[int, Field(32, 32, 0, 4294967295)]


class HelloFaultStatus(_HelloFaultStatusFields, Message, number=0x706, length=8, name="HELLO_FAULT_STATUS", sender="ROBOT"):
    """HELLO_FAULT_STATUS: HELLO page 5: fault status registers of the processor fault that reset the robot;
    0 when none did.
    """

    __slots__ = ()


class _HelloFaultPlaceFields(NamedTuple):
    pc: Annotated[int, Field(0, 32, 0, 4294967295)]
    lr: Annotated[int, Field(32, 32, 0, 4294967295)]


class HelloFaultPlace(_HelloFaultPlaceFields, Message, number=0x707, length=8, name="HELLO_FAULT_PLACE", sender="ROBOT"):
    """HELLO_FAULT_PLACE: HELLO page 6: where the processor was at that fault; 0 when it is not known.
    pc: Address of the instruction.
    lr: Where its function would have returned to.
    """

    __slots__ = ()


class _HelloFaultAddressFields(NamedTuple):
    mmfar: Annotated[int, Field(0, 32, 0, 4294967295)]
    bfar: Annotated[int, Field(32, 32, 0, 4294967295)]


class HelloFaultAddress(_HelloFaultAddressFields, Message, number=0x708, length=8, name="HELLO_FAULT_ADDRESS", sender="ROBOT"):
    """HELLO_FAULT_ADDRESS: HELLO page 7: which address that fault was about, where cfsr says that it holds
    one.
    mmfar: Of a memory management fault.
    bfar: Of a bus fault.
    """

    __slots__ = ()


MESSAGES: dict[int, type[Message]] = {
    kind.ID: kind
    for kind in (
        Estop,
        HostHeartbeat,
        TorqueFeedforward,
        WheelCommand,
        TorqueCommand,
        Tick,
        Encoders,
        WheelSpeeds,
        Currents,
        Accelerometer,
        Gyro,
        Status,
        Power,
        Temperatures,
        LinkCounters,
        AbsoluteFront,
        AbsoluteRear,
        PortCounters,
        TimeSyncRequest,
        TimeSyncResponse,
        ParameterRequest,
        ParameterResponse,
        Step,
        StepDone,
        HelloRequest,
        HelloIdentity,
        HelloFirmware,
        HelloParameters,
        HelloGeometry,
        HelloLimits,
        HelloFaultStatus,
        HelloFaultPlace,
        HelloFaultAddress,
    )
}
LENGTHS: dict[int, int] = {number: message.LENGTH for number, message in MESSAGES.items()}
NAMES: dict[int, str] = {number: message.NAME for number, message in MESSAGES.items()}
SENDERS: dict[int, str] = {number: message.SENDER for number, message in MESSAGES.items()}
