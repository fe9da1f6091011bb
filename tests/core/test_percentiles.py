"""A sample of bounded size: exact up to its size, whatever pieces the values come in, and fair beyond it."""

import math

import numpy as np
import pytest

from hil.core import percentiles
from hil.core.json_lines import json_safe
from hil.core.percentiles import Reservoir


@pytest.mark.parametrize("pieces", [[10], [3, 7], [4, 4, 2], [9, 1], [1] * 10])
@pytest.mark.parametrize("by_one", [True, False])
def test_up_to_its_size_percentiles_are_numpys(
    monkeypatch: pytest.MonkeyPatch, pieces: list[int], by_one: bool
) -> None:
    monkeypatch.setattr(percentiles, "CAPACITY", 10)
    monkeypatch.setattr(percentiles, "_BLOCK", 4)
    values = np.array([3.0, -1.0, 7.0, 2.5, 9.0, 0.0, 4.0, 8.0, 1.0, 6.0])
    sample = Reservoir()
    assert sample.percentiles() is None
    for piece in np.split(values, np.cumsum(pieces)[:-1]):
        if by_one:
            for value in piece.tolist():
                sample.append(value)
        else:
            sample.extend(np.concatenate([[math.nan], piece, [math.inf]]))
    assert len(sample) == 10
    assert sample.percentiles() == pytest.approx(tuple(np.percentile(values, [50, 99])))


def test_beyond_its_size_each_value_is_kept_as_likely_as_any_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(percentiles, "CAPACITY", 400)
    sample, values = Reservoir(), np.arange(4000.0)
    for piece in np.split(values, [399, 402, 1000, 1001, 2500]):
        sample.extend(piece)
    assert len(sample) == 4000
    found = sample.percentiles()
    assert found is not None
    # The deviation of the median of 400 from 4000 is 4000 / 2 / √400.
    assert found.p50 == pytest.approx(2000.0, abs=3 * 100.0)
    assert found.p99 == pytest.approx(3960.0, abs=3 * 20.0)


def test_the_nth_value_takes_one_of_n_places_of_which_the_first_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    class Places:
        def __init__(self, _seed: int) -> None:
            pass

        def integers(self, low: int, high: np.ndarray) -> np.ndarray:
            asked.append((low, high.tolist()))
            return np.array([1, 4, 3][: len(high)])

    asked: list[tuple[int, list[int]]] = []
    monkeypatch.setattr(percentiles, "CAPACITY", 4)
    monkeypatch.setattr(np.random, "default_rng", Places)
    sample = Reservoir()
    sample.extend(np.arange(7.0))
    sample.extend(np.array([70.0]))
    assert asked == [(0, [5, 6, 7]), (0, [8])]
    assert np.frombuffer(sample._kept).tolist() == [0.0, 70.0, 2.0, 6.0], "place 4 is beyond the sample"


def test_what_json_does_not_have_is_null_wherever_it_is() -> None:
    value = {"a": [1.5, math.nan, (math.inf, "nan", True)], "b": {"c": -math.inf, "d": None, "e": 3}}
    assert json_safe(value) == {"a": [1.5, None, [None, "nan", True]], "b": {"c": None, "d": None, "e": 3}}
