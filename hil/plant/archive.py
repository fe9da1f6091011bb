"""Finds FMUs, reads and unpacks them, and checks whether one can run on this machine, without running its code.

An FMU is an untrusted zip archive: its names, sizes and bytes may be false or malicious. The rules are those of FMI 3.0
section 2.5 (stored or deflated, not encrypted); names that this system cannot hold are refused. Every refusal is a
BadInputError with one sentence that names the file.
"""

import contextlib
import functools
import hashlib
import re
import stat
import struct
import sys
import unicodedata
import xml.etree.ElementTree as ET
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from firmware_protocol.built import BuildError
from hil.core.errors import BadInputError, nearest
from hil.core.extensions import check_may_run, code_is_refused
from hil.core.printable import printable
from hil.core.scratch import scratch_folder
from hil.plant.built import FMUS
from plant_fmu import SHIPPED
from plant_fmu import path as plant_path
from plant_fmu.platforms import suffix, this_platform, word_size_name

DESCRIPTIONS = ("modelDescription.xml", "sources/buildDescription.xml")  # all the XML that FMPy reads
_INTERFACES = ("CoSimulation", "ModelExchange", "ScheduledExecution")
_MOST_DESCRIPTION_BYTES = 64 * 1024 * 1024
LIBRARY_SUFFIX = suffix(this_platform())
_MOST_BYTES = 512 * 1024 * 1024  # unpacked; large FMUs with resources stay below
_MOST_ENTRIES = 20_000
_CHUNK = 64 * 1024
_LFS = b"version https://git-lfs"
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1 | 0x40  # general purpose bits 0 and 6
# Windows holds no file or folder whose name ends in a dot or a blank, has one of these characters, or begins as these
# devices, whatever the extension.
_NOT_OF_WINDOWS = re.compile(
    r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])(\..*)?|.*[<>:\"|?*].*|.*[. ]", re.IGNORECASE | re.DOTALL
)
_DRIVE = re.compile(r"[a-z]:", re.IGNORECASE)
_FOLDS_NAMES = sys.platform in ("win32", "darwin")  # its file systems hold no two names that differ in case
# Errors of zipfile for damaged archives; ValueError is also for names that are not UTF-8.
_DAMAGED = (zipfile.BadZipFile, zlib.error, struct.error, RuntimeError, ValueError, EOFError, IndexError, OverflowError)
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

    ``fmi_version`` is "2.0" or "3.0".
    """

    member: str
    fmi_version: str
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

    MuJoCo's FMU does not count: its code is not ours, and a fatal error in MuJoCo ends the process.
    """
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
    interfaces = {child.tag: child.attrib for child in root if child.tag in _INTERFACES}
    parameters = (variable.get("name", "") for variable in root.iterfind("ModelVariables/*[@causality='parameter']"))
    return Header(version[:3], interfaces, frozenset(parameters))


def _what_instead(names: Sequence[str]) -> str:
    for name in names:
        if PurePosixPath(name).name.casefold() == DESCRIPTIONS[0].casefold():
            return f"it has {name!r}; expected {DESCRIPTIONS[0]!r}: zip what is in the folder, not the folder itself"
    return "it has no modelDescription.xml, so it is no FMU"


def library_of(fmu: Path) -> Library:
    """Return this platform's library for co-simulation.

    Raises BadInputError when the FMU has not that interface, or no library for this platform.
    """
    header = read_header(fmu)
    if (interface := header.interfaces.get("CoSimulation")) is None:
        there = ", ".join(header.interfaces) or "none at all"
        raise BadInputError(f"FMU {fmu}: its interface is {there}; expected co-simulation, export it for that")
    identifier = interface.get("modelIdentifier", "")
    if not identifier:
        raise BrokenFmuError(f"FMU {fmu}: its CoSimulation has no modelIdentifier, so its library has no name")
    members = [f"binaries/{folder}/{identifier}{LIBRARY_SUFFIX}" for folder in binary_folders(header.fmi_version)]
    with opened(fmu) as archive:
        names = archive.namelist()
    for member in members:
        if member in names:
            return Library(member, header.fmi_version, identifier)
    folders = platforms(fmu)
    there = f"it has binaries for {', '.join(folders)}" if folders else "it has no binaries"
    raise BadInputError(f"FMU {fmu}: no {members[-1]} for this platform; {there}")


def platforms(fmu: Path) -> tuple[str, ...]:
    """Return the platforms for which the FMU has binaries, by the names of their folders. Raises BadInputError."""
    with opened(fmu) as archive:
        paths = [PurePosixPath(name.replace("\\", "/")) for name in archive.namelist() if not name.endswith("/")]
    return tuple(sorted({path.parts[1] for path in paths if path.parts[0] == "binaries" and len(path.parts) > 2}))


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


# The zip archive


@contextlib.contextmanager
def opened(fmu: Path) -> Iterator[zipfile.ZipFile]:
    """Yield the archive, with every entry's name and size checked. Raises BadInputError."""
    refuse_folder(fmu)
    if not fmu.is_file():
        raise BadInputError(f"FMU {fmu} does not exist; give the path of an .fmu file, or a shipped name")
    try:
        archive = zipfile.ZipFile(fmu)
    except OSError as error:
        raise BadInputError(f"FMU {fmu}: it cannot be read ({error.strerror or error})") from error
    except _DAMAGED as error:
        raise BadInputError(f"FMU {fmu}: {_not_a_zip(fmu)} ({error})") from error
    with archive:
        if problem := _unsafe(archive.infolist()):
            raise BadInputError(f"FMU {fmu}: {problem}; it is not opened")
        yield archive


def _not_a_zip(fmu: Path) -> str:
    with fmu.open("rb") as file:
        begin = file.read(len(_LFS))
    if begin == _LFS:
        return "not the file itself but a pointer of Git LFS; run git lfs pull"
    return (
        "a damaged zip archive; copy it again" if begin.startswith(b"PK\3\4") else "not a zip archive, so it is no FMU"
    )


def refuse_folder(fmu: Path) -> None:
    """Raise BadInputError for a folder, such as one into which an FMU was unpacked."""
    if fmu.is_dir():
        raise BadInputError(
            f"FMU {fmu} is a folder; expected an .fmu file, which is a zip archive with modelDescription.xml at its top"
        )


def pieces(fmu: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Iterator[bytes]:
    """Yield the bytes of an entry in pieces of bounded size, never more than the size that the archive gives for it.

    Raises BadInputError when they are damaged, or not as many as that size.
    """
    try:
        with archive.open(entry) as file:
            # A call of read() without a size would unpack all that is there, whatever the entry says.
            while piece := file.read(_CHUNK):
                yield piece
    except (OSError, *_DAMAGED) as error:
        raise BadInputError(f"FMU {fmu}: its entry {entry.filename!r} cannot be unpacked ({error})") from error


@contextlib.contextmanager
def extract(fmu: Path, only: Callable[[str], bool] = lambda _: True) -> Iterator[Path]:
    """Yield a temporary folder with the entries, of these names ``only``. Raises BadInputError."""
    with scratch_folder("fmu") as folder:
        with opened(fmu) as archive:
            for entry in map(archive.getinfo, dict.fromkeys(archive.namelist())):  # one that is there twice once
                if only(entry.filename):
                    _write(fmu, archive, entry, folder / entry.filename)
        yield folder


def _write(fmu: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> None:
    content = pieces(fmu, archive, entry)
    try:
        if entry.is_dir():
            target.mkdir(parents=True, exist_ok=True)
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb") as file:  # never over another entry
            for piece in content:
                file.write(piece)
        if (entry.external_attr >> 16) & 0o111:  # a program in resources/, packed on POSIX
            target.chmod(target.stat().st_mode | 0o100)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise BadInputError(f"FMU {fmu}: its entry {entry.filename!r} cannot be written ({reason})") from error


def _unsafe(entries: list[zipfile.ZipInfo]) -> str | None:
    if len(entries) > _MOST_ENTRIES:
        return f"it has {len(entries)} entries; expected at most {_MOST_ENTRIES}"
    total = sum(entry.file_size for entry in entries)
    if total > _MOST_BYTES:
        return f"it unpacks to {total} bytes; expected at most {_MOST_BYTES}"
    seen: dict[str, zipfile.ZipInfo] = {}
    for entry in entries:
        if problem := _unsafe_entry(entry):
            return f"its entry {entry.orig_filename!r} {problem}"
        other = seen.setdefault(_folded(entry) if _FOLDS_NAMES else entry.filename, entry)
        if other is entry or (other.is_dir() and entry.is_dir()):
            continue
        if other.filename != entry.filename:
            return f"its entries {other.filename!r} and {entry.filename!r} would be one file"
        if (other.CRC, other.file_size) != (entry.CRC, entry.file_size):
            return f"its entry {entry.filename!r} is there twice, with different content"
    return None


def _folded(entry: zipfile.ZipInfo) -> str:
    """Return a name that is the same for two that differ in case, or in the form of a letter."""
    return unicodedata.normalize("NFC", PurePosixPath(entry.filename).as_posix()).casefold()


def _not_of_windows(entry: zipfile.ZipInfo) -> str | None:
    parts = PurePosixPath(entry.filename).parts
    return next((part for part in parts if _NOT_OF_WINDOWS.fullmatch(part)), None)


def _unsafe_entry(entry: zipfile.ZipInfo) -> str | None:
    name = entry.orig_filename
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or _DRIVE.match(name):
        return "leads out of the archive"
    if not path.parts:
        return "has no name"
    if printable(name) != name or "\n" in name or "\t" in name:
        return "has a character in its name that cannot be printed"
    if sys.platform == "win32" and (part := _not_of_windows(entry)) is not None:
        return f"cannot be unpacked on Windows because of {part!r}"
    if stat.S_ISLNK(entry.external_attr >> 16):
        return "is a symbolic link"
    if entry.flag_bits & _ENCRYPTED:
        return "is encrypted"
    if entry.compress_type not in _METHODS:
        return f"is packed by method {entry.compress_type}; expected 0 (stored) or 8 (deflated)"
    return None
