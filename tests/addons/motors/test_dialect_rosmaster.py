"""Yahboom Rosmaster: worked frames, the driver with the emulated board, and how each handles bad input."""

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.addons.motors.rosmaster.rosmaster_driver import PAUSE
from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist, wheel_speeds
from hil.core.options import build
from hil.core.types import FourWheels
from hil.robot.driver import RobotFacts
from hil.robot.driver_registry import dialect
from tests.support.dialect_testbed import STILL, Rig, assert_near, ramp_to
from tests.support.examples import share_of_examples

X3 = (0.204203 / (2 * 3.141592653589793), 0.164555)  # the firmware's wheel radius and lever
FORWARD = (8.0, 8.0, 8.0, 8.0)
EVERY_WAY: tuple[FourWheels, ...] = (FORWARD, (-6.0, 6.0, -6.0, 6.0), (-5.0, 5.0, 5.0, -5.0), (2.0, 8.0, 5.0, 5.0))


def rig(options: dict[str, Any] | None = None, **keywords: Any) -> Rig:
    """A robot with the battery of such a board, which switches itself off with the paper's."""
    return Rig("rosmaster", options, **{"plant.start.battery_voltage_v": 12.0} | keywords)


def armed(options: dict[str, Any] | None = None, **keywords: Any) -> Rig:
    made = rig(options, **keywords)
    made.greet()
    made.arm()
    return made


def report(number: int, payload: str) -> Frame:
    return Frame(number, bytes.fromhex(payload))


def motion_of(frame: Frame) -> tuple[int, ...]:
    assert frame.id == 0x12
    return struct.unpack("<B3h", frame.payload)


def test_a_worked_command_and_the_stop_are_the_makers_bytes() -> None:
    """An X3 with (0.5 m/s, -0.2 m/s, 1 rad/s), and the two frames of a stop: dialects facts 5."""
    made = armed()
    line = dialect("rosmaster").make_framing
    assert line is not None
    [command] = made.driver.command(wheel_speeds(BodyTwist(0.5, -0.2, 1.0), *X3), STILL, made.now_ns + 10**9)
    assert line().encode(command) == bytes.fromhex("FFFC0A1201F40138FFE80334") + PAUSE
    zeros, reset = made.driver.disarm()
    assert line().encode(zeros) == bytes.fromhex("FFFC0A12010000000000001D") + PAUSE
    assert line().encode(reset) == bytes.fromhex("FFFC040F5F72") + PAUSE


def test_worked_reports_are_read() -> None:
    """(0.5, -0.2, 1) at 12.1 V; M1 to M4 are FL, RL, FR, RR; an ICM20948's yaw rate 0.25 rad/s and 9.81 m/s² up."""
    made = rig()
    driver = made.driver
    driver.feed(report(0x0A, "F40138FFE80379"), 7)
    driver.feed(report(0x0D, "00000000 00000000 00000000 00000000"), 8)
    driver.feed(report(0x0D, "28050000 500A0000 D8FAFFFF 4A010000"), 9)
    driver.feed(report(0x0E, "0000 0000 FA00 0000 0000 5226 0000 0000 0000"), 10)
    sample = driver.sample
    assert sample is not None
    assert sample.stamp_ns == 7
    assert_near(sample.speed_rad_s, wheel_speeds(BodyTwist(0.5, -0.2, 1.0), *X3), 1e-3)
    assert_near([angle / 6.283185307 for angle in sample.position_rad], (1.0, -1.0, 0.25, 2.0), 1e-9)
    assert (sample.battery_v, sample.yaw_rate_rad_s) == (12.1, 0.25)
    assert sample.acceleration_m_s2 == (0.0, 0.0, 9.81)
    driver.feed(report(0x0B, "0000 0000 56F1 0000 0000 1040 0000 0000 0000"), 11)  # an MPU9250 turns the other way
    assert driver.sample is not None
    assert driver.sample.yaw_rate_rad_s == pytest.approx(1.0, abs=1e-3)
    assert driver.sample.acceleration_m_s2[2] == pytest.approx(9.81, abs=0.01)


def test_reports_that_ceased_are_not_taken_for_news() -> None:
    """Without the gyro's the yaw rate is not known; without the encoders' the sample grows old."""
    driver = rig().driver
    driver.feed(report(0x0A, "F40138FFE80379"), 0)
    assert driver.sample is None, "odometry would leap when the encoders are heard"
    driver.feed(report(0x0D, "00000000 00000000 00000000 00000000"), 0)
    driver.feed(report(0x0E, "0000 0000 FA00 0000 0000 5226 0000 0000 0000"), 0)
    found = []
    for milliseconds in (240, 260, 300):
        driver.feed(report(0x0A, "F40138FFE80379"), milliseconds * 1_000_000)
        assert driver.sample is not None
        found.append((driver.sample.stamp_ns // 1_000_000, driver.sample.yaw_rate_rad_s == 0.25))
    assert found == [(240, True), (250, False), (250, False)]


@pytest.mark.parametrize(("options", "target"), list(zip(({}, {"car": "x3_plus"}, {}, {}), EVERY_WAY, strict=True)))
def test_wheels_reach_their_speeds_whatever_the_firmware_thinks_of_their_size(
    options: dict[str, object], target: FourWheels
) -> None:
    made = armed(options)
    made.drive(1.0, ramp_to(target, 0.3))
    assert_near(made.speeds(), target, 0.15)
    begin = made.driver.sample
    assert begin is not None
    assert_near(begin.speed_rad_s, made.speeds(), 0.6)
    made.drive(0.4, lambda _t: (target, STILL))
    assert made.driver.sample is not None
    turned = [b - a for a, b in zip(begin.position_rad, made.driver.sample.position_rad, strict=True)]
    assert_near(turned, [0.4 * speed for speed in target], 0.1)


def test_wheels_turn_for_ever_when_commands_end_and_the_stop_ends_that() -> None:
    made = armed()
    assert made.driver.capabilities.watchdog == "none"
    assert made.driver.warnings[0] == (
        "when commands end a Rosmaster drives on for ever with the last one: if this computer loses power, hangs, or "
        "loses the cable, nothing stops the robot; keep its power switch within reach"
    )
    made.drive(1.0, ramp_to(FORWARD, 0.3))
    made.step(ticks=3000)
    assert_near(made.speeds(), FORWARD, 0.1)
    made.step(made.driver.estop(), ticks=1500)
    assert made.is_still()
    assert not made.driver.is_armed
    made.step(made.driver.command(FORWARD, STILL, made.now_ns), ticks=200)
    assert made.is_still()


def test_two_stops_without_a_pause_can_both_be_lost_and_with_the_lines_pause_none_is() -> None:
    """The board has one receive buffer, so it depends on when it looks: in twelve bytes it does at least once."""

    def goes_on(phase: int, pause: bytes) -> bool:
        made = driving
        made.drive(0.02, lambda _t: (FORWARD, STILL))
        made.step(ticks=10)
        made.node.feed(bytes(phase) + b"".join(line.encode(frame).removesuffix(PAUSE) + pause for frame in stops))
        made.step(ticks=12)
        return made.node.is_driving

    driving = armed()
    make_framing = dialect("rosmaster").make_framing
    assert make_framing is not None
    line = make_framing()
    stops = Frame(0x12, bytes([1, 0, 0, 0, 0, 0, 0])), Frame(0x0F, b"\x5f")
    assert any(goes_on(phase, b"") for phase in range(12))
    assert not any(goes_on(phase, PAUSE) for phase in range(12))


def test_a_stop_is_obeyed_wherever_a_command_was_cut() -> None:
    """As when the host dies in the middle of a frame."""
    make_framing = dialect("rosmaster").make_framing
    assert make_framing is not None
    line = make_framing()
    made = armed()
    command, *_ = made.driver.command(FORWARD, STILL, made.now_ns + 10**9)
    for cut in range(12):
        made.node.feed(line.encode(command))
        made.step(ticks=10)
        assert made.node.is_driving
        made.node.feed(line.encode(command)[:cut])
        made.step(made.driver.disarm(), ticks=10)
        assert not made.node.is_driving


def test_a_board_that_still_drives_is_stopped_before_it_counts_as_armed() -> None:
    made = armed()
    made.drive(1.0, ramp_to(FORWARD, 0.3))
    made.driver.restart()
    assert not made.driver.is_armed
    made.greet()
    made.step(made.driver.arm(made.now_ns))
    assert not made.driver.is_armed
    made.arm()
    assert max(map(abs, made.speeds())) < 0.6
    assert all(not any(motion_of(frame)[1:]) for frame in made.sent[-3:] if frame.id == 0x12)


def test_a_command_beyond_the_boards_limit_is_scaled_and_keeps_its_direction() -> None:
    made = armed()
    [frame] = made.driver.command((20.0, 60.0, 40.0, 40.0), STILL, made.now_ns + 10**9)
    _, x, y, turn = motion_of(frame)
    rims = (x - y - turn * X3[1], x + y + turn * X3[1])
    assert rims[1] == pytest.approx(1000.0, abs=2.0)
    assert rims[0] == pytest.approx(1000.0 / 3, abs=2.0)


def test_commands_leave_room_on_the_line_for_their_pause() -> None:
    made = armed()
    begin = made.now_ns + 10**9
    sent = [made.driver.command(FORWARD, STILL, begin + tick * 1_000_000) for tick in range(9)]
    assert [len(frames) for frames in sent] == [1, 0, 0, 0, 1, 0, 0, 0, 1]


def test_a_battery_that_makes_the_board_switch_itself_off_is_told_before_it_does() -> None:
    made = armed(**{"plant.start.battery_voltage_v": 9.45})
    made.drive(1.0, ramp_to(FORWARD, 0.3))
    assert made.driver.is_armed
    made.drive(0.8, lambda _t: (FORWARD, STILL))
    [error] = made.driver.errors
    assert error.startswith("the battery of the Rosmaster has 9.4 V")
    assert not made.driver.is_armed
    assert motion_of(made.sent[-1]) == (1, 0, 0, 0)
    made.step(ticks=500)
    made.heard.clear()
    made.step([Frame(0x12, struct.pack("<B3h", 1, 300, 0, 0))], ticks=500)
    assert not made.node.is_driving
    assert made.heard == []


@pytest.mark.parametrize(
    ("version", "car_number", "words"),
    [
        (
            (2, 4),
            1,
            r"^the Rosmaster board has firmware 2\.4, and this driver knows 3\.x; load that, as Yahboom's page of the "
            "board says$",
        ),
        ((3, 5), 2, r'set to X3 PLUS, and device.motors.car is .x3.; write device.motors.car = "x3_plus"'),
        ((3, 5), 5, "set to car of type 5"),
    ],
)
def test_a_board_that_cannot_be_driven_is_refused(version: tuple[int, int], car_number: int, words: str) -> None:
    made = rig()
    made.node.version, made.node.car_number = version, car_number
    with pytest.raises(BadInputError, match=words):
        made.greet()


def test_what_has_not_answered_is_named() -> None:
    driver = rig().driver
    assert driver.missing.startswith("the Rosmaster board has not reported its version and its car;")
    driver.feed(report(0x51, "0305"), 0)
    assert driver.missing.startswith("the Rosmaster board has not reported its car;")


@pytest.mark.parametrize("wiring", [((1, 0, 2, 3), (1, 1, 1, 1)), ((0, 1, 2, 3), (1, -1, 1, 1))])
def test_a_wiring_of_the_wheels_is_refused(wiring: tuple[Any, Any]) -> None:
    facts: RobotFacts = RIG.facts._replace(wheel_of_channel=wiring[0], sign_of_channel=wiring[1])
    with pytest.raises(BadInputError, match="knows itself how its wheels are wired; remove both keys"):
        dialect("rosmaster").make(build(dialect("rosmaster").settings, {}, "device.motors"), facts)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"battery_low_v": 14.0}, "less than battery_high_v"),
        ({"car": "x1"}, '"x3" or "x3_plus"'),
    ],
)
def test_settings_that_cannot_be_are_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        build(dialect("rosmaster").settings, options, "device.motors")


@share_of_examples(0.5)
@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=8))
def test_counts_go_on_beyond_their_32_bits(steps: list[int]) -> None:
    driver = RIG.driver
    driver.restart()
    driver.feed(report(0x0A, "00000000000078"), 0)
    total = 0
    driver.feed(Frame(0x0D, bytes(16)), 0)
    for step in steps:
        total += step
        raw = total & 0xFFFF_FFFF
        driver.feed(Frame(0x0D, struct.pack("<4I", raw, 0, 0, 0)), 0)
    assert driver.sample is not None
    assert driver.sample.position_rad[0] == pytest.approx(total / 1320 * 6.283185307179586)


@share_of_examples(0.5)
@given(st.integers(0, 255), st.binary(max_size=32))
def test_no_frame_is_too_strange(number: int, payload: bytes) -> None:
    driver = RIG.driver
    driver.restart()
    driver.feed(Frame(number, payload), 0)
    assert not driver.is_armed
    assert driver.sample is None or (number == 0x0A and len(payload) == 7)


@share_of_examples(0.5)
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=29)), max_size=6), st.binary(max_size=40), st.data())
def test_frames_come_out_of_any_pieces_and_noise_is_counted(
    sent: list[tuple[int, bytes]], noise: bytes, data: st.DataObject
) -> None:
    made = dialect("rosmaster").make_framing
    assert made is not None
    line = made()
    whole = b"".join(from_board(number, payload) for number, payload in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=5)))
    heard: list[Frame] = []
    for begin, end in zip([0, *cuts], [*cuts, len(whole)], strict=True):
        heard += line.feed(whole[begin:end])
    assert heard == [Frame(*pair) for pair in sent]
    assert not any(line.rejected.values())
    line.feed(noise)
    line.feed(bytes(40))
    [last] = line.feed(from_board(0x51, b"\3\5"))[-1:]
    assert last == Frame(0x51, b"\3\5")


@share_of_examples(0.5)
@given(st.binary(min_size=3, max_size=8), st.integers(0, 7), st.integers(1, 255))
def test_a_damaged_byte_costs_its_frame_alone(payload: bytes, at: int, damage: int) -> None:
    made = dialect("rosmaster").make_framing
    assert made is not None
    line = made()
    damaged = bytearray(from_board(0x0A, payload))
    damaged[at % len(damaged)] ^= damage
    heard = line.feed(bytes(damaged) + bytes(40) + from_board(0x51, b"\3\5"))
    assert heard[-1] == Frame(0x51, b"\3\5")
    assert Frame(0x0A, payload) not in heard
    assert any(line.rejected.values())


def from_board(number: int, payload: bytes) -> bytes:
    """Frame a report as the maker's library expects it: the sum of all after FF FB."""
    body = [len(payload) + 3, number, *payload]
    return bytes([0xFF, 0xFB, *body, sum(body) % 256])


def test_a_probe_reads_version_and_car_and_sends_questions_alone() -> None:
    made = rig({"car": "x3_plus"})
    make = dialect("rosmaster").probe
    assert make is not None
    probe = make()
    for _ in range(2):
        asked = probe.ask()
        assert all(frame.id == 0x50 for frame in asked)
        made.step(asked, ticks=10)
    assert probe.found() is None
    for frame in made.heard:
        probe.feed(frame)
    found = probe.found()
    assert found is not None
    assert found.motors == {"car": "x3_plus"}
    assert found.sentences[0] == "a Rosmaster board, firmware 3.5, set to X3 PLUS"
    assert found.known["robot.wheel_radius_m"] == pytest.approx(0.04, rel=1e-4)
    assert made.is_still()


RIG = rig()
