"""``hil doctor``: whether this machine is ready."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from hil.cli.options import Json
from hil.cli.output import print_result
from hil.core.extensions import Extensions

if TYPE_CHECKING:
    from hil.core.findings import Finding


def doctor(
    folder: Annotated[Path, Option(metavar="DIR", help="where recordings are to be written")] = Path("runs"),
    as_json: Json = False,
) -> None:
    """Check this machine and print remedies; exit 1 when there is a problem.

    Kernel, permissions, clock, ports, CAN, disk, viewer, compiler and versions are looked at; nothing is changed.
    """
    from hil.core.findings import Level

    findings = _of_machine(folder)
    print_result(as_json, [finding._asdict() for finding in findings], lines(findings))
    raise typer.Exit(any(finding.verdict is Level.PROBLEM for finding in findings))


def _of_machine(folder: Path) -> "list[Finding]":
    from hil.addons.doctor import checks

    return [
        *checks.check_versions(),
        *checks.check_native(),
        *checks.check_kernel(),
        *checks.check_permissions(),
        *checks.check_lateness(),
        *checks.check_serial(),
        *checks.check_can(),
        *checks.check_disk(folder),
        *(viewer.load()() if (viewer := Extensions("hil.checks").ours.get("viewer")) is not None else ()),
    ]


def lines(findings: "Sequence[Finding]") -> Iterator[str]:
    """Yield the findings, the verdict first, and the remedy below."""
    for verdict, subject, sentence, remedy in findings:
        yield f"{verdict:<8} {subject:<15} {sentence}"
        if remedy:
            yield f"{'':<24} -> {remedy}"
