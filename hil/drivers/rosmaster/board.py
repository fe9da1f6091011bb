"""The cars that a Rosmaster board can be set to, the questions for version and car, and the driver's settings."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from firmware_protocol.framing import Frame
from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.drivers.port import ANSWER_S, Found, Probe, expected_length

BAUD = 115_200
CAR_TYPE, REQUEST, VERSION = 0x15, 0x50, 0x51
KNOWN_MAJOR = 3


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
_OTHER_CARS = {3: "car of type 3", 4: "X1, without Mecanum wheels", 5: "R2, with steering", 6: "Sunrise car"}


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``wheel_radius_m``, ``lever_m`` and ``counts_per_turn``: of the firmware, not of the robot.

    0 stands for the value of the ``car``. When the battery is outside the two voltages for 2 s, the firmware switches
    the motors off until a reset.
    """

    car: CarName = "x3"
    wheel_radius_m: Annotated[float, NOT_NEGATIVE] = 0.0
    lever_m: Annotated[float, NOT_NEGATIVE] = 0.0
    counts_per_turn: Annotated[float, NOT_NEGATIVE] = 0.0
    battery_low_v: Annotated[float, NOT_NEGATIVE] = 9.6
    battery_high_v: Annotated[float, POSITIVE] = 13.0

    def __post_init__(self) -> None:
        if self.battery_low_v >= self.battery_high_v:
            raise ValueError(
                f"battery_low_v = {self.battery_low_v:g}: expected less than battery_high_v = {self.battery_high_v:g}"
            )

    @property
    def geometry(self) -> Car:
        """The geometry of the car, with the values that the settings replace."""
        car = CARS[self.car]
        return car._replace(
            wheel_radius_m=self.wheel_radius_m or car.wheel_radius_m,
            lever_m=self.lever_m or car.lever_m,
            counts_per_turn=self.counts_per_turn or car.counts_per_turn,
        )


class Identity:
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
        return f"a Rosmaster board, firmware {version}, set to {car_name(self.car_number)}"


class RosmasterProbe(Probe):
    """Asks for version and car. This moves nothing and writes nothing."""

    def __init__(self) -> None:
        self._identity = Identity()

    @property
    def patience_s(self) -> float:
        return ANSWER_S

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
        if not names or board.version[0] != KNOWN_MAJOR:
            return Found([board.describe()], None)
        car = CARS[names[0]]
        geometry = (
            f"its firmware computes with a wheel radius of {car.wheel_radius_m:.4g} m, and with {car.lever_m:.4g} m "
            "for half the length plus half the width; each of the two is set to half of that"
        )
        known = {
            "robot.wheel_radius_m": car.wheel_radius_m,
            "robot.half_length_m": car.lever_m / 2,
            "robot.half_width_m": car.lever_m / 2,
            "robot.speed_limit_rad_s": car.rim_limit_m_s / car.wheel_radius_m,
            "firmware.counts_per_revolution": car.counts_per_turn,
        }
        return Found([board.describe(), geometry], {"car": names[0]}, known)


def car_name(number: int | None) -> str:
    """Return the maker's name for a car of this number."""
    known = {car.number: name.upper().replace("_", " ") for name, car in CARS.items()}
    return known.get(number or 0) or _OTHER_CARS.get(number or 0, f"car of type {number}")
