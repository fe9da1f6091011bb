"""Interactive plots of a page, as plotly takes them: panels over one x axis, with bands, bounds and marks.

chart = Chart("Errors", "Truth minus reference.", [Panel("planar error", "mm", [Line("dsc", t_s, planar_mm)])])
html = [*place(chart, 0), *charts_script([chart])]
"""

import base64
import gzip
import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.pages.plots import Colour
from hil.record.contents import Series

_RED, _INK, _GRID = "#c62828", "#333333", "#e4e4e4"
_FILLS = {
    "waiting": "#dcdcdc",
    "held": "#79c2a1",
    "violated": _RED,
    "fault": "#e0912f",
    "not run": "#f3f3f3",
}
_TITLE_PX, _AXIS_PX, _LANE_PX, _TOP_PX = 28, 40, 30, 42
_LEFT_PX = 52
_TOP_AXIS = {"overlaying": "x", "matches": "x", "side": "top", "anchor": "free", "position": 1, "showgrid": False}
_TOP_AXIS |= {"zeroline": False, "ticksuffix": " s", "ticklen": 0}
_NOWHERE: Series = np.array([np.nan])
_NOTHING: dict[str, Any] = {"type": "scatter", "mode": "none", "xaxis": "x2", "yaxis": "y", "hoverinfo": "skip"}
"""A trace that shows nothing: plotly draws no axis without one."""
_NOTE = {"showarrow": False, "xref": "paper", "x": 0, "xshift": 4 - _LEFT_PX, "xanchor": "left"}
_NOTE |= {"yref": "paper", "yanchor": "bottom", "align": "left"}


class Line(NamedTuple):
    """A curve: values ``y`` over ``x``, both of shape (n,), NaN for a gap. Lines that share ``x`` share its array."""

    label: str
    x: Series
    y: Series
    colour: Colour
    width_px: float = 1.4
    dash: str = "solid"
    opacity: float = 1.0
    in_title: bool = True


class Mark(NamedTuple):
    """A point that is marked in red, with a text beside it."""

    x: float
    y: float
    text: str


class Band(NamedTuple):
    """A stretch of the x axis, shaded by what it stands for: waiting, held, violated, fault or not run."""

    begin: float
    end: float
    kind: str


class Lane(NamedTuple):
    """A bar over the time with its text above it, such as an expectation with when it held."""

    text: str
    bands: Sequence[Band]


@dataclass(frozen=True)
class Panel:
    """Lines over the chart's x axis with a y axis of their own.

    ``bands`` are shaded here alone. The panel opens at ``y_range``.
    """

    title: str
    unit: str
    lines: Sequence[Line]
    marks: Sequence[Mark] = ()
    bands: Sequence[Band] = ()
    y_range: tuple[float, float] | None = None
    height_px: int = 120
    is_true_to_scale: bool = False


@dataclass(frozen=True)
class Chart:
    """Panels below each other over one x axis, under the lanes.

    ``bands`` are shaded over all panels; ``instants`` are red lines through all panels.
    """

    title: str
    caption: str
    panels: Sequence[Panel]
    x_title: str = "t [s]"
    lanes: Sequence[Lane] = ()
    bands: Sequence[Band] = ()
    instants: Sequence[float] = ()
    x_range: tuple[float, float] | None = None

    @property
    def height_px(self) -> int:
        """Height of the whole chart."""
        panels_px = sum(_TITLE_PX + panel.height_px for panel in self.panels)
        return _TOP_PX + _LANE_PX * len(self.lanes) + panels_px + _AXIS_PX

    @property
    def is_over_time(self) -> bool:
        """Whether its x axis is the time of the run, at which all such charts of a page are kept alike."""
        return self.x_title.startswith("t [")


def figure_of(chart: Chart, xs: list[Series]) -> dict[str, Any]:
    """Return a chart as plotly's data and layout; its x are numbers of arrays, which are appended to ``xs``."""
    data: list[dict[str, Any]] = []
    axes: dict[str, Any] = {}
    inner_px = chart.height_px - _TOP_PX - _AXIS_PX
    shapes = [_rectangle(band, "paper", 1.0 if band.kind == "not run" else 0.16) for band in chart.bands]
    lane_shapes, notes = _lanes(chart, inner_px)
    shapes += lane_shapes
    top_px = _LANE_PX * len(chart.lanes)
    for number, panel in enumerate(chart.panels, start=1):
        top = 1.0 - (top_px + _TITLE_PX) / inner_px
        top_px += _TITLE_PX + panel.height_px
        y = f"y{number}" if number > 1 else "y"
        axes[y.replace("y", "yaxis")] = _y_axis(panel, (1.0 - top_px / inner_px, top))
        data += [_trace(line, panel, y, xs) for line in panel.lines]
        data += [_marks(panel.marks, y, xs, chart)] if panel.marks else []
        shapes += [_rectangle(band, f"{y} domain", 0.12) for band in panel.bands]
        notes.append({"text": _title(panel), "y": top, "yshift": 5})
    for at in chart.instants:
        line = {"color": _RED, "width": 1, "dash": "dot"}
        shapes.append({"type": "line", "x0": at, "x1": at, "yref": "paper", "y0": 0, "y1": 1, "line": line})
    if chart.lanes:  # the times above them too: the axis below is far away
        axes["xaxis2"] = _TOP_AXIS
        data.append(_NOTHING | {"x": _number(_NOWHERE, xs), "y": packed(_NOWHERE, "f4")})
    lowest = f"y{len(chart.panels)}" if len(chart.panels) > 1 else "y"
    layout = {
        "xaxis": _x_axis(chart, lowest),
        **axes,
        "shapes": shapes,
        "annotations": [_NOTE | note for note in notes],
        "height": chart.height_px,
        "margin": {"l": _LEFT_PX, "r": 14, "t": _TOP_PX, "b": _AXIS_PX},
        "font": {"family": "system-ui, sans-serif", "size": 11, "color": _INK},
        "hovermode": "x unified" if not chart.panels[0].is_true_to_scale else "closest",
        "hoversubplots": "axis",
        "hoverdistance": -1,
        "showlegend": False,
        "plot_bgcolor": "rgba(0,0,0,0)",
        "dragmode": "zoom",
    }
    return {"data": data, "layout": layout, "time": chart.is_over_time}


def _lanes(chart: Chart, inner_px: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the shapes and the texts of the lanes, which are above the panels."""
    shapes, notes = [], []
    for number, lane in enumerate(chart.lanes):
        top, bottom = (1.0 - px / inner_px for px in (_LANE_PX * number + 17, _LANE_PX * (number + 1) - 3))
        shapes += [_rectangle(band, "paper", 1.0) | {"y0": bottom, "y1": top} for band in lane.bands]
        notes.append({"text": escape(lane.text), "y": top})
    return shapes, notes


def _rectangle(band: Band, y: str, opacity: float) -> dict[str, Any]:
    box = {"type": "rect", "xref": "x", "x0": band.begin, "x1": band.end, "yref": y, "y0": 0, "y1": 1}
    # An outline of each judged time, so that short ones are visible in a long run too.
    line = {"width": 1.5 if band.kind in ("violated", "fault") else 0, "color": _FILLS[band.kind]}
    return box | {"fillcolor": _FILLS[band.kind], "opacity": opacity, "line": line, "layer": "below"}


def _x_axis(chart: Chart, anchor: str) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "anchor": anchor,
        "title": {"text": chart.x_title, "standoff": 4},
        "gridcolor": _GRID,
        "zeroline": False,
        "showspikes": chart.is_over_time,
        "spikemode": "across",
        "spikethickness": 1,
        "spikecolor": "#888888",
        "spikedash": "solid",
        "unifiedhovertitle": {"text": re.sub(r" \[(.*)\]", r" = %{x:.6~g} \1", chart.x_title)},
    }
    if chart.x_range is not None:
        axis["range"] = list(chart.x_range)
    return axis


def _y_axis(panel: Panel, domain: tuple[float, float]) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "domain": list(domain),
        "gridcolor": _GRID,
        "zerolinecolor": "#bbbbbb",
        "nticks": max(3, panel.height_px // 22),
        "automargin": False,
    }
    if panel.y_range is not None:
        axis["range"] = list(panel.y_range)
    if panel.is_true_to_scale:
        axis["scaleanchor"] = "x"
    return axis


def _trace(line: Line, panel: Panel, y: str, xs: list[Series]) -> dict[str, Any]:
    is_alone = sum(one.in_title for one in panel.lines) < 2 and line is panel.lines[0]
    name = panel.title if is_alone else f"{panel.title}, {line.label}"
    return {
        "type": "scatter",
        "mode": "lines",
        "name": escape(name),
        "x": _number(line.x, xs),
        "y": packed(line.y, "f4"),
        "yaxis": y,
        "line": {"color": css(line.colour), "width": line.width_px, "dash": line.dash},
        "opacity": line.opacity,
        "hovertemplate": f"%{{y:.5~g}} {escape(panel.unit)}".rstrip(),
        "meta": f"{name} [{panel.unit}]" if panel.unit else name,
    }


def _marks(marks: Sequence[Mark], y: str, xs: list[Series], chart: Chart) -> dict[str, Any]:
    """Return the marks of a panel; their texts stand to the side on which there is more room."""
    low, high = chart.x_range or (marks[0].x, marks[0].x)
    return {
        "type": "scatter",
        "mode": "markers+text",
        "x": _number(np.array([mark.x for mark in marks]), xs),
        "y": packed(np.array([mark.y for mark in marks]), "f8"),
        "yaxis": y,
        "text": [f"<b>{escape(mark.text)}</b>" for mark in marks],
        "textposition": ["top left" if mark.x > (low + high) / 2 else "top right" for mark in marks],
        "textfont": {"color": _RED, "shadow": "0 0 2px white, 0 0 4px white"},
        "marker": {"symbol": "x", "size": 9, "color": _RED, "line": {"color": "white", "width": 1}},
        "hoverinfo": "skip",
        "cliponaxis": False,
    }


def _title(panel: Panel) -> str:
    unit = f" [{escape(panel.unit)}]" if panel.unit else ""
    keys = {line.label: line for line in reversed(panel.lines) if line.in_title}
    if len(keys) == 1:
        keys = {}
    signs = {"solid": "━", "dash": "╍", "dot": "┅"}
    words = (
        f'<span style="color:{css(line.colour)}">{signs[line.dash]} {escape(label)}</span>'
        for label, line in reversed(keys.items())
    )
    return "  ".join([f"<b>{escape(panel.title)}</b>{unit}", *words])


def css(colour: Colour) -> str:
    """Return a colour as style sheets and plotly write it."""
    return f"rgb({','.join(map(str, colour))})"


def _number(x: Series, xs: list[Series]) -> int:
    """Return the place of an array in ``xs``; append it if it is not there."""
    for place_, known in enumerate(xs):
        if known is x:
            return place_
    xs.append(x)
    return len(xs) - 1


def packed(values: Series, kind: str) -> Mapping[str, str]:
    """Return numbers as plotly takes them in JSON: their bytes, little-endian, in base64."""
    return {"dtype": kind, "bdata": base64.b64encode(values.astype(f"<{kind}").tobytes()).decode()}


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
