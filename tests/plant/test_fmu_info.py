"""What an FMU says of itself, read without running it."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.fmu_check.info import info
from hil.core.errors import BadInputError
from hil.plant.archive import library_of
from hil.plant.description import check_start
from hil.plant.fmu import FmuPlant
from tests.support.broken_fmu import pack
from tests.support.plant_testbed import FMU


def test_info_of_the_shipped_fmu() -> None:
    about = info(FMU)
    assert (about.shipped, about.fmi_version, about.interfaces) == ("mecanum", "2.0", {"CoSimulation": "mecanum"})
    assert "canGetAndSetFMUstate" in about.capabilities["CoSimulation"]
    assert about.about["license"] == "MIT"
    assert about.experiment["step"] == "0.001"
    by_name = {variable.name: variable for variable in about.variables}
    mass = by_name["mass_kg"]
    assert (mass.causality, mass.unit, mass.start, mass.type) == ("parameter", "kg", "20.0", "Real")
    assert by_name["pose.x_m"].start is None
    assert ("slip", "2") in by_name["contact"].items


def test_info_of_an_fmi_3_fmu_has_arrays_ranges_and_enumerations(tmp_path: Path) -> None:
    about = info(pack(tmp_path / "a.fmu", 3))
    by_name = {variable.name: variable for variable in about.variables}
    assert by_name["w"].dimensions == (2,)
    assert (by_name["gain"].min, by_name["gain"].max) == ("0.5", "5")
    assert by_name["shape"].items == (("linear", "1"), ("squared", "2"))
    assert about.capabilities["CoSimulation"][1] == "canGetAndSetFMUState"


def test_info_of_some_variables(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", 2)
    assert [v.name for v in info(fmu, "*a*").variables] == ["gain", "shape"]
    with pytest.raises(BadInputError, match=r"no variable fits 'gian'; did you mean 'gain'\?"):
        info(fmu, "gian")


BRACKETS = ["motor[1].tau", "motor1.tau", "phi[1]", "phi1", "a*", "ab", "a?", "[x]", "x", "[!x]"]


@given(st.sampled_from(BRACKETS), st.lists(st.sampled_from(BRACKETS), unique=True))
def test_a_name_is_that_variable_and_only_star_and_question_mark_are_patterns(
    tmp_path_factory: pytest.TempPathFactory, asked: str, names: list[str]
) -> None:
    there = dict.fromkeys([asked, *names, "motor[2].tau"])
    rows = "".join(f'<ScalarVariable name="{n}" valueReference="9"><Real/></ScalarVariable>' for n in there)
    end = b"</ModelVariables>"
    fmu = pack(tmp_path_factory.getbasetemp() / "names.fmu", 2, lambda _, d: d.replace(end, rows.encode() + end))
    assert [v.name for v in info(fmu, asked).variables] == [asked]
    assert [v.name for v in info(fmu, "m*r?2?.t*").variables] == ["motor[2].tau"]


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_description_that_is_wrong_beside_its_variables_is_refused(fmi: int, tmp_path: Path) -> None:
    unit = b'<UnitDefinitions><Unit name="x"><BaseUnit kg="abc"/></Unit></UnitDefinitions><ModelVariables>'
    fmu = pack(tmp_path / "a.fmu", fmi, lambda _, data: data.replace(b"<ModelVariables>", unit))
    with pytest.raises(BadInputError, match=r"cannot be used .*'abc'"):
        info(fmu)


WRONG = [
    (2, 'valueReference="1"', 'valueReference="one"', "invalid literal for int()"),
    (3, 'Type="shape" start="1"', 'Type="no" start="1"', 'has declaredType="no" which has not been defined'),
    (3, '"parameter" variability="fixed" start', '"parameter" variability="continuous" start', "illegal comb"),
    (3, '<Dimension start="2"', '<Dimension valueReference="77"', "77"),
    (2, '<Unknown index="5"', '<Unknown index="500"', "list index out of"),
]


@pytest.mark.parametrize(("fmi", "old", "new", "words"), WRONG)
def test_a_variable_that_is_wrong_is_refused_alike(fmi: int, old: str, new: str, words: str, tmp_path: Path) -> None:
    fmu = pack(tmp_path / "b.fmu", fmi, lambda _, data: data.replace(old.encode(), new.encode()))
    for read in (info, lambda path: check_start(path, {}), lambda path: FmuPlant(path, {})):
        with pytest.raises(BadInputError, match=r"its modelDescription\.xml cannot be used \(") as told:
            read(fmu)
        assert words in str(told.value)


def test_what_is_wrong_of_an_fmu_is_one_line_of_text(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", 2, lambda _, data: data.replace(b'valueReference="1"', b'valueReference="&#10;one"'))
    assert library_of(fmu).fmi_version == "2.0"
    with pytest.raises(BadInputError) as caught:
        check_start(fmu, {})
    assert str(caught.value).isprintable()
