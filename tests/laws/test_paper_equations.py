"""Equations of Nguyen Minh et al. 2023 as printed, next to ours: which are right, and which are not. See PAPER.md."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.kinematics import BodyTwist, body_twist, body_wrench, wheel_speeds
from hil.core.types import Acceleration, CommandMode, Pose, Reference, State, Twist, Wheels
from hil.laws.surface import Dsc
from tests.support.closed_loop import AT_REST, PAPER_ROBOT

M, I, R, IB = 20.0, 0.56, PAPER_ROBOT.wheel_radius_m, PAPER_ROBOT.wheel_inertia_kg_m2  # noqa: E741  the paper's names
L1 = L2 = 0.3
L = L1 + L2
K = 4.0 * IB / R**2
MASS = np.diag([M + K, M + K, I + K * L**2])
H = np.array([[1, -1, -L], [1, 1, L], [1, -1, L], [1, 1, -L]])

value = st.floats(-3.0, 3.0)
triple = st.tuples(value, value, value)
four = st.tuples(value, value, value, value)


def rot(heading: float) -> np.ndarray:
    """Rot(z, θ) of equation 8."""
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def lagrangian_matrix() -> np.ndarray:
    """The symmetric A with L = ½ ωᵀ A ω of equation 12, coefficient by coefficient as printed."""
    a = I * R**2 / (16.0 * L**2)
    b = M * R**2 / 8.0
    matrix = np.eye(4) * (b + a + IB)
    for i, j, coefficient in ((0, 2, b - a), (1, 3, b - a), (0, 1, -a), (0, 3, a), (1, 2, a), (2, 3, -a)):
        matrix[i, j] = matrix[j, i] = coefficient
    return matrix


@given(triple)
def test_equation_1_gives_the_wheel_speeds_with_rollers_at_minus_and_plus_45_degrees(v):
    """γ is not in the paper: -45° for wheels 1 and 3, +45° for 2 and 4."""
    places = ((L1, L2, -1.0), (L1, -L2, 1.0), (-L1, -L2, -1.0), (-L1, L2, 1.0))
    rows = [np.array([1.0, tangent]) @ np.array([[1.0, 0.0, -y], [0.0, 1.0, x]]) for x, y, tangent in places]
    assert np.array(rows) @ v / R == pytest.approx(wheel_speeds(BodyTwist(*v), R, L), abs=1e-9)


@given(four)
def test_equation_7_is_right_once_its_third_row_has_four_entries(speeds):
    matrix = R / 4.0 * np.array([[1, 1, 1, 1], [-1, 1, -1, 1], [-1 / L, 1 / L, 1 / L, -1 / L]])
    assert matrix @ speeds == pytest.approx(body_twist(Wheels(*speeds), R, L), abs=1e-12)


@given(four)
def test_equation_12_is_the_energy_of_equations_7_and_10(speeds):
    v = body_twist(Wheels(*speeds), R, L)
    energy = 0.5 * M * (v[0] ** 2 + v[1] ** 2) + 0.5 * I * v[2] ** 2 + 0.5 * IB * np.dot(speeds, speeds)
    assert 0.5 * np.array(speeds) @ lagrangian_matrix() @ speeds == pytest.approx(energy, rel=1e-12, abs=1e-15)


@given(triple, value)
def test_lagrange_on_four_dependent_wheel_angles_gives_the_printed_coriolis_term(v, heading):
    """Equation 13 on equation 12: A ω̇ = Q with ω = H Rᵀ q̇ / r gives (m + k) θ̇ (ẏ, -ẋ, 0), where k belongs."""
    x, y, turn = v
    rotation = rot(heading)
    derivative = turn * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) @ rotation
    onto_body = rotation @ H.T / R
    found = onto_body @ lagrangian_matrix() @ H @ derivative.T @ np.array(v) / R
    assert found == pytest.approx([(M + K) * turn * y, -(M + K) * turn * x, 0.0], abs=1e-9)
    assert onto_body @ lagrangian_matrix() @ H @ rotation.T / R == pytest.approx(MASS, abs=1e-9)


@given(four, value)
def test_b_of_equation_14_is_right_and_that_of_equation_15_is_its_transpose(torques, heading):
    c, s = math.cos(heading), math.sin(heading)
    b14 = np.array([[c + s, c - s, c + s, c - s], [-c + s, c + s, -c + s, c + s], [-L, L, L, -L]]) / R
    first_rows_of_15 = np.array([[c + s, -c + s, -L], [c - s, c + s, L]]) / R
    wrench = body_wrench(Wheels(*torques), R, L)
    assert b14 @ torques == pytest.approx(rot(heading) @ wrench, abs=1e-9)
    assert b14.T[:2] == pytest.approx(first_rows_of_15)


@given(triple, triple, value)
def test_equation_18_is_the_law_with_a_coriolis_term_of_k(error, v, heading):
    """After a tick the filter has moved: x2d = x̄2 - (x̄2 - x2d) exp(-dt / ς); a short tick is equation 18."""
    k1, k2, filter_s, dt_s = 15.0, 40.0, 0.0675, 1e-9
    moving = Twist(0.3, -0.2, 0.1)
    pose = Pose(error[0], error[1], heading)
    wanted = Reference(Pose(0.0, 0.0, heading - error[2]), moving, Acceleration(0.0, 0.0, 0.0))
    law = Dsc(PAPER_ROBOT, CommandMode.TORQUE, Dsc.Options(k1, k2, filter_s))
    law.reset(State(Pose(0.0, 0.0, heading - error[2]), moving), wanted)  # x2d = q̇_d
    found = law.update(wanted, State(pose, Twist(*v)), AT_REST, dt_s).torque_n_m

    s1 = np.array([error[0], error[1], math.remainder(error[2], math.tau)])
    s2 = np.array(v) - moving
    virtual = np.array(moving) - k1 * s1
    coriolis = K * v[2] * np.array([v[1], -v[0], 0.0])
    b = rot(heading) @ H.T / R
    expected = -b.T @ np.linalg.inv(b @ b.T) @ (MASS @ (-(virtual - moving) / filter_s + k2 * s2) - coriolis)
    assert found == pytest.approx(expected, rel=1e-5, abs=1e-5)


@given(triple, value)
def test_b_times_its_pseudo_inverse_is_one(wrench, heading):
    still = 0.0, 0.0, 0.0
    torques = PAPER_ROBOT.wheel_torques(np.linalg.solve(MASS, wrench), still, heading, still)
    assert rot(heading) @ body_wrench(torques, R, L) == pytest.approx(wrench, abs=1e-9)


def test_the_inequality_of_equation_21_fails_for_the_small_epsilon_of_the_proof():
    """z <= 3 z² / 2 + ε / 3 for all z = abs(χ) abs(η) wants ε >= 1/2; "ε can be arbitrarily small" is what follows."""
    z = np.linspace(0.0, 1.0, 3001)
    assert np.all(z <= 1.5 * z**2 + 0.5 / 3.0 + 1e-12)
    assert not np.all(z <= 1.5 * z**2 + 0.49 / 3.0)
    # Equation 22 uses another one, which holds for every ε.
    assert all(np.all(z <= z**2 / (2.0 * eps) + eps / 2.0 + 1e-12) for eps in (1e-3, 0.1, 1.0))
