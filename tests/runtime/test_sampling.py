"""When a tick begins: ticks that are late are skipped, and deadlines never drift."""

from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.clock import WallClock
from hil.core.types import Pose, PoseFix, Twist
from hil.robot.stm32 import Stm32
from hil.runtime.sampling import Sampling, Timing


class HandSetClock:
    """A clock that somebody sets."""

    def __init__(self) -> None:
        self.t_ns = 0

    def now_ns(self) -> int:
        return self.t_ns

    def wait_until(self, t_ns: int) -> int:
        late_ns = max(0, self.t_ns - t_ns)
        self.t_ns = max(self.t_ns, t_ns)
        return late_ns


class WaitsOnItsClock:
    """The part of a device by which time passes."""

    def __init__(self, clock: HandSetClock) -> None:
        self._clock = clock

    def wait_until(self, t_ns: int) -> int:
        return self._clock.wait_until(t_ns)


@given(
    st.sampled_from([1_000_000, 5_000_000, 50_000_000]),
    st.integers(0, 20_000_000),
    st.integers(0, 10**12),
    st.lists(st.integers(0, 40_000_000), min_size=1, max_size=50),
)
def test_each_tick_begins_on_its_own_deadline_whatever_the_ones_before_took(
    period_ns: int, feedback_latency_ns: int, origin_ns: int, work_ns: list[int]
) -> None:
    clock = HandSetClock()
    clock.t_ns = origin_ns
    device = cast(Stm32, WaitsOnItsClock(clock))
    sampling = Sampling(clock, device, None, Timing(period_ns, 0, feedback_latency_ns, 10**9))
    number = sampling.begin(origin_ns)
    for took_ns in work_ns:
        late_ns = sampling.wait(number)
        due_ns = origin_ns + number * period_ns + feedback_latency_ns
        assert clock.t_ns == max(due_ns, origin_ns)
        assert late_ns == clock.t_ns - due_ns or due_ns < origin_ns
        clock.t_ns += took_ns
        following = sampling.following(number)
        # The first that is still to come, and none that could have been on time is left out.
        assert following > number
        assert origin_ns + following * period_ns + feedback_latency_ns >= clock.t_ns
        if following > number + 1:
            assert origin_ns + (following - 1) * period_ns + feedback_latency_ns < clock.t_ns
        number = following


def test_the_wall_clock_waits_to_an_absolute_time_and_says_how_late_it_is() -> None:
    clock = WallClock()
    due_ns = clock.now_ns() + 2_000_000
    late_ns = clock.wait_until(due_ns)
    assert 0 <= late_ns <= clock.now_ns() - due_ns
    assert clock.wait_until(due_ns) >= late_ns


class TruthOfNow:
    """The true pose, whose time is that of the clock when it is asked for."""

    def __init__(self, clock: HandSetClock) -> None:
        self._clock = clock

    def poll(self) -> PoseFix:
        return PoseFix(self._clock.t_ns, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0))

    def close(self) -> None:
        """Nothing to release."""


@pytest.mark.parametrize("late_ms", [0, 2, 5, 10, 13])
def test_the_truth_of_a_tick_is_that_of_its_sampling_instant_or_the_last_one_before_it(late_ms: int) -> None:
    clock = HandSetClock()
    device = cast(Stm32, WaitsOnItsClock(clock))
    sampling = Sampling(clock, device, TruthOfNow(clock), Timing(5_000_000, 0, late_ms * 1_000_000, 10**9))
    clock.t_ns = 100_000_000
    first = sampling.begin(clock.t_ns)
    assert first == -(late_ms // 5)
    for number in (*range(first, 12), 20, *range(21, 30)):  # 8 ticks are skipped
        sampling.wait(number)
        assert clock.t_ns == 100_000_000 + max(0, number * 5_000_000 + late_ms * 1_000_000)
        fix = sampling.fix_of(number)
        if number < 0:
            assert fix is None
        else:
            # While ticks were skipped nobody looked: what was seen last was for the tick of that time.
            newest = min(number, 11 + late_ms // 5) if number < 20 + late_ms // 5 else number
            assert fix is not None
            assert fix.time_ns == 100_000_000 + newest * 5_000_000


def test_the_latency_of_a_command_is_that_of_both_ways() -> None:
    assert Timing(5_000_000, 3_000_000, 2_500_000, 0).latency_s == pytest.approx(0.0055)
