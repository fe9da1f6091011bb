"""How laws hold in random cases: ``hil compare --robust N``. Each run gets one verdict, from its last third."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hil.batch.comparison.cases import Case, cases
from hil.batch.comparison.plan import LINK, MODE, check_laws, entries
from hil.batch.comparison.result import Entry
from hil.batch.job import ENDED, PASSED, REFUSED, Job, Outcome
from hil.batch.keys import make_job
from hil.batch.plan import OnProgress, run_jobs
from hil.batch.run import attempt, kept_robot
from hil.core.types import WHEEL_NAMES
from hil.judge.effort import Effort
from hil.judge.measure import NoFigureError, RunSetup, Series
from hil.laws.registry import SHIPPED
from hil.review.result import RunResult
from hil.runtime.assembly import RunOptions
from hil.runtime.parts import RunParts
from hil.scenario import Scenario, read, set_texts

KIND = f"{__name__}:run"
"""The kind of job that runs a case and measures its last third."""
FAILED = "failed"
VERDICTS = ("held", "over 3 mm", "limit cycle", "diverged", "stopped", FAILED)
"""From best to worst; a run has the worst that fits.

Over 3 mm: the error, rms over the last third. Limit cycle: the torque varies by more than 20 N·m/s a wheel, and twice
what the reference itself needs. Diverged: more than 100 mm away, rms. Stopped: the robot, or the link, ended the run.
Failed: the law raised an error, or the run hung.
"""
_FAR_M, _OFF_M = 0.1, 0.003
_VARIATION_N_M_S, _TIMES = 20.0, 2.0
_CURRENTS = tuple(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES)
_VARIATION = "torque_variation_n_m_per_s"


class Trial(NamedTuple):
    """A law in a case; ``command`` repeats it."""

    entry: Entry
    case: Case
    outcome: Outcome
    command: Sequence[str]

    @property
    def error_m(self) -> float | None:
        """The planar error, rms over the last third."""
        return self.outcome.figures.get("error_m")

    @property
    def verdict(self) -> str:
        """One of ``VERDICTS``, or ``refused``."""
        status, figures = self.outcome.status, self.outcome.figures
        if status == REFUSED:
            return REFUSED
        if status != PASSED:
            return "stopped" if status == ENDED else FAILED
        if not figures["error_m"] <= _FAR_M:  # NaN is far too
            return "diverged"
        if figures["variation"] > max(_VARIATION_N_M_S, _TIMES * figures["needed"]):
            return "limit cycle"
        return "over 3 mm" if figures["error_m"] > _OFF_M else "held"


class Robustness(NamedTuple):
    """All trials, law by law, each in the order of the cases."""

    scenario: str
    seed: int
    trials: Sequence[Trial]

    def laws(self) -> dict[str, list[Trial]]:
        """Return the trials of each law, by its label."""
        laws: dict[str, list[Trial]] = {}
        for trial in self.trials:
            laws.setdefault(trial.entry.label, []).append(trial)
        return laws

    @property
    def has_failed(self) -> bool:
        """Whether a run failed, which says nothing of the case."""
        return any(trial.verdict == FAILED for trial in self.trials)

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield a table: how often each verdict was given, with the references that wheels can follow and the rest."""
        yield ("law", "the wheels", "cases", *VERDICTS, REFUSED, "rms mm, median", "worst")
        for label, trials in self.laws().items():
            for words, can_follow in (("can follow", True), ("cannot", False)):
                some = [trial for trial in trials if trial.case.can_follow is can_follow]
                if not some:
                    continue
                count = Counter(trial.verdict for trial in some)
                errors = [1e3 * one.error_m for one in some if one.error_m is not None and math.isfinite(one.error_m)]
                spread = (f"{np.median(errors):.3f}", f"{max(errors):.3g}") if errors else ("-", "-")
                yield (label, words, str(len(some)), *(str(count[one]) for one in (*VERDICTS, REFUSED)), *spread)

    def plain(self) -> dict[str, Any]:
        """Return everything as plain values, for JSON."""
        trials = [
            {
                "law": trial.entry.label,
                "case": trial.case.number,
                "can_follow": trial.case.can_follow,
                "verdict": trial.verdict,
                "reason": trial.outcome.reason,
                "figures": dict(trial.outcome.figures),
                "command": list(trial.command),
            }
            for trial in self.trials
        ]
        return {"scenario": self.scenario, "seed": self.seed, "passed": not self.has_failed, "trials": trials}


def try_laws(
    laws: Sequence[str],
    scenario: str,
    count: int,
    sets: Sequence[str],
    seed: int | None = None,
    *,
    workers: int | None = None,
    limit_s: float = 120.0,
    on_progress: OnProgress | None = None,
) -> Robustness:
    """Run laws (without any, all shipped ones) in the same ``count`` cases; workers and limits as in ``compare``.

    A key among ``sets`` is not drawn. Raises BadInputError as ``compare`` does.
    """
    check_laws(scenario, sets)
    sources = read(scenario)
    base = sources.scenario(set=sets, mode=MODE, link=LINK, seed=seed)
    given = [text.partition("=")[0].strip() for text in sets]
    drawn = cases(base, count, base.loop.seed, given)
    scenarios = [
        sources.scenario(set=[*sets, *set_texts(case.sets)], mode=MODE, link=LINK, seed=seed) for case in drawn
    ]
    named = entries(laws or list(SHIPPED), scenario, sets)
    planned = [
        (entry, case, _job(one, entry, limit_s)) for entry in named for case, one in zip(drawn, scenarios, strict=True)
    ]
    outcomes = run_jobs([job for _, _, job in planned], workers, on_progress)
    seeds = () if seed is None else ("--seed", str(seed))
    trials = [
        Trial(entry, case, outcome, (*_command(scenario, sets, case, entry), *seeds))
        for (entry, case, _), outcome in zip(planned, outcomes, strict=True)
    ]
    return Robustness(base.name, base.loop.seed, trials)


def _job(scenario: Scenario, entry: Entry, limit_s: float) -> Job:
    controller = replace(scenario.controller, law=entry.law, gains=dict(entry.gains[scenario.controller.mode]))
    return make_job(replace(scenario, controller=controller, expect=()), KIND, limit_s=limit_s)


def _command(scenario: str, sets: Sequence[str], case: Case, entry: Entry) -> list[str]:
    """Return the words of the command that runs a law in a case."""
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


def run(job: Job, scenario: Scenario) -> Outcome:
    """Run a case and measure its last third: the kind of job of this module, for worker processes.

    Figures are ``error_m``, the planar error (rms); ``variation``, the torque's [N·m/s a wheel]; and ``needed``, that
    of the torques that the reference takes by the true mass and friction.
    """

    def judge(result: RunResult) -> Outcome:
        if result.failure is not None:
            return Outcome(job.key, ENDED, str(result.failure))
        t_s = result.signals["loop.t_s"]
        last = t_s >= t_s[-1] * 2.0 / 3.0
        error_m = result.signals["error.planar_m"][last]
        constant = scenario.firmware.torque_constant_n_m_a
        currents = {name: result.signals[name][last] for name in _CURRENTS}
        figures = {
            "error_m": float(np.sqrt(np.mean(error_m**2))),
            "variation": _variation(t_s[last], currents, constant),
            "needed": _variation(t_s[last], _needed_a(scenario, t_s[last], constant), constant),
        }
        return Outcome(job.key, PASSED, None, figures)

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
