"""Parts of the host, each alone: limits, brake, wiring, clocks, latency, reports."""

import itertools
import math

import pytest

from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError
from hil.core.guard import Brake, Guard
from hil.core.kinematics import BodyTwist, body_twist, to_body, to_world, wheel_speeds, wrap_angle
from hil.core.types import ZERO_WHEELS, CommandMode, Twist, WheelCommand, Wheels
from hil.core.wheel_map import ImuMount, WheelMap, Wiring
from hil.robot.link_times import ClockSync, CommandLatency, PollAge, RoundTrip
from hil.robot.robot_report import ProcessorFault, RobotReport
from hil.robot.snapshot import Feedback

MS = 1_000_000
SPEED, TORQUE = CommandMode.SPEED, CommandMode.TORQUE
SOME, STILL = Wheels(1.0, -2.0, 3.0, -4.0), (ZERO_WHEELS, ZERO_WHEELS)


def near(found: tuple[float, ...], expected: tuple[float, ...]) -> None:
    assert tuple(found) == pytest.approx(tuple(expected), rel=1e-9, abs=1e-12)


# Limits, brake, wiring


@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_guard_scales_all_wheels_by_one_factor_from_its_limit_on(place: int, sign: float) -> None:
    guard = Guard(10.0, 4.0)
    for limit, size, is_scaled in ((10.0, 10.0, False), (10.0, 12.5, True)):
        speed = Wheels(*(sign * size if wheel == place else 1.0 for wheel in range(4)))
        found = guard.apply(WheelCommand(SPEED, speed, SOME))
        assert found == (WheelCommand(SPEED, Wheels(*(one * min(1.0, limit / size) for one in speed)), SOME), is_scaled)
        torque = Wheels(*(0.4 * one for one in speed))
        for mode in (SPEED, TORQUE):
            found = guard.apply(WheelCommand(mode, speed, torque))
            near(found[0].torque_n_m, tuple(one * min(1.0, limit / size) for one in torque))
            assert found[1] is is_scaled
            assert (found[0].speed_rad_s == ZERO_WHEELS) is (mode is TORQUE)
    for wrong in (math.nan, math.inf):
        spoilt = Wheels(*(sign * wrong if wheel == place else 1.0 for wheel in range(4)))
        for mode, speed, torque in ((SPEED, spoilt, SOME), (SPEED, SOME, spoilt), (TORQUE, SOME, spoilt)):
            assert guard.apply(WheelCommand(mode, speed, torque)) == (WheelCommand(mode, *STILL), False)
    assert guard.refused == 6
    guard.limit_to(5.0)
    halved = guard.apply(WheelCommand(SPEED, Wheels(10.0, 0.0, 5.0, -1.0), ZERO_WHEELS))[0]
    near(halved.speed_rad_s, (5.0, 0.0, 2.5, -0.5))
    guard.limit_to(50.0)
    assert guard.speed_limit_rad_s == 10.0
    for limits in ((0.0, 1.0), (1.0, 0.0), (math.nan, 1.0), (1.0, math.inf)):
        with pytest.raises(BadInputError, match="more than zero"):
            Guard(*limits)


def test_the_brake_works_against_each_wheel_with_a_quarter_of_the_gain() -> None:
    guard = Guard(10.0, 4.0)
    assert Brake(SPEED, guard, 8.0).command(SOME) == (WheelCommand(SPEED, *STILL), False)
    brake = Brake(TORQUE, guard, 2.0)
    assert brake.command(SOME) == (WheelCommand(TORQUE, ZERO_WHEELS, Wheels(-0.5, 1.0, -1.5, 2.0)), False)
    assert brake.command(Wheels(16.0, -8.0, 0.0, 4.0))[0].torque_n_m == Wheels(-4.0, 2.0, 0.0, -1.0)
    for unknown in (None, Wheels(1.0, math.nan, 1.0, 1.0)):
        assert brake.command(unknown) == (WheelCommand(TORQUE, *STILL), False)


def test_a_wiring_goes_to_the_wire_and_back() -> None:
    wired = WheelMap(("rr", "fl", "rl", "fr"), ("fl", "rr"))
    assert wired.to_wire(SOME) == Wheels(-3.0, -1.0, -4.0, -2.0)
    assert wired.from_wire((-3.0, -1.0, -4.0, -2.0)) == SOME
    assert wired.counts_from_wire((1, 2, 3, 4)) == (0xFFFE, 4, 0xFFFF, 3)
    assert wired.temperatures_from_wire(Wheels(30.0, 10.0, 40.0, 20.0)) == Wheels(10.0, 20.0, 30.0, 40.0)
    for plain in (WheelMap(), WheelMap(("fl", "fr", "rr", "rl"))):
        assert plain.to_wire(SOME) == SOME == plain.from_wire(SOME)
        assert plain.counts_from_wire((1, 2, 3, 4)) == (1, 2, 3, 4)
    assert WheelMap(reversed_wheels=("rl",)).to_wire(SOME) == Wheels(1.0, -2.0, 3.0, 4.0)
    wiring = Wiring(wired, ("fl", "fr", "rr", "rl"), ("rr",), ImuMount())
    assert (wiring.encoder_channels, wiring.encoder_signs) == ((1, 3, 0, 2), (1, 1, -1, 1))
    assert Wiring.of(wired).encoder_wheels == ("rr", "fl", "rl", "fr")
    assert Wiring.of(wired).encoder_channels == (0, 1, 2, 3)
    assert Wiring.of(wired).imu.is_identity
    assert not Wiring.of(wired, ImuMount(("-y", "x", "z"))).imu.is_identity


def test_an_imu_is_mounted_in_one_of_24_ways() -> None:
    """Its frame is right-handed; a vector comes back along the robot's axes."""
    found = 0
    for order, signs in itertools.product(itertools.permutations("xyz"), itertools.product(("", "-"), repeat=3)):
        axes = [sign + axis for sign, axis in zip(signs, order, strict=True)]
        rows = [[(-1 if sign else 1) * (axis == one) for one in "xyz"] for sign, axis in zip(signs, order, strict=True)]
        (a, b, c), (d, e, f), (g, h, i) = rows
        if a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0:
            with pytest.raises(ValueError, match="left-handed"):
                ImuMount(axes)
            continue
        found += 1
        body = (1.0, 2.0, 3.0)
        measured = [sum(row[one] * body[one] for one in range(3)) for row in rows]
        mount = ImuMount(axes)
        assert mount.to_body((measured[0], measured[1], measured[2])) == body
        rate = mount.yaw_rate(0.5)
        assert rate == {"z": 0.5, "-z": -0.5}[axes[2]] if axes[2].endswith("z") else math.isnan(rate)
        assert mount.is_identity is (axes == ["x", "y", "z"])
    assert found == 24
    with pytest.raises(ValueError, match="one of x"):
        ImuMount(("x", "x", "z"))


def test_bodies_and_worlds_turn_into_each_other_and_wheels_drive_as_mecanum_wheels_do() -> None:
    world = Twist(0.0, 1.0, 0.5)
    near(to_body(world, math.pi / 2), (1.0, 0.0, 0.5))
    near(to_world(BodyTwist(1.0, 0.0, 0.5), math.pi / 2), world)
    for heading in (-2.0, 0.3, 4.0):
        near(to_world(to_body(Twist(0.3, -0.2, 0.7), heading), heading), (0.3, -0.2, 0.7))
    near(wheel_speeds((1.0, 0.0, 0.0), 0.1, 0.4), (10.0,) * 4)
    near(wheel_speeds((0.0, 1.0, 0.0), 0.1, 0.4), (-10.0, 10.0, -10.0, 10.0))
    near(wheel_speeds((0.0, 0.0, 1.0), 0.1, 0.4), (-4.0, 4.0, 4.0, -4.0))
    near(body_twist(wheel_speeds((0.3, -0.2, 0.7), 0.1, 0.4), 0.1, 0.4), (0.3, -0.2, 0.7))
    near((wrap_angle(3.5), wrap_angle(-3.5), wrap_angle(0.1 + 4 * math.pi)), (3.5 - math.tau, math.tau - 3.5, 0.1))


# Clocks and latency


def test_the_robots_clock_is_found_from_the_exchange_with_the_least_delay() -> None:
    sync = ClockSync()
    assert sync.figures() is None
    delays_ms = (3, 1, 9, 4, 2, 8)
    for number, delay_ms in enumerate(delays_ms):
        sent_ns = number * 250 * MS
        sequence = sync.request(sent_ns)
        # The robot's clock is 70 ms ahead and 100 ppm fast; the answer takes all of the delay, after 5 ms at the robot.
        received_us = 70_000 + sent_ns * 1.0001 / 1000
        sync.answered(sequence ^ 1, 0, 0, sent_ns)
        sync.answered(sequence, round(received_us), 5000, sent_ns + (delay_ms + 5) * MS)
        sync.answered(sequence, 0, 0, sent_ns)
        best_ms = min(delays_ms[: number + 1])
        best = delays_ms.index(best_ms) * 250 * MS
        assert sync.offset_us == pytest.approx(70_000 + best * 1e-7 - 500 * best_ms, abs=1.0)
    figures = sync.figures()
    assert figures is not None
    assert (figures["requests"], figures["answered"], figures["steps"]) == (6, 6, 0)


def exchange(sync: ClockSync, t_ns: int, offset_us: float, held_us: int = 0) -> None:
    """An exchange without delay."""
    sync.answered(sync.request(t_ns), round(t_ns / 1000 + offset_us) % 2**32, held_us, t_ns + held_us * 1000)


def test_drift_jump_and_wrap_of_the_robots_clock_are_told_apart() -> None:
    sync = ClockSync()
    for number in range(20):
        t_ns = number * 250 * MS
        exchange(sync, t_ns, -5000 + 50e-6 * t_ns / 1000)
        assert math.isnan(sync.drift_ppm) is (number < 4), "a fit needs a second"
    assert sync.drift_ppm == pytest.approx(50.0, rel=0.02)
    exchange(sync, 20 * 250 * MS, -5000 + 100_000)
    assert (sync.steps, sync.offset_us > 50_000) == (0, True)
    exchange(sync, 21 * 250 * MS, 2_000_000)
    assert sync.steps == 1
    assert sync.offset_us == pytest.approx(2_000_000)
    assert math.isnan(sync.drift_ppm)
    before = sync.offset_us
    exchange(sync, 22 * 250 * MS, 0.0, 0xFFFF)
    assert sync.offset_us == before, "held for too long"
    wrapped = ClockSync()
    for t_s in (4294, 4296):
        exchange(wrapped, t_s * 1_000_000_000, 500_000)
    assert wrapped.offset_us == pytest.approx(500_000)


def reported(sequence: int, at_ns: int, age_ms: int) -> Feedback:
    """Return feedback of a robot time, by which a command was in force and so old."""
    zeros = Wheels(0.0, 0.0, 0.0, 0.0)
    return Feedback(at_ns, m.State.ACTIVE, sequence & 0xFF, age_ms, (0,) * 4, zeros, zeros, (0.0, 0.0, 0.0), 0.0)


def test_the_latency_of_commands_is_the_median_of_those_of_late() -> None:
    latency = CommandLatency(0.02, 100 * MS)
    at_ns, took, newest = 0, itertools.cycle((4, 9, 5, 30, 6)), reported(255, 0, 0)
    for number in range(61):
        at_ns += 10 * MS
        for _ in range(2):  # a second report of a command does not count
            told_s = latency.applied(newest, number, at_ns, None, False).latency_s
        took_ms = next(took) if number < 30 else 12
        newest = reported(number, at_ns + (took_ms + 3) * MS, 3)
        if number < 9:
            assert told_s == 0.02
        elif number == 30:
            assert told_s == pytest.approx(0.006)
    assert latency.s == pytest.approx(0.012)
    for age_ms, late_ms in ((255, 20), (0, 101), (50, 40)):
        for number in range(40):
            latency.applied(reported(number - 1, at_ns + late_ms * MS, age_ms), number, at_ns, None, False)
    assert latency.s == pytest.approx(0.012), "old ones, too long ones, negative ones"
    latency.applied(newest, 7, at_ns, None, False)
    latency.restart()
    for _ in range(40):
        latency.applied(reported(7, at_ns + 30 * MS, 0), 8, at_ns, None, False)
    assert latency.s == pytest.approx(0.012)
    trips = RoundTrip()
    assert trips.figures() is None
    trips.add([MS, 2 * MS, 3 * MS])
    figures = trips.figures()
    assert figures is not None
    assert figures["count"] == 3
    assert 2.0 in figures.values()


def test_data_are_no_older_than_since_the_link_was_last_empty() -> None:
    age = PollAge()
    polls = ((5, True, 0), (9, True, 4), (12, False, 3), (20, False, 11), (30, True, 21), (31, True, 1))
    for now, everything, expected in polls:
        age.record_poll(now, everything=everything)
        assert age.ns == expected
    age.restart()
    age.record_poll(90, everything=False)
    assert age.ns == 0


# What the robot reports


def status(**values: int) -> m.Status:
    blank = dict.fromkeys(m.Status._fields, 0)
    return m.Status(**(blank | values))


def test_a_report_names_reason_fault_and_the_wheel_that_hangs_on_the_channel() -> None:
    report = RobotReport(WheelMap(("rr", "fl", "rl", "fr")))
    assert not report.explains(m.State.IDLE)
    assert not report.knows_no_reason
    assert report.last_reset == ""
    report.feed(status(state=m.State.IDLE))
    assert report.knows_no_reason
    fault = {"fault": m.Fault.ENCODER_STUCK, "fault_wheel": m.FaultWheel.FL + 2}
    report.feed(status(state=m.State.FAULT, stop_reason=m.StopReason.FAULT, **fault))
    assert report.stop_reason() == "FAULT (ENCODER_STUCK of wheel rl)"
    assert report.explains(m.State.FAULT)
    assert not report.explains(m.State.IDLE)
    assert "find the cause" in report.why_not_active(m.State.FAULT)
    assert "release the e-stop" in report.why_not_active(m.State.ESTOP)
    report.feed(m.Power(24.5, -1.5))
    report.feed(m.Temperatures(30, 10, 40, 20))
    assert report.health == (24.5, -1.5, Wheels(10, 20, 30, 40))
    words = ProcessorFault(cfsr=1 << 25 | 1 << 15, pc=0x08000100, lr=0x08000200, bfar=0x20000000).describe()
    where = "at 0x08000100, called from 0x08000200 for address 0x20000000"
    assert words == f"{where} (CFSR 02008000, HFSR 00000000)"
    for crc in (250, 3):
        report.feed(m.LinkCounters(*(crc if name == "crc" else 0 for name in m.LinkCounters._fields)))
    assert report.rejected["crc"] == 9, "it counts on where a counter of the robot wraps"
