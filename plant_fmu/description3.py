"""Makes modelDescription.xml and terminalsAndIcons.xml for FMI 3.0 co-simulation."""

import xml.etree.ElementTree as ET

from plant_fmu import description
from plant_fmu.variables import Definition

_TYPE = {"Real": "Float64", "Integer": "Int32", "Enumeration": "Enumeration"}


def model_description(definition: Definition, token: str) -> str:
    """Return modelDescription.xml: FMI 3.0 section 2.4; ``token`` is the instantiation token."""
    attributes = {"fmiVersion": "3.0", "instantiationToken": token, **description.model_attributes(definition)}
    root = ET.Element("fmiModelDescription", attributes)
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=definition.model["name"],
        canHandleVariableCommunicationStepSize="true",
        fixedInternalStepSize=repr(longest_step_s(definition)),
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
    )
    description.add_units(root, definition)
    types = ET.SubElement(root, "TypeDefinitions")
    for name, enumeration in definition.enumerations.items():
        kind = ET.SubElement(types, "EnumerationType", name=name, description=enumeration["description"])
        description.add_items(kind, definition, name)
    description.add_log_categories(root)
    ET.SubElement(root, "DefaultExperiment", description.default_experiment(definition))
    variables = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(definition.variables):
        attributes = description.variable_attributes(variable, reference) | description.value_attributes(variable)
        ET.SubElement(variables, _TYPE[variable.type], attributes)
    _add_structure(root, definition)
    return description.text_of(root)


def longest_step_s(definition: Definition) -> float:
    """Return the length of internal steps [s] with default values, if the communication step is a multiple of it."""
    return next(float(v.start or 0.0) for v in definition.variables if v.name == "longest_step_s")


def _add_structure(root: ET.Element, definition: Definition) -> None:
    """Add ModelStructure, section 2.4.8: all outputs, then all initial unknowns, by value reference."""
    structure = ET.SubElement(root, "ModelStructure")
    references = {name: str(reference) for name, reference in definition.references.items()}
    for initially, tag in enumerate(("Output", "InitialUnknown")):
        for variable, *dependencies in description.outputs(definition):
            listed = " ".join(references[name] for name in dependencies[initially])
            ET.SubElement(structure, tag, valueReference=references[variable.name], dependencies=listed)


def terminals(definition: Definition) -> str:
    """Return terminalsAndIcons.xml: a terminal for each wheel with its inputs and outputs.

    FMI 3.0 section "Definition of Terminals"; names follow its suggestion, variable = terminal.member. The rule "bus"
    connects only members that both sides have: a motor model needs only torque and speed.
    """
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    parts = ET.SubElement(root, "Terminals")
    for wheel, words in definition.wheels.items():
        name = f"wheel.{wheel}"
        terminal = ET.SubElement(
            parts,
            "Terminal",
            name=name,
            matchingRule="bus",
            terminalKind="_mecanum_hil_wheel",  # the standard's form of a custom kind
            description=f"Drive, encoder and contact of the {words} wheel",
        )
        for variable in definition.variables:
            if (
                variable.wheel is not None
                and variable.causality != "parameter"
                and variable.name.startswith(f"{name}.")
            ):
                ET.SubElement(
                    terminal,
                    "TerminalMemberVariable",
                    variableName=variable.name,
                    memberName=variable.name.removeprefix(f"{name}."),
                    variableKind="signal",
                )
    return description.text_of(root)
