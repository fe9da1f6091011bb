"""``hil reproduce``."""

import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.commands.options import Json, interrupt, print_json
from hil.errors import RunInterruptedError

if TYPE_CHECKING:
    from hil.reproduction.runs import Outcome


def reproduce(
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder for pictures, recordings and summary.json")] = Path(
        "runs/reproduction"
    ),
    quick: Annotated[bool, typer.Option("--quick", help="a few short runs instead of all")] = False,
    jobs: Annotated[int | None, typer.Option(metavar="N", help="processes; by default one a processor", min=1)] = None,
    as_json: Json = False,
) -> None:
    """Run section IV of the paper and say which of its figures come out, which do not, and why."""
    from hil import report
    from hil.progress import runs_progress
    from hil.reproduction import reproduce as run_reproduction
    from hil.reproduction.summary import failures

    signal.signal(signal.SIGTERM, interrupt)
    tell = None if as_json or not sys.stderr.isatty() else runs_progress(_trouble)
    try:
        summary = run_reproduction(out, quick=quick, jobs=jobs, tell=tell)
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the runs were ended") from None
    if as_json:
        print_json(summary)
    else:
        report.print_reproduction(summary)
    raise typer.Exit(1 if failures(summary) else 0)


def _trouble(outcome: "Outcome") -> str | None:
    return None if outcome.failure is None else f"{outcome.name}: {outcome.failure}"
