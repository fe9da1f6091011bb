"""``[device.motors]`` of VESCs."""

from dataclasses import dataclass
from typing import Annotated

from hil.core.options import NOT_NEGATIVE, POSITIVE, Range
from hil.drivers.port import four_ids
from hil.drivers.vesc.frames import MIN_CURRENT_A

MAX_ID = 254  # 255 is the broadcast id
_ID = Range(ge=0, le=MAX_ID)


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``ids``: of the channels in order. ``pole_pairs``: of a motor, half of its magnets.

    ``gear_ratio``: motor turns per turn of the wheel. ``status_hz``: rate of the status messages, as set in VESC Tool.
    ``serial_id``: id of the VESC at the serial line. ``host_id``: id of this computer on the bus, which no VESC may
    have. ``brake_current_a``: current of an e-stop; 0 stands for the current of the torque limit.
    """

    ids: Annotated[tuple[int, ...], four_ids(0, MAX_ID)] = (1, 2, 3, 4)
    pole_pairs: Annotated[int, Range(ge=1)] = 7
    gear_ratio: Annotated[float, POSITIVE] = 1.0
    status_hz: Annotated[float, POSITIVE] = 50.0
    serial_id: Annotated[int, _ID] = 1
    host_id: Annotated[int, _ID] = 253
    brake_current_a: Annotated[float, NOT_NEGATIVE] = 0.0

    def __post_init__(self) -> None:
        if self.host_id in self.ids:
            raise ValueError(f"host_id = {self.host_id}: expected none of device.motors.ids")
        if 0.0 < self.brake_current_a < MIN_CURRENT_A:
            raise ValueError(
                f"brake_current_a = {self.brake_current_a:g}: expected 0, or {MIN_CURRENT_A:g} and more, as a VESC "
                "does not brake with less"
            )
