"""``hil reproduce``."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from hil.cli.options import Force, Json, print_json


def reproduce(
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="folder for pictures, recordings and summary.json; by default runs/reproduction, "
            "with --quick runs/reproduction-quick",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="a few short runs instead of all")] = False,
    jobs: Annotated[int | None, typer.Option(metavar="N", help="processes; by default one a processor", min=1)] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run section IV of the paper and say which of its figures come out, which do not, and why."""
    from hil.batch.reproduction import NotWrittenError
    from hil.batch.reproduction import reproduce as run_reproduction
    from hil.batch.reproduction.runs import failures
    from hil.cli.progress import batch
    from hil.core.outputs import existing_files

    if out is None:
        out = Path("runs/reproduction-quick" if quick else "runs/reproduction")
    not_written: NotWrittenError | None = None
    existing = existing_files(force=force)
    try:
        with batch(as_json=as_json) as progress:
            summary = run_reproduction(out, quick=quick, workers=jobs, on_progress=progress, existing=existing)
    except NotWrittenError as error:
        not_written, summary = error, error.summary
    if as_json:
        print_json(summary)
    else:
        print_reproduction(summary)
    if not_written is not None:
        sys.stdout.flush()
        raise not_written
    raise typer.Exit(1 if failures(summary) else 0)


def print_reproduction(summary: Mapping[str, Any]) -> None:
    """Print the tables of a reproduction, then which results of the paper are reproduced and which are not."""
    from hil.batch.reproduction import page
    from hil.cli import report

    print("Assumptions, where the paper gives no value\n")
    for place, what, ours, why in page.assumptions(summary)[1:]:
        print(f"  {place}, {what}: {ours}\n    {why}")
    for title, table in (
        ("Section IV.A, the circle", page.circle(summary)),
        ("Section IV.B, the experiment: oscillation over latency", page.delay(summary)),
        ("Section IV.B, the experiment: the transition", page.transition(summary)),
    ):
        if len(table) > 1:
            print(f"\n{title}\n")
            report.print_table(table)
    print("\nWhat comes out\n")
    for place, claim, paper, ours, tolerance, verdict, why in page.verdicts(summary)[1:]:
        within = "" if tolerance == "-" else f", within {tolerance}"
        print(f"  {verdict}: {claim} ({place}): the paper {paper}, ours {ours}{within}")
        print(f"    {why}")
    files = ", ".join([*summary["pictures"], *summary["recordings"]])
    print(f"\n{summary['wall_s']:.0f} s; in {summary['folder']}: {files}")
