"""States: saved and restored to the bit in every drive and contact, independent, and continued as if started there."""

import contextlib
from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from tests.plant_testbed import (
    CURRENT,
    DEFAULTS,
    GRIPS,
    OUTPUTS,
    POSE,
    RIGID,
    SLIP,
    SLIPS,
    SPEEDS,
    START,
    TORQUE,
    TWIST,
    VARIABLES,
    VOLTAGE,
    Robot,
    assign,
    robot,
    slave,
)

contacts = pytest.mark.parametrize("contact", [RIGID, SLIP], ids=["rigid", "slip"])
drives = pytest.mark.parametrize("drive", [TORQUE, CURRENT, VOLTAGE], ids=["torque", "current", "voltage"])
# Torques or duties under which, from 60 ms on, two wheels stand while the others turn, and slip where they can.
STICKING = {
    "friction_coefficient": 0.2,
    "gyro_noise_rad_s": 0.01,
    "accelerometer_noise_m_s2": 0.1,
    "com_x_m": 0.02,
    "slope_rad": 0.02,
    "current_limit_a": 6.0,
    "start_vx_m_s": 0.02,
    "mass_kg": 60.0,
}


def drive_on(plant: Robot, first: int, last: int) -> list[bytes]:
    """Take the steps with these numbers, under inputs that follow from them; return all outputs after each."""
    rows = []
    for n in range(first, last):
        ramp = 0.7 + 0.3 * np.sin(0.2 * n)
        plant.torque((0.0, 7.0 * ramp, 0.0, 7.0 * ramp))
        plant.duty((0.0, 0.5 * ramp, 0.0, 0.5 * ramp))
        plant.push(0.1 * n, -0.05 * n, 0.01 * n)
        plant.step(2**-10)
        rows.append(plant.bits())
    return rows


@contacts
@drives
def test_a_restored_state_continues_to_the_bit(contact: int, drive: int) -> None:
    """From the middle of a run, while two wheels stick and two turn, slipping where they can; also in another one."""
    with robot(STICKING, contact=contact, drive=drive) as plant, robot() as other:
        drive_on(plant, 0, 100)
        speeds = plant.read(SPEEDS)
        assert (np.abs(speeds) < 1e-12).tolist() == [True, False, True, False]
        assert (np.abs(plant.read(SLIPS)).max() > 1e-3) == (contact == SLIP)
        state, time_s = plant.save(), plant.time_s
        data = plant.fmu.serializeFMUState(state)
        here = plant.bits()
        expected = drive_on(plant, 100, 160)
        plant.restore(state, time_s)
        assert plant.bits() == here
        assert drive_on(plant, 100, 160) == expected
        copy = other.fmu.deSerializeFMUstate(data)
        other.restore(copy, time_s)
        assert other.bits() == here
        assert drive_on(other, 100, 160) == expected
        plant.fmu.freeFMUState(state)
        other.fmu.freeFMUState(copy)


@contacts
@drives
def test_robots_do_not_disturb_one_another(contact: int, drive: int) -> None:
    """Step about with another one of other parameters; and the same inputs give the same bits."""
    case = {**STICKING, "contact": contact, "drive": drive}
    others = {"contact": 3 - contact, "drive": 1 + drive % 3, "rollers": 2, "seed": 5, "mass_kg": 7.0}
    with robot(case) as alone:
        expected = drive_on(alone, 0, 60)
    with robot(case) as plant, robot(others) as other, robot(case) as twin:
        rows, twins = [], []
        for n in range(60):
            rows += drive_on(plant, n, n + 1)
            other.torque((3.0, -1.0, 0.1 * n, 2.0))
            other.step(3e-3)
            twins += drive_on(twin, n, n + 1)
        assert rows == twins == expected


@contacts
@drives
@pytest.mark.parametrize("count", [2, 64])
def test_short_steps_are_one_long_step_where_internal_steps_coincide(contact: int, drive: int, count: int) -> None:
    """To the bit, with steps that are powers of 2; with Coulomb friction and wheels that stop in mid-step too."""
    case = {**STICKING, "contact": contact, "drive": drive, "longest_step_s": 2**-14, "start_yaw_rate_rad_s": 0.3}
    with robot(case) as short, robot(case) as long:
        for _ in range(4):
            for plant in (short, long):
                plant.torque((1.0, 6.0, -2.0, 4.0))
                plant.duty((0.1, 0.5, -0.2, 0.3))
            short.step(2**-12, count)
            long.step(2**-12 * count)
            assert short.bits() == long.bits()
            assert short.time_s == long.time_s


def test_other_internal_steps_differ_by_the_method_error_alone() -> None:
    """A step of 7.5 ms has 8 internal ones, five of 1.5 ms have 10: close, not equal."""
    case = {"start_vx_m_s": 0.4, "start_yaw_rate_rad_s": 2.0}
    with robot(case) as short, robot(case) as long:
        for plant, step_s in ((short, 1.5e-3), (long, 7.5e-3)):
            plant.torque((0.3, -0.2, 0.1, 0.4))
            plant.step(step_s, round(0.3 / step_s))
        np.testing.assert_allclose(short.read((*POSE, *TWIST)), long.read((*POSE, *TWIST)), rtol=1e-10)
        assert short.bits() != long.bits()


# Every tunable parameter, with a value for the rest of a run that makes the rest different.
TUNED = {
    "mass_kg": 35.0,
    "inertia_kg_m2": 1.7,
    "com_x_m": 0.05,
    "com_y_m": -0.04,
    "com_height_m": 0.2,
    "friction_coefficient": 0.05,
    "viscous_n_m_s_rad": 0.3,
    "slope_rad": 0.1,
    "slope_direction_rad": 2.0,
    "grip_coefficient": 0.2,
    **dict.fromkeys(GRIPS, 0.1),
    "roller_friction_coefficient": 0.03,
    "current_limit_a": 0.5,
    "battery_voltage_v": 14.0,
    "battery_resistance_ohm": 0.4,
    "gyro_noise_rad_s": 0.5,
    "accelerometer_noise_m_s2": 0.5,
    **{name: 0.3 for name in VARIABLES if "_bias_" in name},
}
NOT_COMPARED = ("angle", "count", "index", "energy", "pose.x", "pose.y")  # count from the start of a run


@contextlib.contextmanager
def restarted(case: Mapping[str, float], start_s: float) -> Iterator[Robot]:
    """Give a robot that starts at ``start_s``."""
    with slave(initialised=False) as fmu:
        fmu.setupExperiment(startTime=start_s)
        assign(fmu, case)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        yield Robot(fmu, start_s)


def test_every_tunable_parameter_is_tried() -> None:
    assert {name for name, v in VARIABLES.items() if v.variability == "tunable"} == set(TUNED)


def shown(plant: Robot, since: np.ndarray) -> np.ndarray:
    """Return what outputs do not count from the start of a run, and the way since a position."""
    names = [name for name in OUTPUTS if not any(part in name for part in NOT_COMPARED)]
    return np.concatenate([plant.read(names), plant.read(POSE[:2]) - since])


SLIPPING = {name for name in TUNED if "grip" in name or "roller" in name or name == "com_height_m"}


@contacts
@drives
@pytest.mark.parametrize("name", TUNED)
def test_a_parameter_set_between_steps_acts_as_if_the_robot_started_there_with_it(
    contact: int, drive: int, name: str
) -> None:
    """A robot that cruises bends no roller and carries no current, so that a start can be where it is.

    Without slip and windings it can be anywhere: there it turns as well.
    """
    velocity = 0.4
    case = {"contact": contact, "drive": drive, "roller_friction_coefficient": 0.0, START[3]: velocity}
    hill = {"slope_rad": 0.1} if name == "slope_direction_rad" else {}
    cruising = velocity / DEFAULTS["wheel_radius_m"] * DEFAULTS["motor_constant_n_m_a"] / DEFAULTS["battery_voltage_v"]
    with robot(case) as plant, robot(case) as unchanged:
        for each in (plant, unchanged):
            each.duty([cruising] * 4)
            each.torque((1.5, -0.6, 0.9, 0.3) if contact == RIGID else (0, 0, 0, 0))
            each.step(2**-10, 20)
            each.set(hill)
        plant.set({name: TUNED[name]})
        pose, twist = plant.read(POSE), plant.read(TWIST)
        start = {**case, **dict(zip(START, (*pose, *twist), strict=True)), **hill, name: TUNED[name]}
        with restarted(start, plant.time_s) as fresh:
            for each in (plant, unchanged, fresh):
                each.torque((2.0, 0.5, 1.0, 2.5))
                each.duty((0.6, 0.2, 0.4, 0.7))
            for _ in range(20):
                for each in (plant, unchanged, fresh):
                    each.step(2**-10)
                np.testing.assert_allclose(shown(plant, pose[:2]), shown(fresh, pose[:2]), rtol=1e-9, atol=1e-10)
            idle = (contact == RIGID and name in SLIPPING) or (drive == TORQUE and name == "current_limit_a")
            differs = not np.allclose(shown(plant, pose[:2]), shown(unchanged, pose[:2]), rtol=1e-6, atol=1e-9)
            assert differs != idle


@contacts
@drives
def test_a_parameter_that_is_set_and_set_back_leaves_no_trace(contact: int, drive: int) -> None:
    with robot(STICKING, contact=contact, drive=drive) as plant, robot(STICKING, contact=contact, drive=drive) as twin:
        drive_on(plant, 0, 100)
        drive_on(twin, 0, 100)
        plant.set(TUNED)
        plant.read(OUTPUTS)
        plant.set({name: STICKING.get(name, DEFAULTS[name]) for name in TUNED})
        assert drive_on(plant, 100, 120) == drive_on(twin, 100, 120)
