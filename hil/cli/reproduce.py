"""``hil reproduce``."""

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from hil.cli.options import Force, Jobs, Json, PictureFormat
from hil.cli.output import batch, print_result, table
from hil.core.extras import need
from hil.core.outputs import existing_files


def reproduce(
    out: Annotated[
        Path | None,
        Option(
            metavar="DIR",
            help="folder for pictures, recordings and summary.json; by default runs/reproduction, "
            "with --quick runs/reproduction-quick",
        ),
    ] = None,
    quick: Annotated[bool, Option("--quick", help="a few short runs instead of all")] = False,
    pictures: PictureFormat = "png",
    jobs: Jobs = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run section IV of the paper and say which of its figures come out, which do not, and why."""
    from hil.batch.reproduction import NotWrittenError
    from hil.batch.reproduction import reproduce as run_reproduction
    from hil.batch.reproduction.runs import failures
    from hil.review.plots import check_format

    kind = check_format("--pictures", pictures)
    out = out or Path("runs/reproduction-quick" if quick else "runs/reproduction")
    not_written: NotWrittenError | None = None
    existing = existing_files(force=force)
    need("plots", "hil reproduce")
    try:
        with batch(as_json=as_json) as progress:
            summary = run_reproduction(
                out, quick=quick, kind=kind, workers=jobs, on_progress=progress, existing=existing
            )
    except NotWrittenError as error:
        not_written, summary = error, error.summary
    print_result(as_json, summary, text_of(summary))
    if not_written is not None:
        sys.stdout.flush()
        raise not_written
    raise typer.Exit(1 if failures(summary) else 0)


def text_of(summary: Mapping[str, Any]) -> Iterator[str]:
    """Yield the tables of a reproduction, then which results of the paper are reproduced and which are not."""
    from hil.batch.reproduction import page

    yield "Assumptions, where the paper gives no value\n"
    for place, what, ours, why in page.assumptions(summary)[1:]:
        yield f"  {place}, {what}: {ours}\n    {why}"
    for title, rows in (
        ("Section IV.A, the circle", page.circle(summary)),
        ("Section IV.B, the experiment: oscillation over latency", page.delay(summary)),
        ("Section IV.B, the experiment: the transition", page.transition(summary)),
    ):
        if len(rows) > 1:
            yield f"\n{title}\n"
            yield from table(rows)
    yield "\nWhat comes out\n"
    for place, claim, paper, ours, tolerance, verdict, why in page.verdicts(summary)[1:]:
        within = "" if tolerance == "-" else f", within {tolerance}"
        yield f"  {verdict}: {claim} ({place}): the paper {paper}, ours {ours}{within}\n    {why}"
    files = ", ".join([*summary["pictures"], *summary["recordings"]])
    yield f"\n{summary['wall_s']:.0f} s; in {summary['folder']}: {files}"
