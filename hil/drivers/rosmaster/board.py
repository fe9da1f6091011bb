"""What a Rosmaster board can be set to be, how it is asked for that, and the settings of its driver."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from firmware_protocol.framing import Frame
from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.drivers.port import ANSWER_S, Found, Probe

BAUD = 115_200
CAR_TYPE, REQUEST, VERSION = 0x15, 0x50, 0x51
KNOWN_MAJOR = 3


class Car(NamedTuple):
    """What a board is told to be, and with what its firmware then computes (app_mecanum.h, app_motion.h)."""

    number: int
    wheel_radius_m: float
    lever_m: float
    counts_per_turn: float
    rim_limit_m_s: float


CARS = {
    "x3": Car(1, 0.204203 / math.tau, 0.164555, 30 * 11 * 4, 1.0),
    "x3_plus": Car(2, 0.251327 / math.tau, 0.2141, 56 * 11 * 4, 0.7),
}
_OTHER_CARS = {3: "car of type 3", 4: "X1, without Mecanum wheels", 5: "R2, with steering", 6: "Sunrise car"}


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``wheel_radius_m``, ``lever_m`` and ``counts_per_turn`` are the firmware's, not the robot's.

    0 takes those of the ``car``. Beyond the two voltages, for 2 s, the firmware switches the motors off until a reset.
    """

    car: Literal["x3", "x3_plus"] = "x3"
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
        """The car with what is given in its place."""
        car = CARS[self.car]
        return car._replace(
            wheel_radius_m=self.wheel_radius_m or car.wheel_radius_m,
            lever_m=self.lever_m or car.lever_m,
            counts_per_turn=self.counts_per_turn or car.counts_per_turn,
        )


class Identity:
    """Asks a board for its version and its car in turn, and keeps what it answered."""

    def __init__(self) -> None:
        self.version: tuple[int, int] | None = None
        self.car_number: int | None = None
        self._turn = 0

    def ask(self) -> Sequence[Frame]:
        """One question a call: the board has room for one."""
        self._turn += 1
        return (_request(VERSION if self._turn % 2 else CAR_TYPE),)

    def feed(self, frame: Frame) -> None:
        """Take a frame; one that answers neither question changes nothing."""
        if len(frame.payload) != 2:
            return
        if frame.id == VERSION:
            self.version = frame.payload[0], frame.payload[1]
        elif frame.id == CAR_TYPE:
            self.car_number = frame.payload[0]

    def describe(self) -> str:
        """Return what answered, in words."""
        return (
            f"a Rosmaster board, firmware {'.'.join(map(str, self.version or ()))}, set to {car_name(self.car_number)}"
        )


class RosmasterProbe(Probe):
    """Asks for version and car, which moves nothing and writes nothing."""

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
        who = self._identity
        if who.version is None or who.car_number is None:
            return None
        names = [name for name, car in CARS.items() if car.number == who.car_number and who.version[0] == KNOWN_MAJOR]
        if not names:
            return Found([who.describe()], None)
        car = CARS[names[0]]
        geometry = (
            f"its firmware computes with wheels of {car.wheel_radius_m:.4g} m and with half the length and half the "
            f"width together of {car.lever_m:.4g} m, of which each is given one half"
        )
        known = {
            "robot.wheel_radius_m": car.wheel_radius_m,
            "robot.half_length_m": car.lever_m / 2,
            "robot.half_width_m": car.lever_m / 2,
            "robot.speed_limit_rad_s": car.rim_limit_m_s / car.wheel_radius_m,
            "firmware.counts_per_revolution": car.counts_per_turn,
        }
        return Found([who.describe(), geometry], {"car": names[0]}, known)


def _request(function: int) -> Frame:
    return Frame(REQUEST, bytes([function, 0]))


def car_name(number: int | None) -> str:
    """Return what the maker calls a car of this number."""
    known = {car.number: name.upper().replace("_", " ") for name, car in CARS.items()}
    return known.get(number or 0) or _OTHER_CARS.get(number or 0, f"car of type {number}")
