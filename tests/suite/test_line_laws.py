"""A serial line and the rows of its faults: spoilt bytes, what a framing gives and counts, and when a claim is judged.

FAULTS.md and EXPECTATIONS.md describe them.
"""

import errno
import math

import pytest

from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import PackedFrames
from hil.faults.kinds import KINDS, find, is_instant, link_faults
from hil.faults.link_faults import ByteFault, LinkFault
from hil.faults.rows import REST_RAD_S, FaultRow, ScenarioTime, claimed_span_s
from hil.wire.byte_faults import FaultLine
from hil.wire.can_errors import causes_of, failure
from hil.wire.can_url import CanUrl
from hil.wire.conditions import ConditionedLink
from hil.wire.framed import StreamLink
from hil.wire.streams import MemoryStream, memory_pair
from hil.wire.url import parse_link
from tests.suite import link_bench as bench
from tests.suite.link_bench import BEAT, MS, STEP, Clock, command, framed, heard, row, tick


def line(*rows: FaultRow, begun: bool = True) -> tuple[Clock, FaultLine, MemoryStream, list[LinkFault]]:
    clock = Clock()
    time = bench.begun(clock) if begun else ScenarioTime(clock)
    here, there = memory_pair()
    faults = link_faults(rows, 1)
    return clock, FaultLine(here, time, [one for one in faults if isinstance(one, ByteFault)]), there, faults


def wrong_bits(sent: bytes, arrived: bytes) -> int:
    return sum((a ^ b).bit_count() for a, b in zip(sent, arrived, strict=True))


@pytest.mark.parametrize("direction", ["command", "feedback"])
def test_bits_are_wrong_by_their_rate_in_both_directions(direction: str) -> None:
    _, faulty, there, faults = line(row("bit_errors", direction, 0.01))
    sent = framed([command(number) for number in range(1500)])
    if direction == "command":
        faulty.write(sent)
        arrived = there.read(0)
    else:
        there.write(sent)
        arrived = faulty.read(0)
    bits = 8 * len(sent)
    assert wrong_bits(sent, arrived) == pytest.approx(0.01 * bits, abs=6 * math.sqrt(0.01 * bits))
    whole = 0.99 ** (8 * len(sent) / 1500)
    assert faults[0].applied == pytest.approx(1500 * (1.0 - whole), abs=6 * math.sqrt(1500 * whole * (1.0 - whole)))


def test_a_line_is_whole_before_the_scenario_in_other_windows_and_for_other_messages() -> None:
    sent = framed([command(number) for number in range(50)])
    for rows, begun in (
        ([row("bit_errors", "command", 0.2)], False),
        ([row("bit_errors", "command", 0.2, 10, 20), row("truncation", "TICK", 1.0)], True),
        ([row("bit_errors", "feedback", 0.2), row("truncation", "HOST_HEARTBEAT", 1.0)], True),
    ):
        _, faulty, there, faults = line(*rows, begun=begun)
        faulty.write(sent)
        assert there.read(0) == sent
        assert [fault.applied for fault in faults] == [0] * len(rows)


@pytest.mark.parametrize(("kind", "value"), [("bit_errors", 0.01), ("truncation", 0.3), ("babble", 300.0)])
def test_spoilt_bytes_make_no_wrong_frame_and_leave_lockstep_whole(kind: str, value: float) -> None:
    clock, faulty, there, faults = line(row(kind, "command", value))
    framer, deframer = Framer(), Deframer()
    for number in range(256):
        clock.now = number * MS
        faulty.write(framer.encode(command(number)))
        faulty.write(framer.encode(STEP))
    frames = deframer.feed(there.read(0))
    commands = [frame for frame in frames if frame.id == m.WheelCommand.ID]
    assert frames.count(STEP) == 256
    assert set(commands) <= {command(number) for number in range(256)}
    lost, applied = 256 - len(commands), faults[0].applied
    if kind == "babble":  # every other is garbage, which spoils the next frame; the others are whole frames of nobody
        assert applied == 76
        assert lost == pytest.approx(38, abs=6)
    else:
        whole = 0.99 ** (8 * 13) if kind == "bit_errors" else 0.7
        assert applied == pytest.approx(256 * (1.0 - whole), abs=50)
        assert lost == pytest.approx(applied, abs=0.2 * applied), "only a zero byte may be cut off without a loss"
    unknown = deframer.rejected["unknown_id"]
    assert unknown == (applied // 2 if kind == "babble" else 0)


def test_what_is_read_is_spoilt_frame_by_frame_however_it_comes_in() -> None:
    data = framed([command(number) for number in range(30)])

    def read(size: int) -> bytes:
        _, faulty, there, _ = line(row("bit_errors", "feedback", 0.01))
        heard = b""
        for at in range(0, len(data), size):
            there.write(data[at : at + size])
            heard += faulty.read(0)
        return heard

    assert read(len(data)) == read(1) == read(7) != data


# The framing


def test_a_line_gives_fifty_frames_at_once_and_counts_all() -> None:
    here, there = memory_pair()
    link = StreamLink(here)
    clock = Clock()
    link.now_ns = clock.now_ns
    there.write(framed([tick(number) for number in range(120)]))
    clock.now = 7
    batches = []
    while (received := link.receive(0)) is not None:
        batches.append(received)
        clock.now = 9
    assert [len(one.frames) for one in batches] == [50, 50, 20]
    assert [frame for one in batches for frame in one.frames] == [tick(number) for number in range(120)]
    assert {one.stamp_ns for one in batches} == {7}
    assert link.received_frames == 120


def test_frames_that_were_lost_on_a_line_are_counted_and_a_reopened_one_begins_anew() -> None:
    here, there = memory_pair()
    link = StreamLink(here)
    framer = Framer()
    pieces = [framer.encode(tick(number)) for number in range(300)]
    for first, last, lost in ((0, 10, 0), (13, 20, 3), (20, 290, 3)):
        there.write(b"".join(pieces[first:last]))
        heard(link)
        assert link.rejected()["lost"] == lost
    there.write(b"\x05\x06\0" + pieces[290][:4])
    assert link.receive(0) is None
    link.reopen()
    there.write(pieces[299])
    assert heard(link) == [tick(299)]
    assert link.rejected()["lost"] == 3, "the gap was on the line before"
    before = link.sent_frames, link.sent_bytes
    link.begin_byte_counts()
    link.send_packed(PackedFrames(pack([command(1), command(2)])))
    link.send(command(3))
    data = there.read(0)
    assert Deframer().feed(data) == [command(1), command(2), command(3)]
    assert link.byte_counts() == (len(data), 0)
    assert (link.sent_frames - before[0], link.sent_bytes - before[1]) == (3, len(data))


@pytest.mark.parametrize("target", ["command", "WHEEL_COMMAND", "HOST_HEARTBEAT"])
def test_packed_frames_pass_the_faults_as_single_ones_do(target: str) -> None:
    frames = [BEAT, command(1), STEP, command(2)]
    arrived = []
    for some in (frames, PackedFrames(pack(frames))):
        here, there = memory_pair()
        clock, faults = Clock(), link_faults([row("duplicate", target)], 1)
        link = ConditionedLink(StreamLink(here), clock, faults=faults, scenario_time=bench.begun(clock))
        link.send_all(some)
        arrived.append(Deframer().feed(there.read(0)))
    assert arrived[0] == arrived[1]
    doubled = {"command": 3, "WHEEL_COMMAND": 2, "HOST_HEARTBEAT": 1}[target]
    assert len(arrived[0]) == 4 + doubled
    assert arrived[0].count(STEP) == 1


# Words of errors, and rows


def test_an_error_frame_has_the_causes_that_linux_gives_them() -> None:
    """include/uapi/linux/can/error.h"""
    for identifier, data, causes in (
        (0x040, b"", ("error_bus_off",)),
        (0x004, b"\0\x04", ("error_warning",)),
        (0x004, b"\0\x10", ("error_passive",)),
        (0x004, b"\0\x01", ("error_overflow",)),
        (0x088, b"\0\0\x04", ("error_stuff",)),
        (0x080, b"\0\0\x02", ("error_form",)),
        (0x008, b"\0\0\x01", ("error_bit",)),
        (0x020, b"", ("error_acknowledgement",)),
        (0x002, b"", ("error_arbitration",)),
        (0x001, b"", ("error_transmit_timeout",)),
        (0x110, b"", ("error_transceiver", "error_restarted")),
        (0x200, b"", ("error_other",)),
        (0x004, b"\x30\0\x30", ("error_other",)),
    ):
        assert causes_of(identifier, data) == causes


@pytest.mark.parametrize(
    ("interface", "error", "words"),
    [
        ("socketcan/can9", OSError(errno.ENETDOWN, "x"), "is down; bring it up: ip link set can9 up type can bitrate"),
        ("socketcan/can9", OSError(errno.ENODEV, "x"), "does not exist"),
        ("socketcan/can9", OSError(errno.ENOBUFS, "x"), "the transmit queue stays full"),
        ("pcan/PCAN_USBBUS1", ImportError("no library"), "install PEAK's PCAN-Basic library"),
        ("vector/0", ValueError("the bitrate 3 is odd"), "cannot run at"),
        ("kvaser/0", OSError("lost"), "failed (lost); check that the adapter is plugged in"),
    ],
)
def test_a_failure_of_an_interface_says_what_to_do(interface: str, error: Exception, words: str) -> None:
    url = parse_link(f"can:{interface}")
    assert isinstance(url, CanUrl)
    assert words in str(failure(url, error))


def test_a_claim_after_a_fault_is_judged_in_its_time() -> None:
    faults = [{"kind": "mute", "start_s": 1.0, "end_s": 3.0}, {"kind": "reset", "start_s": 2.0, "name": "again"}]
    for claim, span in (
        ({}, (0.0, math.inf)),
        ({"from_s": 0.5, "to_s": 2.5}, (0.5, 2.5)),
        ({"after_fault": "mute", "within_s": 0.4}, (1.4, math.inf)),
        ({"after_fault": 2, "within_s": 0.4, "to_s": 4.0}, (2.4, 4.0)),
        ({"after_fault": "mute", "within_s": 0.4, "at_rest": True}, (1.4, 3.0)),
        ({"after_fault": "mute", "within_s": 2.5, "at_rest": True}, (3.5, math.inf)),
        ({"after_fault": "mute", "within_s": 2.0, "at_rest": True}, (3.0, math.inf)),
        ({"after_fault": "again", "within_s": 0.3, "stops": True}, (2.0, 2.3)),
    ):
        assert claimed_span_s(claim, faults) == span
    for wrong in ("nothing", 3, 0):
        with pytest.raises(ValueError, match=r"no fault has this|expected a row"):
            claimed_span_s({"after_fault": wrong}, faults)
    with pytest.raises(ValueError, match="name one of them"):
        claimed_span_s({"after_fault": "mute"}, [faults[0], faults[0]])


def test_a_row_is_in_force_from_its_first_instant_to_before_its_last() -> None:
    one = row("drop", "command", 1.0, 10, 20)
    assert [one.is_in_force(t) for t in (10 * MS - 1, 10 * MS, 20 * MS - 1, 20 * MS)] == [False, True, True, False]


NOTHING: dict[str, float | None] = dict.fromkeys(("value", "burst_frames", "x_m", "y_m", "radius_m"))


def test_numbers_of_a_row_keep_the_ranges_of_their_kind() -> None:
    most = {
        "drop": 1.0, "burst_loss": 0.99, "delay": 10.0, "jitter": 10.0, "duplicate": 1.0, "reorder": 1.0,
        "bit_errors": 0.5, "truncation": 1.0, "babble": 1e5, "gyro_bias": 100.0, "slow_clock": 1e5, "slip_patch": 1.0,
    }  # fmt: skip
    assert {kind.name: kind.value.high for kind in KINDS if kind.name in most and kind.value} == most
    assert pytest.approx(0.015) == REST_RAD_S * 0.075, "15 mm/s at the rim"
    for kind in KINDS:
        target = kind.targets[0] if kind.targets else "mass_kg"
        assert find(kind.name, target) == kind
        assert is_instant(kind.name, target) is (kind.name in ("estop", "reset"))
        if (value := kind.value) is None or kind.further:
            continue
        kind.check(target, NOTHING | {"value": value.high})
        for wrong in (value.low if value.excludes_low else value.low - 1.0, value.high * 1.001, None):
            with pytest.raises(ValueError, match="value"):
                kind.check(target, NOTHING | {"value": wrong})
        with pytest.raises(ValueError, match="takes no radius_m"):
            kind.check(target, NOTHING | {"value": value.high, "radius_m": 1.0})
    bursts = find("burst_loss", "command")
    bursts.check("command", {"value": 0.66, "burst_frames": 2.0})
    with pytest.raises(ValueError, match="lower value"):
        bursts.check("command", {"value": 0.67, "burst_frames": 2.0})
    with pytest.raises(ValueError, match="belong together"):
        find("slip_patch", "floor").check("floor", NOTHING | {"value": 0.5, "x_m": 1.0})
