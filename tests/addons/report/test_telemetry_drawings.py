"""What a recording draws besides its signals, read back from the file: robot, limits, lanes."""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.report.blueprint import blueprint
from hil.addons.report.claim_watch import limits
from hil.addons.report.entities import layout
from hil.addons.report.lanes import _Link
from hil.addons.report.urdf import RobotShape
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.record.recording import Recording
from hil.runtime.provenance import properties
from hil.scenario import load
from tests.support.examples import share_of_examples
from tests.support.recorded_circle import PERIOD_S, circle_rows, circle_table, column

ROWS = 1600
FAULTS = """
[[fault]]
kind = "drop"
target = "command"
value = 0.1
start_s = 0.5
end_s = 0.75

[[fault]]
kind = "reset"
target = "robot"
start_s = 1.2

[[fault]]
kind = "estop"
target = "command"
start_s = 9.0

[[expect]]
signal = "error.planar_m"
from_s = 1.0
to_s = 1.45
below = 0.02

[[expect]]
signal = "wheel.fl.speed_rad_s"
within = [-9.0, 9.5]
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("drawings")
    (directory / "faulted.toml").write_text('extends = "paper_circle"\n' + FAULTS)
    path = directory / "run.rrd"
    told = properties(load(directory / "faulted.toml"))
    assert json.loads(told["gains"])["filter_s"] == 0.0675
    with Recording(path, properties=told, blocking=True) as recorder:
        for row in circle_rows(ROWS):
            recorder.put(pack_row(row))
        assert recorder.finish({"passed": True}).complete
    return path


def batches(recording: Path, entity: str) -> Iterator[dict[str, Any]]:
    """Yield the columns of each temporal chunk of an entity."""
    import rerun.chunk as rrc

    for chunk in rrc.RrdReader(recording).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if "t" in batch.schema.names:
            yield {name: batch.column(name) for name in batch.schema.names}


def read(recording: Path, entity: str, component: str, width: int) -> tuple[npt.NDArray[np.float64], ...]:
    """Return times [s] and values (n, width) of a component of an entity."""
    times, values = [], []
    for one in batches(recording, entity):
        if component in one:
            times.append(one["t"].cast("int64").to_numpy() / 1e9)
            flat = one[component].flatten()
            while flat.type.num_fields:
                flat = flat.flatten()
            values.append(flat.to_numpy().reshape(-1, width).astype(float))
    return np.concatenate(times), np.concatenate(values)


def states(recording: Path, entity: str) -> list[tuple[float, str]]:
    """Return the changes of a lane."""
    return [
        (t_ns / 1e9, state[0])
        for one in batches(recording, entity)
        for t_ns, state in zip(one["t"].cast("int64").to_pylist(), one["StateChange:state"].to_pylist(), strict=True)
    ]


ROBOT = load("paper_circle").robot
AHEAD_LEFT = {"fl": (1, 1), "fr": (1, -1), "rr": (-1, -1), "rl": (-1, 1)}
PUSHES_LEFT = {"fl": -1, "fr": 1, "rr": -1, "rl": 1}  # a wheel that drives forward, by the X of its rollers


@cache
def table() -> npt.NDArray[np.float64]:
    return circle_table(ROWS)


def rows_at(t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return table()[np.rint(t_s / PERIOD_S).astype(int)]


def places(rows: npt.NDArray[np.float64], group: str) -> npt.NDArray[np.complex128]:
    """Return where something is, as x + jy."""
    found: npt.NDArray[np.complex128] = column(rows, f"{group}.x_m") + 1j * column(rows, f"{group}.y_m")
    return found


def turns(rows: npt.NDArray[np.float64], group: str) -> npt.NDArray[np.complex128]:
    """Return by what a vector of the body is multiplied to be one of the world."""
    found: npt.NDArray[np.complex128] = np.exp(1j * column(rows, f"{group}.heading_rad"))
    return found


@pytest.mark.parametrize("wheel", AHEAD_LEFT)
def test_a_wheel_turns_in_its_place_by_the_integral_of_its_speed(recording: Path, wheel: str) -> None:
    turned = np.cumsum(column(table(), f"wheel.{wheel}.speed_rad_s")) * PERIOD_S
    t_s, quaternion = read(recording, f"/world/wheel/{wheel}", "Transform3D:quaternion", 4)
    assert np.diff(t_s) == pytest.approx(0.02)
    expected = turned[np.rint(t_s / PERIOD_S).astype(int)] - turned[0]
    angle = 2 * np.arctan2(quaternion[:, 1], quaternion[:, 3])
    assert np.abs(np.exp(1j * angle) - np.exp(1j * expected)).max() < 1e-5
    assert np.abs(quaternion[:, [0, 2]]).max() < 1e-6
    _, place = read(recording, f"/world/wheel/{wheel}", "Transform3D:translation", 3)
    ahead, left = AHEAD_LEFT[wheel]
    at = (ahead * ROBOT.half_length_m, left * ROBOT.half_width_m, ROBOT.wheel_radius_m)
    np.testing.assert_allclose(place, np.tile(at, (len(place), 1)), rtol=1e-6)


def test_the_robot_stands_where_the_truth_is(recording: Path) -> None:
    t_s, place = read(recording, "/world/pose", "Transform3D:translation", 3)
    rows = rows_at(t_s)
    np.testing.assert_allclose(place[:, 0] + 1j * place[:, 1], places(rows, "truth"), atol=1e-6)
    assert set(place[:, 2]) == {0.0}
    _, quaternion = read(recording, "/world/pose", "Transform3D:quaternion", 4)
    assert set(quaternion[:, :2].flat) == {0.0}
    turn = (quaternion[:, 3] + 1j * quaternion[:, 2]) ** 2
    np.testing.assert_allclose(turn, turns(rows, "truth"), atol=1e-6)


def arrows(recording: Path, name: str, each: int) -> tuple[npt.NDArray[np.float64], ...]:
    """Return the times of arrows, and from where they point to what, as x + jy, and their two heights."""
    t_s, origins = read(recording, f"/world/{name}", "Arrows3D:origins", 3 * each)
    _, vectors = read(recording, f"/world/{name}", "Arrows3D:vectors", 3 * each)
    xyz = [one.reshape(-1, each, 3) for one in (origins, vectors)]
    return t_s, *(one[..., 0] + 1j * one[..., 1] for one in xyz), *(one[..., 2] for one in xyz)


def test_an_arrow_over_each_wheel_is_the_force_of_its_motor(recording: Path) -> None:
    """Together they are the force on the body, which R(heading) turns into the world."""
    t_s, origins, vectors, heights, rises = arrows(recording, "force", 4)
    rows, constant = rows_at(t_s), load("paper_circle").firmware.torque_constant_n_m_a
    scale_m_n = RobotShape.of_model(ROBOT).force_scale_m_n
    np.testing.assert_allclose(heights, 2.15 * ROBOT.wheel_radius_m, rtol=1e-6)
    assert set(rises.flat) == {0.0}
    for number, (wheel, (ahead, left)) in enumerate(AHEAD_LEFT.items()):
        at = ahead * ROBOT.half_length_m + 1j * left * ROBOT.half_width_m
        np.testing.assert_allclose(
            origins[:, number], places(rows, "truth") + at * turns(rows, "truth"), atol=1e-6, err_msg=wheel
        )
        force_n = column(rows, f"wheel.{wheel}.current_a") * constant / ROBOT.wheel_radius_m
        expected = force_n * (1 + 1j * PUSHES_LEFT[wheel]) * scale_m_n * turns(rows, "truth")
        np.testing.assert_allclose(vectors[:, number], expected, atol=1e-6, err_msg=wheel)


def test_the_reference_is_an_arrow_along_its_heading_and_the_error_one_from_it(recording: Path) -> None:
    for name in ("reference", "error"):
        t_s, origins, vectors, heights, rises = arrows(recording, name, 1)
        rows = rows_at(t_s)
        np.testing.assert_allclose(origins[:, 0], places(rows, "reference"), atol=1e-6)
        np.testing.assert_allclose(heights, 3 * ROBOT.wheel_radius_m, rtol=1e-6)
        assert set(rises.flat) == {0.0}
        error = places(rows, "truth") - places(rows, "reference")
        expected = ROBOT.half_length_m * turns(rows, "reference") if name == "reference" else error
        np.testing.assert_allclose(vectors[:, 0], expected, atol=1e-6)


def test_the_trails_go_from_row_to_row_and_lie_over_each_other(recording: Path) -> None:
    for order, (name, group) in enumerate({"reference": "reference", "estimate": "pose", "truth": "truth"}.items(), 1):
        t_s, strips = read(recording, f"/xy/{name}", "LineStrips2D:strips", 4)
        assert np.diff(t_s) == pytest.approx(0.04)
        ends = places(rows_at(t_s), group)
        np.testing.assert_allclose(strips[:, 2] + 1j * strips[:, 3], ends, atol=1e-6)
        np.testing.assert_allclose(strips[1:, 0] + 1j * strips[1:, 1], ends[:-1], atol=1e-6)
        assert strips[0, 0] + 1j * strips[0, 1] == pytest.approx(ends[0], abs=1e-6)
        _, solid = read(recording, f"/world/trail/{name}", "LineStrips3D:strips", 6)
        np.testing.assert_allclose(solid[:, [0, 1, 3, 4]], strips)
        np.testing.assert_allclose(solid[:, [2, 5]], 0.001 * order, rtol=1e-6)
    t_s, outline = read(recording, "/xy/robot", "LineStrips2D:strips", 12)
    rows = rows_at(t_s)
    body = ((outline[:, ::2] + 1j * outline[:, 1::2]) - places(rows, "truth")[:, None]) / turns(rows, "truth")[:, None]
    corners = [-0.1 - 0.08j, 0.04 - 0.08j, 0.17, 0.04 + 0.08j, -0.1 + 0.08j, -0.1 - 0.08j]
    np.testing.assert_allclose(body, np.tile(corners, (len(body), 1)), atol=1e-6)


def test_each_curve_has_the_values_of_its_signals_every_5_ms(recording: Path) -> None:
    import rerun.chunk as rrc

    found: dict[str, list[tuple[Any, Any]]] = {}
    names: dict[str, list[str]] = {}
    for chunk in rrc.RrdReader(recording).stream():
        batch = chunk.to_record_batch()
        if "SeriesLines:names" in batch.schema.names:
            names[chunk.entity_path] = batch.column("SeriesLines:names").to_pylist()[0]
        if "Scalars:scalars" in batch.schema.names and "t" in batch.schema.names:
            values = batch.column("Scalars:scalars").flatten().to_numpy()
            t_s = batch.column("t").cast("int64").to_numpy() / 1e9
            found.setdefault(chunk.entity_path, []).append((t_s, values.reshape(len(t_s), -1)))
    for entity in layout(SIGNAL_NAMES):
        rows = table()[::5]
        expected = np.column_stack([column(rows, series.signal) for series in entity.series])
        kept = np.isfinite(expected).any(axis=0)
        labels = [series.label for series, is_kept in zip(entity.series, kept, strict=True) if is_kept]
        if labels:
            t_s, values = (np.concatenate(part) for part in zip(*found[entity.path], strict=True))
            at = np.rint(t_s / PERIOD_S).astype(int) // 5
            np.testing.assert_array_equal(values, expected[at][:, kept], err_msg=entity.path)
            assert at.tolist() == list(range(at[0], 320))
            assert names[entity.path] == labels
        else:
            assert entity.path not in found


def test_a_bound_is_drawn_while_it_is_claimed_and_never_ahead_of_the_run(recording: Path) -> None:
    t_s, values = read(recording, "/limits/ctrl/error/position/0", "Scalars:scalars", 1)
    assert (t_s.min(), t_s.max()) == pytest.approx((1.0, 1.45))
    assert set(values.flat) == {0.02}
    for number, limit in enumerate((5.0, -5.0)):
        t_s, values = read(recording, f"/limits/ctrl/wheel/command/torque/{number}", "Scalars:scalars", 1)
        assert set(values.flat) == {limit}
        assert (t_s.min(), t_s.max()) == pytest.approx((0.0, (ROWS - 1) * PERIOD_S))
    for number, bound in enumerate((-9.0, 9.5)):
        _, values = read(recording, f"/limits/ctrl/wheel/speed/{number}", "Scalars:scalars", 1)
        assert set(values.flat) == {bound}


def test_faults_have_lanes_of_their_own_once_they_have_begun(recording: Path) -> None:
    assert states(recording, "/state/6_fault_0_drop_command") == [(0.5, "IN FORCE"), (0.75, "-")]
    assert states(recording, "/state/6_fault_1_reset_robot") == [(1.2, "HAPPENED")]
    assert states(recording, "/state/6_fault_2_estop_command") == []


def test_the_link_is_lossy_for_a_while_after_a_loss_and_silent_without_feedback(tmp_path: Path) -> None:
    from hil.core.signals import INDEX, pack_row

    path, table = tmp_path / "run.rrd", circle_table(1000)
    table[200:, INDEX["link.lost"]] = 1.0
    table[500:600, INDEX["link.feedback_age_ms"]] = 150.0
    table[800:, INDEX["link.feedback_age_ms"]] = np.nan
    with Recording(path, properties={}, blocking=True) as recorder:
        for row in table:
            recorder.put(pack_row(tuple(row)))
        recorder.finish({})
    assert states(path, "/state/3_link") == [
        (0.0, "GOOD"), (0.2, "LOSSY"), (0.301, "GOOD"), (0.5, "STALE"), (0.6, "GOOD"), (0.8, "SILENT"),
    ]  # fmt: skip


@share_of_examples(0.4)
@given(
    rows=st.lists(
        st.tuples(st.integers(0, 40), st.integers(0, 1), st.integers(0, 1), st.booleans()), min_size=1, max_size=9
    ),
    cuts=st.lists(st.integers(1, 8), max_size=2, unique=True).map(sorted),
)
def test_a_link_is_lossy_for_100_ms_after_each_loss_wherever_the_rows_are_cut(
    rows: list[tuple[int, int, int, bool]], cuts: list[int]
) -> None:
    """Rows are multiples of 10 ms apart; what was lost before the first one is of another time."""
    table, expected, at, lost_at, counts = [], [], 0, None, [3, 5]
    for number, (step, rejected, lost, is_old) in enumerate(rows):
        at += step
        counts = [counts[0] + rejected, counts[1] + lost]
        lost_at = at if number and rejected + lost else lost_at
        age_ms = 30.0 if is_old else 20.0
        table.append([age_ms, counts[0], counts[1], at / 128])
        is_lossy = lost_at is not None and (at - lost_at) / 128 < 0.1
        expected.append(2 if is_old else int(is_lossy))
    column = {"link.feedback_age_ms": 0, "link.rejected": 1, "link.lost": 2, "loop.t_s": 3}
    link = _Link(column, 25.0)
    pieces = np.split(np.array(table), [cut for cut in cuts if cut < len(rows)])
    assert np.concatenate([link(piece) for piece in pieces]).tolist() == expected


def test_signals_that_a_run_brings_get_views_of_their_own() -> None:
    entities = layout(["loop.t_s", "fuzzy.x.error", "fuzzy.x.rate_1_s"])
    paths = [entity.path for entity in entities]
    assert paths[1:] == ["/more/fuzzy/error/number", "/more/fuzzy/rate_1_s/1_s"]
    shown = blueprint(entities, limits=limits({}, [], entities), shape=None, live=True)
    views = repr(_names(shown.root_container))
    for name in ("fuzzy error", "fuzzy rate [1_s]"):
        assert name in views
    assert "Gain K1" not in views


def _names(part: Any) -> list[Any]:
    return [part.name, *(_names(one) for one in getattr(part, "contents", ()) if not isinstance(one, str))]
