"""Supervision: each fault is found, names its wheel and switches the drives off, and none is found without cause."""

import math
from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.generated import messages as m
from tests.support.examples import share_of_examples
from tests.support.wheel_rig import PARAMETERS, WheelRig

FREE = (0.0,) * 4


def fault(rig: WheelRig) -> tuple[m.Fault, m.FaultWheel]:
    view = rig.node.look()
    return view.fault, view.fault_wheel


def driving(speed_rad_s: float = 10.0, **parameters: float) -> tuple[WheelRig, int]:
    """A rig that follows a speed, and the next sequence."""
    rig = WheelRig(**parameters)
    rig.activate()
    return rig, rig.drive(speed_rad_s, 1000)


def set_currents(rig: WheelRig, wheel: int, value: float) -> None:
    rig.current_a[wheel] = value


def set_temperature(rig: WheelRig, wheel: int, value: float) -> None:
    rig.temperature_degc[wheel] = value


@pytest.mark.proves("R-FAULT-4", "R-FAULT-5", "R-FAULT-9", "R-GEN-5")
@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize(
    ("cause", "ticks", "harmless", "break_it"),
    [
        (m.Fault.OVERCURRENT, 5, 30.0, lambda r, w, v: set_currents(r, w, v)),
        (m.Fault.OVERCURRENT, 5, -30.0, lambda r, w, v: set_currents(r, w, v)),
        (m.Fault.OVERTEMPERATURE, 1, 119.99, lambda r, w, v: set_temperature(r, w, v)),
    ],
    ids=["current", "negative current", "temperature"],
)
def test_a_limit_is_a_fault_of_its_wheel_beyond_it_and_in_time(
    wheel: int, cause: m.Fault, ticks: int, harmless: float, break_it: Callable[[WheelRig, int, float], None]
) -> None:
    rig, sequence = driving()
    break_it(rig, wheel, harmless)
    sequence = rig.drive(10.0, 100, sequence)
    assert rig.state is m.State.ACTIVE
    for _ in range(3):  # a shorter time than it takes, again and again
        break_it(rig, wheel, harmless * 1.01)
        rig.run(ticks - 1)
        assert rig.state is m.State.ACTIVE
        break_it(rig, wheel, 0.0)
        sequence = rig.drive(10.0, 5, sequence)
    break_it(rig, wheel, harmless * 1.01)
    rig.run(ticks)
    assert (rig.state, fault(rig)) == (m.State.FAULT, (cause, m.FaultWheel(wheel + 1)))
    rig.run(1)
    assert not rig.enabled
    assert rig.torque_n_m == rig.duty == [0.0] * 4


@pytest.mark.proves("R-FAULT-6")
def test_a_low_battery_is_a_fault_of_a_driving_robot_only() -> None:
    rig, sequence = driving(undervoltage_v=18.0)
    rig.battery_v = 17.99
    rig.run(19)
    assert rig.state is m.State.ACTIVE
    rig.battery_v = 18.0
    sequence = rig.drive(10.0, 5, sequence)
    rig.battery_v = 17.99
    sequence = rig.drive(10.0, 15, sequence)
    rig.run(4)
    assert rig.state is m.State.ACTIVE
    rig.run(1)
    assert (rig.state, fault(rig)) == (m.State.FAULT, (m.Fault.UNDERVOLTAGE, m.FaultWheel.NONE))

    rig = WheelRig(undervoltage_v=18.0)
    rig.battery_v = 5.0
    rig.run(100)
    assert rig.state is m.State.IDLE, "on a charger, or before the main switch"
    rig.activate()
    rig.run(1)
    assert rig.state is m.State.FAULT


@pytest.mark.proves("R-FAULT-6")
def test_a_battery_that_sags_while_stopping_is_a_fault() -> None:
    rig, _ = driving(undervoltage_v=18.0)
    rig.run(50)
    assert rig.state is m.State.STOPPING
    rig.battery_v = 5.0
    rig.run(20)
    assert rig.state is m.State.FAULT


@pytest.mark.proves("R-FAULT-2", "R-FAULT-9")
@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize("pushed_rad_s", [100.5, -100.5])
def test_overspeed_of_any_wheel_either_way_is_a_fault(wheel: int, pushed_rad_s: float) -> None:
    rig = WheelRig()
    rig.speed_rad_s[wheel] = 0.99 * pushed_rad_s
    rig.run(200)
    assert rig.state is m.State.IDLE
    rig.speed_rad_s[wheel] = pushed_rad_s
    rig.run(200)
    assert (rig.state, fault(rig)) == (m.State.FAULT, (m.Fault.OVERSPEED, m.FaultWheel(wheel + 1)))


@pytest.mark.proves("R-FAULT-1")
@pytest.mark.parametrize(
    "path", ["current_a", "temperature_degc", "gyro_rad_s", "acceleration_m_s2", "battery_v", "battery_a"]
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.1e6, -3e38])
def test_a_value_that_no_sensor_gives_is_a_fault_at_once(path: str, value: float) -> None:
    for place in range(3 if path in ("gyro_rad_s", "acceleration_m_s2") else 4):
        rig = WheelRig()
        rig.override = {path: (place, value)}
        rig.run(1)
        assert (rig.state, fault(rig)) == (m.State.FAULT, (m.Fault.SENSOR, m.FaultWheel.NONE)), place
        if path.startswith("battery"):
            break


@pytest.mark.proves("R-FAULT-7", "R-FAULT-9")
@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize("speed_rad_s", [10.0, -10.0])
def test_a_dead_encoder_is_found_and_named(wheel: int, speed_rad_s: float) -> None:
    """From the moment on that the filter follows, and before the wheel ran away far."""
    rig, sequence = driving(speed_rad_s)
    rig.encoder_dead[wheel] = True
    rig.drive(speed_rad_s, 250, sequence)
    assert (rig.state, fault(rig)) == (m.State.FAULT, (m.Fault.ENCODER_STUCK, m.FaultWheel(wheel + 1)))
    assert max(map(abs, rig.speed_rad_s)) < 45.0


@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize("speed_rad_s", [10.0, -10.0])
def test_an_encoder_that_is_dead_from_the_start_is_found(wheel: int, speed_rad_s: float) -> None:
    rig = WheelRig()
    rig.encoder_dead[wheel] = True
    rig.activate()
    rig.drive(speed_rad_s, 300)
    assert (rig.state, fault(rig)) == (m.State.FAULT, (m.Fault.ENCODER_STUCK, m.FaultWheel(wheel + 1)))


@pytest.mark.parametrize("mode", [m.Mode.SPEED, m.Mode.TORQUE])
def test_a_dead_encoder_is_found_in_either_mode(mode: m.Mode) -> None:
    rig = WheelRig()
    rig.encoder_dead[2] = True
    rig.activate(mode)
    for sequence in range(1, 60):
        rig.command(10.0, sequence) if mode is m.Mode.SPEED else rig.torque(2.0, sequence)
        rig.run(5)
    assert (rig.state, fault(rig)) == (m.State.FAULT, (m.Fault.ENCODER_STUCK, m.FaultWheel.RR))


@pytest.mark.proves("R-FAULT-8", "R-FAULT-9")
@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize("speed_rad_s", [5.0, -5.0])
def test_a_wheel_wired_the_wrong_way_round_is_found(wheel: int, speed_rad_s: float) -> None:
    rig = WheelRig()
    rig.encoder_sign[wheel] = -1
    rig.activate()
    rig.drive(speed_rad_s, 300)
    assert (rig.state, fault(rig)) == (m.State.FAULT, (m.Fault.WRONG_DIRECTION, m.FaultWheel(wheel + 1)))
    assert max(map(abs, rig.speed_rad_s)) < 30.0


@pytest.mark.proves("R-FAULT-8")
@pytest.mark.parametrize("end", ["estop", "silence", "request"])
@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize("torque_n_m", [1.0, -1.0])
def test_a_stop_of_torque_mode_does_not_drive_a_wheel_whose_encoder_is_mirrored(
    torque_n_m: float, wheel: int, end: str
) -> None:
    """Torques show no mirrored encoder; the speed loop that stops would drive its wheel ever faster."""
    rig = WheelRig()
    rig.encoder_sign[wheel] = -1
    rig.activate(m.Mode.TORQUE)
    for sequence in range(1, 60):
        rig.torque(torque_n_m, sequence)
        rig.run(5)
    if end == "estop":
        rig.send(m.Estop(0, 0))
    elif end == "request":
        rig.heartbeat(m.Request.IDLE, 0x99)
    ticks = 0
    while rig.enabled:
        rig.run(1)
        ticks += 1
    assert fault(rig) == (m.Fault.WRONG_DIRECTION, m.FaultWheel(wheel + 1))
    assert ticks < (51 if end == "silence" else 1) + 200 + 150
    assert max(map(abs, rig.speed_rad_s)) < 45.0


@pytest.mark.proves("R-FAULT-11")
@pytest.mark.parametrize("end", ["estop", "silence"])
def test_a_robot_that_a_slope_drives_on_keeps_its_brakes(end: str) -> None:
    """All four wheels gain speed against their torque, and say so together: no encoder is wrong."""
    rig, _ = driving(5.0, overspeed_rad_s=120.0)
    if end == "estop":
        rig.send(m.Estop(0, 0))
    for _ in range(600):
        rig.run(1)
        rig.held = [True] * 4
        rig.speed_rad_s = [v + 0.05 for v in rig.speed_rad_s]
    assert min(rig.speed_rad_s) > 30.0
    assert rig.enabled
    assert fault(rig) == (m.Fault.NONE, m.FaultWheel.NONE)


@pytest.mark.proves("R-FAULT-7")
@pytest.mark.parametrize("period_s", [0.02, 0.1, 1.0])
def test_the_time_until_an_encoder_fault_is_a_parameter(period_s: float) -> None:
    rig, sequence = driving(encoder_fault_s=period_s, speed_kp_n_m_s_rad=0.2, speed_ki_n_m_rad=0.0)
    rig.held = [False, False, False, True]
    rig.speed_rad_s[3] = 0.0
    ticks = 0
    while rig.state is m.State.ACTIVE:
        sequence = rig.drive(10.0, 5, sequence)
        ticks += 5
        assert ticks < 2000
    assert 1000 * period_s <= ticks <= 1000 * period_s + 60, "the filter takes some time to stand still"
    assert fault(rig) == (m.Fault.ENCODER_STUCK, m.FaultWheel.RL)


@pytest.mark.proves("R-FAULT-10")
def test_the_first_fault_is_kept_and_clearing_forgets_it() -> None:
    rig, _ = driving()
    rig.temperature_degc[1] = 130.0
    rig.run(1)
    rig.current_a[0] = math.nan
    rig.run(10)
    assert fault(rig) == (m.Fault.OVERTEMPERATURE, m.FaultWheel.FR)
    told = [x for x in rig.heard() if isinstance(x, m.Status)][-1]
    assert (told.fault, told.fault_wheel) == (m.Fault.OVERTEMPERATURE, m.FaultWheel.FR)
    rig.temperature_degc[1], rig.current_a[0] = 25.0, 0.0
    rig.run(1)
    rig.heartbeat(m.Request.CLEAR, 0x99)
    assert (rig.state, fault(rig)) == (m.State.IDLE, (m.Fault.NONE, m.FaultWheel.NONE))
    rig.activate()
    rig.drive(5.0, 500)
    assert rig.state is m.State.ACTIVE


@pytest.mark.proves("R-STATE-12")
@pytest.mark.parametrize("cause", ["temperature", "current", "sensor"])
def test_a_cause_that_lasts_is_a_fault_again_after_clearing(cause: str) -> None:
    rig = WheelRig()
    rig.temperature_degc[0] = 130.0 if cause == "temperature" else 25.0
    rig.current_a[0] = {"temperature": 0.0, "current": 31.0, "sensor": math.nan}[cause]
    rig.run(10)
    assert rig.state is m.State.FAULT
    rig.heartbeat(m.Request.CLEAR, 0x99)
    rig.run(1)
    assert rig.state is m.State.FAULT


@pytest.mark.proves("R-STATE-12")
def test_a_robot_that_is_cleared_and_armed_within_a_tick_gives_no_duty_without_its_sensors() -> None:
    """It drives for that tick, by its encoders; the duty from a current of NaN would be NaN."""
    rig = WheelRig()
    rig.current_a[0] = math.nan
    rig.run(10)
    rig.heartbeat(m.Request.CLEAR, 0x99)
    rig.activate()
    assert rig.state is m.State.ACTIVE
    rig.run(1)
    assert rig.duty == [0.0] * 4
    assert rig.state is m.State.FAULT


@pytest.mark.proves("R-STATE-7", "R-GEN-5")
def test_a_fault_while_an_estop_brakes_switches_off_and_stays_an_estop() -> None:
    rig, _ = driving()
    rig.send(m.Estop(0, 0))
    rig.run(5)
    assert rig.enabled
    rig.temperature_degc[0] = 130.0
    rig.run(2)
    assert (rig.state, rig.enabled, rig.torque_n_m) == (m.State.ESTOP, False, [0.0] * 4)


@pytest.mark.proves("R-STATE-7")
def test_an_estop_gives_up_on_wheels_that_do_not_stop() -> None:
    rig, _ = driving()
    rig.held = [True] * 4  # towed
    rig.send(m.Estop(0, 0))
    rig.run(1000)
    assert rig.enabled
    rig.run(1)
    assert not rig.enabled


@pytest.mark.proves("R-STATE-5")
def test_a_stop_gives_up_on_wheels_that_do_not_stop() -> None:
    rig, _ = driving()
    rig.held = [True] * 4
    rig.run(50 + 200 + 1000 - 1 - 5)
    assert (rig.state, rig.enabled) == (m.State.STOPPING, True)
    rig.run(10)
    assert (rig.state, rig.enabled) == (m.State.IDLE, False)


class Stand(WheelRig):
    """A rig whose four wheels are commanded one by one."""

    def __init__(self, mode: m.Mode, **parameters: float) -> None:
        super().__init__(**parameters)
        self.activate(mode)
        self.mode = mode
        self.sequence = 0

    def follow(self, values: tuple[float, ...], ticks: int) -> None:
        kind = m.WheelCommand if self.mode is m.Mode.SPEED else m.TorqueCommand
        for n in range(ticks):
            if n % 5 == 0:
                self.sequence += 1
                self.send(kind(*values, self.sequence & 0xFF, self.nonce & 0xF))
            self.run(1)

    def assert_no_fault(self) -> None:
        assert (self.state, fault(self)) == (m.State.ACTIVE, (m.Fault.NONE, m.FaultWheel.NONE))


@pytest.mark.proves("R-FAULT-11")
def test_all_wheels_blocked_is_no_encoder_fault() -> None:
    stand = Stand(m.Mode.SPEED)
    stand.held = [True] * 4
    stand.follow((20.0,) * 4, 1000)
    stand.assert_no_fault()


@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize(("mode", "value"), [(m.Mode.SPEED, 20.0), (m.Mode.TORQUE, 1.0)])
def test_one_wheel_jogged_on_a_stand_is_no_fault(wheel: int, mode: m.Mode, value: float) -> None:
    """The three others stand still as they should, and say nothing of the one that turns."""
    stand = Stand(mode)
    stand.follow(tuple(value if i == wheel else 0.0 for i in range(4)), 500)
    stand.follow(tuple(-value if i == wheel else 0.0 for i in range(4)), 500)
    stand.assert_no_fault()


_SPEED = st.floats(-60.0, 60.0).map(lambda v: round(v * 64) / 64)
_TORQUE = st.floats(-8.0, 8.0).map(lambda v: round(v * 256) / 256)


def moves(value: st.SearchStrategy[float]) -> st.SearchStrategy[list[tuple[tuple[float, ...], int]]]:
    """Set points that jump at any instant, each wheel by itself, for 20 to 400 ms."""
    four = st.tuples(value, value, value, value)
    same = value.map(lambda v: (v, v, v, v))
    return st.lists(st.tuples(four | same, st.integers(20, 400)), min_size=1, max_size=12)


@pytest.mark.proves("R-FAULT-11")
@share_of_examples(0.6)
@given(
    profile=moves(_SPEED | st.sampled_from([0.0, 2.1, -2.1, 60.0, -60.0])),
    limit_n_m=st.sampled_from([0.5, 5.0, 15.0]),
)
@example(profile=[((39.0, -36.0, 0.0, -60.0), 275), ((-2.1, 0.0, 0.0, -60.0), 134)], limit_n_m=0.5)
@example(profile=[((0.0, 0.0, -3.0, -4.0), 265), ((-2.0,) * 4, 32), ((0.0, 1.0, 1.0, 0.0), 100)], limit_n_m=0.5)
def test_no_false_alarm_whatever_speeds_are_commanded(
    profile: list[tuple[tuple[float, ...], int]], limit_n_m: float
) -> None:
    """Wheels on ice, each by itself: braking, reversing, jumps at the torque limit. None is an encoder fault."""
    stand = Stand(m.Mode.SPEED, torque_limit_n_m=limit_n_m)
    for values, ticks in profile:
        stand.follow(values, ticks)
    stand.assert_no_fault()


@pytest.mark.proves("R-FAULT-11")
@share_of_examples(0.6)
@given(profile=moves(_TORQUE))
def test_no_false_alarm_whatever_torques_are_commanded(profile: list[tuple[tuple[float, ...], int]]) -> None:
    stand = Stand(m.Mode.TORQUE)
    for values, ticks in profile:
        stand.follow(values, ticks)
        if max(map(abs, stand.speed_rad_s)) > 0.8 * PARAMETERS["overspeed_rad_s"]:
            break
    assert fault(stand)[0] in (m.Fault.NONE, m.Fault.OVERSPEED)
