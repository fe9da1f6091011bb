"""What hil identify tells of a fit: intervals, what each value is worth, the written files and the printed lines."""

import json
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from hil.addons.identify import drives, identify_command
from hil.addons.identify.drive_checks import Unknown
from hil.addons.identify.drives import Drive
from hil.addons.identify.estimates import Estimate, estimates
from hil.addons.identify.excitation import Step
from hil.addons.identify.fit import Fitted, Prediction, Result
from hil.addons.identify.gauss_newton import Solution
from hil.addons.identify.identify_command import _figures, _lines
from hil.addons.identify.written_files import check_files, write_figures, write_files
from hil.cli.main import app
from hil.core.errors import BadInputError
from tests.addons.identify.test_before import BLOCKS, KINEMATICS, before
from tests.support.formula_drives import ROBOT, formula_drive

SIGMA = {
    "mass_kg": 0.01, "inertia_kg_m2": 0.02, "wheel_inertia_kg_m2": 0.03, "friction_coefficient": 0.04,
    "viscous_n_m_s_rad": 0.015, "com_x_m": 0.05, "com_y_m": 0.2, "wheel_radius_m": 0.001, "lever_m": 0.002,
    "grip_coefficient": 0.025, "roller_friction_coefficient": 0.3, "roller_stiffness_n_m": 0.06,
}  # fmt: skip
"""Standard deviations of the fit's numbers: of logarithms, or in the fit's units."""
WITH_MASS = 0.4  # the correlation of each number with the mass
VALUES = {
    "mass_kg": 16.0, "inertia_kg_m2": 0.8, "wheel_inertia_kg_m2": 0.005, "friction_coefficient": 0.03,
    "viscous_n_m_s_rad": 0.02, "com_x_m": 0.012, "com_y_m": -0.007, "wheel_radius_m": 0.061, "lever_m": 0.42,
    "grip_coefficient": 0.62, "roller_friction_coefficient": 0.011, "roller_stiffness_n_m": 1.5e5, "stretch_m": 0.004,
}  # fmt: skip


def fitted(contact: str, rms_m: float) -> Fitted:
    parameters = before().parameters(contact)
    known = VALUES | {one.name: 1.0 for one in parameters if "gain" in one.name}
    numbers = np.array([one.internal(known.get(one.name, 0.0)) for one in parameters])
    sigmas = np.array([SIGMA.get(one.name, 0.01) for one in parameters])
    correlation = np.eye(len(parameters))
    correlation[0, 1:] = correlation[1:, 0] = WITH_MASS
    solution = Solution(numbers, correlation * np.outer(sigmas, sigmas), np.zeros((1, 1)), np.zeros((1, 3)))
    return Fitted(contact, parameters, solution, Prediction(rms_m, "truth"), {})


def result(*, blocks: bool = True, fixes: bool = True, grip: float | None = 0.62, **others: Any) -> Result:
    slip, rigid = fitted("slip", 0.00123), fitted("rigid", 0.00234)
    kinematics = KINEMATICS._replace(scale_known=fixes, sideways=0.987, sideways_sigma=0.002, delay_s=0.031)
    found = Result(
        ROBOT, 1.3, (), kinematics, BLOCKS if blocks else None, (rigid, slip), slip, Prediction(0.0456, "truth"),
        grip, ("squeeze.rrd: the wheels slid",),
    )  # fmt: skip
    return found._replace(**others)


def by_name(found: Result, weighed_kg: float | None = None) -> dict[str, Estimate]:
    return {one.name: one for one in estimates(found, weighed_kg)}


def test_each_value_is_that_of_the_fit_with_twice_its_deviation_to_either_side() -> None:
    found = by_name(result())
    assert found.keys() == VALUES.keys() - {"stretch_m"} | {"torque_constant_n_m_a"}
    units = {"com_x_m": 0.05, "com_y_m": 0.05, "roller_friction_coefficient": 0.01}
    for name in VALUES.keys() - {"stretch_m"}:
        one = found[name]
        assert one.value == pytest.approx(VALUES[name])
        if name in units:
            half = 1.96 * SIGMA[name] * units[name]
            assert (one.low, one.high) == pytest.approx((one.value - half, one.value + half)), name
        else:
            half = 1.96 * SIGMA[name]
            assert (one.low, one.high) == pytest.approx((one.value * np.exp(-half), one.value * np.exp(half))), name


def test_a_weighed_mass_scales_what_hangs_on_the_torque_constant_and_its_doubt() -> None:
    plain, found = by_name(result()), by_name(result(), 18.0)
    assert found["mass_kg"][1:5] == (18.0, 18.0, 18.0, "weighed")
    for name in ("inertia_kg_m2", "wheel_inertia_kg_m2", "viscous_n_m_s_rad", "roller_stiffness_n_m"):
        assert found[name].value == pytest.approx(VALUES[name] * 18.0 / 16.0)
        # The deviation of the difference of two logarithms that are correlated.
        own, mass = SIGMA[name], SIGMA["mass_kg"]
        sigma = np.sqrt(own**2 + mass**2 - 2.0 * WITH_MASS * own * mass)
        assert np.log(found[name].high / found[name].value) == pytest.approx(1.96 * sigma), name
    for name in ("com_x_m", "friction_coefficient", "wheel_radius_m", "lever_m", "grip_coefficient"):
        assert found[name][1:4] == plain[name][1:4], name
    constant = found["torque_constant_n_m_a"]
    assert constant.value == pytest.approx(1.3 * 18.0 / 16.0)
    assert (constant.low / constant.value, constant.high / constant.value) == pytest.approx(
        (np.exp(-0.0196), np.exp(0.0196))
    )
    assert plain["torque_constant_n_m_a"][1:5] == (1.3, 1.3, 1.3, "believed")
    assert "weigh the robot (--mass-kg)" in plain["torque_constant_n_m_a"].why


def test_without_blocks_what_mass_and_wheels_share_is_less_certain() -> None:
    shared = {"mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2", "viscous_n_m_s_rad", "friction_coefficient"}
    found, plain = by_name(result(blocks=False)), by_name(result())
    for name in SIGMA.keys() - shared:
        assert found[name][1:4] == plain[name][1:4], name
    for name in shared:
        assert np.log(found[name].high / found[name].value) == pytest.approx(2.5 * 1.96 * SIGMA[name]), name
    constant = by_name(result(blocks=False), 18.0)["torque_constant_n_m_a"]
    assert np.log(constant.high / constant.value) == pytest.approx(2.5 * 0.0196)


def test_each_value_is_called_what_it_is_worth() -> None:
    every = by_name(result(), 18.0)
    assert {name: one.status for name, one in every.items()} == {
        "mass_kg": "weighed", "inertia_kg_m2": "identified", "wheel_inertia_kg_m2": "identified",
        "friction_coefficient": "identified", "viscous_n_m_s_rad": "identified", "com_x_m": "identified",
        "com_y_m": "effective", "wheel_radius_m": "identified", "lever_m": "identified",
        "grip_coefficient": "identified", "roller_friction_coefficient": "identified",
        "roller_stiffness_n_m": "effective", "torque_constant_n_m_a": "identified",
    }  # fmt: skip
    assert (every["com_y_m"].why, every["inertia_kg_m2"].why, every["mass_kg"].why) == (
        "its interval is wide", "", "by a scale"
    )  # fmt: skip
    unweighed = by_name(result())
    for name in ("mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2", "viscous_n_m_s_rad", "roller_stiffness_n_m"):
        assert unweighed[name].status == "effective"
        assert unweighed[name].why == "over the torque constant; weigh the robot (--mass-kg)"
    bare = by_name(result(blocks=False, fixes=False, grip=None), 18.0)
    for name in ("inertia_kg_m2", "wheel_inertia_kg_m2", "torque_constant_n_m_a"):
        assert bare[name].status == "effective"
        assert bare[name].why == "mass and wheels are hardly told apart; spin the wheels on blocks (--blocks)"
    assert bare["viscous_n_m_s_rad"].status == "identified"
    assert bare["grip_coefficient"][4:] == ("effective", "squeeze the wheels (--squeeze)")
    radius = bare["wheel_radius_m"]
    assert (radius.status, radius.low, radius.high) == ("believed", radius.value, radius.value)
    assert radius.why.startswith("the scale of length needs pose fixes")


def recorded(folder: Path, name: str) -> Drive:
    path = folder / f"{name}.rrd"
    path.write_bytes(name.encode())
    values = {
        "robot.torque_limit_n_m": 2.5, "robot.speed_limit_rad_s": 31.0, "firmware.torque_constant_n_m_a": 1.3,
        "firmware.watchdog_s": 0.1, "firmware.none": None, "device.driver": "stm32", "loop.rate_hz": 200,
    }  # fmt: skip
    return formula_drive(np.zeros((2, 4)), path=path, values=values)


def test_the_files_hold_the_values_with_their_worth_and_where_they_are_from(tmp_path: Path) -> None:
    found = estimates(result(), 18.0)
    made_from = [recorded(tmp_path, "floor"), formula_drive(np.zeros((2, 4)), path=tmp_path / "gone.rrd")]
    robot, plant = write_files(tmp_path / "new" / "mine", result(), found, made_from, "refuse")
    text = robot.read_text("utf-8")
    table = tomllib.loads(text)
    assert table["robot"] == pytest.approx(
        {
            "mass_kg": 18.0, "inertia_kg_m2": 0.9, "wheel_radius_m": 0.061, "half_length_m": 0.24, "half_width_m": 0.17,
            "wheel_inertia_kg_m2": 0.005625, "friction_coefficient": 0.03, "torque_limit_n_m": 2.5,
            "speed_limit_rad_s": 31.0,
        }
    )  # fmt: skip
    assert table["firmware"] == {"torque_constant_n_m_a": 1.4625, "watchdog_s": 0.1}
    assert table["device"] == {"driver": "stm32"}
    comments = {line.split(" = ")[0]: line.partition("# ")[2] for line in text.splitlines() if " = " in line}
    assert comments["mass_kg"] == "weighed; by a scale"
    assert comments["friction_coefficient"] == "identified, 95 %: 0.027738 to 0.032447"
    assert comments["half_width_m"] == comments["half_length_m"] == "their sum identified, 95 %: 0.41836 to 0.42165"
    assert comments["torque_constant_n_m_a"] == "identified, 95 %: 1.4341 to 1.4914"
    assert comments["speed_limit_rad_s"] == "as it was"
    assert "# Held-out drive: 1.23 mm after a second, 45.6 mm before the fit, against truth." in text
    assert "# From floor.rrd, SHA-256 a3e1f4935b09." in text, "by sha256sum"
    assert "# From gone.rrd, SHA-256 not there." in text
    tables = tomllib.loads(plant.read_text("utf-8"))
    assert (tables["extends"], tables["plant"]["fmu"]) == ("robot.toml", "mecanum")
    assert tables["plant"]["start"] == {
        "contact": "slip", "drive": "current", "com_x_m": 0.012, "com_y_m": -0.007, "viscous_n_m_s_rad": 0.0225,
        "grip_coefficient": 0.62, "roller_friction_coefficient": 0.011, "roller_stiffness_n_m": 168750.0,
    }  # fmt: skip
    assert "effective, 95 %: -0.0266 to 0.0126; its interval is wide" in plant.read_text("utf-8")
    with pytest.raises(BadInputError, match="exists already"):
        write_files(robot.parent, result(), found, made_from, "refuse")


@pytest.mark.parametrize("name", ["robot.toml", "plant.toml", "fit.json"])
def test_no_file_of_an_earlier_fit_is_replaced_unless_that_is_asked_for(tmp_path: Path, name: str) -> None:
    check_files(tmp_path, "refuse")
    (tmp_path / name).write_text("mine", encoding="utf-8")
    check_files(tmp_path, "replace")
    with pytest.raises(BadInputError, match=f"^file .*{name}"):
        check_files(tmp_path, "refuse")


def test_the_figures_are_those_of_the_fit_and_what_was_not_measured_is_null(tmp_path: Path) -> None:
    found = estimates(result(), 18.0)
    figures = _figures(result(), found)
    assert figures["held_out"] == {
        "against": "truth", "before_rms_m": 0.0456, "rigid_rms_m": 0.00234, "slip_rms_m": 0.00123
    }  # fmt: skip
    assert (figures["passed"], figures["contact"], figures["fix_delay_s"]) == (True, "slip", 0.031)
    assert (figures["sideways"], figures["gyro_bias_rad_s"]) == ({"scale": 0.987, "sigma": 0.002}, 0.013)
    assert figures["estimates"][0] == {
        "name": "mass_kg", "value": 18.0, "low": 18.0, "high": 18.0, "status": "weighed", "why": "by a scale"
    }  # fmt: skip
    for rms_m in (0.00123, 0.001):
        assert not _figures(result(before=Prediction(rms_m, "truth")), found)["passed"]
    unknown = KINEMATICS._replace(scale_known=False, sideways_sigma=np.nan, delay_s=np.nan)
    write_figures(tmp_path, _figures(result(kinematics=unknown), found), "refuse")
    text = (tmp_path / "fit.json").read_text("utf-8")
    written = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert (written["fix_delay_s"], written["sideways"]["sigma"]) == (None, None)


@pytest.mark.parametrize(("unused_s", "words"), [(0.004, ""), (0.006, "0.006 s of 4.01 s are not used, only its long")])
def test_how_much_of_a_recording_is_not_used_is_said(
    unused_s: float, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = formula_drive(np.zeros((801, 4)), unused_s=unused_s)
    monkeypatch.setattr(drives, "read_drive", lambda _: drive)
    assert identify_command._drive(Path("floor.rrd")) is drive
    said = capsys.readouterr().err
    assert said.startswith(f"hil: note: floor.rrd: {words}") if words else said == ""


def test_the_lines_tell_values_errors_and_what_was_written() -> None:
    found = estimates(result(), 18.0)
    lines = list(_lines(result(), found, Path("mine")))
    cells = [line.split() for line in lines]
    assert ["friction_coefficient", "0.03", "0.027738", "0.032447", "identified"] in cells
    assert ["mass_kg", "18", "weighed", "by", "a", "scale"] in cells
    assert ["before", "the", "fit", "45.6", "mm"] in cells
    assert ["fitted,", "rigid", "2.34", "mm"] in cells
    assert ["fitted,", "slip", "1.23", "mm"] in cells
    assert "Scale of sideways motion, for odometry: 0.9870 ± 0.0039" in lines
    assert "Held-out drive, error of the position after a second against truth (rms):" in lines
    assert lines[0] == "squeeze.rrd: the wheels slid"
    assert lines[-1] == "Taken: slip. Wrote mine: robot.toml for --robot, plant.toml to extend"
    unknown = KINEMATICS._replace(sideways_sigma=np.nan)
    less = list(_lines(result(kinematics=unknown), found, None))
    assert less[-1] == "The fit predicts no better than what was believed; nothing was written"
    assert not any("sideways" in line for line in less)
    open_ones = (Unknown(("mass_kg",), 0.4, "weigh it"),)
    assert list(_lines(result(unknown=open_ones), found, None))[:3] == [
        "What these recordings cannot tell well:",
        f"  {open_ones[0].sentence}",
        "squeeze.rrd: the wheels slid",
    ]


# The commands


@pytest.mark.parametrize(("before_rms_m", "code"), [(0.0456, 0), (0.00123, 1)])
def test_a_fit_is_written_and_told_where_it_predicts_better(
    before_rms_m: float, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("floor", "judge", "blocks", "squeeze"):
        recorded(tmp_path, name)
    given: list[tuple[Any, ...]] = []

    def made(floor: Drive, held_out: Drive, **others: Drive | None) -> Result:
        given.append((floor, held_out, others))
        return result(before=Prediction(before_rms_m, "truth"))

    monkeypatch.setattr("hil.addons.identify.fit.fit", made)
    monkeypatch.setattr(drives, "read_drive", lambda path: recorded(tmp_path, path.stem))
    out = tmp_path / "out"
    words = [
        "identify",
        "fit",
        str(tmp_path / "floor.rrd"),
        "--held-out",
        str(tmp_path / "judge.rrd"),
        "--out",
        str(out),
    ]
    done = CliRunner().invoke(app, words)
    assert (done.exit_code, sorted(path.name for path in out.glob("*"))) == (
        code, ["fit.json", "plant.toml", "robot.toml"] if code == 0 else []
    )  # fmt: skip
    last = f"Taken: slip. Wrote {out}: robot.toml for --robot, plant.toml to extend"
    nothing = "The fit predicts no better than what was believed; nothing was written"
    assert "".join(done.stdout.split()).endswith("".join((last if code == 0 else nothing).split()))
    floor, held_out, others = given.pop()
    assert (floor.path.name, held_out.path.name) == ("floor.rrd", "judge.rrd")
    assert others == {"blocks": None, "squeeze": None}
    more = [
        "--blocks",
        str(tmp_path / "blocks.rrd"),
        "--squeeze",
        str(tmp_path / "squeeze.rrd"),
        "--mass-kg=18",
        "--json",
    ]
    done = CliRunner().invoke(app, [*words, *more, "--force"])
    assert done.exit_code == code
    found = json.loads(done.stdout)
    assert (found["schema"], found["passed"]) == ("hil.identify/1", code == 0)
    assert found["estimates"][0]["value"] == 18.0
    assert found.get("files") == ([str(out / "robot.toml"), str(out / "plant.toml")] if code == 0 else None)
    *_, others = given.pop()
    assert {name: one.path.name for name, one in others.items()} == {"blocks": "blocks.rrd", "squeeze": "squeeze.rrd"}
    if code == 0:
        assert json.loads((out / "fit.json").read_text(encoding="utf-8")) == found
        text = (out / "robot.toml").read_text(encoding="utf-8")
        places = [text.index(f"From {name}.rrd") for name in ("floor", "blocks", "squeeze", "judge")]
        assert places == sorted(places)
        assert CliRunner().invoke(app, words).exit_code != 0, "nothing is replaced without --force"


def test_drives_are_made_one_after_another_and_what_to_do_next_names_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, made = tmp_path / "out", list[tuple[str, Path, Any]]()
    failure: BadInputError | None = None

    def perform(step: Step, recording: Path, options: Any) -> SimpleNamespace:
        made.append((step.name, recording, options))
        return SimpleNamespace(failure=failure if step.name == "held_out" else None)

    monkeypatch.setattr("hil.addons.identify.excitation.perform", perform)
    words = ["identify", "drive", "paper_circle", "--out", str(out)]
    waiting = CliRunner().invoke(app, words)
    assert (waiting.exit_code != 0, made, out.exists()) == (True, [], False), "stdin is no terminal"
    done = CliRunner().invoke(app, [*words, "--yes"])
    assert done.exit_code == 0
    names = ["blocks", "floor", "squeeze", "held_out"]
    assert [row[:2] for row in made] == [(name, out / f"{name}.rrd") for name in names]
    assert not made[0][2].allow_motion
    assert not made[0][2].keep_signals
    said = done.stdout.splitlines()
    assert said[:5] == [*(f"  recorded {out / name}.rrd" for name in names), "Next:"]
    command = " ".join(said[5:]).split()
    assert command[-10:] == [
        "fit", f"{out}/floor.rrd", "--blocks", f"{out}/blocks.rrd", "--squeeze", f"{out}/squeeze.rrd",
        "--held-out", f"{out}/held_out.rrd", "--mass-kg", "KG",
    ]  # fmt: skip
    told = CliRunner().invoke(app, [*words, "--yes", "--step=squeeze", "--step=blocks", "--json", "--allow-motion"])
    assert made[-1][2].allow_motion
    assert json.loads(told.stdout) == {
        "schema": "hil.identify.drive/1",
        "recordings": {name: f"{out}/{name}.rrd" for name in ("squeeze", "blocks")},
    }
    made.clear()
    failure = BadInputError("the robot stopped")
    assert CliRunner().invoke(app, [*words, "--yes"]).exception is failure
    (out / "floor.rrd").touch()
    made.clear()
    assert CliRunner().invoke(app, [*words, "--yes"]).exit_code != 0
    assert made == [], "no drive begins where a recording is in the way"
