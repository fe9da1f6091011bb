"""What is in an FMU besides its binaries, and the archive itself.

The archive depends on nothing but its members (fixed dates, no compression).
"""

import os
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

from plant_fmu import manifest
from plant_fmu.platforms import ZIG_TARGETS
from plant_fmu.sources import DESCRIPTIONS, GENERATED, HEADERS, HERE, SOURCES

DOCUMENTS = (HERE / "documentation" / "index.html", HERE / "documentation" / "licenses" / "license.txt")
_DATE = (1980, 1, 1, 0, 0, 0)


# Reference results: member -> file.
REFERENCE = {f"{manifest.FOLDER}/{path.name}": path for path in (GENERATED / manifest.NAME, *manifest.files())}


def text_members(fmi: int) -> dict[str, bytes]:
    """Return all members but the binaries: description, documents, and the sources of the whole library.

    Both versions' archives have the same sources, from which the library that serves both is made. They need no
    header of the standard.
    """
    files = {
        **DESCRIPTIONS[fmi],
        **REFERENCE,
        **{f"sources/{path.name}": path for path in (*SOURCES, *HEADERS)},
        **{path.relative_to(HERE).as_posix(): path for path in DOCUMENTS},
    }
    members = {name: path.read_bytes() for name, path in files.items()}
    return {**members, "sources/buildDescription.xml": _build_description(model_identifier(fmi))}


def model_identifier(fmi: int) -> str:
    """Return the name of the library's files, as this version's description has it."""
    slave = ET.parse(DESCRIPTIONS[fmi]["modelDescription.xml"]).getroot().find("CoSimulation")
    assert slave is not None
    return slave.attrib["modelIdentifier"]


def write(members: dict[str, bytes], out: Path, comment: str) -> None:
    """Write the archive, whole or not at all. Raises OSError."""
    out.parent.mkdir(parents=True, exist_ok=True)
    unfinished = out.with_name(f"{out.name}.{os.getpid()}.tmp")
    try:
        with zipfile.ZipFile(unfinished, "w") as archive:
            archive.comment = comment.encode()
            for name in sorted(members):
                entry = zipfile.ZipInfo(name, date_time=_DATE)
                entry.create_system, entry.external_attr = 3, 0o100644 << 16
                archive.writestr(entry, members[name])
        unfinished.replace(out)
    finally:
        unfinished.unlink(missing_ok=True)


def _build_description(identifier: str) -> bytes:
    """Return how to compile ``sources/``: FMI 3.0 section 2.5.1.3, which importers of 2.0 read too.

    Where the mathematics functions are a library of their own it is named; elsewhere there is none to link.
    """
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    for platform in (None, *(name for name in ZIG_TARGETS if name.endswith("-linux"))):
        attributes = {"modelIdentifier": identifier, **({"platform": platform} if platform else {})}
        configuration = ET.SubElement(root, "BuildConfiguration", attributes)
        files = ET.SubElement(configuration, "SourceFileSet", language="C11")
        for source in SOURCES:
            ET.SubElement(files, "SourceFile", name=source.name)
        if platform:
            ET.SubElement(configuration, "Library", name="m", external="true")
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'.encode()
