"""The first files of a user's own robot: its values, and a scenario with a circle that it can drive.

``--robot`` takes the robot's file, and the scenario extends it. Ranges and meanings come from the scenario's options.
"""

import tempfile
from collections.abc import Mapping
from pathlib import Path

from hil.cli.new_robot.questions import QUESTIONS, Question, Value, problem_with
from hil.cli.new_robot.texts import robot_text, scenario_text
from hil.core.errors import BadInputError
from hil.core.outputs import Existing, check_free, write_whole
from hil.runtime.assembly import check_scenario
from hil.scenario import load

__all__ = ["QUESTIONS", "ROBOT_FILE", "SCENARIO_FILE", "Question", "Value", "begin", "problem_with"]

ROBOT_FILE = "robot.toml"
SCENARIO_FILE = "first_circle.toml"
_SLOWER = 1.25
_TRIES = 40


def begin(folder: Path, answers: Mapping[str, Value], existing: Existing = "refuse") -> tuple[Path, Path]:
    """Write both files and return them; the folder is made. ``answers`` has every question's key.

    Raises BadInputError when a file exists and is not to be replaced, when values contradict each other, or when no
    circle is slow enough for the robot.
    """
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


def _feasible(answers: Mapping[str, Value]) -> str:
    """Return a scenario whose circle the robot can follow, the fastest of those tried."""
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
