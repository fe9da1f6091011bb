"""The rerun blueprint of a recording: the views that the viewer opens. In review they show the whole run, live 10 s.

Tabs: the verdict with the states, the events, the errors and the robot first; then the transients, wheels, law,
link and loop, sensors, and the run's page. A view is left out if the run has none of its signals.
"""

from collections.abc import Mapping, Sequence

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange
from rerun.blueprint.encodings import TimelineColumn

from hil.addons.report.claim_watch import LIMITS_PATH, VIOLATIONS_PATH, Limit
from hil.addons.report.entities import MORE_PATH, NO_UNIT, Entity
from hil.addons.report.lanes import LANES
from hil.addons.report.review_windows import Course, Window
from hil.addons.report.scene import BODY, FLOOR, PLAN, SCENE, TRAILS
from hil.addons.report.urdf import RobotShape
from hil.core.signals import unit_of

LIVE_WINDOW_S = 10.0
VERDICT = "/verdict"
LOG = "/log"
"""The events with their times in their texts, for the viewer: its own column of times is too narrow to read."""
_AFTER_END = 0.02
"""How much longer than the run the lanes of states are, as a share of it."""
Pane = rrb.View | rrb.Container
_CLOSE_M = 0.01
"""Half the range of the close view of the position error, where no expectation bounds it."""
_CLOSE_BOUNDS = 2.0
_LANE_PX, _LANES_FRAME_PX, _LINE_PX, _VERDICT_PX, _PAGE_PX = 40, 68, 24, 118, 1000
_MOST_LANES = 11
_TWO_ROWS_PX = 420
_WINDOWS_A_TAB = 4
_POSITION_ERROR = "/ctrl/error/position"
_HEADING_ERROR = "/ctrl/error/heading"
_SPEED = ("/ctrl/wheel/command/speed", "/ctrl/wheel/speed")
_TORQUE = ("/ctrl/wheel/command/torque",)


_WHEELS = {
    "Wheel speed: command (wide) and estimate, and bounds [rad/s]": _SPEED,
    "Torque command and limits [N·m]": _TORQUE,
    "Motor current and limits [A]": ("/ctrl/wheel/current",),
    "Winding temperature [°C]": ("/ctrl/wheel/temperature",),
    "Command scaled at a limit: 1 for yes": ("/ctrl/guard",),
    "Torque taken by a limit of motion [N·m], and which": ("/ctrl/limiter",),
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
_TRANSIENT = {
    "Position error [m]": (_POSITION_ERROR,),
    "Heading error [rad]": (_HEADING_ERROR,),
    "Wheel speed: command (wide), estimate [rad/s]": _SPEED,
    "Torque command [N·m]": _TORQUE,
}


class _Views:
    """Makes the views of a run, each over the same range of time."""

    def __init__(self, entities: Sequence[Entity], limits: Mapping[str, Sequence[Limit]], *, live: bool) -> None:
        self._families: dict[str, list[str]] = {}  # of each plot, the paths of the entities that it shows
        for entity in entities:
            self._families.setdefault(entity.plot or entity.path, []).append(entity.path)
        self._limits = limits
        self._units = {entity.path: unit_of(entity.series[0].signal) for entity in entities}
        self._is_live = live
        infinite, cursor = rrb.TimeRangeBoundary.infinite, rrb.TimeRangeBoundary.cursor_relative
        start, end = (cursor(seconds=-LIVE_WINDOW_S), cursor()) if live else (infinite(), infinite())
        # The last seconds, or the whole run.
        self._window = rrb.VisibleTimeRanges([rrb.VisibleTimeRange("t", start=start, end=end)])
        # The corner where a legend hides least: the oldest data when live, the newest in review.
        self._corner = rrb.Corner2D.LeftTop if live else rrb.Corner2D.RightTop

    def plots(
        self,
        plots: Mapping[str, Sequence[str]],
        *,
        limits: bool = True,
        y_range: tuple[float, float] | None = None,
        span: Window | None = None,
    ) -> list[Pane]:
        """Return the ``plots`` (paths by title) of which the run has an entity, by default with the limits.

        With ``span`` they show that time alone, else that of the other views.
        """
        shown = {title: [path for path in paths if path in self._families] for title, paths in plots.items()}
        return [
            rrb.TimeSeriesView(
                name=title,
                contents=[one for path in paths for one in self._contents(path, limits=limits)],
                time_ranges=self._window if span is None else _only(span),
                axis_x=None if span is None else rrb.TimeAxis(view_range=_time_range(span)),
                axis_y=None if y_range is None else rrb.ScalarAxis(range=y_range),
                plot_legend=rrb.PlotLegend(corner=self._corner),
            )
            for title, paths in shown.items()
            if paths
        ]

    def _contents(self, path: str, *, limits: bool) -> list[str]:
        bounds = [f"{LIMITS_PATH}{path}/**"] if limits and path in self._limits else []
        return [*self._families[path], *bounds, f"{VIOLATIONS_PATH}{path}/**"]

    @property
    def paths(self) -> list[str]:
        """The paths of the plots that the run has."""
        return list(self._families)

    def unit(self, path: str) -> str:
        """Return the unit of the first signal of an entity."""
        return self._units[path]

    def bounds(self, path: str) -> list[float]:
        """Return the values of the bounds of a plot."""
        return [limit.value for limit in self._limits.get(path, ())]

    def add(self, path: str) -> None:
        """Add an entity that holds no signal of the run, but something computed from them."""
        self._families.setdefault(path, [path])

    def tab(self, name: str, views: Sequence[Pane]) -> list[Pane]:
        """Return a tab with these views in two columns, filled row by row; none if there are no views."""
        columns = [rrb.Vertical(*column) for column in (views[::2], views[1::2]) if column]
        return [rrb.Horizontal(*columns, name=name)] if columns else []

    def states(self, course: Course | None) -> Pane:
        """Return the lanes of states; a little time after the end shows what began in the last instant."""
        after = None
        if course is not None and not self._is_live:
            after = Window(course.begin_s, course.end_s + _AFTER_END * (course.end_s - course.begin_s), "")
        return rrb.StateTimelineView(
            origin=LANES,
            contents=f"{LANES}/**",
            name="States: verdict, robot, link, expectations, faults in force",
            time_ranges=self._window,
            time_view=None if after is None else rrb.TimeAxis(view_range=_time_range(after)),
        )

    def events(self) -> Pane:
        return rrb.TextLogView(
            origin=LOG,
            name="Events: faults, expectations, warnings",
            columns=rrb.TextLogColumns(
                timeline_columns=[TimelineColumn("t", visible=False)], text_log_columns=["LogLevel", "Body"]
            ),
        )

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


def _title_of(path: str) -> str:
    """Return a title for the signals of a path: group and unit."""
    *group, unit = path.removeprefix(f"{MORE_PATH}/").strip("/").split("/")
    words = " ".join(group).removesuffix(f"_{unit}")
    return words if unit == NO_UNIT else f"{words} [{unit}]"


def _only(span: Window) -> rrb.VisibleTimeRanges:
    at = rrb.TimeRangeBoundary.absolute
    return rrb.VisibleTimeRanges([rrb.VisibleTimeRange("t", start=at(seconds=span.from_s), end=at(seconds=span.to_s))])


def _time_range(span: Window) -> rr.TimeRange:
    at = rr.TimeRangeBoundary.absolute
    return rr.TimeRange(start=at(seconds=span.from_s), end=at(seconds=span.to_s))


def blueprint(
    entities: Sequence[Entity],
    *,
    limits: Mapping[str, Sequence[Limit]],
    shape: RobotShape | None,
    live: bool,
    course: Course | None = None,
) -> rrb.Blueprint:
    """Return the layout of the viewer for a run with these entities, limits and robot.

    A recording under review shows the whole run; a live one follows the last ``LIVE_WINDOW_S`` seconds. ``course`` is
    what the run turned out to have, None before its end. The time cursor is at the end; the first violation is the
    selected range.
    """
    views = _Views(entities, limits, live=live)
    selected = None if course is None else course.first_violation
    return _without_panels(
        rrb.Tabs(
            _verdict(views, shape, course),
            *_transients(views, course),
            *views.tab("Wheels", views.plots(_WHEELS)),
            *views.tab("Law", _law(views)),
            *views.tab("Link and loop", views.plots(_LINK)),
            *views.tab("Estimator and sensors", views.plots(_SENSORS)),
            _page(views),
            active_tab=0,
        ),
        selected=selected,
    )


def first_blueprint(
    entities: Sequence[Entity], *, limits: Mapping[str, Sequence[Limit]], shape: RobotShape | None, live: bool
) -> rrb.Blueprint:
    """Return the layout before a row is drawn: the first and the last tab alone.

    It is that of a file whose recorder was killed, too. A whole layout is half a megabyte.
    """
    views = _Views(entities, limits, live=live)
    return _without_panels(rrb.Tabs(_verdict(views, shape, None), _page(views), active_tab=0))


def _page(views: _Views) -> Pane:
    """Return the last tab: the run's page and its events."""
    page = rrb.TextDocumentView(origin="/run", name="Figures and properties")
    return rrb.Horizontal(page, views.events(), name="Run")


def _without_panels(root: Pane, selected: tuple[float, float] | None = None) -> rrb.Blueprint:
    """Return a layout of these views alone, rerun's own panels closed, with the time cursor at the end of ``t``.

    ``selected`` is a range of time [s] that is marked in the time panel.
    """
    closed = rrb.PanelState.Collapsed
    range_ns = None if selected is None else AbsoluteTimeRange(*(round(t_s * 1e9) for t_s in selected))
    time_panel = rrb.TimePanel(state=closed, timeline="t", play_state="Following", time_selection=range_ns)
    panels = (rrb.BlueprintPanel(state=closed), rrb.SelectionPanel(state=closed), time_panel)
    return rrb.Blueprint(root, *panels, auto_views=False)


def _verdict(views: _Views, shape: RobotShape | None, course: Course | None) -> Pane:
    """Return the first tab: the verdict, the states, what was violated, the errors, the events and the robot."""
    spaces = [views.plan()] if shape is None else [views.scene(shape), views.plan()]
    lanes = min(_MOST_LANES, 4 if course is None else course.lanes)
    heights = [_VERDICT_PX + (1 if course is None else course.lines) * _LINE_PX, lanes * _LANE_PX + _LANES_FRAME_PX]
    left_px = _PAGE_PX - sum(heights)
    plots = views.tab("Errors", _first_plots(views, course)[: 4 if left_px > _TWO_ROWS_PX else 2])
    told = rrb.TextDocumentView(origin=VERDICT, name="Verdict", titlebar=False)
    return rrb.Horizontal(
        rrb.Vertical(told, views.states(course), *plots, row_shares=[*heights, left_px][: 2 + len(plots)]),
        rrb.Vertical(views.events(), *spaces, row_shares=[1.0, 1.25, 1.25][: 1 + len(spaces)]),
        column_shares=[2.0, 1.0],
        name="Verdict",
    )


def _first_plots(views: _Views, course: Course | None) -> list[Pane]:
    """Return plots: first those in which something is violated, then the errors and the wheels."""
    violated = () if course is None else course.violated
    titles = {path: title for plots in (_WHEELS, _LINK, _SENSORS) for title, paths in plots.items() for path in paths}
    titles |= {_HEADING_ERROR: "Heading error: truth minus reference, and its bounds [rad]"}
    first: list[Pane] = []
    for path in violated[:2]:
        if path == _POSITION_ERROR:
            first += _position_error_close(views)
        else:
            first += views.plots({f"Violated: {titles.get(path, _title_of(path))}": [path]})
    rest = [
        *views.plots({"Position error: truth minus reference [m]": [_POSITION_ERROR]}, limits=False),
        *([] if _POSITION_ERROR in violated[:2] else _position_error_close(views)),
        *([] if _HEADING_ERROR in violated[:2] else views.plots({titles[_HEADING_ERROR]: [_HEADING_ERROR]})),
        *views.plots({"Wheel speed: command (wide) and estimate [rad/s]": _SPEED}, limits=False),
    ]
    return [*first, *rest]


def _transients(views: _Views, course: Course | None) -> list[Pane]:
    """Return a tab with a column of plots for each window of the run; more than four are spread over tabs."""
    spans = () if course is None else course.windows
    columns = [rrb.Vertical(*views.plots(_plain(_TRANSIENT, span), span=span), name=span.words[:40]) for span in spans]
    groups = [columns[i : i + _WINDOWS_A_TAB] for i in range(0, len(columns), _WINDOWS_A_TAB)]
    tabs = [rrb.Horizontal(*group, name=f"Transients {number}") for number, group in enumerate(groups, 1)]
    if len(tabs) == 1:
        return [rrb.Horizontal(*columns, name="Transients")]
    return [*tabs]


def _law(views: _Views) -> list[Pane]:
    more = [path for path in views.paths if path.startswith(f"{MORE_PATH}/")]
    return [
        *views.plots({"Gain K1 [1/s]": ["/ctrl/gain/k1"], "Gain K2 [1/s]": ["/ctrl/gain/k2"]}),
        *_position_error_close(views),
        *views.plots({"Torque command [N·m]": _TORQUE}, limits=False),
        *views.plots({_title_of(path): [path] for path in more}),
    ]


def _position_error_close(views: _Views) -> list[Pane]:
    """Return a plot of the position error near zero, with its bounds."""
    bounds = [abs(value) for value in views.bounds(_POSITION_ERROR) if value]
    half_m = _CLOSE_BOUNDS * min(bounds) if bounds else _CLOSE_M
    title = f"Position error within {half_m * 1e3:g} mm, and its bounds [m]"
    return views.plots({title: [_POSITION_ERROR]}, y_range=(-half_m, half_m))


def _plain(plots: Mapping[str, Sequence[str]], span: Window) -> dict[str, Sequence[str]]:
    """Return the plots with the words of a window in the title of the first."""
    titles = [f"{span.words}: {title}" if number == 0 else title for number, title in enumerate(plots)]
    return dict(zip(titles, plots.values(), strict=True))
