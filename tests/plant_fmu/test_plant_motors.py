"""Motors and battery: what an engineer checks on the bench with an ammeter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.support.examples import share_of_examples
from tests.support.plant_testbed import AXLE_TORQUES, CURRENT, CURRENTS, DEFAULTS, SPEEDS, VOLTAGE, robot

CONSTANT, RESISTANCE = DEFAULTS["motor_constant_n_m_a"], DEFAULTS["motor_resistance_ohm"]
INDUCTANCE, SOURCE_V = DEFAULTS["motor_inductance_h"], DEFAULTS["battery_voltage_v"]
BATTERY_OHM = DEFAULTS["battery_resistance_ohm"]
# So heavy that it does not move while currents settle; so strong that the limit is never reached.
BLOCKED = {"drive": VOLTAGE, "mass_kg": 1e4, "inertia_kg_m2": 1e4, "current_limit_a": 1e4, "motor_constant_n_m_a": 1e-3}


@pytest.mark.parametrize("battery_ohm", [0.0, 0.05, 5.0])
@pytest.mark.parametrize("inductance_h", [1e-5, 5e-4, 0.01])
def test_the_stall_current_is_voltage_over_resistance(inductance_h: float, battery_ohm: float) -> None:
    """Four blocked motors on the whole battery: U / (R + 4 Rb) each, whatever the windings and however weak it is."""
    with robot(BLOCKED, motor_inductance_h=inductance_h, battery_resistance_ohm=battery_ohm) as plant:
        plant.duty([1.0] * 4)
        plant.step(0.01, 40)
        np.testing.assert_allclose(plant.read(CURRENTS), SOURCE_V / (RESISTANCE + 4 * battery_ohm), rtol=1e-6)
        np.testing.assert_allclose(plant.read(AXLE_TORQUES), plant.read(CURRENTS) * 1e-3, rtol=1e-14)


@pytest.mark.parametrize("inductance_h", [1e-5, 1e-3])
def test_short_circuited_motors_swing_with_the_robot(inductance_h: float) -> None:
    """Windings without resistance are springs: v0 cos(w t), w^2 = 4 constant^2 / (r^2 (m + k) L); up to 5000 rad/s."""
    mass, r = 1.0, DEFAULTS["wheel_radius_m"]
    carried = 4 * DEFAULTS["wheel_inertia_kg_m2"] / r**2
    swing = 2 * CONSTANT / (r * np.sqrt((mass + carried) * inductance_h))
    start = {"drive": VOLTAGE, "mass_kg": mass, "motor_inductance_h": inductance_h, "motor_resistance_ohm": 1e-4}
    with robot(start, battery_resistance_ohm=0.0, current_limit_a=1e5, start_vx_m_s=0.5) as plant:
        for n in range(1, 20):
            plant.step(0.5 / swing)
            decay = np.exp(-0.25 * n / swing * 1e-4 / inductance_h)
            assert plant["twist.vx_m_s"] == pytest.approx(0.5 * decay * np.cos(0.5 * n), abs=0.002)


def test_the_no_load_speed_is_voltage_over_constant() -> None:
    with robot(drive=VOLTAGE) as plant:
        plant.duty([0.5] * 4)
        plant.step(5.0, 4)
        np.testing.assert_allclose(plant.read(SPEEDS), 0.5 * SOURCE_V / CONSTANT, rtol=1e-9)
        np.testing.assert_allclose(plant.read(CURRENTS), 0.0, atol=1e-6)


def test_a_current_rises_with_the_electrical_time_constant() -> None:
    """A blocked motor of L / R alone: 1 - exp(-t R / L), here on one wheel and without the battery's resistance."""
    tau_s = INDUCTANCE / RESISTANCE
    with robot(BLOCKED, battery_resistance_ohm=0.0, longest_step_s=2e-5) as plant:
        plant.duty([0.3, 0.0, 0.0, 0.0])
        for n in range(1, 4):
            plant.step(tau_s)
            expected = 0.3 * SOURCE_V / RESISTANCE * (1 - np.exp(-n))
            assert plant["wheel.fl.current_a"] == pytest.approx(expected, rel=1e-5)
        assert abs(plant["wheel.fr.current_a"]) < 1e-3


def test_a_turning_motor_opposes_its_voltage() -> None:
    """At 10 rad/s, without duty, a heavy robot drives a current of minus back-EMF over resistance: it brakes."""
    r = DEFAULTS["wheel_radius_m"]
    with robot(drive=VOLTAGE, mass_kg=1e4, start_vx_m_s=10 * r, current_limit_a=1e3) as plant:
        plant.step(0.02)
        speed = plant["wheel.fl.speed_rad_s"]
        assert plant["wheel.fl.current_a"] == pytest.approx(-CONSTANT * speed / RESISTANCE, rel=1e-3)
        assert plant["accelerometer.x_m_s2"] < 0


@pytest.mark.parametrize("drive", [CURRENT, VOLTAGE], ids=["current", "voltage"])
@pytest.mark.parametrize("battery_ohm", [0.0, 0.05, 1.5])
def test_the_battery_sags_by_its_resistance(drive: int, battery_ohm: float) -> None:
    """V = U - Rb I, I the currents weighted by the part of the voltage on each motor, its power over V."""
    start = {"drive": drive, "battery_resistance_ohm": battery_ohm, "start_vx_m_s": 0.4, "current_limit_a": 1e3}
    with robot(start) as plant:
        plant.duty([0.1, 0.2, -0.1, 0.25])
        plant.torque([1.0, 2.0, -1.0, 2.5])
        plant.step(0.004)
        voltage, current = plant["battery.voltage_v"], plant["battery.current_a"]
        currents, speeds = plant.read(CURRENTS), plant.read(SPEEDS)
        assert voltage == pytest.approx(SOURCE_V - battery_ohm * current, rel=1e-9)
        duty = [0.1, 0.2, -0.1, 0.25]
        if drive == CURRENT:
            duty = (RESISTANCE * currents + CONSTANT * speeds) / voltage
            assert np.abs(duty).max() <= 1 + 1e-12
        assert current == pytest.approx(np.dot(duty, currents), rel=1e-9)


def test_a_weak_battery_gives_no_more_than_it_can() -> None:
    """Behind 50 Ohm there are U^2 / 4 Rb = 2.9 W; set points that ask for 38 W share the voltage that is left."""
    with robot(BLOCKED, drive=CURRENT, battery_resistance_ohm=50.0, current_limit_a=4.0) as plant:
        plant.torque([4e-3] * 4)
        voltage = SOURCE_V / (1 + 4 * 50.0 / RESISTANCE)
        np.testing.assert_allclose(plant.read(CURRENTS), voltage / RESISTANCE, rtol=1e-9)
        assert plant["battery.voltage_v"] == pytest.approx(voltage, rel=1e-9)
        assert plant["battery.current_a"] == pytest.approx(4 * voltage / RESISTANCE, rel=1e-9)


def test_braking_charges_the_battery() -> None:
    with robot(drive=CURRENT, start_vx_m_s=1.0) as plant:
        plant.torque([-0.5] * 4)
        assert plant["battery.current_a"] < 0
        assert plant["battery.voltage_v"] > SOURCE_V


@pytest.mark.parametrize("battery_ohm", [0.0, 0.05, 1.0])
@pytest.mark.parametrize("start_vx_m_s", [0.0, 0.5, -0.5])
def test_both_drives_push_what_the_battery_pushes(battery_ohm: float, start_vx_m_s: float) -> None:
    """The current of an endless set point is that of full duty in the steady state."""
    heavy = {**BLOCKED, "motor_constant_n_m_a": CONSTANT, "start_vx_m_s": start_vx_m_s, "mass_kg": 1e4}
    heavy |= {"battery_resistance_ohm": battery_ohm}
    with robot({**heavy, "drive": CURRENT}) as ideal, robot(heavy) as wound:
        wound.duty([1.0, 1.0, -1.0, 1.0])
        wound.step(0.02)
        ideal.torque([1e5, 1e5, -1e5, 1e5])
        ideal.step(0.02)
        np.testing.assert_allclose(ideal.read(CURRENTS), wound.read(CURRENTS), rtol=2e-3, atol=1e-3)
        assert ideal["battery.voltage_v"] == pytest.approx(wound["battery.voltage_v"], rel=2e-3, abs=1e-6)


def test_an_ideal_current_follows_its_set_point_up_to_the_limit() -> None:
    with robot(drive=CURRENT, current_limit_a=3.0) as plant:
        plant.torque([1.25, -2.5, 3.75, -10.0])
        np.testing.assert_array_equal(plant.read(CURRENTS), [1.0, -2.0, 3.0, -3.0])
        np.testing.assert_allclose(plant.read(AXLE_TORQUES), CONSTANT * plant.read(CURRENTS), rtol=1e-15)


duties = st.lists(st.tuples(*[st.floats(-1, 1)] * 4), min_size=5, max_size=20)


@share_of_examples(0.25)
@given(
    duties,
    st.floats(1e-4, 2e-2),
    st.floats(0.05, 5),
    st.floats(0.5, 20),
    st.floats(0, 1),
)
def test_no_winding_carries_more_than_the_limit(
    run: list[tuple[float, ...]], inductance_h: float, resistance_ohm: float, limit_a: float, battery_ohm: float
) -> None:
    """Whatever duties a controller sends, a millisecond each, and whatever the motor."""
    motor = {"motor_inductance_h": inductance_h, "motor_resistance_ohm": resistance_ohm}
    with robot(motor, drive=VOLTAGE, current_limit_a=limit_a, battery_resistance_ohm=battery_ohm) as plant:
        for duty in run:
            plant.duty(duty)
            plant.step(1e-3)
            assert np.abs(plant.read(CURRENTS)).max() <= limit_a * (1 + 1e-9)


def test_a_gear_turns_speed_into_torque() -> None:
    """A motor of a tenth of the constant behind a gear of ten is the same motor at the axle."""
    with robot(drive=VOLTAGE) as direct, robot(drive=VOLTAGE, gear_ratio=10, motor_constant_n_m_a=0.125) as geared:
        for plant in (direct, geared):
            plant.duty([0.5, 0.1, -0.2, 0.3])
            plant.step(1e-3, 50)
        np.testing.assert_allclose(direct.read(SPEEDS), geared.read(SPEEDS), rtol=1e-12)
        np.testing.assert_allclose(direct.read(CURRENTS), geared.read(CURRENTS), rtol=1e-12)


def test_the_drive_torque_shows_what_its_motors_would_draw() -> None:
    """Current torque / constant; the battery pays winding heat and mechanical power."""
    with robot(start_vx_m_s=0.3) as plant:
        plant.torque([1.0, 2.0, 0.5, -1.0])
        plant.step(0.01)
        currents, speeds = plant.read(CURRENTS), plant.read(SPEEDS)
        np.testing.assert_allclose(currents, np.array([1.0, 2.0, 0.5, -1.0]) / CONSTANT, rtol=1e-15)
        power = np.sum(RESISTANCE * currents**2 + CONSTANT * currents * speeds)
        assert plant["battery.voltage_v"] * plant["battery.current_a"] == pytest.approx(power, rel=1e-12)
        assert plant["battery.voltage_v"] == pytest.approx(SOURCE_V - BATTERY_OHM * plant["battery.current_a"])


def test_a_battery_falls_with_the_charge_that_was_taken() -> None:
    """Four motors stalled on the drive current: V (U - V) = Rb R sum i^2, dQ/dt = I, U = 24 V - f Q, by SciPy."""
    fall, torque = 3.0, 2.5
    start = {"drive": CURRENT, "friction_coefficient": 2.0, "battery_fall_v_c": fall}
    power_w = 4 * RESISTANCE * (torque / CONSTANT) ** 2

    def taken_a(_: float, charge_c: np.ndarray) -> np.ndarray:
        source_v = SOURCE_V - fall * charge_c
        return power_w / (0.5 * (source_v + np.sqrt(source_v**2 - 4 * BATTERY_OHM * power_w)))

    instants = np.arange(1, 11) * 0.2
    charge_c = solve_ivp(taken_a, (0, 2), [0.0], "DOP853", t_eval=instants, rtol=1e-11, atol=1e-12).y[0]
    with robot(start) as plant:
        plant.torque([torque] * 4)
        seen = []
        for _ in instants:
            plant.step(1e-3, 200)
            seen.append((plant["battery.voltage_v"], plant["battery.current_a"]))
        assert not plant.read(SPEEDS).any()
    current_a = taken_a(0.0, charge_c)
    expected = np.column_stack([SOURCE_V - fall * charge_c - BATTERY_OHM * current_a, current_a])
    np.testing.assert_allclose(seen, expected, rtol=1e-9)
    assert seen[-1][0] < 0.95 * SOURCE_V


def test_a_battery_that_was_emptied_has_no_voltage() -> None:
    with robot(BLOCKED, battery_fall_v_c=1e3) as plant:
        plant.duty([1.0] * 4)
        plant.step(1e-3, 500)
        assert plant["battery.voltage_v"] == pytest.approx(0.0, abs=1e-6)
        np.testing.assert_allclose(plant.read(CURRENTS), 0.0, atol=1e-3)
