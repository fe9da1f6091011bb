"""Finds FMUs and checks whether and how one can run on this machine, without running its code.

Every refusal is a BadInputError with one sentence that names the file.
"""

import functools
import hashlib
import re
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from firmware_protocol.built import BuildError
from hil.core.errors import BadInputError, nearest
from hil.core.mutant import in_force
from hil.core.strangers import check_may_run, code_is_refused
from hil.plant.built import FMUS
from hil.plant.unpacking import extract as extract
from hil.plant.unpacking import odd_names as odd_names
from hil.plant.unpacking import opened, pieces, refuse_folder
from plant_fmu import SHIPPED
from plant_fmu import path as plant_path
from plant_fmu.platforms import suffix, this_platform, word_size_name

DESCRIPTIONS = ("modelDescription.xml", "sources/buildDescription.xml")  # all the XML that FMPy reads
INTERFACES = {"CoSimulation": "co_simulation", "ModelExchange": "model_exchange"}  # that with the better first
_MOST_DESCRIPTION_BYTES = 64 * 1024 * 1024
LIBRARY_SUFFIX = suffix(this_platform())
_BUILT_BY = {SHIPPED["mecanum_mujoco"]: "hil fmu build --mujoco"}
"""FMUs that are not built automatically, because they need an optional package, and the command that builds each."""


class Header(NamedTuple):
    """What modelDescription.xml says, as far as it can be had without FMPy.

    ``interfaces`` has the attributes of each interface's element by its name: CoSimulation, ModelExchange and, in
    FMI 3.0, ScheduledExecution. ``parameters`` are the names of the variables that are parameters.
    """

    fmi_version: str
    interfaces: dict[str, dict[str, str]]
    parameters: frozenset[str]


class Library(NamedTuple):
    """The shared library to load: its path in the archive, and what it is loaded as.

    ``fmi_version`` is "2.0" or "3.0"; ``interface`` is "co_simulation" or "model_exchange".
    """

    member: str
    fmi_version: str
    interface: str
    model_identifier: str


class BrokenFmuError(BadInputError):
    """The FMU violates the standard so that no tool can run it; ``hil fmu check`` reports a violation."""


def place(name: str, directory: Path) -> Path:
    """Return the path of a scenario's FMU, given a shipped name or a path relative to ``directory``."""
    return SHIPPED[name] if name in SHIPPED else directory / name


def locate(name: str, directory: Path) -> Path:
    """Return the path of a scenario's FMU, given a shipped name or a path relative to ``directory``.

    In a checkout a shipped FMU is rebuilt if its sources have changed. Raises BadInputError when that fails, and when
    the FMU does not exist.
    """
    path = place(name, directory)
    refuse_folder(path)
    if is_ours(path) and (path.is_file() or path not in _BUILT_BY):
        _make_current(path)
    if path.is_file():
        return path
    if name in SHIPPED:
        raise BadInputError(f"the shipped FMU {path} is not built; run: {_BUILT_BY[path]}")
    raise BadInputError(f"FMU {name!r} does not exist at {path}{nearest(name, SHIPPED)}")


@functools.cache
def _make_current(fmu: Path) -> None:
    """Rebuild an FMU of this package if its sources have changed; once per process. Raises BadInputError."""
    try:
        FMUS[fmu].make_current()
    except BuildError as error:
        raise BadInputError(str(error)) from error


def sha256(fmu: Path) -> str:
    """Return the SHA-256 of the file, in hex. Raises BadInputError when it cannot be read."""
    try:
        with fmu.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise BadInputError(f"FMU {fmu} cannot be read ({error.strerror}); give the path of an .fmu file") from error


def is_ours(fmu: Path) -> bool:
    """Return whether this is the path of an FMU that ships with this package, MuJoCo's included."""
    return fmu in SHIPPED.values()


def check_may_load(fmu: Path) -> None:
    """Raise BadInputError for a foreign FMU where code of files is refused: its library is code."""
    if code_is_refused() and not (is_ours(fmu) or is_shipped(fmu)):
        check_may_run(f"FMU {fmu}")


def is_shipped(fmu: Path) -> bool:
    """Return whether this is, byte for byte, the plant that ships with this package, for either FMI version.

    MuJoCo's FMU does not count: its code is not ours, and a fatal error in MuJoCo ends the process. In a process of
    ``hil verify`` its mutated FMU counts too.
    """
    if (mutant := in_force()) is not None and str(fmu) == mutant.fmu:
        return True
    digest = sha256(fmu)
    return any(plant.is_file() and sha256(plant) == digest for plant in (plant_path(2), plant_path(3)))


def read_header(fmu: Path) -> Header:
    """Check the archive and its XML, and return the header of modelDescription.xml. Raises BadInputError."""
    now = fmu.stat() if fmu.is_file() else None
    return _header(fmu, None if now is None else (now.st_mtime_ns, now.st_size))


@functools.lru_cache
def _header(fmu: Path, _state: tuple[int, int] | None) -> Header:
    """Read the header, cached until the file changes."""
    with opened(fmu) as archive:
        if DESCRIPTIONS[0] not in archive.namelist():
            raise BadInputError(f"FMU {fmu}: {_what_instead(archive.namelist())}")
        root = _read_xml(fmu, archive, DESCRIPTIONS[0])
        if root.tag != "fmiModelDescription":
            raise BadInputError(f"FMU {fmu}: its modelDescription.xml has the root {root.tag!r}; it is no description")
        version = root.get("fmiVersion", "missing")
        # Releases of 3.0 share their interface. A version with a suffix is a draft.
        if version != "2.0" and not re.fullmatch(r"3\.0(\.\d+)?", version):
            raise BadInputError(
                f"FMU {fmu}: FMI version {version[:20]}; expected 2.0 or 3.0, export it for one of them"
            )
        if DESCRIPTIONS[1] in archive.namelist():
            _read_xml(fmu, archive, DESCRIPTIONS[1])
    known = (*INTERFACES, "ScheduledExecution")
    interfaces = {child.tag: child.attrib for child in root if child.tag in known}
    parameters = (variable.get("name", "") for variable in root.iterfind("ModelVariables/*[@causality='parameter']"))
    return Header(version[:3], interfaces, frozenset(parameters))


def _what_instead(names: Sequence[str]) -> str:
    """Return what an archive without modelDescription.xml at its top is."""
    inner = [name for name in names if name.lower().endswith(".fmu")]
    some = ", ".join(inner[:3]) + (f" and {len(inner) - 3} more" if len(inner) > 3 else "")
    if "SystemStructure.ssd" in names:
        return f"it is an SSP, a system of FMUs{f' ({some})' if inner else ''}; unzip it and give one FMU"
    if inner:
        return f"it is no FMU but an archive of some ({some}); unzip it and give one FMU"
    for name in names:
        path = PurePosixPath(name)
        if path.name.casefold() == DESCRIPTIONS[0].casefold():
            return f"it has {name!r}; expected {DESCRIPTIONS[0]!r}: zip what is in the folder, not the folder itself"
    return "it has no modelDescription.xml, so it is no FMU"


def library_of(fmu: Path) -> Library:
    """Return this platform's library: for co-simulation if there is one, else for model exchange.

    Raises BadInputError when the FMU has neither interface, or no library for this platform.
    """
    header = read_header(fmu)
    element = next((name for name in INTERFACES if name in header.interfaces), None)
    if element is None:
        there = ", ".join(header.interfaces) or "none at all"
        raise BadInputError(f"FMU {fmu}: its interface is {there}; expected co-simulation, export it for that")
    identifier = header.interfaces[element].get("modelIdentifier", "")
    if not identifier:
        raise BrokenFmuError(f"FMU {fmu}: its {element} has no modelIdentifier, so its library has no name")
    members = [f"binaries/{folder}/{identifier}{LIBRARY_SUFFIX}" for folder in binary_folders(header.fmi_version)]
    with opened(fmu) as archive:
        names = archive.namelist()
    for member in members:
        if member in names:
            return Library(member, header.fmi_version, INTERFACES[element], identifier)
    folders = platforms(fmu)
    here = {PurePosixPath(member).parent for member in members}
    for name in names:
        if PurePosixPath(name).parent in here and name.endswith(LIBRARY_SUFFIX):
            raise BrokenFmuError(
                f"FMU {fmu}: no {members[-1]} for this platform, but {name}; its name is to be the modelIdentifier"
            )
    for name in names:
        if name.replace("\\", "/") in members:
            raise BrokenFmuError(f"FMU {fmu}: its library is the entry {name!r}; expected '/' in place of a backslash")
    there = f"it has binaries for {', '.join(folders)}" if folders else "it has no binaries"
    raise BadInputError(f"FMU {fmu}: no {members[-1]} for this platform; {there}")


def platforms(fmu: Path) -> tuple[str, ...]:
    """Return the platforms for which the FMU has binaries, by the names of their folders. Raises BadInputError."""
    with opened(fmu) as archive:
        paths = [PurePosixPath(name.replace("\\", "/")) for name in archive.namelist() if not name.endswith("/")]
    return tuple(sorted({path.parts[1] for path in paths if path.parts[0] == "binaries" and len(path.parts) > 2}))


def holds(fmu: Path, member: str, text: bytes) -> bool:
    """Return whether a member of the archive contains these bytes. Raises BadInputError."""
    with opened(fmu) as archive:
        return text in b"".join(pieces(fmu, archive, archive.getinfo(member)))


def binary_folders(fmi_version: str) -> tuple[str, ...]:
    """Return the folders of this platform's binaries, the best first: FMI 3.0 section 2.5.1, FMI 2.0 section 2.3.

    The folder names of FMI 2.0 do not distinguish 64-bit architectures, so 2.0 may use those of 3.0 as well.
    """
    here = this_platform()
    names = (here, word_size_name(here))
    return names if fmi_version == "2.0" else names[:1]


class _Tree(ET.TreeBuilder):
    """Builds a document; refuses a document type definition, which could define entities that grow without bound."""

    def __init__(self, named: str) -> None:
        super().__init__()
        self._named = named

    def doctype(self, *_: object) -> None:
        raise BadInputError(f"{self._named} has a document type definition; an FMU has none")


def _read_xml(fmu: Path, archive: zipfile.ZipFile, name: str) -> ET.Element:
    """Parse an XML entry. Raises BadInputError."""
    named = f"FMU {fmu}: its {name}"
    entry = archive.getinfo(name)
    if entry.file_size > _MOST_DESCRIPTION_BYTES:
        raise BadInputError(f"{named} claims {entry.file_size} bytes; that is no description")
    parser = ET.XMLParser(target=_Tree(named))
    try:
        for piece in pieces(fmu, archive, entry):
            parser.feed(piece)
        root: ET.Element = parser.close()
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter two: encodings that Python cannot read
        raise BadInputError(f"{named} cannot be read ({error})") from error
    return root
