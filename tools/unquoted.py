"""Lists what the product says of failures and no test quotes: ``python -m tools.unquoted --room wire``.

A sentence of failure is any text in the call of an error's class, and elsewhere one that has a word such as "not". It
is quoted when three words that follow one another in it, and in no other sentence, do so too in a text of the tests or
in a block of a page that they run. So provoke it, and compare what only this sentence says, with its names and figures.
With ``--check`` it fails when a room has not just as many as ``unquoted.toml`` says: then lower the number there. That
file also has, by module, how those sentences begin that tell no failure: a signal's meaning, an option's help.
"""

import argparse
import ast
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from tools.mutants import room_of
from tools.page_blocks import RUN, blocks

ROOT = Path(__file__).parents[1]
ALLOWED = ROOT / "tools" / "unquoted.toml"
_PACKAGES = ("hil", "firmware_protocol", "plant_fmu")
_ERROR = re.compile(r"\w*Error|Refused")
_FAILURE = re.compile(
    r"\b(not|no(?! value)|never|cannot|none|nothing|neither|expected|failed|lost|refuse[sd]|damaged|without|too"
    r"|lacks|wrong|differs|ended|unknown|missing|hardly)\b"
)
_CODE = re.compile(r"[<{}#]|/\*")
_WORD = re.compile(r"[^\W_]+(?:['_.][^\W_]+)*")


class Sentence(NamedTuple):
    """A text of the product, without what is filled in."""

    file: str
    line: int
    parts: tuple[str, ...]

    @property
    def runs(self) -> set[str]:
        """Each three words of it that follow one another."""
        return {run for part in self.parts for run in runs(part)}

    @property
    def says(self) -> str:
        """The text, with … for what is filled in."""
        return "…".join(self.parts)

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.says}"


def runs(text: str) -> set[str]:
    """Return each three words of a text, or of a pattern, that follow one another."""
    words = _WORD.findall(text.replace("\\", ""))
    return {" ".join(three) for three in zip(words, words[1:], words[2:], strict=False)}


def texts(node: ast.AST) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield the line of each text below a node, and its parts between what is filled in."""
    if isinstance(node, ast.JoinedStr):
        yield node.lineno, tuple(str(part.value) for part in node.values if isinstance(part, ast.Constant))
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.lineno, (node.value,)
    if not isinstance(node, ast.Expr) or not isinstance(node.value, ast.Constant):  # a docstring is not said
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.keyword) and child.arg == "help":
                continue
            if not isinstance(node, ast.JoinedStr) or not isinstance(child, ast.Constant):
                yield from texts(child)


def sentences(file: str, text: str) -> list[Sentence]:
    """Return the sentences of failure of a module: in errors, functions and tables. What declares help says none."""
    found: set[Sentence] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if _ERROR.fullmatch(name):
                found.update(Sentence(file, *one) for one in texts(node))
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            found.update(Sentence(file, *one) for part in node.body for one in texts(part) if _tells_failure(*one[1]))
        elif isinstance(node, (ast.Assign, ast.Dict)):
            values = node.values if isinstance(node, ast.Dict) else [node.value]
            some = [one for one in values if isinstance(one, (ast.Constant, ast.JoinedStr))]
            found.update(Sentence(file, *one) for part in some for one in texts(part) if _tells_failure(*one[1]))
    return sorted(one for one in found if one.runs)


def _tells_failure(*parts: str) -> bool:
    return any(map(_FAILURE.search, parts)) and not any(map(_CODE.search, parts))


def quoted() -> set[str]:
    """Return each three words that follow one another in the tests, and in the blocks of pages that they run."""
    found: set[str] = set()
    for path in (ROOT / "tests").rglob("*.*"):
        if path.suffix == ".py":
            for _, parts in texts(ast.parse(path.read_text(encoding="utf-8"))):
                found.update(*map(runs, parts))
        elif path.suffix in (".toml", ".xml", ".txt"):
            found |= runs(path.read_text(encoding="utf-8"))
    for path in (*ROOT.glob("*.md"), *(one for top in ("docs", *_PACKAGES) for one in (ROOT / top).rglob("*.md"))):
        found.update(*(runs(block.text) for block in blocks(path.read_text(encoding="utf-8")) if block.language in RUN))
    return found


def unquoted() -> list[Sentence]:
    """Return the sentences of failure that no test quotes."""
    files = [path for package in _PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    every = [
        one for path in files for one in sentences(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))
    ]
    number, said = Counter(run for one in every for run in one.runs), quoted()
    found = [one for one in every if not said & ({run for run in one.runs if number[run] == 1} or one.runs)]
    meanings = _rows()["no_failure"]
    for file, begins in meanings.items():
        for begin in begins:
            if not any(one.file == file and one.says.startswith(begin) for one in found):
                raise SystemExit(
                    f"{ALLOWED.name}: no_failure: {file} has no unquoted sentence that begins with {begin!r}"
                )
    return [one for one in found if not one.says.startswith(tuple(meanings.get(one.file, ())))]


def _rows() -> dict[str, Any]:
    return tomllib.loads(ALLOWED.read_text(encoding="utf-8"))


def main() -> int:
    """Print the sentences, or with ``--check`` only the rooms that have not just as many as is allowed."""
    parser = argparse.ArgumentParser(prog="tools.unquoted", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--room", action="append", metavar="NAME", help="only of this room, as in wire or addons/batch")
    parser.add_argument("--check", action="store_true", help="compare how many each room has with unquoted.toml")
    options = parser.parse_args()
    found = [one for one in unquoted() if options.room is None or room_of(one.file) in options.room]
    if not options.check:
        print(*found, sep="\n")
        return 0
    allowed = Counter(_rows()["unquoted"])
    counted = Counter(room_of(one.file) for one in found)
    wrong = [room for room in sorted({*allowed, *counted}) if allowed[room] != counted[room]]
    for room in wrong:
        print(f"{ALLOWED.name}: {room} = {allowed[room]}; python -m {parser.prog} --room {room} lists {counted[room]}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
