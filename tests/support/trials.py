"""Trials of the fault catalogue in the tests' own process."""

from hil.addons.batch.catalogue.trial_run import run
from hil.addons.batch.catalogue.trials import JudgedTrial, Request, Trial, scenarios
from hil.scenario import Scenario


def done_here(request: Request, trial: Trial) -> JudgedTrial:
    """Return a trial with its outcome, done in this process."""
    (scenario,) = scenarios(request, [trial])
    assert isinstance(scenario, Scenario)
    return JudgedTrial(trial, run(trial.job(scenario), scenario))
