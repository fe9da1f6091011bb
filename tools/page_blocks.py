"""Runs the blocks of a documentation page, one after another in one folder, as a reader would type them.

``python -m tools.page_blocks docs/start.md`` runs a page where one stands. Three kinds of blocks are run:

- ``console``: a line that begins with ``$`` is a command for bash; the lines below it must be among its output, in this
  order. ``…`` stands for anything, within a line or as one.
- a block with ``:caption: NAME`` is the file NAME, and is written.
- ``python`` without a caption is run as a program.

A block with ``:class: needs-board`` is not run, and is counted. Other languages, and TOML without a caption, are for
the eye.
"""

import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt

NOT_RUN = "needs-board"
_DIRECTIVE = re.compile(r"\{code-block\} (\w+)")


class Block(NamedTuple):
    """A fenced block: its language, its options as ``:name: value`` lines give them, its text, and its first line."""

    language: str
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
    """Yield the fenced blocks of a page in Markdown."""
    for token in MarkdownIt().parse(page):
        if token.type != "fence" or token.map is None:
            continue
        directive = _DIRECTIVE.fullmatch(token.info.strip())
        lines = token.content.splitlines(keepends=True)
        options = {}
        while directive and lines and (given := re.fullmatch(r":(\S+): (.*)\n", lines[0])):
            options[given[1]] = given[2]
            lines.pop(0)
        language = directive[1] if directive else token.info.strip()
        yield Block(language, options, "".join(lines), token.map[0] + 1)


def commands(block: Block) -> Iterator[Command]:
    """Yield the commands of a console block."""
    for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
        words, _, shown = part.partition("\n")
        yield Command(words, shown)


def run_page(
    page: Path,
    folder: Path,
    variables: Mapping[str, str] | None = None,
    bash: Sequence[str] = ("bash",),
    root: Path = Path("/"),
) -> int:
    """Run a page's blocks in a folder, in one shell; return how many were not run. Raises PageError.

    ``bash`` starts the shell, perhaps with another ``root`` for its files.
    """
    left_out = 0
    shell = _Shell(folder, variables, bash, root)
    try:
        for block in blocks(page.read_text(encoding="utf-8")):
            where = f"{page.name}, line {block.line}"
            if block.options.get("class") == NOT_RUN:
                left_out += 1
            elif (name := block.options.get("caption")) is not None:
                (shell.folder() / name).write_text(block.text, encoding="utf-8")
            elif block.language == "console":
                for command in commands(block):
                    _check(where, command, *shell.run(command.words))
            elif block.language == "python":
                (shell.folder() / "block.py").write_text(block.text, encoding="utf-8")
                _check(where, Command("python block.py", ""), *shell.run("python block.py"))
    finally:
        shell.close()
    return left_out


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

    def run(self, words: str) -> tuple[str, int]:
        """Return what a command printed, and its exit code."""
        assert self._bash.stdin is not None
        assert self._bash.stdout is not None
        self._bash.stdin.write(f"{words}\nprintf '\\n--- ended %d\\n' $?\n")
        self._bash.stdin.flush()
        printed: list[str] = []
        for line in self._bash.stdout:
            if (ended := re.fullmatch(r"--- ended (\d+)\n", line)) is not None:
                return "".join(printed), int(ended[1])
            printed.append(line)
        return "".join(printed), self._bash.wait() or 1

    def folder(self) -> Path:
        """Return the folder in which the next command will run."""
        return self._root / self.run("pwd")[0].strip().lstrip("/")

    def close(self) -> None:
        """End it."""
        self._bash.communicate()


def main() -> None:
    """Run a page in the present folder."""
    [page] = sys.argv[1:]
    try:
        left_out = run_page(Path(page).resolve(), Path.cwd())
    except PageError as error:
        raise SystemExit(str(error)) from None
    print(f"{page}: all blocks ran, but for {left_out} that need a board")


if __name__ == "__main__":
    main()
