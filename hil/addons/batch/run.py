"""Does one job in a worker process: runs its scenario, records it on request, and judges it."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hil.addons.batch.columns import run_columns
from hil.addons.batch.job import ALWAYS, ENDED, FAILED, IF_FAILED, PASSED, REFUSED, Job, Outcome
from hil.core.errors import BadInputError, HilError
from hil.judge.result import RunResult
from hil.judge.run_text import why_not_passed
from hil.laws.law_registry import forget_law
from hil.robot.virtual import KeptRobot, MakeRobot
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import Scenario


def run(job: Job, scenario: Scenario) -> Outcome:
    """Run a scenario and return all figures of ``run_columns``; the usual kind of job.

    Details: ``reasons`` has a sentence for each figure that is None; ``undriven`` is a sentence if the robot was not
    driven in more ticks than ``[allow]`` permits, else None. ``claims`` has margin and text of each expectation, then
    of each limit of ``[allow]``. The signals in ``options["signals"]`` are saved in the job's ``signals_file``.

    A run that is to be recorded if it fails is recorded from the start in real time. In lockstep it repeats to the bit,
    so it is run again with the recorder only if it failed.
    """
    at_once = job.record == ALWAYS or (job.record == IF_FAILED and scenario.loop.mode == "realtime")
    outcome = _run(job, scenario, record=at_once)
    if job.record == IF_FAILED and not at_once and outcome.status in (FAILED, ENDED):
        again = _run(job, scenario, record=True)
        reason = outcome.reason if again.recording else f"{outcome.reason}; it could not be recorded: {again.reason}"
        return outcome._replace(reason=reason, recording=again.recording)
    return outcome


def _run(job: Job, scenario: Scenario, *, record: bool) -> Outcome:
    path = Path(job.recording) if record else None

    def judge(result: RunResult) -> Outcome:
        if job.signals_file:
            signals: dict[str, Any] = {name: result.signals[name] for name in job.options["signals"]}
            np.savez(job.signals_file, **signals)
        judged = result.run
        undriven = next((row.text for row in judged.allow if row.name in _UNDRIVEN and not row.passed), None)
        status = FAILED if result.failure is None else ENDED
        reason = next((words for _, words in why_not_passed(judged)), None)  # first what ended it
        if result.passed:
            status, reason = PASSED, None
        claims = [
            {name: getattr(row, name, None) for name in ("margin", "text")} for row in (*judged.expect, *judged.allow)
        ]
        details = {"reasons": judged.reasons, "undriven": undriven, "claims": claims}
        return Outcome(job.key, status, reason, run_columns(judged), details)

    options = RunOptions(
        record=path, allow_motion=job.allow_motion, make_robot=kept_robot(), keep_signals=bool(job.signals_file)
    )
    outcome = attempt(job, scenario, judge, options)
    is_kept = path is not None and path.exists() and (job.record == ALWAYS or outcome.status not in (PASSED, REFUSED))
    return outcome._replace(recording=job.recording) if is_kept else outcome


def attempt(job: Job, scenario: Scenario, judge: Callable[[RunResult], Outcome], options: RunOptions) -> Outcome:
    """Run a scenario with these options and return what ``judge`` says of it.

    A run that is refused or ends with a HilError is an outcome too. Any other exception is raised: it is a defect of
    this package or of a law, and ends the process. The law is imported anew, so that nothing is left of an earlier run.
    """
    try:
        forget_law(scenario.controller.law, scenario.directory)
        return judge(run_scenario(scenario, options))
    except BadInputError as error:
        return Outcome(job.key, REFUSED, str(error))
    except HilError as error:
        return Outcome(job.key, ENDED, str(error))


_UNDRIVEN = ("stale_ticks", "held_ticks")
_kept = functools.cache(KeptRobot)


def kept_robot() -> MakeRobot:
    """Return what makes the robot of this process, whose FMU stays open from run to run."""
    return _kept().robot
