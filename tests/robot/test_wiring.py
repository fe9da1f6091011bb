"""A robot's wiring: hidden from the bridge by [plant.wiring], and told to it by [device]."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES
from hil.core.wheel_map import IMU_AXES, ImuMount, WheelMap, Wiring
from hil.plant import archive
from hil.plant.fmu import FmuPlant
from hil.plant.shim import load
from hil.robot.faults import Body, RobotFaults
from hil.runtime.bench import Bench
from hil.scenario import load as load_scenario
from tests.support.examples import share_of_examples

ORDERS = st.permutations(WHEEL_NAMES)
SOME = st.lists(st.sampled_from(WHEEL_NAMES), unique=True)
SIGNS = ("", "-")


def frames() -> list[tuple[str, ...]]:
    """Return all ways to mount an IMU."""
    found = []
    for axes in itertools.permutations(IMU_AXES):
        for signs in itertools.product(SIGNS, repeat=3):
            mount = tuple(sign + axis for sign, axis in zip(signs, axes, strict=True))
            try:
                ImuMount(mount)
            except ValueError:
                continue
            found.append(mount)
    return found


def sensed(wiring: Wiring, torque_n_m: tuple[float, ...]) -> dict[str, np.ndarray]:
    """Return the sensed values of a robot with this wiring after 50 ms of these torques of its channels."""
    ffi, _ = load()
    start = {"contact": "slip", "slope_rad": 0.1, "gyro_bias_x_rad_s": 0.2, "gyro_bias_y_rad_s": -0.1}
    with FmuPlant(archive.locate("mecanum", Path()), start) as plant:
        plant.wire(wiring.motors.wheel_of_channel, wiring.motors.sign_of_channel)
        faults = RobotFaults(plant, Body(wiring, 0.3, 0.3, has_rigid_contact=False))
        faults.clear()  # as at a power cycle: the wiring stays
        exchange = ffi.cast("wheel_plant_exchange", faults.exchange_address)
        context, sense = ffi.cast("void *", faults.context_address), ffi.new("wheel_sense *")
        for tick in range(50):
            drive = ffi.new("wheel_drive *", {"tick": tick, "enabled": 1, "torque_n_m": torque_n_m})
            assert exchange(context, drive, sense) == 0
    count = np.array(list(sense.count), dtype=np.uint16).astype(np.int16)
    return {"count": count, **{name: np.array(list(getattr(sense, name))) for name in ("gyro_rad_s", "current_a")}} | {
        "acceleration_m_s2": np.array(list(sense.acceleration_m_s2))
    }


def test_an_imu_can_be_mounted_in_24_ways_and_each_is_undone_by_its_mount() -> None:
    assert len(frames()) == 24
    body = np.array([1.0, 2.0, 3.0])
    for axes in frames():
        measured = [(-1 if axis.startswith("-") else 1) * body[IMU_AXES.index(axis[-1])] for axis in axes]
        mount = ImuMount(axes)
        assert mount.to_body(tuple(measured)) == tuple(body)
        rate = mount.yaw_rate(measured[2])
        assert rate == 3.0 if axes[2] in ("z", "-z") else np.isnan(rate)


@share_of_examples(0.1)
@given(ORDERS, SOME, ORDERS, SOME, st.sampled_from(frames()))
def test_electronics_sense_the_same_robot_through_any_wiring(
    wheels: list[str], reversed_wheels: list[str], encoders: list[str], against: list[str], imu: tuple[str, ...]
) -> None:
    by_wheel = dict(zip(WHEEL_NAMES, (0.5, 0.3, -0.2, 0.1), strict=True))
    sign = {wheel: -1 if wheel in reversed_wheels else 1 for wheel in WHEEL_NAMES}
    motors = WheelMap(wheels, reversed_wheels)
    truth = sensed(Wiring.of(WheelMap()), tuple(by_wheel.values()))
    wired = Wiring(motors, tuple(encoders), tuple(against), ImuMount(imu))
    seen = sensed(wired, tuple(sign[wheel] * by_wheel[wheel] for wheel in wheels))
    assert abs(truth["count"]).min() > 3
    true = dict(zip(WHEEL_NAMES, truth["count"], strict=True))
    flipped = {wheel: sign[wheel] * (-1 if wheel in against else 1) for wheel in WHEEL_NAMES}
    assert list(seen["count"]) == [flipped[wheel] * true[wheel] for wheel in encoders]
    currents = dict(zip(WHEEL_NAMES, truth["current_a"], strict=True))
    assert list(seen["current_a"]) == [sign[wheel] * currents[wheel] for wheel in wheels]
    for name in ("gyro_rad_s", "acceleration_m_s2"):
        assert wired.imu.to_body(tuple(seen[name])) == tuple(truth[name])


HIDDEN = {
    "plant.wiring.wheels": ["rl", "fl", "fr", "rr"],
    "plant.wiring.reversed": ["fl", "rl"],
    "plant.wiring.imu": ["-y", "-x", "-z"],
}
TOLD = {key.replace("plant.wiring", "device"): value for key, value in HIDDEN.items()}
SHORT = {"loop.duration_s": 1.0, "estimator.source": "odometry", "expect": []}


def test_a_wiring_that_the_bridge_knows_changes_nothing_and_one_that_it_does_not_know_ruins_the_run() -> None:
    plain, told, hidden = (
        hil.run("paper_circle", set=SHORT | more, record=None) for more in ({}, HIDDEN | TOLD, HIDDEN)
    )
    for signal in ("robot.yaw_rate_rad_s", "robot.acceleration_x_m_s2", "wheel.fr.speed_rad_s", "error.planar_m"):
        assert told.signals[signal] == pytest.approx(plain.signals[signal], abs=1e-9, nan_ok=True)
    assert hidden.signals["error.planar_m"][-1] > 2 * plain.signals["error.planar_m"][-1]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("plant.wiring.wheels", ["fl", "fl", "rr", "rl"], 'each of "fl", "fr", "rr" and "rl" once'),
        ("plant.wiring.encoders", ["fl"], 'each of "fl", "fr", "rr" and "rl" once'),
        ("plant.wiring.reversed", ["fl", "fl"], "each wheel at most once"),
        ("plant.wiring.imu", ["x", "y", "-z"], "left-handed"),
        ("plant.wiring.imu", ["x", "x", "z"], "one of x, one of y and one of z"),
        ("device.imu", ["x", "y", "up"], "expected"),
        ("plant.wiring.motors", ["fl"], "unknown key plant.wiring.motors"),
    ],
)
def test_a_wiring_that_cannot_be_is_refused(key: str, value: list[str], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        load_scenario("paper_circle", set={key: value})


def test_a_hidden_wiring_is_refused_for_a_real_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario("paper_circle", set=HIDDEN)
    with Bench(scenario, None, allow_motion=True) as bench:
        assert bench.connect().has_power_stage is False
        bench.local = None  # as for a robot elsewhere
        bench.truth = None
        bench.connect()  # a simulated plant behind a real board: nothing real is wired
        monkeypatch.setattr(type(bench.device.info), "has_power_stage", property(lambda _: True))
        with pytest.raises(BadInputError, match="this one is real; remove the table"):
            bench.connect()
