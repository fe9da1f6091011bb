"""Changes of a few numbers that pass a port once a tick: a wrong sign, unit or order, a delay, a limit, a drift."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

Values = tuple[float, ...]
Step = Callable[[float], float]
_WHERE = ("element",)


def _delay(ticks: float) -> Step:
    """Give the value of some ticks ago; before that, the first one."""
    held: deque[float] = deque(maxlen=round(ticks) + 1)

    def step(value: float) -> float:
        held.append(value)
        return held[0]

    return step


def _hold(ticks: float) -> Step:
    """Take a new value only every so many ticks."""
    count, held = 0, math.nan

    def step(value: float) -> float:
        nonlocal count, held
        held = value if count % round(ticks) == 0 else held
        count += 1
        return held

    return step


def _drift(per_tick: float) -> Step:
    """Add what grows by so much a tick."""
    total = 0.0

    def step(value: float) -> float:
        nonlocal total
        total += per_tick
        return value + total

    return step


def _lag(ticks: float) -> Step:
    """Pass the value through a first-order lag with a time constant of so many ticks."""
    state: float | None = None

    def step(value: float) -> float:
        nonlocal state
        state = value if state is None or not math.isfinite(value) else state + (value - state) / (ticks + 1.0)
        return state

    return step


def _freeze(after: float) -> Step:
    """Keep the value of this tick for ever."""
    count, held = 0, math.nan

    def step(value: float) -> float:
        nonlocal count, held
        held = value if count <= after else held
        count += 1
        return held

    return step


def _drop_out(every: float) -> Step:
    """Give the last value again once in so many ticks."""
    count, last = 0, math.nan

    def step(value: float) -> float:
        nonlocal count, last
        count += 1
        last = last if count % round(every) == 0 else value
        return last

    return step


def _spike(every: float) -> Step:
    """Give ten times the value once in so many ticks."""
    count = 0

    def step(value: float) -> float:
        nonlocal count
        count += 1
        return 10.0 * value if count % round(every) == 0 else value

    return step


CHANGES: Mapping[str, Callable[[float], Step]] = {
    "scale": lambda factor: lambda value: factor * value,
    "offset": lambda more: lambda value: value + more,
    "limit": lambda most: lambda value: min(max(value, -most), most),
    "deadband": lambda least: lambda value: 0.0 if abs(value) < least else value,
    "quantum": lambda step: lambda value: step * round(value / step) if math.isfinite(value) else value,
    "wrap": lambda turn: lambda value: math.remainder(value, turn) if math.isfinite(value) else value,
    "positive": lambda _: lambda value: abs(value),
    "delay": _delay,
    "hold": _hold,
    "drift": _drift,
    "lag": _lag,
    "freeze": _freeze,
    "drop_out": _drop_out,
    "spike": _spike,
}
"""The changes of a number by name, each made of its size; times are in ticks of the port."""
ORDER = "order"
"""The change that gives the elements in another order: a list of places."""


class Change:
    """Changes the values of a port: all of them, or one ``element``.

    ``options`` are ``element`` and one of ``CHANGES``, or ``order``. Raises ValueError for any other.
    """

    def __init__(self, elements: Sequence[str], options: Mapping[str, Any]) -> None:
        given = {name: value for name, value in options.items() if name not in _WHERE}
        if len(given) != 1 or not given.keys() <= {*CHANGES, ORDER}:
            raise ValueError(f"{sorted(given)}: expected one of {', '.join((*CHANGES, ORDER))}")
        [(name, size)] = given.items()
        chosen = options.get("element")
        if chosen is not None and chosen not in elements:
            raise ValueError(f"element {chosen!r}: expected one of {', '.join(elements)}")
        self._order: Sequence[int] | None = None
        if name == ORDER:
            if sorted(size) != list(range(len(elements))) or list(size) == sorted(size):
                raise ValueError(f"order {size}: expected the places 0 to {len(elements) - 1} in another order")
            self._order = size
        places = [place for place, element in enumerate(elements) if chosen in (None, element)]
        self._steps = [] if name == ORDER else [(place, CHANGES[name](float(size))) for place in places]

    def __call__(self, values: Values) -> Values:
        """Return the changed values."""
        if self._order is not None:
            return tuple(values[place] for place in self._order)
        changed = list(values)
        for place, step in self._steps:
            changed[place] = step(changed[place])
        return tuple(changed)
