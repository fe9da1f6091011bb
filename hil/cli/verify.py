"""``hil verify``."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hil.cli.options import Jobs, Json, Limit
from hil.cli.output import batch, print_result
from hil.core.errors import BadInputError
from hil.core.printable import printable


def verify(
    suite: Annotated[
        list[str] | None,
        Argument(metavar="SUITE", help="scenarios, pytest files or folders; by default the shipped ones"),
    ] = None,
    mutants: Annotated[
        list[Path] | None, Option("--mutants", metavar="FILE", help="further mutants and variations; repeatable")
    ] = None,
    room: Annotated[list[str] | None, Option(metavar="ROOM", help="only mutants of this room; repeatable")] = None,
    mutant: Annotated[list[str] | None, Option(metavar="ID", help="only this mutant; repeatable")] = None,
    sample: Annotated[
        int | None, Option(metavar="N", help="only N mutants, chosen by --seed; 0 runs the suite alone", min=0)
    ] = None,
    seed: Annotated[int, Option(metavar="N", help="chooses the sample and the fresh seeds", min=0)] = 0,
    healthy: Annotated[
        int | None,
        Option(metavar="N", help="healthy runs with fresh seeds and variations; by default 6 a scenario", min=0),
    ] = None,
    least: Annotated[
        float, Option(metavar="PERCENT", help="of the mutants that have to be noticed for exit code 0", min=0, max=100)
    ] = 100.0,
    no_baseline: Annotated[bool, Option("--no-baseline", help="judge by expectations and [allow] alone")] = False,
    out: Annotated[Path, Option(metavar="DIR", help="the page, and what is done so far")] = Path("runs/verify"),
    jobs: Jobs = None,
    limit_s: Limit = 600.0,
    as_json: Json = False,
) -> None:
    """Put known defects into a suite of tests, one at a time, and say which it notices; exit 1 when one survives.

    Defects are applied to the plant, the firmware, the wire, the host, estimators, laws and motor controllers, without
    a change of any file. For each that nothing noticed, an expectation to paste is printed. The same command after an
    interruption goes on where it was.
    """
    from hil.batch.verify import page as pages
    from hil.batch.verify import verify as engine
    from hil.batch.verify.catalogue import chosen, read_catalogue
    from hil.batch.verify.suite import read_suite
    from hil.core.extras import need

    if not suite:
        need("dbc,mpc", "the shipped suite")
    catalogue = read_catalogue(mutants or [])
    wanted = chosen(catalogue.mutants, room or [], mutant or [], sample, seed)
    members = read_suite(suite or [], baselines=not no_baseline)
    further = 6 * sum(member.tests is None for member in members) if healthy is None else healthy
    request = engine.Request(members, wanted, catalogue.variations, further, out, seed, jobs, limit_s, least / 100.0)
    with batch(as_json=as_json) as progress:
        found = engine.verify(request, progress or (lambda *_: None))
    file = out / pages.PAGE
    try:
        file.write_text(printable(pages.page(found)), encoding="utf-8")
    except OSError as error:
        raise BadInputError(
            f"--out {out}: {file.name} cannot be written ({error.strerror}); make room for it"
        ) from error
    print_result(as_json, pages.as_json(found), pages.lines(found, file))
    raise typer.Exit(0 if found.passed else 1)
