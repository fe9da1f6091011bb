"""Check values as RECORDING.md has them, and the sentences on what a file lacks, by an account in plain Python."""

import json
import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.record import checks
from hil.record.checks import CHECK, Contained, WrittenBytes, event_check, numbered, property_check, row_crcs
from hil.record.contents import (
    CUT_BEFORE_ROWS,
    DamagedError,
    Properties,
    json_property,
    numbered_events,
    numbered_rows,
    why_nothing,
)
from hil.record.decode_rrd import _order, _Piece, _whole_rows
from hil.record.properties import APPLICATION, scenario_values, table_rows
from tests.support.examples import share_of_examples

WHOLE = st.integers(-(2**63), 2**63 - 1)
FIRST = st.sampled_from([0, 5, 2**32 - 3, 2**33 + 1])
LEFT_OUT = "cannot be read and are left out"


def word(number: int, data: bytes) -> int:
    """Return the word of a row or event."""
    return number % 2**32 << 32 | zlib.crc32(data) ^ number % 2**32 * 2654435761 % 2**32


def properties(**texts: object) -> Properties:
    """Return properties of a file, each with its check value."""
    made = Properties()
    for name, value in texts.items():
        own = {"json": json.dumps(value)}
        made.read(name, {**own, CHECK: property_check(name, own)})
    return made


@share_of_examples(0.4)
@given(FIRST, st.lists(st.tuples(WHOLE, WHOLE, st.floats(), st.floats()), min_size=1, max_size=4))
def test_the_word_of_a_row_is_what_the_page_says(first: int, rows: list[tuple[int, int, float, float]]) -> None:
    t_ns, ticks = (np.array([row[i] for row in rows], np.int64) for i in (0, 1))
    values = np.array([row[2:] for row in rows])
    found = numbered(np.arange(first, first + len(rows)), row_crcs(t_ns, ticks, values))
    assert found.tolist() == [word(first + i, struct.pack("<qqdd", *row)) for i, row in enumerate(rows)]


@share_of_examples(0.4)
@given(FIRST, WHOLE, st.text())
def test_events_and_properties_have_the_crc_of_their_json(number: int, t_ns: int, text: str) -> None:
    assert event_check(number, t_ns, "WARN", text) == word(number, json.dumps([t_ns, "WARN", text]).encode())
    crc = zlib.crc32(json.dumps(["run", {"a": text, "b": "1"}]).encode())
    assert property_check("run", {"b": "1", "a": text}) == f"{crc:08x}"


def test_what_is_read_back_piece_by_piece_is_what_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "_PIECE_BYTES", 4)
    content = bytes(range(21))
    with (tmp_path / "file").open("wb", buffering=0) as file:
        file.write(content[:13])
        written = WrittenBytes(tmp_path / "file")
        for most in (0, 3, 4, 9, 13):
            written.read(most)
            assert (written.count, written.crc32) == (most, zlib.crc32(content[:most]))
        file.write(content[13:])
        written.read()
        assert (written.count, written.crc32) == (21, zlib.crc32(content))
        written.close()


def test_a_file_counts_its_contents_over_the_whole_run() -> None:
    held = Contained({"first_row": 100, "first_event": 7})
    assert [held.add_rows(3), held.add_rows(2), held.add_rows(4, 200), held.add_rows(1)] == [100, 103, 200, 204]
    assert [held.add_event(), held.add_event()] == [7, 8]
    assert held.checked("run", {"a": "b"}) == {"a": "b", CHECK: property_check("run", {"a": "b"})}
    held.checked("run", {"a": "c"})
    held.checked("part", {})
    assert held.end() == {"rows_until": 205, "events_until": 9, "holds": ["run", "part"]}


@share_of_examples(0.4)
@given(FIRST, st.lists(st.integers(-9, 30), max_size=25), st.one_of(st.none(), st.integers(0, 30)))
def test_each_row_is_there_once_in_order_and_the_others_are_counted(
    first: int, read: list[int], until: int | None
) -> None:
    """Rows before the first of the part are those of a file that was merged from several."""
    read = [number for number in read if first + number >= 0]
    stored = np.array([(first + number) % 2**32 for number in read], np.uint64)
    values = np.array([[first + number, 0.5 * number] for number in read], float).reshape(-1, 2)
    end = {} if until is None else {"recorder": {"rows_until": first + until}}
    found = numbered_rows(stored, values, ["number", "loop.t_s"], properties(part={"first_row": first}, **end))
    there = sorted(set(read))
    assert found.numbers.tolist() == found.signals["number"].tolist() == [first + number for number in there]
    ends = [last + 1 for last in there[-1:]] + [until] * (until is not None)
    expected = set(range(min([0, *there]), max(ends, default=0))) - set(there)
    assert found.lost == len(expected)
    assert found.last_s == (0.5 * there[-1] if there else -np.inf)


def rows_without(gone: Iterable[int], count: int = 20, **recorder: Any) -> tuple[int, list[str], list[str]]:
    """Return what is said of a file of rows 0, 1, ..., every 0.1 s, without some."""
    there = np.setdiff1d(np.arange(count), list(gone))
    told = properties(part={"first_row": 0}, recorder={"rows_until": count, "rows_in_part": count, **recorder})
    found = numbered_rows(there.astype(np.uint32), 0.1 * there[:, None], ["loop.t_s"], told)
    return found.lost, found.damage, found.remarks


def test_a_gap_is_told_with_its_rows_and_the_times_around_it() -> None:
    assert rows_without([]) == (0, [], [])
    gone = [0, 1, 2, 6, 10, 11, 19]
    sentences = [
        f"3 rows (0 to 2), before t = 0.3 s, {LEFT_OUT}",
        f"1 row (6), after t = 0.5 s and before t = 0.7 s, {LEFT_OUT}",
        f"2 rows (10 to 11), after t = 0.9 s and before t = 1.2 s, {LEFT_OUT}",
        f"1 row (19), after t = 1.8 s, {LEFT_OUT}",
    ]
    assert rows_without(gone) == (7, sentences, [])
    lost = [sentence.replace(LEFT_OUT, "were lost when the run was recorded") for sentence in sentences]
    assert rows_without(gone, rows_in_part=13) == (7, [], lost)
    assert rows_without(gone, rows_in_part=14) == (7, sentences, [])
    later = properties(part={"first_row": 100}, recorder={"rows_until": 110, "rows_in_part": 7})
    found = numbered_rows(np.array([100, 101, 105, 106, 107, 108, 109], np.uint32), np.empty((7, 0)), [], later)
    assert (found.lost, found.damage, len(found.remarks)) == (3, [], 1)
    assert rows_without(range(20)) == (20, [f"20 rows (0 to 19), {LEFT_OUT}"], [])


def test_of_many_gaps_the_first_eight_are_told_and_the_others_counted() -> None:
    lost, damage, _ = rows_without([*range(1, 18, 2)], 19)
    assert (lost, len(damage), damage[7][:11]) == (9, 9, "1 row (15),")
    assert damage[8] == f"1 rows in 1 more places {LEFT_OUT}"
    lost, damage, _ = rows_without([*range(1, 18, 2), 21, 22, 24], 26)
    assert (lost, damage[8]) == (12, f"4 rows in 3 more places {LEFT_OUT}")
    assert len(rows_without([*range(1, 16, 2)], 17)[1]) == 8


def test_events_are_in_order_once_and_the_missing_ones_are_counted() -> None:
    one, two, three = ((0.5 * n, "INFO", f"event {n}") for n in (1, 2, 3))
    told = properties(part={"first_event": 4}, recorder={"events_until": 7})
    assert numbered_events([(6, three), (4, one), (5, two), (4, one)], told) == ([one, two, three], 0, [])
    assert numbered_events([(6, three), (4, one)], told) == (
        [one, three], 1, ["1 event cannot be read and is left out"],
    )  # fmt: skip
    assert numbered_events([(5, two)], told) == ([two], 2, ["2 events cannot be read and are left out"])
    assert numbered_events([(4, one), (5, two), (6, three)], told, differ=3)[1:] == (
        3, ["3 events cannot be read and are left out"],
    )  # fmt: skip
    assert numbered_events([], told)[:2] == ([], 3)
    # Older recordings do not number them.
    assert numbered_events([(None, two), (None, one)], properties()) == ([two, one], 0, [])


def test_a_property_that_differs_from_its_check_value_is_left_out_and_told() -> None:
    held = properties(run=1, recorder={"holds": ["run", "part", "summary", "mine"]})
    held.read("summary", {"json": "1", CHECK: "00000000"})
    held.read("mine", {"json": "1"})  # of nobody's kind: it needs no check value
    assert held.damage() == [
        "its property 'summary' differs from its check value and is left out",
        "its property 'part' is missing",
    ]
    assert sorted(held) == ["mine", "recorder", "run"]
    held.read("summary", {"json": "2", CHECK: property_check("summary", {"json": "2"})})
    assert held.damage() == ["its property 'part' is missing"], "the newest one counts"
    held.read("summary", {"json": "3", CHECK: "00000000"})
    assert "summary" not in held, "the newest one counts, and it is damaged"
    held.read("summary", {"json": "2", CHECK: property_check("summary", {"json": "2"})})
    held.read("part", {"json": "{}"})
    assert held.damage() == ["its property 'part' differs from its check value and is left out"]
    assert "part" not in held
    held.read("signals", {CHECK: "00000000"})
    with pytest.raises(DamagedError, match=r"^damaged: its property 'signals' differs from its check value$"):
        held.damage()


def test_without_any_check_value_every_property_counts() -> None:
    held = Properties()
    held.read("run", {"a": "b"})
    assert (held.damage(), held, held.has_checks, held.part, held.end) == ([], {"run": {"a": "b"}}, False, {}, {})
    assert properties(part=3)["part"] == {"json": "3"}
    for text in ("3", "{"):
        with pytest.raises(DamagedError, match=r"^damaged: its property 'part' is not readable$"):
            json_property({"part": {"json": text}}, "part")
    assert json_property({}, "part") is None


def test_a_file_without_rows_is_cut_or_damaged_or_of_another_program() -> None:
    damaged, foreign = "damaged: it does not say what its signals are", "a recording of another program"
    early = "cut off so early that its program is not known"
    cases = {
        ((APPLICATION,), None): damaged, ((APPLICATION,), 0): CUT_BEFORE_ROWS,
        (("other", APPLICATION), 3): CUT_BEFORE_ROWS,
        (("other",), 3): foreign, (("other",), None): foreign, ((), None): foreign, ((), 0): early,
    }  # fmt: skip
    assert {case: why_nothing(*case) for case in cases} == cases


def test_tables_of_a_scenario_are_in_the_order_of_their_numbers() -> None:
    values = scenario_values(
        {"scenario": '{"fault.10.kind": "b", "fault.2.kind": "a", "fault.2.x": 1, "a.fault.1.x": 2}'}
    )
    assert table_rows(values, "fault") == [{"kind": "a", "x": 1}, {"kind": "b"}]
    assert scenario_values({}) == scenario_values({"scenario": "[]"}) == scenario_values({"scenario": "{"}) == {}


def test_rows_of_a_file_that_was_written_again_are_in_the_order_of_their_whole_ids() -> None:
    """The first half of an id is the time: the count in the second half may begin anew with another process."""
    ids = np.array([[2, 1], [1, 5], [1, 3], [2, 0]], np.uint64)
    assert ids[_order(ids)].tolist() == [[1, 3], [1, 5], [2, 0], [2, 1]]


def test_rows_and_their_check_values_are_matched_by_their_ids_and_those_without_a_partner_are_left_out() -> None:
    def of(ids: list[tuple[int, int]]) -> np.ndarray:
        return np.array(ids, np.uint64).reshape(-1, 2)

    every = [(1, 3), (1, 5), (2, 0), (2, 1), (3, 9)]
    crcs = np.array([70, 71, 72, 73, 74], np.uint64)
    words = numbered(np.arange(10, 15), crcs)
    words[4] += np.uint64(1)  # it differs
    for rows_of, words_of, whole in (
        ([0, 1, 2, 3], [0, 1, 2, 3], [0, 1, 2, 3]),
        ([1, 2, 3], [0, 1, 2], [1, 2]),
        ([0, 3], [0, 1, 2, 3, 4], [0, 3]),
        ([0, 1, 2, 4], [1, 4], [1]),
        ([0, 1], [], []),
    ):
        rows = _Piece(of([every[i] for i in rows_of]), np.array(rows_of), crcs[rows_of], crcs[rows_of, None] * 0.5)
        # They were read in two pieces, the later one first.
        pieces = [(of([every[i] for i in some]), words[some]) for some in (words_of[1:], words_of[:1])]
        numbers, found = _whole_rows(rows, pieces)
        assert numbers.tolist() == [10 + i for i in whole]
        assert found.ticks.tolist() == whole
        assert found.values[:, 0].tolist() == [0.5 * (70 + i) for i in whole]
