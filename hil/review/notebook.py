"""A result as the small page that a notebook shows: the verdict, what happened, the figures, and the position error."""

import base64
import math
from collections.abc import Iterable, Iterator, Mapping
from html import escape
from io import BytesIO
from typing import Any

import numpy as np

from hil.core.errors import BadInputError
from hil.core.printable import printable
from hil.judge.measure import Series
from hil.judge.verdict import happenings, head_rows
from hil.judge.words import figure_rows
from hil.record.layout import ALARM_COLOUR
from hil.review.judged import fault_band
from hil.review.plots import Curve, draw_error, drawing, rgb, thinned

_COLOURS = {"PASSED": "#1b7f3b", "FAILED": "#c62828"}
_SHOWN = 12
_SHORT = 24
_ERROR = "error.planar_m"


def small_page(metrics: Mapping[str, Any], signals: Mapping[str, Series]) -> str:
    """Return the page as HTML without scripts. ``metrics`` are a run's figures with its ``events`` and ``notes``."""
    return printable("".join(_parts(metrics, signals)))


def _parts(metrics: Mapping[str, Any], signals: Mapping[str, Series]) -> Iterator[str]:
    (verdict, about), *others = head_rows(metrics)
    colour = _COLOURS.get(verdict, "#8a6d00")
    yield f'<div style="max-width: 60em"><p><b style="color: {colour}; font-size: 1.3em">{verdict}</b> '
    yield f"{escape(about)}</p>"
    yield from _table(others)
    happened = happenings(metrics)
    yield from _table(
        (f"{one.t_s:.3f} s" if math.isfinite(one.t_s) else "at the end", one.kind, one.text)
        for one in happened[:_SHOWN]
    )
    if len(happened) > _SHOWN:
        yield f"<p>{len(happened) - _SHOWN} more; print the result to see them all</p>"
    yield from _table(row for row in figure_rows(metrics, machine=False) if not row[1].startswith("-  "))
    if _ERROR in signals and np.isfinite(signals[_ERROR]).any():
        try:
            picture = _picture(metrics, signals)
            yield f'<img alt="position error over time" src="data:image/svg+xml;base64,{picture}">'
        except BadInputError as error:  # without matplotlib the rest is still worth reading
            yield f"<p>{escape(str(error))}</p>"
    yield "</div>"


def _table(rows: Iterable[Iterable[str]]) -> Iterator[str]:
    cells = ["".join(f'<td style="{_cell(text)}">{escape(text)}</td>' for text in row) for row in rows]
    if cells:
        yield f"<table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table>"


def _picture(metrics: Mapping[str, Any], signals: Mapping[str, Series]) -> str:
    """Return the planar error over time as SVG in base64: grey while a fault was in force, a line at each violation."""
    svg = BytesIO()
    t_s = signals["loop.t_s"]
    with drawing(svg, size_in=(7.2, 2.6)) as (axes,):
        draw_error(axes, [thinned(Curve("", t_s, signals[_ERROR]))], title="")
        for fault in metrics.get("fault") or ():
            if fault["applied"]:
                band = fault_band(fault, float(t_s[-1]))
                axes.axvspan(band.begin, band.end, color="#dddddd")
        for row in metrics.get("expect") or ():
            if row["passed"] is False and row["violation_s"] is not None:
                axes.axvline(row["violation_s"], color=rgb(ALARM_COLOUR), linewidth=1.0)
    return base64.b64encode(svg.getvalue()).decode("ascii")


def _cell(text: str) -> str:
    """Return the style of a cell; a short text, such as a time, stays on one line."""
    return "text-align: left; vertical-align: top" + ("; white-space: nowrap" if len(text) <= _SHORT else "")
