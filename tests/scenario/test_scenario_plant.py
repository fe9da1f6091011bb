"""[plant] in a scenario: the map of signals, start values of all types, and what belongs to a foreign FMU alone."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli.main import app
from hil.core.errors import BadInputError
from hil.runtime.provenance import properties
from hil.scenario import Scenario, load, resolved
from hil.scenario.layers import assign, make_layer, plain, stack

FOREIGN = """
extends = "paper_circle"
[plant]
fmu = "x.fmu"
timeout_s = 0.5
[plant.map]
"wheel.fl.torque_n_m" = "tau1"
"wheel.fl.angle_rad" = { name = "phi1", scale = 0.5, offset = 0.25, sign = -1 }
pose.x_m = "x"
[plant.start]
mass = 3
contact = "slip"
sticky = true
"""


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def scenario(text: str = FOREIGN, **options: object) -> Scenario:
    Path("my.toml").write_text(text, "utf-8")
    return load("my.toml", **options)  # type: ignore[arg-type]


def rows(loaded: Scenario) -> dict[str, tuple[object, ...]]:
    return {signal: (row.name, row.scale, row.offset, row.sign) for signal, row in loaded.plant.map.items()}


def test_a_row_is_a_name_or_a_table() -> None:
    loaded = scenario()
    assert rows(loaded) == {
        "wheel.fl.torque_n_m": ("tau1", None, 0.0, 1),
        "wheel.fl.angle_rad": ("phi1", 0.5, 0.25, -1),
        "pose.x_m": ("x", None, 0.0, 1),
    }
    assert loaded.plant.timeout_s == 0.5


def test_every_value_of_a_row_is_shown_with_its_origin() -> None:
    shown = {key: (value, where) for key, value, where in resolved(scenario())}
    assert shown["plant.map.wheel.fl.torque_n_m.name"] == ("tau1", "my.toml:7")
    assert shown["plant.map.wheel.fl.angle_rad.sign"] == (-1, "my.toml:8")
    assert shown["plant.map.pose.x_m.sign"] == (1, "default")


def test_start_values_are_numbers_truths_and_texts() -> None:
    start = scenario(set=["plant.start.contact=rigid"]).plant.start
    assert start == {"mass": 3.0, "contact": "rigid", "sticky": True}
    assert [type(value) for value in start.values()] == [float, str, bool]


def test_a_row_that_names_a_variable_replaces_the_row_before() -> None:
    renamed = scenario(set=["plant.map.wheel.fl.angle_rad=other", "plant.map.pose.y_m=y"])
    assert rows(renamed)["wheel.fl.angle_rad"] == ("other", None, 0.0, 1)
    assert rows(renamed)["pose.y_m"] == ("y", None, 0.0, 1)
    scaled = scenario(set=["plant.map.wheel.fl.angle_rad.scale=2"])
    assert rows(scaled)["wheel.fl.angle_rad"] == ("phi1", 2.0, 0.25, -1)


def test_every_spelling_of_a_row_is_the_same() -> None:
    quoted = make_layer({"plant": {"map": {"wheel.fl.count": {"name": "n", "sign": -1}}}}, "x")
    nested = make_layer({"plant": {"map": {"wheel": {"fl": {"count": {"name": "n", "sign": -1}}}}}}, "x")
    one_by_one = assign(assign({}, "plant.map.wheel.fl.count", "n", "x"), "plant.map.wheel.fl.count.sign", -1, "x")
    assert quoted == nested == one_by_one


def test_another_fmu_drops_the_variables_of_the_one_before() -> None:
    """paper_circle has start values of the shipped FMU."""
    assert set(scenario().plant.start) == {"mass", "contact", "sticky"}
    shipped = scenario(set=["plant.fmu=mecanum"])
    assert (shipped.plant.start, shipped.plant.map, shipped.plant.timeout_s) == ({}, {}, 0.5)


def test_the_shipped_fmus_share_their_variables() -> None:
    assert load("paper_circle", set=["plant.fmu=mecanum_fmi3"]).plant.start == load("paper_circle").plant.start


def test_start_values_without_a_named_fmu_are_the_shipped_ones() -> None:
    below = make_layer({"plant": {"start": {"start_x_m": 1.0}}}, "below")
    shipped, foreign = ({"plant": {"fmu": fmu}} for fmu in ("mecanum", "x.fmu"))
    assert plain(stack(below, make_layer(shipped, "above")))["plant"]["start"] == {"start_x_m": 1.0}
    assert "start" not in plain(stack(below, make_layer(foreign, "above")))["plant"]


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        (
            '"wheel.fl.torqe_n_m" = "t"',
            "scenario my.toml:3: plant.map.wheel.fl.torqe_n_m: the plant has no such signal",
        ),
        ('"wheel.fl.torqe_n_m" = "t"', "did you mean 'wheel.fl.torque_n_m'?"),
        ('"wheel.fl.torqe_n_m" = { name = "t", sign = -1 }', "plant.map.wheel.fl.torqe_n_m: the plant has no"),
        ("xyz = 't'", "plant.map.xyz: the plant has no such signal; known: accelerometer.x_m_s2, "),
        ("xyz = 't'", "wheel.*.angle_rad, wheel.*.count, wheel.*.current_a"),
        ('"pose.x_m" = 3', "my.toml:3: plant.map.pose.x_m.name = 3; expected text in quotation marks"),
        ('"pose.x_m" = ["x"]', 'plant.map.pose.x_m.name = ["x"]; expected text in quotation marks'),
        ('"pose.x_m" = ""', 'plant.map.pose.x_m.name = ""; expected text of one line, not empty'),
        ('"pose.x_m" = { sign = true }', "plant.map.pose.x_m.sign = true; expected 1 or -1"),
        (
            '"pose.x_m" = { name = "x", scal = 2 }',
            "unknown key plant.map.pose.x_m.scal; did you mean 'plant.map.pose.x_m.scale'?",
        ),
        ('"pose.x_m" = { name = "x", scale = 0 }', "plant.map.pose.x_m.scale = 0; expected a number greater than 0"),
        ('"pose.x_m" = { name = "x", offset = inf }', "pose.x_m.offset = inf; expected a finite number"),
        ('"pose.x_m" = { name = "x", sign = 2 }', "plant.map.pose.x_m.sign = 2; expected 1 or -1"),
    ],
)
def test_a_row_that_is_wrong(row: str, sentence: str) -> None:
    with pytest.raises(BadInputError) as caught:
        scenario(f'extends = "paper_circle"\n[plant.map]\n{row}\n')
    assert sentence in str(caught.value)
    assert str(caught.value).count("\n") == 0


def test_a_map_that_is_no_table() -> None:
    with pytest.raises(BadInputError, match=r"my\.toml:3: plant\.map = 3; expected a table"):
        scenario('extends = "paper_circle"\n[plant]\nmap = 3\n')


def test_the_hash_covers_the_map_and_the_bytes_of_a_foreign_fmu() -> None:
    hashes = [scenario().hash, scenario(set=["plant.map.pose.x_m.sign=-1"]).hash]
    for content in (b"one", b"two"):
        Path("x.fmu").write_bytes(content)
        hashes.append(scenario().hash)
    assert len(set(hashes)) == 4
    Path("x.fmu").rename("same_bytes.fmu")
    Path("my.toml").write_text(FOREIGN.replace("x.fmu", "same_bytes.fmu"), "utf-8")
    assert load("my.toml").hash == hashes[-1]


def test_a_recording_names_the_map_and_the_bytes_of_the_fmu() -> None:
    Path("x.fmu").write_bytes(b"one")
    told = properties(scenario())
    assert told["fmu_sha256"] == "7692c3ad3540bb803c020b3aee66cd8887123234ea0c6e7143c0add73ff431ed"
    assert told["map_sha256"] != properties(scenario(set=["plant.map.pose.x_m.sign=-1"]))["map_sha256"]
    assert json.loads(told["scenario"])["plant.map.wheel.fl.angle_rad.name"] == "phi1"
    Path("x.fmu").unlink()
    with pytest.raises(BadInputError, match=r"FMU 'x\.fmu' does not exist"):
        properties(scenario())
    assert "fmu_sha256" not in properties(scenario(set=["link.url=serial:/dev/robot"]))


def test_a_row_without_a_name_has_the_signals_own() -> None:
    scenario = load("paper_circle", set=["plant.map.wheel.fl.torque_n_m.sign=-1"])
    (row,) = scenario.plant.map.values()
    assert (row.name, row.sign) == ("wheel.fl.torque_n_m", -1)


def test_a_start_value_of_64_bits_keeps_them_and_a_longer_one_is_refused() -> None:
    assert load("paper_circle", set=[f"plant.start.n={2**63 + 1}"]).plant.start["n"] == 2**63 + 1
    with pytest.raises(BadInputError, match="within 64 bits"):
        load("paper_circle", set=[f"plant.start.n={10**400}"])


@pytest.mark.parametrize(
    ("key", "sentence"),
    [
        ("plant.fmu=nope.fmu", "does not exist"),
        ("plant.fmu=my.toml", "not a zip archive"),
        ("plant.map.wheel.fl.angle_rad=nix", "'nix'"),
        ('plant.map."wheel.fl.angle_rad".name=nix', "'nix'"),
        ("plant.start.mass=3", "has no such variable; did you mean 'mass_kg'?"),
    ],
)
def test_check_looks_at_the_plant_without_running_it(key: str, sentence: str) -> None:
    Path("my.toml").write_text('extends = "paper_circle"\n', "utf-8")
    done = CliRunner().invoke(app, ["check", "my.toml", "--set", key])
    assert isinstance(done.exception, BadInputError)
    assert sentence in str(done.exception)
    elsewhere = CliRunner().invoke(app, ["check", "my.toml", "--set", key, "--link", "serial:/dev/ttyACM0"])
    assert elsewhere.exit_code == 0
