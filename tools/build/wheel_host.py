"""``python -m tools.build.wheel_host`` builds the firmware core as a library of this machine, unless it is current."""

import sys
from pathlib import Path

from firmware_protocol.built import SOURCES, WHEEL_HOST, BuildError
from firmware_protocol.declarations import HEADERS, TABLE, are_written, write_declarations
from tools.build.compiler import compile_shared


def build(library: Path = WHEEL_HOST.path) -> Path:
    """Build the host library and return its path. Raises BuildError with the compiler's words."""
    compile_shared(SOURCES, library, built=WHEEL_HOST)
    write_declarations(library, HEADERS, TABLE)
    return library


if __name__ == "__main__":
    try:
        print(WHEEL_HOST.path if WHEEL_HOST.is_current() and are_written(WHEEL_HOST.path) else build())
    except BuildError as error:
        sys.exit(f"tools.build.wheel_host: {error}")
