"""The benchmarks run; what they measure is not judged here, as a loaded machine would decide it."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.plant_testbed import FMU
from tools.bench.__main__ import AT_LEAST, BENCHES, Row, judge

ROOT = Path(__file__).parents[1]


def test_the_cost_of_a_step_is_printed_for_all_ways() -> None:
    command = [sys.executable, "-m", "tools.bench.fmu_step", "--repeats", "1", str(FMU)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for words in ("FMI 2, 12 outputs", "C loop over the FMU", "FMPy's class methods", "slip contact, torque"):
        assert words in done.stdout


def test_a_missing_fmu_is_one_sentence() -> None:
    command = [sys.executable, "-m", "tools.bench.fmu_step", "none.fmu"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("tools.bench.fmu_step: FMU none.fmu does not exist")


def test_the_cost_of_foreign_can_traffic_is_printed_as_a_ratio() -> None:
    command = [sys.executable, "-m", "tools.bench.can_foreign", "--frames", "50", "--repeats", "2"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for words in ("python-can, recv loop", "CanLink.receive", "21 of 2048 identifiers"):
        assert words in done.stdout


@pytest.mark.alone
def test_the_rate_that_is_held_is_written_into_the_page_once(tmp_path: Path) -> None:
    page = tmp_path / "LIMITS.md"
    page.write_text("before\n<!-- rates: begin -->\n| another | row |\n<!-- rates: end -->\nafter\n")
    command = [sys.executable, "-m", "tools.bench.lateness", "--seconds", "1", "--turns", "1", "--rate", "200"]
    done = subprocess.run([*command, "--page", str(page)], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for words in ("lateness of ticks", "feedback stamped to command sent", "of 200 ticks skipped"):
        assert words in done.stdout
    lines = page.read_text().splitlines()
    assert [lines[0], lines[2], lines[-1]] == ["before", "| another | row |", "after"]
    assert "serial:pty, 200 Hz" in lines[3]
    assert len(lines) == 6


ROWS = [row for bench in BENCHES for row in bench.rows]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.what)
def test_a_ratio_beyond_its_limit_is_a_loss_and_one_within_is_none(row: Row) -> None:
    worse, better = (0.5, 2.0) if row.holds is AT_LEAST else (2.0, 0.5)
    for short, limit in ((False, row.limit), (True, row.short_limit)):
        for share, held in ((worse, False), (better, True), (1.0, True)):
            figures = {row.place[0]: {row.place[1]: share * limit}}
            assert judge(row, figures, short=short)[2] is held
