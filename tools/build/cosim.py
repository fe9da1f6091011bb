"""``python -m tools.build.cosim`` builds the shim between the plant port and an FMU, unless it is current."""

import sys
from pathlib import Path

from firmware_protocol.built import BuildError
from firmware_protocol.declarations import are_written, write_declarations
from hil.plant.built import COSIM, HEADERS, INCLUDE, SOURCES
from tools.build.compiler import compile_shared


def build(library: Path = COSIM.path, cc: str | None = None) -> Path:
    """Build the shim and return its path. Raises BuildError with the compiler's words."""
    compile_shared(SOURCES, library, include=INCLUDE, cc=cc, built=COSIM)
    write_declarations(library, HEADERS)
    return library


if __name__ == "__main__":
    try:
        print(COSIM.path if COSIM.is_current() and are_written(COSIM.path) else build())
    except BuildError as error:
        sys.exit(f"tools.build.cosim: {error}")
