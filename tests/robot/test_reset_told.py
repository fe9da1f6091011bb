"""Messages to a user on a robot that was reset: by a run, a service, hil probe and hil params."""

import contextlib
import functools
from typing import Any

import pytest

from firmware_protocol.generated import messages as m
from firmware_protocol.host import HostNode
from hil.addons.service.messages import Phase
from hil.robot import parameters
from hil.robot.robot_report import ProcessorFault, reset_words
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from hil.wire.framed import StreamLink
from tests.robot.test_stm32 import Line, driver
from tests.support.pilot_bench import PilotBench
from tests.support.wheel_rig import WheelRig

SHORT: dict[str, Any] = {"loop.duration_s": 0.2, "expect": []}
FAULT = ProcessorFault(1 << 9 | 1 << 15, 1 << 30, 0x0800_1234, 0x0800_0101, 0, 0x6000_0000)


@pytest.mark.proves("R-RESET-5")
@pytest.mark.parametrize("cause", m.ResetCause)
def test_a_run_warns_once_of_a_reset_that_came_of_trouble(cause: m.ResetCause) -> None:
    said: list[str] = []
    make_node = functools.partial(HostNode, reset_cause=cause)
    run_scenario(load("circle_speed", set=SHORT), RunOptions(make_node=make_node, warn=said.append))
    told = [sentence for sentence in said if "was reset since" in sentence]
    assert len(told) == (cause.name in {"BROWN_OUT", "WATCHDOG", "LOW_POWER", "PROCESSOR_FAULT"})
    assert all(f"({cause.name}): {reset_words(cause)}" in sentence for sentence in told)


def test_a_service_tells_once_of_a_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    make_node = functools.partial(HostNode, reset_cause=m.ResetCause.WATCHDOG)
    monkeypatch.setattr("hil.runtime.local_robot.node_maker", lambda _device: make_node)
    with PilotBench() as bench:
        bench.run_until(Phase.DISARMED)
        bench.pilot.arm()
        bench.run_until(Phase.ACTIVE)
        bench.run(1.0)
        assert ["(WATCHDOG)" in note for note in bench.notes].count(True) == 1


def test_a_fault_is_told_with_its_place_and_its_address() -> None:
    said = reset_words(m.ResetCause.PROCESSOR_FAULT, FAULT)
    assert "at 0x08001234, called from 0x08000101 for address 0x60000000" in said
    assert "(CFSR 00008200, HFSR 40000000)" in said


def test_the_same_robot_is_known_again_after_a_fault() -> None:
    device, _ = driver(WheelRig(lockstep=True))
    info = device.connect()
    again = info._replace(processor_fault=FAULT, reset_cause=m.ResetCause.PROCESSOR_FAULT)
    assert info.is_same_robot(again)
    assert not info.is_same_robot(again._replace(build=1))
    assert "last reset PROCESSOR_FAULT" in again.describe()


def test_params_tell_the_last_reset() -> None:
    with contextlib.closing(StreamLink(Line(WheelRig()))) as link:
        assert "; last reset POWER_ON: it was powered on" in parameters.ParameterClient(link).greet().describe()
