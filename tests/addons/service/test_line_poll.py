"""Lines that the control loop reads: never a wait, never half a line."""

import os
from collections.abc import Iterator

import pytest

from hil.addons.service.api_child import LinePoll
from hil.core.json_lines import LineReader, LineWriter
from tests.support.processes import wait_for


@pytest.fixture
def pipe() -> Iterator[tuple[LineReader, LineWriter, list[int]]]:
    ends = list(os.pipe())
    yield LineReader(ends[0]), LineWriter(ends[1]), ends
    for end in ends:
        os.close(end)


def test_what_is_at_hand_is_taken_whole_and_nothing_is_waited_for(
    pipe: tuple[LineReader, LineWriter, list[int]],
) -> None:
    _, writer, ends = pipe
    lines = LinePoll(ends[0])
    assert lines.receive() == []
    writer.send({"n": 1})
    os.write(ends[1], b'{"n": 2}\n{"n"')
    assert taken(lines, 2) == [{"n": 1}, {"n": 2}]
    assert (lines.receive(), lines.ended) == ([], False)
    os.write(ends[1], b': 3}\n{"n": 4')
    os.close(ends.pop())
    assert taken(lines, 1) == [{"n": 3}]
    wait_for(lambda: lines.receive() or lines.ended)
    assert lines.ended, "and the line cut short is none"


def taken(lines: LinePoll, number: int) -> list[dict[str, object]]:
    records: list[dict[str, object]] = []
    wait_for(lambda: records.extend(lines.receive()) or len(records) >= number)
    return records
