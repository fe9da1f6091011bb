"""The kept results: both FMUs agree with them, they agree with mathematics, and a deviation is found."""

import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
import pytest
from fmpy.util import read_csv

import plant_fmu
from plant_fmu import manifest, reference
from tests.fmu_slave import FMUS, VERSIONS

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


def test_the_check_is_a_program() -> None:
    command = [sys.executable, "-m", "plant_fmu.reference", "--check"]
    done = subprocess.run(command, cwd=plant_fmu.path().parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(" agrees; ") == len(CASES) * len(VERSIONS)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_archive_holds_the_reference_files_and_a_manifest_of_them(fmi: int) -> None:
    with zipfile.ZipFile(FMUS[fmi]) as archive:
        names = {name.removeprefix(f"{manifest.FOLDER}/") for name in archive.namelist() if manifest.FOLDER in name}
        listed = {e.get("source") for e in ET.fromstring(archive.read(f"{manifest.FOLDER}/{manifest.NAME}"))}
        for path in manifest.files():
            assert archive.read(f"{manifest.FOLDER}/{path.name}") == path.read_bytes()
    assert names == listed | {manifest.NAME}
    assert listed == {path.name for path in manifest.REFERENCE.iterdir() if path.suffix not in (".py", "")}
