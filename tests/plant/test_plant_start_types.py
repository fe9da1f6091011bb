"""Texts of a description are read in the types of their variables: start values, ranges and defaults."""

import contextlib
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.fmu_check.info import info
from hil.addons.fmu_check.slave import Model
from hil.core.errors import BadInputError
from hil.plant import archive
from hil.plant.description import check_start, start_defaults
from hil.plant.start import Value, elements_at_start, limits
from tests.support.broken_fmu import HERE, pack

NAMES = {2: ("Real", "Integer"), 3: ("Float64", "Int64")}


def fmu_with(folder: Path, fmi: int, *parameters: tuple[str, str, str]) -> Path:
    """Make an FMU with these parameters: name, type and further XML attributes, or elements."""
    rows = []
    for place, (name, kind, more) in enumerate(parameters):
        inner, _, element = more.partition(">")
        common = f'name="{name}" valueReference="{100 + place}" causality="parameter" variability="fixed"'
        rows.append(
            f"<ScalarVariable {common}><{kind} {inner}/></ScalarVariable>"
            if fmi == 2
            else f"<{kind} {common} {inner}>{element}</{kind}>"
        )
    end = b"</ModelVariables>"
    return pack(folder / "a.fmu", fmi, lambda _, data: data.replace(end, "".join(rows).encode() + end))


def test_every_type_of_start_is_read_and_what_a_scenario_cannot_set_is_left_out(tmp_path: Path) -> None:
    two = fmu_with(tmp_path, 2, ("on", "Boolean", 'start="false"'), ("off", "Boolean", 'start="1"'))
    assert start_defaults(two) == {"gain": 2.0, "shape": 1, "on": False, "off": True}
    assert [type(value) for value in start_defaults(two).values()] == [float, int, bool, bool]
    three = fmu_with(
        tmp_path,
        3,
        ("row", "Float64", 'start="1 2"><Dimension start="2"/>'),
        ("bits", "Boolean", 'start="true false"><Dimension start="2"/>'),
        ("blob", "Binary", '><Start value="00ff"/>'),
        ("text", "String", '><Start value="1 2"/>'),
        ("large", "UInt64", 'start="18446744073709551615"'),
    )
    assert start_defaults(three) == {"gain": 2.0, "shape": 1, "text": "1 2", "large": 2**64 - 1}


@given(st.integers(-(2**63), 2**64 - 1))
def test_no_bit_of_an_integer_is_lost(tmp_path_factory: pytest.TempPathFactory, number: int) -> None:
    kind = "Int64" if number < 2**63 else "UInt64"
    fmu = fmu_with(tmp_path_factory.getbasetemp(), 3, ("n", kind, f'start="{number}" min="{number}"'))
    assert start_defaults(fmu)["n"] == number
    assert [v.min for v in info(fmu, "n").variables] == [str(number)]
    check_start(fmu, {"n": number})
    if number > -(2**63):
        with pytest.raises(BadInputError, match="expected at least"):
            check_start(fmu, {"n": number - 1})


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("place", "attributes", "words"),
    [
        (1, 'start="2.5"', "= '2.5'; expected a whole number"),
        (0, 'start="2,5"', "= '2,5'; expected a number"),
        (None, 'start="True"', "= 'True'; expected true or false"),
    ],
)
def test_a_start_that_is_not_of_its_type_is_refused_by_name(
    fmi: int, place: int | None, attributes: str, words: str, tmp_path: Path
) -> None:
    fmu = fmu_with(tmp_path, fmi, ("odd", "Boolean" if place is None else NAMES[fmi][place], attributes))
    with pytest.raises(BadInputError, match=f"^the FMU's modelDescription.xml gives odd of type .* start {words}$"):
        start_defaults(fmu)


EDGES = [  # parameter, the values that it takes, and what is said of others
    ("gain", (0.5, 5), {0.4999: "0.4999; expected a number from 0.5 to 5", 5.001: "5.001; expected a number"}),
    ("low", (-2.5, 1e9), {-2.75: "-2.75; expected at least -2.5"}),
    ("high", (-1e9, 7.25), {7.5: "7.5; expected at most 7.25"}),
    ("byte", (-128, 127, 3.0), {128: "128; expected a whole number of 8 bits, as Int8 is",
                                -129: "-129; expected a whole", 2.5: "2.5; expected a whole"}),
    ("word", (0, 65535), {65536: "65536; expected a whole number of 16 bits, unsigned as UInt16 is",
                          -1: "-1; expected"}),
    ("shape", ("linear", 2), {3: "3; expected one of 'linear' (1), 'squared' (2)", True: "true; expected one of",
                              "sqared": "'sqared'; expected an item of the enumeration; did you mean 'squared'?"}),
    ("on", (True,), {1: "1; expected true or false"}),
    ("text", ("",), {2.0: "2; expected a text"}),
    ("blob", (), {"00": "'00'; its type Binary cannot be set here"}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "fits", "refused"), EDGES)
def test_a_value_is_taken_up_to_the_edge_of_its_range(
    name: str, fits: tuple[Value, ...], refused: dict[Value, str], tmp_path: Path
) -> None:
    fmu = fmu_with(
        tmp_path,
        3,
        ("low", "Float64", 'start="0" min="-2.5"'),
        ("high", "Float64", 'start="0" max="7.25"'),
        ("byte", "Int8", 'start="0"'),
        ("word", "UInt16", 'start="0"'),
        ("on", "Boolean", 'start="false"'),
        ("text", "String", '><Start value="a"/>'),
        ("blob", "Binary", '><Start value="00ff"/>'),
    )
    for value in fits:
        check_start(fmu, {name: value})
    for value, words in refused.items():
        with pytest.raises(BadInputError) as caught:
            check_start(fmu, {name: value})
        assert str(caught.value).startswith(f"plant.start.{name} = {words}")


DESCRIPTIONS = {fmi: (HERE / f"lag_fmi{fmi}.xml").read_text(encoding="utf-8") for fmi in (2, 3)}
PLACES = [(fmi, *found.span(1)) for fmi, text in DESCRIPTIONS.items() for found in re.finditer(r' \w+="([^"]*)"', text)]
ODD = ["", "abc", "1.5", "-1", "true", "1e400", "9" * 30, "0x10", "\u0663", "1 2", "shape", "NaN"]


@given(st.sampled_from(PLACES), st.sampled_from(ODD))
def test_no_text_of_an_attribute_is_anything_but_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, place: tuple[int, int, int], odd: str
) -> None:
    fmi, begin, end = place
    text = DESCRIPTIONS[fmi]
    changed = (text[:begin] + odd + text[end:]).encode()
    fmu = pack(tmp_path_factory.getbasetemp() / "odd.fmu", fmi, lambda name, d: changed if name.endswith(".xml") else d)
    start = {"gain": 1.0, "shape": "linear", "u": 0.0}
    for read in (info, start_defaults, lambda path: check_start(path, start), ranges_and_values):
        with contextlib.suppress(BadInputError):
            read(fmu)


def ranges_and_values(fmu: Path) -> None:
    """Read what a check reads of a description."""
    library = archive.library_of(fmu)
    model = Model(fmu, fmu.parent, fmu.parent / library.member, library.fmi_version, lambda **_: None)
    for variable in model.variables:
        for read in (limits, elements_at_start):
            read(variable)
    for place, variable in enumerate(model.inputs):
        model.input_value(variable, 1, place)
