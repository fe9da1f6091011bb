"""The energy balance: what is stored grows by what is supplied less what is lost, with every contact and drive."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.plant_cases import held, robots
from tests.plant_oracle import G
from tests.plant_testbed import (
    ANGLES,
    CURRENT,
    CURRENTS,
    DEFAULTS,
    ENERGY,
    LOADS,
    POSE,
    RIGID,
    SLIP,
    SPEEDS,
    TORQUE,
    TWIST,
    VOLTAGE,
    Robot,
    robot,
)


def motion_j(plant: Robot, p: dict[str, float]) -> float:
    """Energy of motion, height and windings from the outputs alone, in the world frame; not that of bent rollers."""
    x, y, heading = plant.read(POSE)
    vx, vy, yaw_rate = plant.read(TWIST)
    arm = (p["com_x_m"] + 1j * p["com_y_m"]) * np.exp(1j * heading)
    mass_velocity = vx + 1j * vy + 1j * yaw_rate * arm
    spin_inertia = p["wheel_inertia_kg_m2"] + p["gear_ratio"] ** 2 * p["rotor_inertia_kg_m2"]
    uphill = np.exp(-1j * p["slope_direction_rad"]) * (x + 1j * y + arm)
    winding = p["motor_inductance_h"] * np.sum(plant.read(CURRENTS) ** 2) if p["drive"] == VOLTAGE else 0.0
    turning = p["inertia_kg_m2"] * yaw_rate**2 + spin_inertia * np.sum(plant.read(SPEEDS) ** 2)
    height = p["mass_kg"] * G * np.sin(p["slope_rad"]) * uphill.real
    return float(0.5 * (p["mass_kg"] * abs(mass_velocity) ** 2 + turning + winding) + height)


def check_balance(parameters: dict[str, float], run: list[Any], tolerance: float) -> None:
    """Hold each input for 20 ms; the balance is compared with the energy that has gone through the robot."""
    p = {**DEFAULTS, **parameters}
    with robot(parameters) as plant:
        _, start, _ = plant.read(ENERGY)
        start_motion = motion_j(plant, p)
        through, lost_before = abs(start), 0.0
        for drive, push in run:
            plant.duty([d / 10 for d in drive])
            plant.torque(drive)
            plant.push(*push)
            for _ in range(20):
                plant.step(1e-3)
                supplied, stored, lost = plant.read(ENERGY)
                through = max(through, abs(supplied), abs(stored), lost, 1e-3)
                assert lost >= lost_before - 1e-12 * through
                lost_before = lost
                bent = stored - start - (motion_j(plant, p) - start_motion)
                stiffness, grip = p["roller_stiffness_n_m"], p["grip_coefficient"]
                # A roller stores at most (grip x load)^2 / 2K, and a little more for the moment after the load fell.
                most = 2 * np.sum((grip * plant.read(LOADS)) ** 2) / stiffness if p["contact"] == SLIP else 0.0
                rounding = 1e-11 * (through + 100.0)  # of heights, in J
                assert -rounding <= bent <= most + rounding
            assert abs(stored - start - supplied + lost) <= tolerance * through


# Twice to ten times what 250 runs each left. The corners of sliding rollers cost the integrator most, and those of a
# drive's limiter, which regulates as fast as the steps are long; without it shorter steps leave as little as one likes.
@pytest.mark.parametrize(
    ("contact", "drive", "limit_a", "longest_s", "tolerance"),
    [
        (RIGID, TORQUE, 4.0, 1e-3, 1e-8),
        (RIGID, CURRENT, 4.0, 1e-3, 1e-5),
        (RIGID, VOLTAGE, 1e4, 5e-5, 1e-6),
        (RIGID, VOLTAGE, 4.0, 1e-3, 1e-2),
        (SLIP, TORQUE, 4.0, 1e-3, 1e-3),
        (SLIP, CURRENT, 4.0, 1e-3, 1e-3),
        (SLIP, VOLTAGE, 4.0, 1e-3, 1e-2),
    ],
)
@settings(max_examples=12)
@given(data=st.data(), friction=st.floats(0, 0.3))
def test_energy_is_neither_made_nor_lost(
    contact: int, drive: int, limit_a: float, longest_s: float, tolerance: float, friction: float, data: st.DataObject
) -> None:
    fixed = {"friction_coefficient": friction, "current_limit_a": limit_a, "longest_step_s": longest_s}
    parameters = data.draw(robots(contact=contact, drive=drive, **fixed))
    check_balance(parameters, data.draw(held(9.0)), tolerance)


def test_what_is_supplied_is_the_work_of_torques_and_push() -> None:
    """tau . angle + F . way + M . heading, for inputs that are held; and the losses are those of viscous friction."""
    with robot(viscous_n_m_s_rad=0.01, com_x_m=0.05) as plant:
        plant.torque([0.5, -0.2, 0.3, 0.6])
        plant.push(3.0, -5.0, 0.7)
        plant.step(0.5, 2)
        work = np.dot(plant.read(ANGLES), [0.5, -0.2, 0.3, 0.6]) + np.dot(plant.read(POSE), [3.0, -5.0, 0.7])
        assert plant["energy.supplied_j"] == pytest.approx(work, rel=1e-9)


def test_the_battery_pays_for_all() -> None:
    """Supplied is source voltage times current; at stall all of it is heat in windings and battery."""
    with robot(drive=VOLTAGE, friction_coefficient=2.0) as plant:
        plant.duty([0.05] * 4)
        plant.step(0.1)
        before = plant["energy.supplied_j"], plant["energy.lost_j"]
        plant.step(1.0)
        power = DEFAULTS["battery_voltage_v"] * plant["battery.current_a"]
        assert plant["energy.supplied_j"] - before[0] == pytest.approx(power, rel=1e-6)
        assert plant["energy.lost_j"] - before[1] == pytest.approx(power, rel=1e-6)
        current = plant.read(CURRENTS)
        heat = DEFAULTS["motor_resistance_ohm"] * np.sum(current**2)
        heat += DEFAULTS["battery_resistance_ohm"] * plant["battery.current_a"] ** 2
        assert power == pytest.approx(heat, rel=1e-6)


def test_friction_turns_all_motion_into_heat() -> None:
    with robot(friction_coefficient=0.1, start_vx_m_s=1.0, start_yaw_rate_rad_s=1.0) as plant:
        before = plant["energy.stored_j"]
        plant.step(0.01, 1000)
        assert plant["energy.stored_j"] == 0.0
        assert plant["energy.lost_j"] == pytest.approx(before, rel=1e-6)
