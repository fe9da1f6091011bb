"""The default and range of each key, and the form of each figure: users count on them without a look at the code."""

import re
from pathlib import Path

from hil.judge.figures import figures
from tests.support.golden import assert_golden
from tools.reference_pages import keys

VECTORS = Path(__file__).parents[1] / "vectors"


def test_the_defaults_and_ranges_of_all_keys_are_those_that_a_person_has_read() -> None:
    """Without their meanings."""
    assert_golden(VECTORS / "keys.txt", re.sub(r"(?m)^(\|.*\|) [^|]*\|$", r"\1", keys()))


def test_the_figures_are_printed_and_compared_as_a_person_has_read() -> None:
    rows = (
        f"{one.name} {one.column} {one.unit} {one.scale:g} {one.printed} {one.resolution:g} {one.resolution_ticks:g}\n"
        for one in figures()
    )
    assert_golden(VECTORS / "figures.txt", "".join(rows))
