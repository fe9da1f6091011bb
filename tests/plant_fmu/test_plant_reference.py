"""The kept results: both FMUs agree with them, they agree with mathematics, and a deviation is found."""

import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy.util import read_csv

import plant_fmu
from plant_fmu import manifest, reference
from plant_fmu.reference import __main__ as program
from tests.support.fmu_slave import FMUS, VERSIONS

CASES = reference.read_cases()


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", CASES)
def test_a_run_agrees_with_the_reference(name: str, fmi: int) -> None:
    found = reference.largest_deviation(CASES[name], reference.run(CASES[name], FMUS[fmi]))
    assert found.size <= CASES[name].tolerance, found


@pytest.mark.parametrize("name", CASES)
def test_every_column_of_a_reference_says_something(name: str) -> None:
    results = read_csv(str(CASES[name].results))
    assert [column for column in CASES[name].outputs if not results[column].any()] == []


def test_coasting_in_a_turn_follows_its_analytic_solution() -> None:
    results, start = read_csv(str(CASES["coast_in_a_turn"].results)), CASES["coast_in_a_turn"].start
    speed, turn, t = start["start_vx_m_s"], start["start_yaw_rate_rad_s"], results["time"]
    mass, wheel_inertia, radius = 20.0, 0.005, 0.075
    k = 4.0 * wheel_inertia / radius**2
    a = k / (mass + k) * turn
    expected = {
        "pose.x_m": speed * np.sin(a * t) / a,
        "pose.y_m": speed * (1.0 - np.cos(a * t)) / a,
        "pose.heading_rad": turn * t,
        "twist.vx_m_s": speed * np.cos(a * t),
        "twist.vy_m_s": speed * np.sin(a * t),
        "twist.yaw_rate_rad_s": turn + 0.0 * t,
    }
    for column, values in expected.items():
        np.testing.assert_allclose(results[column], values, rtol=0.0, atol=1e-9, err_msg=column)


@pytest.mark.parametrize("wrong", [1e-3, np.nan])
def test_a_deviation_is_found_where_it_is(wrong: float) -> None:
    case = CASES["torque_steps"]
    results = read_csv(str(case.results))
    results["pose.y_m"][40] += wrong
    found = reference.largest_deviation(case, results)
    assert (found.column, found.time_s) == ("pose.y_m", pytest.approx(40 * case.step_s))
    assert found.size > case.tolerance


def test_a_run_of_another_length_is_refused() -> None:
    case = CASES["torque_steps"]
    results = read_csv(str(case.results))
    for other in (results[:-1], results[["time", *case.outputs[1:]]]):
        with pytest.raises(ValueError, match=r"torque_steps_ref\.csv has other rows or columns"):
            reference.largest_deviation(case, other)


def run_program(monkeypatch: pytest.MonkeyPatch, *options: str) -> int | str | None:
    monkeypatch.setattr(sys, "argv", ["reference", *options])
    try:
        program.main()
    except SystemExit as ended:
        return ended.code
    return None


def test_the_program_tells_of_each_version_that_it_agrees(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_program(monkeypatch, "--check") == 0
    assert capsys.readouterr().out.count(" agrees; ") == len(CASES) * len(VERSIONS)


def test_the_program_says_where_a_run_deviates_and_writes_the_results_anew(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One number of a kept result is changed by a figure that is worked out here; another has a row too few."""
    kept = {path.name: path.read_bytes() for path in manifest.REFERENCE.iterdir() if path.suffix in (".csv", ".toml")}
    for name, content in kept.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.setattr(reference, "HERE", tmp_path)
    path = tmp_path / "voltage_drive_ref.csv"
    head, *rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    column = head.index('"pose.x_m"')
    largest = max(abs(float(row[column])) for row in rows)
    rows[40][column] = repr(float(rows[40][column]) - 0.25 * largest)
    path.write_text("".join(",".join(row) + "\n" for row in (head, *rows)), encoding="utf-8")
    (tmp_path / "torque_steps_ref.csv").write_bytes(
        kept["torque_steps_ref.csv"].rpartition(b"\n")[0].rpartition(b"\n")[0]
    )
    assert run_program(monkeypatch, "--check") == 1
    said = capsys.readouterr().out.splitlines()
    time_s, allowed = CASES["voltage_drive"].step_s * 40, CASES["voltage_drive"].tolerance
    for fmi in VERSIONS:
        assert (
            f"voltage_drive, FMI {fmi}.0: DEVIATES; pose.x_m at {time_s:g} s is off by 2.5e-01 of its largest value, "
            f"{allowed:.1e} allowed"
        ) in said
        assert sum(line.startswith(f"coast_in_a_turn, FMI {fmi}.0: agrees; ") for line in said) == 1
    assert sum(line.startswith("torque_steps_ref.csv has other rows or columns than a run of") for line in said) == 2
    assert len(said) == 6
    assert run_program(monkeypatch) is None
    assert capsys.readouterr().out.splitlines() == [str(tmp_path / f"{name}_ref.csv") for name in CASES]
    for name in CASES:
        made, before = (read_csv(str(folder / f"{name}_ref.csv")) for folder in (tmp_path, manifest.REFERENCE))
        assert made.dtype.names == before.dtype.names
        for one in before.dtype.names:
            np.testing.assert_allclose(made[one], before[one], rtol=1e-9, atol=1e-12)


def test_without_an_fmu_the_program_says_what_builds_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(plant_fmu, "path", lambda fmi: tmp_path / f"{fmi}.fmu")
    assert run_program(monkeypatch) == f"{tmp_path / '2.fmu'} does not exist; run python -m tools.build.fmu"
    (tmp_path / "2.fmu").touch()
    assert run_program(monkeypatch, "--check") == f"{tmp_path / '3.fmu'} does not exist; run python -m tools.build.fmu"


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_archive_holds_the_reference_files_and_a_manifest_of_them(fmi: int) -> None:
    with zipfile.ZipFile(FMUS[fmi]) as archive:
        names = {name.removeprefix(f"{manifest.FOLDER}/") for name in archive.namelist() if manifest.FOLDER in name}
        listed = {e.get("source") for e in ET.fromstring(archive.read(f"{manifest.FOLDER}/{manifest.NAME}"))}
        for path in manifest.files():
            assert archive.read(f"{manifest.FOLDER}/{path.name}") == path.read_bytes()
    assert names == listed | {manifest.NAME}
    assert listed == {path.name for path in manifest.REFERENCE.iterdir() if path.suffix not in (".py", "")}
