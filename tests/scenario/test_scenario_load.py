"""Loading: the order of the layers, provenance, relative paths, the hash, and the shipped scenarios."""

import hashlib
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.host import Parameter, parameters
from hil.core.model import RobotModel
from hil.core.options import options_of
from hil.core.types import CommandMode
from hil.laws.law_registry import make_controller
from hil.references import make_reference
from hil.scenario import Scenario, load, resolved, shipped_scenarios
from hil.scenario.load import SHIPPED_DIRECTORY
from hil.scenario.scenario import tables_of
from hil.scenario.tables import RATES_HZ, FirmwareTable

BASE = 'extends = "paper_circle"\n'


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    return path


def where(scenario: Scenario, key: str) -> str:
    return scenario.provenance[key]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_shipped_scenario_can_be_built(name: str) -> None:
    scenario = load(name)
    assert scenario.name == name
    assert scenario.path is None
    assert scenario.expect
    make_reference(scenario.reference.kind, scenario.reference.options, scenario.directory)
    make_controller(
        scenario.controller.law,
        scenario.directory,
        scenario.robot,
        CommandMode[scenario.controller.command.upper()],
        scenario.controller.gains,
    )


@pytest.mark.parametrize(("name", "line"), shipped_scenarios().items())
def test_a_shipped_scenario_says_what_it_is(name: str, line: str) -> None:
    assert 20 < len(line) < 120, name


def test_the_paper_circle_has_the_papers_numbers() -> None:
    """Nguyen Minh et al. 2023, AFDSC, table V."""
    scenario = load("paper_circle")
    robot = scenario.robot
    assert (robot.mass_kg, robot.inertia_kg_m2, robot.wheel_radius_m) == (20.0, 0.56, 0.075)
    assert (robot.half_length_m, robot.half_width_m) == (0.3, 0.3)
    assert (scenario.reference.options["radius_m"], scenario.loop.duration_s) == (1.0, 15.0)
    assert load("paper_circle_dsc").controller.gains == {"k1_1_s": 15.0, "k2_1_s": 40.0, "filter_s": 0.0675}


def test_each_layer_wins_over_the_one_before(here: Path) -> None:
    write(here / "base.toml", BASE + "[robot]\nmass_kg = 21\n[loop]\nseed = 21\n")
    write(here / "mine.toml", 'extends = "base.toml"\n[robot]\nmass_kg = 22\n[loop]\nseed = 22\n')
    write(here / "robot.toml", "[robot]\nmass_kg = 23\n")
    assert load("base.toml").robot.mass_kg == 21.0
    assert load("mine.toml").robot.mass_kg == 22.0
    assert load("mine.toml", robot="robot.toml").robot.mass_kg == 23.0
    assert load("mine.toml", robot="robot.toml", set=["robot.mass_kg=24"]).robot.mass_kg == 24.0
    assert load("mine.toml", seed=23).loop.seed == 23
    assert load("mine.toml", seed=23, set=["loop.seed=24"]).loop.seed == 24


def test_provenance_names_the_file_and_line_or_the_option(here: Path) -> None:
    write(here / "mine.toml", BASE + "\n[robot]\nmass_kg = 22\n\n[[expect]]\nsignal = 'pose.x_m'\nbelow = 3\n")
    write(here / "robot.toml", "[link]\nurl = 'serial:pty'\n[firmware]\nramp_s = 0.1\n")
    scenario = load(
        "mine.toml",
        robot="robot.toml",
        mode="realtime",
        seed=3,
        set=["robot.inertia_kg_m2=1", "expect.1.above=1"],
    )
    assert where(scenario, "robot.mass_kg") == "mine.toml:4"
    assert where(scenario, "robot.wheel_radius_m").startswith("paper_circle.toml:")
    assert where(scenario, "robot.inertia_kg_m2") == "--set"
    assert where(scenario, "link.url") == "--robot robot.toml:2"
    assert where(scenario, "firmware.ramp_s") == "--robot robot.toml:4"
    assert where(scenario, "loop.mode") == "--mode"
    assert where(scenario, "loop.seed") == "--seed"
    assert where(scenario, "expect.1.below") == "mine.toml:8"
    assert where(scenario, "expect.1.above") == "--set"
    assert where(scenario, "expect.1.from_s") == "default"


def test_a_link_option_is_told_apart() -> None:
    scenario = load("paper_circle", link="can:virtual/a%2Fb")
    assert scenario.link.url == "can:virtual/a%2Fb"
    assert where(scenario, "link.url") == "--link"


def test_show_covers_every_value_once() -> None:
    scenario = load("paper_circle", set=["fault=[{kind='mute', target='TICK'}]", "controller.gains.extra=[1, 2]"])

    def count(value: object) -> int:
        if isinstance(value, dict):
            return sum(map(count, value.values()))
        if isinstance(value, tuple) and value and isinstance(value[0], dict):
            return sum(map(count, value))
        return 0 if value is None else 1

    rows = resolved(scenario)
    keys = [key for key, _, _ in rows]
    assert len(set(keys)) == len(keys) == count(tables_of(scenario))
    assert {"fault.1.target", "controller.gains.extra", "plant.start.start_x_m", "reference.radius_m"} <= {*keys}
    assert all(origin for _, _, origin in rows)


def test_what_show_prints_is_the_scenario(here: Path) -> None:
    """Every shown value set on another scenario of the same shape gives the first one."""
    first, second = load("circle_speed"), load("paper_circle_dsc")
    again = load("paper_circle_dsc", set={key: value for key, value, _ in resolved(first)})
    assert {key: value for key, value, _ in resolved(first)}.items() <= {
        key: value for key, value, _ in resolved(again)
    }.items()
    assert again.hash == first.hash != second.hash


def test_a_robots_own_file_runs_any_scenario(here: Path) -> None:
    write(
        here / "robot.toml",
        "[robot]\nmass_kg = 8\n[device]\nwheels = ['fr', 'fl', 'rl', 'rr']\nreversed = ['fr']\n",
    )
    for name in shipped_scenarios():
        scenario = load(name, robot=here / "robot.toml")
        assert scenario.robot.mass_kg == 8.0
        assert scenario.device.wheels == ("fr", "fl", "rl", "rr")


def test_another_law_needs_no_gains_of_the_one_before() -> None:
    for order in (
        ["controller.law=dsc", "controller.gains.k1_1_s=9"],
        ["controller.gains.k1_1_s=9", "controller.law=dsc"],
    ):
        assert load("paper_circle", set=order).controller.gains == {"k1_1_s": 9}


def test_set_takes_pythons_own_values() -> None:
    scenario = load(
        "paper_circle",
        set={
            "robot.mass_kg": np.float32(24),
            "loop.rate_hz": np.int64(200),
            "plant.start": {"start_x_m": np.float64(1.5)},
            "plant.fmu": Path("/tmp/a.fmu"),
            "device.reversed": ["fl", "rl"],
        },
    )
    assert (scenario.robot.mass_kg, scenario.loop.rate_hz) == (24.0, 200)
    assert type(scenario.plant.start["start_x_m"]) is float
    assert scenario.plant.start == {"start_x_m": 1.5}
    assert scenario.directory / scenario.plant.fmu == Path("/tmp/a.fmu")
    assert scenario.device.reversed == ("fl", "rl")


def test_paths_start_from_the_file_that_names_them(here: Path) -> None:
    write(here / "lib" / "base.toml", BASE + '[plant]\nfmu = "my.fmu"\n[controller]\nlaw = "./law.py:Law"\n')
    write(here / "runs" / "mine.toml", 'extends = "../lib/base.toml"\n')
    base, mine = load("lib/base.toml"), load("runs/mine.toml")
    assert base.controller.law == "./law.py:Law"
    assert base.directory == here / "lib"
    assert Path(mine.controller.law.removesuffix(":Law")).resolve() == here / "lib" / "law.py"
    assert (mine.directory / mine.plant.fmu).resolve() == here / "lib" / "my.fmu"
    assert where(mine, "plant.fmu").endswith("base.toml:3")
    assert mine.hash == base.hash
    given = load("runs/mine.toml", set=["controller.law=./other.py:Law"])
    assert Path(given.controller.law.removesuffix(":Law")).resolve() == here / "other.py"
    assert load("runs/mine.toml", set=["controller.law=package.law:Law"]).controller.law == "package.law:Law"


def test_a_file_with_windows_line_ends_and_byte_order_mark(here: Path) -> None:
    (here / "mine.toml").write_bytes(
        b"\xef\xbb\xbf" + (BASE + "[robot]\nmass_kg = 22\n").replace("\n", "\r\n").encode()
    )
    scenario = load("mine.toml")
    assert scenario.robot.mass_kg == 22.0
    assert where(scenario, "robot.mass_kg") == "mine.toml:3"


@pytest.mark.parametrize(
    ("rate_hz", "watchdog_s"),
    [(1000, 0.02), (500, 0.02), (250, 0.02), (200, 0.025), (125, 0.04), (100, 0.05), (50, 0.1), (20, 0.1)],
)
def test_the_watchdog_follows_the_command_rate(here: Path, rate_hz: int, watchdog_s: float) -> None:
    paper_circle = (SHIPPED_DIRECTORY / "paper_circle.toml").read_text(encoding="utf-8")
    write(here / "mine.toml", "\n".join(x for x in paper_circle.splitlines() if "watchdog_s" not in x))
    scenario = load("mine.toml", set=[f"loop.rate_hz={rate_hz}"])
    assert scenario.firmware.watchdog_s == watchdog_s
    assert where(scenario, "firmware.watchdog_s").startswith("default: 5 command periods")


def test_a_period_is_a_whole_number_of_firmware_ticks() -> None:
    for rate_hz in RATES_HZ:
        loop = load("paper_circle", set={"loop.rate_hz": rate_hz}).loop
        assert loop.substeps * 1_000_000 == loop.period_ns
        assert loop.period_ns * rate_hz == 1_000_000_000


@pytest.mark.parametrize("parameter", parameters(), ids=lambda parameter: parameter.name)
def test_the_firmware_takes_whatever_the_scenario_allows(parameter: Parameter) -> None:
    if parameter.name == "feedback_period_s":  # the period of the loop
        allowed = [1.0 / max(RATES_HZ), 1.0 / min(RATES_HZ)]
    else:
        options = {**options_of(RobotModel), **options_of(FirmwareTable)}
        within = options[parameter.name].range
        allowed = [bound for bound in (within.gt, within.ge, within.le) if bound is not None]
        assert len(allowed) == 2
    assert parameter.minimum <= np.float32(min(allowed))
    assert np.float32(max(allowed)) <= parameter.maximum


def test_a_scenario_is_frozen() -> None:
    scenario = load("paper_circle")
    with pytest.raises(FrozenInstanceError):
        scenario.robot.mass_kg = 1.0
    with pytest.raises(FrozenInstanceError):
        scenario.name = "other"


@pytest.mark.parametrize(
    "change",
    [
        "link.url=serial:pty",
        "link.command_latency_s=0.005",
        "loop.mode=realtime",
        "loop.duration_s=2",
        "controller.law=dsc",
        "reference.radius_m=2",
        "expect=[]",
        "fault=[{kind='drop', target='command', value=0.1}]",
        "estimator.source=odometry",
        "robot.mass_kg=20",
        "firmware.watchdog_s=0.1",
    ],
)
def test_the_hash_leaves_out_what_concerns_one_process(change: str) -> None:
    assert load("paper_circle", set=[change]).hash == load("paper_circle").hash


@pytest.mark.parametrize(
    "change",
    [
        "robot.mass_kg=20.000000000000004",
        "plant.start.start_x_m=0.81",
        "plant.start.friction_coefficient=0.0",
        "plant.fmu=./other.fmu",
        "plant.map.pose.x_m=x",
        "firmware.speed_kp_n_m_s_rad=1.2",
        "firmware.watchdog_s=0.03",
        "device.reversed=['fl']",
        "loop.rate_hz=500",
        "loop.seed=2",
    ],
)
def test_the_hash_covers_what_both_processes_share(change: str) -> None:
    assert load("paper_circle", set=[change]).hash != load("paper_circle").hash


@given(st.permutations([(f"start_{i}", float(i)) for i in range(5)]))
def test_the_hash_does_not_know_the_order(start: list[tuple[str, float]]) -> None:
    ordered = load("paper_circle", set={"plant.start": dict(sorted(start))})
    assert load("paper_circle", set={"plant.start": dict(start)}).hash == ordered.hash


def test_the_hash_is_that_of_the_canonical_text(here: Path) -> None:
    """The text is written out here: when it changes, so has HASH_FORMAT to."""
    write(
        here / "small.toml",
        """
        [robot]
        mass_kg = 20
        inertia_kg_m2 = 0.5
        wheel_radius_m = 0.1
        half_length_m = 0.3
        half_width_m = 0.2
        wheel_inertia_kg_m2 = 0
        torque_limit_n_m = 5
        speed_limit_rad_s = 60
        [plant]
        fmu = "lib/other.fmu"
        start = { x_m = 1, gear = "direct", is_on = true }
        map."pose.heading_rad" = { name = "psi", sign = -1 }
        [firmware]
        counts_per_revolution = 4096
        torque_limit_n_m = 5
        torque_constant_n_m_a = 1.25
        [device]
        reversed = ["rr", "fl"]
        [controller]
        law = "dsc"
        [reference]
        kind = "hold"
        [loop]
        rate_hz = 200
        duration_s = 1
        """,
    )
    canonical = (
        '{"device":{"reversed":["fl","rr"],"wheels":["fl","fr","rr","rl"]},'
        '"firmware":{"counts_per_revolution":4096,"current_bandwidth_rad_s":1000.0,"current_limit_a":20.0,'
        '"encoder_fault_s":0.1,"motor_inductance_h":0.0005,"motor_resistance_ohm":0.6,"overspeed_rad_s":100.0,'
        '"ramp_s":0.2,"speed_ki_n_m_rad":12.0,"speed_kp_n_m_s_rad":1.1,"temperature_limit_degc":120.0,'
        '"torque_constant_n_m_a":1.25,"torque_limit_n_m":5.0,"tracking_bandwidth_rad_s":150.0,'
        '"undervoltage_v":0.0,"watchdog_s":0.025},'
        '"format":4,"loop":{"rate_hz":200,"seed":1},'
        '"plant":{"fmu":"other.fmu",'
        '"map":{"pose.heading_rad":{"name":"psi","offset":0.0,"scale":null,"sign":-1,"unit":null}},'
        '"start":{"gear":"direct","is_on":true,"x_m":1.0},"step_s":null},'
        '"robot":{"friction_coefficient":0.0,"half_length_m":0.3,"half_width_m":0.2,"inertia_kg_m2":0.5,'
        '"mass_kg":20.0,"speed_limit_rad_s":60.0,"torque_limit_n_m":5.0,"wheel_inertia_kg_m2":0.0,'
        '"wheel_radius_m":0.1}}'
    )
    assert load("small.toml").hash == hashlib.sha256(canonical.encode()).hexdigest()
