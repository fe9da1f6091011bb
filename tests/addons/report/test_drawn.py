"""Everything that a made-up run draws in rerun's viewer, compared with a text that a person has read.

``test_telemetry_drawings.py`` proves the values; this proves that colours, widths and counts stay.
"""

import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.addons.report.run_drawing import RunDrawing
from hil.core.signals import INDEX, SIGNAL_NAMES
from tests.support.golden import assert_golden
from tests.support.recorded_circle import circle_table

GOLDEN = Path(__file__).parent / "golden"
SCENARIO = {
    "robot.mass_kg": 20.0, "robot.wheel_radius_m": 0.075, "robot.half_length_m": 0.3, "robot.half_width_m": 0.2,
    "robot.torque_limit_n_m": 5.5, "firmware.torque_constant_n_m_a": 0.6, "firmware.current_limit_a": 8.0,
    "expect.1.signal": "error.planar_m", "expect.1.below": 0.02, "expect.1.from_s": 0.3, "expect.1.to_s": 0.45,
    "expect.2.signal": "truth.x_m", "expect.2.of": "reference.x_m", "expect.2.within": [-0.125, 0.25],
    "expect.3.at_rest": True, "expect.3.below": 3.0, "expect.3.from_s": 0.5,
    "expect.4.signal": "link.rtt_ms", "expect.4.below": 9.0, "expect.4.from_s": 0.62,
    "fault.1.kind": "drop", "fault.1.target": "command", "fault.1.start_s": 0.25, "fault.1.end_s": 0.5,
}  # fmt: skip


class Told:
    """A recording that notes what is drawn: in full what stays, of what changes how many values and their sum."""

    def __init__(self) -> None:
        self.static: list[str] = []
        self.columns: dict[str, list[tuple[list[float], dict[str, np.ndarray]]]] = {}
        self.blueprints = 0

    def log(self, path: str, *archetypes: Any, static: bool) -> None:
        assert static
        for one in archetypes:
            for batch in one.as_component_batches():
                name = str(batch.component_descriptor()).partition("#")[0]
                text = json.dumps(batch.as_arrow_array().to_pylist(), default=str)
                text = re.sub(r"(-?\d+\.\d{5})\d+(?!e)", r"\1", text)
                self.static.append(f"{path} {name} {text[:300]}")

    def send_columns(self, path: str, indexes: list[Any], columns: Iterable[Any]) -> None:
        t_s = [at / 1e9 for at in indexes[0].as_arrow_array().cast("int64").to_pylist()] if indexes else []
        found = {}
        for column in columns:
            flat = column.as_arrow_array()
            while flat.type.num_fields:
                flat = flat.flatten()
            found[str(column.component_descriptor()).partition("#")[0]] = flat.to_numpy(zero_copy_only=False)
        self.columns.setdefault(path, []).append((t_s, found))

    def send_blueprint(self, _blueprint: Any) -> None:
        self.blueprints += 1

    def lines(self) -> Iterator[str]:
        yield from self.static
        for path, pieces in sorted(self.columns.items()):
            t_s = [at for times, _ in pieces for at in times]
            over = f"{len(t_s)} times, {t_s[0]:g} to {t_s[-1]:g} s, sum {sum(t_s):.6g}" if t_s else "always"
            yield f"{path}: {over}"
            for name in pieces[0][1]:
                values = np.concatenate([found[name] for _, found in pieces])
                if values.dtype.kind not in "fiu":
                    yield f"  {name}: {sorted(set(values.tolist()))}"
                    continue
                known = values[np.isfinite(values)].astype(float)
                weighed = known @ np.cos(np.arange(len(known)))  # their order counts too
                yield f"  {name}: {len(known)} of {len(values)}, sum {known.sum():.6g}, weighed {weighed:.3f}"


@pytest.mark.parametrize("live", [False, True])
def test_a_run_draws_this(live: bool) -> None:
    table = circle_table(700)
    table[:450, INDEX["link.rtt_ms"]] = np.nan
    table[640:660, INDEX["link.rtt_ms"]] = np.nan
    table[100:150, INDEX["truth.x_m"]] = np.nan
    table[200:220, INDEX["pose.y_m"]] = np.nan
    table[560:590, INDEX["wheel.rl.current_a"]] = np.nan
    table = np.delete(table, np.s_[350:470], axis=0)
    told = Told()
    properties = {"scenario_name": "made", "scenario": json.dumps(SCENARIO)}
    drawing = RunDrawing(told, SIGNAL_NAMES, properties, live)  # type: ignore[arg-type]
    drawing.describe()
    for piece in np.split(table, [1, 203, 404]):
        drawing.rows(piece)
    drawing.event(0.25, "WARN", "fault begins")
    drawing.event(0.5, "ERROR", "failed")
    drawing.finish({"passed": False, "failure": None, "why": [("expectation", "failed")]}, None)
    lines = [*told.lines(), f"layouts: {told.blueprints}"]
    assert_golden(GOLDEN / f"drawn_{'live' if live else 'ended'}.txt", "\n".join(lines) + "\n")
