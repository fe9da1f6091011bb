"""The rerun blueprint of a recording: the views that the viewer opens. In review they show the whole run, live 10 s.

Tabs: the robot with its errors first, then wheels, law, link and loop, sensors, and the run's page. A view is left out
if the run has none of its signals.
"""

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb

from hil.record.drawings import BODY, FLOOR, PLAN, SCENE, TRAILS
from hil.record.lanes import FAULT_LANES, LIMITS_PATH, ROBOT_LANE, Limit
from hil.record.layout import MORE_PATH, NO_UNIT, SHADOW_GROUP, Entity
from hil.record.robot_model import RobotShape

LIVE_WINDOW_S = 10.0
_CLOSE_M = 0.01
"""Half the range of the close view of the position error, where no expectation bounds it."""
_CLOSE_BOUNDS = 2.0
_POSITION_ERROR = "/ctrl/error/position"
_SPEED = ("/ctrl/wheel/command/speed", "/ctrl/wheel/speed")
_TORQUE = ("/ctrl/wheel/command/torque",)

Pane = rrb.View | rrb.Container


_WHEELS = {
    "Wheel speed: command (wide) and estimate, and bounds [rad/s]": _SPEED,
    "Torque command and limits [N·m]": _TORQUE,
    "Motor current and limits [A]": ("/ctrl/wheel/current",),
    "Winding temperature [°C]": ("/ctrl/wheel/temperature",),
    "Command scaled at a limit: 1 for yes": ("/ctrl/guard",),
    "Battery [V] and [A]": ("/robot/battery",),
}
"""The plots of a tab by their titles, each with the paths of the entities that it shows."""
_LINK = {
    "Lateness and work of a tick [µs]": ("/loop/timing",),
    "Round trip and latency [ms]": ("/link/delay",),
    "Deadline misses so far": ("/loop/deadline_misses",),
    "Age of command and feedback [ms]": ("/link/age",),
    "Frames so far": ("/link/frames",),
    "Load of the wire [%]": ("/link/load",),
    "Robot's clock ahead [µs]": ("/link/clock/offset",),
    "Robot's clock faster [ppm]": ("/link/clock/drift",),
}
_SENSORS = {
    "Standard deviation of the estimate [m] and [rad]": ("/ctrl/estimator/sigma",),
    "Pose fixes so far": ("/ctrl/estimator/fixes",),
    "Gyro and its bias [rad/s]": ("/robot/gyro", "/ctrl/estimator/gyro_bias"),
    "Age of the newest fix [ms]": ("/ctrl/estimator/fix_age",),
    "Acceleration [m/s²]": ("/robot/acceleration",),
    "Slip: 1 for yes; health: 0 good, 2 lost": ("/ctrl/estimator/state",),
}


def blueprint(
    entities: Sequence[Entity], *, limits: Mapping[str, Sequence[Limit]], shape: RobotShape | None, live: bool
) -> rrb.Blueprint:
    """Return the layout of the viewer for a run with these entities, limits and robot.

    A recording under review shows the whole run, with the time cursor at its end; a live one follows the last
    ``LIVE_WINDOW_S`` seconds.
    """
    views = _Views([entity.path for entity in entities], limits, live=live)
    return without_panels(
        rrb.Tabs(
            views.robot(shape),
            *views.tab("Wheels", views.plots(_WHEELS)),
            *views.tab("Law", views.law()),
            *views.tab("Link and loop", views.plots(_LINK)),
            *views.tab("Estimator and sensors", views.plots(_SENSORS)),
            rrb.Horizontal(
                rrb.TextDocumentView(origin="/run", name="Figures and properties"), views.events(), name="Run"
            ),
            active_tab=0,
        )
    )


def without_panels(root: Pane) -> rrb.Blueprint:
    """Return a layout of these views alone, rerun's own panels closed, with the time cursor at the end of ``t``."""
    closed = rrb.PanelState.Collapsed
    time_panel = rrb.TimePanel(state=closed, timeline="t", play_state="Following")
    panels = (rrb.BlueprintPanel(state=closed), rrb.SelectionPanel(state=closed), time_panel)
    return rrb.Blueprint(root, *panels, auto_views=False)


def window(*, live: bool) -> rrb.VisibleTimeRanges:
    """Return the range of time that a view shows: the last ``LIVE_WINDOW_S`` seconds, or the whole run."""
    infinite, cursor = rrb.TimeRangeBoundary.infinite, rrb.TimeRangeBoundary.cursor_relative
    start, end = (cursor(seconds=-LIVE_WINDOW_S), cursor()) if live else (infinite(), infinite())
    return rrb.VisibleTimeRanges([rrb.VisibleTimeRange("t", start=start, end=end)])


class _Views:
    """Makes the views of a run, each over the same range of time."""

    def __init__(self, paths: Sequence[str], limits: Mapping[str, Sequence[Limit]], *, live: bool) -> None:
        self._paths = paths
        self._limits = limits
        self._window = window(live=live)
        # The corner where a legend hides least: the oldest data when live, the newest in review.
        self._corner = rrb.Corner2D.LeftTop if live else rrb.Corner2D.RightTop

    def plots(
        self, plots: Mapping[str, Sequence[str]], *, limits: bool = True, y_range: tuple[float, float] | None = None
    ) -> list[Pane]:
        """Return the ``plots`` (paths by title) of which the run has an entity, by default with the limits."""
        shown = {title: [path for path in paths if path in self._paths] for title, paths in plots.items()}
        return [
            rrb.TimeSeriesView(
                name=title,
                contents=[*paths, *(LIMITS_PATH + path for path in paths if limits and path in self._limits)],
                time_ranges=self._window,
                axis_y=None if y_range is None else rrb.ScalarAxis(range=y_range),
                plot_legend=rrb.PlotLegend(corner=self._corner),
            )
            for title, paths in shown.items()
            if paths
        ]

    def tab(self, name: str, views: Sequence[Pane]) -> list[Pane]:
        """Return a tab with these views in two columns, filled row by row; none if there are no views."""
        columns = [rrb.Vertical(*column) for column in (views[::2], views[1::2]) if column]
        return [rrb.Horizontal(*columns, name=name)] if columns else []

    def robot(self, shape: RobotShape | None) -> Pane:
        """Return the first tab: the robot, its path, its errors, its wheels and its states."""
        spaces = [self.plan()] if shape is None else [self.scene(shape), self.plan()]
        errors = (
            *self.plots({"Position error: truth minus reference [m]": [_POSITION_ERROR]}, limits=False),
            *self.position_error_close(),
            *self.plots({"Heading error: truth minus reference, and its bounds [rad]": ["/ctrl/error/heading"]}),
        )
        wheels = {"Wheel speed: command (wide) and estimate [rad/s]": _SPEED, "Wheel torque command [N·m]": _TORQUE}
        return rrb.Vertical(
            rrb.Horizontal(
                rrb.Vertical(*spaces, row_shares=[1.25, 1.0][-len(spaces) :]),
                rrb.Vertical(*errors),
                rrb.Vertical(*self.plots(wheels, limits=False)),
                column_shares=[1.1, 1.0, 1.0],
            ),
            rrb.Horizontal(self.states(), self.events(), column_shares=[1.6, 1.0]),
            row_shares=[4.2, 1.0],
            name="Robot",
        )

    def position_error_close(self) -> list[Pane]:
        """Return a plot of the position error near zero, with its bounds."""
        bounds = [abs(limit.value) for limit in self._limits.get(_POSITION_ERROR, ()) if limit.value]
        half_m = _CLOSE_BOUNDS * min(bounds) if bounds else _CLOSE_M
        title = f"Position error within {half_m * 1e3:g} mm, and its bounds [m]"
        return self.plots({title: [_POSITION_ERROR]}, y_range=(-half_m, half_m))

    def law(self) -> list[Pane]:
        more = [path for path in self._paths if path.startswith(f"{MORE_PATH}/")]
        shadows = [path for path in more if path.startswith(f"{MORE_PATH}/{SHADOW_GROUP}/")]
        return [
            *self.plots({"Gain K1 [1/s]": ["/ctrl/gain/k1"], "Gain K2 [1/s]": ["/ctrl/gain/k2"]}),
            *self.position_error_close(),
            *self.plots({"Torque command [N·m]": _TORQUE}, limits=False),
            *self.plots({f"Shadow {_title(path)}": [path] for path in shadows}),
            *self.plots({_title(path): [path] for path in more if path not in shadows}),
        ]

    def states(self) -> Pane:
        lanes = [ROBOT_LANE, "/link/state", "/ctrl/estimator/health", f"{FAULT_LANES}/**"]
        return rrb.StateTimelineView(
            origin="/", contents=lanes, name="States: robot, link, estimator, faults", time_ranges=self._window
        )

    def events(self) -> Pane:
        return rrb.TextLogView(origin="/events", name="Events: faults, expectations, warnings")

    def scene(self, shape: RobotShape) -> Pane:
        """The robot from behind and above; the camera follows it."""
        far = 1.3 * (shape.half_length_m + shape.half_width_m)
        scale = f"{1e3 * shape.force_scale_m_n:g} mm/N"
        return rrb.Spatial3DView(
            name=f"Robot: wheel forces {scale}, reference orange, error red",
            origin=SCENE,
            contents=f"{SCENE}/**",
            overrides={f"{FLOOR}/{name}": [self._window] for name, _, _, _ in TRAILS},
            eye_controls=rrb.EyeControls3D(
                position=(-0.7 * far, -0.55 * far, 0.75 * far),
                look_target=(0.0, 0.0, 0.0),
                eye_up=(0.0, 0.0, 1.0),
                tracking_entity=BODY,
            ),
        )

    def plan(self) -> Pane:
        return rrb.Spatial2DView(
            name="Plan [m]: reference orange, estimate green, truth blue",
            # From the root: a transform on the origin itself would not apply.
            origin="/",
            contents=f"{PLAN}/**",
            overrides={f"{PLAN}/{name}": [self._window] for name, _, _, _ in TRAILS},
        )


def _title(path: str) -> str:
    """Return a title for the signals of a path below ``/more``: group and unit."""
    *group, unit = path.removeprefix(f"{MORE_PATH}/").removeprefix(f"{SHADOW_GROUP}/").split("/")
    words = " ".join(group).removesuffix(f"_{unit}")
    return words if unit == NO_UNIT else f"{words} [{unit}]"
