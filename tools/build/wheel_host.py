"""``python -m tools.build.wheel_host`` builds the extension module of this machine, unless it is current.

``python -m tools.build.wheel_host LIBRARY`` builds the same C without Python, as a library for programs in C, with the
headers of ``firmware_protocol``.
"""

import sys
from pathlib import Path

from firmware_protocol.built import FIRMWARE_FLAGS, SOURCES, WHEEL_HOST, BuildError
from firmware_protocol.declarations import HEADERS, TABLE, are_written, write_declarations
from tools.build.compiler import compile_shared


def build(library: Path = WHEEL_HOST.path) -> Path:
    """Build the extension module and return its path. Raises BuildError with the compiler's words."""
    compile_shared(SOURCES, library, built=WHEEL_HOST)
    write_declarations(library, HEADERS, TABLE)
    return library


def build_for_c(library: Path) -> Path:
    """Build the library without Python and return its path. Raises BuildError with the compiler's words."""
    sources = [source for source in SOURCES if source.parent.name != "python"]
    compile_shared(sources, library, flags=FIRMWARE_FLAGS)
    return library


def main() -> None:
    """Build, and print the path."""
    try:
        if len(sys.argv) > 1:
            print(build_for_c(Path(sys.argv[1])))
        else:
            print(WHEEL_HOST.path if WHEEL_HOST.is_current() and are_written(WHEEL_HOST.path) else build())
    except BuildError as error:
        sys.exit(f"tools.build.wheel_host: {error}")


if __name__ == "__main__":
    main()
