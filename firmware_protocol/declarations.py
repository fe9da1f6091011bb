"""The declarations of a native library, taken from the C headers themselves, for cffi's ABI mode.

A build writes them beside the library as cffi has read them, because reading C takes a process 0.08 s.
"""

import contextlib
import re
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from firmware_protocol.built import digest_in_library

HEADERS = tuple(
    Path(__file__).parent / header
    for header in (
        "firmware/plant_port.h",
        "generated/wheel_parameters.h",
        "firmware/parameters.h",
        "port/host/host.h",
        "client/wheel_line.h",
        "client/wheel_client.h",
        "client/wheel_timing.h",
        "client/wheel_motion.h",
        "client/wheel_load.h",
        "port/host/direct.h",
    )
)
TABLE = "extern const wheel_parameter_info wheel_parameter_table[];"
"""What cffi needs to know of the host library: the marked parts of these headers, and this declaration."""

_SECTION = re.compile(r"/\* cffi: begin \*/(.*?)/\* cffi: end \*/", re.DOTALL)
_SUFFIX = ".cffi"


def declared(library: Path, headers: Iterable[Path], declarations: str = "") -> Any:
    """Return cffi's ``ffi`` with what these headers mark for cffi, and further ``declarations``.

    Where the file beside the library was written for another one, or is not there, cffi reads the headers.
    """
    return _written(library) or read_headers(headers, declarations)


def are_written(library: Path) -> bool:
    """Return whether the file beside a library is there, and was written for it."""
    return _written(library) is not None


def _written(library: Path) -> Any | None:
    file, found = library.with_suffix(_SUFFIX), dict[str, Any]()
    if file.is_file():
        exec(compile(file.read_bytes(), file, "exec"), found)
    return found["ffi"] if found and found.get("SOURCES") == digest_in_library(library) else None


def write_declarations(library: Path, headers: Iterable[Path], declarations: str = "") -> None:
    """Write the file for ``declared``, whole, beside a library that was just built."""
    ffi = read_headers(headers, declarations)
    ffi.set_source(library.stem, None)
    with tempfile.TemporaryDirectory(dir=library.parent, prefix=f".{library.name}.") as folder:
        made = Path(folder, library.stem + _SUFFIX)
        with contextlib.redirect_stdout(None):  # cffi prints what it makes
            ffi.emit_python_code(str(made))
        with made.open("a", encoding="ascii") as file:
            file.write(f'SOURCES = "{digest_in_library(library)}"\n')
        made.replace(library.with_suffix(_SUFFIX))


def read_headers(headers: Iterable[Path], declarations: str = "") -> Any:
    """Return cffi's ``ffi`` with what these headers mark for cffi, to which more can be added."""
    import cffi  # only here: it also imports a parser of C

    ffi = cffi.FFI()
    for header in headers:
        for section in _SECTION.findall(header.read_text(encoding="utf-8")):
            ffi.cdef(section)
    ffi.cdef(declarations)
    return ffi
