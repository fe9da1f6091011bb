"""The mutants of ``hil verify``: the catalogue's contents, and the effect of each way of applying one."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from hil.addons.batch.job import FAILED, PASSED
from hil.addons.batch.pool import run_jobs
from hil.addons.verify.catalogue import FOLDER, ROOMS, read_catalogue
from hil.addons.verify.mutation import wrappers
from hil.addons.verify.mutation.change import CHANGES, ORDER, Change
from hil.addons.verify.mutation.mutant import FLOWS, IDS, from_text
from hil.addons.verify.mutation.wrappers import PORTS
from hil.addons.verify.suite import Member
from hil.core.errors import BadInputError
from hil.plant import archive
from hil.plant.description import start_defaults
from hil.record.reader import read
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load

SHORT = {"loop.duration_s": 1.0, "loop.rate_hz": 200, "expect": []}
CATALOGUE = read_catalogue()
ENTRIES = {entry.id: entry for entry in CATALOGUE.mutants}


# The catalogue


def test_the_catalogue_has_mutants_of_each_room_and_no_two_change_the_same() -> None:
    assert len(CATALOGUE.mutants) == len(ENTRIES) >= 200
    assert {entry.room for entry in CATALOGUE.mutants} == set(ROOMS)
    assert all(entry.wrong and entry.size for entry in CATALOGUE.mutants)
    changes = [entry.mutant._replace(id="").to_text() for entry in CATALOGUE.mutants]
    assert len(set(changes)) == len(changes)
    assert all(from_text(entry.mutant.to_text()) == entry.mutant for entry in CATALOGUE.mutants)
    assert CATALOGUE.variations
    mass = ENTRIES["plant.mass_more"]
    assert (mass.room, mass.way, mass.target) == ("plant", "start", "start")
    (row,) = [one for one in tomllib.loads((FOLDER / "plant.toml").read_text())["mutant"] if one["id"] == "mass_more"]
    assert (mass.wrong, mass.size, mass.mutant.start) == (row["wrong"], row["size"], row["start"])
    assert (ENTRIES["law.gain_half"].way, ENTRIES["law.gain_half"].target) == ("wrap", "law")


def test_every_row_of_the_catalogue_can_be_applied() -> None:
    known = start_defaults(archive.place("mecanum", Path())).keys()
    elements_of = {"plant": {**wrappers.DRIVE, **wrappers.SENSE}} | {name: one.of for name, one in PORTS.items()}
    for file in FOLDER.glob("*.toml"):
        for row in tomllib.loads(file.read_text(encoding="utf-8"))["mutant"]:
            assert row.keys() - {"start", "wrap"} == {"id", "wrong", "size"}, row
            assert len(row) == 4, "it is applied in one way"
    for entry in CATALOGUE.mutants:
        wrap = dict(entry.mutant.wrap)
        assert entry.mutant.start.keys() <= known, entry.id
        if not wrap:
            continue
        port, of = wrap.pop("port"), wrap.pop("of")
        if port == "link":
            assert of in ("sent", "received"), entry.id
            assert (wrap.pop("id") in IDS, wrap.keys() <= FLOWS.keys(), len(wrap)) == (True, True, 1)
        elif of not in ("model", "gains"):
            values = tuple(map(float, range(len(elements := elements_of[port][of]))))
            assert len(Change(elements, wrap)(values)) == len(values), entry.id


def test_the_page_on_mutants_names_every_port_and_change() -> None:
    page = (FOLDER.parent / "VERIFY.md").read_text(encoding="utf-8")
    for name, port in PORTS.items():
        [row] = [line for line in page.splitlines() if line.startswith(f"| `{name}` |")]
        assert {f"`{of}`" for of in port.of} <= set(row.replace(",", " ").replace(";", " ").split()), name
    for name in (*CHANGES, ORDER, *FLOWS, "sent", "received", *wrappers.DRIVE, *wrappers.SENSE):
        assert f"`{name}`" in page


# Each way of applying one


def outcomes_of(name: str, *ids: str, **sets: Any) -> list[dict[str, Any]]:
    """Return the extremes of the signals of a short run, healthy and with each of some mutants."""
    member = Member(name, load(name, set=SHORT | sets))
    jobs = [member.job(), *(member.job(ENTRIES[one].mutant) for one in ids)]
    outcomes = run_jobs(jobs, 2)
    assert {outcome.status for outcome in outcomes} <= {PASSED, FAILED}, [outcome.reason for outcome in outcomes]
    return [{**outcome.figures, **outcome.details["extremes"]} for outcome in outcomes]


def test_each_way_of_applying_a_mutant_changes_what_it_says() -> None:
    """Start values, and wrappers between firmware and plant, on the link, and of the reference."""
    healthy, heavy, warm, deaf, doubled, turned, backward = outcomes_of(
        "circle_speed",
        "plant.mass_more",
        "motors.temperature_fahrenheit",
        "wire.power_lost",
        "wire.speed_commands_twice",
        "plant.gyro_degrees",
        "host.reference_mirrored",
    )
    (by_hand,) = run_jobs([Member("x", load("circle_speed", set=SHORT | {"plant.start.mass_kg": 24.0})).job()], 1)
    assert heavy["wire_sha256"] == by_hand.figures["wire_sha256"] != healthy["wire_sha256"]
    fl = "wheel.fl.temperature_degc"
    assert warm[fl][:2] == pytest.approx([one + 30.0 for one in healthy[fl][:2]], abs=0.02)
    assert deaf["battery.voltage_v"] == [None] * 4 != healthy["battery.voltage_v"]
    assert healthy["link.rejected"][1] == 0 < doubled["link.rejected"][1]
    assert turned["robot.yaw_rate_rad_s"][1] > 10.0 * healthy["robot.yaw_rate_rad_s"][1]
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


def test_a_recording_names_the_mutant(tmp_path: Path) -> None:
    mutant = ENTRIES["law.torque_half"].mutant
    options = mutant.put_into(RunOptions(record=tmp_path / "run.rrd"))
    run_scenario(load("circle_speed", set={"loop.duration_s": 0.2, "expect": []}), options)
    properties = read(tmp_path / "run.rrd").properties
    assert {name: properties[name] for name in mutant.properties} == mutant.properties
    assert mutant.properties["mutant"] == "law.torque_half"


def test_a_mutant_is_refused_where_real_motors_may_move() -> None:
    scenario = load("paper_circle", mode="realtime", link="serial:/dev/robot")
    options = ENTRIES["law.gain_half"].mutant.put_into(RunOptions(allow_motion=True))
    with pytest.raises(BadInputError, match="a run whose parts are changed moves no real motors"):
        run_scenario(scenario, options)
