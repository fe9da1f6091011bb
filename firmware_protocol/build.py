"""Builds the firmware core as a shared library of this machine. Needs a C compiler and the standard library only.

``python -m firmware_protocol.build`` builds when a source is newer than the library. The library is loaded with
cffi's ABI mode, so that neither Python's headers nor a compiler are needed where it runs.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
# A library built in another way, to measure what tests cover or notice, takes the place of this one.
LIBRARY = Path(os.environ.get("WHEEL_HOST_LIBRARY", HERE / f"libwheel_host{_SUFFIX}"))
SOURCES = (
    *sorted((HERE / "firmware").glob("*.c")),
    *sorted((HERE / "port" / "host").glob("*.c")),
    HERE / "generated" / "wheel_messages.c",
)
# Without fused multiply-add and libm, host and ARM compute the same bits.
FLAGS = (
    "-std=c11",
    "-O2",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Werror",
)


class BuildError(Exception):
    """The library could not be built; the message says what to do."""


def compiler() -> str:
    """Return the C compiler: ``$CC``, or cc, gcc, clang in this order. Raises BuildError when there is none."""
    names = [os.environ["CC"]] if os.environ.get("CC") else ["cc", "gcc", "clang"]
    for name in names:
        if found := shutil.which(name):
            return found
    raise BuildError(f"no C compiler found (tried {', '.join(names)}); install one, for example gcc, or set CC")


def build(library: Path = LIBRARY) -> Path:
    """Build the host library and return its path. Raises BuildError with the compiler's words."""
    command = [compiler(), *FLAGS, "-shared", "-fPIC", "-o", str(library), *map(str, SOURCES)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BuildError(f"{' '.join(command)} failed:\n{done.stderr}")
    return library


def is_fresh(library: Path = LIBRARY) -> bool:
    """Tell whether the library is there and newer than every source and header."""
    if not library.exists():
        return False
    made = library.stat().st_mtime
    headers = [*HERE.glob("firmware/*.h"), *HERE.glob("port/host/*.h"), *HERE.glob("generated/*.h")]
    return all(source.stat().st_mtime <= made for source in [*SOURCES, *headers])


if __name__ == "__main__":
    try:
        print(LIBRARY if is_fresh() else build())
    except BuildError as error:
        sys.exit(f"firmware_protocol.build: {error}")
