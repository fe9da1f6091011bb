"""The exact thresholds of supervision: just enough, and just too little, tick by tick.

The estimates are set from outside, so that a threshold is met to the last bit; everything else is the core's.
"""

import itertools
from typing import Any

import numpy as np
import pytest

from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import State
from tests.support.bare_node import BareNode

LIMIT_N_M = 5.0  # the torque limit of the rig
FAULT_TICKS = 100  # encoder_fault_s
STRONG_N_M = 1.01  # a fifth of the limit moves a wheel
WHEELS = pytest.mark.parametrize("wheel", range(4))
SIGNS = pytest.mark.parametrize("sign", [1.0, -1.0])
NO_FAULT = (m.Fault.NONE, m.FaultWheel.NONE)
# From 10 rad/s: 0.1 rad/s, and the estimate's own change, to the last bit of binary32.
JUST_NOT_LOST = 10.0 - float(
    np.float32(10.0) - np.float32(0.1) - np.float32(3.14159265) * np.float32(150.0) / np.float32(4096.0)
)


def active(mode: m.Mode = m.Mode.SPEED) -> BareNode:
    node = BareNode()
    node.activate(mode)
    return node


def supervise(node: BareNode, ticks: int, **values: Any) -> tuple[int, int]:
    """Let supervision look so often at these estimates; return the fault and its wheel."""
    for name, value in values.items():
        setattr(node.node, name, value)
    node.node.sense.battery_v = 24.0
    for _ in range(ticks):
        node.lib.wheel_node_supervise(node.node)
    return node.node.fault, node.node.fault_wheel


def still(wheel: int, by_others: float, own: float = 0.0) -> list[float]:
    """Speeds with this wheel at `own`, of which the three others say `by_others`: FL + FR = RR + RL."""
    fl_fr_rr_rl = [0.0] * 4
    partner, a, b = ((1, 2, 3), (0, 2, 3), (3, 0, 1), (2, 0, 1))[wheel]
    fl_fr_rr_rl[partner], fl_fr_rr_rl[a], fl_fr_rr_rl[b] = 16.0, 7.0, 9.0 + by_others
    fl_fr_rr_rl[wheel] = own
    return fl_fr_rr_rl


def only(wheel: int, value: float) -> list[float]:
    return [value if i == wheel else 0.0 for i in range(4)]


@pytest.mark.proves("R-FAULT-7", "R-FAULT-9")
@WHEELS
@SIGNS
@pytest.mark.parametrize(
    ("by_others", "own", "set_point", "torque", "found"),
    [
        (2.125, 0.1875, 2.125, STRONG_N_M, True),
        (2.0, 0.1875, 2.125, STRONG_N_M, False),
        (2.125, 0.2001, 2.125, STRONG_N_M, False),
        (2.125, 0.1999, 2.125, STRONG_N_M, True),
        (2.125, 0.2, 2.125, STRONG_N_M, False),
        (2.125, 0.1875, 2.125, 1.0, False),
        (2.125, 0.1875, 2.0, STRONG_N_M, False),
        (2.125, 0.1875, 2.125, 0.99, False),
        (-2.125, 0.1875, 2.125, STRONG_N_M, False),
        (2.125, -0.1999, 2.125, STRONG_N_M, True),
        (2.125, -0.2001, 2.125, STRONG_N_M, False),
    ],
)
def test_an_encoder_is_stuck_when_everything_says_that_its_wheel_turns(
    wheel: int, sign: float, by_others: float, own: float, set_point: float, torque: float, found: bool
) -> None:
    node = active()
    values = {
        "speed_rad_s": [sign * v for v in still(wheel, by_others, own)],
        "set_point_rad_s": only(wheel, sign * set_point),
        "torque_n_m": only(wheel, sign * torque),
    }
    assert supervise(node, FAULT_TICKS - 1, **values) == NO_FAULT
    expected = (m.Fault.ENCODER_STUCK, wheel + 1) if found else NO_FAULT
    assert supervise(node, 1) == expected
    assert supervise(node, 100) == expected


@pytest.mark.proves("R-FAULT-7")
def test_the_torque_that_counts_is_a_part_of_the_limit_in_force() -> None:
    """With hot windings the limit is less, and less torque is strong."""
    values = {"speed_rad_s": still(0, 3.0), "set_point_rad_s": only(0, 3.0), "torque_n_m": only(0, 0.5)}
    node = active()
    assert supervise(node, 200, **values) == NO_FAULT
    node.node.sense.temperature_degc = [118.5] * 4  # a tenth of 20 A is left, 2.5 N m
    assert node.lib.wheel_node_torque_limit(node.node) == pytest.approx(2.5)
    assert supervise(node, 200, torque_n_m=only(0, 0.49)) == NO_FAULT
    assert supervise(node, 200, torque_n_m=only(0, 0.51)) == (m.Fault.ENCODER_STUCK, 1)


def test_in_torque_mode_the_set_point_is_the_speed_and_says_nothing() -> None:
    values = {"speed_rad_s": still(2, 3.0), "set_point_rad_s": [0.0] * 4, "torque_n_m": only(2, STRONG_N_M)}
    assert supervise(active(m.Mode.TORQUE), FAULT_TICKS, **values) == (m.Fault.ENCODER_STUCK, 3)
    assert supervise(active(m.Mode.SPEED), FAULT_TICKS, **values) == NO_FAULT


@pytest.mark.proves("R-FAULT-7")
def test_a_wheel_that_turned_between_was_not_stuck() -> None:
    node = active()
    stuck = {"set_point_rad_s": only(1, 3.0), "torque_n_m": only(1, STRONG_N_M)}
    for _ in range(3):
        assert supervise(node, FAULT_TICKS - 1, speed_rad_s=still(1, 3.0), **stuck) == NO_FAULT
        assert supervise(node, 1, speed_rad_s=still(1, 3.0, own=0.25)) == NO_FAULT


@pytest.mark.proves("R-FAULT-7")
@WHEELS
@SIGNS
@pytest.mark.parametrize(("changed", "found"), [(0.0990, True), (0.1, True), (0.1010, False)])
def test_a_wheel_that_passes_slowly_through_zero_is_not_stuck(
    wheel: int, sign: float, changed: float, found: bool
) -> None:
    node = active()
    values = {"set_point_rad_s": only(wheel, sign * 3.0), "torque_n_m": only(wheel, sign * STRONG_N_M)}
    before, after = ([sign * v for v in still(wheel, 3.0, own)] for own in (-0.05, changed - 0.05))
    assert supervise(node, FAULT_TICKS - 1, speed_rad_s=before, **values) == NO_FAULT
    stuck = (m.Fault.ENCODER_STUCK, wheel + 1)
    assert supervise(node, 1, speed_rad_s=after) == (stuck if found else NO_FAULT)
    assert supervise(node, FAULT_TICKS - 2) == (stuck if found else NO_FAULT)
    assert supervise(node, 1) == stuck, "the time counts from the last change on"


def direction(wheel: int, sign: float, target: float, torque: float, speeds: list[float]) -> dict[str, Any]:
    """What supervision sees of a wheel that should turn at `target`, is driven so, and says its part of `speeds`."""
    return {
        "set_point_rad_s": only(wheel, sign * target),
        "torque_n_m": only(wheel, sign * torque),
        "speed_rad_s": [sign * v for v in speeds],
    }


@WHEELS
@SIGNS
@pytest.mark.proves("R-FAULT-7", "R-FAULT-8")
@pytest.mark.parametrize(
    ("by_others", "own", "torque", "found"),
    [
        (2.125, 0.0, 0.11, m.Fault.ENCODER_STUCK),
        (-2.125, 0.0, 0.11, m.Fault.NONE),
        (2.125, -2.0, 0.11, m.Fault.WRONG_DIRECTION),
        (2.125, -2.0, -0.11, m.Fault.NONE),
    ],
)
def test_of_a_weak_motor_the_sign_of_its_torque_counts_too(
    wheel: int, sign: float, by_others: float, own: float, torque: float, found: m.Fault
) -> None:
    node = BareNode(changes={"torque_limit_n_m": 0.5})
    node.activate()
    values = direction(wheel, sign, 3.0, torque, still(wheel, by_others, own))
    assert supervise(node, FAULT_TICKS, **values)[0] == found


@pytest.mark.proves("R-FAULT-8", "R-FAULT-9")
@WHEELS
@SIGNS
@pytest.mark.parametrize(
    ("gained", "target", "torque", "by_others", "found"),
    [
        (3.01, 2.125, STRONG_N_M, 1.0, True),
        (2.99, 2.125, STRONG_N_M, 1.0, False),
        (3.0, 2.125, STRONG_N_M, 1.0, False),
        (6.0, 0.0, STRONG_N_M, 0.7, False),
        (3.01, 2.0, STRONG_N_M, 1.0, False),
        (3.01, -2.125, STRONG_N_M, 1.0, False),
        (3.01, 2.125, 0.99, 1.0, False),
        (3.01, 2.125, -STRONG_N_M, 1.0, False),
        (3.01, 0.0, STRONG_N_M, 0.68, True),
        (3.01, 0.0, STRONG_N_M, 0.72, False),
        (3.01, -2.125, STRONG_N_M, 0.0, True),
        (3.01, -2.125, STRONG_N_M, 1.32, True),
        (3.01, -2.125, STRONG_N_M, 1.28, False),
        (2.99, 0.0, STRONG_N_M, 0.0, False),
        (3.01, 0.0, -STRONG_N_M, 0.0, False),
    ],
)
def test_a_wheel_runs_away_against_its_torque_its_set_point_or_the_other_wheels(
    wheel: int, sign: float, gained: float, target: float, torque: float, by_others: float, found: bool
) -> None:
    """`by_others` is the part of its speed that the three others tell."""
    node = active()

    def turning(own: float, torque: float = torque) -> dict[str, Any]:
        return direction(wheel, sign, target, torque, still(wheel, by_others * own, own))

    assert supervise(node, 1, **turning(-5.0, torque=0.0)) == NO_FAULT
    assert supervise(node, 200, **turning(-5.0)) == NO_FAULT, "as fast as before is no gain"
    assert supervise(node, 200, **turning(-4.0)) == NO_FAULT, "braking"
    assert supervise(node, FAULT_TICKS - 1, **turning(-4.0 - gained)) == NO_FAULT
    expected = (m.Fault.WRONG_DIRECTION, wheel + 1) if found else NO_FAULT
    assert supervise(node, 1) == expected
    assert supervise(node, 200) == expected


@pytest.mark.proves("R-FAULT-8")
@WHEELS
@SIGNS
@pytest.mark.parametrize("lapse", ["torque", "mode"])
def test_a_gain_counts_from_where_the_wheel_was_last_not_driven_against(wheel: int, sign: float, lapse: str) -> None:
    """From 1 rad/s, and after a lapse of one tick from 6 rad/s: 8 rad/s is then no gain of 3, and 9.5 rad/s is."""
    node = active()
    assert supervise(node, 90, **direction(wheel, sign, 3.0, STRONG_N_M, only(wheel, -1.0))) == NO_FAULT
    torque = -STRONG_N_M if lapse == "torque" else STRONG_N_M
    node.node.mode = m.Mode.TORQUE if lapse == "mode" else m.Mode.SPEED
    assert supervise(node, 1, **direction(wheel, sign, 3.0, torque, only(wheel, -6.0))) == NO_FAULT
    node.node.mode = m.Mode.SPEED
    assert supervise(node, 300, **direction(wheel, sign, 3.0, STRONG_N_M, only(wheel, -8.0))) == NO_FAULT
    away = direction(wheel, sign, 3.0, STRONG_N_M, only(wheel, -9.5))
    assert supervise(node, FAULT_TICKS - 1, **away) == NO_FAULT
    assert supervise(node, 1) == (m.Fault.WRONG_DIRECTION, wheel + 1)


@pytest.mark.proves("R-FAULT-8")
@WHEELS
@SIGNS
@pytest.mark.parametrize(
    ("by_others", "own", "target", "torque", "found"),
    [
        (2.125, -2.125, 0.5, STRONG_N_M, True),
        (2.0, -2.0, 0.5, STRONG_N_M, False),
        (10.0, -7.0625, 0.5, STRONG_N_M, True),
        (10.0, -6.9375, 0.5, STRONG_N_M, False),
        (10.0, -7.0, 0.5, STRONG_N_M, False),
        (10.0, -12.9375, 0.5, STRONG_N_M, True),
        (10.0, -13.0625, 0.5, STRONG_N_M, False),
        (10.0, 10.0, 0.5, STRONG_N_M, False),
        (10.0, -10.0, 0.0, STRONG_N_M, True),
        (10.0, -10.0, -9.0, STRONG_N_M, True),
        (10.0, -10.0, 0.5, 0.99, False),
        (10.0, -10.0, 0.5, -STRONG_N_M, False),
    ],
)
def test_an_encoder_is_mirrored_when_its_torque_and_the_others_contradict_it(
    wheel: int, sign: float, by_others: float, own: float, target: float, torque: float, found: bool
) -> None:
    node = active()
    assert supervise(node, 1, **direction(wheel, sign, target, 0.0, still(wheel, by_others, own))) == NO_FAULT
    seen = direction(wheel, sign, target, torque, still(wheel, by_others, own))
    assert supervise(node, FAULT_TICKS - 1, **seen) == NO_FAULT
    expected = (m.Fault.WRONG_DIRECTION, wheel + 1) if found else NO_FAULT
    assert supervise(node, 1) == expected
    assert supervise(node, 200) == expected


@pytest.mark.proves("R-FAULT-8", "R-FAULT-11")
@WHEELS
@SIGNS
@pytest.mark.parametrize(("lost", "found"), [(0.1875, True), (JUST_NOT_LOST, True), (0.21875, False)])
def test_a_wheel_that_loses_speed_brakes_and_is_not_mirrored(wheel: int, sign: float, lost: float, found: bool) -> None:
    node = active()
    fault = (m.Fault.WRONG_DIRECTION, wheel + 1)
    half = FAULT_TICKS // 2
    fast, slow = (direction(wheel, sign, 0.5, STRONG_N_M, still(wheel, 10.0, own)) for own in (-10.0, -10.0 + lost))
    supervise(node, 1, **direction(wheel, sign, 0.5, 0.0, still(wheel, 10.0, -10.0)))
    assert supervise(node, half, **fast) == NO_FAULT
    assert supervise(node, half, **slow) == (fault if found else NO_FAULT)
    assert supervise(node, half, **fast) == fault, "the time counts from the last loss on"


def test_a_coarse_encoder_moves_the_estimate_and_a_loss_within_that_is_no_braking() -> None:
    node = BareNode(changes={"counts_per_revolution": 1024.0})
    node.activate()
    supervise(node, 1, **direction(0, 1.0, 0.5, 0.0, still(0, 10.0, -10.0)))
    for own, ticks in ((-10.0, 50), (-9.45, 49)):  # 0.1 rad/s, and pi 150 / 1024
        assert supervise(node, ticks, **direction(0, 1.0, 0.5, STRONG_N_M, still(0, 10.0, own))) == NO_FAULT
    assert supervise(node, 1) == (m.Fault.WRONG_DIRECTION, 1)


def test_a_wheel_that_runs_away_is_found_though_its_estimate_trembles() -> None:
    node = active()
    supervise(node, 1, **direction(0, 1.0, 5.0, STRONG_N_M, only(0, -1.0)))
    for n in range(FAULT_TICKS - 1):
        seen = direction(0, 1.0, 5.0, STRONG_N_M, only(0, -9.0 - n % 2))
        assert supervise(node, 1, **seen) == NO_FAULT
    assert supervise(node, 1) == (m.Fault.WRONG_DIRECTION, 1)


@WHEELS
def test_a_wheel_that_was_right_for_one_tick_is_not_mirrored(wheel: int) -> None:
    node = active()
    wrong = direction(wheel, 1.0, 5.0, STRONG_N_M, still(wheel, 5.0, -5.0))
    right = direction(wheel, 1.0, 5.0, STRONG_N_M, still(wheel, 5.0, 5.0))
    for _ in range(5):
        assert supervise(node, FAULT_TICKS - 1, **wrong) == NO_FAULT
        assert supervise(node, 1, **right) == NO_FAULT


@pytest.mark.proves("R-FAULT-8")
@WHEELS
@SIGNS
def test_direction_is_watched_under_the_speed_loop_and_in_the_stop_of_either_mode(wheel: int, sign: float) -> None:
    """In torque mode others may drag a wheel against its torque."""
    cases = {
        "mirrored": direction(wheel, sign, 5.0, STRONG_N_M, still(wheel, 5.0, -5.0)),
        "runs away": direction(wheel, sign, 5.0, STRONG_N_M, only(wheel, -9.0)),
    }
    for name, seen in cases.items():
        for mode, stopping in itertools.product(m.Mode, (False, True)):
            node = active(mode)
            if stopping:
                node.heartbeat(m.Request.IDLE, 0x99)
            supervise(node, 1, **direction(wheel, sign, 5.0, STRONG_N_M, only(wheel, -1.0)))
            found = supervise(node, 3 * FAULT_TICKS, **seen)
            expected = (m.Fault.WRONG_DIRECTION, wheel + 1) if mode is m.Mode.SPEED or stopping else NO_FAULT
            assert found == expected, name


@pytest.mark.proves("R-STATE-5")
@WHEELS
@SIGNS
def test_a_wheel_rests_below_a_fifth_of_a_rad_s_for_fifty_ticks(wheel: int, sign: float) -> None:
    node = active()
    node.heartbeat(m.Request.IDLE, 0x99)
    node.node.state_ticks = 200
    for turning in (0.2001, 0.2):
        supervise(node, 300, speed_rad_s=only(wheel, sign * turning))
        assert node.state is State.STOPPING
    supervise(node, 49, speed_rad_s=only(wheel, sign * 0.1999))
    assert node.state is State.STOPPING
    supervise(node, 1, speed_rad_s=only(wheel, sign * 0.2001))
    supervise(node, 49, speed_rad_s=only(wheel, sign * 0.1999))
    assert node.state is State.STOPPING
    supervise(node, 1)
    assert node.state is State.IDLE


@pytest.mark.proves("R-STATE-5")
def test_a_stop_is_over_after_the_ramp_and_a_second_later_at_the_latest() -> None:
    for ticks, rests, expected in (
        (199, True, State.STOPPING),
        (200, True, State.IDLE),
        (1199, False, State.STOPPING),
        (1200, False, State.IDLE),
    ):
        node = active()
        node.heartbeat(m.Request.IDLE, 0x99)
        node.node.rest_ticks = 100 if rests else 0
        supervise(node, 1, state_ticks=ticks, speed_rad_s=[0.0 if rests else 5.0] * 4)
        assert node.state is expected, ticks


@pytest.mark.proves("R-STATE-7")
def test_an_estop_brakes_for_a_second_at_the_latest() -> None:
    node = active()
    node.send(m.Estop(0, 0))
    node.node.speed_rad_s = [5.0] * 4
    for ticks, expected in ((998, 1), (999, 1), (1000, 0)):
        node.node.state_ticks = ticks
        node.lib.wheel_node_drive(node.node, node.drive)
        assert node.drive.enabled == expected


def test_encoders_are_watched_while_an_estop_brakes_and_not_when_it_is_over() -> None:
    for braking in (True, False):
        node = active()
        node.send(m.Estop(0, 0))
        node.node.braking = braking
        supervise(node, FAULT_TICKS, **direction(3, 1.0, 5.0, STRONG_N_M, still(3, 5.0, -5.0)))
        assert node.node.fault == (m.Fault.WRONG_DIRECTION if braking else m.Fault.NONE)


@pytest.mark.proves("R-FAULT-2", "R-FAULT-4")
@WHEELS
@SIGNS
def test_overspeed_and_overcurrent_begin_beyond_their_limits(wheel: int, sign: float) -> None:
    node = active()
    assert supervise(node, 10, speed_rad_s=only(wheel, sign * 100.0)) == NO_FAULT
    assert supervise(node, 1, speed_rad_s=only(wheel, sign * 100.01)) == (m.Fault.OVERSPEED, wheel + 1)
    node = active()
    node.node.sense.current_a = only(wheel, sign * 30.0)
    assert supervise(node, 10) == NO_FAULT
    node.node.sense.current_a = only(wheel, sign * 30.01)
    assert supervise(node, 4) == NO_FAULT
    assert supervise(node, 1) == (m.Fault.OVERCURRENT, wheel + 1)


@pytest.mark.proves("R-FAULT-5", "R-FAULT-9")
@WHEELS
def test_the_hottest_wheel_is_named(wheel: int) -> None:
    node = active()
    for others in (119.0, 119.9):
        node.node.sense.temperature_degc = [120.0 if i == wheel else others for i in range(4)]
        assert supervise(node, 1) == (m.Fault.OVERTEMPERATURE, wheel + 1)
        node = active()
    node.node.sense.temperature_degc = [120.0 if i >= wheel else 25.0 for i in range(4)]
    assert supervise(node, 1) == (m.Fault.OVERTEMPERATURE, wheel + 1), "of several the first"


@pytest.mark.proves("R-FAULT-1")
def test_what_is_just_plausible_is_taken() -> None:
    node = active()
    sense = node.node.sense
    sense.gyro_rad_s, sense.acceleration_m_s2, sense.battery_a = [1e6] * 3, [-1e6] * 3, 1e6
    assert supervise(node, 1) == NO_FAULT
    sense.gyro_rad_s[1] = 1000001.0
    assert supervise(node, 1) == (m.Fault.SENSOR, 0)


@pytest.mark.proves("R-FAULT-1")
@WHEELS
def test_a_winding_colder_than_any_robot_is_a_sensor_without_its_wire(wheel: int) -> None:
    """It would not tell any heat, and the current limit with it."""
    node = active()
    node.node.sense.temperature_degc[wheel] = -45.0
    assert supervise(node, 1) == NO_FAULT
    node.node.sense.temperature_degc[wheel] = -45.01
    assert supervise(node, 1) == (m.Fault.SENSOR, 0)


@pytest.mark.parametrize("bandwidth_rad_s", [50.0, 150.0, 500.0])
@pytest.mark.parametrize("counts", [4.0, 4096.0, 32768.0])
@SIGNS
def test_no_counts_drive_an_estimate_beyond_all_measure(counts: float, bandwidth_rad_s: float, sign: float) -> None:
    """An encoder that always says what drives the filter on, as no wheel turns."""
    node = BareNode(changes={"tracking_bandwidth_rad_s": bandwidth_rad_s, "counts_per_revolution": counts})
    tracker = node.node.tracker[0]
    for _ in range(2000):
        ahead = int(tracker.fraction + tracker.rate_counts_s * 1e-3 + sign * 0x7F00)
        node.sense.count[0] = (tracker.whole + ahead) & 0xFFFF
        node.lib.wheel_node_sense(node.node, node.sense)
    assert node.node.speed_rad_s[0] == pytest.approx(sign * 256.0)
    assert (node.node.fault, node.node.fault_wheel) == (m.Fault.OVERSPEED, 1)
    node.tick(3000)
    assert abs(node.node.speed_rad_s[0]) < 1.0, "and from there it finds back"
