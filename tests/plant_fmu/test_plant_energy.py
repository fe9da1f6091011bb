"""Energy: the stored energy is the supplied energy less the losses, whatever drives, holds or slows the robot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import share_of_examples
from tests.support.plant_testbed import (
    CURRENT,
    CURRENTS,
    DEFAULTS,
    ENERGY,
    POSE,
    RIGID,
    SLIP,
    SPEEDS,
    TORQUE,
    TWIST,
    VOLTAGE,
    O,
    Robot,
    X,
    robot,
)

G = 9.81
# What the method leaves in the accounts at longest_step_s = 5e-5, over the throughput: measured, with a margin. A drive
# current that lacks voltage brakes within a millisecond; the limiter and the rollers turn corners within steps.
PRECISION = {TORQUE: 1e-11, CURRENT: 2e-6, VOLTAGE: 3e-5}
SLIP_PRECISION = 3e-5
contacts = pytest.mark.parametrize("contact", [RIGID, SLIP], ids=["rigid", "slip"])
drives = pytest.mark.parametrize("drive", [TORQUE, CURRENT, VOLTAGE], ids=["torque", "current", "voltage"])
robots = st.fixed_dictionaries(
    {
        "mass_kg": st.floats(5, 60),
        "inertia_kg_m2": st.floats(0.2, 5),
        "com_x_m": st.floats(-0.1, 0.1),
        "com_y_m": st.floats(-0.1, 0.1),
        "half_width_m": st.floats(0.1, 0.5),
        "rollers": st.sampled_from([X, O]),
        "friction_coefficient": st.sampled_from([0.0, 0.02, 0.2]),
        "viscous_n_m_s_rad": st.floats(0, 0.1),
        "slope_rad": st.floats(0, 0.3),
        "slope_direction_rad": st.floats(-4, 4),
        "gear_ratio": st.floats(0.5, 2),
        "rotor_inertia_kg_m2": st.floats(0, 0.002),
        "battery_resistance_ohm": st.floats(0, 0.5),
        "current_limit_a": st.floats(1, 20),
        "grip_coefficient": st.just(0.0) | st.floats(0.01, 1),
        "roller_friction_coefficient": st.floats(0, 0.05),
        "start_heading_rad": st.floats(-4, 4),
        "start_vx_m_s": st.floats(-1, 1),
        "start_vy_m_s": st.floats(-1, 1),
        "start_yaw_rate_rad_s": st.floats(-3, 3),
    }
)
inputs = st.tuples(
    st.tuples(*[st.floats(-6, 6)] * 4),
    st.tuples(*[st.floats(-1, 1)] * 4),
    st.tuples(st.floats(-40, 40), st.floats(-40, 40), st.floats(-10, 10)),
)


def stored_j(plant: Robot, p: dict[str, float]) -> float:
    """Energy of motion, height and windings from what the robot shows: the centre of mass in the world, the wheels."""
    p = {**DEFAULTS, **p}
    x, y, heading, vx, vy, yaw_rate = plant.read((*POSE, *TWIST))
    com = np.exp(1j * heading) * (p["com_x_m"] + 1j * p["com_y_m"])
    velocity = vx + 1j * vy + 1j * yaw_rate * com
    height_m = np.sin(p["slope_rad"]) * np.real((x + 1j * y + com) * np.exp(-1j * p["slope_direction_rad"]))
    spin_inertia = p["wheel_inertia_kg_m2"] + p["gear_ratio"] ** 2 * p["rotor_inertia_kg_m2"]
    motion = p["mass_kg"] * abs(velocity) ** 2 + p["inertia_kg_m2"] * yaw_rate**2
    windings = p["motor_inductance_h"] * np.square(plant.read(CURRENTS)).sum() if p["drive"] == VOLTAGE else 0.0
    turning = spin_inertia * np.square(plant.read(SPEEDS)).sum()
    return float(motion + turning + windings) / 2 + p["mass_kg"] * G * float(height_m)


@contacts
@drives
@share_of_examples(0.25)
@given(p=robots, sequence=st.lists(inputs, min_size=4, max_size=4))
def test_energy_is_neither_made_nor_lost_unseen(contact: int, drive: int, p: dict[str, float], sequence: list) -> None:
    """And the heat only grows. What is stored beyond motion, height and windings bends rollers: (mu N)^2 / 2 K each."""
    p = {**p, "contact": contact, "drive": drive, "longest_step_s": 5e-5}
    precision = PRECISION[drive] if contact == RIGID else SLIP_PRECISION
    weight_n = p["mass_kg"] * G
    most_bent_j = 4 * (p["grip_coefficient"] * weight_n) ** 2 / (2 * DEFAULTS["roller_stiffness_n_m"])
    with robot(p) as plant:
        start_j, moved_j, before = plant["energy.stored_j"], 0.0, np.zeros(3)
        level_j = stored_j(plant, p) - start_j  # the plant's height begins at 0
        for torque, duty, push in sequence:
            plant.torque(torque)
            plant.duty(duty)
            plant.push(*push)
            for _ in range(10):
                plant.step(3e-3)
                now = plant.read(ENERGY)
                supplied_j, kept_j, lost_j = now
                assert lost_j >= before[2]
                moved_j += abs(now - before)[[0, 2]].sum()
                before = now
                throughput_j = start_j + moved_j + abs(kept_j)
                assert kept_j - start_j == pytest.approx(supplied_j - lost_j, abs=precision * throughput_j + 1e-12)
                rounding_j = 1e-12 * (throughput_j + weight_n)
                bent_j = kept_j + level_j - stored_j(plant, p)
                assert -rounding_j <= bent_j <= rounding_j + (most_bent_j if contact == SLIP else 0.0)
