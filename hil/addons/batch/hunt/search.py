"""Chooses the runs of a hunt: one change alone each, then a quarter by the margins so far, the others at the ends.

By the margins: the tree-structured Parzen estimator of Optuna (Bergstra et al. 2011). At the ends: numbers at either
end of their ranges by chance, and faults that begin together. This finds defects without a margin (boundary values,
Kuhn et al. 2004: most defects need few conditions).
"""

import random
import warnings
from collections.abc import Generator, Iterator, Mapping, Sequence
from typing import Any

from hil.addons.batch.hunt.space import Change, Chosen, Params, Space, SpanTable

AT_A_TIME = 4
"""Runs that are chosen together, however many workers there are: so the search does not depend on their number."""
_STARTUP = 10
_ALIKE = 1e-9
_END = 0.4
"""How likely a number is at one end of its range, and at the other."""

Shares = Mapping[int, float]
"""What a run left of the scenario's own margins, by the places of the claims."""
Search = Generator[list[Params], Sequence[Shares | None], None]
"""Yields cases to run and is sent their shares in the same order, None for a run that was refused."""


def search(space: Space, seed: int) -> Search:
    """Search for ever for cases that break a claim; ``seed`` decides the cases as far as shares do not."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True, n_startup_trials=_STARTUP)
    study = optuna.create_study(sampler=sampler)
    counts = {name: space.options(name) for name in space.nominal_params}
    kinds = optuna.distributions
    of_name = {
        name: kinds.CategoricalDistribution(range(count)) if count else kinds.FloatDistribution(0.0, 1.0)
        for name, count in counts.items()
    }
    chance, told = random.Random(seed), 0
    tried = yield from _screened(space)
    while True:
        for params, shares in tried[told:]:
            if shares:
                least = min(shares.values())
                study.add_trial(optuna.trial.create_trial(params=dict(params), distributions=of_name, value=least))
        told = len(tried)
        asked = study.ask(of_name)
        study.tell(asked, state=optuna.trial.TrialState.FAIL)  # its share comes with those of the others
        ends = [_at_ends(space, chance) for _ in range(AT_A_TIME - 1)]
        yield from _tried([asked.params, *ends], tried)


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
    """Try single changes, and for each claim the combination of those that bring it nearer; return all tried.

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


Shrink = Generator[list[Change], Sequence[bool], Change]
"""Yields smaller cases, is sent which of them still break the same, and returns the smallest."""
_PARTS = (1.0, 0.5, 0.1)
"""How much of the way to the nominal value is tried at once."""
_FEWEST_DIGITS = 2


def shrink(space: Space, case: Change) -> Shrink:
    """Make a case smaller until no single step does.

    Each round tries all steps at once, then those that still break it together, the greatest first.
    """
    tried: set[str] = set()
    while True:
        steps = [step for step in _steps(space, case) if repr(step) not in tried]
        if not steps:
            return case
        tried.update(map(repr, steps))
        breaks = yield steps
        good = [step for step, still in zip(steps, breaks, strict=True) if still]
        if not good:
            return case
        together = _together(case, good)
        if len(good) > 1 and repr(together) not in tried:
            tried.add(repr(together))
            (still,) = yield [together]
            good = [together, *good] if still else good
        case = good[0]


def _steps(space: Space, case: Change) -> Iterator[Change]:
    """Yield the cases one step smaller, the greatest step first."""
    for place in range(len(case.faults)):
        yield case._replace(faults=case.faults[:place] + case.faults[place + 1 :])
    for key in case.values:
        yield case._replace(values={name: value for name, value in case.values.items() if name != key})
    for key, value in case.values.items():
        for nearer in _nearer(space.ranges[key], value, space.nominal.get(key)):
            yield case._replace(values={**case.values, key: nearer})
    for place, fault in enumerate(case.faults):
        for name, nearer in _smaller(space.offers[fault.offer], fault.given):
            changed = Chosen(fault.offer, {**fault.given, name: nearer})
            yield case._replace(faults=(*case.faults[:place], changed, *case.faults[place + 1 :]))


def _smaller(offer: Mapping[str, SpanTable], given: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield a number of a fault and a smaller value of it: weaker, or shorter; its begin only gets fewer digits."""
    for name, span in offer.items():
        if not span.options:
            least = min((span.low, span.high), key=abs)
            parts = _PARTS if name in ("duration_s", "value") else ()
            yield from ((name, nearer) for nearer in _nearer(span, given[name], least, parts))


def _nearer(span: SpanTable, value: Any, nominal: Any, parts: Sequence[float] = _PARTS) -> Iterator[float]:
    """Yield values between a value and the nominal one, then the value with fewer digits."""
    if span.options or not isinstance(nominal, int | float) or isinstance(nominal, bool):
        return
    low, high = sorted((value, nominal))
    seen = {value}
    near = [value + part * (nominal - value) for part in parts]
    for one in (*map(span.rounded, near), *(float(f"{value:.{digits}g}") for digits in (_FEWEST_DIGITS, 3))):
        if one not in seen and max(low, span.low) <= one <= min(high, span.high):
            seen.add(one)
            yield one


def _together(case: Change, steps: Sequence[Change]) -> Change:
    """Return the case with all of these steps; where two change the same, the first one counts."""
    gone = [
        fault
        for fault in case.faults
        if any(fault not in one.faults and len(one.faults) < len(case.faults) for one in steps)
    ]
    values: dict[str, Any] = {}
    for key, value in case.values.items():
        changed = [one.values.get(key) for one in steps if one.values.get(key) != value]
        if not changed or changed[0] is not None:
            values[key] = changed[0] if changed else value
    faults = []
    for place, fault in enumerate(case.faults):
        if fault in gone:
            continue
        given = dict(fault.given)
        for one in steps:
            if len(one.faults) == len(case.faults):
                new = {name: value for name, value in one.faults[place].given.items() if value != fault.given[name]}
                given |= {name: value for name, value in new.items() if given[name] == fault.given[name]}
        faults.append(Chosen(fault.offer, given))
    return Change(values, tuple(faults))
