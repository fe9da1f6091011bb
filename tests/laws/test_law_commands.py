"""Every law and mode gives the commands that it gave when they were kept (tests/support/law_commands.py)."""

import csv
import itertools

import pytest

from hil.core.types import CommandMode
from tests.support.law_commands import LAWS, SITUATIONS, VECTORS, WHEELS, commands

with VECTORS.open(encoding="utf-8", newline="") as file:
    ROWS = list(csv.DictReader(file))
KEPT = {
    key: {int(row["tick"]): [float(row[wheel]) for wheel in WHEELS] for row in rows}
    for key, rows in itertools.groupby(ROWS, lambda row: (row["law"], row["command"], row["situation"]))
}


def test_there_are_commands_of_every_law_in_every_mode_that_it_has():
    modes = [mode.name.lower() for mode in CommandMode]
    assert set(KEPT) == set(itertools.product(LAWS, modes, SITUATIONS)) - set(
        itertools.product(["computed_torque"], ["speed"], SITUATIONS)
    )


@pytest.mark.parametrize(("law", "command", "situation"), KEPT)
def test_the_wheels_get_what_they_got(law, command, situation):
    found = dict(commands(law, CommandMode[command.upper()], situation))
    kept = KEPT[law, command, situation]
    assert list(found) == list(kept)
    for tick, values in kept.items():
        assert found[tick] == pytest.approx(values, rel=1e-6, abs=1e-6), f"tick {tick}"
