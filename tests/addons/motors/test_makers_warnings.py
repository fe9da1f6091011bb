"""What motors of other makers are warned of: once they have answered, before they are armed, and what changes later."""

import contextlib
from contextlib import AbstractContextManager

import pytest

from hil.addons.service.messages import Phase
from hil.robot.virtual import MakeNode, VirtualRobot, VirtualStm32
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tests.support.pilot_bench import PilotBench

AWAY = {"kind": "disconnect", "target": "link", "start_s": 1.0, "end_s": 1.3}
LONG, ENDLESS = "the timeout of the VESC 1, 2, 3, 4 is 1000 ms", "the timeout of the VESC 1, 2, 3, 4 is 0"


def of_the_timeout(sentences: list[str]) -> list[str]:
    return [sentence for sentence in sentences if "the timeout of" in sentence]


def set_endless(robot: VirtualStm32) -> None:
    for vesc in robot.node.vescs:  # type: ignore[attr-defined]
        vesc.timeout_ticks = 0


def test_a_service_says_what_they_have_told_and_what_is_new_when_they_come_back() -> None:
    with PilotBench(**{"device.driver": "vesc", "fault": [AWAY]}) as bench:
        assert bench.notes == []
        bench.run_until(Phase.DISARMED)
        [said] = of_the_timeout(bench.notes)
        assert said.startswith(LONG)
        assert bench.bench.local is not None
        set_endless(bench.bench.local.robot)
        bench.run_until(Phase.AWAY)
        before = len(bench.notes)
        bench.run_until(Phase.DISARMED)
        [said] = of_the_timeout(bench.notes[before:])
        assert said.startswith(ENDLESS)


def test_a_run_says_what_is_new_when_they_come_back_before_it_arms_them() -> None:
    robots: list[VirtualStm32] = []
    said: list[str] = []

    def make(made_of: VirtualRobot, make_node: MakeNode) -> AbstractContextManager[VirtualStm32]:
        robots.append(VirtualStm32(made_of, make_node))
        return contextlib.closing(robots[0])

    def warn(sentence: str) -> None:
        said.append(sentence)
        if sentence.startswith(ENDLESS):
            assert not robots[0].node.is_driving  # type: ignore[attr-defined]
        set_endless(robots[0])

    changes = {"device.driver": "vesc", "loop.rearm": True, "loop.duration_s": 3.0, "fault": [AWAY], "expect": []}
    scenario = load("circle_speed", mode="lockstep", link="memory:", set=changes)
    assert run_scenario(scenario, RunOptions(make_robot=make, warn=warn)).failure is None
    first, second = of_the_timeout(said)
    assert first.startswith(LONG)
    assert second.startswith(ENDLESS)
    assert said[-1] == second


@pytest.mark.parametrize("link", ["memory:", "can:virtual/again"])
def test_a_run_says_nothing_twice(link: str) -> None:
    said: list[str] = []
    changes = {"device.driver": "vesc", "loop.rearm": True, "loop.duration_s": 3.0, "fault": [AWAY], "expect": []}
    scenario = load("circle_speed", mode="lockstep", link=link, set=changes)
    result = run_scenario(scenario, RunOptions(warn=said.append))
    assert (result.failure, len(result.metrics["recoveries"])) == (None, 1)
    assert len(of_the_timeout(said)) == 1
    assert len(said) == len(set(said))
