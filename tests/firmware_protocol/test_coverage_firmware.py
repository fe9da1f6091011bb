"""What the coverage of the firmware core is judged by: decisions as trees, and a reason for each branch not taken."""

import pytest

from tools import coverage_firmware as tool


@pytest.mark.parametrize(
    ("decision", "is_joined"),
    [
        ("a && b && c", False),
        ("a || (b && c)", False),
        ("a && (b || (c && d))", False),
        ("(a || b) && c", True),
        ("a && b || c", True),
        ("a && (b || c) && d", True),
        ("!(a || b) && c", False),
        ("!(a && b) && c", True),
        ("a && !(b && c)", False),
        ("a && ((b && c) || d)", True),
    ],
)
def test_a_condition_that_is_reached_in_two_ways_is_found(decision: str, is_joined: bool) -> None:
    """The oracle: of the paths through the decision, some two differ before the same condition is asked."""
    (node,) = tool.decisions(f"int f(int a, int b, int c, int d) {{ return {decision}; }}", "x.c")
    assert tool.is_joined(node) == is_joined
    assert (len(paths_to_conditions(decision)) > len(set("abcd") & set(decision))) == is_joined


def paths_to_conditions(decision: str) -> set[tuple[tuple[str, bool], ...]]:
    """Return the ways in which conditions are reached, as Python evaluates the decision."""
    python = decision.replace("&&", " and ").replace("||", " or ").replace("!", " not ")
    ways = set()
    for bits in range(16):
        asked: list[tuple[str, bool]] = []

        class Values(dict[str, bool]):
            def __getitem__(self, name: str) -> bool:
                ways.add((*asked, (name, True)))  # noqa: B023
                asked.append((name, bool(bits >> "abcd".index(name) & 1)))  # noqa: B023
                return asked[-1][1]  # noqa: B023

        eval(python, {}, Values())
    return ways


def test_decisions_are_found_wherever_they_stand() -> None:
    text = "int f(int a, int b) { int x = a && b; if (g(a || b)) { return x; } return a > (a && b ? 1 : 2); }"
    assert len(tool.decisions(text, "x.c")) == 3


def test_a_branch_without_a_reason_and_a_reason_without_a_branch_are_told() -> None:
    untouched = [tool.Coverage(source.name, 1, [], 1, []) for source in tool.CORE]
    wrong, explained = tool.unexplained(untouched)
    assert explained == 0
    assert all("explains a branch that is taken" in one for one in wrong)
    place = next(n for n, source in enumerate(tool.CORE) if source.name == "node.c")
    lines = tool.CORE[place].read_text(encoding="utf-8").splitlines()
    known = next(n for n, line in enumerate(lines, 1) if "wp_step_done_encode(" in line)
    untouched[place] = untouched[place]._replace(missed_branches=[1, known, known])
    assert tool.unexplained(untouched)[1] == 1
    told = [one for one in tool.unexplained(untouched)[0] if one.startswith("node.c:")]
    assert told == [
        f"node.c:1: 1 branches not taken: {lines[0]}",
        f"node.c:{known}: 1 branches not taken: {lines[known - 1].strip()}",
    ]
