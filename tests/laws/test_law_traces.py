"""Every law and mode does in lockstep what it did when its golden trace was kept (tests/support/law_traces.py)."""

import csv
import itertools

import pytest

from hil.core.types import CommandMode
from hil.laws.law_registry import shipped_laws
from tests.support.law_traces import HEAD, TIMES_S, VECTORS, trace

SHIPPED = shipped_laws()

with VECTORS.open(encoding="utf-8", newline="") as file:
    ROWS = list(csv.DictReader(file))
KEPT = {
    key: [[float(row[name]) for name in HEAD[2:]] for row in rows]
    for key, rows in itertools.groupby(ROWS, lambda row: (row["law"], row["command"]))
}
REFUSED = {("computed_torque", "speed"), ("mpc", "speed")}


def test_there_is_a_trace_of_every_law_in_every_mode_that_it_has():
    modes = [mode.name.lower() for mode in CommandMode]
    assert set(KEPT) == set(itertools.product(SHIPPED, modes)) - REFUSED


@pytest.mark.parametrize(("law", "command"), KEPT)
def test_the_robot_goes_where_it_went(law, command):
    kept = KEPT[law, command]
    assert [row[0] for row in kept] == list(TIMES_S)
    found = trace(law, CommandMode[command.upper()])
    for (t_s, *expected), pose in zip(kept, found, strict=True):
        assert pose == pytest.approx(expected, abs=2e-5), (
            f"{law} by {command} at {t_s} s; see tests/support/law_traces.py"
        )
