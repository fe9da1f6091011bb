"""Compiles the shim between the firmware's plant port and an FMU.

``python -m hil.plant.build`` builds unless the library was built from these sources (``native_build.built_from``). The
library is loaded with cffi's ABI mode, so that neither Python's headers nor a compiler are needed where it runs.
"""

import sys
from pathlib import Path

from native_build.built_from import Built, digest_in_library
from native_build.compiler import FLAGS, SUFFIX, BuildError, compile_shared

HERE = Path(__file__).parent
PLANT_PORT = HERE.parents[1] / "firmware_protocol" / "firmware" / "plant_port.h"
HEADERS = (PLANT_PORT, HERE / "cosim.h", HERE / "derive.h", HERE / "remote.h", HERE / "robot_faults.h")
SOURCES = (HERE / "cosim.c", HERE / "derive.c", HERE / "remote.c", HERE / "robot_faults.c")
BUILT = Built(
    HERE / f"libcosim{SUFFIX}", HERE.parents[1], "hil.plant.build", (*SOURCES, *HEADERS), FLAGS, digest_in_library
)


def build(library: Path = BUILT.path, cc: str | None = None) -> Path:
    """Build the shim and return its path. Raises BuildError with the compiler's words."""
    compile_shared(SOURCES, library, include=(HERE, PLANT_PORT.parent), cc=cc, built=BUILT)
    return library


if __name__ == "__main__":
    try:
        print(BUILT.path if BUILT.is_current() else build())
    except BuildError as error:
        sys.exit(f"hil.plant.build: {error}")
