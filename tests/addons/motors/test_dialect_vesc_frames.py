"""VESC's messages on a serial line and in parts over CAN: worked frames, any bytes, any pieces, any damage."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.addons.motors.vesc import vesc_frames
from hil.addons.motors.vesc.emulated_vesc import can_parts
from hil.addons.motors.vesc.vesc_frames import (
    SET_CURRENT,
    SET_CURRENT_BRAKE,
    SET_RPM,
    Bus,
    CanMessages,
    Line,
    SerialFraming,
    Setting,
    Timeout,
    parse_timeout,
)
from hil.robot.driver import EXTENDED
from tests.support.dialect_testbed import Rig

NODE, LINE = Rig("vesc", wire="can").node, Rig("vesc", wire="serial")


@pytest.mark.parametrize(
    ("setting", "value", "packet"),
    [
        (SET_RPM, 3000.0, "02050800000bb8f80403"),
        (SET_RPM, -123456.0, "020508fffe1dc01dbe03"),
        (SET_CURRENT, 51.0, "0205060000c738f51d03"),
        (SET_CURRENT_BRAKE, 4.0, "02050700000fa0c20003"),
    ],
)
def test_packets_of_the_line_are_those_that_pyvesc_makes(setting: Setting, value: float, packet: str) -> None:
    """The hex is what pyvesc 1.0.5 encodes for the same commands."""
    assert SerialFraming().encode(Line([1], 1).setting(setting, 1, value)).hex() == packet


def test_a_command_for_another_than_the_near_one_is_passed_on() -> None:
    assert Line([1, 2], 1).setting(SET_RPM, 2, 3000.0) == Frame(34, bytes.fromhex("020800000bb8"))


def test_the_worked_example_of_the_maker_is_the_current_of_51_a_to_vesc_23() -> None:
    assert Bus([23]).setting(SET_CURRENT, 23, 51.0) == Frame(EXTENDED | 0x0117, bytes.fromhex("0000C738"))


def test_a_number_too_large_for_a_frame_is_the_largest() -> None:
    assert SET_CURRENT.counts(1e9) == b"\x7f\xff\xff\xff"
    assert SET_CURRENT.counts(-1e9) == b"\x80\x00\x00\x00"


@given(st.lists(st.tuples(st.integers(1, 255), st.binary(min_size=1, max_size=300)), max_size=5), st.data())
def test_packets_arrive_whole_in_pieces_of_any_size(messages: list[tuple[int, bytes]], data: st.DataObject) -> None:
    frames = [Frame(code, payload) for code, payload in messages]
    framing = SerialFraming()
    stream = b"".join(map(framing.encode, frames))
    heard, at = [], 0
    while at < len(stream):
        size = data.draw(st.integers(1, 200))
        heard += framing.feed(stream[at : at + size])
        at += size
    assert heard == frames
    assert not any(framing.rejected.values())


@given(st.lists(st.binary(max_size=100), max_size=8))
def test_any_bytes_are_dropped_and_counted_and_a_packet_gets_through_after_them(pieces: list[bytes]) -> None:
    framing = SerialFraming()
    for piece in pieces:
        framing.feed(piece)
    whole = Frame(8, bytes(4))
    heard = []
    for _ in range(53):  # what looked like the begin of a long packet has waited for up to 512 bytes
        heard += framing.feed(framing.encode(whole))
    assert heard[-1] == whole


@pytest.mark.parametrize(
    ("damaged", "cause"),
    [
        ("0200", "length"),
        ("030005", "length"),
        ("02050800000bb8f80404", "end"),
        ("02050800000bb9f80403", "checksum"),
    ],
)
def test_damage_is_counted_by_its_cause_once(damaged: str, cause: str) -> None:
    framing = SerialFraming()
    packet = framing.encode(Frame(4, b""))
    assert framing.feed(bytes.fromhex(damaged) + packet * 60) != []
    assert framing.rejected[cause] == 1


def test_a_message_that_no_packet_holds_is_an_error() -> None:
    with pytest.raises(ValueError, match="of 513 bytes: expected at most 512"):
        SerialFraming().encode(Frame(0, bytes(512)))


def test_an_answer_cut_off_has_no_values_but_may_lack_the_last_of_newer_firmware() -> None:
    wanted = vesc_frames.request_values(*vesc_frames.ALL_VALUES)
    NODE.receive(Frame(EXTENDED | 0x0802, b"\xfd\x00" + wanted))
    messages = CanMessages()
    [(_, message)] = [heard for frame in NODE.take_frames() if (heard := messages.feed(frame))]
    assert vesc_frames.parse_values(message) is not None
    known = vesc_frames.parse_values(message[:-1])
    assert known is not None
    assert "status" not in known
    assert not any(vesc_frames.parse_values(message[:size]) for size in range(len(message) - 1))
    assert vesc_frames.parse_values(message + b"\0") is None


@pytest.mark.parametrize("damage", [(0, 5), (1, 3), (-1, 2), (-1, 3), (-1, 5)])
def test_damaged_parts_make_no_message(damage: tuple[int, int]) -> None:
    NODE.receive(Bus([2]).message(2, b"\0"))
    said = NODE.take_frames()
    place, byte = damage
    number, payload = said[place]
    said[place] = Frame(number, payload[:byte] + bytes((payload[byte] ^ 0x10,)) + payload[byte + 1 :])
    messages = CanMessages()
    assert not any(messages.feed(frame) for frame in said)


@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=90), st.integers(0, 20))
def test_messages_in_parts_are_whole_or_nothing(hardware: str, lost: int) -> None:
    """What an emulated one says of itself, in up to 17 parts, and the same with a part lost."""
    NODE.vescs[1].hardware = hardware.encode()
    NODE.receive(Bus([2]).message(2, b"\0"))
    said = NODE.take_frames()
    messages = CanMessages()
    [(sender, message)] = [heard for frame in said if (heard := messages.feed(frame))]
    assert (sender, vesc_frames.parse_version(message)) == (2, (6, 5, hardware))
    if lost < len(said):
        assert not any(messages.feed(frame) for frame in said[:lost] + said[lost + 1 :])


def answer(sender: int, message: bytes) -> list[Frame]:
    return [Frame(EXTENDED | command << 8 | 253, data) for command, data in can_parts(sender, message)]


MESSAGES = st.integers(1, 512).flatmap(lambda size: st.binary(min_size=size, max_size=size))  # also long ones


@given(st.integers(0, 254), MESSAGES)
def test_any_message_comes_back_whole_from_its_parts(sender: int, message: bytes) -> None:
    frames, messages = answer(sender, message), CanMessages()
    assert messages.feed(frames[-1]) == (None if len(frames) > 1 else (sender, message))
    heard = [messages.feed(frame) for frame in frames]
    assert heard == [None] * (len(frames) - 1) + [(sender, message)]


@given(st.lists(st.tuples(st.integers(0, 254), MESSAGES), min_size=2, max_size=3), st.data())
def test_parts_that_are_lost_doubled_or_mixed_make_no_message_that_nobody_sent(
    sent: list[tuple[int, bytes]], data: st.DataObject
) -> None:
    waiting = [answer(*one) for one in sent]
    messages = CanMessages()
    for turn in data.draw(st.lists(st.tuples(st.sampled_from(waiting), st.integers(-1, 3)), max_size=40)):
        queue, fate = turn
        count = 1 + 9 * (fate == 3)
        for frame in queue[:count]:
            for _ in range((0, 1, 2)[fate] if fate in (0, 2) else 1):
                assert messages.feed(frame) in (None, *sent)
        del queue[:count]


def test_a_message_longer_than_any_is_none() -> None:
    messages = CanMessages()
    assert not any(messages.feed(frame) for frame in answer(1, bytes(600)))


def test_the_front_of_an_app_configuration_is_read() -> None:
    """Of 6.00: its signature, id 7, 1500 ms, 12.5 A, and then 480 bytes of the rest."""
    message = bytes.fromhex("11 1d003a2c 07 000005dc 41480000") + bytes(480)
    assert parse_timeout(message) == Timeout(7, 1.5, 12.5)
    assert parse_timeout(message[:199]) is None  # as short as none
    assert parse_timeout(message[:5] + bytes(1) + (700).to_bytes(4, "big") + message[10:]) == Timeout(0, 0.7, 12.5)
    assert parse_timeout(b"\x12" + message[1:]) is None  # the configuration as delivered, which nobody asked for
    assert parse_timeout(message[:10] + bytes.fromhex("7fc00000") + bytes(480)) is None


def float32_auto(value: float) -> bytes:
    """Return a number as util/buffer.c writes it: sign, exponent of ``frexp`` plus 126, significand minus one half."""
    if abs(value) < 1.5e-38:
        return bytes(4)
    significand, exponent = math.frexp(abs(value))
    bits = (value < 0.0) << 31 | exponent + 126 << 23 | int((significand - 0.5) * 2**24)
    return bits.to_bytes(4, "big")


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_numbers_of_a_configuration_are_what_the_format_says(value: float) -> None:
    """The significand is 0.5 and its bits behind the point, times two to the exponent less 126."""
    [bits] = struct.unpack(">I", float32_auto(value))
    sign, exponent, behind = -1.0 if bits >> 31 else 1.0, bits >> 23 & 0xFF, bits & 0x7FFFFF
    by_hand = sign * math.ldexp(0.5 + behind / 2**24, exponent - 126) if bits & 0x7FFFFFFF else 0.0
    read = parse_timeout(b"\x11" + bytes(9) + float32_auto(value) + bytes(264))
    assert read is not None
    assert read.brake_current_a == by_hand == (value if abs(value) >= 1.5e-38 else 0.0)


HELD = (Frame(8, b"\0\0\1\0"), Frame(34, b"\2\x08\0\0\1\0"), Frame(34, b"\4\6\0\0\x20\0"))


@given(
    st.lists(
        st.binary(max_size=100)
        | st.sampled_from(HELD).map(SerialFraming().encode)
        | st.sampled_from((b"\3\2\0", b"\3\1", b"\2\xff", b"\3")),
        max_size=8,
    )
)
def test_the_last_stop_is_the_last_that_is_done_after_any_bytes(pieces: list[bytes]) -> None:
    node = LINE.node
    node.feed(b"".join(pieces))
    for vesc in node.vescs:
        vesc.command("rpm", 400)
    node.feed(b"".join(map(SerialFraming().encode, [*LINE.driver.last_stop(), Frame(0, b"")])))  # type: ignore[attr-defined]
    assert [vesc._control for vesc in node.vescs] == ["brake"] * 4
    heard = SerialFraming().feed(node.take_bytes())
    assert heard[-1].id == 0
