"""The page of a campaign: one self-contained HTML file with its verdicts, plots and worst runs."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from hil.batch.campaign.judged import COMPARED, Judged, duel_words, percent, word
from hil.batch.campaign.pictures import COLUMNS, plots
from hil.batch.figures import KEY, column_of
from hil.batch.job import PASSED
from hil.core.outputs import Existing
from hil.review.html_page import WIDTH_IN, document, figure, mark, picture, table, write_document
from hil.review.plots import drawing

_MEANINGS = (
    "Steady: the planar error over the last 5 s, its root mean square and its greatest value; to 10 mm: the first time "
    "from which the planar error stays below that; overshoot: how far past the reference, along the line of the "
    "initial error; effort: the torques of the four wheels over time. Of each less is better."
)
_REASONS = 12


def write_page(path: Path, judged: Judged, existing: Existing = "refuse") -> None:
    """Write the page; ``existing`` says what to do if the file exists.

    Raises BadInputError when its name does not end in .html, and when it cannot be written.
    """
    write_document(path, page(judged, path.parent), existing)


def page(judged: Judged, folder: Path) -> str:
    """Return the page as HTML; ``folder`` is where it is to be, from which its links to recordings start."""
    sections = (_head, _reasons, _rates, _figures, _duels, _effects, _pictures)
    html = [line for section in sections for line in section(judged)]
    title = f"{judged.about['name']}: {judged.about['runs']} runs of {judged.about['scenario']}"
    return document(title, [*html, *_worst(judged, folder)])


def _section(
    title: str, about: str, head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()
) -> Iterator[str]:
    """Yield a heading, a paragraph and a table; the columns in ``numbers`` hold numbers. Cells are text."""
    yield f"<h2>{title}</h2>"
    yield f'<p class="about">{escape(about, quote=False)}</p>'
    yield from table(head, [list(map(escape, row)) for row in rows], numbers)


def _head(judged: Judged) -> Iterator[str]:
    done, passed = len(judged.rows), judged.outcomes.get(PASSED, 0)
    verdict = f"{passed} of {done} runs passed" if done else "no run is done yet"
    yield f'<p class="verdict {"passed" if done and passed == done else "failed"}">{verdict}</p>'
    axes = "; ".join(f"{name}: {axis['kind']} {axis['values']}" for name, axis in judged.about["axes"].items())
    yield from (f'<p class="about">{escape(sentence)}</p>' for sentence in (*judged.sentences(), axes) if sentence)
    if len(judged.commits) > 1:
        yield f'<p class="note">the runs were done by several commits: {escape(", ".join(judged.commits))}</p>'


def _reasons(judged: Judged) -> Iterator[str]:
    if judged.reasons:
        yield "<h2>Why runs did not pass</h2>"
        rows = [(mark(outcome, False), str(count), escape(why)) for outcome, why, count in judged.reasons[:_REASONS]]
        yield from table(("outcome", "runs", "reason"), rows, numbers=(1,))
        if more := len(judged.reasons) - _REASONS:
            yield f'<p class="about">and {more} more reasons</p>' if more > 0 else ""


def _rates(judged: Judged) -> Iterator[str]:
    about = (
        "Of all runs that are done, and of those with one value of an axis. Runs that share a draw of the random axes, "
        "or without these a seed, repeat each other: the interval is that of as many independent runs as would scatter "
        "so. Intervals on this page are of 95 %: were the campaign done again with other draws, 19 of 20 such "
        "intervals would hold the true value."
    )
    head = ("axis", "value", "runs", "passed", "draws", "share, with its interval")
    rows = [(one.axis, one.value, str(one.runs), str(one.passed), str(one.units), percent(one)) for one in judged.rates]
    yield from _section("Pass rates", about, head, rows, (2, 3, 4))


def _figures(judged: Judged) -> Iterator[str]:
    about = (
        "Over the runs that have the figure: a run that never came within 10 mm has no steady error, and one that did "
        f"not come to its end has none of them. {_MEANINGS}"
    )
    rows = []
    for spread in judged.spreads():
        column = column_of(spread.figure)
        numbers = (f"{column.scale * value:.4g}" for value in (spread.median, spread.p95, spread.worst))
        rows.append((column.labelled, spread.law, str(spread.runs), *numbers))
    head = ("figure", "law", "runs", "median", "95th percentile", "worst")
    yield from _section("Figures of each law", about, head, rows, (2, 3, 4, 5))


def _duels(judged: Judged) -> Iterator[str]:
    if not judged.duels:
        return
    about = (
        "Runs that differ in the law alone, in pairs; the mean difference with the percentile interval of a bootstrap "
        "over at least six independent draws. Pairs of which one run has no such figure, or did not come to its end, "
        "are left out: where they are many, the rest are the easy ones. Where the interval contains 0, no difference "
        "is shown. There is no correction for multiple comparisons."
    )
    rows = []
    for duel in judged.duels:
        column = column_of(duel.figure)
        scaled = duel._replace(difference=duel.difference.scaled(column.scale))
        counts = map(str, (duel.pairs, duel.left_out, duel.units))
        rows.append((column.labelled, duel_words(scaled), f"{100 * duel.first_less:.3g} %", *counts))
    head = ("figure", "difference", "first less in", "pairs", "left out", "draws")
    yield from _section("Law against law", about, head, rows, (2, 3, 4, 5))


def _effects(judged: Judged) -> Iterator[str]:
    if not judged.axes:
        return
    about = (
        "The share of a figure's ranks that one axis explains by itself (epsilon squared): 1 is all, 0 none. What only "
        "several axes together explain is in none of them."
    )
    shares = {(effect.axis, effect.figure): effect.share for effect in judged.effects}
    rows = [
        (axis, *("-" if (share := shares[axis, name]) is None else f"{share:.2f}" for name in COMPARED))
        for axis in sorted(judged.axes, key=lambda axis: -(shares.get((axis, judged.by)) or 0.0))
    ]
    head = ("axis", *(column_of(name).title for name in COMPARED))
    yield from _section("What matters", about, head, rows, range(1, len(COMPARED) + 1))


def _pictures(judged: Judged) -> Iterator[str]:
    for plot in plots(judged).values():
        drawn = picture(plot.title, plot.caption, plot.draw, height_in=plot.height_in, rows=plot.rows, columns=COLUMNS)
        yield from figure(drawn)


def write_pictures(page: Path, judged: Judged, kind: str, existing: Existing = "refuse") -> list[Path]:
    """Write each picture of the page as a file beside it, as png, svg or pdf (``kind``), and return the files.

    They are called ``report-distributions.svg`` for a page ``report.html``. Raises BadInputError when one cannot be
    written.
    """
    files = []
    for name, plot in plots(judged).items():
        files.append(page.with_name(f"{page.stem}-{name}.{kind}"))
        size_in = (WIDTH_IN, plot.height_in)
        with drawing(files[-1], rows=plot.rows, columns=COLUMNS, size_in=size_in, existing=existing) as axes:
            plot.draw(axes)
    return files


def _worst(judged: Judged, folder: Path) -> Iterator[str]:
    column = column_of(judged.by)
    yield "<h2>The worst runs</h2>"
    for row in judged.worst:
        value = "-" if row[judged.by] is None else f"{column.scale * row[judged.by]:.4g} {column.unit}"
        outcome = mark(row["outcome"], row["outcome"] == PASSED)
        yield f"<p>{outcome} {escape(f'{column.title} {value}; {_point(judged, row)}')}</p>"
        if row["reason"] is not None:
            yield f'<p class="failed">{escape(row["reason"])}</p>'
        yield f'<p class="about"><code>{escape(judged.repeats[row[KEY]])}</code></p>'
        if (recording := judged.recording(row[KEY])) is not None:
            link = Path(os.path.relpath(judged.folder / recording, folder)).as_posix()
            yield f'<p class="about">recorded: <a href="{escape(link)}">{escape(recording.as_posix())}</a></p>'


def _point(judged: Judged, row: Mapping[str, Any]) -> str:
    axes = (f"{name} = {word(row[name])}" for name in judged.about["axes"])
    return ", ".join((row["law"], *axes, f"fault {row['fault']}", f"seed {row['seed']}"))
