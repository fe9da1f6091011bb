"""hil.load: what hil.run gave, from a recording of either format, of a killed run too."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from firmware_protocol.generated.messages import Gyro
from hil.core.errors import BadInputError, DeviceError, LinkError, RunInterruptedError, error_of, kind_of
from hil.core.ports import Link, Received
from hil.judge.run_json import from_json
from hil.record.reader import read
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import Scenario, from_values, load, to_plain
from tests.support.processes import environment, wait_for

OLD = Path(__file__).parents[1] / "recordings" / "circle_speed_ca92b7a.rrd"
EXPECT = [{"signal": "error.planar_m", "from_s": 0.2, "below": 0.001}, {"figure": "ticks", "above": 1}]
FAULT = [{"kind": "drop", "target": "command", "value": 0.5, "start_s": 0.1, "end_s": 0.2}]
SETS = {"loop.duration_s": 0.5, "expect": EXPECT, "fault": FAULT, "plant.start.wheel.fl.lifted": 1.0}
OF_THE_MACHINE = {"realtime_factor", "tick_us", "recorded", "realtime", "recording", "page"}


@pytest.mark.parametrize("suffix", [".rrd", ".mcap"])
def test_a_loaded_run_is_what_the_run_gave(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    ran = hil.run("circle_speed", set=SETS, record=path)
    loaded = hil.load(path)
    assert type(loaded) is type(ran)
    assert list(loaded.signals) == list(ran.signals)
    for name, series in ran.signals.items():
        assert loaded.signals[name].tobytes() == np.ascontiguousarray(series).tobytes(), name
    figures = {name: value for name, value in ran.metrics.items() if name not in OF_THE_MACHINE}
    assert {name: loaded.metrics[name] for name in figures} == json.loads(json.dumps(figures))
    assert (loaded.passed, loaded.exit_code, loaded.failure) == (ran.passed, ran.exit_code, None)
    assert str(loaded) == str(ran)
    assert repr(loaded) == repr(ran)
    assert loaded.notes == []
    assert ran.scenario is not None
    assert loaded.scenario is not None
    ours, theirs = (to_plain(one)["tables"] for one in (ran.scenario, loaded.scenario))
    assert theirs == ours
    assert (loaded.scenario.name, loaded.scenario.hash) == ("circle_speed", ran.scenario.hash)
    told = {(round(event.t_s, 6), event.level, event.text) for event in loaded.events}
    assert {(round(event.t_s, 6), event.level, event.text) for event in ran.events} <= told
    with pytest.raises(BadInputError, match=r"did you mean 'error\.planar_m'"):
        loaded.signals["error.planar"]
    assert loaded.frame().shape == ran.frame().shape


def test_the_scenario_of_an_older_run_that_had_shadows_is_read_without_them(tmp_path: Path) -> None:
    ran = hil.run("circle_speed", set={"loop.duration_s": 0.1, "expect": []}, record=tmp_path / "run.mcap")
    properties = read(tmp_path / "run.mcap").properties
    values = json.loads(properties["scenario"])
    values |= {"controller.shadow": ["dsc"], "controller.shadow_gains.dsc.k1_1_s": 5.0}
    older = from_values("circle_speed", values, json.loads(properties["scenario_sources"]))
    assert ran.scenario is not None
    assert to_plain(older)["tables"] == to_plain(ran.scenario)["tables"]


def test_a_recording_of_the_version_before_has_its_scenario() -> None:
    result = hil.load(Path(__file__).parents[1] / "recordings" / "circle_speed_1edb5dc.mcap")
    assert result.scenario is not None
    assert "streamed" not in from_json({"passed": True, "streamed": {"sent": 3}}).figures


def test_a_run_that_failed_has_its_kind_of_failure(tmp_path: Path) -> None:
    fault = [{"kind": "reset", "target": "robot", "start_s": 0.2}]
    path = tmp_path / "run.mcap"
    ran = hil.run("circle_speed", set={"loop.duration_s": 0.5, "expect": [], "fault": fault}, record=path)
    loaded = hil.load(str(path))
    assert isinstance(loaded.failure, DeviceError)
    assert str(loaded.failure) == str(ran.failure)
    assert loaded.exit_code == ran.exit_code == 3
    assert kind_of(LinkError("x")) == "LinkError"
    assert isinstance(error_of("LinkError", "x"), LinkError)
    assert isinstance(error_of(None, "x"), DeviceError)


@pytest.mark.skipif(sys.platform == "win32", reason="kills a process by a signal")
def test_a_run_that_was_killed_is_loaded_with_a_note(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    # In lockstep, which no busy machine can end early.
    words = [sys.executable, "-m", "hil", "run", "circle_speed", "--mode", "lockstep", "--record", str(path)]
    with subprocess.Popen(
        [*words, "--set", "loop.duration_s=3600"], env=environment(), stderr=subprocess.DEVNULL, start_new_session=True
    ) as running:
        try:
            wait_for(lambda: path.exists() and path.stat().st_size > 200_000)
        finally:
            os.killpg(running.pid, signal.SIGKILL)
    loaded = hil.load(path)
    assert isinstance(loaded.failure, RunInterruptedError)
    assert not loaded.passed
    told = str(loaded)
    assert "did not come to its end" in str(loaded.failure) or "how the run ended is not known" in str(loaded.failure)
    assert " s  ended     the recording has no summary" in told
    assert len(loaded.signals["loop.t_s"]) > 10
    assert repr(loaded).startswith("<RunResult NO VERDICT circle_speed, ")
    assert told.startswith("NO VERDICT  circle_speed: ")


class WithoutGyro:
    """A link, and the instrument of a run over it, that loses all messages of the gyro."""

    properties: Mapping[str, str] = {"instrument": "without gyro"}

    def link(self, link: Link) -> Link:
        self._link = link
        return self  # type: ignore[return-value]

    def parts(self, _scenario: Scenario, parts: Any) -> Any:
        return parts

    def receive(self, timeout_ns: int) -> Received | None:
        received = self._link.receive(timeout_ns)
        frames = [frame for frame in received.frames if frame.id != Gyro.ID] if received is not None else []
        return received._replace(frames=frames) if received is not None and frames else None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._link, name)


@pytest.mark.parametrize("suffix", [".rrd", ".mcap"])
def test_a_run_that_could_not_begin_has_the_reason_in_its_recording(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    with pytest.raises(DeviceError) as failed:
        run_scenario(load("circle_speed"), RunOptions(record=path, instrument=WithoutGyro()))
    loaded = hil.load(path)
    assert loaded.exit_code == 3
    assert str(loaded.failure) == str(failed.value)
    assert "it was not judged" not in str(loaded)
    assert "     0.000 s  ended     the robot answered HELLO but sends no feedback" in str(loaded)


def test_an_older_recording_is_loaded_too() -> None:
    loaded = hil.load(OLD)
    assert loaded.metrics["scenario"] == "circle_speed"
    assert len(loaded.signals["loop.t_s"]) == loaded.metrics["ticks"]
    assert loaded.scenario is not None or any("scenario" in note for note in loaded.notes)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="No such file"):
        hil.load(tmp_path / "missing.rrd")
