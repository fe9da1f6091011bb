"""What the catalogue runs: every case alone over each link, all pairs, and the subset in real time."""

import itertools
import random
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from hil.batch.catalogue.runs import Job
from hil.core.errors import BadInputError, nearest
from hil.drivers.registry import dialect
from hil.faults.cases import (
    CASES,
    MOTORS_CASES,
    NO_FEEDBACK,
    PAIRS,
    SILENCE,
    Case,
    Outcome,
    Pair,
)
from hil.scenario import Scenario, load
from hil.scenario.motors import make_driver

LINKS = {"memory": "memory:", "serial": "serial:pty", "can": "can:virtual/catalogue"}
MOTORS_WIRES = {
    "can": "can:virtual/catalogue",
    "can_fd": "can:virtual/catalogue?fd=1&data_bitrate=5000000",
    "serial": "memory:",
}
_ORDER = list(Outcome)


class Asked(NamedTuple):
    """What a user asks the catalogue for: base scenario with changes, links and kinds, and where recordings go.

    ``sample`` is how many of the pairs, None for all; ``seed`` chooses them.
    """

    scenario: str
    sets: Sequence[str]
    links: Sequence[str]
    kinds: Sequence[str]
    recordings: Path
    sample: int | None = None
    seed: int = 0


def check(asked: Asked) -> None:
    """Raise BadInputError for a link or a kind that does not exist."""
    for what, given, known in (
        ("link", asked.links, list(LINKS)),
        ("kind", asked.kinds, list(dict.fromkeys(case.kind for case in CASES))),
    ):
        for name in given:
            if name not in known:
                raise BadInputError(f"--{what} {name}: the catalogue has no such {what}{nearest(name, known)}")


def check_motors(asked: Asked, *, pairs: bool, realtime: bool) -> None:
    """Raise BadInputError for what there is not with motors of other makers."""
    if not load(asked.scenario, set=asked.sets).device.is_makers:
        return
    given = {"--link": bool(asked.links), "--pairs": pairs, "--realtime": realtime}
    if wrong := [option for option, is_given in given.items() if is_given]:
        raise BadInputError(
            f"{', '.join(wrong)}: with motors of other makers the catalogue runs each fault alone, in lockstep, over "
            "the wire of their own; leave it out"
        )


def alone(asked: Asked, mode: str = "lockstep") -> list[Job]:
    """Return every case over each link; what re-arms, without loop.rearm too. In real time only the subset.

    A machine that stalls in real time may stop the robot by its watchdog in any of them, and it re-arms.
    """
    base = load(asked.scenario, set=asked.sets)
    if base.device.is_makers:
        return _of_motors(asked, base) if mode == "lockstep" else []
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
    """Return all pairs of cases, of kinds that were asked for, or a sample; over memory where no link was.

    A pair comes out as the worse of its two does alone, but for those of ``PAIRS``.
    """
    chosen = {case.name for case in _chosen(asked)}
    jobs: list[Job] = []
    if load(asked.scenario, set=asked.sets).device.is_makers:
        return jobs
    for two in itertools.combinations([case for case in CASES if case.in_pairs], 2):
        if not chosen.isdisjoint(case.name for case in two):
            jobs += [_pair(asked, two, link) for link in asked.links or ("memory",)]
    if asked.sample is None or asked.sample >= len(jobs):
        return jobs
    chosen_jobs = random.Random(asked.seed).sample(range(len(jobs)), asked.sample)
    return [jobs[number] for number in sorted(chosen_jobs)]


def _of_motors(asked: Asked, base: Scenario) -> list[Job]:
    """Return every case that there is for motors of other makers, over the wire of their own, in this process."""
    can = make_driver(base).capabilities
    if can.is_twist or can.watchdog == "none":
        raise BadInputError(
            f"the catalogue cannot judge {base.device.driver!r} as it is set up: that needs a command of its own for "
            "each wheel, and a watchdog, without which nothing stops the wheels when a host is gone"
        )
    [wire, *_] = sorted(dialect(base.device.driver).wires)
    # A scenario with a fault of a gyro that is not there is refused.
    cases = [one for one in MOTORS_CASES if one.case.kind != "gyro_bias" or "gyro" in can.sensors]
    for kind in asked.kinds:
        if kind not in (one.case.kind for one in cases):
            driver = base.device.driver
            raise BadInputError(f"--kind {kind}: this never strikes {driver!r} as it is set up; leave it out")
    jobs = []
    for motors in cases:
        if asked.kinds and motors.case.kind not in asked.kinds:
            continue
        outcomes = set(motors.outcomes)
        if can.watchdog == "fixed":  # which may be longer than the window, and what is reset may obey at once
            outcomes.add(Outcome.GOES_ON)
        job = _job(asked, (motors.case,), MOTORS_WIRES[wire], "lockstep", True, outcomes)
        jobs.append(job._replace(causes=list(motors.causes), causes_of_end=list(motors.causes)))
    return jobs


def _pair(asked: Asked, two: tuple[Case, Case], link: str) -> Job:
    worst = _ORDER[max(_ORDER.index(case.expected(link)) for case in two)]
    known: Pair | None = PAIRS.get((two[0].name, two[1].name))
    job = _job(asked, two, link, "lockstep", True, {worst if known is None else known.outcome})
    if known is None:
        return job
    causes = [] if known.cause is None else [known.cause]
    return job._replace(causes=sorted({*job.causes, *causes}), causes_of_end=causes)


def _chosen(asked: Asked) -> Iterator[Case]:
    return (case for case in CASES if not asked.kinds or case.kind in asked.kinds)


def _job(asked: Asked, cases: Sequence[Case], link: str, mode: str, rearm: bool, allowed: set[Outcome]) -> Job:
    name = " + ".join(case.name for case in cases)
    causes = {case.cause for case in cases if case.cause is not None}
    ends = {case.cause for case in cases if case.cause is not None and case.expected(link) is Outcome.ENDS}
    if mode == "realtime":
        causes |= {NO_FEEDBACK, SILENCE}
    file = "-".join([*name.replace("+", "").split(), link.partition(":")[0], mode, "rearm" if rearm else "end"])
    return Job(
        fault=name,
        link=LINKS.get(link, link),
        mode=mode,
        scenario=asked.scenario,
        sets=list(asked.sets),
        rows=[row for case in cases for row in case.rows],
        rearm=rearm,
        allowed=[outcome for outcome in Outcome if outcome in allowed],
        causes=sorted(causes),
        causes_of_end=sorted(ends or causes),
        recording=str(asked.recordings / f"{file}.rrd"),
        # A recorder of its own costs a second, and is the same whatever the link.
        records_here=len(cases) > 1 or (mode == "lockstep" and link != "serial"),
    )
