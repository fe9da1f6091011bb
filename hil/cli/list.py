"""``hil list``: the names that a scenario can use."""

import pkgutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from typer import Argument

from hil.cli.options import Json
from hil.cli.output import print_result, table
from hil.core.errors import BadInputError, nearest
from hil.core.options import OptionsError
from hil.core.types import CommandMode

if TYPE_CHECKING:
    from hil.scenario import Scenario

Row = tuple[str, ...]

DRIVER_COLUMNS = ("driver", "wires", "commands", "sensors", "what")


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
    from hil.robot.driver_registry import EXTENSIONS, OUR_DRIVER, dialect
    from hil.scenario import BASE, load

    base = load(BASE)
    ours = ("can, can_fd, serial", "speed with torque, torque", "as the board has", "our own firmware")
    rows: list[tuple[str, ...]] = [(OUR_DRIVER, *ours)]
    shipped = ((name, dialect(name)) for name in EXTENSIONS.ours)
    rows += [(name, *_abilities(name, base), made.description or made.title) for name, made in shipped]
    for name, package, line in EXTENSIONS.lines():
        try:
            abilities = ("",) * 3 if EXTENSIONS.is_shipped(name) else _abilities(name, base)
        except BadInputError as error:
            abilities, line = ("",) * 3, str(error)
        rows.append((name, *abilities, f"{line} ({package})"))
    return rows


def _abilities(name: str, base: "Scenario") -> tuple[str, ...]:
    from hil.robot.driver_registry import dialect
    from hil.scenario import DeviceTable
    from hil.scenario.motor_checks import make_driver

    wires = ", ".join(sorted(dialect(name).wires))
    try:
        can = make_driver(replace(base, device=DeviceTable(name))).capabilities
    except OptionsError:  # it needs settings
        return wires, "as its file says", "as its file says"
    speed = "speed with torque" if can.adds_torque else "speed"
    modes = ", ".join(speed if mode is CommandMode.SPEED else "torque" for mode in sorted(can.modes))
    return wires, "velocity of the body" if can.is_twist else modes, ", ".join(sorted(can.sensors)) or "none"


_LISTS = {
    "signals": (("name", "unit", "meaning"), "hil.core.signals:SIGNALS"),
    "figures": (("figure", "unit", "meaning"), "hil.cli.list:figure_rows"),
    "laws": (("law", "package", "meaning"), "hil.laws.law_registry:laws"),
    "references": (("reference", "package", "meaning"), "hil.references:references"),
    "scenarios": (("scenario", "meaning"), "hil.scenario:shipped_scenarios"),
    "links": (("link", "meaning"), "hil.wire.url:link_forms"),
    "faults": (("kind", "acts on", "target", "value", "meaning"), "hil.cli.list:fault_rows"),
    "drivers": (DRIVER_COLUMNS, "hil.cli.list:driver_rows"),
}
"""Column names of each list, and where its rows are, or the function that makes them: imported when it is called."""


def list_(
    what: Annotated[str, Argument(metavar="WHAT", help=", ".join(_LISTS))],
    as_json: Json = False,
) -> None:
    """Print signals, figures, laws, references, scenarios, links, faults or drivers."""
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
