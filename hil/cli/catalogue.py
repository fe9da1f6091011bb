"""``hil catalogue``."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hil.cli.options import Jobs, Json, Limit, Sets
from hil.cli.output import batch, next_command, print_result, table

if TYPE_CHECKING:
    from hil.batch.catalogue import Verdict


def catalogue(
    scenario: Annotated[str, Argument(metavar="SCENARIO", help="gets the faults; 1.3 s of it run")] = "circle_speed",
    law: Annotated[str | None, Option(metavar="LAW", help="the law to test instead, with its default gains")] = None,
    link: Annotated[list[str] | None, Option(metavar="memory|serial|can", help="by default all; repeatable")] = None,
    kind: Annotated[list[str] | None, Option(metavar="KIND", help="only faults of this kind; repeatable")] = None,
    pairs: Annotated[bool, Option("--pairs", help="all pairs too, over memory unless --link says more")] = False,
    sample: Annotated[int | None, Option(metavar="N", help="only N of the pairs, chosen by --seed", min=0)] = None,
    seed: Annotated[int, Option(metavar="N", help="which pairs --sample takes")] = 0,
    realtime: Annotated[bool, Option("--realtime", help="a part of them in real time too")] = False,
    sets: Sets = None,
    jobs: Jobs = None,
    limit_s: Limit = 60.0,
    as_json: Json = False,
) -> None:
    """Run the fault catalogue and judge every run for safety; exit 1 when one is not as it should be."""
    from hil.batch import catalogue as engine
    from hil.record.files import new_in_runs

    sets = [*([] if law is None else [f"controller.law={law}"]), *(sets or [])]
    recordings = new_in_runs("catalogue", "", "go where you may write")
    request = engine.Request(scenario, sets, link or [], kind or [], recordings, sample, seed)
    with batch(as_json=as_json) as progress:
        verdicts = engine.catalogue(
            request, pairs=pairs, realtime=realtime, workers=jobs, limit_s=limit_s, on_progress=progress
        )
    passed = all(verdict.is_ok for verdict in verdicts)
    found = {"passed": passed, "runs": [verdict._asdict() for verdict in verdicts]}
    print_result(as_json, found, _lines(verdicts))
    raise typer.Exit(0 if passed else 1)


def _lines(verdicts: "Sequence[Verdict]") -> Iterator[str]:
    """Yield a row for each run of the catalogue, and how many were safe."""
    head = ("fault", "link", "re-arm", "outcome", "applied", "recoveries", "after silence", "wall s", "verdict")
    yield from table([head, *map(_row, verdicts)])
    failed = [verdict for verdict in verdicts if not verdict.is_ok]
    wall_s = sum(verdict.wall_s for verdict in verdicts)
    yield f"\n{len(verdicts) - len(failed)} of {len(verdicts)} runs are as they should be, {wall_s:.0f} s of runs"
    for verdict in failed:
        where = "" if verdict.recording is None else f" ({next_command('hil', 'view', Path(verdict.recording))})"
        yield f"  {verdict.fault} over {verdict.link}: {verdict.verdict}{where}"


def _row(verdict: "Verdict") -> tuple[str, ...]:
    return (
        verdict.fault,
        verdict.link + (", real time" if verdict.mode == "realtime" else ""),
        "yes" if verdict.rearm else "no",
        verdict.outcome or "-",
        "-" if verdict.applied is None else " ".join(map(str, verdict.applied)),
        "-" if verdict.recoveries is None else str(verdict.recoveries),
        "-" if verdict.silent_rad_s is None else f"{verdict.silent_rad_s:g} rad/s",
        f"{verdict.wall_s:.1f}",
        "ok" if verdict.is_ok else verdict.verdict.partition(":")[0],
    )
