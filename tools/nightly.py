"""Runs what is too long for CI, and writes one file of results for each: ``python -m tools.nightly``, or make nightly.

The files go to ``build/nightly/DATE-COMMIT/``, or to ``--out``. Each begins with the commit, the date and the command,
and ends with the exit code and the time taken; ``summary.txt`` has a line each. Exits with 1 when a step failed.
"""

import argparse
import datetime
import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PYTHON = sys.executable
_SUITE = map(str, sorted((ROOT / "tests" / "suite").glob("*.toml")))


class Step(NamedTuple):
    """A command, a text on it, and its environment; the date is the seed of tests."""

    words: str
    command: tuple[str, ...]
    environment: Mapping[str, str] = {}


STEPS = {
    "tests": Step(
        "all tests side by side in random order, each property with twenty times the examples; and Windows FMUs",
        (PYTHON, "-m", "pytest", "-n", "auto", "--dist", "worksteal", "-m", "not alone"),
        {"HIL_EXAMPLES": "thorough", "HIL_ORDER": "shuffled"},
    ),
    "alone": Step("the tests of real time", (PYTHON, "-m", "pytest", "-m", "alone")),
    "without": Step(
        "the core's tests and the demo without each add-on in turn",
        (PYTHON, "-m", "tools.without_addon"),
    ),
    "mutation": Step(
        "every mutant of the firmware",
        (PYTHON, "-m", "tools.mutate", "--room", "firmware_protocol/firmware"),
    ),
    "c": Step(
        "1000 mutants of all our C by rule, as many from each folder",
        (PYTHON, "-m", "tools.mutate", "--sample", "1000"),
    ),
    "covered": Step(
        "which tests call which function, for the mutants of the Python",
        (PYTHON, "-m", "tools.covered_functions"),
    ),
    "python": Step(
        "1000 mutants of the Python by rule, as many from each room",
        (PYTHON, "-m", "tools.mutate_python", "--sample", "1000"),
    ),
    "fuzz": Step(
        "fuzzing of the firmware, of the decoder, of the host's line and of its calls from Python",
        (PYTHON, "-m", "tools.fuzz", "--runs", "10000000"),
    ),
    "catalogue": Step(
        "every fault, and all pairs of faults", (PYTHON, "-m", "hil", "catalogue", "--pairs", "--realtime")
    ),
    "verify": Step(
        "every known defect of hil verify put into the suite, and 3000 healthy runs",
        (PYTHON, "-m", "hil", "verify", *_SUITE, "--least", "90", "--healthy", "3000", "--out", "{out}/verify"),
    ),
    "hunt": Step(
        "runs until a planted defect is found, by a hunt and at random",
        (PYTHON, "-m", "tools.bench.hunt", "--hunts", "3", "--cap", "1000", "--json", "{out}/hunt.json"),
    ),
    "identify": Step(
        "how well hil identify finds 300 random robots of each plant",
        (
            PYTHON,
            "-m",
            "tools.identify_robots",
            "--robots",
            "300",
            "--plants",
            "rigid",
            "slip",
            "mujoco",
            "--outcomes",
            "{out}/identify.jsonl",
        ),
    ),
    "pages": Step("the blocks of the pages that take minutes", (PYTHON, "-m", "tools.page_blocks")),
    "start": Step("the start page, typed into an empty Debian; needs root", (PYTHON, "-m", "tools.start_page")),
    "soak": Step("a service that is driven for two hours", (PYTHON, "-m", "tools.soak", "--minutes", "120")),
    "chaos": Step(
        "an hour of kills, stops, full disks and bad lines, judged by the robot's truth",
        (PYTHON, "-m", "tools.chaos", "--minutes", "60"),
    ),
    "container": Step(
        "the steps of the Dockerfile, in a folder of Debian's; needs root", (PYTHON, "-m", "tools.container")
    ),
    "release": Step("the wheels of a release", (PYTHON, "-m", "tools.release", "--out", "{out}/dist")),
    "elsewhere": Step(
        "the wheels of that release on ARM64, on another Python and under wine",
        (PYTHON, "-m", "tools.elsewhere", "--wheels", "{out}/dist"),
    ),
    "bench": Step("all benchmarks", (PYTHON, "-m", "tools.bench", "--json", "{out}/bench.json")),
}


def main() -> int:
    """Run the steps that were asked for."""
    parser = argparse.ArgumentParser(prog="tools.nightly", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", choices=STEPS, action="append", help="this step; may be repeated")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="where the results go")
    options = parser.parse_args()
    commit = commit_of(ROOT)
    out = options.out or ROOT / "build" / "nightly" / f"{_now():%Y%m%dT%H%M%SZ}-{commit[:12]}"
    return run({name: STEPS[name] for name in options.only or STEPS}, out, commit)


def run(steps: Mapping[str, Step], out: Path, commit: str) -> int:
    """Run each step, write its file and a line of the summary, and return the exit code."""
    out.mkdir(parents=True, exist_ok=True)
    worst = 0
    for name, step in steps.items():
        command = [word.format(out=out) for word in step.command]
        environment = {"HIL_SEED": f"{_now():%Y%m%d}"} | dict(step.environment)
        shown = " ".join([*(f"{key}={value}" for key, value in environment.items()), *command])
        head = (
            f"commit   {commit}\ndate     {_now():%Y-%m-%dT%H:%M:%SZ}\n"
            f"machine  {platform.platform()}, {os.cpu_count()} processors\n"
        )
        path = out / f"{name}.txt"
        print(f"{name}: {step.words}; {path}", flush=True)
        begin_s = time.monotonic()
        with path.open("w", encoding="utf-8") as file:
            file.write(f"{step.words}\n\n{head}command  {shown}\n\n")
            file.flush()
            code = subprocess.run(
                command, cwd=ROOT, env=os.environ | environment, stdout=file, stderr=subprocess.STDOUT, check=False
            ).returncode
            ended = f"exit code {code} after {time.monotonic() - begin_s:.0f} s"
            file.seek(0, os.SEEK_END)
            file.write(f"\n{ended}\n")
        with (out / "summary.txt").open("a", encoding="utf-8") as summary:
            summary.write(f"{'good' if code == 0 else 'BAD '}  {name:10} {ended}\n")
        worst = max(worst, int(code != 0))
    print((out / "summary.txt").read_text(encoding="utf-8"), end="")
    return worst


def commit_of(folder: Path) -> str:
    """Return the commit of a checkout, with a mark where files differ from it; "unknown" where there is no git."""
    words = ("git", "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*")
    try:
        return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)


if __name__ == "__main__":
    sys.exit(main())
