"""The targets of make, and what the nightly run leaves behind."""

import itertools
import json
import re
import shutil
import subprocess
import sys

import pytest

from tests.support.processes import ROOT
from tests.support.slow import SLOW
from tools import nightly, soak

needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="make is not there; install it")


def make(*words: str) -> str:
    return subprocess.run(["make", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout


@needs_make
def test_make_help_has_a_line_for_every_target() -> None:
    listed = re.findall(r"^make ([a-z-]+) +\S+", make("help"), re.MULTILINE)
    [phony] = re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted([*listed, "native"]) == sorted(phony.split())


@needs_make
@pytest.mark.parametrize(("targets", "sessions"), [(("test-all",), 3), (("test", "test-rest"), 4)])
def test_every_test_is_chosen_once(targets: tuple[str, ...], sessions: int) -> None:
    shown = make("--dry-run", *targets, "ARGS=")
    chosen = [one or other for one, other in re.findall(r"pytest .*?-m (?:'(.+?)'|(\w+))", shown)]
    assert len(chosen) == sessions
    for slow, alone, socketcan in itertools.product((True, False), repeat=3):
        if alone or not socketcan:  # tests/conftest.py marks every socketcan test as alone
            marks = {"slow": slow, "alone": alone, "socketcan": socketcan}
            assert sum(eval(words, marks) for words in chosen) == 1


def test_every_slow_test_is_there() -> None:
    for entry in SLOW:
        file, _, name = entry.partition("::")
        [path] = (ROOT / "tests").rglob(file)
        text = path.read_text(encoding="utf-8")
        assert f"def {name.partition('[')[0]}" in text, entry


def test_each_step_leaves_a_file_that_names_commit_date_and_command(tmp_path, capfd) -> None:
    steps = {
        "good": nightly.Step(
            "what goes well", (sys.executable, "-c", "import os; print(os.environ['HOW'])"), {"HOW": "so"}
        ),
        "bad": nightly.Step("what does not", (sys.executable, "-c", "raise SystemExit('broken: {out}')")),
    }
    assert nightly.run(steps, tmp_path / "night", "0123abcd") == 1
    good, bad = ((tmp_path / "night" / f"{name}.txt").read_text().splitlines() for name in steps)
    assert good[:4] == ["what goes well", "", "commit   0123abcd", good[3]]
    assert re.fullmatch(r"date     \d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", good[3])
    seed = re.search(r"\d{4}-\d\d-\d\d", good[3])[0].replace("-", "")
    assert good[5] == f"command  HIL_SEED={seed} HOW=so {sys.executable} -c import os; print(os.environ['HOW'])"
    assert good[7] == "so"
    assert re.fullmatch(r"exit code 0 after \d+ s", good[-1])
    assert f"broken: {tmp_path}/night" in bad
    summary = (tmp_path / "night" / "summary.txt").read_text()
    assert re.fullmatch(r"good  good +exit code 0 .*\nBAD   bad +exit code 1 .*\n", summary)
    assert capfd.readouterr().out.endswith(summary)


@pytest.mark.parametrize("command", sorted({step.command for step in nightly.STEPS.values()}))
def test_every_step_is_a_command_that_has_its_options(command: tuple[str, ...]) -> None:
    name = command[: 4 if command[2] == "hil" else 3]
    shown = subprocess.run([*name, "--help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for option in command[len(name) :]:
        assert not option.startswith("-") or re.search(rf"(?<![\w-]){option}(?![\w-])", shown), option


def test_what_grows_is_told_and_what_settles_is_not() -> None:
    def sizes(memory: list[float], files: list[float]) -> list[dict[str, float]]:
        return [{"memory_mib": one, "files": other} for one, other in zip(memory, files, strict=True)]

    settled = [100.0, 120.0, 130.0, 131.0, 131.0, 132.0, 131.0, 132.0]
    assert soak.grown(sizes(settled, [20.0] * 8)) == []
    assert soak.grown(sizes([100.0 + 10.0 * n for n in range(8)], [20.0] * 8)) == [
        "memory_mib grew from 125.0 to 165.0 in 8 cycles"
    ]
    assert soak.grown(sizes(settled, [20.0 + 3.0 * n for n in range(8)])) == [
        "files grew from 27.5 to 39.5 in 8 cycles"
    ]
    assert soak.grown(sizes(settled[:3], [20.0] * 3)) == [], "too few to tell"


@pytest.mark.alone
def test_a_short_soak_drives_a_service_and_finds_nothing_wrong() -> None:
    command = [sys.executable, "-m", "tools.soak", "--minutes", "0", "--track-s", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    figures = json.loads(done.stdout)
    # Where the machine stood still for half a second the robot is stopped, as it should be, and that is told.
    late = [one for one in figures["trouble"] if "slower than the robot" in one]
    assert figures["trouble"] == late
    assert late or (done.returncode, figures["cycles"]) == (0, 1)
    assert all(one["processes"] == 3 for one in figures["sizes"]), "control, API, e-stop"
