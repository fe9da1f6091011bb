"""What is set for ODrive axes: the options of a scenario, and what follows for an axis."""

import math
import re
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.types import CommandMode
from hil.drivers.odrive import tables as can
from hil.drivers.port import check_ids

_VERSION = re.compile(r"\d+\.\d+\.\d+")


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``: ``node_ids`` of the channels in order, ``gear_ratio`` motor turns in one of the
    wheel.

    ``feedback_hz`` is the rate at which the axes send their encoder estimates by themselves, 0 asks for them with
    each command. ``firmware`` refuses any other. ``watchdog_endpoints`` are the ids of axis0.config.watchdog_timeout
    and axis0.config.enable_watchdog from the flat_endpoints.json of exactly ``endpoints_firmware`` and
    ``endpoints_hardware``; without them the watchdog is neither set nor read.
    """

    node_ids: tuple[int, ...] = (0, 1, 2, 3)
    gear_ratio: Annotated[float, POSITIVE] = 1.0
    feedback_hz: Annotated[float, NOT_NEGATIVE] = 100.0
    firmware: Literal["any", "0.5", "0.6"] = "any"
    watchdog_endpoints: tuple[int, ...] = ()
    endpoints_firmware: str = ""
    endpoints_hardware: str = ""

    def __post_init__(self) -> None:
        check_ids("node_ids", self.node_ids, 0, can.BROADCAST - 1)
        if self.feedback_hz > 1000.0:
            raise ValueError(f"feedback_hz = {self.feedback_hz:g}: expected 1000 at most, or 0 to ask for each")
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
    """A parameter of firmware 0.6 that is to hold a value, both as bytes; ``is_switch`` for a bool, else a float32."""

    name: str
    number: int
    wanted: bytes
    is_switch: bool

    def can_be(self, value: bytes) -> bool:
        """Tell whether what was read can be of this parameter at all: what is not is not written to."""
        if self.is_switch:
            return value[0] in (0, 1)
        return len(value) == can.FLOAT.size and math.isfinite(number := can.FLOAT.unpack(value)[0]) and number >= 0.0


class Setup(NamedTuple):
    """What every axis is set to: its control mode, the command of standstill in it, and its watchdog."""

    control_mode: int
    standstill: tuple[int, bytes]
    watchdog: tuple[Endpoint, ...]


def setup(settings: Settings, mode: CommandMode, watchdog_s: float) -> Setup:
    """Return what the axes are set to before they are driven."""
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
