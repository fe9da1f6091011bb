"""What does a run of a campaign: a process that imports once, keeps its FMU open, and records only what is kept."""

import functools
import time
from pathlib import Path

from hil.batch.campaign.jobs import ALWAYS, IF_FAILED, Job
from hil.batch.campaign.keys import key_of
from hil.batch.campaign.rows import ENDED, FAILED, FOREIGN, PASSED, REFUSED, Said, figures_of, why_failed
from hil.core.errors import BadInputError, HilError
from hil.judge.results import RunResult
from hil.laws.registry import forget_law
from hil.robot.virtual import KeptRobot
from hil.runtime.assembly import run_scenario
from hil.scenario import Scenario, from_plain


def perform(job: Job) -> Said:
    """Do a run. Whatever is no HilError is raised: it is a defect of ours, or of a law that ends its process."""
    began = time.monotonic()
    scenario = from_plain(job.scenario)
    if key_of(scenario) != job.key:
        return Said({}, FOREIGN, None, time.monotonic() - began)
    at_once = job.recorded == ALWAYS or (job.recorded == IF_FAILED and scenario.loop.mode == "realtime")
    said = _run(scenario, job, began, record=at_once)
    if job.recorded == IF_FAILED and not at_once and said.outcome in (FAILED, ENDED):
        # In lockstep it repeats to the bit, and most runs are spared the recorder.
        again = _run(scenario, job, began, record=True)
        reason = said.reason if again.recording else f"{said.reason}; it could not be recorded: {again.reason}"
        return said._replace(reason=reason, wall_s=again.wall_s, recording=again.recording)
    return said


@functools.cache
def _kept() -> KeptRobot:
    """Return the robot of this process."""
    return KeptRobot()


def _run(scenario: Scenario, job: Job, began: float, *, record: bool) -> Said:
    path = Path(job.recording) if record else None
    try:
        for law in (scenario.controller.law, *scenario.controller.shadow):
            forget_law(law, scenario.directory)
        result = run_scenario(
            scenario, record=path, allow_motion=job.allow_motion, make_robot=_kept().robot, keep_signals=False
        )
    except BadInputError as error:
        return Said({}, REFUSED, str(error), time.monotonic() - began)
    except HilError as error:
        return Said({}, ENDED, str(error), time.monotonic() - began)
    outcome, reason = _outcome(result)
    kept = path is not None and path.exists() and (job.recorded == ALWAYS or outcome != PASSED)
    return Said(figures_of(result.metrics), outcome, reason, time.monotonic() - began, job.recording if kept else None)


def _outcome(result: RunResult) -> tuple[str, str | None]:
    if result.failure is not None:
        return ENDED, str(result.failure)
    return (PASSED, None) if result.passed else (FAILED, why_failed(result.metrics))
