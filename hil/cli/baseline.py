"""``hil baseline``."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hil.cli import options as o
from hil.cli.output import batch, print_result, rows

if TYPE_CHECKING:
    from hil.batch.baselines import Made


def baseline(
    scenarios: Annotated[list[str], Argument(metavar="SCENARIO", help="shipped names or paths to .toml files")],
    accept: Annotated[bool, Option("--accept", help="write also where something has moved")] = False,
    seeds: Annotated[int, Option(metavar="N", help="runs of each, with seeds from the scenario's own on", min=2)] = 10,
    mode: o.Mode = None,
    link: o.LinkUrl = None,
    robot: o.RobotFile = None,
    jobs: o.Jobs = None,
    limit_s: o.Limit = 120.0,
    allow_motion: o.AllowMotion = False,
    as_json: o.Json = False,
) -> None:
    """Write the figures of a scenario's runs beside it, for later runs to be compared with.

    Where there is a baseline already, print what has moved and by how much; exit 1 if something has, and write it with
    --accept alone.
    """
    from hil.batch.baselines import SCHEMA, make_baselines
    from hil.scenario import load
    from hil.scenario.baseline import without_baselines

    loaded = [load(name, mode=mode, link=link, robot=robot) for name in without_baselines(scenarios)]
    with batch(as_json=as_json) as progress:
        found = make_baselines(
            loaded, seeds, workers=jobs, limit_s=limit_s, allow_motion=allow_motion, on_progress=progress
        )
    written = [one.new is not None and (one.old is None or accept) for one in found]
    for one, is_written in zip(found, written, strict=True):
        if is_written:
            one.write()
    results = list(zip(found, written, strict=True))
    plain = {"schema": SCHEMA, "baselines": [{**one.plain(), "written": is_written} for one, is_written in results]}
    print_result(as_json, plain, (line for one, is_written in results for line in _lines(one, is_written=is_written)))
    is_bad = any(one.failed or (one.has_moved and not is_written) for one, is_written in results)
    raise typer.Exit(1 if is_bad else 0)


def _lines(made: "Made", *, is_written: bool) -> Iterator[str]:
    """Yield what came of a scenario's runs."""
    yield made.scenario.name
    yield from rows(("failed", sentence) for sentence in made.failed)
    yield from rows(("moved", one.text) for one in made.moved)
    yield from rows(("moved", sentence) for sentence in made.other)
    if made.failed:
        yield from rows([("baseline", "not made: it is made of runs that passed")])
    elif is_written:
        assert made.new is not None
        yield from rows([("baseline", f"{len(made.new.figure)} figures of {len(made.new.seeds)} seeds in {made.file}")])
    elif made.has_moved:
        yield from rows([("baseline", f"{made.file} stays as it is; if the change is meant, add --accept")])
    else:
        yield from rows([("baseline", f"nothing has moved from {made.file}")])
