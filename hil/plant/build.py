"""Compiles the shim between the firmware's plant port and an FMU.

``python -m hil.plant.build`` builds when a source is newer than the library. The library is loaded with
cffi's ABI mode, so that neither Python's headers nor a compiler are needed where it runs.
"""

import sys
from pathlib import Path

import native_build.compiler
from native_build.compiler import SUFFIX, BuildError, compile_shared

HERE = Path(__file__).parent
PLANT_PORT = HERE.parents[1] / "firmware_protocol" / "firmware" / "plant_port.h"
LIBRARY = HERE / f"libcosim{SUFFIX}"
HEADERS = (PLANT_PORT, HERE / "cosim.h", HERE / "derive.h", HERE / "remote.h", HERE / "robot_faults.h")
SOURCES = (HERE / "cosim.c", HERE / "derive.c", HERE / "remote.c", HERE / "robot_faults.c")


def build(library: Path = LIBRARY, cc: str | None = None) -> Path:
    """Build the shim and return its path. Raises BuildError with the compiler's words."""
    compile_shared(SOURCES, library, include=(HERE, PLANT_PORT.parent), cc=cc)
    return library


def is_fresh(library: Path = LIBRARY) -> bool:
    """Tell whether the library is there and newer than every source and header."""
    return native_build.compiler.is_fresh(library, (*SOURCES, *HEADERS))


if __name__ == "__main__":
    try:
        print(LIBRARY if is_fresh() else build())
    except BuildError as error:
        sys.exit(f"hil.plant.build: {error}")
