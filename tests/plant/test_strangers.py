"""--no-code: laws in files and FMUs of others are refused, in this process and in those that it starts."""

import shutil
import zipfile
from pathlib import Path

import pytest

from plant_fmu import SHIPPED
from tests.support.processes import hil

RUN = ("run", "circle_speed", "--set", "loop.duration_s=0.1", "--set", "expect=[]", "--record", "none")
LAW = """
from hil import WheelCommand
from pathlib import Path

Path("it_ran").touch()


class Mine:
    def __init__(self, model, mode):
        self.mode = mode

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        return applied.command
"""


@pytest.fixture(autouse=True)
def _code_is_allowed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """--no-code is for a process, and tests share one."""
    monkeypatch.setenv("HIL_NO_CODE", "")


@pytest.fixture
def foreign_fmu(tmp_path: Path) -> Path:
    fmu = tmp_path / "foreign.fmu"
    shutil.copy(SHIPPED["mecanum"], fmu)
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr("resources/more.txt", "another")
    return fmu


def test_a_law_in_a_file_is_refused_and_not_run(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(LAW)
    refused = hil("--no-code", *RUN, "--set", "controller.law='./mine.py:Mine'", cwd=tmp_path)
    assert (refused.returncode, "it is code, and --no-code" in refused.stderr) == (2, True)
    assert not (tmp_path / "it_ran").exists()


def test_an_fmu_of_others_is_refused_by_run_and_check(foreign_fmu: Path) -> None:
    for command in ((*RUN, "--set", f"plant.fmu={foreign_fmu}"), ("fmu", "check", foreign_fmu)):
        refused = hil("--no-code", *command)
        assert (refused.returncode, f"{foreign_fmu}: it is code" in refused.stderr) == (2, True), refused.stderr


def test_the_environment_refuses_too_and_what_is_shipped_runs(
    foreign_fmu: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_NO_CODE", "1")
    assert hil(*RUN, "--set", f"plant.fmu={foreign_fmu}").returncode == 2
    assert hil(*RUN).returncode == 0
    monkeypatch.setenv("HIL_NO_CODE", "0")
    assert hil(*RUN, "--set", f"plant.fmu={foreign_fmu}").returncode == 0
