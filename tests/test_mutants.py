"""The mutants of ``hil verify``: the catalogue fits the sources, and each way of applying one does what it says."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from hil.batch.job import FAILED, PASSED
from hil.batch.plan import run_jobs
from hil.batch.verify import page as pages
from hil.batch.verify import verify as engine
from hil.batch.verify.catalogue import MOST_EQUIVALENT, ROOMS, Entry, check_sources, read_catalogue
from hil.batch.verify.suite import Member
from hil.core.errors import BadInputError
from hil.core.mutant import VARIABLE, Patch
from hil.core.subprocesses import module_command
from hil.review.reader import read
from hil.runtime.mutation import exchange, frames, wrappers
from hil.runtime.mutation.change import CHANGES, ORDER
from hil.scenario import load
from tests.processes import HIL, environment, hil

SHORT = {"loop.duration_s": 1.0, "loop.rate_hz": 200, "expect": []}
CATALOGUE = read_catalogue()
ENTRIES = {entry.id: entry for entry in CATALOGUE.mutants}


# The catalogue


def test_the_catalogue_has_enough_of_each_room_and_fits_the_sources() -> None:
    assert len(ENTRIES) >= 300
    for room in ROOMS:
        assert sum(entry.room == room for entry in CATALOGUE.mutants) >= 30, room
    assert sum(one.equivalent is not None for one in CATALOGUE.mutants) <= MOST_EQUIVALENT * len(ENTRIES)
    changes = [entry.mutant._replace(id="").to_text() for entry in CATALOGUE.mutants]
    assert len(set(changes)) == len(changes), "no two change the same"
    check_sources(CATALOGUE.mutants)
    assert CATALOGUE.variations


def test_the_page_on_mutants_names_every_port_and_change() -> None:
    page = (Path(pages.__file__).parent / "VERIFY.md").read_text(encoding="utf-8")
    for name, port in wrappers.PORTS.items():
        [row] = [line for line in page.splitlines() if line.startswith(f"| `{name}` |")]
        assert {f"`{of}`" for of in port.of} <= set(row.replace(",", " ").replace(";", " ").split()), name
    for name in (*CHANGES, ORDER, *frames.FLOWS, *frames.WAYS, *exchange.DRIVE, *exchange.SENSE):
        assert f"`{name}`" in page


def test_every_mutant_of_the_c_sources_compiles(tmp_path: Path) -> None:
    assert engine.build(CATALOGUE.mutants, tmp_path).keys() == ENTRIES.keys()


def test_a_row_that_is_wrong_is_refused_with_its_place(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'room = "plant"\nmutant = [\n'
        '  { id = "a", wrong = "w", size = "s", start = { mass_kg = 1.0 }, wrap = { port = "law" } },\n'
        '  { id = "b", wrong = "w", size = "s", wrap = { port = "law", of = "torqe", scale = -1 } },\n'
        '  { id = "c", wrong = "w", size = "s", wrap = { port = "law", of = "torque", scale = -1, element = "x" } },\n'
        '  { id = "d", wrong = "w", size = "s", patch = { file = "hil/cli/run.py", before = "a", after = "b" } },\n'
        '  { id = "mass_more", wrong = "w", size = "s", start = { mass_kg = 1.0 } },\n'
        '  { id = "e", wrong = "w", size = "s", rules = ["CMD-4"], start = { mass_kg = 1.0 } },\n'
        '  { id = "f", wrong = "w", size = "s", rules = ["R-CMD-4"], equivalent = "e", start = { mass_kg = 1 } },\n]\n',
        encoding="utf-8",
    )
    with pytest.raises(BadInputError) as refused:
        read_catalogue([file])
    lines = str(refused.value).splitlines()
    assert [line.partition(":")[0] for line in lines] == [
        f"mutants mine.toml, row {number} ({name})"
        for number, name in enumerate(("a", "b", "c", "d", "mass_more", "e", "f"), 1)
    ]
    assert "did you mean 'torque'?" in lines[1]
    assert "['CMD-4']: expected ids of rules" in lines[5]
    wrong = Entry("plant.x", "plant", "w", "s", "patch", ENTRIES["plant.mass_more"].mutant._replace(
        patches=[Patch("hil/laws/dsc.py", "no such text", "")]))  # fmt: skip
    with pytest.raises(BadInputError, match="'no such text' is there 0 times; expected once"):
        check_sources([wrong])


# Each way of applying one


def outcomes_of(name: str, *ids: str, **sets: Any) -> list[dict[str, Any]]:
    """Return the extremes of the signals of a short run, healthy and with each of some mutants."""
    member = Member(name, load(name, set=SHORT | sets))
    built = engine.build([ENTRIES[one] for one in ids])
    jobs = [member.job(), *(member.job(built[one].mutant, built[one].library) for one in ids)]
    outcomes = run_jobs(jobs, 2)
    assert {outcome.status for outcome in outcomes} <= {PASSED, FAILED}, [outcome.reason for outcome in outcomes]
    return [{**outcome.figures, **outcome.details["extremes"]} for outcome in outcomes]


def test_each_way_of_applying_a_mutant_changes_what_it_says() -> None:
    """Start values, a wrapper between firmware and plant, one on the link, and builds of firmware, client and plant."""
    healthy, heavy, warm, deaf, swapped, doubled, turned, backward = outcomes_of(
        "circle_speed",
        "plant.mass_more",
        "motors.temperature_fahrenheit",
        "wire.power_lost",
        "wire.battery_swapped",
        "wire.speed_commands_twice",
        "plant.gyro_sign",
        "host.circle_clockwise",
    )
    (by_hand,) = run_jobs([Member("x", load("circle_speed", set=SHORT | {"plant.start.mass_kg": 24.0})).job()], 1)
    assert heavy["wire_sha256"] == by_hand.figures["wire_sha256"] != healthy["wire_sha256"]
    fl = "wheel.fl.temperature_degc"
    assert warm[fl][:2] == pytest.approx([one + 30.0 for one in healthy[fl][:2]], abs=0.02)
    assert deaf["battery.voltage_v"] == [None] * 4 != healthy["battery.voltage_v"]
    assert swapped["battery.voltage_v"] == healthy["battery.current_a"]
    assert healthy["link.rejected"][1] == 0 < doubled["link.rejected"][1]
    low, high, *_ = healthy["robot.yaw_rate_rad_s"]
    assert turned["robot.yaw_rate_rad_s"][:2] == [-high, -low]
    assert backward["reference.y_m"][:2] == [-healthy["reference.y_m"][1], 0.0]


def test_wrappers_of_the_parts_of_a_tick_change_what_they_say() -> None:
    healthy, estimate, later, truth, fewer, law = outcomes_of(
        "compare_circle",
        "estimator.x_offset",
        "host.reference_late",
        "host.truth_offset",
        "law.torque_limited",
        "law.gain_half",
        **{"controller.law": "dsc", "controller.gains": {}},
    )
    assert estimate["pose.x_m"][:2] != healthy["pose.x_m"][:2]
    assert later["reference.y_m"][1] == pytest.approx(healthy["reference.y_m"][1], rel=0.03)
    assert later["reference.y_m"][1] < healthy["reference.y_m"][1]
    assert truth["truth.y_m"] != healthy["truth.y_m"]
    torques = [f"wheel.{wheel}.torque_command_n_m" for wheel in ("fl", "fr", "rr", "rl")]
    assert max(healthy[name][1] for name in torques) > 1.0 >= max(fewer[name][1] for name in torques)
    assert law["gain.k1_x_1_s"][:2] == [7.5, 7.5] != healthy["gain.k1_x_1_s"][:2]


def test_a_recording_and_the_results_name_the_mutant(tmp_path: Path) -> None:
    mutant = ENTRIES["law.torque_half"].mutant
    command = module_command("hil.cli.main", "run", "circle_speed", "--set", "loop.duration_s=0.2", "--json")
    done = subprocess.run(
        [*command, "--set", "expect=[]", "--record", str(tmp_path / "run.rrd")],
        env={**os.environ, **environment(), VARIABLE: mutant.to_text()}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert json.loads(done.stdout)["mutant"] == "law.torque_half"
    properties = read(tmp_path / "run.rrd").properties
    assert (properties["mutant"], properties["mutant_sha256"]) == ("law.torque_half", mutant.sha256)
    assert "law.torque_half, a known defect" in hil("review", tmp_path / "run.rrd").stdout
    healthy = json.loads(
        hil("run", "circle_speed", "--set", "loop.duration_s=0.2", "--record", "none", "--json").stdout
    )
    assert "mutant" not in healthy


def test_a_mutant_is_refused_where_real_motors_may_move() -> None:
    command = [*HIL, "run", "paper_circle", "--mode", "realtime", "--link", "serial:/dev/robot", "--allow-motion"]
    variables = environment() | {VARIABLE: ENTRIES["law.gain_half"].mutant.to_text()}
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "mutant 'law.gain_half' into this process: real motors get no known defect" in done.stderr
