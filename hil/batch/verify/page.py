"""What a verification found, as a page in Markdown, as lines for the terminal, and as JSON."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hil.batch.output import markdown_table
from hil.batch.verify.catalogue import ROOMS
from hil.batch.verify.verify import (
    EQUIVALENT,
    GOOD,
    NOT_BUILT,
    NOT_EQUIVALENT,
    NOTICED,
    SURVIVED,
    UNREACHED,
    Verdict,
    Verification,
    noticed_part,
)

PAGE = "verify.md"
SCHEMA = "hil.verify/1"
"""Name and version of the JSON; ``verify.schema.json`` beside this file describes it."""
_SHOWN = (NOTICED, SURVIVED, UNREACHED, NOT_EQUIVALENT, EQUIVALENT, NOT_BUILT)


def as_json(found: Verification) -> dict[str, Any]:
    """Return the JSON object of ``hil verify --json``."""
    return {
        "schema": SCHEMA,
        "passed": found.passed,
        "noticed_part": noticed_part(found.verdicts),
        "by_bytes": _by_bytes(found),
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


def lines(found: Verification, page: Path | None = None) -> Iterator[str]:
    """Yield the lines for the terminal."""
    for one in _bad(found):
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
    if count := _by_bytes(found):
        yield f"  {count} of them by other bytes than the baseline's alone, which another platform does not judge"
    yield f"  {len(found.alarms)} false alarms in {found.healthy} healthy runs; {found.wall_s:.0f} s"
    if page is not None:
        yield f"  all of it: {page}"


def page(found: Verification) -> str:
    """Return the page."""
    part = noticed_part(found.verdicts)
    head = ["room", "mutants", *_SHOWN]
    rows = [
        [room, str(len(of_room)), *(str(_counts(of_room)[name]) for name in _SHOWN)]
        for room, of_room in [*_by_room(found), ("all", found.verdicts)]
    ]
    texts = [
        "# What a green run of this suite is worth\n",
        "Known defects were put in, one at a time, and the suite was run on each until a member of it noticed. "
        + ("" if part is None else f"**It noticed {100.0 * part:.1f} %** of those that change something.")
        + _BY_BYTES.format(_by_bytes(found)) * bool(_by_bytes(found))
        + f" {found.healthy} healthy runs, with fresh seeds and permitted variations, raised {len(found.alarms)} false "
        "alarms.\n",
        markdown_table([head, *rows]),
        _SURVIVORS if any(_bad(found)) else "",
        *(_survivor(one) for one in _bad(found)),
    ]
    if found.alarms:
        texts += ["## False alarms\n", markdown_table([["member", "varied", "what it said"], *map(list, found.alarms)])]
    noticed = [one for one in found.verdicts if one.verdict == NOTICED]
    texts += ["## Noticed\n", markdown_table([["mutant", "what is wrong", "size", "by", "what it said"], *(
        [one.entry.id, one.entry.wrong, one.entry.size, str(one.by), str(one.reason)] for one in noticed
    )])]  # fmt: skip
    others = [one for one in found.verdicts if one.verdict in (EQUIVALENT, NOT_BUILT)]
    if others:
        rows = [[one.entry.id, one.verdict, one.entry.equivalent or "the C sources are not here"] for one in others]
        texts += ["## Equivalent or not tried\n", markdown_table([["mutant", "verdict", "why"], *rows])]
    worth = Counter(one.by for one in noticed)
    rows = [[name, f"{wall_s:.2f}", str(worth[name])] for name, wall_s in found.members.items()]
    texts += ["## The suite\n", markdown_table([["member", "s a run", "noticed first"], *rows])]
    return "\n".join(text for text in texts if text)


_BY_BYTES = (
    " Of these, {} by nothing but other bytes on the wire than those of a baseline, which are judged on its own "
    "platform alone; `--no-baseline` shows what the expectations notice."
)
_SURVIVORS = """## Not noticed

Survived: figures or bytes moved, and all passed. Unreached: nothing changed in any run, so no member of the suite goes
where the defect is. Each expectation below holds in all healthy runs, and not with the mutant.
"""


def _survivor(one: Verdict) -> str:
    entry = one.entry
    text = f"### {entry.id}\n\n{entry.wrong} ({entry.size}); {one.verdict}.\n"
    if (found := one.suggestion) is not None:
        text += (
            f"\nAdd to `{found.member}`; on the healthy system there is {found.healthy:.4g}, with the mutant "
            f"{found.mutated:.4g}, and the margin is {100.0 * found.margin:.0f} % of its size:\n\n"
            f"```toml\n{found.toml}```\n"
        )
    else:
        text += "".join(f"\n{line}\n" for line in _remedy(one))
    return text


def _remedy(one: Verdict) -> Iterator[str]:
    """Yield what would have noticed it."""
    found = one.suggestion
    if found is not None:
        yield f"add to {found.member}: " + found.toml.strip().replace("\n", "; ")
        yield f"healthy {found.healthy:.4g}, with the mutant {found.mutated:.4g}, margin {100.0 * found.margin:.0f} %"
    elif one.verdict == NOT_EQUIVALENT:
        yield f"it is listed as equivalent, but {one.by or ', '.join(one.moved)} shows it: take that from its row"
    elif one.moved:
        yield f"it moved {', '.join(one.moved)} by less than healthy runs differ: a baseline's bytes would notice it"
    else:
        yield "no member goes where it is: add a scenario that does, or give its row a reason under `equivalent`"


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
        "by_bytes": one.by_bytes,
        "moved": list(one.moved),
        "runs": one.runs,
        "suggestion": None if found is None else {**found._asdict(), "toml": found.toml},
    }


def _by_bytes(found: Verification) -> int:
    return sum(one.by_bytes for one in found.verdicts if one.verdict == NOTICED)


def _bad(found: Verification) -> list[Verdict]:
    return [one for one in found.verdicts if one.verdict not in GOOD]


def _counts(verdicts: Sequence[Verdict]) -> dict[str, int]:
    counted = Counter(one.verdict for one in verdicts)
    return {name: counted[name] for name in _SHOWN}


def _summary(verdicts: Sequence[Verdict]) -> str:
    told = ", ".join(f"{count} {name}" for name, count in _counts(verdicts).items() if count)
    return f"{len(verdicts)} mutants: {told}"


def _by_room(found: Verification) -> list[tuple[str, list[Verdict]]]:
    rooms = ((room, [one for one in found.verdicts if one.entry.room == room]) for room in ROOMS)
    return [(room, of_room) for room, of_room in rooms if of_room]
