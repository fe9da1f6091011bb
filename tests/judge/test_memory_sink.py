"""Data kept of a run: its figures always, its rows only on request."""

import itertools
import tracemalloc
from typing import Any

import numpy as np
import pytest

import hil
from hil.core.errors import BadInputError
from hil.core.signals import SIGNAL_NAMES, pack_row
from hil.core.types import ZERO_WHEELS, Applied, CommandMode, Reference, State, WheelCommand
from hil.judge.claims import check_expectation
from hil.judge.figures import RunFigures, signal_figures
from hil.judge.measure import CommandLimits, RunSetup
from hil.judge.memory_sink import MemorySink
from hil.laws.lqi import Lqi
from hil.scenario import ExpectTable
from tests.support.recorded_circle import circle_rows

SETUP = RunSetup(0.3, CommandLimits(20.0, 5.0))
ROWS = 4700  # four blocks and a part of one


def test_the_figures_made_as_the_run_goes_are_those_of_all_its_rows_to_the_last_bit() -> None:
    rows = list(circle_rows(ROWS))
    sink = MemorySink(SIGNAL_NAMES, RunFigures(SETUP, SIGNAL_NAMES), keep=True)
    for row in rows:
        sink.put(pack_row(row))
    figures, reasons = sink.figures()
    signals = sink.signals()
    assert (figures, reasons) == signal_figures(signals, SETUP)
    assert figures["ticks"] == ROWS
    assert figures["effort_n_m_s"] is not None
    np.testing.assert_array_equal(np.column_stack(list(signals.values())), rows)


def test_without_its_rows_a_run_needs_no_more_memory_when_it_goes_on() -> None:
    sink = MemorySink(SIGNAL_NAMES, RunFigures(SETUP, SIGNAL_NAMES), keep=False)
    rows = list(circle_rows(2000))
    tracemalloc.start()
    try:
        sizes = []
        for row in itertools.chain.from_iterable([rows] * 20):
            sink.put(pack_row(row))
            if row is rows[-1]:
                sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    row_bytes = 8 * len(SIGNAL_NAMES)
    # What percentiles are made of is two numbers a row, up to a million rows.
    assert max(sizes[10:]) - max(sizes[:10]) < 20_000 * row_bytes / 10
    assert sink.figures()[0]["ticks"] == 40_000
    assert sink.signals() == {}


class Still:
    """A law that stands still."""

    def reset(self, state: State, reference: Reference) -> None:
        pass

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        return WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS)


SHORT = {"loop.duration_s": 0.1, "expect": []}


def test_a_result_has_a_short_repr_and_is_printed_with_why_it_has_not_passed() -> None:
    failed = hil.run("circle_speed", set={**SHORT, "expect": [{"signal": "loop.tick", "below": 5.0}]})
    assert repr(failed).startswith("<RunResult FAILED circle_speed, 20 ticks, loop.tick below 5 from 0 s to the end: ")
    assert len(repr(failed)) < 160
    lines = str(failed).splitlines()
    assert lines[0] == "FAILED  circle_speed: dsc by speed, lockstep over memory:, seed 1"
    assert "     0.025 s  failed    loop.tick below 5 from 0 s to the end: first 5 at" in lines
    passed = hil.run("circle_speed", set=SHORT)
    assert repr(passed) == "<RunResult PASSED circle_speed, 20 ticks>"


def test_a_wrong_name_of_a_signal_is_answered_with_the_near_ones() -> None:
    result = hil.run("circle_speed", set=SHORT)
    with pytest.raises(
        BadInputError, match=r"^the run has no signal 'error\.planar'; did you mean 'error\.planar_m'\?$"
    ):
        result.signals["error.planar"]
    with pytest.raises(KeyError, match=r"no signal 'nonsense'; `hil list signals` prints them all"):
        result.signals["nonsense"]
    with pytest.raises(BadInputError, match="did you mean"):
        check_expectation(ExpectTable(signal="error.planar", below=1.0), dict(result.signals))
    assert result.signals.get("nonsense") is None
    assert "nonsense" not in result.signals
    assert repr(result.signals).endswith(" signals of 20 ticks>")


@pytest.mark.parametrize("given", [{"law": Still}, {"set": {"controller.law": Still, **SHORT}}])
def test_a_law_is_given_as_a_class(given: dict[str, Any]) -> None:
    result = hil.run("circle_speed", **{"set": SHORT, **given})
    assert result.metrics["law"] == f"{__name__}:Still"
    assert set(result.signals["wheel.fl.speed_command_rad_s"]) == {0.0}


def test_a_law_of_ours_is_given_as_a_class_too_and_what_is_no_law_is_refused() -> None:
    assert hil.run("circle_speed", law=Lqi, set=SHORT).metrics["law"] == "lqi"
    with pytest.raises(BadInputError, match=r"the class has no update; expected update\(self, reference, state"):
        hil.run("circle_speed", law=type("Nothing", (), {"reset": Still.reset}), set=SHORT)
