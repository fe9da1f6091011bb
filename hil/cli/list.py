"""``hil list``: the names that a scenario can use."""

import pkgutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument

from hil.cli.options import Json
from hil.cli.output import print_result, table
from hil.core.errors import BadInputError, nearest
from hil.core.options import options_of
from hil.core.types import CommandMode

if TYPE_CHECKING:
    from hil.drivers.port import Capabilities, Dialect, RobotFacts

Row = tuple[str, ...]

DRIVER_COLUMNS = ("driver", "wires", "commands", "feedback", "sensors", "watchdog", "e-stop", "what")

_RATE_HZ = 200
_WATCHDOG = {"set": "set and read back", "fixed": "of its own", "none": "none"}
_OURS = ("can, can_fd, serial", "speed with torque, torque", "loop.rate_hz", "as the board has", "in the firmware")
_AS_MAPPED = ("as its file says",) * 5


def fault_rows() -> Iterable[Row]:
    """Return a row for each kind of fault."""
    from hil.faults.kinds import kinds as fault_kinds

    return ((k.name, k.acts_on, k.target_words.replace("`", ""), k.unit, k.meaning) for k in fault_kinds())


def figure_rows() -> Iterable[Row]:
    """Return a row for each figure of a run that an expectation can name."""
    from hil.core.signals import unit_of
    from hil.judge.expectations import figures_by_key

    found = figures_by_key().items()
    return ((key, figure.unit if figure.scale == 1 else unit_of(key), figure.meaning) for key, figure in found)


def driver_rows() -> Sequence[tuple[str, ...]]:
    """Return a row of DRIVER_COLUMNS for each driver with its default settings: the shipped ones, then other packages'.

    For a driver that cannot be loaded the last column says why, and the other columns are empty.
    """
    from hil.drivers.registry import EXTENSIONS, OUR_DRIVER, SHIPPED
    from hil.scenario import BASE, load
    from hil.scenario.motors import robot_facts

    facts = robot_facts(load(BASE, set={"device.driver": next(iter(SHIPPED)), "loop.rate_hz": _RATE_HZ}))
    rows: list[tuple[str, ...]] = [(OUR_DRIVER, *_OURS, "latched", "our own firmware")]
    rows += [(name, *_abilities(name, facts), what) for name, what in SHIPPED.items()]
    for name, package, line in EXTENSIONS.lines():
        try:
            abilities = ("",) * 6 if name in EXTENSIONS.shipped else _abilities(name, facts)
        except BadInputError as error:
            abilities, line = ("",) * 6, str(error)
        rows.append((name, *abilities, f"{line} ({package})"))
    return rows


def _abilities(name: str, facts: "RobotFacts") -> tuple[str, ...]:
    from hil.drivers.registry import dialect

    made = dialect(name)
    settings: Any = made.settings
    needs_settings = any(option.default is MISSING for option in options_of(settings).values())
    return (", ".join(sorted(made.wires)), *(_AS_MAPPED if needs_settings else _words(name, made, facts)))


def _words(name: str, made: "Dialect", facts: "RobotFacts") -> tuple[str, ...]:
    from hil.drivers.registry import make_driver, make_settings

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
        _commands(can),
        rates[wire] if same else ", ".join(f"{wire}: {rate}" for wire, rate in rates.items()),
        ", ".join(sorted(can.sensors)) or "none",
        _WATCHDOG[can.watchdog] + (f" without {made.watchdog_setting}" if made.watchdog_setting else ""),
        "latched" if can.latches_estop else "not latched",
    )


def _commands(can: "Capabilities") -> str:
    if can.is_twist:
        return "velocity of the body"
    speed = "speed with torque" if can.adds_torque else "speed"
    return ", ".join(speed if mode is CommandMode.SPEED else "torque" for mode in sorted(can.modes))


_LISTS = {
    "signals": (("name", "unit", "meaning"), "hil.core.signals:SIGNALS"),
    "figures": (("figure", "unit", "meaning"), "hil.cli.list:figure_rows"),
    "laws": (("law", "package", "meaning"), "hil.laws.registry:laws"),
    "references": (("reference", "package", "meaning"), "hil.references:references"),
    "scenarios": (("scenario", "meaning"), "hil.scenario:shipped_scenarios"),
    "suite": (("scenario", "meaning"), "hil.scenario:suite_scenarios"),
    "links": (("link", "meaning"), "hil.wire.url:link_forms"),
    "faults": (("kind", "acts on", "target", "value", "meaning"), "hil.cli.list:fault_rows"),
    "drivers": (DRIVER_COLUMNS, "hil.cli.list:driver_rows"),
}
"""Column names of each list, and where its rows are, or the function that makes them: imported when it is called."""


def _complete(incomplete: str) -> list[str]:
    return [name for name in _LISTS if name.startswith(incomplete)]


def list_(
    what: Annotated[str, Argument(metavar="WHAT", help=", ".join(_LISTS), autocompletion=_complete)],
    as_json: Json = False,
) -> None:
    """Print signals, figures, laws, references, scenarios, those of the suite, links, faults or drivers."""
    header, rows = listing(what)
    print_result(as_json, [dict(zip(header, row, strict=True)) for row in rows], table([header, *rows]))


def listing(what: str) -> tuple[Row, list[Row]]:
    """Return the column names and the rows of ``hil list``. Raises BadInputError for an unknown list."""
    if what not in _LISTS:
        raise BadInputError(f"there is no list of {what!r}{nearest(what, _LISTS)}")
    header, place = _LISTS[what]
    rows = pkgutil.resolve_name(place)
    rows = rows() if callable(rows) else rows
    return header, list(rows.items() if isinstance(rows, Mapping) else rows)
