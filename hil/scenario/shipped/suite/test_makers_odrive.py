"""The driver for ODrive against frames made by hand from its maker's description: units, signs, stops.

A member of the shipped suite of ``hil verify``. The driver's tables name their sources.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.types import CommandMode, FourWheels
from hil.drivers.port import REMOTE, Driver, RobotFacts, Sample, Wire
from hil.drivers.registry import dialect, make_settings

MS = 1_000_000
STILL: FourWheels = (0.0, 0.0, 0.0, 0.0)
SPEEDS: FourWheels = (1.0, -2.0, 3.0, -4.0)
TORQUES: FourWheels = (0.5, -1.0, 1.5, -2.0)
SPEED, TORQUE = CommandMode.SPEED, CommandMode.TORQUE
LIMIT_N_M, N_M_A, WATCHDOG_S, PERIOD_S = 4.0, 0.5, 0.1, 0.01
ALL = (0, 1, 2, 3)


def make(name: str, settings: Mapping[str, Any] | None = None, mode: CommandMode = SPEED, wire: Wire = "can") -> Driver:
    facts = RobotFacts(0.05, 0.3, ALL, (1, 1, 1, 1), LIMIT_N_M, 60.0, N_M_A, WATCHDOG_S, PERIOD_S, mode, wire)
    return dialect(name).make(make_settings(name, settings or {}, "device.motors"), facts)


def sample_of(driver: Driver) -> Sample:
    assert driver.sample is not None
    return driver.sample


def near(found: Sequence[float], expected: Sequence[float]) -> None:
    assert list(found) == pytest.approx(list(expected), rel=1e-6, abs=1e-9, nan_ok=True)


# ODrive: identifier node << 5 | command, little-endian, revolutions of the motor

GEAR = 8.0
IDLE, CLOSED = 1, 8
ENDPOINTS: dict[str, Any] = {
    "watchdog_endpoints": [300, 301],
    "endpoints_firmware": "0.6.10",
    "endpoints_hardware": "4.4.58",
}


def odrive(mode: CommandMode = SPEED, **settings: Any) -> Driver:
    return make("odrive", {"gear_ratio": GEAR, "node_ids": [4, 5, 6, 7]} | settings, mode)


def axis_says(
    driver: Driver, command: int, layout: str, *values: float, t_ms: float = 1.0, axes: Sequence[int] = ALL
) -> None:
    for axis in axes:
        driver.feed(Frame(4 + axis << 5 | command, struct.pack("<" + layout, *values)), round(t_ms * MS))


def beat(
    driver: Driver,
    state: int,
    error: int = 0,
    t_ms: float = 1.0,
    axes: Sequence[int] = ALL,
    flags: Sequence[int] = (0, 0, 0),
) -> None:
    axis_says(driver, 0x01, "IBBBB", error, state, *flags, t_ms=t_ms, axes=axes)


def estimates(driver: Driver, t_ms: float = 1.0, axes: Sequence[int] = ALL) -> None:
    axis_says(driver, 0x09, "ff", 2.5, -0.75, t_ms=t_ms, axes=axes)


def greet(driver: Driver, minor: int = 6) -> None:
    """Introduce four axes with firmware 0.6, or with 0.5, which answers only for its controller's error."""
    beat(driver, IDLE)
    for _ in range(5):
        driver.ask()
        if minor == 6:
            axis_says(driver, 0x00, "xBBBBBBB", 4, 4, 58, 0, 6, 10, 0)
        else:
            axis_says(driver, 0x1D, "II", 0, 0)
    beat(driver, IDLE)
    estimates(driver)


def commands_of(frames: Sequence[Frame], command: int, layout: str) -> list[tuple[float, ...]]:
    """Return the values of a command to the four axes, in their order."""
    some = [frame for frame in frames if frame.id & 0x1F == command and not frame.id & REMOTE]
    assert [frame.id >> 5 for frame in some] == [4, 5, 6, 7]
    return [struct.unpack("<" + layout, frame.payload) for frame in some]


def test_an_odrive_gets_turns_and_torque_of_its_motor() -> None:
    for (speed, torque), w, n in zip(
        commands_of(odrive().command(SPEEDS, TORQUES, 0), 0x0D, "ff"), SPEEDS, TORQUES, strict=True
    ):
        near((speed, torque), (w * GEAR / math.tau, n / GEAR))
    for (torque,), n in zip(commands_of(odrive(TORQUE).command(STILL, TORQUES, 0), 0x0E, "f4x"), TORQUES, strict=True):
        near((torque,), (n / GEAR,))


def test_an_odrive_says_what_its_motor_does_and_a_value_that_comes_no_more_is_unknown() -> None:
    driver = odrive()
    greet(driver)
    axis_says(driver, 0x14, "ff", 9.0, -1.5)
    axis_says(driver, 0x15, "ff", 31.0, 42.0)
    axis_says(driver, 0x17, "ff", 23.5, 0.5)
    found = sample_of(driver)
    near(found.speed_rad_s, [-0.75 * math.tau / GEAR] * 4)
    near(found.position_rad, [2.5 * math.tau / GEAR] * 4)
    near(
        [*found.current_a, *found.temperature_degc, found.battery_v, found.battery_a],
        [-1.5] * 4 + [42.0] * 4 + [23.5, 2.0],
    )
    late_ms = 1 + 1000 * max(5 * 4 * 5 * PERIOD_S, 0.1)
    estimates(driver, late_ms - 1.0)
    near([sample_of(driver).battery_v], [23.5])
    estimates(driver, late_ms + 1.0)
    near(
        [*sample_of(driver).current_a, *sample_of(driver).temperature_degc, sample_of(driver).battery_v], [math.nan] * 9
    )
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
    axis_says(driver, 0x15, "ff", 31.0, 42.0)
    axis_says(driver, 0x17, "ff", 23.5, 0.5)
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
                    driver.feed(
                        Frame(4 + axis << 5 | 0x05, struct.pack("<BHB", 0, endpoint, 0) + stored[endpoint]), ms * MS
                    )
        beat(driver, state, t_ms=ms)
        if driver.is_armed:
            assert stored in ({300: struct.pack("<f", WATCHDOG_S), 301: b"\1"}, {300: bytes(4), 301: b"\0"})
            return ms
    raise AssertionError(driver.errors)


@pytest.mark.parametrize("settings", [{}, ENDPOINTS])
@pytest.mark.parametrize("mode", [SPEED, TORQUE])
def test_an_odrive_is_armed_step_by_step_at_standstill(settings: Mapping[str, Any], mode: CommandMode) -> None:
    driver = odrive(mode, **settings)
    assert driver.capabilities.watchdog == ("set" if settings else "none")
    greet(driver)
    first = driver.arm(MS)
    if not settings:
        assert commands_of(first, 0x0B, "II") == [(2 if mode is SPEED else 1, 1)] * 4
        assert commands_of(first, 0x07, "I4x") == [(CLOSED,)] * 4
        still = commands_of(first, 0x0D, "ff") if mode is SPEED else commands_of(first, 0x0E, "f4x")
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


@pytest.mark.parametrize(
    ("error", "name"), [(1 << 9, "DC_BUS_UNDER_VOLTAGE"), (1 << 24, "WATCHDOG"), (1 << 23, "0x800000")]
)
def test_an_error_of_an_odrive_ends_its_closed_loop_and_lasts_until_it_is_cleared(error: int, name: str) -> None:
    driver = odrive()
    greet(driver)
    follow(driver)
    beat(driver, CLOSED, 0, 2000, axes=(0, 2, 3))
    beat(driver, CLOSED, error, 2000, axes=(1,))
    assert not driver.is_armed
    assert len(driver.errors) == 1
    assert name in driver.errors[0]
    assert not commands_in(driver.arm(2010 * MS), 0x07), "with an error nothing is armed"
    axis_says(driver, 0x03, "II", 0, error, t_ms=2010.0, axes=(1,))
    assert name in driver.errors[0], "it is also the reason why it was disarmed"
    cleared = driver.clear()
    assert [(frame.id & 0x1F, frame.payload) for frame in cleared] == [(0x18, b"\0")] * 4
    assert driver.errors == []
    beat(driver, IDLE, error, 2020, axes=(1,))
    assert driver.errors == [], "it was on the way"
    beat(driver, IDLE, 0, 2120)
    estimates(driver, 2120)
    assert commands_in(driver.arm(2130 * MS), 0x07)


def commands_in(frames: Sequence[Frame], command: int) -> list[Frame]:
    return [frame for frame in frames if frame.id & 0x1F == command and not frame.id & REMOTE]


def test_a_flag_of_0_5_is_an_error_before_its_register_is_read_and_ends_with_the_flag() -> None:
    driver = odrive()
    greet(driver, 5)
    beat(driver, IDLE, t_ms=2, axes=(0,), flags=(1, 0, 0))
    assert "motor error, not read yet" in driver.errors[0]
    asked = [frame.id for frame in driver.disarm() if frame.id & REMOTE]
    assert asked == [REMOTE | 4 << 5 | 0x03]
    axis_says(driver, 0x03, "Q", 1 << 12, axes=(0,))
    assert "motor error CURRENT_LIMIT_VIOLATION" in driver.errors[0]
    beat(driver, IDLE, t_ms=3, axes=(0,))
    assert driver.errors == []
    for flags, command, name in (
        ((0, 1, 0), 0x04, "encoder error NO_RESPONSE"),
        ((0, 0, 1), 0x1D, "controller error UNSTABLE_GAIN"),
    ):
        beat(driver, IDLE, t_ms=4, axes=(3,), flags=flags)
        axis_says(driver, command, "II", 4, 0, axes=(3,))
        assert name in driver.errors[0]
        beat(driver, IDLE, t_ms=5, axes=(3,))


def test_an_odrive_that_is_silent_for_a_second_is_an_error_and_it_is_asked_in_turn() -> None:
    driver = odrive(feedback_hz=0)
    greet(driver)
    follow(driver)
    now_ms = 1500
    beat(driver, CLOSED, t_ms=now_ms)
    asked = [
        frame.id
        for turn in range(16)
        for frame in driver.command(STILL, STILL, (now_ms + turn) * MS)
        if frame.id & REMOTE
    ]
    polled = [number for number in asked if number & 0x1F != 0x09]
    assert {(number >> 5 & 0x3F, number & 0x1F) for number in polled} == {
        (n, c) for n in (4, 5, 6, 7) for c in (3, 0x14, 0x15, 0x17)
    }
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
    make_probe = dialect("odrive").probe
    assert make_probe is not None
    probe = make_probe()
    for node, state, is_one in ((5, 1, True), (6, 14, True), (7, 15, False), (63, 1, False)):
        assert probe.feed(Frame(node << 5 | 1, struct.pack("<IBBBB", 0, state, 0, 0, 0))) is is_one
    assert probe.found() is None
    assert {frame.id for frame in probe.ask()} == {
        REMOTE | node << 5 | command for node in (5, 6) for command in (0, 0x1D)
    }
    for numbers, is_version in (
        ((4, 4, 58, 0, 6, 10, 0), True),
        ((0, 4, 58, 0, 6, 10, 0), False),
        ((4, 4, 58, 0, 5, 6, 0), False),
    ):
        assert probe.feed(Frame(5 << 5, struct.pack("<xBBBBBBB", *numbers))) is is_version
    found = probe.found()
    assert found is not None
    assert found.motors is None
    assert found.sentences == ["an ODrive axis, node 5, of firmware 0.6.10 on hardware 4.4.58"]
