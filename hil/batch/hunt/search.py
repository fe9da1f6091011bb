"""Chooses the runs of a hunt: first one change alone each, then a search guided by the margins so far.

The search is that of Optuna, a tree-structured Parzen estimator (Bergstra et al. 2011). It needs few runs, and takes
numbers, choices, and faults that have numbers of their own. It begins anew after some runs, since it may be stuck.
"""

import importlib.util
import warnings
from collections.abc import Generator, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from hil.batch.hunt.space import Params, Space
from hil.core.errors import BadInputError

if TYPE_CHECKING:
    import optuna

AT_A_TIME = 4
"""Runs that are chosen together, however many workers there are: so the search does not depend on their number."""
_RUNS_A_STUDY = 160
_STARTUP = 10
_TOLD = 3


class Tried(NamedTuple):
    """A case, and its score: the least margin as a share of the scenario's own; None for a run that was refused."""

    params: Params
    score: float | None


Search = Generator[list[Params], Sequence[float | None], None]
"""Yields cases to run and is sent their scores in the same order."""


def require_optuna() -> None:
    """Raise BadInputError where Optuna is not installed."""
    if importlib.util.find_spec("optuna") is None:
        raise BadInputError(
            "hil hunt needs Optuna, which is not installed; install it with: pip install 'mecanum-hil[hunt]'"
        )


def search(space: Space, seed: int) -> Search:
    """Search for ever for cases of a low score; ``seed`` decides the cases as far as scores do not."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    best = yield from _screened(space)
    for number in range(2**31):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(
                seed=seed + number, multivariate=True, group=True, constant_liar=True, n_startup_trials=_STARTUP
            )
        study = optuna.create_study(sampler=sampler)
        for tried in best if number == 0 else ():
            study.add_trial(
                optuna.trial.create_trial(
                    params=dict(tried.params),
                    distributions={name: _distribution(space.options(name)) for name in tried.params},
                    value=tried.score,
                )
            )
        for _ in range(0, _RUNS_A_STUDY, AT_A_TIME):
            trials = [study.ask() for _ in range(AT_A_TIME)]
            asked = [space.suggested(partial(_suggested, trial)) for trial in trials]
            scores = yield asked
            for trial, score in zip(trials, scores, strict=True):
                failed = optuna.trial.TrialState.FAIL if score is None else None
                study.tell(trial, score, state=failed)


def _screened(space: Space) -> Generator[list[Params], Sequence[float | None], list[Tried]]:
    """Try each change alone, then the worst of each together; return the worst of all."""
    tried: list[tuple[str, Tried]] = []
    singles = space.singles()
    for begin in range(0, len(singles), AT_A_TIME):
        some = singles[begin : begin + AT_A_TIME]
        scores = yield [params for _, params in some]
        tried += [(what, Tried(params, score)) for (what, params), score in zip(some, scores, strict=True)]
    worst: dict[str, Tried] = {}
    for what, one in sorted((pair for pair in tried if pair[1].score is not None), key=_score):
        if one.score is not None and one.score < 1.0:
            worst.setdefault(what, one)
    together = [space.combined([(what, one.params) for what, one in list(worst.items())[:many]]) for many in (2, None)]
    scores = yield together
    tried += [("together", Tried(params, score)) for params, score in zip(together, scores, strict=True)]
    return [one for _, one in sorted((pair for pair in tried if pair[1].score is not None), key=_score)[:_TOLD]]


def _score(pair: tuple[str, Tried]) -> float:
    return pair[1].score or 0.0


def _suggested(trial: "optuna.Trial", name: str, options: int) -> float | int:
    if options:
        return int(trial.suggest_categorical(name, range(options)))
    return float(trial.suggest_float(name, 0.0, 1.0))


def _distribution(options: int) -> "optuna.distributions.BaseDistribution":
    import optuna

    if options:
        return optuna.distributions.CategoricalDistribution(range(options))
    return optuna.distributions.FloatDistribution(0.0, 1.0)
