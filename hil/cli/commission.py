"""``hil commission``: finds out how a robot is wired, and writes it into the robot's file."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hil.cli.options import Force, Json, LinkUrl, Sets
from hil.cli.output import end_in_order, print_result, say
from hil.core.errors import BadInputError, RunInterruptedError


def commission(
    robot: Annotated[Path, Argument(metavar="ROBOT", help="the robot's own file, as hil init or hil probe writes it")],
    answers: Annotated[
        Path | None,
        Option(metavar="FILE", help="TOML with the answers of a person, by the keys that COMMISSIONING.md names"),
    ] = None,
    link: LinkUrl = None,
    anew: Annotated[bool, Option("--anew", help="begin again, also with a robot that is commissioned")] = False,
    report: Annotated[Path | None, Option(metavar="FILE", help="write what was said also into this file")] = None,
    force: Force = False,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Find out, step by step, how a robot is wired, on blocks and on the floor, and write it into its file.

    Every step is announced, small, and confirmed; Ctrl-C switches the drives off at any time, and the same command goes
    on there. The exit code is 1 where a step has failed or wires have to be changed. A virtual robot in this process
    (link memory:) answers for itself.
    """
    from hil.commission.commission import commission as run
    from hil.commission.person import Answers
    from hil.core.outputs import check_free, existing_files, write_whole

    end_in_order()
    if not robot.is_file():
        raise BadInputError(
            f"{robot}: there is no such file; hil init writes one, or hil probe for motors of other makers"
        )
    existing = existing_files(force=force)
    if report is not None:
        check_free("report", report, existing)
    person = None if answers is None else Answers(answers)
    said: list[str] = []

    def hear(sentence: str) -> None:
        said.append(sentence)
        if not as_json:
            say(sentence)

    try:
        done = run(robot, person=person, sets=sets or [], link=link, anew=anew, say=hear)
    except KeyboardInterrupt:
        raise RunInterruptedError(
            "interrupted; the drives were told to switch off; go on with the same command"
        ) from None
    finally:
        if report is not None and said:
            write_whole(report, ("\n".join(said) + "\n").encode(), "report", existing)
    table = done.table
    found = {"state": table.state, "steps": table.steps, "todo": table.todo, "found": done.values}
    lines = [f"{robot}: state {table.state}", *(f"to do: {one}" for one in table.todo)]
    if table.todo:
        lines.append("then commission the robot again, with the same command")
    if "firmware.counts_per_revolution" in done.values or "robot.wheel_radius_m" in done.values:
        lines.append("our firmware holds some of these values too: hil params LINK NAME=VALUE --store")
    print_result(as_json, found, lines)
    raise typer.Exit(0 if table.state == "done" else 1)
