"""Native files: the sources of each, and whether the built file matches its present sources.

A build script of ``tools/build`` writes a hash of the sources into its output. Loading compares that hash with the
present sources. A stale file is rebuilt in a checkout, and refused elsewhere. Time stamps are not compared: a file that
git or a copy has restored may be older and yet different.
"""

import hashlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parent
"""The top of a checkout, or site-packages."""
SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
EXTENSION_SUFFIX = ".pyd" if sys.platform == "win32" else ".abi3.so"
"""Of an extension module of the stable ABI."""
# Without fused multiply-add the same sources give the same numbers on every machine with IEEE 754 rounding.
FLAGS = (
    "-std=c11",
    "-O3",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Werror",
)
FIRMWARE_FLAGS = (*FLAGS, "-Wdouble-promotion")
_MARK = "mecanum-hil sources "


class BuildError(Exception):
    """A native file is missing or stale and cannot be built; the message says what to do."""


class Built(NamedTuple):
    """A file that is built from this project's sources.

    Attributes:
        path: the library or FMU.
        module: the script that builds it, as in ``python -m MODULE``.
        sources: the files that it is built from.
        read: returns the hash that a file of this kind holds, or None.
        root: the folder of the packages.
        flags: the compiler's flags; they are part of the hash.
        of_python: the header of what an extension module finds in the Python that loads it; None for other files.
    """

    path: Path
    module: str
    sources: tuple[Path, ...]
    read: Callable[[Path], str | None]
    root: Path = ROOT
    flags: tuple[str, ...] = FLAGS
    of_python: Path | None = None

    def digest(self) -> str | None:
        """Return the SHA-256 of sources and flags, in hex; None if no source exists."""
        there = sorted(source for source in self.sources if source.is_file())
        if not there:
            return None
        digest = hashlib.sha256("\0".join(self.flags).encode())
        for source in there:
            content = source.read_bytes()
            digest.update(f"\0{source.relative_to(self.root).as_posix()}\0{len(content)}\0".encode() + content)
        return digest.hexdigest()

    def is_current(self) -> bool:
        """Return whether the file exists and was built from its present sources, or no sources exist."""
        return self.path.is_file() and self.digest() in (None, self.read(self.path))

    def make_current(self) -> None:
        """Build the file again if it is not current, in its own process, with a line on stderr.

        Several processes may do so at once: each builds the same file and replaces it as a whole. Raises BuildError
        outside a checkout, and with the build's own message when it fails.
        """
        if self.is_current():
            return
        problem = "was not built from the sources beside it" if self.path.is_file() else "is not built"
        if not is_checkout(self.root):
            raise BuildError(
                f"{self.path} {problem}, and it can only be built in a checkout; install the package again"
            )
        print(f"{self.path.name} {problem}: running python -m {self.module}", file=sys.stderr)
        done = run_script(self.module, root=self.root)
        # Another process may have built it meanwhile: Windows does not allow replacing a loaded library.
        if not self.is_current():
            words = done.stderr.strip() or f"it ended with exit code {done.returncode}"
            raise BuildError(f"{self.path} {problem}, and python -m {self.module} could not build it: {words}")


def is_checkout(root: Path = ROOT) -> bool:
    """Return whether the packages are in a checkout, with the build scripts, rather than installed."""
    return (root / "pyproject.toml").is_file()


def run_script(module: str, *arguments: str, root: Path = ROOT) -> "subprocess.CompletedProcess[str]":
    """Run a script of the checkout, ``python -m MODULE``, and return its exit code and output."""
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, errors="replace", check=False)


def mark(digest: str) -> str:
    """Return a C file that puts the hash of a library's sources into the library."""
    return f'extern const char built_from_sources[];\nconst char built_from_sources[] = "{_MARK}{digest}";\n'


def digest_in_library(library: Path) -> str | None:
    """Return the hash that ``mark`` has put into a library, without loading it; None without one."""
    found = re.search(_MARK.encode() + b"([0-9a-f]{64})\0", library.read_bytes())
    return None if found is None else found[1].decode()


SOURCES = (
    *sorted((HERE / "firmware").glob("*.c")),
    *sorted((HERE / "client").glob("*.c")),
    *sorted((HERE / "port" / "host").glob("*.c")),
    *sorted((HERE / "port" / "python").glob("*.c")),
    HERE / "generated" / "wheel_messages.c",
)
_FOLDERS = ("firmware", "client", "port/host", "port/python", "generated")
HEADERS = tuple(header for folder in _FOLDERS for header in (HERE / folder).glob("*.h"))
WHEEL_HOST = Built(
    HERE / f"_wheel{EXTENSION_SUFFIX}",
    "tools.build.wheel_host",
    (*SOURCES, *HEADERS),
    digest_in_library,
    flags=FIRMWARE_FLAGS,
    of_python=HERE / "port" / "python" / "stable_abi.h",
)
"""The firmware core and the host's half of the protocol, as an extension module of the stable ABI. For what is not in a
tick cffi's ABI mode opens the same file, which needs neither Python's headers nor a compiler where it runs.
"""
# Another build of the library may replace it, to measure which code the tests cover.
OTHER = os.environ.get("WHEEL_HOST_LIBRARY")
