"""The shipped suite: its scenarios are found by their names, and go everywhere."""

from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load, shipped_scenarios, suite_scenarios
from hil.scenario.load import SUITE_DIRECTORY


def test_a_scenario_of_the_suite_is_found_by_its_name_and_passes() -> None:
    """``hil verify`` runs all of them in ``make test-all``."""
    scenario = load("stop_estop")
    result = run_scenario(scenario, RunOptions(record=None, keep_signals=False))
    assert result.passed, result
    assert scenario.path is None
    assert scenario.directory == SUITE_DIRECTORY


def test_no_name_stands_for_two_scenarios_and_each_has_a_title() -> None:
    assert not set(suite_scenarios()) & set(shipped_scenarios())
    assert all(title and not title.endswith(".") for title in suite_scenarios().values())


def test_the_suite_has_each_law_and_each_driver() -> None:
    from hil.drivers.registry import SHIPPED as DRIVERS
    from hil.laws.registry import SHIPPED as LAWS

    scenarios = [load(name) for name in suite_scenarios()]
    assert {one.controller.law for one in scenarios} >= set(LAWS)
    assert {one.device.driver for one in scenarios} >= set(DRIVERS)
