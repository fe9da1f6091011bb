"""Finds a maker's protocol by the name in ``[device] driver``; each is imported when it is first used."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import is_dataclass
from functools import partial
from importlib import import_module
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, cast, get_args

from hil.core.errors import BadInputError, HilError
from hil.core.extensions import Extensions, failure, failures_of, from_package
from hil.core.options import build
from hil.drivers.port import Dialect, Driver, DriverError, RobotFacts, Wire

if TYPE_CHECKING:
    from hil.drivers.emulated import EmulatedMotors

OUR_DRIVER = "stm32"
"""``[device] driver`` of a robot with our own firmware."""

SHIPPED: Mapping[str, str] = {
    "c620": "RoboMaster C620 with M3508, or C610 with M2006",
    "odrive": "ODrive, CANSimple of firmware 0.5 and 0.6",
    "dbc": "a device of your own, by its DBC and a mapping",
    "rosmaster": "Yahboom Rosmaster expansion board",
    "wheeltec": "WHEELTEC C50X base",
    "vesc": "VESC, over CAN or UART",
    "moteus": "mjbots moteus, over CAN FD",
}
"""The makers' drivers of this package by name. ``hil.drivers.NAME.driver`` has ``DIALECT``."""

EXTENSIONS = Extensions("hil.drivers", (OUR_DRIVER, *SHIPPED))


def driver_names() -> tuple[str, ...]:
    """Return every name that ``[device] driver`` takes: our own firmware's, the makers', those of other packages."""
    return tuple(EXTENSIONS.names())


def dialect(name: str) -> Dialect:
    """Return a maker's protocol. Raises BadInputError if there is none of this name, or it cannot be used."""
    if name in SHIPPED:
        return cast(Dialect, import_module(f"hil.drivers.{name}.driver").DIALECT)
    where = _where(name)
    made = EXTENSIONS.load(name, where)
    if not isinstance(made, Dialect):
        raise BadInputError(f"{where}: {made!r} is no hil.drivers.port.Dialect")
    if not made.wires or not made.wires <= set(get_args(Wire)):
        raise BadInputError(f"{where}: wires = {set(made.wires)}: expected some of {', '.join(get_args(Wire))}")
    if not (isinstance(made.settings, type) and is_dataclass(made.settings)):
        raise BadInputError(f"{where}: settings = {made.settings!r}: expected a dataclass of options")
    return made


def make_settings(name: str, values: Mapping[str, Any], key: str) -> Any:
    """Return the settings of a driver from plain values; ``key`` is what messages call their table.

    Raises BadInputError as ``build`` does, and for a failure of another package's code.
    """
    made = dialect(name)
    with _failures(name, "making its settings"):
        return build(made.settings, values, key)


def make_driver(name: str, settings: Any, robot: RobotFacts) -> Driver:
    """Make a driver. Raises BadInputError for settings that do not fit the robot, and as ``dialect`` does.

    What another package's driver raises later, during a run, becomes a DriverError that names the package.
    """
    made = dialect(name)
    with _failures(name, "making the driver"):
        driver = made.make(settings, robot)
        driver.capabilities  # noqa: B018 - fails here, before anything starts, rather than later
    return driver if name in SHIPPED else cast(Driver, _OutsideDriver(driver, _where_from(name)))


def emulated(name: str) -> "Callable[..., EmulatedMotors[Any]]":
    """Return the class of a maker's emulated device; it is made of settings and the arguments of ``EmulatedMotors``."""
    from hil.drivers.emulated import EmulatedMotors  # with the plant: not for every command

    made = dialect(name)
    with _failures(name, f"importing {made.emulated!r}"):
        kind = resolve_name(made.emulated)
    if not (isinstance(kind, type) and issubclass(kind, EmulatedMotors)):
        raise BadInputError(f"{_where(name)}: {made.emulated!r} is no hil.drivers.emulated.EmulatedMotors")
    return kind


def driver_module(name: str) -> str | None:
    """Return the module in which another package has a driver; None for a shipped or unknown one."""
    return EXTENSIONS.module(name)


_FRAMES = ("ask", "arm", "command", "disarm", "estop", "last_stop", "clear")  # methods that return frames


class _OutsideDriver:
    """Passes all calls to another package's driver; any error but a HilError becomes a DriverError."""

    def __init__(self, driver: Driver, where: str) -> None:
        self._driver = driver
        self._where = where

    def __getattr__(self, name: str) -> Any:
        member = self._call(name, getattr, self._driver, name)
        if not callable(member):
            return member
        call = partial(self._call, name, partial(_frames, member) if name in _FRAMES else member)
        setattr(self, name, call)  # the next call does not come here
        return call

    def _call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except HilError:
            raise
        except Exception as error:
            raise DriverError(str(failure(self._where, name, error))) from error


def _frames(method: Callable[..., Any], *arguments: Any) -> tuple[Any, ...]:
    """Return a method's frames as a tuple: a generator would raise its errors later."""
    return tuple(method(*arguments))


def _where(name: str) -> str:
    return f"device.driver = {name!r}"


def _where_from(name: str) -> str:
    return from_package(_where(name), EXTENSIONS.find(name, _where(name)))


def _failures(name: str, activity: str) -> AbstractContextManager[None]:
    """Turn any error of another package's code into a BadInputError. A shipped driver's errors pass."""
    return nullcontext() if name in SHIPPED else failures_of(_where_from(name), activity)
