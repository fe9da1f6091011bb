"""A short run of the fuzzers of ``tests/fuzz``; ``python -m tools.fuzz`` runs them for long."""

from pathlib import Path

import pytest

from tests import once
from tools import fuzz


@pytest.mark.parametrize("target", fuzz.TARGETS)
def test_a_short_run_breaks_no_check(target: str, tmp_path: Path) -> None:
    runs = 5000
    try:
        shared = once.made("fuzz", fuzz.compile_shared_part)
        outcome = fuzz.fuzz(target, runs, seed=1, keep_in=tmp_path, shared=shared)
    except fuzz.UnavailableError as error:
        pytest.skip(str(error))
    assert outcome.failure is None, outcome.failure
    assert outcome.runs >= runs
    # The arithmetic of times has no line, and is little code.
    least = 300 if target == "timing" else 500
    assert outcome.features > least, "the mutator gets past the checks of the line"
