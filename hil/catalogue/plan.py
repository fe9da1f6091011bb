"""What the catalogue runs: every case alone over each link, all pairs, and the subset in real time."""

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from hil.catalogue.runs import Job
from hil.errors import BadInputError, nearest
from hil.faults.cases import CASES, Case, Outcome

LINKS = {"memory": "memory:", "serial": "serial:pty", "can": "can:virtual/catalogue"}
_ORDER = list(Outcome)


class Asked(NamedTuple):
    """What a user asks the catalogue for: base scenario with changes, links and kinds, and where recordings go."""

    scenario: str
    sets: Sequence[str]
    links: Sequence[str]
    kinds: Sequence[str]
    recordings: Path


def check(asked: Asked) -> None:
    """Raise BadInputError for a link or a kind that does not exist."""
    for what, given, known in (
        ("link", asked.links, list(LINKS)),
        ("kind", asked.kinds, list(dict.fromkeys(case.kind for case in CASES))),
    ):
        for name in given:
            if name not in known:
                raise BadInputError(f"--{what} {name}: the catalogue has no such {what}{nearest(name, known)}")


def alone(asked: Asked, mode: str = "lockstep") -> list[Job]:
    """Return every case over each link; what re-arms, without loop.rearm too. In real time only the subset.

    A machine that stalls in real time may stop the robot by its watchdog in any of them, and it re-arms.
    """
    jobs = []
    for case, link in itertools.product(_chosen(asked), asked.links or LINKS):
        expected = case.expected(link)
        if mode == "realtime":
            if case.realtime:
                jobs.append(_job(asked, (case,), link, mode, True, {expected, Outcome.REARMS}))
            continue
        jobs.append(_job(asked, (case,), link, mode, True, {expected}))
        if expected is Outcome.REARMS:
            jobs.append(_job(asked, (case,), link, mode, False, {Outcome.ENDS}))
    return jobs


def pairs(asked: Asked) -> list[Job]:
    """Return all pairs of cases, of kinds that were asked for; over memory where no link was.

    A pair comes out at worst as the worse of its two does alone.
    """
    chosen = {case.name for case in _chosen(asked)}
    jobs = []
    for two in itertools.combinations([case for case in CASES if case.in_pairs], 2):
        if not chosen.isdisjoint(case.name for case in two):
            for link in asked.links or ("memory",):
                worst = max(_ORDER.index(case.expected(link)) for case in two)
                jobs.append(_job(asked, two, link, "lockstep", True, set(_ORDER[: worst + 1])))
    return jobs


def _chosen(asked: Asked) -> Iterator[Case]:
    return (case for case in CASES if not asked.kinds or case.kind in asked.kinds)


def _job(asked: Asked, cases: Sequence[Case], link: str, mode: str, rearm: bool, allowed: set[Outcome]) -> Job:
    name = " + ".join(case.name for case in cases)
    file = "-".join([*name.replace("+", "").split(), link, mode, "rearm" if rearm else "end"])
    return Job(
        fault=name,
        link=LINKS[link],
        mode=mode,
        scenario=asked.scenario,
        sets=list(asked.sets),
        rows=[row for case in cases for row in case.rows],
        rearm=rearm,
        allowed=[outcome for outcome in Outcome if outcome in allowed],
        recording=str(asked.recordings / f"{file}.rrd"),
        records_here=len(cases) > 1,
    )
