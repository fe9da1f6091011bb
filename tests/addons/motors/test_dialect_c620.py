"""RoboMaster C620: worked frames, the driver with its emulated device, and how each handles bad input."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.options import build
from hil.core.types import CommandMode, FourWheels
from hil.robot.driver_registry import dialect
from tests.support.dialect_testbed import STILL, Rig, assert_near, assert_position_follows, assert_told, ramp_to

FORWARD = (8.0, 8.0, 8.0, 8.0)


def test_currents_of_both_halves_of_the_bus_are_big_endian_in_the_order_of_the_ids() -> None:
    """One ampere of a C620 is 819.2 counts; motors 1 to 4 are in 0x200, 5 to 8 in 0x1FF."""
    rig = Rig("c620", {"ids": [2, 5, 1, 8]}, mode=CommandMode.TORQUE)
    one_a = rig.facts.torque_constant_n_m_a
    frames = rig.driver.command(STILL, (one_a, -one_a, 2 * one_a, 0.0), 0)
    assert frames == [
        Frame(0x200, struct.pack(">4h", 1638, 819, 0, 0)),
        Frame(0x1FF, struct.pack(">4h", -819, 0, 0, 0)),
    ]


def test_a_worked_feedback_frame_is_read() -> None:
    """A quarter of a turn of the rotor, 1000 rpm, -1 A, 40 degrees: 0x201 # 0800 03E8 FCCD 28 00."""
    rig = Rig("c620")
    for number in (1, 2, 3, 4):
        rig.driver.feed(Frame(0x200 + number, bytes.fromhex("080003E8FCCD2800")), 7)
    sample = rig.driver.sample
    assert sample is not None
    assert sample.stamp_ns == 7
    assert_near(sample.speed_rad_s, (1000 * 2 * 3.141592653589793 / 60 / (3591 / 187),) * 4, 1e-9)
    assert_near(sample.current_a, (-1.0,) * 4, 1e-3)
    assert sample.temperature_degc == (40.0,) * 4


@pytest.mark.parametrize("settings", [{}, {"ids": [8, 1, 6, 3]}, {"controller": "c610"}])
def test_wheels_reach_their_speeds_and_the_position_follows(settings: dict[str, object]) -> None:
    rig = Rig("c620", settings)
    rig.step()
    rig.greet()
    rig.arm()
    rig.drive(2.0, ramp_to(FORWARD))
    assert_told(rig, FORWARD, 0.2)
    assert_position_follows(rig, FORWARD, 0.05)


def test_a_silent_motor_makes_the_whole_sample_old() -> None:
    rig = Rig("c620")
    rig.step()
    for number in (1, 2, 3):
        rig.driver.feed(Frame(0x200 + number, bytes(8)), rig.now_ns + 1_000_000_000)
    assert rig.driver.sample is not None
    assert rig.driver.sample.stamp_ns == rig.now_ns


def test_motors_that_were_not_heard_are_named() -> None:
    rig = Rig("c620", {"ids": [1, 2, 3, 7]}, emulated_settings={"ids": [1, 2, 3, 4]})
    rig.step()
    assert rig.driver.identity is None
    assert rig.driver.missing.startswith("no feedback of the motors 7;")


def test_what_a_controller_may_do_when_commands_end_is_warned_of() -> None:
    assert Rig("c620", {"controller": "c610"}).driver.warnings == (
        "it is not known what a C610 does when commands end: keep an e-stop that cuts the motors' power within reach",
        "a stopped C610 lets its wheel coast and does not brake it",
    )


def test_a_hot_motor_is_an_error_by_its_wheel() -> None:
    rig = Rig("c620")
    rig.step()
    rig.driver.feed(Frame(0x202, bytes(6) + b"\x7d\0"), 1)
    [error] = rig.driver.errors
    assert error.startswith("motor 2 of wheel fr has 125 °C")


def test_disarming_gives_every_motor_no_current() -> None:
    rig = Rig("c620")
    rig.step()
    rig.arm()
    rig.drive(0.5, ramp_to(FORWARD))
    rig.step(rig.driver.disarm())
    assert not rig.driver.is_armed
    assert rig.node.torque_n_m == STILL


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_frame_is_too_strange(number: int, payload: bytes) -> None:
    driver = RIG.driver
    driver.feed(Frame(number, payload), 0)
    assert driver.sample is None or all(abs(speed) < 200 for speed in driver.sample.speed_rad_s)


RIG = Rig("c620")


@pytest.mark.parametrize("ids", [[1, 2, 3], [1, 2, 3, 3], [0, 1, 2, 3], [1, 2, 3, 9]])
def test_ids_that_cannot_be_are_refused(ids: list[int]) -> None:
    with pytest.raises(BadInputError, match="expected four different ones, each 1 to 8"):
        build(dialect("c620").settings, {"ids": ids}, "device.motors")


def test_a_probe_finds_the_ids_from_what_the_motors_say() -> None:
    rig = Rig("c620", {"ids": [4, 6, 7, 8]})
    rig.step(ticks=2)
    made = dialect("c620").probe
    assert made is not None
    probe = made()
    assert probe.ask() == ()
    for frame in rig.heard:
        probe.feed(frame)
    found = probe.found()
    assert found is not None
    assert found.motors == {"ids": [4, 6, 7, 8]}


@pytest.mark.parametrize(("period_ms", "rpm"), [(10, 3667), (5, 8250), (20, -5000)])
def test_frames_that_are_read_at_once_are_a_millisecond_apart(period_ms: int, rpm: int) -> None:
    """As a loop of 50 to 200 Hz reads a bus whose frames have no stamps of their own."""
    driver = Rig("c620").driver
    first: FourWheels | None = None
    for tick in range(1, 401):
        turns = rpm / 60_000 * tick
        payload = struct.pack(">HhhBx", round(turns * 8192) % 8192, rpm, 0, 20)
        stamp_ns = -(-tick // period_ms) * period_ms * 1_000_000
        for number in (1, 2, 3, 4):
            driver.feed(Frame(0x200 + number, payload), stamp_ns)
        if tick % period_ms == 0:
            assert driver.sample is not None
            first = first or driver.sample.position_rad
    assert driver.sample is not None
    assert first is not None
    turned = [now - then for then, now in zip(first, driver.sample.position_rad, strict=True)]
    expected = rpm / 60_000 * (400 - period_ms) * 2 * 3.141592653589793 / (3591 / 187)
    assert_near(turned, (expected,) * 4, 0.01)


def test_no_loop_is_closed_on_a_speed_of_long_ago_and_a_stall_winds_nothing_up() -> None:
    rig = Rig("c620")
    rig.step()
    rig.arm()
    rig.drive(1.0, ramp_to(FORWARD))
    rig.now_ns += 200_000_000
    [frame] = rig.driver.command(STILL, STILL, rig.now_ns)
    assert frame.payload == bytes(8)


@given(*[st.floats(-3.0, 3.0)] * 3, st.floats(0.1, 1.0))
def test_what_turns_the_robot_gets_its_share_of_the_gain(
    forward: float, left: float, turn: float, share: float
) -> None:
    """From rest: FL, FR, RR and RL turn as forward - left - turn and so on; ids and wheels are in the same order."""
    rig = Rig("c620", turning_share=share)
    rig.step()
    rig.arm()
    signs = ((1, -1, -1), (1, 1, 1), (1, -1, 1), (1, 1, -1))
    targets = [a * forward + b * left + c * turn for a, b, c in signs]
    expected = [0.4 * (a * forward + b * left + share * c * turn) for a, b, c in signs]
    fl, fr, rr, rl = targets
    [frame] = rig.driver.command((fl, fr, rr, rl), STILL, rig.now_ns)
    limit = rig.facts.torque_limit_n_m
    counts = [min(max(t, -limit), limit) / rig.facts.torque_constant_n_m_a * 16384 / 20.0 for t in expected]
    assert struct.unpack(">4h", frame.payload) == pytest.approx(counts, abs=0.51)


def test_a_wheel_on_blocks_is_by_itself() -> None:
    """No robot moves so, and the loop of its opposite is not told of it."""
    rig = Rig("c620", turning_share=0.2)
    rig.step()
    rig.arm()
    [frame] = rig.driver.command((1.0, 0.0, 0.0, 0.0), STILL, rig.now_ns)
    assert struct.unpack(">4h", frame.payload) == (round(0.4 / rig.facts.torque_constant_n_m_a * 16384 / 20.0), 0, 0, 0)


SPEEDS = (0.5, -0.75, 1.0, -1.25)


def commanded(rig: Rig, at_ms: int, speeds: FourWheels, torques: FourWheels = STILL) -> list[float]:
    """Hear that all rotors stand still, then return the torques [N·m] of a command."""
    for number in (1, 2, 3, 4):
        rig.driver.feed(Frame(0x200 + number, bytes(8)), at_ms * 1_000_000)
    [frame] = rig.driver.command(speeds, torques, at_ms * 1_000_000)
    n_m = rig.facts.torque_constant_n_m_a * 20.0 / 16384
    return [count * n_m for count in struct.unpack(">4h", frame.payload)]


def test_the_loop_adds_up_the_error_over_the_time_between_commands_of_at_most_two_periods() -> None:
    """With a period of 5 ms; the first command counts as one period, and acts before its own error is added."""
    rig = Rig("c620", {"kp_n_m_s_rad": 0.5, "ki_n_m_rad": 20.0})
    commanded(rig, 1, STILL)
    rig.driver.arm(0)
    ahead = (0.1, 0.2, -0.3, 0.4)
    added_s = 0.0
    for at_ms, dt_s in ((2, 0.005), (5, 0.003), (15, 0.010), (26, 0.010), (27, 0.001)):
        expected = [torque + (0.5 + 20.0 * added_s) * speed for torque, speed in zip(ahead, SPEEDS, strict=True)]
        assert_near(commanded(rig, at_ms, SPEEDS, ahead), expected, 0.001)
        added_s += dt_s
    rig.driver.arm(0)
    assert_near(commanded(rig, 28, SPEEDS), [0.5 * speed for speed in SPEEDS], 0.001)


def test_at_the_limit_the_loop_adds_nothing_up_but_what_leads_away_from_it() -> None:
    rig = Rig("c620", {"kp_n_m_s_rad": 0.5, "ki_n_m_rad": 20.0})
    commanded(rig, 1, STILL)
    rig.driver.arm(0)
    limit = rig.facts.torque_limit_n_m
    commanded(rig, 2, SPEEDS, STILL)
    held = [20.0 * speed * 0.005 for speed in SPEEDS]
    beyond = tuple(2.0 * limit if speed > 0.0 else -2.0 * limit for speed in SPEEDS)
    full = [limit if speed > 0.0 else -limit for speed in SPEEDS]
    assert_near(commanded(rig, 7, SPEEDS, beyond), full, 0.001)
    assert_near(commanded(rig, 12, STILL), held, 0.001)
    back = tuple(-speed for speed in SPEEDS)
    assert_near(commanded(rig, 17, back, beyond), full, 0.001)
    assert_near(commanded(rig, 22, STILL), [0.0] * 4, 0.001)


def test_a_speed_counts_until_it_is_as_old_as_the_watchdog() -> None:
    rig = Rig("c620", {"kp_n_m_s_rad": 0.5, "ki_n_m_rad": 0.0})
    commanded(rig, 1, STILL)
    age_ns = round(rig.facts.watchdog_s * 1e9)
    for now_ns, share in ((1_000_000 + age_ns - 1, 0.5), (1_000_000 + age_ns, 0.0)):
        [frame] = rig.driver.command(SPEEDS, STILL, now_ns)
        n_m = rig.facts.torque_constant_n_m_a * 20.0 / 16384
        assert_near([count * n_m for count in struct.unpack(">4h", frame.payload)], [share * v for v in SPEEDS], 0.001)
