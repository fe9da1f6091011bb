"""The lines between the run and the recorder: never a wait, never half a line, every loss counted."""

import os
from collections.abc import Iterator

import pytest

from hil.core.json_lines import KEPT_BACK_BYTES, LineReader, LineWriter


@pytest.fixture
def pipe() -> Iterator[tuple[LineReader, LineWriter, list[int]]]:
    ends = list(os.pipe())
    yield LineReader(ends[0]), LineWriter(ends[1]), ends
    for end in ends:
        os.close(end)


def test_records_arrive_as_they_were_sent(pipe: tuple[LineReader, LineWriter, list[int]]) -> None:
    reader, writer, _ = pipe
    records: list[dict[str, object]] = [
        {"event": [0.1, "info", "a\nb — ω"]},
        {"finish": {"passed": True, "tracked_s": None}},
    ]
    for record in records:
        writer.send(record)
    assert [reader.read(), reader.read()] == records


@pytest.mark.skipif(os.name == "nt", reason="a pipe of Windows waits")
def test_a_full_pipe_keeps_lines_back_whole_and_then_counts_the_loss(
    pipe: tuple[LineReader, LineWriter, list[int]],
) -> None:
    reader, writer, _ = pipe
    text = "x" * 10_000
    sent = 0
    while writer.lost == 0:
        writer.send({"n": sent, "text": text})
        sent += 1
    assert sent * len(text) > KEPT_BACK_BYTES
    for n in range(sent - 1):
        record = reader.read()
        assert record == {"n": n, "text": text}
        writer.flush()


def test_lines_to_a_reader_that_has_gone_are_counted(pipe: tuple[LineReader, LineWriter, list[int]]) -> None:
    _, writer, ends = pipe
    os.close(ends.pop(0))
    writer.send({"n": 1})
    writer.send({"n": 2})
    assert writer.lost == 2


def test_the_end_of_the_pipe_drops_a_line_cut_short(pipe: tuple[LineReader, LineWriter, list[int]]) -> None:
    reader, writer, ends = pipe
    writer.send({"n": 1})
    os.write(ends[1], b'{"n": 2')
    os.close(ends.pop())
    assert reader.read() == {"n": 1}
    assert reader.read() is None
