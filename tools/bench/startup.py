"""What it takes to begin: ``python -m tools.bench.startup``.

``hil --help``, and the paper's circle (15 s of robot time at 1 kHz, recorded) from a cold start, in turns with an
interpreter that does nothing and one that imports NumPy. Medians; the ratios are what can be compared between machines.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[2]
NOTHING = "python -c pass"
NUMPY = "import numpy"
_HIL = ("-m", "hil.cli.main")
_WAYS = {
    NOTHING: ("-c", "pass"),
    NUMPY: ("-c", "import numpy"),
    "hil --help": (*_HIL, "--help"),
    "hil check": (*_HIL, "check", "paper_circle"),
    "hil run": (*_HIL, "run", "paper_circle"),
    "hil run, not recorded": (*_HIL, "run", "paper_circle", "--record", "none"),
}

MOST_OF_NUMPY = {"hil --help": 1.5, "hil check": 10.0, "hil run": 80.0}
"""CPU time in that of importing NumPy: about twice what they take, so that only a clear loss counts."""


class Took(NamedTuple):
    """What a process took, its children among it [s]."""

    wall_s: float
    cpu_s: float


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.startup", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=7, help="turns, of which the median counts")
    parser.add_argument("--check", action="store_true", help="exit 1 on a clear loss")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    taken: dict[str, list[Took]] = {way: [] for way in _WAYS}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(options.repeats + 1):
            for way, arguments in _WAYS.items():
                took = _process(arguments, folder)
                if turn:  # the first turn compiles what was not, and fills the caches
                    taken[way].append(took)
    medians = {way: Took(*(statistics.median(one) for one in zip(*took, strict=True))) for way, took in taken.items()}
    figures = {
        way: {
            "wall_s": took.wall_s,
            "cpu_s": took.cpu_s,
            "of_nothing": took.cpu_s / medians[NOTHING].cpu_s,
            "of_numpy": took.cpu_s / medians[NUMPY].cpu_s,
        }
        for way, took in medians.items()
    }
    _print(figures)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    lost = [
        f"{way}: {figures[way]['of_numpy']:.1f}, at most {most}"
        for way, most in MOST_OF_NUMPY.items()
        if figures[way]["of_numpy"] > most
    ]
    if options.check and lost:
        raise SystemExit(f"more CPU time than NumPy's import, times: {'; '.join(lost)}")


def _process(arguments: tuple[str, ...], folder: str) -> Took:
    """Run a process to its end, in a folder of its own."""
    # As an installed package has it: compiled once, wherever this shell would keep that.
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONPYCACHEPREFIX": str(Path(folder, "cache"))}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = _children_cpu_s()
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, stdout=subprocess.DEVNULL, check=True, timeout=300
    )
    return Took(time.perf_counter() - begin, _children_cpu_s() - before)


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)  # os.times has a grain of 10 ms
    return used.ru_utime + used.ru_stime


def _print(figures: dict[str, dict[str, float]]) -> None:
    table = Table("command", "wall s", "CPU s", "of nothing's", "of NumPy's", title="from a cold start, medians")
    for way, row in figures.items():
        cells = (f"{row['wall_s']:.2f}", f"{row['cpu_s']:.2f}", f"{row['of_nothing']:.1f}", f"{row['of_numpy']:.1f}")
        table.add_row(way, *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
