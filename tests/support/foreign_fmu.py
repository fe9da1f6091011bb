"""Makes the foreign FMUs of the tests: the C of tests/support/fmus with a description written here."""

import functools
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import fmpy

from firmware_protocol.built import SUFFIX
from hil.core.types import WHEEL_NAMES
from hil.plant.mapping import Row, SignalMap
from tools.build.compiler import compile_shared

SOURCES = Path(__file__).with_name("fmus")
DEGREE = 0.017453292519943295
FAULTS = (
    "none",
    "say_error",
    "silent_error",
    "say_discard",
    "say_fatal",
    "give_nan",
    "end",
    "return_early",
    "reach_elsewhere",
    "say_warning",
    "return_pending",
    "fail_at_initialization",
    "fail_to_reset",
    "fail_to_read",
    "ask_for_event_mode",
    "refuse_to_begin",
    "stay_in_configuration",
)


class Var(NamedTuple):
    """A variable of the description; ``more`` are further XML attributes."""

    name: str
    reference: int
    kind: str
    causality: str
    more: Mapping[str, str] = {}
    size: tuple[int | str, ...] = ()  # or the name of the structural parameter that gives it


PARAMETER = {"variability": "fixed", "initial": "exact"}


def _common(integer: str, real: str, enumeration_type: str) -> list[Var]:
    return [
        Var("J", 20, real, "parameter", {**PARAMETER, "start": "0.02", "min": "1e-6"}),
        Var("fault_time", 23, real, "parameter", {**PARAMETER, "start": "1e9"}),
        Var("fault", 34, integer, "parameter", {**PARAMETER, "start": "0"}),
        Var("gear", 35, "Enumeration", "parameter", {**PARAMETER, "start": "1", "declaredType": enumeration_type}),
        Var("reversed", 40, "Boolean", "parameter", {**PARAMETER, "start": "false"}),
        Var("label", 50, "String", "parameter", {**PARAMETER, "start": ""}),
        Var("grain", 25, real, "parameter", {**PARAMETER, "start": "0"}),
        Var("fixed_at", 24, real, "parameter", {"variability": "fixed", "initial": "calculated"}),
    ]


def variables2() -> list[Var]:
    """Return the variables of wheels2.c."""
    return [
        *(Var(f"tau{i + 1}", i, "Real", "input", {"start": "0"}) for i in range(4)),
        *(Var(f"phi[{i + 1}]", 4 + i, "Real", "output") for i in range(4)),
        *(Var(name, 8 + i, "Real", "output") for i, name in enumerate(("x", "y", "psi"))),
        *(Var(f"w{i + 1}", 11 + i, "Real", "local") for i in range(4)),
        *(Var(f"n{i + 1}", 30 + i, "Integer", "output", {"variability": "discrete"}) for i in range(4)),
        *_common("Integer", "Real", "Gear"),
    ]


def variables3(counter: str = "Int32") -> list[Var]:
    """Return the variables of wheels3.c, whose counters are of whatever integer type one asks for."""
    return [
        Var("tau", 0, "Float32", "input", {"start": "0"}, ("wheels",)),
        Var("phi", 4, "Float64", "output", {}, (2, 2)),
        Var("x", 8, "Float64", "output"),
        Var("y", 9, "Float32", "output"),
        Var("psi", 10, "Float64", "output"),
        *(Var(f"w{i + 1}", 11 + i, "Float64", "local") for i in range(4)),
        *(Var(f"n{i + 1}", 30 + i, counter, "output") for i in range(4)),
        Var("wheels", 36, "UInt32", "structuralParameter", {"variability": "fixed", "start": "4"}),
        *_common("Int32", "Float64", "Gear"),
    ]


def description2(variables: list[Var], guid: str, attributes: Mapping[str, str]) -> str:
    """Return modelDescription.xml of FMI 2.0."""
    root = ET.Element("fmiModelDescription", fmiVersion="2.0", modelName="wheels", guid=guid, generationTool="A Tool")
    ET.SubElement(root, "CoSimulation", modelIdentifier="wheels", **attributes)
    types = ET.SubElement(root, "TypeDefinitions")
    _items(ET.SubElement(ET.SubElement(types, "SimpleType", name="Gear"), "Enumeration"))
    _categories(root)
    scalars = ET.SubElement(root, "ModelVariables")
    for v in variables:
        scalar = ET.SubElement(scalars, "ScalarVariable", name=v.name, valueReference=str(v.reference))
        scalar.set("causality", v.causality)
        kind = ET.SubElement(scalar, v.kind)
        for key, value in v.more.items():
            (scalar if key in ("variability", "initial") else kind).set(key, value)
    ET.SubElement(root, "ModelStructure")
    return ET.tostring(root, encoding="unicode")


def description3(variables: list[Var], guid: str, attributes: Mapping[str, str]) -> str:
    """Return modelDescription.xml of FMI 3.0."""
    root = ET.Element("fmiModelDescription", fmiVersion="3.0", modelName="wheels", instantiationToken=guid)
    root.set("generationTool", "A Tool")
    ET.SubElement(root, "CoSimulation", modelIdentifier="wheels", **attributes)
    types = ET.SubElement(root, "TypeDefinitions")
    _items(ET.SubElement(types, "EnumerationType", name="Gear"))
    scalars = ET.SubElement(root, "ModelVariables")
    for v in variables:
        element = ET.SubElement(scalars, v.kind, name=v.name, valueReference=str(v.reference), causality=v.causality)
        for extent in v.size:
            sized_by = [str(other.reference) for other in variables if other.name == extent]
            ET.SubElement(element, "Dimension", {"valueReference": sized_by[0]} if sized_by else {"start": str(extent)})
        for key, value in v.more.items():
            if v.kind == "String" and key == "start":
                ET.SubElement(element, "Start", value=value)
            else:
                element.set(key, value)
    ET.SubElement(root, "ModelStructure")
    return ET.tostring(root, encoding="unicode")


def _items(enumeration: ET.Element) -> None:
    for name, value in (("direct", "1"), ("geared", "3")):
        ET.SubElement(enumeration, "Item", name=name, value=value)


def _categories(root: ET.Element) -> None:
    categories = ET.SubElement(root, "LogCategories")
    for name in ("logEvents", "logStatusError"):
        ET.SubElement(categories, "Category", name=name)


@functools.cache
def _library(version: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / f"wheels{SUFFIX}"
        compile_shared([SOURCES / f"wheels{version}.c"], library, include=[SOURCES])
        return library.read_bytes()


def foreign_fmu(
    folder: Path,
    version: int,
    variables: list[Var] | None = None,
    guid: str = "{wheels}",
    library: bytes | None = None,
    more: str = "",
    **attributes: str,
) -> Path:
    """Write an FMU of the foreign robot; ``attributes`` are those of its CoSimulation in the XML, ``more`` are further
    elements of its description."""
    describe, default = (description2, variables2) if version == 2 else (description3, variables3)
    place = fmpy.platform if version == 2 else fmpy.platform_tuple
    path = folder / f"wheels{version}.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        description = describe(default() if variables is None else variables, guid, attributes)
        archive.writestr("modelDescription.xml", description.replace("<ModelVariables>", f"{more}<ModelVariables>"))
        archive.writestr(f"binaries/{place}/wheels{SUFFIX}", _library(version) if library is None else library)
    return path


def foreign_map(version: int, **rows: Row | None) -> SignalMap:
    """Return the map of the foreign robot: its wheels 1, 2, 3, 4 are FL, FR, RL, RR, and its second turns in reverse.
    ``rows`` replace or, where None, remove rows: ``wheel_fl_count=None``."""
    number = {"fl": 1, "fr": 2, "rl": 3, "rr": 4}
    all_rows: dict[str, Row | None] = {}
    for wheel in WHEEL_NAMES:
        i, sign = number[wheel], -1 if wheel == "fr" else 1
        torque = f"tau{i}" if version == 2 else f"tau[{i}]"
        angle = f"phi[{i}]" if version == 2 else f"phi[{(i + 1) // 2},{(i + 1) % 2 + 1}]"
        all_rows[f"wheel.{wheel}.torque_n_m"] = Row(torque, scale=0.01, sign=sign)
        all_rows[f"wheel.{wheel}.angle_rad"] = Row(angle, scale=DEGREE, sign=sign)
    all_rows |= {"pose.x_m": Row("x"), "pose.y_m": Row("y"), "pose.heading_rad": Row("psi", scale=DEGREE)}
    for name, row in rows.items():
        signal, _, quantity = name.partition("__")
        all_rows[f"{signal.replace('_', '.')}.{quantity}"] = row
    kept = {signal: row for signal, row in all_rows.items() if row is not None}
    return SignalMap(kept, counts_per_revolution=1000, torque_constant_n_m_a=0.5)
