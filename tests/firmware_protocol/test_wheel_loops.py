"""The loops of a wheel: the filter of its speed, the speed loop, and the current loop on a winding solved exactly."""

import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.host import parameters
from tests.support.bare_node import core
from tests.support.wheel_rig import PARAMETERS

TICK_S = 1e-3
LIMITS = {p.name: (p.minimum, p.maximum) for p in parameters()}


class Winding:
    """Four windings L di/dt = u - R i - k w, each tick of constant voltage and speed solved exactly, in binary64."""

    def __init__(self, resistance_ohm: float, inductance_h: float, constant_n_m_a: float) -> None:
        self.ffi, self.lib = core()
        self.resistance_ohm, self.constant_n_m_a = resistance_ohm, constant_n_m_a
        self.decay = math.exp(-resistance_ohm * TICK_S / inductance_h)
        self.current_a = [0.0] * 4
        self.loop = self.ffi.new("wheel_current_loop *")
        self.duty = self.ffi.new("float[4]")

    def step(self, target_a: float, parameters: Any, speed_rad_s: float = 0.0, battery_v: float = 24.0) -> float:
        """Let a tick pass and return the current of the first motor at its end."""
        self.lib.wheel_current_loop_update(
            self.loop, [target_a] * 4, self.current_a, [speed_rad_s] * 4, battery_v, parameters, self.duty
        )
        for i in range(4):
            settled = (self.duty[i] * battery_v - self.constant_n_m_a * speed_rad_s) / self.resistance_ohm
            self.current_a[i] = settled + (self.current_a[i] - settled) * self.decay
        return self.current_a[0]


def believed(**changes: float) -> Any:
    return core()[0].new("wheel_parameters *", PARAMETERS | changes)


def motor(scale_r: float = 1.0, scale_l: float = 1.0, scale_k: float = 1.0) -> Winding:
    p = PARAMETERS
    return Winding(
        p["motor_resistance_ohm"] * scale_r, p["motor_inductance_h"] * scale_l, p["torque_constant_n_m_a"] * scale_k
    )


@pytest.mark.parametrize("bandwidth_rad_s", [10.0, 100.0, 1000.0, 5000.0])
def test_a_step_rises_exactly_with_the_wanted_bandwidth(bandwidth_rad_s: float) -> None:
    """With the right model the current follows 1 - exp(-bandwidth * time), without overshoot."""
    for inductance_h in (1e-6, 5e-4, 0.05, 10.0):
        winding = Winding(0.6, inductance_h, 1.25)
        block = believed(motor_inductance_h=inductance_h, current_bandwidth_rad_s=bandwidth_rad_s)
        response = [winding.step(1e-3, block, battery_v=200.0) for _ in range(200)]
        wanted = [1e-3 * (1.0 - math.exp(-bandwidth_rad_s * n * TICK_S)) for n in range(1, 201)]
        assert response == pytest.approx(wanted, abs=1e-6)


@given(
    wrong=st.tuples(*[st.floats(0.7, 1.3)] * 3),
    bandwidth_rad_s=st.floats(50.0, 1000.0),
    speed_rad_s=st.floats(-8.0, 8.0),
    target_a=st.floats(-6.0, 6.0),
)
def test_no_steady_error_with_a_motor_that_is_30_percent_different(
    wrong: tuple[float, float, float], bandwidth_rad_s: float, speed_rad_s: float, target_a: float
) -> None:
    winding, block = motor(*wrong), believed(current_bandwidth_rad_s=bandwidth_rad_s)
    for _ in range(2000):
        winding.step(target_a, block, speed_rad_s)
    assert winding.current_a == pytest.approx([target_a] * 4, abs=1e-3)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_battery_that_is_too_weak_winds_nothing_up(sign: float) -> None:
    """After two seconds at full duty the current follows another target at once, with the wanted bandwidth."""
    winding, block = motor(), believed(current_bandwidth_rad_s=300.0)
    for _ in range(2000):
        winding.step(sign * 20.0, block, speed_rad_s=sign * 15.0)
    assert list(winding.duty) == [sign] * 4
    began_a = winding.current_a[0]
    response = [winding.step(sign, block, speed_rad_s=sign * 15.0) for _ in range(50)]
    wanted = [sign + (began_a - sign) * math.exp(-0.3 * n) for n in range(1, 51)]
    assert response == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize("battery_v", [0.0, -24.0, float("nan")])
def test_without_a_battery_the_duty_is_zero(battery_v: float) -> None:
    winding, block = motor(), believed()
    winding.loop.integral_v = [1.0] * 4
    winding.duty[0:4] = [1.0] * 4
    winding.step(5.0, block, battery_v=battery_v)
    assert list(winding.duty) == [0.0] * 4
    assert list(winding.loop.integral_v) == [0.0] * 4


def test_any_battery_above_zero_drives() -> None:
    winding = motor()
    winding.step(0.01, believed(), battery_v=0.2)
    assert winding.duty[0] > 0.0


@pytest.mark.parametrize("bandwidth_rad_s", [9.0, 11.0])
def test_a_slow_loop_is_as_slow_as_it_is_asked_to_be(bandwidth_rad_s: float) -> None:
    """So little of the way a tick is worked out by a series of its own."""
    winding = motor()
    winding.step(1.0, believed(current_bandwidth_rad_s=bandwidth_rad_s), battery_v=200.0)
    volts = winding.duty[0] * 200.0 / winding.resistance_ohm
    assert volts * (1.0 - winding.decay) == pytest.approx(-math.expm1(-bandwidth_rad_s * TICK_S), rel=3e-4)


@pytest.mark.parametrize(("bandwidth_rad_s", "overshoot"), [(300.0, 0.001), (1000.0, 0.001), (2000.0, 0.04)])
@pytest.mark.parametrize("resistance_ohm", [0.4, 0.6, 1.0])
def test_means_over_the_last_fifth_of_a_tick_leave_the_step_nearly_without_overshoot(
    bandwidth_rad_s: float, overshoot: float, resistance_ohm: float
) -> None:
    """A board with motors does not sample at the tick: its converter gives the mean over the 0.204 ms before it."""
    winding, window_s = motor(resistance_ohm / PARAMETERS["motor_resistance_ohm"]), 0.204e-3
    block = believed(motor_resistance_ohm=resistance_ohm, current_bandwidth_rad_s=bandwidth_rad_s)
    time_constant_s = -TICK_S / math.log(winding.decay)
    decay_s = time_constant_s * (math.exp(-(TICK_S - window_s) / time_constant_s) - winding.decay)
    true_a, response = 0.0, []
    for _ in range(50):
        winding.step(1.0, block, battery_v=200.0)  # takes the mean of the last tick for the current
        settled_a = winding.duty[0] * 200.0 / winding.resistance_ohm
        winding.current_a = [settled_a + (true_a - settled_a) * decay_s / window_s] * 4
        true_a = settled_a + (true_a - settled_a) * winding.decay
        response.append(true_a)
    assert max(response) <= 1.0 + overshoot
    assert response[-1] == pytest.approx(1.0, abs=1e-4)


_MOTOR = ("motor_resistance_ohm", "motor_inductance_h", "torque_constant_n_m_a", "current_bandwidth_rad_s")


@given(
    ends=st.tuples(*(st.sampled_from(LIMITS[name]) | st.floats(*LIMITS[name], width=32) for name in _MOTOR)),
    senses=st.lists(
        st.tuples(
            st.floats(-21.0, 21.0, width=32),
            st.floats(-1e6, 1e6, width=32),
            st.floats(-1e6, 1e6, width=32),
            st.floats(0.0, 1e6, width=32),
        ),
        min_size=1,
        max_size=30,
    ),
)
def test_duties_are_numbers_within_their_limits_at_any_parameters(
    ends: tuple[float, ...], senses: list[tuple[float, float, float, float]]
) -> None:
    ffi, lib = core()
    block = believed(**dict(zip(_MOTOR, ends, strict=True)))
    loop, duty = ffi.new("wheel_current_loop *"), ffi.new("float[4]")
    for target_a, current_a, speed_rad_s, battery_v in senses:
        lib.wheel_current_loop_update(loop, [target_a] * 4, [current_a] * 4, [speed_rad_s] * 4, battery_v, block, duty)
        assert all(-1.0 <= d <= 1.0 for d in duty)
        assert all(map(math.isfinite, loop.integral_v))


@given(x=st.floats(0.0, 25.0, width=32))
def test_exp_minus(x: float) -> None:
    assert core()[1].wheel_exp_minus(x) == pytest.approx(math.exp(-x), abs=5e-6)


def test_exp_minus_is_nothing_from_20_on() -> None:
    exp_minus = core()[1].wheel_exp_minus
    assert [exp_minus(x) for x in (20.0, 22.0, 1e30)] == [0.0] * 3
    assert exp_minus(19.9) > 0.0


@given(
    values=st.lists(st.floats(-1e6, 1e6, width=32), min_size=4, max_size=4),
    limit=st.floats(0.0, 100.0, width=32),
)
@example(values=[-0.2, 0.0, 0.0, 0.0], limit=0.125)
def test_scaling_keeps_the_direction_and_the_limit(values: list[float], limit: float) -> None:
    ffi, lib = core()
    scaled = ffi.new("float[4]", values)
    largest = max(map(abs, values))
    assert lib.wheel_scale_to_limit(scaled, limit) == (largest > limit)
    assert max(map(abs, scaled)) <= limit or largest <= limit
    factor = min(1.0, limit / largest) if largest else 1.0
    assert list(scaled) == pytest.approx([v * factor for v in values], rel=1e-5, abs=1e-6)


@given(counts=st.lists(st.integers(-3000, 3000), min_size=1, max_size=50), first=st.integers(0, 0xFFFF))
def test_the_filter_starts_at_rest_and_keeps_its_fraction_within_a_count(counts: list[int], first: int) -> None:
    ffi, lib = core()
    block, tracker = believed(), ffi.new("wheel_tracker *")
    assert abs(lib.wheel_tracker_update(tracker, first, block)) < 1e-6
    at = first
    for moved in counts:
        at = (at + moved) & 0xFFFF
        lib.wheel_tracker_update(tracker, at, block)
        assert 0.0 <= tracker.fraction < 1.0


KI, LIMIT_N_M = PARAMETERS["speed_ki_n_m_rad"], 5.0


def speed_loop(integral_n_m: float, error_rad_s: float, feedforward_n_m: float, ticks: int = 1) -> list[float]:
    """Return the integral and the torque of a wheel after so many ticks at a constant error; its limit is 5 N m."""
    ffi, lib = core()
    loop, torque = ffi.new("wheel_speed_loop *", {"integral_n_m": [integral_n_m] * 4}), ffi.new("float[4]")
    for _ in range(ticks):
        lib.wheel_speed_loop_update(
            loop, [error_rad_s] * 4, [0.0] * 4, [feedforward_n_m] * 4, believed(), LIMIT_N_M, torque
        )
    return [loop.integral_n_m[0], torque[0]]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_at_the_limit_an_integral_only_goes_back(sign: float) -> None:
    step = sign * 0.1 * KI * TICK_S
    far = sign * 20.0  # a feedforward that is beyond the limit alone
    assert speed_loop(sign * 0.1, sign * 0.1, far)[0] == pytest.approx(sign * 0.1)
    assert speed_loop(sign * 0.1, -sign * 0.1, far)[0] == pytest.approx(sign * 0.1 - step, rel=1e-6)
    assert speed_loop(0.0, sign * 0.1, far)[0] == pytest.approx(step, rel=1e-6)
    assert speed_loop(sign * 0.1, sign * 0.1, 0.0)[0] == pytest.approx(sign * 0.1 + step, rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_integral_stays_within_the_torque_limit(sign: float) -> None:
    """A feedforward against it keeps the sum below the limit, so that nothing else stops the integral."""
    integral, torque = speed_loop(sign * 4.9, sign * 0.5, -sign * 4.0, ticks=round(1.0 / (0.5 * KI * TICK_S)))
    assert abs(integral) == pytest.approx(LIMIT_N_M)
    assert abs(torque) < LIMIT_N_M
