"""Runs the blocks of a documentation page, one after another in one folder, as a reader would type them.

``python -m tools.page_blocks PAGE`` runs a page in a copy of docs/examples, with what takes minutes; without a page,
all pages that have such blocks. The language of a block says what it is:

- ``console``: a line that begins with ``$`` is a command for bash; the lines below it must be among its output, in this
  order. ``…`` stands for anything, within a line or as one. A command that ends in ``&`` goes on while the others run,
  once it has printed the shown output.
- ``sh``: each line is a command, which must end well. ``python`` is run as a program.
- a block with ``:caption: NAME`` is the file NAME, and is written.

A word after the language says why a block is not run: ``sh board``; ``REASONS`` has these words. Other languages are
for the eye, or for the tests of the pages.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt

REASONS = {
    "board": "needs a board, motors, a bus or an adapter",
    "root": "needs the rights of root",
    "screen": "needs a screen, a terminal or a person",
    "elsewhere": "needs ROS 2's tools, a container engine or another machine",
    "network": "needs a package index",
    "source": "changes or tests the sources themselves",
    "minutes": "takes minutes, or the service's port; `make nightly` runs it",
    "nightly": "takes longer, and is a step of `make nightly`",
    "form": "is a form to fill in, or a part of a file",
}
RUN = ("console", "sh", "python")
GIT = {f"GIT_{who}_{what}": "reader@localhost" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
"""Who commits, for git in the shell of a page."""
ROOT = Path(__file__).parents[1]
_DIRECTIVE = re.compile(r"\{code-block\} (\w+)")


class Block(NamedTuple):
    """A block: its language and the word after it, options of ``:name: value`` lines, its text, and its first line.

    The language is empty where none is given, as in a block that is only indented.
    """

    language: str
    word: str
    options: Mapping[str, str]
    text: str
    line: int


class Command(NamedTuple):
    """A command of a console block, and the output that the page shows."""

    words: str
    shown: str


class PageError(Exception):
    """A command failed, or printed something else than the page shows."""


def blocks(page: str) -> Iterator[Block]:
    """Yield the blocks of a page in Markdown."""
    for token in MarkdownIt().parse(page):
        if token.type not in ("fence", "code_block") or token.map is None:
            continue
        directive = _DIRECTIVE.fullmatch(token.info.strip())
        lines = token.content.splitlines(keepends=True)
        options = {}
        while directive and lines and (given := re.fullmatch(r":(\S+): (.*)\n", lines[0])):
            options[given[1]] = given[2]
            lines.pop(0)
        language, _, word = (directive[1] if directive else token.info.strip()).partition(" ")
        yield Block(language, word, options, "".join(lines), token.map[0] + 1)


def commands(block: Block) -> Iterator[Command]:
    """Yield the commands of a block of commands."""
    if block.language == "sh":
        lines = block.text.replace("\\\n", " ").splitlines()
        yield from (Command(line, "") for line in lines if line.strip() and not line.startswith("#"))
        return
    for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
        words, _, shown = part.partition("\n")
        yield Command(words, shown)


def run_page(
    page: Path,
    folder: Path,
    variables: Mapping[str, str] | None = None,
    bash: Sequence[str] = ("bash",),
    root: Path = Path("/"),
    reasons: Container[str] = REASONS,
) -> None:
    """Run a page's blocks in a folder, in one shell, but for those with a word of ``reasons``. Raises PageError.

    ``bash`` starts the shell, perhaps with another ``root`` for its files.
    """
    shell = _Shell(folder, variables, bash, root)
    try:
        for block in blocks(page.read_text(encoding="utf-8")):
            where = f"{page.name}, line {block.line}"
            if block.word in reasons:
                continue
            if (name := block.options.get("caption")) is not None:
                file = shell.folder() / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(block.text, encoding="utf-8")
            elif block.language in ("console", "sh"):
                for command in commands(block):
                    _check(where, command, *shell.run(*command))
            elif block.language == "python":
                (shell.folder() / "block.py").write_text(block.text, encoding="utf-8")
                _check(where, Command("python block.py", ""), *shell.run("python block.py"))
    finally:
        shell.close()


def _check(where: str, command: Command, output: str, code: int) -> None:
    if code != 0:
        raise PageError(f"{where}: {command.words!r} ended with {code}:\n{output}")
    if not shows(command.shown, output):
        raise PageError(f"{where}: {command.words!r} printed\n{output}\nwhere the page shows\n{command.shown}")


def shows(shown: str, output: str) -> bool:
    """Return whether the shown lines are among the output, in this order; ``…`` stands for anything."""
    lines = iter(output.splitlines())
    for line in shown.splitlines():
        pattern = re.compile(".*".join(map(re.escape, line.rstrip().split("…"))))
        if line.strip() not in ("", "…") and not any(pattern.fullmatch(one.rstrip()) for one in lines):
            return False
    return True


class _Shell:
    """A bash that keeps its folder and its variables from one command to the next."""

    def __init__(self, folder: Path, variables: Mapping[str, str] | None, bash: Sequence[str], root: Path) -> None:
        self._root = root
        self._bash = subprocess.Popen(
            bash, cwd=folder, env=variables, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )  # fmt: skip

    def run(self, words: str, shown: str = "") -> tuple[str, int]:
        """Return a command's output and exit code; of one that goes on, its output so far."""
        assert self._bash.stdin is not None
        assert self._bash.stdout is not None
        printed: list[str] = []
        if words.endswith("&"):
            self._bash.stdin.write(f"{words}\n")
            self._bash.stdin.flush()
            while not shows(shown, "".join(printed)) and (line := self._bash.stdout.readline()):
                printed.append(line)
            return "".join(printed), 0
        self._bash.stdin.write(f"{{ {words}\n}} < /dev/null\nprintf '\\n--- ended %d\\n' $?\n")
        self._bash.stdin.flush()
        for line in self._bash.stdout:
            if (ended := re.fullmatch(r"--- ended (\d+)\n", line)) is not None:
                return "".join(printed), int(ended[1])
            printed.append(line)
        return "".join(printed), self._bash.wait() or 1

    def folder(self) -> Path:
        """Return the folder in which the next command will run."""
        return self._root / self.run("pwd")[0].strip().lstrip("/")

    def close(self) -> None:
        """End it, and what goes on in it."""
        self._bash.communicate("kill $(jobs -p) 2>/dev/null; wait\n")


def runs(page: Path, word: str = "") -> bool:
    """Whether a page has blocks to run that have this word."""
    return any(one.language in RUN and one.word == word for one in blocks(page.read_text(encoding="utf-8")))


def other_pages() -> list[Path]:
    """Return the pages with commands that are no tutorials: guides and reference."""
    listed = subprocess.run(("git", "ls-files", "*.md"), cwd=ROOT, capture_output=True, text=True, check=True)
    pages = [ROOT / name for name in listed.stdout.splitlines() if name != "docs/start.md"]
    return [page for page in pages if page.parent.name != "tutorials" and (runs(page) or runs(page, "minutes"))]


def reader(home: Path) -> dict[str, str]:
    """Return the environment of a reader who has the package installed."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    settings = {"PYTHONPATH": str(ROOT), "PATH": path, "HOME": str(home), "COLUMNS": "80", "NO_COLOR": "1"}
    return os.environ | GIT | settings


def run_among_examples(page: Path, home: Path, reasons: Container[str] = REASONS) -> None:
    """Run a page's blocks in a copy of docs/examples in an empty folder. Raises PageError."""
    folder = Path(shutil.copytree(ROOT / "docs" / "examples", home / "examples"))
    run_page(page, folder, reader(home), reasons=reasons)


def main() -> int:
    """Run the named pages, or all with blocks that take minutes, with these."""
    parser = argparse.ArgumentParser(prog="tools.page_blocks", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE", help="by default all with blocks of minutes")
    named = [page.resolve() for page in parser.parse_args().pages]
    code = 0
    for page in named or [one for one in other_pages() if runs(one, "minutes")]:
        begun_s = time.monotonic()
        with tempfile.TemporaryDirectory() as home:
            try:
                run_among_examples(page, Path(home), REASONS.keys() - {"minutes"})
            except PageError as error:
                print(error)
                code = 1
        print(f"{page.relative_to(ROOT)}: {time.monotonic() - begun_s:.0f} s", flush=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
