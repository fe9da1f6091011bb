"""``hil init``: the first two files of a user's own robot, from answers or flags."""

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from hil.cli.options import Force, LinkUrl
from hil.core.errors import BadInputError
from hil.core.outputs import Existing, check_free, existing_files, write_whole

if TYPE_CHECKING:
    from hil.cli.new_robot import Question, Value

ROBOT_FILE = "robot.toml"
SCENARIO_FILE = "first_circle.toml"
_SLOWER = 1.25
_TRIES = 40
_Number = float | None


def init(
    directory: Annotated[Path, Argument(metavar="[DIRECTORY]")] = Path(),
    mass_kg: Annotated[_Number, Option(metavar="KG", help="with everything on it")] = None,
    wheel_radius_m: Annotated[_Number, Option(metavar="M", help="to where a roller touches the floor")] = None,
    half_length_m: Annotated[_Number, Option(metavar="M", help="half the distance of front and rear axle")] = None,
    half_width_m: Annotated[_Number, Option(metavar="M", help="half the distance of left and right wheels")] = None,
    inertia_kg_m2: Annotated[_Number, Option(metavar="KG·M²", help="of the robot, about the vertical axis")] = None,
    wheel_inertia_kg_m2: Annotated[_Number, Option(metavar="KG·M²", help="of a wheel with gear and motor")] = None,
    torque_limit_n_m: Annotated[_Number, Option(metavar="N·M", help="of a wheel")] = None,
    speed_limit_rad_s: Annotated[_Number, Option(metavar="RAD/S", help="of a wheel")] = None,
    counts_per_revolution: Annotated[int | None, Option(metavar="COUNTS", help="of an encoder, a wheel's turn")] = None,
    torque_constant_n_m_a: Annotated[_Number, Option(metavar="N·M/A", help="torque of a wheel for each ampere")] = None,
    link: LinkUrl = None,
    defaults: Annotated[bool, Option("--defaults", help="take the proposed value where no flag gives one")] = False,
    force: Force = False,
) -> None:
    """Write a robot file and a first scenario; ask for the values that no flag gives.

    Each question, and the file, says what its value means.
    """
    from hil.cli.new_robot import QUESTIONS, problem_with

    arguments = dict(locals())
    given: dict[str, Value | None] = {one.key: arguments[one.parameter] for one in QUESTIONS}
    is_interactive = not defaults and sys.stdin.isatty()
    missing = [question.flag for question in QUESTIONS if given[question.key] is None]
    if missing and not defaults and not is_interactive:
        raise BadInputError(f"stdin is not a terminal; give {', '.join(missing)}, or --defaults for proposed values")
    answers: dict[str, Value] = {}
    for question in QUESTIONS:
        value = given[question.key]
        if value is None:
            proposed = question.proposed(answers)
            value = _prompt(question, proposed) if is_interactive else proposed
        elif (problem := problem_with(question, value)) is not None:
            raise BadInputError(f"{question.flag}: {problem}")
        answers[question.key] = value
    robot, scenario = begin(directory, answers, existing_files(force=force))
    print(f"wrote {robot} and {scenario}")
    elsewhere = " --link memory:" if answers["link.url"] != "memory:" else ""
    print(f"Next: hil run {scenario}{elsewhere}    # on the virtual robot")


def _prompt(question: "Question", proposed: "Value") -> "Value":
    """Ask until the answer is valid in the scenario's table."""
    from hil.cli.new_robot import problem_with

    while True:
        text = typer.prompt(f"{question.key}: {question.description}", default=str(proposed))
        try:
            value = question.read(text)
        except ValueError:
            print(f"{text!r} is not a number")
            continue
        problem = problem_with(question, value)
        if problem is None:
            return value
        print(problem)


def begin(folder: Path, answers: "Mapping[str, Value]", existing: Existing = "refuse") -> tuple[Path, Path]:
    """Write ``robot.toml`` and ``first_circle.toml`` into ``folder``, which is made if missing; return their paths.

    ``answers`` has a value for every question. Raises BadInputError when a file exists and may not be replaced, when
    values contradict each other, or when the robot cannot follow the scenario's circle at any speed that is tried.
    """
    from hil.cli.new_robot import robot_text

    robot, scenario = folder / ROBOT_FILE, folder / SCENARIO_FILE
    for path in (robot, scenario):
        check_free("file", path, existing)
    texts = robot_text(answers), _feasible(answers)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"folder {folder}: it cannot be made ({error.strerror}); name another") from error
    for path, text in zip((robot, scenario), texts, strict=True):
        write_whole(path, text.encode(), "file", existing)
    return robot, scenario


def _feasible(answers: "Mapping[str, Value]") -> str:
    """Return a scenario whose circle the robot can follow, at the highest speed of those tried."""
    from hil.cli.new_robot import robot_text, scenario_text
    from hil.runtime.assembly import check_scenario
    from hil.scenario import load

    slowness = 1.0
    with tempfile.TemporaryDirectory() as trial:
        Path(trial, ROBOT_FILE).write_text(robot_text(answers), encoding="utf-8")
        for _ in range(_TRIES):
            text = scenario_text(answers, slowness)
            path = Path(trial, SCENARIO_FILE)
            path.write_text(text, encoding="utf-8")
            if not check_scenario(load(path)).sentences:
                return text
            slowness *= _SLOWER
    raise BadInputError(
        f"no circle is slow enough for a torque limit of {answers['robot.torque_limit_n_m']} N·m and a speed limit of "
        f"{answers['robot.speed_limit_rad_s']} rad/s; check these and the mass"
    )
