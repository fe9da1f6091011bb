"""Each scenario of the suite passes: its claims, its limits, its faults, and the figures of its baseline."""

from pathlib import Path

import pytest

from hil.laws.law_registry import laws
from hil.robot.driver_registry import driver_names
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load, shipped_scenarios
from hil.scenario.baseline import asked_sha256, is_baseline

HERE = Path(__file__).parent
GOLDEN = {
    *("serial_vesc", "odometry_wheeltec", "driver_moteus", "reset_odrive", "reset_dbc", "hot_c620", "driver_rosmaster"),
    *("fused_bad_line", "law_mpc_torque", "payload_corner", "wild_computed_torque", "wild_lqi"),
}
"""The scenarios whose baselines have the hash of all frames too; `make test` runs these."""
SCENARIOS = {path.stem: path for path in sorted(HERE.glob("*.toml")) if not is_baseline(path)}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in GOLDEN else pytest.mark.slow) for name in SCENARIOS]
)
def test_a_scenario_runs_as_accepted(name: str) -> None:
    scenario = load(SCENARIOS[name])
    result = run_scenario(scenario, RunOptions(record=None, keep_signals=False))
    assert result.passed, result


@pytest.mark.slow
def test_each_scenario_has_a_title_of_its_own_and_the_baseline_of_what_it_asks() -> None:
    titles = {name: path.read_text(encoding="utf-8").partition("\n")[0] for name, path in SCENARIOS.items()}
    assert all(title.startswith("# ") and not title.endswith(".") for title in titles.values())
    assert not SCENARIOS.keys() & shipped_scenarios().keys()
    for name, path in SCENARIOS.items():
        scenario = load(path)
        assert scenario.baseline is not None, f"make it: cd tests/suite && hil baseline ./{name}.toml"
        assert scenario.baseline.scenario_sha256 == asked_sha256(scenario), name
        assert len(scenario.baseline.seeds) >= 10, name


@pytest.mark.slow
def test_golden_runs_have_each_driver_link_and_contact_and_a_law_of_each_family() -> None:
    """With those of the package; a law whose name begins as another's is of its family."""
    scenarios = [load(path) for path in SCENARIOS.values()] + [load(name) for name in shipped_scenarios()]
    golden = [one for one in scenarios if one.baseline is not None and one.baseline.wire_sha256]
    assert {one.name for one in golden} == GOLDEN | {"circle_speed", "paper_circle", "compare_circle", "circle_slip"}
    for part in (
        lambda one: one.device.driver,
        lambda one: one.link.url.partition(":")[0],
        lambda one: one.plant.start.get("contact", "roll"),
        lambda one: one.estimator.source,
        lambda one: one.controller.law.partition("_")[0],
    ):
        assert set(map(part, golden)) == set(map(part, scenarios))


@pytest.mark.slow
def test_the_suite_has_each_law_and_each_driver() -> None:
    scenarios = [load(path) for path in SCENARIOS.values()]
    assert {one.controller.law for one in scenarios} >= {name for name, _, _ in laws()}
    assert {one.device.driver for one in scenarios} >= set(driver_names())
