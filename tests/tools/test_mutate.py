"""The rules by which C is mutated, and that every file of it is reached."""

import random
from pathlib import Path

import pytest

from tools.mutants import ROOT, Mutant
from tools.mutants_of_c import PLACES, changes, mutants, near_tests


@pytest.mark.parametrize(
    ("line", "rule", "others"),
    [
        ("    a = b[1];", "constant", {"    a = b[0];", "    a = b[2];"}),
        ("    a = 2.0f;", "constant", {"    a = 1.5f;", "    a = 2.5f;"}),
        ("    a = b * 1e-3;", "constant", {f"    a = b * {0.75e-3};", "    a = b * 0.00125;"}),
        ("    while (a <= b) {", "comparison", {"    while (a < b) {"}),
        ("    if (a && b) {", "logic", {"    if (a || b) {", "    if (!(a && b)) {"}),
        ("    a = b * -c;", "sign", {"    a = b / -c;", "    a = b * c;"}),
        ("    a += b;", "sign", {"    a -= b;"}),
        ("    a = cos(b) * x_m;", "axis", {"    a = sin(b) * x_m;", "    a = cos(b) * y_m;"}),
        ("    a = g[POSE_X];", "axis", {"    a = g[POSE_Y];"}),
        ("    f(a, g(b, c));", "arguments", {"    f(g(b, c), a);", "    f(a, g(c, b));"}),
        ("    float a[3] = {b, c, d};", "arguments", {"    float a[3] = {c, b, d};", "    float a[3] = {b, d, c};"}),
        ("    a = fmin(b, c);", "arguments", set()),
        ("    stop(a);", "statement left out", {";"}),
    ],
)
def test_a_rule_makes_these_changes(line: str, rule: str, others: set[str]) -> None:
    assert {other for kind, other in changes(line) if kind == rule} == others


@pytest.mark.parametrize("line", ['    return "x + 1";', "float f(float, int);", "a_t b;"])
def test_words_and_declarations_are_not_changed(line: str) -> None:
    assert list(changes(line)) == []


def test_comments_and_includes_have_no_mutant_and_each_lies_where_it_says() -> None:
    assert mutants("a.c", '#include "1.h"\n/* a + b;\n   c + d; */\n_Static_assert(1, "");\n') == []
    (one,) = mutants("a.c", "/* \u00b5 */\nint f(a b) {\n    return -c; /* - */\n}\n")
    text = "/* \u00b5 */\nint f(a b) {\n    return -c; /* - */\n}\n".encode()
    assert text[: one.start] + one.after.encode() + text[one.end :] == (
        "/* \u00b5 */\nint f(a b) {\n    return c;\n}\n".encode()
    )


def test_the_quickest_of_the_near_tests_come_first_and_those_of_other_files_not() -> None:
    near = "tests/plant_fmu/test_plant_motors.py::"
    seconds = {f"{near}slow": 9.0, "tests/wire/test_trace.py::other": 0.1, f"{near}quick": 2.0, f"{near}last": 11.0}
    mutant = Mutant("plant_fmu/motor.c", 1, "sign", 0, 1, "+", "-")
    first, second, room = near_tests(mutant, seconds)
    assert (first.names, second.names) == ([f"{near}quick", f"{near}slow"], [f"{near}last"])
    assert (room.files, room.names) == (["tests/plant_fmu"], None)


def test_every_c_file_of_a_library_is_a_room_s_and_has_near_tests() -> None:
    rooms = set()
    for file in PLACES.values():
        one = random.Random(file).choice(mutants(file, Path(ROOT, file).read_text(encoding="utf-8")))
        rooms.add(one.room)
        assert all(Path(ROOT, test).exists() for tests in near_tests(one, {}) for test in tests.files), file
    assert rooms == {
        *(f"firmware_protocol/{part}" for part in ("firmware", "client", "port/host", "port/python")),
        *("hil/plant", "plant_fmu", "plant_fmu/mujoco"),
    }
