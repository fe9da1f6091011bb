"""The plant port's line: the firmware's codec in C and the other end's in Python agree, and garbage is harmless."""

import re
import shutil
import struct
import subprocess

import cffi
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.arm_build import PORT
from firmware_protocol.built import FIRMWARE_FLAGS as FLAGS
from firmware_protocol.built import HERE
from firmware_protocol.framing import crc16
from firmware_protocol.generated.messages import LENGTHS
from firmware_protocol.plant_port import (
    Drive,
    PlantDeframer,
    PlantFramer,
    PlantId,
    PlantPort,
    Sample,
    Sense,
)

number = st.floats(width=32, allow_nan=False)
tick = st.integers(0, 2**32 - 1)


def numbers(count: int):
    return st.tuples(*[number] * count)


samples = st.builds(Sample, tick)
drives = st.builds(Drive, tick, st.booleans(), numbers(4), numbers(4))
counts = st.tuples(*[st.integers(0, 65535)] * 4)
senses = st.builds(Sense, tick, counts, numbers(4), numbers(3), numbers(3), number, number, numbers(4))
REST = Sense(0, (0, 0, 0, 0), (0.0,) * 4, (0.0,) * 3, (0.0, 0.0, 9.81), 24.0, 0.0, (25.0,) * 4)


@pytest.fixture(scope="module")
def c(tmp_path_factory):
    """(ffi, library) of the firmware's codec; undefined behaviour traps."""
    cc = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if cc is None:
        pytest.skip("no C compiler on this machine: install gcc or clang")
    library = tmp_path_factory.mktemp("plant") / "plant.so"
    trap = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
    sources = (PORT / "plant_codec.c", HERE / "firmware" / "cobs.c", HERE / "firmware" / "crc.c")
    subprocess.run(list(map(str, [cc, *FLAGS, *trap, "-shared", "-fPIC", "-o", library, *sources])), check=True)
    ffi = cffi.FFI()
    for header in (HERE / "firmware" / "plant_port.h", PORT / "plant_codec.h"):
        ffi.cdef("".join(re.findall(r"/\* cffi: begin \*/(.*?)/\* cffi: end \*/", header.read_text(), re.DOTALL)))
    return ffi, ffi.dlopen(str(library))


def c_feed(c, data: bytes) -> list[Sense]:
    ffi, lib = c
    deframer, out = ffi.new("plant_deframer *"), ffi.new("wheel_sense *")
    heard = []
    for byte in data:
        if lib.plant_deframer_feed(deframer, byte, out):
            fields = (out.count, out.current_a, out.gyro_rad_s, out.acceleration_m_s2)
            lists = [tuple(field) for field in fields]
            heard.append(Sense(out.tick, *lists, out.battery_v, out.battery_a, tuple(out.temperature_degc)))
    return heard


def c_encode(c, message: Sample | Drive, sequence: int) -> bytes:
    ffi, lib = c
    out = ffi.new("uint8_t[]", lib.PLANT_FRAME_MAX)
    if isinstance(message, Sample):
        length = lib.plant_encode_sample(message.tick, sequence, out)
    else:
        drive = ffi.new("wheel_drive *", [message.tick, message.enabled, message.torque_n_m, message.duty])
        length = lib.plant_encode_drive(drive, sequence, out)
    return bytes(ffi.buffer(out, length))


@pytest.mark.proves("R-PORT-2")
@given(st.lists(samples | drives, min_size=1, max_size=3))
def test_what_the_firmware_sends_is_what_python_would_send(c, messages):
    framer = PlantFramer()
    sent = [c_encode(c, message, i) for i, message in enumerate(messages)]
    assert sent == [framer.encode(message) for message in messages]
    assert PlantDeframer().feed(b"".join(sent)) == messages


@pytest.mark.proves("R-PORT-2")
@given(st.lists(senses, min_size=1, max_size=3))
def test_senses_arrive_in_the_firmware_bit_for_bit(c, messages):
    framer = PlantFramer()
    data = b"".join(framer.encode(message) for message in messages)
    heard = c_feed(c, data)
    assert [repr(one) for one in heard] == [repr(one) for one in messages]  # repr tells -0.0 from 0.0


@given(senses, st.integers(0, 82 * 8 - 1))
def test_a_flipped_bit_is_never_taken_for_another_sense(c, message, bit):
    data = bytearray(PlantFramer().encode(message))
    data[bit // 8 % (len(data) - 1)] ^= 1 << bit % 8
    assert c_feed(c, bytes(data)) == []
    assert PlantDeframer().feed(bytes(data)) == []


@given(st.binary(max_size=400), senses)
def test_after_any_bytes_a_zero_brings_both_ends_back_in_step(c, garbage, message):
    data = garbage + b"\0" + PlantFramer().encode(message)
    assert c_feed(c, data)[-1:] == [message]
    assert PlantDeframer().feed(data)[-1:] == [message]


@given(st.lists(st.binary(max_size=120), max_size=8))
def test_no_bytes_raise_and_none_move_the_plant(pieces):
    moved = []
    port = PlantPort(lambda drive: moved.append(drive) or REST)
    for piece in pieces:
        port.feed(piece)
    assert moved == []


@pytest.mark.proves("R-PORT-5")
@given(drives, st.integers(1, 5))
def test_a_repeated_drive_is_answered_again_and_moves_the_plant_once(drive, repeats):
    moved = []
    port = PlantPort(lambda asked: moved.append(asked) or REST)
    framer, robot = PlantFramer(), PlantDeframer()
    answers = [robot.feed(port.feed(framer.encode(drive))) for _ in range(1 + repeats)]
    assert moved == [drive]
    assert all([one.tick for one in heard] == [(drive.tick + 1) % 2**32] for heard in answers)


def test_a_sample_begins_anew():
    moved = []
    port = PlantPort(lambda asked: moved.append(asked) or REST)
    framer, robot = PlantFramer(), PlantDeframer()
    drive = Drive(0, False, (0.0,) * 4, (0.0,) * 4)
    for message in (Sample(0), drive, Sample(0), drive):
        port.feed(framer.encode(message))
    assert moved == [None, drive, None, drive]
    assert robot.feed(port.feed(framer.encode(Sample(7))))[0].tick == 7


def test_a_robot_hears_nothing_from_another_robot():
    port = PlantPort(lambda _: REST)
    assert port.feed(PlantFramer().encode(REST)) == b""
    assert port.rejected == 0


def test_broken_frames_are_counted():
    port = PlantPort(lambda _: REST)
    port.feed(b"\x05\0" + b"a" * 200 + b"\0" + b"\x01\x01\0")
    assert port.rejected == 3


@pytest.mark.parametrize("wrong", [b"", b"\0" * 5, b"\0" * 41])
def test_a_length_that_is_not_the_identifiers_is_dropped(wrong):
    body = struct.pack("<HB", PlantId.DRIVE, 0) + wrong
    data = cobs.encode(body + crc16(body).to_bytes(2, "little")) + b"\0"
    assert PlantDeframer().feed(data) == []


@pytest.mark.proves("R-PORT-1")
def test_no_identifier_is_one_of_the_hosts_line():
    assert not {int(number) for number in PlantId} & set(LENGTHS)
    assert all(number > 0x7FF for number in PlantId)
