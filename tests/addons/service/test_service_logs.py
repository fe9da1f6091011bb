"""Structured log lines on stderr; writing them never waits."""

import ast
import json
import logging
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hil.addons.service import logs
from hil.addons.service.messages import LogStyle

Read = Callable[[], str]


@pytest.fixture
def pipe() -> Iterator[tuple[int, Read]]:
    root = logging.getLogger()
    before = root.handlers[:], root.level
    ends = os.pipe()
    os.set_blocking(ends[0], False)

    def read() -> str:
        try:
            return os.read(ends[0], 1 << 20).decode()
        except BlockingIOError:
            return ""

    yield ends[1], read
    root.handlers[:], level = before
    root.setLevel(level)
    for end in ends:
        os.close(end)


def configured(style: LogStyle, pipe: tuple[int, Read]) -> Read:
    logs.configure(style, "control", pipe[0])
    return pipe[1]


def test_a_line_of_json_has_time_level_process_event_and_fields(pipe: tuple[int, Read]) -> None:
    read = configured("json", pipe)
    logs.warning("link lost", link="serial:/dev/ttyACM0", silent_s=0.25, event="not to be mistaken", why="a\nb")
    line = json.loads(read())
    assert (line["level"], line["process"], line["event"]) == ("warning", "control", "link lost")
    assert (line["silent_s"], line["why"]) == (0.25, "a\nb")
    assert line["time"].endswith("Z")


def test_a_line_of_text_is_one_line_whatever_is_in_it(pipe: tuple[int, Read]) -> None:
    read = configured("text", pipe)
    logs.info("order", action="arm", why="the robot\nis away", none="")
    assert read().partition(" ")[2] == 'info    control: order action=arm why="the robot\\nis away" none=""\n'


def test_what_libraries_say_and_tracebacks_are_lines_too(pipe: tuple[int, Read]) -> None:
    read = configured("json", pipe)
    try:
        raise ValueError("bad")
    except ValueError:
        logging.getLogger("uvicorn.error").exception("it %s", "failed")
    logging.getLogger("uvicorn.error").info("not this one")
    (text,) = read().splitlines()
    line = json.loads(text)
    assert (line["event"], line["logger"], line["level"]) == ("it failed", "uvicorn.error", "error")
    assert line["traceback"].endswith("ValueError: bad")


@pytest.mark.parametrize("style", ["text", "json"])
def test_of_a_traceback_that_is_too_long_the_end_stays(pipe: tuple[int, Read], style: LogStyle) -> None:
    read = configured(style, pipe)

    def fail(depth: int) -> None:
        if not depth:
            raise ValueError("é" * 50 + "the cause")
        try:
            fail(depth - 1)
        except ValueError as error:
            raise ValueError(depth) from error

    try:
        fail(30)
    except ValueError:
        logging.getLogger("uvicorn.error").exception("it failed")
    (text,) = read().splitlines()
    assert "ValueError: 30" in text
    assert "… (cut)" in text or json.loads(text)["event"] == "it failed… (cut)"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows waits")
def test_a_reader_that_stands_still_holds_nobody_up_and_learns_what_it_missed(pipe: tuple[int, Read]) -> None:
    read = configured("json", pipe)
    for number in range(2000):
        logs.info(f"tick {number}", number=number)
    taken = [json.loads(line)["number"] for line in read().splitlines()]
    assert taken == list(range(len(taken)))
    assert 100 < len(taken) < 2000
    for number in (2000, 2001):
        logs.info(f"tick {number}", number=number)
    first, second = map(json.loads, read().splitlines())
    assert (first["number"], first["lines_dropped"]) == (2000, 2000 - len(taken))
    assert "lines_dropped" not in second


def test_of_one_event_few_lines_are_written_and_the_next_says_how_many_were_not(
    pipe: tuple[int, Read], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr(logs.time, "monotonic", lambda: now_s)
    read = configured("json", pipe)
    for number in range(5000):
        logs.warning("frame rejected", number=number)
        logs.info("order", action="go", number=number)
    logs.info("order", action="arm")
    lines = [json.loads(line) for line in read().splitlines()]
    assert [line["number"] for line in lines if line["event"] == "frame rejected"] == list(range(20))
    assert lines[-1]["action"] == "arm", "many orders of one kind hide none of another"
    now_s += 0.5
    logs.warning("frame rejected", number=5000)
    logs.warning("frame rejected", number=5001)
    (line,) = map(json.loads, read().splitlines())
    assert (line["number"], line["left_out"]) == (5000, 4980)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows waits")
def test_a_line_that_cannot_be_written_uses_up_no_allowance_and_every_line_is_counted(
    pipe: tuple[int, Read], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr(logs.time, "monotonic", lambda: now_s)
    read = configured("json", pipe)
    for number in range(30):  # 20 are written and 10 left out
        logs.warning("frame rejected", number=number)
    for number in range(2000):
        logs.info(f"tick {number}")  # until the pipe is full
    now_s += 0.5
    for _ in range(25):
        logs.warning("frame rejected")
        logs.warning("link lost")
    lost = 2000 + 50 - sum("tick" in line for line in read().splitlines())
    logs.warning("link lost")
    logs.warning("frame rejected")
    for number in range(19):
        logs.warning("link lost", number=number)
    lost_line, rejected_line, *others = map(json.loads, read().splitlines())
    assert (lost_line["lines_dropped"], lost_line.get("left_out")) == (lost, None)
    assert rejected_line["left_out"] == 10
    assert len(others) == 19


def test_the_events_of_a_service_are_constants() -> None:
    for file in Path(logs.__file__).parent.rglob("*.py"):
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            is_log = isinstance(call, ast.Call) and ast.unparse(call.func) in (
                "logs.info",
                "logs.warning",
                "logs.error",
            )
            assert not is_log or isinstance(call.args[0], ast.Constant), f"{file}:{call.lineno}"


def test_a_line_too_long_to_be_written_at_once_is_cut(pipe: tuple[int, Read]) -> None:
    read = configured("json", pipe)
    logs.error("bad frame", data="x" * 10_000)
    assert json.loads(read())["event"] == "bad frame… (cut)"
    logs.error("bad frame", data="")
    left = logs._LONGEST_LINE_BYTES - len(read())  # with the newline
    logs.error("bad frame", data="x" * left)
    assert json.loads(read())["event"] == "bad frame"
    logs.error("bad frame", data="x" * (left + 1))
    assert json.loads(read())["event"] == "bad frame… (cut)"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such pipes")
def test_a_reader_that_has_gone_is_no_error() -> None:
    root = logging.getLogger()
    before = root.handlers[:], root.level
    reader, writer = os.pipe()
    os.close(reader)
    try:
        logs.configure("text", "control", writer)
        logs.info("nobody hears this")
    finally:
        root.handlers[:], level = before
        root.setLevel(level)
        os.close(writer)


def test_a_line_that_nobody_read_is_counted_with_those_that_it_stood_for(
    pipe: tuple[int, Read], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr(logs.time, "monotonic", lambda: now_s)
    read = configured("json", pipe)
    for number in range(25):  # 20 are written and 5 left out
        logs.warning("frame rejected", number=number)
    read()
    now_s += 0.5

    def full(*_: object) -> int:
        raise BlockingIOError

    with monkeypatch.context() as patch:
        patch.setattr(logs.os, "write", full)
        logs.warning("frame rejected")  # would say that 5 were left out
        logs.warning("link lost")
    logs.warning("link lost")
    line = json.loads(read())
    assert (line["event"], line["lines_dropped"]) == ("link lost", 1 + 5 + 1)
    logs.warning("link lost")
    assert "lines_dropped" not in json.loads(read())
