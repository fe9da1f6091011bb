"""What commands print on a terminal: tables and lines that fit it, the progress of many runs, and errors of Python."""

import io
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from hil.cli import main as program
from hil.cli import output
from hil.cli.list import listing
from hil.core.errors import BadInputError


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def terminal_of_40_columns(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Make stdout and stderr a terminal."""
    shown = Terminal()
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(sys, "stdout", shown)
    monkeypatch.setattr(sys, "stderr", shown)
    return shown


def test_many_runs_show_how_many_are_done_at_which_rate_and_how_long_the_others_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = terminal_of_40_columns(monkeypatch)
    times = iter([100.0, 104.0, 110.0])
    monkeypatch.setattr("hil.cli.output.time.monotonic", lambda: next(times))
    progress = output.RunsProgress()
    progress.end()
    assert terminal.getvalue() == "", "nothing has been shown"
    progress(5, 45, None)
    progress(15, 45, None, failed=2)
    progress(25, 45, "a worker was killed", failed=3)
    progress.end()
    _, first, second, _, third = terminal.getvalue().split("\r")
    assert first == "5 of 45 runs"
    assert second == "15 of 45 runs, 2 failed, 2.5 runs/s, 12 s left"
    assert f"\r{'a worker was killed':<{len(second)}}\n" in terminal.getvalue()
    assert third == f"{'25 of 45 runs, 3 failed, 2 runs/s, 10 s left':<{len(second)}}\n"


def test_without_a_terminal_progress_is_a_line_each_ten_seconds_and_a_trouble_is_said_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    times = iter([100.0, 104.0, 110.0, 111.0, 121.0])
    monkeypatch.setattr("hil.cli.output.time.monotonic", lambda: next(times))
    progress = output.RunsProgress()
    for done in (0, 4, 10, 11):
        progress(done, 40, None)
    progress(20, 40, "a worker was killed", failed=1)
    progress.end()
    assert pipe.getvalue().splitlines() == [
        "10 of 40 runs, 1 runs/s, 30 s left",
        "a worker was killed",
        "20 of 40 runs, 1 failed, 0.952 runs/s, 21 s left",
    ]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (89.0, "89 s"), (90.0, "2 min"), (5399.0, "90 min"), (5400.0, "1.5 h"), (9000.0, "2.5 h")],
)
def test_a_duration_is_in_seconds_minutes_or_hours(seconds: float, words: str) -> None:
    assert output.duration_words(seconds) == words


def test_a_table_is_as_wide_as_the_terminal_and_whole_in_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal_of_40_columns(monkeypatch)
    rows = [("name", "unit", "what"), ("ab", "m", "one two three four five six seven"), ("abcd", "", "x" * 20)]
    assert list(output.table(rows)) == [
        "name  unit  what",
        "ab    m     one two three four five six",
        "            seven",
        f"abcd        {'x' * 20}",
    ]
    assert list(output.table(rows[:1])) == ["name  unit  what"]
    exact = [("ab", "m", "x" * 10 + " " + "y" * 22), ("abc", "", "z")]  # 3, 1 and 33 with two gaps: 41
    assert len(list(output.table(exact, has_head=False))) == 3
    wide = [("ab", "m", " ".join(["xx"] * 20)), exact[1]]
    assert next(output.table(wide, has_head=False)) == f"ab   m  {' '.join(['xx'] * 11)}", "all 40 columns"
    exact[0] = ("ab", "m", "x" * 10 + " " + "y" * 21)
    assert list(output.table(exact, has_head=False)) == [f"ab   m  {'x' * 10} {'y' * 21}", "abc     z"]
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    assert list(output.table(rows))[1] == "ab    m     one two three four five six seven"


def test_a_table_with_columns_too_narrow_for_prose_becomes_paragraphs(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal_of_40_columns(monkeypatch)
    prose = " ".join(["word"] * 20)
    rows = [("name", "unit", "meaning"), ("ab", "", prose), ("cd", "m", "short"), ("e" * 22, "kg", "x")]
    shown = list(output.table(rows))
    assert shown[:2] == ["ab", "  meaning  word word word word word word"]
    assert shown[2] == "           word word word word word word"
    words = [("name", "meaning"), ("a" * 30, "b" * 29)]  # neither is long, and both do not fit
    assert list(output.table(words)) == ["a" * 30, f"  meaning  {'b' * 29}"]
    assert shown[5:] == ["cd", "  unit     m", "  meaning  short", "e" * 22, "  unit     kg", "  meaning  x"]


def test_a_line_is_folded_below_its_text_and_a_command_stays_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = terminal_of_40_columns(monkeypatch)
    output.print_result(False, {}, output.rows([("label", "a text that is longer than the terminal")]))
    output.print_result(False, {}, ["  hil run a_scenario --record a_name_that_is_long.rrd", "no end " * 8])
    assert terminal.getvalue().splitlines() == [
        "  label                  a text that is",
        "    longer than the terminal",
        "  hil run a_scenario --record a_name_that_is_long.rrd",
        "no end no end no end no end no end no",
        "  end no end no end",
    ]
    assert output.folded("  label  a text that is longer than the terminal") == [
        "  label  a text that is longer than the",
        "         terminal",
    ]
    for column, indent in ((20, 20), (21, 4)):  # half of the terminal
        assert output.folded(f"{'  label':{column}}a text that is longer")[1] == " " * indent + "longer"
    output.print_result(True, {"a": float("nan")}, [])
    assert terminal.getvalue().splitlines()[-1] == '{"a": null}'


def test_a_warning_is_told_as_one_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    output.warn("the floor is wet")
    assert capsys.readouterr() == ("", "hil: warning: the floor is wet\n")


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (RecursionError(), "hil: a file or an option is nested too deeply to be read; give one with fewer levels"),
        (
            MemoryError(),
            "hil: there is too little memory; end other programs, or raise the limit of this one (ulimit -v)",
        ),
        (
            OSError(36, "File name too long", "n" * 300),
            f"hil: '{'n' * 40}'...: a file's name of 300 characters is too long; give a shorter one",
        ),
        (BadInputError("robot x.toml: it is empty"), "hil: robot x.toml: it is empty"),
    ],
)
def test_what_python_cannot_do_is_one_sentence_and_exit_code_2(
    error: BaseException, sentence: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(**_options: object) -> None:
        raise error

    monkeypatch.setattr(program, "app", fails)
    with pytest.raises(SystemExit) as ended:
        program.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"{sentence}\n"


def test_a_recording_that_has_no_folder_is_refused_with_the_option_for_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "runs").touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInputError, match=r"name a file with --record, or --record none$") as refused:
        CliRunner().invoke(program.app, ["run", "circle_speed"], catch_exceptions=False)
    assert str(refused.value).startswith(f"recording folder {tmp_path / 'runs'}: it cannot be made (File exists); ")


def test_a_list_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(BadInputError, match=r"there is no list of 'signal'; did you mean 'signals'"):
        listing("signal")
    units = {row[0]: row[1] for row in listing("figures")[1]}
    assert (units["steady_rms_m"], units["t10_s"], units["effort_n_m_s"], units["ticks"]) == ("m", "s", "N·m·s", "")
