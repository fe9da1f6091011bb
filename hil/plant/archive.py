"""Opens an FMU without trusting it: a zip archive whose entries, sizes and XML may say anything.

Every refusal is a BadInputError of one sentence that names the file.
"""

import hashlib
import shutil
import stat
import sys
import tempfile
import xml.etree.ElementTree as ET
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import plant_fmu
from hil.errors import BadInputError, nearest

SHIPPED = "mecanum"
_MOST_BYTES = 512 * 1024 * 1024  # unpacked; large FMUs with resources stay below
_MOST_DESCRIPTION_BYTES = 64 * 1024 * 1024
_MOST_ENTRIES = 20_000
_LIBRARY_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
# Damaged, encrypted, or packed by a method that Python lacks.
_UNREADABLE = (zipfile.BadZipFile, zlib.error, RuntimeError, NotImplementedError)


class Library(NamedTuple):
    """This platform's binary in an FMU, and what it is to be used as."""

    member: str  # path in the archive
    fmi_version: str  # "2.0" or "3.0"
    interface: str  # "co_simulation" or "model_exchange"
    model_identifier: str


class Header(NamedTuple):
    """What modelDescription.xml says first of all; an identifier is None where that interface is missing."""

    fmi_version: str
    co_simulation: str | None
    model_exchange: str | None


def locate(name: str, directory: Path) -> Path:
    """Return the FMU of a scenario: a shipped name, or a path relative to ``directory``.

    Raises BadInputError when there is none.
    """
    path = plant_fmu.path() if name == SHIPPED else directory / name
    if path.is_file():
        return path
    if name == SHIPPED:
        raise BadInputError(f"the shipped FMU {path} is not built; run: hil fmu build")
    raise BadInputError(f"FMU {name!r} does not exist at {path}{nearest(name, [SHIPPED])}")


def sha256(fmu: Path) -> str:
    """Return the SHA-256 of the file, in hex. Raises BadInputError when it cannot be read."""
    try:
        return hashlib.sha256(fmu.read_bytes()).hexdigest()
    except OSError as error:
        raise BadInputError(f"FMU {fmu} cannot be read ({error.strerror}); give the path of an .fmu file") from error


def is_shipped(fmu: Path) -> bool:
    """Tell whether this is, byte for byte, the FMU that ships with this package."""
    return plant_fmu.path().is_file() and sha256(fmu) == sha256(plant_fmu.path())


def read_header(fmu: Path) -> Header:
    """Check the archive and return what its modelDescription.xml says first. Raises BadInputError."""
    with _open(fmu) as archive:
        try:
            size = archive.getinfo("modelDescription.xml").file_size
        except KeyError as error:
            raise BadInputError(f"FMU {fmu}: it has no modelDescription.xml, so it is no FMU") from error
        if size > _MOST_DESCRIPTION_BYTES:
            raise BadInputError(f"FMU {fmu}: its modelDescription.xml claims {size} bytes; that is no description")
        try:
            root = ET.fromstring(archive.read("modelDescription.xml"))
        except (ET.ParseError, LookupError, *_UNREADABLE) as error:
            raise BadInputError(f"FMU {fmu}: its modelDescription.xml cannot be read ({error})") from error
    interfaces = [root.find(name) for name in ("CoSimulation", "ModelExchange")]
    co_simulation, model_exchange = (
        None if found is None else found.get("modelIdentifier", "") for found in interfaces
    )
    return Header(root.get("fmiVersion", "missing"), co_simulation, model_exchange)


def library_of(fmu: Path) -> Library:
    """Return this platform's library in an FMI 2.0 or 3.0 FMU, for co-simulation where it is for both.

    Raises BadInputError when the FMU has another version, another interface, or no library for this platform.
    """
    header = read_header(fmu)
    version = header.fmi_version[:3]
    if version not in ("2.0", "3.0"):
        raise BadInputError(f"FMU {fmu}: FMI version {header.fmi_version}; expected 2.0 or 3.0, export it anew")
    interface = "model_exchange" if header.co_simulation is None else "co_simulation"
    identifier = header.co_simulation or header.model_exchange
    if identifier is None:
        raise BadInputError(f"FMU {fmu}: it is neither for co-simulation nor for model exchange; export it anew")
    library = f"binaries/{_platform(version)}/{identifier}{_LIBRARY_SUFFIX}"
    with _open(fmu) as archive:
        names = archive.namelist()
    if library not in names:
        folders = sorted({PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/") and n.count("/") > 1})
        there = f"it has binaries for {', '.join(folders)}" if folders else "it has no binaries"
        raise BadInputError(f"FMU {fmu}: no {library} for this platform; {there}")
    return Library(library, version, interface, identifier)


def extract(fmu: Path) -> Path:
    """Unpack the checked archive into a new temporary folder; the caller removes it. Raises BadInputError."""
    with _open(fmu) as archive:
        folder = Path(tempfile.mkdtemp(prefix="hil_fmu_"))
        try:
            archive.extractall(folder)
        except (OSError, *_UNREADABLE) as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise BadInputError(f"FMU {fmu}: it cannot be unpacked ({error})") from error
    return folder


def _platform(version: str) -> str:
    import fmpy

    return str(fmpy.platform if version == "2.0" else fmpy.platform_tuple)


def _open(fmu: Path) -> zipfile.ZipFile:
    if not fmu.is_file():
        raise BadInputError(f"FMU {fmu} does not exist; give the path of an .fmu file, or {SHIPPED!r}")
    try:
        archive = zipfile.ZipFile(fmu)
    except zipfile.BadZipFile as error:
        raise BadInputError(f"FMU {fmu}: not a zip archive ({error}), so it is no FMU") from error
    except OSError as error:
        raise BadInputError(f"FMU {fmu}: it cannot be read ({error.strerror})") from error
    if problem := _unsafe(archive):
        archive.close()
        raise BadInputError(f"FMU {fmu}: {problem}; it is not opened")
    return archive


def _unsafe(archive: zipfile.ZipFile) -> str | None:
    entries = archive.infolist()
    if len(entries) > _MOST_ENTRIES:
        return f"it has {len(entries)} entries; expected at most {_MOST_ENTRIES}"
    total = sum(entry.file_size for entry in entries)
    if total > _MOST_BYTES:
        return f"it unpacks to {total} bytes; expected at most {_MOST_BYTES}"
    for entry in entries:
        name = entry.orig_filename
        if name.startswith("/") or "\\" in name or ":" in name or ".." in PurePosixPath(name).parts:
            return f"its entry {name!r} leads out of the archive"
        if stat.S_ISLNK(entry.external_attr >> 16):
            return f"its entry {name!r} is a symbolic link"
    return None
