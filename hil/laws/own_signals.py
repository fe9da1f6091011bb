"""Signals that a law adds to its command and its gains (``hil.core.ports.OwnSignals``)."""

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

from hil.core.errors import BadInputError
from hil.core.signals import GROUPS

if TYPE_CHECKING:
    from hil.core.ports import Controller, OwnSignals

_NAME = re.compile(r"[a-z][a-z0-9_]*(\.[a-z0-9_]+)+")
_RESERVED = GROUPS | {"shadow", "replay", "timestamp", "sequence"}


def own_signals(law: "Controller") -> "tuple[OwnSignals, ...]":
    """Return a tuple with the law if it has signals of its own, else an empty tuple."""
    return (cast("OwnSignals", law),) if getattr(law, "signals", ()) else ()


def short_name(spec: str) -> str:
    """Return the prefix of a law's signals: its name, or the class name of a law like ``./my_law.py:MyLaw``."""
    return re.sub(r"\W", "_", spec.rpartition(":")[2])


def check_names(named: str, names: Sequence[object]) -> tuple[str, ...]:
    """Check and return the names of a law's own signals; error messages begin with ``named``.

    Raises BadInputError for a name that is not dotted lower case, is repeated, is a group of another (``a.b`` and
    ``a.b.c``), or whose first word is reserved, such as that of a built-in signal group.
    """
    checked: list[str] = []
    for name in names:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise BadInputError(
                f"{named}: signals has {name!r}; expected dotted names in lower case, such as 'observer.x_m_s2'"
            )
        group = name.partition(".")[0]
        if group in _RESERVED:
            raise BadInputError(
                f"{named}: signals has {name!r}; {group!r} is reserved, begin the name with another word"
            )
        for other in checked:
            if name == other:
                raise BadInputError(f"{named}: signals has {name!r} twice; name each once")
            if name.startswith(f"{other}.") or other.startswith(f"{name}."):
                raise BadInputError(f"{named}: signals has {name!r} and {other!r}; neither may be a group of the other")
        checked.append(name)
    return tuple(checked)
