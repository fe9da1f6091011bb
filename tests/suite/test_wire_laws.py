"""The wire: bits of a CAN frame, load, errors of a bus and of a line, and the output and counts of a framing.

FAULTS.md and STATISTICS.md describe them.
"""

import itertools
import math
import random
from typing import Any

import can
import pytest

from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import LinkError
from hil.core.ports import EXTENDED, REMOTE
from hil.faults.kinds import link_faults
from hil.faults.link_faults import ByteFault, LinkFault
from hil.faults.rows import FaultRow
from hil.wire.byte_faults import BusFaults
from hil.wire.can_bus import CanLink
from hil.wire.can_meter import classic_bits, fd_bits
from hil.wire.conditions import ConditionedLink
from hil.wire.framed import StreamLink
from hil.wire.link_statistics import LinkStatistics, LoadWindow, observe
from hil.wire.streams import memory_bus, memory_pair
from hil.wire.url import parse_link
from tests.suite import link_bench as bench
from tests.suite.can_frame_model import classic_frame, fd_lengths
from tests.suite.link_bench import MS, STEP, Clock, command, heard, row, tick

# Bits of a CAN frame


def payloads() -> list[bytes]:
    chance = random.Random(5)
    some = [
        bytes(chance.choice((0, 0xFF, 0x0F, 0x1F, 0x83, chance.randrange(256))) for _ in range(n % 9))
        for n in range(60)
    ]
    return [b"", bytes(8), b"\xff" * 8, *some]


def test_a_classic_frame_has_its_bits_with_those_that_are_stuffed() -> None:
    standard, extended = [(0, False), (0x7FF, False), (0x1F, False), (0x123, False)], [(0, True), (0x1FFFFFFF, True)]
    extended += [(0x1F, True), (0x18FF1234, True)]
    for payload, (number, is_extended) in itertools.product(payloads(), standard + extended):
        expected = len(classic_frame(number, payload, extended=is_extended))
        assert classic_bits(number, payload, extended=is_extended) == expected
    for asked in (0, 4, 8):
        assert classic_bits(0x55, b"", remote_length=asked) == len(classic_frame(0x55, b"", remote_length=asked))


@pytest.mark.parametrize("extended", [False, True])
def test_an_fd_frame_has_its_slow_bits_and_its_fast_ones(extended: bool) -> None:
    chance = random.Random(6)
    for length, switched in itertools.product((0, 1, 7, 8, 12, 16, 20, 32, 48, 64), (False, True)):
        for _ in range(12):
            payload = bytes(chance.choice((0, 0xFF, chance.randrange(256))) for _ in range(length))
            number = chance.randrange(0x1FFFFFFF if extended else 0x7FF)
            found = fd_bits(number, payload, extended=extended, switched=switched)
            assert found == fd_lengths(number, payload, extended=extended, switched=switched)


# Load


def test_the_load_is_of_the_last_100_ms_and_the_worst_is_kept() -> None:
    window = LoadWindow()
    assert window.percent(0) == 0.0
    for ms in range(0, 60, 10):
        window.add(ms * MS + MS, 2 * MS)
    assert window.percent(60 * MS) == pytest.approx(12.0)
    assert window.percent(109 * MS) == pytest.approx(10.0), "since 10 ms"
    assert window.percent(145 * MS) == pytest.approx(2.0)
    assert window.percent(151 * MS) == 0.0
    window.add(900 * MS, 3 * MS)
    assert window.percent(900 * MS) == pytest.approx(3.0)
    assert window.figures(1000 * MS) == pytest.approx({"mean_percent": 1.5, "worst_100_ms_percent": 12.0})
    assert window.figures(0)["mean_percent"] is None


def observed(url: str) -> tuple[Any, Clock, LinkStatistics, ConditionedLink, Any]:
    clock, link = Clock(), parse_link(url)
    here: Any
    there: Any
    if link.is_bus:
        here, there = CanLink(link, "ROBOT"), CanLink(link, "HOST")  # type: ignore[arg-type]
    else:
        stream, there = memory_pair()
        here = StreamLink(stream)
    statistics = observe(here, link, clock)
    return here, clock, statistics, ConditionedLink(here, clock, observer=statistics), there


def test_a_serial_line_has_ten_bits_a_byte_and_each_direction_its_own_load() -> None:
    _, clock, statistics, link, there = observed("serial:/dev/none?baud=100000")
    framer, sent, received = Framer(), 0, 0
    for ms in range(0, 100, 5):
        clock.now = ms * MS
        link.send(command(ms))
        sent += len(there.read(0))
        data = b"".join(framer.encode(tick(one)) for one in range(3)) + b"\x07\0"
        there.write(data)
        received += len(data)
        assert len(heard(link)) == 3
        counts = statistics.byte_counts()
        assert counts == (sent, received)
        assert statistics.load_percent(counts) == pytest.approx(100.0 * received * 10 / 100_000 / 0.1)
    clock.now = 200 * MS
    figures = statistics.figures()
    assert figures["sent"] == {"frames": 20, "bytes": sent}
    assert figures["received"] == {"frames": 60, "bytes": received}
    assert figures["load"]["sent"]["mean_percent"] == pytest.approx(100.0 * sent * 10 / 100_000 / 0.2)
    assert figures["load"]["received"]["worst_100_ms_percent"] == pytest.approx(100.0 * received * 10 / 100_000 / 0.1)
    assert (figures["lasted_s"], figures["foreign"]) == (0.2, None)
    statistics.begin()
    assert statistics.byte_counts() == (0, 0)
    assert statistics.figures()["sent"]["frames"] == 0
    assert link.rejected()["lost"] == 0
    assert sum(link.rejected().values()) == 20, "the noise between the frames"


@pytest.mark.parametrize("settings", ["?bitrate=500000", "?bitrate=500000&fd=1&data_bitrate=2000000"])
def test_a_can_bus_carries_both_directions_and_strangers(settings: str) -> None:
    here, clock, statistics, link, there = observed("can:virtual/suite_load" + settings)
    stranger = can.Bus(interface="virtual", channel="suite_load")
    try:
        sent, answer = [command(1), command(2)], tick(3)
        for frame in sent:
            link.send(frame)
        there.send(answer)
        stranger.send(can.Message(arbitration_id=0x18FF1234, data=b"\0" * 8))
        stranger.send(can.Message(arbitration_id=0x555, is_extended_id=False, is_remote_frame=True, dlc=4))
        stranger.send(can.Message(is_error_frame=True, data=b"\0" * 8))
        assert heard(link) == [answer]
        clock.now = 50 * MS
        if "fd" in settings:
            used = [fd_bits(*one, switched=True) for one in (*sent, answer)]
            ns = [one.nominal * 2000 + one.data * 500 for one in used]
        else:
            ns = [2000 * len(classic_frame(*one)) for one in (*sent, answer)]
        strangers = [classic_frame(0x18FF1234, bytes(8), extended=True), classic_frame(0x555, b"", remote_length=4)]
        foreign = sum(map(len, strangers))
        figures = statistics.figures()
        assert figures["sent"] == {"frames": 2, "bytes": 16}
        assert figures["received"] == {"frames": 1, "bytes": len(answer.payload)}
        assert figures["foreign"] == {"frames": 3, "bytes": 8}
        busy_s = (sum(ns) + 2000 * foreign) * 1e-9
        assert figures["load"]["bus"]["mean_percent"] == pytest.approx(100.0 * busy_s / 0.05)
        counts = statistics.byte_counts()
        assert counts == (16, len(answer.payload))
        assert statistics.load_percent(counts) == pytest.approx(100.0 * busy_s / 0.1)
        assert link.rejected()["foreign"] == 2
        assert link.rejected()["error_other"] == 1
    finally:
        for end in (here, there):
            end.close()
        stranger.shutdown()


def test_flags_of_an_identifier_are_no_bits_of_it() -> None:
    meter = parse_link("can:virtual/none?bitrate=1000000").meter(None)
    frames = [Frame(EXTENDED | 0x18FF1234, bytes(3)), Frame(REMOTE | 0x29, b"")]
    whole = classic_frame(0x18FF1234, bytes(3), extended=True), classic_frame(0x29, b"", remote_length=8)
    assert [meter.sent([one]) for one in frames] == [1000 * len(one) for one in whole]  # type: ignore[attr-defined]


# Errors of a bus


class Bus:
    """A CAN bus in memory with errors: the host's link, the robot's end, and a node that babbles."""

    def __init__(self, *rows: FaultRow) -> None:
        self.clock = Clock()
        self.faults: list[LinkFault] = link_faults(rows, 1)
        self.here, self.there = memory_bus()
        self.babbler, self.listener = memory_bus()
        of_bytes = [fault for fault in self.faults if isinstance(fault, ByteFault)]
        bus, time = BusFaults(of_bytes, self.babbler), bench.begun(self.clock)
        self.link = ConditionedLink(self.here, self.clock, bus=bus, scenario_time=time)


def test_a_frame_is_sent_again_until_it_is_whole_and_its_chance_grows_with_its_bits() -> None:
    rate = 0.0008
    for frame in (command(1), Frame(m.TimeSyncRequest.ID, m.TimeSyncRequest(1).encode())):
        bus = Bus(row("bit_errors", "command", rate))
        for _ in range(2000):
            bus.link.send(frame)
        assert heard(bus.there) == [frame] * 2000
        whole = (1.0 - rate) ** (47 + 8 * len(frame.payload))
        expected = 2000 * (1.0 - whole) / whole
        assert bus.faults[0].applied == bus.link.rejected()["error_bit"]
        assert bus.faults[0].applied == pytest.approx(expected, abs=6 * math.sqrt(expected))


@pytest.mark.parametrize("direction", ["command", "feedback"])
def test_an_error_counts_eight_a_whole_frame_takes_one_and_256_is_bus_off(direction: str) -> None:
    bus = Bus(row("bit_errors", direction, 0.5))
    for again in (1, 2):
        if direction == "command":
            with pytest.raises(LinkError, match="bus-off"):
                bus.link.send(command(1))
        else:
            bus.there.send(tick(1))
            assert heard(bus.link) == []
        assert bus.faults[0].applied == 32 * again, "the counter begins anew"
    assert bus.link.rejected()["error_bus_off"] == (2 if direction == "command" else 0)
    bus.link.send(STEP)
    assert heard(bus.there) == [STEP]


def test_whole_frames_take_errors_off_one_by_one() -> None:
    """Every third frame has an error: four up for each frame, one down."""
    bus = Bus(row("bit_errors", "command", 0.0037))
    whole, is_off = 0, False
    while not is_off:
        try:
            bus.link.send(command(whole))
            whole += 1
        except LinkError:
            is_off = True
    errors = bus.faults[0].applied
    assert 200 < 8 * errors - whole < 256 + 8
    assert errors > 36


def test_a_cut_frame_is_too_short_for_its_message() -> None:
    bus = Bus(row("truncation", "command", 0.5), row("truncation", "feedback", 0.5))
    for number in range(400):
        bus.link.send(command(number))
        bus.there.send(tick(number))
    short = [len(frame.payload) for frame in heard(bus.there) if len(frame.payload) < 8]
    assert set(short) == set(range(8))
    assert len(short) == bus.faults[0].applied == pytest.approx(200, abs=60)
    assert len(heard(bus.link)) == 400 - bus.faults[1].applied
    assert bus.link.rejected()["length"] == bus.faults[1].applied == pytest.approx(200, abs=60)


def test_a_babbler_keeps_its_rate_within_its_window_with_ids_of_nobody() -> None:
    for sends in (True, False):
        bus = Bus(row("babble", "command", 500.0, from_ms=100, to_ms=300))
        for ms in range(0, 400, 5):
            bus.clock.now = ms * MS
            if sends:
                bus.link.send(command(ms))
            else:
                bus.there.send(tick(ms))
                assert heard(bus.link) == [tick(ms)]
        babbled = heard(bus.listener)
        assert bus.listener.received_frames == len(babbled)
        assert len(babbled) == bus.faults[0].applied == 97  # at the last tick of the window, 195 ms after its begin
        assert not {frame.id for frame in babbled} & set(m.LENGTHS)
        assert {len(frame.payload) for frame in babbled} == set(range(9))
        assert all(frame.id <= 0x7FF for frame in babbled)
    bus.listener.send(tick(1))
    bus.link.reopen()
    assert bus.babbler.receive(0) is None, "its end was opened again too"
