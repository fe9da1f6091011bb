"""The rerun blueprint of a recording: the views that the viewer opens. In review they show the whole run, live 10 s.

Tabs: the robot with its errors first, then wheels, law, link and loop, sensors, and the run in words. A view is left
out if the run has none of its signals.
"""

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb

from hil.record.drawings import BODY, FLOOR, PLAN, SCENE, TRAILS
from hil.record.lanes import FAULT_LANES, ROBOT_LANE
from hil.record.layout import MORE_PATH, NO_UNIT, SHADOW_GROUP, Entity
from hil.record.limits import LIMITS_PATH, Limit
from hil.record.robot_model import RobotShape

LIVE_WINDOW_S = 10.0
_CLOSE_M = 0.01
"""Half the range of the close view of the position error, where no expectation bounds it."""
_CLOSE_BOUNDS = 2.0
_POSITION_ERROR = "/ctrl/error/position"
_SPEED = ("/ctrl/wheel/command/speed", "/ctrl/wheel/speed")
_TORQUE = "/ctrl/wheel/command/torque"

Pane = rrb.View | rrb.Container


def blueprint(
    entities: Sequence[Entity], *, limits: Mapping[str, Sequence[Limit]], shape: RobotShape | None, live: bool
) -> rrb.Blueprint:
    """Return the layout of the viewer for a run with these entities, limits and robot.

    A recording under review shows the whole run, with the time cursor at its end; a live one follows the last
    ``LIVE_WINDOW_S`` seconds.
    """
    views = _Views([entity.path for entity in entities], limits, live=live)
    tabs = [
        views.robot(shape),
        _column_pair("Wheels", views.wheels()),
        _column_pair("Law", views.law()),
        _column_pair("Link and loop", views.link()),
        _column_pair("Estimator and sensors", views.sensors()),
        rrb.Horizontal(rrb.TextDocumentView(origin="/run", name="Figures and properties"), views.events(), name="Run"),
    ]
    return rrb.Blueprint(
        rrb.Tabs(*_there(*tabs), active_tab=0),
        rrb.BlueprintPanel(state=rrb.PanelState.Collapsed),
        rrb.SelectionPanel(state=rrb.PanelState.Collapsed),
        rrb.TimePanel(state=rrb.PanelState.Collapsed, timeline="t", play_state="Following"),
        auto_views=False,
    )


def _column_pair(name: str, views: Sequence[Pane | None]) -> Pane | None:
    """Put the views that are not None into two columns, filled row by row; return None when there is none."""
    there = _there(*views)
    columns = [rrb.Vertical(*one) for one in (there[::2], there[1::2]) if one]
    return rrb.Horizontal(*columns, name=name) if columns else None


def _there(*views: Pane | None) -> list[Pane]:
    return [view for view in views if view is not None]


class _Views:
    """Makes the views of a run, each over the same range of time."""

    def __init__(self, paths: Sequence[str], limits: Mapping[str, Sequence[Limit]], *, live: bool) -> None:
        self._paths = paths
        self._limits = limits
        self._window = _window(live=live)
        # The corner where a legend hides least: the oldest data when live, the newest in review.
        self._corner = rrb.Corner2D.LeftTop if live else rrb.Corner2D.RightTop

    def plot(
        self, name: str, *paths: str, limits: bool = True, y_range: tuple[float, float] | None = None
    ) -> rrb.TimeSeriesView | None:
        """Return a plot of those ``paths`` that the run has, by default with their limits; None if it has none."""
        shown = [path for path in paths if path in self._paths]
        if not shown:
            return None
        lines = [LIMITS_PATH + path for path in shown if path in self._limits] if limits else []
        return rrb.TimeSeriesView(
            name=name,
            contents=[*shown, *lines],
            time_ranges=self._window,
            axis_y=None if y_range is None else rrb.ScalarAxis(range=y_range),
            plot_legend=rrb.PlotLegend(corner=self._corner),
        )

    def robot(self, shape: RobotShape | None) -> Pane:
        """Return the first tab: the robot, its path, its errors, its wheels and its states."""
        spaces = [self.plan()] if shape is None else [self.scene(shape), self.plan()]
        errors = (
            self.plot("Position error: truth minus reference [m]", _POSITION_ERROR, limits=False),
            self.position_error_close(),
            self.plot("Heading error: truth minus reference, and its bounds [rad]", "/ctrl/error/heading"),
        )
        wheels = (
            self.plot("Wheel speed: command (wide) and estimate [rad/s]", *_SPEED, limits=False),
            self.plot("Wheel torque command [N·m]", _TORQUE, limits=False),
        )
        return rrb.Vertical(
            rrb.Horizontal(
                rrb.Vertical(*spaces, row_shares=[1.25, 1.0][-len(spaces) :]),
                rrb.Vertical(*_there(*errors)),
                rrb.Vertical(*_there(*wheels)),
                column_shares=[1.1, 1.0, 1.0],
            ),
            rrb.Horizontal(self.states(), self.events(), column_shares=[1.6, 1.0]),
            row_shares=[4.2, 1.0],
            name="Robot",
        )

    def position_error_close(self) -> Pane | None:
        """The position error near zero, with its bounds."""
        bounds = [abs(limit.value) for limit in self._limits.get(_POSITION_ERROR, ()) if limit.value]
        half_m = _CLOSE_BOUNDS * min(bounds) if bounds else _CLOSE_M
        name = f"Position error within {half_m * 1e3:g} mm, and its bounds [m]"
        return self.plot(name, _POSITION_ERROR, y_range=(-half_m, half_m))

    def wheels(self) -> list[Pane | None]:
        return [
            self.plot("Wheel speed: command (wide) and estimate, and bounds [rad/s]", *_SPEED),
            self.plot("Torque command and limits [N·m]", _TORQUE),
            self.plot("Motor current and limits [A]", "/ctrl/wheel/current"),
            self.plot("Winding temperature [°C]", "/ctrl/wheel/temperature"),
            self.plot("Command scaled at a limit: 1 for yes", "/ctrl/guard", limits=False),
            self.plot("Battery [V] and [A]", "/robot/battery"),
        ]

    def law(self) -> list[Pane | None]:
        shadows = [path for path in self._paths if path.startswith(f"{MORE_PATH}/{SHADOW_GROUP}/")]
        others = [path for path in self._paths if path.startswith(f"{MORE_PATH}/") and path not in shadows]
        return [
            self.plot("Gain K1 [1/s]", "/ctrl/gain/k1"),
            self.plot("Gain K2 [1/s]", "/ctrl/gain/k2"),
            self.position_error_close(),
            self.plot("Torque command [N·m]", _TORQUE, limits=False),
            *(self.plot(f"Shadow {_words(path)}", path, limits=False) for path in shadows),
            *(self.plot(_words(path), path, limits=False) for path in others),
        ]

    def link(self) -> list[Pane | None]:
        return [
            self.plot("Lateness and work of a tick [µs]", "/loop/timing"),
            self.plot("Round trip and latency [ms]", "/link/delay"),
            self.plot("Deadline misses so far", "/loop/deadline_misses"),
            self.plot("Age of command and feedback [ms]", "/link/age"),
            self.plot("Frames so far", "/link/frames"),
            self.plot("Load of the wire [%]", "/link/load"),
            self.plot("Robot's clock ahead [µs]", "/link/clock/offset", limits=False),
            self.plot("Robot's clock faster [ppm]", "/link/clock/drift", limits=False),
        ]

    def sensors(self) -> list[Pane | None]:
        return [
            self.plot("Standard deviation of the estimate [m] and [rad]", "/ctrl/estimator/sigma"),
            self.plot("Pose fixes so far", "/ctrl/estimator/fixes"),
            self.plot("Gyro and its bias [rad/s]", "/robot/gyro", "/ctrl/estimator/gyro_bias", limits=False),
            self.plot("Age of the newest fix [ms]", "/ctrl/estimator/fix_age"),
            self.plot("Acceleration [m/s²]", "/robot/acceleration", limits=False),
            self.plot("Slip: 1 for yes; health: 0 good, 2 lost", "/ctrl/estimator/state", limits=False),
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
            overrides={f"{FLOOR}/{name}": [rrb.VisibleTimeRanges([self._window])] for name, _, _, _ in TRAILS},
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
            overrides={f"{PLAN}/{name}": [rrb.VisibleTimeRanges([self._window])] for name, _, _, _ in TRAILS},
        )


def _words(path: str) -> str:
    """Return a title for the signals of a path below ``/more``: group and unit."""
    *group, unit = path.removeprefix(f"{MORE_PATH}/").removeprefix(f"{SHADOW_GROUP}/").split("/")
    words = " ".join(group).removesuffix(f"_{unit}")
    return words if unit == NO_UNIT else f"{words} [{unit}]"


def _window(*, live: bool) -> rrb.VisibleTimeRange:
    infinite, cursor = rrb.TimeRangeBoundary.infinite, rrb.TimeRangeBoundary.cursor_relative
    start, end = (cursor(seconds=-LIVE_WINDOW_S), cursor()) if live else (infinite(), infinite())
    return rrb.VisibleTimeRange("t", start=start, end=end)
