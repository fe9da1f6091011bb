"""Laws of stacking: the later layer wins, nothing else is lost, every value remembers where it was given."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.options import format_value
from hil.scenario.layers import Tree, assign, dotted, leaves, make_layer, merge, plain, stack
from hil.scenario.toml_text import key_lines, parse, parse_value

names = st.sampled_from(["a", "b", "c", "d"])
scalars = st.integers() | st.booleans() | st.text(max_size=3)
documents = st.dictionaries(
    names,
    st.recursive(
        scalars | st.lists(scalars, max_size=2),
        lambda inner: st.dictionaries(names, inner, min_size=1, max_size=3),
        max_leaves=8,
    ),
    max_size=4,
)
# The same shape in every layer: names of tables and names of values are told apart, as a schema does.
shaped_documents = st.recursive(
    st.dictionaries(names, scalars, max_size=3),
    lambda inner: st.builds(
        lambda keys, tables: {**keys, **tables},
        st.dictionaries(names, scalars, max_size=3),
        st.dictionaries(st.sampled_from(["t", "u", "v"]), inner, max_size=3),
    ),
    max_leaves=6,
)


def layer(document: dict[str, object], where: str) -> Tree:
    return make_layer(document, where)


def given_values(tree: Tree) -> dict[str, tuple[object, str]]:
    return {dotted(path): (given.value, given.where) for path, given in leaves(tree)}


@given(documents, documents)
def test_the_later_layer_wins_and_the_rest_stays(below: dict[str, object], above: dict[str, object]) -> None:
    low, high = given_values(layer(below, "below")), given_values(layer(above, "above"))
    merged = given_values(merge(layer(below, "below"), layer(above, "above")))
    assert high.items() <= merged.items()
    for key in low.keys() - high.keys():
        hidden = any(f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.") for other in high)
        assert hidden or merged[key] == low[key]
    assert merged.keys() <= low.keys() | high.keys()


@given(shaped_documents, shaped_documents, shaped_documents)
def test_merging_is_associative(a: dict[str, object], b: dict[str, object], c: dict[str, object]) -> None:
    low, middle, high = layer(a, "a"), layer(b, "b"), layer(c, "c")
    assert merge(merge(low, middle), high) == merge(low, merge(middle, high))


@given(documents)
def test_merging_with_nothing_or_itself_changes_nothing(document: dict[str, object]) -> None:
    tree = layer(document, "here")
    assert merge({}, tree) == merge(tree, {}) == merge(tree, tree) == tree


@given(documents, documents)
def test_merging_leaves_its_arguments_alone(below: dict[str, object], above: dict[str, object]) -> None:
    low, high = layer(below, "below"), layer(above, "above")
    before = repr((low, high))
    merge(low, high)
    assert repr((low, high)) == before


@given(documents, st.lists(names, min_size=1, max_size=3), scalars)
def test_what_is_assigned_is_there(document: dict[str, object], path: list[str], value: object) -> None:
    tree = assign(layer(document, "file"), ".".join(path), value, "--set")
    assert given_values(tree)[".".join(path)] == (value, "--set")


def test_another_law_drops_the_gains_of_the_one_before_but_not_the_command() -> None:
    below = layer({"controller": {"law": "afdsc", "command": "torque", "gains": {"tables": "printed"}}}, "below")
    above = layer({"controller": {"law": "dsc", "gains": {"k1_1_s": 8.0}}}, "above")
    expected = {"controller": {"law": "dsc", "command": "torque", "gains": {"k1_1_s": 8.0}}}
    assert plain(stack(below, above)) == expected


def test_the_same_law_keeps_its_gains() -> None:
    below = layer({"controller": {"law": "dsc", "gains": {"k1_1_s": 8.0}}}, "below")
    assert plain(stack(below, layer({"controller": {"law": "dsc"}}, "above"))) == plain(below)


def test_another_reference_drops_the_options_of_the_one_before() -> None:
    below = layer({"reference": {"kind": "circle", "radius_m": 1.0}}, "below")
    above = layer({"reference": {"kind": "hold", "x_m": 2.0}}, "above")
    assert plain(stack(below, above)) == {"reference": {"kind": "hold", "x_m": 2.0}}


def test_an_array_of_tables_replaces_the_one_before() -> None:
    below = layer({"expect": [{"signal": "a"}, {"signal": "b"}]}, "below")
    above = layer({"expect": [{"signal": "c"}]}, "above")
    assert plain(stack(below, above)) == {"expect": ({"signal": "c"},)}
    assert plain(stack(below, layer({"expect": []}, "above"))) == {"expect": ()}


def test_one_key_of_a_row_is_assigned() -> None:
    tree = assign(layer({"expect": [{"below": 1}, {"below": 2}]}, "file"), "expect.2.below", 3, "--set")
    assert given_values(tree) == {"expect.1.below": (1, "file"), "expect.2.below": (3, "--set")}


def test_start_values_with_dots_are_one_name_in_every_spelling() -> None:
    nested = layer({"plant": {"start": {"wheel": {"fl": {"angle_rad": 1.0}}}}}, "x")
    quoted = layer({"plant": {"start": {"wheel.fl.angle_rad": 1.0}}}, "x")
    assert nested == quoted == assign({}, "plant.start.wheel.fl.angle_rad", 1.0, "x")


@pytest.mark.parametrize("key", ["", ".", "robot.", ".mass_kg", "robot..mass_kg"])
def test_a_malformed_key_is_refused(key: str) -> None:
    with pytest.raises(BadInputError, match="expected a dotted key"):
        assign({}, key, 1, "--set")


def test_lines_of_all_kinds_of_statements() -> None:
    text = """# a comment with [brackets] and = signs
extends = "x"

[robot]   # a table
mass_kg = 1
"quoted.key" = 2
names = [
    "a",  # [not.a.table]
    "b",
]
text = '''
[nor.this]
key = 1
'''
start = { x = 1, y = 2 }
after.dotted = 3

[[expect]]
below = 1
[[expect]]
below = 2
[[expect.inner]]
deep = 3
"""
    tomllib.loads(text)
    assert key_lines(text) == {
        ("extends",): 2,
        ("robot", "mass_kg"): 5,
        ("robot", "quoted.key"): 6,
        ("robot", "names"): 7,
        ("robot", "text"): 11,
        ("robot", "start", "x"): 15,
        ("robot", "start", "y"): 15,
        ("robot", "after", "dotted"): 16,
        ("expect", "1", "below"): 19,
        ("expect", "2", "below"): 21,
        ("expect", "2", "inner", "1", "deep"): 23,
    }
    assert key_lines(text.replace("\n", "\r\n")) == key_lines(text)


@given(st.integers(-(2**63), 2**63 - 1) | st.booleans() | st.floats(allow_nan=False) | st.lists(st.integers()))
def test_a_written_value_reads_back(value: object) -> None:
    assert parse_value(format_value(value)) == value


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_any_text_is_a_value(text: str) -> None:
    parse_value(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("24", 24),
        ("2.4e1", 24.0),
        ("true", True),
        ('"24"', "24"),
        ("[1, 2]", [1, 2]),
        ("{a = 1}", {"a": 1}),
        ("memory:", "memory:"),
        ("24 kg", "24 kg"),
        ("1\nb = 2", "1\nb = 2"),
        ("", ""),
    ],
)
def test_what_is_no_toml_is_text(text: str, value: object) -> None:
    assert parse_value(text) == value


@pytest.mark.parametrize(("begin", "end"), [("a." * 48 + "a = [", "]"), ("a = " + "[" * 49, "]" * 49)])
def test_a_document_is_read_unless_its_values_are_50_deep(begin: str, end: str) -> None:
    parse(f"{begin}{end}", "my.toml")
    with pytest.raises(BadInputError, match=r"my\.toml: not readable: arrays or tables are nested more than 50 deep"):
        parse(f"{begin}1{end}", "my.toml")
