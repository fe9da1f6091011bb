"""Results of a batch on the terminal, as a page, in Markdown and as files; what cannot be asked for or written."""

from pathlib import Path

import pytest

from hil.addons.batch.results_page import (
    Page,
    Plot,
    Results,
    Table,
    as_html,
    as_markdown,
    as_text,
    finish,
    markdown_table,
)
from hil.core.errors import BadInputError

TABLE = Table("Runs & more", [("law", "rms"), ("a<b", "1.5"), ("c", "22.25")], ["a note <1>"], "about > it", (1,))


def results(*plots: Plot) -> Results:
    return Results("Title", False, "1 of 2 <failed>", ["about one", "", "about two"], [TABLE], plots, {"passed": False})


def test_a_table_is_text_html_and_markdown() -> None:
    lines = list(as_text(results()))
    assert lines[0] == "Runs & more"
    assert lines[4:] == ["  a note <1>", "", "1 of 2 <failed>", "about one", "", "about two"]
    page = as_html(results())
    assert '<p class="verdict failed">1 of 2 &lt;failed&gt;</p>' in page
    assert '<p class="verdict passed">' in as_html(results()._replace(passed=True))
    assert page.count('<p class="about">') == 2 + 1
    assert "<h2>Runs &amp; more</h2>" in page
    assert '<p class="about">about &gt; it</p>' in page
    assert '<p class="note">a note &lt;1&gt;</p>' in page
    assert list(as_markdown(TABLE)) == [
        *("", "## Runs & more", "", "| law | rms |\n|---|---|\n| a<b | 1.5 |\n| c | 22.25 |"),
        *("", "- a note <1>"),
    ]
    assert list(as_markdown(TABLE._replace(notes=()), "###"))[1:] == [
        "### Runs & more",
        "",
        list(as_markdown(TABLE))[3],
    ]
    assert markdown_table([("a|b",), ("c",)]) == "| a\\|b |\n|---|\n| c |\n"


def test_a_plot_is_on_the_page_in_its_proportions_and_beside_it_as_a_file(tmp_path: Path) -> None:
    drawn = []
    plot = Plot("one", lambda axes: drawn.append(len(axes)), 1, 2, (6.0, 3.0), "Its title", "its caption")
    page = Page.of(tmp_path / "page.html", "svg", force=False)
    finish(results(plot), page, as_json=False, files={tmp_path / "more.txt": "more"})
    assert drawn == [2, 2]
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Its title" in text
    assert "its caption" in text
    assert page.picture(plot) == tmp_path / "one.svg"
    assert "<svg" in (tmp_path / "one.svg").read_text(encoding="utf-8")
    assert (tmp_path / "more.txt").read_text() == "more"
    with pytest.raises(BadInputError, match="the file exists already"):
        Page.of(tmp_path / "page.html", None, force=False)
    assert Page.of(tmp_path / "page.html", None, force=True).existing == "replace"
    finish(results(plot), Page(tmp_path / "other.html", None, "refuse"), as_json=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["more.txt", "one.svg", "other.html", "page.html"]


def test_results_are_with_their_reader_before_a_picture_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed = []
    with (tmp_path / "printed").open("w", encoding="utf-8") as stdout:  # buffered, as into a pipe
        monkeypatch.setattr("sys.stdout", stdout)
        plot = Plot("one", lambda _: printed.append((tmp_path / "printed").read_text(encoding="utf-8")))
        finish(results(plot), Page(tmp_path / "page.html", "svg", "refuse"), as_json=False)
    assert ["about two" in text for text in printed] == [True, True]


def test_what_cannot_be_written_keeps_nothing_else_back_and_is_told_first(tmp_path: Path) -> None:
    for name in ("more.txt", "one.svg"):
        (tmp_path / name).mkdir()
    page = Page(tmp_path / "page.html", "svg", "replace")
    plots = [Plot(name, lambda _: None) for name in ("one", "two")]
    with pytest.raises(BadInputError, match=r"more\.txt"):
        finish(results(*plots), page, as_json=False, files={tmp_path / "more.txt": "more", tmp_path / "b.txt": "b"})
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == {"b.txt", "page.html", "two.svg"}


def test_pictures_without_a_page_or_of_another_format_are_refused() -> None:
    with pytest.raises(BadInputError, match=r"--pictures svg: they stand beside the page; give --html FILE\.html too"):
        Page.of(None, "svg", force=False)
    with pytest.raises(BadInputError, match="--pictures gif"):
        Page.of(Path("page.html"), "gif", force=False)
    assert Page.of(None, None, force=False) == (None, None, "refuse")
