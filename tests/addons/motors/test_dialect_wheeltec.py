"""WHEELTEC C50X: worked frames, the driver before the emulated base over both its wires, and what is wrong."""

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.addons.motors.wheeltec.wheeltec_driver import IN_STEP
from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist, wheel_speeds
from hil.core.options import build
from hil.core.types import FourWheels
from hil.robot.driver_registry import dialect
from tests.support.dialect_testbed import STILL, Rig, assert_near, ramp_to
from tests.support.examples import share_of_examples

FORWARD = (8.0, 8.0, 8.0, 8.0)
EVERY_WAY: tuple[FourWheels, ...] = (FORWARD, (-6.0, 6.0, -6.0, 6.0), (-5.0, 5.0, 5.0, -5.0), (2.0, 8.0, 5.0, 5.0))
REPORT = bytes.fromhex("7B00 01F4FF3803E8 00000000 4169 00000000 0EAB 5DC0")
"""(0.5 m/s, -0.2 m/s, 1 rad/s), 1 g up, 1 rad/s about the vertical, 24 V; without its sum and its end."""


class CanRig(Rig):
    """The same over CAN: frames without a line's framing."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self.ours = None


def whole(body: bytes) -> bytes:
    total = 0
    for byte in body:
        total ^= byte
    return body + bytes([total, 0x7D])


def parts(report: bytes) -> list[Frame]:
    return [Frame(0x101 + i, report[8 * i : 8 * i + 8]) for i in range(3)]


def line() -> Any:
    made = dialect("wheeltec").make_framing
    assert made is not None
    return made()


def driver_without_plant() -> Any:
    made = dialect("wheeltec")
    return made.make(build(made.settings, {}, "device.motors"), RIG.facts)


def armed(kind: type[Rig] = Rig, options: dict[str, Any] | None = None) -> Rig:
    made = kind("wheeltec", options)
    assert made.greet() == "a WHEELTEC base (it reports no version)"
    made.arm()
    return made


def test_a_worked_command_is_the_makers_bytes_on_both_wires() -> None:
    """(0.5 m/s, -0.2 m/s, 1 rad/s): dialects facts 6."""
    made = armed()
    speeds = wheel_speeds(BodyTwist(0.5, -0.2, 1.0), made.facts.wheel_radius_m, made.facts.lever_m)
    [frame] = made.driver.command(speeds, STILL, made.now_ns + 10**9)
    assert frame == Frame(0x181, bytes.fromhex("01F4FF3803E80000"))
    assert line().encode(frame) == IN_STEP + bytes.fromhex("7B000001F4FF3803E8A27D")
    stop, again = made.driver.disarm()
    assert stop == again
    assert line().encode(stop) == IN_STEP + bytes.fromhex("7B00000000000000007B7D")


def test_a_worked_report_is_read_from_either_wire() -> None:
    for frames in (line().feed(whole(REPORT)), parts(whole(REPORT))):
        driver = driver_without_plant()
        for stamp, frame in enumerate(frames):
            driver.feed(frame, stamp)
        sample = driver.sample
        assert sample.stamp_ns == 2
        assert_near(sample.speed_rad_s, wheel_speeds(BodyTwist(0.5, -0.2, 1.0), 0.075, 0.6), 1e-9)
        assert sample.battery_v == 24.0
        assert sample.yaw_rate_rad_s == pytest.approx(1.0, abs=1e-3)
        assert_near((*sample.acceleration_m_s2, 0.0), (0.0, 0.0, 10.01, 0.0), 0.01)
        assert all(angle != angle for angle in sample.position_rad)  # it reports none


@pytest.mark.parametrize("kind", [Rig, CanRig])
@pytest.mark.parametrize("target", EVERY_WAY)
def test_wheels_reach_their_speeds_over_both_wires(kind: type[Rig], target: FourWheels) -> None:
    made = armed(kind)
    made.drive(1.0, ramp_to(target, 0.3))
    assert_near(made.speeds(), target, 0.15)
    assert made.driver.sample is not None
    assert_near(made.driver.sample.speed_rad_s, made.speeds(), 0.3)


def test_wheels_turn_for_ever_when_commands_end_as_the_firmware_is_by_default() -> None:
    made = armed()
    assert made.driver.capabilities.watchdog == "none"
    assert made.driver.warnings[1] == (
        "when commands end a WHEELTEC base drives on for ever with the last one, unless its firmware was built with "
        "SecurityLevel 0: if this computer loses power, hangs, or loses the cable, nothing stops the robot; keep its "
        "emergency stop within reach"
    )
    made.drive(1.0, ramp_to(FORWARD, 0.3))
    made.step(ticks=2500)
    assert_near(made.speeds(), FORWARD, 0.1)
    made.step(made.driver.estop(), ticks=1500)
    assert made.is_still()
    made.step(made.driver.command(FORWARD, STILL, made.now_ns), ticks=200)
    assert made.is_still()


@pytest.mark.parametrize("is_in_step", [True, False])
def test_a_stop_is_obeyed_wherever_a_command_was_cut_thanks_to_the_bytes_before_it(
    is_in_step: bool,
) -> None:
    """As when the host dies in the middle of a frame. It is the sum of a stop that makes it look like a beginning."""
    made = armed()
    obeyed = []
    for cut in range(11):
        made.step(made.driver.disarm(), ticks=300)
        made.arm()
        made.drive(0.02, lambda _t: (FORWARD, STILL))
        [command] = made.driver.command(FORWARD, STILL, made.now_ns + 10**9)
        made.node.feed(line().encode(command)[: len(IN_STEP) + cut])
        stops = b"".join(map(line().encode, made.driver.disarm()))
        made.node.feed(stops if is_in_step else 5 * stops.replace(IN_STEP, b""))
        made.step(ticks=100)
        obeyed.append(not made.node.is_driving)
    assert all(obeyed) == is_in_step


def test_a_base_that_stops_on_silence_does_so_after_its_second() -> None:
    made = armed(options={"stops_on_silence": True})
    assert made.driver.capabilities.watchdog == "fixed"
    made.drive(1.0, ramp_to(FORWARD, 0.3))
    made.step(ticks=950)
    assert_near(made.speeds(), FORWARD, 0.1)
    made.step(ticks=900)
    assert made.is_still()


def test_a_base_that_still_drives_is_stopped_before_it_counts_as_armed() -> None:
    made = armed()
    made.drive(1.0, ramp_to(FORWARD, 0.3))
    made.driver.restart()
    made.greet()
    made.step(made.driver.arm(made.now_ns))
    assert not made.driver.is_armed
    made.arm()
    assert max(map(abs, made.speeds())) < 0.8


def test_the_bases_emergency_stop_is_told_and_disarms_and_its_release_does_not_arm() -> None:
    made = armed()
    made.drive(0.5, ramp_to(FORWARD, 0.3))
    made.node.is_switched_off = True
    made.drive(0.1, lambda _t: (FORWARD, STILL))
    [error] = made.driver.errors
    assert "its emergency stop is pressed" in error
    assert not made.driver.is_armed
    made.node.is_switched_off = False
    made.drive(1.5, lambda _t: (FORWARD, STILL))
    assert made.driver.errors == ()
    assert made.is_still()
    assert not made.driver.is_armed


def test_a_low_battery_is_told_and_keeps_from_arming() -> None:
    made = Rig("wheeltec", **{"plant.start.battery_voltage_v": 19.5})
    made.greet()
    for _ in range(40):
        made.step(made.driver.arm(made.now_ns))
    [error] = made.driver.errors
    assert "its battery has 19.5 V, less than device.motors.battery_low_v = 20" in error
    assert not made.driver.is_armed


def test_a_command_beyond_the_bases_limit_is_scaled_and_keeps_its_direction() -> None:
    made = armed(options={"speed_limit_m_s": 1.0})
    [frame] = made.driver.command((10.0, 30.0, 20.0, 20.0), STILL, made.now_ns + 10**9)
    x, y, turn = struct.unpack(">3hxx", frame.payload)
    assert x + y + 0.6 * turn == pytest.approx(1000.0, abs=2.0)
    assert x - y - 0.6 * turn == pytest.approx(1000.0 / 3, abs=2.0)


def test_on_can_a_report_that_lacks_a_part_or_mixes_two_is_none() -> None:
    one, other = parts(whole(REPORT)), parts(whole(REPORT[:2] + b"\x00\x00" + REPORT[4:]))
    for frames in ([one[0], one[2]], one[1:], [one[0], one[1], other[2]], [one[0], one[0], one[2]]):
        driver = driver_without_plant()
        for frame in frames:
            driver.feed(frame, 1)
        assert driver.sample is None
        assert driver.identity is None
    assert driver.missing.startswith("no report from a WHEELTEC base; check its power")


@share_of_examples(0.5)
@given(st.integers(0x100, 0x104), st.lists(st.binary(max_size=9), max_size=6))
def test_no_frame_is_too_strange(number: int, payloads: list[bytes]) -> None:
    driver = RIG.driver
    driver.restart()
    for payload in payloads:
        driver.feed(Frame(number, payload), 0)
    assert driver.sample is None


@share_of_examples(0.5)
@given(st.lists(st.binary(min_size=22, max_size=22), max_size=4), st.binary(max_size=40), st.data())
def test_reports_come_out_of_any_pieces_and_noise_is_counted(
    bodies: list[bytes], noise: bytes, data: st.DataObject
) -> None:
    ours = line()
    sent = [whole(b"\x7b" + body[1:]) for body in bodies]
    stream = b"".join(sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=5)))
    heard: list[Frame] = []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        heard += ours.feed(stream[begin:end])
    assert heard == [frame for report in sent for frame in parts(report)]
    assert not any(ours.rejected.values())
    after = ours.feed(noise + bytes(24) + whole(REPORT) + bytes(24))
    assert after[-3:] == parts(whole(REPORT))
    assert sum(ours.rejected.values()) > 0


@share_of_examples(0.5)
@given(st.integers(0, 23), st.integers(1, 255))
def test_a_damaged_byte_costs_its_report_alone(at: int, damage: int) -> None:
    damaged = bytearray(whole(REPORT))
    damaged[at] ^= damage
    assert line().feed(bytes(damaged) + bytes(24) + whole(REPORT)) == parts(whole(REPORT))


def test_the_line_refuses_what_is_no_command() -> None:
    with pytest.raises(ValueError, match="expected 0x181 with 8"):
        line().encode(Frame(0x101, bytes(8)))


@pytest.mark.parametrize(
    ("options", "words"), [({"speed_limit_m_s": 0.0}, "speed_limit_m_s"), ({"lever_m": -1}, "lever_m")]
)
def test_settings_that_cannot_be_are_refused(options: dict[str, object], words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        build(dialect("wheeltec").settings, options, "device.motors")


def test_a_wiring_of_the_wheels_is_refused() -> None:
    made = dialect("wheeltec")
    facts = RIG.facts._replace(wheel_of_channel=(1, 0, 3, 2))
    with pytest.raises(BadInputError, match=r"device.wheels = \['fr', 'fl', 'rl', 'rr'\] .*remove both keys"):
        made.make(build(made.settings, {}, "device.motors"), facts)


def test_a_probe_listens() -> None:
    made = Rig("wheeltec")
    make = dialect("wheeltec").probe
    assert make is not None
    probe = make()
    assert probe.ask() == ()
    assert probe.found() is None
    made.step(ticks=60)
    for frame in made.heard:
        probe.feed(frame)
    found = probe.found()
    assert found is not None
    assert found.sentences == ["a WHEELTEC base, battery 24 V"]


RIG = Rig("wheeltec")
