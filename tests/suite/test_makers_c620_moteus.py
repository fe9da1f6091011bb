"""The drivers for C620 and moteus against frames made by hand from their makers' descriptions: units, signs, stops.

Each driver's docstring names its sources.
"""

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.types import CommandMode, FourWheels
from hil.robot.driver import EXTENDED, Driver
from tests.suite import driver_bench as bench
from tests.suite.driver_bench import MS, SPEEDS, STILL, TORQUES, feed, found_by, make, near, sample_of

# C620: currents in 1/16384 of 20 A, 0x200 for motors 1 to 4, 0x1FF for 5 to 8; the gear is 3591 / 187

C620_GEAR = 3591 / 187
C610 = {"controller": "c610"}
IDS = (1, 2, 3, 4)


def c620_says(
    driver: Driver, t_ms: float, angle: int = 0, rpm: int = 0, count: int = 0, degc: int = 30, ids: Sequence[int] = IDS
) -> None:
    for number in ids:
        feed(driver, 0x200 + number, ">HhhBx", angle % 8192, rpm, count, degc, t_ms=t_ms)


@pytest.mark.parametrize(("controller", "per_a", "most"), [("c620", 819.2, 16384), ("c610", 1000.0, 10000)])
def test_a_c620_gets_the_current_of_a_torque_within_its_range(controller: str, per_a: float, most: int) -> None:
    driver = make("c620", {"controller": controller, "ids": [2, 5, 1, 8]}, bench.TORQUE)
    low, high = driver.command(STILL, TORQUES, 0)
    a, b, c, d = (round(torque / bench.N_M_A * per_a) for torque in TORQUES)
    assert low == Frame(0x200, struct.pack(">4h", c, a, 0, 0))
    assert high == Frame(0x1FF, struct.pack(">4h", b, 0, 0, d))
    low, high = driver.command(STILL, (1e3, -1e3, 1e3, -1e3), 0)
    assert (struct.unpack(">4h", low.payload)[1], struct.unpack(">4h", high.payload)[0]) == (most, -most)
    for stop in (driver.disarm(), driver.estop(), driver.arm(0)):
        assert [frame.payload for frame in stop] == [bytes(8)] * 2


@pytest.mark.parametrize(("settings", "gear"), [({}, C620_GEAR), (C610, 36), ({"gear_ratio": 10}, 10)])
def test_a_c620_says_what_its_rotor_does(settings: Mapping[str, Any], gear: float) -> None:
    driver = make("c620", settings)
    full, amperes = (10000, 10.0) if settings.get("controller") == "c610" else (16384, 20.0)
    c620_says(driver, 1, rpm=-1200, count=-full // 4, degc=40)
    found = sample_of(driver)
    near(found.speed_rad_s, [-1200 / 60 * math.tau / gear] * 4)
    near(found.current_a, [-amperes / 4] * 4)
    near(found.temperature_degc, [40.0] * 4)
    assert found.stamp_ns == MS
    assert math.isnan(found.battery_v)
    driver.feed(Frame(0x201, bytes(7)), 5 * MS)
    c620_says(driver, 9, ids=(1, 2, 3))
    assert sample_of(driver).stamp_ns == MS, "as old as the oldest"


@pytest.mark.parametrize(
    ("together", "rpm", "lost"), [(1, 900, 0), (10, 8000, 0), (5, -8250, 0), (1, 7000, 15), (4, -6000, 8)]
)
def test_a_c620_s_turns_are_counted_also_of_frames_that_came_together(together: int, rpm: int, lost: int) -> None:
    driver = make("c620")
    first: float | None = None
    last_ms = 0
    for ms in range(1, 401):
        read_ms = -(-ms // together) * together
        if 150 <= ms < 150 + lost:
            continue
        c620_says(driver, read_ms, angle=round(rpm / 60_000 * ms * 8192), rpm=rpm)
        if ms % together == 0:
            first = sample_of(driver).position_rad[0] if first is None else first
            last_ms = ms
    turned = sample_of(driver).position_rad[0] - (first or 0.0)
    assert turned == pytest.approx(rpm / 60_000 * (last_ms - together) * math.tau / C620_GEAR, abs=0.01)


def torques_of(frames: Sequence[Frame]) -> list[float]:
    return [count / 819.2 * bench.N_M_A for count in struct.unpack(">4h", frames[0].payload)]


def test_the_speed_loop_for_a_c620_has_its_gains_limit_and_no_windup() -> None:
    driver = make("c620", {"kp_n_m_s_rad": 0.5, "ki_n_m_rad": 10.0})
    c620_says(driver, 0)
    driver.arm(0)
    ahead: FourWheels = (0.1, 0.0, -0.1, 0.2)
    near_ahead = pytest.approx([0.5 + 0.1, -1.0, 1.5 - 0.1, -2.0 + 0.2], abs=1e-3)
    assert torques_of(driver.command(SPEEDS, ahead, 0)) == near_ahead
    integrated = [10.0 * speed * bench.PERIOD_S for speed in SPEEDS]
    for step in range(1, 4):
        found = torques_of(driver.command(SPEEDS, STILL, step * 10 * MS))
        assert found == pytest.approx([0.5 * w + step * i for w, i in zip(SPEEDS, integrated, strict=True)], abs=1e-3)
    c620_says(driver, 40)
    stalled = torques_of(driver.command(SPEEDS, STILL, 90 * MS))  # after a stall it integrates over two periods
    assert stalled[0] == pytest.approx(0.5 + 4 * 0.1, abs=1e-3)
    after = torques_of(driver.command(SPEEDS, STILL, 100 * MS))
    assert after[0] == pytest.approx(0.5 + 6 * 0.1, abs=1e-3)
    fast: FourWheels = (30.0, -30.0, 30.0, -30.0)
    for step in range(11, 13):
        assert torques_of(driver.command(fast, STILL, step * 10 * MS)) == pytest.approx([4, -4, 4, -4], abs=1e-3)
    c620_says(driver, 120)
    assert torques_of(driver.command(STILL, STILL, 130 * MS))[0] == pytest.approx(0.7, abs=1e-3), "no windup"
    assert torques_of(driver.command(SPEEDS, STILL, 221 * MS)) == [0.0] * 4, "too old a speed"
    c620_says(driver, 230)
    assert torques_of(driver.command(SPEEDS, STILL, 230 * MS))[0] == pytest.approx(0.5, abs=1e-3)
    driver.arm(240 * MS)
    assert torques_of(driver.command(SPEEDS, STILL, 240 * MS))[0] == pytest.approx(0.5, abs=1e-3), "armed anew"


def test_a_c620_is_there_when_all_four_were_heard_and_hot_beyond_its_limit() -> None:
    driver = make("c620", {"temperature_limit_degc": 80})
    c620_says(driver, 0, ids=(1, 2, 4))
    driver.arm(0)
    assert (driver.identity, driver.sample, driver.is_armed) == (None, None, False)
    assert "motors 3;" in driver.missing
    c620_says(driver, 0, degc=80)
    driver.arm(0)
    assert (driver.missing, driver.is_armed, driver.errors) == ("", True, [])
    c620_says(driver, 1, degc=81, ids=(2,))
    assert [words[:20] for words in driver.errors] == ["motor 2 of wheel fr "]
    driver.disarm()
    assert not driver.is_armed
    driver.restart()
    assert (driver.sample, driver.identity) == (None, None)


# moteus: registers in revolutions at the output; a command has mode, position, speed, torque, limit and timeout

MOTEUS_GEAR = 6.0
LIMITS = bench.LIMIT_N_M / MOTEUS_GEAR, bench.WATCHDOG_S  # registers 0x25 and 0x27


def moteus(mode: CommandMode = bench.SPEED, **settings: Any) -> Driver:
    return make("moteus", {"gear_ratio": MOTEUS_GEAR} | settings, mode, "can_fd")


def moteus_says(driver: Driver, t_ms: float = 1.0, mode: int = 10, ids: Sequence[int] = IDS, fault: int = 0) -> None:
    state = struct.pack("<BBb", 0x21, 0x00, mode) + struct.pack("<BBff", 0x2E, 0x01, 1.5, -0.75)
    state += struct.pack("<BBf", 0x2D, 0x04, -3.5) + struct.pack("<BBhhh", 0x27, 0x0D, 243, 412, fault)
    state += struct.pack("<BBf", 0x2D, 0x27, bench.WATCHDOG_S)
    for number in ids:
        driver.feed(Frame(EXTENDED | number << 8, state), round(t_ms * MS))


def moteus_introduces(driver: Driver, register_map: int = 5) -> None:
    for number in IDS:
        payload = struct.pack("<BBB", 0x2B, 0x80, 0x02) + struct.pack("<iii", 0x20, 0x10A, register_map)
        driver.feed(Frame(EXTENDED | number << 8, payload), 0)


def written(frame: Frame) -> dict[int, float]:
    """Return the registers that a frame to a moteus writes."""
    found: dict[int, float] = {}
    data, at = frame.payload, 0
    while at < len(data) and data[at] != 0x50:
        code = data[at]
        count, kind = code & 3, code >> 2 & 3
        at += 1
        if not count:
            count, at = data[at], at + 1
        first, at = data[at], at + 1
        if first & 0x80:
            first, at = first & 0x7F | data[at] << 7, at + 1
        for register in range(first, first + count if code & 0xF0 == 0 else first):
            found[register] = struct.unpack_from("<" + "bhif"[kind], data, at)[0]
            at += (1, 2, 4, 4)[kind]
    return found


def test_a_moteus_gets_speed_torque_limit_and_timeout_at_its_output() -> None:
    driver = moteus(can_prefix=3)
    frames = driver.command(SPEEDS, TORQUES, 0)
    assert [frame.id for frame in frames] == [EXTENDED | 3 << 16 | 0x8000 | number for number in IDS]
    for frame, speed, torque in zip(frames, SPEEDS, TORQUES, strict=True):
        registers = written(frame)
        assert registers[0x00] == 10
        assert math.isnan(registers[0x20]), "a speed alone"
        near([registers[number] for number in (0x21, 0x22, 0x25, 0x27)],
             [speed * MOTEUS_GEAR / math.tau, torque / MOTEUS_GEAR, *LIMITS])  # fmt: skip
    for frame, torque in zip(moteus(bench.TORQUE).command(STILL, TORQUES, 0), TORQUES, strict=True):
        registers = written(frame)
        near([registers[number] for number in (0x21, 0x22, 0x23, 0x24, 0x25, 0x27, 0x2B)],
             [0.0, torque / MOTEUS_GEAR, 0.0, 0.0, *LIMITS, 0.0])  # fmt: skip


def test_a_moteus_says_what_its_output_does() -> None:
    driver = moteus()
    moteus_says(driver, 3)
    found = sample_of(driver)
    near(found.speed_rad_s, [-0.75 * math.tau / MOTEUS_GEAR] * 4)
    near(found.position_rad, [1.5 * math.tau / MOTEUS_GEAR] * 4)
    near([*found.current_a, *found.temperature_degc, found.battery_v], [-3.5] * 4 + [41.2] * 4 + [24.3])
    moteus_says(driver, 9, ids=(1, 2, 4))
    assert sample_of(driver).stamp_ns == 3 * MS
    driver.feed(Frame(EXTENDED | 3 << 8 | 1, b""), 20 * MS)
    driver.feed(Frame(EXTENDED | 3 << 8, struct.pack("<BBff", 0x2E, 0x01, math.nan, 0.0)), 20 * MS)
    assert sample_of(driver).stamp_ns == 3 * MS, "not for us, and no number"


def test_a_moteus_is_armed_in_its_mode_with_its_watchdog_and_is_not_rearmed_from_a_fault() -> None:
    driver = moteus()
    assert "1, 2, 3, 4" in driver.missing
    moteus_introduces(driver)
    assert (driver.missing, driver.identity is not None) == ("", True)
    moteus_says(driver, mode=0)
    assert {written(frame)[0x00] for frame in driver.arm(0)} == {10}
    assert {written(frame)[0x21] for frame in driver.arm(0)} == {0.0}
    assert not driver.is_armed
    moteus_says(driver, mode=10, ids=(1, 2, 3))
    driver.arm(0)
    assert not driver.is_armed
    moteus_says(driver, mode=10)
    driver.arm(0)
    assert driver.is_armed
    for mode, words in ((0, []), (11, ["mode 11"]), (1, ["fault 38: over temperature"])):
        moteus_says(driver, mode=10)
        driver.arm(0)
        moteus_says(driver, mode=mode, ids=(3,), fault=38)
        assert not driver.is_armed
        for one, error in zip(words, driver.errors, strict=True):
            assert one in error
            assert "moteus 3 of wheel rr" in error
    assert all(not written(frame) for frame in driver.arm(0)), "in fault it is only asked"
    moteus_introduces(driver, 4)
    assert driver.identity is not None
    moteus_introduces(driver, 9)
    with pytest.raises(BadInputError, match="register map"):
        _ = driver.identity


def test_a_stop_of_a_moteus_spares_a_fault_and_its_e_stop_lasts() -> None:
    driver = moteus()
    moteus_says(driver, mode=10)
    driver.arm(0)
    moteus_says(driver, mode=1, ids=(2,))
    assert [written(frame).get(0x00) for frame in driver.disarm()] == [0, None, 0, 0]
    for registers in map(written, driver.estop()):
        near([registers[number] for number in (0x00, 0x21, 0x22, 0x27)], [10, 0.0, 0.0, 0.001])
    moteus_says(driver, mode=11)
    assert len(driver.errors) == 4
    assert all(not written(frame) for frame in driver.disarm()), "a stop would end the e-stop"
    assert not driver.is_armed
    first, last = driver.clear()[:4], driver.clear()[4:]
    assert [written(frame) for frame in first] == [{0x00: 0}] * 4
    assert [written(frame) for frame in last] == [{}] * 4


# Probes: what is on the bus, without moving anything


def test_a_probe_hears_a_c620_by_its_feedback() -> None:
    c620 = bench.make_probe("c620")
    assert (c620.ask(), c620.found(), c620.patience_s) == ((), None, 0.0)
    for number, angle, is_one in ((4, 8191, True), (8, 0, True), (1, 8192, False), (9, 0, False), (0, 0, False)):
        assert c620.feed(Frame(0x200 + number, struct.pack(">Hhhxx", angle, 1, 2))) is is_one
    found = found_by(c620)
    assert [sentence[-1] for sentence in found.sentences] == ["4", "8"]
    assert found.motors is None
    for number in (1, 6):
        c620.feed(Frame(0x200 + number, bytes(8)))
    found = found_by(c620)
    assert found.motors == {"ids": [1, 4, 6, 8]}


def test_a_probe_asks_every_moteus_and_knows_it_by_model_and_firmware() -> None:
    moteus_probe = bench.make_probe("moteus")
    assert {frame.id for frame in moteus_probe.ask()} == {EXTENDED | 0x8000 | number for number in range(1, 127)}
    identity = struct.pack("<BBBiii", 0x2B, 0x80, 0x02, 0x20, 0x10A, 5)
    for number, to, is_one in ((7, 0, True), (9, 1, False), (127, 0, False)):
        assert moteus_probe.feed(Frame(EXTENDED | number << 8 | to, identity)) is is_one
    assert moteus_probe.feed(Frame(EXTENDED | 8 << 8, struct.pack("<BBb", 0x21, 0x00, 0))) is False
    for number in (1, 2, 3):
        moteus_probe.feed(Frame(EXTENDED | number << 8, identity))
    found = found_by(moteus_probe)
    assert found.motors == {"ids": [1, 2, 3, 7]}
    assert "model 0x20, firmware 0x10a" in found.sentences[0]
