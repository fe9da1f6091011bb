"""``hil doctor``: whether this machine is ready."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.checks import Finding, Verdict, install, ports, realtime, recording
from hil.cli.options import Json, print_json


def doctor(
    folder: Annotated[Path, typer.Option(metavar="FOLDER", help="where recordings are to be written")] = Path("runs"),
    as_json: Json = False,
) -> None:
    """Check this machine and print remedies; exit 1 when there is a problem.

    Kernel, permissions, clock, ports, CAN, disk, viewer, compiler and versions are looked at; nothing is changed.
    """
    findings = list(examine(folder))
    if as_json:
        print_json([finding._asdict() for finding in findings])
    else:
        print_findings(findings)
    raise typer.Exit(any(finding.verdict is Verdict.PROBLEM for finding in findings))


def examine(folder: Path) -> Iterator[Finding]:
    """Yield the findings of every check; ``folder`` is where recordings are to be written."""
    yield from install.check_versions()
    yield from install.check_native()
    yield from realtime.check_kernel()
    yield from realtime.check_permissions()
    yield from realtime.check_clock()
    yield from ports.check_serial()
    yield from ports.check_can()
    yield from recording.check_disk(folder)
    yield from recording.check_viewer()


def print_findings(findings: Sequence[Finding]) -> None:
    """Print the findings, the verdict first, and the remedy below."""
    for verdict, subject, sentence, remedy in findings:
        print(f"{verdict:<8} {subject:<15} {sentence}")
        if remedy:
            print(f"{'':<24} -> {remedy}")
