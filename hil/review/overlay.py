"""An overlay of two runs as a recording for the viewer: each signal of both over the scenario's time.

Both begin at t = 0, their first ACTIVE tick, at any rates. ``hil view`` opens the file, which has its own layout.
"""

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.core.errors import BadInputError
from hil.core.outputs import Existing, whole_file
from hil.core.signals import unit_of
from hil.core.types import WHEEL_NAMES
from hil.record.files import check_output_path
from hil.record.layout import REFERENCE_COLOUR, Colour
from hil.record.properties import OVERLAY_PROPERTY
from hil.record.started_process import rerun_environment
from hil.review.difference import changes
from hil.review.plots import Curve, Series, colour_of, thinned
from hil.review.reader import RecordedRun, read

if TYPE_CHECKING:
    import rerun.blueprint as rrb

_APPLICATION = "mecanum-hil-overlay"
_RUNS = ("first", "second")
_MOST_POINTS = 100_000
_TRAIL_POINTS = 4000
_WIDTHS_PX = (3.0, 1.5)  # the second is drawn over the first, which must still show


def write_overlay(first: Path, second: Path, file: Path, existing: Existing = "refuse") -> None:
    """Write the overlay of two recordings; ``existing`` says what to do if the file exists.

    Raises BadInputError when a recording cannot be read, rerun is not installed, or the file cannot be written.
    """
    check_output_path("overlay", file, existing)
    runs = read(first), read(second)
    with whole_file(file, "overlay", existing) as unfinished, _without_user_settings():
        try:
            _write(runs, unfinished)
        except ImportError as error:
            raise BadInputError(f"overlay {file}: {error}; install rerun-sdk==0.41.*") from error
        except (RuntimeError, OSError) as error:
            raise BadInputError(f"overlay {file}: {error}; choose a path that can be written") from error


@contextmanager
def _without_user_settings() -> Iterator[None]:
    """Take the user's settings for rerun out of the environment while the block runs."""
    users = dict(os.environ)
    os.environ.clear()
    os.environ.update(rerun_environment())
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(users)


def _write(runs: Sequence[RecordedRun], file: Path) -> None:
    import rerun as rr

    from hil.record.drawings import seconds_index

    rr.set_strict_mode(True)
    labels = [f"{which}: {run.properties.get('law', run.path.stem)}" for which, run in zip(_RUNS, runs, strict=True)]
    stream = rr.RecordingStream(_APPLICATION)
    stream.set_sinks(rr.FileSink(file), default_blueprint=_blueprint())
    stream.send_property(OVERLAY_PROPERTY, rr.AnyValues(json=json.dumps([str(run.path) for run in runs])))
    stream.send_recording_name(f"{labels[0]} and {labels[1]}")
    stream.log("/about", rr.TextDocument(_about(labels, runs), media_type=rr.MediaType.MARKDOWN), static=True)
    # A 2D view counts y downwards; the world's y points up.
    stream.log("/xy", rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)

    def trail(name: str, points: Series | None, colour: Colour, width_px: float, draw_order: float) -> None:
        if points is not None:
            # A negative radius is in pixels, whatever the zoom.
            strip = rr.LineStrips2D([points], colors=[colour], radii=[-width_px / 2], draw_order=draw_order)
            stream.log(f"/xy/{name}", strip, static=True)

    trail("reference", _points(runs[0], "reference"), REFERENCE_COLOUR, 6.0, 30.0)
    for number, (which, label, run) in enumerate(zip(_RUNS, labels, runs, strict=True)):
        colour, width_px = colour_of(number), _WIDTHS_PX[number]
        trail(which, _points(run, "truth", "pose"), colour, width_px, 31.0 + number)
        t_s = run.signals["loop.t_s"]
        for name, values in run.signals.items():
            known = np.isfinite(values) & np.isfinite(t_s)
            if known.any():
                path = f"/{name.replace('.', '/')}/{which}"
                curve = thinned(Curve("", t_s[known], values[known]), _MOST_POINTS)
                stream.log(path, rr.SeriesLines(names=[label], colors=[colour], widths=[width_px]), static=True)
                stream.send_columns(path, [seconds_index(curve.x)], rr.Scalars.columns(scalars=curve.y))
        for event in run.events:
            text = rr.TextLog.columns(text=[f"{label}: {event.text}"], level=[event.level])
            stream.send_columns(f"/events/{which}", [seconds_index(np.array([event.t_s]))], text)
    stream.flush()
    stream.disconnect()


def _points(run: RecordedRun, *groups: str) -> Series | None:
    """Return the path of a run, shape (n, 2), by the first of these groups of signals that has a value anywhere."""
    for group in groups:
        points = np.column_stack([run.signals.get(f"{group}.{axis}", np.empty(0)) for axis in ("x_m", "y_m")])
        points = points[np.isfinite(points).all(axis=1)]
        if len(points):
            return points[:: -(-len(points) // _TRAIL_POINTS)]
    return None


def _about(labels: Sequence[str], runs: Sequence[RecordedRun]) -> str:
    """Return a page that names the runs and how their scenarios and code differ."""
    lines = [f"- **{label}**: {run.path}" for label, run in zip(labels, runs, strict=True)]
    table = [f"| {key} | {one:.24} | {other:.24} |" for key, one, other in (row.words() for row in changes(*runs))]
    return "\n".join([*lines, "", "| different | first | second |", "|---|---|---|", *table, ""])


def _blueprint() -> "rrb.Blueprint":
    import rerun.blueprint as rrb

    from hil.record.blueprint import without_panels
    from hil.record.views import window

    def plot(title: str, signal: str) -> rrb.TimeSeriesView:
        unit = unit_of(signal)
        return rrb.TimeSeriesView(
            name=f"{title} [{unit}]" if unit else title,
            contents=f"/{signal.replace('.', '/')}/**",
            time_ranges=window(live=False),
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        )

    def wheels(title: str, quantity: str) -> rrb.Grid:
        plots = [plot(f"{title} {wheel.upper()}", f"wheel.{wheel}.{quantity}") for wheel in WHEEL_NAMES]
        return rrb.Grid(*plots, grid_columns=2, name=title)

    axes = ("x", "y", "heading")
    gains = [plot(f"{gain.upper()} {axis}", f"gain.{gain}_{axis}_1_s") for gain in ("k1", "k2") for axis in axes]
    errors = {"Planar error": "planar_m", "Error x": "x_m", "Error y": "y_m", "Heading error": "heading_rad"}
    timing = {
        "Lateness": "loop.lateness_us",
        "Work of a tick": "loop.tick_us",
        "Feedback age": "link.feedback_age_ms",
        "Round trip": "link.rtt_ms",
    }
    return without_panels(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(name="Trajectory, world frame [m]: reference orange", origin="/", contents="/xy/**"),
                rrb.Tabs(
                    rrb.TextDocumentView(origin="/about", name="Runs"),
                    rrb.TextLogView(origin="/", contents="/events/**", name="Events"),
                ),
                row_shares=[3, 2],
            ),
            rrb.Vertical(*(plot(title, f"error.{name}") for title, name in errors.items())),
            rrb.Tabs(
                wheels("Wheel speed", "speed_rad_s"),
                wheels("Speed command", "speed_command_rad_s"),
                wheels("Torque command", "torque_command_n_m"),
                wheels("Motor current", "current_a"),
                rrb.Grid(*gains, grid_columns=3, name="Gains"),
                rrb.Vertical(*(plot(title, signal) for title, signal in timing.items()), name="Loop and link"),
            ),
            column_shares=[2, 2, 3],
        )
    )
