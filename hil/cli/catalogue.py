"""``hil catalogue``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.options import Json, Sets, print_json

if TYPE_CHECKING:
    from hil.batch.catalogue import Verdict


def catalogue(
    scenario: Annotated[
        str, typer.Argument(metavar="[SCENARIO]", help="what the faults are put into, 1.3 s of it")
    ] = "circle_speed",
    law: Annotated[
        str | None, typer.Option(metavar="LAW", help="the law to test instead, without the scenario's gains")
    ] = None,
    link: Annotated[
        list[str] | None, typer.Option("--link", metavar="memory|serial|can", help="by default each; may be repeated")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help="only faults of this kind; may be repeated")
    ] = None,
    pairs: Annotated[bool, typer.Option("--pairs", help="all pairs too, over memory unless --link says more")] = False,
    sample: Annotated[
        int | None, typer.Option("--sample", metavar="N", help="only so many of the pairs, chosen by --seed", min=0)
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="which pairs --sample takes")] = 0,
    realtime: Annotated[bool, typer.Option("--realtime", help="a part of them in real time too")] = False,
    sets: Sets = None,
    jobs: Annotated[int | None, typer.Option(metavar="N", help="processes; by default one a processor", min=1)] = None,
    limit_s: Annotated[
        float, typer.Option("--limit", metavar="S", help="a run that takes longer is ended as hung", min=1.0)
    ] = 60.0,
    as_json: Json = False,
) -> None:
    """Run the fault catalogue and judge every run for safety; exit 1 when one is not as it should be."""
    from hil.batch.catalogue import Request
    from hil.batch.catalogue import catalogue as run_catalogue
    from hil.cli import report
    from hil.cli.progress import batch

    laws = [] if law is None else [f"controller.law={law}"]
    sets = [*laws, *(sets or [])]
    request = Request(scenario, sets, link or [], kind or [], report.catalogue_folder(), sample, seed)
    with batch(as_json=as_json) as progress:
        verdicts = run_catalogue(
            request, pairs=pairs, realtime=realtime, workers=jobs, limit_s=limit_s, on_progress=progress
        )
    passed = all(verdict.is_ok for verdict in verdicts)
    if as_json:
        print_json({"passed": passed, "runs": [verdict._asdict() for verdict in verdicts]})
    else:
        _print_verdicts(verdicts)
    raise typer.Exit(0 if passed else 1)


def _print_verdicts(verdicts: Sequence["Verdict"]) -> None:
    """Print a row for each run of the catalogue, and how many were safe."""
    from hil.cli import report

    head = ("fault", "link", "re-arm", "outcome", "applied", "recoveries", "after silence", "wall s", "verdict")
    report.print_table([head, *(_catalogue_row(verdict) for verdict in verdicts)])
    failed = [verdict for verdict in verdicts if not verdict.is_ok]
    wall_s = sum(verdict.wall_s for verdict in verdicts)
    print(f"\n{len(verdicts) - len(failed)} of {len(verdicts)} runs are as they should be, {wall_s:.0f} s of runs")
    for verdict in failed:
        where = "" if verdict.recording is None else f" (hil view {verdict.recording})"
        print(f"  {verdict.fault} over {verdict.link}: {verdict.verdict}{where}")


def _catalogue_row(verdict: "Verdict") -> tuple[str, ...]:
    realtime = ", real time" if verdict.mode == "realtime" else ""
    silence = "-" if verdict.silent_rad_s is None else f"{verdict.silent_rad_s:g} rad/s"
    return (
        verdict.fault,
        verdict.link + realtime,
        "yes" if verdict.rearm else "no",
        verdict.outcome or "-",
        "-" if verdict.applied is None else " ".join(map(str, verdict.applied)),
        "-" if verdict.recoveries is None else str(verdict.recoveries),
        silence,
        f"{verdict.wall_s:.1f}",
        "ok" if verdict.is_ok else verdict.verdict.partition(":")[0],
    )
