"""Mutation testing of the firmware's checks and of the host's half: does a test notice when one is a little wrong?

``python -m tools.mutate`` changes one place of a file of ``FILES`` at a time, builds the host library with it, and runs
the tests of that file until one fails. What survives is tried once more with AddressSanitizer, where the compiler has
it: a read beyond an array may read what is right by chance. It prints the survivors and the score. It fails when a
survivor is not in ``equivalent_mutants.toml``, which says why a change is none; a sample, as ``--sample 20`` takes at
random, is printed for somebody to look at, and fails for none.
"""

import argparse
import os
import random
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from firmware_protocol.built import FIRMWARE_FLAGS, HERE, SOURCES
from tools.build.compiler import compiler
from tools.first_failure import PROCESSOR_S

ROOT = Path(__file__).parent.parent
# The fastest and the ones that find most first.
_OF_THE_NODE = (
    "tests/test_node_sessions.py",
    "tests/test_node_states.py",
    "tests/test_node_thresholds.py",
    "tests/test_node_faults.py",
    "tests/test_node.py",
    "tests/test_node_feedback.py",
    "tests/test_node_replay.py",
    "tests/test_parameters.py",
    "tests/test_stored_parameters.py",
)
_OF_PARAMETERS = ("tests/test_parameters.py", "tests/test_stored_parameters.py")
_OF_THE_CLIENT = ("tests/test_client_frames.py", "tests/test_client.py")
_OF_CONTROL = ("tests/test_wheel_loops.py", "tests/test_node_thresholds.py", *_OF_THE_NODE)
FILES = {
    **dict.fromkeys(("states.c", "receive.c", "supervise.c", "node.c"), _OF_THE_NODE),
    **dict.fromkeys(("arming.c", "session.c"), (*_OF_THE_CLIENT, "tests/test_snapshot.py")),
    "incoming.c": ("tests/test_snapshot.py", *_OF_THE_CLIENT, "tests/test_snapshot_twin.py"),
    "service.c": (*_OF_PARAMETERS, "tests/test_node_feedback.py", "tests/test_protocol_rules.py"),
    "control.c": tuple(dict.fromkeys(_OF_CONTROL)),
    "feedback.c": ("tests/test_node_feedback.py", "tests/test_node_means.py", *_OF_THE_NODE[:5], "tests/test_node.py"),
    "parameters.c": (*_OF_PARAMETERS, "tests/test_node.py"),
    **dict.fromkeys(("line.c", "framing.c", "cobs.c", "crc.c"), ("tests/test_line_of_the_library.py",)),
}
"""The tests of each file whose mutants are tried."""
_SOURCES = {source.name: source for source in SOURCES}
EQUIVALENT = Path(__file__).parent / "equivalent_mutants.toml"
# An index beyond an array ends the tests as well.
_TRAP = ["-fsanitize=undefined,float-cast-overflow", "-fsanitize-undefined-trap-on-error"]
_PLAIN_FLAGS = [flag for flag in FIRMWARE_FLAGS if not flag.startswith("-W")]
# A warning is noticed by whoever builds; of a function that forgets its value no more than that can be told.
_FLAGS = [*_PLAIN_FLAGS, "-w", "-Wreturn-type", "-Werror=return-type", *_TRAP]
_ADDRESS_FLAGS = [*_PLAIN_FLAGS, "-w", "-fsanitize=address", "-fno-omit-frame-pointer"]

_SWAPS = {
    "<": "<=",
    "<=": "<",
    ">": ">=",
    ">=": ">",
    "==": "!=",
    "!=": "==",
    "&&": "||",
    "||": "&&",
    "+": "-",
    "-": "+",
    "+=": "-=",
    "++": "--",
    "true": "false",
    "false": "true",
}
_OPERATOR = re.compile(r"(?<= )(?:<=|>=|==|!=|&&|\|\||\+=|<|>|\+|-)(?= )|\+\+|\b(?:true|false)\b")
_WHOLE = re.compile(r"(?<![\w.])(\d+)(u?)(?![\w.])")
_DECLARED = re.compile(r"\b(?!return\b|sizeof\b)\w+ \w+\[$")
_REAL = re.compile(r"(?<![\w.])\d+\.\d+f")
_CONDITION = re.compile(r"\bif \((.*)\) \{$")
_STATEMENT = re.compile(
    r"^\s+(?!\s|\(void\)\w+;|return\b.*\S;|const |static |wp_|float |bool |uint\w+ |wheel_\w+ \w+;)[^{}]*;\s*(/\*.*)?$"
)
_ROW = re.compile(r"^\s+\{WP_STATE_\w+, WHEEL_EVENT_\w+, (WP_STATE_\w+)\},$")
_FUNCTION = re.compile(r"^(?:static )?\w+ \**(\w+)\([^;]*?\) \{$|^const \w+ (\w+)\[\w+\] = \{$", re.MULTILINE)
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


class Mutant(NamedTuple):
    """One change: the line is that of the unchanged source, and follows the one in ``follows``."""

    file: str
    number: int
    before: str
    after: str
    follows: str

    @property
    def key(self) -> "Key":
        return self.file, self.follows.strip(), self.before.strip(), self.after.strip()

    def __str__(self) -> str:
        return f"{self.file}:{self.number}: {self.before.strip()}  ->  {self.after.strip() or '(removed)'}"


Key = tuple[str, str, str, str]
"""File, line before, line and change of a mutant."""


def changes(line: str) -> Iterator[str]:
    """Yield every line that this one is changed to."""
    for found in _OPERATOR.finditer(line):
        yield line[: found.start()] + _SWAPS[found[0]] + line[found.end() :]
    for found in _WHOLE.finditer(line):
        before, behind = line[: found.start()], line[found.end() :]
        others = {int(found[1]) + 1, max(int(found[1]) - 1, 0)} - {int(found[1])}
        if _DECLARED.search(before) or behind.startswith("]){"):
            # An array may be larger; of a parameter the size means nothing in C.
            others = set() if behind[1:2] in (",", ")") and not behind.startswith("]){") else {min(others)}
        yield from (f"{before}{whole}{found[2]}{behind}" for whole in sorted(others))
    for found in _REAL.finditer(line):
        for factor in (0.75, 1.25):
            real = float(found[0][:-1])
            yield line[: found.start()] + f"{real * factor if real else factor - 1}f" + line[found.end() :]
    if found_condition := _CONDITION.search(line):
        start, end = found_condition.span(1)
        yield f"{line[:start]}!({line[start:end]}){line[end:]}"
    if row := _ROW.match(line):
        yield line[: row.start(1)] + "WP_STATE_ACTIVE" + line[row.end(1) :]
        yield "    {WP_STATE_BOOT, WHEEL_EVENT_READY, WP_STATE_IDLE},"
    elif _STATEMENT.match(line):
        yield ";"


def mutants(file: str) -> list[Mutant]:
    """Return every mutant of a file; what runs no code has none: comments, includes, static assertions."""
    text = _SOURCES[file].read_text(encoding="utf-8")
    code = _COMMENT.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)
    lines = zip(["", *text.splitlines()], text.splitlines(), code.splitlines(), strict=False)
    return [
        Mutant(file, number, line, after, follows)
        for number, (follows, line, bare) in enumerate(lines, start=1)
        if bare.strip() and not bare.startswith(("#include", "_Static_assert"))
        for after in changes(bare.rstrip())
        if after.strip() != bare.strip()
    ]


def functions(file: str) -> list[str]:
    """Return the names of a file's functions and tables."""
    found = _FUNCTION.finditer(_SOURCES[file].read_text(encoding="utf-8"))
    return [one[1] or one[2] for one in found]


class Bench:
    """The objects of the unchanged sources, and a place to build and test mutants in."""

    def __init__(self, folder: Path, tests: tuple[str, ...], flags: list[str], preload: Path | None = None) -> None:
        """Raise ValueError when the tests fail without any change, or the compiler has not what the flags ask for.

        ``preload``: a library that has to be in the process before the mutant.
        """
        self._folder = folder
        self._tests = tests
        self._flags = flags
        self._preload = preload
        self._processor_s = 600
        folder.mkdir()
        self._objects = {name: self._compile(source, folder / f"{source.stem}.o") for name, source in _SOURCES.items()}
        before_s = os.times().children_user
        if not self.passes(folder, {}):
            raise ValueError(f"{' '.join(tests)} fail without any change")
        # An endless loop is noticed too: by the processor's time, as on a busy machine any run takes long.
        self._processor_s = round(5.0 * (os.times().children_user - before_s)) + 10

    def _compile(self, source: Path, target: Path) -> Path:
        include = f"-I{_SOURCES[source.name].parent}"
        command = [*compiler(), *self._flags, include, "-fPIC", "-c", str(source), "-o", str(target)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise ValueError(done.stderr)
        return target

    def survives(self, mutant: Mutant, place: int) -> bool | None:
        """Tell whether no test notices the mutant; None when it does not compile."""
        text = _SOURCES[mutant.file].read_text(encoding="utf-8").splitlines()
        text[mutant.number - 1] = mutant.after
        folder = self._folder / str(place)
        folder.mkdir()
        source = folder / mutant.file
        # The sources include "../generated/...", beside their own folder.
        body = re.sub(r'"\.\./(\w+)/', rf'"{HERE}/\1/', "\n".join(text))
        source.write_text(body + "\n", encoding="utf-8")
        try:
            objects = {mutant.file: self._compile(source, folder / "mutant.o")}
        except ValueError:
            return None
        return self.passes(folder, objects)

    def passes(self, folder: Path, changed: dict[str, Path]) -> bool:
        """Tell whether every test passes with these objects instead of the unchanged ones."""
        library = folder / "libmutant.so"
        objects = (self._objects | changed).values()
        sanitizer = [flag for flag in self._flags if flag.startswith("-fsanitize=address")]
        subprocess.run([*compiler(), *sanitizer, "-shared", "-o", str(library), *map(str, objects)], check=True)
        environment = os.environ | {"WHEEL_HOST_LIBRARY": str(library), "HIL_CI": "1", "HIL_EXAMPLES": "usual"}
        environment["PYTHONDONTWRITEBYTECODE"] = ""  # or each run compiles the tests again
        environment[PROCESSOR_S] = str(self._processor_s)
        if self._preload is not None:
            environment |= {"LD_PRELOAD": str(self._preload), "ASAN_OPTIONS": "detect_leaks=0"}
        command = [sys.executable, "-m", "pytest", "-x", "--tb=no", "-p", "no:cacheprovider"]
        command += ["-p", "tools.first_failure", *self._tests]
        done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, check=False)
        return done.returncode == 0


def second_bench(folder: Path, tests: tuple[str, ...]) -> Bench | None:
    """Return a bench with AddressSanitizer; None where the compiler has none that can be loaded first."""
    asked = [*compiler(), "-print-file-name=libasan.so"]
    found = Path(subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip())
    return Bench(folder, tests, _ADDRESS_FLAGS, found) if found.is_absolute() else None


def equivalent() -> tuple[dict[Key, str], list[str]]:
    """Return the listed mutants that change nothing, with the reason; and the rows that are no mutant any more.

    A row without ``follows`` means every line that is as its ``before``.
    """
    every = [mutant.key for file in FILES for mutant in mutants(file)]
    found: dict[Key, str] = {}
    stale = []
    for row in tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["mutant"]:
        same = [
            key
            for key in every
            if (key[0], *key[2:]) == (row["file"], row["before"], row["after"]) and key[1] == row.get("follows", key[1])
        ]
        found |= dict.fromkeys(same, row["because"])
        stale += [] if same else [f"{row['file']}: {row['before']}  ->  {row['after']}"]
    return found, stale


def try_all(chosen: list[Mutant], folder: Path, jobs: int) -> list[bool | None]:
    """Return for each mutant whether it survives, and print it then; None when it does not compile."""
    outcomes: list[bool | None] = []
    with ThreadPoolExecutor(jobs) as pool:
        for number, tests in enumerate(dict.fromkeys(FILES[mutant.file] for mutant in chosen)):
            some = [mutant for mutant in chosen if FILES[mutant.file] == tests]
            bench = Bench(folder / str(number), tests, _FLAGS)
            second: Bench | None = None
            for place, (mutant, first) in enumerate(
                zip(some, pool.map(bench.survives, some, range(len(some))), strict=True)
            ):
                outcome = first
                if outcome:
                    second = second or second_bench(folder / f"{number} with addresses", tests)
                    outcome = second is None or bool(second.survives(mutant, place))
                if outcome:
                    print(f"survives: {mutant}", flush=True)
                outcomes.append(outcome)
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--sample", type=int, metavar="N", help="take N mutants at random instead of all")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--file", choices=FILES, action="append", help="default: all of them")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="default: one a processor")
    arguments = parser.parse_args()
    known, stale = equivalent()
    chosen = [mutant for file in arguments.file or FILES for mutant in mutants(file) if mutant.key not in known]
    if arguments.sample is not None:
        chosen = random.Random(arguments.seed).sample(chosen, min(arguments.sample, len(chosen)))
    with tempfile.TemporaryDirectory() as name:
        try:
            outcomes = try_all(chosen, Path(name), arguments.jobs)
        except ValueError as error:
            print(f"tools.mutate: {error}", file=sys.stderr)
            return 2
    survivors = outcomes.count(True)
    tested = len(outcomes) - outcomes.count(None)
    for row in stale:
        print(f"listed as equivalent, but no mutant any more: {row}")
    print(
        f"{tested - survivors} of {tested} mutants noticed ({100 * (tested - survivors) / max(tested, 1):.1f} %), "
        f"{outcomes.count(None)} did not compile, {len(known)} are listed as equivalent"
    )
    return int(bool(stale or (survivors and arguments.sample is None)))


if __name__ == "__main__":
    sys.exit(main())
