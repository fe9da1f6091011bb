"""The host's end of a line to a robot in the same thread: the same with and without the bytes of the line between."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.extension import library
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host import HostNode
from firmware_protocol.host_line import HostLine, PackedFrames
from hil.core.errors import LinkError
from hil.robot.direct import DirectLink
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from hil.wire.framed import StreamLink
from hil.wire.streams import DirectStream
from tests.support.client_rig import new_client
from tests.support.protocol_cases import frames
from tests.support.wheel_rig import WheelRig


class ByBytes(HostNode):
    """A firmware of a type of its own, which is given and asked for bytes."""


def stream_to(rig: WheelRig) -> DirectStream:
    def answer(data: bytes) -> bytes:
        rig.node.feed(data)
        return rig.node.take_bytes()

    return DirectStream(answer)


def both() -> tuple[DirectLink, StreamLink, WheelRig, WheelRig]:
    """Return the link under test, one by bytes, and the robot of each."""
    one, other = WheelRig(lockstep=True), WheelRig(lockstep=True)
    return DirectLink(one, stream_to(one)), StreamLink(stream_to(other)), one, other


def received(link: DirectLink | StreamLink) -> list[Frame]:
    """Return all that there is."""
    heard: list[Frame] = []
    while (some := link.receive(0)) is not None:
        assert len(some.frames) > 0
        heard += some.frames
    return heard


steps = st.builds(m.Step, st.integers(0, 3), st.integers(0, 40)).map(codec.encode)


@given(turns=st.lists(st.lists(frames | steps, max_size=6), max_size=8), reopened=st.sets(st.integers(0, 8)))
def test_it_says_hears_and_counts_what_a_line_of_bytes_does(turns: list[list[Frame]], reopened: set[int]) -> None:
    direct, line, one, other = both()
    for number, turn in enumerate(turns):
        for frame in turn:
            direct.send(frame)
            line.send(frame)
        if number in reopened:
            direct.reopen()
            line.reopen()
        assert (direct.sent_frames, direct.byte_counts()[0]) == (line.sent_frames, line.byte_counts()[0])
        assert received(direct) == received(line)
        assert (direct.received_frames, direct.byte_counts()) == (line.received_frames, line.byte_counts())
        assert direct.rejected() == line.rejected()
    assert one.node.look() == other.node.look()


def test_a_robot_that_began_anew_counts_as_on_a_line_of_bytes() -> None:
    direct, line, one, other = both()
    for begins_anew in (False, True, True):
        for link, rig in ((direct, one), (line, other)):
            if begins_anew:
                rig.node = WheelRig(lockstep=True).node
            link.send(codec.encode(m.Step(0, 70)))
            assert codec.decode(received(link)[-1]) == m.StepDone(70)
        assert direct.rejected() == line.rejected()
        direct.reopen()
        line.reopen()


def test_all_that_a_full_queue_has_comes_at_once() -> None:
    direct, line, one, _ = both()
    for link in (direct, line):
        for number in range(8):
            link.send(codec.encode(m.Step(1000 * number, 1000)))
    some = direct.receive(0)
    assert some is not None
    assert list(some.frames) == received(line)
    assert one.node.look().rejected["transmit_overruns"] > 0
    assert direct.receive(0) is None


@pytest.mark.parametrize("sizes", [(100,) * 9, (373,), (372, 1), (1, 600, 1)], ids=str)
def test_what_has_no_room_to_wait_reaches_the_robot_in_its_order(sizes: tuple[int, ...]) -> None:
    direct, line, one, other = both()
    for number, size in enumerate(sizes):
        some = [codec.encode(m.Step(turn, 1)) for turn in range(number, number + size - 1)] + [
            codec.encode(m.Estop(1, 0))
        ]
        direct.send_packed(PackedFrames(pack(some)))
        for frame in some:
            line.send(frame)
        assert (direct.sent_frames, direct.byte_counts()[0]) == (line.sent_frames, line.byte_counts()[0])
    assert received(direct) == received(line)
    assert (direct.received_frames, direct.byte_counts()) == (line.received_frames, line.byte_counts())
    assert one.node.look() == other.node.look()


def test_what_crossed_is_told_with_its_number() -> None:
    direct, *_ = both()
    client = new_client()
    direct.serve(client)
    client.request(m.Request.IDLE, 0)
    before = client.out()
    answer = direct.exchange(2)
    sent, sent_count, heard, count = direct.crossed()
    assert (PackedFrames(sent)[:-1], sent_count) == (list(before), 2)
    assert codec.decode(PackedFrames(sent)[-1]) == m.Step(0, 2)
    assert (heard, count) == (answer.packed, len(answer))
    direct.step(3)
    assert direct.crossed()[:2] == (pack([codec.encode(m.Step(0, 3))]), 1)


def test_a_link_that_was_closed_says_so_and_its_robot_hears_nothing_more() -> None:
    direct, line, *rigs = both()
    for link in (direct, line):
        link.send(codec.encode(m.Step(0, 1)))
        send = link.send  # as whoever stands before the link holds it
        link.close()
        link.close()
        assert link.receive(0) is None
        with pytest.raises(LinkError, match="closed; open a new one"):
            send(codec.encode(m.Step(0, 1)))
    assert [rig.node.look().tick for rig in rigs] == [0, 0]


@pytest.mark.parametrize("wrong", [Frame(0x123, b""), Frame(m.Tick.ID, b"1234567"), Frame(1 << 16, b"")])
def test_what_is_no_message_is_refused_and_changes_nothing(wrong: Frame) -> None:
    direct, line, *_ = both()
    words = []
    for link in (direct, line):
        link.send(codec.encode(m.Step(0, 3)))
        with pytest.raises(ValueError, match="expected") as refused:
            link.send(wrong)
        words.append(str(refused.value))
        assert link.sent_frames == 1
        assert codec.decode(received(link)[-1]) == m.StepDone(3)
    assert words[0] == words[1]


STEP = pack([codec.encode(m.Step(0, 1))])


@pytest.mark.parametrize(
    "rest",
    [STEP[:1], STEP[:-1], b"\x23\x01\x00" + STEP, b"\x00\x03\x05" + STEP, b"\x00\x03\x09" + 2 * STEP],
    ids=["cut", "short", "id", "length", "beyond all"],
)
def test_the_library_sends_what_is_whole_and_stops_there(rest: bytes) -> None:
    rig = WheelRig(lockstep=True)
    ffi, lib = library()
    lines = HostLine(), HostLine()
    direct = ffi.new("wheel_direct *", {"here": lines[0].handle, "there": lines[1].handle})
    lib.wheel_direct_send(direct, rig.node.handle, STEP + rest, len(STEP + rest))
    lib.wheel_direct_receive(direct, rig.node.handle)
    some = list(PackedFrames(ffi.buffer(direct.answer)[: direct.answer_bytes], direct.received_frames))
    assert codec.decode(some[-1]) == m.StepDone(1)
    assert sum(frame.id == m.StepDone.ID for frame in some) == 1


@pytest.mark.parametrize("ticks", [1001, 65537, 1 << 62])
def test_a_step_that_cannot_be_sent_is_none(ticks: int) -> None:
    link, *_ = both()
    client = new_client()
    link.serve(client)
    for call in (link.step, link.exchange):
        with pytest.raises(ValueError, match=f"a step of {ticks} ticks; expected at most 1000"):
            call(ticks)
    assert (client.view.out_bytes, client.view.step) == (0, 0)


def test_a_run_is_the_same_with_a_firmware_that_is_asked_for_bytes() -> None:
    scenario = load("paper_circle", mode="lockstep", link="memory:", set={"loop.duration_s": 1.0})
    of_this_machine = {"realtime_factor": None, "tick_us": None}
    direct, by_bytes = run_scenario(scenario), run_scenario(scenario, RunOptions(make_node=ByBytes))
    assert {**direct.metrics, **of_this_machine} == {**by_bytes.metrics, **of_this_machine}
