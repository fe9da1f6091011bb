"""WHEELTEC base with a C50X board. It takes a velocity of the body, and closes the wheels' loops itself.

Serial, 115200 baud, big-endian: a command has 11 bytes ``7B 00 00 vx vy wz xor 7D``, a report 24 bytes at 20 Hz:
``7B``, stop flag, twist, acceleration, angular velocity, battery, xor, ``7D``. CAN, 1 Mbit/s, carries the same numbers:
0x181 has the three of the command; 0x101, 0x102 and 0x103 have the 24 bytes of a report. The driver handles CAN frames
only; ``WheeltecFraming`` translates between them and the serial line.
Sources: WHEELTEC's STM32 firmware for the C50X (data_task.c, uartx_callback.c, can_callback.c, balance_task.c, sys.c,
robot_init.h); its ROS driver turn_on_wheeltec_robot. WHEELTEC.md says what follows from them.

The base has no arming and reports no version. Its firmware is compiled either to stop when commands end, or, which is
the default, not to.
"""

import math
from dataclasses import dataclass
from functools import reduce
from operator import xor
from struct import Struct
from typing import Annotated

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import PacketFraming, expected_length
from hil.addons.motors.twist_base import Counts, TwistBase
from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.types import NAN
from hil.robot.driver import Capabilities, Dialect, Found, Probe, RobotFacts, Sample

COMMAND = 0x181
REPORTS = (0x101, 0x102, 0x103)
HEAD, TAIL = 0x7B, 0x7D

COMMAND_NUMBERS = Struct(">3hxx")
IN_STEP = bytes(10)
"""Sent before each command on the serial line. The board reads eleven bytes from the first 7B that it sees, and the
checksum of a stop is 7B. So after a lost byte it could read all following stops from a wrong position. Ten zero bytes
complete whatever message it has begun."""

_COMMAND_WIRE = Struct(">Bxx3h")


def checksum(data: bytes | bytearray) -> int:
    """Return the xor of all bytes."""
    return reduce(xor, data, 0)


class WheeltecFraming(PacketFraming):
    """Translates the 24 bytes of a serial report to three CAN frames, and the CAN frame of a command to 11 bytes.

    ``rejected`` counts packets without their tail byte, wrong checksums, and bytes that belong to no packet.
    """

    head = bytes([HEAD])
    longest = 24
    causes = ("tail", "checksum")

    def encode(self, frame: Frame) -> bytes:
        if frame.id != COMMAND or len(frame.payload) != COMMAND_NUMBERS.size:
            raise ValueError(f"frame 0x{frame.id:X} with {len(frame.payload)} bytes: expected 0x181 with 8")
        # In newer firmware a third byte of 0 asks the board to stop when commands end.
        body = _COMMAND_WIRE.pack(HEAD, *COMMAND_NUMBERS.unpack(frame.payload))
        return IN_STEP + body + bytes([checksum(body), TAIL])

    def _decode(self, data: bytes) -> tuple[int, list[Frame]] | str | None:
        if len(data) < self.longest:
            return None
        if data[-1] != TAIL:
            return "tail"
        if checksum(data[:-2]) != data[-2]:
            return "checksum"
        return self.longest, [Frame(number, data[8 * i : 8 * i + 8]) for i, number in enumerate(REPORTS)]


_REPORT = Struct(">BB3h3h3hHBB")
_M_S2 = 1671.84  # counts; the range is ±2 g
_RAD_S = math.radians(500.0) / 32768
_STOPPED = 1
_BAUD = 115_200


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]`` for this base.

    ``wheel_radius_m`` and ``lever_m`` are the firmware's; 0 means the values of ``[robot]``. ``speed_limit_m_s`` is the
    firmware's limit of each rim speed [m/s] and, as the same number, of the yaw rate [rad/s]. ``stops_on_silence`` is
    whether the firmware stops the wheels 1 s after the last command (WHEELTEC.md says how to find out).
    """

    wheel_radius_m: Annotated[float, NOT_NEGATIVE] = 0.0
    lever_m: Annotated[float, NOT_NEGATIVE] = 0.0
    speed_limit_m_s: Annotated[float, POSITIVE] = 3.5
    battery_low_v: Annotated[float, NOT_NEGATIVE] = 20.0
    stops_on_silence: bool = False


class Report:
    """The newest report, assembled from three CAN frames. Its checksum is verified, as CAN may lose one of them."""

    def __init__(self) -> None:
        self._received = b""
        self.stamp_ns: int | None = None
        self.is_stopped = False
        self.twist = (0, 0, 0)
        self.acceleration_m_s2 = (NAN, NAN, NAN)
        self.yaw_rate_rad_s = NAN
        self.battery_v = NAN

    def feed(self, frame: Frame, stamp_ns: int) -> bool:
        """Take a frame, and return whether it completed a report."""
        if frame.id not in REPORTS or len(frame.payload) != 8:
            return False
        index = REPORTS.index(frame.id)
        if index == 0 or len(self._received) != 8 * index:
            self._received = b""
        if len(self._received) == 8 * index:
            self._received += frame.payload
        if len(self._received) != _REPORT.size:
            return False
        whole, self._received = self._received, b""
        head, stopped, x, y, turn, ax, ay, az, _, _, yaw, battery, total, tail = _REPORT.unpack(whole)
        if (head, tail) != (HEAD, TAIL) or checksum(whole[:-2]) != total:
            return False
        self.stamp_ns = stamp_ns
        self.is_stopped = stopped == _STOPPED
        self.twist = (x, y, turn)
        self.acceleration_m_s2 = (ax / _M_S2, ay / _M_S2, az / _M_S2)
        self.yaw_rate_rad_s = yaw * _RAD_S
        self.battery_v = battery / 1000.0
        return True


class Wheeltec(TwistBase):
    """Drives one base with four Mecanum wheels."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        self._settings = settings
        limit = settings.speed_limit_m_s
        super().__init__(
            "a WHEELTEC base",
            robot,
            wheel_radius_m=settings.wheel_radius_m or robot.wheel_radius_m,
            lever_m=settings.lever_m or robot.lever_m,
            rim_limit_m_s=limit,
            yaw_limit_rad_s=limit,
            capabilities=Capabilities(
                20.0,
                frozenset({"battery_voltage", "gyro", "accelerometer"}),
                watchdog="fixed" if settings.stops_on_silence else "none",
            ),
            warnings=[
                "for 12 s after it is switched on a WHEELTEC base ignores commands, and drives 0.4 m forward to test "
                "itself",
                "a WHEELTEC base may drive on for 1 s when commands end"
                if settings.stops_on_silence
                else "when commands end a WHEELTEC base drives on for ever with the last one, unless its firmware was "
                "built with SecurityLevel 0: if this computer loses power, hangs, or loses the cable, nothing stops "
                "the robot; keep its emergency stop within reach",
            ],
        )

    def restart(self) -> None:
        super().restart()
        self._report = Report()

    @property
    def identity(self) -> str | None:
        return None if self._report.stamp_ns is None else "a WHEELTEC base (it reports no version)"

    @property
    def missing(self) -> str:
        if self._report.stamp_ns is not None:
            return ""
        return (
            "no report from a WHEELTEC base; check its power, the cable, that this is its port for a ROS computer, "
            f"with baud={_BAUD} in the link, or its CAN, at 1 Mbit/s"
        )

    def _motion(self, counts: Counts) -> Frame:
        return Frame(COMMAND, COMMAND_NUMBERS.pack(*counts))

    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        if frame.id not in REPORTS:
            return ""
        if self._report.feed(frame, stamp_ns):
            self._is_armed = self._is_armed and not self._report.is_stopped
        elif frame.id == REPORTS[-1]:
            return expected_length(frame.payload, 8) or "the end of a report that is not whole, or has a wrong checksum"
        return expected_length(frame.payload, 8)

    @property
    def sample(self) -> Sample | None:
        report = self._report
        if report.stamp_ns is None:
            return None
        return Sample(
            report.stamp_ns,
            self._speeds_of(report.twist),
            battery_v=report.battery_v,
            acceleration_m_s2=report.acceleration_m_s2,
            yaw_rate_rad_s=report.yaw_rate_rad_s,
        )

    @property
    def _off(self) -> str | None:
        if not self._report.is_stopped:
            return None
        battery_v, low_v = self._report.battery_v, self._settings.battery_low_v
        reason = "its emergency stop is pressed, its key is off, or its self-test at the start has failed"
        if battery_v < low_v:
            reason = f"its battery has {battery_v:g} V, less than device.motors.battery_low_v = {low_v:g}"
        return f"the WHEELTEC base has switched its motors off: {reason}"


class _Probe(Probe):
    """Listens only: the base sends reports without being asked."""

    def __init__(self) -> None:
        self._report = Report()

    def feed(self, frame: Frame) -> bool:
        self._report.feed(frame, 0)
        return frame.id in REPORTS and len(frame.payload) == 8

    def found(self) -> Found | None:
        if self._report.stamp_ns is None:
            return None
        unknown = ("device.motors.wheel_radius_m", "device.motors.lever_m", "device.motors.speed_limit_m_s")
        return Found([f"a WHEELTEC base, battery {self._report.battery_v:g} V"], {}, unknown=unknown)


DIALECT = Dialect(
    title="WHEELTEC C50X",
    wires=frozenset({"serial", "can"}),
    settings=Settings,
    make=Wheeltec,
    emulated="hil.addons.motors.wheeltec.emulated_wheeltec:EmulatedWheeltec",
    make_framing=WheeltecFraming,
    probe=_Probe,
    baud=_BAUD,
    description="WHEELTEC C50X base",
)
