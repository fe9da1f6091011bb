"""Faults of the robot and its plant, between firmware and FMU: exact to the tick, and none arms it."""

import contextlib
import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.wheel_map import WheelMap, Wiring
from hil.faults.rows import NEVER_NS, FaultRow
from hil.plant import archive
from hil.plant.fmu import FmuPlant
from hil.plant.remote import RemotePlant
from hil.plant.shim import load
from hil.robot.faults import Body, RobotFaults
from tests.support.examples import share_of_examples
from tests.support.foreign_fmu import Var, foreign_fmu, foreign_map, variables2

MS = 1_000_000
BODY = Body(Wiring.of(WheelMap()), 0.3, 0.3, has_rigid_contact=False)
SLIP = {"contact": "slip"}


class Bridge:
    """A plant with faults in front, driven by hand through the plant port."""

    def __init__(self, *rows: FaultRow, begin: int = 0, plant=None, body: Body = BODY, start=None) -> None:
        self.ffi, _ = load()
        self.plant = plant or FmuPlant(archive.locate("mecanum", Path()), SLIP if start is None else start)
        self.faults = RobotFaults(self.plant, body)
        self.faults.arm(rows)
        self.faults.begin(begin)
        self.exchange = self.ffi.cast("wheel_plant_exchange", self.faults.exchange_address)
        self.context = self.ffi.cast("void *", self.faults.context_address)
        self.sense = self.ffi.new("wheel_sense *")
        self.tick = 0
        assert self.exchange(self.context, self.ffi.NULL, self.sense) == 0

    def run(self, ticks: int, torque_n_m=(0.3, 0.3, 0.3, 0.3)) -> list[dict[str, object]]:
        """Hold the torques for ``ticks``; return the sensed values after each, with the true pose."""
        out = []
        for _ in range(ticks):
            drive = self.ffi.new("wheel_drive *", {"tick": self.tick, "enabled": 1, "torque_n_m": torque_n_m})
            assert self.exchange(self.context, drive, self.sense) == 0, self.plant.message
            self.tick += 1
            out.append(
                {
                    "count": list(self.sense.count),
                    "gyro": self.sense.gyro_rad_s[2],
                    "tick": self.sense.tick,
                    "pose": self.plant.truth().pose,
                    "time_ns": self.plant.truth().time_ns,
                    "speeds": self.plant.wheel_speeds(),
                }
            )
        return out


def row(kind: str, target: str, start: int = 20, end: int = 40, value=0.0, **more) -> FaultRow:
    acts_on = "plant" if kind in ("parameter", "push", "payload", "lifted_wheel", "slip_patch") else "device"
    return FaultRow(kind, acts_on, target, start * MS, NEVER_NS if end is None else end * MS, value, **more)


def differing_ticks(one, other, key) -> list[int]:
    return [n for n, (a, b) in enumerate(zip(one, other, strict=True)) if a[key] != b[key]]


@pytest.mark.parametrize("begin", [0, 7])
def test_a_gyro_bias_is_in_exactly_the_ticks_of_its_window(begin) -> None:
    bridge = Bridge(row("gyro_bias", "gyro", value=0.5), begin=begin)
    assert differing_ticks(bridge.run(60), Bridge().run(60), "gyro") == list(range(20 + begin, 40 + begin))
    assert bridge.faults.applied() == [20]


@pytest.mark.parametrize("torque", [1.5, -1.5])
def test_an_encoder_loses_a_part_of_its_counts_in_the_window_and_misses_them_for_good(torque: float) -> None:
    bridge = Bridge(row("lost_counts", "rr", end=80, value=0.25))
    true, seen = ([each["count"] for each in b.run(100, [torque] * 4)] for b in (Bridge(), bridge))
    missed = (np.array(true) - seen).astype(np.int16)
    turned = np.diff(np.array(true, np.uint16)[:, 2], prepend=np.uint16(0)).astype(np.int16).cumsum()
    assert not np.delete(missed, 2, axis=1).any()
    expected = np.trunc(0.25 * (np.clip(turned, *sorted((turned[19], turned[79]))) - turned[19]))
    np.testing.assert_array_equal(missed[:, 2], expected)
    assert abs(missed[-1, 2]) > 10
    assert bridge.faults.applied() == [np.count_nonzero(np.diff(turned[19:80]))]


def test_a_stuck_encoder_loses_its_counts_for_good() -> None:
    bridge = Bridge(row("stuck_encoder", "rr"))
    sensed, clean = bridge.run(60), Bridge().run(60)
    counts = [s["count"][2] for s in sensed]
    true = [s["count"][2] for s in clean]
    assert counts[:20] == true[:20]
    assert set(counts[20:40]) == {true[19]}
    lost = true[39] - true[19]
    assert lost > 0
    assert counts[40:] == [count - lost for count in true[40:]]
    assert [s["count"][0] for s in sensed] == [s["count"][0] for s in clean]
    assert bridge.faults.applied() == [sum(a != b for a, b in itertools.pairwise(true[19:40]))]


def test_a_dead_motor_is_the_wheel_that_the_scenario_names() -> None:
    wired = Body(Wiring.of(WheelMap(("rr", "rl", "fl", "fr"))), 0.3, 0.3, has_rigid_contact=False)
    bridge = Bridge(row("dead_motor", "fl", start=0, end=None), body=wired)
    bridge.plant.wire((2, 3, 0, 1), (1, 1, 1, 1))
    speeds = bridge.run(10)[-1]["speeds"]
    assert speeds.fl < 0.5 * min(speeds.fr, speeds.rr, speeds.rl)
    assert bridge.faults.applied() == [10]


def test_a_reset_switches_the_drives_off_from_its_tick_until_the_power_comes_back() -> None:
    bridge = Bridge(row("reset", "robot", end=None))
    bridge.run(20)
    assert not bridge.faults.is_off
    moving = bridge.run(1)[-1]["pose"].x_m
    assert bridge.faults.is_off
    coasting = bridge.run(10)
    assert coasting[-1]["pose"].x_m > moving, "the plant goes on"
    bridge.faults.power_on()
    assert bridge.exchange(bridge.context, bridge.ffi.NULL, bridge.sense) == 0
    assert bridge.sense.tick == 0
    bridge.tick = 0
    assert bridge.run(30)[-1]["tick"] == 30
    assert not bridge.faults.is_off
    assert bridge.faults.applied() == [1]


def test_a_slow_clock_misses_what_it_says() -> None:
    bridge = Bridge(row("slow_clock", "clock", start=0, end=None, value=50_000.0))
    newest = bridge.run(400)[-1]
    assert newest["time_ns"] == 420 * MS
    assert newest["tick"] == 400
    assert bridge.faults.applied() == [20] == [bridge.faults.extra_ticks]


PLANTS = {
    "FMI 2.0": lambda: FmuPlant(archive.locate("mecanum", Path()), SLIP),
    "FMI 3.0": lambda: FmuPlant(archive.locate("mecanum_fmi3", Path()), SLIP),
    "in a process of its own": lambda: RemotePlant(archive.locate("mecanum", Path()), SLIP),
}


@pytest.mark.parametrize("kind", PLANTS)
def test_a_push_moves_the_robot_from_its_tick_on_and_is_over_at_the_end(kind: str) -> None:
    zero = (0.0, 0.0, 0.0, 0.0)
    with contextlib.closing(PLANTS[kind]()) as plant:
        bridge = Bridge(row("push", "force_y_n", value=100.0), plant=plant)
        y_m = [s["pose"].y_m for s in bridge.run(21, zero)]
        assert y_m[19] == 0.0
        assert y_m[20] > 0.0
        assert bridge.faults.applied() == [1]
        bridge.run(60, zero)
        assert bridge.faults.applied() == [20]


def test_of_rows_for_one_variable_the_last_in_force_counts_and_all_ends_as_before() -> None:
    rows = (
        row("push", "force_y_n", 10, 40, 50.0),
        row("parameter", "push.force_y_n", 20, 30, -50.0),
    )
    bridge = Bridge(*rows)
    v = np.diff([s["pose"].y_m for s in bridge.run(60, (0.0,) * 4)], n=2)
    assert v[:8] == pytest.approx(0.0, abs=1e-12)
    assert (v[10:17] > 0).all()
    assert (v[20:27] < 0).all()
    assert bridge.faults.applied() == [30, 10]


def test_a_payload_changes_mass_inertia_and_centre_of_mass_in_its_window_and_moves_with_the_next() -> None:
    """20 kg with their centre at (0.03, 0), and 5 kg first at one place, then at another: a sum of point masses."""
    own = {"mass_kg": 20.0, "inertia_kg_m2": 0.6, "com_x_m": 0.03, "com_y_m": 0.0}
    spots = [(0, 20, None), (20, 40, 0.2 - 0.1j), (40, 60, 0.1j), (60, 80, None)]
    rows = [row("payload", "robot", a, b, 5.0, x_m=at.real, y_m=at.imag) for a, b, at in spots if at is not None]
    bridge, plants = Bridge(*rows, start=own), []
    torque = (0.4, 0.1, -0.2, 0.3)
    for _, _, at in spots:
        if at is None:
            plants.append((20.0, 0.6, 0.03))
        else:
            com = (20.0 * 0.03 + 5.0 * at) / 25.0
            plants.append((25.0, 0.6 + 20.0 * abs(0.03 - com) ** 2 + 5.0 * abs(at - com) ** 2, com))
    with FmuPlant(archive.locate("mecanum", Path()), own) as by_hand:
        hand = Bridge(plant=by_hand)
        for mass, inertia, com in plants:
            values = (mass, inertia, complex(com).real, complex(com).imag)
            for name, value in zip(own, values, strict=True):
                by_hand.set_variable(name, value)
            assert bridge.run(20, torque)[-1]["pose"] == pytest.approx(hand.run(20, torque)[-1]["pose"], abs=1e-12)
    assert bridge.faults.applied() == [20, 20]


@pytest.mark.parametrize("wheel", range(4))
def test_a_wheel_that_lifts_drives_nothing_in_its_window(wheel: int) -> None:
    """Its torque turns it alone, tau / J; the body goes by the other three, and afterwards as before."""
    name = ("fl", "fr", "rr", "rl")[wheel]
    bridge = Bridge(row("lifted_wheel", name), start=SLIP | {"roller_friction_coefficient": 0.0})
    bridge.run(20, (0.2,) * 4)
    before = bridge.plant.wheel_speeds()[wheel]
    lifted = bridge.run(20, (0.2,) * 4)[-1]["speeds"]
    assert lifted[wheel] - before == pytest.approx(0.2 / 0.005 * 0.02, rel=1e-3)
    assert max(lifted[wheel - 1], lifted[wheel - 3]) < 0.5 * lifted[wheel]
    assert bridge.faults.applied() == [20]
    after = np.array(bridge.run(300, (0.2,) * 4)[-1]["speeds"])
    assert np.ptp(after) < 0.02 * after.mean()


def test_a_patch_acts_on_each_wheel_that_is_on_it() -> None:
    left = row("slip_patch", "floor", 0, None, 0.0, x_m=0.0, y_m=0.3, radius_m=0.35)
    bridge = Bridge(left)
    turned = bridge.run(200, (1.0,) * 4)[-1]["pose"].heading_rad
    assert turned > 0.01, "the right wheels pull alone"
    assert bridge.faults.applied() == [200]
    away = Bridge(row("slip_patch", "floor", 0, None, 0.0, x_m=50.0, y_m=0.0, radius_m=1.0))
    away.run(10)
    assert away.faults.applied() == [0]


@pytest.mark.parametrize("wheel", range(4))
def test_a_patch_is_under_the_wheel_that_stands_there_whatever_the_heading(wheel: int) -> None:
    """Where a wheel of a turned robot stands, by complex numbers; where its mirror image stands there is none."""
    offset = 0.3 * (1 + 1j, 1 - 1j, -1 - 1j, -1 + 1j)[wheel]
    start = SLIP | {"start_x_m": 1.0, "start_y_m": -2.0, "start_heading_rad": 0.7}
    for turn, applied in ((np.exp(0.7j), 20), (np.exp(-0.7j), 0)):
        at = 1 - 2j + offset * turn
        patch = row("slip_patch", "floor", 0, None, 0.0, x_m=at.real, y_m=at.imag, radius_m=0.02)
        bridge = Bridge(patch, start=start)
        speeds = bridge.run(20, (1.0,) * 4)[-1]["speeds"]
        assert bridge.faults.applied() == [applied]
        assert (speeds[wheel] > 2 * np.median(speeds)) == bool(applied)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (row("parameter", "friction_coeficient", value=0.1), "did you mean 'friction_coefficient'?"),
        (row("parameter", "wheel_radius_m", value=0.1), "no tunable parameter or free input 'wheel_radius_m'"),
        (row("parameter", "friction_coefficient", value=9.0), "out of the FMU's range; expected 0 to 2"),
        (row("drop", "command"), "a virtual robot does not support it"),
    ],
)
def test_what_the_plant_has_not_is_refused(fault, words) -> None:
    with pytest.raises(BadInputError, match=words.replace("?", r"\?")) as error:
        Bridge(fault)
    assert str(error.value).startswith(f"fault {fault.kind} {fault.target}: ")


def test_a_patch_needs_wheels_that_can_slip() -> None:
    with pytest.raises(BadInputError) as refused:
        Bridge(row("slip_patch", "floor", value=0.1), body=BODY._replace(has_rigid_contact=True), start={})
    assert str(refused.value) == (
        'fault slip_patch floor: wheels with rigid contact never slip; add plant.start.contact = "slip"'
    )


def test_an_fmu_of_others_may_lack_what_a_push_needs(tmp_path: Path) -> None:
    tunable = Var("k", 11, "Real", "parameter", {"variability": "tunable", "initial": "exact", "start": "1"})
    none = "the FMU has no variable that can change in a run; use another FMU, or remove the row"
    another = "the FMU has no tunable parameter or free input 'push.force_y_n'; the FMU has no such input"
    for more, words in (([], none), ([tunable], another)):
        fmu = foreign_fmu(tmp_path, 2, [*variables2(), *more])
        with FmuPlant(fmu, {}, foreign_map(2)) as plant, pytest.raises(BadInputError) as refused:
            Bridge(row("push", "force_y_n", value=1.0), plant=plant)
        assert str(refused.value) == f"fault push force_y_n: {words}"


DEVICE_ROWS = st.one_of(
    st.builds(row, st.sampled_from(["stuck_encoder", "dead_motor"]), st.sampled_from(["fl", "fr", "rr", "rl"])),
    st.builds(row, st.just("gyro_bias"), st.just("gyro"), value=st.floats(-100, 100)),
    st.builds(row, st.just("slow_clock"), st.just("clock"), value=st.floats(1, 1e5)),
    st.builds(row, st.just("low_battery"), st.just("battery"), value=st.floats(0, 100)),
    st.builds(row, st.just("reset"), st.just("robot"), st.integers(0, 60), st.none()),
    st.builds(row, st.just("parameter"), st.just("friction_coefficient"), value=st.floats(0, 2)),
    st.builds(row, st.just("slip_patch"), st.just("floor"), value=st.floats(0, 1)),
)


@share_of_examples(0.25)
@given(st.lists(DEVICE_ROWS, min_size=1, max_size=6), st.lists(st.binary(max_size=40), max_size=10))
def test_no_fault_moves_a_robot_that_was_not_armed(rows, garbage) -> None:
    robot = robot_at_rest()
    try:
        robot.faults.arm(rows)
        robot.faults.begin(0)
        for n in range(20):
            robot.node.feed(garbage[n] if n < len(garbage) else b"")
            robot.node.run(5)
            view = robot.node.look()
            assert not any((*view.set_point_rad_s, *view.torque_n_m, *view.duty))
            if robot.faults.is_off:
                robot.restart()
        assert robot.plant.wheel_speeds() == (0.0, 0.0, 0.0, 0.0)
        assert robot.plant.truth().pose == (0.0, 0.0, 0.0)
    finally:
        robot.close()


def robot_at_rest():
    from hil.robot.virtual import VirtualStm32
    from hil.runtime.robots import virtual_robot
    from hil.scenario import load

    start = {f"plant.start.start_{name}": 0.0 for name in ("x_m", "y_m", "heading_rad")}
    return VirtualStm32(virtual_robot(load("circle_slip", set=start)))
