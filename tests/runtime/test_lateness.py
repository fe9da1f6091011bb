"""The histogram of lateness, against NumPy over the same ticks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.runtime.lateness import EDGES_NS, Lateness

LATE_NS = st.lists(st.integers(0, 5_000_000_000), min_size=1, max_size=300)


def _of(late_ns: list[int]) -> Lateness:
    histogram = Lateness()
    for one_ns in late_ns:
        histogram.add(one_ns)
    return histogram


@given(LATE_NS)
def test_every_tick_is_counted_in_the_bucket_that_has_it(late_ns: list[int]) -> None:
    expected, _ = np.histogram(late_ns, [0, *EDGES_NS, 10**18])
    assert _of(late_ns).counts == expected.tolist()


@given(LATE_NS)
def test_a_percentile_is_within_the_bucket_of_the_true_one(late_ns: list[int]) -> None:
    found = _of(late_ns)
    for name, share in (("p50", 50.0), ("p99", 99.0), ("p99.9", 99.9)):
        true_ns = float(np.percentile(late_ns, share, method="inverted_cdf"))
        bucket = int(np.searchsorted(EDGES_NS, true_ns, side="right"))
        low_ns = (0, *EDGES_NS)[bucket]
        high_ns = (*EDGES_NS, max(late_ns))[bucket]
        assert low_ns <= found.percentiles_us()[name] * 1e3 * (1 + 1e-12)
        assert found.percentiles_us()[name] * 1e3 <= min(high_ns, max(late_ns)) * (1 + 1e-12)


def test_buckets_are_ten_a_decade_from_a_microsecond_to_a_second() -> None:
    assert (EDGES_NS[0], EDGES_NS[-1], len(EDGES_NS)) == (1_000, 1_000_000_000, 61)
    assert np.ptp(np.diff(np.log10(EDGES_NS))) < 1e-3


def test_without_a_tick_there_are_no_figures() -> None:
    assert Lateness().figures() is None
    assert Lateness().percentiles_us() == {}


def test_ticks_that_are_never_late_have_no_lateness() -> None:
    figures = _of([0] * 10).figures()
    assert figures is not None
    assert [figures[name] for name in ("p50", "p99", "p99.9", "max")] == [0.0] * 4


def test_a_percentile_is_interpolated_within_its_bucket_as_the_buckets_are_made() -> None:
    mixed = _of([500] * 4 + [1500] * 6 + [3000] * 10)
    # The share of the bucket's ticks that are needed: 10 of 10 are below 1584.9 ns, 9.8 and 9.98 of 10 up to 3000 ns.
    assert mixed.percentiles_us() == pytest.approx(
        {"p50": 1.585, "p99": 2.512 * (3.0 / 2.512) ** 0.98, "p99.9": 2.512 * (3.0 / 2.512) ** 0.998}
    )
    assert _of([500] * 8).percentiles_us()["p50"] == pytest.approx(0.25), "the first bucket begins at 0"
    late = Lateness()
    late.add(2_000, 3)
    late.add(7_000_000_000)
    figures = late.figures()
    assert figures is not None
    assert (figures["max"], sum(figures["counts"]), figures["counts"][-1]) == (7e6, 4, 1)
    assert figures["edges"] == pytest.approx([10 ** (place / 10) for place in range(61)], rel=1e-3)
    assert 1e6 < figures["p99"] < 7e6
