"""What is on the wire, counted: against the bytes at the other end, and against loads worked out the slow way."""

import itertools
import math

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.ports import Received
from hil.core.signals import SIGNAL_NAMES
from hil.runtime.assembly import run
from hil.wire.can_bus import CanLink
from hil.wire.can_meter import BusMeter, classic_bits, fd_bits
from hil.wire.conditions import ConditionedLink
from hil.wire.framed import StreamLink
from hil.wire.link_statistics import LineMeter, LoadWindow, observe
from hil.wire.serial_url import SerialUrl
from hil.wire.streams import memory_bus, memory_pair
from hil.wire.url import parse_link
from tests.support.client_rig import feed, new_client
from tests.support.heard import everything

MS = 1_000_000
WINDOW_NS = 100 * MS
MESSAGES = [m.TimeSyncRequest(3), m.Step(7, 5), m.WheelCommand(1.5, -2.25, 10.0, 0.0, 17, 5), m.Estop(1, 2)]
some_frames = st.lists(st.sampled_from(MESSAGES).map(codec.encode), max_size=30)


class Clock:
    def __init__(self):
        self.now = 0

    def now_ns(self):
        return self.now

    def wait_until(self, t_ns):
        self.now = t_ns
        return 0


@given(
    frames=st.lists(st.tuples(st.integers(0, 40), st.integers(0, 12 * MS)), max_size=60),
    silence=st.integers(0, 30),
)
def test_the_load_is_that_of_the_worst_window_and_of_the_last(frames, silence):
    window = LoadWindow()
    now_ns, heard = 0, []
    worst_ns = 0
    for gap, busy_ns in frames:
        now_ns += gap * 5 * MS
        heard.append((now_ns, busy_ns))
        window.add(now_ns, busy_ns)
        # Windows begin at multiples of 10 ms.
        begin_ns = now_ns // (10 * MS) * 10 * MS + 10 * MS - WINDOW_NS
        worst_ns = max(worst_ns, sum(busy for at, busy in heard if at >= begin_ns))
    end_ns = now_ns + silence * 10 * MS
    begin_ns = end_ns // (10 * MS) * 10 * MS + 10 * MS - WINDOW_NS
    last_ns = sum(busy for at, busy in heard if at >= begin_ns)
    assert window.percent(end_ns) == pytest.approx(100 * last_ns / WINDOW_NS)
    figures = window.figures(end_ns)
    assert figures["worst_100_ms_percent"] == pytest.approx(100 * worst_ns / WINDOW_NS)
    if end_ns:
        assert figures["mean_percent"] == pytest.approx(100 * sum(busy for _, busy in heard) / end_ns)


def test_a_time_before_that_of_the_last_count_is_of_the_present_bucket():
    """A bus counts received frames at their arrival, and sent frames now: either may be reported first."""
    late, in_order = LoadWindow(), LoadWindow()
    for window, times in ((late, (50, 0)), (in_order, (50, 50))):
        for ms in times:
            window.add(ms * MS, MS)
    for ms in (59, 100, 149):
        assert late.percent(ms * MS) == in_order.percent(ms * MS) == pytest.approx(2.0)
    assert late.percent(150 * MS) == in_order.percent(150 * MS) == 0.0
    assert late.figures(150 * MS) == in_order.figures(150 * MS)


@given(sent=some_frames, received=some_frames, noise=st.binary(max_size=40))
def test_a_serial_line_s_bytes_are_those_on_the_line(sent, received, noise):
    here, there = memory_pair()
    clock = Clock()
    link = StreamLink(here)
    statistics = observe(link, SerialUrl("/dev/ttyACM0", 115_200), clock)
    wire = ConditionedLink(link, clock, observer=statistics)
    framer = Framer()
    for frame in map(codec.encode, MESSAGES[:3]):  # the handshake, which does not count
        wire.send(frame)
        there.write(framer.encode(frame) + b"\0")
    there.read(0)
    everything(wire)
    clock.now = 30 * MS
    statistics.begin()
    for frame in sent:
        wire.send(frame)
    line_down = there.read(0)
    line_up = noise + b"\0" + b"".join(framer.encode(frame) for frame in received)
    there.write(line_up)
    taken = everything(wire)
    clock.now = 280 * MS
    figures = statistics.figures()
    assert figures["lasted_s"] == pytest.approx(0.25)
    assert figures["sent"] == {"frames": len(sent), "bytes": len(line_down)}
    assert taken[len(taken) - len(received) :] == received
    if taken:
        assert figures["received"] == {"frames": len(taken), "bytes": len(line_up)}
    assert figures["load"]["received"]["mean_percent"] == pytest.approx(len(line_up) * 10 / 115_200 / 0.25 * 100)
    assert figures["load"]["sent"]["mean_percent"] == pytest.approx(len(line_down) * 10 / 115_200 / 0.25 * 100)


def test_of_many_frames_at_once_those_count_that_were_given():
    here, there = memory_pair()
    wire = StreamLink(here)
    statistics = observe(wire, parse_link("memory:"), Clock())
    framer = Framer()
    there.write(b"".join(framer.encode(Frame(m.TimeSyncRequest.ID, b"\1")) for _ in range(120)))
    counted = []
    while wire.receive(0) is not None:
        counted.append(statistics.figures()["received"]["frames"])
    assert counted == [50, 100, 120]


def test_a_bus_in_memory_counts_payloads_in_both_directions_from_the_beginning():
    here, there = memory_bus()
    clock = Clock()
    here.now_ns = clock.now_ns
    meter = LineMeter(here, None)
    for sent, received in (((3, 4), (8, 0, 2)), ((1,), (5, 5))):
        meter.begin()
        for length in sent:
            here.send(Frame(0x100, bytes(length)))
        for length in received:
            there.send(Frame(0x200, bytes(length)))
        clock.now += 7 * MS
        assert here.receive(0) == Received([Frame(0x200, bytes(length)) for length in received], clock.now)
        assert here.receive(0) is None
        assert meter.counts() == ((len(sent), sum(sent)), (len(received), sum(received)))
    assert (here.sent_frames, here.received_frames) == (3, 5)
    assert (meter.timed, meter.byte_ns) == (False, 0.0)
    assert LineMeter(here, 115_200).byte_ns == pytest.approx(1e9 * 10 / 115_200)


@pytest.mark.parametrize("settings", ["", "?fd=1", "?fd=1&data_bitrate=4000000"])
def test_a_can_bus_carries_both_directions_and_what_others_say(settings):
    url = parse_link(f"can:virtual/load{settings}")
    robot, other = CanLink(url, "HOST"), can.Bus(interface="virtual", channel="load")
    clock = Clock()
    host = CanLink(url, "ROBOT")
    statistics = observe(host, url, clock)
    wire = ConditionedLink(host, clock, observer=statistics)
    try:
        command, tick = codec.encode(MESSAGES[2]), codec.encode(m.Tick(1, 2, 3, 3, 0, 9))
        wire.send(command)
        robot.send(tick)
        other.send(can.Message(arbitration_id=0x18FF1234, data=b"\0" * 8))
        other.send(can.Message(arbitration_id=0x555, is_extended_id=False, is_remote_frame=True, dlc=4))
        other.send(can.Message(is_error_frame=True))
        assert everything(wire) == [tick]
        assert wire.receive(0) is None
        clock.now = 100 * MS
        figures = statistics.figures()
    finally:
        wire.close()
        robot.close()
        other.shutdown()
    foreign_us = classic_bits(0x18FF1234, bytes(8), extended=True) + classic_bits(0x555, b"", remote_length=4)
    assert figures["foreign"] == {"frames": 3, "bytes": 8}
    ours_us = 0.0
    for number, payload in (command, tick):
        nominal, data = fd_bits(number, payload, switched="data" in settings)
        ours_us += nominal + data / 4 if settings else classic_bits(number, payload)
    assert figures["load"]["bus"]["mean_percent"] == pytest.approx((foreign_us + ours_us) / 100_000 * 100)
    assert figures["load"]["bus"]["worst_100_ms_percent"] == pytest.approx((foreign_us + ours_us) / 100_000 * 100)
    assert figures["sent"] == {"frames": 1, "bytes": len(command.payload)}
    assert figures["received"] == {"frames": 1, "bytes": len(tick.payload)}
    assert {cause: n for cause, n in wire.rejected().items() if n} == {"foreign": 2, "error_other": 1}


def test_a_bus_counts_each_kind_of_frame_at_its_own_bit_rate():
    """Remote frames are classic ones and ask for eight bytes; the data of others may be switched or not."""
    meter = BusMeter(500_000, fd=True, data_bitrate=2_000_000)
    extended, remote = Frame(0x80123456, b"abc"), Frame(0x40000123, b"")
    nominal, data = fd_bits(0x123456, b"abc", extended=True, switched=True)
    expected_ns = 2000 * nominal + 500 * data + 2000 * classic_bits(0x123, b"", remote_length=8)
    assert (meter.sent([extended, remote]), meter.received([remote, extended])) == (expected_ns, expected_ns)
    assert [tuple(count) for count in meter.counts()] == [(2, 3), (2, 3)]
    assert meter.sent([Frame(0x321, bytes(12))]) == sum(
        map(int.__mul__, fd_bits(0x321, bytes(12), switched=True), (2000, 500))
    )
    assert [tuple(count) for count in meter.counts()] == [(3, 15), (2, 3)]
    assert meter.byte_counts() == (15, 3)
    for switched in (True, False):
        said = can.Message(
            arbitration_id=0x7FF, is_extended_id=False, is_fd=True, bitrate_switch=switched, data=b"\x55" * 7
        )
        nominal, data = fd_bits(0x7FF, b"\x55" * 7, switched=switched)
        assert meter.overheard(said) == 2000 * nominal + 500 * data
    assert tuple(meter.foreign) == (2, 14)
    classic = BusMeter(250_000)
    assert classic.sent([Frame(0x80000001, b"\xff")]) == 4000 * classic_bits(1, b"\xff", extended=True)


SHORT = {"loop.duration_s": 1.5, "expect": []}


def lockstep(link, **options):
    result = run("paper_circle", set=SHORT | options, mode="lockstep", link=link)
    assert result.failure is None
    return result


def test_in_lockstep_a_links_figures_repeat_and_the_frames_are_those_of_every_link():
    links = ["memory:", "memory:", "serial:pty", "can:virtual/statistics"]
    results = [lockstep(link) for link in links]
    figures = [result.metrics["link_statistics"] for result in results]
    assert figures[0] == figures[1]
    assert len({result.metrics["wire_sha256"] for result in results}) == 1
    for key in ("lasted_s", "clock", "round_trip_ms", "feedback_age_ms"):
        assert all(one[key] == figures[0][key] for one in figures)
    assert len({one[way]["frames"] for one in figures for way in ["sent"]}) == 1
    serial, bus = figures[2], figures[3]
    assert serial["sent"] == figures[0]["sent"]
    assert serial["received"] == figures[0]["received"]
    assert serial["load"]["received"]["worst_100_ms_percent"] > serial["load"]["sent"]["worst_100_ms_percent"] > 0
    assert 0 < bus["load"]["bus"]["mean_percent"] <= bus["load"]["bus"]["worst_100_ms_percent"] < 100
    assert figures[0]["load"] is None
    no_others, no_number = "a line between two ends has no other nodes", "frames carry no running number on this link"
    assert [one["reasons"] for one in figures[1:]] == [
        {"load": "a link in memory has no bit rate", "foreign": no_others},
        {"foreign": no_others},
        {"frames_to_host": no_number, "frames_to_robot": no_number},
    ]
    for one in figures:
        assert all(name in one["reasons"] for name, value in (one | one["lost"]).items() if value is None)


def test_lockstep_has_a_round_trip_of_one_period_and_a_clock_that_agrees():
    figures = lockstep("memory:", **{"loop.rate_hz": 200}).metrics["link_statistics"]
    assert figures["round_trip_ms"]["p50"] == figures["round_trip_ms"]["p99"] == pytest.approx(5.0)
    clock = figures["clock"]
    assert (clock["offset_us"], clock["drift_ppm"], clock["steps"]) == (0.0, 0.0, 0)
    assert clock["answered"] == clock["requests"] > 5


def test_latency_on_the_link_is_part_of_the_round_trip():
    options = {"link.command_latency_s": 0.002, "link.feedback_latency_s": 0.005}
    figures = lockstep("memory:", **options).metrics["link_statistics"]
    plain = lockstep("memory:").metrics["link_statistics"]
    assert figures["round_trip_ms"]["p50"] == pytest.approx(plain["round_trip_ms"]["p50"] + 7.0, abs=1.01)


def test_snapshots_that_a_fault_swallows_are_counted_as_lost():
    mute = {"kind": "mute", "target": "TICK", "start_s": 0.5, "end_s": 0.52}
    result = lockstep("memory:", fault=[mute])
    (applied,) = result.metrics["fault"]
    assert result.metrics["link_statistics"]["lost"]["snapshots"] == applied["applied"] > 10
    assert result.signals["link.lost"][-1] == applied["applied"]


def test_a_tick_that_is_repeated_leaves_no_gap_in_the_count():
    client = new_client()
    feed(client, [m.Tick(0, 0, 0, m.State.ACTIVE, 0, number) for number in (254, 255, 255, 0, 1, 1, 5)])
    assert client.view.lost == 3


def test_the_signals_say_how_the_link_is_at_each_tick():
    result = lockstep("serial:pty")
    signals, figures = result.signals, result.metrics["link_statistics"]
    assert {name for name in SIGNAL_NAMES if name.startswith("link.")} <= set(signals)
    for name in ("link.sent_bytes", "link.received_bytes"):
        assert all(before < after for before, after in itertools.pairwise(signals[name][5:]))
        assert signals[name][-1] <= figures[name.split(".")[1].removesuffix("_bytes")]["bytes"]
    assert signals["link.load_percent"].max() <= figures["load"]["received"]["worst_100_ms_percent"]
    assert signals["link.load_percent"].max() > 5
    assert signals["link.clock_offset_us"][-1] == figures["clock"]["offset_us"]
    assert math.isnan(lockstep("memory:").signals["link.load_percent"][-1])


@pytest.mark.alone
@pytest.mark.parametrize("link", ["serial:pty", "can:virtual/realtime", "memory:"])
def test_in_real_time_the_clock_is_read_over_a_link(link):
    result = run("paper_circle", set=SHORT | {"loop.rate_hz": 100}, mode="realtime", link=link)
    figures = result.metrics["link_statistics"]
    clock, trip = figures["clock"], figures["round_trip_ms"]
    assert clock["answered"] > 0
    assert clock["round_trip_us"]["p50"] > 0
    # A robot in this process counts from when it was made, a moment after the run's clock.
    # It slips only further behind, perhaps after the last answer.
    assert clock["offset_us"] < 0
    assert clock["offset_us"] + result.metrics["robot_slipped_ticks"] * 1000 > -5e6
    assert trip["count"] > 0
    assert 0 < trip["p50"] <= trip["p99"]


def test_a_frame_of_another_length_is_not_counted_as_ours():
    url = parse_link("can:virtual/other")
    host = CanLink(url, "ROBOT")
    statistics = observe(host, url, Clock())
    wire = ConditionedLink(host, Clock(), observer=statistics)
    bus = can.Bus(interface="virtual", channel="other")
    try:
        bus.send(can.Message(arbitration_id=m.Tick.ID, data=b"\1\2", is_extended_id=False))
        assert wire.receive(0) is None
        figures = statistics.figures()
        assert (figures["received"]["frames"], figures["foreign"]["frames"]) == (0, 1)
    finally:
        wire.close()
        bus.shutdown()


@pytest.mark.alone
def test_stamps_in_real_time_are_those_of_the_transport_on_the_clock_of_the_run():
    from hil.core.clock import WallClock

    here, there = memory_pair()
    clock = WallClock()
    link = StreamLink(here)
    observe(link, parse_link("memory:"), clock)
    before_ns = clock.now_ns()
    there.write(Framer().encode(Frame(m.TimeSyncRequest.ID, b"\1")))
    received = link.receive(MS)
    assert before_ns <= received.stamp_ns <= clock.now_ns()
