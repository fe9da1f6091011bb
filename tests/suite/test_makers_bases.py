"""The drivers for Rosmaster and WHEELTEC against frames made by hand: units, signs, order, age, arming, stops.

The drivers' docstrings name the sources.
"""

import functools
import math
import operator
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from hil.addons.motors.rosmaster.rosmaster_driver import RosmasterFraming
from hil.addons.motors.wheeltec.wheeltec_driver import WheeltecFraming
from hil.core.errors import BadInputError
from hil.robot.driver import Driver
from tests.suite import driver_bench as bench
from tests.suite.driver_bench import MS, STILL, feed, found_by, near, sample_of


def make(name: str, settings: Mapping[str, Any] | None = None, order: tuple[int, ...] = bench.ALL) -> Driver:
    return bench.make(name, settings, wire="serial", order=order)


# Rosmaster X3: FF FC length function data sum, little-endian; M1 to M4 are FL, RL, FR, RR

X3_RADIUS_M, X3_LEVER_M = 0.204203 / math.tau, 0.164555


def board_says(driver: Driver, number: int, layout: str, *values: float, t_ms: float = 1.0) -> None:
    feed(driver, number, "<" + layout, *values, t_ms=t_ms)


def greet_board(driver: Driver, car: int = 1, major: int = 3) -> None:
    asked = [driver.ask()[0] for _ in range(2)]
    assert [(frame.id, frame.payload) for frame in asked] == [(0x50, b"\x51\0"), (0x50, b"\x15\0")]
    board_says(driver, 0x51, "BB", major, 5)
    board_says(driver, 0x15, "BB", car, 0)


def board(t_ms: float = 1.0, twist: Sequence[int] = (0, 0, 0), volts: float = 12.0, of: Driver | None = None) -> Driver:
    driver = of or make("rosmaster")
    board_says(driver, 0x0A, "3hB", *twist, round(10 * volts), t_ms=t_ms)
    board_says(driver, 0x0D, "4i", 0, 0, 0, 0, t_ms=t_ms)
    return driver


def test_a_rosmaster_gets_the_twist_of_its_own_geometry_within_its_limit() -> None:
    driver = board()
    greet_board(driver)
    driver.arm(MS)
    driver.arm(10 * MS)
    assert driver.is_armed
    for number, twist in enumerate(((0.3, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, -0.9), (0.2, -0.1, 0.5))):
        (frame,) = driver.command(bench.wheels(*twist, X3_RADIUS_M, X3_LEVER_M), STILL, (20 + 10 * number) * MS)
        assert frame.id == 0x12
        car, *counts = struct.unpack("<B3h", frame.payload)
        assert car == 1
        near(counts, [1000 * one for one in twist], 0.51)
    (frame,) = driver.command(bench.wheels(1.5, 0.5, 0.0, X3_RADIUS_M, X3_LEVER_M), STILL, 100 * MS)
    near(struct.unpack("<B3h", frame.payload)[1:], [750, 250, 0], 0.51)
    assert driver.command(STILL, STILL, 103 * MS) == (), "the board takes a frame each 4 ms"
    assert driver.command(STILL, STILL, 104 * MS) != ()
    stops = driver.disarm()
    assert [(frame.id, frame.payload) for frame in stops] == [(0x12, b"\x01" + bytes(6)), (0x0F, b"\x5f")]
    (frame,) = driver.command((5.0,) * 4, STILL, 200 * MS)
    assert frame.payload == b"\x01" + bytes(6), "it is not armed"


def test_a_rosmaster_says_what_its_wheels_imu_and_battery_do() -> None:
    driver = board(1, (300, -200, 900))
    board_says(driver, 0x0B, "9h", 1, 2, -3755, 1672, -3344, 16395, 0, 0, 0, t_ms=2)
    near(sample_of(driver).speed_rad_s, bench.wheels(0.3, -0.2, 0.9, X3_RADIUS_M, X3_LEVER_M))
    near([sample_of(driver).battery_v, sample_of(driver).yaw_rate_rad_s], [12.0, 1.0], 1e-3)
    near(sample_of(driver).acceleration_m_s2, [1.0, -2.0, 9.8066], 2e-3)
    board_says(driver, 0x0E, "9h", 1, 2, -500, 1000, -2000, 9807, 0, 0, 0, t_ms=2)
    near([sample_of(driver).yaw_rate_rad_s, *sample_of(driver).acceleration_m_s2], [-0.5, 1.0, -2.0, 9.807])
    board_says(driver, 0x0D, "4i", 132, -264, 396, 528, t_ms=3)
    near(sample_of(driver).position_rad, [math.tau * turns / 10 for turns in (1, 3, 4, -2)])
    for counts in ((2**31 - 1, -(2**31), 0, 0), (-(2**31) + 9, 2**31 - 12, 0, 0)):
        before = sample_of(driver).position_rad
        board_says(driver, 0x0D, "4i", *counts, t_ms=4)
    after = sample_of(driver).position_rad
    near([after[0] - before[0], after[3] - before[3]], [10 / 1320 * math.tau, -12 / 1320 * math.tau], 1e-6)
    for t_ms, stamp_ms, has_imu in ((240, 240, True), (260, 254, False), (400, 254, False)):
        board_says(driver, 0x0A, "3hB", 0, 0, 0, 120, t_ms=t_ms)
        assert sample_of(driver).stamp_ns == stamp_ms * MS, "old counts hold it back"
        assert math.isnan(sample_of(driver).yaw_rate_rad_s) is not has_imu


def test_a_rosmaster_is_armed_when_its_wheels_stand_and_its_report_is_fresh() -> None:
    driver = make("rosmaster")
    frames = [frame.id for step in range(4) for frame in driver.arm(step * 5 * MS)]
    assert frames == [0x12] * 4, "stops"
    assert not driver.is_armed
    for twist, t_ms, armed in (((40, 0, 0), 20, False), ((10, 0, 0), 30, True), ((0, 0, 0), 300, False)):
        driver.restart()
        board(30.0 if t_ms == 300 else t_ms, twist, of=driver)
        driver.arm(t_ms * MS)
        driver.arm((t_ms + 5) * MS)
        assert driver.is_armed is armed
    assert "version" in driver.missing
    for car, major in ((2, 3), (1, 4)):
        wrong = make("rosmaster")
        greet_board(wrong, car, major)
        with pytest.raises(BadInputError, match="Rosmaster board"):
            _ = wrong.identity
    with pytest.raises(BadInputError, match="remove both keys"):
        make("rosmaster", order=(1, 0, 2, 3))


@pytest.mark.parametrize("volts", [9.6, 13.0])
def test_a_battery_of_a_rosmaster_may_be_bad_for_a_second_and_a_half(volts: float) -> None:
    driver = board()
    driver.arm(MS)
    driver.arm(10 * MS)
    for begin_ms, lasts_ms, bad in ((100, 1499, False), (3000, 1500, True)):
        board(begin_ms, volts=volts, of=driver)
        board(begin_ms + lasts_ms, volts=volts, of=driver)
        assert (driver.is_armed, len(driver.errors)) == (not bad, bad)
        board(begin_ms + lasts_ms + 10, of=driver)
        assert driver.errors == ()


def test_packets_of_a_rosmaster_are_found_and_checked() -> None:
    framing = RosmasterFraming()
    body = bytes((6, 0x0A)) + b"\1\2\3"
    good = b"\xff\xfb" + body + bytes((sum(body) & 0xFF,))
    bad = good[:-1] + bytes((good[-1] ^ 1,))
    data = b"\x09\x08\xff" + good + bad + b"\xff\xfb\x02" + b"\xff\xfb\x21" + good
    assert [frame for byte in bench.each_byte(data) for frame in framing.feed(byte)] == [Frame(0x0A, b"\1\2\3")] * 2
    assert framing.rejected["checksum"] == 1
    assert framing.rejected["length"] == 2
    sent = framing.encode(Frame(0x12, b"\1\2"))
    assert sent[:7] == bytes((0xFF, 0xFC, 5, 0x12, 1, 2, (5 + 0x12 + 3) & 0xFF))
    assert len(sent) * 10 / 115_200 > 0.0015, "with its pause"
    with pytest.raises(ValueError, match="a payload of 30 bytes: expected at most 29"):
        framing.encode(Frame(0x12, bytes(30)))


# WHEELTEC: 24 bytes of a report, big-endian, in three frames


def report(stop: int = 0, twist: Sequence[int] = (0,) * 3, imu: Sequence[int] = (0,) * 6, mv: int = 24_000) -> bytes:
    body = struct.pack(">BB3h3h3hH", 0x7B, stop, *twist, *imu, mv)
    return body + bytes((functools.reduce(operator.xor, body), 0x7D))


def base_says(driver: Driver, data: bytes, t_ms: float = 1.0, numbers: Sequence[int] = (0, 1, 2)) -> None:
    for number in numbers:
        driver.feed(Frame(0x101 + number, data[8 * number : 8 * number + 8]), round(t_ms * MS))


def test_a_wheeltec_base_gets_and_says_thousandths() -> None:
    driver = make("wheeltec")
    base_says(driver, report(0, (300, -200, 900), (1672, -3344, 16395, 5, 6, -3277), 22_700))
    found = sample_of(driver)
    near(found.speed_rad_s, bench.wheels(0.3, -0.2, 0.9))
    near(found.acceleration_m_s2, [1.0, -2.0, 9.8066], 2e-3)
    near([found.yaw_rate_rad_s, found.battery_v], [math.radians(-50.0), 22.7], 1e-3)
    assert math.isnan(found.position_rad[0])
    own = make("wheeltec", {"wheel_radius_m": 0.1, "lever_m": 0.5, "speed_limit_m_s": 1.0})
    base_says(own, report())
    own.arm(0)
    own.arm(10 * MS)
    assert own.is_armed
    twists = ((0.2, 0.1, -0.4), (0.4, 0.0, 1.0), (2.0, 0.0, 0.0), (0.0, 0.0, 1.6), (0.8, 0.2, 1.0))
    sent = ((200, 100, -400), (400, 0, 1000), (1000, 0, 0), (0, 0, 1000), (533, 133, 667))
    for twist, counts, t_ms in zip(twists, sent, range(20, 70, 10), strict=True):
        (frame,) = own.command(bench.wheels(*twist, 0.1, 0.5), STILL, t_ms * MS)
        assert frame.id == 0x181
        near(struct.unpack(">3hxx", frame.payload), counts, 0.51)
    assert list(own.disarm()) == [Frame(0x181, bytes(8))] * 2


def test_a_report_of_a_wheeltec_base_is_whole_or_does_not_count() -> None:
    driver = make("wheeltec")
    first, second = report(0, (100, 0, 0)), report(0, (200, 0, 0), (7, 8, 9, 1, 2, 3))
    base_says(driver, first)
    speed = sample_of(driver).speed_rad_s
    base_says(driver, second, 2, (0, 2))
    base_says(driver, second, 3, (1, 2))
    base_says(driver, second, 4, (0, 1))
    base_says(driver, first[:16] + second[16:], 5)
    base_says(driver, b"\x7c" + second[1:], 6)
    assert (sample_of(driver).speed_rad_s, sample_of(driver).stamp_ns) == (speed, MS)
    base_says(driver, second, 7)
    assert sample_of(driver).stamp_ns == 7 * MS


def test_a_wheeltec_base_that_has_switched_off_says_why_and_is_not_armed() -> None:
    driver = make("wheeltec")
    base_says(driver, report())
    for now_ms in (0, 10):
        driver.arm(now_ms * MS)
    assert driver.is_armed
    for millivolts, words in ((24_000, "emergency stop"), (19_900, "19.9 V")):
        base_says(driver, report(1, mv=millivolts), 20)
        assert not driver.is_armed
        assert words in driver.errors[0]
        driver.arm(30 * MS)
        assert not driver.is_armed
    base_says(driver, report(), 40)
    driver.arm(50 * MS)
    assert driver.is_armed
    assert make("wheeltec", {"stops_on_silence": True}).capabilities.watchdog == "fixed"
    assert make("wheeltec").capabilities.watchdog == "none"


def test_packets_of_a_wheeltec_base_are_found_and_checked() -> None:
    framing = WheeltecFraming()
    good = report(0, (1, 2, 3))
    data = b"\x01" + good + good[:-2] + bytes((good[-2] ^ 1, 0x7D)) + good[:-1] + b"\x7c" + good
    found = [frame for byte in bench.each_byte(data) for frame in framing.feed(byte)]
    assert found == [Frame(0x101 + n, good[8 * n : 8 * n + 8]) for n in (0, 1, 2)] * 2
    assert (framing.rejected["checksum"], framing.rejected["tail"]) == (1, 1)
    sent = framing.encode(Frame(0x181, struct.pack(">3hxx", 300, -2, 5)))
    assert sent[10:] == bytes((0x7B, 0, 0, 0x01, 0x2C, 0xFF, 0xFE, 0, 5, 0x7B ^ 1 ^ 0x2C ^ 0xFF ^ 0xFE ^ 5, 0x7D))
    assert not any(sent[:10])


def test_probes_know_a_base_by_what_it_says() -> None:
    for car, major, motors in ((1, 3, {"car": "x3"}), (2, 3, {"car": "x3_plus"}), (5, 3, None), (1, 2, None)):
        probe = bench.make_probe("rosmaster")
        assert probe.patience_s == 0.1
        assert [frame.payload[0] for _ in range(3) for frame in probe.ask()] == [0x51, 0x15, 0x51]
        assert probe.found() is None
        probe.feed(Frame(0x51, bytes((major, 5))))
        probe.feed(Frame(0x15, bytes((car, 0))))
        found = found_by(probe)
        assert found.motors == motors
        if car == 1 and motors:
            assert found.known["robot.wheel_radius_m"] == X3_RADIUS_M
            assert found.known["robot.half_length_m"] + found.known["robot.half_width_m"] == X3_LEVER_M
            assert found.known["robot.speed_limit_rad_s"] == pytest.approx(1.0 / X3_RADIUS_M)
            assert found.known["firmware.counts_per_revolution"] == 1320
    probe = bench.make_probe("wheeltec")
    data = report(mv=23_500)
    for number in range(3):
        assert probe.found() is None
        assert probe.feed(Frame(0x101 + number, data[8 * number : 8 * number + 8]))
    found = found_by(probe)
    assert found.sentences == ["a WHEELTEC base, battery 23.5 V"]
    assert not probe.feed(Frame(0x104, bytes(8)))
