"""Lists for each rule of PROTOCOL.md the tests, faults and mutants that prove it: ``python -m tools.rules``.

A rule is a sentence or a row of a table that begins with an id in brackets. A test names rules with the marker
``proves``, a case of the fault catalogue in ``rules``, and a function of the firmware whose mutants are tried in
``mutated_rules.toml``. The list is printed, and ``make docs`` makes a page of it. With ``--check`` nothing is printed:
it fails when a rule has no test, or anything names a rule that does not exist.
"""

import ast
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from hil.addons.batch.catalogue.fault_cases import CASES
from tools.mutants_of_c import RULED, functions

ROOT = Path(__file__).parents[1]
PROTOCOL = ROOT / "firmware_protocol" / "PROTOCOL.md"
MUTATED = ROOT / "tools" / "mutated_rules.toml"

_NO_PROSE = re.compile(r"<!-- generated -->.*?<!-- /generated -->|^```.*?^```", re.DOTALL | re.MULTILINE)
_BLOCK = re.compile(r"\n\s*\n|\n(?=\s*(?:-|\d+\.|\|) )")
_SENTENCE = re.compile(r"(?<=[.:]) (?=\[R-)|(?<=\.) (?=[A-Z`*])|(?<=\.\*\*) ")
_RULE = re.compile(r"^(?:[-|]|\d+\.)? ?\[(R-[A-Z]+-\d+)\] ?(.*)$")
_MUST = re.compile(r"\bmust\b", re.IGNORECASE)

Proofs = dict[str, list[str]]


def sentences(text: str) -> Iterator[str]:
    """Yield each sentence, and each row of a table, of the page's prose."""
    for block in _BLOCK.split(_NO_PROSE.sub("", text)):
        flat = " ".join(block.split())
        yield from [flat] if flat.startswith("|") else _SENTENCE.split(flat)


def read_rules(text: str) -> tuple[dict[str, str], list[str]]:
    """Return the rules by id, and what is wrong with how the page states them."""
    rules: dict[str, str] = {}
    wrong = []
    for sentence in sentences(text):
        if not (found := _RULE.match(sentence)):
            if _MUST.search(sentence):
                wrong.append(f"PROTOCOL.md says must without an id: {sentence}")
            continue
        name, said = found.groups()
        if name in rules:
            wrong.append(f"PROTOCOL.md has {name} twice")
        if not sentence.startswith("|") and not _MUST.search(said):
            wrong.append(f"{name} does not say must: {said}")
        rules[name] = said.removesuffix(" |").replace(" | ", ": ").replace("**", "")
    return rules, wrong


def of_tests(folder: Path) -> Proofs:
    """Return the tests that name each rule, without running or importing them."""
    found: Proofs = {}
    for path in sorted(folder.rglob("test_*.py"), key=lambda path: path.name):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
                continue
            for mark in node.decorator_list:
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.proves":
                    for argument in mark.args:
                        found.setdefault(ast.literal_eval(argument), []).append(f"{path.stem}: {node.name[5:]}")
    return found


def of_faults() -> Proofs:
    """Return the cases of the fault catalogue that name each rule."""
    return _inverse((case.name, case.rules) for case in CASES)


def of_mutants() -> Proofs:
    """Return the functions whose mutants are tried, by the rules that they carry out."""
    tables = tomllib.loads(MUTATED.read_text(encoding="utf-8"))
    rows = [(f"{file}: {name}", rules) for file, table in tables.items() for name, rules in table.items()]
    return _inverse(rows)


def _inverse(rows: Iterable[tuple[str, Sequence[str]]]) -> Proofs:
    found: Proofs = {}
    for name, rules in rows:
        for rule in rules:
            found.setdefault(rule, []).append(name)
    return found


def unlisted_functions() -> list[str]:
    """Return what is wrong with the list of mutated functions."""
    tables = tomllib.loads(MUTATED.read_text(encoding="utf-8"))
    listed = {(file, name) for file, table in tables.items() for name in table}
    there = {(file, name) for file in RULED for name in functions(file)}
    return [f"{MUTATED.name} lacks {file}: {name}" for file, name in sorted(there - listed)] + [
        f"{MUTATED.name} has {file}: {name}, which is not mutated" for file, name in sorted(listed - there)
    ]


def page() -> str:
    """Return the list of rules and of what proves each as a page of docs/reference."""
    rules, _ = read_rules(PROTOCOL.read_text(encoding="utf-8"))
    return _page(rules, of_tests(ROOT / "tests"), of_faults(), of_mutants())


def _page(rules: Mapping[str, str], tests: Proofs, faults: Proofs, mutants: Proofs) -> str:
    rows = [
        "# Rules of the protocol",
        "",
        "Each rule is a sentence of [PROTOCOL.md](../../firmware_protocol/PROTOCOL.md). A test that proves it",
        "has its id (`@pytest.mark.proves`). A case of the fault catalogue has it in `rules`. A function, listed after",
        "its file, stands for all of its mutants, which `python -m tools.mutate` tries; `tools/mutated_rules.toml`",
        "lists the rules of each function.",
        "",
        f"{len(rules)} rules, {len({test for some in tests.values() for test in some})} tests.",
        "",
        "| rule | text | tests | faults | mutants |",
        "|---|---|---|---|---|",
    ]
    for rule, said in rules.items():
        cells = (_joined(tests.get(rule, [])), ", ".join(faults.get(rule, [])), _joined(mutants.get(rule, [])))
        rows.append(f"| {rule} | {said} | {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _joined(names: list[str]) -> str:
    """Join "file: name" with each file once."""
    files: dict[str, list[str]] = {}
    for file, name in (one.split(": ", 1) for one in names):
        files.setdefault(file, []).append(name)
    return "; ".join(f"{file}: {', '.join(some)}" for file, some in files.items())


def problems(rules: Mapping[str, str], tests: Proofs, faults: Proofs, mutants: Proofs) -> list[str]:
    """Return what is wrong with the markers."""
    wrong = [f"{rule} has no test: {said}" for rule, said in rules.items() if rule not in tests]
    return wrong + [
        f"{', '.join(proofs[rule])} names {rule}, which PROTOCOL.md does not have"
        for proofs in (tests, faults, mutants)
        for rule in sorted(set(proofs) - set(rules))
    ]


def main(arguments: list[str]) -> int:
    """Print the list, or with ``--check`` only the errors; return the exit code."""
    if arguments not in ([], ["--check"]):
        print("usage: python -m tools.rules [--check]", file=sys.stderr)
        return 2
    rules, wrong = read_rules(PROTOCOL.read_text(encoding="utf-8"))
    wrong += problems(rules, of_tests(ROOT / "tests"), of_faults(), of_mutants()) + unlisted_functions()
    if not arguments:
        print(page(), end="")
    print(*wrong, sep="\n", end="\n" * bool(wrong), file=sys.stderr)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
