"""Makes what follows from variables.toml: modelDescription.xml, the C header, the tables of the documents.

``python -m plant_fmu.generate`` writes the files; ``--check`` writes nothing and exits 1 naming a stale
one. Needs the standard library only.
"""

import argparse
import hashlib
import html
import math
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

from plant_fmu.variables import HERE, STRUCTURE, Definition, DefinitionError, Variable, read

SOURCE_FILES = ("fmi2.c", "instance.c", "mecanum.c", "mecanum_physics.c")
BEGIN, END = "<!-- variables: begin -->", "<!-- variables: end -->"

_INITIAL = {"input": None, "output": "calculated", "parameter": "exact"}  # FMI 2.0 section 2.2.7
_INT32 = (-(2**31), 2**31 - 1)


def guid(definition: Definition) -> str:
    """Return the GUID that ties the XML to the C table: a hash of the XML without it (FMI 2.0 2.2.1)."""
    digest = hashlib.sha256(_xml(definition, "").encode()).hexdigest()
    return f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"


def model_description(definition: Definition) -> str:
    """Return modelDescription.xml for FMI 2.0 co-simulation."""
    return _xml(definition, guid(definition))


def _xml(definition: Definition, guid_text: str) -> str:
    model = definition.model
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model["name"],
        guid=guid_text,
        description=model["description"],
        author=model["author"],
        license=model["license"],
        version=model["version"],
        generationTool="plant_fmu/generate.py",
        variableNamingConvention="structured",
    )
    slave = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model["name"],
        canHandleVariableCommunicationStepSize="true",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    if sources := model.get("sources", SOURCE_FILES):
        files = ET.SubElement(slave, "SourceFiles")
        for file in sources:
            ET.SubElement(files, "File", name=file)
    units = ET.SubElement(root, "UnitDefinitions")
    for name, exponents in definition.units.items():
        unit = ET.SubElement(units, "Unit", name=name)
        ET.SubElement(unit, "BaseUnit", {base: str(power) for base, power in exponents.items()})
    types = ET.SubElement(root, "TypeDefinitions")
    for name, enumeration in definition.enumerations.items():
        simple = ET.SubElement(types, "SimpleType", name=name, description=enumeration["description"])
        items = ET.SubElement(simple, "Enumeration")
        for value, item in enumerate(enumeration["items"], start=1):
            ET.SubElement(items, "Item", name=item["name"], value=str(value), description=item["description"])
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="Why a call returned fmi2Error")
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr(model["stop_s"]),
        stepSize=repr(model["step_s"]),
    )
    _add_variables(root, definition)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _add_variables(root: ET.Element, definition: Definition) -> None:
    scalars = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(definition.variables):
        attributes = {
            "name": variable.name,
            "valueReference": str(reference),
            "causality": variable.causality,
            "variability": variable.variability,
            "initial": _INITIAL[variable.causality],
            "description": variable.description,
        }
        scalar = ET.SubElement(scalars, "ScalarVariable", _present(attributes))
        enumeration = variable.type == "Enumeration"
        values: dict[str, str | None] = {
            "declaredType": variable.name if enumeration else None,
            "unit": variable.unit,
            "min": None if enumeration or variable.minimum is None else repr(variable.minimum),
            "max": None if enumeration or variable.maximum is None else repr(variable.maximum),
            "start": None if variable.start is None else repr(variable.start),
        }
        ET.SubElement(scalar, variable.type, _present(values))
    structure = ET.SubElement(root, "ModelStructure")
    index = {variable.name: str(place) for place, variable in enumerate(definition.variables, start=1)}
    outputs = [variable for variable in definition.variables if variable.causality == "output"]
    parts = ET.SubElement(structure, "Outputs")
    for variable in outputs:
        # An output without depends_on follows from the states alone: it has no direct feedthrough.
        feedthrough = " ".join(index[name] for name in variable.depends_on)
        ET.SubElement(parts, "Unknown", index=index[variable.name], dependencies=feedthrough)
    parts = ET.SubElement(structure, "InitialUnknowns")
    for variable in outputs:
        ET.SubElement(parts, "Unknown", index=index[variable.name])


def _present(attributes: dict[str, str | None]) -> dict[str, str]:
    return {key: value for key, value in attributes.items() if value is not None}


def c_header(definition: Definition) -> str:
    """Return mecanum_variables.h: the structures and the table by value reference."""
    lines = [
        "/* Made from variables.toml by generate.py; do not edit. */",
        "#ifndef MECANUM_VARIABLES_H",
        "#define MECANUM_VARIABLES_H",
        "",
        "#include <math.h>",
        "#include <stdint.h>",
        "",
        f'#define MECANUM_MODEL_NAME "{definition.model["name"]}"',
        f'#define MECANUM_GUID "{guid(definition)}"',
        f"#define MECANUM_WHEELS {len(definition.wheels)}",
        f"#define MECANUM_VARIABLE_COUNT {len(definition.variables)}",
        "",
        "enum {",
    ]
    for name, enumeration in definition.enumerations.items():
        for value, item in enumerate(enumeration["items"], start=1):
            lines.append(f"    MECANUM_{name.upper()}_{item['name'].upper()} = {value},")
    lines += ["};", ""]
    for causality, structure in STRUCTURE.items():
        lines.append("typedef struct {")
        for variable in definition.variables:
            if variable.causality == causality and not variable.wheel:
                kind = "double" if variable.type == "Real" else "int32_t"
                size = "" if variable.wheel is None else "[MECANUM_WHEELS]"
                lines.append(f"    {kind} {variable.field}{size};")
        lines += [f"}} mecanum_{structure};", ""]
    rows = [f"    X({reference}, {_c_row(v)})" for reference, v in enumerate(definition.variables)]
    lines += [
        "/* X(value reference, type, causality, member of the snapshot, start, min, max, name) */",
        "/* clang-format off */",
        "#define MECANUM_VARIABLES(X) \\",
        " \\\n".join(rows),
        "/* clang-format on */",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _c_row(v: Variable) -> str:
    numbers = f"{_c_number(v, v.start, 0)}, {_c_number(v, v.minimum, -1)}, {_c_number(v, v.maximum, 1)}"
    causality = "TUNABLE" if v.variability == "tunable" else v.causality.upper()
    return f'{_C_TYPE[v.type]}, {causality}, {v.member}, {numbers}, "{v.name}"'


_C_TYPE = {"Real": "REAL", "Integer": "INTEGER", "Enumeration": "INTEGER"}


def _c_number(variable: Variable, value: float | int | None, side: int) -> str:
    """Return a limit or a start value as a C double; without one, the type's own limit on that side, or 0."""
    if value is None and side and variable.type == "Real":
        value = side * math.inf
    elif value is None:
        value = _INT32[0] if side < 0 else _INT32[1] if side > 0 else 0
    if math.isinf(value):
        return "-INFINITY" if value < 0 else "INFINITY"
    return repr(float(value))


def markdown_table(definition: Definition) -> str:
    """Return the table of the README."""
    lines = ["| variable | causality | unit | start | range | meaning |", "|---|---|---|---|---|---|"]
    lines += ["| " + " | ".join([f"`{row[0]}`", *row[1:]]) + " |" for row in _rows(definition)]
    return "\n".join(lines)


def html_table(definition: Definition) -> str:
    """Return the table of documentation/index.html."""
    heads = ("variable", "causality", "unit", "start", "range", "meaning")
    lines = ["<table>", "<tr>" + "".join(f"<th>{head}</th>" for head in heads) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in _rows(definition)]
    return "\n".join([*lines, "</table>"])


def _rows(definition: Definition) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for variable in definition.variables:
        limits = f"{variable.minimum:g} to {variable.maximum:g}" if variable.minimum is not None else ""
        start = "" if variable.start is None else f"{variable.start:g}"
        rows.append((variable.name, variable.causality, variable.unit or "", start, limits, variable.description))
    return rows


def _between_marks(path: Path, table: str) -> str:
    text = path.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise DefinitionError(f"{path.name}: the marks {BEGIN} and {END} are missing")
    head, rest = text.split(BEGIN, 1)
    return f"{head}{BEGIN}\n{table}\n{END}{rest.split(END, 1)[1]}"


def render(definition: Definition) -> dict[Path, str]:
    """Return every file that follows from the definition, with its content."""
    documents: dict[str, Callable[[Definition], str]] = {
        "README.md": markdown_table,
        "documentation/index.html": html_table,
    }
    return {
        HERE / "generated" / "modelDescription.xml": model_description(definition),
        HERE / "generated" / "mecanum_variables.h": c_header(definition),
        **{HERE / name: _between_marks(HERE / name, table(definition)) for name, table in documents.items()},
    }


def stale(definition: Definition | None = None) -> list[Path]:
    """Return the files that differ from what variables.toml gives."""
    made = render(definition or read())
    return [path for path, text in made.items() if not path.exists() or path.read_text("utf-8") != text]


def main() -> None:
    """Write the files, or with ``--check`` name the stale ones and exit 1."""
    parser = argparse.ArgumentParser(prog="plant_fmu.generate", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when a file is stale")
    check = parser.parse_args().check
    try:
        definition = read()
        for path in stale(definition):
            if check:
                sys.exit(f"{path.name} is stale; run python -m plant_fmu.generate")
            path.parent.mkdir(exist_ok=True)
            path.write_text(render(definition)[path], encoding="utf-8", newline="\n")
            print(path)
    except DefinitionError as error:
        sys.exit(f"variables.toml: {error}")


if __name__ == "__main__":
    main()
