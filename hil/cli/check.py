"""``hil check`` and ``hil show``: a scenario is checked and printed without running it."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument

from hil.cli.options import Json, LinkUrl, Mode, RobotFile, ScenarioName, Seed, Sets, load_scenario
from hil.cli.output import print_result, rows, table
from hil.core.errors import apart

if TYPE_CHECKING:
    from hil.references import Feasibility


def check(
    scenarios: Annotated[list[str], Argument(metavar="SCENARIO", help="shipped names or paths to .toml files")],
    robot: RobotFile = None,
    mode: Mode = None,
    link: LinkUrl = None,
    seed: Seed = None,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Check scenarios without running them: their values, laws, FMU, and whether the robot can follow the reference."""
    from hil.judge.baselines import baseline_words
    from hil.runtime.assembly import check_scenario
    from hil.runtime.robots import check_plant
    from hil.scenario.baseline import without_baselines
    from hil.scenario.encoders import coarse
    from hil.scenario.unreached import beyond_the_end, without_effect

    found, lines, feasible = [], [], True
    names = without_baselines(scenarios)
    for name in names:
        resolved = load_scenario(name, set=sets or [], robot=robot, mode=mode, link=link, seed=seed)
        feasibility = check_scenario(resolved)
        check_plant(resolved)
        late, unread = (
            [f"{resolved.provenance[key]}: {key}: {words}" for key, words in rows_of(resolved)]
            for rows_of in (beyond_the_end, without_effect)
        )
        rough = list(coarse(resolved))
        feasible &= not feasibility.sentences and not late
        baseline = baseline_words(resolved)
        reference = {"kind": resolved.reference.kind, **feasibility.figures()}
        one = {"scenario": resolved.name, "reference": reference, "baseline": baseline}
        found.append(one | {"beyond_the_end": late, "without_effect": unread, "encoder": rough})
        lines += [name] if len(names) > 1 else []
        told = [("after the end", sentence) for sentence in late] + [("no effect", sentence) for sentence in unread]
        told += [("encoder", sentence) for sentence in rough]
        lines += rows([*_rows(feasibility), *told, ("baseline", baseline)])
    print_result(as_json, found[0] if len(names) == 1 else {"scenarios": found}, lines)
    raise typer.Exit(0 if feasible else 1)


def show(
    scenario: ScenarioName,
    robot: RobotFile = None,
    mode: Mode = None,
    link: LinkUrl = None,
    seed: Seed = None,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Print every value of a scenario and where it came from."""
    from hil.scenario import format_value
    from hil.scenario import resolved as resolved_values

    values = resolved_values(load_scenario(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed))
    found = {key: {"value": value, "from": where} for key, value, where in values}
    print_result(
        as_json,
        found,
        table([("key", "value", "from"), *((key, format_value(value), where) for key, value, where in values)]),
    )


def _rows(feasibility: "Feasibility") -> Iterator[tuple[str, str]]:
    """Yield the wheel speed and torque that a reference needs, and why it is not feasible, if it is not."""
    for label, needed in (("wheel speed", feasibility.speed), ("wheel torque", feasibility.torque)):
        most = f"at most {apart(needed.worst, needed.limit)} {needed.unit}, of wheel {needed.worst_wheel}"
        yield label, f"{most} at t = {needed.worst_s:.3g} s; the limit is {needed.limit:g} {needed.unit}"
    yield from (("not feasible", sentence) for sentence in feasibility.sentences)
    yield from (("note", sentence) for sentence in feasibility.notes)
