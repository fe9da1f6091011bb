"""Chooses the runs of a hunt: one change alone each, then half of the runs by the margins so far, half at the ends.

By the margins: the tree-structured Parzen estimator of Optuna (Bergstra et al. 2011) for the claim that is closest, and
for each claim in turn changes of the run that came closest to breaking it, as in many-objective search of tests
(Panichella et al. 2018). At the ends: numbers at either end of their ranges by chance, faults that begin together, for
defects of which no margin says anything (boundary values, Kuhn et al. 2004: most defects need few conditions).
"""

import itertools
import math
import random
import warnings
from collections.abc import Generator, Mapping, Sequence
from typing import TYPE_CHECKING

from hil.batch.hunt.space import Params, Space

if TYPE_CHECKING:
    import optuna

AT_A_TIME = 4
"""Runs that are chosen together, however many workers there are: so the search does not depend on their number."""
_STARTUP = 10
_ALIKE = 1e-9
_ANEW, _CHANGED, _CHANGE = 0.1, 0.4, 0.15
"""How likely a value is drawn anew, or changed, and the standard deviation of a change, as a share of the range."""
_END = 0.4
"""How likely a number is at one end of its range, and at the other."""

Shares = Mapping[int, float]
"""What a run left of the scenario's own margins, by the places of the claims."""
Search = Generator[list[Params], Sequence[Shares | None], None]
"""Yields cases to run and is sent their shares in the same order, None for a run that was refused."""


def search(space: Space, seed: int) -> Search:
    """Search for ever for cases that break a claim; ``seed`` decides the cases as far as shares do not."""
    tried = yield from _screened(space)
    chance = random.Random(seed)
    studies: dict[int, _Study] = {}
    for turn in itertools.count():
        claims = list(_least(tried))
        closest, in_turn = claims[0], claims[turn % len(claims)]
        study = studies.setdefault(closest, _Study(space, seed + closest))
        asked = [
            study.asked(tried, closest),
            _near_best(space, chance, [_best(space, tried, one) for one in (in_turn, chance.choice(claims))]),
            *(_at_ends(space, chance) for _ in range(AT_A_TIME - 2)),
        ]
        yield from _tried(asked, tried)


def _best(space: Space, tried: "Tried", claim: int) -> Params:
    """Return the run that came closest to breaking a claim; the scenario as it is if none could be judged."""
    return min(tried, key=lambda one: one[1].get(claim, math.inf), default=(space.nominal_params, {}))[0]


def _near_best(space: Space, chance: random.Random, parents: Sequence[Params]) -> Params:
    """Return a case between two, the first of which counts more, with some changes."""
    first, second = parents

    def suggest(name: str, options: int) -> float | int:
        value = (second if chance.random() < _ANEW else first)[name]
        luck = chance.random()
        if luck < _ANEW:
            return chance.randrange(options) if options else chance.random()
        if luck < _CHANGED and not options:
            return min(max(value + chance.gauss(0.0, _CHANGE), 0.0), 1.0)
        return value

    return space.suggested(suggest)


def _at_ends(space: Space, chance: random.Random) -> Params:
    """Return a case by chance, with many numbers at the ends of their ranges, and often with faults that coincide."""

    def suggest(name: str, options: int) -> float | int:
        luck = chance.random()
        if options:
            return chance.randrange(options)
        if name.endswith(" start_s") or luck >= 2.0 * _END:
            return chance.random()
        return 0.0 if luck < _END else 1.0

    params = space.suggested(suggest)
    return space.coincident(params, at_end=chance.random() < 0.5) if chance.random() < 0.5 else params


class _Study:
    """A study of Optuna that has other runs told before it is asked."""

    def __init__(self, space: Space, seed: int) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, n_startup_trials=_STARTUP)
        self._study = optuna.create_study(sampler=sampler)
        self._distributions = {name: _distribution(space.options(name)) for name in space.nominal_params}
        self._told = 0

    def asked(self, tried: "Tried", claim: int) -> Params:
        """Return the case that the estimator takes for the best to try, by all that was tried."""
        import optuna

        for done, shares in tried[self._told :]:
            if claim in shares:
                trial = optuna.trial.create_trial(
                    params=dict(done), distributions=self._distributions, value=shares[claim]
                )
                self._study.add_trial(trial)
        self._told = len(tried)
        asked = self._study.ask(self._distributions)
        self._study.tell(asked, state=optuna.trial.TrialState.FAIL)  # its share comes with those of the others
        params: Params = asked.params
        return params


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


def _distribution(options: int) -> "optuna.distributions.BaseDistribution":
    import optuna

    if options:
        return optuna.distributions.CategoricalDistribution(range(options))
    return optuna.distributions.FloatDistribution(0.0, 1.0)
