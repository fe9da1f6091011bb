"""The driver for a DBC of one's own against frames made by hand; what all drivers share: angles, age, stops.

The examples of ``hil/addons/motors/dbc`` describe the frames.
"""

import math
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import four_ids, holds_back, late_ns, oldest
from hil.addons.motors.makers_feedback import Angles
from hil.addons.motors.motor_stop import MotorLine, MotorStop, SessionTerms
from hil.core.clock import LockstepClock
from hil.core.errors import BadInputError
from hil.core.guard import Brake, Guard
from hil.core.types import CommandMode, FourWheels
from hil.robot.driver import EXTENDED, Capabilities, Driver, Sample, clamp
from hil.robot.link_times import PollAge
from hil.scenario import load
from hil.wire.conditions import ConditionedLink
from hil.wire.streams import memory_bus
from tests.suite import driver_bench as bench
from tests.suite.driver_bench import MS, STILL, near, sample_of

HERE = Path(__file__).parent


def make(scenario: str) -> Driver:
    """Make the driver with the mapping of a scenario of the suite."""
    return bench.make("dbc", load(HERE / f"{scenario}.toml").device.motors)


# A DBC: twenty motor turns for one of the wheel, in rpm; a base in m/s, rad/s, degrees and g


def say(
    driver: Driver, t_ms: float, rpm: float = 0.0, angle: int = 0, state: int = 2, error: int = 0, of: Any = bench.ALL
) -> None:
    """Send STATUS: speed in 0.5 rpm, angle in 4096 to a turn, -6 A in 0.05 A, state, 41 degrees from -40 on."""
    for wheel in of:
        bits = (round(rpm * 2) & 0xFFFF) | (angle & 0xFFF) << 16 | (-120 & 0xFFF) << 32
        bits |= state << 44 | 81 << 48 | error << 56
        driver.feed(Frame(0x120 + wheel, bits.to_bytes(8, "little")), round(t_ms * MS))


def inform(driver: Driver, t_ms: float, timeout_ms: int = 100, protocol: int = 2) -> None:
    bits = protocol | timeout_ms << 8 | 2395 << 24 | (-150 & 0xFFFF) << 40
    driver.feed(Frame(0x130, bits.to_bytes(8, "little")), round(t_ms * MS))


def fields(frames: Sequence[Frame]) -> list[tuple[int, int, int, int, float, float]]:
    """Return Enable, Mode, Alive, speed [rad/s of the wheel] and torque of each DRIVE, with its wheel."""
    found = []
    for frame in frames:
        if 0x110 <= frame.id <= 0x113:
            first, rpm, torque = struct.unpack_from("<Bhh", frame.payload)
            speed = rpm * 0.5 / 60 * math.tau / 20
            found.append((frame.id - 0x110, first & 1, first >> 1 & 7, first >> 4, speed, torque * 0.001))
    return found


def test_drives_of_a_dbc_get_and_say_what_their_wheels_do() -> None:
    driver = make("odometry_dbc")
    assert "STATUS_FL" in driver.missing
    frames = [fields(driver.command((1.0, -2.0, 3.0, -4.0), (0.5, -1.0, 1.5, -2.0), 0)) for _ in range(17)]
    for number, frame in enumerate(frames):
        assert [one[:3] for one in frame] == [(wheel, 1, frame[0][2]) for wheel in bench.ALL]
        assert [one[3] for one in frame] == [number % 16] * 4
        near([one[4] for one in frame], (1.0, -2.0, 3.0, -4.0), 0.0015)
    ratio = frames[0][0][5] / 0.5
    near([one[5] for one in frames[0]], [ratio * one for one in (0.5, -1.0, 1.5, -2.0)], 1e-3)
    assert ratio in (pytest.approx(1.0, abs=0.01), pytest.approx(0.05, abs=0.01))
    fast = fields(driver.command((1e3, -1e3, 1e3, -1e3), (1e3, -1e3, 1e3, -1e3), 0))
    near([one[4] for one in fast], [sign * 12_000 / 60 * math.tau / 20 for sign in (1, -1, 1, -1)])
    near([one[5] for one in fast], (20.0, -20.0, 20.0, -20.0))
    inform(driver, 0)
    first = 0.0
    for ms in range(0, 500, 5):
        say(driver, ms, -900, round(-15 * 4096 * ms / 1000))
        first = sample_of(driver).position_rad[0] if ms == 0 else first
    found = sample_of(driver)
    near(found.speed_rad_s, [-15 * math.tau / 20] * 4)
    near([found.position_rad[0] - first], [-15 * math.tau / 20 * 0.495], 1e-3)
    near([*found.current_a, *found.temperature_degc], [-6.0] * 4 + [41.0] * 4)
    near([found.battery_v, found.battery_a], [23.95, -1.5])
    say(driver, 800, of=(0, 1, 3))
    late = sample_of(driver)
    assert late.stamp_ns == 495 * MS
    assert math.isnan(late.battery_v), "it came five periods of 100 ms ago"


def test_drives_of_a_dbc_are_armed_with_their_watchdog_and_in_their_state() -> None:
    driver = make("odometry_dbc")
    for ms in range(0, 60, 10):
        say(driver, ms, state=1)
        inform(driver, ms, 300 if ms < 30 else 100)
        driver.arm(ms * MS)
        assert not driver.is_armed
    say(driver, 60)
    inform(driver, 60)
    driver.arm(60 * MS)
    assert driver.is_armed
    for state, error, words in ((1, 0, 0), (2, 1, 1)):
        say(driver, 70, state=state, error=error, of=(2,))
        assert not driver.is_armed
        assert len(driver.errors) == words
        assert all(one.startswith("wheel rr") for one in driver.errors)
        say(driver, 80)
        driver.disarm()
        for ms in range(90, 130, 10):
            inform(driver, ms)
            driver.arm(ms * MS)
        assert driver.is_armed
    assert [one[1] for one in fields(driver.disarm())] == [0] * 4
    assert not driver.is_armed
    assert [frame.payload[0] & 7 for frame in driver.disarm() if frame.id == 0x100] == [0]
    inform(driver, 200, protocol=9)
    with pytest.raises(BadInputError, match="Protocol"):
        _ = driver.identity


def test_a_base_of_a_dbc_gets_and_says_its_twist() -> None:
    driver = make("odometry_dbc_base")
    (frame,) = driver.command(bench.wheels(0.3, -0.2, 0.5), STILL, 0)
    assert struct.unpack(">3hB", frame.payload) == (300, -200, 500, 0)
    assert frame.id & EXTENDED
    motion, imu = EXTENDED | 2566849024 & 0x1FFFFFFF, EXTENDED | 2566849280 & 0x1FFFFFFF
    driver.feed(Frame(imu, struct.pack(">4h", -3000, 100, -200, 1000)), MS)
    driver.feed(Frame(motion, struct.pack(">3hBx", 300, -200, 900, 0)), MS)
    near(sample_of(driver).speed_rad_s, bench.wheels(0.3, -0.2, 0.9))
    near([sample_of(driver).yaw_rate_rad_s], [math.radians(-30.0)])
    near(sample_of(driver).acceleration_m_s2, [0.980665, -1.96133, 9.80665], 1e-3)
    driver.feed(Frame(motion, struct.pack(">3hBx", 0, 0, 0, 0x40)), 2 * MS)
    assert len(driver.errors) == 1
    assert "EmergencyStop" in driver.errors[0]


# What all drivers share


def turned(angles: Angles, t_ms: float, speed: float, position: float = math.nan) -> int:
    """Return the count of the first wheel after a sample."""
    sample = Sample(round(t_ms * MS), (speed,) * 4, (position,) * 4)
    return angles.add(sample)[0]


def test_angles_are_the_positions_or_the_integral_of_the_speeds() -> None:
    per_rad = 4096 / math.tau
    angles = Angles(4096)
    assert turned(angles, 0, 0.0, 5.0) == 0, "they begin where the robot stands"
    assert turned(angles, 10, 9.0, 6.0) == round(per_rad)
    assert turned(angles, 20, 9.0, 4.0) == -round(per_rad) & 0xFFFF
    assert turned(angles, 30, 9.0, 4.0 + math.tau * 16) == round(-per_rad + 65536) & 0xFFFF, "16 bits"
    angles.restart()
    before = turned(angles, 40, 9.0, 0.0)
    assert before == round(-per_rad + 65536) & 0xFFFF, "one that counts from zero again does not jump"
    assert turned(angles, 50, 9.0, 1.0) == 0
    angles = Angles(4096)
    turned(angles, 0, 2.0)
    assert turned(angles, 100, 4.0) == round(0.3 * per_rad), "the mean of both speeds"
    assert turned(angles, 350, 4.0) == round(1.3 * per_rad)
    assert turned(angles, 601, 4.0) == round(1.3 * per_rad), "nothing is known of a gap"
    assert turned(angles, 501, -4.0) == round(1.3 * per_rad), "time does not go back"


def test_a_value_is_too_old_after_five_periods_and_holds_a_sample_back_for_so_long() -> None:
    assert [late_ns(period_s) for period_s in (0.001, 0.02, 0.04)] == [100 * MS, 100 * MS, 200 * MS]
    assert [holds_back(stamp, 10, 5) for stamp in (8, 12, 15, 16, 99)] == [8, 12, 15, 15, 15]
    assert oldest([3, 1, 2]) == 1
    assert oldest([3, None]) is None
    assert [clamp(value, 2.0) for value in (-3.0, -1.0, 3.0)] == [-2.0, -1.0, 2.0]
    assert clamp(9, 5, 1) == 5
    assert clamp(0, 5, 1) == 1
    check = four_ids(1, 8)
    check((1, 8, 3, 4))
    for wrong in ((1, 2, 3), (1, 2, 3, 3), (0, 1, 2, 3), (1, 2, 3, 9)):
        with pytest.raises(ValueError, match="each 1 to 8"):
            check(wrong)


class Motors(Driver):
    """A driver whose bench.wheels have the speed that a test sets."""

    _capabilities = Capabilities(100.0, frozenset())

    def __init__(self) -> None:
        self.now: Sample | None = None
        self.commands: list[FourWheels] = []

    identity = "motors"

    def arm(self, now_ns: int) -> Sequence[Frame]:
        return ()

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        self.commands.append(speed_rad_s if any(speed_rad_s) else torque_n_m)
        return (Frame(2, b""),)

    def disarm(self) -> Sequence[Frame]:
        return Frame(1, b""), Frame(1, b"")

    def estop(self) -> Sequence[Frame]:
        return (Frame(9, b""),)

    def feed(self, frame: Frame, stamp_ns: int) -> None:
        pass

    @property
    def sample(self) -> Sample | None:
        return self.now


@pytest.mark.parametrize("mode", list(CommandMode))
def test_a_stop_ramps_or_brakes_and_is_repeated_until_the_wheels_were_seen_at_rest_twice(mode: CommandMode) -> None:
    driver, (here, there) = Motors(), memory_bus()
    guard = Guard(30.0, 4.0)
    terms = SessionTerms(mode, 0.2, 0.1, Brake(mode, guard, 2.0), 4096, True, False, lambda _ticks: None)
    clock = LockstepClock()
    stop = MotorStop(driver, terms, MotorLine(ConditionedLink(here, clock), driver, PollAge(), is_lockstep=True))
    assert not stop.is_needed
    stop.armed()
    assert stop.is_needed
    stop.ramp_down(0, (8.0, -4.0, 2.0, 0.0))
    sent: dict[int, list[int]] = {}
    for ms in range(0, 1000, 10):
        speed = 1.5 if ms < 600 else 0.1
        if ms < 400 or ms >= 600:
            driver.now = Sample(ms * MS, (speed, -speed, speed, 0.0))
        stop.repeat(ms * MS)
        is_over = stop.go_on(ms * MS)
        received = there.receive(0)
        if received is not None:
            sent[ms] = [frame.id for frame in received.frames]
    assert is_over
    stops = [ms for ms, numbers in sent.items() if 1 in numbers]
    if mode is CommandMode.SPEED:
        assert driver.commands[10] == pytest.approx((4.0, -2.0, 1.0, 0.0))
        assert len(driver.commands) == 20
        assert stops[:4] == [200, 250, 300, 350]
    else:
        assert driver.commands[5] == pytest.approx((-0.75, 0.75, -0.75, 0.0))
        assert driver.commands[50] == (0.0,) * 4 == driver.commands[55], "the speed is too old"
        assert stops[0] == 600
    assert not stop.is_needed
    assert stops[-1] - 600 in (50, 100), "two of them at rest"
    assert all(sent[ms].count(1) == 2 for ms in stops)
    stop.leave_loop(2000 * MS, latched=True)
    stop.leave_loop(2010 * MS)
    received = there.receive(0)
    assert received is not None
    assert [frame.id for frame in received.frames] == [9, 9], "latched until it is cleared"
    assert stop.go_on(3010 * MS) is False
    assert stop.go_on(3010 * MS + 1) is True
