"""An overlay of two runs as a recording for the viewer: each signal of both over the scenario's time.

Both begin at t = 0, their first ACTIVE tick, whatever their rates are. ``hil view`` opens the file, which has its own
layout of views. A separate process, ``python -m hil.review.overlay FIRST SECOND FILE``, writes it, because the user's
settings for rerun must not apply.
"""

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hil.core.errors import BadInputError
from hil.core.outputs import Existing, whole_file
from hil.core.signals import unit_of
from hil.core.subprocesses import module_command
from hil.core.types import WHEEL_NAMES
from hil.record.files import check_output_path
from hil.record.layout import REFERENCE_COLOUR
from hil.record.properties import OVERLAY_PROPERTY
from hil.record.started_process import rerun_environment
from hil.review.difference import changes
from hil.review.plots import Curve, colour_of, thinned
from hil.review.reader import RecordedRun, read

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

Series = npt.NDArray[np.float64]

_APPLICATION = "mecanum-hil-overlay"
_RUNS = ("first", "second")
_MOST_POINTS = 100_000
_TRAIL_POINTS = 4000
_WIDTHS_PX = (3.0, 1.5)  # the second is drawn over the first, which must still show


def write_overlay(first: Path, second: Path, file: Path, existing: Existing = "refuse") -> None:
    """Write the overlay of two recordings; ``existing`` says what to do if the file exists.

    Raises BadInputError when a recording cannot be read, or the file cannot be written.
    """
    check_output_path("overlay", file, existing)
    with whole_file(file, "overlay", existing) as unfinished:
        done = subprocess.run(
            module_command("hil.review.overlay", str(first), str(second), str(unfinished)),
            capture_output=True,
            env=rerun_environment(),
            check=False,
            text=True,
        )
        if done.returncode != 0:
            reason = done.stdout.strip() or f"its writer ended with exit status {done.returncode}"
            raise BadInputError(f"overlay {file}: {reason}; choose a path that can be written")


def main() -> int:
    """Write the overlay; return 1, with the reason on standard output, when that fails."""
    first, second, file = map(Path, sys.argv[1:])
    try:
        _write([read(first), read(second)], file)
    except (BadInputError, RuntimeError, OSError) as error:
        print(error)
        return 1
    return 0


def _write(runs: Sequence[RecordedRun], file: Path) -> None:
    import rerun as rr

    rr.set_strict_mode(True)
    labels = [f"{which}: {run.properties.get('law', run.path.stem)}" for which, run in zip(_RUNS, runs, strict=True)]
    stream = rr.RecordingStream(_APPLICATION)
    stream.set_sinks(rr.FileSink(file), default_blueprint=_blueprint())
    stream.send_property(OVERLAY_PROPERTY, rr.AnyValues(json=json.dumps([str(run.path) for run in runs])))
    stream.send_recording_name(f"{labels[0]} and {labels[1]}")
    stream.log("/about", rr.TextDocument(_about(labels, runs), media_type=rr.MediaType.MARKDOWN), static=True)
    # A 2D view counts y downwards; the world's y points up.
    stream.log("/xy", rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
    _trail(stream, "/xy/reference", runs[0].signals, ("reference",), REFERENCE_COLOUR, 6.0, 30.0)
    for number, (which, label, run) in enumerate(zip(_RUNS, labels, runs, strict=True)):
        colour, width_px = colour_of(number), _WIDTHS_PX[number]
        _trail(stream, f"/xy/{which}", run.signals, ("truth", "pose"), colour, width_px, 31.0 + number)
        for name, values in run.signals.items():
            style = rr.SeriesLines(names=[label], colors=[colour], widths=[width_px])
            _signal(stream, f"/{name.replace('.', '/')}/{which}", run.signals["loop.t_s"], values, style)
        for event in run.events:
            stream.send_columns(
                f"/events/{which}",
                indexes=[_times(np.array([event.t_s]))],
                columns=rr.TextLog.columns(text=[f"{label}: {event.text}"], level=[event.level]),
            )
    stream.flush()
    stream.disconnect()


def _signal(stream: "rr.RecordingStream", path: str, t_s: Series, values: Series, style: "rr.SeriesLines") -> None:
    import rerun as rr

    there = np.isfinite(values) & np.isfinite(t_s)
    if not there.any():
        return
    curve = thinned(Curve("", t_s[there], values[there]), _MOST_POINTS)
    stream.log(path, style, static=True)
    stream.send_columns(path, indexes=[_times(curve.x)], columns=rr.Scalars.columns(scalars=curve.y))


def _trail(
    stream: "rr.RecordingStream",
    path: str,
    signals: Mapping[str, Series],
    groups: Sequence[str],
    colour: tuple[int, int, int],
    width_px: float,
    draw_order: float,
) -> None:
    """Draw the path of a run by the first of these groups of signals that has a value anywhere."""
    import rerun as rr

    for group in groups:
        points = np.column_stack([signals.get(f"{group}.{axis}", np.empty(0)) for axis in ("x_m", "y_m")])
        points = points[np.isfinite(points).all(axis=1)]
        if len(points):
            points = points[:: -(-len(points) // _TRAIL_POINTS)]
            # A negative radius is in pixels, whatever the zoom.
            strip = rr.LineStrips2D([points], colors=[colour], radii=[-width_px / 2], draw_order=draw_order)
            stream.log(path, strip, static=True)
            return


def _times(t_s: Series) -> "rr.TimeColumn":
    import rerun as rr

    return rr.TimeColumn("t", duration=np.rint(t_s * 1e9).astype("timedelta64[ns]"))


def _about(labels: Sequence[str], runs: Sequence[RecordedRun]) -> str:
    """Return a page that names the runs and how their scenarios and code differ."""
    lines = [f"- **{label}**: {run.path}" for label, run in zip(labels, runs, strict=True)]
    table = [f"| {key} | {one:.24} | {other:.24} |" for key, one, other in (row.words() for row in changes(*runs))]
    return "\n".join([*lines, "", "| different | first | second |", "|---|---|---|", *table, ""])


def _blueprint() -> "rrb.Blueprint":
    import rerun.blueprint as rrb

    window = rrb.VisibleTimeRange("t", start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())

    def plot(title: str, *signals: str) -> rrb.TimeSeriesView:
        unit = unit_of(signals[0])
        return rrb.TimeSeriesView(
            name=f"{title} [{unit}]" if unit else title,
            contents=[f"/{signal.replace('.', '/')}/**" for signal in signals],
            time_ranges=window,
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
        )

    def wheels(title: str, quantity: str) -> rrb.Grid:
        plots = [plot(f"{title} {wheel.upper()}", f"wheel.{wheel}.{quantity}") for wheel in WHEEL_NAMES]
        return rrb.Grid(*plots, grid_columns=2, name=title)

    gains = [
        plot(f"{gain.upper()} {axis}", f"gain.{gain}_{axis}_1_s")
        for gain in ("k1", "k2")
        for axis in ("x", "y", "heading")
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(name="Trajectory, world frame [m]: reference orange", origin="/", contents="/xy/**"),
                rrb.Tabs(
                    rrb.TextDocumentView(origin="/about", name="Runs"),
                    rrb.TextLogView(origin="/", contents="/events/**", name="Events"),
                ),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                plot("Planar error", "error.planar_m"),
                plot("Error x", "error.x_m"),
                plot("Error y", "error.y_m"),
                plot("Heading error", "error.heading_rad"),
            ),
            rrb.Tabs(
                wheels("Wheel speed", "speed_rad_s"),
                wheels("Speed command", "speed_command_rad_s"),
                wheels("Torque command", "torque_command_n_m"),
                wheels("Motor current", "current_a"),
                rrb.Grid(*gains, grid_columns=3, name="Gains"),
                rrb.Vertical(
                    plot("Lateness", "loop.lateness_us"),
                    plot("Work of a tick", "loop.tick_us"),
                    plot("Feedback age", "link.feedback_age_ms"),
                    plot("Round trip", "link.rtt_ms"),
                    name="Loop and link",
                ),
            ),
            column_shares=[2, 2, 3],
        ),
        rrb.BlueprintPanel(state=rrb.PanelState.Collapsed),
        rrb.SelectionPanel(state=rrb.PanelState.Collapsed),
        rrb.TimePanel(state=rrb.PanelState.Collapsed, timeline="t", play_state="Following"),
        auto_views=False,
    )


if __name__ == "__main__":
    sys.exit(main())
