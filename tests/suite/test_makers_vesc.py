"""The driver for VESC against frames made by hand from the maker's sources, over CAN and over a serial line.

``hil/addons/motors/vesc/vesc_frames.py`` names the sources.
"""

import itertools
import math
import struct
from binascii import crc_hqx
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from hil.addons.motors.vesc.vesc_frames import LONGEST_PACKET, SerialFraming
from hil.core.errors import BadInputError
from hil.core.types import CommandMode
from hil.robot.driver import EXTENDED, Driver, Wire
from tests.suite import driver_bench as bench
from tests.suite.driver_bench import MS, SPEEDS, STILL, TORQUES, feed, near, sample_of

IDS, HOST = (11, 12, 13, 14), 253
POLES, GEAR = 5, 3.0
ERPM_PER_RAD_S = GEAR * POLES * 60.0 / math.tau
STEP_RAD = math.tau / (6 * POLES * GEAR)


def make(settings: Mapping[str, Any] | None = None, mode: CommandMode = bench.SPEED, wire: Wire = "can") -> Driver:
    options = {"ids": IDS, "pole_pairs": POLES, "gear_ratio": GEAR, "serial_id": 11} | dict(settings or {})
    return bench.make("vesc", options, mode, wire)


def status(driver: Driver, command: int, layout: str, *values: float, t_ms: float, ids: Sequence[int] = IDS) -> None:
    for vesc in ids:
        feed(driver, EXTENDED | command << 8 | vesc, ">" + layout, *values, t_ms=t_ms)


def moves(
    driver: Driver, t_ms: float, erpm: int = 900, current: int = 30, duty: int = 1, *, steps: int = 0, **of: Any
) -> None:
    """Send status 1, 4 and 5: current in 0.1 A, MOSFETs at 40.5 °C, input of 2.5 A at 23.9 V."""
    status(driver, 9, "ihh", erpm, current, duty, t_ms=t_ms, **of)
    status(driver, 16, "hhhh", 405, 555, 25, 0, t_ms=t_ms, **of)
    status(driver, 27, "ihh", steps, 239, 0, t_ms=t_ms, **of)


def pieces(vesc: int, message: bytes) -> list[Frame]:
    """Return the frames of a message to the host: one, or pieces with their offsets, and a last one with the CRC."""
    if len(message) <= 6:
        return [Frame(EXTENDED | 8 << 8 | HOST, bytes((vesc, 0)) + message)]
    short, long = range(0, min(len(message), 256), 7), range(259, len(message), 6)
    frames = [Frame(EXTENDED | 5 << 8 | HOST, bytes((at,)) + message[at : at + 7]) for at in short]
    frames += [Frame(EXTENDED | 6 << 8 | HOST, struct.pack(">H", at) + message[at : at + 6]) for at in long]
    last = struct.pack(">BBHH", vesc, 1, len(message), crc_hqx(message, 0))
    return [*frames, Frame(EXTENDED | 7 << 8 | HOST, last)]


def answer(driver: Driver, vesc: int, message: bytes) -> None:
    for frame in pieces(vesc, message):
        driver.feed(frame, MS)


FIELDS = {
    "fet": (0, "h", 10), "motor_a": (2, "i", 100), "input_a": (3, "i", 100), "erpm": (7, "i", 1),
    "input_v": (8, "h", 10), "steps": (13, "i", 1), "fault": (15, "B", 1), "id": (17, "B", 1), "status": (21, "B", 1),
}  # fmt: skip
"""The bit of each value in the mask, its layout, and its counts per unit."""


def values(**named: float) -> bytes:
    """Return an answer to COMM_GET_VALUES_SELECTIVE."""
    parts = sorted((FIELDS[name], value) for name, value in named.items())
    data = b"".join(struct.pack(">" + layout, round(value * per_unit)) for (_, layout, per_unit), value in parts)
    return struct.pack(">BI", 50, sum(1 << bit for (bit, _, _), _ in parts)) + data


def version(major: int = 6, minor: int = 5) -> bytes:
    return bytes((0, major, minor)) + b"60\0"


def configuration(vesc: int, timeout_ms: int = 80, brake_a: float = 5.0) -> bytes:
    return struct.pack(">BIBIf", 17, 0xABCDEF01, vesc, timeout_ms, brake_a) + bytes(300)


def introduce(driver: Driver, timeout_ms: int = 80, brake_a: float = 5.0, major: int = 6) -> None:
    """Answer every question until none is left."""
    for _ in range(30):
        for frame in driver.ask():
            vesc, question = frame.id & 0xFF, frame.payload[2]
            mask = int.from_bytes(frame.payload[3:7], "big") if question == 50 else 0
            if question == 0:
                answer(driver, vesc, version(major))
            elif question == 17:
                answer(driver, vesc, configuration(vesc, timeout_ms, brake_a))
            elif question == 50:
                answer(driver, vesc, values(fault=0) if mask == 1 << 15 else values(status=1))


def settings_of(frames: Sequence[Frame], command: int) -> list[int]:
    """Return the numbers of a motor command to the four VESCs, in their order."""
    some = [frame for frame in frames if (frame.id & ~EXTENDED) >> 8 == command and frame.id & EXTENDED]
    assert [frame.id & 0xFF for frame in some] == list(IDS)
    return [struct.unpack(">i", frame.payload)[0] for frame in some]


def test_a_vesc_gets_electrical_revolutions_or_a_current() -> None:
    assert settings_of(make().command(SPEEDS, TORQUES, 0), 3) == [round(w * ERPM_PER_RAD_S) for w in SPEEDS]
    by_torque = make(mode=bench.TORQUE).command(STILL, TORQUES, 0)
    assert settings_of(by_torque, 1) == [round(n / bench.N_M_A * 1000) for n in TORQUES]
    assert settings_of(make().disarm(), 1) == [0] * 4
    assert settings_of(make().estop(), 2) == [round(bench.LIMIT_N_M / bench.N_M_A * 1000)] * 4
    assert settings_of(make().command((1e9,) * 4, STILL, 0), 3) == [2**31 - 1] * 4


MOTIONS = [(900, 30, 100, 1), (-900, 30, -100, -1), (0, 30, -5, -1), (-900, -30, -9, 1)]


@pytest.mark.parametrize(("erpm", "current", "duty", "torque_sign"), MOTIONS)
def test_a_vesc_says_what_its_motor_does(erpm: int, current: int, duty: int, torque_sign: int) -> None:
    driver = make()
    moves(driver, 2, erpm, current, duty)
    found = sample_of(driver)
    near(found.speed_rad_s, [erpm / ERPM_PER_RAD_S] * 4)
    near(found.current_a, [3.0 * torque_sign] * 4)
    near([*found.temperature_degc, found.battery_v, found.battery_a], [40.5] * 4 + [23.9, 10.0])
    moves(driver, 30, ids=(11, 12, 14))
    assert sample_of(driver).stamp_ns == 2 * MS
    driver.feed(Frame(EXTENDED | 9 << 8 | 13, bytes(7)), 40 * MS)
    assert sample_of(driver).stamp_ns == 2 * MS


@pytest.mark.parametrize("erpm", [600, -600, 6000])
@pytest.mark.parametrize("first", [0, 2**31 - 20, -(2**31) + 10])
def test_the_position_follows_the_speed_and_the_steps_over_their_wrap(erpm: int, first: int) -> None:
    driver = make({"status_hz": 100})
    begin = 0.0
    for ms in range(0, 2001, 10):
        true_steps = erpm / 60_000 * 6 * ms
        steps = (first + math.floor(true_steps) + 2**31) % 2**32 - 2**31
        moves(driver, ms, erpm, steps=steps)
        position = sample_of(driver).position_rad[0]
        begin = position if ms == 0 else begin
        assert position - begin == pytest.approx(true_steps * STEP_RAD, abs=1.6 * STEP_RAD)


def test_speeds_alone_move_the_position_up_to_a_step_and_not_over_a_gap() -> None:
    driver = make({"status_hz": 100})
    moves(driver, 0, erpm=0)
    status(driver, 9, "ihh", 600, 0, 1, t_ms=10)
    near(sample_of(driver).position_rad, [0.5 * 600 / 60 * 6 * 0.01 * STEP_RAD] * 4)
    status(driver, 9, "ihh", 600, 0, 1, t_ms=520)
    near(sample_of(driver).position_rad, [0.3 * STEP_RAD] * 4)


def test_values_that_come_no_more_are_unknown_and_steps_hold_the_sample_back() -> None:
    driver = make({"status_hz": 40})  # five periods: 125 ms
    moves(driver, 0)
    for t_ms, battery_v, stamp_ms in ((100, 23.9, 100), (125, 23.9, 125), (140, math.nan, 125), (300, math.nan, 125)):
        status(driver, 9, "ihh", 900, 30, 100, t_ms=t_ms)
        found = sample_of(driver)
        near([found.battery_v, found.battery_a], [battery_v, 10.0 if battery_v == battery_v else math.nan])
        assert found.stamp_ns == stamp_ms * MS


def test_a_vesc_is_asked_for_version_state_and_timeout_one_after_the_other() -> None:
    driver = make()
    assert "11, 12, 13, 14" in driver.missing
    asked = [{frame.id & 0xFF for frame in driver.ask()} for _ in range(8)]
    assert asked[::2] == [{11}, {12}, {13}, {14}], "each has two calls' time to answer"
    assert asked[1::2] == [set()] * 4
    introduce(driver)
    assert "status messages" in driver.missing
    assert driver.identity is None
    moves(driver, 1)
    assert driver.missing == ""
    assert "firmware 6.05" in (driver.identity or "")
    assert driver.capabilities.watchdog == "fixed"
    assert [words for words in driver.warnings if "timeout" in words] == []
    old = make()
    introduce(old, major=4)
    with pytest.raises(BadInputError, match=r"4\.05"):
        _ = old.identity


@pytest.mark.parametrize(
    ("timeout_ms", "brake_a", "warning"),
    [(100, 5.0, ""), (101, 5.0, "longer than"), (0, 5.0, "is 0"), (10, 5.0, "no longer than"), (80, 0.04, "rolls")],
)  # fmt: skip
def test_the_timeout_of_a_vesc_is_its_watchdog_if_short_enough(timeout_ms: int, brake_a: float, warning: str) -> None:
    driver = make()
    introduce(driver, timeout_ms, brake_a)
    assert driver.capabilities.watchdog == ("fixed" if 0 < timeout_ms <= 1000 * bench.WATCHDOG_S else "none")
    found = [words for words in driver.warnings if "timeout" in words]
    assert len(found) == bool(warning)
    assert all(warning in words and "11, 12, 13, 14" in words for words in found)


def test_a_vesc_is_armed_while_it_reports_neither_fault_nor_kill_switch() -> None:
    driver = make()
    introduce(driver)
    moves(driver, 1)
    driver.arm(0)
    assert not driver.is_armed, "faults are asked for anew"
    for vesc in IDS:
        answer(driver, vesc, values(fault=0))
    assert settings_of(driver.arm(10 * MS), 3) == [0] * 4
    assert driver.is_armed
    hot = "fault 5: over temperature of the MOSFETs"
    for said, words in (({"fault": 5}, hot), ({"fault": 99}, "fault 99"), ({"status": 2}, "kill switch")):
        answer(driver, 13, values(**said))
        assert not driver.is_armed
        assert [error.startswith("VESC 13 of wheel rr") and words in error for error in driver.errors] == [True]
        answer(driver, 13, values(fault=0))
        answer(driver, 13, values(status=0))
        assert driver.errors == []
        driver.arm(20 * MS)
        assert driver.is_armed
    sent = [frame for turn in range(8) for frame in driver.command(STILL, STILL, (30 + turn) * MS)]
    asked = [(frame.id & 0xFF, frame.payload) for frame in sent if (frame.id & ~EXTENDED) >> 8 == 8]
    assert len(asked) == 16
    questions = [struct.pack(">BBBI", HOST, 0, 50, 1 << bit) for bit in (15, 21)]
    assert {*asked} == {*itertools.product(IDS, questions)}
    for vesc in IDS[:3]:
        answer(driver, vesc, values(fault=0))
    driver.command(STILL, STILL, 1005 * MS)
    assert driver.errors == []
    driver.command(STILL, STILL, 1050 * MS)
    assert [error[:21] for error in driver.errors] == ["VESC 14 of wheel rl h"]
    driver.restart()
    introduce(driver)
    moves(driver, 2000)
    driver.arm(2010 * MS)
    assert not driver.is_armed, "it is a new arming"
    answer(driver, 12, values(status=0))


def test_a_long_answer_counts_if_its_pieces_are_all_there() -> None:
    for spoil in (None, 3, 40):
        driver = make()
        for frame in driver.ask():
            question = frame.payload[2]
            answer(driver, 11, version() if question == 0 else values(fault=0) if question == 50 else b"\0\0")
        before = driver.warnings
        for number, frame in enumerate(pieces(11, configuration(11))):
            if number != spoil:
                driver.feed(frame, MS)
        assert (driver.warnings != before) == (spoil is None)


# A serial line: 02 length payload CRC 03, and one VESC that forwards to the others


def packet(message: bytes) -> bytes:
    head = bytes((2, len(message))) if len(message) < 256 else struct.pack(">BH", 3, len(message))
    return head + message + struct.pack(">H", crc_hqx(message, 0)) + b"\3"


@pytest.mark.parametrize("size", [1, 5, 255, 256, 512])
def test_packets_of_a_line_are_found_among_noise(size: int) -> None:
    framing = SerialFraming()
    message = (bytes(range(1, 256)) * 3)[:size]
    good = packet(message)
    assert framing.encode(Frame(message[0], message[1:])) == good
    damaged = bytearray(good)
    damaged[-3] ^= 1
    data = b"\x07\x09" + good + bytes(damaged) + b"\xff" * 520 + good
    found = [frame for byte in bench.each_byte(data) for frame in framing.feed(byte)]
    assert found == [Frame(message[0], message[1:])] * 2
    assert framing.rejected["stray"] >= 2
    assert framing.rejected["checksum"] >= 1
    for wrong in (packet(b"")[:1] + b"\0", good[:-1] + b"\4" + b"\xff" * 520):
        assert SerialFraming().feed(wrong) == []


def test_over_a_line_a_vesc_forwards_what_is_for_another() -> None:
    driver = make(wire="serial")
    near_one, *others = driver.command(SPEEDS, STILL, 0)[:4]
    numbers = [struct.pack(">i", round(w * ERPM_PER_RAD_S)) for w in SPEEDS]
    assert near_one == Frame(8, numbers[0])
    assert others == [Frame(34, bytes((vesc, 8)) + data) for vesc, data in zip(IDS[1:], numbers[1:], strict=True)]
    asked = [frame for turn in range(3) for frame in driver.command(STILL, STILL, turn)[4:]]
    assert [frame.id for frame in asked] == [50, 34] * 3
    assert {frame.payload[0] for frame in asked[1::2]} == {12, 13, 14}
    for vesc, erpm in zip(IDS, (900, -900, 600, 0), strict=True):
        measured = values(fet=40.5, motor_a=-3.0, input_a=2.5, erpm=erpm, input_v=23.9, steps=0, fault=0, id=vesc)
        driver.feed(Frame(measured[0], measured[1:]), 5 * MS)
    found = sample_of(driver)
    near(found.speed_rad_s, [erpm / ERPM_PER_RAD_S for erpm in (900, -900, 600, 0)])
    near([*found.current_a, found.battery_v, found.battery_a], [-3.0, 3.0, -3.0, -3.0, 23.9, 10.0])
    stop = b"".join(SerialFraming().encode(frame) for frame in driver.last_stop())
    one = b"".join(SerialFraming().encode(frame) for frame in driver.estop())
    assert stop == one * (len(stop) // len(one))
    assert len(stop) > LONGEST_PACKET
