"""The tutorials work: every block is run, in the order of the page, by a reader that only types."""

import json
import shutil
from pathlib import Path

import pytest

from tests.support.processes import ROOT
from tools.page_blocks import (
    PageError,
    blocks,
    commands,
    other_pages,
    reader,
    run_among_examples,
    run_page,
    runs,
    shows,
)

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
START = ROOT / "docs" / "start.md"
INSTALLING = ("python3 -m venv", "pip install")
pytestmark = pytest.mark.skipif(
    shutil.which("bash") is None, reason="no bash: install it, as the pages are typed into it"
)


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_shows_what_happens(page: Path, tmp_path: Path) -> None:
    run_page(page, tmp_path, reader(tmp_path))


def test_the_start_page_shows_what_happens(tmp_path: Path) -> None:
    text = START.read_text(encoding="utf-8")
    typed = tuple(f"$ {one}" for one in INSTALLING)
    installed = "\n".join(line for line in text.splitlines() if not line.startswith(typed))
    (page := tmp_path / "start.md").write_text(installed, encoding="utf-8")
    run_page(page, tmp_path, reader(tmp_path))


@pytest.mark.parametrize(
    "page", [page for page in other_pages() if runs(page)], ids=lambda page: str(page.relative_to(ROOT))
)
def test_the_commands_of_a_page_run(page: Path, tmp_path: Path) -> None:
    run_among_examples(page, tmp_path)


def test_the_start_page_is_short() -> None:
    text = START.read_text(encoding="utf-8")
    typed = [one for block in blocks(text) if block.language == "console" for one in commands(block)]
    assert len(typed) <= 12
    assert len(text.split()) <= 1500


def test_the_notebook_runs(tmp_path: Path) -> None:
    import matplotlib as mpl

    mpl.use("agg")
    notebook = json.loads((ROOT / "docs" / "tutorials" / "demo.ipynb").read_text(encoding="utf-8"))
    names: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    assert names["heavy"].metrics["t10_s"] > 0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("shown", "same"),
    [("a\nc", True), ("…\nc", True), ("a…\nb", True), ("c\na", False), ("a b", False), ("…z…", False), ("", True)],
)
def test_shown_lines_are_looked_for_in_order(shown: str, same: bool) -> None:
    assert shows(shown, "a\nb\nc\n") is same


def test_a_command_that_fails_fails_its_page(tmp_path: Path) -> None:
    (page := tmp_path / "page.md").write_text("```console\n$ false\n```\n", encoding="utf-8")
    with pytest.raises(PageError, match="'false' ended with 1"):
        run_page(page, tmp_path, reader(tmp_path))
    page.write_text("```console\n$ echo one\ntwo\n```\n", encoding="utf-8")
    with pytest.raises(PageError, match="where the page shows\ntwo"):
        run_page(page, tmp_path, reader(tmp_path))
