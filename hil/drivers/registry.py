"""The dialects by name; each is imported when it is asked for."""

from collections.abc import Mapping
from importlib import import_module

from hil.core.errors import BadInputError, nearest
from hil.drivers.port import Dialect

DIALECTS: Mapping[str, str] = {
    "c620": "RoboMaster C620 with M3508, or C610 with M2006",
    "odrive": "ODrive, CANSimple of firmware 0.5 and 0.6",
    "dbc": "a device of your own, by its DBC and a mapping",
    "rosmaster": "Yahboom Rosmaster expansion board",
    "wheeltec": "WHEELTEC C50X base",
    "vesc": "VESC, over CAN or UART",
    "moteus": "mjbots moteus, over CAN FD",
}
"""What ``[device] driver`` takes beside ``stm32``, with what it is. The module of the same name has ``DIALECT``."""


OUR_DRIVER = "stm32"
"""``[device] driver`` of a robot with our own firmware."""


def dialect(name: str) -> Dialect:
    """Return a dialect. Raises BadInputError when there is none of this name."""
    if name not in DIALECTS:
        raise BadInputError(f"no driver is named {name!r}{nearest(name, DIALECTS)}")
    found: Dialect = import_module(f"hil.drivers.{name}.driver").DIALECT
    return found


def driver_names() -> tuple[str, ...]:
    """Return every name that ``[device] driver`` takes: our own firmware's, then the makers'."""
    return (OUR_DRIVER, *DIALECTS)
