"""Present and future motion of wheels, in C, against the same formulas in Python; and ticks that a limiter skips."""

import math
from itertools import accumulate
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.extension import library, wheel
from hil.core.model import RobotModel
from hil.core.motion_limits import BodyLimits, MotionLimits, TorqueSpeed
from hil.core.types import Pose, State, Twist, Wheels

MODEL = RobotModel(20.0, 0.56, 0.075, 0.3, 0.2, 0.005, torque_limit_n_m=5.0, speed_limit_rad_s=20.0)
AHEAD_S, LAG_S, OLD_S, LATENCY_S = 0.0183, 0.0133, 0.05, 0.005
STILL, MOST, SLIP = 1.0, 8.0, 2.0
BLIND, A_STEP = -1.5, 0.8  # of a coarse encoder: of a change 2 rad/s are not seen when 4.7 steps are to come

speeds = st.builds(Wheels, *[st.floats(-60.0, 60.0)] * 4)
slow = st.builds(Wheels, *[st.floats(-1.5, 1.5)] * 4)
odd = st.builds(Wheels, *[st.sampled_from([math.nan, math.inf, -math.inf, 0.0, -0.0])] * 4)
torques = st.builds(Wheels, *[st.floats(-5.0, 5.0)] * 4)
states = st.builds(
    State,
    st.builds(Pose, st.just(0.0), st.just(0.0), st.floats(-7.0, 7.0)),
    st.builds(Twist, *[st.floats(-4.0, 4.0)] * 3),
)
apart_ms = st.sampled_from([5, 5, 5, 5, 1, 0, 49, 51, -400])
ticks = st.lists(st.tuples(apart_ms, speeds | slow | odd, states, torques), max_size=25)


class Plain:
    """The rules of ``wheel_motion.h`` as one would write them first."""

    def __init__(self, slip_rad_s: float, older_s: float = 0.0, *, is_coarse: bool = False) -> None:
        self.slip_rad_s, self.older_s, self.is_coarse = slip_rad_s, older_s, is_coarse
        self.past: list[tuple[int, tuple[float, ...]]] = []
        self.time_ns, self.slip_ns = 0, -1
        self.before: Wheels | None = None
        self.slip: tuple[float, ...] | None = None
        self.once: tuple[float, ...] = (0.0,) * 4
        self.twice: tuple[float, ...] = self.once
        self.coming: tuple[float, ...] = self.once
        self.coming_slip: tuple[float, ...] = self.once
        self.steps = 0.0

    def add(self, speed: Wheels, time_ns: int, state: State) -> bool:
        before, before_ns = self.before, self.time_ns
        self.before, self.time_ns = speed if math.isfinite(sum(speed)) else None, time_ns
        apart_s = (time_ns - before_ns) * 1e-9
        self.steps = (AHEAD_S + LATENCY_S) / apart_s if before is not None and 0.0 < apart_s < OLD_S else 0.0
        if max(map(abs, speed)) <= STILL or not math.isfinite(sum(speed)):
            return False
        self.coming = self._ahead(speed, before)
        near = max(map(abs, self.coming)) > MOST
        if self.slip_rad_s == math.inf:
            return near
        rolling = MODEL.wheel_speeds(state.twist, state.pose.heading_rad)
        slip_before = None
        if time_ns < before_ns:
            self.once = self.twice = speed
        elif self.slip_ns != before_ns:
            self.once = self.twice = rolling
        else:
            slip_before = self.slip
            follows = -math.expm1(-2e-9 * (time_ns - before_ns) / LAG_S)
            self.once = tuple(old + follows * (new - old) for old, new in zip(self.once, rolling, strict=True))
            self.twice = tuple(old + follows * (new - old) for old, new in zip(self.twice, self.once, strict=True))
        if slip_before is None:
            self.past.clear()
        if self.older_s > 0.0:
            self.slip = self.coming_slip = self._beyond(speed, rolling, time_ns)
        else:
            self.slip = tuple(one - rolls for one, rolls in zip(speed, self.twice, strict=True))
            self.coming_slip = self._ahead(self.slip, slip_before)
        self.past.append((time_ns, self.twice))
        self.slip_ns = time_ns
        return near or max(map(abs, self.coming_slip)) > self.slip_rad_s

    def _beyond(self, speed: Wheels, rolling: tuple[float, ...], time_ns: int) -> tuple[float, ...]:
        """Return how far each speed is outside all that its wheel had since ``older_s`` and a lag, if it rolls."""
        since = [self.twice, rolling]
        for at_ns, rolled in reversed(self.past):
            since.append(rolled)
            if (time_ns - at_ns) * 1e-9 >= self.older_s + LAG_S:
                break
        else:
            since.append((0.0,) * 4)
        return tuple(
            one - min(max(one, min(had)), max(had)) for one, had in zip(speed, zip(*since, strict=True), strict=True)
        )

    def _ahead(self, now: tuple[float, ...], before: tuple[float, ...] | None) -> tuple[float, ...]:
        if before is None or not self.steps:
            return now
        blind = max(BLIND + self.steps * A_STEP, 0.0) if self.is_coarse else 0.0
        found = []
        for a, b in zip(now, before, strict=True):
            more = self.steps * (a - b)
            grows = (a - b) * a > 0.0 and abs(more) > blind
            found.append(a if not grows else a + (more - math.copysign(blind, more)) if blind else a + more)
        return tuple(found)


def times_ns(sequence: list[Any]) -> list[int]:
    return [1_000_000 * (500 + passed) for passed in accumulate(apart for apart, *_ in sequence)]


def tick(apart_ms: int, fl: float, vx_m_s: float = 0.75) -> tuple[object, ...]:
    state = State(Pose(0.0, 0.0, 0.0), Twist(vx_m_s, 0.0, 0.0))
    return apart_ms, Wheels(fl, 10.0, 10.0, 10.0), state, Wheels(1.0, -1.0, 1.0, 1.0)


@given(ticks, st.sampled_from([SLIP, math.inf]), st.sampled_from([0.0, 0.0, 0.011, 0.0223]), st.booleans())
@example([tick(0, 5.0), tick(5, 6.0), tick(5, 7.0)], math.inf, 0.0, False)  # only its speed
@example([tick(0, 5.0), tick(5, 5.3), tick(5, 7.0), tick(5, 7.2)], math.inf, 0.0, True)  # less and more than is seen
@example([tick(0, 5.0), tick(5, 5.0, math.nan), tick(5, 5.0)], SLIP, 0.0, False)
@example([tick(0, 5.0), tick(5, 6.0), tick(5, 1.0), tick(5, 3.0), tick(5, 30.0)], SLIP, 0.011, False)
@example([tick(0, 5.0), *[tick(40, one) for one in (6.0, 1.0, 3.0, 30.0, 12.0)]], SLIP, 0.011, False)
def test_what_wheels_will_do_is_as_the_rules_say_whatever_they_did(
    sequence: list[Any], slip_rad_s: float, older_s: float, is_coarse: bool
) -> None:
    ffi, _ = library()
    wheels = {"wheel_radius_m": MODEL.wheel_radius_m, "lever_m": MODEL.lever_m, "ahead_s": AHEAD_S, "lag_s": LAG_S}
    limits = {"still_rad_s": STILL, "most_rad_s": MOST, "most_slip_rad_s": slip_rad_s}
    limits |= {"blind_rad_s": BLIND, "blind_rad_s_a_step": A_STEP} if is_coarse else {}
    made = wheel.Motion()
    motion = ffi.cast("wheel_motion *", made.address)
    for name, value in (wheels | limits).items():
        setattr(motion, name, value)
    add, expected = made.add, Plain(slip_rad_s, older_s, is_coarse=is_coarse)
    for (_, speed, state, _), time_ns in zip(sequence, times_ns(sequence), strict=True):
        near = expected.add(speed, time_ns, state)
        found = add(speed, time_ns, state, LATENCY_S, older_s)
        if not any(map(math.isnan, (*expected.coming, *expected.coming_slip))):  # NaN is not within
            assert found == near
        assert repr(motion.steps) == repr(expected.steps)
        for name, four in (("coming_rad_s", expected.coming), ("coming_slip_rad_s", expected.coming_slip)):
            assert list(map(repr, getattr(motion, name))) == list(map(repr, map(float, four))), name
        assert list(map(repr, motion.slip_rad_s)) == list(map(repr, map(float, expected.slip or (0.0,) * 4)))


@pytest.mark.parametrize(
    "wrong",
    [{0: (1.0, None)}, {1: None}, {2: (("x", 0.0, 0.0), ())}, {2: ((0.0,) * 3,)}, {3: None}, {4: "old"}],
    ids=str,
)
def test_what_raises_leaves_all_as_it_was(wrong: dict[int, object]) -> None:
    ffi, _ = library()
    made = wheel.Motion()
    motion = ffi.cast("wheel_motion *", made.address)
    motion.wheel_radius_m, motion.lever_m = MODEL.wheel_radius_m, MODEL.lever_m
    add = made.add
    _, speed, state, _ = tick(0, 5.0)
    good = [speed, 500_000_000, state, LATENCY_S, 0.011]
    add(*good)
    before = bytes(ffi.buffer(motion))
    bad = dict(enumerate(good)) | {1: 505_000_000, 4: 0.02} | wrong
    with pytest.raises((TypeError, IndexError)):
        add(*bad.values())
    assert bytes(ffi.buffer(motion)) == before


@given(ticks, st.sampled_from([0.3, math.inf]), st.sampled_from(["protection", "limit", "off"]), st.booleans())
@example([tick(5, one) for one in (10.0, 10.0, 16.0, 13.0, 12.0, 11.0, 10.0, 10.0, 10.0)], 0.3, "protection", False)
def test_torques_are_the_same_where_the_limiter_is_asked_in_every_tick(
    sequence: list[Any], slip_m_s: float, torque_speed: TorqueSpeed, has_body: bool
) -> None:
    asked, always = (MotionLimits(MODEL, 0.005, slip_m_s, torque_speed) for _ in range(2))
    for made in (asked, always):
        made.body = BodyLimits(0.5, 1.0) if has_body else None
        made.limit_to(32.0, 40.0)
    for (_, speed, state, torque), time_ns in zip(sequence, times_ns(sequence), strict=True):
        left = asked.faded(torque) if asked.is_near(speed, time_ns, state, LATENCY_S, 0.0) else torque
        is_still = max(map(abs, speed)) <= always._motion.still_rad_s  # nothing is worked out then
        always.is_near(speed, time_ns, state, LATENCY_S, 0.0)
        assert left == (torque if is_still or not math.isfinite(sum(speed)) else always.faded(torque))
