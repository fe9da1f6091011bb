"""When a tick begins: ticks that are late are skipped, and deadlines never drift."""

from typing import cast

from hypothesis import given
from hypothesis import strategies as st

from hil.core.clock import WallClock
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
