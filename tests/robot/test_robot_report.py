"""What a robot reports, in words and counts, from its messages alone."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.generated import messages as m
from hil.core.types import NAN_WHEELS
from hil.core.wheel_map import WheelMap
from hil.robot.robot_report import ProcessorFault, RobotReport, reset_words
from tests.support.examples import share_of_examples

STATUS = m.Status(*([0] * len(m.Status._fields)))
MAP = WheelMap(("rl", "fl", "fr", "rr"))


def report(**status: int) -> RobotReport:
    one = RobotReport(MAP)
    one.feed(STATUS._replace(**status))
    return one


def test_a_stop_has_its_reason_its_fault_and_the_wheel_of_the_scenario() -> None:
    assert RobotReport(MAP).stop_reason() == "a reason that it has not reported yet"
    assert report(stop_reason=m.StopReason.HOST_REQUEST).stop_reason() == "HOST_REQUEST"
    stopped = {"stop_reason": m.StopReason.COMMAND_TIMEOUT, "fault": m.Fault.OVERSPEED}
    assert report(**stopped).stop_reason() == "COMMAND_TIMEOUT (OVERSPEED)"
    for channel, wheel in enumerate(("rl", "fl", "fr", "rr")):
        told = report(**stopped, fault_wheel=m.FaultWheel.FL + channel)
        assert told.stop_reason() == f"COMMAND_TIMEOUT (OVERSPEED of wheel {wheel})"
        said = told.why_not_active(m.State.FAULT)
        assert said.startswith(
            f"the robot did not become ACTIVE: it is FAULT because of OVERSPEED of wheel {wheel}; it"
        )


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (None, "the robot answered HELLO but sends no feedback; reset it and try again"),
        (m.State.ACTIVE, "it is ACTIVE; another controller drives it; stop that controller first"),
        (m.State.ESTOP, "it is ESTOP; it is latched; release the e-stop, then restart the robot, or have its own host"),
        (
            m.State.FAULT,
            "it is FAULT; it is latched; find the cause, then restart the robot, or have its own",
        ),
        (m.State.IDLE, "it is IDLE; restart the robot and look at its link counters"),
    ],
)
def test_why_a_robot_is_not_active_and_what_to_do(state: m.State | None, words: str) -> None:
    for one in (RobotReport(MAP), report()):
        assert words in one.why_not_active(state)


def test_what_a_status_explains() -> None:
    assert not RobotReport(MAP).explains(m.State.IDLE)
    assert not RobotReport(MAP).knows_no_reason
    assert RobotReport(MAP).last_reset == ""
    told = report(state=m.State.FAULT, stop_reason=m.StopReason.NONE, reset_cause=m.ResetCause.PIN)
    assert (told.explains(m.State.FAULT), told.explains(m.State.ESTOP), told.knows_no_reason) == (True, False, True)
    assert told.last_reset == "its reset pin was pulled low"
    assert not report(stop_reason=m.StopReason.HOST_REQUEST).knows_no_reason


@share_of_examples(0.2)
@given(st.lists(st.lists(st.integers(0, 255), min_size=8, max_size=8), max_size=8))
def test_counters_of_a_byte_are_added_up_over_their_wrap_and_from_the_first_of_each_session(turns: list) -> None:
    one = RobotReport(MAP)
    size = len(m.LinkCounters._fields)
    expected = dict.fromkeys(m.LinkCounters._fields, 0)
    before = None
    for number, turn in enumerate(turns):
        if number == 4:
            one.restart()
            before = None
        one.feed(m.LinkCounters(*turn[:size]))
        if before is not None:
            for name, new, old in zip(expected, turn, before, strict=False):
                expected[name] += (new - old) % 256
        before = turn
    assert {name: one.rejected.get(name, 0) for name in expected} == expected


def test_counters_of_link_and_ports_are_kept_apart() -> None:
    one = RobotReport(MAP)
    link, ports = (kind(*range(len(kind._fields))) for kind in (m.LinkCounters, m.PortCounters))
    for message in (link, ports, ports._replace(**{ports._fields[0]: ports[0] + 3}), link):
        one.feed(message)
    assert {name: count for name, count in one.rejected.items() if count} == {ports._fields[0]: 3}


def test_battery_and_temperatures_stand_under_their_names_and_wheels() -> None:
    one = RobotReport(MAP)
    one.feed(m.Power(24.5, -1.5))
    assert one.health == (24.5, -1.5, NAN_WHEELS)
    one.feed(m.Temperatures(10, 20, 30, 40))
    assert one.health == (24.5, -1.5, (20.0, 30.0, 40.0, 10.0))
    one.feed(m.Power(23.5, 2.5))
    assert one.health == (23.5, 2.5, (20.0, 30.0, 40.0, 10.0))


@pytest.mark.parametrize(
    ("cause", "words"),
    [
        ("UNKNOWN", "the cause is unknown"),
        ("POWER_ON", "it was powered on"),
        ("BROWN_OUT", "its supply voltage was too low for the chip"),
        ("SOFTWARE", "its firmware or a debugger requested it"),
        ("WATCHDOG", "its watchdog expired because the firmware hung"),
        ("LOW_POWER", "it entered a low-power mode"),
    ],
)
def test_the_cause_of_a_reset_is_told_in_words(cause: str, words: str) -> None:
    assert report(reset_cause=m.ResetCause[cause]).last_reset == words


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({}, ""),
        ({"cfsr": 1, "hfsr": 0x4000_0000}, ": (CFSR 00000001, HFSR 40000000)"),
        ({"lr": 0x0800_0101}, ": at 0x00000000, called from 0x08000101 (CFSR 00000000, HFSR 00000000)"),
        ({"cfsr": 1 << 7, "mmfar": 0xA, "bfar": 0xB}, ": for address 0x0000000a (CFSR 00000080, HFSR 00000000)"),
        ({"cfsr": 1 << 15, "mmfar": 0xA, "bfar": 0xB}, ": for address 0x0000000b (CFSR 00008000, HFSR 00000000)"),
    ],
)
def test_a_processor_fault_tells_what_its_registers_hold(fault: dict[str, int], words: str) -> None:
    told = reset_words(m.ResetCause.PROCESSOR_FAULT, ProcessorFault(**fault))
    assert told == f"its processor had a fault{words}"
