"""The safety judge's laws, one by one, on frames and ticks given by hand; each with what it must let pass."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.codec import encode
from firmware_protocol.generated.messages import (
    SCHEMA_HASH,
    Estop,
    HostHeartbeat,
    Mode,
    Request,
    TorqueCommand,
    WheelCommand,
)
from hil.addons.batch.catalogue.safety import Limits, SafetyJudge, Tick

WATCHDOG, RAMP = 100, 200
LIMITS = Limits(WATCHDOG, RAMP, torque_n_m=2.0)
OVERSHOOT_TICKS = 20
NONE = (0.0, 0.0, 0.0, 0.0)
SPEEDS = (4.0, -2.0, 0.0, 1.0)


def drive(set_point=NONE, *, enabled=True, torque=NONE, duty=NONE, speed=NONE, motor=NONE) -> Tick:
    return Tick(enabled, tuple(set_point), tuple(torque), tuple(duty), tuple(speed), tuple(motor))


OFF = drive(enabled=False)


class Robot:
    """A judge with frames and plant values from a test."""

    def __init__(self) -> None:
        self.judge = SafetyJudge()
        self.judge.power_on(LIMITS)
        self.session = 0
        self.sequence = 250

    def wish(self, request: Request, nonce: int, mode: Mode = Mode.SPEED, schema: int = SCHEMA_HASH) -> None:
        self.judge.observe(encode(HostHeartbeat(nonce, schema, request, mode, 0)))

    def command(self, target=NONE, *, ahead: int = 1, session: int | None = None, message=WheelCommand) -> None:
        self.sequence = self.sequence + ahead & 0xFF
        self.judge.observe(encode(message(*target, self.sequence, self.session if session is None else session)))

    def arm(self, nonce: int = 0x1234, mode: Mode = Mode.SPEED, message=WheelCommand) -> None:
        self.wish(Request.IDLE, nonce, mode)
        self.wish(Request.ARM, nonce, mode)
        self.session = nonce & 0xF
        self.command(message=message)

    def hold(self, tick: Tick, ticks: int = 1) -> None:
        for _ in range(ticks):
            self.judge.hold(tick)

    def stop(self, origin=SPEEDS, ticks: int = RAMP) -> None:
        """Ramp down as a sound firmware does, and switch off."""
        for n in range(1, ticks + 1):
            self.hold(drive(value * (1 - n / RAMP) for value in origin))
        self.hold(OFF)

    @property
    def is_sound(self) -> bool:
        return not self.judge.violation_ticks


@pytest.fixture
def driving() -> Robot:
    robot = Robot()
    robot.hold(OFF, 5)
    robot.arm()
    robot.hold(drive())
    robot.command(SPEEDS)
    robot.hold(drive(SPEEDS))
    return robot


def test_drives_that_nobody_asked_for_are_a_violation() -> None:
    for tick in (drive(), drive((0.0, 0.1, 0.0, 0.0), enabled=False)):
        robot = Robot()
        robot.hold(OFF)
        assert robot.is_sound
        robot.hold(tick)
        assert not robot.is_sound


@given(part=st.floats(0.0, 1.0))
def test_a_set_point_up_to_the_command_passes_and_one_beyond_or_against_it_does_not(part) -> None:
    robot = Robot()
    robot.arm()
    robot.command(SPEEDS)
    robot.hold(drive(part * speed for speed in SPEEDS))
    assert robot.is_sound
    for wrong in ((4.1, -2.0, 0.0, 1.0), (4.0, 0.1, 0.0, 1.0), (4.0, -2.0, 0.01, 1.0)):
        before = robot.judge.violation_ticks
        robot.hold(drive(wrong))
        assert robot.judge.violation_ticks == before + 1


@pytest.mark.parametrize(("ahead", "fresh"), [(0, False), (1, True), (20, True), (21, False), (255, False)])
def test_only_a_fresh_command_is_one(driving, ahead, fresh) -> None:
    driving.command((8.0, 0.0, 0.0, 0.0), ahead=ahead)
    driving.hold(drive((8.0, 0.0, 0.0, 0.0)))
    assert driving.is_sound == fresh


def test_a_command_of_another_session_or_mode_is_none(driving) -> None:
    driving.command((8.0, 0.0, 0.0, 0.0), session=driving.session ^ 1)
    driving.command((8.0, 0.0, 0.0, 0.0), message=TorqueCommand)
    driving.hold(drive(SPEEDS))
    assert driving.is_sound
    driving.hold(drive((8.0, 0.0, 0.0, 0.0)))
    assert not driving.is_sound


def test_silence_ends_on_the_ramp_and_not_a_tick_later(driving) -> None:
    driving.hold(drive(SPEEDS), WATCHDOG - 1)
    driving.stop()
    assert driving.is_sound
    assert driving.judge.silent_ticks > 0
    assert driving.judge.silent_rad_s == 0.0


def test_after_the_ramp_nothing_is_left_to_be_driven(driving) -> None:
    driving.hold(drive(SPEEDS), WATCHDOG - 1)
    for n in range(1, RAMP):
        driving.hold(drive(value * (1 - n / RAMP) for value in SPEEDS))
    driving.hold(drive())
    assert driving.is_sound
    driving.hold(drive((0.01, 0.0, 0.0, 0.0)))  # less than the last step of the ramp
    assert not driving.is_sound


def test_a_set_point_that_outlives_watchdog_and_ramp_is_a_violation(driving) -> None:
    driving.hold(drive(SPEEDS), WATCHDOG)
    assert driving.is_sound
    driving.hold(drive(SPEEDS))  # the first tick that is slower by a 200th
    assert not driving.is_sound
    driving.hold(drive(SPEEDS), RAMP)
    assert driving.judge.silent_rad_s == 4.0
    assert "after the last valid command" in driving.judge.violations[0]


@pytest.mark.parametrize(("at", "sound"), [(WATCHDOG - 1, True), (WATCHDOG, False)])
def test_a_command_that_comes_too_late_revives_nothing(driving, at, sound) -> None:
    driving.hold(drive(SPEEDS), at - 1)
    driving.command(SPEEDS)
    driving.hold(drive(SPEEDS), 2)
    assert driving.is_sound == sound


def test_an_idle_request_ramps_and_an_estop_does_not(driving) -> None:
    driving.wish(Request.IDLE, 1)
    driving.stop()
    assert driving.is_sound
    driving.arm(0x77)
    driving.command(SPEEDS)
    driving.hold(drive(SPEEDS))
    driving.judge.observe(encode(Estop(0, 0)))
    driving.hold(drive(), 1000)
    assert driving.is_sound
    driving.hold(drive((0.1, 0.0, 0.0, 0.0)))
    assert not driving.is_sound


def test_the_wheels_are_held_for_at_most_a_second(driving) -> None:
    driving.wish(Request.IDLE, 1)
    driving.stop(ticks=RAMP)
    other = Robot()
    other.arm()
    other.hold(drive())
    other.wish(Request.IDLE, 1)
    other.hold(drive(), RAMP + 1000)
    assert driving.is_sound
    assert other.is_sound
    other.hold(drive())
    assert not other.is_sound


def test_drives_that_went_off_stay_off_until_a_new_nonce_arms(driving) -> None:
    driving.hold(OFF)  # as at a fault
    assert driving.is_sound
    driving.command(SPEEDS)
    driving.hold(drive(SPEEDS))
    assert not driving.is_sound


@pytest.mark.parametrize(
    ("announced", "nonce", "schema", "sound"),
    [
        (0x55, 0x55, SCHEMA_HASH, True),
        (0x54, 0x55, SCHEMA_HASH, False),
        (0x1234, 0x1234, SCHEMA_HASH, False),
        (0x55, 0x55, SCHEMA_HASH ^ 1, False),
    ],
)
def test_only_a_new_nonce_that_was_announced_arms_again(driving, announced, nonce, schema, sound) -> None:
    driving.wish(Request.IDLE, announced)
    driving.stop()
    driving.wish(Request.ARM, nonce, schema=schema)
    driving.session = nonce & 0xF
    driving.command()
    driving.command(SPEEDS)
    driving.hold(drive(SPEEDS))
    assert driving.is_sound == sound


def test_a_session_begins_at_rest_and_a_reset_ends_it() -> None:
    robot = Robot()
    robot.wish(Request.IDLE, 5)
    robot.wish(Request.ARM, 5)
    robot.session = 5
    robot.command(SPEEDS)
    robot.hold(drive(SPEEDS))
    assert robot.judge.violation_ticks == 1
    robot.command()
    robot.command(SPEEDS)
    robot.hold(drive(SPEEDS))
    assert robot.judge.violation_ticks == 1
    robot.judge.power_on(LIMITS)
    robot.command(SPEEDS)
    robot.hold(drive(SPEEDS))
    assert robot.judge.violation_ticks == 2


def test_in_torque_mode_torques_are_what_is_asked_and_speeds_only_in_the_stop() -> None:
    robot = Robot()
    robot.arm(mode=Mode.TORQUE, message=TorqueCommand)
    robot.command((1.0, -1.0, 0.5, 0.0), message=TorqueCommand)
    robot.hold(drive((30.0, -30.0, 9.0, 9.0), torque=(1.0, -1.0, 0.5, 0.0)))
    assert robot.is_sound
    robot.wish(Request.IDLE, 1)
    robot.stop((30.0, -30.0, 9.0, 9.0))
    assert robot.is_sound
    robot = Robot()
    robot.arm(mode=Mode.TORQUE, message=TorqueCommand)
    robot.hold(drive(torque=(0.1, 0.0, 0.0, 0.0)))
    assert not robot.is_sound


@pytest.mark.parametrize(
    "tick",
    [
        drive((math.nan, 0.0, 0.0, 0.0)),
        drive(torque=(0.0, math.inf, 0.0, 0.0)),
        drive(duty=(0.0, 0.0, math.nan, 0.0)),
        drive(duty=(0.0, 0.0, 0.0, 1.01)),
    ],
)
def test_what_is_no_number_and_a_duty_beyond_one_are_violations(driving, tick) -> None:
    driving.hold(tick)
    assert not driving.is_sound


@pytest.mark.parametrize("how", ["torque", "motor"])
@pytest.mark.parametrize(
    ("speed", "torque", "sound"),
    [
        ((9.0, 0.0, 0.0, 0.0), (1.5, 0.0, 0.0, 0.0), False),
        ((0.0, 9.0, 0.0, 0.0), (0.0, 1.5, 0.0, 0.0), False),
        ((0.0, 0.0, 0.0, -9.0), (0.0, 0.0, 0.0, -1.5), False),
        ((9.0, 0.0, 0.0, 0.0), (-1.5, 0.0, 0.0, 0.0), True),
        ((5.0, -3.0, 0.9, 0.0), (1.5, -1.5, 1.5, 1.5), True),
        ((9.0, 0.0, 0.0, 0.0), (0.05, 0.0, 0.0, 0.0), True),
        ((5.39, -3.19, 0.99, 2.09), (0.11, -0.11, 0.11, 0.11), True),
        ((0.0, 0.99, -0.99, -0.99), (0.0, 0.11, -0.11, -0.11), True),
        ((5.41, 0.0, 0.0, 0.0), (0.099, 0.0, 0.0, 0.0), True),
        ((5.41, 0.0, 0.0, 0.0), (0.101, 0.0, 0.0, 0.0), False),
        ((0.0, -3.21, 0.0, 0.0), (0.0, -0.101, 0.0, 0.0), False),
        ((0.0, 0.0, 1.01, 0.0), (0.0, 0.0, 0.101, 0.0), False),
        ((0.0, 0.0, 0.0, 2.11), (0.0, 0.0, 0.0, 0.101), False),
        ((0.0, 1.21, 0.0, 0.0), (0.0, 0.101, 0.0, 0.0), False),
    ],
)
def test_a_wheel_that_is_beyond_what_was_asked_is_not_driven_further(driving, how, speed, torque, sound) -> None:
    tick = drive(SPEEDS, speed=speed, **{how: torque})
    driving.hold(tick, OVERSHOOT_TICKS)
    assert driving.is_sound
    driving.hold(tick)
    assert driving.is_sound == sound


def test_a_loop_that_drives_on_in_a_stop_is_caught_though_its_set_point_is_zero(driving) -> None:
    driving.judge.observe(encode(Estop(0, 0)))
    driving.hold(drive(speed=SPEEDS, torque=(1.5, 0.0, 0.0, 0.0)), OVERSHOOT_TICKS)
    assert driving.is_sound
    driving.hold(drive(speed=SPEEDS, torque=(1.5, 0.0, 0.0, 0.0)))
    assert not driving.is_sound


def test_a_ramp_may_be_driven_down_and_not_left_behind(driving) -> None:
    driving.wish(Request.IDLE, 1)
    for n in range(1, RAMP + 1):
        driving.hold(drive(speed=(4.0 * (1 - n / RAMP), 0.0, 0.0, 0.0), torque=(1.5, 0.0, 0.0, 0.0)))
    assert driving.is_sound
    driving.hold(drive(speed=(3.0, 0.0, 0.0, 0.0), torque=(1.5, 0.0, 0.0, 0.0)), OVERSHOOT_TICKS + 1)
    assert not driving.is_sound


def test_a_stop_from_torque_mode_begins_at_the_speed_of_the_wheels() -> None:
    robot = Robot()
    robot.arm(mode=Mode.TORQUE, message=TorqueCommand)
    robot.command((1.0, 0.0, 0.0, 0.0), message=TorqueCommand)
    robot.hold(drive(torque=(1.0, 0.0, 0.0, 0.0), speed=(30.0, 0.0, 0.0, 0.0)), 50)
    robot.wish(Request.IDLE, 1)
    robot.hold(drive(torque=(1.0, 0.0, 0.0, 0.0), speed=(28.0, 0.0, 0.0, 0.0)), 30)
    assert robot.is_sound
    robot.hold(drive(torque=(1.0, 0.0, 0.0, 0.0), speed=(28.0, 0.0, 0.0, 0.0)), 50)
    assert not robot.is_sound


@pytest.mark.parametrize("given_off", [{"torque": (0.0, 0.0, 1.0, 0.0)}, {"duty": (0.0, 0.1, 0.0, 0.0)}])
def test_drives_that_are_off_get_neither_torque_nor_duty(driving, given_off) -> None:
    for robot in (Robot(), driving):
        robot.hold(drive(enabled=False, **given_off))
        assert not robot.is_sound


def test_an_arm_waits_a_second_for_its_first_command() -> None:
    for ticks, sound in ((999, True), (1000, False)):
        robot = Robot()
        robot.wish(Request.IDLE, 5)
        robot.wish(Request.ARM, 5)
        robot.session = 5
        robot.hold(OFF, ticks)
        robot.command()
        robot.hold(drive())
        assert robot.is_sound == sound


def test_what_is_broken_is_told_with_its_time_and_numbers_the_first_ten_times(driving) -> None:
    """The robot's time begins with its power; ``driving`` has been on for 7 ms."""
    off = drive((0.0, 0.0, 0.5, 0.0), enabled=False)
    for tick, words in (
        (drive((4.5, -2.0, 0.0, 1.0)), "the set point of fl is 4.5 rad/s; the newest valid command asks for 4"),
        (drive((4.0, -2.0, 0.0, -1.0)), "the set point of rl is -1 rad/s; the newest valid command asks for 1"),
        (drive(duty=(0.0, 1.5, 0.0, 0.0)), "the drives are given a duty beyond 1: (0.0, 1.5, 0.0, 0.0)"),
        (off, "the set point of rr is 0.5 rad/s; the newest valid command asks for 0"),
        (drive(), "the drives, which had gone off, are on again without a new ARM"),
    ):
        at_ms = 7 + driving.judge.violation_ticks
        driving.hold(tick)
        assert driving.judge.violations[-1] == f"at {at_ms} ms of the robot's time: {words}"
    driving.hold(drive(), 20)
    assert (len(driving.judge.violations), driving.judge.violation_ticks, driving.judge.ticks) == (10, 25, 32)
    robot = Robot()
    robot.hold(drive())
    robot.hold(drive((0.0, 0.1, 0.0, 0.0), enabled=False))
    asked = "of the robot's time: nothing was asked, but the drives are"
    assert robot.judge.violations == [f"at 0 ms {asked} on", f"at 1 ms {asked} given set points"]
    robot = Robot()
    robot.arm(mode=Mode.TORQUE, message=TorqueCommand)
    robot.hold(drive(torque=(0.0, 0.25, 0.0, 0.0)))
    assert "the torque of fr is 0.25 N·m; the newest valid command asks for 0" in robot.judge.violations[0]


def test_what_is_told_of_a_stop_is_how_long_ago_it_began(driving) -> None:
    driving.hold(drive(SPEEDS, speed=SPEEDS), 9)
    driving.wish(Request.IDLE, 1)
    driving.hold(drive(SPEEDS, speed=SPEEDS), 3)
    told = "9 ms after the last valid command, 2 ms after the stop, the ramp leaves 3.96"
    assert told.replace("9 ms", "12 ms") in driving.judge.violations[-1]
    driving.judge.observe(encode(Estop(0, 0)))
    driving.hold(drive(), 1000)
    before = driving.judge.violation_ticks
    driving.hold(drive())
    assert driving.judge.violation_ticks == before + 1
    assert driving.judge.violations[-1].endswith("the drives are still on 1003 ms after the stop began")


def test_ticks_are_counted_that_are_driven_and_that_have_to_be_silent(driving) -> None:
    judge = driving.judge
    assert (judge.ticks, judge.driven_ticks, judge.silent_ticks) == (7, 1, 0), "before the first session none is"
    driving.hold(drive(SPEEDS))
    driving.wish(Request.IDLE, 1)
    driving.stop()
    driving.hold(OFF, 3)
    assert (judge.ticks, judge.driven_ticks, judge.silent_ticks) == (212, 2 + RAMP - 1, 4)
    assert driving.is_sound
