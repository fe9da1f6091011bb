"""How laws hold in random cases: ``hil compare --robust N``. Each run gets one verdict, from its last third."""

import csv
import io
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.addons.batch.campaign import campaign_page
from hil.addons.batch.campaign.judged import Judged
from hil.addons.batch.columns import KEY, run_columns
from hil.addons.batch.comparison.comparison import LINK, MODE, Entry, check_laws, entries
from hil.addons.batch.comparison.random_cases import RandomCase, cases
from hil.addons.batch.job import ENDED, FAILED, LOST, PASSED, REFUSED, Job, Outcome
from hil.addons.batch.kept_runs import KeptRuns
from hil.addons.batch.keys import make_job
from hil.addons.batch.results_page import Plot, Results, Table
from hil.addons.batch.run import attempt, kept_robot
from hil.addons.batch.store import Row, read_rows
from hil.cli.output import next_command
from hil.core.printable import command
from hil.core.types import WHEEL_NAMES
from hil.judge.effort import Effort
from hil.judge.measure import NoFigureError, RunSetup, Series
from hil.judge.result import RunResult
from hil.laws.law_registry import LAWS
from hil.runtime.assembly import RunOptions
from hil.runtime.run_parts import RunParts
from hil.scenario import Scenario, read, set_texts

KIND = f"{__name__}:run"
"""The kind of job that runs a case and measures its last third."""
CSV = "cases.csv"
"""The file with a line for each run, in the folder of a comparison."""
HELD = "held"
VERDICTS = (HELD, "over bound", "limit cycle", "diverged", "stopped", "failed")
"""From best to worst; a run has the worst that fits.

Over bound: the error, rms over the last third, is above 3 mm and three of the deviations that the estimate of the state
told. Limit cycle: the torque varies by more than 20 N·m/s a wheel, and twice what the reference itself needs. Diverged:
more than 100 mm away, rms. Stopped: the robot, or the link, ended the run. Failed: the law raised an error, or the run
hung.
"""
_JUDGED = VERDICTS.index("stopped")
_OF_STATUS = {ENDED: "stopped", LOST: "failed", REFUSED: REFUSED}
_DIVERGED_M, _OFF_M, _DEVIATIONS = 0.1, 0.003, 3.0
_VARIATION_N_M_S, _TIMES = 20.0, 2.0
_CURRENTS = tuple(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES)
_VARIATION = "torque_variation_n_m_per_s"
_LOG = ("mass_factor", "friction_factor", "counts_per_revolution")
"""Axes that pictures show logarithmically."""
_FIGURES = ("error_m", "told_m", "variation", "needed")


class Tried(NamedTuple):
    """A law in a case, with its row once it is done; ``command`` repeats it."""

    entry: Entry
    case: RandomCase
    job: Job
    command: Sequence[str]
    row: Row | None = None

    @property
    def error_m(self) -> float | None:
        """The planar error, rms over the last third."""
        return None if self.row is None else self.row.get("error_m")

    @property
    def verdict(self) -> str:
        """One of ``VERDICTS``, ``refused``, or ``not done``."""
        if self.row is None:
            return "not done"
        return _OF_STATUS.get(self.row["outcome"]) or str(self.row["verdict"])

    @property
    def reason(self) -> str | None:
        """What the run says on why it did not hold."""
        return None if self.row is None else self.row["reason"]

    def plain(self) -> dict[str, Any]:
        """Return it as plain values, for JSON and CSV."""
        return {
            "law": self.entry.label,
            "case": self.case.number,
            "can_follow": self.case.can_follow,
            "verdict": self.verdict,
            "reason": self.reason,
            **{name: (self.row or {}).get(name) for name in _FIGURES},
            **self.case.axes,
            "repeat": command(*self.command),
        }

    def lines(self) -> Iterator[str]:
        """Yield the verdict, and the command that repeats the run."""
        why = self.reason or self.verdict
        if self.verdict not in VERDICTS[:_JUDGED]:  # its reason does not begin with the verdict
            why = f"{self.verdict}: {why}"
        follows = "" if self.case.can_follow else " (which wheels cannot follow)"
        yield f"{self.entry.label}, case {self.case.number}{follows}, {why}"
        yield f"  {next_command(*self.command)}"


class Robust:
    """Laws (without any, all shipped ones) in the same ``count`` cases; a key among ``sets`` is not drawn.

    Raises BadInputError as ``compare`` does.
    """

    def __init__(
        self, laws: Sequence[str], scenario: str, count: int, sets: Sequence[str], seed: int | None = None
    ) -> None:
        check_laws(scenario, sets)
        sources = read(scenario)
        self.base = base = sources.scenario(set=sets, mode=MODE, link=LINK, seed=seed)
        given = [text.partition("=")[0].strip() for text in sets]
        drawn = cases(base, count, base.loop.seed, given)
        texts = [[*sets, *set_texts(case.sets)] for case in drawn]
        scenarios = [sources.scenario(set=one, mode=MODE, link=LINK, seed=seed) for one in texts]
        seeds = () if seed is None else ("--seed", str(seed))
        self.trials = [
            Tried(
                entry,
                case,
                make_job(entry.scenario(one), KIND),
                (*_command(scenario, sets, case, entry), *seeds),
            )
            for entry in entries(laws or list(LAWS.shipped), scenario, sets)
            for case, one in zip(drawn, scenarios, strict=True)
        ]

    @cached_property
    def _kept(self) -> KeptRuns:
        """The runs as those of a campaign over what is drawn, so that its page can show them."""
        first = self.trials[0].case
        kinds = {
            name: "list" if isinstance(value, str) else "log_uniform" if name in _LOG else "uniform"
            for name, value in first.axes.items()
        }
        about = {
            "name": f"random cases of {self.base.name}, seed {self.base.loop.seed}",
            "scenario": self.base.name,
            "laws": list(dict.fromkeys(one.entry.label for one in self.trials)),
            "faults": ["none"],
            "seeds": 1,
            "samples": len({one.case.number for one in self.trials}),
            "axes": {"can_follow": {"kind": "list", "values": ["yes", "no"]}}
            | {name: {"kind": kind, "values": self._range(name, kind)} for name, kind in kinds.items()},
            "keep": "none",
        }
        return KeptRuns(about, [self._columns(one) for one in self.trials])

    def _range(self, name: str, kind: str) -> list[str | float]:
        values = dict.fromkeys(one.case.axes[name] for one in self.trials)
        return sorted(values) if kind == "list" else [min(values), max(values)]

    def _columns(self, one: Tried) -> dict[str, Any]:
        own = {"law": one.entry.label, "fault": "none", "seed": self.base.loop.seed, "sample": one.case.number}
        follows = {"can_follow": "yes" if one.case.can_follow else "no"}
        return {KEY: one.job.key, **own, **follows, **one.case.axes, "repeat": command(*one.command)}

    def perform(self, folder: Path, workers: int | None = None, limit_s: float = 120.0) -> Iterator[Sequence[Row]]:
        """Do the runs that a folder does not have, and yield their rows, as ``KeptRuns.perform``."""
        jobs = {one.job.key: one.job for one in self.trials}
        for rows in self._kept.perform(folder, lambda key, _: jobs[key]._replace(limit_s=limit_s), workers):
            self._take({row[KEY]: row for row in rows})
            yield rows

    def read(self, folder: Path) -> None:
        """Take the rows of a folder, also those whose writing was interrupted after they were whole."""
        self._take(read_rows(folder))

    def _take(self, rows: Mapping[str, Row]) -> None:
        self.trials = [one._replace(row=rows.get(one.job.key, one.row)) for one in self.trials]

    @property
    def done(self) -> int:
        """How many runs are done."""
        return sum(one.row is not None for one in self.trials)

    @property
    def failed(self) -> int:
        """How many of these did not hold."""
        return sum(one.row is not None and one.verdict != HELD for one in self.trials)

    def csv(self) -> str:
        """Return a line for each run that is done: what was drawn, the verdict and the figures."""
        text = io.StringIO()
        rows = [one.plain() for one in self.trials if one.row is not None]
        writer = csv.DictWriter(text, list(self.trials[0].plain()), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return text.getvalue()


def results(base: Scenario, trials: Sequence[Tried], folder: Path, drawn: Sequence[Plot] = ()) -> Results:
    """Return what laws did in the cases that are done: how often each held, and what repeats each other run."""
    tries = [one for one in trials if one.row is not None]
    failed, left = sum(one.verdict == VERDICTS[-1] for one in tries), len(trials) - len(tries)
    verdict = f"{failed} of {len(tries)} runs failed" if failed else f"{len(tries)} runs, none of which failed"
    name, seed = base.name, base.loop.seed
    return Results(
        f"Laws in random cases of {name}, seed {seed}",
        not failed,
        f"{verdict} ({left} of {len(trials)} are not done yet)" if left else verdict,
        [
            *(line for one in tries if one.verdict != HELD for line in one.lines()),
            f"each run is a line of {folder / CSV}",
            next_command("hil", "campaign", "report", folder),
        ],
        [Table("Random cases", list(_rows(tries)), numbers=range(2, 5 + len(VERDICTS)))],
        drawn,
        {
            "scenario": name,
            "seed": seed,
            "passed": not failed,
            "folder": str(folder),
            "trials": [one.plain() for one in tries],
        },
    )


def plots(folder: Path) -> list[Plot]:
    """Return those of a campaign over what was drawn; none where no run is done."""
    return list(campaign_page.plots(Judged(folder)))


def _rows(tries: Sequence[Tried]) -> Iterator[tuple[str, ...]]:
    """Yield a table: how often each verdict was given, with the references that wheels can follow and the rest."""
    yield ("law", "the wheels", "cases", *VERDICTS, REFUSED, "rms mm, median", "worst")
    words = {True: "can follow", False: "cannot"}
    for label, follows in itertools.product(dict.fromkeys(one.entry.label for one in tries), words):
        some = [one for one in tries if (one.entry.label, one.case.can_follow) == (label, follows)]
        if some:
            count = Counter(one.verdict for one in some)
            errors = [1e3 * one.error_m for one in some if one.error_m is not None and math.isfinite(one.error_m)]
            spread = (f"{np.median(errors):.3f}", f"{max(errors):.3g}") if errors else ("-", "-")
            yield (label, words[follows], str(len(some)), *(str(count[one]) for one in (*VERDICTS, REFUSED)), *spread)


def _command(scenario: str, sets: Sequence[str], case: RandomCase, entry: Entry) -> list[str]:
    law = {"controller.law": entry.label.partition(",")[0]}
    mode = case.sets.get("controller.command")
    gains = {
        f"controller.gains.{name}": value
        for of, own in entry.gains.items()
        if mode is None or of.name.lower() == mode
        for name, value in own.items()
    }
    texts = [*sets, *set_texts({**case.sets, **law, **gains})]
    return ["hil", "run", scenario, "--lenient", *(word for text in texts for word in ("--set", text))]


def verdict_of(figures: Mapping[str, float]) -> str:
    """Return the verdict of a run that came to its end."""
    if not figures["error_m"] <= _DIVERGED_M:  # NaN is far too
        return "diverged"
    if figures["variation"] > max(_VARIATION_N_M_S, _TIMES * figures["needed"]):
        return "limit cycle"
    return "over bound" if figures["error_m"] > _OFF_M + _DEVIATIONS * figures["told_m"] else HELD


def run(job: Job, scenario: Scenario) -> Outcome:
    """Run a case and measure its last third: the kind of job of this module, for worker processes.

    Besides those of a campaign the figures are ``error_m``, the planar error (rms); ``told_m``, the deviation that the
    estimator told of its position (rms), 0 of the true one; ``variation``, the torque's [N·m/s a wheel]; ``needed``,
    that of the torques that the reference takes by the true mass and friction; and ``verdict``. The reason of a run
    that did not hold is that, and the newest warning of its events.
    """

    def judge(result: RunResult) -> Outcome:
        if result.failure is not None:
            return Outcome(job.key, ENDED, str(result.failure))
        t_s = result.signals["loop.t_s"]
        last = t_s >= t_s[-1] * 2.0 / 3.0
        error_m = result.signals["error.planar_m"][last]
        told_m = np.nan_to_num(result.signals["estimator.sigma_position_m"][last])
        constant = scenario.firmware.torque_constant_n_m_a
        currents = {name: result.signals[name][last] for name in _CURRENTS}
        figures = {
            "error_m": float(np.sqrt(np.mean(error_m**2))),
            "told_m": float(np.sqrt(np.mean(told_m**2))),
            "variation": _variation(t_s[last], currents, constant),
            "needed": _variation(t_s[last], _needed_a(scenario, t_s[last], constant), constant),
        }
        verdict = verdict_of(figures)
        found = {**run_columns(result.run), **figures, "verdict": verdict}
        if verdict == HELD:
            return Outcome(job.key, PASSED, None, found)
        warned = [event.text for event in result.events if event.level in ("WARN", "ERROR")]
        return Outcome(job.key, FAILED, f"{verdict}; {warned[-1]}" if warned else verdict, found)

    return attempt(job, scenario, judge, RunOptions(make_robot=kept_robot(), keep_signals=True))


def _variation(t_s: Series, currents_a: Mapping[str, Series], torque_constant_n_m_a: float) -> float:
    measure = Effort(RunSetup(torque_constant_n_m_a))
    measure.add({"loop.t_s": t_s, **currents_a})
    try:
        return measure.value(_VARIATION)
    except NoFigureError:  # a board that measures no currents
        return math.nan


def _needed_a(scenario: Scenario, t_s: Series, torque_constant_n_m_a: float) -> dict[str, Series]:
    """Return the currents with which the true robot would follow its reference without an error."""
    start = scenario.plant.start
    names = ("mass_kg", "inertia_kg_m2", "friction_coefficient")
    true = replace(scenario.robot, **{name: float(start[name]) for name in names if name in start})
    source = RunParts(scenario).reference
    torques = []
    for one in t_s:
        pose, twist, acceleration = source.at(float(one))
        torques.append(true.wheel_torques(acceleration, twist, pose.heading_rad, twist))
    return dict(zip(_CURRENTS, np.array(torques).T / torque_constant_n_m_a, strict=True))
