"""``hil list``: the names that a scenario can use."""

from collections.abc import Sequence
from typing import Annotated

import typer

from hil.cli.options import Json, print_json
from hil.core.errors import BadInputError, nearest


def list_(
    what: Annotated[str, typer.Argument(metavar="signals|laws|references|scenarios|links|faults|drivers")],
    as_json: Json = False,
) -> None:
    """Print the signals, laws, references, scenarios, forms of links, kinds of faults or drivers."""
    from hil.cli import report

    header, rows = listing(what)
    if as_json:
        print_json([dict(zip(header, row, strict=True)) for row in rows])
    else:
        report.print_table([header, *rows])


def listing(what: str) -> tuple[tuple[str, ...], Sequence[tuple[str, ...]]]:
    """Return the column names and the rows of ``hil list``. Raises BadInputError for an unknown list."""
    if what == "signals":
        from hil.core.signals import SIGNALS

        return SIGNALS[0]._fields, [(s.name, s.unit, s.meaning) for s in SIGNALS]
    if what == "laws":
        from hil.laws.registry import laws

        return ("law", "package", "meaning"), laws()
    if what == "references":
        from hil.references import references

        return ("reference", "package", "meaning"), references()
    if what == "scenarios":
        from hil.scenario import shipped

        return ("scenario", "meaning"), list(shipped().items())
    if what == "links":
        from hil.wire.url import link_forms

        return ("link", "meaning"), list(link_forms().items())
    if what == "faults":
        from hil.faults.kinds import kinds as fault_kinds

        rows = [(k.name, k.acts_on, k.target_words.replace("`", ""), k.unit, k.meaning) for k in fault_kinds()]
        return ("kind", "acts on", "target", "value", "meaning"), rows
    if what == "drivers":
        from hil.scenario.drivers import COLUMNS, driver_rows

        return COLUMNS, driver_rows()
    known = ("signals", "laws", "references", "scenarios", "links", "faults", "drivers")
    raise BadInputError(f"there is no list of {what!r}{nearest(what, known)}")
