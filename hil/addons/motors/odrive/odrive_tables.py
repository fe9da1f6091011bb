"""CANSimple of ODrive as data: command ids, payloads, states and error bits, by firmware; and the set-up of an axis.

Source: ODrive, tools/odrive-cansimple.dbc (0.5.6) and Firmware/communication/can/can_simple.cpp; ros_odrive,
odrive_base/include/can_simple_messages.hpp and odrive_enums.h (0.6). Everything is little-endian, and a frame's
identifier is ``node << 5 | command``.
"""

import math
from collections.abc import Mapping, Sequence
from struct import Struct
from typing import NamedTuple

from hil.core.types import CommandMode

NODE_SHIFT, COMMAND_MASK = 5, 0x1F
BROADCAST = 63
"""The last node id: with firmware 0.6 it addresses every ODrive."""

GET_VERSION = 0x00
HEARTBEAT = 0x01
ESTOP = 0x02
GET_ERROR = 0x03  # 0.5: Get_Motor_Error
WRITE_SDO = 0x04  # RxSdo; 0.5: Get_Encoder_Error
READ_SDO = 0x05  # TxSdo
SET_AXIS_STATE = 0x07
GET_ESTIMATES = 0x09
SET_MODES = 0x0B
SET_INPUT_VEL = 0x0D
SET_INPUT_TORQUE = 0x0E
GET_IQ = 0x14
GET_TEMPERATURE = 0x15  # 0.5: Get_Sensorless_Estimates
GET_BUS = 0x17
CLEAR_ERRORS = 0x18
GET_CONTROLLER_ERROR = 0x1D  # 0.6: Get_Powers, from 0.6.9 on
GET_MOTOR_ERROR, GET_ENCODER_ERROR = 0x03, 0x04

VERSION = Struct("<x7B")  # hardware line, version, variant; firmware major, minor, revision, unreleased
BEAT = Struct("<IBBBB")  # axis error, state; 0.5: flags of motor, encoder, controller; 0.6: result of a procedure
TWO_FLOATS = Struct("<2f")
TWO_WORDS = Struct("<2I")
LONG_WORD = Struct("<Q")
STATE = Struct("<I4x")
TORQUE = Struct("<f4x")
FLOAT = Struct("<f")
SDO = Struct("<BHB")  # read or write, endpoint, reserved; then the value
READ, WRITE = b"\x00", b"\x01"

IDLE, CLOSED_LOOP = 1, 8
TORQUE_CONTROL, VELOCITY_CONTROL = 1, 2
PASSTHROUGH = 1


def _bits(table: str) -> Mapping[int, str]:
    """Return the name of each bit's value. In a table ``4: NAME NAME`` names bits 4 and 5."""
    names: dict[int, str] = {}
    for word in table.split():
        if word.endswith(":"):
            bit = 1 << int(word[:-1])
        else:
            names[bit] = word
            bit <<= 1
    return names


ERRORS_06: Mapping[int, str] = _bits("""
    0: INITIALIZING SYSTEM_LEVEL TIMING_ERROR MISSING_ESTIMATE BAD_CONFIG DRV_FAULT MISSING_INPUT
    8: DC_BUS_OVER_VOLTAGE DC_BUS_UNDER_VOLTAGE DC_BUS_OVER_CURRENT DC_BUS_OVER_REGEN_CURRENT
        CURRENT_LIMIT_VIOLATION MOTOR_OVER_TEMP INVERTER_OVER_TEMP VELOCITY_LIMIT_VIOLATION
        POSITION_LIMIT_VIOLATION REQUESTED_CURRENT_TOO_HIGH
    24: WATCHDOG_TIMER_EXPIRED ESTOP_REQUESTED SPINOUT_DETECTED BRAKE_RESISTOR_DISARMED THERMISTOR_DISCONNECTED
    30: CALIBRATION_ERROR
""")
AXIS_ERRORS_05: Mapping[int, str] = _bits("""
    0: INVALID_STATE
    6: MOTOR_FAILED SENSORLESS_ESTIMATOR_FAILED ENCODER_FAILED CONTROLLER_FAILED
    11: WATCHDOG_TIMER_EXPIRED MIN_ENDSTOP_PRESSED MAX_ENDSTOP_PRESSED ESTOP_REQUESTED
    17: HOMING_WITHOUT_ENDSTOP OVER_TEMP UNKNOWN_POSITION
""")
MOTOR_ERRORS_05: Mapping[int, str] = _bits("""
    0: PHASE_RESISTANCE_OUT_OF_RANGE PHASE_INDUCTANCE_OUT_OF_RANGE
    3: DRV_FAULT CONTROL_DEADLINE_MISSED
    7: MODULATION_MAGNITUDE
    10: CURRENT_SENSE_SATURATION
    12: CURRENT_LIMIT_VIOLATION
    16: MODULATION_IS_NAN MOTOR_THERMISTOR_OVER_TEMP FET_THERMISTOR_OVER_TEMP TIMER_UPDATE_MISSED
        CURRENT_MEASUREMENT_UNAVAILABLE CONTROLLER_FAILED I_BUS_OUT_OF_RANGE BRAKE_RESISTOR_DISARMED
        SYSTEM_LEVEL BAD_TIMING UNKNOWN_PHASE_ESTIMATE UNKNOWN_PHASE_VEL UNKNOWN_TORQUE UNKNOWN_CURRENT_COMMAND
        UNKNOWN_CURRENT_MEASUREMENT UNKNOWN_VBUS_VOLTAGE UNKNOWN_VOLTAGE_COMMAND UNKNOWN_GAINS
        CONTROLLER_INITIALIZING UNBALANCED_PHASES
""")
ENCODER_ERRORS_05: Mapping[int, str] = _bits("""
    0: UNSTABLE_GAIN CPR_POLEPAIRS_MISMATCH NO_RESPONSE UNSUPPORTED_ENCODER_MODE ILLEGAL_HALL_STATE
        INDEX_NOT_FOUND_YET ABS_SPI_TIMEOUT ABS_SPI_COM_FAIL ABS_SPI_NOT_READY HALL_NOT_CALIBRATED_YET
""")
CONTROLLER_ERRORS_05: Mapping[int, str] = _bits("""
    0: OVERSPEED INVALID_INPUT_MODE UNSTABLE_GAIN INVALID_MIRROR_AXIS INVALID_LOAD_ENCODER INVALID_ESTIMATE
        INVALID_CIRCULAR_RANGE SPINOUT_DETECTED
""")


class ErrorField(NamedTuple):
    """One error register of an ODrive.

    Attributes:
        name: for messages.
        command, layout, position: the CAN message that carries it, and the place among its values.
        bits: the name of each bit's value.
        flag: index (0 to 2) of the heartbeat flag that is set while this register is not zero; None without one.
    """

    name: str
    command: int
    layout: Struct
    position: int
    bits: Mapping[int, str]
    flag: int | None = None


class Firmware(NamedTuple):
    """What differs between the firmwares.

    Attributes:
        polled: the commands that are asked for in turn.
        clear: payload of Clear_Errors.
    """

    name: str
    errors: tuple[ErrorField, ...]
    polled: tuple[int, ...]
    clear: bytes


FIRMWARE_05 = Firmware(
    "0.5",
    (
        ErrorField("axis error", HEARTBEAT, BEAT, 0, AXIS_ERRORS_05),
        ErrorField("motor error", GET_MOTOR_ERROR, LONG_WORD, 0, MOTOR_ERRORS_05, flag=0),
        ErrorField("encoder error", GET_ENCODER_ERROR, TWO_WORDS, 0, ENCODER_ERRORS_05, flag=1),
        ErrorField("controller error", GET_CONTROLLER_ERROR, TWO_WORDS, 0, CONTROLLER_ERRORS_05, flag=2),
    ),
    (GET_MOTOR_ERROR, GET_IQ, GET_ENCODER_ERROR, GET_BUS, GET_CONTROLLER_ERROR),
    b"",
)

FIRMWARE_06 = Firmware(
    "0.6",
    (
        ErrorField("axis error", HEARTBEAT, BEAT, 0, ERRORS_06),
        ErrorField("active error", GET_ERROR, TWO_WORDS, 0, ERRORS_06),
        ErrorField("disarm reason", GET_ERROR, TWO_WORDS, 1, ERRORS_06),
    ),
    (GET_ERROR, GET_IQ, GET_TEMPERATURE, GET_BUS),
    b"\x00",
)


def bit_names(word: int, bits: Mapping[int, str]) -> str:
    """Return the names of the set bits, and the unknown ones as one hexadecimal number."""
    names = [name for bit, name in bits.items() if word & bit]
    if unknown := word & ~sum(bits):
        names.append(f"{unknown:#x}")
    return ", ".join(names)


def dotted(version: Sequence[object]) -> str:
    """Return a version as text."""
    return ".".join(map(str, version))


class Endpoint(NamedTuple):
    """A parameter of firmware 0.6 and the value to set: a bool of one byte, or a float32."""

    name: str
    number: int
    target: bytes

    def is_plausible(self, value: bytes) -> bool:
        """Return whether a value that was read can belong to this parameter. If not, nothing is written to it."""
        if len(self.target) == 1:
            return value[0] in (0, 1)
        return len(value) == FLOAT.size and math.isfinite(number := FLOAT.unpack(value)[0]) and number >= 0.0


class Setup(NamedTuple):
    """The set-up of every axis: control mode, command (id and payload) of standstill in this mode, and watchdog."""

    control_mode: int
    standstill: tuple[int, bytes]
    watchdog: tuple[Endpoint, ...]


def setup(watchdog_endpoints: Sequence[int], mode: CommandMode, watchdog_s: float) -> Setup:
    """Return the set-up of the axes, which is made before they are driven."""
    if mode is CommandMode.SPEED:
        control_mode, standstill = VELOCITY_CONTROL, (SET_INPUT_VEL, TWO_FLOATS.pack(0.0, 0.0))
    else:
        control_mode, standstill = TORQUE_CONTROL, (SET_INPUT_TORQUE, TORQUE.pack(0.0))
    if not watchdog_endpoints:
        return Setup(control_mode, standstill, ())
    timeout = Endpoint("axis0.config.watchdog_timeout", watchdog_endpoints[0], FLOAT.pack(watchdog_s))
    switch = Endpoint("axis0.config.enable_watchdog", watchdog_endpoints[1], b"\x01")
    return Setup(control_mode, standstill, (timeout, switch))
