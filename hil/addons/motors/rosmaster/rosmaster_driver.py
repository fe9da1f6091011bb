"""Yahboom Rosmaster expansion board (X3, X3 PLUS). It takes a velocity of the body and closes the wheels' loops itself.

Serial, 115200 baud, little-endian: ``FF FC length function data sum`` to the board and ``FF FB …`` from it. ``length``
counts the bytes from itself to the sum; the sum leaves out the first two bytes. The board reports its twist, an IMU,
an attitude and four encoder counts in turn, 10 ms apart, each at 25 Hz.
Sources: Yahboom Rosmaster_Lib 3.3.9; Yahboom's STM32 firmware 3.3.9 and 3.5.1 (protocol.c, app.c, app_motion.c,
app_mecanum.c, app_bat.c). ROSMASTER.md says what follows from them.

The board has no arming, no error codes and no watchdog: it obeys the last command for ever.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Annotated, Literal, NamedTuple

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import PacketFraming, expected_length, holds_back
from hil.addons.motors.twist_base import LATE_NS, Counts, TwistBase
from hil.core.errors import BadInputError
from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.types import NAN
from hil.robot.driver import ANSWER_S, Capabilities, Dialect, Found, Probe, RobotFacts, Sample, four

_BAUD = 115_200
_KNOWN_MAJOR = 3
CarName = Literal["x3", "x3_plus"]


class Car(NamedTuple):
    """A type of car, by its number, and the geometry that the firmware uses for it (app_mecanum.h, app_motion.h)."""

    number: int
    wheel_radius_m: float
    lever_m: float
    counts_per_turn: float
    rim_limit_m_s: float


CARS: Mapping[CarName, Car] = {
    "x3": Car(1, 0.204203 / math.tau, 0.164555, 30 * 11 * 4, 1.0),
    "x3_plus": Car(2, 0.251327 / math.tau, 0.2141, 56 * 11 * 4, 0.7),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``car``: what the board is set to.

    When the battery is outside the two voltages for 2 s, the firmware switches the motors off until a reset.
    """

    car: CarName = "x3"
    battery_low_v: Annotated[float, NOT_NEGATIVE] = 9.6
    battery_high_v: Annotated[float, POSITIVE] = 13.0

    def __post_init__(self) -> None:
        if self.battery_low_v >= self.battery_high_v:
            raise ValueError(
                f"battery_low_v = {self.battery_low_v:g}: expected less than battery_high_v = {self.battery_high_v:g}"
            )


# The board has one receive buffer and reads it once per millisecond. Two frames within that time may destroy each
# other, even two stops. So a pause follows each frame, made of bytes that cannot begin a frame.
PAUSE = bytes(18)
"""1.6 ms at 115200 baud. The maker's library waits 2 ms from write to write, which leaves half as long a pause."""

_TO_BOARD = b"\xff\xfc"
_LEAST = 3  # length, function, sum
_MOST = 32  # the longest report, of an IMU, has 21


class RosmasterFraming(PacketFraming):
    """The host's framing. ``rejected`` counts wrong lengths, wrong checksums, and bytes that belong to no frame."""

    head = b"\xff\xfb"
    longest = len(head) + _MOST
    causes = ("length", "checksum")

    def encode(self, frame: Frame) -> bytes:
        length = _LEAST + len(frame.payload)
        if length > _MOST:
            raise ValueError(f"a payload of {len(frame.payload)} bytes: expected at most {_MOST - _LEAST}")
        body = bytes([length, frame.id]) + frame.payload
        return _TO_BOARD + body + bytes([sum(body) & 0xFF]) + PAUSE

    def _decode(self, data: bytes) -> tuple[int, list[Frame]] | str | None:
        if len(data) <= 2:
            return None
        end = 2 + data[2]
        if not _LEAST <= data[2] <= _MOST:
            return "length"
        if len(data) < end:
            return None
        if sum(data[2 : end - 1]) & 0xFF != data[end - 1]:
            return "checksum"
        return end, [Frame(data[3], data[4 : end - 1])]


RESET_STATE, MOTION = 0x0F, 0x12
CAR_TYPE, REQUEST, VERSION = 0x15, 0x50, 0x51
TWIST_REPORT, MPU_REPORT, ENCODER_REPORT, ICM_REPORT = 0x0A, 0x0B, 0x0D, 0x0E

_MOTION = Struct("<B3h")
_TWIST = Struct("<3hB")
_COUNTS = Struct("<4i")
_IMU = Struct("<9h")
_CONFIRM = 0x5F
_WHEEL_OF_MOTOR = (0, 3, 1, 2)  # M1 to M4 are FL, RL, FR, RR
_WRAP = 1 << 32
_BATTERY_NS = 1_500_000_000  # the firmware switches off after 2 s: this leaves time for a controlled stop


_IMUS = {MPU_REPORT: (-3754.9, 1671.84), ICM_REPORT: (1000.0, 1000.0)}
"""Counts per rad/s about the vertical, negative where the maker's library inverts the rate, and per m/s²."""


_REPORT_BYTES = {TWIST_REPORT: _TWIST.size, ENCODER_REPORT: _COUNTS.size} | dict.fromkeys(_IMUS, _IMU.size)


class _Identity:
    """Asks a board for its version and its car in turn, and keeps the answers."""

    def __init__(self) -> None:
        self.version: tuple[int, int] | None = None
        self.car_number: int | None = None
        self._turn = 0

    def ask(self) -> Sequence[Frame]:
        """Return one question: the board has room for one message only."""
        self._turn += 1
        return (Frame(REQUEST, bytes([VERSION if self._turn % 2 else CAR_TYPE, 0])),)

    def feed(self, frame: Frame) -> str | None:
        """Take a frame. It changes nothing unless it answers one of the questions. Return as ``Driver.feed``."""
        if frame.id not in (VERSION, CAR_TYPE):
            return ""
        if (why := expected_length(frame.payload, 2)) is not None:
            return why
        if frame.id == VERSION:
            self.version = frame.payload[0], frame.payload[1]
        else:
            self.car_number = frame.payload[0]
        return None

    def describe(self) -> str:
        """Return firmware version and car in words."""
        version = ".".join(map(str, self.version or ()))
        return f"a Rosmaster board, firmware {version}, set to {_car_name(self.car_number)}"


def _car_name(number: int | None) -> str:
    known = {car.number: name.upper().replace("_", " ") for name, car in CARS.items()}
    return known.get(number or 0, f"car of type {number}")


class Rosmaster(TwistBase):
    """Drives one board with four Mecanum wheels."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        self._settings = settings
        car = self._car = CARS[settings.car]
        super().__init__(
            "a Rosmaster",
            robot,
            wheel_radius_m=car.wheel_radius_m,
            lever_m=car.lever_m,
            rim_limit_m_s=car.rim_limit_m_s,
            capabilities=Capabilities(25.0, frozenset({"position", "battery_voltage", "gyro", "accelerometer"})),
            warnings=[
                "when commands end a Rosmaster drives on for ever with the last one: if this computer loses power, "
                "hangs, or loses the cable, nothing stops the robot; keep its power switch within reach"
            ],
        )

    def restart(self) -> None:
        super().restart()
        self._identity = _Identity()
        self._twist: Counts | None = None
        self._twist_ns = 0
        self._battery_v = NAN
        self._battery_bad_ns: int | None = None
        self._is_battery_bad = False
        self._counts: tuple[int, ...] | None = None
        self._turned = [0, 0, 0, 0]
        self._counts_ns = 0
        self._imu_ns = 0
        self._yaw_rate_rad_s = NAN
        self._acceleration_m_s2 = (NAN, NAN, NAN)

    def ask(self) -> Sequence[Frame]:
        return self._identity.ask() if self.missing else ()

    @property
    def identity(self) -> str | None:
        board = self._identity
        if board.version is None or board.car_number is None:
            return None
        major, minor = board.version
        if major != _KNOWN_MAJOR:
            raise BadInputError(
                f"the Rosmaster board has firmware {major}.{minor}, and this driver knows {_KNOWN_MAJOR}.x; load that, "
                "as Yahboom's page of the board says"
            )
        if board.car_number != self._car.number:
            known = [
                f'write device.motors.car = "{name}"' for name, car in CARS.items() if car.number == board.car_number
            ]
            remedy = (*known, "set the board to X3 or X3 PLUS with Yahboom's tool")[0]
            raise BadInputError(
                f"the Rosmaster board is set to {_car_name(board.car_number)}, and device.motors.car is "
                f"{self._settings.car!r}; {remedy}"
            )
        return board.describe()

    @property
    def missing(self) -> str:
        answers = {"version": self._identity.version, "car": self._identity.car_number}
        unknown = " and its ".join(name for name, answer in answers.items() if answer is None)
        return unknown and (
            f"the Rosmaster board has not reported its {unknown}; check its power, the cable, "
            f"baud={_BAUD} in the link, that the port is the board's, and that no other program reads from it"
        )

    def _motion(self, counts: Counts) -> Frame:
        return Frame(MOTION, _MOTION.pack(self._car.number, *counts))

    def _second_stop(self) -> Frame:
        return Frame(RESET_STATE, bytes([_CONFIRM]))

    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        number, payload = frame
        if number in _REPORT_BYTES and (why := expected_length(payload, _REPORT_BYTES[number])) is not None:
            return why
        if number == TWIST_REPORT:
            x, y, turn, battery = _TWIST.unpack(payload)
            self._twist, self._twist_ns = (x, y, turn), stamp_ns
            self._feed_battery(battery / 10.0, stamp_ns)
        elif number == ENCODER_REPORT:
            self._feed_counts(_COUNTS.unpack(payload))
            self._counts_ns = stamp_ns
        elif number in _IMUS:
            per_rad_s, per_m_s2 = _IMUS[number]
            self._imu_ns = stamp_ns
            _, _, yaw, x, y, z, *_ = _IMU.unpack(payload)
            self._yaw_rate_rad_s = yaw / per_rad_s
            self._acceleration_m_s2 = (x / per_m_s2, y / per_m_s2, z / per_m_s2)
        else:
            return self._identity.feed(frame)
        return None

    def _feed_battery(self, battery_v: float, stamp_ns: int) -> None:
        self._battery_v = battery_v
        if self._settings.battery_low_v < battery_v < self._settings.battery_high_v:
            self._battery_bad_ns = None
        elif self._battery_bad_ns is None:
            self._battery_bad_ns = stamp_ns
        self._is_battery_bad = self._battery_bad_ns is not None and stamp_ns - self._battery_bad_ns >= _BATTERY_NS
        self._is_armed = self._is_armed and not self._is_battery_bad

    def _feed_counts(self, counts: tuple[int, ...]) -> None:
        for motor, (count, last) in enumerate(zip(counts, self._counts or counts, strict=True)):
            self._turned[_WHEEL_OF_MOTOR[motor]] += (count - last + _WRAP // 2) % _WRAP - _WRAP // 2
        self._counts = counts

    @property
    def sample(self) -> Sample | None:
        """Return the newest twist, with the last values of the other reports: wheel positions may be 40 ms older.

        None until both a twist and encoder counts have come. Before that the angles would be integrated from speeds,
        and odometry would jump when the encoders' angles replace them.
        """
        if self._twist is None or self._counts is None:
            return None
        to_rad = math.tau / self._car.counts_per_turn
        has_imu = self._twist_ns - self._imu_ns <= LATE_NS
        return Sample(
            holds_back(self._twist_ns, self._counts_ns, LATE_NS),
            self._speeds_of(self._twist),
            four(count * to_rad for count in self._turned),
            battery_v=self._battery_v,
            acceleration_m_s2=self._acceleration_m_s2 if has_imu else (NAN, NAN, NAN),
            yaw_rate_rad_s=self._yaw_rate_rad_s if has_imu else NAN,
        )

    @property
    def _off(self) -> str | None:
        if not self._is_battery_bad:
            return None
        low, high = self._settings.battery_low_v, self._settings.battery_high_v
        return (
            f"the battery of the Rosmaster has {self._battery_v:g} V; outside {low:g} to {high:g} V "
            "(device.motors.battery_low_v and battery_high_v) its firmware switches all motors off until a reset"
        )


class _Probe(Probe):
    """Asks for version and car. This moves nothing and writes nothing."""

    patience_s = ANSWER_S

    def __init__(self) -> None:
        self._identity = _Identity()

    def ask(self) -> Sequence[Frame]:
        return self._identity.ask()

    def feed(self, frame: Frame) -> bool:
        self._identity.feed(frame)
        return True  # others' frames do not begin with FF FB

    def found(self) -> Found | None:
        board = self._identity
        if board.version is None or board.car_number is None:
            return None
        names = [name for name, car in CARS.items() if car.number == board.car_number]
        if not names or board.version[0] != _KNOWN_MAJOR:
            return Found([board.describe()], None)
        car = CARS[names[0]]
        known = {
            "robot.wheel_radius_m": car.wheel_radius_m,
            "robot.half_length_m": car.lever_m / 2,
            "robot.half_width_m": car.lever_m / 2,
            "robot.speed_limit_rad_s": car.rim_limit_m_s / car.wheel_radius_m,
            "firmware.counts_per_revolution": car.counts_per_turn,
        }
        return Found([board.describe()], {"car": names[0]}, known)


DIALECT = Dialect(
    title="Yahboom Rosmaster",
    wires=frozenset({"serial"}),
    settings=Settings,
    make=Rosmaster,
    emulated="hil.addons.motors.rosmaster.emulated_rosmaster:EmulatedRosmaster",
    make_framing=RosmasterFraming,
    probe=_Probe,
    baud=_BAUD,
    description="Yahboom Rosmaster expansion board",
)
