"""How many runs a second a campaign does, what a second worker adds, and what many runs leave in memory:
``python -m tools.bench.campaign``.

The paper's circle, 15 s at 1 kHz, not recorded, each with another mass. The rate is beside that of a pool of the
standard library's, as many processes that call ``hil.run``; of one worker and of two, in turns. Rates are from the
first run that is done to the last: how long processes take to begin is not in them. With ``--peer`` the campaign of
another checkout takes part in the turns. The coordinator is the process that hands out the runs and stores the answers:
what it does in a second of a processor, with workers that answer with a recorded outcome. Memory is that of one process
that does short runs, one after the other, when a tenth of them is done, a half, and all.
"""

import argparse
import json
import multiprocessing
import pkgutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

import psutil
from rich.console import Console
from rich.table import Table

import hil
from hil.addons.batch import pool
from hil.addons.batch.campaign.campaign import Campaign
from hil.addons.batch.job import Job, Outcome, plain
from hil.addons.batch.pool import MODULE, READY, Runner
from hil.scenario import from_plain

PLAN = """
scenario = "{scenario}"
samples = {runs}
keep = "none"
[set]
loop.duration_s = {seconds}
expect = []
[axes]
plant.start.mass_kg = {{ uniform = [16, 24] }}
"""
THIS = "tools.bench.campaign"
ANSWERS = 2000
LIMIT_S = 600.0
SHORT_S = 0.2


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.campaign", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=1000, help="paper circles with two workers; 0 for none")
    parser.add_argument("--seconds", type=float, default=15.0, help="of robot time each")
    parser.add_argument("--turns", type=int, default=3, help="of scaling and of the pool; the best counts; 0 for none")
    parser.add_argument("--turn-runs", type=int, default=40, help="in a turn")
    parser.add_argument("--peer", type=Path, metavar="CHECKOUT", help="with its own .venv, measured in the same turns")
    parser.add_argument("--short-runs", type=int, default=10_000, help="for memory; 0 for none")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    figures: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        if options.runs:
            figures["paper circles"] = circles(Path(folder), options.runs, options.seconds)
        if options.turns:
            figures["scaling"] = scaling(Path(folder), options)
            figures["coordinator"] = coordinator(Path(folder))
        if options.short_runs:
            figures["memory"] = memory(Path(folder), options.short_runs)
    print_figures(figures)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


def circles(folder: Path, runs: int, seconds: float) -> dict[str, float]:
    """Return how long so many circles take with two workers, with all that a campaign does."""
    began = time.perf_counter()
    rate = of_campaign(folder / "circles", runs, seconds, 2)
    wall_s = time.perf_counter() - began
    return {"runs": runs, "wall_s": wall_s, "runs_per_s": rate}


def scaling(folder: Path, options: argparse.Namespace) -> dict[str, float]:
    """Return the rates of one worker and of two, of a pool of two processes, and of the peer's two workers."""
    runs, seconds = options.turn_runs, options.seconds
    one, two, pools, peer = [], [], [], []
    for turn in range(options.turns):
        one.append(of_campaign(folder / f"one-{turn}", runs // 2, seconds, 1))
        two.append(of_campaign(folder / f"two-{turn}", runs, seconds, 2))
        pools.append(of_pool(folder / f"pool-{turn}", runs, seconds, 2))
        if options.peer is not None:
            peer.append(of_peer(folder / f"peer-{turn}.json", options.peer, runs, seconds))
    figures = {
        "one_runs_per_s": max(one),
        "two_runs_per_s": max(two),
        "pool_runs_per_s": max(pools),
        "efficiency": max(two) / (2.0 * max(one)),
        "of_pool": max(two) / max(pools),
    }
    return figures | ({"peer_runs_per_s": max(peer), "of_peer": max(two) / max(peer)} if peer else {})


def of_peer(file: Path, checkout: Path, runs: int, seconds: float) -> float:
    """Return the rate of another checkout's campaign with two workers."""
    options = {"runs": runs, "seconds": seconds, "turns": 0, "short-runs": 0, "json": file}
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    python = checkout.absolute() / ".venv" / Path(sys.executable).relative_to(sys.prefix)
    subprocess.run([python, "-m", THIS, *words], cwd=checkout, check=True, stdout=subprocess.DEVNULL)
    return float(json.loads(file.read_text(encoding="utf-8"))["paper circles"]["runs_per_s"])


def coordinator(folder: Path) -> dict[str, float]:
    """Return how many runs a second the process that hands them out can do, by the time that it has a processor."""
    begin_s = time.process_time()
    campaign = _campaign(folder / "answers", "circle_speed", ANSWERS, SHORT_S)
    prepared_s = time.process_time()
    pool.MODULE = THIS
    try:
        for _ in campaign.perform(folder / "answers" / "out", 2, LIMIT_S):
            pass
    finally:
        pool.MODULE = MODULE
    return {
        "prepared_per_s": ANSWERS / (prepared_s - begin_s),
        "answers_per_s": ANSWERS / (time.process_time() - prepared_s),
    }


def answer(kind: str) -> None:
    """Be a worker that does its first job, and answers each other one with the same outcome."""
    perform: Callable[..., Outcome] = pkgutil.resolve_name(kind)
    recorded: Outcome | None = None
    print(READY, end="", flush=True)
    for line in sys.stdin:
        job = Job(**json.loads(line))
        recorded = recorded or perform(job, from_plain(job.scenario))
        print(json.dumps(plain(recorded._replace(key=job.key))), flush=True)


def of_campaign(folder: Path, runs: int, seconds: float, workers: int) -> float:
    """Return the rate of a campaign."""
    campaign = _campaign(folder, "paper_circle", runs, seconds)

    def done() -> Iterator[int]:
        for rows in campaign.perform(folder / "out", workers, LIMIT_S):
            failed = [row["reason"] for row in rows if row["outcome"] != "passed"]
            if failed:
                raise SystemExit(f"a run failed, and its time means nothing: {failed[0]}")
            yield len(rows)

    return _rate(done())


def of_pool(folder: Path, runs: int, seconds: float, workers: int) -> float:
    """Return the rate of a pool of processes, as one would write it first."""
    campaign = _campaign(folder, "paper_circle", runs, seconds)
    sets = [dict(run.point.sets) for run in campaign.runs]
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        return _rate(pool.imap_unordered(partial(_run, "paper_circle"), sets))


def _run(scenario: str, sets: dict[str, object]) -> int:
    result = hil.run(scenario, set=sets, lenient=True)  # no baseline is of these masses
    if not result.passed:
        # Not SystemExit: for the answer of a process that has ended, the pool would wait for ever.
        raise RuntimeError(f"a run failed, and its time means nothing: {result}")
    return 1


def _rate(done: Iterable[int]) -> float:
    """Return runs a second from the first that is done on."""
    first_s: float | None = None
    count = 0
    for new in done:
        if first_s is not None:
            count += new
        elif new:
            first_s = time.perf_counter()
    if first_s is None or not count:
        raise SystemExit("too few runs for a rate; give more")
    return count / (time.perf_counter() - first_s)


def memory(folder: Path, runs: int) -> dict[str, float]:
    """Return the memory of a process after a tenth of so many runs, after a half, and after all."""
    campaign = _campaign(folder / "short", "circle_speed", runs, SHORT_S)
    runner = Runner()
    try:
        parts = (slice(0, runs // 10), slice(runs // 10, runs // 2), slice(runs // 2, None))
        tenth_mb, half_mb, all_mb = (_after(runner.run, campaign, part) for part in parts)
    finally:
        runner.close()
    figures = {"runs": runs, "tenth_mb": tenth_mb, "half_mb": half_mb, "all_mb": all_mb}
    return figures | {"growth": all_mb / half_mb}


def _after(perform: Callable[..., object], campaign: Campaign, part: slice) -> float:
    for run in campaign.runs[part]:
        perform(campaign.job(run, limit_s=LIMIT_S))
    (child,) = (one for one in psutil.Process().children() if MODULE in one.cmdline())
    return float(child.memory_info().rss) / 1e6


def _campaign(folder: Path, scenario: str, runs: int, seconds: float) -> Campaign:
    folder.mkdir()
    file = folder / "plan.toml"
    file.write_text(PLAN.format(scenario=scenario, runs=runs, seconds=seconds), encoding="utf-8")
    return Campaign(file)


def print_figures(figures: dict[str, dict[str, float]]) -> None:
    """Print the table."""
    table = Table("what", "figure", "value", title="campaigns")
    for what, row in figures.items():
        for name, value in row.items():
            table.add_row(what, name.replace("_", " "), f"{value:.4g}")
    Console().print(table)


if __name__ == "__main__":
    answer(sys.argv[1]) if sys.argv[1:] and ":" in sys.argv[1] else main()
