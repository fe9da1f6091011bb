"""A mutant: a known defect that ``hil verify`` puts into a process, to see whether a suite of tests notices it.

Only ``hil verify`` starts processes with a mutant: as JSON in the environment, so that their own children have it too.
A defect of a Python file is put in when the file is imported; the file on the disk stays as it is. What wraps parts of
a run is in ``hil.runtime.mutation``. Recordings and results of such a process name the mutant.
"""

import functools
import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

VARIABLE = "HIL_MUTANT"
"""The environment variable that holds the mutant of a process."""


class Patch(NamedTuple):
    """A change of a source file: ``before``, which is there exactly once, becomes ``after``.

    ``file`` is relative to the folder of the packages, such as ``hil/laws/dsc.py``.
    """

    file: str
    before: str
    after: str

    def apply(self, text: str) -> str:
        """Return the changed text. Raises ValueError unless ``before`` is there exactly once."""
        count = text.count(self.before)
        if count != 1:
            raise ValueError(
                f"{self.file}: {self.before!r} is there {count} times; expected once: look where the code has gone, "
                "and quote it as it is now"
            )
        return text.replace(self.before, self.after)


class Mutant(NamedTuple):
    """What a process needs to know of its mutant.

    Attributes:
        id: its name in the catalogue.
        start: changes of the FMU's start values, by name: a number, a text, or "*1.2", "+0.1" or "-0.1".
        wrap: which part of the run is wrapped, and how (``hil.runtime.mutation``); empty for none.
        patches: changes of Python files.
        fmu: path of an FMU with mutated equations, which replaces the shipped one; "" for none.
        built_sha256: hash of that FMU, or of the mutated firmware library; "" for none.
    """

    id: str
    start: Mapping[str, Any] = {}
    wrap: Mapping[str, Any] = {}
    patches: Sequence[Patch] = ()
    fmu: str = ""
    built_sha256: str = ""

    def to_text(self) -> str:
        """Return it for the environment."""
        return json.dumps(self._asdict(), sort_keys=True)

    @property
    def sha256(self) -> str:
        """A hash of all that it changes."""
        return hashlib.sha256(self._replace(fmu="").to_text().encode()).hexdigest()


def from_text(text: str) -> Mutant:
    """Return the mutant that ``to_text`` gave."""
    fields = json.loads(text)
    return Mutant(**{**fields, "patches": [Patch(*patch) for patch in fields["patches"]]})


@functools.cache
def in_force() -> Mutant | None:
    """Return the mutant of this process, None in any process that ``hil verify`` has not started."""
    text = os.environ.get(VARIABLE)
    return from_text(text) if text else None


def install() -> None:
    """Let Python files be imported with the patches of this process's mutant. Call it before any other import."""
    mutant = in_force()
    if mutant is not None and mutant.patches:
        sys.meta_path.insert(0, _Finder(mutant.patches))


def module_of(file: str) -> str:
    """Return the module that a Python file is, such as ``hil.laws.dsc`` of ``hil/laws/dsc.py``."""
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the modules that are patched, and no other."""

    def __init__(self, patches: Sequence[Patch]) -> None:
        self._patches = patches

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        patches = [patch for patch in self._patches if module_of(patch.file) == fullname]
        spec = importlib.machinery.PathFinder.find_spec(fullname, path) if patches else None
        if spec is None or spec.origin is None:
            return None
        spec.loader = _Loader(fullname, spec.origin, patches)
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    """Compiles a patched module. It neither reads nor writes the cache of compiled files."""

    def __init__(self, name: str, path: str, patches: Sequence[Patch]) -> None:
        super().__init__(name, path)
        self._patches = patches

    def get_code(self, fullname: str) -> CodeType:
        text = Path(self.path).read_text(encoding="utf-8")
        for patch in self._patches:
            text = patch.apply(text)
        code: CodeType = compile(text, self.path, "exec", dont_inherit=True)
        return code
