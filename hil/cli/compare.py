"""``hil compare``."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from typer import Argument, Option

from hil.cli.options import LAW, LAW_HELP, Force, Jobs, Json, Limit, PictureFormat, Seed, Sets
from hil.cli.output import batch, next_command, print_result, table
from hil.core.errors import BadInputError
from hil.core.extras import need
from hil.core.outputs import Existing, check_free, existing_files
from hil.core.printable import command

if TYPE_CHECKING:
    from hil.batch.comparison import Comparison
    from hil.batch.comparison.robust import Robustness


_BESIDE_ROBUST = {
    "--torque": ", or fix it for all: --set robot.torque_limit_n_m=N·M --set firmware.torque_limit_n_m=N·M",
    "--drive": ", or fix it for all: --set plant.start.drive=torque (or current, voltage)",
    "--estimator": ", or fix it for all: --set estimator.source=NAME",
    "--contact": ", or fix it for all: --set plant.start.contact=NAME",
    "--quick": "; fewer cases are quicker",
    "--out": ": it draws no pictures; --json has every run",
    "--markdown": ": it writes no page; its table is printed, and --json has every run",
}
"""What to do in the place of an option that --robust does not take."""


def compare(
    laws_and_scenario: Annotated[
        list[str],
        Argument(
            metavar="LAW|SCENARIO",
            help=f"laws, then the scenario; each law {LAW}: {LAW_HELP}; by default all that are shipped",
        ),
    ],
    torque: Annotated[
        list[float] | None, Option(metavar="N·M", help="limit of a wheel; by default 5 and 1.8; repeatable")
    ] = None,
    drive: Annotated[list[str] | None, Option(metavar="ideal|motors", help="by default both; repeatable")] = None,
    estimator: Annotated[list[str] | None, Option(metavar="NAME", help="by default the scenario's; repeatable")] = None,
    contact: Annotated[
        list[str] | None, Option(metavar="rigid|slip", help="by default the scenario's; repeatable")
    ] = None,
    quick: Annotated[bool, Option("--quick", help="nominal runs alone")] = False,
    robust: Annotated[
        int | None, Option(metavar="N", min=1, help="instead of tables: N random cases, and how many each law holds")
    ] = None,
    out: Annotated[Path | None, Option(metavar="DIR", help="pictures and every run as CSV")] = None,
    pictures: PictureFormat = "png",
    markdown: Annotated[Path | None, Option(metavar="FILE", help="a page with all tables")] = None,
    jobs: Jobs = None,
    limit_s: Limit = 120.0,
    seed: Seed = None,
    sets: Sets = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run laws under the same conditions and print one table for each; exit 1 when a run failed."""
    from hil.batch.comparison import Request, page
    from hil.batch.comparison import compare as run_comparison
    from hil.batch.comparison.conditions import DRIVES, TORQUES_N_M
    from hil.batch.output import prepare_folder
    from hil.review.plots import check_format

    *laws, scenario = laws_and_scenario
    if robust is not None:
        others = {"--torque": torque, "--drive": drive, "--estimator": estimator, "--contact": contact, "--out": out}
        _refuse_beside_robust(others | {"--quick": quick, "--markdown": markdown})
        _try_in_cases(laws, scenario, robust, sets or [], seed, jobs, limit_s, as_json=as_json)
    request = Request(
        laws,
        scenario,
        sets or [],
        seed,
        torque or TORQUES_N_M,
        drive or list(DRIVES),
        estimator or [],
        contact or [],
        quick=quick,
        curves=out is not None,
    )
    existing = existing_files(force=force)
    kind = check_format("--pictures", pictures)
    if out is not None:
        need("plots", "--out")
        prepare_folder(out, page.older, "comparison", existing)
    if markdown is not None:
        check_free("page", markdown, existing)
    with batch(as_json=as_json) as progress:
        comparison = run_comparison(request, workers=jobs, limit_s=limit_s, on_progress=progress)
    # Print the results before writing files: they took long, and a disk may be full.
    print_result(as_json, comparison.plain(), _lines(comparison))
    sys.stdout.flush()
    _write(comparison, out, kind, markdown, existing)
    raise typer.Exit(1 if comparison.has_failed else 0)


def _refuse_beside_robust(others: Mapping[str, object]) -> None:
    for name, value in others.items():
        if value:
            raise BadInputError(f"{name}: --robust draws its own cases; leave {name} out{_BESIDE_ROBUST[name]}")


def _try_in_cases(
    laws: Sequence[str],
    scenario: str,
    count: int,
    sets: Sequence[str],
    seed: int | None,
    jobs: int | None,
    limit_s: float,
    *,
    as_json: bool,
) -> NoReturn:
    """Run laws in random cases, print how they held, and exit."""
    from hil.batch.comparison.robust import try_laws

    with batch(as_json=as_json) as progress:
        tried = try_laws(laws, scenario, count, sets, seed, workers=jobs, limit_s=limit_s, on_progress=progress)
    print_result(as_json, tried.plain(), _case_lines(tried))
    raise typer.Exit(1 if tried.has_failed else 0)


def _case_lines(tried: "Robustness") -> Iterator[str]:
    """Yield the table, and for each case that a law did not hold, what happened and the command that repeats it."""
    yield from table(list(tried.rows()))
    for trial in tried.trials:
        if trial.verdict != "held":
            reason = f": {trial.outcome.reason}" if trial.outcome.reason else ""
            follows = "" if trial.case.can_follow else " (which wheels cannot follow)"
            yield f"\n{trial.entry.label}, case {trial.case.number}{follows}, {trial.verdict}{reason}"
            yield f"  {next_command(*trial.command)}"


def _write(comparison: "Comparison", out: Path | None, kind: str, markdown: Path | None, existing: Existing) -> None:
    """Write the files. If one cannot be written, the others still are; then raises BadInputError for the first."""
    from hil.batch.comparison import page
    from hil.batch.comparison.pictures import draw
    from hil.batch.output import deferred, remove

    pictures: list[Path] = []
    errors: list[BadInputError] = []
    if out is not None:
        with deferred(errors):
            remove(page.older(out) if existing == "replace" else [])
            page.write_csv(comparison, out / "comparison.csv")
        with deferred(errors):
            draw(comparison, out, kind, pictures)
    if markdown is not None:
        with deferred(errors):
            page.write_markdown(comparison, markdown, command("hil", *sys.argv[1:]), pictures, existing)
    if errors:
        raise errors[0]


def _lines(comparison: "Comparison") -> Iterator[str]:
    """Yield a table for each condition, and below it why figures are missing."""
    from hil.batch.comparison import page

    for number, (title, rows, notes) in enumerate(page.terminal(comparison)):
        yield title if number == 0 else f"\n{title}"
        yield from table(rows)
        yield from (f"  {note}" for note in notes)
    yield f"\n{comparison.limiter}"
    if len(comparison.rows[0].runs) > 1:
        yield "nominal / worst over mass and friction of the plant; less is better in every column"
