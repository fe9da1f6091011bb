"""Numbers and units in messages: bounds in words, the unit that was meant, and digits that tell two numbers apart."""

import math
from typing import Literal

import pytest

from hil.core.errors import (
    BadInputError,
    DeviceError,
    HilError,
    LinkError,
    OverdueError,
    RobotLatchedError,
    RobotStoppedError,
    RunInterruptedError,
    apart,
    error_of,
    kind_of,
    near,
)
from hil.core.options import RATE, Range, format_value, in_another_unit, plausible, size_words


@pytest.mark.parametrize(
    ("name", "value", "within", "words"),
    [
        ("wheel_radius_m", 76.0, Range(ge=0.001, le=1.0), "76 m? if you mean millimetres, write 0.076"),
        ("radius_m", 40.0, Range(ge=0.1, le=1.0), "40 m? if you mean centimetres, write 0.4"),
        ("max_speed_m_s", 1500.0, Range(gt=0, le=10), "1500 m/s? if you mean millimetres a second, write 1.5"),
        ("top_m_s2", -2500.0, Range(ge=-9, le=9), "-2500 m/s²? if you mean millimetres a second squared, write -2.5"),
        ("heading_rad", 90.0, plausible("heading_rad"), "90 rad? if you mean degrees, write 1.5708"),
        ("speed_limit_rad_s", 300.0, Range(gt=0, le=60), "300 rad/s? if you mean turns a minute, write 31.416"),
        ("yaw_rate_rad_s", 180.0, Range(gt=0, le=4), "180 rad/s? if you mean degrees a second, write 3.1416"),
        ("delay_s", 250.0, Range(ge=0, le=10), "250 s? if you mean milliseconds, write 0.25"),
        ("delay_s", 25000.0, Range(ge=0, le=1), "25000 s? if you mean microseconds, write 0.025"),
        ("mass_kg", 20500.0, Range(gt=0, le=10000), "20500 kg? if you mean grams, write 20.5"),
        ("inertia_kg_m2", 5600.0, Range(gt=0, le=1), "5600 kg·m²? if you mean kg·cm², write 0.56"),
        ("inertia_kg_m2", 5.6e6, Range(gt=0, le=1), "5600000 kg·m²? if you mean g·cm², write 0.56"),
        ("torque_limit_n_m", 1800.0, Range(gt=0, le=15), "1800 N·m? if you mean N·mm, write 1.8"),
        ("torque_limit_n_m", 180.0, Range(ge=1, le=15), "180 N·m? if you mean N·cm, write 1.8"),
        ("current_a", 2500.0, Range(gt=0, le=100), "2500 A? if you mean milliamperes, write 2.5"),
        ("supply_v", 24000.0, Range(gt=0, le=1000), "24000 V? if you mean millivolts, write 24"),
        ("winding_ohm", 220.0, Range(gt=0, le=100), "220 Ω? if you mean milliohms, write 0.22"),
        ("winding_h", 50.0, Range(gt=0, le=1), "50 H? if you mean millihenries, write 0.05"),
        ("winding_h", 5000.0, Range(gt=0, le=1), "5000 H? if you mean microhenries, write 0.005"),
    ],
)
def test_a_value_that_is_too_large_may_be_in_another_unit(name: str, value: float, within: Range, words: str) -> None:
    assert in_another_unit(name, value, within) == f"; {words}"


@pytest.mark.parametrize(
    ("name", "value", "within"),
    [
        ("wheel_radius_m", 0.0001, Range(ge=0.001, le=1.0)),  # too small
        ("wheel_radius_m", 1e6, Range(ge=0.001, le=1.0)),  # too large in any unit
        ("wheel_radius_m", 76.0, Range(ge=0.001)),
        ("tones", 76.0, Range(ge=1, le=40)),
        ("gain_n_m_s_rad", 76.0, Range(ge=0.001, le=1.0)),
    ],
)
def test_where_no_other_unit_fits_none_is_proposed(name: str, value: float, within: Range) -> None:
    assert in_another_unit(name, value, within) == ""


def test_an_angle_without_bounds_is_at_most_whole_turns() -> None:
    assert plausible("heading_rad") == Range(ge=-6.3, le=6.3)
    assert plausible("heading_rad", 2) == Range(ge=-12.6, le=12.6)
    assert plausible("yaw_rate_rad_s") == plausible("label") == Range()


@pytest.mark.parametrize(
    ("within", "words", "held", "not_held"),
    [
        (Range(), "", (-1e9, math.inf), (math.nan,)),
        (Range(gt=0), " greater than 0", (1e-9,), (0.0, -1.0)),
        (Range(gt=0.5, le=2), " greater than 0.5 and at most 2", (0.6, 2.0), (0.5, 2.1, math.nan)),
        (Range(ge=2), " of at least 2", (2.0, 9.0), (1.9,)),
        (Range(ge=-1, le=15.99609375), " from -1 to 15.99609375", (-1.0, 15.99609375), (-1.1, 16.0)),
        (RATE, " greater than 0 and at most 1000", (0.1, 1000.0), (0.0, 1000.1)),
    ],
)
def test_bounds_hold_as_their_words_say(
    within: Range, words: str, held: tuple[float, ...], not_held: tuple[float, ...]
) -> None:
    assert str(within) == words
    assert all(map(within.holds, held))
    assert not any(map(within.holds, not_held))


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (0.0, None),
        (-1e30, None),
        (1e-30, None),
        (-1.1e30, "a size of at most 1e+30"),
        (9e-31, "0, or a size of at least 1e-30"),
        (-9e-31, "0, or a size of at least 1e-30"),
    ],
)
def test_a_number_whose_powers_are_none_is_told(number: float, words: str | None) -> None:
    assert size_words(number) == words


def test_values_are_written_as_in_a_scenario() -> None:
    value = {"a": [True, False, 1, 2.5, "é"], "b": {"c": None}}
    assert format_value(value) == '{a = [true, false, 1, 2.5, "é"], b = {c = None}}'


@pytest.mark.parametrize(
    ("value", "bounds", "digits", "text"),
    [
        (2.34567, (2.0,), 3, "2.35"),
        (0.8496, (0.85,), 2, "0.8496"),
        (1.00000000001, (1.0,), 3, "1.00000000001"),
        (1.0000000000001, (1.0,), 3, "1"),  # the rounding of a sum
        (19.996, (19.99, 20.0), 3, "19.996"),
        (20.0, (20.0,), 3, "20"),
        (-0.3004, (-0.3,), 2, "-0.3004"),
    ],
)
def test_a_number_has_the_digits_that_put_it_on_its_side_of_a_bound(
    value: float, bounds: tuple[float, ...], digits: Literal[2, 3], text: str
) -> None:
    assert apart(value, *bounds, digits=digits) == text


def test_as_many_as_three_words_are_near() -> None:
    assert near("ab", ("abc", "abd", "abe")) == ["abc", "abd", "abe"]
    assert near("ab", ("abc", "abd", "abe", "abf")) == []
    assert near("wxyz1", ("wxyza", "wxyzb", "wxyzc")) == ["wxyza", "wxyzb", "wxyzc"], "equally alike"
    assert near("wxyz1", ("wxyza", "wxyzb", "wxyzc", "wxyzd")) == []
    assert near("abcd", ("abxd", "abcx1")) == ["abxd"], "three of four letters are enough"
    assert near("abc", ("axcx",)) == []


def test_an_error_passes_between_processes_by_the_name_of_its_kind() -> None:
    codes = {
        HilError: 2, BadInputError: 2, LinkError: 3, DeviceError: 3, RobotStoppedError: 3, RobotLatchedError: 3,
        OverdueError: 3, RunInterruptedError: 130,
    }  # fmt: skip
    for kind, code in codes.items():
        again = error_of(kind_of(kind("why")), "why")
        assert (type(again), str(again), again.exit_code) == (kind, "why", code)
    assert type(error_of("Unknown", "why")) is type(error_of(None, "why")) is DeviceError

    class SpecialError(LinkError):
        """Of another module."""

    assert kind_of(SpecialError("why")) == "LinkError"
