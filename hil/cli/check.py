"""``hil check`` and ``hil show``: a scenario is checked and printed without running it."""

from typing import TYPE_CHECKING

import typer

from hil.cli.options import Json, LinkUrl, Mode, RobotFile, ScenarioName, Seed, Sets, print_json

if TYPE_CHECKING:
    from hil.references import Feasibility


def check(
    scenario: ScenarioName,
    robot: RobotFile = None,
    mode: Mode = None,
    link: LinkUrl = None,
    seed: Seed = None,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Check a scenario without running it: its values, its law, and whether the robot can follow its reference."""
    from hil.runtime.assembly import check_scenario
    from hil.scenario import load

    resolved = load(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed)
    demands = check_scenario(resolved)
    if as_json:
        print_json({"scenario": resolved.name, "reference": {"kind": resolved.reference.kind, **demands.figures()}})
    else:
        _print_demands(demands)
    raise typer.Exit(1 if demands.sentences else 0)


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
    from hil.cli import report
    from hil.scenario import format_value, load, resolved

    rows = resolved(load(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed))
    if as_json:
        print_json({key: {"value": value, "from": where} for key, value, where in rows})
        return
    report.print_table([(key, format_value(value), where) for key, value, where in rows])


def _print_demands(demands: "Feasibility") -> None:
    """Print the speed and torque that a reference needs, and why it is not feasible, if so."""
    for label, demand in (("wheel speed", demands.speed), ("wheel torque", demands.torque)):
        most = f"at most {demand.worst:.3g} {demand.unit}, of wheel {demand.worst_wheel} at t = {demand.worst_s:.3g} s"
        print(f"  {label:<22} {most}; the limit is {demand.limit:g} {demand.unit}")
    for sentence in demands.sentences:
        print(f"  {'not feasible':<22} {sentence}")
    for sentence in demands.notes:
        print(f"  {'note':<22} {sentence}")
