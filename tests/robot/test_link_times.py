"""Round trip and clock, from messages and stamps: against simulated ways there and back, and a clock that is known."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.robot.link_times import SYNC_PERIOD_NS, ClockSync

US = 1000
MS = 1_000_000


class Robot:
    """A robot whose clock is ``ahead_us`` ahead of the host's at zero, and faster by ``drift_ppm``."""

    def __init__(self, ahead_us, drift_ppm):
        self.ahead_us = ahead_us
        self.drift_ppm = drift_ppm

    def clock_us(self, host_ns):
        return self.ahead_us + host_ns / 1000 * (1 + self.drift_ppm * 1e-6)

    def offset_us(self, host_ns):
        return self.clock_us(host_ns) - host_ns / 1000

    def exchange(self, sync, at_ns, there_ns, held_us, back_ns):
        """One TIME_SYNC as wheel.dbc has it: whole microseconds, the robot's clock in 32 bits."""
        sequence = sync.request(at_ns)
        received_us = int(self.clock_us(at_ns + there_ns)) & 0xFFFF_FFFF
        stamp_ns = at_ns + there_ns + held_us * US + back_ns
        sync.answered(sequence, received_us, held_us, stamp_ns)
        return stamp_ns


@given(
    ahead_us=st.integers(-(2**31) + 10**6, 2**31 - 10**6),
    drift_ppm=st.floats(-500, 500),
    way_us=st.integers(0, 5000),
    held_us=st.integers(0, 2000),
)
def test_over_equal_ways_offset_and_drift_are_the_clock_s_own(ahead_us, drift_ppm, way_us, held_us):
    robot, sync = Robot(ahead_us, drift_ppm), ClockSync()
    for number in range(40):
        end_ns = robot.exchange(sync, number * SYNC_PERIOD_NS, way_us * US, held_us, way_us * US)
    # Quantised to 1 µs; while the robot holds the answer its clock drifts too.
    assert sync.offset_us == pytest.approx(robot.offset_us(end_ns), abs=2.0 + (way_us + held_us) * 5e-4)
    assert sync.drift_ppm == pytest.approx(drift_ppm, abs=0.5)


@given(seed=st.integers(0, 1000), drift_ppm=st.floats(-300, 300), ahead_us=st.integers(-(10**9), 10**9))
def test_of_ways_that_are_held_up_the_shortest_are_believed(seed, drift_ppm, ahead_us):
    draw = random.Random(seed)
    robot, sync = Robot(ahead_us, drift_ppm), ClockSync()
    raw_us, ways_us = 0.0, list[float]()
    for number in range(200):
        # Two in three are held up on one side by milliseconds; the rest is quick.
        there_us, back_us = (
            30 + (draw.expovariate(1 / 4000) if draw.random() < 0.42 else draw.random() * 5) for _ in "ab"
        )
        raw_us = max(raw_us, abs(there_us - back_us) / 2)
        ways_us.append(there_us + back_us)
        at_ns = number * SYNC_PERIOD_NS
        robot.exchange(sync, at_ns, int(there_us * US), 0, int(back_us * US))
    # The believed exchange is the shortest of the last 8: wrong by half its way at most, and its offset has drifted on.
    slack_us = 8 * SYNC_PERIOD_NS / US * abs(drift_ppm) * 1e-6
    error_us = abs(sync.offset_us - robot.offset_us(at_ns))
    assert raw_us > 2000
    assert error_us <= min(ways_us[-8:]) / 2 + slack_us + 2


@given(there_us=st.integers(0, 20_000), back_us=st.integers(0, 20_000), held_us=st.integers(0, 60_000))
def test_one_exchange_is_wrong_by_half_its_round_trip_at_most(there_us, back_us, held_us):
    robot, sync = Robot(1_000_000, 0.0), ClockSync()
    robot.exchange(sync, 5 * MS, there_us * US, held_us, back_us * US)
    assert abs(sync.offset_us - 1_000_000) <= (there_us + back_us) / 2 + 1
    way = sync.figures()["round_trip_us"]
    assert way["p50"] == way["p99"] == pytest.approx(there_us + back_us)


@pytest.mark.proves("R-TIME-4")
def test_the_robot_s_clock_wraps_and_the_offset_does_not():
    robot, sync = Robot(2**31 - 3_000_000, 0.0), ClockSync()
    seen = []
    for number in range(40):
        robot.exchange(sync, number * SYNC_PERIOD_NS, 0, 0, 0)
        seen.append(sync.offset_us)
    assert seen == [2**31 - 3_000_000] * 40
    assert sync.steps == 0


def test_a_robot_that_was_reset_has_another_clock():
    sync = ClockSync()
    for number in range(20):
        Robot(50_000_000, 200.0).exchange(sync, number * SYNC_PERIOD_NS, 0, 0, 0)
    reset = Robot(-4_000_000, 0.0)
    for number in range(20, 40):
        reset.exchange(sync, number * SYNC_PERIOD_NS, 0, 0, 0)
    assert sync.steps == 1
    assert sync.offset_us == -4_000_000
    assert sync.drift_ppm == pytest.approx(0.0, abs=1e-6)


def test_answers_that_cannot_be_right_change_nothing():
    sync = ClockSync()
    first = sync.request(0)
    second = sync.request(250 * MS)
    sync.answered(first, 0, 0, 251 * MS)  # of a request that was given up
    assert sync.awaiting
    sync.answered(second, 0, 0xFFFF, 400 * MS)  # held for longer than can be said
    third = sync.request(500 * MS)
    sync.answered(third, 0, 2000, 501 * MS)  # held for longer than the whole exchange took
    sync.answered(third, 0, 0, 502 * MS)  # a second time
    assert math.isnan(sync.offset_us)
    assert sync.figures() is None
    assert not sync.awaiting


def test_an_answer_that_is_lost_spoils_no_later_exchange():
    robot, sync = Robot(7_000, 0.0), ClockSync()
    sync.request(0)  # and no answer
    robot.exchange(sync, 250 * MS, 100 * US, 0, 100 * US)
    assert sync.offset_us == 7_000
    figures = sync.figures()
    assert (figures["requests"], figures["answered"], figures["round_trip_us"]["p50"]) == (2, 1, 200.0)
