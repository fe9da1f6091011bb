"""Traces: written by a run, read back by python-can, and decoded with wheel.dbc by cantools."""

import itertools
import signal
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Iterable

import can
import cantools
import pytest

from firmware_protocol import codec
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import PackedFrames
from hil.addons.report.trace import trace_decoder as decode
from hil.core.errors import BadInputError
from hil.runtime.assembly import run
from hil.wire.can_bus import CanLink
from hil.wire.conditions import ConditionedLink
from hil.wire.link_statistics import observe
from hil.wire.trace import Trace
from hil.wire.url import parse_link
from tests.support.processes import HIL, ROOT, device, environment, hil, hil_process, run_json
from tests.support.traced_runs import SHORT, one_second_of_frames, traced

DATABASE = cantools.database.load_file(ROOT / "firmware_protocol" / "wheel.dbc")
EVERYTHING = decode.Selection.of([], 0, 10)
LINKS = ["memory:", "serial:pty", "can:virtual/traced", "can:virtual/traced?fd=1&data_bitrate=4000000"]


def frames(path) -> list[can.Message]:
    options = {"relative_timestamp": False} if path.suffix == ".asc" else {}
    with can.LogReader(path, **options) as reader:
        return list(reader)


def packed(some: Iterable[Frame]) -> PackedFrames:
    return PackedFrames(pack(some))


def counted(read: list[can.Message]) -> list[can.Message]:
    """Return the messages that the figures of a run count: all except HELLO."""
    return [one for one in read if one.arbitration_id < m.HelloRequest.ID]


@pytest.mark.parametrize(
    ("ending", "link"),
    [
        pytest.param(ending, link, marks=() if (row, place) in ((0, 0), (1, 3), (2, 1)) else pytest.mark.slow)
        for row, ending in enumerate(("blf", "asc", "log"))
        for place, link in enumerate(LINKS)
    ],
)
def test_a_trace_holds_every_frame_of_the_wire_as_other_tools_read_it(tmp_path, ending, link):
    path = tmp_path / f"bus.{ending}"
    begin_s = time.time()
    result = traced(path, link)
    read = frames(path)
    assert result.metrics["trace"] == {"path": str(path), "frames": len(read), "dropped": 0, "lost": 0, "trouble": None}
    assert len([one for one in counted(read) if not one.is_rx]) == result.metrics["frames"]["sent"]
    pages = [place for place, one in enumerate(read) if one.arbitration_id == m.HelloGeometry.ID]
    # A slow machine asks for HELLO again; what the host counts begins when it has all pages.
    assert len([one for one in counted(read[pages[0] + 1 :]) if one.is_rx]) == result.metrics["frames"]["received"]
    assert {one.is_fd for one in read} == {"fd" in link}
    assert not any(one.is_extended_id or one.is_error_frame for one in read)
    # Robot time, made absolute: it may run ahead of the wall or behind it.
    stamps = [one.timestamp for one in read]
    assert abs(stamps[0] - begin_s) < 60
    assert all(before <= after for before, after in itertools.pairwise(stamps))
    tick_s = [one.timestamp for one in read if one.arbitration_id == m.Tick.ID]
    told_s = [
        DATABASE.decode_message(m.Tick.ID, one.data)["time_us"] * 1e-6
        for one in read
        if one.arbitration_id == m.Tick.ID
    ]
    first = next(place for place, told in enumerate(told_s) if told > 0)
    for stamp_s, robot_s in zip(tick_s[first:], told_s[first:], strict=True):
        assert stamp_s - tick_s[first] == pytest.approx(robot_s - told_s[first], abs=2e-6)


def test_a_trace_changes_nothing_of_the_run(tmp_path):
    plain = run("paper_circle", set=SHORT, mode="lockstep", link="memory:")
    assert traced(tmp_path / "bus.log").metrics["wire_sha256"] == plain.metrics["wire_sha256"]


def test_decode_agrees_with_cantools_on_every_frame_of_a_run(tmp_path):
    path = tmp_path / "bus.blf"
    traced(path, "serial:pty")
    entries = list(decode.read(path, EVERYTHING))
    messages = frames(path)
    assert len(entries) == len(messages) > 1000
    for entry, message in zip(entries, messages, strict=True):
        expected = DATABASE.get_message_by_frame_id(message.arbitration_id)
        assert entry.kind == expected.name
        assert entry.record()["sender"] == expected.senders[0]
        plain = expected.decode(message.data, decode_choices=False)
        assert entry.record()["signals"] == plain
        text = entry.text()
        for name, value in expected.decode(message.data).items():
            unit = expected.get_signal_by_name(name).unit
            shown = str(value) if unit is None else f"{value} "
            assert f"  {name} {shown}" in text.replace(expected.name, "", 1), text


def test_a_trace_of_a_run_that_was_killed_is_readable_up_to_the_cut(tmp_path):
    path = tmp_path / "bus.log"
    arguments = ["run", "paper_circle", "--mode", "lockstep", "--record", "none", "--set", "loop.duration_s=600"]
    process = subprocess.Popen(
        [*HIL, *arguments, "--trace", str(path)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment(),
    )
    while not path.exists() or path.stat().st_size < 100_000:
        assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    counts = Counter(line.split()[3] for line in hil("decode", path).stdout.splitlines())
    assert counts["TICK"] > 100
    assert counts["TICK"] - counts["ENCODERS"] in (0, 1)


@pytest.mark.parametrize(
    ("path", "words"),
    [("nowhere/bus.blf", ["no folder"]), ("bus.pcap", ["must end in .blf, .asc or .log"]), (".", ["format"])],
)
def test_a_trace_that_cannot_be_written_is_refused_before_anything_starts(tmp_path, path, words):
    with pytest.raises(BadInputError) as refused:
        run("paper_circle", set=SHORT, mode="lockstep", trace=tmp_path / path)
    assert all(word in str(refused.value) for word in words)


def test_frames_that_crossed_together_are_traced_and_counted_one_by_one(tmp_path):
    all_kinds = [codec.encode(m.TimeSyncRequest(number)) for number in range(40)]
    with Trace(tmp_path / "bus.blf", blocking=True) as trace:
        trace.frames(5_000_000, packed(all_kinds[:9]), sent=False)
        trace.frames(6_000_000, packed(all_kinds[9:]), sent=True)
        report = trace.finish()
    read = frames(tmp_path / "bus.blf")
    assert [(one.arbitration_id, bytes(one.data)) for one in read] == all_kinds
    assert [one.is_rx for one in read] == [True] * 9 + [False] * 31
    assert (report["frames"], report["dropped"], report["lost"]) == (40, 0, 0)


def test_a_frame_that_the_format_has_no_room_for_ends_the_trace_with_a_sentence(tmp_path):
    frame = codec.encode(m.TimeSyncRequest(1))
    with Trace(tmp_path / "bus.blf", blocking=True) as trace:
        trace.frames(0, [frame], sent=True)
        trace.frames(2 * 10**19, [frame], sent=True)  # BLF has room for 584 years
        report = trace.finish()
    assert "is incomplete" in report["trouble"]
    assert "python-can's writer refused a frame" in report["trouble"]
    assert [one.arbitration_id for one in frames(tmp_path / "bus.blf")] == [m.TimeSyncRequest.ID]


def test_a_writer_that_fails_in_any_way_ends_the_trace_and_holds_no_run_up(tmp_path, monkeypatch):
    frame = codec.encode(m.TimeSyncRequest(1))
    with Trace(tmp_path / "bus.log", blocking=True) as trace:
        monkeypatch.setattr(trace._file, "on_message_received", lambda _: {}["a writer's own mistake"])
        for number in range(20_000):
            trace.frames(number, [frame], sent=True)
        report = trace.finish()
    assert (report["frames"], report["lost"]) == (0, 20_000)
    assert "is incomplete" in report["trouble"]


def test_a_writer_that_is_too_slow_for_real_time_drops_frames_and_says_how_many(tmp_path, monkeypatch):
    frame, path = codec.encode(m.TimeSyncRequest(1)), tmp_path / "bus.log"
    begun, may_go_on = threading.Event(), threading.Event()
    with Trace(path, blocking=False) as trace:
        slow = lambda _: (begun.set(), may_go_on.wait(10.0))  # noqa: E731
        monkeypatch.setattr(trace._file, "on_message_received", slow)
        trace.frames(0, [frame], sent=True)
        assert begun.wait(10.0)
        for number in range(16_384):
            trace.frames(number, [frame], sent=True)
        for number in range(7):
            trace.frames(number, [frame, frame], sent=True)
        may_go_on.set()
        report = trace.finish()
    assert report["trouble"] == (
        f"trace {path} is incomplete: the writer was too slow; 14 frames were dropped and 0 lost, 16385 are safe in it"
    )


def test_on_can_a_trace_shows_what_faults_left_on_the_bus(tmp_path):
    rows = ('{kind="truncation",target="WHEEL_COMMAND",start_s=0.1,end_s=0.15}',
            '{kind="babble",target="command",start_s=0.2,end_s=0.25,value=400.0}')  # fmt: skip
    changes = ["expect=[]", "loop.duration_s=0.4", f"fault=[{','.join(rows)}]"]
    result = run("circle_speed", set=changes, mode="lockstep", link="can:virtual/spoilt", trace=tmp_path / "bus.log")
    cut, said = (row["applied"] for row in result.metrics["fault"])
    heard = frames(tmp_path / "bus.log")
    commands = [one for one in heard if one.arbitration_id == m.WheelCommand.ID]
    assert sum(one.dlc < 8 for one in commands) == cut > 0
    assert sum(one.arbitration_id not in m.NAMES for one in heard) == said > 0
    statistics = result.metrics["link_statistics"]
    assert statistics["foreign"]["frames"] == said


def test_what_others_say_is_in_the_trace(tmp_path):
    class Clock:
        def now_ns(self):
            return 5_000_000

        def wait_until(self, t_ns):
            return 0

    url = parse_link("can:virtual/noise")
    bus = can.Bus(interface="virtual", channel="noise")
    with Trace(tmp_path / "bus.blf", blocking=True) as trace:
        host = CanLink(url, "ROBOT")
        wire = ConditionedLink(host, Clock(), observer=observe(host, url, Clock(), trace))
        for message in one_second_of_frames():
            bus.send(message)
        while wire.receive(0) is not None:
            pass
        trace.finish()
    wire.close()
    bus.shutdown()
    # The host's own messages are not taken from the bus: some buses give them back.
    heard = [one for one in one_second_of_frames() if m.SENDERS.get(one.arbitration_id) != "HOST"]
    theirs = sorted(one.arbitration_id for one in heard if not one.is_error_frame)
    read = frames(tmp_path / "bus.blf")
    assert sorted(one.arbitration_id for one in read if not one.is_error_frame) == theirs
    assert [one.is_error_frame for one in read].count(True) == 1


def test_the_page_s_worked_output_is_what_decode_prints(tmp_path):
    path = tmp_path / "bus.blf"
    traced(path, **{"loop.rate_hz": 200, "loop.duration_s": 2})
    page = (ROOT / "hil" / "wire" / "STATISTICS.md").read_text(encoding="utf-8")
    shown = page.partition("```text decoded\n")[2].partition("```")[0].splitlines()
    printed = [entry.text() for entry in decode.read(path, decode.Selection.of([], 1.0, 1.0051))]
    assert len(shown) == 5
    assert [line for line in printed if line in shown] == shown


@pytest.mark.alone
def test_a_run_in_real_time_is_traced_as_it_goes(tmp_path):
    path = tmp_path / "bus.blf"
    with device("paper_circle", "--mode", "realtime", "--link", "serial:pty", "--set", "loop.rate_hz=100") as robot:
        result = run_json(
            "paper_circle", "--mode", "realtime", "--link", robot.link, "--truth", robot.truth, "--record", "none",
            "--set", "loop.rate_hz=100", "--set", "loop.duration_s=2", "--set", "expect=[]", "--trace", path,
            "--set", "loop.rearm=true",  # a busy machine may stop the robot
            by=hil_process,
        )  # fmt: skip
    read = frames(path)
    assert result["trace"]["frames"] == len(read)
    assert result["trace"]["trouble"] is None
    assert len([one for one in counted(read) if not one.is_rx]) == result["frames"]["sent"]
    commands = [one.timestamp for one in read if one.arbitration_id in (m.WheelCommand.ID, m.TorqueCommand.ID)]
    assert 1.8 < commands[-1] - commands[0] < 4
    clock = result["link_statistics"]["clock"]
    assert 0 < clock["round_trip_us"]["p50"] <= clock["round_trip_us"]["p99"]
