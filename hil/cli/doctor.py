"""``hil doctor``: whether this machine is ready."""

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import Json, print_json


def doctor(
    folder: Annotated[Path, typer.Option(metavar="FOLDER", help="where recordings are to be written")] = Path("runs"),
    as_json: Json = False,
) -> None:
    """Check this machine and say what to do: exit 1 when there is a problem.

    Kernel, permissions, clock, ports, CAN, disk, viewer, compiler and versions are looked at; nothing is changed.
    """
    from hil.cli import report
    from hil.cli.checks import Verdict, examine

    findings = list(examine(folder))
    if as_json:
        print_json([finding._asdict() for finding in findings])
    else:
        report.print_findings(findings)
    raise typer.Exit(any(finding.verdict is Verdict.PROBLEM for finding in findings))
