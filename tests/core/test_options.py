"""Options from plain values: types, ranges, tables within tables, and one sentence for each problem."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import pytest

from hil.core.errors import BadInputError
from hil.core.options import OTHERS, Expected, OptionsError, Range, build, items, options_of, plain


def _even(value: int) -> int:
    if value % 2:
        raise ValueError("expected an even number")
    return value


@dataclass(frozen=True)
class Row:
    name: Annotated[str, Expected("the name of a thing")]
    scale: Annotated[float, Range(gt=0)] = 1.0

    def __post_init__(self) -> None:
        if self.name == "both" and self.scale != 1.0:
            raise ValueError("both has no scale; remove it")


@dataclass(frozen=True)
class Options:
    share: Annotated[float, Range(ge=0, le=1), "of the whole"]
    kind: Literal["a", "b", "0.5"] = "a"
    count: Annotated[int, Range(ge=2), _even] = 4
    until_s: Annotated[float, Range(gt=0, infinite=True)] = math.inf
    pair: tuple[float, float] | None = None
    numbers: tuple[int, ...] = ()
    rows: tuple[Row, ...] = ()
    gains: Annotated[Mapping[str, Any], OTHERS] = field(default_factory=dict)


@dataclass(frozen=True)
class Closed:
    share: float = 0.0
    row: Row | None = None


def test_values_become_the_dataclass_and_plain_values_again() -> None:
    given = {"share": 1, "pair": [1, 2], "rows": [{"name": "x", "scale": 2}], "k1": 3, "until_s": 5}
    made = build(Options, given)
    assert (made.share, made.pair, made.rows, made.gains) == (1.0, (1.0, 2.0), (Row("x", 2.0),), {"k1": 3})
    assert type(made.share) is type(made.until_s) is float
    assert build(Options, plain(made)) == made
    assert dict(items(made))["k1"] == 3
    assert options_of(Options)["share"].meaning == "of the whole"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"share": 2}, "t.share = 2; expected a number from 0 to 1"),
        ({"share": True}, "t.share = true; expected a number from 0 to 1"),
        ({"share": math.inf}, "t.share = inf; expected a finite number from 0 to 1"),
        ({"share": 10**400}, "expected a finite number from 0 to 1"),
        ({"until_s": math.nan}, "t.until_s = nan; expected a number greater than 0"),
        ({"kind": "c"}, 't.kind = "c"; expected "a", "b" or "0.5"'),
        ({"kind": 0.5}, 't.kind = 0.5; expected text in quotation marks: "0.5"'),
        ({"count": 1}, "t.count = 1; expected a whole number of at least 2"),
        ({"count": 2.0}, "t.count = 2.0; expected a whole number of at least 2"),
        ({"count": 3}, "t.count = 3; expected an even number"),
        ({"pair": [1]}, "t.pair = [1]; expected two numbers: [low, high]"),
        ({"numbers": [1, "2"]}, 't.numbers.2 = "2"; expected a whole number'),
        ({"rows": [{"name": "x"}, {"name": "y", "scale": 0}]}, "t.rows.2.scale = 0; expected a number greater than 0"),
        ({"rows": [{"scale": 2}]}, "t.rows.1.name is missing; expected the name of a thing"),
        ({"rows": [{"name": "x", "scalle": 2}]}, "unknown key t.rows.1.scalle; did you mean 't.rows.1.scale'?"),
        ({"rows": [{"name": "both", "scale": 2}]}, "t.rows.1: both has no scale; remove it"),
        ({"rows": {}}, "t.rows: expected an array of tables: write [[...]], with two brackets"),
    ],
)
def test_a_value_that_is_wrong_is_named_with_its_place_and_what_was_expected(change: Any, sentence: str) -> None:
    with pytest.raises(OptionsError) as caught:
        build(Options, {"share": 0.5} | change, "t")
    assert sentence in str(caught.value)
    assert len(caught.value.problems) == 1


def test_each_problem_has_a_line_and_a_misspelt_key_is_not_missing_too() -> None:
    with pytest.raises(OptionsError) as caught:
        build(Options, {"share": 2, "count": 1}, "t")
    assert len(str(caught.value).splitlines()) == 2
    with pytest.raises(OptionsError) as caught:
        build(Row, {"nam": "x"}, "row")
    assert str(caught.value) == "unknown key row.nam; did you mean 'row.name'?"
    with pytest.raises(OptionsError, match=r"t\.row = 3; expected a table"):
        build(Closed, {"row": 3}, "t")


def test_only_a_dataclass_defines_options() -> None:
    with pytest.raises(BadInputError, match="must be a dataclass"):
        build(int, {}, "controller.gains")
