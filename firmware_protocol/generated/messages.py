"""The messages of the wheel-command protocol: generated from wheel.dbc; do not edit.

Made by `python -m firmware_protocol.generate`. One class a message, with the fields of the DBC, units in
their names. ``encode`` returns the payload and raises ValueError when a value is out of its range or not a
number, TypeError when an integer field is not an integer. ``decode`` returns None when the payload has the
wrong length or holds a value out of its range. Scaled values are rounded to the nearest step, halves away
from zero, exactly as in the generated C.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from operator import index as _index
from struct import Struct
from typing import ClassVar, NamedTuple, Self, TypeAlias

_Range: TypeAlias = tuple[str, float, float, str]

_new = tuple.__new__  # of a named tuple: half the time that calling its class takes


def _out_of_range(message: str, values: Sequence[float], ranges: Sequence[_Range]) -> ValueError:
    for value, (field, minimum, maximum, unit) in zip(values, ranges, strict=True):
        if not minimum <= value <= maximum:
            return ValueError(f"{message}.{field} = {value}{unit}: expected {minimum} to {maximum}{unit}")
    raise AssertionError(f"{message}: all values are in range")


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


_ESTOP = Struct("<BB")
_ESTOP_RANGES: tuple[_Range, ...] = (
    ("source", 0, 255, ""),
    ("reason", 0, 255, ""),
)


class _EstopFields(NamedTuple):
    source: int
    reason: int


class Estop(_EstopFields):
    """ESTOP: Stop driving at once and latch. Needs no session; sent on the event and repeated until STATUS
    answers ESTOP.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x010
    LENGTH: ClassVar[int] = 2
    NAME: ClassVar[str] = "ESTOP"

    def encode(self) -> bytes:
        source, reason = self
        if not (
            0 <= source <= 255
            and 0 <= reason <= 255
        ):
            raise _out_of_range(self.NAME, self, _ESTOP_RANGES)
        return _ESTOP.pack(
            _index(source),
            _index(reason),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 2:
            return None
        return _new(cls, _ESTOP.unpack(payload))


_HOST_HEARTBEAT_WORDS = Struct("<HIBB")
_HOST_HEARTBEAT_RANGES: tuple[_Range, ...] = (
    ("nonce", 1, 65535, ""),
    ("schema_hash", 0, 4294967295, ""),
    ("request", 0, 2, ""),
    ("mode", 0, 1, ""),
    ("parameter_check", 0, 255, ""),
)


class _HostHeartbeatFields(NamedTuple):
    nonce: int
    schema_hash: int
    request: int
    mode: int
    parameter_check: int


class HostHeartbeat(_HostHeartbeatFields):
    """HOST_HEARTBEAT: What the host wishes, sent at 10 Hz and on every change. IDLE announces a nonce, ARM
    with that nonce arms once; repeating it never re-arms.
    nonce: With IDLE: the nonce that the next ARM will have. With ARM: the session nonce, whose low 4 bits
        are the session in every command. With CLEAR: a new one for each.
    schema_hash: The host's schema hash; ARM is refused unless it equals the robot's.
    parameter_check: Low 8 bits of the parameter hash that the host expects; ARM is refused unless it equals
        the robot's.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x020
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "HOST_HEARTBEAT"

    def encode(self) -> bytes:
        nonce, schema_hash, request, mode, parameter_check = self
        if not (
            1 <= nonce <= 65535
            and 0 <= schema_hash <= 4294967295
            and 0 <= request <= 2
            and 0 <= mode <= 1
            and 0 <= parameter_check <= 255
        ):
            raise _out_of_range(self.NAME, self, _HOST_HEARTBEAT_RANGES)
        return (
            _index(nonce)
            | _index(schema_hash) << 16
            | _index(request) << 48
            | _index(mode) << 52
            | _index(parameter_check) << 56
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        nonce, schema_hash, word_6, parameter_check = _HOST_HEARTBEAT_WORDS.unpack(payload)
        request = word_6 & 0xF
        mode = word_6 >> 4
        if not (
            1 <= nonce
            and request <= 2
            and mode <= 1
        ):
            return None
        return _new(cls, (
            nonce,
            schema_hash,
            request,
            mode,
            parameter_check,
        ))


_TORQUE_FEEDFORWARD_RANGES: tuple[_Range, ...] = (
    ("fl_n_m", -15.99609375, 15.99609375, " N.m"),
    ("fr_n_m", -15.99609375, 15.99609375, " N.m"),
    ("rr_n_m", -15.99609375, 15.99609375, " N.m"),
    ("rl_n_m", -15.99609375, 15.99609375, " N.m"),
    ("sequence", 0, 255, ""),
    ("session", 0, 15, ""),
)


class _TorqueFeedforwardFields(NamedTuple):
    fl_n_m: float
    fr_n_m: float
    rr_n_m: float
    rl_n_m: float
    sequence: int
    session: int


class TorqueFeedforward(_TorqueFeedforwardFields):
    """TORQUE_FEEDFORWARD: Torque feedforward, staged: applied only together with the WHEEL_COMMAND of the
    same session and sequence that follows it.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x030
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "TORQUE_FEEDFORWARD"

    def encode(self) -> bytes:
        fl_n_m, fr_n_m, rr_n_m, rl_n_m, sequence, session = self
        if not (
            -15.99609375 <= fl_n_m <= 15.99609375
            and -15.99609375 <= fr_n_m <= 15.99609375
            and -15.99609375 <= rr_n_m <= 15.99609375
            and -15.99609375 <= rl_n_m <= 15.99609375
            and 0 <= sequence <= 255
            and 0 <= session <= 15
        ):
            raise _out_of_range(self.NAME, self, _TORQUE_FEEDFORWARD_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        fl_n_m_twice = int(fl_n_m * 512.0)
        fr_n_m_twice = int(fr_n_m * 512.0)
        rr_n_m_twice = int(rr_n_m * 512.0)
        rl_n_m_twice = int(rl_n_m * 512.0)
        return (
            ((fl_n_m_twice + (fl_n_m_twice > 0) >> 1) & 0x1FFF)
            | ((fr_n_m_twice + (fr_n_m_twice > 0) >> 1) & 0x1FFF) << 13
            | ((rr_n_m_twice + (rr_n_m_twice > 0) >> 1) & 0x1FFF) << 26
            | ((rl_n_m_twice + (rl_n_m_twice > 0) >> 1) & 0x1FFF) << 39
            | _index(sequence) << 52
            | _index(session) << 60
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        bits = int.from_bytes(payload, "little")
        fl_n_m = (bits & 0x1FFF ^ 0x1000) - 0x1000
        fr_n_m = (bits >> 13 & 0x1FFF ^ 0x1000) - 0x1000
        rr_n_m = (bits >> 26 & 0x1FFF ^ 0x1000) - 0x1000
        rl_n_m = (bits >> 39 & 0x1FFF ^ 0x1000) - 0x1000
        sequence = bits >> 52 & 0xFF
        session = bits >> 60 & 0xF
        if not (
            -4095 <= fl_n_m
            and -4095 <= fr_n_m
            and -4095 <= rr_n_m
            and -4095 <= rl_n_m
        ):
            return None
        return _new(cls, (
            fl_n_m * 0.00390625,
            fr_n_m * 0.00390625,
            rr_n_m * 0.00390625,
            rl_n_m * 0.00390625,
            sequence,
            session,
        ))


_WHEEL_COMMAND_RANGES: tuple[_Range, ...] = (
    ("fl_rad_s", -63.984375, 63.984375, " rad/s"),
    ("fr_rad_s", -63.984375, 63.984375, " rad/s"),
    ("rr_rad_s", -63.984375, 63.984375, " rad/s"),
    ("rl_rad_s", -63.984375, 63.984375, " rad/s"),
    ("sequence", 0, 255, ""),
    ("session", 0, 15, ""),
)


class _WheelCommandFields(NamedTuple):
    fl_rad_s: float
    fr_rad_s: float
    rr_rad_s: float
    rl_rad_s: float
    sequence: int
    session: int


class WheelCommand(_WheelCommandFields):
    """WHEEL_COMMAND: Wheel speed set points. In speed mode the only message that feeds the watchdog."""

    __slots__ = ()
    ID: ClassVar[int] = 0x040
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "WHEEL_COMMAND"

    def encode(self) -> bytes:
        fl_rad_s, fr_rad_s, rr_rad_s, rl_rad_s, sequence, session = self
        if not (
            -63.984375 <= fl_rad_s <= 63.984375
            and -63.984375 <= fr_rad_s <= 63.984375
            and -63.984375 <= rr_rad_s <= 63.984375
            and -63.984375 <= rl_rad_s <= 63.984375
            and 0 <= sequence <= 255
            and 0 <= session <= 15
        ):
            raise _out_of_range(self.NAME, self, _WHEEL_COMMAND_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        fl_rad_s_twice = int(fl_rad_s * 128.0)
        fr_rad_s_twice = int(fr_rad_s * 128.0)
        rr_rad_s_twice = int(rr_rad_s * 128.0)
        rl_rad_s_twice = int(rl_rad_s * 128.0)
        return (
            ((fl_rad_s_twice + (fl_rad_s_twice > 0) >> 1) & 0x1FFF)
            | ((fr_rad_s_twice + (fr_rad_s_twice > 0) >> 1) & 0x1FFF) << 13
            | ((rr_rad_s_twice + (rr_rad_s_twice > 0) >> 1) & 0x1FFF) << 26
            | ((rl_rad_s_twice + (rl_rad_s_twice > 0) >> 1) & 0x1FFF) << 39
            | _index(sequence) << 52
            | _index(session) << 60
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        bits = int.from_bytes(payload, "little")
        fl_rad_s = (bits & 0x1FFF ^ 0x1000) - 0x1000
        fr_rad_s = (bits >> 13 & 0x1FFF ^ 0x1000) - 0x1000
        rr_rad_s = (bits >> 26 & 0x1FFF ^ 0x1000) - 0x1000
        rl_rad_s = (bits >> 39 & 0x1FFF ^ 0x1000) - 0x1000
        sequence = bits >> 52 & 0xFF
        session = bits >> 60 & 0xF
        if not (
            -4095 <= fl_rad_s
            and -4095 <= fr_rad_s
            and -4095 <= rr_rad_s
            and -4095 <= rl_rad_s
        ):
            return None
        return _new(cls, (
            fl_rad_s * 0.015625,
            fr_rad_s * 0.015625,
            rr_rad_s * 0.015625,
            rl_rad_s * 0.015625,
            sequence,
            session,
        ))


_TORQUE_COMMAND_RANGES: tuple[_Range, ...] = (
    ("fl_n_m", -15.99609375, 15.99609375, " N.m"),
    ("fr_n_m", -15.99609375, 15.99609375, " N.m"),
    ("rr_n_m", -15.99609375, 15.99609375, " N.m"),
    ("rl_n_m", -15.99609375, 15.99609375, " N.m"),
    ("sequence", 0, 255, ""),
    ("session", 0, 15, ""),
)


class _TorqueCommandFields(NamedTuple):
    fl_n_m: float
    fr_n_m: float
    rr_n_m: float
    rl_n_m: float
    sequence: int
    session: int


class TorqueCommand(_TorqueCommandFields):
    """TORQUE_COMMAND: Wheel torque set points. In torque mode the only message that feeds the watchdog."""

    __slots__ = ()
    ID: ClassVar[int] = 0x041
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "TORQUE_COMMAND"

    def encode(self) -> bytes:
        fl_n_m, fr_n_m, rr_n_m, rl_n_m, sequence, session = self
        if not (
            -15.99609375 <= fl_n_m <= 15.99609375
            and -15.99609375 <= fr_n_m <= 15.99609375
            and -15.99609375 <= rr_n_m <= 15.99609375
            and -15.99609375 <= rl_n_m <= 15.99609375
            and 0 <= sequence <= 255
            and 0 <= session <= 15
        ):
            raise _out_of_range(self.NAME, self, _TORQUE_COMMAND_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        fl_n_m_twice = int(fl_n_m * 512.0)
        fr_n_m_twice = int(fr_n_m * 512.0)
        rr_n_m_twice = int(rr_n_m * 512.0)
        rl_n_m_twice = int(rl_n_m * 512.0)
        return (
            ((fl_n_m_twice + (fl_n_m_twice > 0) >> 1) & 0x1FFF)
            | ((fr_n_m_twice + (fr_n_m_twice > 0) >> 1) & 0x1FFF) << 13
            | ((rr_n_m_twice + (rr_n_m_twice > 0) >> 1) & 0x1FFF) << 26
            | ((rl_n_m_twice + (rl_n_m_twice > 0) >> 1) & 0x1FFF) << 39
            | _index(sequence) << 52
            | _index(session) << 60
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        bits = int.from_bytes(payload, "little")
        fl_n_m = (bits & 0x1FFF ^ 0x1000) - 0x1000
        fr_n_m = (bits >> 13 & 0x1FFF ^ 0x1000) - 0x1000
        rr_n_m = (bits >> 26 & 0x1FFF ^ 0x1000) - 0x1000
        rl_n_m = (bits >> 39 & 0x1FFF ^ 0x1000) - 0x1000
        sequence = bits >> 52 & 0xFF
        session = bits >> 60 & 0xF
        if not (
            -4095 <= fl_n_m
            and -4095 <= fr_n_m
            and -4095 <= rr_n_m
            and -4095 <= rl_n_m
        ):
            return None
        return _new(cls, (
            fl_n_m * 0.00390625,
            fr_n_m * 0.00390625,
            rr_n_m * 0.00390625,
            rl_n_m * 0.00390625,
            sequence,
            session,
        ))


_TICK_WORDS = Struct("<IBBBB")
_TICK_RANGES: tuple[_Range, ...] = (
    ("time_us", 0, 4294967295, " us"),
    ("sequence", 0, 255, ""),
    ("command_age_ms", 0, 255, " ms"),
    ("state", 0, 6, ""),
    ("parts", 0, 31, ""),
    ("snapshot", 0, 255, ""),
)


class _TickFields(NamedTuple):
    time_us: int
    sequence: int
    command_age_ms: int
    state: int
    parts: int
    snapshot: int


class Tick(_TickFields):
    """TICK: Opens a feedback snapshot at the loop rate; the parts that it announces follow it.
    time_us: Robot time of the sampling instant, wrapping.
    sequence: Sequence of the command in force.
    command_age_ms: Robot time since the newest accepted command; 255 means 255 or more, or none yet.
    parts: Parts that follow: bit 0 ENCODERS, bit 1 WHEEL_SPEEDS, bit 2 CURRENTS, bit 3 ACCELEROMETER, bit 4
        GYRO.
    snapshot: Counts snapshots, wrapping.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x080
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "TICK"

    def encode(self) -> bytes:
        time_us, sequence, command_age_ms, state, parts, snapshot = self
        if not (
            0 <= time_us <= 4294967295
            and 0 <= sequence <= 255
            and 0 <= command_age_ms <= 255
            and 0 <= state <= 6
            and 0 <= parts <= 31
            and 0 <= snapshot <= 255
        ):
            raise _out_of_range(self.NAME, self, _TICK_RANGES)
        return (
            _index(time_us)
            | _index(sequence) << 32
            | _index(command_age_ms) << 40
            | _index(state) << 48
            | _index(parts) << 51
            | _index(snapshot) << 56
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        time_us, sequence, command_age_ms, word_6, snapshot = _TICK_WORDS.unpack(payload)
        state = word_6 & 0x7
        parts = word_6 >> 3
        if not (
            state <= 6
        ):
            return None
        return _new(cls, (
            time_us,
            sequence,
            command_age_ms,
            state,
            parts,
            snapshot,
        ))


_ENCODERS = Struct("<HHHH")
_ENCODERS_RANGES: tuple[_Range, ...] = (
    ("fl_count", 0, 65535, ""),
    ("fr_count", 0, 65535, ""),
    ("rr_count", 0, 65535, ""),
    ("rl_count", 0, 65535, ""),
)


class _EncodersFields(NamedTuple):
    fl_count: int
    fr_count: int
    rr_count: int
    rl_count: int


class Encoders(_EncodersFields):
    """ENCODERS: Encoder counts, wrapping."""

    __slots__ = ()
    ID: ClassVar[int] = 0x081
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "ENCODERS"

    def encode(self) -> bytes:
        fl_count, fr_count, rr_count, rl_count = self
        if not (
            0 <= fl_count <= 65535
            and 0 <= fr_count <= 65535
            and 0 <= rr_count <= 65535
            and 0 <= rl_count <= 65535
        ):
            raise _out_of_range(self.NAME, self, _ENCODERS_RANGES)
        return _ENCODERS.pack(
            _index(fl_count),
            _index(fr_count),
            _index(rr_count),
            _index(rl_count),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _ENCODERS.unpack(payload))


_WHEEL_SPEEDS = Struct("<hhhh")
_WHEEL_SPEEDS_RANGES: tuple[_Range, ...] = (
    ("fl_rad_s", -127.99609375, 127.99609375, " rad/s"),
    ("fr_rad_s", -127.99609375, 127.99609375, " rad/s"),
    ("rr_rad_s", -127.99609375, 127.99609375, " rad/s"),
    ("rl_rad_s", -127.99609375, 127.99609375, " rad/s"),
)


class _WheelSpeedsFields(NamedTuple):
    fl_rad_s: float
    fr_rad_s: float
    rr_rad_s: float
    rl_rad_s: float


class WheelSpeeds(_WheelSpeedsFields):
    """WHEEL_SPEEDS: Wheel speeds as the tracking filter estimates them."""

    __slots__ = ()
    ID: ClassVar[int] = 0x082
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "WHEEL_SPEEDS"

    def encode(self) -> bytes:
        fl_rad_s, fr_rad_s, rr_rad_s, rl_rad_s = self
        if not (
            -127.99609375 <= fl_rad_s <= 127.99609375
            and -127.99609375 <= fr_rad_s <= 127.99609375
            and -127.99609375 <= rr_rad_s <= 127.99609375
            and -127.99609375 <= rl_rad_s <= 127.99609375
        ):
            raise _out_of_range(self.NAME, self, _WHEEL_SPEEDS_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        fl_rad_s_twice = int(fl_rad_s * 512.0)
        fr_rad_s_twice = int(fr_rad_s * 512.0)
        rr_rad_s_twice = int(rr_rad_s * 512.0)
        rl_rad_s_twice = int(rl_rad_s * 512.0)
        return _WHEEL_SPEEDS.pack(
            (fl_rad_s_twice + (fl_rad_s_twice > 0) >> 1),
            (fr_rad_s_twice + (fr_rad_s_twice > 0) >> 1),
            (rr_rad_s_twice + (rr_rad_s_twice > 0) >> 1),
            (rl_rad_s_twice + (rl_rad_s_twice > 0) >> 1),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        fl_rad_s, fr_rad_s, rr_rad_s, rl_rad_s = _WHEEL_SPEEDS.unpack(payload)
        if not (
            -32767 <= fl_rad_s
            and -32767 <= fr_rad_s
            and -32767 <= rr_rad_s
            and -32767 <= rl_rad_s
        ):
            return None
        return _new(cls, (
            fl_rad_s * 0.00390625,
            fr_rad_s * 0.00390625,
            rr_rad_s * 0.00390625,
            rl_rad_s * 0.00390625,
        ))


_CURRENTS = Struct("<hhhh")
_CURRENTS_RANGES: tuple[_Range, ...] = (
    ("fl_a", -31.9990234375, 31.9990234375, " A"),
    ("fr_a", -31.9990234375, 31.9990234375, " A"),
    ("rr_a", -31.9990234375, 31.9990234375, " A"),
    ("rl_a", -31.9990234375, 31.9990234375, " A"),
)


class _CurrentsFields(NamedTuple):
    fl_a: float
    fr_a: float
    rr_a: float
    rl_a: float


class Currents(_CurrentsFields):
    """CURRENTS: Motor currents, each the mean over the feedback period that ends at time_us."""

    __slots__ = ()
    ID: ClassVar[int] = 0x083
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "CURRENTS"

    def encode(self) -> bytes:
        fl_a, fr_a, rr_a, rl_a = self
        if not (
            -31.9990234375 <= fl_a <= 31.9990234375
            and -31.9990234375 <= fr_a <= 31.9990234375
            and -31.9990234375 <= rr_a <= 31.9990234375
            and -31.9990234375 <= rl_a <= 31.9990234375
        ):
            raise _out_of_range(self.NAME, self, _CURRENTS_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        fl_a_twice = int(fl_a * 2048.0)
        fr_a_twice = int(fr_a * 2048.0)
        rr_a_twice = int(rr_a * 2048.0)
        rl_a_twice = int(rl_a * 2048.0)
        return _CURRENTS.pack(
            (fl_a_twice + (fl_a_twice > 0) >> 1),
            (fr_a_twice + (fr_a_twice > 0) >> 1),
            (rr_a_twice + (rr_a_twice > 0) >> 1),
            (rl_a_twice + (rl_a_twice > 0) >> 1),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        fl_a, fr_a, rr_a, rl_a = _CURRENTS.unpack(payload)
        if not (
            -32767 <= fl_a
            and -32767 <= fr_a
            and -32767 <= rr_a
            and -32767 <= rl_a
        ):
            return None
        return _new(cls, (
            fl_a * 0.0009765625,
            fr_a * 0.0009765625,
            rr_a * 0.0009765625,
            rl_a * 0.0009765625,
        ))


_ACCELEROMETER = Struct("<hhhH")
_ACCELEROMETER_RANGES: tuple[_Range, ...] = (
    ("x_m_s2", -127.99609375, 127.99609375, " m/s2"),
    ("y_m_s2", -127.99609375, 127.99609375, " m/s2"),
    ("z_m_s2", -127.99609375, 127.99609375, " m/s2"),
    ("tick", 0, 65535, ""),
)


class _AccelerometerFields(NamedTuple):
    x_m_s2: float
    y_m_s2: float
    z_m_s2: float
    tick: int


class Accelerometer(_AccelerometerFields):
    """ACCELEROMETER: Acceleration of the robot's centre without gravity's, in the body frame: at rest z is
    9.81 m/s2. The mean over the feedback period that ends at time_us.
    tick: As in GYRO.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x090
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "ACCELEROMETER"

    def encode(self) -> bytes:
        x_m_s2, y_m_s2, z_m_s2, tick = self
        if not (
            -127.99609375 <= x_m_s2 <= 127.99609375
            and -127.99609375 <= y_m_s2 <= 127.99609375
            and -127.99609375 <= z_m_s2 <= 127.99609375
            and 0 <= tick <= 65535
        ):
            raise _out_of_range(self.NAME, self, _ACCELEROMETER_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        x_m_s2_twice = int(x_m_s2 * 512.0)
        y_m_s2_twice = int(y_m_s2 * 512.0)
        z_m_s2_twice = int(z_m_s2 * 512.0)
        return _ACCELEROMETER.pack(
            (x_m_s2_twice + (x_m_s2_twice > 0) >> 1),
            (y_m_s2_twice + (y_m_s2_twice > 0) >> 1),
            (z_m_s2_twice + (z_m_s2_twice > 0) >> 1),
            _index(tick),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        x_m_s2, y_m_s2, z_m_s2, tick = _ACCELEROMETER.unpack(payload)
        if not (
            -32767 <= x_m_s2
            and -32767 <= y_m_s2
            and -32767 <= z_m_s2
        ):
            return None
        return _new(cls, (
            x_m_s2 * 0.00390625,
            y_m_s2 * 0.00390625,
            z_m_s2 * 0.00390625,
            tick,
        ))


_GYRO = Struct("<hhhH")
_GYRO_RANGES: tuple[_Range, ...] = (
    ("x_rad_s", -31.9990234375, 31.9990234375, " rad/s"),
    ("y_rad_s", -31.9990234375, 31.9990234375, " rad/s"),
    ("z_rad_s", -31.9990234375, 31.9990234375, " rad/s"),
    ("tick", 0, 65535, ""),
)


class _GyroFields(NamedTuple):
    x_rad_s: float
    y_rad_s: float
    z_rad_s: float
    tick: int


class Gyro(_GyroFields):
    """GYRO: Angular rates in the body frame at time_us, x forward, y left, z up.
    tick: Low 16 bits of TICK.time_us / 1000 of the snapshot that this part belongs to.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x091
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "GYRO"

    def encode(self) -> bytes:
        x_rad_s, y_rad_s, z_rad_s, tick = self
        if not (
            -31.9990234375 <= x_rad_s <= 31.9990234375
            and -31.9990234375 <= y_rad_s <= 31.9990234375
            and -31.9990234375 <= z_rad_s <= 31.9990234375
            and 0 <= tick <= 65535
        ):
            raise _out_of_range(self.NAME, self, _GYRO_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        x_rad_s_twice = int(x_rad_s * 2048.0)
        y_rad_s_twice = int(y_rad_s * 2048.0)
        z_rad_s_twice = int(z_rad_s * 2048.0)
        return _GYRO.pack(
            (x_rad_s_twice + (x_rad_s_twice > 0) >> 1),
            (y_rad_s_twice + (y_rad_s_twice > 0) >> 1),
            (z_rad_s_twice + (z_rad_s_twice > 0) >> 1),
            _index(tick),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        x_rad_s, y_rad_s, z_rad_s, tick = _GYRO.unpack(payload)
        if not (
            -32767 <= x_rad_s
            and -32767 <= y_rad_s
            and -32767 <= z_rad_s
        ):
            return None
        return _new(cls, (
            x_rad_s * 0.0009765625,
            y_rad_s * 0.0009765625,
            z_rad_s * 0.0009765625,
            tick,
        ))


_STATUS_WORDS = Struct("<BBBHBH")
_STATUS_RANGES: tuple[_Range, ...] = (
    ("state", 0, 6, ""),
    ("mode", 0, 1, ""),
    ("fault", 0, 8, ""),
    ("fault_wheel", 0, 4, ""),
    ("stop_reason", 0, 5, ""),
    ("reset_cause", 0, 7, ""),
    ("nonce", 0, 65535, ""),
    ("arm_refusal", 0, 7, ""),
    ("limited", 0, 65535, ""),
)


class _StatusFields(NamedTuple):
    state: int
    mode: int
    fault: int
    fault_wheel: int
    stop_reason: int
    reset_cause: int
    nonce: int
    arm_refusal: int
    limited: int


class Status(_StatusFields):
    """STATUS: State, and why the robot last stopped or refused to arm; 10 Hz and on every change of state.
    fault_wheel: Wheel of the fault, 1 to 4 for FL, FR, RR, RL; 0 when it is not one wheel's.
    reset_cause: Why the robot began anew the last time.
    nonce: Nonce of the last session; 0 when there was none.
    limited: Ticks in which all four wheels were scaled at a limit of torque, current, temperature or speed,
        wrapping.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x100
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "STATUS"

    def encode(self) -> bytes:
        state, mode, fault, fault_wheel, stop_reason, reset_cause, nonce, arm_refusal, limited = self
        if not (
            0 <= state <= 6
            and 0 <= mode <= 1
            and 0 <= fault <= 8
            and 0 <= fault_wheel <= 4
            and 0 <= stop_reason <= 5
            and 0 <= reset_cause <= 7
            and 0 <= nonce <= 65535
            and 0 <= arm_refusal <= 7
            and 0 <= limited <= 65535
        ):
            raise _out_of_range(self.NAME, self, _STATUS_RANGES)
        return (
            _index(state)
            | _index(mode) << 4
            | _index(fault) << 8
            | _index(fault_wheel) << 13
            | _index(stop_reason) << 16
            | _index(reset_cause) << 20
            | _index(nonce) << 24
            | _index(arm_refusal) << 40
            | _index(limited) << 48
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        word_0, word_1, word_2, nonce, arm_refusal, limited = _STATUS_WORDS.unpack(payload)
        state = word_0 & 0xF
        mode = word_0 >> 4
        fault = word_1 & 0x1F
        fault_wheel = word_1 >> 5
        stop_reason = word_2 & 0xF
        reset_cause = word_2 >> 4
        if not (
            state <= 6
            and mode <= 1
            and fault <= 8
            and fault_wheel <= 4
            and stop_reason <= 5
            and reset_cause <= 7
            and arm_refusal <= 7
        ):
            return None
        return _new(cls, (
            state,
            mode,
            fault,
            fault_wheel,
            stop_reason,
            reset_cause,
            nonce,
            arm_refusal,
            limited,
        ))


_POWER = Struct("<hh")
_POWER_RANGES: tuple[_Range, ...] = (
    ("battery_v", -255.9921875, 255.9921875, " V"),
    ("battery_a", -255.9921875, 255.9921875, " A"),
)


class _PowerFields(NamedTuple):
    battery_v: float
    battery_a: float


class Power(_PowerFields):
    """POWER: Battery, the means over the newest feedback period; 10 Hz.
    battery_a: Out of the battery; negative while braking charges it.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x101
    LENGTH: ClassVar[int] = 4
    NAME: ClassVar[str] = "POWER"

    def encode(self) -> bytes:
        battery_v, battery_a = self
        if not (
            -255.9921875 <= battery_v <= 255.9921875
            and -255.9921875 <= battery_a <= 255.9921875
        ):
            raise _out_of_range(self.NAME, self, _POWER_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        battery_v_twice = int(battery_v * 256.0)
        battery_a_twice = int(battery_a * 256.0)
        return _POWER.pack(
            (battery_v_twice + (battery_v_twice > 0) >> 1),
            (battery_a_twice + (battery_a_twice > 0) >> 1),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 4:
            return None
        battery_v, battery_a = _POWER.unpack(payload)
        if not (
            -32767 <= battery_v
            and -32767 <= battery_a
        ):
            return None
        return _new(cls, (
            battery_v * 0.0078125,
            battery_a * 0.0078125,
        ))


_TEMPERATURES = Struct("<hhhh")
_TEMPERATURES_RANGES: tuple[_Range, ...] = (
    ("fl_degc", -255.9921875, 255.9921875, " degC"),
    ("fr_degc", -255.9921875, 255.9921875, " degC"),
    ("rr_degc", -255.9921875, 255.9921875, " degC"),
    ("rl_degc", -255.9921875, 255.9921875, " degC"),
)


class _TemperaturesFields(NamedTuple):
    fl_degc: float
    fr_degc: float
    rr_degc: float
    rl_degc: float


class Temperatures(_TemperaturesFields):
    """TEMPERATURES: Temperatures of the motors' windings; 10 Hz."""

    __slots__ = ()
    ID: ClassVar[int] = 0x102
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "TEMPERATURES"

    def encode(self) -> bytes:
        fl_degc, fr_degc, rr_degc, rl_degc = self
        if not (
            -255.9921875 <= fl_degc <= 255.9921875
            and -255.9921875 <= fr_degc <= 255.9921875
            and -255.9921875 <= rr_degc <= 255.9921875
            and -255.9921875 <= rl_degc <= 255.9921875
        ):
            raise _out_of_range(self.NAME, self, _TEMPERATURES_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        fl_degc_twice = int(fl_degc * 256.0)
        fr_degc_twice = int(fr_degc * 256.0)
        rr_degc_twice = int(rr_degc * 256.0)
        rl_degc_twice = int(rl_degc * 256.0)
        return _TEMPERATURES.pack(
            (fl_degc_twice + (fl_degc_twice > 0) >> 1),
            (fr_degc_twice + (fr_degc_twice > 0) >> 1),
            (rr_degc_twice + (rr_degc_twice > 0) >> 1),
            (rl_degc_twice + (rl_degc_twice > 0) >> 1),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        fl_degc, fr_degc, rr_degc, rl_degc = _TEMPERATURES.unpack(payload)
        if not (
            -32767 <= fl_degc
            and -32767 <= fr_degc
            and -32767 <= rr_degc
            and -32767 <= rl_degc
        ):
            return None
        return _new(cls, (
            fl_degc * 0.0078125,
            fr_degc * 0.0078125,
            rr_degc * 0.0078125,
            rl_degc * 0.0078125,
        ))


_LINK_COUNTERS = Struct("<BBBBBBBB")
_LINK_COUNTERS_RANGES: tuple[_Range, ...] = (
    ("cobs", 0, 255, ""),
    ("crc", 0, 255, ""),
    ("length", 0, 255, ""),
    ("unknown_id", 0, 255, ""),
    ("range", 0, 255, ""),
    ("session", 0, 255, ""),
    ("stale", 0, 255, ""),
    ("state", 0, 255, ""),
)


class _LinkCountersFields(NamedTuple):
    cobs: int
    crc: int
    length: int
    unknown_id: int
    range: int
    session: int
    stale: int
    state: int


class LinkCounters(_LinkCountersFields):
    """LINK_COUNTERS: Frames rejected, by cause, each wrapping; 10 Hz.
    length: Frames of a wrong length.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x103
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "LINK_COUNTERS"

    def encode(self) -> bytes:
        cobs, crc, length, unknown_id, range, session, stale, state = self
        if not (
            0 <= cobs <= 255
            and 0 <= crc <= 255
            and 0 <= length <= 255
            and 0 <= unknown_id <= 255
            and 0 <= range <= 255
            and 0 <= session <= 255
            and 0 <= stale <= 255
            and 0 <= state <= 255
        ):
            raise _out_of_range(self.NAME, self, _LINK_COUNTERS_RANGES)
        return _LINK_COUNTERS.pack(
            _index(cobs),
            _index(crc),
            _index(length),
            _index(unknown_id),
            _index(range),
            _index(session),
            _index(stale),
            _index(state),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _LINK_COUNTERS.unpack(payload))


_ABSOLUTE_FRONT = Struct("<II")
_ABSOLUTE_FRONT_RANGES: tuple[_Range, ...] = (
    ("fl_count", 0, 4294967295, ""),
    ("fr_count", 0, 4294967295, ""),
)


class _AbsoluteFrontFields(NamedTuple):
    fl_count: int
    fr_count: int


class AbsoluteFront(_AbsoluteFrontFields):
    """ABSOLUTE_FRONT: Encoder counts since power-on in two's complement: whole turns that ENCODERS no longer
    tells; 1 Hz.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x104
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "ABSOLUTE_FRONT"

    def encode(self) -> bytes:
        fl_count, fr_count = self
        if not (
            0 <= fl_count <= 4294967295
            and 0 <= fr_count <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _ABSOLUTE_FRONT_RANGES)
        return _ABSOLUTE_FRONT.pack(
            _index(fl_count),
            _index(fr_count),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _ABSOLUTE_FRONT.unpack(payload))


_ABSOLUTE_REAR = Struct("<II")
_ABSOLUTE_REAR_RANGES: tuple[_Range, ...] = (
    ("rr_count", 0, 4294967295, ""),
    ("rl_count", 0, 4294967295, ""),
)


class _AbsoluteRearFields(NamedTuple):
    rr_count: int
    rl_count: int


class AbsoluteRear(_AbsoluteRearFields):
    """ABSOLUTE_REAR: As ABSOLUTE_FRONT."""

    __slots__ = ()
    ID: ClassVar[int] = 0x105
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "ABSOLUTE_REAR"

    def encode(self) -> bytes:
        rr_count, rl_count = self
        if not (
            0 <= rr_count <= 4294967295
            and 0 <= rl_count <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _ABSOLUTE_REAR_RANGES)
        return _ABSOLUTE_REAR.pack(
            _index(rr_count),
            _index(rl_count),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _ABSOLUTE_REAR.unpack(payload))


_PORT_COUNTERS = Struct("<BBBBBB")
_PORT_COUNTERS_RANGES: tuple[_Range, ...] = (
    ("overrun", 0, 255, ""),
    ("feedforward_unmatched", 0, 255, ""),
    ("transmit_overrun", 0, 255, ""),
    ("serial_lost", 0, 255, ""),
    ("can_errors", 0, 255, ""),
    ("bus_off", 0, 255, ""),
)


class _PortCountersFields(NamedTuple):
    overrun: int
    feedforward_unmatched: int
    transmit_overrun: int
    serial_lost: int
    can_errors: int
    bus_off: int


class PortCounters(_PortCountersFields):
    """PORT_COUNTERS: What the robot's ports lost, each wrapping; 10 Hz.
    overrun: Serial frames too long, and bytes that the port could not take in time.
    feedforward_unmatched: Torque feedforwards without their command.
    transmit_overrun: Frames that the robot could not send in time.
    serial_lost: Frames of the host that are missing in its line count.
    can_errors: CAN error frames seen by the robot's controller.
    bus_off: Times that the robot's controller went off the bus and came back.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x106
    LENGTH: ClassVar[int] = 6
    NAME: ClassVar[str] = "PORT_COUNTERS"

    def encode(self) -> bytes:
        overrun, feedforward_unmatched, transmit_overrun, serial_lost, can_errors, bus_off = self
        if not (
            0 <= overrun <= 255
            and 0 <= feedforward_unmatched <= 255
            and 0 <= transmit_overrun <= 255
            and 0 <= serial_lost <= 255
            and 0 <= can_errors <= 255
            and 0 <= bus_off <= 255
        ):
            raise _out_of_range(self.NAME, self, _PORT_COUNTERS_RANGES)
        return _PORT_COUNTERS.pack(
            _index(overrun),
            _index(feedforward_unmatched),
            _index(transmit_overrun),
            _index(serial_lost),
            _index(can_errors),
            _index(bus_off),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 6:
            return None
        return _new(cls, _PORT_COUNTERS.unpack(payload))


_TIME_SYNC_REQUEST = Struct("<B")
_TIME_SYNC_REQUEST_RANGES: tuple[_Range, ...] = (
    ("sequence", 0, 255, ""),
)


class _TimeSyncRequestFields(NamedTuple):
    sequence: int


class TimeSyncRequest(_TimeSyncRequestFields):
    """TIME_SYNC_REQUEST: Asks for the robot's clock; 4 Hz."""

    __slots__ = ()
    ID: ClassVar[int] = 0x180
    LENGTH: ClassVar[int] = 1
    NAME: ClassVar[str] = "TIME_SYNC_REQUEST"

    def encode(self) -> bytes:
        sequence, = self
        if not (
            0 <= sequence <= 255
        ):
            raise _out_of_range(self.NAME, self, _TIME_SYNC_REQUEST_RANGES)
        return _TIME_SYNC_REQUEST.pack(
            _index(sequence),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 1:
            return None
        return _new(cls, _TIME_SYNC_REQUEST.unpack(payload))


_TIME_SYNC_RESPONSE = Struct("<IHB")
_TIME_SYNC_RESPONSE_RANGES: tuple[_Range, ...] = (
    ("received_us", 0, 4294967295, " us"),
    ("held_us", 0, 65535, " us"),
    ("sequence", 0, 255, ""),
)


class _TimeSyncResponseFields(NamedTuple):
    received_us: int
    held_us: int
    sequence: int


class TimeSyncResponse(_TimeSyncResponseFields):
    """TIME_SYNC_RESPONSE: Answers TIME_SYNC_REQUEST.
    received_us: The robot's clock, that of TICK.time_us, when the request arrived.
    held_us: Time from then until this answer was handed to the port; 65535 or more is 65535.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x181
    LENGTH: ClassVar[int] = 7
    NAME: ClassVar[str] = "TIME_SYNC_RESPONSE"

    def encode(self) -> bytes:
        received_us, held_us, sequence = self
        if not (
            0 <= received_us <= 4294967295
            and 0 <= held_us <= 65535
            and 0 <= sequence <= 255
        ):
            raise _out_of_range(self.NAME, self, _TIME_SYNC_RESPONSE_RANGES)
        return _TIME_SYNC_RESPONSE.pack(
            _index(received_us),
            _index(held_us),
            _index(sequence),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 7:
            return None
        return _new(cls, _TIME_SYNC_RESPONSE.unpack(payload))


_PARAMETER_REQUEST = Struct("<BBBI")
_PARAMETER_REQUEST_RANGES: tuple[_Range, ...] = (
    ("parameter", 0, 255, ""),
    ("operation", 0, 5, ""),
    ("transaction", 0, 255, ""),
    ("value", 0, 4294967295, ""),
)


class _ParameterRequestFields(NamedTuple):
    parameter: int
    operation: int
    transaction: int
    value: int


class ParameterRequest(_ParameterRequestFields):
    """PARAMETER_REQUEST: Reads or changes one of the firmware's parameters; STORE and RESTORE concern all.
    operation: WRITE, STORE and RESTORE are done in IDLE only. RESTORE takes the values that the firmware was
        built with.
    transaction: Comes back in the answer.
    value: WRITE: the bits of the value, by its type. Otherwise 0.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x200
    LENGTH: ClassVar[int] = 7
    NAME: ClassVar[str] = "PARAMETER_REQUEST"

    def encode(self) -> bytes:
        parameter, operation, transaction, value = self
        if not (
            0 <= parameter <= 255
            and 0 <= operation <= 5
            and 0 <= transaction <= 255
            and 0 <= value <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _PARAMETER_REQUEST_RANGES)
        return _PARAMETER_REQUEST.pack(
            _index(parameter),
            _index(operation),
            _index(transaction),
            _index(value),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 7:
            return None
        parameter, operation, transaction, value = _PARAMETER_REQUEST.unpack(payload)
        if not (
            operation <= 5
        ):
            return None
        return _new(cls, (
            parameter,
            operation,
            transaction,
            value,
        ))


_PARAMETER_RESPONSE_WORDS = Struct("<BBBBI")
_PARAMETER_RESPONSE_RANGES: tuple[_Range, ...] = (
    ("parameter", 0, 255, ""),
    ("operation", 0, 5, ""),
    ("transaction", 0, 255, ""),
    ("result", 0, 4, ""),
    ("type", 0, 1, ""),
    ("value", 0, 4294967295, ""),
)


class _ParameterResponseFields(NamedTuple):
    parameter: int
    operation: int
    transaction: int
    result: int
    type: int
    value: int


class ParameterResponse(_ParameterResponseFields):
    """PARAMETER_RESPONSE: Answers PARAMETER_REQUEST.
    result: PARAMETER: no such one. RANGE: not from its minimum to its maximum. STATE: not in IDLE. STORAGE:
        could not be kept.
    value: The bits of the value, or of a limit, as it is now; for STORE and RESTORE, done or refused, the
        parameter hash.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x280
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "PARAMETER_RESPONSE"

    def encode(self) -> bytes:
        parameter, operation, transaction, result, type, value = self
        if not (
            0 <= parameter <= 255
            and 0 <= operation <= 5
            and 0 <= transaction <= 255
            and 0 <= result <= 4
            and 0 <= type <= 1
            and 0 <= value <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _PARAMETER_RESPONSE_RANGES)
        return (
            _index(parameter)
            | _index(operation) << 8
            | _index(transaction) << 16
            | _index(result) << 24
            | _index(type) << 28
            | _index(value) << 32
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        parameter, operation, transaction, word_3, value = _PARAMETER_RESPONSE_WORDS.unpack(payload)
        result = word_3 & 0xF
        type = word_3 >> 4
        if not (
            operation <= 5
            and result <= 4
            and type <= 1
        ):
            return None
        return _new(cls, (
            parameter,
            operation,
            transaction,
            result,
            type,
            value,
        ))


_STEP = Struct("<IH")
_STEP_RANGES: tuple[_Range, ...] = (
    ("tick", 0, 4294967295, ""),
    ("substeps", 0, 1000, ""),
)


class _StepFields(NamedTuple):
    tick: int
    substeps: int


class Step(_StepFields):
    """STEP: Lockstep only. At this tick, run so many 1 ms ticks. Repeating it runs nothing twice; 0 substeps
    asks for the tick.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x300
    LENGTH: ClassVar[int] = 6
    NAME: ClassVar[str] = "STEP"

    def encode(self) -> bytes:
        tick, substeps = self
        if not (
            0 <= tick <= 4294967295
            and 0 <= substeps <= 1000
        ):
            raise _out_of_range(self.NAME, self, _STEP_RANGES)
        return _STEP.pack(
            _index(tick),
            _index(substeps),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 6:
            return None
        tick, substeps = _STEP.unpack(payload)
        if not (
            substeps <= 1000
        ):
            return None
        return _new(cls, (
            tick,
            substeps,
        ))


_STEP_DONE = Struct("<I")
_STEP_DONE_RANGES: tuple[_Range, ...] = (
    ("tick", 0, 4294967295, ""),
)


class _StepDoneFields(NamedTuple):
    tick: int


class StepDone(_StepDoneFields):
    """STEP_DONE: Lockstep only. The tick reached; sent after the feedback of the step."""

    __slots__ = ()
    ID: ClassVar[int] = 0x301
    LENGTH: ClassVar[int] = 4
    NAME: ClassVar[str] = "STEP_DONE"

    def encode(self) -> bytes:
        tick, = self
        if not (
            0 <= tick <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _STEP_DONE_RANGES)
        return _STEP_DONE.pack(
            _index(tick),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 4:
            return None
        return _new(cls, _STEP_DONE.unpack(payload))


_HELLO_REQUEST = Struct("<B")
_HELLO_REQUEST_RANGES: tuple[_Range, ...] = (
    ("protocol_version", 0, 255, ""),
)


class _HelloRequestFields(NamedTuple):
    protocol_version: int


class HelloRequest(_HelloRequestFields):
    """HELLO_REQUEST: Asks for the HELLO pages. Ids 1792-1807 and the layout of page 0 are frozen for ever.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x700
    LENGTH: ClassVar[int] = 1
    NAME: ClassVar[str] = "HELLO_REQUEST"

    def encode(self) -> bytes:
        protocol_version, = self
        if not (
            0 <= protocol_version <= 255
        ):
            raise _out_of_range(self.NAME, self, _HELLO_REQUEST_RANGES)
        return _HELLO_REQUEST.pack(
            _index(protocol_version),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 1:
            return None
        return _new(cls, _HELLO_REQUEST.unpack(payload))


_HELLO_IDENTITY = Struct("<BBHI")
_HELLO_IDENTITY_RANGES: tuple[_Range, ...] = (
    ("protocol_version", 0, 255, ""),
    ("pages", 0, 255, ""),
    ("capabilities", 0, 65535, ""),
    ("schema_hash", 0, 4294967295, ""),
)


class _HelloIdentityFields(NamedTuple):
    protocol_version: int
    pages: int
    capabilities: int
    schema_hash: int


class HelloIdentity(_HelloIdentityFields):
    """HELLO_IDENTITY: HELLO page 0.
    pages: How many pages follow each other from this id on.
    capabilities: Bit 0 POWER_STAGE, 1 LOCKSTEP, 2 SPEED, 3 TORQUE, 4 FEEDFORWARD, 5 CURRENTS, 6 GYRO, 7
        ACCELEROMETER, 8 POWER, 9 TEMPERATURES, 10 STORAGE.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x701
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "HELLO_IDENTITY"

    def encode(self) -> bytes:
        protocol_version, pages, capabilities, schema_hash = self
        if not (
            0 <= protocol_version <= 255
            and 0 <= pages <= 255
            and 0 <= capabilities <= 65535
            and 0 <= schema_hash <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _HELLO_IDENTITY_RANGES)
        return _HELLO_IDENTITY.pack(
            _index(protocol_version),
            _index(pages),
            _index(capabilities),
            _index(schema_hash),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _HELLO_IDENTITY.unpack(payload))


_HELLO_FIRMWARE = Struct("<BBBBI")
_HELLO_FIRMWARE_RANGES: tuple[_Range, ...] = (
    ("major", 0, 255, ""),
    ("minor", 0, 255, ""),
    ("patch", 0, 255, ""),
    ("board", 0, 255, ""),
    ("build", 0, 4294967295, ""),
)


class _HelloFirmwareFields(NamedTuple):
    major: int
    minor: int
    patch: int
    board: int
    build: int


class HelloFirmware(_HelloFirmwareFields):
    """HELLO_FIRMWARE: HELLO page 1.
    board: 0 is the host library.
    build: First 32 bits of the build's source hash; 0 when unknown.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x702
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "HELLO_FIRMWARE"

    def encode(self) -> bytes:
        major, minor, patch, board, build = self
        if not (
            0 <= major <= 255
            and 0 <= minor <= 255
            and 0 <= patch <= 255
            and 0 <= board <= 255
            and 0 <= build <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _HELLO_FIRMWARE_RANGES)
        return _HELLO_FIRMWARE.pack(
            _index(major),
            _index(minor),
            _index(patch),
            _index(board),
            _index(build),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _HELLO_FIRMWARE.unpack(payload))


_HELLO_PARAMETERS = Struct("<IHH")
_HELLO_PARAMETERS_RANGES: tuple[_Range, ...] = (
    ("parameter_hash", 0, 4294967295, ""),
    ("watchdog_ms", 0, 65535, " ms"),
    ("feedback_period_ms", 0, 65535, " ms"),
)


class _HelloParametersFields(NamedTuple):
    parameter_hash: int
    watchdog_ms: int
    feedback_period_ms: int


class HelloParameters(_HelloParametersFields):
    """HELLO_PARAMETERS: HELLO page 2."""

    __slots__ = ()
    ID: ClassVar[int] = 0x703
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "HELLO_PARAMETERS"

    def encode(self) -> bytes:
        parameter_hash, watchdog_ms, feedback_period_ms = self
        if not (
            0 <= parameter_hash <= 4294967295
            and 0 <= watchdog_ms <= 65535
            and 0 <= feedback_period_ms <= 65535
        ):
            raise _out_of_range(self.NAME, self, _HELLO_PARAMETERS_RANGES)
        return _HELLO_PARAMETERS.pack(
            _index(parameter_hash),
            _index(watchdog_ms),
            _index(feedback_period_ms),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _HELLO_PARAMETERS.unpack(payload))


_HELLO_GEOMETRY = Struct("<hhhH")
_HELLO_GEOMETRY_RANGES: tuple[_Range, ...] = (
    ("wheel_radius_m", -3.9998779296875, 3.9998779296875, " m"),
    ("half_length_m", -3.9998779296875, 3.9998779296875, " m"),
    ("half_width_m", -3.9998779296875, 3.9998779296875, " m"),
    ("counts_per_revolution", 0, 65535, ""),
)


class _HelloGeometryFields(NamedTuple):
    wheel_radius_m: float
    half_length_m: float
    half_width_m: float
    counts_per_revolution: int


class HelloGeometry(_HelloGeometryFields):
    """HELLO_GEOMETRY: HELLO page 3: the robot's size, as its firmware knows it.
    half_length_m: From the centre to an axle.
    half_width_m: From the centre to a wheel.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x704
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "HELLO_GEOMETRY"

    def encode(self) -> bytes:
        wheel_radius_m, half_length_m, half_width_m, counts_per_revolution = self
        if not (
            -3.9998779296875 <= wheel_radius_m <= 3.9998779296875
            and -3.9998779296875 <= half_length_m <= 3.9998779296875
            and -3.9998779296875 <= half_width_m <= 3.9998779296875
            and 0 <= counts_per_revolution <= 65535
        ):
            raise _out_of_range(self.NAME, self, _HELLO_GEOMETRY_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        wheel_radius_m_twice = int(wheel_radius_m * 16384.0)
        half_length_m_twice = int(half_length_m * 16384.0)
        half_width_m_twice = int(half_width_m * 16384.0)
        return _HELLO_GEOMETRY.pack(
            (wheel_radius_m_twice + (wheel_radius_m_twice > 0) >> 1),
            (half_length_m_twice + (half_length_m_twice > 0) >> 1),
            (half_width_m_twice + (half_width_m_twice > 0) >> 1),
            _index(counts_per_revolution),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        wheel_radius_m, half_length_m, half_width_m, counts_per_revolution = _HELLO_GEOMETRY.unpack(payload)
        if not (
            -32767 <= wheel_radius_m
            and -32767 <= half_length_m
            and -32767 <= half_width_m
        ):
            return None
        return _new(cls, (
            wheel_radius_m * 0.0001220703125,
            half_length_m * 0.0001220703125,
            half_width_m * 0.0001220703125,
            counts_per_revolution,
        ))


_HELLO_LIMITS = Struct("<hhh")
_HELLO_LIMITS_RANGES: tuple[_Range, ...] = (
    ("speed_limit_rad_s", -127.99609375, 127.99609375, " rad/s"),
    ("overspeed_rad_s", -127.99609375, 127.99609375, " rad/s"),
    ("torque_limit_n_m", -127.99609375, 127.99609375, " N.m"),
)


class _HelloLimitsFields(NamedTuple):
    speed_limit_rad_s: float
    overspeed_rad_s: float
    torque_limit_n_m: float


class HelloLimits(_HelloLimitsFields):
    """HELLO_LIMITS: HELLO page 4: what the robot keeps its wheels to.
    speed_limit_rad_s: WHEEL_COMMANDs beyond it are scaled to it, all four wheels by one factor.
    overspeed_rad_s: A wheel faster than this is a fault.
    torque_limit_n_m: Of one wheel; beyond it all four are scaled.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x705
    LENGTH: ClassVar[int] = 6
    NAME: ClassVar[str] = "HELLO_LIMITS"

    def encode(self) -> bytes:
        speed_limit_rad_s, overspeed_rad_s, torque_limit_n_m = self
        if not (
            -127.99609375 <= speed_limit_rad_s <= 127.99609375
            and -127.99609375 <= overspeed_rad_s <= 127.99609375
            and -127.99609375 <= torque_limit_n_m <= 127.99609375
        ):
            raise _out_of_range(self.NAME, self, _HELLO_LIMITS_RANGES)
        # Half of a truncated double: the nearest step, halves away from zero.
        speed_limit_rad_s_twice = int(speed_limit_rad_s * 512.0)
        overspeed_rad_s_twice = int(overspeed_rad_s * 512.0)
        torque_limit_n_m_twice = int(torque_limit_n_m * 512.0)
        return _HELLO_LIMITS.pack(
            (speed_limit_rad_s_twice + (speed_limit_rad_s_twice > 0) >> 1),
            (overspeed_rad_s_twice + (overspeed_rad_s_twice > 0) >> 1),
            (torque_limit_n_m_twice + (torque_limit_n_m_twice > 0) >> 1),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 6:
            return None
        speed_limit_rad_s, overspeed_rad_s, torque_limit_n_m = _HELLO_LIMITS.unpack(payload)
        if not (
            -32767 <= speed_limit_rad_s
            and -32767 <= overspeed_rad_s
            and -32767 <= torque_limit_n_m
        ):
            return None
        return _new(cls, (
            speed_limit_rad_s * 0.00390625,
            overspeed_rad_s * 0.00390625,
            torque_limit_n_m * 0.00390625,
        ))


_HELLO_FAULT_STATUS = Struct("<II")
_HELLO_FAULT_STATUS_RANGES: tuple[_Range, ...] = (
    ("cfsr", 0, 4294967295, ""),
    ("hfsr", 0, 4294967295, ""),
)


class _HelloFaultStatusFields(NamedTuple):
    cfsr: int
    hfsr: int


class HelloFaultStatus(_HelloFaultStatusFields):
    """HELLO_FAULT_STATUS: HELLO page 5: fault status registers of the processor fault that reset the robot;
    0 when none did.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x706
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "HELLO_FAULT_STATUS"

    def encode(self) -> bytes:
        cfsr, hfsr = self
        if not (
            0 <= cfsr <= 4294967295
            and 0 <= hfsr <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _HELLO_FAULT_STATUS_RANGES)
        return _HELLO_FAULT_STATUS.pack(
            _index(cfsr),
            _index(hfsr),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _HELLO_FAULT_STATUS.unpack(payload))


_HELLO_FAULT_PLACE = Struct("<II")
_HELLO_FAULT_PLACE_RANGES: tuple[_Range, ...] = (
    ("pc", 0, 4294967295, ""),
    ("lr", 0, 4294967295, ""),
)


class _HelloFaultPlaceFields(NamedTuple):
    pc: int
    lr: int


class HelloFaultPlace(_HelloFaultPlaceFields):
    """HELLO_FAULT_PLACE: HELLO page 6: where the processor was at that fault; 0 when it is not known.
    pc: Address of the instruction.
    lr: Where its function would have returned to.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x707
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "HELLO_FAULT_PLACE"

    def encode(self) -> bytes:
        pc, lr = self
        if not (
            0 <= pc <= 4294967295
            and 0 <= lr <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _HELLO_FAULT_PLACE_RANGES)
        return _HELLO_FAULT_PLACE.pack(
            _index(pc),
            _index(lr),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _HELLO_FAULT_PLACE.unpack(payload))


_HELLO_FAULT_ADDRESS = Struct("<II")
_HELLO_FAULT_ADDRESS_RANGES: tuple[_Range, ...] = (
    ("mmfar", 0, 4294967295, ""),
    ("bfar", 0, 4294967295, ""),
)


class _HelloFaultAddressFields(NamedTuple):
    mmfar: int
    bfar: int


class HelloFaultAddress(_HelloFaultAddressFields):
    """HELLO_FAULT_ADDRESS: HELLO page 7: which address that fault was about, where cfsr says that it holds
    one.
    mmfar: Of a memory management fault.
    bfar: Of a bus fault.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x708
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "HELLO_FAULT_ADDRESS"

    def encode(self) -> bytes:
        mmfar, bfar = self
        if not (
            0 <= mmfar <= 4294967295
            and 0 <= bfar <= 4294967295
        ):
            raise _out_of_range(self.NAME, self, _HELLO_FAULT_ADDRESS_RANGES)
        return _HELLO_FAULT_ADDRESS.pack(
            _index(mmfar),
            _index(bfar),
        )

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        return _new(cls, _HELLO_FAULT_ADDRESS.unpack(payload))


Message: TypeAlias = (
    Estop
    | HostHeartbeat
    | TorqueFeedforward
    | WheelCommand
    | TorqueCommand
    | Tick
    | Encoders
    | WheelSpeeds
    | Currents
    | Accelerometer
    | Gyro
    | Status
    | Power
    | Temperatures
    | LinkCounters
    | AbsoluteFront
    | AbsoluteRear
    | PortCounters
    | TimeSyncRequest
    | TimeSyncResponse
    | ParameterRequest
    | ParameterResponse
    | Step
    | StepDone
    | HelloRequest
    | HelloIdentity
    | HelloFirmware
    | HelloParameters
    | HelloGeometry
    | HelloLimits
    | HelloFaultStatus
    | HelloFaultPlace
    | HelloFaultAddress
)

MESSAGES: dict[int, type[Message]] = {
    0x010: Estop,
    0x020: HostHeartbeat,
    0x030: TorqueFeedforward,
    0x040: WheelCommand,
    0x041: TorqueCommand,
    0x080: Tick,
    0x081: Encoders,
    0x082: WheelSpeeds,
    0x083: Currents,
    0x090: Accelerometer,
    0x091: Gyro,
    0x100: Status,
    0x101: Power,
    0x102: Temperatures,
    0x103: LinkCounters,
    0x104: AbsoluteFront,
    0x105: AbsoluteRear,
    0x106: PortCounters,
    0x180: TimeSyncRequest,
    0x181: TimeSyncResponse,
    0x200: ParameterRequest,
    0x280: ParameterResponse,
    0x300: Step,
    0x301: StepDone,
    0x700: HelloRequest,
    0x701: HelloIdentity,
    0x702: HelloFirmware,
    0x703: HelloParameters,
    0x704: HelloGeometry,
    0x705: HelloLimits,
    0x706: HelloFaultStatus,
    0x707: HelloFaultPlace,
    0x708: HelloFaultAddress,
}
DECODERS: dict[int, Callable[[bytes], Message | None]] = {
    0x010: Estop.decode,
    0x020: HostHeartbeat.decode,
    0x030: TorqueFeedforward.decode,
    0x040: WheelCommand.decode,
    0x041: TorqueCommand.decode,
    0x080: Tick.decode,
    0x081: Encoders.decode,
    0x082: WheelSpeeds.decode,
    0x083: Currents.decode,
    0x090: Accelerometer.decode,
    0x091: Gyro.decode,
    0x100: Status.decode,
    0x101: Power.decode,
    0x102: Temperatures.decode,
    0x103: LinkCounters.decode,
    0x104: AbsoluteFront.decode,
    0x105: AbsoluteRear.decode,
    0x106: PortCounters.decode,
    0x180: TimeSyncRequest.decode,
    0x181: TimeSyncResponse.decode,
    0x200: ParameterRequest.decode,
    0x280: ParameterResponse.decode,
    0x300: Step.decode,
    0x301: StepDone.decode,
    0x700: HelloRequest.decode,
    0x701: HelloIdentity.decode,
    0x702: HelloFirmware.decode,
    0x703: HelloParameters.decode,
    0x704: HelloGeometry.decode,
    0x705: HelloLimits.decode,
    0x706: HelloFaultStatus.decode,
    0x707: HelloFaultPlace.decode,
    0x708: HelloFaultAddress.decode,
}
LENGTHS: dict[int, int] = {number: message.LENGTH for number, message in MESSAGES.items()}
NAMES: dict[int, str] = {number: message.NAME for number, message in MESSAGES.items()}
SENDERS: dict[int, str] = {
    0x010: "HOST",
    0x020: "HOST",
    0x030: "HOST",
    0x040: "HOST",
    0x041: "HOST",
    0x080: "ROBOT",
    0x081: "ROBOT",
    0x082: "ROBOT",
    0x083: "ROBOT",
    0x090: "ROBOT",
    0x091: "ROBOT",
    0x100: "ROBOT",
    0x101: "ROBOT",
    0x102: "ROBOT",
    0x103: "ROBOT",
    0x104: "ROBOT",
    0x105: "ROBOT",
    0x106: "ROBOT",
    0x180: "HOST",
    0x181: "ROBOT",
    0x200: "HOST",
    0x280: "ROBOT",
    0x300: "HOST",
    0x301: "ROBOT",
    0x700: "HOST",
    0x701: "ROBOT",
    0x702: "ROBOT",
    0x703: "ROBOT",
    0x704: "ROBOT",
    0x705: "ROBOT",
    0x706: "ROBOT",
    0x707: "ROBOT",
    0x708: "ROBOT",
}
UNITS: dict[int, dict[str, str]] = {
    0x030: {"fl_n_m": "N.m", "fr_n_m": "N.m", "rr_n_m": "N.m", "rl_n_m": "N.m"},
    0x040: {"fl_rad_s": "rad/s", "fr_rad_s": "rad/s", "rr_rad_s": "rad/s", "rl_rad_s": "rad/s"},
    0x041: {"fl_n_m": "N.m", "fr_n_m": "N.m", "rr_n_m": "N.m", "rl_n_m": "N.m"},
    0x080: {"time_us": "us", "command_age_ms": "ms"},
    0x082: {"fl_rad_s": "rad/s", "fr_rad_s": "rad/s", "rr_rad_s": "rad/s", "rl_rad_s": "rad/s"},
    0x083: {"fl_a": "A", "fr_a": "A", "rr_a": "A", "rl_a": "A"},
    0x090: {"x_m_s2": "m/s2", "y_m_s2": "m/s2", "z_m_s2": "m/s2"},
    0x091: {"x_rad_s": "rad/s", "y_rad_s": "rad/s", "z_rad_s": "rad/s"},
    0x101: {"battery_v": "V", "battery_a": "A"},
    0x102: {"fl_degc": "degC", "fr_degc": "degC", "rr_degc": "degC", "rl_degc": "degC"},
    0x181: {"received_us": "us", "held_us": "us"},
    0x703: {"watchdog_ms": "ms", "feedback_period_ms": "ms"},
    0x704: {"wheel_radius_m": "m", "half_length_m": "m", "half_width_m": "m"},
    0x705: {"speed_limit_rad_s": "rad/s", "overspeed_rad_s": "rad/s", "torque_limit_n_m": "N.m"},
}
NAMED_VALUES: dict[int, dict[str, type[IntEnum]]] = {
    0x020: {"request": Request, "mode": Mode},
    0x080: {"state": State},
    0x100: {"state": State, "mode": Mode, "fault": Fault, "fault_wheel": FaultWheel, "stop_reason": StopReason, "reset_cause": ResetCause, "arm_refusal": ArmRefusal},
    0x200: {"operation": Operation},
    0x280: {"operation": Operation, "result": Result, "type": Type},
}
