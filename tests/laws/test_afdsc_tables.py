"""The fuzzy block, against the inference that it stands for, and the paper's tables against their pattern."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.laws.afdsc import K1_1_S, K2_1_S, RULES, FuzzyBlock, FuzzyGains

LEVELS = ["VS", "S", "M", "B", "VB"]
PEAKS = [-1.0, -0.5, 0.0, 0.5, 1.0]  # NB, NS, Z, PS, PB, in units of the range
tables = st.sampled_from(["printed", "corrected"])
value = st.floats(-3.0, 3.0)
any_value = value | st.sampled_from([float("nan"), float("inf"), -float("inf")])
span = st.floats(0.05, 5.0)


def memberships(x: float) -> list[float]:
    """Return how much x is NB, NS, Z, PS, PB: triangles half a range to each side, shoulders at the ends."""
    x = min(max(x, -1.0), 1.0)
    return [max(0.0, 1.0 - abs(x - peak) / 0.5) for peak in PEAKS]


def inferred(which: str, error: float, rate: float) -> tuple[float, float]:
    """Return (K1, K2) by product inference over the 25 rules and weighted average."""
    k1_rules, k2_rules = RULES[which]
    weight_sum = k1 = k2 = 0.0
    for (j, of_rate), (i, of_error) in itertools.product(enumerate(memberships(rate)), enumerate(memberships(error))):
        weight = of_rate * of_error
        weight_sum += weight
        k1 += weight * K1_1_S[k1_rules[j][i]]
        k2 += weight * K2_1_S[k2_rules[j][i]]
    return k1 / weight_sum, k2 / weight_sum


@given(tables, value, value, span, span)
def test_look_up_is_product_inference_with_weighted_average(which, error, rate, error_range, rate_range):
    gains = FuzzyGains(FuzzyBlock.from_tables(which, error_range, rate_range))
    expected = inferred(which, error / error_range, rate / rate_range)
    assert gains.at((error, rate)) == pytest.approx(expected, rel=1e-9)


@given(st.lists(st.tuples(tables, any_value, any_value, span, span), min_size=1, max_size=4))
def test_blocks_together_are_as_each_alone(some):
    blocks = [FuzzyBlock.from_tables(which, *spans) for which, _, _, *spans in some]
    inputs = [(error, rate) for _, error, rate, *_ in some]
    together, alone = FuzzyGains(*blocks), [FuzzyGains(block) for block in blocks]
    each = [one.at(pair) for one, pair in zip(alone, inputs, strict=True)]
    assert together.at((*(e for e, _ in inputs), *(r for _, r in inputs))) == (
        *(k1 for k1, _ in each),
        *(k2 for _, k2 in each),
    )
    assert together.firing() == tuple(itertools.chain.from_iterable(one.firing() for one in alone))


@pytest.mark.parametrize("wrong", [(1.0,), ("a", 1.0), [1.0, 1.0]])
def test_what_is_no_tuple_of_an_error_and_a_rate_raises(wrong):
    with pytest.raises(TypeError):
        FuzzyGains(FuzzyBlock.from_tables("printed", 1.0, 1.0)).at(wrong)


@given(tables, value, value)
def test_signs_do_not_matter(which, error, rate):
    at = FuzzyGains(FuzzyBlock.from_tables(which, 1.0, 2.0)).at
    assert at((-error, rate)) == pytest.approx(at((error, rate)))
    assert at((error, -rate)) == pytest.approx(at((error, rate)))


@pytest.mark.parametrize("which", ["printed", "corrected"])
def test_at_the_peaks_the_output_is_the_rule_s(which):
    gains = FuzzyGains(FuzzyBlock.from_tables(which, 0.2, 0.7))
    for (j, rate), (i, error) in itertools.product(enumerate(PEAKS), enumerate(PEAKS)):
        k1_rules, k2_rules = RULES[which]
        expected = K1_1_S[k1_rules[j][i]], K2_1_S[k2_rules[j][i]]
        assert gains.at((0.2 * error, 0.7 * rate)) == pytest.approx(expected)


def test_the_corrected_tables_follow_one_pattern():
    """The level of K1 rises with the size of the error and falls with that of the rate; K2's opposes it."""
    k1_rules, k2_rules = RULES["corrected"]
    for j, i in itertools.product(range(5), range(5)):
        rise = abs(i - 2) - abs(j - 2)
        assert k1_rules[j][i] == LEVELS[2 + rise]
        assert k2_rules[j][i] == LEVELS[2 - rise]


def test_the_printed_tables_differ_at_a_big_error_with_rate_zero_alone():
    for printed, corrected in zip(RULES["printed"], RULES["corrected"], strict=True):
        different = [(j, i) for j, i in itertools.product(range(5), range(5)) if printed[j][i] != corrected[j][i]]
        assert different == [(2, 0), (2, 4)]
        assert {printed[2][0], corrected[2][0]} == {"VS", "VB"}


def test_gains_stay_finite_for_what_is_not_a_number():
    at = FuzzyGains(FuzzyBlock.from_tables("printed", 0.2, 0.7)).at
    nan = float("nan")
    assert at((nan, nan)) == at((-9.0, -9.0))
    assert at((float("inf"), 0.0)) == at((9.0, 0.0))
