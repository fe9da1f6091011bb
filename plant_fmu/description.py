"""The common parts of the model descriptions of FMI 2.0 and 3.0: model attributes, units, dependencies, XML text."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

from plant_fmu.variables import HERE, Definition, Variable

LICENSE = HERE / "documentation" / "licenses" / "license.txt"
LOG_CATEGORIES = (
    {"name": "logStatusError", "description": "Why a call returned an error"},
    {"name": "logStatusDiscard", "description": "Why a call was discarded, which left the instance as it was"},
)
_INITIAL = {"output": "calculated", "parameter": "exact"}  # FMI 2.0 section 2.2.7, FMI 3.0 section 2.4.7


def model_attributes(definition: Definition) -> dict[str, str]:
    """Return the attributes of the root element that both versions have."""
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


def default_experiment(definition: Definition) -> dict[str, str]:
    """Return the attributes of DefaultExperiment."""
    model = definition.model
    return {"startTime": "0.0", "stopTime": repr(model["stop_s"]), "stepSize": repr(model["step_s"])}


def add_units(root: ET.Element, definition: Definition) -> None:
    """Add UnitDefinitions: every unit as exponents of the SI base units, with the factor 1, and its display units."""
    units = ET.SubElement(root, "UnitDefinitions")
    for name, exponents in definition.units.items():
        unit = ET.SubElement(units, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", {base: str(power) for base, power in exponents.items()})
        for shown, factor in definition.display_units.get(name, {}).items():
            ET.SubElement(unit, "DisplayUnit", name=shown, factor=repr(factor))


def add_log_categories(root: ET.Element) -> None:
    """Add LogCategories."""
    categories = ET.SubElement(root, "LogCategories")
    for category in LOG_CATEGORIES:
        ET.SubElement(categories, "Category", category)


def add_items(element: ET.Element, definition: Definition, name: str) -> None:
    """Add the items of an enumeration, numbered from 1."""
    for value, item in enumerate(definition.enumerations[name]["items"], start=1):
        ET.SubElement(element, "Item", name=item["name"], value=str(value), description=item["description"])


def variable_attributes(variable: Variable, reference: int) -> dict[str, str]:
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


def value_attributes(variable: Variable) -> dict[str, str]:
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


def outputs(definition: Definition) -> Iterator[tuple[Variable, tuple[str, ...], tuple[str, ...]]]:
    """Yield each output with the variables it depends on: at a communication point, and in initialization mode.

    At a communication point an output without dependencies follows from the states alone: it has no direct feedthrough.
    Initially the states may depend on any parameter. The other inputs are not listed, so that importers do not see an
    algebraic loop where there is none.
    """
    parameters = tuple(variable.name for variable in definition.variables if variable.causality == "parameter")
    for variable in definition.variables:
        if variable.causality == "output":
            yield variable, variable.depends_on, (*variable.depends_on, *parameters)


def text_of(root: ET.Element) -> str:
    """Return a document, indented."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
