"""The driver for ODrive against frames made by hand from its maker's description: units, signs, stops.

The driver's tables name their sources.
"""

import itertools
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.types import CommandMode
from hil.robot.driver import REMOTE, Driver
from tests.suite import driver_bench as bench
from tests.suite.driver_bench import MS, SPEEDS, STILL, TORQUES, feed, found_by, make, near, sample_of

# ODrive: identifier node << 5 | command, little-endian, revolutions of the motor

GEAR = 8.0
IDLE, CLOSED = 1, 8
VERSIONS = {"endpoints_firmware": "0.6.10", "endpoints_hardware": "4.4.58"}
ENDPOINTS: dict[str, Any] = {"watchdog_endpoints": [300, 301]} | VERSIONS


def odrive(mode: CommandMode = bench.SPEED, **settings: Any) -> Driver:
    return make("odrive", {"gear_ratio": GEAR, "node_ids": [4, 5, 6, 7]} | settings, mode)


def says(
    driver: Driver, command: int, layout: str, *values: float, t_ms: float = 1.0, axes: Sequence[int] = bench.ALL
) -> None:
    for axis in axes:
        feed(driver, 4 + axis << 5 | command, "<" + layout, *values, t_ms=t_ms)


def beat(driver: Driver, state: int, error: int = 0, *flags: int, **of: Any) -> None:
    says(driver, 0x01, "IBBBB", error, state, *(flags or (0, 0, 0)), **of)


def estimates(driver: Driver, t_ms: float = 1.0, **of: Any) -> None:
    says(driver, 0x09, "ff", 2.5, -0.75, t_ms=t_ms, **of)


def greet(driver: Driver, minor: int = 6) -> None:
    """Introduce four axes with firmware 0.6, or with 0.5, which answers only for its controller's error."""
    beat(driver, IDLE)
    for _ in range(5):
        driver.ask()
        if minor == 6:
            says(driver, 0x00, "xBBBBBBB", 4, 4, 58, 0, 6, 10, 0)
        else:
            says(driver, 0x1D, "II", 0, 0)
    beat(driver, IDLE)
    estimates(driver)


def commands_in(frames: Sequence[Frame], command: int) -> list[Frame]:
    return [frame for frame in frames if frame.id & 0x1F == command and not frame.id & REMOTE]


def commands_of(frames: Sequence[Frame], command: int, layout: str) -> list[tuple[float, ...]]:
    """Return the values of a command to the four axes, in their order."""
    some = commands_in(frames, command)
    assert [frame.id >> 5 for frame in some] == [4, 5, 6, 7]
    return [struct.unpack("<" + layout, frame.payload) for frame in some]


def test_an_odrive_gets_turns_and_torque_of_its_motor() -> None:
    by_speed = commands_of(odrive().command(SPEEDS, TORQUES, 0), 0x0D, "ff")
    near([one[0] for one in by_speed], [w * GEAR / math.tau for w in SPEEDS])
    near([one[1] for one in by_speed], [n / GEAR for n in TORQUES])
    by_torque = commands_of(odrive(bench.TORQUE).command(STILL, TORQUES, 0), 0x0E, "f4x")
    near([one[0] for one in by_torque], [n / GEAR for n in TORQUES])


def test_an_odrive_says_what_its_motor_does_and_a_value_that_comes_no_more_is_unknown() -> None:
    driver = odrive()
    greet(driver)
    says(driver, 0x14, "ff", 9.0, -1.5)
    says(driver, 0x15, "ff", 31.0, 42.0)
    says(driver, 0x17, "ff", 23.5, 0.5)
    found = sample_of(driver)
    near(found.speed_rad_s, [-0.75 * math.tau / GEAR] * 4)
    near(found.position_rad, [2.5 * math.tau / GEAR] * 4)
    near([*found.current_a, *found.temperature_degc], [-1.5] * 4 + [42.0] * 4)
    near([found.battery_v, found.battery_a], [23.5, 2.0])
    late_ms = 1 + 1000 * max(5 * 4 * 5 * bench.PERIOD_S, 0.1)
    estimates(driver, late_ms - 1.0)
    near([sample_of(driver).battery_v], [23.5])
    estimates(driver, late_ms + 1.0)
    late = sample_of(driver)
    near([*late.current_a, *late.temperature_degc, late.battery_v], [math.nan] * 9)
    estimates(driver, 9000, axes=(0, 1, 3))
    assert sample_of(driver).stamp_ns == round((late_ms + 1.0) * MS)
    driver.feed(Frame(REMOTE | 6 << 5 | 0x09, b""), 9000 * MS)
    driver.feed(Frame(6 << 5 | 0x09, struct.pack("<ff", math.nan, 1.0)), 9000 * MS)
    driver.feed(Frame(6 << 5 | 0x09, bytes(7)), 9000 * MS)
    assert sample_of(driver).stamp_ns == round((late_ms + 1.0) * MS)


def test_an_odrive_of_0_5_tells_itself_by_what_it_does_not_answer() -> None:
    driver = odrive()
    assert "heartbeat" in driver.missing
    greet(driver, 5)
    assert driver.missing == ""
    assert "0.5.4" in (driver.identity or "")
    says(driver, 0x15, "ff", 31.0, 42.0)
    says(driver, 0x17, "ff", 23.5, 0.5)
    assert math.isnan(sample_of(driver).temperature_degc[0])
    assert math.isnan(sample_of(driver).battery_a)
    assert not driver.capabilities.sensors & {"temperature", "battery_current"}
    assert odrive().capabilities.sensors >= {"temperature", "battery_current"}
    for settings, said in (({"firmware": "0.6"}, 5), ({"firmware": "0.5"}, 6), (ENDPOINTS, 5)):
        wrong = odrive(**settings)
        greet(wrong, said)
        with pytest.raises(BadInputError, match="firmware"):
            _ = wrong.identity


def follow(driver: Driver, until_ms: int = 4000) -> int:
    """Answer as an axis does until all are armed, and return how long it took [ms]."""
    state, stored = IDLE, {300: struct.pack("<f", 0.0), 301: b"\0"}
    for ms in range(1, until_ms, 10):
        for frame in driver.arm(ms * MS):
            command, axis = frame.id & 0x1F, (frame.id >> 5 & 0x3F) - 4
            if frame.id & REMOTE:
                continue
            if command == 0x07:
                (state,) = struct.unpack("<I4x", frame.payload)
            elif command == 0x04:
                write, endpoint = struct.unpack_from("<BH", frame.payload)
                if write:
                    stored[endpoint] = frame.payload[4:]
                else:
                    answer = struct.pack("<BHB", 0, endpoint, 0) + stored[endpoint]
                    driver.feed(Frame(4 + axis << 5 | 0x05, answer), ms * MS)
        beat(driver, state, t_ms=ms)
        if driver.is_armed:
            assert stored in ({300: struct.pack("<f", bench.WATCHDOG_S), 301: b"\1"}, {300: bytes(4), 301: b"\0"})
            return ms
    raise AssertionError(driver.errors)


@pytest.mark.parametrize("settings", [{}, ENDPOINTS])
@pytest.mark.parametrize("mode", [bench.SPEED, bench.TORQUE])
def test_an_odrive_is_armed_step_by_step_at_standstill(settings: Mapping[str, Any], mode: CommandMode) -> None:
    driver = odrive(mode, **settings)
    assert driver.capabilities.watchdog == ("set" if settings else "none")
    greet(driver)
    first = driver.arm(MS)
    if not settings:
        assert commands_of(first, 0x0B, "II") == [(2 if mode is bench.SPEED else 1, 1)] * 4
        assert commands_of(first, 0x07, "I4x") == [(CLOSED,)] * 4
        still = commands_of(first, 0x0D, "ff") if mode is bench.SPEED else commands_of(first, 0x0E, "f4x")
        assert {value for values in still for value in values} == {0.0}
    assert follow(driver) < 1500
    assert driver.is_armed
    beat(driver, IDLE, t_ms=1600, axes=(2,))
    assert not driver.is_armed
    assert [error[:25] for error in driver.errors] == ["ODrive node 6 of wheel rr"]
    frames = driver.disarm()
    assert commands_of(frames, 0x07, "I4x") == [(IDLE,)] * 4
    assert driver.errors == []
    assert [frame.id & 0x1F for frame in driver.estop()] == [0x02] * 4


ERRORS = [(1 << 9, "DC_BUS_UNDER_VOLTAGE"), (1 << 24, "WATCHDOG"), (1 << 23, "0x800000")]


@pytest.mark.parametrize(("error", "name"), ERRORS)
def test_an_error_of_an_odrive_ends_its_closed_loop_and_lasts_until_it_is_cleared(error: int, name: str) -> None:
    driver = odrive()
    greet(driver)
    follow(driver)
    beat(driver, CLOSED, t_ms=2000, axes=(0, 2, 3))
    beat(driver, CLOSED, error, t_ms=2000, axes=(1,))
    assert not driver.is_armed
    assert len(driver.errors) == 1
    assert name in driver.errors[0]
    assert not commands_in(driver.arm(2010 * MS), 0x07), "with an error nothing is armed"
    says(driver, 0x03, "II", 0, error, t_ms=2010.0, axes=(1,))
    assert name in driver.errors[0], "it is also the reason why it was disarmed"
    cleared = driver.clear()
    assert [(frame.id & 0x1F, frame.payload) for frame in cleared] == [(0x18, b"\0")] * 4
    assert driver.errors == []
    beat(driver, IDLE, error, t_ms=2020, axes=(1,))
    assert driver.errors == [], "it was on the way"
    beat(driver, IDLE, t_ms=2120)
    estimates(driver, 2120)
    assert commands_in(driver.arm(2130 * MS), 0x07)


def test_a_flag_of_0_5_is_an_error_before_its_register_is_read_and_ends_with_the_flag() -> None:
    driver = odrive()
    greet(driver, 5)
    beat(driver, IDLE, 0, 1, 0, 0, t_ms=2, axes=(0,))
    assert "motor error, not read yet" in driver.errors[0]
    asked = [frame.id for frame in driver.disarm() if frame.id & REMOTE]
    assert asked == [REMOTE | 4 << 5 | 0x03]
    says(driver, 0x03, "Q", 1 << 12, axes=(0,))
    assert "motor error CURRENT_LIMIT_VIOLATION" in driver.errors[0]
    beat(driver, IDLE, t_ms=3, axes=(0,))
    assert driver.errors == []
    encoder, controller = "encoder error NO_RESPONSE", "controller error UNSTABLE_GAIN"
    for flags, command, name in (((0, 1, 0), 0x04, encoder), ((0, 0, 1), 0x1D, controller)):
        beat(driver, IDLE, 0, *flags, t_ms=4, axes=(3,))
        assert driver.errors[0].endswith(f": {name.rpartition(' ')[0]}, not read yet")
        says(driver, command, "II", 4, 0, axes=(3,))
        assert name in driver.errors[0]
        beat(driver, IDLE, 0, 0, 0, 0x80, t_ms=5, axes=(3,))
        assert driver.errors == [], "a trajectory that is done is none"


def test_an_odrive_that_is_silent_for_a_second_is_an_error_and_it_is_asked_in_turn() -> None:
    driver = odrive(feedback_hz=0)
    greet(driver)
    follow(driver)
    now_ms = 1500
    beat(driver, CLOSED, t_ms=now_ms)
    sent = [frame.id for turn in range(16) for frame in driver.command(STILL, STILL, (now_ms + turn) * MS)]
    asked = [(number >> 5 & 0x3F, number & 0x1F) for number in sent if number & REMOTE]
    polled = [(node, command) for node, command in asked if command != 0x09]
    assert {*polled} == {*itertools.product((4, 5, 6, 7), (3, 0x14, 0x15, 0x17))}
    assert len(asked) - len(polled) == 16 * 4, "it asks for estimates that do not come by themselves"
    driver.command(STILL, STILL, (now_ms + 1000) * MS)
    assert driver.is_armed
    driver.command(STILL, STILL, (now_ms + 1001) * MS)
    assert not driver.is_armed
    assert ["no heartbeat" in error for error in driver.errors] == [True] * 4


def test_a_disarmed_odrive_is_not_armed_and_a_watchdog_that_is_not_kept_is_an_error() -> None:
    driver = odrive()
    greet(driver)
    follow(driver)
    driver.disarm()
    assert not driver.is_armed
    lost = odrive(**ENDPOINTS)
    greet(lost)
    for ms in range(1, 900, 10):
        lost.arm(ms * MS)
        beat(lost, IDLE, t_ms=ms)
    assert not lost.is_armed
    assert ["watchdog_timeout (endpoint 300) could not be set" in error for error in lost.errors] == [True] * 4


def test_a_probe_knows_an_odrive_by_its_answers() -> None:
    probe = bench.make_probe("odrive")
    for node, state, is_one in ((5, 1, True), (6, 14, True), (7, 15, False), (63, 1, False)):
        assert probe.feed(Frame(node << 5 | 1, struct.pack("<IBBBB", 0, state, 0, 0, 0))) is is_one
    assert probe.found() is None
    assert {frame.id ^ REMOTE for frame in probe.ask()} == {node << 5 | one for node in (5, 6) for one in (0, 0x1D)}
    versions = ((4, 4, 58, 0, 6, 10, 0), True), ((0, 4, 58, 0, 6, 10, 0), False), ((4, 4, 58, 0, 5, 6, 0), False)
    for numbers, is_version in versions:
        assert probe.feed(Frame(5 << 5, struct.pack("<xBBBBBBB", *numbers))) is is_version
    found = found_by(probe)
    assert found.motors is None
    assert found.sentences == ["an ODrive axis, node 5, of firmware 0.6.10 on hardware 4.4.58"]
