"""The table of `hil list drivers`: the names for ``[device] driver``, and the abilities of each."""

from collections.abc import Sequence
from dataclasses import MISSING, fields

from hil.core.errors import BadInputError
from hil.core.types import CommandMode
from hil.drivers.port import Capabilities, Dialect, RobotFacts
from hil.drivers.registry import EXTENSIONS, OUR_DRIVER, SHIPPED, dialect, make_driver, make_settings
from hil.scenario.load import load
from hil.scenario.motors import robot_facts

COLUMNS = ("driver", "wires", "commands", "feedback", "sensors", "watchdog", "e-stop", "what")

_RATE_HZ = 200
_WATCHDOG = {"set": "set and read back", "fixed": "of its own", "none": "none"}
_OURS = ("can, can_fd, serial", "speed with torque, torque", "loop.rate_hz", "as the board has", "in the firmware")
_AS_MAPPED = ("as its file says",) * 5


def driver_rows() -> Sequence[tuple[str, ...]]:
    """Return a row of COLUMNS for each driver with its default settings: the shipped ones, then other packages'.

    For a driver that cannot be loaded the last column says why, and the other columns are empty.
    """
    facts = robot_facts(load("circle_speed", set={"device.driver": next(iter(SHIPPED)), "loop.rate_hz": _RATE_HZ}))
    rows: list[tuple[str, ...]] = [(OUR_DRIVER, *_OURS, "latched", "our own firmware")]
    rows += [(name, *_abilities(name, facts), what) for name, what in SHIPPED.items()]
    for name, package, line in EXTENSIONS.lines():
        try:
            abilities = ("",) * 6 if name in EXTENSIONS.shipped else _abilities(name, facts)
        except BadInputError as error:
            abilities, line = ("",) * 6, str(error)
        rows.append((name, *abilities, f"{line} ({package})"))
    return rows


def _abilities(name: str, facts: RobotFacts) -> tuple[str, ...]:
    made = dialect(name)
    wires = ", ".join(sorted(made.wires))
    return (wires, *(_words(name, made, facts) if _has_defaults(made) else _AS_MAPPED))


def _has_defaults(made: Dialect) -> bool:
    return not any(
        one.init and one.default is MISSING and one.default_factory is MISSING for one in fields(made.settings)
    )


def _words(name: str, made: Dialect, facts: RobotFacts) -> tuple[str, ...]:
    settings = make_settings(name, {}, "device.motors")
    rates = {}
    for wire in sorted(made.wires):
        at = facts._replace(wire=wire)
        can = make_driver(name, settings, at).capabilities
        slower = make_driver(name, settings, at._replace(period_s=2.0 * at.period_s)).capabilities
        follows = f" at loop.rate_hz = {_RATE_HZ}" if slower.feedback_hz != can.feedback_hz else ""
        rates[wire] = f"{can.feedback_hz:.4g} Hz{follows}"
    same = len(set(rates.values())) == 1
    return (
        ", ".join(_commands(can)),
        rates[wire] if same else ", ".join(f"{wire}: {rate}" for wire, rate in rates.items()),
        ", ".join(sorted(can.sensors)) or "none",
        _WATCHDOG[can.watchdog] + (f" without {made.watchdog_setting}" if made.watchdog_setting else ""),
        "latched" if can.latches_estop else "not latched",
    )


def _commands(can: Capabilities) -> Sequence[str]:
    if can.is_twist:
        return ["velocity of the body"]
    speed = "speed with torque" if can.adds_torque else "speed"
    return [speed if mode is CommandMode.SPEED else "torque" for mode in sorted(can.modes)]
