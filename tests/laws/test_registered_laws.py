"""Laws of other packages, registered as entry points: distributions as pip leaves them, on the path of this process."""

import sys
from pathlib import Path

import pytest

import hil
from hil.cli.list import listing
from hil.core.errors import BadInputError
from hil.core.types import CommandMode, Pose, State, Twist
from hil.laws.law_registry import laws, load_law, make_controller
from hil.laws.surface import Dsc
from tests.support.closed_loop import AT_REST, PAPER_CIRCLE, PAPER_ROBOT
from tests.support.outside import outside_package

STAND_STILL = """
    from hil.core.types import ZERO_WHEELS, WheelCommand

    class StandStill:
        def __init__(self, model, mode):
            self.mode = mode

        def reset(self, state, reference):
            pass

        def update(self, reference, state, applied, dt_s):
            return WheelCommand(self.mode, ZERO_WHEELS, ZERO_WHEELS)
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that installs a package with entry points of the group ``hil.laws`` and one module."""

    def installed(package: str, module: str, text: str, **points: str) -> Path:
        return outside_package(tmp_path, monkeypatch, text, {"hil.laws": points}, package, module)

    return installed


def row_of(name, package):
    [meaning] = [meaning for law, of, meaning in laws() if (law, of) == (name, package)]
    return meaning


def message_of(name):
    with pytest.raises(BadInputError) as caught:
        load_law(name, Path())
    return str(caught.value)


def test_a_registered_law_drives_a_run_by_its_name(install):
    install("lazy-laws", "lazy_laws", STAND_STILL, stand_still="lazy_laws:StandStill")
    result = hil.run("circle_speed", set={"controller": {"law": "stand_still"}, "loop.duration_s": 0.2, "expect": []})
    assert result.failure is None
    assert result.metrics["law"] == "stand_still"
    assert set(result.signals["truth.x_m"]) == {0.5}


def test_the_list_names_the_package_and_loads_nothing(install):
    install("lazy-laws", "never_imported", "raise SystemExit('loaded')", stand_still="never_imported:StandStill")
    header, rows = listing("laws")
    assert header == ("law", "package", "meaning")
    assert ("stand_still", "lazy-laws", "never_imported:StandStill") in rows
    assert "never_imported" not in sys.modules


def test_a_shipped_name_wins_and_the_list_says_so(install):
    install("lazy-laws", "lazy_laws", STAND_STILL, dsc="lazy_laws:StandStill")
    assert load_law("dsc", Path()) is Dsc
    assert row_of("dsc", "lazy-laws") == "not used: a shipped one has this name; use 'lazy_laws:StandStill'"
    assert load_law("lazy_laws:StandStill", Path()).__name__ == "StandStill"


def test_a_name_that_two_packages_have_registered_is_taken_from_neither(install):
    install("first", "first_laws", STAND_STILL, stand_still="first_laws:StandStill")
    install("second", "second_laws", STAND_STILL, stand_still="second_laws:StandStill")
    assert message_of("stand_still") == (
        "controller.law = 'stand_still': registered by first (first_laws:StandStill) and second "
        "(second_laws:StandStill); name one as 'package.module:Class'"
    )
    assert row_of("stand_still", "first") == "registered by more than one package; use 'first_laws:StandStill'"


def test_a_registered_name_is_among_the_nearest(install):
    install("lazy-laws", "lazy_laws", STAND_STILL, stand_still="lazy_laws:StandStill")
    assert message_of("stand_stil") == "controller.law = 'stand_stil': unknown; did you mean 'stand_still'?"


@pytest.mark.parametrize(
    ("text", "value", "message"),
    [
        (STAND_STILL, "lazy_laws:Missing", "no class 'Missing' in lazy_laws; known: StandStill"),
        (STAND_STILL, "not_there:Law", "no module 'not_there'; install it, or name a file as in './my_law.py:MyLaw'"),
        (STAND_STILL, "lazy_laws", "registered as 'lazy_laws', expected 'package.module:Class'"),
        ("\n1 / 0", "lazy_laws:Law", "importing it failed at {file}:2 (1 / 0): ZeroDivisionError: division by zero"),
        ("class Law: pass", "lazy_laws:Law", "the class has no reset; expected reset(self, state, reference)"),
    ],
)
def test_a_broken_one_gives_one_sentence(install, text, value, message):
    folder = install("lazy-laws", "lazy_laws", text, broken=value)
    expected = message.format(file=folder / "lazy_laws.py")
    assert message_of("broken") == f"controller.law = 'broken', of the package lazy-laws: {expected}"


def test_one_that_fails_in_the_run_names_its_package_too(install):
    install(
        "lazy-laws",
        "lazy_laws",
        STAND_STILL.replace("return WheelCommand", "return None #"),
        law="lazy_laws:StandStill",
    )
    law = make_controller("law", Path(), PAPER_ROBOT, CommandMode.SPEED, {})
    reference = PAPER_CIRCLE.at(0.0)
    with pytest.raises(BadInputError, match="of the package lazy-laws: update returned None"):
        law.update(reference, State(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0)), AT_REST, 0.005)
