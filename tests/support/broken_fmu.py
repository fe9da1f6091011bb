"""Small FMUs for FMI 2.0 and FMI 3.0, whole or broken in one way, compiled from tests/support/fmus_broken."""

import functools
import re
import struct
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

import fmpy

from hil.plant import archive
from tests.support import once
from tools.build.compiler import compile_shared

HERE = Path(__file__).with_name("fmus_broken")
HEADERS = Path(fmpy.__file__).with_name("c-code")  # the standard's own
Change = Callable[[str, bytes], bytes | None]


def same(_name: str, data: bytes) -> bytes:
    """Change nothing."""
    return data


def pack(
    fmu: Path, fmi: int, change: Change = same, added: Iterable[tuple[str, bytes]] = (), library: bytes = b"a library"
) -> Path:
    """Write an FMU, with members changed, left out (None) or added; by default its library cannot be loaded."""
    folder = archive.binary_folders(f"{fmi}.0")[-1]
    members = [
        ("modelDescription.xml", (HERE / f"lag_fmi{fmi}.xml").read_bytes()),
        (f"binaries/{folder}/lag{archive.LIBRARY_SUFFIX}", library),
    ]
    with zipfile.ZipFile(fmu, "w") as packed:
        for name, data in members:
            if (new := change(name, data)) is not None:
                packed.writestr(name, new)
        for name, data in added:
            packed.writestr(name, data)
    return fmu


FAULTS = re.findall(r"^    ([A-Z_]+),$", (HERE / "lag.h").read_text(encoding="utf-8"), re.MULTILINE)
"""The faults of lag.h by their numbers."""
_MARK = b"lag breaks:\0"


def lag(folder: Path, fmi: int, fault: str = "NO_FAULT", change: Change = same) -> Path:
    """Make an FMU that can be run, with a fault of lag.h. It is compiled once a session."""
    library = once.made(f"lag_fmi{fmi}", functools.partial(_compile, fmi))
    number = library.index(_MARK) + len(_MARK)
    broken = library[:number] + struct.pack("i", FAULTS.index(fault)) + library[number + 4 :]
    return pack(folder / f"lag_fmi{fmi}.fmu", fmi, change, library=broken)


def _compile(fmi: int, folder: Path) -> bytes:
    library = folder / f"lag_{fmi}{archive.LIBRARY_SUFFIX}"
    compile_shared((HERE / "lag.c", HERE / f"lag_fmi{fmi}.c"), library, include=(HERE, HEADERS), flags=("-O0",))
    return library.read_bytes()
