"""The motors of emulated controllers: they have the torque that was asked for, whatever their wheels do."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.addons.motors.emulated_motors import CurrentLoop


@given(st.floats(-200.0, 200.0), st.floats(-4.0, 4.0), st.floats(0.3, 2.0), st.floats(2e-4, 2e-3))
def test_a_motor_that_takes_voltages_has_its_torque_while_its_wheel_speeds_up(
    rises_rad_s2: float, torque_n_m: float, resistance_ohm: float, inductance_h: float
) -> None:
    """The measured speed is late by 13 ms, and the back-EMF of so much speed would be up to 5 N·m of torque."""
    constant, battery_v, tick_s, steps = 1.25, 48.0, 1e-3, 20
    loop = CurrentLoop(resistance_ohm, inductance_h, 1000.0)
    current_a, measured_a = 0.0, 0.0
    for tick in range(60):
        late_rad_s = rises_rad_s2 * max(tick * tick_s - 0.0133, 0.0)
        duty = loop.duty(torque_n_m / constant, measured_a, constant * late_rad_s, battery_v)
        assert -1.0 <= duty <= 1.0
        for step in range(steps):  # L di/dt = V - R i - κ ω, exact for a speed that is held
            speed_rad_s = rises_rad_s2 * (tick + (step + 0.5) / steps) * tick_s
            settles_a = (duty * battery_v - constant * speed_rad_s) / resistance_ohm
            current_a += (settles_a - current_a) * -math.expm1(-resistance_ohm * tick_s / steps / inductance_h)
        measured_a = current_a
    assert constant * current_a == pytest.approx(torque_n_m, abs=0.1)


def test_a_current_loop_without_a_battery_or_after_a_reset_begins_anew() -> None:
    loop = CurrentLoop(0.6, 5e-4, 1000.0)
    first = loop.duty(3.0, 0.0, 1.0, 24.0)
    assert loop.duty(3.0, 0.0, 1.0, 24.0) > first
    assert loop.duty(3.0, 0.0, 1.0, 0.0) == 0.0
    assert loop.duty(3.0, 0.0, 1.0, 24.0) == first
    loop.reset()
    assert loop.duty(3.0, 0.0, 1.0, 24.0) == first


@pytest.mark.parametrize("driver", ["odrive", "vesc"])
def test_makers_motors_that_take_voltages_hold_a_heavy_robot_on_its_circle(driver: str) -> None:
    """With the voltage for the current and a late back-EMF alone it swung by 0.14 rad and 3 mm for good."""
    sets = {
        "controller.command": "torque",
        "robot.torque_limit_n_m": 4.9,
        "firmware.torque_limit_n_m": 4.9,
        "firmware.current_limit_a": 3.92,
        "robot.speed_limit_rad_s": 17.28,
        "device.driver": driver,
        "plant.start.drive": "voltage",
        "plant.start.current_limit_a": 3.92,
        "plant.start.mass_kg": 26.4,
        "plant.start.inertia_kg_m2": 0.74,
        "plant.start.start_x_m": 0.0,
        "plant.start.start_heading_rad": -1.7,
        "link.command_latency_s": 0.009,
        "link.feedback_latency_s": 0.002,
        "loop.rate_hz": 250,
        "loop.duration_s": 6.0,
        "expect": [],
    }
    result = hil.run("compare_circle", law="profile", set=sets, lenient=True)
    assert result.failure is None
    late = result.signals["loop.t_s"] > 5.0
    assert abs(result.signals["error.heading_rad"][late]).max() < 0.002
    assert result.signals["error.planar_m"][late].max() < 0.0005
