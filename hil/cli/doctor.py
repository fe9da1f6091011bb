"""``hil doctor``: whether this machine is ready."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from hil.cli.options import Json
from hil.cli.output import print_result

if TYPE_CHECKING:
    from hil.cli.checks import Finding


def doctor(
    folder: Annotated[Path, Option(metavar="FOLDER", help="where recordings are to be written")] = Path("runs"),
    as_json: Json = False,
) -> None:
    """Check this machine and print remedies; exit 1 when there is a problem.

    Kernel, permissions, clock, ports, CAN, disk, viewer, compiler and versions are looked at; nothing is changed.
    """
    from hil.cli.checks import Verdict, install, ports, realtime, recording

    findings = [
        *install.check_versions(),
        *install.check_native(),
        *realtime.check_kernel(),
        *realtime.check_permissions(),
        *realtime.check_clock(),
        *ports.check_serial(),
        *ports.check_can(),
        *recording.check_disk(folder),
        *recording.check_viewer(),
    ]
    print_result(as_json, [finding._asdict() for finding in findings], lines(findings))
    raise typer.Exit(any(finding.verdict is Verdict.PROBLEM for finding in findings))


def lines(findings: "Sequence[Finding]") -> Iterator[str]:
    """Yield the findings, the verdict first, and the remedy below."""
    for verdict, subject, sentence, remedy in findings:
        yield f"{verdict:<8} {subject:<15} {sentence}"
        if remedy:
            yield f"{'':<24} -> {remedy}"
