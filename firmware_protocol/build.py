"""Builds the firmware core as a shared library of this machine.

``python -m firmware_protocol.build`` builds when a source is newer than the library. The library is loaded with
cffi's ABI mode, so that neither Python's headers nor a compiler are needed where it runs.
"""

import os
import sys
from pathlib import Path

import native_build.compiler
from native_build.compiler import SUFFIX, BuildError, compile_shared

HERE = Path(__file__).parent
# A library built in another way, to measure what tests cover or notice, takes the place of this one.
LIBRARY = Path(os.environ.get("WHEEL_HOST_LIBRARY", HERE / f"libwheel_host{SUFFIX}"))
SOURCES = (
    *sorted((HERE / "firmware").glob("*.c")),
    *sorted((HERE / "port" / "host").glob("*.c")),
    HERE / "generated" / "wheel_messages.c",
)
FLAGS = (*native_build.compiler.FLAGS, "-Wdouble-promotion")
HEADERS = tuple(sorted(HERE.rglob("*.h")))


def build(library: Path = LIBRARY) -> Path:
    """Build the host library and return its path. Raises BuildError with the compiler's words."""
    compile_shared(SOURCES, library, flags=("-Wdouble-promotion",))
    return library


def is_fresh(library: Path = LIBRARY) -> bool:
    """Tell whether the library is there and newer than every source and header."""
    return native_build.compiler.is_fresh(library, (*SOURCES, *HEADERS))


if __name__ == "__main__":
    try:
        print(LIBRARY if is_fresh() else build())
    except BuildError as error:
        sys.exit(f"firmware_protocol.build: {error}")
