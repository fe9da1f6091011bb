"""hil compare: figures are those of the runs, a failed law gives a row, a misspelling gives a sentence."""

import json
import os
import signal
import socket
import subprocess
from pathlib import Path

import pytest
from typer.testing import CliRunner

import hil
from hil.addons.batch.columns import shown_columns
from hil.addons.batch.comparison.comparison import (
    FRICTIONS,
    MASS_FACTORS,
    OVER,
    Compared,
    Comparison,
    Condition,
    Entry,
    Request,
    Row,
    Variation,
    compare,
    conditions,
    entries,
    variations,
)
from hil.addons.batch.comparison.comparison_page import tables
from hil.addons.batch.job import PASSED, Outcome
from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.core.types import CommandMode
from tests.support.processes import HIL, environment
from tests.support.processes import hil as command
from tools import comparison_page

SHORT = "loop.duration_s=0.2"
FIGURES = [column.name for column in shown_columns()]
LAWS = """
import os
import socket

from hil.core.errors import BadInputError
from hil.core.types import CommandMode, WheelCommand, Wheels

REST = Wheels(0.0, 0.0, 0.0, 0.0)


class Rests:
    def __init__(self, model, mode):
        self.mode = mode

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        return WheelCommand(self.mode, REST, REST)


class SpeedOnly(Rests):
    def __init__(self, model, mode):
        super().__init__(model, mode)
        if mode is CommandMode.TORQUE:
            raise BadInputError("SpeedOnly: it gives speeds; set controller.command = speed")


class Raises(Rests):
    def update(self, reference, state, applied, dt_s):
        raise ZeroDivisionError("no gain")


class NoNumber(Rests):
    def update(self, reference, state, applied, dt_s):
        return WheelCommand(self.mode, REST, Wheels(float("nan"), 0.0, 0.0, 0.0))


class Dies(Rests):
    def update(self, reference, state, applied, dt_s):
        os._exit(7)


class Hangs(Rests):
    def update(self, reference, state, applied, dt_s):
        with socket.create_connection(("127.0.0.1", int(os.environ["LAW_PORT"]))) as line:
            line.recv(1)
"""


def asked(*laws: str, sets: tuple[str, ...] = (SHORT,), **more: object) -> Request:
    base = Request(laws, "circle_speed", sets, None, [5.0], ["ideal"], quick=True)
    return base._replace(**more)


@pytest.fixture
def in_folder_of_laws(tmp_path, monkeypatch) -> Path:
    (tmp_path / "laws.py").write_text(LAWS, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_command_gives_and_writes_the_figures_of_the_runs_the_same_every_time(tmp_path) -> None:
    laws, sets = ("dsc,speed.k1_1_s=7,torque.k1_1_s=9", "afdsc"), (SHORT,)
    words = (*laws, "circle_speed", "--torque", "3", "--drive", "motors", "--quick", "--set", *sets, "--json")
    written = ("--pictures", "svg", "--html", tmp_path / "page.html")
    first = command("compare", *words, *written)
    assert first.returncode == 0, first.stderr
    rows = json.loads(first.stdout)["rows"]
    again = compare(asked(*laws, sets=sets, torques_n_m=[3.0], drives=["motors", "ideal"]), workers=1).plain()["rows"]
    assert [(row["condition"]["drive"], row["law"]) for row in again] == [
        (drive, law) for drive in ("motors", "ideal") for law in laws
    ]
    assert json.loads(json.dumps(again[:2])) == rows
    limits = {"robot.torque_limit_n_m": 3.0, "firmware.torque_limit_n_m": 3.0, "loop.duration_s": 0.2}
    motors = {"plant.start.drive": "current", "plant.start.current_limit_a": 4.0, "firmware.current_limit_a": 4.0}
    for row, more in (
        (again[0], {"controller.gains.k1_1_s": 7.0, **motors}),
        (again[2], {"controller.command": "torque", "controller.gains.k1_1_s": 9.0}),
    ):
        metrics = hil.run("circle_speed", set=limits | more).metrics
        assert row["nominal"] == {name: metrics[name] for name in FIGURES}
        assert row["nominal"]["effort_n_m_s"] > 0.0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "wheels slip at most 0.3 m/s" in page, "what limits torques beyond the law is named"
    assert f"{rows[1]['nominal']['effort_n_m_s']:.1f}</td>" in page.partition(">afdsc</td>")[2].partition("</tr>")[0]
    assert page.count("<svg") == 1
    pictures = sorted(tmp_path.glob("*.svg"))
    assert [picture.stem for picture in pictures] == ["error-3nm-motors"]
    for picture in pictures:
        text = picture.read_text(encoding="utf-8")
        assert all(f">{row['law']}</text>" in text for row in rows), "laws are called by their names"


def test_a_law_that_refuses_fails_or_kills_its_process_is_a_row_with_its_reason(in_folder_of_laws) -> None:
    laws = [f"laws.py:{name}" for name in ("Rests", "SpeedOnly", "Raises", "NoNumber", "Dies")]
    found = compare(asked(*laws, drives=["ideal", "motors"]), workers=2)
    rests, refused, raises, no_number, dies, *motors = found.rows
    assert rests.runs[0].figures is not None
    assert refused.runs[0].refused == "SpeedOnly: it gives speeds; set controller.command = speed"
    assert refused.runs[0].failed is None
    assert motors[1].runs[0].figures is not None
    assert 'laws.py:31 (raise ZeroDivisionError("no gain")): ZeroDivisionError: no gain' in raises.runs[0].failed
    assert "were not finite" in no_number.runs[0].failed
    assert dies.runs[0].failed == "crashed: exit code 7"
    assert found.failed == 2 * 3
    for row in (refused, raises, no_number, dies):
        assert list(row.notes())
        assert all(value is None for value in found.plain()["rows"][found.rows.index(row)]["worst"].values())


def test_the_robots_of_a_row_differ_as_they_say_and_the_worst_is_the_largest() -> None:
    (row,) = compare(asked("dsc", quick=False)).rows
    assert [run.variation for run in row.runs] == variations(quick=False)
    assert len(row.runs) == (1 + len(MASS_FACTORS)) * (1 + len(FRICTIONS))
    efforts_n_m_s = [run.figures["effort_n_m_s"] for run in row.runs]
    assert len(set(efforts_n_m_s)) == len(efforts_n_m_s)
    assert row.worst("effort_n_m_s") == max(efforts_n_m_s)
    light = {"plant.start.mass_kg": 0.8 * 20.0, "plant.start.friction_coefficient": 0.08, "loop.duration_s": 0.2}
    both = {"robot.torque_limit_n_m": 5.0, "firmware.torque_limit_n_m": 5.0, "controller.command": "torque"}
    # circle_speed's gain of 8 1/s is for speed commands: in torque mode the law begins from its own defaults.
    metrics = hil.run("circle_speed", set=light | both | {"controller.gains.k1_1_s": 15.0}).metrics
    (run,) = [run for run in row.runs if run.variation == Variation(0.8, 0.08)]
    assert run.figures == {name: metrics[name] for name in FIGURES}


def test_a_figure_that_one_run_has_not_is_no_worst_figure() -> None:
    def run(variation: Variation, t10_s: float | None) -> Compared:
        figures = dict.fromkeys(FIGURES, 1.0) | {"t10_s": t10_s}
        return Compared(variation, Outcome("", PASSED, None, figures, {"reasons": {"t10_s": "it never came"}}))

    entry = Entry("dsc", "dsc", {CommandMode.TORQUE: {}}, {CommandMode.TORQUE: {}})
    runs = [run(Variation(), 0.5), run(Variation(0.8, None), 0.7), run(Variation(0.8, 0.08), None)]
    row = Row(entry, Condition(5.0, "ideal", None, None), runs)
    assert tuple(row.worst("t10_s", over) for over in OVER) == (0.5, 0.7, None)
    assert row.worst("steady_rms_m") == 1.0
    assert list(row.notes()) == ["no t10 in 1 of 3 runs, first with mass x 0.8, friction 0.08: it never came"]


def test_gains_are_the_scenarios_in_its_own_mode_and_the_texts_over_them() -> None:
    plain, changed, other = entries(["dsc", "dsc,speed.k1_1_s=7,filter_s=0.05", "afdsc"], "circle_speed", [])
    assert plain.gains == {CommandMode.SPEED: {"k1_1_s": 8.0}, CommandMode.TORQUE: {}}
    assert changed.gains[CommandMode.SPEED] == {"k1_1_s": 7, "filter_s": 0.05}
    assert changed.gains[CommandMode.TORQUE] == {"filter_s": 0.05}
    assert other.gains == {CommandMode.SPEED: {}, CommandMode.TORQUE: {}}


def test_gains_of_the_scenario_that_are_not_the_laws_defaults_are_in_the_tables() -> None:
    profile, said, same = entries(["profile", "profile,keeps_speed_limit=false", "dsc"], "compare_circle", [])
    assert profile.title(CommandMode.TORQUE) == "profile (keeps_speed_limit = false)"
    assert profile.title(CommandMode.SPEED) == "profile"
    assert said.title(CommandMode.TORQUE) == "profile,keeps_speed_limit=false"
    assert same.title(CommandMode.TORQUE) == "dsc"
    condition = Condition(5.0, "ideal", None, None)
    run = Compared(Variation(), Outcome("", PASSED, None, dict.fromkeys(FIGURES, 1.0)))
    found = Comparison("compare_circle", 1, [Row(profile, condition, [run])])
    ((_, (_, (label, *_)), *_),) = tables(found)
    assert label == found.plain()["rows"][0]["title"] == "profile (keeps_speed_limit = false)"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"laws": ["dcs"]}, "'dcs': unknown; did you mean 'dsc'"),
        ({"laws": ["dsc,k1_s=8"]}, "unknown key dsc.k1_s; did you mean"),
        ({"laws": ["dsc,k1_1_s=abc"]}, 'dsc.k1_1_s = "abc"; expected a number'),
        ({"torques_n_m": [0.0]}, "--torque 0: expected the limit of a wheel in N·m, more than 0"),
        ({"laws": ["dsc,k1_1_s=-8"]}, "k1_1_s = -8"),
        ({"laws": ["dsc,fast.k1_1_s=8"]}, "'fast.k1_1_s=8' is not a gain; expected key=value, torque.key=value"),
        ({"laws": ["dsc,k1_1_s"]}, "'k1_1_s' is not a gain"),
        ({"laws": ["laws.py:Rests,k=1"]}, "takes no gains"),
        ({"laws": ["dsc", "dsc"]}, "law dsc: it is named twice"),
        ({"scenario": "circle_sped"}, "did you mean 'circle_speed'"),
        ({"scenario": "afdsc"}, "scenario afdsc: this is a law; the last argument is the scenario"),
        ({"drives": ["motor"]}, "--drive motor: unknown; did you mean 'motors'"),
        ({"estimators": ["oddometry"]}, "--estimator oddometry: unknown; did you mean 'odometry'"),
        ({"contacts": ["slop"]}, "--contact slop: unknown; did you mean 'slip'"),
        ({"torques_n_m": [5.0, 5.0]}, "--torque: one is named twice in 5.0, 5.0"),
        ({"torques_n_m": [50.0]}, "torque_limit_n_m = 50"),
        (
            {"sets": ["robot.torque_limit_n_m=3"]},
            "--set robot.torque_limit_n_m=3: a comparison sets robot.torque_limit_n_m itself, under --torque, --drive, "
            "--estimator and --contact",
        ),
        ({"sets": ["controller.gains.k1_1_s=3"]}, "laws and gains are named together"),
        ({"sets": ["robot.mas_kg=3"]}, "mass_kg"),
        (
            {"sets": ["plant.fmu=mecanum_mujoco"]},
            "scenario circle_speed: plant.fmu = 'mecanum_mujoco' has no drive, which a comparison under 5 N·m, ideal "
            "torque needs; use the plant 'mecanum'",
        ),
    ],
    ids=lambda value: str(value)[:40],
)
def test_what_does_not_exist_is_a_sentence_before_anything_runs(change, words, in_folder_of_laws) -> None:
    with pytest.raises(BadInputError) as caught:
        compare(asked("dsc")._replace(**change), on_progress=lambda *_: pytest.fail("a run was made"))
    assert words in str(caught.value)


def test_conditions_are_all_combinations_and_have_names_of_their_own() -> None:
    axes = {"torques_n_m": [5.0, 1.8], "drives": ["ideal", "motors"], "estimators": ["truth", "odometry"]}
    found = conditions(asked("dsc", contacts=["slip"], **axes))
    assert len(found) == len({table.words for table in found}) == len({table.slug for table in found}) == 8
    assert found[-1].words == "1.8 N·m, motors, speed commands, state from odometry, slip contact"
    assert found[-1].sets()["plant.start.contact"] == "slip"
    assert found[-1].sets()["estimator.source"] == "odometry"


def test_ctrl_c_ends_the_runs_and_says_so(in_folder_of_laws) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(60.0)
        process = subprocess.Popen(
            [*HIL, "compare", "laws.py:Hangs", "circle_speed", "--quick"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment() | {"LAW_PORT": str(server.getsockname()[1])},
        )
        running, _ = server.accept()
        with running:
            os.kill(process.pid, signal.SIGINT)
            _, errors = process.communicate(timeout=60.0)
            running.settimeout(60.0)
            assert running.recv(1) == b"", "the worker has ended with its run"
    assert process.returncode == 130
    assert errors == "hil: interrupted; the runs were ended\n"


def test_what_cannot_be_written_is_said_after_the_table_and_keeps_nothing_else_back(tmp_path) -> None:
    (tmp_path / "error-5nm-ideal.png").mkdir()
    page = tmp_path / "page.html"
    words = ["dsc", "circle_speed", "--quick", "--torque", "5", "--drive", "ideal", "--set", SHORT]
    done = CliRunner().invoke(app, ["compare", *words, "--html", str(page), "--pictures", "png", "--force"])
    assert "\ndsc " in done.stdout
    assert isinstance(done.exception, BadInputError)
    assert str(done.exception).startswith(f"picture {tmp_path / 'error-5nm-ideal.png'}: it cannot be written")
    assert page.stat().st_size


def test_the_page_of_the_results_is_made_of_the_tables_that_are_kept(tmp_path, monkeypatch) -> None:
    found = json.loads(json.dumps(compare(asked("dsc", torques_n_m=[5.0])).plain()))
    (tmp_path / "true.json").write_text(json.dumps(found), encoding="utf-8")
    (cells,) = comparison_page.read(tmp_path / "true.json")["5 N·m, ideal torque"].values()
    assert cells["effort [N·m·s]"].split(" / ")[0] == f"{found['rows'][0]['nominal']['effort_n_m_s']:.1f}"
