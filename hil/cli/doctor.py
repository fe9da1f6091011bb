"""``hil doctor``: whether this machine is ready."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from hil.cli.options import Json, ServicePort, ServiceUrl, TokenFile
from hil.cli.output import print_result
from hil.core.errors import BadInputError
from hil.core.extras import need

if TYPE_CHECKING:
    from hil.cli.checks import Finding


def doctor(
    folder: Annotated[Path, Option(metavar="DIR", help="where recordings are to be written")] = Path("runs"),
    service: Annotated[bool, Option("--service", help="examine a running service instead")] = False,
    url: ServiceUrl = None,
    port: ServicePort = None,
    token_file: TokenFile = None,
    clean: Annotated[
        bool, Option("--clean", help="remove caches, locks, tokens and temporary folders that nothing uses; asks first")
    ] = False,
    yes: Annotated[bool, Option("--yes", help="--clean does not ask")] = False,
    as_json: Json = False,
) -> None:
    """Check this machine and print remedies; exit 1 when there is a problem.

    Kernel, permissions, clock, ports, CAN, disk, viewer, compiler and versions are looked at; nothing is changed. With
    --service it is a service that runs on this machine: its robot, loop, link, recording, and clients. With --clean it
    is what hil has left on this machine: listed, and removed after a yes; recordings and audit logs stay.
    """
    if yes and not clean:
        raise BadInputError("--yes answers --clean; add --clean")
    if clean:
        _clean(sure=yes, as_json=as_json)
        return
    from hil.cli.checks import Verdict

    if not service and (url, port, token_file) != (None, None, None):
        raise BadInputError("--url, --port and --token-file choose a service; add --service")
    findings = _of_service(url, port, token_file) if service else _of_machine(folder)
    print_result(as_json, [finding._asdict() for finding in findings], lines(findings))
    raise typer.Exit(any(finding.verdict is Verdict.PROBLEM for finding in findings))


def _clean(*, sure: bool, as_json: bool) -> None:
    from hil.cli.clean import clean

    found, is_removed = clean(sure=sure)
    plain = {"removed": is_removed, "leftovers": [{"path": str(one.path), "what": one.what} for one in found]}
    print_result(
        as_json, plain, [f"{'removed' if is_removed else 'left'}: {len(found)}" if found else "nothing is left"]
    )


def _of_service(url: str | None, port: int | None, token_file: Path | None) -> "list[Finding]":
    need("service", "hil doctor --service")
    from hil.cli.checks.service import check_service
    from hil.service.client import find

    client = find(url, port, token_file)
    return list(check_service(client.status(), client.metrics()))


def _of_machine(folder: Path) -> "list[Finding]":
    from hil.cli.checks import install, ports, realtime, recording

    return [
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


def lines(findings: "Sequence[Finding]") -> Iterator[str]:
    """Yield the findings, the verdict first, and the remedy below."""
    for verdict, subject, sentence, remedy in findings:
        yield f"{verdict:<8} {subject:<15} {sentence}"
        if remedy:
            yield f"{'':<24} -> {remedy}"
