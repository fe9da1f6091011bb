"""Wheels that are off the ground: on blocks all four, or one alone, with rigid contact and with slip."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import share_of_examples
from tests.support.plant_oracle import G
from tests.support.plant_testbed import (
    DEFAULTS,
    ENERGY,
    LOADS,
    MESSAGES,
    POSE,
    RIGID,
    SLIP,
    SLIPS,
    SPEEDS,
    TWIST,
    Robot,
    robot,
    wheels,
)

M, R, L1, L2, J, INERTIA = (
    DEFAULTS[name]
    for name in (
        "mass_kg",
        "wheel_radius_m",
        "half_length_m",
        "half_width_m",
        "wheel_inertia_kg_m2",
        "inertia_kg_m2",
    )
)
LIFTED = wheels("lifted")
ON_BLOCKS = dict.fromkeys(LIFTED, 1.0)
FREE = {"roller_friction_coefficient": 0.0}
L = L1 + L2
ROWS = np.array([[1, -1, -L], [1, 1, L], [1, -1, L], [1, 1, -L]]) / R
CONTACTS = pytest.mark.parametrize("contact", [RIGID, SLIP], ids=["rigid", "slip"])
ACCELEROMETER = ("accelerometer.x_m_s2", "accelerometer.y_m_s2", "accelerometer.z_m_s2")


def steady(plant: Robot, torque: tuple[float, ...], seconds: float) -> np.ndarray:
    """Hold torques; return the speeds of the wheels at the end."""
    plant.torque(torque)
    plant.step(count=round(seconds * 1000))
    return plant.read(SPEEDS)


@CONTACTS
def test_on_blocks_each_wheel_turns_by_its_own_torque_and_inertia_and_the_body_stands(contact: int) -> None:
    """omega = tau / d (1 - exp(-d t / J)), with the viscous friction d."""
    torque, d, seconds = (0.1, -0.05, 0.02, 0.0), 0.01, 0.4
    with robot(ON_BLOCKS, contact=contact, viscous_n_m_s_rad=d, com_x_m=0.05) as plant:
        plant.push(30.0, -20.0, 5.0)  # blocks hold against it
        speeds = steady(plant, torque, seconds)
        assert speeds == pytest.approx(np.array(torque) / d * (1 - np.exp(-d * seconds / J)), rel=1e-6, abs=1e-12)
        assert not plant.read((*POSE, *TWIST, *LOADS, *SLIPS)).any()
        assert plant.read(ACCELEROMETER) == pytest.approx((0.0, 0.0, G))
        supplied, stored, lost = plant.read(ENERGY)
        assert stored == pytest.approx(supplied - lost, rel=1e-6)
        assert stored == pytest.approx(0.5 * J * (speeds**2).sum(), rel=1e-6)


@CONTACTS
def test_a_lifted_wheel_sticks_up_to_the_friction_of_its_axle(contact: int) -> None:
    mu = 0.02
    limit = mu * M * G / 4 * R
    with robot(ON_BLOCKS, contact=contact, friction_coefficient=mu) as plant:
        speeds = steady(plant, (0.99 * limit, -0.99 * limit, 1.5 * limit, -2 * limit), 0.1)
    assert speeds == pytest.approx((0.0, 0.0, 0.5 * limit / J * 0.1, -limit / J * 0.1), rel=1e-6)


def acceleration(lifted: int, torque: np.ndarray, com: tuple[float, float]) -> np.ndarray:
    """Body acceleration at rest of a rigid robot, by the mass matrix of the wheels that are on the ground."""
    cx, cy = com
    mass = np.array([[M, 0, -M * cy], [0, M, M * cx], [-M * cy, M * cx, INERTIA + M * (cx**2 + cy**2)]])
    down = [i for i in range(4) if i != lifted]
    mass = mass + J * ROWS[down].T @ ROWS[down]
    return np.linalg.solve(mass, ROWS[down].T @ torque[down])


@share_of_examples(0.2)
@given(
    lifted=st.integers(0, 3),
    torque=st.tuples(*[st.floats(-1.0, 1.0)] * 4),
    com=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
)
def test_with_one_wheel_lifted_the_other_three_drive_the_robot(
    lifted: int, torque: tuple[float, ...], com: tuple[float, float]
) -> None:
    seconds = 1e-3
    start = {LIFTED[lifted]: 1.0, "com_x_m": com[0], "com_y_m": com[1]}
    with robot(start) as plant:
        speeds = steady(plant, torque, seconds)
        twist = plant.read(TWIST)
        assert plant[LOADS[lifted]] == 0.0
    expected = acceleration(lifted, np.array(torque), com) * seconds
    # Where torques cancel along an axis, the rest comes from the turn that has begun: centripetal acceleration.
    vx, vy, turn = expected
    turning = seconds * abs(turn) * (math.hypot(vx, vy) + math.hypot(*com) * abs(turn))
    assert twist == pytest.approx(expected, rel=1e-3, abs=turning + 1e-9)
    rolling = ROWS @ twist
    rolling[lifted] = torque[lifted] / J * seconds
    assert speeds == pytest.approx(rolling, rel=1e-3, abs=1e-6)


@CONTACTS
@pytest.mark.parametrize("lifted", range(4))
def test_without_a_block_the_other_three_wheels_carry_the_robot(contact: int, lifted: int) -> None:
    """Three supports share a weight in one way only; the centre of mass is on their side of the diagonal."""
    x, y = np.array([L1, L1, -L1, -L1]), np.array([L2, -L2, -L2, L2])
    cx, cy = -0.2 * x[lifted], -0.1 * y[lifted]
    down = [i for i in range(4) if i != lifted]
    expected = np.zeros(4)
    expected[down] = np.linalg.solve([np.ones(3), x[down], y[down]], M * G * np.array([1.0, cx, cy]))
    start = {LIFTED[lifted]: 1.0, "blocks": 0.0, "com_x_m": cx, "com_y_m": cy, "com_height_m": 0.0}
    with robot(start, contact=contact) as plant:
        assert plant.read(LOADS) == pytest.approx(expected, rel=1e-9)
        plant.set({"blocks": 1.0})
        on_block = plant.read(LOADS)
        plant.set({LIFTED[lifted]: 0.0})
        assert on_block == pytest.approx(np.where(np.arange(4) == lifted, 0.0, plant.read(LOADS)))


@pytest.mark.parametrize(
    ("hang", "expected"),
    [((0,), (0, 2, 0, 2)), ((1, 3), (2, 0, 2, 0)), ((0, 3), (0, 2, 2, 0)), ((0, 1, 2), (0, 0, 0, 4))],
    ids=str,
)
def test_wheels_that_hang_leave_the_weight_to_those_that_stand(
    hang: tuple[int, ...], expected: tuple[int, ...]
) -> None:
    """A symmetric robot rocks on a diagonal; on one side or a corner alone it falls, and that side carries it."""
    with robot(dict.fromkeys((LIFTED[i] for i in hang), 1.0), blocks=0.0) as plant:
        assert plant.read(LOADS) == pytest.approx(np.array(expected) * M * G / 4, abs=1e-9)


@pytest.mark.parametrize("lifted", range(4))
def test_with_slip_the_ground_gives_a_lifted_wheel_no_force(lifted: int) -> None:
    torque = np.array([0.3, 0.2, 0.25, 0.35])
    with robot(FREE, contact=SLIP, **{LIFTED[lifted]: 1.0}) as plant:
        speeds = steady(plant, tuple(torque), 0.3)
        assert plant[LOADS[lifted]] == plant[SLIPS[lifted]] == 0.0
        assert speeds[lifted] == pytest.approx(torque[lifted] / J * 0.3, rel=1e-6)
        twist = plant.read(TWIST)
        assert np.delete(plant.read(LOADS), lifted).min() > 20.0
    with robot(**{LIFTED[lifted]: 1.0}) as rigid:
        steady(rigid, tuple(torque), 0.3)
        assert twist == pytest.approx(rigid.read(TWIST), abs=0.02 * np.abs(twist).max())


@CONTACTS
def test_a_robot_is_put_on_blocks_and_back_between_two_steps(contact: int) -> None:
    with robot(FREE, contact=contact) as plant:
        rolling = steady(plant, (0.5, 0.5, 0.5, 0.5), 0.2)
        assert rolling.min() > 1.0
        plant.torque((0.0, 0.0, 0.0, 0.0))
        plant.set(ON_BLOCKS)
        assert not plant.read(TWIST).any()
        place = plant.read(POSE)
        plant.step(count=50)
        assert plant.read(SPEEDS) == pytest.approx(rolling, rel=1e-9)  # nothing brakes them
        assert plant.read(POSE) == pytest.approx(place)
        state = plant.save()
        then = plant.time_s
        plant.step(count=20)
        bits = plant.bits()
        plant.restore(state, then)
        plant.step(count=20)
        assert plant.bits() == bits
        plant.fmu.freeFMUState(state)
        plant.set(dict.fromkeys(LIFTED, 0.0))
        plant.step(count=400)
        assert plant.read(SPEEDS) == pytest.approx(ROWS @ plant.read(TWIST), abs=0.02)  # they roll again
        assert plant.read(LOADS).sum() == pytest.approx(M * G, rel=1e-6)


def test_less_than_a_half_is_on_the_ground_and_changes_no_bit() -> None:
    bits = []
    for lifted in (0.0, 0.49):
        with robot(dict.fromkeys(LIFTED, lifted), contact=SLIP, friction_coefficient=0.01) as plant:
            steady(plant, (0.5, -0.2, 0.5, 0.3), 0.1)
            bits.append(plant.bits())
    assert bits[0] == bits[1]


def test_a_wheel_without_inertia_cannot_be_lifted() -> None:
    with robot(wheel_inertia_kg_m2=0.0) as plant:
        plant.step()
        plant.set({LIFTED[2]: 1.0})
        with pytest.raises(Exception, match="discard"):
            plant.step()
        assert "with a lifted wheel; expected a positive number" in MESSAGES[-1]
        plant.set({LIFTED[2]: 0.0})
        plant.step()
