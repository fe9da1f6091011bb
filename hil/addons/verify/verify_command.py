"""``hil verify``."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hil.cli.options import Jobs, Json, Limit
from hil.cli.output import batch, print_result


def verify(
    suite: Annotated[
        list[str] | None,
        Argument(metavar="SUITE", help="scenarios, pytest files, or folders of them"),
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
    out: Annotated[Path, Option(metavar="DIR", help="the outcomes so far")] = Path("runs/verify"),
    jobs: Jobs = None,
    limit_s: Limit = 600.0,
    as_json: Json = False,
) -> None:
    """Put known defects into a suite of tests, one at a time, and say which it notices; exit 1 when one survives.

    Defects are other start values of the plant, and changes of what passes between the parts of a run: plant, firmware,
    wire, host, estimator, law and motor controllers. For each that nothing noticed, an expectation to paste is printed.
    The same command after an interruption goes on where it was.
    """
    from hil.addons.verify import results
    from hil.addons.verify import verify as engine
    from hil.addons.verify.catalogue import chosen, read_catalogue
    from hil.addons.verify.suite import read_suite

    catalogue = read_catalogue()
    wanted = chosen(catalogue.mutants, room or [], mutant or [], sample, seed)
    members = read_suite(suite or [], baselines=not no_baseline)
    further = 6 * sum(member.tests is None for member in members) if healthy is None else healthy
    request = engine.Request(members, wanted, catalogue.variations, further, out, seed, jobs, limit_s, least / 100.0)
    with batch(as_json=as_json) as progress:
        found = engine.verify(request, progress or (lambda *_: None))
    print_result(as_json, results.as_json(found), results.lines(found))
    raise typer.Exit(0 if found.passed else 1)
