"""The library puts snapshots together as its twin in Python does, whatever comes and however it is cut."""

from collections.abc import Iterator
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from tests.support.client_rig import feedback, new_client, take
from tests.support.examples import share_of_examples
from tests.support.protocol_cases import frames as any_frames
from tests.support.snapshot_twin import SnapshotAssembler

OWN = (m.Tick, m.Encoders, m.WheelSpeeds, m.Currents, m.Accelerometer, m.Gyro, m.StepDone)
OUT_OF_RANGE = [
    Frame(m.Tick.ID, b"\0" * 6 + b"\x07\0"),
    Frame(m.WheelSpeeds.ID, b"\0\x80" * 4),
    Frame(m.Currents.ID, b"\0\x80" * 4),
    Frame(m.Accelerometer.ID, b"\0\x80" * 3 + b"\0\0"),
    Frame(m.Gyro.ID, b"\0\x80" * 3 + b"\0\0"),
]


def snapshot(number: int, parts: int, time_us: int, late: tuple[int, int]) -> list[Frame]:
    """Return a snapshot; ``late`` is by how many instants its inertial parts belong to another one."""
    at = time_us // 1000
    some = (
        m.Encoders(number, 2, 3, 4),
        m.WheelSpeeds(float(number % 100), 2.0, 3.0, 4.0),
        m.Currents(number % 8 / 4.0, 2.0, 3.0, 4.0),
        m.Accelerometer(number % 7 / 4.0, -0.5, 9.75, at + late[0] & 0xFFFF),
        m.Gyro(0.0, 0.0, number % 5 / 2.0, at + late[1] & 0xFFFF),
    )
    tick = m.Tick(time_us, number % 200, number, m.State.ACTIVE, parts, number)
    return [codec.encode(one) for one in (tick, *(part for place, part in enumerate(some) if parts >> place & 1))]


def gap(number: int, size: int) -> list[Frame]:
    return snapshot(number, 3, 5, (0, 0)) + snapshot(number + size & 0xFF, 3, 9, (0, 0))


snapshots = st.builds(
    snapshot,
    st.integers(0, 255),
    st.sampled_from([31, 3, 1, 7, 27, 19, 11, 2, 0]) | st.integers(0, 31),
    st.sampled_from([0, 5000, 0xFFFF_FFF0, 66_000_000]) | st.integers(0, 0xFFFF_FFFF),
    st.sampled_from([(0, 0)] * 6 + [(1, 0), (0, 1)]),
)
gaps = st.builds(gap, st.integers(0, 255), st.sampled_from([127, 128, 129, 130]))
ends = st.integers(0, 9).map(lambda tick: [codec.encode(m.StepDone(tick))])
strangers = (any_frames | st.sampled_from(OUT_OF_RANGE)).map(lambda frame: [frame])
accidents = st.tuples(
    st.sampled_from(["none"] * 6 + ["lost", "beside it", "twice"]), st.integers(0, 5), st.sampled_from(OUT_OF_RANGE)
)


def spoilt(piece: list[Frame], accident: tuple[str, int, Frame]) -> list[Frame]:
    kind, place, another = accident
    place = min(place, len(piece) - 1)
    keep = [] if kind == "lost" else [piece[place]] * (2 if kind == "twice" else 1)
    return [*piece[:place], *keep, *([another] if kind == "beside it" else []), *piece[place + 1 :]]


def batches(frames: list[Frame], chance: Random) -> Iterator[list[Frame]]:
    while frames:
        count = chance.randint(1, 9)
        yield frames[:count]
        frames = frames[count:]


@pytest.mark.proves("R-SNAP-5", "R-SNAP-6", "R-SNAP-7", "R-SNAP-10")
@share_of_examples(3.0)
@given(
    pieces=st.lists(st.tuples(snapshots | gaps | ends | strangers | st.just("restart"), accidents), max_size=12),
    chance=st.randoms(use_true_random=False),
)
def test_it_reads_what_the_python_twin_does(pieces, chance) -> None:
    client, twin = new_client(), SnapshotAssembler()
    newest, counted, refused = None, 0, 0
    for piece, accident in pieces:
        if piece == "restart":
            client.begin(1)
            twin.restart()
            newest = None
            continue
        for batch in batches(spoilt(piece, accident), chance):
            messages = []
            for frame in batch:
                if (message := codec.decode(frame)) is None:
                    refused += 1
                    continue
                newest = twin.feed(message) or newest
                counted += frame.id < m.HelloRequest.ID
                if type(message) not in OWN:
                    messages.append(frame.id)
            assert take(client, batch) == messages, "it stops behind each that is none of its own"
            assert repr(feedback(client)) == repr(newest), "NaN and all"
            view = client.view
            assert (view.received, view.out_of_range) == (counted, refused)
            assert (view.lost, view.incomplete) == (twin.lost, twin.incomplete)
