"""The latency that a law is told: as configured in lockstep, as measured in real time."""

import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from firmware_protocol.generated.messages import State
from hil.robot.link_times import CommandLatency
from hil.robot.snapshot import Feedback
from hil.robot.stm32 import Stm32

MS = 1_000_000
CONFIGURED_S = 0.004
LONGEST_NS = 100 * MS
SHORT = {"loop.duration_s": 0.5, "expect": []}


def reported(sequence, at_ms, age_ms=2):
    """Return feedback of that robot time, with this command in force and its age."""
    zeros = (0.0,) * 4
    return Feedback(at_ms * MS, State.ACTIVE, sequence & 0xFF, age_ms, (0,) * 4, zeros, zeros, zeros[:3], 0.0)


NOTHING = reported(255, 0)


def told(latencies_ms, period_ms=5, start=0):
    """Return the latency reported after commands with these latencies, each in two TICKs; the second adds nothing."""
    meter = CommandLatency(CONFIGURED_S, LONGEST_NS)
    newest = reported(start - 1, 0)  # nobody's command
    for number, late_ms in enumerate(latencies_ms):
        sampled_ms, sequence = number * period_ms, (start + number) & 0xFF
        for _ in range(2):
            meter.applied(newest, sequence, sampled_ms * MS, None, False)
        newest = reported(sequence, sampled_ms + late_ms + 2)
    return meter.applied(newest, start, 0, None, False).latency_s


@given(late_ms=st.integers(0, 100), start=st.integers(0, 255), count=st.integers(9, 400))
def test_a_latency_that_stays_is_measured_to_the_firmware_s_tick(late_ms, start, count):
    assert told([late_ms] * count, start=start) == pytest.approx(late_ms * 1e-3)


def test_until_nine_commands_were_seen_it_is_the_configured_one():
    assert told([20] * 8) == CONFIGURED_S
    assert told([20] * 9) == pytest.approx(0.020)


@given(held_up=st.lists(st.integers(0, 32), max_size=16, unique=True), late_ms=st.integers(7, 90))
def test_less_than_half_of_the_commands_held_up_change_nothing(held_up, late_ms):
    latencies = [late_ms if number in held_up else 6 for number in range(33)]
    assert told(latencies) == pytest.approx(0.006)


def test_what_cannot_be_a_latency_is_left_out():
    assert told([101] * 50) == CONFIGURED_S  # longer than the robot's patience
    assert told([-1] * 50) == CONFIGURED_S
    meter = CommandLatency(CONFIGURED_S, LONGEST_NS)
    for sequence in range(50):
        meter.applied(reported(sequence, sequence), sequence, 0, None, False)  # another host's
        meter.applied(reported(sequence, 300, 255), sequence, 0, None, False)  # so old that the age says no more
    assert meter.s == CONFIGURED_S


def test_a_new_session_keeps_what_was_measured_and_forgets_what_was_sent():
    meter = CommandLatency(CONFIGURED_S, LONGEST_NS)
    newest = NOTHING
    for sequence in range(10):
        meter.applied(newest, sequence, 0, None, False)
        newest = reported(sequence, 7, 0)
    meter.restart()
    for _ in range(33):
        meter.applied(reported(9, 50, 0), 10, 0, None, False)
    assert meter.s == pytest.approx(0.007)


@given(st.lists(st.integers(0, 100), min_size=9, max_size=80))
def test_it_is_the_lower_median_of_the_last_33(latencies_ms):
    expected = statistics.median_low(latencies_ms[-33:])
    assert told(latencies_ms) == pytest.approx(expected * 1e-3)


@pytest.mark.parametrize("wrong", [(), (0, 1, 2, "a"), (0.5, 1, 2, 3), [0, 1, 2, 3], None])
def test_what_is_no_feedback_raises_and_notes_nothing(wrong):
    meter = CommandLatency(CONFIGURED_S, LONGEST_NS)
    with pytest.raises((TypeError, IndexError, SystemError)):
        meter.applied(wrong, 1, 0, None, False)
    for number in ("a", None, 0.5, 1 << 70):
        with pytest.raises((TypeError, OverflowError)):
            meter.applied(NOTHING, 1, number, None, False)
    assert [meter.applied(reported(1, 7, 0), 2, 0, None, False).latency_s for _ in range(20)] == [CONFIGURED_S] * 20


@pytest.mark.parametrize(("command_ms", "feedback_ms"), [(0, 0), (3, 2), (7, 0), (0, 10), (12, 9)])
@pytest.mark.parametrize("source", ["truth", "odometry"])
def test_on_exact_time_the_measured_latency_is_the_configured_one(source, command_ms, feedback_ms, monkeypatch):
    """Lockstep, but the loop takes it for real time: it then measures, and only the latency is late."""
    monkeypatch.setattr(Stm32, "is_lockstep", False)
    latency = {"link.command_latency_s": command_ms * 1e-3, "link.feedback_latency_s": feedback_ms * 1e-3}
    keys = {"firmware.watchdog_s": 0.1, "estimator.source": source, **latency}
    monkeypatch.setattr(CommandLatency, "__init__", _beginning_wrong(CommandLatency.__init__))
    found = hil.run("circle_speed", set=SHORT | keys).signals["link.latency_ms"]
    assert found[0] == pytest.approx(77.0)
    assert found[30:] == pytest.approx(command_ms + feedback_ms)


def _beginning_wrong(begin):
    return lambda meter, _, longest_ns: begin(meter, 0.077, longest_ns)


def test_in_lockstep_the_law_is_told_what_the_scenario_says():
    found = hil.run("circle_speed", set=SHORT).signals["link.latency_ms"]
    assert found == pytest.approx(5.0)
    assert len(set(found)) == 1


@pytest.mark.alone
@pytest.mark.parametrize("source", ["truth", "odometry"])
def test_in_real_time_the_latency_lies_between_the_scenarios_and_the_watchdog(source):
    keys = {"estimator.source": source}
    found = hil.run("circle_speed", set=SHORT | keys, mode="realtime").signals["link.latency_ms"]
    assert found[0] == pytest.approx(5.0)
    assert min(found) > 4.0 - 1e-9  # a tick of the firmware is 1 ms
    assert max(found) < 100.0
