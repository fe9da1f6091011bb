"""The histogram of lateness, against NumPy over the same ticks."""

import numpy as np
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
