"""``hil decode`` shows or counts everything in a trace, whichever tool wrote it."""

import gzip
import json
import math
import shutil
import struct
import subprocess
import sys
import zlib

import can
import pytest
from can.io import blf
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.report.trace import trace_decoder as decode
from tests.support.examples import share_of_examples
from tests.support.processes import hil
from tests.support.traced_runs import one_second_of_frames

EVERYTHING = decode.Selection.of([], -math.inf, math.inf, raw=True)
can_utils = pytest.mark.skipif(shutil.which("log2asc") is None, reason="no log2asc and asc2log: install can-utils")

FD_LENGTHS = [*range(9), 12, 16, 20, 24, 32, 48, 64]


@st.composite
def a_message(draw):
    kind, extended = draw(st.sampled_from(["data", "data", "fd", "remote", "error"])), draw(st.booleans())
    if kind == "error":
        return can.Message(is_error_frame=True, channel=draw(st.integers(0, 4)))
    length = draw(st.sampled_from(FD_LENGTHS) if kind == "fd" else st.integers(0, 8))
    return can.Message(
        arbitration_id=draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF)),
        is_extended_id=extended,
        is_fd=kind == "fd",
        is_remote_frame=kind == "remote",
        is_rx=draw(st.booleans()),
        data=None if kind == "remote" else draw(st.binary(min_size=length, max_size=length)),
        dlc=length,
        channel=draw(st.integers(0, 4)),
    )


def stamped(messages, stamps):
    for message, stamp in zip(messages, stamps, strict=False):
        message.timestamp = 1.7e9 + stamp / 1000
        yield message


def what(entry):
    frame = entry.frame
    return frame.number, frame.extended, frame.payload, frame.direction


def things_in(path):
    """How many frames a file has by counting its lines, or by the count in its header."""
    content = path.read_bytes()
    if path.suffix == ".blf":
        return blf.FILE_HEADER_STRUCT.unpack_from(content)[12]
    return sum(bool(line) for line in content.splitlines())


@given(
    ending=st.sampled_from(["blf", "log"]),
    messages=st.lists(a_message(), min_size=1, max_size=12),
    stamps=st.lists(st.integers(0, 1000), min_size=12, max_size=12),
)
def test_every_frame_that_python_can_writes_is_read(tmp_path_factory, ending, messages, stamps):
    path = tmp_path_factory.mktemp("forms") / f"bus.{ending}"
    with can.Logger(path) as log:
        for message in stamped(messages, stamps):
            log.on_message_received(message)
    reading = decode.read(path, EVERYTHING)
    entries = list(reading)
    assert (reading.trouble, reading.rest()) == (None, None)
    assert len(entries) == len(messages) == things_in(path)
    sent = [one for one in messages if not one.is_error_frame]
    assert [what(entry) for entry in entries if entry.kind != decode.ERROR] == [
        (one.arbitration_id, one.is_extended_id, bytes(one.data), "Rx" if one.is_rx else "Tx") for one in sent
    ]
    form = "can{}" if ending == "log" else "{}"
    first = 0 if ending == "log" else 1  # Vector's formats count from 1
    assert [entry.frame.channel for entry in entries] == [form.format(one.channel + first) for one in messages]


@can_utils
@share_of_examples(0.5)
@given(messages=st.lists(a_message(), min_size=1, max_size=12))
def test_every_frame_that_can_utils_write_is_read(tmp_path_factory, messages):
    folder = tmp_path_factory.mktemp("utils")
    with can.Logger(folder / "bus.log") as log:
        for message in stamped(messages, range(0, 1000, 10)):
            log.on_message_received(message)
    buses = [f"can{number}" for number in range(5)]
    subprocess.run(["log2asc", "-I", "bus.log", "-O", "bus.asc", *buses], cwd=folder, check=True)
    subprocess.run(["asc2log", "-I", "bus.asc", "-O", "back.log"], cwd=folder, check=True, capture_output=True)
    reading = decode.read(folder / "back.log", EVERYTHING)
    entries = list(reading)
    assert (reading.trouble, reading.rest()) == (None, None)
    assert len(entries) == things_in(folder / "back.log")
    channels = [one.frame.channel for one in entries]
    assert channels[: len(messages)] == [f"can{one.channel}" for one in messages][: len(channels)]


def test_an_asc_file_is_read_once_python_can_has_converted_it(tmp_path):
    with can.Logger(tmp_path / "bus.asc") as log:
        for message in one_second_of_frames():
            log.on_message_received(message)
    convert = [sys.executable, "-m", "can.logconvert", "bus.asc", "bus.log"]
    subprocess.run(convert, cwd=tmp_path, check=True, capture_output=True)
    reading = decode.read(tmp_path / "bus.log", EVERYTHING)
    assert [entry.frame.number for entry in reading if entry.kind != decode.ERROR] == [
        one.arbitration_id for one in one_second_of_frames() if not one.is_error_frame
    ]
    assert (reading.trouble, reading.rest()) == (None, None)


CASES = {
    # name: (content, the payloads of frames (None: an error frame), words of the note, words of the refusal)
    "errors.log": (
        "(1.0) can0 20000004#0004000000000000\n(1.1) can0 123#00\n(1.2) can0 20000080#\n(1.3) can0 20000010#00 R\n",
        [None, "00", None, None],
        (),
        (),
    ),
    "dlc.log": (
        "(1.0) can0 123#0011223344556677_9\n(1.1) can0 123#R8_F\n(1.2) can0 123##F11\n",
        ["0011223344556677", "", "11"],
        (),
        (),
    ),
    "xl.log": ("(1.0) can0 123#80:00:12345678#0011\n(1.1) can0 123#00\n", ["00"], ("CAN XL frames: 1",), ()),
    "no_feed.log": ("(1.0) can0 123#00\n(1.1) can0 123#0011223344556677", ["00", "0011223344556677"], (), ()),
    "cut.log": ("(1.0) can0 123#00\n(1.1) can0 123#001122", ["00"], (), ("cut within line 2",)),
    "screen.log": ("  can0  123   [8]  11 22 33 44 55 66 77 88\n", [], (), ("candump -L",)),
    "screen_ax.log": (" (1.5)  can0  RX - -  123   [1]  11   '.'\n", [], (), ("candump -L",)),
    "busmaster.log": ("***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n", [], (), ("BUSMASTER", "candump -L")),
    "endless.log": (f"({'9' * 400}.0) can0 123#00\n", [], (), ("line 1",)),
}


@pytest.mark.parametrize("name", CASES)
def test_every_line_is_shown_counted_or_named_as_the_end(tmp_path, name):
    content, payloads, note, trouble = CASES[name]
    path = tmp_path / name
    path.write_text(content)
    done = hil("decode", "--raw", "--json", path)
    records = [json.loads(line) for line in done.stdout.splitlines()]
    assert [None if one["message"] == "error" else one["payload"] for one in records] == payloads
    assert all(word in done.stderr for word in (*note, *trouble)), done.stderr
    assert (done.returncode, done.stderr.count("\n")) == (2 if trouble else 0, bool(note) + bool(trouble))


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("a.log", gzip.compress(b"(1.0) can0 123#00\n", mtime=0), "gzip"),
        ("a.blf", gzip.compress(b"LOGG", mtime=0), "gzip"),
        ("b.log", "(1.0) can0 123#00\n".encode("utf-16"), "UTF-16"),
        ("c.log", b"LOGG" + bytes(140), "a .blf by its content"),
        ("c.blf", b"LOGG", "it is not a .blf file"),
        ("d.log", b";$FILEVERSION=2.1\n", "a trace of PEAK"),
        ("e.blf", b"MDF     4.10    asammdf", "MDF"),
        ("f.log", b"\xd4\xc3\xb2\xa1" + bytes(40), "pcap"),
        ("g.log", b"Chn Identifier Flg   DLC  D0...1...2\n", "Kvaser"),
        ("h.log", b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n", "SavvyCAN"),
    ],
)
def test_a_file_of_another_form_is_called_that(tmp_path, name, content, word):
    (tmp_path / name).write_bytes(content)
    [why] = hil("decode", tmp_path / name).stderr.splitlines()
    assert word in why


def test_frames_stamped_before_the_first_are_shown(tmp_path):
    path = tmp_path / "bus.log"
    path.write_text("(10.5) can0 123#01\n(10.0) can0 123#02\n(11.0) can0 123#03\n")
    assert [line.split()[0] for line in hil("decode", path).stdout.splitlines()] == [
        "0.000000",
        "-0.500000",
        "0.500000",
    ]
    assert len(hil("decode", "--from", "0", path).stdout.splitlines()) == 2
    assert "none of the 3 frames" in hil("decode", "--from", "9", path).stderr


def test_each_channel_is_shown_and_selected_on_its_own(tmp_path):
    path = tmp_path / "bus.log"
    command = "040#6000EE038A001051"
    path.write_text(
        f"(1.0) can0 {command}\n(1.1) can1 {command}\n(1.2) can1 123#00\n(1.3) can1 124#00\n(1.4) can0 123#00\n"
    )
    records = [json.loads(line) for line in hil("decode", "--json", path).stdout.splitlines()]
    assert [(one["channel"], one["message"]) for one in records] == [
        ("can0", "WHEEL_COMMAND"),
        ("can1", "foreign"),  # most of its frames are not ours
        ("can1", "foreign"),
        ("can1", "foreign"),
        ("can0", "foreign"),
    ]
    only = hil("decode", "--channel", "can0", path).stdout.splitlines()
    assert [line.split()[1:4:2] for line in only] == [["can0", "WHEEL_COMMAND"], ["can0", "foreign"]]
    assert "no TICK of our firmware on channel can1" in hil("decode", path).stderr
    assert "none of the 5 frames" in hil("decode", "--channel", "can7", path).stderr


def an_object(kind, content, *, length=None, stamp_ns=0):
    head = blf.OBJ_HEADER_V1_STRUCT.pack(blf.TIME_ONE_NANS, 0, 0, stamp_ns)
    whole = blf.OBJ_HEADER_BASE_STRUCT.size + len(head) + len(content)
    length = whole if length is None else length
    raw = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 32, 1, length, kind) + head + content
    return raw + bytes(whole % 4)


def a_blf(path, *pieces, loose=b""):
    """Write a file of containers, whatever is in them, after objects without one."""
    blocks = loose
    for piece in pieces:
        packed = blf.LOG_CONTAINER_STRUCT.pack(blf.ZLIB_DEFLATE, len(piece)) + zlib.compress(piece)
        size = blf.OBJ_HEADER_BASE_STRUCT.size + len(packed)
        blocks += blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, size, blf.LOG_CONTAINER) + packed + bytes(size % 4)
    size = blf.FILE_HEADER_SIZE + len(blocks)
    numbers = [0] * 7 + [0, size, 0, 0, 0] + [0] * 16
    head = struct.pack(
        blf.FILE_HEADER_STRUCT.format, b"LOGG", blf.FILE_HEADER_SIZE, *numbers[:7], 0, size, *numbers[9:]
    )
    path.write_bytes(head.ljust(blf.FILE_HEADER_SIZE, b"\0") + blocks)
    return path


DATA = an_object(blf.CAN_MESSAGE, blf.CAN_MSG_STRUCT.pack(2, 0, 1, 0x123, b"\1" + bytes(7)))


@pytest.mark.parametrize(
    ("length", "what"),
    [
        (0, "by an object of 0 bytes"),
        (1, "by an object of 1 bytes"),
        (15, "by an object of 15 bytes"),
        (17, "by an object that is too short"),
        (40, "by an object that is too short"),
    ],
)
def test_a_blf_object_of_no_sensible_size_is_damage(tmp_path, length, what):
    path = a_blf(tmp_path / "bus.blf", DATA + an_object(blf.CAN_MESSAGE, bytes(16), length=length))
    done = hil("decode", path)
    assert (done.returncode, len(done.stdout.splitlines())) == (2, 1)
    assert f"1 frames could be read; the file is damaged in the block at byte 144, {what}" in done.stderr


def test_blf_objects_of_all_kinds_are_shown_or_counted(tmp_path):
    request = an_object(blf.CAN_MESSAGE2, blf.CAN_MSG_STRUCT.pack(1, 2, 1, 0x123, bytes(8)) + bytes(8))
    errors = [an_object(kind, struct.pack("<HH", 3, 0) + bytes(60)) for kind in (2, blf.CAN_ERROR_EXT, 104)]
    others = [an_object(kind, bytes(20)) for kind in (4, 65, 65, 200)]
    others.append(bytes(30))  # more padding than there should be
    stream = b"".join([DATA, request, *errors, DATA, *others])
    # Objects go on in the next container, and some tools put them into none.
    path = a_blf(tmp_path / "bus.blf", stream[:50], stream[50:130], stream[130:], loose=request)
    done = hil("decode", path)
    assert [line.split()[1:4] for line in done.stdout.splitlines()] == [
        ["1", "Tx", "request"],
        ["2", "Rx", "foreign"],
        ["1", "Tx", "request"],
        *[["3", "Rx", "error"]] * 3,
        ["2", "Rx", "foreign"],
    ]
    types = "objects of type 65: 2, objects of type 4: 1, objects of type 200: 1"
    assert done.stderr == f"hil: note: {path}: left out, not readable as CAN frames: {types}\n"
    assert "its last object is cut" in hil("decode", a_blf(tmp_path / "cut.blf", stream[:-50])).stderr


def told(entries):
    """Return what is told of each frame, without its time."""
    of = [(one.frame, one.kind) for one in entries]
    return [(f.channel, f.direction, f.number, f.extended, f.payload.hex(), kind) for f, kind in of]


def fd_64(flags, direction, payload, valid, *, extra=0):
    """Return the content of a frame as CANoe writes it; data that end with zeros may be shorter than they are."""
    head = blf.CAN_FD_MSG_64_STRUCT.pack(3, 0, valid, 0, 0x80000123, 0, flags, 0, 0, 0, 0, 0, direction, extra, 0)
    return head + payload


def test_blf_frames_of_every_form_have_their_parts_in_their_places(tmp_path):
    frames = [
        an_object(blf.CAN_MESSAGE, blf.CAN_MSG_STRUCT.pack(2, 1, 3, 0x123, bytes(range(1, 9))), stamp_ns=1_500_000_000),
        an_object(blf.CAN_MESSAGE2, blf.CAN_MSG_STRUCT.pack(4, 0x80, 8, 0x80000124, bytes(8)) + bytes(8)),
        an_object(blf.CAN_MESSAGE, blf.CAN_MSG_STRUCT.pack(1, 0, 15, 0x7FF, bytes(range(1, 9)))),
        an_object(blf.CAN_FD_MESSAGE,
                  blf.CAN_FD_MSG_STRUCT.pack(5, 1, 9, 0x125, 0, 0, 0, 12, bytes(range(1, 65)))),
        an_object(blf.CAN_FD_MESSAGE_64, fd_64(0x1000, 1, b"\1\2\3", 8)),
        an_object(blf.CAN_FD_MESSAGE_64, fd_64(0x10, 2, b"", 8)),
        an_object(blf.CAN_FD_MESSAGE_64, fd_64(0x1000, 0, bytes(range(1, 9)) + b"more", 8)),
        an_object(2, struct.pack("<HH", 0x102, 0)), an_object(104, b"\7\1\0\0"),
    ]  # fmt: skip
    reading = decode.read(a_blf(tmp_path / "bus.blf", b"".join(frames)), EVERYTHING)
    assert told(reading) == [
        ("2", "Tx", 0x123, False, "010203", "foreign"), ("4", "Rx", 0x124, True, "", "foreign"),
        ("1", "Rx", 0x7FF, False, "0102030405060708", "foreign"),
        ("5", "Tx", 0x125, False, bytes(range(1, 13)).hex(), "foreign"),
        ("3", "Tx", 0x123, True, "0102030000000000", "foreign"), ("3", "Tx", 0x123, True, "", "request"),
        ("3", "Rx", 0x123, True, "0102030405060708", "foreign"),
        ("258", "Rx", 0, False, "", "error"), ("7", "Rx", 0, False, "", "error"),
    ]  # fmt: skip
    assert (reading.trouble, reading.rest(), reading.frames, reading.selected) == (None, None, 9, 9)


def test_blf_times_are_in_nanoseconds_or_in_tens_of_microseconds_and_headers_have_two_forms(tmp_path):
    base, data = blf.OBJ_HEADER_BASE_STRUCT, blf.CAN_MSG_STRUCT.pack(2, 0, 1, 0x123, bytes(8))

    def of(version, flags, stamp):
        form = {1: blf.OBJ_HEADER_V1_STRUCT, 2: blf.OBJ_HEADER_V2_STRUCT}.get(version, blf.OBJ_HEADER_V1_STRUCT)
        head = form.pack(flags, *([0] * (len(form.unpack(bytes(form.size))) - 2)), stamp)
        if version == 2:
            head = form.pack(flags, 0, 0, stamp)
        size = base.size + len(head) + len(data)
        return base.pack(b"LOBJ", base.size + len(head), version, size, blf.CAN_MESSAGE) + head + data + bytes(size % 4)

    stream = [of(1, 2, 0), of(1, 1, 150_000), of(2, 2, 2_500_000_000), of(3, 2, 9), of(1, 2, 1_000_000)]
    reading = decode.read(a_blf(tmp_path / "bus.blf", b"".join(stream)), EVERYTHING)
    assert [one.t_s for one in reading] == [0.0, 1.5, 2.5, 0.001]
    assert reading.rest() == (
        f"{tmp_path / 'bus.blf'}: left out, not readable as CAN frames: objects with a header of version 3: 1"
    )


def test_of_many_kinds_left_out_the_eight_most_frequent_are_named(tmp_path):
    kinds = [kind for kind in range(40, 50) for _ in range(1 + (kind - 40) % 9)]
    reading = decode.read(
        a_blf(tmp_path / "bus.blf", DATA + b"".join(an_object(kind, bytes(4)) for kind in kinds)), EVERYTHING
    )
    assert len(list(reading)) == 1
    counted = ", ".join(f"objects of type {kind}: {kind - 39}" for kind in range(48, 40, -1))
    assert reading.rest() == (
        f"{tmp_path / 'bus.blf'}: left out, not readable as CAN frames: {counted}, 2 other kinds: 2"
    )


def test_a_line_of_a_log_has_its_parts_in_their_places(tmp_path):
    path = tmp_path / "bus.log"
    lines = {
        "(1000.500000) can0 123#0102 T": ("can0", "Tx", 0x123, False, "0102", "foreign"),
        "(1000.250000) vcan1 1F334455#": ("vcan1", "Rx", 0x1F334455, True, "", "foreign"),
        "(1001.000001) can0 7ff##3" + "0a" * 64 + " R": ("can0", "Rx", 0x7FF, False, "0a" * 64, "foreign"),
        "(1001.5) can0 080#r": ("can0", "Rx", 0x080, False, "", "foreign"),
        "(1002.0) can0 20000088#0000080000000000 R": ("can0", "Rx", 0x88, False, "0000080000000000", "error"),
        "(1002.0) can0 123#0011223344556677": ("can0", "Rx", 0x123, False, "0011223344556677", "foreign"),
    }
    path.write_text("\ufeff" + "\n\n".join(lines), encoding="utf-8")
    entries = list(decode.read(path, EVERYTHING))
    assert told(entries) == list(lines.values())
    assert [one.t_s for one in entries] == [0.0, -0.25, 0.500001, 1.0, 1.5, 1.5]
    assert [entry.refusal for entry in entries] == [None, None, None, "remote", None, None]
    assert entries[4].text() == (
        "   1.500000  can0   Rx  error               error frame, or bytes that are no frame 088 "
        "[8] 00 00 08 00 00 00 00 00"
    )
    assert entries[1].text() == "  -0.250000  vcan1  Rx  foreign             1F334455 [0]"
    assert entries[1].record() == {
        "t_s": -0.25, "channel": "vcan1", "direction": "Rx", "message": "foreign", "sender": None, "id": 0x1F334455,
        "extended": True, "payload": "",
    }  # fmt: skip
    for wrong in ("(1.0) can0 123#001122334455667788", "(1.0) can0 123##0" + "00" * 65, "(1.0) can0 4000000#00"):
        path.write_text(f"(1.0) can0 123#00\n{wrong}\n(1.1) can0 123#00\n")
        reading = decode.read(path, EVERYTHING)
        assert len(list(reading)) == 1
        assert reading.trouble == (
            f"{path}: 1 frames could be read; line 2 is not of a log of candump -L; the file is damaged there, or has "
            "another form"
        )


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (lambda content: content[:20], "no frames could be read; it is not a .blf file, or it is empty"),
        (lambda content: content[:-30], "no frames could be read; it was not finished, or is cut"),
        (
            lambda content: content[:-30] + bytes(30),
            "no frames could be read; the file is damaged in the block at byte 144",
        ),
        (lambda content: content + b"LOBJ", "1 frames could be read; it was not finished, or is cut"),
    ],
)
def test_why_a_blf_file_is_not_read_to_its_end(tmp_path, spoil, why):
    path = a_blf(tmp_path / "bus.blf", DATA)
    path.write_bytes(spoil(path.read_bytes()))
    reading = decode.read(path, EVERYTHING)
    list(reading)
    assert reading.trouble == f"{path}: {why}"


def test_a_selection_has_both_ends_and_the_channels_that_are_named(tmp_path):
    path = tmp_path / "bus.log"
    path.write_text("".join(f"({1000 + n / 10:.1f}) can{n % 3} 123#0{n}\n" for n in range(9)))

    def found(*names, from_s=-math.inf, to_s=math.inf, **options):
        reading = decode.read(path, decode.Selection.of(names, from_s, to_s, **options))
        return [int(one.frame.payload.hex()) for one in reading], reading.frames, reading.selected

    assert found() == ([*range(9)], 9, 9)
    assert found(from_s=0.2, to_s=0.5) == ([2, 3, 4, 5], 9, 4)
    assert found(from_s=0.3, to_s=0.3) == ([3], 9, 1)
    assert found(channels=["can0", "can2"]) == ([0, 2, 3, 5, 6, 8], 9, 6)
    assert found("Foreign", channels=["can1"]) == ([1, 4, 7], 9, 3)
    assert found("error") == ([], 9, 0)
