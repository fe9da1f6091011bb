"""What a campaign gave, as tables and plots: its pass rates, laws, axes and worst runs."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.addons.batch.campaign.judged import BY, COMPARED, Judged, duel_words, percent, word
from hil.addons.batch.columns import KEY, Column, column_of
from hil.addons.batch.job import PASSED
from hil.addons.batch.results_page import Page, Plot, Results, Table
from hil.pages.html_page import WIDTH_IN
from hil.pages.plots import colour_of, rgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = 2
"""How many panels of a plot are side by side."""
_MEANINGS = (
    "Steady: the planar error over the last 5 s, its root mean square and its greatest value; to 10 mm: the first time "
    "from which the planar error stays below that; overshoot: how far past the reference, along the line of the "
    "initial error; effort: the torques of the four wheels over time. Of each less is better."
)
_REASONS = 12
_SCATTERED = 2000
_LEGEND_IN = 0.3
_LETTERS = 40
"""Of words side by side below a panel; more of them are written at an angle."""


def results(judged: Judged, page: Page) -> Results:
    """Return what a campaign gave; ``page`` is where it is shown."""
    done, passed = len(judged.rows), judged.outcomes.get(PASSED, 0)
    axes = "; ".join(f"{name}: {axis['kind']} {axis['values']}" for name, axis in judged.about["axes"].items())
    about = [*judged.sentences(), axes]
    if len(judged.commits) > 1:
        about.append(f"the runs were done by several commits: {', '.join(judged.commits)}")
    tables = [made for make in (_reasons, _rates, _figures, _duels, _worst) if (made := make(judged))]
    drawn = list(plots(judged))
    files = [str(page.picture(plot)) for plot in drawn if page.kind is not None]
    return Results(
        f"{judged.about['name']}: {judged.about['runs']} runs of {judged.about['scenario']}",
        done > 0 and passed == done,
        f"{passed} of {done} runs passed" if done else "no run is done yet",
        [*about, str(page.file), *files],
        tables,
        drawn,
        {"html": str(page.file), "pictures": files, **judged.plain()},
    )


def _reasons(judged: Judged) -> Table | None:
    rows = [(outcome, str(count), why) for outcome, why, count in judged.reasons[:_REASONS]]
    more = len(judged.reasons) - len(rows)
    notes = [f"and {more} more reasons"] if more else []
    return Table("Why runs did not pass", [("outcome", "runs", "reason"), *rows], notes, numbers=(1,)) if rows else None


def _rates(judged: Judged) -> Table:
    about = (
        "Of all runs that are done, and of those with one value of an axis. Runs that share a draw of the random axes, "
        "or without these a seed, repeat each other: the interval is that of as many runs as there are draws. "
        "Intervals on this page are of 95 %: were the campaign done again with other draws, 19 of 20 such "
        "intervals would hold the true value."
    )
    head = ("axis", "value", "runs", "passed", "draws", "share, with its interval")
    rows = [(one.axis, one.value, str(one.runs), str(one.passed), str(one.units), percent(one)) for one in judged.rates]
    return Table("Pass rates", [head, *rows], about=about, numbers=(2, 3, 4))


def _figures(judged: Judged) -> Table:
    about = (
        "Over the runs that have the figure: a run that never came within 10 mm has no steady error, and one that did "
        f"not come to its end has none of them. {_MEANINGS}"
    )
    rows = [("figure", "law", "runs", "median", "95th percentile", "worst")]
    for spread in judged.spreads():
        column = column_of(spread["figure"])
        median, p95, worst = (f"{column.scale * spread[name]:.4g}" for name in ("median", "p95", "worst"))
        rows.append((column.labelled, spread["law"], str(spread["runs"]), median, p95, worst))
    return Table("Figures of each law", rows, about=about, numbers=(2, 3, 4, 5))


def _duels(judged: Judged) -> Table | None:
    if not judged.duels:
        return None
    about = (
        "Runs that differ in the law alone, in pairs; the mean difference with the percentile interval of a bootstrap "
        "over at least six independent draws. Pairs of which one run has no such figure, or did not come to its end, "
        "are left out: where they are many, the rest are the easy ones. Where the interval contains 0, no difference "
        "is shown. There is no correction for multiple comparisons."
    )
    rows = [("figure", "difference", "first less in", "pairs", "left out", "draws")]
    for duel in judged.duels:
        column = column_of(duel.figure)
        scaled = duel._replace(difference=duel.difference.scaled(column.scale))
        counts = (str(duel.pairs), str(duel.left_out), str(duel.units))
        rows.append((column.labelled, duel_words(scaled), f"{100 * duel.first_less:.3g} %", *counts))
    return Table("Law against law", rows, about=about, numbers=(2, 3, 4, 5))


def _worst(judged: Judged) -> Table:
    column = column_of(BY)
    rows = [(column.labelled, "outcome", "run", "repeated by", "recorded in")]
    for row in judged.worst:
        outcome = row["outcome"] if row["reason"] is None else f"{row['outcome']}: {row['reason']}"
        recording = judged.recording(row[KEY])
        kept = "-" if recording is None else str(judged.folder / recording)
        rows.append((column.text(row[BY]), outcome, _point(judged, row), row["repeat"], kept))
    return Table("The worst runs", rows, numbers=(0,))


def _point(judged: Judged, row: Mapping[str, Any]) -> str:
    axes = (f"{name} = {word(row[name])}" for name in judged.about["axes"])
    return ", ".join((row["law"], *axes, f"fault {row['fault']}", f"seed {row['seed']}"))


def plots(judged: Judged) -> Iterator[Plot]:
    """Yield the plots that have something to show."""

    def plot(name: str, caption: str, draw: Callable[["list[Axes]"], None], count: int, height_in: float) -> Plot:
        rows = -(-count // COLUMNS)
        size_in = (WIDTH_IN, height_in * rows + _LEGEND_IN)
        return Plot(name, draw, rows, COLUMNS, size_in, name.capitalize(), caption)

    if not (there := [name for name in COMPARED if len(judged.values(name))]):
        return
    caption = "The share of a law's runs in which a figure is at most this: further left is better."
    yield plot("distributions", caption, partial(draw_distributions, judged=judged, names=there), len(there), 2.2)
    shown = BY if BY in there else there[0]
    if axes := [axis for axis in judged.axes if axis not in ("law", "seed")]:
        caption = f"{column_of(shown).labelled} over each axis; dots are runs."
        yield plot("effects", caption, partial(draw_effects, judged=judged, names=axes, shown=shown), len(axes), 2.4)


def _panels(axes: "list[Axes]", names: list[str]) -> "Iterator[tuple[Axes, str, Column]]":
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
            panel.plot(x[::every], y[::every], ".", color=colour, markersize=2.5, alpha=0.4, label=law)
        if not numeric:
            panel.set_xticks(range(len(words)), words)
            if sum(map(len, words)) > _LETTERS:
                for label in panel.get_xticklabels():
                    label.set(rotation=45.0, ha="right")
        if judged.axes[name] == "log_uniform":
            panel.set_xscale("log")
        panel.set(xlabel=name, ylabel=column.labelled)
