"""What a robot with real rollers does, against kinematics, the rigid FMU and Coulomb's law."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import share_of_examples
from tests.support.mujoco_testbed import DIRECTIONS, FORWARD, RIGID, TURN, Robot, Row, robot, wheel_speeds

ROLLING_MASS_KG = 4 * 0.005 / 0.075**2  # what four turning wheels add to the mass: 4 Ib / r^2
WEIGHT_N = 20.0 * 9.81


def drive(plant: Robot, wanted_rad_s: Row, steps: int) -> None:
    """Turn the wheels with wanted speeds by a stiff proportional speed loop."""
    for _ in range(steps):
        plant.torque(np.clip(0.5 * (wanted_rad_s - plant.wheels("speed_rad_s")), -1.0, 1.0))
        plant.step()


@share_of_examples(0.1)
@given(
    twist=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-1.0, 1.0)),
    heading_rad=st.floats(-10.0, 10.0),
    rollers=st.sampled_from((1, 2)),
    half_length_m=st.sampled_from((0.2, 0.4)),
)
def test_a_robot_that_starts_in_motion_rolls_on_with_the_wheel_speeds_of_kinematics(
    twist: tuple[float, float, float], heading_rad: float, rollers: int, half_length_m: float
) -> None:
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    start = {
        "start_vx_m_s": c * twist[0] - s * twist[1],
        "start_vy_m_s": s * twist[0] + c * twist[1],
        "start_yaw_rate_rad_s": twist[2],
        "start_heading_rad": heading_rad,
    }
    wanted = wheel_speeds(np.array(twist), rollers, half_length_m)
    with robot(**start, rollers=rollers, half_length_m=half_length_m) as plant:
        assert plant.pose[2] == pytest.approx(heading_rad, abs=1e-9)
        assert plant.wheels("speed_rad_s") == pytest.approx(wanted, abs=1e-9)
        plant.step(20)
        after = plant.pose[2] - heading_rad  # in so short a time little else turns the velocity
        vx, vy, yaw_rate = plant.twist
        assert plant.wheels("speed_rad_s") == pytest.approx(wanted, abs=0.5)
        assert yaw_rate == pytest.approx(twist[2], abs=0.05)
        assert (c * vx + s * vy, c * vy - s * vx) == pytest.approx(twist[:2], abs=0.02 + abs(after))


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_positive_and_negative_torques_drive_where_kinematics_says(direction: str) -> None:
    sign = DIRECTIONS[direction]
    axis = list(DIRECTIONS).index(direction)
    for sense in (1, -1):
        with robot() as plant:
            plant.torque(0.5 * sense * sign)
            plant.step(200)
            twist = plant.twist
            assert sense * twist[axis] > 0.1
            assert np.delete(twist, axis) == pytest.approx([0.0, 0.0], abs=1e-6)
            assert np.all(sense * sign * plant.wheels("speed_rad_s") > 1.0)


@pytest.mark.parametrize(
    ("loss", "speed_rad_s", "larger"), [(0.0, 2.0, 1.0), (0.0, 10.0, 1.0), (0.05, 4.0, 1.0), (-0.05, 4.0, 1.02)]
)
@pytest.mark.parametrize(("direction", "deficit"), [("forward", 0.0), ("left", 0.0115), ("turn", 0.0058)])
def test_the_twist_follows_from_the_wheel_speeds_up_to_the_rollers_number_and_the_loss(
    direction: str, deficit: float, loss: float, speed_rad_s: float, larger: float
) -> None:
    # Contacts wander along the rollers: sideways is shorter by sin(pi/n) / (pi/n) for n rollers, a turn by half of it.
    axis = list(DIRECTIONS).index(direction)
    lost = {"forward": 0.0, "left": loss, "turn": 0.5 * loss}[direction]
    size = np.array([1.0, larger, 1.0, 1.0])
    with robot(sideways_loss=loss, **{"wheel.fr.radius_factor": larger}) as plant:
        drive(plant, speed_rad_s * DIRECTIONS[direction] / size, 500)
        pose, angle = plant.pose, plant.wheels("angle_rad")
        drive(plant, speed_rad_s * DIRECTIONS[direction] / size, 1000)
        x, y, turned = plant.pose - pose
        c, s = math.cos(pose[2]), math.sin(pose[2])
        moved = (c * x + s * y, c * y - s * x, turned)[axis]
        rolled = 0.075 * DIRECTIONS[direction] @ (size * (plant.wheels("angle_rad") - angle)) / 4
        assert moved / (rolled / (0.6 if direction == "turn" else 1.0)) == pytest.approx(
            (1.0 - deficit) * (1.0 - lost), abs=0.0015
        )


@pytest.mark.parametrize("torque_n_m", [0.8, 1.6])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_torque_steps_agree_with_the_rigid_plant_to_3_per_cent(direction: str, torque_n_m: float) -> None:
    axis = list(DIRECTIONS).index(direction)
    with robot() as plant, robot(RIGID) as rigid:
        for each in (plant, rigid):
            each.torque(torque_n_m * DIRECTIONS[direction])
        for _ in range(2):
            plant.step(100)
            rigid.step(100)
            assert plant.twist[axis] == pytest.approx(rigid.twist[axis], rel=0.03)


@pytest.mark.parametrize("grip", [0.7, 0.35])
def test_forward_slip_begins_near_the_limit_of_coulombs_law(grip: float) -> None:
    # Equal loads would slip at 0.7 * 49 N * r / sqrt(2) = 1.82 N m, and what turns the wheels comes on top: 2.1. The
    # front wheels carry less and slip first.
    def slip_m_s(torque_n_m: float) -> float:
        with robot(grip_coefficient=grip) as plant:
            plant.torque(torque_n_m * FORWARD)
            plant.step(300)
            return float(np.max(0.075 * plant.wheels("speed_rad_s") - plant.twist[0]))

    assert slip_m_s(1.7 * grip / 0.7) < 0.02
    assert slip_m_s(2.0 * grip / 0.7) > 0.2 * grip


def test_one_slippery_wheel_pulls_the_robot_round() -> None:
    with robot(**{"wheel.fl.grip_factor": 0.3}) as plant:
        plant.torque(1.5 * FORWARD)
        plant.step(300)
        slip = 0.075 * plant.wheels("speed_rad_s") - plant.twist[0]
        assert np.argmax(slip) == 0
        assert plant.twist[2] > 0.1  # the pull along its rollers' axis would turn the robot clockwise


@pytest.mark.parametrize("wheel_inertia", [0.005, 0.015])
@pytest.mark.parametrize("yaw_rate", [2.0, 4.0])
def test_coasting_in_a_turn_decides_the_coriolis_term(wheel_inertia: float, yaw_rate: float) -> None:
    # With C = k yaw_rate (vy, -vx) the velocity turns at k / (m + k) of the yaw rate; with the paper's m + k at 1.
    added = 4 * wheel_inertia / 0.075**2
    with robot(start_vx_m_s=0.5, start_yaw_rate_rad_s=yaw_rate, wheel_inertia_kg_m2=wheel_inertia) as plant:
        plant.step(500)
        turned = math.atan2(plant.twist[1], plant.twist[0])
        assert plant.pose[2] > 0.9 * 0.5 * yaw_rate
        assert turned / plant.pose[2] == pytest.approx(added / (20.0 + added), abs=0.02)


def test_at_rest_nothing_moves_and_the_loads_are_the_weight() -> None:
    with robot(com_x_m=0.06, com_y_m=-0.03) as plant:
        loads = plant.wheels("load_n")
        assert plant.get("accelerometer.z_m_s2") == pytest.approx([9.81], abs=1e-3)
        assert loads.sum() == pytest.approx(WEIGHT_N, rel=1e-4)
        assert loads[:2].sum() == pytest.approx(WEIGHT_N * (0.3 + 0.06) / 0.6, rel=1e-3)
        assert loads[[0, 3]].sum() == pytest.approx(WEIGHT_N * (0.3 - 0.03) / 0.6, rel=1e-3)
        plant.step(500)
        assert plant.pose == pytest.approx([0.0, 0.0, 0.0], abs=2e-5)
        assert plant.wheels("load_n") == pytest.approx(loads, rel=1e-3)


@pytest.mark.parametrize("direction_rad", [0.0, math.pi / 2, 2.0])
def test_a_slope_pulls_downhill(direction_rad: float) -> None:
    fall = -9.81 * math.sin(0.1) * 20.0 / (20.0 + ROLLING_MASS_KG)
    with robot(slope_rad=0.1, slope_direction_rad=direction_rad) as plant:
        plant.step(400)
        wanted = 0.4 * fall * np.array([math.cos(direction_rad), math.sin(direction_rad)])
        assert plant.twist[:2] == pytest.approx(wanted, rel=0.04, abs=0.01)


def test_bearing_friction_holds_on_a_slope_below_it_and_gives_way_above() -> None:
    # A quarter of the weight on each wheel: mu m g r / 4 at the axle holds up to a slope of 4 mu r / (4 r) = mu.
    with robot(friction_coefficient=0.05, slope_rad=0.045) as plant:
        plant.step(500)
        assert abs(plant.pose[0]) < 2e-4
    with robot(friction_coefficient=0.05, slope_rad=0.1) as plant:
        plant.step(500)
        free_m = 0.125 * (math.sin(0.1) - 0.05 * math.cos(0.1)) * WEIGHT_N / (20.0 + ROLLING_MASS_KG)
        assert plant.pose[0] == pytest.approx(-free_m, rel=0.05)


def test_viscous_friction_and_a_push_balance() -> None:
    viscous, force = 0.05, 8.0
    with robot(viscous_n_m_s_rad=viscous) as plant:
        plant.set(**{"push.force_x_n": force})
        plant.step(3000)
        assert plant.twist[0] == pytest.approx(force * 0.075**2 / (4 * viscous), rel=0.05)


def test_a_pushing_moment_turns_the_robot() -> None:
    inertia = 0.56 + ROLLING_MASS_KG * 0.6**2
    with robot() as plant:
        plant.set(**{"push.moment_n_m": 15.0})
        plant.step(200)
        assert plant.twist[2] == pytest.approx(15.0 / inertia * 0.2, rel=0.04)
        assert plant.get("gyro.z_rad_s")[0] == pytest.approx(plant.twist[2], rel=1e-3)


def test_the_heading_is_not_wrapped() -> None:
    with robot() as plant:
        plant.torque(1.0 * TURN)
        plant.step(20, step_s=0.05)
        assert plant.pose[2] > 2 * math.pi


LIFTED = ("wheel.fl.lifted", "wheel.fr.lifted", "wheel.rr.lifted", "wheel.rl.lifted")


def test_on_blocks_each_wheel_turns_by_its_own_torque_and_the_body_stands() -> None:
    torque, seconds, inertia = np.array([0.1, -0.05, 0.02, 0.0]), 0.2, 0.005
    with robot() as plant:
        plant.torque(0.5 * FORWARD)
        plant.step(100)
        assert plant.twist[0] > 0.05
        plant.set(**dict.fromkeys(LIFTED, 1.0))
        before, place = plant.wheels("speed_rad_s"), plant.pose
        plant.torque(torque)
        plant.step(round(seconds * 1000))
        turned = plant.wheels("speed_rad_s") - before
        assert turned == pytest.approx(torque / inertia * seconds, rel=0.01, abs=0.02)  # rollers spin on
        assert plant.pose == pytest.approx(place, abs=1e-6)
        assert not plant.twist.any()
        assert not plant.wheels("load_n").any()
        assert plant.get("accelerometer.z_m_s2")[0] == pytest.approx(9.81, abs=0.03)
        plant.set(**dict.fromkeys(LIFTED, 0.0))
        plant.torque(np.zeros(4))
        plant.step(300)
        assert plant.wheels("load_n").sum() == pytest.approx(WEIGHT_N, rel=0.02)


def test_one_lifted_wheel_has_no_ground_force_and_the_others_drive_on() -> None:
    with robot(**{LIFTED[1]: 1.0}) as plant, robot(RIGID, **{LIFTED[1]: 1.0}) as rigid:
        for one in (plant, rigid):
            one.torque(np.array([0.8, 0.1, 0.8, 0.8]))
            one.step(200)
        loads = plant.wheels("load_n")
        assert loads[1] == 0.0
        assert np.delete(loads, 1).min() > 20.0
        assert plant.wheels("speed_rad_s")[1] == pytest.approx(0.1 / 0.005 * 0.2, rel=0.02)
        assert plant.twist == pytest.approx(rigid.twist, abs=0.06 * np.abs(rigid.twist).max())
