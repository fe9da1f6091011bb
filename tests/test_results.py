"""What a run keeps: its figures always, its rows only for who wants them."""

import itertools
import tracemalloc

import numpy as np

from hil.metrics import CommandLimits, SignalFigures, signal_figures
from hil.results import MemorySink
from hil.signals import SIGNAL_NAMES
from tests.recorded_circle import circle_rows

LIMITS = CommandLimits(20.0, 5.0)
ROWS = 4700  # four blocks and a part of one


def test_the_figures_made_as_the_run_goes_are_those_of_all_its_rows_to_the_last_bit() -> None:
    rows = list(circle_rows(ROWS))
    sink = MemorySink(SIGNAL_NAMES, SignalFigures(0.3, LIMITS), keep=True)
    for row in rows:
        sink.put(row)
    figures, reasons = sink.figures()
    signals = sink.signals()
    assert (figures, reasons) == signal_figures(signals, 0.3, LIMITS)
    assert figures["ticks"] == ROWS
    assert figures["effort_n_m_s"] is not None
    np.testing.assert_array_equal(np.column_stack(list(signals.values())), rows)


def test_without_its_rows_a_run_needs_no_more_memory_when_it_goes_on() -> None:
    sink = MemorySink(SIGNAL_NAMES, SignalFigures(0.3, LIMITS), keep=False)
    rows = list(circle_rows(2000))
    tracemalloc.start()
    try:
        sizes = []
        for row in itertools.chain.from_iterable([rows] * 20):
            sink.put(row)
            if row is rows[-1]:
                sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    row_bytes = 8 * len(SIGNAL_NAMES)
    # What percentiles are made of is two numbers a row, up to a million rows.
    assert max(sizes[10:]) - max(sizes[:10]) < 20_000 * row_bytes / 10
    assert sink.figures()[0]["ticks"] == 40_000
    assert sink.signals() == {}
