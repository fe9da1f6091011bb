"""The table of `hil list drivers`: the names for ``[device] driver``, and the abilities of each."""

from collections.abc import Sequence
from dataclasses import MISSING, fields

from hil.core.options import build
from hil.core.types import CommandMode
from hil.drivers.port import Capabilities, Dialect, RobotFacts
from hil.drivers.registry import DIALECTS, OUR_DRIVER, dialect
from hil.scenario.load import load
from hil.scenario.motors import robot_facts

COLUMNS = ("driver", "wires", "commands", "feedback", "sensors", "watchdog", "e-stop", "what")

_RATE_HZ = 200
_WATCHDOG = {"set": "set and read back", "fixed": "of its own", "none": "none"}
_OURS = ("can, can_fd, serial", "speed with torque, torque", "loop.rate_hz", "as the board has", "in the firmware")
_AS_MAPPED = ("as its file says",) * 5


def driver_rows() -> Sequence[tuple[str, ...]]:
    """Return a row of COLUMNS for each driver, with its default settings."""
    facts = robot_facts(load("circle_speed", set={"device.driver": next(iter(DIALECTS)), "loop.rate_hz": _RATE_HZ}))
    rows: list[tuple[str, ...]] = [(OUR_DRIVER, *_OURS, "latched", "our own firmware")]
    for name, what in DIALECTS.items():
        made = dialect(name)
        wires = ", ".join(sorted(made.wires))
        rows.append((name, wires, *(_words(made, facts) if _has_defaults(made) else _AS_MAPPED), what))
    return rows


def _has_defaults(made: Dialect) -> bool:
    return not any(
        one.init and one.default is MISSING and one.default_factory is MISSING for one in fields(made.settings)
    )


def _words(made: Dialect, facts: RobotFacts) -> tuple[str, ...]:
    settings = build(made.settings, {}, "device.motors")
    rates = {}
    for wire in sorted(made.wires):
        at = facts._replace(wire=wire)
        can = made.make(settings, at).capabilities
        slower = made.make(settings, at._replace(period_s=2.0 * at.period_s)).capabilities
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
