"""The plots of a campaign's page: distributions, effects of the axes, and differences between laws."""

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hil.batch.campaign.judged import COMPARED, Judged
from hil.batch.campaign.tables import RANDOM
from hil.batch.figures import Column, column_of
from hil.review.plots import colour_of, rgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = 2
"""How many panels of a plot are side by side."""
_SCATTERED = 2000
_MOST_VALUES = 12
_LEGEND_IN = 0.3


class Plot(NamedTuple):
    """A plot of a campaign: what draws it on ``COLUMNS`` times ``rows`` axes, and how high these are together."""

    title: str
    caption: str
    draw: Callable[["list[Axes]"], None]
    rows: int
    height_in: float


def plots(judged: Judged) -> dict[str, Plot]:
    """Return by name the plots that have something to show."""
    found = {}

    def add(name: str, caption: str, draw: Callable[["list[Axes]"], None], count: int, height_in: float) -> None:
        rows = -(-count // COLUMNS)
        found[name] = Plot(name.capitalize(), caption, draw, rows, height_in * rows + _LEGEND_IN)

    if there := list(dict.fromkeys(duel.figure for duel in judged.duels)):
        caption = "Mean differences of paired runs with their 95 % intervals; left of 0 the first law is less."
        pairs = len({(duel.first, duel.second) for duel in judged.duels})
        add("differences", caption, partial(draw_duels, judged=judged, names=there), len(there), 0.9 + 0.22 * pairs)
    there = [name for name in COMPARED if len(judged.values(name))]
    if not there:
        return found
    caption = "The share of a law's runs in which a figure is at most this: further left is better."
    add("distributions", caption, partial(draw_distributions, judged=judged, names=there), len(there), 2.2)
    shown = judged.by if judged.by in there else there[0]
    if axes := [axis for axis in judged.axes if axis not in ("law", "seed")]:
        caption = f"{column_of(shown).labelled} over each axis; dots are runs, the line joins medians."
        draw = partial(draw_effects, judged=judged, names=axes, shown=shown)
        add("effects", caption, draw, len(axes), 2.4)
    return found


def _panels(axes: "list[Axes]", names: list[str]) -> "Iterator[tuple[Axes, str, Column]]":
    """Yield a panel for each name, with how the figure of that name is shown, and hide the other panels."""
    for panel in axes[len(names) :]:
        panel.set_visible(False)
    yield from zip(axes, names, map(column_of, names), strict=False)


def draw_distributions(axes: "list[Axes]", *, judged: Judged, names: list[str]) -> None:
    """Draw, for each law, the share of its runs in which a figure is at most the value on the x axis."""
    for panel, name, column in _panels(axes, names):
        for number, law in enumerate(judged.about["laws"]):
            values = np.sort(column.scale * judged.values(name, law))
            if len(values):
                shares = np.arange(1, len(values) + 1) / len(values)
                panel.step(values, shares, where="post", label=law, color=rgb(colour_of(number)))
        panel.set(title=column.title, xlabel=column.labelled, ylabel="share of runs", ylim=(0.0, 1.02))


def draw_effects(axes: "list[Axes]", *, judged: Judged, names: list[str], shown: str) -> None:
    """Draw the figure ``shown`` over the axes of the campaign with these names."""
    column = column_of(shown)
    for panel, name, _ in _panels(axes, names):
        numeric = all(isinstance(row[name], float | int) for row in judged.rows)
        words = list(dict.fromkeys(str(row[name]) for row in judged.plan))
        for number, law in enumerate(judged.about["laws"]):
            rows = [row for row in judged.rows if row["law"] == law and row[shown] is not None]
            x = np.array([float(row[name]) if numeric else words.index(str(row[name])) for row in rows])
            y = column.scale * np.array([row[shown] for row in rows])
            if not len(x):
                continue
            every = -(-len(x) // _SCATTERED)
            colour = rgb(colour_of(number))
            panel.plot(x[::every], y[::every], ".", color=colour, markersize=2.5, alpha=0.4)
            is_random = judged.axes[name] in RANDOM
            panel.plot(*_medians(x, y, is_random=is_random), "-", color=colour, label=law)
        if not numeric:
            panel.set_xticks(range(len(words)), words)
        if judged.axes[name] == "log_uniform":
            panel.set_xscale("log")
        panel.set(xlabel=name, ylabel=column.labelled)


def _medians(x: Any, y: Any, *, is_random: bool) -> tuple[list[float], list[float]]:
    """Return the medians over the values of an axis, or over ranges of them where they are many."""
    places = np.unique(x)
    if is_random or len(places) > _MOST_VALUES:
        edges = np.quantile(x, np.linspace(0.0, 1.0, 1 + min(8, max(1, len(places) // 3))))
        ranges = [(x >= low) & (x <= high) for low, high in itertools.pairwise(edges)]
    else:
        ranges = [x == place for place in places]
    ranges = [one for one in ranges if one.any()]
    return [float(np.median(x[one])) for one in ranges], [float(np.median(y[one])) for one in ranges]


def draw_duels(axes: "list[Axes]", *, judged: Judged, names: list[str]) -> None:
    """Draw the mean differences between laws in figures, each with its interval."""
    for panel, name, column in _panels(axes, names):
        duels = [duel for duel in judged.duels if duel.figure == name]
        for place, duel in enumerate(duels):
            value, low, high = duel.difference.scaled(column.scale)
            colour = rgb(colour_of(place))
            panel.plot([value], [place], "o", color=colour, markersize=4)
            if low is not None and high is not None:
                panel.plot([low, high], [place, place], "-", color=colour, linewidth=2)
        panel.axvline(0.0, color="#888888", linewidth=0.8)
        panel.set_yticks(range(len(duels)), [f"{duel.first} - {duel.second}" for duel in duels])
        panel.set(title=column.title, xlabel=f"difference [{column.unit}]", ylim=(len(duels) - 0.5, -0.5))
