"""The views of a recording in rerun's viewer: plots, states, events, the robot in 3D and the plan."""

from collections.abc import Mapping, Sequence

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TimelineColumn

from hil.core.signals import unit_of
from hil.record.course import Course, Window
from hil.record.drawings import BODY, FLOOR, PLAN, SCENE, TRAILS
from hil.record.lanes import LANES
from hil.record.layout import MORE_PATH, NO_UNIT, Entity
from hil.record.limits import LIMITS_PATH, VIOLATIONS_PATH, Limit
from hil.record.robot_model import RobotShape

LIVE_WINDOW_S = 10.0
VERDICT = "/verdict"
LOG = "/log"
"""The events with their times in their texts, for the viewer: its own column of times is too narrow to read."""
_AFTER_END = 0.02
"""How much longer than the run the lanes of states are, as a share of it."""
Pane = rrb.View | rrb.Container


def window(*, live: bool) -> rrb.VisibleTimeRanges:
    """Return the range of time that a view shows: the last ``LIVE_WINDOW_S`` seconds, or the whole run."""
    infinite, cursor = rrb.TimeRangeBoundary.infinite, rrb.TimeRangeBoundary.cursor_relative
    start, end = (cursor(seconds=-LIVE_WINDOW_S), cursor()) if live else (infinite(), infinite())
    return rrb.VisibleTimeRanges([rrb.VisibleTimeRange("t", start=start, end=end)])


class Views:
    """Makes the views of a run, each over the same range of time."""

    def __init__(self, entities: Sequence[Entity], limits: Mapping[str, Sequence[Limit]], *, live: bool) -> None:
        self._families: dict[str, list[str]] = {}  # of each plot, the paths of the entities that it shows
        for entity in entities:
            self._families.setdefault(entity.plot or entity.path, []).append(entity.path)
        self._limits = limits
        self._units = {entity.path: unit_of(entity.series[0].signal) for entity in entities}
        self._is_live = live
        self._window = window(live=live)
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


def title_of(path: str) -> str:
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
