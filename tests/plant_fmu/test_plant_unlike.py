"""Robots that differ from the nominal one: what an odometry that believes the nominal one reads of their wheels."""

from collections.abc import Mapping

import numpy as np
import pytest

from tests.support.plant_oracle import G
from tests.support.plant_testbed import (
    ANGLES,
    AXLE_TORQUES,
    CURRENT,
    CURRENTS,
    DEFAULTS,
    POSE,
    RIGID,
    SLIP,
    SPEEDS,
    TORQUE,
    TWIST,
    VOLTAGE,
    O,
    X,
    robot,
    wheels,
)

R, L1, L2 = DEFAULTS["wheel_radius_m"], DEFAULTS["half_length_m"], DEFAULTS["half_width_m"]
RADII = wheels("radius_factor")
CONTACTS = pytest.mark.parametrize("contact", [RIGID, SLIP], ids=["rigid", "slip"])
FREE = {"roller_friction_coefficient": 0.0}


def odometry(angles: np.ndarray, rollers: int = X) -> np.ndarray:
    """Return the way forward and to the left, and the turn, that wheels of the nominal robot would have rolled."""
    forward = R / 4 * angles.sum()
    left = R / 4 * np.array([-1, 1, -1, 1]) @ angles * (1 if rollers == X else -1)
    turn = R / 4 * np.array([-1, 1, 1, -1]) @ angles
    return np.array([forward, left, turn / (L1 + L2 if rollers == X else L2 - L1 or np.inf)])


def coasted(start: Mapping[str, float], seconds: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Let a robot roll on from its start; return its pose, and its wheels' angles."""
    with robot(FREE, **start) as plant:
        plant.step(1e-3, round(seconds * 1000))
        return plant.read(POSE), plant.read(ANGLES)


@CONTACTS
@pytest.mark.parametrize("rollers", [X, O])
@pytest.mark.parametrize("loss", [0.05, -0.05, 0.012])
def test_the_robot_goes_sideways_by_what_its_wheels_rolled_less_the_loss(
    contact: int, rollers: int, loss: float
) -> None:
    start = {"contact": contact, "rollers": rollers, "sideways_loss": loss}
    pose, angles = coasted({**start, "start_vx_m_s": 0.3, "start_vy_m_s": 0.4})
    believed = odometry(angles, rollers)
    assert pose == pytest.approx((0.3, 0.4, 0.0), abs=1e-6)
    assert believed == pytest.approx((0.3, 0.4 / (1 - loss), 0.0), abs=1e-6)


@CONTACTS
def test_a_turn_loses_the_part_of_its_way_that_is_sideways(contact: int) -> None:
    """A contact ahead of the centre by l1 goes sideways, and one beside it by l2 forward: half of each here."""
    pose, angles = coasted({"contact": contact, "sideways_loss": 0.05, "start_yaw_rate_rad_s": 0.8})
    assert pose[2] == pytest.approx(0.8, rel=1e-6)
    assert odometry(angles)[2] == pytest.approx(0.8 * (L1 / 0.95 + L2) / (L1 + L2), rel=1e-6)


@CONTACTS
@pytest.mark.parametrize("wheel", range(4))
def test_a_larger_wheel_turns_less_and_the_odometry_drifts(contact: int, wheel: int) -> None:
    """One wheel of four is 2 % larger: it believes half a per cent less, and goes askew and turns by the rest."""
    pose, angles = coasted({"contact": contact, RADII[wheel]: 1.02, "start_vx_m_s": 0.5})
    assert pose == pytest.approx((0.5, 0.0, 0.0), abs=1e-6)
    expected = np.full(4, 0.5 / R)
    expected[wheel] /= 1.02
    assert angles == pytest.approx(expected, rel=1e-6)
    less = 0.5 * (1 - 1 / 1.02) / 4
    side, turn = (-1, 1, -1, 1)[wheel], (-1, 1, 1, -1)[wheel]
    assert odometry(angles) == pytest.approx((0.5 - less, -side * less, -turn * less / (L1 + L2)), abs=1e-6)


@CONTACTS
def test_radii_and_loss_that_change_on_the_way_hold_from_then_on(contact: int) -> None:
    """Dirt on a tyre for a while: the robot goes on as it was, and the wheel turns more slowly for so long."""
    with robot(FREE, contact=contact, start_vx_m_s=0.5, start_vy_m_s=0.2) as plant:
        turned = [plant.read(ANGLES)]
        for values in ({RADII[2]: 1.05, "sideways_loss": 0.1}, {RADII[2]: 1.0, "sideways_loss": 0.0}):
            plant.set(values)
            plant.step(1e-3, 1000)
            turned.append(plant.read(ANGLES))
        vx, vy, _ = plant.read(TWIST)
        during, after = np.diff(turned, axis=0)
    assert (vx, vy) == pytest.approx((0.5, 0.2), rel=0.02)
    signs = np.array([-1, 1, -1, 1])
    assert during == pytest.approx((0.5 + signs * 0.2 / 0.9) / (R * np.array([1, 1, 1.05, 1])), rel=0.03)
    assert after == pytest.approx((vx + signs * vy) / R, rel=0.03)


@pytest.mark.parametrize("drive", [TORQUE, CURRENT])
def test_a_stronger_motor_gives_more_torque_for_the_current_that_its_drive_sets(drive: int) -> None:
    wanted, gain = np.array([0.5, -0.3, 0.2, 0.1]), np.array([1.0, 1.1, 0.8, 1.0])
    constant = 2.0 * DEFAULTS["motor_constant_n_m_a"]
    with robot(dict(zip(wheels("torque_factor"), gain, strict=True)), drive=drive, gear_ratio=2.0) as plant:
        plant.torque(wanted)
        assert plant.read(CURRENTS) == pytest.approx(wanted / constant)
        assert plant.read(AXLE_TORQUES) == pytest.approx(gain * wanted)


def test_the_back_emf_of_a_stronger_motor_is_larger_too() -> None:
    """On blocks, with a duty of a half, a wheel without friction ends at d U / constant."""
    blocks = dict.fromkeys(wheels("lifted"), 1.0)
    with robot(blocks, drive=VOLTAGE, battery_resistance_ohm=0.0, **{"wheel.rr.torque_factor": 1.1}) as plant:
        plant.duty([0.5] * 4)
        plant.step(1e-3, 2000)
        ends = 0.5 * DEFAULTS["battery_voltage_v"] / (DEFAULTS["motor_constant_n_m_a"] * np.array([1, 1, 1.1, 1]))
        assert plant.read(SPEEDS) == pytest.approx(ends, rel=1e-6)


@CONTACTS
def test_a_wheel_whose_bearing_is_tight_sticks_up_to_its_own_friction(contact: int) -> None:
    mu, factor = 0.02, np.array([1.0, 1.0, 3.0, 0.0])
    limit = mu * factor * DEFAULTS["mass_kg"] * G / 4 * R
    blocks = dict.fromkeys(wheels("lifted"), 1.0) | dict(zip(wheels("friction_factor"), factor, strict=True))
    with robot(blocks, contact=contact, friction_coefficient=mu) as plant:
        plant.torque(0.99 * limit)
        plant.step(1e-3, 50)
        assert not plant.read(SPEEDS).any()
        plant.torque(limit + np.array([0.01, -3 * limit[0], 0.01, 0.01]))
        plant.step(1e-3, 100)
        assert plant.read(SPEEDS) == pytest.approx(np.array([1, -100 * limit[0], 1, 1]) * 1e-3 / 0.005, rel=1e-6)
