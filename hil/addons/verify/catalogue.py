"""The catalogue of mutants: realistic defects of realistic size, as data, and the permitted variations beside them."""

import random
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hil.addons.verify.mutation.mutant import Mutant
from hil.core.errors import BadInputError, nearest

ROOMS = ("plant", "firmware", "law", "wire", "host", "estimator", "motors")
FOLDER = Path(__file__).parent / "mutants"


class Entry(NamedTuple):
    """A mutant of the catalogue.

    Attributes:
        room: one of ``ROOMS``.
        wrong: a text on the defect. size: how large the defect is.
        mutant: what it changes, by start values of the FMU or by a wrapper of a port.
    """

    room: str
    wrong: str
    size: str
    mutant: Mutant

    @property
    def id(self) -> str:
        """Its name, which begins with its room."""
        return self.mutant.id

    @property
    def way(self) -> str:
        """How it is applied: ``start`` or ``wrap``."""
        return "start" if self.mutant.start else "wrap"

    @property
    def target(self) -> str:
        """What it changes, roughly: mutants with the same target are noticed by the same members of a suite."""
        return str(self.mutant.wrap.get("port", "start"))


class Catalogue(NamedTuple):
    """The mutants, and the variations of a healthy robot: start values by name, which must not be noticed."""

    mutants: Sequence[Entry]
    variations: Mapping[str, Mapping[str, Any]]


def read_catalogue() -> Catalogue:
    """Return the catalogue, which is in ``mutants/*.toml``, a file a room."""
    mutants: list[Entry] = []
    variations: dict[str, Mapping[str, Any]] = {}
    for file in sorted(FOLDER.glob("*.toml")):
        table = tomllib.loads(file.read_text(encoding="utf-8"))
        room = table["room"]
        variations |= {row["id"]: row["start"] for row in table.get("variation", ())}
        for row in table["mutant"]:
            mutant = Mutant(f"{room}.{row['id']}", row.get("start", {}), row.get("wrap", {}))
            mutants.append(Entry(room, row["wrong"], row["size"], mutant))
    return Catalogue(mutants, variations)


def chosen(
    mutants: Sequence[Entry], rooms: Sequence[str], ids: Sequence[str], sample: int | None, seed: int
) -> list[Entry]:
    """Return the mutants of some rooms, or with some ids, or a sample of them, in the catalogue's order.

    Raises BadInputError for a room or an id that is not there.
    """
    known = {entry.id for entry in mutants}
    for name in rooms:
        if name not in ROOMS:
            raise BadInputError(f"--room {name}: expected one of {', '.join(ROOMS)}{nearest(name, ROOMS)}")
    for name in ids:
        if name not in known:
            raise BadInputError(f"--mutant {name}: the catalogue has no such mutant{nearest(name, known)}")
    found = [entry for entry in mutants if (not rooms or entry.room in rooms) and (not ids or entry.id in ids)]
    if sample is None or sample >= len(found):
        return found
    places = sorted(random.Random(seed).sample(range(len(found)), sample))
    return [found[place] for place in places]
