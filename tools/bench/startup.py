"""What it takes to begin: ``python -m tools.bench.startup``.

``hil --help``, and the paper's circle (15 s of robot time at 1 kHz, recorded) from a cold start, in turns with an
interpreter that does nothing and one that imports NumPy. Medians; the ratios are what can be compared between machines.
With ``--peer`` the ``hil`` of another checkout takes part in the turns.
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

_OF_PEER = ", the peer's"

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
    parser.add_argument("--peer", type=Path, metavar="CHECKOUT", help="with its own .venv, measured in the same turns")
    options = parser.parse_args()
    ways = {way: (sys.executable, *arguments) for way, arguments in _WAYS.items()}
    if options.peer is not None:
        hil = options.peer.absolute() / ".venv" / Path(sys.executable).with_name("hil").relative_to(sys.prefix)
        own = [way for way, arguments in _WAYS.items() if arguments[: len(_HIL)] == _HIL]
        ways |= {way + _OF_PEER: (str(hil), *_WAYS[way][len(_HIL) :]) for way in own}
    taken: dict[str, list[Took]] = {way: [] for way in ways}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(options.repeats + 1):
            for way, command in ways.items():
                took = _process(command, folder, options.peer if way.endswith(_OF_PEER) else ROOT)
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
    for way in [way for way in figures if way.endswith(_OF_PEER)]:
        ours = way.removesuffix(_OF_PEER)
        figures[ours] |= {f"{time}_of_peer": figures[ours][time] / figures[way][time] for time in ("wall_s", "cpu_s")}
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


def _process(command: tuple[str, ...], folder: str, root: Path) -> Took:
    """Run a process of a checkout to its end, in a folder of its own."""
    # As an installed package has it: compiled once, wherever this shell would keep that.
    environment = os.environ | {"PYTHONPATH": str(root), "PYTHONPYCACHEPREFIX": str(Path(folder, "cache"))}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = _children_cpu_s()
    begin = time.perf_counter()
    # Its output ends with the process. Python waits for a pipe without polling, for a process it polls every 50 ms.
    subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, check=True, timeout=300)
    return Took(time.perf_counter() - begin, _children_cpu_s() - before)


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)  # os.times has a grain of 10 ms
    return used.ru_utime + used.ru_stime


def _print(figures: dict[str, dict[str, float]]) -> None:
    heads = {"wall_s": "wall s", "cpu_s": "CPU s", "of_nothing": "CPU, of nothing's", "of_numpy": "of NumPy's"}
    heads |= {"wall_s_of_peer": "wall, of the peer's", "cpu_s_of_peer": "CPU, of the peer's"}
    heads = {name: head for name, head in heads.items() if any(name in row for row in figures.values())}
    table = Table("command", *heads.values(), title="from a cold start, medians")
    for way, row in figures.items():
        if not way.endswith(_OF_PEER):
            table.add_row(way, *(f"{row[name]:.2f}" if name in row else "" for name in heads))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
