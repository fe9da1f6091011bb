"""``hil init``: the files that test a user's own robot, from answers or flags: law, scenarios, tests, workflow."""

import importlib.metadata
import os
import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_type_hints

import typer
from typer import Argument, Option
from typer.models import OptionInfo

from hil import __version__
from hil.cli.options import Force, LinkUrl
from hil.cli.output import next_command, say_on_stderr, table
from hil.core.errors import BadInputError
from hil.core.extensions import OUR_PACKAGE
from hil.core.outputs import Existing, check_free, existing_files, write_whole
from hil.core.scratch import scratch_folder

if TYPE_CHECKING:
    from hil.addons.init.new_robot import Question, Value

ROBOT_FILE = "robot.toml"
SCENARIO_FILE = "first_circle.hil.toml"
WORKFLOW = ".github/workflows/robot.yml"
_SEEDS = 3
_SLOWER = 1.25
_TRIES = 40
_Number = float | None


def init(
    directory: Annotated[Path, Argument(metavar="DIR", help="by default this one")] = Path(),
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
    driver: Annotated[
        str | None, Option(metavar="NAME", help="who talks to the motors: one of hil list drivers, but for dbc")
    ] = None,
    rate_hz: Annotated[int | None, Option(metavar="HZ", help="of the commands")] = None,
    defaults: Annotated[bool, Option("--defaults", help="take the proposed value where no flag gives one")] = False,
    force: Force = False,
) -> None:
    """Write what tests your robot: its file, a law, scenarios, tests, a baseline and a CI workflow.

    It asks for the values that no flag gives; each question, and the robot's file, says what its value means. All that
    it writes runs, and passes, as it stands: on the virtual robot.
    """
    from hil.addons.init.new_robot import PROJECT_QUESTIONS, problem_with

    arguments = dict(locals())
    given: dict[str, Value | None] = {one.key: arguments[one.parameter] for one in PROJECT_QUESTIONS}
    is_interactive = not defaults and sys.stdin.isatty()
    missing = [question.flag for question in PROJECT_QUESTIONS if given[question.key] is None]
    if missing and not defaults and not is_interactive:
        raise BadInputError(f"stdin is not a terminal; give {', '.join(missing)}, or --defaults for proposed values")
    answers: dict[str, Value] = {}
    for question in PROJECT_QUESTIONS:
        value = given[question.key]
        if value is None:
            proposed = question.proposed(answers)
            value = _prompt(question, proposed) if is_interactive else proposed
        elif (problem := problem_with(question, value)) is not None:
            raise BadInputError(f"{question.flag}: {problem}")
        answers[question.key] = value
    existing = existing_files(force=force)
    written = begin(directory, answers, existing)
    _write_baseline(directory / SCENARIO_FILE)
    print("Written:")
    for line in table([(f"  {path}", FILES[name]) for name, path in written.items()], has_head=False):
        print(line)
    if not is_address_set():
        say_on_stderr(
            f"hil: note: the address in {WORKFLOW} is not set yet; put the owner of mecanum-hil's repository there"
        )
    print(f"Next:\n  {next_command('hil', 'run', directory / SCENARIO_FILE)}\n  {next_command('pytest', directory)}")


def _prompt(question: "Question", proposed: "Value") -> "Value":
    """Ask until the answer is valid in the scenario's table."""
    from hil.addons.init.new_robot import problem_with

    while True:
        text = typer.prompt(f"{question.key}: {_meaning(question)}", default=str(proposed))
        try:
            value = question.read(text)
        except ValueError:
            print(f"{text!r} is not a number")
            continue
        problem = problem_with(question, value)
        if problem is None:
            return value
        print(problem)


def _meaning(question: "Question") -> str:
    """Return the meaning of a question: the help of its option."""
    hint = get_type_hints(init, include_extras=True)[question.parameter]
    return str(next(one.help for one in hint.__metadata__ if isinstance(one, OptionInfo)))


def begin(folder: Path, answers: "Mapping[str, Value]", existing: Existing = "refuse") -> dict[str, Path]:
    """Write all files but the baseline into ``folder``, which is made if missing; return their paths by name.

    The workflow goes to the top of the repository. ``answers`` has a value for every question. Raises BadInputError
    when a file exists and may not be replaced, when values contradict each other, or when the robot cannot follow the
    scenario's circle at any speed that is tried.
    """
    from hil.addons.init.new_robot import robot_text

    top = next((one for one in (folder.absolute(), *folder.absolute().parents) if (one / ".git").exists()), folder)
    written = {name: (top if name == WORKFLOW else folder) / name for name in FILES}
    # pytest takes files of one name in two folders for one module, so each robot's tests have its folder's name.
    written[TESTS_FILE] = folder / f"test_{re.sub(r'[^a-z0-9]+', '_', folder.resolve().name.lower())}.py"
    for path in written.values():
        check_free("file", path, existing)
    circle = _feasible(answers)
    mass_kg, duration_s = float(answers["robot.mass_kg"]), tomllib.loads(circle)["loop"]["duration_s"]
    texts = {
        ROBOT_FILE: robot_text(answers),
        SCENARIO_FILE: circle,
        "bad_day.hil.toml": bad_day_text(mass_kg, duration_s),
        "my_law.py": law_text(),
        TESTS_FILE: tests_text(mass_kg),
        ".gitignore": IGNORED,
        WORKFLOW: workflow_text(os.path.relpath(folder, top)),
    }
    for name, text in texts.items():
        path = written[name]
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInputError(f"folder {path.parent}: it cannot be made ({error.strerror}); name another") from error
        write_whole(path, text.encode(), "file", existing)
    return written


def _write_baseline(scenario: Path) -> None:
    """Run a scenario with a few seeds and write its baseline. Raises BadInputError when it does not pass."""
    from hil.judge.baselines import baseline_of
    from hil.judge.run_text import why_not_passed
    from hil.runtime.assembly import RunOptions, run_scenario
    from hil.scenario import load
    from hil.scenario.baseline import place, text_of

    first, runs = load(scenario), {}
    for seed in range(first.loop.seed, first.loop.seed + _SEEDS):
        result = run_scenario(load(scenario, seed=seed), RunOptions(keep_signals=False))
        if not result.passed:
            why = next(words for _, words in why_not_passed(result.run))
            raise BadInputError(
                f"{scenario}: the virtual robot does not pass it with seed {seed}: {why}; check the limits"
            )
        runs[seed] = result.run
    write_whole(place(first), text_of(baseline_of(first, runs)).encode(), "baseline", "replace")


def _feasible(answers: "Mapping[str, Value]") -> str:
    """Return a scenario whose circle the robot can follow, at the highest speed of those tried."""
    from hil.addons.init.new_robot import robot_text, scenario_text
    from hil.runtime.assembly import check_scenario
    from hil.scenario import load

    slowness = 1.0
    with scratch_folder("init") as trial:
        (trial / ROBOT_FILE).write_text(robot_text(answers), encoding="utf-8")
        for _ in range(_TRIES):
            text = scenario_text(answers, slowness)
            path = trial / SCENARIO_FILE
            path.write_text(text, encoding="utf-8")
            if not check_scenario(load(path)).sentences:
                return text
            slowness *= _SLOWER
    raise BadInputError(
        f"no circle is slow enough for a torque limit of {answers['robot.torque_limit_n_m']} N·m and a speed limit of "
        f"{answers['robot.speed_limit_rad_s']} rad/s; check these and the mass"
    )


_PUSH_SHARE = 0.05
"""Force of the push as a share of the robot's weight."""
_TO_BE_SET = "OWNER"


def action() -> str:
    """Return the GitHub Action of this version, as a workflow names it; the address is that of the package."""
    links = importlib.metadata.metadata(OUR_PACKAGE).get_all("Project-URL") or ()
    addresses = dict(link.split(", ", 1) for link in links)
    return f"{addresses['Repository'].removeprefix('https://github.com/')}/tools/action@v{__version__}"


def is_address_set() -> bool:
    """Whether the package says where its repository is."""
    return not action().startswith(f"{_TO_BE_SET}/")


def law_text() -> str:
    """Return the text of my_law.py, a short law that documents its arguments and its result."""
    return Path(__file__).with_name("my_law.py").read_text(encoding="utf-8")


def bad_day_text(mass_kg: float, duration_s: float) -> str:
    """Return a scenario with faults: the first circle, with commands that get lost and a push."""
    from hil.core.model import GRAVITY_M_S2

    push_s = round(duration_s / 2, 1)
    return f"""\
# A bad day: one command in fifty is lost, and somebody pushes the robot.
# It passes when every claim holds, and when every fault was really applied.

extends = "first_circle.hil.toml"

[[fault]]                               # `hil list faults` prints all kinds
kind = "drop"
target = "command"
value = 0.02
start_s = 1.0

[[fault]]
kind = "push"
target = "force_x_n"
value = {_PUSH_SHARE * mass_kg * GRAVITY_M_S2:.3g}
start_s = {push_s:g}
end_s = {push_s + 0.2:g}

[[expect]]                              # a claim; `hil list signals` prints what it can be about
signal = "error.planar_m"
after_fault = "push"
within_s = 2.0
below = 0.05
"""


def tests_text(mass_kg: float) -> str:
    """Return the tests of the law: pytest finds them, and every *.hil.toml beside them."""
    return f'''\
"""Tests of the law; run `pytest` here. The files *.hil.toml beside this one are tests too."""

from pathlib import Path

HERE = Path(__file__).parent
MINE = {{"controller.law": f"{{HERE / 'my_law.py'}}:MyLaw", "controller.gains": {{}}}}
HEAVIER = {{"plant.start.mass_kg": {1.2 * mass_kg:.4g}}}  # than robot.toml says


def test_my_law_drives_the_circle(hil_run):
    hil_run(HERE / "first_circle.hil.toml", set=MINE)  # fails with a report when a claim does not hold


def test_my_law_survives_a_bad_day(hil_run):
    hil_run(HERE / "bad_day.hil.toml", set=MINE)


def test_my_law_does_not_need_to_know_the_mass(hil_run):
    result = hil_run(HERE / "first_circle.hil.toml", set=MINE | HEAVIER)
    assert result.signals["error.planar_m"][-1] < 0.05
'''


def workflow_text(folder: str) -> str:
    """Return a workflow for GitHub that runs the tests of a folder of the repository."""
    return f"""\
# Runs scenarios and tests on each push. Verdicts are in the job's summary; pages and recordings are its artifact.
name: robot
on: [push, pull_request]
jobs:
  scenarios:
    runs-on: ubuntu-latest
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: "3.12"
      - uses: {action()}
        with:
          path: {folder}
"""


IGNORED = """\
# What runs and tests leave behind
runs/
__pycache__/
.pytest_cache/
"""

TESTS_FILE = "tests"
"""The tests' place in FILES: their file is called after the folder."""
FILES: Mapping[str, str] = {
    "robot.toml": "your robot: mass, sizes, limits, driver, link",
    "first_circle.hil.toml": "a scenario: a circle that it can drive",
    "bad_day.hil.toml": "the same circle with lost commands and a push",
    "my_law.py": "a control law of your own, to be changed",
    TESTS_FILE: "tests of the law",
    "first_circle.baseline.toml": "the figures of the circle today; a later run that differs fails",
    ".gitignore": "keeps recordings out of the repository",
    ".github/workflows/robot.yml": "the same in GitHub's CI",
}
"""What each file is for."""
