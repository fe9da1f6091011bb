"""From the bridge's signals to an FMU's variables: the equation, and every row that does not fit."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES, Wheels
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import Row, SignalMap
from hil.plant.start import Value
from tests.support.examples import share_of_examples
from tests.support.foreign_fmu import Var, foreign_fmu, foreign_map, variables2
from tests.support.plant_testbed import FMU

SCALES = st.floats(0.01, 100)
OFFSETS = st.floats(-5, 5)
SIGNS = st.sampled_from([1, -1])


def single(value: float) -> float:
    return float(np.float32(value))


def refusal(fmu: Path, mapping: SignalMap, start: Mapping[str, Value] | None = None) -> str:
    with pytest.raises(BadInputError) as caught:
        FmuPlant(fmu, start or {}, mapping=mapping)
    return str(caught.value)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return foreign_fmu(tmp_path_factory.mktemp("two"), 2)


@pytest.fixture(scope="module")
def foreign3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return foreign_fmu(tmp_path_factory.mktemp("three"), 3)


@share_of_examples(0.15)
@given(
    torque=st.tuples(*[st.floats(-1, 1, width=32)] * 4),
    rows=st.lists(st.tuples(SCALES, OFFSETS, SIGNS), min_size=5, max_size=5),
)
def test_bridge_value_is_sign_scale_fmu_value_plus_offset(
    torque: tuple[float, ...], rows: list[tuple[float, float, int]]
) -> None:
    """The shipped FMU as a foreign one: its torques are the inverse of the equation, its pose the equation."""
    names = [*(f"wheel.{wheel}.torque_n_m" for wheel in WHEEL_NAMES), "pose.x_m"]
    mapping = SignalMap({name: Row(name, *row, "") for name, row in zip(names, rows, strict=True)})
    given_to_fmu = [
        (value - offset) / (sign * scale) for value, (scale, offset, sign) in zip(torque, rows[:4], strict=True)
    ]
    with FmuPlant(FMU, {}, mapping=mapping) as mapped, FmuPlant(FMU, {}) as plain:
        mapped.step(Wheels(*torque), 50)
        plain.step(Wheels(*given_to_fmu), 50)
        scale, offset, sign = rows[4]
        x, *rest = plain.truth().pose
        # The plain plant is given its torques in single precision, the mapped one's FMU in double.
        worst = 1e-7 * (1 + max(abs(value) for value in given_to_fmu))
        assert np.allclose(mapped.truth().pose[1:], rest, rtol=1e-6, atol=worst)
        assert np.isclose(mapped.truth().pose.x_m, sign * scale * x + offset, rtol=1e-6, atol=worst * scale)


def test_a_row_of_the_identity_changes_no_bit() -> None:
    mapping = SignalMap({name: Row(name) for name in ("pose.x_m", "wheel.rl.torque_n_m", "wheel.fl.count")})
    start = {"start_yaw_rate_rad_s": 1.0}
    with FmuPlant(FMU, start, mapping=mapping) as mapped, FmuPlant(FMU, start) as plain:
        for plant in (mapped, plain):
            plant.step(Wheels(0.3, -0.1, 0.7, 0.2), 500)
        assert mapped.truth() == plain.truth()
        assert mapped.wheel_speeds() == plain.wheel_speeds()


def test_all_problems_are_told_at_once(foreign: Path) -> None:
    mapping = foreign_map(
        2,
        wheel_fl__torque_n_m=Row("tua1"),
        wheel_fr__torque_n_m=Row("x"),
        pose__x_m=Row("gear"),
        pose__y_m=Row("label"),
    )
    no_output = "is of causality parameter; expected an output or a local variable"
    assert refusal(foreign, mapping).splitlines() == [
        "plant.map.\"wheel.fl.torque_n_m\": wheels2.fmu has no variable 'tua1'; did you mean 'tau1'?",
        "plant.map.\"wheel.fr.torque_n_m\": 'x' of wheels2.fmu is of causality output; expected an input",
        f"plant.map.\"pose.x_m\": 'gear' of wheels2.fmu {no_output}",
        f"plant.map.\"pose.y_m\": 'label' of wheels2.fmu {no_output}",
    ]


def test_a_row_for_a_variable_that_is_not_there_is_refused(foreign: Path) -> None:
    mapping = foreign_map(2, pose__heading_rad=Row("nothing like it"))
    assert "has no variable 'nothing like it'; known: " in refusal(foreign, mapping)


def test_what_is_missing_is_named(foreign: Path) -> None:
    text = refusal(foreign, SignalMap())
    assert text.startswith("wheels2.fmu has no variable of the name of wheel.fl.torque_n_m, ")
    for name in ("pose.x_m", "pose.heading_rad", "wheel.rl.torque_n_m", "wheel.rr.angle_rad (or both wheel.rr.count"):
        assert name in text
    only_count = foreign_map(2, wheel_fl__angle_rad=None, wheel_fl__count=Row("n1"))
    assert "no variable of the name of wheel.fl.angle_rad (or both" in refusal(foreign, only_count)
    both = foreign_map(2, wheel_fl__angle_rad=None, wheel_fl__count=Row("n1"), wheel_fl__speed_rad_s=Row("w1"))
    FmuPlant(foreign, {}, mapping=both).close()


def test_what_follows_needs_its_numbers(foreign: Path) -> None:
    text = refusal(foreign, SignalMap(foreign_map(2).rows))
    assert "counts_per_revolution = None; expected a positive number, since wheel.fl.count, " in text
    assert "torque_constant_n_m_a = None; expected a positive number, since wheel.fl.current_a, " in text


def test_an_input_serves_one_signal(foreign: Path) -> None:
    mapping = foreign_map(2, wheel_fr__torque_n_m=Row("tau1"))
    assert "'tau1' already takes wheel.fl.torque_n_m; each needs its own input" in refusal(foreign, mapping)


@pytest.mark.parametrize("kind", ["Boolean", "String", "Enumeration"])
def test_an_output_that_is_no_number_is_refused(kind: str, tmp_path: Path) -> None:
    fmu = foreign_fmu(
        tmp_path, 2, variables=[*variables2(), Var("odd", 99, kind, "output", {"variability": "discrete"})]
    )
    assert f"'odd' of wheels2.fmu is of type {kind}; expected a number" in refusal(
        fmu, foreign_map(2, pose__x_m=Row("odd"))
    )


def test_an_input_that_is_no_float_is_refused(tmp_path: Path) -> None:
    odd = Var("odd", 99, "Integer", "input", {"variability": "discrete", "start": "0"})
    fmu = foreign_fmu(tmp_path, 2, variables=[*variables2(), odd])
    words = "'odd' of wheels2.fmu is of type Integer; expected Real, Float64 or Float32"
    assert words in refusal(fmu, foreign_map(2, wheel_rl__torque_n_m=Row("odd")))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("phi", "'phi' is an array; name one element of it, such as 'phi[1,1]'"),
        ("phi[3,1]", "'phi[3,1]' is not there: the array has 2 x 2 elements, counted from 1"),
        ("phi[0,1]", "'phi[0,1]' is not there"),
        ("phi[1]", "'phi[1]' is not there"),
        ("x[1]", "'x[1]' is not there: the array has no elements"),
        ("fi[1,1]", "has no variable 'fi[1,1]'"),
    ],
)
def test_an_element_that_is_not_there_is_refused(foreign3: Path, name: str, words: str) -> None:
    assert words in refusal(foreign3, foreign_map(3, wheel_fl__angle_rad=Row(name)))


STARTS: list[tuple[dict[str, Value], str]] = [
    ({"gaer": 1}, "plant.start.gaer: wheels{v}.fmu has no such variable; did you mean 'gear'?"),
    ({"x": 1.0}, "plant.start.x: wheels{v}.fmu gives this output its value itself; expected a parameter"),
    ({"fixed_at": 1.0}, "plant.start.fixed_at: wheels{v}.fmu gives this parameter its value itself"),
    ({"J": "heavy"}, "plant.start.J = 'heavy'; expected a finite number"),
    ({"J": True}, "plant.start.J = true; expected a finite number"),
    ({"J": 0.0}, "plant.start.J = 0; expected at least 1e-06"),
    ({"gear": "gared"}, "plant.start.gear = 'gared'; expected an item of the enumeration; did you mean 'geared'?"),
    ({"gear": 2}, "plant.start.gear = 2; expected one of 'direct' (1), 'geared' (3)"),
    ({"reversed": 1}, "plant.start.reversed = 1; expected true or false"),
    ({"label": 5}, "plant.start.label = 5; expected a text"),
    ({"fault": 2.5}, "plant.start.fault = 2.5; expected a whole number of 32 bits"),
    ({"fault": 2**31}, "plant.start.fault = 2147483648; expected a whole number of 32 bits"),
]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("start", "words"), STARTS)
def test_a_start_that_does_not_fit_is_refused(
    version: int, start: dict[str, Value], words: str, foreign: Path, foreign3: Path
) -> None:
    fmu = foreign if version == 2 else foreign3
    assert words.format(v=version) in refusal(fmu, foreign_map(version), start)


def test_all_starts_that_do_not_fit_are_told_at_once(foreign3: Path) -> None:
    start: dict[str, Value] = {"gaer": 1, "J": 0.0, "wheels": -1, "tau": 0.0}
    lines = refusal(foreign3, foreign_map(3), start).splitlines()
    assert len(lines) == 4
    assert lines[2] == "plant.start.wheels = -1; expected a whole number of 32 bits, unsigned as UInt32 is"
    assert lines[3] == "plant.start.tau: this variable is an array, which [plant.start] cannot set"
