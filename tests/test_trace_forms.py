"""``hil decode`` shows or counts everything in a trace, whichever tool wrote it."""

import gzip
import json
import math
import re
import shutil
import struct
import subprocess
import zlib

import can
import pytest
from can.io import blf
from hypothesis import assume, given
from hypothesis import strategies as st

from hil.wire.trace import decode
from tests.examples import share_of_examples
from tests.processes import hil

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
    return entry.number, entry.extended, entry.payload, entry.direction


def things_in(path):
    """How many frames a file has by counting its lines, or by the count in its header."""
    content = path.read_bytes()
    if path.suffix == ".blf":
        return blf.FILE_HEADER_STRUCT.unpack_from(content)[12]
    unlike = {".asc": rb"[^ \d]| +0.000000 Start", ".trc": rb";", ".log": rb"$"}[path.suffix]
    return sum(re.match(unlike, line) is None for line in content.splitlines())


@given(
    ending=st.sampled_from(["asc", "blf", "log", "trc"]),
    messages=st.lists(a_message(), min_size=1, max_size=12),
    stamps=st.lists(st.integers(0, 1000), min_size=12, max_size=12),
)
def test_every_frame_that_python_can_writes_is_read(tmp_path_factory, ending, messages, stamps):
    if ending == "trc":  # its writer has neither FD frames nor others without data
        messages = [one for one in messages if not (one.is_fd or one.is_remote_frame or one.is_error_frame)]
        assume(messages)
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
    first = 0 if ending in ("log", "trc") else 1  # Vector's formats count from 1
    named = [form.format(one.channel + first) for one in messages]
    if ending == "trc":
        assert {entry.channel for entry in entries} <= {str(number) for number in range(6)}
    else:
        assert [entry.channel for entry in entries] == named


@can_utils
@share_of_examples(0.5)
@given(
    messages=st.lists(a_message(), min_size=1, max_size=12),
    options=st.lists(st.sampled_from(["-4", "-n", "-f", "-r"]), unique=True),
)
def test_every_frame_that_can_utils_write_is_read(tmp_path_factory, messages, options):
    folder = tmp_path_factory.mktemp("utils")
    with can.Logger(folder / "bus.log") as log:
        for message in stamped(messages, range(0, 1000, 10)):
            log.on_message_received(message)
    buses = [f"can{number}" for number in range(5)]
    subprocess.run(["log2asc", "-I", "bus.log", "-O", "bus.asc", *options, *buses], cwd=folder, check=True)
    subprocess.run(["asc2log", "-I", "bus.asc", "-O", "back.log"], cwd=folder, check=True, capture_output=True)
    for name in ("bus.asc", "back.log"):
        reading = decode.read(folder / name, EVERYTHING)
        entries = list(reading)
        assert (reading.trouble, reading.rest()) == (None, None)
        assert len(entries) == things_in(folder / name)
        channels = [f"can{int(one.channel) - 1}" if name == "bus.asc" else one.channel for one in entries]
        assert channels[: len(messages)] == [f"can{one.channel}" for one in messages][: len(channels)]
    whole = list(decode.read(folder / "bus.asc", EVERYTHING))
    assert len(whole) == len(messages)
    if "-f" not in options:  # it writes an error frame as data
        assert [one.kind == decode.ERROR for one in whole] == [one.is_error_frame for one in messages]
    sent = [(one.arbitration_id, bytes(one.data)) for one in messages if not one.is_error_frame]
    read = [(one.number, one.payload) for one, was in zip(whole, messages, strict=True) if not was.is_error_frame]
    assert read == sent


@can_utils
def test_relative_time_stamps_count_from_the_line_before(tmp_path):
    path = tmp_path / "bus.asc"
    lines = [f"   0.{number}00000 1  123  Rx   d 1 0{number}\n" for number in (5, 1, 3, 1)]
    path.write_text("date Tue Nov 14 22:13:20 2023\nbase hex  timestamps relative\n" + "".join(lines))
    done = subprocess.run(["asc2log", "-I", path], check=True, capture_output=True, text=True)
    theirs = [float(line[1:].partition(")")[0]) for line in done.stdout.splitlines()]
    ours = [entry.unix_s for entry in decode.read(path, EVERYTHING)]
    assert [one - ours[0] for one in ours] == pytest.approx([one - theirs[0] for one in theirs], abs=1e-5)
    assert ours[-1] - ours[0] == pytest.approx(0.5)


HEAD = "date Tue Nov 14 10:13:20.000 PM 2023\nbase hex  timestamps absolute\ninternal events logged\n"
BEGIN = HEAD + "Begin Triggerblock Tue Nov 14 10:13:20.000 PM 2023\n"
TRC = ";$FILEVERSION=2.1\n;$STARTTIME=45000.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
LAST = "040 [8] 60 00 ee 03 8a 00 10 51"
CASES = {
    # name: (content, the payloads of frames (None: an error frame), words of the note, words of the refusal)
    "bare.asc": ("0.001 1 123 Rx d 1 01\n0.002 1 123 Rx d 1 02\n", ["01", "02"], (), ()),
    "no_date.asc": ("base hex timestamps absolute\n0.001 1 123 Rx d 1 01\n", ["01"], (), ()),
    "decimal.asc": (
        "base dec timestamps absolute\n0.001 1 291 Rx d 2 16 255\n0.002 1 418119424x Rx d 1 7\n",
        ["10ff", "07"],
        (),
        (),
    ),
    "no_feed.asc": ("0.001 1 123 Rx d 1 01\n0.002 1 123 Rx d 2 02 03", ["01", "0203"], (), ()),
    "cut.asc": ("0.001 1 123 Rx d 1 01\n0.002 1 123 Rx d 2 02 0", ["01"], (), ("cut within line 2",)),
    "cut_decimal.asc": ("base dec\n0.002 1 291 Rx d 1 25", [], (), ("cut within line 2",)),
    "fd_start.asc": (
        BEGIN + "   0.000000 CANFD   Start of measurement\n"
        "   0.1 CANFD   1 Rx  4B0  1 0 8 8 00 01 02 03 04 05 06 07   0  0   323040 0 0 0 0 0\n"
        "   0.2 CANFD   1 Rx  201  EngineData 0 0 2 2 AA BB\n   0.3 CANFD 2 Tx 4B0 0 0 5 0 140000 73 200050 7a60\n"
        "   0.4 CANFD 2 Rx 4B0 1 0 0 0 1 1 303000 0 0\nEnd TriggerBlock\n",
        ["0001020304050607", "aabb", "", ""],
        (),
        (),
    ),
    "names.asc": (
        BEGIN + "   0.1 1  EngineData  Rx   d 1 00\n   0.2 1  123  Rx   d 1 01\n   0.3 CANFD 1 Rx Gear 1 0 1 1 07\n"
        "End TriggerBlock",
        ["01"],
        ("frames with a name in place of their identifier", "numbers): 2"),
        (),
    ),
    "requests.asc": ("0.1 1 123 TxRq d 1 01\n0.2 1 123 Tx d 1 01\n", ["01", "01"], (), ()),
    "events.asc": (
        "0.1 1  Statistic: D 0 R 0\n0.2 CAN 1 Status:chip status error active\n0.3 Li 60 Rx 8 00 00\n0.4 1 123 Rx d 0\n"
        "0.5 1  J1939TP FEE3p 6 0 0 - Rx d 3 01 02 03\n0.55 0 16777215 0 1 GMGroup: here GMMarker: x\n"
        "0.6 2 ErrorFrame ECC: 10100010\n0.7 1  Statistic: D 1 R 0\n",
        ["", None],
        ("Statistic lines: 2", "Status lines: 1", "Li lines: 1", "J1939TP lines: 1", "markers: 1"),
        (),
    ),
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
    "v10.trc": (
        ";   Start time: 11.09.2002\n 1)  1841  0001  2  00 01\n 2)  1842  0008  4  ERROR 00 19 08 08\n"
        " 3)  1843  FFFFFFFF  4  00 00 00 04 -- -- -- --  BUSLIGHT\n 4)  1844  0100  3  RTR",
        ["0001", None, ""],
        ("warnings: 1",),
        (),
    ),
    "v12.trc": (
        ";$FILEVERSION=1.2\n;$STARTTIME=39878.6772258947;\n1) 1059.9 1 Rx 0300 2 00 01\n"
        "2) 1060.0 1 Warng FFFFFFFF 4 00 00 00 04 BUSLIGHT\n3) 1061.0 1 Error 0008 4 00 19 08 08\n"
        "4) 1062.0 2 Tx 18EFC034 1 07",
        ["0001", None, "07"],
        ("Warng rows: 1",),
        (),
    ),
    "v21.trc": (
        TRC + "1 1.0 DT 1 0300 Rx - 2 00 01\n2 1.1 FD 1 0500 Tx - 9 01 02 03 04 05 06 07 08 09 0A 0B 0C\n"
        "3 1.2 ER 1    - Rx - 5 04 00 02 00 00\n4 1.3 EV -  User-defined event\n5 1.4 ST 1    - Rx - 4 00 00 00 08\n"
        "6 1.5 EC 1    - Rx - 2 02 02\n7 1.6 RR 1 0100 Rx - 3\n",
        ["0001", "0102030405060708090a0b0c", None, ""],
        ("EV rows: 1", "ST rows: 1", "EC rows: 1"),
        (),
    ),
    "cut.trc": (
        TRC + "1 1.0 DT 1 0300 Rx - 2 00 01\n2 1.1 DT 1 0300 Rx - 2 00 0",
        ["0001"],
        (),
        ("cut within line 5",),
    ),
    "no_length.trc": (TRC + "1 1.0 DT 1 0300 Rx - -1 00\n", [], (), ("line 4",)),
    "endless.log": (f"({'9' * 400}.0) can0 123#00\n", [], (), ("line 1",)),
    "unknown.trc": (";$FILEVERSION=3.0\n1 1.0 DT 1 0300 Rx - 1 00\n", [], (), ("version 3.0", "2.1")),
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
    counted = json.loads(hil("decode", "--raw", "--counts", "--json", path).stdout or "[]")
    assert sum(row["frames"] for row in counted) == len(payloads)


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("a.log", gzip.compress(b"(1.0) can0 123#00\n", mtime=0), "gzip"),
        ("a.blf", gzip.compress(b"LOGG", mtime=0), "gzip"),
        ("b.asc", "0.1 1 123 Rx d 0\n".encode("utf-16"), "UTF-16"),
        ("c.log", b"LOGG" + bytes(140), "a .blf by its content"),
        ("c.blf", b"LOGG", "it is not a .blf file"),
        ("d.log", TRC.encode(), "a .trc by its content"),
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
    [row] = json.loads(hil("decode", "--counts", "--json", path).stdout)
    assert (row["frames"], row["per_s"]) == (3, 3.0)
    assert len(hil("decode", "--from", "0", path).stdout.splitlines()) == 2
    assert "3 frames of 1.000 s" in hil("decode", "--from", "9", path).stderr


def test_each_channel_is_shown_counted_and_selected_on_its_own(tmp_path):
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
    done = hil("decode", "--counts", "--channel", "can0", path)
    assert [line.split() for line in done.stdout.splitlines()[1:]] == [
        ["WHEEL_COMMAND", "040", "1", "2.5", "can0"],
        ["foreign", "1", "2.5", "can0"],
    ]
    assert "no TICK of our firmware on channel can1" in hil("decode", path).stderr
    assert "5 frames of 0.400 s on can0, can1" in hil("decode", "--channel", "can7", path).stderr


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


@pytest.mark.parametrize("length", [0, 1, 15, 17, 40])
def test_a_blf_object_of_no_sensible_size_is_damage(tmp_path, length):
    path = a_blf(tmp_path / "bus.blf", DATA + an_object(blf.CAN_MESSAGE, bytes(16), length=length))
    done = hil("decode", path)
    assert (done.returncode, len(done.stdout.splitlines())) == (2, 1)
    assert "1 frames could be read; the file is damaged in the block at byte 144" in done.stderr


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
    assert (
        done.stderr
        == f"hil: note: {path}: left out, not readable as CAN frames: texts: 2, statistics: 1, objects of type 200: 1\n"
    )
    assert "its last object is cut" in hil("decode", a_blf(tmp_path / "cut.blf", stream[:-50])).stderr
