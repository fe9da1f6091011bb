"""Chooses the runs of a hunt: first one change alone each, then a search guided by the margins so far.

The search is that of Optuna, a tree-structured Parzen estimator (Bergstra et al. 2011). It needs few runs, and takes
numbers, choices, and faults that have numbers of their own. It begins anew after some runs, since it may be stuck.
"""

import importlib.util
import itertools
import warnings
from collections.abc import Generator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from hil.batch.hunt.space import Params, Space
from hil.core.errors import BadInputError

if TYPE_CHECKING:
    import optuna

AT_A_TIME = 4
"""Runs that are chosen together, however many workers there are: so the search does not depend on their number."""
_RUNS_A_ROUND = 240
_STARTUP = 10
_ALIKE = 1e-9

Shares = Mapping[int, float]
"""What a run left of the scenario's own margins, by the places of the claims."""
Search = Generator[list[Params], Sequence[Shares | None], None]
"""Yields cases to run and is sent their shares in the same order, None for a run that was refused."""


def require_optuna() -> None:
    """Raise BadInputError where Optuna is not installed."""
    if importlib.util.find_spec("optuna") is None:
        raise BadInputError(
            "hil hunt needs Optuna, which is not installed; install it with: pip install 'mecanum-hil[hunt]'"
        )


def search(space: Space, seed: int) -> Search:
    """Search for ever for cases that break a claim; ``seed`` decides the cases as far as shares do not.

    Each claim that varies has a study of its own, so that one that is always close hides no other. All studies are told
    of all runs. Of four runs one is for the claim that is closest, the others for all claims in turn.
    """
    tried = yield from _screened(space)
    turns = itertools.count()
    for number in itertools.count():
        studies: dict[int, optuna.Study] = {}
        for _ in range(0, _RUNS_A_ROUND, AT_A_TIME):
            least = _least(tried)
            for claim in least:
                if claim not in studies:
                    studies[claim] = _study(seed + 1000 * number + claim)
                    for params, shares in tried if number == 0 else ():
                        _tell(studies[claim], space, params, shares.get(claim))
            claims = list(least)
            chosen = [claims[0], *(claims[next(turns) % len(claims)] for _ in range(AT_A_TIME - 1))]
            trials = [studies[claim].ask() for claim in chosen]
            asked = [space.suggested(partial(_suggested, trial)) for trial in trials]
            found = yield asked
            for claim, trial, run, left in zip(chosen, trials, asked, found, strict=True):
                value = None if left is None else left.get(claim)
                studies[claim].tell(trial, value, state=_failed() if value is None else None)
                if left is not None:
                    tried.append((run, left))
                    for other in studies.keys() - {claim}:
                        _tell(studies[other], space, run, left.get(other))


Tried = list[tuple[Params, Shares]]


def _least(tried: Tried) -> dict[int, float]:
    """Return the least share of each claim that varies, the closest first; of all claims if none does."""
    least: dict[int, float] = {}
    greatest: dict[int, float] = {}
    for _, shares in tried:
        for claim, share in shares.items():
            least[claim] = min(share, least.get(claim, share))
            greatest[claim] = max(share, greatest.get(claim, share))
    varying = {claim: share for claim, share in least.items() if greatest[claim] - share > _ALIKE}
    return dict(sorted((varying or least or {0: 1.0}).items(), key=lambda pair: pair[1]))


def _screened(space: Space) -> Generator[list[Params], Sequence[Shares | None], Tried]:
    """Try changes alone, and for each claim those together that bring it nearer; return what was tried.

    In the first round one end of each key is tried: where that is better than the scenario, the other end is taken to
    be worse. Further rounds try the other ends.
    """
    tried: Tried = []
    groups = [group for group in space.singles() if group]
    for number in range(max(map(len, groups), default=0)):
        alone = [group[number] for group in groups if number < len(group)]
        yield from _tried(alone, tried)
        known = {_key(params): shares for params, shares in tried}
        together = []
        for claim in _least(tried):
            worst = [_worst(group, [known.get(_key(one), {}).get(claim) for one in group]) for group in groups]
            chosen = sorted((one for one in worst if one is not None), key=lambda one: one[0])
            together.append(space.combined([params for _, params in chosen]))
        yield from _tried([one for one in together if _key(one) not in known], tried)
    return tried


def _tried(cases: Sequence[Params], tried: Tried) -> Generator[list[Params], Sequence[Shares | None], None]:
    """Run cases, some at a time, and add them to what was tried."""
    for begin in range(0, len(cases), AT_A_TIME):
        some = list(cases[begin : begin + AT_A_TIME])
        found = yield some
        tried += [(params, one) for params, one in zip(some, found, strict=True) if one is not None]


def _worst(group: Sequence[Params], shares: Sequence[float | None]) -> tuple[float, Params] | None:
    """Return the worst case of a group with its share, measured or guessed; None where none is worse than nominal."""
    known = [(share, params) for share, params in zip(shares, group, strict=True) if share is not None]
    if not known:
        return None
    share, params = min(known, key=lambda one: one[0])
    if share < 1.0 - _ALIKE:
        return share, params
    is_better = share > 1.0 + _ALIKE
    return (2.0 - share, group[1]) if is_better and len(group) == 2 and shares[1] is None else None


def _key(params: Params) -> tuple[tuple[str, float | int], ...]:
    return tuple(sorted(params.items()))


def _study(seed: int) -> "optuna.Study":
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.TPESampler(
            seed=seed, multivariate=True, group=True, constant_liar=True, n_startup_trials=_STARTUP
        )
    return optuna.create_study(sampler=sampler)


def _tell(study: "optuna.Study", space: Space, params: Params, value: float | None) -> None:
    """Tell a study of a run that it did not ask for."""
    import optuna

    if value is not None:
        distributions = {name: _distribution(space.options(name)) for name in params}
        trial = optuna.trial.create_trial(params=dict(params), distributions=distributions, value=value)
        study.add_trial(trial)


def _failed() -> "optuna.trial.TrialState":
    import optuna

    return optuna.trial.TrialState.FAIL


def _suggested(trial: "optuna.Trial", name: str, options: int) -> float | int:
    if options:
        return int(trial.suggest_categorical(name, range(options)))
    return float(trial.suggest_float(name, 0.0, 1.0))


def _distribution(options: int) -> "optuna.distributions.BaseDistribution":
    import optuna

    if options:
        return optuna.distributions.CategoricalDistribution(range(options))
    return optuna.distributions.FloatDistribution(0.0, 1.0)
