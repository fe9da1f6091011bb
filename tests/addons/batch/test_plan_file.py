"""Files of batches: where a key stands, what a value of a path becomes, what cannot be read; columns of a row."""

import math
from pathlib import Path
from types import SimpleNamespace

import pytest

from hil.addons.batch.columns import column_of, run_columns, shown_columns
from hil.addons.batch.plan_file import found_from_anywhere, read_plan_file, row_of_table
from hil.core.errors import BadInputError
from hil.judge.judged_run import ExpectationResult, FaultResult, JudgedRun
from hil.scenario.trial import FaultTable

PLAN = """\
scenario = "circle_speed"
laws = ["dsc"]

[axes]
robot.mass_kg = { grid = [1, 2] }
[axes.plant.start]
mass_kg = { list = [3] }

[[fault]]
name = "first"
[[fault]]
name = "second"

[set]
loop.duration_s = 1.0
"""


def test_a_place_is_the_line_of_a_key_written_in_either_way_or_of_what_is_above_it(tmp_path: Path) -> None:
    (file := tmp_path / "plan.toml").write_bytes(b"\xef\xbb\xbf" + PLAN.encode())
    plan = read_plan_file(file, "campaign")
    for path, line in (
        (("laws",), 2),
        (("axes", "robot.mass_kg"), 5),
        (("axes", "robot", "mass_kg"), 5),
        (("axes", "plant.start.mass_kg"), 7),
        (("axes", "plant.start.no_such"), 5),
        (("fault", "2", "name"), 12),
        (("set", "loop.duration_s"), 15),
    ):
        assert plan.place(*path) == f"{file}:{line}", path
    assert plan.place("nothing") == str(file)
    assert plan.document["axes"] == {"robot.mass_kg": {"grid": (1, 2)}, "plant.start.mass_kg": {"list": (3,)}}
    assert plan.document["set"] == {"loop.duration_s": 1.0}
    assert plan.folder == tmp_path


def test_a_file_that_cannot_be_read_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe9"')
    for name, words in (("no.toml", "there is no such file; give the path of a .toml file"),
                        ("", "it cannot be read (Is a directory)"),
                        ("latin.toml", "it cannot be read (it is not text in UTF-8)")):  # fmt: skip
        with pytest.raises(BadInputError) as refused:
            read_plan_file(tmp_path / name, "hunt")
        assert str(refused.value) == f"hunt {tmp_path / name}: {words}"


@pytest.mark.parametrize(
    ("key", "value", "found"),
    [
        ("reference.file", "way.csv", "/there/way.csv"),
        ("device.motors.file", "../motors.dbc", "/there/../motors.dbc"),
        ("plant.fmu", "./robot.fmu", "/there/robot.fmu"),
        ("plant.fmu", "mecanum", "mecanum"),
        ("controller.law", "./law.py:Law", "/there/law.py:Law"),
        ("controller.law", "package.module:Law", "package.module:Law"),
        ("controller.law", "dsc", "dsc"),
        ("link.url", "serial:way.csv", "serial:way.csv"),
        ("reference.file", 5, 5),
    ],
)
def test_a_path_becomes_one_that_is_found_from_anywhere(key: str, value: object, found: object) -> None:
    assert found_from_anywhere(key, value, Path("/there")) == found


def test_a_row_that_is_given_again_has_what_was_given() -> None:
    row = FaultTable("drop", "command", start_s=0.5, end_s=math.inf, value=0.25)
    assert row_of_table(row) == {"kind": "drop", "target": "command", "start_s": 0.5, "value": 0.25}


def test_a_column_is_shown_in_its_unit_and_an_unknown_one_as_it_is() -> None:
    rms, other = column_of("steady_rms_m"), column_of("no_such")
    assert (rms.labelled, rms.text(0.0012346), rms.text(None)) == ("steady rms [mm]", "1.235", "-")
    assert (other.labelled, other.text(1.23456), other.title) == ("no_such []", "1.235", "no_such")
    assert [column.name for column in shown_columns()][:3] == ["t10_s", "tracked_s", "steady_rms_m"]


def test_a_row_has_figures_counts_and_the_first_expectation_that_failed() -> None:
    figures = {"ticks": 90, "deadline_misses": 4, "effort_n_m_s": 2.5, "tick_us": {"p50": 31.0}}
    expect = (
        ExpectationResult(signal="a", passed=True, text="a held"),
        ExpectationResult(signal="b", passed=None, text="b was not judged"),
        ExpectationResult(signal="c", passed=False, text="c failed"),
    )
    faults = tuple(FaultResult("drop", "command", "", count, "frames lost") for count in (3, None, 4))
    run = JudgedRun(figures=figures, expect=expect, faults=faults, recoveries=(SimpleNamespace(),) * 2)  # type: ignore[arg-type]
    row = run_columns(run)
    assert (row["ticks"], row["deadline_misses"], row["effort_n_m_s"], row["steady_rms_m"]) == (90, 4, 2.5, None)
    assert (row["faults_applied"], row["recoveries"], row["failed_expectation"]) == (7, 2, "c failed")
    assert row["machine.tick_p50_us"] == 31.0
