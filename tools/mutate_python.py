"""Mutation testing of the Python: does a test notice when one place is a little wrong?

``python -m tools.mutate_python --sample 100`` takes 100 mutants at random, shared equally by the packages of ``hil``,
``firmware_protocol`` and ``plant_fmu`` (the rooms). Each is written into a copy of the checkout. There tests run until
one fails. First come the quick tests that call the function, by the notes of ``tools.covered_functions``; without notes
those of files that name the module. Then come the quick tests of its room, then the slow ones. It prints the survivors
and a table of the rooms.
Another ``--seed`` takes other mutants, so tests cannot be tuned to a sample.

``--since COMMIT`` takes mutants of the lines changed since then, if there are any; ``--within S`` starts none after S
seconds; ``--at FILE:LINE`` takes those of a line. A survivor that changes nothing that anyone could notice is listed in
``equivalent_mutants.toml``, with the reason: for its file, or with ``line`` for places whose line has that text.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

from tools.covered_functions import CoveredFunctions
from tools.mutants import (
    FIRST_FILES,
    NEAR_S,
    ROOT,
    Copy,
    Key,
    Mutant,
    Tests,
    batches,
    chosen,
    equivalent,
    options,
    print_stale,
    try_all,
)

_PACKAGES = ("hil", "firmware_protocol", "plant_fmu")
_ROOM_S = 300.0

_COMPARED: dict[type[ast.cmpop], str] = {
    ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">", ast.Eq: "!=", ast.NotEq: "==",
    ast.Is: "is not", ast.IsNot: "is", ast.In: "not in", ast.NotIn: "in",
}  # fmt: skip
_CALCULATED: dict[type[ast.operator], str] = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.FloorDiv: "*", ast.LShift: ">>", ast.RShift: "<<",
    ast.BitAnd: "|", ast.BitOr: "&",
}  # fmt: skip
_OPERATOR = re.compile(r"not\s+in|is\s+not|//=?|<<=?|>>=?|[<>=!]=|[-+*/&|]=?|[<>]|\bin\b|\bis\b|\band\b|\bor\b")
_AXES = {"x": "y", "y": "x", "vx": "vy", "vy": "vx", "fl": "fr", "fr": "fl", "rl": "rr", "rr": "rl"}
# Only NaN tells the order of arguments of these apart; the last are those of hil/addons/fmu_check/slave.py.
_SYMMETRIC = {"min", "max", "math.hypot", "np.hypot", "math.isclose", "same", "close", "same_time"}
_UNITS = {"radians", "degrees", "deg2rad", "rad2deg"}
_RETURNED = {"bool": ("True", "False"), "float": ("0.0",), "int": ("0",), "str": ('""',), "None": ("",)}


class _Source:
    """A file's text by the places of its syntax tree, whose columns are bytes."""

    def __init__(self, file: str, text: bytes) -> None:
        self.file = file
        self.text = text
        self._starts = [0]
        for line in text.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))

    def span(self, node: ast.expr | ast.stmt | ast.keyword | ast.arg) -> tuple[int, int]:
        """Return where a node begins and ends."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._starts[node.lineno - 1] + node.col_offset, self._starts[node.end_lineno - 1] + node.end_col_offset

    def of(self, node: ast.expr | ast.stmt) -> str:
        """Return a node's text."""
        start, end = self.span(node)
        return self.text[start:end].decode()

    def mutant(self, rule: str, span: tuple[int, int], after: str) -> Mutant:
        """Return the mutant with another text at a place."""
        start, end = span
        line = self.text.count(b"\n", 0, start) + 1
        return Mutant(self.file, line, rule, start, end, " ".join(self.text[start:end].decode().split()), after)

    def between(self, rule: str, left: ast.expr, right: ast.expr, after: str) -> Iterator[Mutant]:
        """Yield the mutant with another operator between two operands."""
        start, end = self.span(left)[1], self.span(right)[0]
        if found := _OPERATOR.search(self.text[start:end].decode()):
            yield self.mutant(rule, (start + found.start(), start + found.end()), after)


def mutants(file: str, text: bytes) -> list[Mutant]:
    """Return every mutant of a Python file, in order. Docstrings, annotations, messages and imports have none."""
    source, found = _Source(file, text), []
    for node in _nodes(ast.parse(text)):
        for rule in _RULES:
            found += [one for one in rule(source, node) if one.after != one.before]
    return sorted(set(found), key=lambda one: (one.start, one.end, one.rule, one.after))


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that run and decide something."""
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        return
    if isinstance(node, (ast.Import, ast.ImportFrom, ast.JoinedStr, ast.Raise, ast.Assert)):
        return
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return
    if isinstance(node, ast.keyword) and node.arg == "strict":  # of zip, where it asserts
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases", "ctx"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _nodes(child)


def _constants(source: _Source, node: ast.AST) -> Iterator[Mutant]:
    if not isinstance(node, ast.Constant):
        return
    span, value = source.span(node), node.value
    if isinstance(value, bool):
        yield source.mutant("constant", span, str(not value))
    elif isinstance(value, int):
        yield from (source.mutant("constant", span, str(value + step)) for step in (1, -1) if value + step >= 0)
    elif isinstance(value, float):
        yield source.mutant("constant", span, repr(value * 1.25 if value else 0.25))
        if value in (1e3, 1e-3, 1e6, 1e-6, 1e9, 1e-9, 60.0):
            yield source.mutant("unit", span, "1.0")


def _comparisons(source: _Source, node: ast.AST) -> Iterator[Mutant]:
    if isinstance(node, ast.Compare):
        for left, kind, right in zip([node.left, *node.comparators], node.ops, node.comparators, strict=False):
            yield from source.between("comparison", left, right, _COMPARED[type(kind)])
    elif isinstance(node, ast.BoolOp):
        other = "or" if isinstance(node.op, ast.And) else "and"
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield from source.between("logic", left, right, other)
    elif isinstance(node, (ast.If, ast.While, ast.IfExp)):
        yield source.mutant("logic", source.span(node.test), f"(not ({source.of(node.test)}))")


def _signs(source: _Source, node: ast.AST) -> Iterator[Mutant]:
    if isinstance(node, ast.BinOp) and (other := _CALCULATED.get(type(node.op))):
        yield from source.between("sign", node.left, node.right, other)
    elif isinstance(node, ast.AugAssign) and (other := _CALCULATED.get(type(node.op))):
        yield from source.between("sign", node.target, node.value, f"{other}=")
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.Not)):
        yield source.mutant("sign", source.span(node), f"({source.of(node.operand)})")


def _axes(source: _Source, node: ast.AST) -> Iterator[Mutant]:
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
        words = node.attr.split("_")
        exchanged = "_".join(_AXES.get(word, word) for word in words)
        end = source.span(node)[1]
        yield source.mutant("axis", (end - len(node.attr), end), exchanged)
    elif isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant) and node.slice.value in (0, 1):
        yield source.mutant("axis", source.span(node.slice), str(1 - node.slice.value))


def _calls(source: _Source, node: ast.AST) -> Iterator[Mutant]:
    if isinstance(node, ast.Expr) and isinstance(node.value, (ast.Call, ast.Await)):
        yield source.mutant("call left out", source.span(node), "pass")
    if not isinstance(node, ast.Call):
        return
    for one, two in zip(node.args, node.args[1:], strict=False):
        if source.of(node.func) in _SYMMETRIC:
            break
        if not isinstance(one, ast.Starred) and not isinstance(two, ast.Starred):
            between = source.text[source.span(one)[1] : source.span(two)[0]].decode()
            span = source.span(one)[0], source.span(two)[1]
            yield source.mutant("arguments", span, source.of(two) + between + source.of(one))
    if isinstance(node.func, ast.Attribute) and node.func.attr in _UNITS and len(node.args) == 1:
        yield source.mutant("unit", source.span(node), f"({source.of(node.args[0])})")


def _returns(source: _Source, node: ast.AST) -> Iterator[Mutant]:
    """A function that ends at once, with the least value of its type."""
    if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) or node.returns is None:
        return
    body = [one for one in node.body if not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))]
    if not body or isinstance(body[0], (ast.Pass, ast.Raise)) or any(isinstance(n, ast.Yield) for n in ast.walk(node)):
        return
    span = source.span(body[0])
    for value in _RETURNED.get(source.of(node.returns), ()):
        if source.of(body[0]) != f"return {value}".strip():
            yield source.mutant("early return", (span[0], span[0]), f"return {value}\n{' ' * body[0].col_offset}")


_RULES: tuple[Callable[[_Source, ast.AST], Iterator[Mutant]], ...] = (
    _constants, _comparisons, _signs, _axes, _calls, _returns,
)  # fmt: skip


def chosen_tests(mutant: Mutant, covered: CoveredFunctions) -> Iterator[Tests]:
    """Yield the tests to run for a mutant: those that call its function, the quickest of its room first; then the room.

    Where no notes tell which these are, those of the room's files that name the module come first.
    """
    room, named = _near_files(mutant.file)
    calling = covered.tests(mutant.file, mutant.line)
    calling.sort(key=lambda test: (test.partition("::")[0] not in named, not test.startswith(f"{room}/")))
    if not calling and named:
        yield Tests(named[:FIRST_FILES], None, NEAR_S)
    yield from batches(calling, covered.seconds)
    yield Tests([room], None, _ROOM_S)
    yield Tests([room], None, _ROOM_S, slow=True)


@cache
def _near_files(file: str) -> tuple[str, list[str]]:
    """Return the folder of the tests of a file's room, and the test files there that name the module."""
    room = Path("tests", *[part for part in Path(file).parts[:-1] if part != "hil"][:2])
    while not (ROOT / room).is_dir():
        room = room.parent
    module = re.compile(rf"\b{Path(file).stem}\b")
    texts = {path: path.read_text(encoding="utf-8") for path in sorted((ROOT / room).rglob("test_*.py"))}
    return room.as_posix(), [path.relative_to(ROOT).as_posix() for path in texts if module.search(texts[path])]


def keys() -> dict[Mutant, Key]:
    """Return every mutant, and by what it is listed. What is generated has none: its generator is compared with it."""
    found = {}
    for path in (path for package in _PACKAGES for path in sorted((ROOT / package).rglob("*.py"))):
        if path.parent.name != "generated":
            text = path.read_bytes()
            lines = text.decode().splitlines()
            for one in mutants(path.relative_to(ROOT).as_posix(), text):
                found[one] = Key(one.file, lines[one.line - 1].strip(), one.before, one.after)
    return found


def main() -> int:
    """Try mutants, and print what survives and a table."""
    parser = options("tools.mutate_python", __doc__)
    parser.set_defaults(sample=100)
    arguments = parser.parse_args()
    every = keys()
    known, stale = equivalent("python", "line", every)
    some = chosen([one for one in every if one not in known], arguments)
    covered = CoveredFunctions(arguments.covered)
    try_all(some, lambda folder: Copy(folder, lambda mutant: chosen_tests(mutant, covered)), arguments)
    print_stale(stale)
    return 0


if __name__ == "__main__":
    sys.exit(main())
