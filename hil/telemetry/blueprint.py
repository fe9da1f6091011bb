"""The views that a recording ships with: the whole run in review, the last ten seconds when live."""

import rerun.blueprint as rrb

LIVE_WINDOW_S = 10.0


def blueprint(*, live: bool) -> rrb.Blueprint:
    """Return the layout of the viewer.

    A recording under review shows the whole run, with the time cursor at its end; a live one follows the last
    ``LIVE_WINDOW_S`` seconds.
    """
    window = _window(live=live)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _trajectory(window),
                rrb.Tabs(
                    rrb.TextDocumentView(origin="/run", name="Run"),
                    rrb.TextLogView(origin="/events", name="Events"),
                ),
                rrb.StateTimelineView(origin="/robot", contents="/robot/state", name="Robot state", time_ranges=window),
                row_shares=[6, 3, 1.3],
            ),
            rrb.Vertical(
                _plot("Position error: truth minus reference [m]", ["/ctrl/error/position"], window),
                _plot(
                    "Position error, within 10 mm [m]",
                    ["/ctrl/error/position"],
                    window,
                    axis_y=rrb.ScalarAxis(range=(-0.01, 0.01)),
                ),
                _plot("Heading error: truth minus reference [rad]", ["/ctrl/error/heading"], window),
                rrb.Tabs(
                    _plot("Loop timing [µs]", ["/loop/timing"], window),
                    _plot("Age of command and feedback [ms]", ["/link/age"], window),
                    _plot("Deadline misses so far", ["/loop/deadline_misses"], window),
                ),
            ),
            rrb.Vertical(
                _plot(
                    "Wheel speed: command (wide) and estimate [rad/s]",
                    ["/ctrl/wheel/command/speed", "/ctrl/wheel/speed"],
                    window,
                ),
                rrb.Tabs(
                    _plot("Wheel torque command [N·m]", ["/ctrl/wheel/command/torque"], window),
                    _plot("Motor current [A]", ["/ctrl/wheel/current"], window),
                ),
                _plot("Gain K1 [1/s]", ["/ctrl/gain/k1"], window),
                _plot("Gain K2 [1/s]", ["/ctrl/gain/k2"], window),
                row_shares=[1.5, 1, 1, 1],
            ),
        ),
        rrb.BlueprintPanel(state=rrb.PanelState.Collapsed),
        rrb.SelectionPanel(state=rrb.PanelState.Collapsed),
        rrb.TimePanel(state=rrb.PanelState.Collapsed, timeline="t", play_state="Following"),
        auto_views=False,
    )


def _window(*, live: bool) -> rrb.VisibleTimeRange:
    if live:
        return rrb.VisibleTimeRange(
            "t",
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-LIVE_WINDOW_S),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    return rrb.VisibleTimeRange("t", start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())


def _plot(
    name: str, contents: list[str], window: rrb.VisibleTimeRange, axis_y: rrb.ScalarAxis | None = None
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        name=name,
        contents=contents,
        time_ranges=window,
        axis_y=axis_y,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )


def _trajectory(window: rrb.VisibleTimeRange) -> rrb.Spatial2DView:
    trail = rrb.VisibleTimeRanges([window])
    return rrb.Spatial2DView(
        name="Trajectory, world frame [m]: reference orange, estimate green, truth blue",
        # From the root: a transform on the origin itself would not apply.
        origin="/",
        contents="/xy/**",
        overrides={path: [trail] for path in ("/xy/reference", "/xy/pose", "/xy/truth")},
    )
