"""``hil catalogue``."""

from typing import Annotated

import typer
from typer import Argument, Option

from hil.addons.batch.results_page import Html, Page, Pictures, finish
from hil.cli.options import Force, Jobs, Json, Limit, Sets
from hil.cli.output import batch


def catalogue(
    scenario: Annotated[str, Argument(metavar="SCENARIO", help="gets the faults; 1.3 s of it run")] = "circle_speed",
    law: Annotated[str | None, Option(metavar="LAW", help="the law to test instead, with its default gains")] = None,
    link: Annotated[list[str] | None, Option(metavar="memory|serial|can", help="by default all; repeatable")] = None,
    kind: Annotated[list[str] | None, Option(metavar="KIND", help="only faults of this kind; repeatable")] = None,
    pairs: Annotated[bool, Option("--pairs", help="all pairs too, over memory unless --link says more")] = False,
    sample: Annotated[int | None, Option(metavar="N", help="only N of the pairs, chosen by --seed", min=0)] = None,
    seed: Annotated[int, Option(metavar="N", help="which pairs --sample takes")] = 0,
    realtime: Annotated[bool, Option("--realtime", help="a part of them in real time too")] = False,
    html: Html = None,
    pictures: Pictures = None,
    sets: Sets = None,
    jobs: Jobs = None,
    limit_s: Limit = 60.0,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Run the fault catalogue and judge every run for safety; exit 1 when one is not as it should be."""
    from hil.addons.batch.catalogue import trials
    from hil.record.files import new_in_runs

    page = Page.of(html, pictures, force=force)
    sets = [*([] if law is None else [f"controller.law={law}"]), *(sets or [])]
    recordings = new_in_runs("catalogue", "", "go where you may write")
    request = trials.Request(scenario, sets, link or [], kind or [], recordings, sample, seed)
    with batch(as_json=as_json) as progress:
        judged = trials.catalogue(
            request, pairs=pairs, realtime=realtime, workers=jobs, limit_s=limit_s, on_progress=progress
        )
    results = trials.results(request, judged)
    finish(results, page, as_json=as_json)
    raise typer.Exit(0 if results.passed else 1)
