"""The plant's motion against an independent model, analytic cases, and conservation laws."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil.plant.fmu import FmuPlant
from hil.types import Wheels
from tests.plant_testbed import FMU, MOTION, ROBOT, TORQUES, Oracle, slave

K = 4 * ROBOT["wheel_inertia_kg_m2"] / ROBOT["wheel_radius_m"] ** 2
M, INERTIA, R, L = ROBOT["mass_kg"], ROBOT["inertia_kg_m2"], ROBOT["wheel_radius_m"], 0.6
ZERO = Wheels(0.0, 0.0, 0.0, 0.0)


def simulate(start: dict[str, float], torques: np.ndarray, hold_ticks: int) -> np.ndarray:
    """Return pose, twist and wheel angles after holding each row of torques, through FMPy."""
    with slave(start) as fmu:
        tick = 0
        for row in torques:
            fmu.setReal(TORQUES, list(row))
            for _ in range(hold_ticks):
                fmu.doStep(tick / 1000, 1e-3)
                tick += 1
        return np.array(fmu.getReal(MOTION))


@st.composite
def runs(draw: st.DrawFn, *, friction: bool) -> tuple[dict[str, float], np.ndarray, np.ndarray, np.ndarray]:
    def number(low: float, high: float) -> float:
        return draw(st.floats(low, high, allow_nan=False))

    robot = {
        **ROBOT,
        "mass_kg": number(5, 60),
        "inertia_kg_m2": number(0.3, 5),
        "wheel_radius_m": number(0.04, 0.15),
        "half_length_m": number(0.1, 0.5),
        "half_width_m": number(0.1, 0.5),
        "wheel_inertia_kg_m2": number(0.0, 0.02),
    }
    if friction:
        robot["friction_coefficient"] = number(0.01, 0.1)
        robot["viscous_n_m_s_rad"] = number(0.0, 0.05)
    pose = np.array([number(-2, 2), number(-2, 2), number(-4, 4)])
    twist = np.array([number(-1, 1), number(-1, 1), number(-3, 3)])
    torques = np.array([[number(-2, 2) for _ in range(4)] for _ in range(6)])
    return robot, pose, twist, torques


def start_of(robot: dict[str, float], pose: np.ndarray, twist: np.ndarray) -> dict[str, float]:
    names = ("x_m", "y_m", "heading_rad", "vx_m_s", "vy_m_s", "yaw_rate_rad_s")
    return robot | {f"start_{n}": float(v) for n, v in zip(names, [*pose, *twist], strict=True)}


@settings(max_examples=30, deadline=None)
@given(runs(friction=False))
def test_agrees_with_the_independent_model(run: tuple) -> None:
    robot, pose, twist, torques = run
    ours = simulate(start_of(robot, pose, twist), torques, 50)
    theirs = Oracle(robot).run(pose, twist, torques, 0.05)
    np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-10)


@settings(max_examples=15, deadline=None)
@example(
    (
        {**ROBOT, "mass_kg": 5.0, "inertia_kg_m2": 1.0, "wheel_radius_m": 0.0625, "half_length_m": 0.5}
        | {"half_width_m": 0.5, "wheel_inertia_kg_m2": 0.0, "friction_coefficient": 0.0625},
        np.zeros(3),
        np.zeros(3),
        np.array([[0.0] * 4] * 5 + [[0.0, 0.0, 0.0, 2.0]]),
    )
)
@given(runs(friction=True))
def test_agrees_with_the_independent_model_with_friction(run: tuple) -> None:
    robot, pose, twist, torques = run
    ours = simulate(start_of(robot, pose, twist), torques, 20)
    theirs = Oracle(robot).run(pose, twist, torques, 0.02)
    # A wheel that is driven through standstill crosses the whole knee of the friction, 0.1 rad/s, within one step of
    # 1 ms: an error of some 1e-4 is what a fixed step leaves there.
    np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("torque", "axis", "inertia"),
    [
        ((1, 1, 1, 1), 0, M + K),
        ((-1, 1, -1, 1), 1, M + K),
        ((-1, 1, 1, -1), 2, (INERTIA + K * L * L) / L),
    ],
    ids=["forward", "left", "turn left"],
)
def test_constant_torque_accelerates_evenly(torque: tuple[int, ...], axis: int, inertia: float) -> None:
    """Four equal torques: acceleration 4 tau / (r (m + k)), in rotation 4 tau L / (r (I + k L^2))."""
    with FmuPlant(FMU, {}) as plant:
        plant.step(Wheels(*(0.5 * t for t in torque)), 1000)
        fix, speeds = plant.truth(), plant.wheel_speeds()
    acceleration = 4 * 0.5 / (R * inertia)
    twist, pose = np.zeros(3), np.zeros(3)
    twist[axis], pose[axis] = acceleration, acceleration / 2
    np.testing.assert_allclose(fix.twist, twist, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(fix.pose, pose, rtol=1e-12, atol=1e-13)
    lever = L if axis == 2 else 1.0
    np.testing.assert_allclose(speeds, [t * lever * acceleration / R for t in torque], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("coriolis", "ratio"), [(1, K / (M + K)), (2, 1.0)], ids=["rigid", "as printed in the paper"])
def test_coasting_in_a_turn(coriolis: int, ratio: float) -> None:
    """The velocity of a coasting robot turns at k / (m + k) of its yaw rate: the README's analytic case."""
    yaw_rate, v, t = 2.0, 1.5, 2.0
    with FmuPlant(FMU, {"start_vx_m_s": v, "start_yaw_rate_rad_s": yaw_rate, "coriolis": coriolis}) as plant:
        plant.step(ZERO, 2000)
        pose, twist = plant.truth().pose, plant.truth().twist
    a = ratio * yaw_rate
    expected_pose = (v * np.sin(a * t) / a, v * (1 - np.cos(a * t)) / a, yaw_rate * t)
    expected_twist = (v * np.cos(a * t), v * np.sin(a * t), yaw_rate)
    np.testing.assert_allclose(pose, expected_pose, rtol=1e-11)
    np.testing.assert_allclose(twist, expected_twist, rtol=1e-11)


@settings(max_examples=10, deadline=None)
@given(runs(friction=False))
def test_energy_is_the_work_of_the_torques(run: tuple) -> None:
    """Constant torques do the work tau . angle; it is all found in the motion of body and wheels."""
    robot, pose, twist, torques = run

    def energy(twist: np.ndarray, heading: float) -> float:
        c, s = np.cos(heading), np.sin(heading)
        body = np.array([c * twist[0] + s * twist[1], -s * twist[0] + c * twist[1], twist[2]])
        return float(0.5 * body @ Oracle(robot).mass @ body)

    end = simulate(start_of(robot, pose, twist), torques[:1], 200)
    work = float(torques[0] @ end[6:10])
    gained = energy(end[3:6], end[2]) - energy(twist, pose[2])
    assert gained == pytest.approx(work, rel=1e-9, abs=1e-9)


def test_the_integrator_is_of_fourth_order() -> None:
    """Halving the step divides the error by 16. A yaw rate of 300 rad/s lifts the error above rounding."""
    yaw_rate, v, t = 300.0, 1.0, 0.1
    a = K / (M + K) * yaw_rate
    exact = np.array([v * np.sin(a * t) / a, v * (1 - np.cos(a * t)) / a])
    errors = []
    for steps in (100, 200, 400):
        with slave({"start_vx_m_s": v, "start_yaw_rate_rad_s": yaw_rate}) as fmu:
            for n in range(steps):
                fmu.doStep(n * t / steps, t / steps)
            errors.append(np.linalg.norm(np.array(fmu.getReal(MOTION[:2])) - exact))
    assert 14 < errors[0] / errors[1] < 18
    assert 14 < errors[1] / errors[2] < 18


def test_a_long_communication_step_is_divided() -> None:
    start = {"start_vx_m_s": 0.4, "start_yaw_rate_rad_s": 2.0}
    with slave(start) as long, slave(start) as short:
        for fmu in (long, short):
            fmu.setReal(TORQUES, [0.3, -0.2, 0.1, 0.4])
        long.doStep(0.0, 0.25)
        for n in range(250):
            short.doStep(n / 1000, 1e-3)
        np.testing.assert_allclose(long.getReal(MOTION), short.getReal(MOTION), rtol=1e-12)


def test_friction_slows_evenly_and_then_holds() -> None:
    """Well above the friction speed the deceleration is 4 xi / (r (m + k)); at the end the robot stays."""
    mu, v = 0.05, 1.0
    deceleration = mu * M * 9.81 / (M + K)
    with FmuPlant(FMU, {"friction_coefficient": mu, "start_vx_m_s": v}) as plant:
        plant.step(ZERO, 1000)
        assert plant.truth().twist.vx_m_s == pytest.approx(v - deceleration, rel=1e-9)
        plant.step(ZERO, 4000)
        assert abs(plant.truth().twist.vx_m_s) < 1e-12


def test_the_stiffest_friction_is_stable() -> None:
    """The internal step follows the steepest friction that the ranges allow, so nothing oscillates."""
    start = {
        "friction_coefficient": 2.0,
        "friction_speed_rad_s": 0.01,
        "viscous_n_m_s_rad": 10.0,
        "wheel_inertia_kg_m2": 0.0,
        "start_vx_m_s": 0.5,
        "start_yaw_rate_rad_s": 3.0,
    }
    with FmuPlant(FMU, start) as plant:
        previous = np.abs(plant.wheel_speeds())
        for _ in range(50):
            plant.step(ZERO)
            speeds = np.abs(plant.wheel_speeds())
            assert np.all(speeds.max() <= previous.max())
            previous = speeds
        plant.step(ZERO, 200)
        assert np.all(np.abs(plant.wheel_speeds()) < 1e-9)


def test_constraint_holds_along_the_way() -> None:
    """Wheel angles integrate the wheel speeds: forward by x turns every wheel by x / r."""
    angles = simulate({}, np.array([[0.5] * 4]), 1000)
    np.testing.assert_allclose(angles[6:10], angles[0] / R, rtol=1e-12)
