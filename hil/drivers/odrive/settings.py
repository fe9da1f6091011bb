"""``[device.motors]`` of ODrives, and the set-up of each axis that follows from it."""

import math
import re
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from hil.core.options import POSITIVE, Range
from hil.core.types import CommandMode
from hil.drivers.odrive import tables as can
from hil.drivers.port import four_ids

_VERSION = re.compile(r"\d+\.\d+\.\d+")


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``node_ids``: of the channels in order. ``gear_ratio``: motor turns per turn of the wheel.

    ``feedback_hz``: rate at which the axes send their encoder estimates; 0 asks for them with each command.
    ``firmware``: the only firmware that is accepted. ``watchdog_endpoints``: ids of axis0.config.watchdog_timeout and
    axis0.config.enable_watchdog, from the flat_endpoints.json of exactly ``endpoints_firmware`` and
    ``endpoints_hardware``; without them the watchdog is neither set nor read.
    """

    node_ids: Annotated[tuple[int, ...], four_ids(0, can.BROADCAST - 1)] = (0, 1, 2, 3)
    gear_ratio: Annotated[float, POSITIVE] = 1.0
    feedback_hz: Annotated[float, Range(ge=0, le=1000)] = 100.0
    firmware: Literal["any", "0.5", "0.6"] = "any"
    watchdog_endpoints: tuple[int, ...] = ()
    endpoints_firmware: str = ""
    endpoints_hardware: str = ""

    def __post_init__(self) -> None:
        endpoints = self.watchdog_endpoints
        if not endpoints and not self.endpoints_firmware and not self.endpoints_hardware:
            return
        if len(endpoints) != 2 or len(set(endpoints)) != 2 or not all(0 < number <= 0xFFFF for number in endpoints):
            raise ValueError(
                f"watchdog_endpoints = {list(endpoints)}: expected the ids of axis0.config.watchdog_timeout and "
                "axis0.config.enable_watchdog"
            )
        if self.firmware == "0.5":
            raise ValueError("watchdog_endpoints: firmware 0.5 has no endpoints on the bus; leave them out")
        for name, example in (("endpoints_firmware", "0.6.10"), ("endpoints_hardware", "4.4.58")):
            if not _VERSION.fullmatch(getattr(self, name)):
                raise ValueError(
                    f"{name} = {getattr(self, name)!r}: expected what the flat_endpoints.json of watchdog_endpoints "
                    f"says, such as {example!r}"
                )


class Endpoint(NamedTuple):
    """A parameter of firmware 0.6 and the value to set, as bytes: a bool with ``is_switch``, else a float32."""

    name: str
    number: int
    target: bytes
    is_switch: bool

    def is_plausible(self, value: bytes) -> bool:
        """Return whether a value that was read can belong to this parameter. If not, nothing is written to it."""
        if self.is_switch:
            return value[0] in (0, 1)
        return len(value) == can.FLOAT.size and math.isfinite(number := can.FLOAT.unpack(value)[0]) and number >= 0.0


class Setup(NamedTuple):
    """The set-up of every axis: control mode, command (id and payload) of standstill in this mode, and watchdog."""

    control_mode: int
    standstill: tuple[int, bytes]
    watchdog: tuple[Endpoint, ...]


def setup(settings: Settings, mode: CommandMode, watchdog_s: float) -> Setup:
    """Return the set-up of the axes, which is made before they are driven."""
    if mode is CommandMode.SPEED:
        control_mode, standstill = can.VELOCITY_CONTROL, (can.SET_INPUT_VEL, can.TWO_FLOATS.pack(0.0, 0.0))
    else:
        control_mode, standstill = can.TORQUE_CONTROL, (can.SET_INPUT_TORQUE, can.TORQUE.pack(0.0))
    if not settings.watchdog_endpoints:
        return Setup(control_mode, standstill, ())
    timeout, switch = settings.watchdog_endpoints
    return Setup(
        control_mode,
        standstill,
        (
            Endpoint("axis0.config.watchdog_timeout", timeout, can.FLOAT.pack(watchdog_s), False),
            Endpoint("axis0.config.enable_watchdog", switch, b"\x01", True),
        ),
    )
