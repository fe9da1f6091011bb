"""The benchmarks run; what they measure is not judged here, as a loaded machine would decide it."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.plant_testbed import FMU
from tools import socketcan
from tools.bench.__main__ import AT_LEAST, BENCHES, Row, judge
from tools.bench.realtime_tick import figures_of

ROOT = Path(__file__).parents[2]


def test_the_cost_of_a_step_is_printed_for_all_ways() -> None:
    command = [sys.executable, "-m", "tools.bench.fmu_step", "--repeats", "1", str(FMU)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for words in ("FMI 2, 12 outputs", "C loop over the FMU", "FMPy's class methods", "slip contact, torque"):
        assert words in done.stdout


def test_the_cost_of_windows_is_printed_beside_the_fmu_alone(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    command = [sys.executable, "-m", "tools.bench.window_stepper", "--repeats", "1", "--json", str(file)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(file.read_text(encoding="utf-8"))
    assert {"rigid, steps of 10 ms", "slip, friction, steps of 10 ms"} <= figures.keys()
    assert all(figure["times"] > 0.5 for figure in figures.values()), "no way does less than the FMU itself"


def test_a_missing_fmu_is_one_sentence() -> None:
    command = [sys.executable, "-m", "tools.bench.fmu_step", "none.fmu"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("tools.bench.fmu_step: FMU none.fmu does not exist")


def test_the_cost_of_foreign_can_traffic_is_printed_as_a_ratio() -> None:
    command = [sys.executable, "-m", "tools.bench.can_foreign", "--frames", "50", "--repeats", "2"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for words in ("python-can, recv loop", "CanLink.receive"):
        assert words in done.stdout


@pytest.mark.alone
@pytest.mark.parametrize("place", [[], ["--one-process"]])
def test_a_tick_in_real_time_is_measured_in_turns_with_a_sleeper(place: list[str], tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    command = [sys.executable, "-m", "tools.bench.realtime_tick", "--seconds", "0.4", "--turns", "1", *place]
    done = subprocess.run([*command, "--json", str(file)], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "only sleeps" in done.stdout
    figures = json.loads(file.read_text())
    assert 0.0 < figures["ours"]["tick_us"]["p50"] < figures["ours"]["tick_us"]["p99"]
    assert 0.0 <= figures["asleep"]["skipped_percent"] <= 100.0


def test_the_figures_of_a_tick_in_real_time_are_ratios_of_the_turns() -> None:
    def turn(p50_us: float, skipped: int) -> dict[str, Any]:
        return {"tick_us": {"p50": p50_us, "p99": 2 * p50_us}, "ticks": 1000 - skipped, "deadline_misses": skipped}

    turns = {"ours": [turn(30, 5), turn(90, 15), turn(40, 10)], "peer": [turn(60, 0), turn(100, 0), turn(50, 0)]}
    figures = figures_of(turns, [0, 3, 6], 1.0)
    assert figures["ours"] == {"tick_us": {"p50": 40, "p99": 80}, "skipped_percent": pytest.approx(1.0)}
    assert figures["skipped"]["beyond_asleep_percent"] == pytest.approx(0.7)
    assert figures["of_peer"] == {"median": pytest.approx(0.8), "turns": pytest.approx([0.5, 0.8, 0.9])}


@pytest.mark.alone
def test_the_rate_that_is_held_is_written_into_the_page_once(tmp_path: Path) -> None:
    page = tmp_path / "LIMITS.md"
    page.write_text("before\n<!-- rates: begin -->\n| another | row |\n<!-- rates: end -->\nafter\n")
    command = [sys.executable, "-m", "tools.bench.lateness", "--seconds", "0.4", "--turns", "1", "--rate", "200"]
    done = subprocess.run([*command, "--page", str(page)], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for words in (
        "200 Hz over serial:pty",
        "lateness of ticks",
        "feedback stamped to command sent",
        "of 80 ticks skipped",
    ):
        assert words in done.stdout
    lines = page.read_text().splitlines()
    assert [lines[0], lines[2], lines[-1]] == ["before", "| another | row |", "after"]
    assert "| serial:pty, 200 Hz |" in lines[3]
    assert len(lines) == 6


@pytest.mark.alone
@pytest.mark.skipif(socketcan.missing() is not None, reason=socketcan.missing() or "")
def test_the_rate_over_vcan_is_measured_inside_and_its_figures_come_out(tmp_path: Path) -> None:
    page, file = tmp_path / "LIMITS.md", tmp_path / "figures.json"
    page.write_text("<!-- rates: begin -->\n<!-- rates: end -->\n")
    command = [
        sys.executable,
        "-m",
        "tools.bench.lateness",
        "--vcan",
        "--seconds",
        "0.4",
        "--turns",
        "1",
        "--unrecorded",
    ]
    done = subprocess.run(
        [*command, "--page", str(page), "--json", str(file)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "200 Hz over can:socketcan/vcan0" in done.stdout
    figures = json.loads(file.read_text())
    assert figures["ticks"] + figures["deadline_misses"] == 80
    assert sum(figures["lateness_us"]["counts"]) == figures["ticks"]
    assert 0 < figures["reaction_us"]["p50"] <= figures["reaction_us"]["p99"]
    assert "without cyclictest" in done.stderr or sum(figures["cyclictest_us"]["counts"]) == 80
    (row,) = page.read_text().splitlines()[1:-1]
    assert "| can:socketcan/vcan0, 200 Hz, not recorded |" in row


ROWS = [row for bench in BENCHES for row in bench.rows]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.what)
def test_a_ratio_beyond_its_limit_is_a_loss_and_one_within_is_none(row: Row) -> None:
    worse, better = (0.5, 2.0) if row.holds is AT_LEAST else (2.0, 0.5)
    for short, limit in ((False, row.limit), (True, row.short_limit)):
        for share, held in ((worse, False), (better, True), (1.0, True)):
            figures = {row.place[0]: {row.place[1]: share * limit}}
            assert judge(row, figures, short=short)[2] is held
