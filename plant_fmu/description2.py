"""Makes modelDescription.xml for FMI 2.0 co-simulation."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable

from plant_fmu import description
from plant_fmu.variables import Definition


def model_description(definition: Definition, guid: str, sources: Iterable[str]) -> str:
    """Return the document: FMI 2.0 section 2.2; ``sources`` are the C files to compile."""
    attributes = {"fmiVersion": "2.0", "guid": guid, **description.model_attributes(definition)}
    root = ET.Element("fmiModelDescription", attributes)
    slave = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=definition.model["name"],
        canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    if names := list(sources):
        files = ET.SubElement(slave, "SourceFiles")
        for name in names:
            ET.SubElement(files, "File", name=name)
    description.add_units(root, definition)
    types = ET.SubElement(root, "TypeDefinitions")
    for name, enumeration in definition.enumerations.items():
        simple = ET.SubElement(types, "SimpleType", name=name, description=enumeration["description"])
        description.add_items(ET.SubElement(simple, "Enumeration"), definition, name)
    description.add_log_categories(root)
    ET.SubElement(root, "DefaultExperiment", description.default_experiment(definition))
    scalars = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(definition.variables):
        scalar = ET.SubElement(scalars, "ScalarVariable", description.variable_attributes(variable, reference))
        ET.SubElement(scalar, variable.type, description.value_attributes(variable))
    _add_structure(root, definition)
    return description.text_of(root)


def _add_structure(root: ET.Element, definition: Definition) -> None:
    """Add ModelStructure, section 2.2.8; indices count the variables from 1."""
    structure = ET.SubElement(root, "ModelStructure")
    now, initially = (ET.SubElement(structure, name) for name in ("Outputs", "InitialUnknowns"))
    index = {name: str(reference + 1) for name, reference in definition.references.items()}
    for variable, *dependencies in description.outputs(definition):
        for part, names in zip((now, initially), dependencies, strict=True):
            listed = " ".join(index[name] for name in names)
            ET.SubElement(part, "Unknown", index=index[variable.name], dependencies=listed)
