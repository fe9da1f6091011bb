"""Rollers that slip: where slip begins, how it goes on, the loads of the wheels, and standing still."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import share_of_examples
from tests.support.plant_oracle import G
from tests.support.plant_testbed import DEFAULTS, GRIPS, LOADS, POSE, RIGID, SLIP, SLIPS, SPEEDS, TWIST, Robot, robot

M, R, L1, L2 = (DEFAULTS[name] for name in ("mass_kg", "wheel_radius_m", "half_length_m", "half_width_m"))
H, GRIP, J = DEFAULTS["com_height_m"], DEFAULTS["grip_coefficient"], DEFAULTS["wheel_inertia_kg_m2"]
K = 4 * J / R**2
FREE = {"contact": SLIP, "roller_friction_coefficient": 0.0}
SLIPPING_M_S = 2e-3  # rollers that only bend move with a tenth of it


def ramp_to_slip(plant: Robot, pattern: np.ndarray, until_n_m: float) -> tuple[float, np.ndarray]:
    """Raise torques slowly; return the torque at which a wheel slips, and which wheels do a little later."""
    torque = 0.0
    while torque < until_n_m:
        torque += 0.002
        plant.torque(torque * pattern)
        plant.step(2e-3)
        if np.abs(plant.read(SLIPS)).max() > SLIPPING_M_S:
            return torque, np.abs(plant.read(SLIPS)) > SLIPPING_M_S / 2
    raise AssertionError("no wheel slips")


@pytest.mark.parametrize(
    ("pattern", "first"),
    [
        ((1, 1, 1, 1), [True, True, False, False]),
        ((-1, -1, -1, -1), [False, False, True, True]),
        ((-1, 1, -1, 1), [True, False, False, True]),
        ((1, -1, 1, -1), [False, True, True, False]),
    ],
    ids=["forward", "backward", "left", "right"],
)
def test_the_axle_that_leads_slips_first_at_the_torque_of_its_load(pattern: tuple[int, ...], first: list[bool]) -> None:
    """The force of a wheel along its roller is sqrt 2 (tau - J alpha) / r; its load N -+ load transfer.

    Forward: 2 l1 times the load that moves = h m a + J alpha 4, with a = 4 tau / (r (m + k)) and alpha = a / r. The
    sum of the loads on the axle that leads is m g / 2 less that; sideways no wheel spin acts, and 2 l2 stands for 2 l1.
    """
    forward = pattern[0] == pattern[1]
    lever = L1 if forward else L2

    def margin(torque: float) -> float:
        a = 4 * torque / (R * (M + K))
        moved = (H * M * a + (4 * J * a / R if forward else 0.0)) / (4 * lever)
        return GRIP * (M * G / 4 - moved) - np.sqrt(2) * (torque - J * a / R) / R

    onset = margin(0.0) / (margin(0.0) - margin(1.0))  # linear
    with robot(FREE) as plant:
        torque, slipping = ramp_to_slip(plant, np.array(pattern), 3.0)
    assert torque == pytest.approx(onset, rel=0.02)
    assert list(slipping) == first


def test_a_turn_on_the_spot_slips_last() -> None:
    """The inertia of the wheels takes most of the torque: I / (I + k L^2) of it reaches the ground."""
    inertia, lever = DEFAULTS["inertia_kg_m2"], L1 + L2
    share = inertia / (inertia + K * lever**2)
    onset = GRIP * M * G / 4 * R / np.sqrt(2) / share
    with robot(FREE) as plant:
        torque, _ = ramp_to_slip(plant, np.array([-1, 1, 1, -1]), 10.0)
    assert torque == pytest.approx(onset, rel=0.03)


@pytest.mark.parametrize("pattern", [(1, 1, 1, 1), (-1, 1, -1, 1), (-1, -1, -1, -1)], ids=["ahead", "left", "back"])
def test_in_gross_slip_the_robot_accelerates_with_grip_over_root_two(pattern: tuple[int, ...]) -> None:
    with robot(FREE) as plant:
        plant.torque(10.0 * np.array(pattern))
        plant.step(1e-3, 200)
        before = plant.read(TWIST[:2])
        plant.step(1e-3, 100)
        acceleration = np.linalg.norm(plant.read(TWIST[:2]) - before) / 0.1
        assert acceleration == pytest.approx(GRIP * G / np.sqrt(2), rel=1e-6)


def test_below_the_grip_it_moves_as_on_rigid_contact() -> None:
    """A gentle drive: the two contacts part by what the rollers bend, fractions of a millimetre."""
    with robot(FREE) as slip, robot() as rigid:
        for plant in (slip, rigid):
            plant.torque([0.5, 0.6, 0.4, 0.55])
            plant.step(1e-3, 500)
        np.testing.assert_allclose(slip.read(POSE), rigid.read(POSE), atol=1e-3)
        np.testing.assert_allclose(slip.read(SPEEDS), rigid.read(SPEEDS), rtol=2e-3)


@pytest.mark.parametrize("torque", [5.0, 10.0, 20.0])
def test_the_default_step_resolves_slides_that_turn_back(torque: float) -> None:
    """Torques that reverse far above the grip: speeds within 1 % of those at a hundredth of the step."""
    ends = []
    for longest_s in (1e-3, 4e-6):
        with robot(contact=SLIP, longest_step_s=longest_s) as plant:
            for sign in (1, -1) * 3:
                plant.torque([torque * sign, torque, 0.5 * torque * sign, torque])
                plant.step(0.02)
            ends.append(plant.read((*TWIST, *SPEEDS)))
    np.testing.assert_allclose(ends[0], ends[1], rtol=0.01, atol=1e-3)


@share_of_examples(0.3)
@given(
    st.tuples(*[st.floats(-8, 8)] * 4),
    st.floats(-0.2, 0.2),
    st.floats(-0.2, 0.2),
    st.floats(0, 0.3),
    st.floats(0, 0.4),
)
def test_loads_carry_the_weight_and_balance_the_moments(
    torque: tuple[float, ...], com_x: float, com_y: float, com_height: float, slope: float
) -> None:
    """Unless the robot would tip over the loads sum to the weight, on three wheels as on four.

    With torques just set no roller is bent: only the wheels' spin takes moments, J alpha = tau each.
    """
    start = {"com_x_m": com_x, "com_y_m": com_y, "com_height_m": com_height, "slope_rad": slope}
    upright = M * G * np.cos(slope)
    pitch, roll = upright * com_x - sum(torque), upright * com_y
    with robot(FREE | start) as plant:
        plant.torque(torque)
        load = plant.read(LOADS)
    assert load.min() >= 0
    assert load.sum() == pytest.approx(upright, rel=1e-12)
    if abs(pitch) < upright * L1 and abs(roll) < upright * L2 and load.min() > 0:
        x, y = np.array([L1, L1, -L1, -L1]), np.array([L2, -L2, -L2, L2])
        assert x @ load == pytest.approx(pitch, abs=1e-9)
        assert y @ load == pytest.approx(roll, abs=1e-9)
        assert load[0] - load[1] + load[2] - load[3] == pytest.approx(0, abs=1e-9)


def test_three_wheels_carry_what_the_fourth_has_lifted() -> None:
    """A mass near the front left corner: the rear right wheel lifts, the moments balance on the others."""
    upright, x, y = M * G, np.array([L1, L1, -L1, -L1]), np.array([L2, -L2, -L2, L2])
    with robot(FREE, com_x_m=0.7 * L1, com_y_m=0.6 * L2) as slip, robot(com_x_m=0.7 * L1, com_y_m=0.6 * L2) as rigid:
        for plant in (slip, rigid):
            load = plant.read(LOADS)
            assert load[2] == 0.0
            np.testing.assert_allclose([load.sum(), x @ load, y @ load], upright * np.array([1, 0.7 * L1, 0.6 * L2]))


def test_load_moves_to_the_rear_when_the_robot_accelerates() -> None:
    """By (h m a + 4 J alpha) / (4 l1) a wheel, and from left to right when it drives to the left."""
    with robot(FREE) as plant:
        plant.torque([0.8] * 4)
        plant.step(1e-3, 300)
        a = plant["accelerometer.x_m_s2"]
        moved = (H * M * a + 4 * J * a / R) / (4 * L1)
        np.testing.assert_allclose(plant.read(LOADS), M * G / 4 + moved * np.array([-1, -1, 1, 1]), rtol=1e-3)
    with robot(FREE) as plant:
        plant.torque([-0.8, 0.8, -0.8, 0.8])
        plant.step(1e-3, 300)
        moved = H * M * plant["accelerometer.y_m_s2"] / (4 * L2)
        np.testing.assert_allclose(plant.read(LOADS), M * G / 4 + moved * np.array([-1, 1, 1, -1]), rtol=1e-3)


@pytest.mark.parametrize("direction", [0.0, 0.8])
def test_a_robot_held_by_its_brakes_does_not_creep_on_a_slope(direction: float) -> None:
    """Wheels stick in their bearings, rollers bend and stay: after the first moment not a bit changes in a minute."""
    start = {"slope_rad": 0.2, "slope_direction_rad": direction, "friction_coefficient": 1.0}
    with robot(FREE | start) as plant:
        plant.step(1.0)
        settled = plant.read(POSE)
        assert 0 < np.hypot(*settled[:2]) < 1e-3
        plant.step(1.0, 60)
        np.testing.assert_allclose(plant.read(POSE), settled, atol=1e-12)


def test_beyond_the_grip_a_braked_robot_slides_down() -> None:
    """Along the rollers at 45 degrees a grip of mu holds mu / sqrt 2: the slope of 0.52 is more than 0.46."""
    start = {"slope_rad": 0.52, "friction_coefficient": 2.0, "com_height_m": 0.0}
    with robot(FREE | start) as plant:
        plant.step(1e-3, 300)
        before = plant["twist.vx_m_s"]
        plant.step(1e-3, 100)
        expected = -G * (np.sin(0.52) - GRIP / np.sqrt(2) * np.cos(0.52))
        assert (plant["twist.vx_m_s"] - before) / 0.1 == pytest.approx(expected, rel=1e-4)
        np.testing.assert_array_equal(plant.read(SPEEDS), 0.0)


def test_a_wheel_on_a_slippery_patch_spins() -> None:
    """A tenth of the grip under one wheel: it spins, the others hold, and the robot is turned towards it."""
    with robot(FREE) as plant:
        plant.torque([1.0] * 4)
        plant.step(1e-3, 200)
        straight = plant["twist.yaw_rate_rad_s"]
        plant.set({GRIPS[0]: 0.1})
        plant.step(1e-3, 200)
        slips = np.abs(plant.read(SLIPS))
        assert slips[0] > 1.0
        assert slips[1:].max() < 0.05
        assert abs(straight) < 1e-9
        assert plant["twist.yaw_rate_rad_s"] > 0.1
        plant.set({GRIPS[0]: 1.0})
        plant.step(1e-3, 400)
        assert np.abs(plant.read(SLIPS)).max() < 0.05


def test_without_grip_wheels_spin_and_nothing_moves() -> None:
    with robot(FREE, grip_coefficient=0.0) as plant:
        plant.torque([1.0, -1.0, 2.0, 0.5])
        plant.step(1e-3, 100)
        np.testing.assert_allclose(plant.read(SPEEDS), np.array([1.0, -1.0, 2.0, 0.5]) / J * 0.1, rtol=1e-12)
        np.testing.assert_array_equal(plant.read(POSE), 0.0)


def test_rollers_resist_a_motion_to_the_side_alone() -> None:
    """Straight ahead no roller turns. To the side each contact moves across its roller: mu_r m g sqrt 2 v."""
    mu = 0.02
    start = {"contact": SLIP, "roller_friction_coefficient": mu}
    with robot(start, start_vx_m_s=2.0) as ahead, robot(start, start_vy_m_s=2.0) as aside:
        for plant in (ahead, aside):
            plant.step(1e-3, 500)
        assert ahead["twist.vx_m_s"] == 2.0
        assert ahead["energy.lost_j"] == 0.0
        assert aside["energy.lost_j"] == pytest.approx(mu * M * G * np.sqrt(2) * aside["pose.y_m"], rel=1e-3)
        slowed = mu * M * G * np.sqrt(2) / (M + K)  # the resistance of a roller also turns its wheel
        assert aside["twist.vy_m_s"] == pytest.approx(2.0 - 0.5 * slowed, rel=1e-3)


def test_rollers_that_hardly_turn_bring_a_slide_to_the_side_to_rest() -> None:
    """A rolling resistance as large as the grip: ever slower, and then at rest without a tremble."""
    with robot(contact=SLIP, roller_friction_coefficient=0.5, start_vy_m_s=0.5) as plant:
        previous = 0.5
        for _ in range(50):
            plant.step(0.01)
            speed = plant["twist.vy_m_s"]
            assert abs(speed) <= abs(previous) + 1e-4
            previous = speed
        assert abs(previous) < 1e-6
        stored, lost = plant["energy.stored_j"], plant["energy.lost_j"]
        start = 0.5 * (M + K) * 0.5**2
        assert stored + lost == pytest.approx(start, rel=1e-3)


def test_the_default_step_resolves_rollers_that_hardly_turn() -> None:
    """Ten times stiffer than the grip about standstill: speeds and heat are those of a hundredth of the step."""
    ends = []
    for longest_s in (1e-3, 4e-6):
        start = {"contact": SLIP, "roller_friction_coefficient": 5.0, "start_vy_m_s": 0.2, "longest_step_s": longest_s}
        with robot(start) as plant:
            for sign in (1, -1) * 4:
                plant.torque([0.5 * sign, 0.2, 0.0, -0.3])
                plant.step(0.02)
            ends.append(plant.read((*TWIST, *SPEEDS, "energy.lost_j")))
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-4, atol=1e-4)


def test_slip_is_zero_on_rigid_contact_and_loads_are_those_at_rest() -> None:
    with robot(contact=RIGID, com_x_m=0.1) as plant:
        plant.torque([5.0] * 4)
        plant.step(1e-3, 100)
        np.testing.assert_array_equal(plant.read(SLIPS), 0.0)
        np.testing.assert_allclose(plant.read(LOADS), M * G / 4 * (1 + 0.1 / L1 * np.array([1, 1, -1, -1])))
