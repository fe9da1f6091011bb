"""Reads an untrusted zip archive: its names, sizes and bytes may be false or malicious.

The rules are those of FMI 3.0 section 2.5 (stored or deflated, not encrypted). Names that this system cannot hold are
refused, and ``odd_names`` tells those that another one cannot. Every refusal is a BadInputError of one sentence.
"""

import contextlib
import re
import stat
import struct
import sys
import unicodedata
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath

from hil.core.errors import BadInputError
from hil.core.printable import printable
from hil.core.scratch import scratch_folder

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
# What zipfile raises for damaged archives; ValueError stands for names that are not UTF-8, too.
_DAMAGED = (zipfile.BadZipFile, zlib.error, struct.error, RuntimeError, ValueError, EOFError, IndexError, OverflowError)


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
        raise BadInputError(f"FMU {fmu}: {_what_instead(fmu)} ({error})") from error
    with archive:
        if problem := _unsafe(archive.infolist()):
            raise BadInputError(f"FMU {fmu}: {problem}; it is not opened")
        yield archive


def _what_instead(fmu: Path) -> str:
    with fmu.open("rb") as file:
        begin = file.read(len(_LFS))
    if begin == _LFS:
        return "not the file itself but a pointer of Git LFS; run git lfs pull"
    return (
        "a damaged zip archive; copy it again" if begin.startswith(b"PK\3\4") else "not a zip archive, so it is no FMU"
    )


def odd_names(fmu: Path) -> list[str]:
    """Return a sentence for each entry whose name this system holds, and that is not as it should be.

    Another operating system cannot hold it, it has backslashes, or it is there twice. Raises BadInputError.
    """
    found, seen = [], dict[str, zipfile.ZipInfo]()
    with opened(fmu) as archive:
        for entry in archive.infolist():
            name = f"the entry {entry.orig_filename!r}"
            if "\\" in entry.orig_filename:
                found.append(f"{name} has a backslash, which is no separator of folders; zip archives have '/'")
            elif (part := _not_of_windows(entry)) is not None:
                found.append(f"{name} cannot be unpacked on Windows because of {part!r}")
            other = seen.setdefault(_folded(entry), entry)
            if other is entry or (other.is_dir() and entry.is_dir()):
                continue
            if other.filename == entry.filename:
                found.append(f"{name} is there twice")
            else:
                found.append(f"{name} and {other.filename!r} would be one file on macOS and Windows")
    return found


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
    """Return what is wrong with the list of entries, None where nothing is."""
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
    """Return the part of a name that Windows cannot hold."""
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
