"""What a recording draws besides its signals, read back from the file: robot, limits, lanes."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hil.core.signals import pack_row
from hil.record import Recording
from hil.record.blueprint import blueprint
from hil.record.layout import layout
from hil.record.limits import limits
from hil.runtime.provenance import properties
from hil.scenario import load
from tests.recorded_circle import PERIOD_S, circle_rows, circle_table, column

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


def test_wheels_turn_by_the_integral_of_their_speeds(recording: Path) -> None:
    table = circle_table(ROWS)
    turned = np.cumsum(column(table, "wheel.fr.speed_rad_s")) * PERIOD_S
    t_s, quaternion = read(recording, "/world/wheel/fr", "Transform3D:quaternion", 4)
    assert np.diff(t_s) == pytest.approx(0.02)
    expected = turned[np.rint(t_s / PERIOD_S).astype(int)] - turned[0]
    angle = 2 * np.arctan2(quaternion[:, 1], quaternion[:, 3])
    assert np.abs(np.exp(1j * angle) - np.exp(1j * expected)).max() < 1e-5
    assert np.abs(quaternion[:, [0, 2]]).max() < 1e-6


def test_the_robot_stands_where_the_truth_is(recording: Path) -> None:
    table = circle_table(ROWS)
    t_s, place = read(recording, "/world/pose", "Transform3D:translation", 3)
    rows = table[np.rint(t_s / PERIOD_S).astype(int)]
    np.testing.assert_allclose(place[:, 0], column(rows, "truth.x_m"), atol=1e-6)
    np.testing.assert_allclose(place[:, 1], column(rows, "truth.y_m"), atol=1e-6)


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
    expected = [(0.0, "GOOD"), (0.2, "LOSSY"), (0.3, "GOOD"), (0.5, "STALE"), (0.6, "GOOD"), (0.8, "SILENT")]
    found = states(path, "/state/3_link")
    assert [state for _, state in found] == [state for _, state in expected]
    assert [t_s for t_s, _ in found] == pytest.approx([t_s for t_s, _ in expected], abs=1.1e-3)


def test_signals_that_a_run_brings_get_views_of_their_own() -> None:
    entities = layout(["loop.t_s", "fuzzy.x.error", "fuzzy.x.rate_1_s", "shadow.dsc.wheel.fl.torque_command_n_m"])
    paths = [entity.path for entity in entities]
    assert paths[1:] == ["/ctrl/shadow/dsc/command", "/more/fuzzy/error/number", "/more/fuzzy/rate_1_s/1_s"]
    shown = blueprint(entities, limits=limits({}, [], entities), shape=None, live=True, shadows={"dsc": None})
    views = repr(_names(shown.root_container))
    for name in ("fuzzy error", "fuzzy rate [1_s]", "Command, and that of the shadow dsc (wide) [N·m]"):
        assert name in views
    assert "Gain K1" not in views


def _names(part: Any) -> list[Any]:
    return [part.name, *(_names(one) for one in getattr(part, "contents", ()) if not isinstance(one, str))]
