"""The rerun blueprint of a recording: the views that the viewer opens. In review they show the whole run, live 10 s.

Tabs: the verdict with the states, the events, the errors and the robot first; then the transients, wheels, law, a tab
for each shadow law, link and loop, sensors, and the run's page. A view is left out if the run has none of its signals.
"""

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from hil.record.course import Course, Window
from hil.record.layout import MORE_PATH, SHADOW_PATH, Entity
from hil.record.limits import Limit
from hil.record.robot_model import RobotShape
from hil.record.views import VERDICT, Pane, Views, title_of

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


def blueprint(
    entities: Sequence[Entity],
    *,
    limits: Mapping[str, Sequence[Limit]],
    shape: RobotShape | None,
    live: bool,
    shadows: Mapping[str, float | None] = {},
    course: Course | None = None,
) -> rrb.Blueprint:
    """Return the layout of the viewer for a run with these entities, limits and robot.

    A recording under review shows the whole run; a live one follows the last ``LIVE_WINDOW_S`` seconds. ``shadows`` are
    the shadow laws, with the rms of their difference to the law that drives, if it is known. ``course`` is what the run
    turned out to have, None before its end. The time cursor is at the end; the first violation is the selected range.
    """
    views = Views(entities, limits, live=live)
    selected = None if course is None else course.first_violation
    return without_panels(
        rrb.Tabs(
            _verdict(views, shape, course),
            *_transients(views, course),
            *views.tab("Wheels", views.plots(_WHEELS)),
            *views.tab("Law", _law(views)),
            *(pane for law, rms in shadows.items() for pane in _shadow(views, law, rms)),
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
    views = Views(entities, limits, live=live)
    return without_panels(rrb.Tabs(_verdict(views, shape, None), _page(views), active_tab=0))


def _page(views: Views) -> Pane:
    """Return the last tab: the run's page and its events."""
    page = rrb.TextDocumentView(origin="/run", name="Figures and properties")
    return rrb.Horizontal(page, views.events(), name="Run")


def without_panels(root: Pane, selected: tuple[float, float] | None = None) -> rrb.Blueprint:
    """Return a layout of these views alone, rerun's own panels closed, with the time cursor at the end of ``t``.

    ``selected`` is a range of time [s] that is marked in the time panel.
    """
    closed = rrb.PanelState.Collapsed
    range_ns = None if selected is None else AbsoluteTimeRange(*(round(t_s * 1e9) for t_s in selected))
    time_panel = rrb.TimePanel(state=closed, timeline="t", play_state="Following", time_selection=range_ns)
    panels = (rrb.BlueprintPanel(state=closed), rrb.SelectionPanel(state=closed), time_panel)
    return rrb.Blueprint(root, *panels, auto_views=False)


def _verdict(views: Views, shape: RobotShape | None, course: Course | None) -> Pane:
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


def _first_plots(views: Views, course: Course | None) -> list[Pane]:
    """Return plots: first those in which something is violated, then the errors and the wheels."""
    violated = () if course is None else course.violated
    titles = {path: title for plots in (_WHEELS, _LINK, _SENSORS) for title, paths in plots.items() for path in paths}
    titles |= {_HEADING_ERROR: "Heading error: truth minus reference, and its bounds [rad]"}
    first: list[Pane] = []
    for path in violated[:2]:
        if path == _POSITION_ERROR:
            first += _position_error_close(views)
        else:
            first += views.plots({f"Violated: {titles.get(path, title_of(path))}": [path]})
    rest = [
        *views.plots({"Position error: truth minus reference [m]": [_POSITION_ERROR]}, limits=False),
        *([] if _POSITION_ERROR in violated[:2] else _position_error_close(views)),
        *([] if _HEADING_ERROR in violated[:2] else views.plots({titles[_HEADING_ERROR]: [_HEADING_ERROR]})),
        *views.plots({"Wheel speed: command (wide) and estimate [rad/s]": _SPEED}, limits=False),
    ]
    return [*first, *rest]


def _transients(views: Views, course: Course | None) -> list[Pane]:
    """Return a tab with a column of plots for each window of the run; more than four are spread over tabs."""
    spans = () if course is None else course.windows
    columns = [rrb.Vertical(*views.plots(_plain(_TRANSIENT, span), span=span), name=span.words[:40]) for span in spans]
    groups = [columns[i : i + _WINDOWS_A_TAB] for i in range(0, len(columns), _WINDOWS_A_TAB)]
    tabs = [rrb.Horizontal(*group, name=f"Transients {number}") for number, group in enumerate(groups, 1)]
    if len(tabs) == 1:
        return [rrb.Horizontal(*columns, name="Transients")]
    return [*tabs]


def _law(views: Views) -> list[Pane]:
    more = [path for path in views.paths if path.startswith(f"{MORE_PATH}/")]
    return [
        *views.plots({"Gain K1 [1/s]": ["/ctrl/gain/k1"], "Gain K2 [1/s]": ["/ctrl/gain/k2"]}),
        *_position_error_close(views),
        *views.plots({"Torque command [N·m]": _TORQUE}, limits=False),
        *views.plots({title_of(path): [path] for path in more}),
    ]


def _position_error_close(views: Views) -> list[Pane]:
    """Return a plot of the position error near zero, with its bounds."""
    bounds = [abs(value) for value in views.bounds(_POSITION_ERROR) if value]
    half_m = _CLOSE_BOUNDS * min(bounds) if bounds else _CLOSE_M
    title = f"Position error within {half_m * 1e3:g} mm, and its bounds [m]"
    return views.plots({title: [_POSITION_ERROR]}, y_range=(-half_m, half_m))


def _shadow(views: Views, law: str, rms: float | None) -> list[Pane]:
    """Return a tab for a shadow law: its command with that of the law that drives, their difference and its rms."""
    path = f"{SHADOW_PATH}/{law}"
    if f"{path}/command" not in views.paths:
        return []
    unit = views.unit(f"{path}/command")
    told = "" if rms is None else f": {rms:.4g} {unit} in all"
    plots = {
        f"Command, and that of the shadow {law} (wide) [{unit}]": [f"{path}/command", f"{path}/driven"],
        f"Difference: {law} minus command [{unit}]": [f"{path}/difference"],
        f"Rms of the difference so far{told} [{unit}]": [f"{path}/rms"],
    }
    for own in ("driven", "difference", "rms"):
        views.add(f"{path}/{own}")
    return [rrb.Vertical(*views.plots(plots, limits=False), row_shares=[2.0, 1.5, 1.0], name=f"Shadow {law}")]


def _plain(plots: Mapping[str, Sequence[str]], span: Window) -> dict[str, Sequence[str]]:
    """Return the plots with the words of a window in the title of the first."""
    titles = [f"{span.words}: {title}" if number == 0 else title for number, title in enumerate(plots)]
    return dict(zip(titles, plots.values(), strict=True))
