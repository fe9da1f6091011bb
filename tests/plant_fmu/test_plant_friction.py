"""Friction that sticks: coasting down, standing on a slope, breaking away, wheels that hold one another."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from tests.support.examples import share_of_examples
from tests.support.plant_oracle import G, Oracle
from tests.support.plant_testbed import (
    ANGLES,
    CURRENT,
    DEFAULTS,
    POSE,
    RIGID,
    SLIP,
    SPEEDS,
    TWIST,
    VOLTAGE,
    O,
    X,
    robot,
    wheels,
)

M, R = DEFAULTS["mass_kg"], DEFAULTS["wheel_radius_m"]
K = 4 * DEFAULTS["wheel_inertia_kg_m2"] / R**2
PLACE = (*POSE, *ANGLES)


@pytest.mark.parametrize(("vx", "vy"), [(1.0, 0.0), (0.0, -0.8), (-0.3, 0.0)])
@pytest.mark.parametrize("step_s", [1e-3, 0.01])
def test_coasting_down_ends_at_the_exact_time_and_place(vx: float, vy: float, step_s: float) -> None:
    """Deceleration a = mu m g / (m + k), in any of four directions; at rest after v / a, v^2 / 2a further on."""
    speed, mu = np.hypot(vx, vy), 0.05
    deceleration = mu * M * G / (M + K)
    rest_s = speed / deceleration
    with robot(friction_coefficient=mu, start_vx_m_s=vx, start_vy_m_s=vy) as plant:
        plant.step(step_s, int(0.5 * rest_s / step_s))
        np.testing.assert_allclose(plant.read(TWIST[:2]), np.array([vx, vy]) * (1 - plant.time_s / rest_s), atol=1e-12)
        plant.step(step_s, int(rest_s / step_s) - int(0.5 * rest_s / step_s))
        assert np.hypot(*plant.read(TWIST[:2])) > 1e-9  # just before
        plant.step(step_s)
        np.testing.assert_array_equal(plant.read((*TWIST, *SPEEDS)), 0.0)
        way = np.array([vx, vy]) / speed * speed**2 / (2 * deceleration)
        np.testing.assert_allclose(plant.read(POSE[:2]), way, rtol=1e-9, atol=1e-15)
        before = plant.read(PLACE).tobytes()
        plant.step(1.0)
        assert plant.read(PLACE).tobytes() == before


def test_viscous_friction_slows_exponentially() -> None:
    """The rate is 4 d / (r^2 (m + k))."""
    rate = 4 * 0.02 / (R**2 * (M + K))
    with robot(viscous_n_m_s_rad=0.02, start_vx_m_s=1.0) as plant:
        plant.step(1e-3, 2000)
        assert plant["twist.vx_m_s"] == pytest.approx(np.exp(-2 * rate), rel=1e-9)
        assert plant["pose.x_m"] == pytest.approx((1 - np.exp(-2 * rate)) / rate, rel=1e-9)


@pytest.mark.parametrize("rollers", [X, O])
@pytest.mark.parametrize("direction", [0.0, 1.0, -2.3])
def test_a_robot_stands_below_the_friction_angle_and_slides_above(direction: float, rollers: int) -> None:
    """Below, pose and wheel angles keep their bits for five seconds.

    A force at the angle d to the robot is held up to m g sin(slope) (|cos d| + |sin d|) = mu m g cos(slope). The two
    wheels of one diagonal take all of it before the others can help.
    """
    start = {"friction_coefficient": 0.05, "slope_direction_rad": direction, "rollers": rollers, "half_width_m": 0.2}
    steepest = np.arctan(0.05 / (abs(np.cos(direction)) + abs(np.sin(direction))))
    with robot(start, slope_rad=0.9999 * steepest) as below, robot(start, slope_rad=1.0001 * steepest) as above:
        before = below.read(PLACE).tobytes()
        for plant in (below, above):
            plant.step(1e-3, 5000)
        assert below.read(PLACE).tobytes() == before
        assert below["energy.lost_j"] == 0.0
        assert np.dot(above.read(POSE[:2]), [np.cos(direction), np.sin(direction)]) < -1e-5


@pytest.mark.parametrize(("slope", "heading"), [(0.06, 0.0), (0.3, 0.0), (0.1, np.pi)])
def test_above_the_friction_angle_it_slides_down(slope: float, heading: float) -> None:
    """Straight down with m g (sin a - mu cos a) / (m + k)."""
    expected = -M * G * (np.sin(slope) - 0.05 * np.cos(slope)) / (M + K)
    with robot(friction_coefficient=0.05, slope_rad=slope, start_heading_rad=heading) as plant:
        plant.step(1e-3, 500)
        assert plant["twist.vx_m_s"] == pytest.approx(0.5 * expected, rel=1e-10)
        assert plant["pose.x_m"] == pytest.approx(0.125 * expected, rel=1e-10)


@pytest.mark.parametrize("contact", [RIGID, SLIP])
@pytest.mark.parametrize("drive", [CURRENT, 1])
def test_a_robot_breaks_away_at_the_friction_torque(contact: int, drive: int) -> None:
    """Four equal torques a little below mu N r move nothing; a little above, everything."""
    breakaway = 0.05 * M * G / 4 * R
    start = {"friction_coefficient": 0.05, "contact": contact, "drive": drive}
    with robot(start) as below, robot(start) as above:
        below.torque([0.999 * breakaway] * 4)
        above.torque([1.02 * breakaway] * 4)
        for plant in (below, above):
            plant.step(1e-3, 200)
        np.testing.assert_array_equal(below.read((*SPEEDS, *ANGLES)), 0.0)
        assert above.read(SPEEDS).min() > 0
        assert above["twist.vx_m_s"] > 0


def test_one_motor_is_held_by_all_four_wheels() -> None:
    """Without slip a wheel cannot turn alone: it has to overcome its own friction and, through the body, others'."""
    own = 0.05 * M * G / 4 * R
    with robot(friction_coefficient=0.05) as plant:
        plant.torque([1.5 * own, 0, 0, 0])
        plant.step(1e-3, 100)
        np.testing.assert_array_equal(plant.read(SPEEDS), 0.0)


def test_one_wheel_on_slipping_rollers_breaks_away_alone() -> None:
    own = 0.05 * M * G / 4 * R
    start = {"friction_coefficient": 0.05, "contact": SLIP, "grip_coefficient": 0.0}
    with robot(start) as plant:
        plant.torque([0.999 * own, 1.001 * own, 0, 0])
        plant.step(1e-3, 100)
        fl, fr, rr, rl = plant.read(SPEEDS)
        assert fl == rr == rl == 0.0
        assert fr > 0


torques = st.tuples(*[st.floats(-3, 3)] * 4)


@share_of_examples(0.6)
@given(
    torques, st.floats(0, 0.2), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(0, 0.3), st.sampled_from([X, O])
)
@example((0.5, 0.5, 0.5, 0.5), 0.0, 0.0, 0.0, 0.0, X)
@example((2.0, 0.0, 0.0, 0.0), 0.03, 0.05, -0.05, 0.2, X)
def test_wheels_at_rest_hold_one_another_by_gausss_principle(
    torque: tuple[float, ...], slope: float, com_x: float, com_y: float, mu: float, rollers: int
) -> None:
    """Of all frictions within their limits those act that leave the least acceleration, in the metric of the mass.

    The oracle gives the accelerations of each torque alone; a bounded least squares solver finds the frictions.
    """
    start = {"slope_rad": slope, "slope_direction_rad": 0.4, "com_x_m": com_x, "com_y_m": com_y, "rollers": rollers}
    start |= {"half_width_m": 0.2, "friction_coefficient": mu}
    oracle = Oracle(start)
    rest = oracle.start()

    def acceleration(torque: np.ndarray) -> np.ndarray:
        return oracle._rigid(1.0 + 0j, rest[7:14], np.array([oracle.fall_n.real, oracle.fall_n.imag, 0.0, *torque]))

    free = acceleration(np.array(torque))
    columns = np.array([acceleration(np.array(torque) + unit) - free for unit in np.eye(4)]).T
    x, y = np.array([0.3, 0.3, -0.3, -0.3]), np.array([0.2, -0.2, -0.2, 0.2])
    load = M * G * np.cos(slope) / 4 * (1 + com_x / x + com_y / y)
    limit = mu * load * R + 1e-15
    weight = np.sqrt(oracle.inertia)[:, None]
    solved = lsq_linear(weight * columns, -weight[:, 0] * free, bounds=(-limit, limit), method="bvls", tol=1e-15)
    left = free + columns @ solved.x
    centre = complex(left[0], left[1]) - 1j * left[2] * oracle.com
    with robot(start) as plant:
        plant.torque(torque)
        gravity = G * np.sin(slope) * np.exp(0.4j)
        felt = plant.read(("accelerometer.x_m_s2", "accelerometer.y_m_s2")) - [gravity.real, gravity.imag]
        np.testing.assert_allclose(felt, [centre.real, centre.imag], atol=1e-7)
        plant.step(1e-6)
        assert plant["twist.yaw_rate_rad_s"] == pytest.approx(1e-6 * left[2], abs=1e-10)


@pytest.mark.parametrize("drive", [CURRENT, VOLTAGE])
@pytest.mark.parametrize("contact", [RIGID, SLIP])
def test_small_inputs_of_changing_sign_move_nothing(contact: int, drive: int) -> None:
    """A controller that dithers within the friction leaves a robot where it stands."""
    start = {"friction_coefficient": 0.05, "contact": contact, "drive": drive}
    with robot(start) as plant:
        for sign in (1, -1) * 50:
            plant.torque([0.1 * sign] * 4)
            plant.duty([0.002 * sign] * 4)
            plant.step(1e-3)
        np.testing.assert_array_equal(plant.read((*SPEEDS, *ANGLES)), 0.0)


def test_the_friction_follows_the_load_at_each_wheel() -> None:
    """With the mass over the front axle the front wheels alone have friction: mu m g r / 2 each."""
    with robot(friction_coefficient=0.1, com_x_m=0.3, half_length_m=0.3, contact=SLIP, grip_coefficient=0.0) as plant:
        plant.torque([0.99 * 0.1 * M * G * R / 2] * 2 + [1e-6] * 2)
        plant.step(1e-3, 10)
        fl, fr, rr, rl = plant.read(SPEEDS)
        assert fl == fr == 0.0
        assert rr > 0
        assert rl > 0


def test_a_driven_wheel_may_stop_and_turn_back_within_one_step() -> None:
    """A step that holds a whole reversal equals two that meet at the standstill."""
    mu, v, torque = 0.02, 0.2, -0.6
    slowing = (mu * M * G * R - 4 * torque) / (R * (M + K))
    speeding = (-mu * M * G * R - 4 * torque) / (R * (M + K))
    rest_s = v / slowing
    with robot(friction_coefficient=mu, start_vx_m_s=v, longest_step_s=0.01) as plant:
        plant.torque([torque] * 4)
        plant.step(2 * rest_s)
        assert plant["twist.vx_m_s"] == pytest.approx(-speeding * rest_s, rel=1e-9)
        assert plant["pose.x_m"] == pytest.approx(v * rest_s / 2 - speeding * rest_s**2 / 2, rel=1e-9)


@pytest.mark.parametrize("way", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_all_wheels_rest_when_a_turning_robot_has_coasted_down(way: tuple[int, int]) -> None:
    """Wheels come to rest one after another, at instants within steps; in the end nothing moves at all."""
    start = {"start_vx_m_s": 0.5 * way[0], "start_yaw_rate_rad_s": 1.5 * way[1], "friction_coefficient": 0.05}
    with robot(start, start_vy_m_s=0.2) as plant:
        previous = np.inf
        for _ in range(40):
            plant.step(0.05)
            energy = plant["energy.stored_j"]
            assert energy <= previous
            previous = energy
        np.testing.assert_array_equal(plant.read((*TWIST, *SPEEDS, *wheels("slip_m_s"))), 0.0)
        assert plant["energy.stored_j"] == 0.0


def test_a_wheel_at_rest_keeps_its_bits_while_others_turn() -> None:
    """Along a diagonal two wheels turn and two stand: their angles stay exactly where they were."""
    with robot(friction_coefficient=0.05, start_heading_rad=0.3, inertia_kg_m2=0.7, half_width_m=0.2) as plant:
        plant.torque([1.0, 0.1, 1.0, 0.1])
        plant.step(1e-3, 500)
        fl, fr, rr, rl = plant.read(ANGLES)
        assert fl > 1
        assert rr > 1
        assert fr == rl == 0.0


def test_wheels_hold_a_robot_of_great_inertia_against_a_moment() -> None:
    """The more inertia, the less a wheel says about the yaw; at rest it is held all the same."""
    with robot(friction_coefficient=0.05, inertia_kg_m2=100.0) as plant:
        plant.push(0.0, 0.0, 2.0)
        plant.step(1e-3, 1000)
        np.testing.assert_array_equal(plant.read((*PLACE, *TWIST)), 0.0)


def test_wheels_on_elastic_rollers_come_to_rest_exactly() -> None:
    with robot(friction_coefficient=0.05, start_vx_m_s=0.4, start_vy_m_s=0.1, contact=SLIP) as plant:
        plant.step(1e-3, 2000)
        np.testing.assert_array_equal(plant.read(SPEEDS), 0.0)
        before = plant.read(ANGLES).tobytes()
        plant.step(1e-3, 200)
        assert plant.read(ANGLES).tobytes() == before
