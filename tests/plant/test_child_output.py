"""A process's output is kept up to a limit, in order, and the omitted part is counted."""

import threading

from hil.plant.child_output import ChildOutput


def lines(first: int, end: int) -> bytes:
    return b"".join(b"line %d\n" % number for number in range(first, end))


def test_a_quiet_process_is_heard_whole_and_in_order() -> None:
    output = ChildOutput()
    assert not output
    output.feed(b"one\ntw")
    assert output
    assert output.new_lines() == ["one"]
    assert not output
    output.feed(b"o\n\n\x1b[31mthree")
    assert (output.new_lines(), output.last()) == (["two"], "[31mthree")
    assert output.end() == ["[31mthree"]


def test_of_a_process_that_never_stops_the_first_and_the_newest_lines_are_kept() -> None:
    output = ChildOutput()
    for first in range(0, 50_000, 1000):
        output.feed(lines(first, first + 1000))
    told = [*output.new_lines(), *output.end()]
    assert told[:100] == [f"line {number}" for number in range(100)]
    assert told[100:] == ["49880 lines are left out here", *(f"line {number}" for number in range(49_980, 50_000))]
    assert output.last() == "line 49999"


def test_nothing_is_told_twice_and_nothing_lost_between_the_first_and_the_newest() -> None:
    for count in (99, 100, 101, 119, 120, 121):
        output = ChildOutput()
        output.feed(lines(0, count))
        told = [*output.new_lines(), *output.end()]
        left_out = [line for line in told if "left out" in line]
        assert len(told) - len(left_out) + (int(left_out[0].split()[0]) if left_out else 0) == count
        assert bool(left_out) == (count > 120)
        assert output.end() == []


def test_a_line_without_an_end_takes_no_memory() -> None:
    output = ChildOutput()
    for _ in range(100):
        output.feed(b"x" * 65536)
    assert len(output._begun) < 20_000
    assert [len(line) for line in output.end()] == [300]


def test_whoever_takes_nothing_holds_up_nobody() -> None:
    output = ChildOutput()
    feeder = threading.Thread(target=lambda: [output.feed(lines(0, 1000)) for _ in range(200)])
    feeder.start()
    feeder.join(20)
    assert not feeder.is_alive()
    assert len(output.new_lines()) == 100


def test_a_second_process_has_last_words_of_its_own() -> None:
    output = ChildOutput()
    output.feed(b"the first\n")
    output.forget_newest()
    assert (output.last(), output.new_lines()) == ("", ["the first"])
