"""``hil check``: what can be said of a scenario without running it."""

import typer

from hil.cli.options import Json, LinkUrl, Mode, RobotFile, ScenarioName, Seed, Sets, print_json


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
    from hil.cli import report
    from hil.runtime.assembly import check_scenario
    from hil.scenario import load

    resolved = load(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed)
    demands = check_scenario(resolved)
    if as_json:
        print_json({"scenario": resolved.name, "reference": {"kind": resolved.reference.kind, **demands.figures()}})
    else:
        report.print_demands(demands)
    raise typer.Exit(1 if demands.sentences else 0)
