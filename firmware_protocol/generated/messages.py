"""The messages of the wheel-command protocol: generated from wheel.dbc; do not edit.

Made by `python -m firmware_protocol.generate`. One class a message, with the fields of the DBC, units in
their names. ``encode`` returns the payload and raises ValueError when a value is out of its range or not a
number, TypeError when an integer field is not an integer. ``decode`` returns None when the payload has the
wrong length or holds a value out of its range. Scaled values are rounded to the nearest step, halves away
from zero, exactly as in the generated C.
"""

from collections.abc import Sequence
from enum import IntEnum
from operator import index as _index
from struct import Struct
from typing import ClassVar, NamedTuple, Self, TypeAlias

_Range: TypeAlias = tuple[str, float, float, str]


def _out_of_range(message: str, values: Sequence[float], ranges: Sequence[_Range]) -> ValueError:
    for value, (field, minimum, maximum, unit) in zip(values, ranges, strict=True):
        if not minimum <= value <= maximum:
            return ValueError(f"{message}.{field} = {value}{unit}: expected {minimum} to {maximum}{unit}")
    raise AssertionError(f"{message}: all values are in range")


PROTOCOL_VERSION = 1
SCHEMA_HASH = 0x169BB7E5


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


class StopReason(IntEnum):
    """Values of STATUS.stop_reason."""

    NONE = 0
    HOST_REQUEST = 1
    COMMAND_TIMEOUT = 2
    ARM_TIMEOUT = 3
    ESTOP = 4
    FAULT = 5


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
        source, reason = _ESTOP.unpack(payload)
        return cls(
            source,
            reason,
        )


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
        bits = int.from_bytes(payload, "little")
        nonce = bits & 0xFFFF
        schema_hash = bits >> 16 & 0xFFFFFFFF
        request = bits >> 48 & 0xF
        mode = bits >> 52 & 0xF
        parameter_check = bits >> 56 & 0xFF
        if not (
            1 <= nonce
            and request <= 2
            and mode <= 1
        ):
            return None
        return cls(
            nonce,
            schema_hash,
            request,
            mode,
            parameter_check,
        )


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
        return cls(
            fl_n_m * 0.00390625,
            fr_n_m * 0.00390625,
            rr_n_m * 0.00390625,
            rl_n_m * 0.00390625,
            sequence,
            session,
        )


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
        return cls(
            fl_rad_s * 0.015625,
            fr_rad_s * 0.015625,
            rr_rad_s * 0.015625,
            rl_rad_s * 0.015625,
            sequence,
            session,
        )


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
        return cls(
            fl_n_m * 0.00390625,
            fr_n_m * 0.00390625,
            rr_n_m * 0.00390625,
            rl_n_m * 0.00390625,
            sequence,
            session,
        )


_TICK_RANGES: tuple[_Range, ...] = (
    ("time_us", 0, 4294967295, " us"),
    ("sequence", 0, 255, ""),
    ("command_age_ms", 0, 255, " ms"),
    ("state", 0, 6, ""),
    ("parts", 0, 15, ""),
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
    parts: Parts that follow: bit 0 ENCODERS, bit 1 WHEEL_SPEEDS, bit 2 CURRENTS, bit 3 GYRO.
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
            and 0 <= parts <= 15
            and 0 <= snapshot <= 255
        ):
            raise _out_of_range(self.NAME, self, _TICK_RANGES)
        return (
            _index(time_us)
            | _index(sequence) << 32
            | _index(command_age_ms) << 40
            | _index(state) << 48
            | _index(parts) << 52
            | _index(snapshot) << 56
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        bits = int.from_bytes(payload, "little")
        time_us = bits & 0xFFFFFFFF
        sequence = bits >> 32 & 0xFF
        command_age_ms = bits >> 40 & 0xFF
        state = bits >> 48 & 0xF
        parts = bits >> 52 & 0xF
        snapshot = bits >> 56 & 0xFF
        if not (
            state <= 6
        ):
            return None
        return cls(
            time_us,
            sequence,
            command_age_ms,
            state,
            parts,
            snapshot,
        )


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
        fl_count, fr_count, rr_count, rl_count = _ENCODERS.unpack(payload)
        return cls(
            fl_count,
            fr_count,
            rr_count,
            rl_count,
        )


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
        return cls(
            fl_rad_s * 0.00390625,
            fr_rad_s * 0.00390625,
            rr_rad_s * 0.00390625,
            rl_rad_s * 0.00390625,
        )


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
    """CURRENTS: Motor currents."""

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
        return cls(
            fl_a * 0.0009765625,
            fr_a * 0.0009765625,
            rr_a * 0.0009765625,
            rl_a * 0.0009765625,
        )


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
    """GYRO: Angular rates in the body frame, x forward, y left, z up.
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
        return cls(
            x_rad_s * 0.0009765625,
            y_rad_s * 0.0009765625,
            z_rad_s * 0.0009765625,
            tick,
        )


_STATUS_RANGES: tuple[_Range, ...] = (
    ("state", 0, 6, ""),
    ("mode", 0, 1, ""),
    ("fault", 0, 3, ""),
    ("stop_reason", 0, 5, ""),
    ("nonce", 0, 65535, ""),
    ("arm_refusal", 0, 7, ""),
    ("limited", 0, 65535, ""),
)


class _StatusFields(NamedTuple):
    state: int
    mode: int
    fault: int
    stop_reason: int
    nonce: int
    arm_refusal: int
    limited: int


class Status(_StatusFields):
    """STATUS: State, and why the robot last stopped or refused to arm; 10 Hz and on every change of state.
    nonce: Nonce of the last session; 0 when there was none.
    limited: Ticks in which all four wheels were scaled at the torque limit, wrapping.
    """

    __slots__ = ()
    ID: ClassVar[int] = 0x100
    LENGTH: ClassVar[int] = 8
    NAME: ClassVar[str] = "STATUS"

    def encode(self) -> bytes:
        state, mode, fault, stop_reason, nonce, arm_refusal, limited = self
        if not (
            0 <= state <= 6
            and 0 <= mode <= 1
            and 0 <= fault <= 3
            and 0 <= stop_reason <= 5
            and 0 <= nonce <= 65535
            and 0 <= arm_refusal <= 7
            and 0 <= limited <= 65535
        ):
            raise _out_of_range(self.NAME, self, _STATUS_RANGES)
        return (
            _index(state)
            | _index(mode) << 4
            | _index(fault) << 8
            | _index(stop_reason) << 16
            | _index(nonce) << 24
            | _index(arm_refusal) << 40
            | _index(limited) << 48
        ).to_bytes(8, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        if len(payload) != 8:
            return None
        bits = int.from_bytes(payload, "little")
        state = bits & 0xF
        mode = bits >> 4 & 0xF
        fault = bits >> 8 & 0xFF
        stop_reason = bits >> 16 & 0xFF
        nonce = bits >> 24 & 0xFFFF
        arm_refusal = bits >> 40 & 0xFF
        limited = bits >> 48 & 0xFFFF
        if not (
            state <= 6
            and mode <= 1
            and fault <= 3
            and stop_reason <= 5
            and arm_refusal <= 7
        ):
            return None
        return cls(
            state,
            mode,
            fault,
            stop_reason,
            nonce,
            arm_refusal,
            limited,
        )


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
    length: Frames of a wrong length, overruns of the serial line included.
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
        cobs, crc, length, unknown_id, range, session, stale, state = _LINK_COUNTERS.unpack(payload)
        return cls(
            cobs,
            crc,
            length,
            unknown_id,
            range,
            session,
            stale,
            state,
        )


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
        return cls(
            tick,
            substeps,
        )


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
        tick, = _STEP_DONE.unpack(payload)
        return cls(
            tick,
        )


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
        protocol_version, = _HELLO_REQUEST.unpack(payload)
        return cls(
            protocol_version,
        )


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
    capabilities: Bit 0 POWER_STAGE, 1 LOCKSTEP, 2 SPEED, 3 TORQUE, 4 FEEDFORWARD, 5 CURRENTS, 6 GYRO.
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
        protocol_version, pages, capabilities, schema_hash = _HELLO_IDENTITY.unpack(payload)
        return cls(
            protocol_version,
            pages,
            capabilities,
            schema_hash,
        )


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
        major, minor, patch, board, build = _HELLO_FIRMWARE.unpack(payload)
        return cls(
            major,
            minor,
            patch,
            board,
            build,
        )


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
        parameter_hash, watchdog_ms, feedback_period_ms = _HELLO_PARAMETERS.unpack(payload)
        return cls(
            parameter_hash,
            watchdog_ms,
            feedback_period_ms,
        )


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
    | Gyro
    | Status
    | LinkCounters
    | Step
    | StepDone
    | HelloRequest
    | HelloIdentity
    | HelloFirmware
    | HelloParameters
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
    0x091: Gyro,
    0x100: Status,
    0x103: LinkCounters,
    0x300: Step,
    0x301: StepDone,
    0x700: HelloRequest,
    0x701: HelloIdentity,
    0x702: HelloFirmware,
    0x703: HelloParameters,
}
LENGTHS: dict[int, int] = {number: message.LENGTH for number, message in MESSAGES.items()}
NAMES: dict[int, str] = {number: message.NAME for number, message in MESSAGES.items()}
