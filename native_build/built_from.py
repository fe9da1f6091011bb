"""Whether a library or an FMU was built from the sources beside it; if not, it is built anew in a checkout.

A build writes a hash of its sources into what it makes; loading compares that with the sources that are there. Times
are not asked: a file that git or a copy has put back is older and different all the same.
"""

import hashlib
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

_PREFIX = "native_build sources "


class NotCurrentError(Exception):
    """What is there was not built from the sources beside it, and cannot be built anew; the message says what to do."""


class Built(NamedTuple):
    """A file that is built from sources of ours.

    Attributes:
        path: the library or FMU.
        root: where the packages are, the top of a checkout or site-packages.
        module: what builds it, as in ``python -m MODULE``.
        sources: the files that it is made of.
        recipe: what else decides what it does, such as the flags of the compiler.
        read: returns the hash that a file of this kind holds, None where it holds none.
    """

    path: Path
    root: Path
    module: str
    sources: tuple[Path, ...]
    recipe: tuple[str, ...]
    read: Callable[[Path], str | None]

    def digest(self) -> str | None:
        """Return the SHA-256 of sources and recipe, in hex; None where there are no sources."""
        there = sorted(source for source in self.sources if source.is_file())
        if not there:
            return None
        digest = hashlib.sha256("\0".join(self.recipe).encode())
        for source in there:
            content = source.read_bytes()
            digest.update(f"\0{source.relative_to(self.root).as_posix()}\0{len(content)}\0".encode() + content)
        return digest.hexdigest()

    def is_current(self) -> bool:
        """Tell whether the file is there and was built from these sources, as far as these are there."""
        return self.path.is_file() and self.digest() in (None, self.read(self.path))

    def is_checkout(self) -> bool:
        """Tell whether the sources are those of a checkout, and not installed ones."""
        return (self.root / "pyproject.toml").is_file()

    def make_current(self) -> None:
        """Build the file anew unless it is current, in a process of its own, which says so on stderr.

        Of several processes that do so at the same time each builds the same, and puts it in place as a whole. Raises
        NotCurrentError outside a checkout, and with the words of the build where that fails.
        """
        if self.is_current():
            return
        problem = "was not built from the sources beside it" if self.path.is_file() else "is not built"
        if not self.is_checkout():
            raise NotCurrentError(
                f"{self.path} {problem}, and this is no checkout in which it could be; install the package anew"
            )
        print(f"{self.path.name} {problem}: running python -m {self.module}", file=sys.stderr)
        command = [sys.executable, "-m", self.module]
        done = subprocess.run(command, cwd=self.root, capture_output=True, text=True, errors="replace", check=False)
        # Another process may have done it meanwhile: Windows lets nobody replace a library that is loaded.
        if not self.is_current():
            words = done.stderr.strip() or f"it ended with exit code {done.returncode}"
            raise NotCurrentError(f"{self.path} {problem}, and python -m {self.module} could not build it: {words}")


def mark(digest: str) -> str:
    """Return a C file that puts the hash of a library's sources into the library."""
    return f'extern const char native_build_sources[];\nconst char native_build_sources[] = "{_PREFIX}{digest}";\n'


def digest_in_library(library: Path) -> str | None:
    """Return the hash that ``mark`` has put into a library, without loading it; None where there is none."""
    found = re.search(_PREFIX.encode() + b"([0-9a-f]{64})\0", library.read_bytes())
    return None if found is None else found[1].decode()
