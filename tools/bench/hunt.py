"""Runs that ``hil hunt`` needs to find a planted defect, against random search: ``python -m tools.bench.hunt``.

The defects are those of ``planted.py``. Random search draws from the same space as a hunt. Its share of runs that break
an expectation was measured with ``--random``, and is kept in ``planted_rates.json``. On average it finds a defect after
1 / share runs; with that the mean of some hunts is compared, each with another seed. Either counts at most 20,000 runs;
a hunt that finds nothing within ``--cap`` runs counts 20,000. A defect that random search meets in more than 1 % of its
runs is not counted.

Until the condition of a defect is met, all runs are those without a defect. So one hunt without defects, and one set of
random runs, serve all defects with a condition: where one is met the run is done again with that defect, and counts if
it then breaks something. If it does not, the defect is hunted for by itself. Of conditions that are known before a run,
random search does only the runs that meet them.

By default this is one short hunt, a minute of processor time. ``--random 4000 --hunts 3 --cap 700 --page
docs/results/hunts.md`` takes ten.
"""

import argparse
import json
import math
import random
import statistics
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.addons.batch.hunt.hunt import Hunt
from hil.addons.batch.job import PASSED, Job, Outcome
from hil.addons.batch.keys import make_job
from hil.addons.batch.pool import run_jobs
from hil.addons.batch.results_page import markdown_table
from hil.addons.batch.run import run
from hil.scenario import Scenario, from_plain, load
from tools.bench.planted import DEFECTS, HEALTHY, Defect, Drawn, hunt_of
from tools.bench.planted_law import MET

RATES = Path(__file__).with_name("planted_rates.json")
CAP = 20_000
RARE, MOST = 0.01, 0.2
AT_A_TIME = 500
MORE, FEWER = 8, 4
"""How many times more runs are drawn for conditions known before a run, and fewer for defects that need their own."""
FIRST_SEED = 1000
MARKS = "<!-- by python -m tools.bench.hunt -->\n", "<!-- end -->\n"


def done(job: Job) -> Outcome:
    """Do a run in this process."""
    return run(job, from_plain(job.scenario))


def watched(job: Job, folder: Path) -> tuple[Outcome, int]:
    """Do a run without a defect, and return also which conditions it met."""
    file = folder / "signals.npz"
    outcome = done(job._replace(options={**job.options, "signals": [MET]}, signals_file=str(file)))
    with np.load(file) as signals:
        return outcome, int(signals[MET][-1])


def planted(job: Job, defect: Defect) -> Job:
    """Return a run without a defect as it is with it."""
    if not defect.has_condition or (defect.when is not None and not defect.when(Drawn(job.scenario))):
        return job
    tables = job.scenario["tables"]
    gains = tables["controller"]["gains"] | {key.rpartition(".")[2]: value for key, value in defect.sets.items()}
    controller = {**tables["controller"], "gains": gains}
    return job._replace(scenario={**job.scenario, "tables": {**tables, "controller": controller}})


def breaks(hunt: Hunt, outcome: Outcome) -> bool:
    """Return whether a run of a hunt breaks something."""
    return bool(hunt.verdict(outcome).broken)


def hunted_together(defects: Sequence[Defect], folder: Path, runs: int, seed: int) -> dict[str, int | None]:
    """Return for defects with a condition after how many runs a hunt found them; None where it did not."""
    hunt, left, apart = hunt_of(HEALTHY, folder, runs, seed), list(defects), []
    found: dict[str, int | None] = dict.fromkeys((defect.name for defect in defects), None)
    outcomes: list[Outcome] = []
    while left and (jobs := hunt.next_jobs(outcomes, runs)):
        outcomes = []
        for place, job in enumerate(jobs, 1):
            outcome, met = watched(job, folder)
            assert not breaks(hunt, outcome), f"it fails without a defect: {outcome.reason}"
            outcomes.append(outcome)
            for defect in [one for one in left if one.is_met(job.scenario, met)]:
                left.remove(defect)
                if breaks(hunt, done(planted(job, defect))):
                    found[defect.name] = hunt.runs + place
                else:
                    apart.append(defect)
    return found | {defect.name: hunted(defect, folder, runs, seed) for defect in apart}


def hunted(defect: Defect, folder: Path, runs: int, seed: int) -> int | None:
    """Return after how many runs a hunt found a defect; None where it did not."""
    hunt = hunt_of({**HEALTHY, **defect.keys}, folder, runs, seed)
    outcomes: list[Outcome] = []
    while hunt.found_case is None and (jobs := hunt.next_jobs(outcomes, runs)):
        outcomes = [done(planted(job, defect)) for job in jobs]
    if (case := hunt.found_case) is None:
        return None
    healthy = hunt_of(HEALTHY, folder, 1, seed)
    job = healthy.cases.job(case)
    assert job is not None
    assert not breaks(healthy, done(job)), f"it fails without a defect: {hunt.cases.differs(case)}"
    return hunt.runs


def broken_at_random(defects: Sequence[Defect], folder: Path, runs: int, seed: int) -> dict[str, int]:
    """Return how many of so many random runs break something with each defect; all are in one of ``groups``."""
    hunt, chance = hunt_of({**HEALTHY, **defects[0].keys}, folder, 1, seed), random.Random(seed)
    broken = dict.fromkeys((defect.name for defect in defects), 0)
    for _ in range(runs):
        params = hunt.cases.space.suggested(lambda _, n: chance.randrange(n) if n else chance.random())
        job = hunt.cases.job(hunt.cases.space.case(params))
        assert job is not None, "all cases of this space are valid"
        met = watched(job, folder)[1] if defects[0].is_seen else 0
        for defect in defects:
            if defect.keys or defect.is_met(job.scenario, met):
                broken[defect.name] += breaks(hunt, done(planted(job, defect)))
    return broken


def groups(defects: Sequence[Defect]) -> list[list[Defect]]:
    """Return the defects that one set of random runs serves: conditions on the law's inputs, on the run, and keys."""
    seen = [one for one in defects if one.is_seen]
    drawn = [one for one in defects if one.when is not None]
    return [some for some in (seen, drawn, *([one] for one in defects if one.keys)) if some]


def work(job: Job, _scenario: Scenario) -> Outcome:
    """Do some random runs or a hunt; a kind of job of the batch engine."""
    defects = [one for one in DEFECTS if one.name in job.options["defects"]]
    runs, seed = job.options["runs"], job.options["seed"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if job.options["at_random"]:
            return Outcome(job.key, PASSED, figures=broken_at_random(defects, folder, runs, seed))
        if defects[0].has_condition:
            return Outcome(job.key, PASSED, figures=hunted_together(defects, folder, runs, seed))
        return Outcome(job.key, PASSED, figures={defects[0].name: hunted(defects[0], folder, runs, seed)})


def job_of(defects: Sequence[Defect], seed: int, runs: int, *, at_random: bool) -> Job:
    """Return a job of ``work``."""
    options = {"defects": [one.name for one in defects], "seed": seed, "runs": runs, "at_random": at_random}
    return make_job(load("circle_speed"), "tools.bench.hunt:work", options, limit_s=7200.0)


def random_jobs(defects: Sequence[Defect], runs: int) -> list[Job]:
    """Return the jobs of random search. A run whose condition is known beforehand is only done where it is met."""
    seeds = range(FIRST_SEED, FIRST_SEED + runs // AT_A_TIME)
    return [
        job_of(some, seed, runs_of(some[0], 1), at_random=True)
        for some in groups(defects)
        for seed in (seeds[::FEWER] if some[0].keys else seeds)
    ]


def runs_of(defect: Defect, jobs: int) -> int:
    """Return how many random runs these jobs did for a defect."""
    return jobs * AT_A_TIME * (MORE if defect.when is not None else 1)


def hunt_jobs(defects: Sequence[Defect], hunts: int, cap: int) -> list[Job]:
    """Return the jobs of hunts: of each seed one for all defects with a condition, and one for each of the others."""
    together = [one for one in defects if one.has_condition]
    some = [*([together] if together else []), *([one] for one in defects if not one.has_condition)]
    return [job_of(one, seed, cap, at_random=False) for seed in range(1, 1 + hunts) for one in some]


def results(jobs: Sequence[Job], workers: int | None) -> dict[str, list[Any]]:
    """Do jobs, and return all figures by name."""
    figures: dict[str, list[Any]] = {}
    for outcome in run_jobs(jobs, workers, lambda done, total, _: print(f"{done} of {total}", file=sys.stderr)):
        if outcome.status != PASSED:
            raise SystemExit(f"{outcome.status}: {outcome.reason}")
        for name, value in outcome.figures.items():
            figures.setdefault(name, []).append(value)
    return figures


def row_of(defect: Defect, rate: Mapping[str, int], hunts: Sequence[int | None]) -> dict[str, Any]:
    """Return the figures of a defect."""
    share = rate["broken"] / rate["runs"]
    at_random = min(CAP, rate["runs"] / max(rate["broken"], 1))
    runs = [CAP if after is None else after for after in hunts]
    return {
        "defect": defect.name,
        "where": defect.where,
        "wrong": defect.words,
        "share": share,
        "random_mean": at_random,
        "hunts": list(hunts),
        "hunt_mean": statistics.mean(runs),
        "ratio": statistics.mean(runs) / at_random,
        "ratio_of_medians": statistics.median(runs) / (math.log(2.0) * at_random),
        "counts": 0.0 < share <= RARE,
    }


def page(rows: Sequence[Mapping[str, Any]], ratio: float) -> str:
    """Return the table for docs/results/hunts.md."""
    head = ["defect", "met at random in", "runs, random", "runs, hunts", "ratio"]
    lines = [
        [
            row["defect"],
            f"{100.0 * row['share']:.2f} %",
            f"{row['random_mean']:.0f}",
            ", ".join("not found" if after is None else str(after) for after in row["hunts"]),
            f"{row['ratio']:.2f}",
        ]
        for row in sorted(rows, key=lambda row: row["ratio"])
    ]
    slower = sum(row["ratio"] >= 1.0 for row in rows)
    of_medians = statistics.median(row["ratio_of_medians"] for row in rows)
    words = f"""
Runs at random are one in as many as meet the defect (`tools/bench/planted_rates.json` has the counts). The runs of each
hunt, with another seed, stand beside them. The ratio is that of the means; a hunt that found nothing counts {CAP} runs.
Of {len(rows)} defects the median ratio is {ratio:.2f}; of medians in place of means it is {of_medians:.2f}.
For {slower} defects a hunt is slower than random search.
"""
    return MARKS[0] + "\n" + markdown_table([head, *lines]).rstrip() + "\n" + words + "\n" + MARKS[1]


def main() -> int:
    """Measure, print, and return 1 where a hunt needs more than a fifth of the runs of random search."""
    parser = argparse.ArgumentParser(prog="tools.bench.hunt", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--defect", choices=[one.name for one in DEFECTS], action="append", help="only these")
    parser.add_argument("--hunts", type=int, default=1, help="hunts a defect, each with another seed")
    parser.add_argument("--cap", type=int, default=400, help="runs of a hunt at most")
    parser.add_argument("--random", type=int, default=0, metavar="RUNS", help="measure the rates anew")
    parser.add_argument("--jobs", type=int, help="workers; by default one a processor")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the table between its marks in a page")
    options = parser.parse_args()
    defects = [one for one in DEFECTS if options.defect is None or one.name in options.defect]
    rates = json.loads(RATES.read_text(encoding="utf-8")) if RATES.exists() else {}
    if options.random:
        found = results(random_jobs(defects, options.random), options.jobs)
        rates |= {
            one.name: {"runs": runs_of(one, len(found[one.name])), "broken": sum(found[one.name])} for one in defects
        }
        RATES.write_text(json.dumps(rates, indent=1) + "\n", encoding="utf-8")
    hunts = results(hunt_jobs(defects, options.hunts, options.cap), options.jobs)
    rows = [row_of(one, rates[one.name], hunts[one.name]) for one in defects]
    counted = [row for row in rows if row["counts"]]
    ratio = statistics.median(row["ratio"] for row in counted)
    for row in rows:
        print(json.dumps(row))
    print(f"median ratio of {len(counted)} defects: {ratio:.3f}")
    if options.json is not None:
        options.json.write_text(json.dumps({"rows": rows, "ratio_median": ratio}, indent=1), encoding="utf-8")
    if options.page is not None:
        text = options.page.read_text(encoding="utf-8")
        before, after = text.partition(MARKS[0])[0], text.partition(MARKS[1])[2]
        options.page.write_text(before + page(counted, ratio) + after, encoding="utf-8")
    return 0 if ratio <= MOST else 1


if __name__ == "__main__":
    sys.exit(main())
