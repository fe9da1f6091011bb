"""Finds a maker's protocol by the name in ``[device] driver``; each is imported when it is first used."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import is_dataclass
from functools import partial
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, cast, get_args

from hil.core.errors import BadInputError, HilError
from hil.core.extensions import Extensions, failure, from_package
from hil.core.options import build

if TYPE_CHECKING:
    from hil.robot.driver import Dialect, RobotFacts
    from hil.robot.driver import Driver as Driver
    from hil.robot.virtual import ClockedNode

OUR_DRIVER = "stm32"
"""``[device] driver`` of a robot with our own firmware."""

EXTENSIONS = Extensions("hil.drivers", (OUR_DRIVER,))


def driver_names() -> tuple[str, ...]:
    """Return every name that ``[device] driver`` takes: our own firmware's, the makers', those of other packages."""
    return tuple(EXTENSIONS.names())


def dialect(name: str) -> "Dialect":
    """Return a maker's protocol. Raises BadInputError if there is none of this name, or it cannot be used."""
    from hil.robot.driver import Dialect, Wire  # only for a robot with third-party motor controllers

    where = _where(name)
    made = EXTENSIONS.load(name, where)
    if not isinstance(made, Dialect):
        raise BadInputError(f"{where}: {made!r} is no hil.robot.driver.Dialect")
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


def make_driver(name: str, settings: Any, robot: "RobotFacts") -> "Driver":
    """Make a driver. Raises BadInputError for settings that do not fit the robot, and as ``dialect`` does.

    What another package's driver raises later, during a run, becomes a DriverError that names the package.
    """
    made = dialect(name)
    with _failures(name, "making the driver"):
        driver = made.make(settings, robot)
        driver.capabilities  # noqa: B018 - fails here, before anything starts, rather than later
    if EXTENSIONS.is_shipped(name):
        return driver
    where = _where(name)
    return cast("Driver", _OutsideDriver(driver, from_package(where, EXTENSIONS.find(name, where))))


def emulated(name: str) -> "Callable[..., ClockedNode]":
    """Return the class of a maker's emulated device; it is made of settings and the arguments of ``HostNode``."""
    from hil.robot.virtual import ClockedNode  # with the plant: not for every command

    made = dialect(name)
    with _failures(name, f"importing {made.emulated!r}"):
        kind = resolve_name(made.emulated)
    if not (isinstance(kind, type) and issubclass(kind, ClockedNode)):
        raise BadInputError(f"{_where(name)}: {made.emulated!r} is no hil.robot.virtual.ClockedNode")
    return cast("Callable[..., ClockedNode]", kind)


def driver_module(name: str) -> str | None:
    """Return the module in which another package has a driver; None for a shipped or unknown one."""
    return EXTENSIONS.module(name)


_FRAMES = ("ask", "arm", "command", "disarm", "estop", "last_stop", "clear")  # methods that return frames


class _OutsideDriver:
    """Passes all calls to another package's driver; any error but a HilError becomes a DriverError."""

    def __init__(self, driver: "Driver", where: str) -> None:
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
            from hil.robot.driver import DriverError

            raise DriverError(str(failure(self._where, name, error))) from error


def _frames(method: Callable[..., Any], *arguments: Any) -> tuple[Any, ...]:
    """Return a method's frames as a tuple: a generator would raise its errors later."""
    return tuple(method(*arguments))


def _where(name: str) -> str:
    return f"device.driver = {name!r}"


def _failures(name: str, activity: str) -> AbstractContextManager[None]:
    return EXTENSIONS.failures(name, _where(name), activity)
