"""The files of a repository that tests a robot, beside the robot's own: a law, a bad day, tests, and a workflow.

``hil init`` writes them, and each says what it is for. Everything in them runs as it stands.
"""

import importlib.metadata
from collections.abc import Mapping
from pathlib import Path

from hil import __version__
from hil.core.extensions import OUR_PACKAGE
from hil.core.model import GRAVITY_M_S2

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
    """Return a law in a few lines, with what it is given and what it returns: the file my_law.py beside this one."""
    return Path(__file__).with_name("my_law.py").read_text(encoding="utf-8")


def bad_day_text(mass_kg: float, duration_s: float) -> str:
    """Return a scenario with faults: the first circle, with commands that get lost and a push."""
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
