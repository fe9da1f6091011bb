"""Every rule of PROTOCOL.md has a test, and the list of rules is read from the page as it is meant."""

import pytest

from tools import rules

PAGE = """# A page

A sentence without a rule. [R-A-1] A robot must move. It may stop; [R-A-2] it must not fly,
at 0.2 m/s or more. The host watches.

- [R-B-1] **A host must look.** Nothing else.

| what | when |
|---|---|
| [R-B-2] X | always |
"""


def test_every_rule_has_a_test_and_every_marker_a_rule(capsys: pytest.CaptureFixture[str]) -> None:
    assert rules.main(["--check"]) == 0, capsys.readouterr().err


def test_rules_are_read_from_sentences_and_rows() -> None:
    found, wrong = rules.read_rules(PAGE.replace("It may stop; [R-A-2] it", "It may stop. [R-A-2] It"))
    assert wrong == []
    assert found == {
        "R-A-1": "A robot must move.",
        "R-A-2": "It must not fly, at 0.2 m/s or more.",
        "R-B-1": "A host must look.",
        "R-B-2": "X: always",
    }


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("A sentence without", "A sentence must have", "says must without an id: A sentence must have"),
        ("must move", "moves", "R-A-1 does not say must"),
        ("R-B-1", "R-A-1", "has R-A-1 twice"),
        ("It may stop;", "It may stop;", "says must without an id: It may stop; [R-A-2]"),
    ],
)
def test_a_rule_that_is_stated_wrongly_is_named(old: str, new: str, sentence: str) -> None:
    assert any(sentence in one for one in rules.read_rules(PAGE.replace(old, new))[1])


def test_a_rule_without_a_test_and_a_marker_without_a_rule_are_named() -> None:
    found, _ = rules.read_rules(PAGE)
    tests = {"R-A-1": ["test_x: a"], "R-B-1": ["test_x: b"], "R-C-9": ["test_x: c"]}
    wrong = rules.problems(found, tests, {"R-D-1": ["mute TICK"]}, {})
    assert wrong[0].startswith("R-B-2 has no test")
    assert wrong[1:] == [
        "test_x: c names R-C-9, which PROTOCOL.md does not have",
        "mute TICK names R-D-1, which PROTOCOL.md does not have",
    ]


def test_functions_that_are_mutated_are_listed_by_rule() -> None:
    found = rules.of_mutants()["R-CMD-4"]
    assert "receive.c: command_is_fresh" in found
