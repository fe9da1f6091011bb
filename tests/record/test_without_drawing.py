"""Recordings where no add-on brings what viewers show: the data are the same."""

from pathlib import Path

import numpy as np
import pytest

from hil.core.errors import BadInputError
from hil.core.extensions import Extensions
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.record import viewing
from hil.record.reader import read
from hil.record.recording import Recording
from hil.runtime.assembly import RunOptions, run_scenario
from hil.runtime.provenance import properties
from hil.scenario import load
from tests.support.recorded_circle import circle_table

ROWS = 3000


@pytest.fixture(autouse=True)
def no_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewing, "_PARTS", Extensions("hil.viewer_of_nobody"))


@pytest.mark.parametrize("name", ["run.rrd", "run.mcap"])
def test_signals_events_and_properties_are_recorded_without_drawings(tmp_path: Path, name: str) -> None:
    told, table = properties(load("paper_circle")), circle_table(ROWS)
    with Recording(tmp_path / name, properties=told, blocking=True) as recording:
        for row in table:
            recording.put(pack_row(row))
        recording.event(1.0, "error", "something")
        assert recording.finish({"passed": False}).complete
    run = read(tmp_path / name)
    assert np.column_stack([run.signals[signal] for signal in SIGNAL_NAMES]).tobytes() == table.tobytes()
    assert run.events == ((1.0, "ERROR", "something"),)
    assert run.properties == told
    assert run.summary == {"passed": False}
    assert not run.notes


def test_a_run_says_so_once(tmp_path: Path) -> None:
    said: list[str] = []
    scenario = load("paper_circle", set={"loop.duration_s": 0.2, "expect": []})
    run_scenario(scenario, RunOptions(record=tmp_path / "run.mcap", warn=said.append))
    assert said == ["without the add-on hil.addons.report the recording has no layout: viewers choose their own"]


def test_live_viewers_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="live port 9876"):
        Recording(tmp_path / "run.rrd", properties={}, blocking=True, live_port=9876)
    assert not list(tmp_path.iterdir())
