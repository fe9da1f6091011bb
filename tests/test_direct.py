"""The host's end of a line to a robot in the same thread: the same with and without the bytes of the line between."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.framing import Frame, Framer, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host import HostNode, library
from firmware_protocol.host_line import HostLine
from hil.assembly import run_scenario
from hil.devices.direct import DirectLink
from hil.errors import LinkError
from hil.links.framed import StreamLink
from hil.links.streams import DirectStream
from hil.scenario import load
from tests.protocol_cases import frames
from tests.wheel_rig import WheelRig


class ByBytes(HostNode):
    """A firmware of a type of its own, which is given and asked for bytes."""


def by_bytes(rig: WheelRig) -> StreamLink:
    def answer(data: bytes) -> bytes:
        rig.node.feed(data)
        return rig.node.take_bytes()

    return StreamLink(DirectStream(answer))


def received(link: DirectLink | StreamLink) -> list[Frame]:
    """Return all that there is."""
    heard: list[Frame] = []
    while (some := link.receive(0)) is not None:
        assert len(some.frames) > 0
        heard += some.frames
    return heard


steps = st.builds(m.Step, st.integers(0, 3), st.integers(0, 40)).map(codec.encode)


@given(turns=st.lists(st.lists(frames | steps, max_size=6), max_size=8))
def test_it_says_hears_and_counts_what_a_line_of_bytes_does(turns: list[list[Frame]]) -> None:
    one, other = WheelRig(lockstep=True), WheelRig(lockstep=True)
    direct, line = DirectLink(one), by_bytes(other)
    for turn in turns:
        for frame in turn:
            direct.send(frame)
            line.send(frame)
        assert (direct.sent_frames, direct.sent_bytes) == (line.sent_frames, line.sent_bytes)
        assert received(direct) == received(line)
        assert (direct.received_frames, direct.received_bytes) == (line.received_frames, line.received_bytes)
        assert direct.rejected() == line.rejected()
    assert one.node.look() == other.node.look()


def test_all_that_a_full_queue_has_comes_at_once() -> None:
    """A thousand ticks are the most that a STEP brings, and more frames than the robot's queue takes."""
    one, other = WheelRig(lockstep=True), WheelRig(lockstep=True)
    direct, line = DirectLink(one), by_bytes(other)
    for link in (direct, line):
        link.send(codec.encode(m.Step(0, 1000)))
        link.send(codec.encode(m.Step(1000, 1000)))
    some = direct.receive(0)
    assert some is not None
    assert list(some.frames) == received(line)
    assert len(some.frames) > 1000
    assert direct.receive(0) is None


def test_what_was_sent_before_the_link_is_opened_anew_arrives_as_on_any_line() -> None:
    rig = WheelRig(lockstep=True)
    link = DirectLink(rig)
    link.send(codec.encode(m.Step(0, 7)))
    link.reopen()
    assert codec.decode(received(link)[-1]) == m.StepDone(7)


def test_a_link_that_was_closed_says_so() -> None:
    link = DirectLink(WheelRig(lockstep=True))
    link.close()
    link.close()
    assert link.receive(0) is None
    link.send(codec.encode(m.Step(0, 1)))
    with pytest.raises(LinkError, match="closed; open a new one"):
        link.receive(0)


@pytest.mark.parametrize("wrong", [Frame(0x123, b""), Frame(m.Tick.ID, b"1234567"), Frame(1 << 16, b"")])
def test_what_is_no_message_is_refused_and_nothing_of_it_is_sent(wrong: Frame) -> None:
    rig = WheelRig(lockstep=True)
    link = DirectLink(rig)
    link.send(codec.encode(m.Step(0, 1)))
    link.send(wrong)
    with pytest.raises(ValueError, match="expected") as ours:
        link.receive(0)
    with pytest.raises(ValueError, match="expected") as theirs:
        Framer().encode(wrong)
    assert str(ours.value) == str(theirs.value)
    assert rig.node.look().tick == 0
    link.send(codec.encode(m.Step(0, 1)))
    assert codec.decode(received(link)[-1]) == m.StepDone(1), "the frames that were refused are forgotten"


STEP = pack([codec.encode(m.Step(0, 1))])


@pytest.mark.parametrize(
    "rest", [STEP[:1], STEP[:-1], b"\x23\x01\x00" + STEP, b"\x00\x03\x05" + STEP], ids=["cut", "short", "id", "length"]
)
def test_the_library_sends_what_is_whole_and_stops_there(rest: bytes) -> None:
    ffi, lib = library()
    rig = WheelRig(lockstep=True)
    memory = ffi.new("uint64_t[]", lib.wheel_line_size() // 8 + 1)
    line = ffi.cast("wheel_line *", memory)
    lib.wheel_line_init(line)
    answer, done = ffi.new("uint8_t[]", lib.WHEEL_DIRECT_ROOM), ffi.new("wheel_direct_bytes *")
    packed = STEP + rest
    lib.wheel_direct_converse(line, rig.node.handle, packed, len(packed), answer, len(answer), done)
    assert done.sent == len(Framer().encode(codec.encode(m.Step(0, 1))))
    assert rig.node.look().tick == 1


def test_what_has_no_room_is_there_the_next_time() -> None:
    ffi, lib = library()
    rig, other = WheelRig(lockstep=True), WheelRig(lockstep=True)
    memory = ffi.new("uint64_t[]", lib.wheel_line_size() // 8 + 1)
    line = ffi.cast("wheel_line *", memory)
    lib.wheel_line_init(line)
    answer, done = ffi.new("uint8_t[]", lib.WHEEL_DIRECT_ROOM), ffi.new("wheel_direct_bytes *")
    packed = pack([codec.encode(m.Step(0, 1000))])
    expected = pack(HostLine().converse(other.node, [codec.encode(m.Step(0, 1000))])[0])
    heard = b""
    while lib.wheel_direct_converse(line, rig.node.handle, packed, len(packed), answer, len(answer), done):
        assert done.packed <= len(answer)
        heard += bytes(ffi.buffer(answer, done.packed))
        packed = b""
    assert heard == expected


def test_a_run_is_the_same_with_a_firmware_that_is_asked_for_bytes() -> None:
    scenario = load("paper_circle", mode="lockstep", link="memory:", set={"loop.duration_s": 1.0})
    of_this_machine = {"realtime_factor": None, "tick_us": None}
    direct, by_bytes = run_scenario(scenario), run_scenario(scenario, make_node=ByBytes)
    assert {**direct.metrics, **of_this_machine} == {**by_bytes.metrics, **of_this_machine}
