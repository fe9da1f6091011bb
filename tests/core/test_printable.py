"""Text from elsewhere reaches no terminal, log or page with a character in it that a terminal would obey."""

import io
import json
import logging
import os
import re
import sys
import unicodedata
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.service import logs
from hil.core.printable import PrintableStream, printable
from tests.support.examples import share_of_examples
from tests.support.processes import hil

EVIL = "\x1b]0;title\x07\x1b[2J\x9b31m\x08\r\x00\u202e\u2028\x7f"
HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
# What a command line can carry.
words = st.text(
    st.characters(exclude_characters="\0", exclude_categories=["Cs"]) | st.sampled_from(EVIL.replace("\0", ""))
)
SHORT = ("--set", "loop.duration_s=0.1", "--set", "expect=[]", "--lenient")


@share_of_examples(0.5)
@given(st.text(st.characters() | st.sampled_from(EVIL)))
def test_only_what_a_terminal_obeys_is_escaped_and_lines_stay(text: str) -> None:
    clean = printable(text)
    assert not HARMFUL.search(clean)
    assert clean.count("\n") == text.count("\n")
    assert printable(clean) == clean
    assert clean == text or HARMFUL.search(text) or re.search("[\u061c\u200e\u200f]", text)


def test_every_mark_that_turns_the_direction_of_text_is_escaped() -> None:
    marks = [chr(0x200E), chr(0x200F), chr(0x061C)]
    turns = {"LRE", "RLE", "PDF", "LRO", "RLO", "LRI", "RLI", "FSI", "PDI"}
    marks += [chr(code) for code in range(sys.maxunicode + 1) if unicodedata.bidirectional(chr(code)) in turns]
    assert len(marks) == 12, "Unicode's property Bidi_Control"
    assert printable("".join(marks)).isascii()
    assert printable("سلام, שלום\tΩ é\n") == "سلام, שלום\tΩ é\n"


def test_whatever_way_text_is_written_to_a_stream_it_is_escaped() -> None:
    raw = io.StringIO()
    stream = PrintableStream(raw)
    stream.writelines(["a\x1b[2J\n", "\u061cb\n"])
    print("\x9b", file=stream)
    stream.write("\r")
    assert raw.getvalue() == "a\\x1b[2J\n\\u061cb\n\\x9b\n\r"


@share_of_examples(0.1)
@given(words)
def test_what_a_command_is_given_comes_back_harmless(text: str) -> None:
    for arguments in (("show", f"./{text}"), ("run", "paper_circle", "--set", text), ("fmu", "check", f"./{text}")):
        done = hil(*arguments)
        assert done.returncode in (1, 2)
        assert not HARMFUL.search(done.stdout + done.stderr)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such names")
def test_a_scenario_s_name_and_a_law_s_words_are_harmless_in_terminal_recording_and_page(tmp_path: Path) -> None:
    evil = EVIL.replace("\0", "")
    (tmp_path / "laws.py").write_text(
        "class Evil:\n    def __init__(self, model, mode): pass\n    def reset(self, state, reference): pass\n"
        f"    def update(self, reference, state, applied, dt_s): print({evil!r}); raise ValueError({EVIL!r})\n"
    )
    scenario = tmp_path / f"one{evil}.toml"
    scenario.write_text('extends = "circle_speed"\ncontroller = { law = "./laws.py:Evil", command = "speed" }\n')
    ran = hil("run", f"./{scenario.name}", *SHORT, "--record", "run.mcap", cwd=tmp_path)
    assert ran.returncode == 2, ran.stderr
    assert "ValueError" in ran.stdout + ran.stderr
    review = hil("review", "run.mcap", "--html", "page.html", cwd=tmp_path)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "ValueError" in review.stdout
    assert "ValueError" in page
    for text in (ran.stdout, ran.stderr, review.stdout, review.stderr, page):
        assert not HARMFUL.search(text)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_what_teleop_shows_of_a_robot_and_a_gamepad_is_harmless(monkeypatch: pytest.MonkeyPatch) -> None:
    import pty

    from hil.addons.service.teleop.terminal import Terminal

    end, inner = pty.openpty()
    with os.fdopen(end, "rb", buffering=0) as window, os.fdopen(inner, "w") as stream:
        for name in ("stdin", "stdout", "stderr"):
            monkeypatch.setattr(sys, name, stream)
        Terminal().show([f"phase {EVIL}", "gamepad a\nb"])
        shown = window.read(65536).decode()
    for ours in ("\x1b[H", "\x1b[K", "\x1b[J"):
        shown = shown.replace(ours, "")
    first, second = shown.split("\r\r\n")  # the terminal puts a return before each line feed
    assert first == f"phase {printable(EVIL)}"
    assert second == "gamepad a b"


@share_of_examples(0.2)
@given(st.text(st.characters() | st.sampled_from(EVIL + "\n")), st.sampled_from(["text", "json"]))
def test_a_line_of_a_log_is_one_harmless_line(text: str, style: logs.LogStyle) -> None:
    reader, writer = os.pipe()
    root, own = logging.getLogger(), logging.getLogger("hil.service")
    handlers, levels = root.handlers[:], (root.level, own.level)
    try:
        logs.configure(style, "control", writer)
        logs.warning("an event", why=text)
    finally:
        root.handlers[:] = handlers
        root.setLevel(levels[0])
        own.setLevel(levels[1])
        os.close(writer)
    with os.fdopen(reader, encoding="utf-8", newline="\n") as file:
        [line] = file.read().removesuffix("\n").split("\n")
    assert not HARMFUL.search(line)
    if style == "json":
        assert json.loads(line)["event"] == "an event"
