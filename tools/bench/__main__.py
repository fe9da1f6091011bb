"""All benches in one table and one JSON file: ``python -m tools.bench [--short] [--json FILE]``.

Each runs in a process of its own and measures against named peers in the same run. Judged are ratios, never times, with
margins for a busy machine: exit code 1 means a clear loss. ``--short`` is for CI, and leaves out those that need a
quiet machine and minutes.
"""

import argparse
import json
import operator
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[2]
AT_LEAST, AT_MOST = operator.ge, operator.le
WORDS: dict[Callable[..., bool], str] = {AT_LEAST: "at least", AT_MOST: "at most"}


class Row(NamedTuple):
    """A ratio of a bench: where it is in its figures, and the limit in a whole run and in a short one."""

    what: str
    place: tuple[str, ...]
    holds: Callable[[float, float], bool]
    limit: float
    short_limit: float


class Bench(NamedTuple):
    """A bench: its module in ``tools.bench``, its arguments in a short run (None where it is left out), its rows."""

    module: str
    short: tuple[str, ...] | None
    rows: tuple[Row, ...]


BENCHES = (
    Bench(
        "tick",
        ("--turns", "2", "--seconds", "1.5", "--naive-seconds", "1"),
        (
            Row("tick: loop of FMPy, cantools, python-can, NumPy, in ours", ("not recorded", "ratio"), AT_LEAST, 8, 5),
            Row("the same with rr.log for each signal, ours recorded", ("recorded", "ratio"), AT_LEAST, 25, 20),
            Row(
                "a tick with a frame fault armed for later", ("frame fault, armed for later", "of_plain"), AT_MOST, 2, 3
            ),
            Row("a tick with a frame fault on feedback", ("frame fault on feedback", "of_plain"), AT_MOST, 2, 3),
            Row("a tick with latency of 2 + 2 ms", ("latency of 2 + 2 ms", "of_plain"), AT_MOST, 2, 3),
            Row("a tick with a trace", ("trace", "of_plain"), AT_MOST, 2, 3),
        ),
    ),
    Bench(
        "controller_step",
        ("--repeats", "3"),
        (Row("AFDSC: in NumPy, in ours", ("afdsc, torque", "numpy_times"), AT_LEAST, 8, 6),),
    ),
    Bench(
        "fmu_step",
        ("--repeats", "3"),
        (
            Row(
                "step of the FMU: what ours adds, of what FMPy's class adds",
                ("FMI 2, 21 outputs read", "hil, one C call a tick"),
                AT_MOST,
                0.1,
                0.2,
            ),
        ),
    ),
    Bench(
        "window_stepper",
        ("--repeats", "3"),
        tuple(
            Row(f"windows, {case}: ours, in a C loop over the FMU", (case, "times"), AT_MOST, 2, 3)
            for case in ("rigid, steps of 10 ms", "slip, friction, steps of 10 ms")
        ),
    ),
    Bench(
        "can_foreign",
        ("--frames", "1000", "--repeats", "5"),
        (Row("foreign CAN frame: ours, in python-can's recv", ("CanLink.receive", "of_recv_loop"), AT_MOST, 3, 4),),
    ),
    Bench(
        "startup",
        ("--repeats", "1"),
        (
            Row("hil --help, in import numpy", ("hil --help", "of_numpy"), AT_MOST, 1.5, 2.5),
            Row("hil run paper_circle, in import numpy", ("hil run", "of_numpy"), AT_MOST, 80, 120),
        ),
    ),
    Bench(
        "telemetry_cost",
        None,
        (Row("recording, in rr.log for each signal", ("added to a tick, of rr.log's", "value"), AT_MOST, 0.05, 0.05),),
    ),
    Bench("lateness", None, ()),
    Bench(
        "realtime_tick",
        None,
        (Row("ticks skipped beyond a sleeper's [%]", ("skipped", "beyond_asleep_percent"), AT_MOST, 1.0, 1.0),),
    ),
    Bench(
        "campaign",
        ("--runs", "0", "--seconds", "1", "--turns", "1", "--turn-runs", "10", "--short-runs", "100"),
        (
            Row(
                "campaign: runs a second, in a pool's of the standard library",
                ("scaling", "of_pool"),
                AT_LEAST,
                0.95,
                0.5,
            ),
            Row("campaign: two workers, in twice one", ("scaling", "efficiency"), AT_LEAST, 0.9, 0.3),
            Row("campaign: memory after all short runs, in that after half", ("memory", "growth"), AT_MOST, 1.03, 1.1),
        ),
    ),
)


def main() -> None:
    """Run, print, write and judge."""
    parser = argparse.ArgumentParser(prog="tools.bench", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--short", action="store_true", help="for CI: fewer turns, wider limits, the short ones alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures")
    options = parser.parse_args()
    table = Table("ratio", "measured", "expected", "", title="benches")
    figures: dict[str, Any] = {}
    lost = []
    for bench in BENCHES:
        if options.short and bench.short is None:
            continue
        figures[bench.module] = measured = _run(bench, short=options.short)
        for row in bench.rows:
            value, expected, held = judge(row, measured, short=options.short)
            table.add_row(row.what, f"{value:.3g}", expected, "ok" if held else "LOST")
            if not held:
                lost.append(f"{row.what}: {value:.3g}, expected {expected}")
    Console(width=120).print(table)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    if lost:
        raise SystemExit("\n".join(lost))


def judge(row: Row, figures: Mapping[str, Any], *, short: bool) -> tuple[float, str, bool]:
    """Return a ratio from the figures of its bench, a text on its expected value, and whether it is met."""
    value: Any = figures
    for key in row.place:
        value = value[key]
    limit = row.short_limit if short else row.limit
    return value, f"{WORDS[row.holds]} {limit:g}", row.holds(value, limit)


def _run(bench: Bench, *, short: bool) -> dict[str, Any]:
    """Run a bench and return its figures."""
    arguments = (bench.short or ()) if short else ()
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "figures.json")
        command = [sys.executable, "-m", f"tools.bench.{bench.module}", *arguments, "--json", str(path)]
        done = subprocess.run(command, cwd=ROOT, stdout=sys.stderr if not short else subprocess.DEVNULL, check=False)
        if not path.exists():
            raise SystemExit(f"{' '.join(command[1:])} ended with exit code {done.returncode} and without figures")
        figures: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    print(f"{bench.module}: {time.perf_counter() - begin:.1f} s", file=sys.stderr)
    return figures


if __name__ == "__main__":
    main()
