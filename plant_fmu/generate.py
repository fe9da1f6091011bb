"""Generates files from variables.toml and reference/cases.toml: descriptions, the C header, tables of documents.

``python -m plant_fmu.generate`` writes the files; ``--check`` writes nothing and exits 1 naming a stale
one. Needs the standard library only.
"""

import argparse
import hashlib
import sys
from pathlib import Path

from plant_fmu import c_header, description, manifest, tables
from plant_fmu.sources import GENERATED, SOURCE_FILES
from plant_fmu.variables import HERE, Definition, DefinitionError, read


def guid(definition: Definition) -> str:
    """Return the identifier that ties the XML to the binary: a hash of both descriptions without it.

    It is the GUID of FMI 2.0 (section 2.2.1) and the instantiation token of FMI 3.0 (section 2.4.1): one binary serves
    both.
    """
    texts = (
        description.model_description(definition, 2, "", SOURCE_FILES),
        description.model_description(definition, 3, ""),
    )
    digest = hashlib.sha256("".join(texts).encode()).hexdigest()
    return f"{{{digest[:8]}-{digest[8:12]}-{digest[12:16]}-{digest[16:20]}-{digest[20:32]}}}"


def render(definition: Definition) -> dict[Path, str]:
    """Return every generated file, with its content."""
    token = guid(definition)
    return {
        GENERATED / "fmi2" / "modelDescription.xml": description.model_description(definition, 2, token, SOURCE_FILES),
        GENERATED / "fmi3" / "modelDescription.xml": description.model_description(definition, 3, token),
        GENERATED / "fmi3" / "terminalsAndIcons.xml": description.terminals(definition),
        GENERATED / manifest.NAME: manifest.manifest(),
        GENERATED / "mecanum_variables.h": c_header.c_header(definition, token),
        HERE / tables.DOCUMENT: tables.document(definition),
    }


def stale(definition: Definition | None = None) -> dict[Path, str]:
    """Return the files that differ from variables.toml, each with its correct content."""
    made = render(definition or read())
    return {path: text for path, text in made.items() if not path.exists() or path.read_text("utf-8") != text}


def main() -> None:
    """Write the files, or with ``--check`` name the stale ones and exit 1."""
    parser = argparse.ArgumentParser(prog="plant_fmu.generate", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when a file is stale")
    check = parser.parse_args().check
    try:
        for path, text in stale().items():
            if check:
                sys.exit(f"{path.relative_to(HERE)} is stale; run python -m plant_fmu.generate")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8", newline="\n")
            print(path)
    except DefinitionError as error:
        sys.exit(f"variables.toml: {error}")


if __name__ == "__main__":
    main()
