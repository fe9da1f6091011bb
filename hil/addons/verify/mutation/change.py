"""Changes of a few numbers that pass a port once a tick: a wrong sign, unit or order, a delay, a limit, a drift."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

Values = tuple[float, ...]
Step = Callable[[float, int, float, list[float]], float]
"""Changes a value: given the size of the change, the number of the value from 0, the value, and what it kept."""
_ELEMENT = "element"


def _delay(ticks: float, _number: int, value: float, kept: list[float]) -> float:
    """Give the value of some ticks ago; before that, the first one."""
    kept.append(value)
    del kept[: -round(ticks) - 1]
    return kept[0]


def _hold(ticks: float, number: int, value: float, kept: list[float]) -> float:
    """Take a new value only every so many ticks."""
    if number % round(ticks) == 0:
        kept[:] = [value]
    return kept[0]


def _drift(per_tick: float, number: int, value: float, _kept: list[float]) -> float:
    """Add what grows by so much a tick."""
    return value + (number + 1) * per_tick


def _lag(ticks: float, _number: int, value: float, kept: list[float]) -> float:
    """Pass the value through a first-order lag with a time constant of so many ticks."""
    is_first = not kept or not math.isfinite(value)
    kept[:] = [value if is_first else kept[0] + (value - kept[0]) / (ticks + 1.0)]
    return kept[0]


def _freeze(after: float, number: int, value: float, kept: list[float]) -> float:
    """Keep the value of this tick for ever."""
    if number <= after:
        kept[:] = [value]
    return kept[0]


def _drop_out(every: float, number: int, value: float, kept: list[float]) -> float:
    """Give the last value again once in so many ticks."""
    if (number + 1) % round(every):
        kept[:] = [value]
    return kept[0]


def _spike(every: float, number: int, value: float, _kept: list[float]) -> float:
    """Give ten times the value once in so many ticks."""
    return value if (number + 1) % round(every) else 10.0 * value


def _plain(change: Callable[[float, float], float]) -> Step:
    """Return a change that depends on its size and the value alone."""
    return lambda size, _number, value, _kept: change(size, value)


CHANGES: Mapping[str, Step] = {
    "scale": _plain(lambda factor, value: factor * value),
    "offset": _plain(lambda more, value: value + more),
    "limit": _plain(lambda most, value: min(max(value, -most), most)),
    "deadband": _plain(lambda least, value: 0.0 if abs(value) < least else value),
    "quantum": _plain(lambda step, value: step * round(value / step) if math.isfinite(value) else value),
    "wrap": _plain(lambda turn, value: math.remainder(value, turn) if math.isfinite(value) else value),
    "delay": _delay,
    "hold": _hold,
    "drift": _drift,
    "lag": _lag,
    "freeze": _freeze,
    "drop_out": _drop_out,
    "spike": _spike,
}
"""The changes of a number by name; times are in ticks of the port."""
ORDER = "order"
"""The change that gives the elements in another order: a list of places."""


class Change:
    """Changes the values of a port: all of them, or one ``element``.

    ``options`` are one of ``CHANGES``, or ``order``, and perhaps ``element``.
    """

    def __init__(self, elements: Sequence[str], options: Mapping[str, Any]) -> None:
        [(self._name, size)] = [one for one in options.items() if one[0] != _ELEMENT]
        self._size: Any = size if self._name == ORDER else float(size)
        chosen = [options[_ELEMENT]] if _ELEMENT in options else elements
        self._kept: Mapping[int, list[float]] = {elements.index(element): [] for element in chosen}
        self._number = 0

    def __call__(self, values: Values) -> Values:
        """Return the changed values."""
        if self._name == ORDER:
            return tuple(values[place] for place in self._size)
        step, changed = CHANGES[self._name], list(values)
        for place, kept in self._kept.items():
            changed[place] = step(self._size, self._number, changed[place], kept)
        self._number += 1
        return tuple(changed)
