"""The elements of a page that draw its charts: plotly and all values, compressed, and the script ``charts.js``."""

import base64
import gzip
import hashlib
import json
from collections.abc import Iterator, Sequence
from functools import cache
from html import escape
from pathlib import Path

from hil.review.charts import Chart, figure_of, packed
from hil.review.contents import Series

_SCRIPT = Path(__file__).with_name("charts.js")


def place(chart: Chart, number: int) -> Iterator[str]:
    """Yield the title of a chart, the element in which it is drawn, and its caption."""
    yield f'<h2>{escape(chart.title)}</h2><figure><div id="chart-{number}" class="chart" role="img" '
    yield f'aria-label="{escape(chart.title)}" style="height:{chart.height_px}px"></div>'
    if chart.is_over_time:
        yield f'<div id="measured-{number}" class="measured"></div>'
    yield f"<figcaption>{escape(chart.caption)}</figcaption></figure>"


def charts_script(charts: Sequence[Chart]) -> Iterator[str]:
    """Yield the elements that draw the charts: plotly and all values, compressed, and the script."""
    if not charts:
        return
    xs: list[Series] = []
    figures = [figure_of(chart, xs) for chart in charts]
    held = {"xs": [packed(x, "f8") for x in xs], "charts": figures}
    yield '<noscript><p class="note">The plots need JavaScript.</p></noscript><p id="undrawn" class="note"></p>'
    for name, text in (("plotly", _plotly()), ("values", json.dumps(held, separators=(",", ":"), allow_nan=False))):
        coded = base64.b64encode(_compressed(text)).decode()
        yield f'<script type="application/gzip" id="{name}">{coded}</script>'
    yield f"<script>{_script()}</script>"


def policy() -> str:
    """Return the sources of scripts that a page with charts allows: its own script and plotly, by their hashes."""
    hashes = (hashlib.sha256(text.encode()).digest() for text in (_script(), _plotly()))
    return " ".join(f"'sha256-{base64.b64encode(one).decode()}'" for one in hashes)


def _compressed(text: str) -> bytes:
    return gzip.compress(text.encode(), mtime=0)


@cache
def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    text: str = get_plotlyjs()
    return text


@cache
def _script() -> str:
    return _SCRIPT.read_text(encoding="utf-8").strip()
