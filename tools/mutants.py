"""Mutants of any language: a change of one place, a copy of the checkout to try it in, a sample, and a table of rooms.

``tools.mutate`` makes those of the C, ``tools.mutate_python`` those of the Python.
"""

import argparse
import json
import os
import queue
import random
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import count, islice, takewhile
from pathlib import Path
from typing import NamedTuple

from tools.covered_functions import NOTES
from tools.first_failure import PROCESSOR_S
from tools.test_server import NEW_PROCESS
from tools.without_addon import copy_without

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results" / "mutants.md"
EQUIVALENT = Path(__file__).parent / "equivalent_mutants.toml"
_LIMIT_S = 300  # for the tests of one mutant
_NEAR = 3
_REMOVED = "(removed)"
NEAR_S = 10.0
FIRST_FILES = 5


class NoMutantError(Exception):
    """The change does not compile, or makes the same machine code."""


def room_of(file: str) -> str:
    """Return the package of a file: ``wire``, ``addons/batch``, ``plant_fmu``."""
    top, *parts = file.split("/")[:-1]
    if top != "hil" or not parts:
        return top
    return "/".join(parts[: 2 if parts[0] == "addons" else 1])


class Mutant(NamedTuple):
    """One change: bytes ``start`` to ``end`` of a file become ``after``; ``rule`` is the kind of change."""

    file: str
    line: int
    rule: str
    start: int
    end: int
    before: str
    after: str

    @property
    def room(self) -> str:
        """The room of its file; of C the folder."""
        return self.file.rpartition("/")[0] if self.file.endswith(".c") else room_of(self.file)

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.rule}: {self.before}  ->  {self.after.strip() or _REMOVED}"


class Key(NamedTuple):
    """By what a mutant is listed as equivalent: its file, a line at its place, and the change."""

    file: str
    line: str
    before: str
    after: str


class Tests(NamedTuple):
    """Tests to run together: node ids in order, or None for those of the files; of a whole room the slow ones too."""

    files: list[str]
    names: list[str] | None
    takes_s: float
    slow: bool = False


def batches(names: Iterable[str], seconds: Mapping[str, float]) -> Iterator[Tests]:
    """Yield tests to run together: all of the first files that they name, then of the next; not for too long."""
    files: dict[str, list[str]] = {}
    for name in names:
        files.setdefault(name.partition("::")[0], []).append(name)
    for begin in range(0, len(files), FIRST_FILES):
        rest = [name for file in islice(files, begin, begin + FIRST_FILES) for name in files[file]]
        while rest:
            some: list[str] = []
            takes_s = 0.0
            while rest and takes_s < NEAR_S:
                some.append(rest.pop(0))
                takes_s += seconds[some[-1]]
            yield Tests(list(dict.fromkeys(test.partition("::")[0] for test in some)), some, takes_s)


class Copy:
    """A copy of the checkout in which one mutant at a time is tried."""

    def __init__(
        self, folder: Path, tests_of: Callable[[Mutant], Iterable[Tests]], environment: Mapping[str, str] | None = None
    ) -> None:
        self.folder = folder
        self._tests_of = tests_of
        copy_without((), folder)
        variables = os.environ | {"PYTHONPATH": str(folder), "HIL_EXAMPLES": "usual"} | dict(environment or {})
        variables["PYTHONDONTWRITEBYTECODE"] = ""
        command = [sys.executable, "-m", "tools.test_server"]
        self._server = subprocess.Popen(
            command, cwd=folder, env=variables, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._passes: dict[tuple[str, bool], bool] = {}
        self._times = count(1)

    def close(self) -> None:
        """End the process that runs the tests."""
        self._server.communicate()

    @contextmanager
    def changed(self, mutant: Mutant) -> Iterator[None]:
        """Hold a mutant in the copy."""
        path = self.folder / mutant.file
        text, times = path.read_bytes(), path.stat()
        # Python takes bytecode for that of a source of the same second and size.
        second = next(self._times)
        path.write_bytes(text[: mutant.start] + mutant.after.encode() + text[mutant.end :])
        os.utime(path, (second, second))
        try:
            yield
        finally:
            path.write_bytes(text)
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))

    def noticed_by(self, mutant: Mutant, *, near: bool, quick: bool = False) -> str | None:
        """Return the test that notices the mutant first, or None; of quick tests, or of those of chosen files.

        Raises NoMutantError.
        """
        every: Iterable[Tests] = self._tests_of(mutant)
        if near:
            every = takewhile(lambda tests: tests.files[0].endswith(".py"), islice(every, _NEAR))
        every = [tests for tests in every if not (quick and tests.slow)]
        if mutant.file.endswith(".py"):
            for tests in takewhile(lambda tests: tests.names is not None, every):
                self._ask(tests, collect=True)
                if failed := self._failure(mutant, tests, in_place=True):
                    if failed == NEW_PROCESS:
                        break
                    return failed
        for tests in every:
            if failed := self._failure(mutant, tests):
                return failed
        return None

    def _failure(self, mutant: Mutant, tests: Tests, *, in_place: bool = False) -> str | None:
        """Return which of these tests fails first, of those that pass without the mutant."""
        module = self.folder / mutant.file
        place = {"module": str(module), "was": module.read_text(encoding="utf-8")} if in_place else {}
        while True:
            without = [test for (test, where), passes in self._passes.items() if where == in_place and not passes]
            with self.changed(mutant):
                failed = self._ask(tests, without=without, **place)
            if failed is None or "::" not in failed:
                return failed
            if (failed, in_place) not in self._passes:
                alone = Tests([failed.partition("::")[0]], [failed], NEAR_S, slow=True)
                self._passes[failed, in_place] = self._ask(alone, **place) is None
            if self._passes[failed, in_place]:
                return failed

    def _ask(self, tests: Tests, **more: object) -> str | None:
        """Run tests, and return the one that fails first. An endless loop fails by the processor's time."""
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        request = {
            "files": tests.files,
            "tests": tests.names,
            "without": [],
            "slow": tests.slow,
            "limit_s": _LIMIT_S + 10 * tests.takes_s,
            PROCESSOR_S: str(round(min(_LIMIT_S, 30 + 5 * tests.takes_s))),
            **more,
        }
        print(json.dumps(request), file=self._server.stdin, flush=True)
        answer = json.loads(self._server.stdout.readline())
        return None if answer is None else str(answer)


def options(name: str, words: str | None) -> argparse.ArgumentParser:
    """Return the options that choose and try mutants."""
    parser = argparse.ArgumentParser(prog=name, description=(words or "").partition("\n")[0])
    parser.add_argument("--sample", type=int, metavar="N", help="take N mutants at random")
    parser.add_argument("--seed", type=int, help="default: the number of commits")
    parser.add_argument("--room", action="append", metavar="NAME", help="only of this room, as the table names it")
    parser.add_argument("--at", action="append", metavar="FILE:LINE", help="only of this line; may be repeated")
    parser.add_argument("--since", metavar="COMMIT", help="only of the lines changed since this commit")
    parser.add_argument("--within", type=float, metavar="S", help="take no further mutant after this time")
    parser.add_argument("--near", action="store_true", help="run only the tests that are nearest to a mutant")
    parser.add_argument("--quick", action="store_true", help="run no slow tests")
    covered_help = "notes of tools.covered_functions on which tests call which function, and how long each takes"
    parser.add_argument("--covered", type=Path, metavar="FOLDER", default=NOTES, help=covered_help)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="default: one a processor")
    parser.add_argument("--page", action="store_true", help="write the table into docs/results/mutants.md")
    parser.set_defaults(name=name)
    return parser


def chosen(every: Iterable[Mutant], arguments: argparse.Namespace) -> list[Mutant]:
    """Return the mutants that the options ask for."""
    if arguments.seed is None:
        arguments.seed = int(_git("rev-list", "--count", "HEAD") or 0)
    lines = (changed_lines(arguments.since) or None) if arguments.since else None
    some = [
        mutant
        for mutant in every
        if (arguments.room is None or mutant.room in arguments.room)
        and (arguments.at is None or f"{mutant.file}:{mutant.line}" in arguments.at)
        and (lines is None or mutant.line in lines.get(mutant.file, ()))
    ]
    return some if arguments.sample is None else sample(some, arguments.sample, random.Random(arguments.seed))


def equivalent(table: str, place: str, every: Mapping[Mutant, Key]) -> tuple[set[Mutant], list[str]]:
    """Return the mutants that ``table`` of ``equivalent_mutants.toml`` lists, and the rows that match no mutant now.

    ``every``: all mutants of today. ``place``: the key of a row with the text of a line (``Key.line``); a row without
    that key matches its change in all lines of its file.
    """
    rows = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get(table, [])
    by_key: dict[Key, set[Mutant]] = defaultdict(set)
    for mutant, key in every.items():
        for line in (key.line, ""):
            by_key[key._replace(line=line, after=key.after.strip() or _REMOVED)].add(mutant)
    wanted = [Key(row["file"], row.get(place, ""), row["before"], row["after"]) for row in rows]
    stale = [f"{key.file}: {key.before}  ->  {key.after}" for key in wanted if key not in by_key]
    return set().union(*(by_key.get(key, ()) for key in wanted)), stale


def print_stale(rows: Iterable[str]) -> None:
    """Print the rows of the list that are to be removed."""
    for row in rows:
        print(f"listed as equivalent, but no mutant any more: {row}")


def changed_lines(commit: str) -> dict[str, set[int]]:
    """Return the lines of each Python and C file that are not as they were in a commit."""
    lines: dict[str, set[int]] = {}
    file = ""
    words = ("diff", "--unified=0", "--no-renames", commit, "--", "hil", "firmware_protocol", "plant_fmu")
    for line in _git(*words).splitlines():
        if line.startswith("+++ "):
            file = line[6:]
        elif found := re.match(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@", line):
            begin, count = int(found[1]), int(found[2] or 1)
            if file.endswith((".py", ".c")):
                lines.setdefault(file, set()).update(range(begin, begin + count))
    return lines


def sample(every: Sequence[Mutant], number: int, chance: random.Random) -> list[Mutant]:
    """Return mutants at random, as many from each room as it has and the number allows, in random order."""
    rooms: dict[str, list[Mutant]] = {}
    for mutant in every:
        rooms.setdefault(mutant.room, []).append(mutant)
    for some in rooms.values():
        chance.shuffle(some)
    taken: list[Mutant] = []
    while rooms and len(taken) < number:
        for room in chance.sample(sorted(rooms), len(rooms)):
            taken.append(rooms[room].pop())
            if not rooms[room]:
                del rooms[room]
    return taken[:number]


def try_all(some: Sequence[Mutant], copy: Callable[[Path], Copy], arguments: argparse.Namespace) -> int:
    """Try mutants in copies, print those that survive and a table of the rooms, and return how many survive."""
    until_s = time.monotonic() + (arguments.within or float("inf"))
    tried: Counter[str] = Counter()
    noticed: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(arguments.jobs) as pool:
        every_copy = [copy(Path(name) / str(number)) for number in range(arguments.jobs)]
        copies: queue.Queue[Copy] = queue.Queue()
        for one in every_copy:
            copies.put(one)

        def survives(mutant: Mutant) -> bool | None:
            if time.monotonic() > until_s:
                return None
            one = copies.get()
            try:
                return one.noticed_by(mutant, near=arguments.near, quick=arguments.quick) is None
            except NoMutantError:
                return None
            finally:
                copies.put(one)

        for mutant, outcome in zip(some, pool.map(survives, some), strict=True):
            if outcome is None:
                continue
            tried[mutant.room] += 1
            noticed[mutant.room] += not outcome
            if outcome:
                print(f"survives: {mutant}", flush=True)
        for one in every_copy:
            one.close()
    found = table(tried, noticed, arguments.seed)
    print(f"\n{found}")
    if arguments.page:
        begin, end = f"<!-- by python -m {arguments.name} -->\n", f"<!-- end of {arguments.name} -->\n"
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(begin)
        PAGE.write_text(f"{before}{begin}\n{found}\n\n{end}{rest.partition(end)[2]}", encoding="utf-8")
    return tried.total() - noticed.total()


def table(tried: Counter[str], noticed: Counter[str], seed: int) -> str:
    """Return the rooms with the numbers of mutants that were tried and noticed, as Markdown."""
    rows = [("all", tried.total(), noticed.total()), *((room, tried[room], noticed[room]) for room in sorted(tried))]
    lines = [f"| {room} | {here} | {seen} | {100 * seen / max(here, 1):.0f} % |" for room, here, seen in rows]
    return "\n".join(["| room | mutants | noticed | of them |", "|---|---|---|---|", *lines, "", f"Seed {seed}."])


def _git(*words: str) -> str:
    """Return what git prints; nothing where it fails, as for a commit that a checkout has not."""
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else ""
