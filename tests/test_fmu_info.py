"""What an FMU says of itself, read without running it."""

from pathlib import Path

import pytest

from hil.core.errors import BadInputError
from hil.plant.archive import library_of
from hil.plant.description import check_start, info
from hil.plant.fmu import FmuPlant
from tests.broken_fmu import pack
from tests.plant_testbed import FMU


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


def test_an_unusable_description_is_refused_in_the_same_words_by_all_who_read_it(tmp_path: Path) -> None:
    fmu = pack(tmp_path / "a.fmu", 2, lambda _, data: data.replace(b'valueReference="1"', b'valueReference="&#10;one"'))
    assert library_of(fmu).fmi_version == "2.0"
    words = set()
    for read in (info, lambda path: check_start(path, {}), lambda path: FmuPlant(path, {})):
        with pytest.raises(BadInputError, match=r"its modelDescription\.xml cannot be used \(.*one") as caught:
            read(fmu)
        words.add(str(caught.value))
    assert [text.isprintable() for text in words] == [True]
