"""The catalogue of mutants: realistic defects of realistic size, as data, and the permitted variations beside them."""

import random
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from firmware_protocol.built import ROOT
from hil.core.errors import BadInputError, nearest
from hil.core.mutant import Mutant, Patch
from hil.plant import archive
from hil.plant.description import start_defaults
from hil.runtime.mutation.applied import check_wrap

ROOMS = ("plant", "firmware", "law", "wire", "host", "estimator", "motors")
FOLDER = Path(__file__).parent / "mutants"
MOST_EQUIVALENT = 0.05
"""The largest part of a catalogue that may be listed as equivalent."""
_PACKAGES = ("hil/", "firmware_protocol/", "plant_fmu/")
_NOT_PATCHED = ("hil/batch/", "hil/cli/", "hil/core/mutant.py", "hil/runtime/mutation/", "hil/__init__.py")
_KEYS = {"id", "wrong", "size", "start", "wrap", "patch", "rules", "equivalent"}
_RULE = re.compile(r"R-[A-Z]+-[1-9]\d*")
_WAYS = ("start", "wrap", "patch")


class Entry(NamedTuple):
    """A mutant of the catalogue.

    Attributes:
        id: its name, which begins with its room. room: one of ``ROOMS``.
        wrong: what is wrong, in words. size: how large the defect is.
        way: how it is applied: ``start`` (start values of the FMU), ``wrap`` (a wrapper of a port), or ``patch`` (of a
            source file). mutant: what that changes.
        equivalent: why it changes nothing that a run could show; None for a mutant that a suite has to notice.
        rules: the ids of the rules of PROTOCOL.md that it breaks.
    """

    id: str
    room: str
    wrong: str
    size: str
    way: str
    mutant: Mutant
    equivalent: str | None = None
    rules: Sequence[str] = ()

    @property
    def target(self) -> str:
        """What it changes, roughly: mutants with the same target are noticed by the same members of a suite."""
        if self.way == "patch":
            return self.mutant.patches[0].file
        return str(self.mutant.wrap.get("port", "start"))

    @property
    def is_built(self) -> bool:
        """Whether it needs a build of C sources."""
        return self.way == "patch" and self.mutant.patches[0].file.endswith(".c")


class Catalogue(NamedTuple):
    """The mutants, and the variations of a healthy robot: start values by name, which must not be noticed."""

    mutants: Sequence[Entry]
    variations: Mapping[str, Mapping[str, Any]]


def read_catalogue(files: Sequence[Path] = (), *, shipped: bool = True) -> Catalogue:
    """Return the shipped catalogue, and that of further files. Variations of a further file replace the shipped ones.

    Raises BadInputError, with a line for each row that is wrong, and when too many are listed as equivalent.
    """
    mutants: dict[str, Entry] = {}
    variations: Mapping[str, Mapping[str, Any]] = {}
    problems = []
    for file in [*(sorted(FOLDER.glob("*.toml")) if shipped else ()), *files]:
        table = _read(file)
        room = table.get("room")
        if variations_here := table.get("variation"):
            variations = {row["id"]: row["start"] for row in variations_here}
        for number, row in enumerate(table.get("mutant", ()), start=1):
            try:
                entry = _entry(row, room)
                if entry.id in mutants:
                    raise ValueError(f"the id {entry.id} is there already")
                mutants[entry.id] = entry
            except ValueError as error:
                problems.append(f"mutants {file.name}, row {number} ({row.get('id', 'without an id')}): {error}")
    found = list(mutants.values())
    equivalents = [entry for entry in found if entry.equivalent is not None]
    if len(equivalents) > MOST_EQUIVALENT * len(found):
        problems.append(
            f"mutants: {len(equivalents)} of {len(found)} are listed as equivalent, more than "
            f"{100 * MOST_EQUIVALENT:.0f} %; replace some by mutants that change something"
        )
    if problems:
        raise BadInputError("\n".join(problems))
    return Catalogue(found, variations)


def check_sources(mutants: Sequence[Entry]) -> None:
    """Raise BadInputError, with a line for each, for patches that do not match the sources exactly once.

    Patches of C files are left out where the sources are not there. For start values it is checked that the shipped
    FMU has them.
    """
    problems = []
    known = start_defaults(archive.place("mecanum", Path()))
    for entry in mutants:
        problems += [
            f"mutant {entry.id}: the FMU has no start value {name!r}{nearest(name, known)}"
            for name in entry.mutant.start
            if name not in known
        ]
        texts: dict[str, str] = {}
        for patch in entry.mutant.patches:
            path = ROOT / patch.file
            if entry.is_built and not path.is_file():
                continue
            try:
                texts[patch.file] = patch.apply(texts.get(patch.file) or path.read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                problems.append(f"mutant {entry.id}: {error}")
    if problems:
        raise BadInputError("\n".join(problems))


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


def _read(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInputError(f"mutants {file}: it cannot be read ({error.strerror}); give a file of mutants") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInputError(f"mutants {file}: it is not TOML ({error})") from error


def _entry(row: Mapping[str, Any], room: object) -> Entry:
    """Return a row as an entry. Raises ValueError with what is wrong with it."""
    if room not in ROOMS:
        raise ValueError(f"room = {room!r} at the head of the file: expected one of {', '.join(ROOMS)}")
    if unknown := sorted(row.keys() - _KEYS):
        raise ValueError(f"{unknown[0]}: unknown{nearest(unknown[0], _KEYS)}")
    for name in ("id", "wrong", "size"):
        if not isinstance(row.get(name), str) or not row[name]:
            raise ValueError(f"{name}: expected a text")
    ways = [name for name in _WAYS if name in row]
    if len(ways) != 1:
        raise ValueError(f"it is applied by {' and '.join(ways) or 'nothing'}; expected one of {', '.join(_WAYS)}")
    [way] = ways
    name = f"{room}.{row['id']}"
    if way == "start":
        mutant = Mutant(name, start=row["start"])
    elif way == "wrap":
        check_wrap(row["wrap"])
        mutant = Mutant(name, wrap=row["wrap"])
    else:
        mutant = Mutant(name, patches=_patches(row["patch"]))
    equivalent = row.get("equivalent")
    return Entry(name, str(room), row["wrong"], row["size"], way, mutant, equivalent, _rules(row, equivalent))


def _rules(row: Mapping[str, Any], equivalent: str | None) -> list[str]:
    rules = row.get("rules", [])
    if not isinstance(rules, list) or not all(isinstance(rule, str) and _RULE.fullmatch(rule) for rule in rules):
        raise ValueError(f'rules = {rules!r}: expected ids of rules of PROTOCOL.md, such as ["R-CMD-4"]')
    if rules and equivalent is not None:
        raise ValueError(f"rules = {rules!r}: a mutant that changes nothing breaks no rule")
    return rules


def _patches(rows: Any) -> list[Patch]:
    try:
        patches = [Patch(**row) for row in (rows if isinstance(rows, list) else [rows])]
    except TypeError as error:
        raise ValueError("patch: expected file, before and after") from error
    for patch in patches:
        if not patch.file.startswith(_PACKAGES) or patch.file.startswith(_NOT_PATCHED):
            raise ValueError(
                f"{patch.file}: expected a file of {', '.join(_PACKAGES)} that is not of hil verify itself"
            )
        if not patch.file.endswith((".py", ".c")) or patch.before == patch.after:
            raise ValueError(f"{patch.file}: expected a change of a file .py or .c")
    if len({patch.file.endswith(".c") for patch in patches}) != 1:
        raise ValueError("patch: expected files of C alone, or of Python alone")
    return patches
