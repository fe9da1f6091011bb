"""Units that an FMU declares: compared with the signal's, converted and told, or refused."""

import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pint
import pytest
from fmpy.model_description import BaseUnit, Unit
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.types import Wheels
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import Row
from hil.plant.units import conversion
from hil.runtime.robots import check_plant_start
from hil.scenario import load
from tests.support.foreign_fmu import Var, foreign_fmu, foreign_map, variables2, variables3
from tests.support.processes import ROOT, environment

DEGREE = math.pi / 180
DEFINED = {
    "deg": BaseUnit(rad=1, factor=DEGREE),
    "grades": BaseUnit(rad=1, factor=math.pi / 200),
    "mm": BaseUnit(m=1, factor=1e-3),
    "m": BaseUnit(m=1),
    "N.cm": BaseUnit(kg=1, m=2, s=-2, factor=1e-2),
    "Hz": BaseUnit(s=-1),
    "rad/s": BaseUnit(s=-1),  # of a tool to which rad is 1
    "rpm": BaseUnit(s=-1, factor=0.10472),  # likewise, and rounded
    "degF": BaseUnit(K=1, factor=5 / 9, offset=459.67 * 5 / 9),
    "K": BaseUnit(K=1),
    "per cent": BaseUnit(factor=0.01),
    "rev/min": BaseUnit(),  # says nothing: the name counts
    "strange": BaseUnit(),
}
DEFINITIONS = {name: Unit(name=name, baseUnit=base) for name, base in DEFINED.items()} | {"V": Unit(name="V")}
HEADING, SPEED, TORQUE = "pose.heading_rad", "wheel.fl.speed_rad_s", "wheel.fl.torque_n_m"
WARMTH, DUTY, COUNT, VOLTAGE = "wheel.fl.temperature_degc", "wheel.fl.duty", "wheel.fl.count", "battery.voltage_v"


def variable(unit: str | None, relative: bool | None = None, of_type: str | None = None) -> SimpleNamespace:
    declared = SimpleNamespace(unit=of_type, relativeQuantity=False)
    return SimpleNamespace(name="v", unit=unit, relativeQuantity=relative, declaredType=declared)


CASES = [  # signal, unit of the variable, row, and factor and offset, or words that refuse it; words of the notice
    (HEADING, None, {}, (1.0, 0.0), ""),
    (HEADING, "deg", {}, (DEGREE, 0.0), "pose.heading_rad = 0.01745329252 * v, which is in deg"),
    (HEADING, "deg", {"scale": 0.017453}, (0.017453, 0.0), ""),
    (
        HEADING,
        "deg",
        {"scale": 1.0},
        "scale = 1, but 'v' is in deg, and 1 deg is 0.01745329252 rad; leave scale out",
        "",
    ),
    (HEADING, "deg", {"scale": 57.3}, "scale = 57.3, but 'v' is in deg", ""),
    (HEADING, "deg", {"scale": 57.3, "unit": ""}, (57.3, 0.0), ""),
    (HEADING, "deg", {"unit": "rad"}, (1.0, 0.0), ""),
    (HEADING, "deg", {"offset": 0.5}, (DEGREE, 0.5), "0.01745329252 * v + 0.5"),
    (HEADING, "gon", {}, (math.pi / 200, 0.0), "which is in gon"),
    (HEADING, None, {"unit": "grades"}, (math.pi / 200, 0.0), "which is in grades"),
    (
        HEADING,
        None,
        {"unit": "degrre"},
        "unit = 'degrre' is no unit that is known; expected one such as deg, rev/min or N.cm",
        "",
    ),
    (HEADING, "m", {}, "'v' is in m; expected a unit of the dimension of rad", ""),
    (HEADING, "strange", {}, (1.0, 0.0), "v is in 'strange', which is no unit that is known: it is taken for 1 rad"),
    (HEADING, "9^9^9^9", {}, (1.0, 0.0), "no unit that is known"),
    (SPEED, "rev/min", {}, (math.tau / 60, 0.0), "which is in rev/min"),
    (SPEED, "rad/s", {}, (1.0, 0.0), ""),
    (SPEED, "rpm", {}, (math.tau / 60, 0.0), "which is in rpm"),
    (SPEED, "rad.s-1", {}, (1.0, 0.0), ""),
    (SPEED, "Hz", {}, "'v' is in Hz; expected a unit of the dimension of rad/s", ""),
    (SPEED, "1/min", {}, "'v' is in 1/min", ""),
    (SPEED, "Hz", {"unit": "turn/s"}, (math.tau, 0.0), "which is in turn/s"),
    (TORQUE, "N.cm", {}, (0.01, 0.0), "which is in N.cm"),
    (TORQUE, "N.cm", {"scale": 0.01}, (0.01, 0.0), ""),
    (TORQUE, "kgf.cm", {}, (0.0980665, 0.0), "which is in kgf.cm"),
    (TORQUE, "N", {}, "'v' is in N; expected a unit of the dimension of N·m", ""),
    (WARMTH, "K", {}, (1.0, -273.15), "wheel.fl.temperature_degc = 1 * v + -273.15, which is in K"),
    (WARMTH, "K", {"offset": -273.15}, (1.0, -273.15), ""),
    (
        WARMTH,
        "K",
        {"offset": 3.0},
        "offset = 3, but 'v' is in K, and 0 K is -273.15 °C; leave offset out, or write "
        "unit = '' to have no unit compared",
        "",
    ),
    (WARMTH, "degC", {}, (1.0, 0.0), ""),
    (WARMTH, "degF", {}, (5 / 9, -160 / 9), "which is in degF"),
    (DUTY, "per cent", {}, (0.01, 0.0), "which is in per cent"),
    (DUTY, "%", {}, (0.01, 0.0), "which is in %"),
    (DUTY, "1", {}, (1.0, 0.0), ""),
    (DUTY, "dB", {}, (1.0, 0.0), "no unit that is known"),
    (COUNT, "deg", {}, "'v' is in deg; expected a unit of the dimension of 1", ""),
    (COUNT, "1", {"scale": 4.0}, "scale = 4, but 'v' is in 1", ""),
    (VOLTAGE, "V", {}, (1.0, 0.0), ""),
    (VOLTAGE, "mV", {}, (1e-3, 0.0), "which is in mV"),
    (VOLTAGE, "\x1b[2JV", {}, (1.0, 0.0), "v is in '[2JV'"),
]


@pytest.mark.parametrize(("signal", "unit", "row", "expected", "words"), CASES)
def test_a_unit_is_compared_with_the_signals(
    signal: str, unit: str | None, row: dict[str, object], expected: tuple[float, float] | str, words: str
) -> None:
    for of in (variable(unit), variable(None, of_type=unit)):
        if isinstance(expected, str):
            with pytest.raises(BadInputError) as caught:
                conversion(signal, Row("v", **row), of, DEFINITIONS)  # type: ignore[arg-type]
            assert expected in str(caught.value)
            continue
        factor, offset, notice = conversion(signal, Row("v", **row), of, DEFINITIONS)  # type: ignore[arg-type]
        assert (factor, offset) == pytest.approx(expected, rel=1e-12, abs=1e-9)
        assert words in notice
        assert bool(words) == bool(notice)


@pytest.mark.parametrize("relative", [True, False])
def test_a_difference_of_temperatures_is_no_temperature(relative: bool) -> None:
    of = variable("K", relative)
    if relative:
        with pytest.raises(BadInputError, match=r"'v' is a difference \(relativeQuantity\)"):
            conversion(WARMTH, Row("v"), of, DEFINITIONS)
    else:
        assert conversion(WARMTH, Row("v"), of, DEFINITIONS).offset == -273.15


REGISTRY = pint.UnitRegistry(cache_folder=None)
BASES = ("kilogram", "meter", "second", "kelvin", "radian")


@given(
    value=st.floats(-1e6, 1e6),
    case=st.sampled_from(
        [
            *((HEADING, unit, "rad") for unit in ("deg", "gon", "turn", "mrad", "arcmin")),
            *((TORQUE, unit, "N*m") for unit in ("kN*mm", "lbf*ft", "N*cm", "J")),
            *((WARMTH, unit, "degC") for unit in ("degF", "K", "degR")),
            *((SPEED, unit, "rad/s") for unit in ("rpm", "deg/s", "turn/hour")),
            *(("twist.vx_m_s", unit, "m/s") for unit in ("km/h", "mph", "mm/ms", "knot")),
        ]
    ),
)
def test_fmis_own_numbers_and_a_name_convert_as_pint_does(value: float, case: tuple[str, str, str]) -> None:
    signal, unit, here = case
    one, zero = (REGISTRY.Quantity(x, unit).to_base_units() for x in (1.0, 0.0))
    powers = {n: dict(one.unit_items()).get(w, 0) for n, w in zip(("kg", "m", "s", "K", "rad"), BASES, strict=True)}
    base = BaseUnit(**{n: int(p) for n, p in powers.items()}, factor=one.m - zero.m, offset=zero.m)
    expected = REGISTRY.Quantity(value, unit).to(here).magnitude
    for definitions in ({}, {unit: Unit(name=unit, baseUnit=base)}):
        factor, offset, _ = conversion(signal, Row("v"), variable(unit), definitions)
        assert factor * value + offset == pytest.approx(expected, rel=1e-9, abs=1e-6)


def in_units(version: int) -> list[Var]:
    """Return the variables of the foreign robot with the units that they have."""
    units = {"tau": {"unit": "N.cm"}, "phi": {"unit": "deg"}, "psi": {"unit": "deg"}, "x": {"unit": "m"}}
    variables = variables2() if version == 2 else variables3()
    return [v._replace(more={**v.more, **units.get(v.name.rstrip("[]1234"), {})}) for v in variables]


def definitions(*names: str) -> str:
    root = ET.Element("UnitDefinitions")
    for name in names:
        base = DEFINED[name]
        powers = {key: str(getattr(base, key)) for key in ("kg", "m", "s", "rad", "factor")}
        ET.SubElement(ET.SubElement(root, "Unit", name=name), "BaseUnit", powers)
    return ET.tostring(root, encoding="unicode")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("more", ["", definitions("N.cm", "deg", "m")])
def test_a_map_without_scales_is_the_map_with_them(version: int, more: str, tmp_path: Path) -> None:
    fmu = foreign_fmu(tmp_path, version, variables=in_units(version), more=more)
    scaled = foreign_map(version)
    plain = replace(scaled, rows={signal: row._replace(scale=None) for signal, row in scaled.rows.items()})
    wrong = replace(scaled, rows=dict(scaled.rows) | {HEADING: Row("psi", scale=1.0)})
    with FmuPlant(fmu, {}, plain) as one, FmuPlant(fmu, {}, scaled) as other:
        for torque in np.random.default_rng(4).uniform(-0.5, 0.5, (50, 4)):
            one.step(Wheels(*torque))
            other.step(Wheels(*torque))
            assert one.truth().pose == pytest.approx(other.truth().pose, rel=1e-9)
        assert sum("which is in deg" in notice for notice in one.notices) == 5
        assert sum("which is in N.cm" in notice for notice in one.notices) == 4
        assert other.notices == ()
    with pytest.raises(BadInputError, match=r'plant\.map\."pose\.heading_rad": scale = 1, but \'psi\' is in deg'):
        FmuPlant(fmu, {}, wrong)


@pytest.mark.parametrize(("unit", "is_refused"), [("kg.m2", False), ("g.cm2", True), ("kg", True), ("foo", False)])
def test_a_value_of_the_robot_in_another_unit_is_refused(unit: str, is_refused: bool, tmp_path: Path) -> None:
    name = "wheel_inertia_kg_m2"
    variables = [v._replace(name=name, more={**v.more, "unit": unit}) if v.name == "J" else v for v in variables2()]
    changes = {"plant.fmu": foreign_fmu(tmp_path, 2, variables=variables)}
    if is_refused:
        words = rf"plant\.start\.{name}: this parameter of wheels2\.fmu is in {unit}, not in kg·m²"
        with pytest.raises(BadInputError, match=words):
            check_plant_start(load("circle_speed", set=changes))
    check_plant_start(load("circle_speed", set=changes | {f"plant.start.{name}": 20.0}))


def test_an_fmu_that_defines_its_units_needs_no_pint() -> None:
    code = (
        "import sys, hil\n"
        "assert hil.run('paper_circle', set={'loop.duration_s': 0.1, 'expect': []}).failure is None\n"
        "assert 'fmpy' in sys.modules and 'pint' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], env=environment(), cwd=ROOT, check=True)
