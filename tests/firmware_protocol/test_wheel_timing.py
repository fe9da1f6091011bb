"""The age of feedback and of a truth in C, call by call, against the same rules in Python."""

from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.extension import library
from firmware_protocol.generated.messages import State

MS = 1_000_000
STALE_NS, LOST_NS, LEAP_NS = 50 * MS, 250 * MS, 1000 * MS
GOOD, RESET, STATE, UNREAD, SILENT = range(5)


class Ages:
    """The rules of ``wheel_timing.h`` as one would write them first."""

    def __init__(self) -> None:
        self.newest_ns: int | None = None
        self.received_ns = self.silent_ns = self.truth_received_ns = 0
        self.stamp_ns: int | None = None
        self.truth_ns: int | None = None
        self.ahead_ns: int | None = 0
        self.known = self.is_stale = False

    def add(self, robot_ns: int, state: State, age_ns: int, now_ns: int, driven: bool, truth_ns: int | None) -> int:
        if not self.known or (robot_ns != self.newest_ns and age_ns <= STALE_NS):
            if self.known and not driven and self.newest_ns is not None:
                passed_ns = now_ns - self.received_ns
                if abs(robot_ns - self.newest_ns - passed_ns) >= LEAP_NS:
                    return RESET
            self.known, self.newest_ns, self.received_ns = True, robot_ns, now_ns
        self.silent_ns = now_ns - self.received_ns
        if driven and state is not State.ACTIVE:
            return STATE
        if age_ns > (LOST_NS if driven else LEAP_NS):
            return UNREAD
        if age_ns <= STALE_NS and self.silent_ns > LOST_NS:
            return SILENT
        if truth_ns is not None:
            if self.ahead_ns is None or (self.stamp_ns is not None and truth_ns < self.stamp_ns - STALE_NS):
                self.ahead_ns = robot_ns - truth_ns
            if truth_ns != self.stamp_ns:
                self.stamp_ns, self.truth_received_ns = truth_ns, now_ns
            self.truth_ns = truth_ns + self.ahead_ns
        oldest_ns = [self.silent_ns]
        if self.truth_ns is not None:
            oldest_ns += [robot_ns - self.truth_ns, now_ns - self.truth_received_ns]
        self.is_stale = max(oldest_ns) > STALE_NS
        return GOOD

    def restart(self, was_reset: bool) -> None:
        self.known = False
        if was_reset:
            self.truth_ns = self.ahead_ns = None


times = st.sampled_from([0, 1, 5, 50, 51, 250, 251, 999, 1000, 1001, 1300]).map(lambda ms: ms * MS)
calls = st.one_of(
    st.tuples(times, st.sampled_from(State), times, times, st.booleans(), times | st.none()),
    st.tuples(times, st.just(State.ACTIVE), st.sampled_from([0, STALE_NS]), times, st.booleans(), times | st.none()),
    st.booleans(),
)


def driven(robot_ms: int, now_ms: int, truth_ms: int) -> tuple[object, ...]:
    return robot_ms * MS, State.ACTIVE, 0, now_ms * MS, True, truth_ms * MS


@given(st.lists(calls, max_size=30))
@example([driven(0, 0, 1000), driven(1, 1, 0)])  # the truth's clock jumped back
@example([driven(1000, 0, 0)])  # it is behind the robot
@example([driven(0, 0, 0), driven(50, 51, 0), driven(51, 52, 1)])  # no new one came
def test_ages_are_as_the_rules_say_whatever_comes(sequence: list[Any]) -> None:
    ffi, lib = library()
    ages, expected = ffi.new("wheel_freshness *", {"stale_ns": STALE_NS}), Ages()
    for call in sequence:
        if isinstance(call, bool):
            lib.wheel_freshness_restart(ages, call)
            expected.restart(call)
            continue
        *first, truth_ns = call
        given_truth = ffi.NULL if truth_ns is None else ffi.new("int64_t *", truth_ns)
        assert lib.wheel_freshness_add(ages, *first, given_truth) == expected.add(*call)
        assert (ages.silent_ns, ages.is_stale) == (expected.silent_ns, expected.is_stale)
        assert ages.has_truth == (expected.truth_ns is not None)
        assert not ages.has_truth or ages.truth_ns == expected.truth_ns
