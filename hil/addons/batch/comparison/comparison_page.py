"""``hil compare``: the command, and what a comparison gave, as tables and plots."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from typer import Argument, Option

from hil.addons.batch.columns import Column, shown_columns
from hil.addons.batch.comparison.comparison import (
    DRIVES,
    FRICTIONS,
    MASS_FACTORS,
    TORQUES_N_M,
    Comparison,
    Request,
    Row,
    compare,
)
from hil.addons.batch.comparison.robust import CSV, Robust
from hil.addons.batch.comparison.robust import plots as plots_of_cases
from hil.addons.batch.comparison.robust import results as results_of_cases
from hil.addons.batch.job import Signals
from hil.addons.batch.results_page import Html, Page, Pictures, Plot, Results, Table, finish
from hil.cli.options import LAW, LAW_HELP, Force, Jobs, Json, Limit, Seed, Sets
from hil.cli.output import batch
from hil.core.errors import BadInputError, RunInterruptedError
from hil.core.extras import missing_of
from hil.core.outputs import write_whole
from hil.pages.plots import (
    Curve,
    colour_of,
    draw_error,
    draw_path,
    is_dashed,
)
from hil.record.files import new_in_runs

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Labelled = Sequence[tuple[str, Signals]]
"""Curves of runs with their labels."""


def command(
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
    out: Annotated[
        Path | None,
        Option(metavar="DIR", help="where --robust keeps its runs, continued if begun; by default new in runs"),
    ] = None,
    html: Html = None,
    pictures: Pictures = None,
    jobs: Jobs = None,
    limit_s: Limit = 120.0,
    seed: Seed = None,
    sets: Sets = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run laws under the same conditions and print one table for each; exit 1 when a run failed."""
    *laws, scenario = laws_and_scenario
    others = {"--torque": torque, "--drive": drive, "--estimator": estimator, "--contact": contact, "--quick": quick}
    if robust is not None:
        if given := [name for name, value in others.items() if value]:
            raise BadInputError(
                f"{given[0]}: --robust draws its own cases; leave {given[0]} out, or fix a key for all of them with "
                "--set"
            )
        cases = Robust(laws, scenario, robust, sets or [], seed)
        folder = out if out is not None else new_in_runs(f"robust-{cases.base.name}", "", "name another with --out")
        _try(cases, folder, html, pictures, jobs, limit_s, force=force, as_json=as_json)
    if out is not None:
        raise BadInputError(f"--out {out}: it keeps the runs of --robust N; give that too, or leave it out")
    page = Page.of(html, pictures, force=force)
    with batch(as_json=as_json) as progress:
        conditions = (torque or TORQUES_N_M, drive or list(DRIVES), estimator or [], contact or [])
        request = Request(laws, scenario, sets or [], seed, *conditions, quick=quick, curves=page.file is not None)
        comparison = compare(request, workers=jobs, limit_s=limit_s, on_progress=progress)
    found = results(comparison)
    finish(found, page, as_json=as_json)
    raise typer.Exit(0 if found.passed else 1)


def _try(
    cases: Robust,
    folder: Path,
    html: Path | None,
    pictures: str | None,
    jobs: int | None,
    limit_s: float,
    *,
    force: bool,
    as_json: bool,
) -> NoReturn:
    """Do the runs of random cases, show what is done even if interrupted, and exit.

    Table and page are written anew from the folder's rows. Without the packages for plots there is no page, unless it
    is asked for.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"folder {folder}: it cannot be made ({error.strerror}); name another with --out"
        ) from error
    own_page = None if pictures is None and missing_of("plots") else folder / "report.html"
    page = Page.of(html or own_page, pictures, force=force or html is None)
    total, is_interrupted = len(cases.trials), False
    with batch(as_json=as_json) as progress:
        try:
            for _ in cases.perform(folder, jobs, limit_s):
                if progress is not None:
                    progress(cases.done, total, None, cases.failed)
        except KeyboardInterrupt:
            is_interrupted = True
            cases.read(folder)
    found = results_of_cases(cases.base, cases.trials, folder, plots_of_cases(folder))
    write_whole(folder / CSV, cases.csv().encode(), "table", "replace")
    finish(found, page, as_json=as_json)
    if is_interrupted:
        raise RunInterruptedError(
            f"interrupted; {cases.done} of {total} runs are done and saved in {folder}; run the same command with "
            f"--out {folder} to continue"
        )
    raise typer.Exit(0 if found.passed else 1)


def results(comparison: Comparison) -> Results:
    """Return what a comparison gave."""
    failed, runs = comparison.failed, sum(len(row.runs) for row in comparison.rows)
    about = [comparison.limiter]
    if len(comparison.rows[0].runs) > 1:
        masses, frictions = (" and ".join(f"{one:g}" for one in values) for values in (MASS_FACTORS, FRICTIONS))
        about.append(
            f"nominal / worst over mass (times {masses}) and friction ({frictions}) of the plant; less is better in "
            "every column"
        )
    return Results(
        f"Laws compared under {comparison.scenario}, seed {comparison.seed}",
        not failed,
        f"{failed} of {runs} runs failed" if failed else f"{runs} runs, none of which failed",
        about,
        tables(comparison),
        list(plots(comparison)),
        comparison.plain(),
    )


def tables(comparison: Comparison) -> list[Table]:
    """Return the table of each condition; a cell has the figure of the nominal run, and the worst of all."""
    columns = shown_columns()
    head = ("law", *(f"{one.head} {one.unit}" for one in columns))
    about = "; ".join(f"{one.head}: {one.meaning}" for one in columns)
    found: list[Table] = []
    for condition, rows in comparison.by_condition().items():
        cells = [(row.entry.title(condition.mode), *(_cell(column, row) for column in columns)) for row in rows]
        notes = [f"{row.entry.label}: {note}" for row in rows for note in row.notes()]
        found.append(Table(condition.words, [head, *cells], notes, "" if found else about, range(1, len(head))))
    return found


def _cell(column: Column, row: Row) -> str:
    over = ("nominal", "worst") if len(row.runs) > 1 else ("nominal",)
    return " / ".join(column.text(row.worst(column.name, one)) for one in over)


def plots(comparison: Comparison) -> Iterator[Plot]:
    """Yield a picture of path and error for each condition."""
    # A law that has no curves here keeps its colour for the other pictures.
    numbers = {label: n for n, label in enumerate(dict.fromkeys(row.entry.label for row in comparison.rows))}
    for condition, rows in comparison.by_condition().items():
        if runs := [(row.entry.label, row.curves) for row in rows if row.curves is not None]:
            draw = partial(_draw_error, runs=runs, numbers=numbers)
            yield Plot(f"error-{condition.slug}", draw, 1, 2, (12.0, 4.5), f"Path and error, {condition.words}")


def _draw_error(axes: "list[Axes]", runs: Labelled, numbers: Mapping[str, int]) -> None:
    def curves(x: str, y: str) -> list[Curve]:
        each = ((label, signals, numbers[label]) for label, signals in runs)
        return [Curve(label, one[x], one[y], colour_of(number), is_dashed(number)) for label, one, number in each]

    path, error = axes
    reference = runs[0][1]
    ways = curves("truth.x_m", "truth.y_m")
    draw_path(path, Curve("reference", reference["reference.x_m"], reference["reference.y_m"]), ways)
    draw_error(error, curves("loop.t_s", "error.planar_m"))
