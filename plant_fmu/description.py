"""Makes modelDescription.xml for FMI 2.0 and 3.0 co-simulation, and terminalsAndIcons.xml for FMI 3.0."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable

from plant_fmu.variables import HERE, Definition, Variable

LICENSE = HERE / "documentation" / "licenses" / "license.txt"
LOG_CATEGORIES = (
    {"name": "logStatusError", "description": "Why a call returned an error"},
    {"name": "logStatusDiscard", "description": "Why a call was discarded, which left the instance as it was"},
)
_INITIAL = {"output": "calculated", "parameter": "exact"}  # FMI 2.0 section 2.2.7, FMI 3.0 section 2.4.7
_FMI3_TYPE = {"Real": "Float64", "Integer": "Int32", "Enumeration": "Enumeration"}


def model_description(definition: Definition, fmi: int, guid: str, sources: Iterable[str] = ()) -> str:
    """Return modelDescription.xml of one FMI version (2 or 3): FMI 2.0 section 2.2, FMI 3.0 section 2.4.

    ``guid`` is the GUID of FMI 2.0, or the instantiation token of FMI 3.0. ``sources`` are the C files to compile,
    which FMI 3.0 lists elsewhere.
    """
    model = definition.model
    token = {"guid": guid} if fmi == 2 else {"instantiationToken": guid}
    root = ET.Element("fmiModelDescription", {"fmiVersion": f"{fmi}.0", **token, **_model_attributes(definition)})
    state = "FMUstate" if fmi == 2 else "FMUState"
    claims = {
        "modelIdentifier": model["name"],
        "canHandleVariableCommunicationStepSize": "true",
        **(
            {"canNotUseMemoryManagementFunctions": "true"}
            if fmi == 2
            else {"fixedInternalStepSize": repr(_longest_step_s(definition))}
        ),
        f"canGetAndSet{state}": "true",
        f"canSerialize{state}": "true",
    }
    interface = ET.SubElement(root, "CoSimulation", claims)
    if names := list(sources):
        files = ET.SubElement(interface, "SourceFiles")
        for name in names:
            ET.SubElement(files, "File", name=name)
    _add_units(root, definition)
    types = ET.SubElement(root, "TypeDefinitions")
    for name, enumeration in definition.enumerations.items():
        tag = "SimpleType" if fmi == 2 else "EnumerationType"
        kind = ET.SubElement(types, tag, name=name, description=enumeration["description"])
        kind = ET.SubElement(kind, "Enumeration") if fmi == 2 else kind
        for value, item in enumerate(enumeration["items"], start=1):
            ET.SubElement(kind, "Item", name=item["name"], value=str(value), description=item["description"])
    categories = ET.SubElement(root, "LogCategories")
    for category in LOG_CATEGORIES:
        ET.SubElement(categories, "Category", category)
    times = {"startTime": "0.0", "stopTime": repr(model["stop_s"]), "stepSize": repr(model["step_s"])}
    ET.SubElement(root, "DefaultExperiment", times)
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(definition.variables):
        attributes, values = _variable_attributes(variable, reference), _value_attributes(variable)
        if fmi == 2:
            ET.SubElement(ET.SubElement(variables, "ScalarVariable", attributes), variable.type, values)
        else:
            ET.SubElement(variables, _FMI3_TYPE[variable.type], attributes | values)
    _add_structure(ET.SubElement(root, "ModelStructure"), definition, fmi)
    return text_of(root)


def terminals(definition: Definition) -> str:
    """Return terminalsAndIcons.xml: a terminal for each wheel with its inputs and outputs.

    FMI 3.0 section "Definition of Terminals"; names follow its suggestion, variable = terminal.member. The rule "bus"
    connects only members that both sides have: a motor model needs only torque and speed.
    """
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    parts = ET.SubElement(root, "Terminals")
    for wheel, words in definition.wheels.items():
        attributes = {
            "name": f"wheel.{wheel}",
            "matchingRule": "bus",
            "terminalKind": "_mecanum_hil_wheel",  # the standard's form of a custom kind
            "description": f"Drive, encoder and contact of the {words} wheel",
        }
        terminal = ET.SubElement(parts, "Terminal", attributes)
        for variable in definition.variables:
            member = variable.name.removeprefix(f"wheel.{wheel}.")
            if variable.wheel is not None and variable.causality != "parameter" and member != variable.name:
                names = {"variableName": variable.name, "memberName": member}
                ET.SubElement(terminal, "TerminalMemberVariable", names, variableKind="signal")
    return text_of(root)


def text_of(root: ET.Element) -> str:
    """Return a document, indented."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _model_attributes(definition: Definition) -> dict[str, str]:
    model = definition.model
    return {
        "modelName": model["name"],
        "description": model["description"],
        "author": model["author"],
        "version": model["version"],
        "copyright": next(line for line in LICENSE.read_text("utf-8").splitlines() if line.startswith("Copyright")),
        "license": model["license"],
        "generationTool": "plant_fmu/generate.py",
        "variableNamingConvention": "structured",
    }


def _longest_step_s(definition: Definition) -> float:
    """Return the length of internal steps [s] with default values, if the communication step is a multiple of it."""
    return next(float(v.start or 0.0) for v in definition.variables if v.name == "longest_step_s")


def _add_units(root: ET.Element, definition: Definition) -> None:
    """Add UnitDefinitions: every unit as exponents of the SI base units, with the factor 1, and its display units."""
    units = ET.SubElement(root, "UnitDefinitions")
    for name, exponents in definition.units.items():
        unit = ET.SubElement(units, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", {base: str(power) for base, power in exponents.items()})
        for shown, factor in definition.display_units.get(name, {}).items():
            ET.SubElement(unit, "DisplayUnit", name=shown, factor=repr(factor))


def _variable_attributes(variable: Variable, reference: int) -> dict[str, str]:
    """Return the attributes that a variable of any type has in both versions."""
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.causality in _INITIAL:
        attributes["initial"] = _INITIAL[variable.causality]
    return attributes


def _value_attributes(variable: Variable) -> dict[str, str]:
    """Return the attributes of a variable's type: unit, range, start value. An enumeration's range is its items."""
    if variable.type == "Enumeration":
        return {"declaredType": variable.name, "start": str(variable.start)}
    values = {
        "unit": variable.unit,
        "displayUnit": variable.display_unit,
        "min": variable.minimum,
        "max": variable.maximum,
        "start": variable.start,
    }
    return {name: str(value) for name, value in values.items() if value is not None}


def _add_structure(structure: ET.Element, definition: Definition, fmi: int) -> None:
    """Add the outputs, then all initial unknowns, each with the variables that it depends on.

    FMI 2.0 section 2.2.8, where indices count the variables from 1; FMI 3.0 section 2.4.8, by value reference. At a
    communication point an output without dependencies follows from the states alone: it has no direct feedthrough.
    Initially the states may depend on any parameter. The other inputs are not listed, so that importers see no false
    algebraic loop.
    """
    parameters = tuple(variable.name for variable in definition.variables if variable.causality == "parameter")
    index = {name: str(reference + (fmi == 2)) for name, reference in definition.references.items()}
    for tag, initially in (("Output", ()), ("InitialUnknown", parameters)):
        parent = ET.SubElement(structure, f"{tag}s") if fmi == 2 else structure
        for variable in definition.variables:
            if variable.causality == "output":
                listed = " ".join(index[name] for name in (*variable.depends_on, *initially))
                unknown = {("index" if fmi == 2 else "valueReference"): index[variable.name], "dependencies": listed}
                ET.SubElement(parent, "Unknown" if fmi == 2 else tag, unknown)
