"""``check`` passes the shipped FMU and finds the defects of real FMUs that were built to have them."""

from pathlib import Path

import pytest

from hil.plant.tools import check
from tests.plant_testbed import FMU, patched_fmu
from tests.test_fmu_archive import Change, in_description, repack, without


def test_the_shipped_fmu_has_no_problem() -> None:
    assert check(FMU) == []


STEP = "    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */\n"
SHARED_STATE = (
    "mecanum_physics.c",
    "    mecanum_state state = plant->now.state;\n",
    "    static mecanum_state state;\n",
)
LIES = (
    ("saved_state.c", "memcpy(&plant->now, state, sizeof plant->now);", "plant->now.stop_s += 0.0;"),
    ("instance.c", "if (!(step_s > 0.0 && isfinite(step_s))) {", "if (!isfinite(step_s)) {"),
    ("instance.c", "store(&plant->now, v, value);", "store(&plant->now, v, value + 1.0);"),
)


def test_a_crash_is_survived_and_located(tmp_path: Path) -> None:
    fmu = patched_fmu(tmp_path, ("fmi2.c", STEP, f"{STEP}    abort();\n"))
    assert check(fmu) == ["variables: the FMU crashed its process (signal 6)"]


def test_a_hang_is_ended(tmp_path: Path) -> None:
    forever = "    for (volatile int i = 0; i == 0;) {\n    }\n"
    (problem,) = check(patched_fmu(tmp_path, ("fmi2.c", STEP, STEP + forever)), longest_s=2.0)
    assert problem.endswith("the FMU did not return within 2 s")


def test_a_state_that_instances_share_is_found(tmp_path: Path) -> None:
    problems = check(patched_fmu(tmp_path, SHARED_STATE))
    assert "two instances: an instance gives other outputs when a second one exists" in problems or (
        "two instances: an instance does not start where it should after another was stepped" in problems
    )


def test_lies_are_found(tmp_path: Path) -> None:
    """A state that is not restored, a negative step that is taken, an input that is lost."""
    problems = check(patched_fmu(tmp_path, *LIES))
    assert "saved state: a restored state gives other outputs than when it was saved" in problems
    assert "illegal calls: doStep with a negative step is accepted" in problems
    assert any(p.startswith("variables: input wheel.fl.torque_n_m reads 0.8 after") for p in problems)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            in_description('guid="{', 'guid="{0'),
            "the FMU ended its process (Exception: Failed to instantiate",
        ),
        (in_description('modelIdentifier="mecanum"', 'modelIdentifier="other"'), "not run: FMU"),
        (without("binaries"), "not run: FMU"),
        (in_description('unit="kg"', 'unit="lb"'), 'The unit "lb" of variable "mass_kg"'),
        (in_description('fmiVersion="2.0"', 'fmiVersion="3.0"'), "not run: FMU"),
    ],
    ids=["another GUID", "another identifier", "no binary", "an unknown unit", "FMI 3.0"],
)
def test_a_wrong_archive_is_found(change: Change, words: str, tmp_path: Path) -> None:
    problems = check(repack(tmp_path / "wrong.fmu", change))
    assert any(words in problem for problem in problems), problems
