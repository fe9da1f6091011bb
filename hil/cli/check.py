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
    feasibility = check_scenario(resolved)
    if as_json:
        print_json({"scenario": resolved.name, "reference": {"kind": resolved.reference.kind, **feasibility.figures()}})
    else:
        _print_feasibility(feasibility)
    raise typer.Exit(1 if feasibility.sentences else 0)


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


def _print_feasibility(feasibility: "Feasibility") -> None:
    """Print the wheel speed and torque that a reference needs, and why it is not feasible, if it is not."""
    for label, needed in (("wheel speed", feasibility.speed), ("wheel torque", feasibility.torque)):
        most = f"at most {needed.worst:.3g} {needed.unit}, of wheel {needed.worst_wheel} at t = {needed.worst_s:.3g} s"
        print(f"  {label:<22} {most}; the limit is {needed.limit:g} {needed.unit}")
    for sentence in feasibility.sentences:
        print(f"  {'not feasible':<22} {sentence}")
    for sentence in feasibility.notes:
        print(f"  {'note':<22} {sentence}")
