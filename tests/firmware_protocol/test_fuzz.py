"""A short run of the fuzzers of ``tests/firmware_protocol/fuzz``; ``python -m tools.fuzz`` runs them for long."""

import sys
from pathlib import Path

import pytest

from tests.support import once
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


@pytest.mark.skipif(sys.platform != "linux", reason="ASan is loaded before CPython by LD_PRELOAD")
def test_calls_from_python_with_any_values_break_no_check(tmp_path: Path) -> None:
    try:
        library = fuzz.build_sanitised(tmp_path)
    except fuzz.UnavailableError as error:
        pytest.skip(str(error))
    outcome = fuzz.fuzz_python(60, seed=1, library=library)
    assert outcome.failure is None, outcome.failure
    assert outcome.runs > 600, "each sequence has at least ten calls"
