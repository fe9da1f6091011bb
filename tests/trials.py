"""Trials of the fault catalogue in the tests' own process."""

from hil.batch.catalogue.plan import Request, Trial, scenarios
from hil.batch.catalogue.runs import run
from hil.batch.catalogue.verdicts import Verdict, job_of, verdict_of
from hil.scenario import Scenario


def done_here(request: Request, trial: Trial) -> Verdict:
    """Return the verdict on a trial that is done in this process."""
    (scenario,) = scenarios(request, [trial])
    assert isinstance(scenario, Scenario)
    return verdict_of(trial, run(job_of(trial, scenario), scenario))
