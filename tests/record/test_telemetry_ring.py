"""Laws of the ring between the run and the recorder, over real shared memory."""

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.signals import pack_row
from hil.record import ring as ring_module
from hil.record.ring import Kept, RingReader, RingWriter, SharedBlock, ring_bytes
from tests.support.examples import share_of_examples


@contextmanager
def ring(capacity: int, width: int) -> Iterator[tuple[RingWriter, RingReader]]:
    block = SharedBlock.reserve().allocate(ring_bytes(capacity, width))
    writer = RingWriter(block, capacity, width)
    reader = RingReader(block)
    yield writer, reader
    reader.close()
    writer.close()
    block.close()


@given(
    capacity=st.integers(1, 7),
    width=st.integers(1, 5),
    steps=st.lists(st.one_of(st.just("put"), st.integers(0, 9)), max_size=60),
)
def test_rows_come_out_in_order_and_what_is_full_refuses(capacity: int, width: int, steps: list[str | int]) -> None:
    model: deque[tuple[float, ...]] = deque()
    with ring(capacity, width) as (writer, reader):
        for number, step in enumerate(steps):
            if step == "put":
                row = tuple(number + 0.25 * i for i in range(width))
                fits = len(model) < capacity
                assert writer.try_put(pack_row(row)) is fits
                if fits:
                    model.append(row)
                else:
                    writer.count_dropped()
            else:
                assert isinstance(step, int)
                count = min(step, reader.head - reader.tail)
                rows = reader.rows(reader.tail, reader.tail + count)
                reader.release(reader.tail + count)
                assert [tuple(row) for row in rows] == [model.popleft() for _ in range(count)]
            assert reader.head - reader.tail == len(model)
        puts = steps.count("put")
        assert writer.head + writer.dropped == puts
        assert reader.dropped == writer.dropped


@given(st.lists(st.floats(width=64), min_size=3, max_size=3))
def test_a_row_keeps_every_bit(row: list[float]) -> None:
    with ring(2, 3) as (writer, reader):
        writer.try_put(pack_row(tuple(row)))
        assert reader.rows(0, 1).tobytes() == np.array([row]).tobytes()


def test_reading_returns_a_copy() -> None:
    with ring(1, 1) as (writer, reader):
        writer.try_put(pack_row((1.0,)))
        rows = reader.rows(0, 1)
        reader.release(1)
        writer.try_put(pack_row((2.0,)))
        assert rows[0, 0] == 1.0


def test_a_row_of_another_width_raises_and_stores_nothing() -> None:
    with ring(4, 3) as (writer, reader):
        for row in ((1.0, 2.0), (1.0, 2.0, 3.0, 4.0)):
            with pytest.raises(ValueError, match="different structures"):
                writer.try_put(pack_row(row))
        assert reader.head == 0


def test_rows_that_are_not_in_the_ring_raise() -> None:
    with ring(4, 1) as (writer, reader):
        writer.try_put(pack_row((1.0,)))
        reader.release(1)
        for start, stop in ((0, 1), (1, 2)):
            with pytest.raises(IndexError, match="not in the ring"):
                reader.rows(start, stop)


def test_a_block_smaller_than_its_header_says_is_refused() -> None:
    block = SharedBlock.reserve().allocate(ring_bytes(4, 3))
    writer = RingWriter(block, 400, 3)
    with pytest.raises(ValueError, match="does not fit"):
        RingReader(block)
    writer.close()
    block.close()


@pytest.mark.parametrize(("capacity", "width"), [(0, 3), (3, 0)])
def test_an_empty_ring_is_refused(capacity: int, width: int) -> None:
    block = SharedBlock.reserve().allocate(ring_bytes(4, 3))
    with pytest.raises(ValueError, match=f"^ring of {capacity} rows of {width} floats: both must be at least 1$"):
        RingWriter(block, capacity, width)
    block.close()


STEPS = st.tuples(st.sampled_from(["save", "save", "give up", "lines", "begin", "lose"]), st.integers(0, 3))


@share_of_examples(0.4)
@given(st.lists(STEPS, max_size=25))
def test_each_file_holds_what_was_saved_while_it_was_the_newest(steps: list[tuple[str, int]]) -> None:
    """Numbers may be skipped; the last number that the header has room for counts the files after it too."""
    files, number, newest, lost = {1: [0, 0]}, 1, 1, [0, 0]
    with pytest.MonkeyPatch.context() as patch, ring(4, 1) as (writer, reader):
        patch.setattr(ring_module, "MOST_FILES", 6)
        reader.begin_file(1)
        for step, count in steps:
            if step in ("save", "give up"):
                for _ in range(count):
                    assert writer.try_put(pack_row((1.0,)))
                assert writer.full == (count == 4)
                (reader.release if step == "save" else reader.give_up)(reader.head)
                files[newest][0] += count * (step == "save")
                lost[0] += count * (step == "give up")
            elif step == "lines":
                reader.add_lines_saved(count)
                files[newest][1] += count
            elif step == "begin" and (number + 1 + count <= 6 or number >= 6):
                number += 1 + count
                reader.begin_file(number)
                if number <= 6:
                    newest, files[number] = number, [0, 0]
            elif step == "lose" and number >= newest:
                reader.lose_file()
                lost = [sum(both) for both in zip(lost, files[newest], strict=True)]
                files[newest] = [0, 0]
            rows, lines = (sum(kept[i] for kept in files.values()) for i in (0, 1))
            for side in (writer, reader):
                assert side.files() == {name: Kept(*kept) for name, kept in files.items()}
                assert (side.file_number, side.saved, side.lines_saved) == (number, rows, lines + lost[1])
                assert (side.head, side.tail, side.lines_lost) == (rows + lost[0], rows + lost[0], lost[1])


def test_a_consumer_reads_up_to_the_head_of_its_call_before() -> None:
    with ring(4, 1) as (writer, reader):
        found = []
        for _ in range(3):
            writer.try_put(pack_row((1.0,)))
            found.append(reader.settled())
        assert found == [0, 1, 2]
        reader.release(2)
        assert (RingReader.settled(reader), reader.tail) == (3, 2)
