"""CANSimple of ODrive as data: command ids, payloads, states and error bits, by firmware.

Source: ODrive, tools/odrive-cansimple.dbc (0.5.6) and Firmware/communication/can/can_simple.cpp; ros_odrive,
odrive_base/include/can_simple_messages.hpp and odrive_enums.h (0.6). Everything is little-endian, and a frame's
identifier is ``node << 5 | command``.
"""

from collections.abc import Mapping
from struct import Struct
from typing import NamedTuple

NODE_SHIFT, COMMAND_MASK = 5, 0x1F
BROADCAST = 63
"""The last node id speaks to every ODrive of firmware 0.6."""

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
SDO = Struct("<BHB")  # read or write, endpoint, nothing; then the value
READ, WRITE = b"\x00", b"\x01"

IDLE, CLOSED_LOOP = 1, 8
TORQUE_CONTROL, VELOCITY_CONTROL = 1, 2
PASSTHROUGH = 1

PROCEDURE_RESULTS: Mapping[int, str] = {
    0: "SUCCESS",
    1: "BUSY",
    2: "CANCELLED",
    3: "DISARMED",
    4: "NO_RESPONSE",
    5: "POLE_PAIR_CPR_MISMATCH",
    6: "PHASE_RESISTANCE_OUT_OF_RANGE",
    7: "PHASE_INDUCTANCE_OUT_OF_RANGE",
    8: "UNBALANCED_PHASES",
    9: "INVALID_MOTOR_TYPE",
    10: "ILLEGAL_HALL_STATE",
    11: "TIMEOUT",
    12: "HOMING_WITHOUT_ENDSTOP",
    13: "INVALID_STATE",
    14: "NOT_CALIBRATED",
    15: "NOT_CONVERGING",
}

ERRORS_06: Mapping[int, str] = {
    0x0000_0001: "INITIALIZING",
    0x0000_0002: "SYSTEM_LEVEL",
    0x0000_0004: "TIMING_ERROR",
    0x0000_0008: "MISSING_ESTIMATE",
    0x0000_0010: "BAD_CONFIG",
    0x0000_0020: "DRV_FAULT",
    0x0000_0040: "MISSING_INPUT",
    0x0000_0100: "DC_BUS_OVER_VOLTAGE",
    0x0000_0200: "DC_BUS_UNDER_VOLTAGE",
    0x0000_0400: "DC_BUS_OVER_CURRENT",
    0x0000_0800: "DC_BUS_OVER_REGEN_CURRENT",
    0x0000_1000: "CURRENT_LIMIT_VIOLATION",
    0x0000_2000: "MOTOR_OVER_TEMP",
    0x0000_4000: "INVERTER_OVER_TEMP",
    0x0000_8000: "VELOCITY_LIMIT_VIOLATION",
    0x0001_0000: "POSITION_LIMIT_VIOLATION",
    0x0002_0000: "REQUESTED_CURRENT_TOO_HIGH",  # from 0.6.11 on
    0x0100_0000: "WATCHDOG_TIMER_EXPIRED",
    0x0200_0000: "ESTOP_REQUESTED",
    0x0400_0000: "SPINOUT_DETECTED",
    0x0800_0000: "BRAKE_RESISTOR_DISARMED",
    0x1000_0000: "THERMISTOR_DISCONNECTED",
    0x4000_0000: "CALIBRATION_ERROR",
}

AXIS_ERRORS_05: Mapping[int, str] = {
    0x0000_0001: "INVALID_STATE",
    0x0000_0040: "MOTOR_FAILED",
    0x0000_0080: "SENSORLESS_ESTIMATOR_FAILED",
    0x0000_0100: "ENCODER_FAILED",
    0x0000_0200: "CONTROLLER_FAILED",
    0x0000_0800: "WATCHDOG_TIMER_EXPIRED",
    0x0000_1000: "MIN_ENDSTOP_PRESSED",
    0x0000_2000: "MAX_ENDSTOP_PRESSED",
    0x0000_4000: "ESTOP_REQUESTED",
    0x0002_0000: "HOMING_WITHOUT_ENDSTOP",
    0x0004_0000: "OVER_TEMP",
    0x0008_0000: "UNKNOWN_POSITION",
}

MOTOR_ERRORS_05: Mapping[int, str] = {
    0x0_0000_0001: "PHASE_RESISTANCE_OUT_OF_RANGE",
    0x0_0000_0002: "PHASE_INDUCTANCE_OUT_OF_RANGE",
    0x0_0000_0008: "DRV_FAULT",
    0x0_0000_0010: "CONTROL_DEADLINE_MISSED",
    0x0_0000_0080: "MODULATION_MAGNITUDE",
    0x0_0000_0400: "CURRENT_SENSE_SATURATION",
    0x0_0000_1000: "CURRENT_LIMIT_VIOLATION",
    0x0_0001_0000: "MODULATION_IS_NAN",
    0x0_0002_0000: "MOTOR_THERMISTOR_OVER_TEMP",
    0x0_0004_0000: "FET_THERMISTOR_OVER_TEMP",
    0x0_0008_0000: "TIMER_UPDATE_MISSED",
    0x0_0010_0000: "CURRENT_MEASUREMENT_UNAVAILABLE",
    0x0_0020_0000: "CONTROLLER_FAILED",
    0x0_0040_0000: "I_BUS_OUT_OF_RANGE",
    0x0_0080_0000: "BRAKE_RESISTOR_DISARMED",
    0x0_0100_0000: "SYSTEM_LEVEL",
    0x0_0200_0000: "BAD_TIMING",
    0x0_0400_0000: "UNKNOWN_PHASE_ESTIMATE",
    0x0_0800_0000: "UNKNOWN_PHASE_VEL",
    0x0_1000_0000: "UNKNOWN_TORQUE",
    0x0_2000_0000: "UNKNOWN_CURRENT_COMMAND",
    0x0_4000_0000: "UNKNOWN_CURRENT_MEASUREMENT",
    0x0_8000_0000: "UNKNOWN_VBUS_VOLTAGE",
    0x1_0000_0000: "UNKNOWN_VOLTAGE_COMMAND",
    0x2_0000_0000: "UNKNOWN_GAINS",
    0x4_0000_0000: "CONTROLLER_INITIALIZING",
    0x8_0000_0000: "UNBALANCED_PHASES",
}

ENCODER_ERRORS_05: Mapping[int, str] = {
    0x0001: "UNSTABLE_GAIN",
    0x0002: "CPR_POLEPAIRS_MISMATCH",
    0x0004: "NO_RESPONSE",
    0x0008: "UNSUPPORTED_ENCODER_MODE",
    0x0010: "ILLEGAL_HALL_STATE",
    0x0020: "INDEX_NOT_FOUND_YET",
    0x0040: "ABS_SPI_TIMEOUT",
    0x0080: "ABS_SPI_COM_FAIL",
    0x0100: "ABS_SPI_NOT_READY",
    0x0200: "HALL_NOT_CALIBRATED_YET",
}

CONTROLLER_ERRORS_05: Mapping[int, str] = {
    0x0001: "OVERSPEED",
    0x0002: "INVALID_INPUT_MODE",
    0x0004: "UNSTABLE_GAIN",
    0x0008: "INVALID_MIRROR_AXIS",
    0x0010: "INVALID_LOAD_ENCODER",
    0x0020: "INVALID_ESTIMATE",
    0x0040: "INVALID_CIRCULAR_RANGE",
    0x0080: "SPINOUT_DETECTED",
}


class ErrorField(NamedTuple):
    """One word of error bits: what it is called, where it comes, and what its bits mean.

    ``flag`` is which of the heartbeat's three flags says that it is not zero, None where there is none.
    """

    name: str
    command: int
    layout: Struct
    place: int
    bits: Mapping[int, str]
    flag: int | None = None


class Firmware(NamedTuple):
    """What differs between the firmwares. ``polled`` is asked for in turn, ``clear`` the payload of Clear_Errors."""

    name: str
    errors: tuple[ErrorField, ...]
    polled: tuple[int, ...]
    clear: bytes
    estimates_option: str


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
    "config.can.encoder_rate_ms",
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
    "config.can.encoder_msg_rate_ms",
)


def bit_names(word: int, bits: Mapping[int, str]) -> str:
    """Return the names of the bits that are set, unknown ones as a number."""
    names = [name for bit, name in bits.items() if word & bit]
    if unknown := word & ~sum(bits):
        names.append(f"{unknown:#x}")
    return ", ".join(names)
