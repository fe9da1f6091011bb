"""The emulated devices by the name of their dialect; each is imported when it is asked for."""

from collections.abc import Callable
from importlib import import_module

from hil.drivers.emulated_motors import EmulatedMotors


def emulated(name: str) -> Callable[..., EmulatedMotors]:
    """Return what makes the emulated device of a dialect, from its settings and the arguments of ``EmulatedMotors``."""
    made: Callable[..., EmulatedMotors] = import_module(f"hil.drivers.{name}.emulated").EMULATED
    return made
