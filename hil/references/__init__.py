"""Where the robot should be, as pure functions of the scenario's time (REFERENCES.md).

May import: `core`.
To add a kind of reference: one file here, and an entry point of the group `hil.references` in pyproject.toml; another
package does the same.
"""

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from hil.core.errors import BadInputError
from hil.core.extensions import OUR_PACKAGE, Extensions, failures_of, from_package
from hil.core.options import build
from hil.core.types import Reference
from hil.references.feasibility import Feasibility, feasibility
from hil.references.source import ReferenceSource

__all__ = [
    "Feasibility",
    "ReferenceSource",
    "feasibility",
    "make_reference",
    "reference_module",
    "references",
]

REFERENCES = Extensions("hil.references")
"""By name in a scenario: the dataclass of its options. It is the motion itself, or reads the motion from a file."""
_EXPECTED = "expected ends, span_s and at(t_s), or read(directory) that returns an object with these (REFERENCES.md)"


def shipped_references() -> dict[str, type[Any]]:
    """Import and return the shipped kinds by name."""
    return {name: REFERENCES.load(name, f"reference.kind = {name!r}") for name in REFERENCES.shipped}


def references() -> list[tuple[str, str, str]]:
    """Return (name, package, description) of each kind: the shipped ones, then other packages', not imported."""
    kinds = shipped_references().items()
    shipped = ((name, OUR_PACKAGE, (inspect.getdoc(kind) or "").splitlines()[0]) for name, kind in kinds)
    return [*shipped, *REFERENCES.lines()]


def make_reference(kind: str, options: Mapping[str, object], directory: Path = Path()) -> ReferenceSource:
    """Return the reference of a scenario's ``[reference]`` table, ``options`` being the table without its kind.

    ``kind`` is a shipped name, or one that an installed package has registered in the group ``hil.references``.
    ``directory`` is the folder from which the path of a file starts. Raises BadInputError for an unknown kind or option
    (with the nearest), a wrong type, a value out of range, an unusable file, and for errors of another package's code.
    """
    where = f"reference.kind = {kind!r}"
    found = REFERENCES.load(kind, where)
    named = from_package(where, REFERENCES.find(kind, where))
    if not isinstance(found, type):
        raise BadInputError(f"{named}: {found!r} is no class; {_EXPECTED}")
    with REFERENCES.failures(kind, where, "making it"):
        source: Any = build(found, options, "reference")
        if hasattr(source, "read"):
            source = source.read(directory)
    return cast(ReferenceSource, source) if REFERENCES.is_shipped(kind) else OutsideReference(named, source)


def reference_module(kind: str) -> str | None:
    """Return the module in which another package has a kind of reference; None for a shipped or unknown one."""
    return REFERENCES.module(kind)


class OutsideReference:
    """A reference of another package. Raises BadInputError, with file and line, for every exception of its code."""

    def __init__(self, where: str, source: Any) -> None:
        """``where`` begins error messages. Raises BadInputError if ``source`` lacks an attribute of a reference."""
        missing = [name for name in ("ends", "span_s", "at") if inspect.getattr_static(source, name, None) is None]
        if missing:
            raise BadInputError(f"{where}: {type(source).__name__} has no {missing[0]}; {_EXPECTED}")
        self._where = where
        self._source = source
        with failures_of(where, "ends and span_s"):
            self.ends = bool(source.ends)
            self.span_s = float(source.span_s)

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``."""
        with failures_of(self._where, "at"):
            reference = self._source.at(t_s)
        if not isinstance(reference, Reference):
            raise BadInputError(f"{self._where}: at returned {reference!r}, expected a hil.core.types.Reference")
        return reference
