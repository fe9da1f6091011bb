"""Two runs as the text of a terminal: what was changed between them, then what became worse and what better.

No side effects: the figures of ``hil.review.figures`` in, lines of at most 80 columns out.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hil.judge.verdict import COLUMNS, failed_words, happenings, head_rows, row_lines, wrapped
from hil.review.difference import Change, Difference

_CHANGES_SHOWN = 20
_LONGEST_VALUE = 52
_COUNTS = ("frames.sent", "frames.received")


def pair_lines(
    figures: Sequence[Mapping[str, Any]],
    differences: Sequence[Difference],
    changes: Sequence[Change],
    *,
    everything: bool = False,
) -> Iterator[str]:
    """Yield the lines about two runs.

    ``figures`` are those of both; ``everything``: also figures that are the same, and those of the machine.
    """
    for which, run in zip(("first", "second"), figures, strict=True):
        yield from wrapped(f"{which:<6}  ", run["recording"])
        yield from row_lines(_head(run))
    yield from ("", "What was changed:" if changes else "Nothing was changed in scenario, code and versions.")
    for change in changes[: None if everything else _CHANGES_SHOWN]:
        yield from _change_lines(change)
    if len(changes) > _CHANGES_SHOWN and not everything:
        yield f"  {len(changes) - _CHANGES_SHOWN} more; --all, --json and --html have them"
    yield from _claims(*figures)
    shown = [row for row in differences if everything or not row.of_machine]
    for verdict, title in (("worse", "Worse in the second run:"), ("better", "Better in the second run:")):
        if rows := sorted((row for row in shown if row.verdict == verdict), key=_share, reverse=True):
            yield from ("", title, *map(_difference_line, rows))
    same = [row for row in shown if row.verdict == "same"]
    others = [row for row in shown if row.verdict is None and (everything or row.difference != 0)]
    if others := [row for row in others if everything or row.name not in _COUNTS]:
        has_ended = any(run.get("failure") is not None for run in figures)
        title = "Not judged, because a run ended early:" if has_ended else "Other figures that differ:"
        yield from ("", title, *map(_difference_line, others))
    if same and everything:
        yield from ("", "The same:", *map(_difference_line, same))
    elif same:
        yield from ("", *wrapped("The same: ", f"{len(same)} figures (--all lists them)"))
    notes = dict.fromkeys(note for row in shown for note in row.notes)
    for note in notes:
        labels = ", ".join(row.label for row in shown if note in row.notes)
        yield from wrapped("  ", f"{labels}: {note}")


def _head(run: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the verdict of a run, and the first reason that it has."""
    yield from (row for row in head_rows(run) if row[0] != "given")
    told = [one for one in happenings(run) if one.kind in ("failed", "ended", "allow", "moved", "no fault")]
    if told and not run["passed"]:
        more = f"; and {len(told) - 1} more reasons" if len(told) > 2 else "; and one more reason" if told[1:] else ""
        yield "why", f"{told[0].text}{more}"


def _change_lines(change: Change) -> Iterator[str]:
    key, *values = change.words()
    first, second = (text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 1]}…" for text in values)
    line = f"  {key}: {first} -> {second}"
    if len(line) <= COLUMNS:
        yield line
    else:
        yield from (f"  {key}:", f"    {first}", f"    -> {second}")


def _claims(first: Mapping[str, Any], second: Mapping[str, Any]) -> Iterator[str]:
    """Yield the expectations that hold in one run and fail in the other."""

    def rows(run: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
        return {row["text"].partition(": ")[0]: row for row in run["expect"] or ()}

    before, after = rows(first), rows(second)
    moved = [(claim, before[claim]["passed"], row) for claim, row in after.items() if claim in before]
    fails = [failed_words(row) for _, passed, row in moved if passed and row["passed"] is False]
    holds = [claim for claim, passed, row in moved if passed is False and row["passed"]]
    for title, texts in (("Fails in the second run:", fails), ("Holds in the second run:", holds)):
        if texts:
            yield from ("", title)
            for text in texts:
                yield from wrapped("  ", text)


def _share(row: Difference) -> float:
    """Return the size of a difference by that of the larger value."""
    assert row.first is not None, "it has a verdict"
    assert row.second is not None, "it has a verdict"
    return abs(row.second - row.first) / max(abs(row.first), abs(row.second), 1e-300)


def _difference_line(row: Difference) -> str:
    first, second = ("-" if one is None else f"{one * row.scale:.5g}" for one in (row.first, row.second))
    ratio = f"{100 * row.difference / abs(row.first):+.3g} %" if row.first and row.difference else ""
    return f"  {row.label:<22} {first:>9} -> {second:<9} {row.unit:<14} {ratio}".rstrip()
