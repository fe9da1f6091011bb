"""References from files: their meaning, and one error message with the line for each possible mistake."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import hil
from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.record.reader import read
from hil.references import make_reference, table
from hil.references.shapes import Circle
from hil.references.table import LARGEST_BYTES
from hil.scenario import load

HEAD = "x_m,y_m,heading_rad\n"
TIMED = "t_s,x_m,y_m,heading_rad\n"
LINE = TIMED + "".join(f"{t},{t},0,0\n" for t in range(8))


def made(folder: Path, kind: str, text: str, **options: object):
    (folder / "way.csv").write_text(text, "utf-8")
    return make_reference(kind, {"file": "way.csv", **options}, folder)


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        ("waypoints", "", ": it is empty; expected a line with the columns x_m, y_m, heading_rad"),
        ("waypoints", "# nothing\n\n", ": it is empty; expected a line"),
        (
            "waypoints",
            "x_m,y_m\n0,0\n1,1\n",
            ", line 1: there is no column 'heading_rad' among 'x_m, y_m'; expected x_m,",
        ),
        ("waypoints", "x_m;y_m;heading_rad\n0;0;0\n1;0;0\n", ", line 1: there is no column 'x_m' among"),
        ("waypoints", "0,0,0\n1,0,0\n", ", line 1: there is no column 'x_m' among '0, 0, 0'"),
        (
            "waypoints",
            "x_m,y_m,heading_rad,speed\n0,0,0,1\n",
            ", line 1: unknown column 'speed'; did you mean 'speed_m_s'?",
        ),
        ("waypoints", "x_m,y_m,heading_rad,x_m\n0,0,0,1\n", ", line 1: the column 'x_m' is there twice"),
        ("waypoints", HEAD + "0,0,0\n", ": 1 rows; expected 2 to 10000"),
        ("waypoints", HEAD + "0,0,0\n" * 10_001, ": 10001 rows; expected 2 to 10000"),
        ("waypoints", HEAD + "0,0,0\n# on\n\n1,one,0\n", ", line 5: y_m = 'one'; expected a number between ±1000000"),
        ("waypoints", HEAD + "0,0,0\n1,,0\n", ", line 3: y_m = ''; expected a number"),
        ("waypoints", HEAD + "0,0,nan\n1,0,0\n", ", line 2: heading_rad = 'nan'; expected a number"),
        ("waypoints", HEAD + "0,0,0\n-inf,0,0\n", ", line 3: x_m = '-inf'; expected a number"),
        ("waypoints", HEAD + "0,0,0\n1_0,0,0\n", ", line 3: x_m = '1_0'; expected a number between ±1000000"),
        ("waypoints", HEAD + "0,0,0\n1e7,0,0\n", ", line 3: x_m = '1e7'; expected a number between"),
        ("waypoints", HEAD + "0,0,0\n1,0\n", ", line 3: 2 values; expected 3, one for each column"),
        ("waypoints", HEAD + '0,0,0\n1,"0,0\n', ", line 3: it cannot be read as values separated by commas"),
        ("waypoints", HEAD + "0,0,0\n1,0,0\n1,0,0\n", ", line 4: the same pose as in the row before; leave it out"),
        ("waypoints", HEAD + "0,0,0\n1e-4,0,0\n", ", line 3: 0.0001 m from the row before; expected at least 0.001 m"),
        (
            "waypoints",
            "x_m,y_m,heading_rad,speed_m_s\n0,0,0,\n1,0,0,0\n",
            ", line 3: speed_m_s = 0; expected at least 0.001",
        ),
        ("waypoints", "x_m,y_m,heading_rad,dwell_s\n0,0,0,-1\n1,0,0,0\n", ", line 2: dwell_s = -1; expected 0 or more"),
        ("trajectory", HEAD + "0,0,0\n", ", line 1: there is no column 't_s' among"),
        ("trajectory", TIMED + "0,0,0,0\n1,0,0,0\n2,0,0,0\n", ": 3 rows; expected 4 to 200000"),
        (
            "trajectory",
            TIMED + "0,0,0,0\n1,0,0,0\n1,1,0,0\n3,0,0,0\n",
            ", line 4: t_s = 1 after 1; expected ascending times",
        ),
        (
            "trajectory",
            TIMED + "0,0,0,0\n1,0,0,0\n0.5,1,0,0\n3,0,0,0\n",
            ", line 4: t_s = 0.5 after 1; expected ascending",
        ),
        ("trajectory", TIMED + "0,0,0,0\n1,0,0,0\n2,nan,0,0\n3,0,0,0\n", ", line 4: x_m = 'nan'; expected a number"),
    ],
)
def test_an_error_in_a_file_names_its_line(tmp_path, kind, text, message):
    with pytest.raises(BadInputError) as caught:
        made(tmp_path, kind, text)
    assert str(caught.value).startswith(f"reference.file = 'way.csv'{message}")
    assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    def complaint(file: str) -> str:
        with pytest.raises(BadInputError) as caught:
            make_reference("waypoints", {"file": file}, tmp_path)
        return str(caught.value)

    assert complaint("no.csv").endswith(f"{str(tmp_path / 'no.csv')!r}; its path starts from the scenario's folder")
    (tmp_path / "folder.csv").mkdir()
    assert "there is no file" in complaint("folder.csv")
    (tmp_path / "latin.csv").write_bytes(HEAD.encode() + "0,0,0 # Höhe\n".encode("latin-1"))
    assert "is not UTF-8 (byte 0xF6 at offset 29); save it as UTF-8" in complaint("latin.csv")
    assert "cannot be read" in complaint("zero\0.csv") or "there is no file" in complaint("zero\0.csv")
    assert complaint("points.txt").endswith("expected a file that ends in .csv")
    assert complaint("run.rrd").endswith("; REFERENCES.md says how to write a recording's poses")
    with (tmp_path / "huge.csv").open("wb") as file:
        file.truncate(LARGEST_BYTES + 1_000_000)
    assert complaint("huge.csv").endswith("51 MB; expected at most 50 MB")


def test_values_at_a_bound_are_taken(tmp_path, monkeypatch):
    text = "x_m,y_m,heading_rad,speed_m_s,dwell_s\n0,0,0,,\n0.001,0,-1e6,0.001,0\n1e6,0,0,,0\n"
    assert made(tmp_path, "waypoints", text).at(1e12).pose == (1e6, 0.0, 0.0)
    four = LINE.splitlines()[:5]
    assert made(tmp_path, "trajectory", "\n".join(four), ramp_s=3.0).span_s == 6.0
    monkeypatch.setattr(table, "LARGEST_BYTES", len(text))
    form = table.Format(("x_m",), {}, fewest_rows=3, most_rows=3, others=True)
    (tmp_path / "way.csv").write_text(text, "utf-8")
    assert table.read_table(tmp_path, "way.csv", form) == [(2, (0.0,)), (3, (0.001,)), (4, (1e6,))]
    (tmp_path / "way.csv").write_text(text + " ", "utf-8")
    with pytest.raises(BadInputError, match="expected at most"):
        table.read_table(tmp_path, "way.csv", form)


def test_a_table_may_have_a_byte_order_mark_spaces_comments_and_another_order(tmp_path):
    text = "\ufeff# shelves\r\n heading_rad , y_m, x_m ,dwell_s\r\n0, 0 ,0,\r\n\r\n1.5,2,1,0.5\r\n"
    end = made(tmp_path, "waypoints", text).at(1e3)
    assert end.pose == (1.0, 2.0, 1.5)


def test_the_path_of_a_file_starts_from_the_folder_of_the_scenario_that_names_it(tmp_path, monkeypatch):
    (tmp_path / "base").mkdir()
    (tmp_path / "base" / "way.csv").write_text(HEAD + "0,0,0\n1,0,0\n")
    base = 'extends = "circle_speed"\n[reference]\nkind = "waypoints"\nfile = "way.csv"\n'
    (tmp_path / "base" / "base.toml").write_text(base)
    (tmp_path / "mine.toml").write_text('extends = "base/base.toml"\n')
    monkeypatch.chdir(tmp_path)
    scenario = load("mine.toml")
    reference = make_reference(scenario.reference.kind, scenario.reference.options, scenario.directory)
    assert reference.at(1e3).pose == (1.0, 0.0, 0.0)
    (tmp_path / "here.csv").write_text(HEAD + "0,0,0\n5,0,0\n")
    scenario = load("base/base.toml", set={"reference.file": "here.csv"})
    reference = make_reference(scenario.reference.kind, scenario.reference.options, scenario.directory)
    assert reference.at(1e3).pose == (5.0, 0.0, 0.0)
    (tmp_path / "base" / "way.csv").write_text(HEAD + "0,0,0\nx,0,0\n")
    with pytest.raises(BadInputError, match=r"base\.toml:4: reference\.file = .*way\.csv', line 3: x_m = 'x'"):
        load("mine.toml")


def test_a_trajectory_of_a_circle_is_the_circle_however_its_heading_is_wrapped(tmp_path):
    circle = Circle(1.0, 10.0, heading="path", ramp_s=2.0)
    rows = [(3.0 + 0.02 * k, *circle.at(0.02 * k).pose) for k in range(700)]
    text = "note,t_s,x_m,y_m,heading_rad\n" + "".join(
        f"ok,{t!r},{x!r},{y!r},{math.remainder(heading, math.tau)!r}\n" for t, x, y, heading in rows
    )
    played = made(tmp_path, "trajectory", text, smoothing_s=0.02)
    for t in np.linspace(0.5, 13.0, 200):
        for one, other, tolerance in zip(played.at(t), circle.at(t), (1e-5, 1e-4, 1e-2), strict=True):
            assert tuple(one) == pytest.approx(tuple(other), abs=tolerance)
    assert played.at(99.0).twist == (0.0, 0.0, 0.0)
    assert tuple(played.at(99.0).pose) == pytest.approx(tuple(circle.at(13.98).pose), abs=1e-3)


def test_a_trajectory_with_a_ramp_starts_and_ends_at_rest_and_lasts_so_much_longer(tmp_path):
    plain, ramped = made(tmp_path, "trajectory", LINE), made(tmp_path, "trajectory", LINE, ramp_s=2.0)
    assert (plain.span_s, ramped.span_s) == (7.0, 9.0)
    assert plain.at(0.0).twist.vx_m_s == pytest.approx(1.0)
    for t, x, speed in ((0.0, 0.0, 0.0), (4.5, 3.5, 1.0), (9.0, 7.0, 0.0), (20.0, 7.0, 0.0)):
        pose, twist, _ = ramped.at(t)
        assert (pose.x_m, twist.vx_m_s) == pytest.approx((x, speed), abs=1e-9)
    with pytest.raises(BadInputError, match=r"ramp_s = 8: expected at most the 7 s of 'way\.csv'"):
        made(tmp_path, "trajectory", LINE, ramp_s=8.0)
    with pytest.raises(BadInputError, match=r"smoothing_s = 2\.0; expected a number from 0 to 1"):
        made(tmp_path, "trajectory", LINE, smoothing_s=2.0)


@pytest.mark.parametrize("name", ["figure_eight", "waypoints"])
def test_the_shipped_references_are_followed_through_the_wire(name):
    below = 0.002
    result = hil.run(name, set={"loop.duration_s": 4.0, "expect.1.to_s": 4.0, "expect.1.below": below})
    assert result.metrics["passed"] is True
    assert result.metrics["reference"]["warnings"] == []


def test_a_run_warns_before_it_begins_and_keeps_the_warning(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fast = ["--set", "reference.radius_m=5", "--set", "loop.duration_s=0.1", "--set", "expect=[]"]
    done = CliRunner().invoke(app, ["run", "circle_speed", *fast, "--record", "run.rrd"])
    recorded = read(tmp_path / "run.rrd")
    (warning,) = recorded.summary["reference"]["warnings"]
    assert warning.startswith("wheel fr would need 39.5 rad/s at t = 0 s, its limit is 20 rad/s: the robot cannot")
    assert done.stderr == f"hil: warning: {warning}\n"
    assert " ".join(done.stdout.split()).count(f"0.000 s warning {warning}") == 1
    assert [event.text for event in recorded.events if event.level == "WARN"] == [warning]


def test_check_says_what_the_reference_asks_of_the_wheels():
    fine = CliRunner().invoke(app, ["check", "figure_eight"])
    assert (fine.exit_code, fine.stderr) == (0, "")
    assert "wheel speed" in fine.stdout
    assert "not feasible" not in fine.stdout
    wild = CliRunner().invoke(app, ["check", "figure_eight", "--set", "reference.period_s=4", "--json"])
    assert wild.exit_code == 1
    assert len(json.loads(wild.stdout)["reference"]["warnings"]) == 2


@pytest.mark.parametrize(
    ("duration_s", "words"),
    [(5.0, "does not come to the end; make loop.duration_s longer"), (60.0, "is to stand at the end"), (None, None)],
)
def test_check_notes_a_reference_that_ends_at_another_time_than_the_run(duration_s, words):
    def check(duration_s):
        done = CliRunner().invoke(app, ["check", "waypoints", "--json", "--set", f"loop.duration_s={duration_s}"])
        assert done.exit_code == 0
        return json.loads(done.stdout)["reference"]

    ends_s = check(5.0)["ends_s"]
    notes = check(duration_s or ends_s)["notes"]
    if words is None:
        assert notes == []
    else:
        (note,) = notes
        assert note.startswith(f"the reference ends at t = {ends_s:.4g} s, the run at {duration_s:g} s: ")
        assert words in note


def test_what_goes_on_for_ever_has_no_end_to_note():
    done = CliRunner().invoke(app, ["check", "figure_eight", "--set", "loop.duration_s=0.1"])
    assert "  note  " not in done.stdout


def test_a_file_in_another_encoding_is_a_sentence_with_what_to_do(tmp_path):
    (tmp_path / "way.csv").write_bytes((HEAD + "# Stra\xdfe\n0,0,0\n").encode("latin-1"))
    with pytest.raises(BadInputError, match=r"way\.csv' is not UTF-8 \(byte 0xDF at offset .* save it as UTF-8$"):
        make_reference("waypoints", {"file": "way.csv"}, tmp_path)
