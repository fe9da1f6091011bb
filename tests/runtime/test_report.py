"""How a recording ends whose run has no figures."""

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import hil
from hil.core.errors import BadInputError, DeviceError, HilError
from hil.judge.judged_run import ExpectationResult
from hil.runtime.report import close_unfinished


class Recording:
    """Takes note of what a run is given to record; ``trouble`` is raised when it is finished."""

    def __init__(self, trouble: HilError | None = None) -> None:
        self.events: list[tuple[float, str, str]] = []
        self.finished: list[Mapping[str, Any]] = []
        self._trouble = trouble

    def event(self, t_s: float, level: str, text: str) -> None:
        self.events.append((t_s, level, text))

    def finish(self, found: Mapping[str, Any]) -> None:
        self.finished.append(found)
        if self._trouble is not None:
            raise self._trouble


@pytest.mark.parametrize("trouble", [None, BadInputError("the disk is full")])
def test_a_run_that_could_not_begin_is_recorded_as_failed_with_the_reason(trouble: HilError | None) -> None:
    recording = Recording(trouble)
    close_unfinished(recording, 2.5, DeviceError("it did not arm"))  # type: ignore[arg-type]
    assert recording.events == [(2.5, "error", "it did not arm")]
    (found,) = recording.finished
    assert {name: found[name] for name in ("passed", "failure", "failure_kind", "failure_s", "expect", "why")} == {
        "passed": False, "failure": "it did not arm", "failure_kind": "DeviceError", "failure_s": 2.5, "expect": [],
        "why": [("failure", "it did not arm")],
    }  # fmt: skip
    assert "it did not arm" in str(found["page"])


def test_an_expectation_that_failed_before_is_kept_and_is_not_the_reason() -> None:
    row = ExpectationResult("error.planar_m", passed=False, text="error.planar_m below 1: failed, 2")
    recording = Recording()
    close_unfinished(recording, 1.0, DeviceError("it hangs"), [row])  # type: ignore[arg-type]
    (found,) = recording.finished
    assert [one["text"] for one in found["expect"]] == ["error.planar_m below 1: failed, 2"]
    assert found["why"] == [("failure", "it hangs")]


def test_a_recording_that_is_there_is_not_replaced_unasked(tmp_path: Path) -> None:
    there = tmp_path / "run.mcap"
    there.write_bytes(b"precious")
    with pytest.raises(BadInputError, match=re.escape(str(there))):
        hil.run("paper_circle", set={"loop.duration_s": 0.2, "expect": []}, record=there)
    assert there.read_bytes() == b"precious"


def test_the_factor_of_real_time_is_that_of_all_ticks(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock of the wall that goes on by 1 ms whenever it is read."""
    times = itertools.count(10_000)
    read_s: list[float] = []

    def perf_counter() -> float:
        read_s.append(next(times) * 1e-3)
        return read_s[-1]

    monkeypatch.setattr("hil.runtime.loop.perf_counter", perf_counter)
    sets = {"loop.duration_s": 0.2, "loop.rate_hz": 200, "expect": []}
    result = hil.run("paper_circle", set=sets, mode="lockstep")
    assert result.metrics["ticks"] == 40
    assert result.metrics["realtime_factor"] == pytest.approx(0.2 / (read_s[-1] - read_s[0]))
