"""What ``hil fmu`` shows, and what a check assumes of an FMU, by its description alone: no code of an FMU runs."""

import hashlib
import json
import subprocess
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from fmpy.fmi1 import FMICallException
from typer.testing import CliRunner

import plant_fmu
from hil.addons.fmu_check import Finding, Kind
from hil.addons.fmu_check.check import CheckResult, Part
from hil.addons.fmu_check.fmu_command import _check_lines, _info_lines
from hil.addons.fmu_check.info import info
from hil.addons.fmu_check.slave import Model, close, same_time
from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.plant.built import MUJOCO
from tests.support.broken_fmu import Change, pack, same


def edited(*pairs: tuple[str, str]) -> Change:
    """Exchange texts in modelDescription.xml."""

    def change(name: str, data: bytes) -> bytes:
        for old, new in pairs if name.endswith(".xml") else ():
            assert old.encode() in data, old
            data = data.replace(old.encode(), new.encode())
        return data

    return change


SAYS_MUCH = edited(
    ('modelName="lag"', 'modelName="lag" author="Ada" version="7" license="MIT" copyright="2026" generationTool="cc"'),
    ('modelName="lag"', 'modelName="lag" description="follows"'),
    ('stopTime="1.5"', 'stopTime="1.5" tolerance="1e-4"'),
    (
        ' canSerializeFMUState="true"',
        ' canSerializeFMUState="false" maxOutputDerivativeOrder="2" needsExecutionTool="0"',
    ),
    ('start="2" min="0.5" max="5"', 'start="2" min="0.5"'),
    ('name="y" valueReference="4"', 'name="y" valueReference="4" unit="s" max="3"'),
)


def test_all_that_an_fmu_says_of_itself_is_shown(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", 3, SAYS_MUCH)
    found = info(fmu)
    assert found.sha256 == hashlib.sha256(fmu.read_bytes()).hexdigest()
    assert (found.path, found.shipped, found.fmi_version, found.model_name) == (fmu, None, "3.0", "lag")
    assert found.about == {
        "description": "follows", "author": "Ada", "version": "7", "license": "MIT", "copyright": "2026", "tool": "cc"
    }  # fmt: skip
    assert list(found.about) == ["description", "author", "version", "license", "copyright", "tool"], "as it is shown"
    assert found.experiment == {"start": "0.5", "stop": "1.5", "step": "0.01", "tolerance": "1e-4"}
    assert found.interfaces == {"CoSimulation": "lag"}
    claims = ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUState", "maxOutputDerivativeOrder=2")
    assert found.capabilities == {"CoSimulation": claims}
    by_name = {one.name: one for one in found.variables}
    assert list(by_name) == ["time", "u", "gain", "shape", "y", "count", "w"]
    assert asdict(by_name["u"]) == {
        "name": "u", "causality": "input", "variability": "continuous", "type": "Float64", "dimensions": (),
        "unit": None, "start": "0", "min": "-10", "max": "10", "items": (), "description": "what is followed",
    }  # fmt: skip
    assert by_name["w"].dimensions == (2,)
    assert by_name["shape"].items == (("linear", "1"), ("squared", "2"))
    lines = [" ".join(line.split()) for line in _info_lines(found)]
    assert lines[0] == str(fmu)
    for line in (
        "model lag", "description follows", "tool cc", "FMI version 3.0", f"sha256 {found.sha256}",
        f"CoSimulation lag: {', '.join(claims)}", f"platforms {found.platforms[0]}",
        "communication step stepped by the tick of 0.001 s, which it claims to handle",
        "name causality variability type unit start range description",
        "u input continuous Float64 0 -10 to 10 what is followed", "gain parameter fixed Float64 2 from 0.5",
        "y output continuous Float64 s up to 3", "w output continuous Float64[2]",
        "shape parameter fixed Enumeration 1 1 linear | 2 squared", "time independent continuous Float64 s",
    ):  # fmt: skip
        assert any(one.startswith(line) for one in lines), (line, lines)


def test_an_fmu_that_says_little_and_cannot_run_here_is_shown_too(tmp_path: Path) -> None:
    exchange = edited(
        ("<CoSimulation", "<ModelExchange"),
        (' canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true" canSerializeFMUstate="true"', ""),
        ('<DefaultExperiment startTime="0.5" stopTime="1.5" stepSize="0.01"/>', ""),
    )
    found = info(pack(tmp_path / "a.fmu", 2, exchange))
    assert found.step == "none: it is not for co-simulation, so it cannot run here"
    assert (found.about, found.experiment) == ({}, {})
    lines = [" ".join(line.split()) for line in _info_lines(replace(found, platforms=()))]
    for line in ("ModelExchange lag: no optional capabilities", "platforms none", "default experiment none"):
        assert line in lines
    odd = pack(tmp_path / "b.fmu", 3, edited(('canHandleVariableCommunicationStepSize="true"',
                                              'fixedInternalStepSize="0.0015"')))  # fmt: skip
    assert "its communication step is 0.0015 s" in info(odd).step
    shipped = info(plant_fmu.path(), "mass_kg")
    assert shipped.shipped == "mecanum"
    assert shipped.step == "stepped by the tick of 0.001 s"
    assert next(_info_lines(shipped)) == f"{plant_fmu.path()} (shipped as mecanum)"


@pytest.mark.parametrize(
    ("names", "fitting"),
    [("w", ["w"]), ("?", ["u", "y", "w"]), ("*a*", ["gain", "shape"]), ("cou?t", ["count"]), ("ti*", ["time"])],
)
def test_variables_are_chosen_by_name_or_pattern(tmp_path: Path, names: str, fitting: list[str]) -> None:
    assert [one.name for one in info(pack(tmp_path / "a.fmu", 3), names).variables] == fitting


def test_brackets_are_no_pattern_and_what_fits_nothing_is_said(tmp_path: Path) -> None:
    array = pack(tmp_path / "a.fmu", 3, edited(('name="u"', 'name="u[1]"')))
    assert [one.name for one in info(array, "u[1]").variables] == ["u[1]"]
    with pytest.raises(BadInputError, match=r"no variable fits 'u'"):
        info(array, "u")
    with pytest.raises(BadInputError, match=r"no variable fits 'gian'; did you mean 'gain'\?$"):
        info(array, "gian")
    with pytest.raises(BadInputError, match=r"no variable fits 'g\?n'$"):
        info(array, "g?n")


def result(*parts: Part) -> CheckResult:
    return CheckResult(parts)


def test_a_check_prints_each_part_with_its_worst_finding_then_violations_needs_and_notes() -> None:
    bad, need, told = (Finding(kind, f"a {kind}\nwith more") for kind in Kind)
    found = result(
        Part("good"), Part("told", (told,)), Part("needy", (told, need)), Part("bad", (need, told, bad)),
        Part("skipped", skipped="it is not claimed"),
    )  # fmt: skip
    lines = [" ".join(line.split()) for line in _check_lines(Path("a.fmu"), found)]
    assert lines == [
        "part outcome reason", "good pass", "told note", "needy need", "bad fail", "skipped skip it is not claimed",
        "violation: bad: a violation with more", "need: needy: a need with more", "need: bad: a need with more",
        "note: told: a note with more", "note: needy: a note with more", "note: bad: a note with more",
        "a.fmu: 1 violation of the standard, 2 things that this importer needs otherwise",
    ]  # fmt: skip
    assert found.violations == ["bad: a violation\nwith more"]
    for violations, needs, words in (
        (0, 0, "no violations of the standard"),
        (0, 1, "no violations of the standard, 1 thing that this importer needs otherwise"),
        (2, 0, "2 violations of the standard"),
    ):
        *_, last = _check_lines(Path("a.fmu"), result(Part("one", (bad,) * violations + (need,) * needs)))
        assert last == f"a.fmu: {words}"


# The commands


@pytest.mark.parametrize(("kind", "code"), [("violation", 1), ("need", 0), ("note", 0)])
def test_the_command_prints_what_a_check_found_and_fails_for_violations_alone(
    kind: str, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = pack(tmp_path / "a.fmu", 2)
    checked: list[Path] = []

    def made(path: Path, say: Callable[[str], object]) -> CheckResult:
        checked.append(path)
        say("functions")
        return result(Part("functions", (Finding(Kind(kind), "so it is"),)))

    monkeypatch.setattr("hil.addons.fmu_check.check.check", made)
    done = CliRunner().invoke(app, ["fmu", "check", str(fmu)])
    assert (done.exit_code, checked) == (code, [fmu])
    assert f"{kind}: functions: so it is" in done.stdout.splitlines()
    done = CliRunner().invoke(app, ["fmu", "check", str(fmu), "--json"])
    assert done.exit_code == code
    assert json.loads(done.stdout) == {
        "fmu": str(fmu), "passed": code == 0,
        "parts": [{"name": "functions", "findings": [{"kind": kind, "text": "so it is"}], "skipped": None}],
    }  # fmt: skip


def test_the_command_prints_what_an_fmu_says_of_itself(tmp_path: Path) -> None:
    fmu = str(pack(tmp_path / "a.fmu", 3))
    done = CliRunner().invoke(app, ["fmu", "info", fmu, "g*"])
    assert done.exit_code == 0
    assert done.stdout.splitlines()[0].startswith(str(tmp_path)[:30])
    assert done.stdout.splitlines()[-1].split()[:2] == ["gain", "parameter"]
    assert [
        one["name"]
        for one in json.loads(CliRunner().invoke(app, ["fmu", "info", fmu, "w", "--json"]).stdout)["variables"]
    ] == ["w"]


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ([], []),
        (["--out", "there"], ["--out", str(Path.cwd() / "there")]),
        (["--all-platforms", "--out", "there"], ["--all-platforms", "--out", str(Path.cwd() / "there")]),
    ],
)
def test_an_fmu_is_built_by_the_script_of_the_checkout(
    words: list[str], arguments: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scripts: list[tuple[str, ...]] = []
    status = 0

    def script(*called: str) -> "subprocess.CompletedProcess[str]":
        scripts.append(called)
        return subprocess.CompletedProcess(called, status, "made\n", "no compiler\n")

    monkeypatch.setattr("firmware_protocol.built.run_script", script)
    for mujoco in ([], ["--mujoco"]) if "--all-platforms" not in words else ([],):
        done = CliRunner().invoke(app, ["fmu", "build", *words, *mujoco])
        assert (done.exit_code, done.stdout) == (0, "made\n")
    assert scripts[0] == ("tools.build.fmu", *arguments)
    if len(scripts) > 1:
        file = [*arguments[:-1], f"{arguments[-1]}/{MUJOCO.name}"] if arguments else []
        assert scripts[1] == ("tools.build.mujoco_fmu", *file)
    status = 1
    done = CliRunner().invoke(app, ["fmu", "build", *words], catch_exceptions=True)
    assert done.exit_code != 0
    assert str(done.exception) == "the FMU was not built: no compiler"


# What a check assumes of a description


def model(folder: Path, fmi: int, change: Change = same) -> Model:
    fmu = pack(folder / "a.fmu", fmi, change)
    return Model(fmu, folder, folder / "none.so", f"{fmi}.0", lambda **_: None)


@pytest.mark.parametrize(
    ("declared", "suggested", "step_s"),
    [
        (' fixedInternalStepSize="0.02"', "0.01", 0.02), ("", "0.01", 0.01), ("", "0", 1e-3), ("", "INF", 1e-3),
        (' fixedInternalStepSize="0"', "0.03", 0.03),
    ],
)  # fmt: skip
def test_an_fmu_is_stepped_as_it_declares_or_suggests_or_by_a_millisecond(
    tmp_path: Path, declared: str, suggested: str, step_s: float
) -> None:
    changes = (
        ('stepSize="0.01"', f'stepSize="{suggested}"'),
        ('modelIdentifier="lag"', f'modelIdentifier="lag"{declared}'),
    )
    found = model(tmp_path, 3, edited(*changes))
    assert (found.step_s, found.start_s) == (step_s, 0.5)
    assert found.time_s(3) == pytest.approx(0.5 + 3.0 * step_s)


def test_inputs_are_driven_near_their_start_within_their_range_and_otherwise_in_each_step(tmp_path: Path) -> None:
    found = model(tmp_path, 3)
    assert ([one.name for one in found.inputs], [one.name for one in found.outputs]) == (["u"], ["y", "count", "w"])
    (u,) = found.inputs
    assert [found.input_value(u, step, 0) for step in range(6)] == pytest.approx([-0.2, -0.1, 0.0, 0.1, 0.2, -0.2])
    assert [found.input_value(u, 0, place) for place in range(3)] == pytest.approx([-0.2, -0.1, 0.0])
    narrow = model(tmp_path, 3, edited(('start="0" min="-10" max="10"', 'start="4" min="3.95" max="4.15"')))
    values = [narrow.input_value(narrow.inputs[0], step, 0) for step in range(5)]
    assert values == pytest.approx([3.95, 3.95, 4.0, 4.1, 4.15])
    single = model(tmp_path, 3, edited(('<Float64 name="u"', '<Float32 name="u"')))
    assert single.input_value(single.inputs[0], 0, 0) == -0.20000000298023224
    shape = next(one for one in found.variables if one.name == "shape")
    older = model(tmp_path, 2)
    assert (found.kind(shape), older.kind(next(one for one in older.variables if one.name == "shape"))) == (
        "Int64", "Integer"
    )  # fmt: skip


def test_of_an_fmu_s_messages_the_newest_of_the_most_severe_is_told(tmp_path: Path) -> None:
    found = model(tmp_path, 2)
    assert found.last_message() == ""
    for status, message in (
        (0, b"all well"),
        (3, b"an error"),
        (1, b"a warning"),
        (3, b"the last\x1b[1m\nword"),
        (2, b""),
    ):
        found.log(None, status, b"", message)
    assert found.last_message() == " (the last [1m word)"
    found.log(None, 3, b"", b"x" * 500)
    assert found.last_message() == f" ({'x' * 300})"


@pytest.mark.parametrize(
    ("status", "words"),
    [(2, "discard"), (3, "error"), (4, "fatal"), (6, "the unknown status 6"), (-1, "the unknown status -1")],
)
def test_a_call_that_failed_is_told_by_its_status(tmp_path: Path, status: int, words: str) -> None:
    error = FMICallException("fmi2DoStep", status)
    error.add_note(" (why)")
    assert model(tmp_path, 2).explain(error) == f"fmi2DoStep returns {words} (why)"


def test_numbers_are_close_and_times_near_but_for_rounding() -> None:
    for one, other, is_close in (
        *((1.0 + 9e-7, 1.0, True), (1.0 + 1.1e-6, 1.0, False), (100.00009, 100.0, True)),
        *((1e6 + 1.0, 1e6, True), (-1e6 - 1.0, -1e6, True), (1e6 + 1.001, 1e6, False)),
    ):
        assert close([one], [other]) is is_close
    assert not close([1.0, 2.0], [1.0])
    assert not close([float("nan")], [float("nan")])
    assert close([True, 3], [True, 3])
    for time_s, expected_s, is_near in (
        (0.9e-9, 0.0, True), (1.1e-9, 0.0, False), (100.0 + 0.9e-7, 100.0, True), (100.0 + 1.1e-7, 100.0, False),
        (1e9 + 1.0, 1e9, True),
    ):  # fmt: skip
        assert same_time(time_s, expected_s) is is_near
