"""Builds the firmware core as a shared library of this machine.

``python -m firmware_protocol.build`` builds unless the library was built from these sources
(``native_build.built_from``). The library is loaded with cffi's ABI mode, so that neither Python's headers nor a
compiler are needed where it runs.
"""

import os
import sys
from pathlib import Path

import native_build.compiler
from native_build.built_from import Built, digest_in_library
from native_build.compiler import SUFFIX, BuildError, compile_shared

HERE = Path(__file__).parent
SOURCES = (
    *sorted((HERE / "firmware").glob("*.c")),
    *sorted((HERE / "port" / "host").glob("*.c")),
    HERE / "generated" / "wheel_messages.c",
)
FLAGS = (*native_build.compiler.FLAGS, "-Wdouble-promotion")
HEADERS = tuple(header for folder in ("firmware", "port/host", "generated") for header in (HERE / folder).glob("*.h"))
BUILT = Built(
    HERE / f"libwheel_host{SUFFIX}",
    HERE.parent,
    "firmware_protocol.build",
    (*SOURCES, *HEADERS),
    FLAGS,
    digest_in_library,
)
# A library built in another way, to measure what tests cover or notice, takes the place of this one when it is loaded.
OTHER = os.environ.get("WHEEL_HOST_LIBRARY")


def build(library: Path = BUILT.path) -> Path:
    """Build the host library and return its path. Raises BuildError with the compiler's words."""
    compile_shared(SOURCES, library, flags=("-Wdouble-promotion",), built=BUILT)
    return library


if __name__ == "__main__":
    try:
        print(BUILT.path if BUILT.is_current() else build())
    except BuildError as error:
        sys.exit(f"firmware_protocol.build: {error}")
