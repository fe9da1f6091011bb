"""The rules by which Python is mutated: each gives other code that compiles, and changes no words."""

import ast
import importlib
import inspect
import json
import random
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from hil.core import percentiles
from tests.support import examples
from tools.covered_functions import CoveredFunctions
from tools.mutants import ROOT, Mutant, equivalent, sample, table
from tools.mutate_python import chosen_tests, keys, mutants
from tools.test_server import take_over


def changed(text: str, rule: str) -> set[str]:
    """Return the texts that a rule makes of one line."""
    content = text.encode()
    every = mutants("hil/wire/some.py", content)
    return {
        (content[: one.start] + one.after.encode() + content[one.end :]).decode() for one in every if one.rule == rule
    }


@pytest.mark.parametrize(
    ("text", "rule", "others"),
    [
        ("a = 5", "constant", {"a = 4", "a = 6"}),
        ("a = 2.0", "constant", {"a = 2.5"}),
        ("a = f(whole=True)", "constant", {"a = f(whole=False)"}),
        ("a = b * 1e-3", "unit", {"a = b * 1.0"}),
        ("a = math.radians(b)", "unit", {"a = (b)"}),
        ("a = b <= c", "comparison", {"a = b < c"}),
        ("a = b not in c", "comparison", {"a = b in c"}),
        ("a = b and c", "logic", {"a = b or c"}),
        ("a = b - c", "sign", {"a = b + c"}),
        ("a = -b", "sign", {"a = (b)"}),
        ("a -= b", "sign", {"a += b"}),
        ("a = p.x_m", "axis", {"a = p.y_m"}),
        ("a = p[1]", "axis", {"a = p[0]"}),
        ("f(a, b)", "arguments", {"f(b, a)"}),
        ("stop.send(a)", "call left out", {"pass"}),
        (
            "def f(a: int) -> bool:\n    return a",
            "early return",
            {f"def f(a: int) -> bool:\n    return {value}\n    return a" for value in ("True", "False")},
        ),
    ],
)
def test_a_rule_makes_these_changes(text: str, rule: str, others: set[str]) -> None:
    assert changed(text, rule) == others


@pytest.mark.parametrize(
    "text",
    [
        '"""Of 5 V."""',
        "from a import b",
        "a: Literal[1]",
        'raise E(f"{a + 1}")',
        "if TYPE_CHECKING:\n    a = 1",
        "a = 'x'",
        "a = zip(*b, strict=True)",
        "a = max(b, c)",
    ],
)
def test_what_only_says_or_asserts_is_not_changed(text: str) -> None:
    assert mutants("hil/wire/some.py", text.encode()) == []


def test_every_change_compiles_and_lies_where_it_says() -> None:
    chance = examples.chance()
    for path in chance.sample(sorted((ROOT / "hil").rglob("*.py")), 12):
        content = path.read_bytes()
        every = mutants(path.relative_to(ROOT).as_posix(), content)
        for one in chance.sample(every, min(len(every), 10)):
            other = content[: one.start] + one.after.encode() + content[one.end :]
            assert ast.dump(ast.parse(other)) != ast.dump(ast.parse(content)), one
            assert one.before.split()[:1] == content[one.start : one.end].decode().split()[:1], one


def test_no_row_of_the_list_of_equivalent_mutants_is_stale() -> None:
    every = keys()
    known, stale = equivalent("python", "line", every)
    assert known
    assert stale == []
    assert equivalent("python", "line", {one: key for one, key in every.items() if one not in known})[1] != []


def test_a_sample_has_as_many_of_each_room() -> None:
    every = [Mutant(f"hil/{room}/a.py", n, "sign", n, n, "+", "-") for room in ("wire", "plant") for n in range(50)]
    every += [Mutant("hil/laws/a.py", 1, "sign", 1, 1, "+", "-")]
    chosen = sample(every, 21, random.Random(1))
    assert sorted({one.room: sum(one.room == other.room for other in chosen) for one in chosen}.values()) == [1, 10, 10]


def test_a_table_has_all_first_and_then_the_rooms() -> None:
    found = table(Counter({"wire": 3, "laws": 1}), Counter({"wire": 2, "laws": 1}), 7)
    assert found.splitlines()[2:] == [
        "| all | 4 | 3 | 75 % |",
        "| laws | 1 | 1 | 100 % |",
        "| wire | 3 | 2 | 67 % |",
        "",
        "Seed 7.",
    ]


def test_without_notes_the_files_that_name_a_module_come_before_its_room(tmp_path) -> None:
    nothing = CoveredFunctions(tmp_path)
    first, room, slow = chosen_tests(Mutant("hil/wire/direction.py", 1, "sign", 0, 1, "+", "-"), nothing)
    assert all(one.startswith("tests/wire/") and Path(ROOT, one).exists() for one in first.files)
    assert room.files == slow.files == ["tests/wire"]
    assert (room.slow, slow.slow) == (False, True)
    *_, last = chosen_tests(Mutant("hil/addons/batch/campaign/campaign.py", 1, "sign", 0, 1, "+", "-"), nothing)
    assert last.files == ["tests/addons/batch"]


def test_tests_that_call_the_function_come_first_those_of_the_room_before_others(tmp_path) -> None:
    seconds = {
        "tests/cli/test_a.py::test_one": 0.1,
        "tests/wire/test_b.py::test_two": 3,
        "tests/wire/test_b.py::c": 0.5,
    }
    notes = {"hil/wire/some.py:10:20": [0, 1], "hil/wire/some.py:12:14": [0, 1, 2]}
    (tmp_path / "1.json").write_text(json.dumps({"seconds": seconds, "tests": notes}))
    covered = CoveredFunctions(tmp_path)
    first, *_ = chosen_tests(Mutant("hil/wire/some.py", 13, "sign", 0, 1, "+", "-"), covered)
    assert first.names == ["tests/wire/test_b.py::c", "tests/wire/test_b.py::test_two", "tests/cli/test_a.py::test_one"]
    assert first.files == ["tests/wire/test_b.py", "tests/cli/test_a.py"]
    assert set(covered.tests("hil/wire/some.py", 20)) == set(list(seconds)[:2])
    assert set(covered.tests("hil/wire/some.py", 1)) == set(seconds)


def test_the_notes_are_of_the_functions_that_a_test_calls(pytester) -> None:
    pytester.makepyfile(
        test_some="import numpy; from hil.core import percentiles\n"
        "def test_nothing(): pass\n"
        "def test_one(): percentiles.percentiles(numpy.ones(1))\n"
    )
    done = pytester.runpytest_subprocess("-p", "tools.covered_functions", "--covered-functions", "notes")
    assert done.ret == 0
    covered = CoveredFunctions(pytester.path / "notes")
    assert set(covered.seconds) == {"test_some.py::test_nothing", "test_some.py::test_one"}
    line = inspect.getsourcelines(percentiles.percentiles)[1]
    assert covered.tests("hil/core/percentiles.py", line) == ["test_some.py::test_one"]


def test_the_server_names_what_fails_first_and_ends_what_hangs(tmp_path) -> None:
    good, bad = tmp_path / "test_good.py", tmp_path / "test_bad.py"
    good.write_text("def test_good(): pass\ndef test_hangs(): import time; time.sleep(1e4)\n")
    bad.write_text("def test_bad(): assert False\n")
    (tmp_path / "conftest.py").write_text("")
    root = ["--rootdir", str(tmp_path)]
    asked = [
        {"files": [str(good)], "tests": ["test_good.py::test_good"], "limit_s": 60},
        {"files": [str(good), str(bad)], "tests": ["test_bad.py::test_bad", "test_good.py::test_good"], "limit_s": 60},
        {"files": [str(bad)], "tests": None, "without": ["test_bad.py::test_bad"], "limit_s": 60},
        {"files": [str(good)], "tests": None, "limit_s": 3},
    ]
    lines = "".join(
        json.dumps({"without": [], "slow": False, **one, "files": root + one["files"]}) + "\n" for one in asked
    )
    done = subprocess.run(
        [sys.executable, "-m", "tools.test_server"], input=lines, capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert [json.loads(line) for line in done.stdout.splitlines()] == [None, "test_bad.py::test_bad", None, "limit"]


_MODULE = """
from functools import cached_property, wraps

LIMIT = 3

def twice(function):
    @wraps(function)
    def both(x):
        return 2 * function(x)
    return both

@twice
def wrapped(x, least=4):
    return x + 1

def outer():
    def inner(x):
        return x - 1
    return inner

class Thing:
    size: int = 5

    @cached_property
    def half(self):
        return self.size / 2

ROWS = {"row": lambda x: x * x}
made = outer()
"""


@pytest.mark.parametrize(
    ("before", "after", "use", "value"),
    [
        ("x + 1", "x - 1", "wrapped(1)", 0),
        ("2 * function(x)", "3 * function(x)", "wrapped(1)", 6),
        ("return x - 1", "return x", "made(1)", 1),
        ("return inner", "return 0", "outer()", 0),
        ("self.size / 2", "self.size * 2", "Thing().half", 10),
        ("x * x", "x / x", 'ROWS["row"](3)', 1.0),
        ("LIMIT = 3", "LIMIT = 4", "LIMIT", None),
        ("least=4", "least=5", "wrapped(1)", None),
        ("size: int = 5", "size: int = 6", "Thing().size", None),
    ],
)
def test_functions_take_over_what_was_changed_and_nothing_else_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, before: str, after: str, use: str, value: object
) -> None:
    """None: a change that needs a new process."""
    path = tmp_path / "changed_in_place.py"
    path.write_text(_MODULE, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "changed_in_place", raising=False)
    module = importlib.import_module("changed_in_place")
    path.write_text(_MODULE.replace(before, after), "utf-8")
    if value is None:
        with pytest.raises(ValueError, match=r"^$"):
            take_over(path, _MODULE)
    else:
        take_over(path, _MODULE)
        assert eval(use, vars(module)) == value
