"""Generates fmi-ls-manifest.xml, which describes the files beside it in an FMU: inputs and reference results.

The layered standard FMI-LS-REF of the Modelica Association, version 1.0.0-alpha.1, for FMI 2.0 and 3.0. It puts
related files into the archive's folder FOLDER.
"""

import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from plant_fmu import description
from plant_fmu.variables import HERE

REFERENCE = HERE / "reference"
NAME = "fmi-ls-manifest.xml"
FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"


def files() -> list[Path]:
    """Return the files that the manifest describes; they must be packed beside it."""
    return [path for path, *_ in _related()]


def manifest() -> str:
    """Return the document."""
    ET.register_namespace("fmi-ls", _NAMESPACE)
    attributes = {
        "fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
        "fmi-ls-version": "1.0.0-alpha.1",
        "fmi-ls-description": "Layered Standard providing information on related files included in an FMU.",
    }
    root = ET.Element("fmiReferences", {f"{{{_NAMESPACE}}}{name}": value for name, value in attributes.items()})
    for path, kind, role, words in _related():
        ET.SubElement(root, "Related", type=kind, source=path.name, role=role, description=words)
    return description.text_of(root)


def _related() -> Iterator[tuple[Path, str, str, str]]:
    """Yield each file with its MIME type, role and description."""
    yield REFERENCE / "README.md", "text/markdown", "document", "What the cases are and how to run them"
    yield REFERENCE / "cases.toml", "application/toml", "testcase", "Start values, steps and tolerances of the cases"
    for name, case in tomllib.loads((REFERENCE / "cases.toml").read_text(encoding="utf-8")).items():
        inputs, results = REFERENCE / f"{name}_in.csv", REFERENCE / f"{name}_ref.csv"
        if inputs.exists():
            yield inputs, "text/csv", "testcase", f"Inputs of {name}"
        yield results, "text/csv", "result", f"Results of {name}: {case['description']}"
