"""``hil hunt``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from hil.cli import options as o
from hil.cli.output import batch, next_command, print_result, rows

if TYPE_CHECKING:
    from hil.batch.hunt.hunt import Hunt

SCHEMA = "hil.hunt/1"


def hunt(
    scenario: o.ScenarioName,
    ranges: Annotated[
        Path | None, Option(metavar="FILE", help="what may differ, see HUNT.md; by default NAME.hunt.toml beside it")
    ] = None,
    out: Annotated[
        Path | None, Option(metavar="DIR", help="results, continued if begun; by default runs/hunt/NAME")
    ] = None,
    robot: o.RobotFile = None,
    link: o.LinkUrl = None,
    seed: o.Seed = None,
    target: Annotated[str, Option(metavar="host|unicorn", help="where the firmware runs, as in hil device")] = "host",
    jobs: o.Jobs = None,
    limit_s: o.Limit = 120.0,
    force: o.Force = False,
    as_json: o.Json = False,
) -> None:
    """Search for a run that breaks an expectation, make it as small as possible and save it; exit 1 when found."""
    from hil.batch.hunt.cases import Request
    from hil.batch.hunt.hunt import Hunt

    found = Hunt(Request(scenario, ranges, robot, link, seed, target, jobs, limit_s))
    folder = out if out is not None else Path("runs") / "hunt" / found.base.name
    found.check_free(folder, force=force)
    with batch(as_json=as_json) as progress:

        def show() -> None:
            if progress is not None:
                progress(found.runs + found.shrinking_runs, max(found.runs, found.tables.runs), found.words)

        found.perform(folder, show)
        saved = None if found.found is None else found.save(folder, force=force)
    result = {"schema": SCHEMA, **found.plain(), "scenario": None if saved is None else str(saved)}
    print_result(as_json, result, rows(_rows(found, saved)))
    raise typer.Exit(0 if found.found is None else 1)


def _rows(hunt: "Hunt", saved: Path | None) -> list[tuple[str, str]]:
    runs = f"{hunt.runs} of at most {hunt.tables.runs}"
    if hunt.found is None or saved is None:
        nearest: list[tuple[str, Any]] = [] if hunt.least is None else [("nearest", hunt.nearest())]
        return [("found", "nothing"), ("runs", runs), *nearest]
    return [
        ("found", hunt.reason()),
        ("runs", f"{hunt.found.found_after} until found, {hunt.shrinking_runs} to make it smaller"),
        ("saved", str(saved)),
        ("again", next_command("hil", "run", saved)),
    ]
