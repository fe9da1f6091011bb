"""What a verification found, as lines for the terminal, and as JSON."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from hil.addons.verify.catalogue import ROOMS
from hil.addons.verify.verify import (
    NOTICED,
    VERDICTS,
    Verdict,
    Verification,
    noticed_part,
)

SCHEMA = "hil.verify/4"
"""Name and version of the JSON; ``verify.schema.json`` beside this file describes it."""


def as_json(found: Verification) -> dict[str, Any]:
    """Return the JSON object of ``hil verify --json``."""
    return {
        "schema": SCHEMA,
        "passed": found.passed,
        "noticed_part": noticed_part(found.verdicts),
        "counts": _counts(found.verdicts),
        "rooms": {room: _counts(of_room) for room, of_room in _by_room(found)},
        "healthy": {
            "runs": found.healthy,
            "false_alarms": [dict(zip(("member", "varied", "reason"), alarm, strict=True)) for alarm in found.alarms],
        },
        "members": dict(found.members),
        "mutants": [_mutant(one) for one in found.verdicts],
        "wall_s": found.wall_s,
    }


def lines(found: Verification) -> Iterator[str]:
    """Yield the lines for the terminal."""
    for one in (verdict for verdict in found.verdicts if verdict.verdict != NOTICED):
        yield f"{one.verdict}: {one.entry.id}: {one.entry.wrong} ({one.entry.size})"
        yield from (f"    {line}" for line in _remedy(one))
    for member, varied, reason in found.alarms:
        yield f"false alarm: {member} ({varied}): {reason}"
    yield ""
    for room, of_room in _by_room(found):
        yield f"  {room:<10} {_summary(of_room)}"
    part = noticed_part(found.verdicts)
    share = "" if part is None else f" ({100.0 * part:.1f} %)"
    yield f"  {'all':<10} {_summary(found.verdicts)}{share}"
    yield f"  {len(found.alarms)} false alarms in {found.healthy} healthy runs; {found.wall_s:.0f} s"


def _remedy(one: Verdict) -> Iterator[str]:
    """Yield what would have noticed it."""
    found = one.suggestion
    if found is not None:
        figures = f"healthy {found.healthy:.4g}, with the mutant {found.mutated:.4g}"
        yield f"add to {found.member} ({figures}, margin {100.0 * found.margin:.0f} %):"
        yield from found.toml.splitlines()
    elif one.moved:
        yield f"it moved {', '.join(one.moved)} by less than healthy runs differ: a baseline's bytes would notice it"
    else:
        yield "no member goes where it is: add a scenario that does"


def _mutant(one: Verdict) -> dict[str, Any]:
    entry, found = one.entry, one.suggestion
    return {
        "id": entry.id,
        "room": entry.room,
        "wrong": entry.wrong,
        "size": entry.size,
        "way": entry.way,
        "verdict": one.verdict,
        "by": one.by,
        "reason": one.reason,
        "moved": list(one.moved),
        "runs": one.runs,
        "suggestion": None if found is None else {**found._asdict(), "toml": found.toml},
    }


def _counts(verdicts: Sequence[Verdict]) -> dict[str, int]:
    counted = Counter(one.verdict for one in verdicts)
    return {name: counted[name] for name in VERDICTS}


def _summary(verdicts: Sequence[Verdict]) -> str:
    told = ", ".join(f"{count} {name}" for name, count in _counts(verdicts).items() if count)
    return f"{len(verdicts)} mutants: {told}"


def _by_room(found: Verification) -> list[tuple[str, list[Verdict]]]:
    rooms = ((room, [one for one in found.verdicts if one.entry.room == room]) for room in ROOMS)
    return [(room, of_room) for room, of_room in rooms if of_room]
