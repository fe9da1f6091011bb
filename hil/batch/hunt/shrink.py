"""Makes a case that breaks an expectation smaller: fewer faults, fewer changes, shorter, nearer to the scenario.

Hypothesis and the delta debuggers that are kept shrink what they made themselves, or lists of equal parts, by one call
after the other; here numbers have a nominal value, and the runs go through the batch engine.
"""

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from typing import Any

from hil.batch.hunt.space import Case, Chosen, Dimension, Space

Shrink = Generator[list[Case], Sequence[bool], Case]
"""Yields smaller cases, is sent which of them still break the same, and returns the smallest."""
_PARTS = (1.0, 0.5, 0.1)
"""How much of the way to the nominal value is tried at once."""
_FEWEST_DIGITS = 2


def shrink(space: Space, case: Case, shorter: Callable[[Case], float | None]) -> Shrink:
    """Make a case smaller until no single step does; ``shorter`` returns a duration [s] that should do for a case.

    Each round tries all steps at once, then those that still break it together, the greatest first.
    """
    tried: set[str] = set()
    while True:
        steps = [step for step in _steps(space, case, shorter(case)) if repr(step) not in tried]
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


def _steps(space: Space, case: Case, duration_s: float | None) -> Iterator[Case]:
    """Yield the cases one step smaller, the greatest step first."""
    for place in range(len(case.faults)):
        yield case._replace(faults=case.faults[:place] + case.faults[place + 1 :])
    for key in case.values:
        yield case._replace(values={name: value for name, value in case.values.items() if name != key})
    if duration_s is not None and (case.duration_s is None or duration_s < case.duration_s):
        yield case._replace(duration_s=duration_s)
    for key, value in case.values.items():
        for nearer in _nearer(space.ranges[key], value, space.nominal.get(key)):
            yield case._replace(values={**case.values, key: nearer})
    for place, fault in enumerate(case.faults):
        for name, nearer in _smaller(space.offers[fault.offer], fault.given):
            changed = Chosen(fault.offer, {**fault.given, name: nearer})
            yield case._replace(faults=(*case.faults[:place], changed, *case.faults[place + 1 :]))


def _smaller(offer: Mapping[str, Dimension], given: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield a number of a fault and a smaller value of it: weaker, or shorter; its begin only gets fewer digits."""
    for name, dimension in offer.items():
        if not dimension.options:
            least = min((dimension.low, dimension.high), key=abs)
            parts = _PARTS if name in ("duration_s", "value") else ()
            yield from ((name, nearer) for nearer in _nearer(dimension, given[name], least, parts))


def _nearer(dimension: Dimension, value: Any, nominal: Any, parts: Sequence[float] = _PARTS) -> Iterator[float]:
    """Yield values between a value and the nominal one, then the value with fewer digits."""
    if dimension.options or not isinstance(nominal, int | float) or isinstance(nominal, bool):
        return
    low, high = sorted((value, nominal))
    seen = {value}
    near = [value + part * (nominal - value) for part in parts]
    for one in (*map(dimension.rounded, near), *(float(f"{value:.{digits}g}") for digits in (_FEWEST_DIGITS, 3))):
        if one not in seen and max(low, dimension.low) <= one <= min(high, dimension.high):
            seen.add(one)
            yield one


def _together(case: Case, steps: Sequence[Case]) -> Case:
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
    durations = [one.duration_s for one in steps if one.duration_s != case.duration_s]
    return Case(values, tuple(faults), durations[0] if durations else case.duration_s)
