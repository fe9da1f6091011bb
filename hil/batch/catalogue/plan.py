"""What the catalogue runs: every case alone over each link, all pairs, and a part of them in real time."""

import itertools
import random
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.core.types import CommandMode
from hil.drivers.registry import dialect
from hil.faults.cases import CASES, DURATION_S, MOTORS_CASES, NO_FEEDBACK, PAIRS, SILENCE, Case, Row
from hil.faults.cases import Outcome as Ending
from hil.scenario import Scenario, format_value, load, read
from hil.scenario.motors import make_driver

LINKS = {"memory": "memory:", "serial": "serial:pty", "can": "can:virtual/catalogue"}
MOTORS_WIRES = {
    "can": "can:virtual/catalogue",
    "can_fd": "can:virtual/catalogue?fd=1&data_bitrate=5000000",
    "serial": "memory:",
}
_ENDINGS = list(Ending)
_OPTION, _GAINS = "--set", "controller.gains."
# A case that names the speed command means the torque command where the law gives torques.
_IN_TORQUE_MODE = {"WHEEL_COMMAND": "TORQUE_COMMAND", "wheel.fl.speed_command_rad_s": "wheel.fl.torque_command_n_m"}


class Request(NamedTuple):
    """What the user wants to run: the base scenario and its changes, links, kinds of fault, and the recordings' folder.

    ``sample`` is how many pairs of faults are run, None for all; ``seed`` chooses them.
    """

    scenario: str
    sets: Sequence[str]
    links: Sequence[str]
    kinds: Sequence[str]
    recordings: Path
    sample: int | None = None
    seed: int = 0


class Trial(NamedTuple):
    """One run of the catalogue: its faults over a link, and the outcomes that are allowed.

    Each message on why the robot was lost must contain one of ``causes``, the message on what ended the run one of
    ``causes_of_end``. With ``records_here`` the process of the run writes the recording itself.
    """

    fault: str
    link: str
    mode: str
    rows: Sequence[Row]
    rearm: bool
    allowed: Sequence[str]
    causes: Sequence[str]
    causes_of_end: Sequence[str]
    recording: str
    records_here: bool


def check(request: Request, *, pairs: bool, realtime: bool) -> None:
    """Raise BadInputError for an unknown link or kind, or an option that third-party controllers do not allow."""
    for what, given, known in (
        ("link", request.links, list(LINKS)),
        ("kind", request.kinds, list(dict.fromkeys(case.kind for case in CASES))),
    ):
        for name in given:
            if name not in known:
                raise BadInputError(f"--{what} {name}: the catalogue has no such {what}{nearest(name, known)}")
    if not load(request.scenario, set=request.sets).device.is_makers:
        return
    given_options = {"--link": bool(request.links), "--pairs": pairs, "--realtime": realtime}
    if wrong := [option for option, is_given in given_options.items() if is_given]:
        raise BadInputError(
            f"{', '.join(wrong)}: with third-party motors the catalogue runs each fault alone, in lockstep, over "
            "the wire of their own; leave it out"
        )


def scenarios(request: Request, trials: Sequence[Trial]) -> Iterator[Scenario | BadInputError]:
    """Yield the scenario of each trial, or the error if it is not valid. Raises BadInputError for the base scenario."""
    sources = read(request.scenario)
    changes = [*request.sets, "expect=[]", f"loop.duration_s={DURATION_S}"]
    base = sources.scenario(set=[*changes, "fault=[]"])
    if base.plant.fmu == "mecanum":
        # The faults of floor and battery need this of the shipped plant.
        changes += ["plant.start.contact=slip", "plant.start.drive=current"]
    for trial in trials:
        rows: Sequence[Row] = trial.rows
        if base.controller.mode is CommandMode.TORQUE:
            rows = [{**row, "target": _IN_TORQUE_MODE.get(str(row["target"]), row["target"])} for row in rows]
        sets = [*changes, f"loop.rearm={format_value(trial.rearm)}", f"fault={format_value(rows)}"]
        try:
            scenario = sources.scenario(set=sets, mode=trial.mode, link=trial.link)
        except BadInputError as error:
            yield error
            continue
        table, where = scenario.controller, scenario.provenance
        if where["controller.law"] == _OPTION:  # keep only gains of that option: the file's belong to the file's law
            gains = {name: value for name, value in table.gains.items() if where[_GAINS + name] == _OPTION}
            scenario = replace(scenario, controller=replace(table, gains=gains))
        yield scenario


def alone(request: Request, mode: str = "lockstep") -> list[Trial]:
    """Return every case over each link; a case that re-arms also without ``loop.rearm``.

    In real time only some cases are run, and each may re-arm: a stall of the machine may trip the robot's watchdog.
    """
    base = load(request.scenario, set=request.sets)
    if base.device.is_makers:
        return _of_motors(request, base) if mode == "lockstep" else []
    trials = []
    for case, link in itertools.product(_chosen(request), request.links or LINKS):
        expected = case.outcome
        if mode == "realtime":
            trials += [_trial(request, (case,), link, mode, True, {expected, Ending.REARMS})] if case.realtime else []
            continue
        trials.append(_trial(request, (case,), link, mode, True, {expected}))
        if expected is Ending.REARMS:
            trials.append(_trial(request, (case,), link, mode, False, {Ending.ENDS}))
    return trials


def pairs(request: Request) -> list[Trial]:
    """Return all pairs of cases with one of the wanted kinds, or a sample of them; by default over memory.

    A pair's outcome must be the worse of its two cases' own, except for those in ``PAIRS``.
    """
    chosen = {case.name for case in _chosen(request)}
    trials: list[Trial] = []
    for two in itertools.combinations([case for case in CASES if case.in_pairs], 2):
        if not chosen.isdisjoint(case.name for case in two):
            trials += [_pair(request, two, link) for link in request.links or ("memory",)]
    if request.sample is None or request.sample >= len(trials):
        return trials
    numbers = random.Random(request.seed).sample(range(len(trials)), request.sample)
    return [trials[number] for number in sorted(numbers)]


def _of_motors(request: Request, base: Scenario) -> list[Trial]:
    """Return every case for third-party motor controllers, over their own wire."""
    can = make_driver(base).capabilities
    if can.is_twist or can.watchdog == "none":
        raise BadInputError(
            f"the catalogue cannot judge {base.device.driver!r} as it is set up: that needs a command of its own for "
            "each wheel, and a watchdog, without which nothing stops the wheels when a host is gone"
        )
    [wire, *_] = sorted(dialect(base.device.driver).wires)
    # A scenario with a fault of a gyro that is not there is refused.
    cases = [one for one in MOTORS_CASES if one.case.kind != "gyro_bias" or "gyro" in can.sensors]
    for kind in request.kinds:
        if kind not in (one.case.kind for one in cases):
            driver = base.device.driver
            raise BadInputError(f"--kind {kind}: this fault cannot act on {driver!r} as it is set up; leave it out")
    trials = []
    for motors in (one for one in cases if not request.kinds or one.case.kind in request.kinds):
        # A fixed watchdog may be longer than the window; a reset controller may obey at once.
        outcomes = {*motors.outcomes, *([Ending.GOES_ON] if can.watchdog == "fixed" else [])}
        trial = _trial(request, (motors.case,), MOTORS_WIRES[wire], "lockstep", True, outcomes)
        trials.append(trial._replace(causes=list(motors.causes), causes_of_end=list(motors.causes)))
    return trials


def _pair(request: Request, two: tuple[Case, Case], link: str) -> Trial:
    worst = _ENDINGS[max(_ENDINGS.index(case.outcome) for case in two)]
    known = PAIRS.get((two[0].name, two[1].name))
    trial = _trial(request, two, link, "lockstep", True, {worst if known is None else known.outcome})
    if known is None:
        return trial
    causes = [] if known.cause is None else [known.cause]
    return trial._replace(causes=sorted({*trial.causes, *causes}), causes_of_end=causes)


def _chosen(request: Request) -> Iterator[Case]:
    return (case for case in CASES if not request.kinds or case.kind in request.kinds)


def _trial(request: Request, cases: Sequence[Case], link: str, mode: str, rearm: bool, allowed: set[Ending]) -> Trial:
    name = " + ".join(case.name for case in cases)
    causes = {case.cause for case in cases if case.cause is not None}
    ends = {case.cause for case in cases if case.cause is not None and case.outcome is Ending.ENDS}
    if mode == "realtime":
        causes |= {NO_FEEDBACK, SILENCE}
    file = "-".join([*name.replace("+", "").split(), link.partition(":")[0], mode, "rearm" if rearm else "end"])
    return Trial(
        fault=name,
        link=LINKS.get(link, link),
        mode=mode,
        rows=[row for case in cases for row in case.rows],
        rearm=rearm,
        allowed=[outcome for outcome in Ending if outcome in allowed],
        causes=sorted(causes),
        causes_of_end=sorted(ends or causes),
        recording=str(request.recordings / f"{file}.rrd"),
        # A recorder process costs a second and does the same for each link, so only one link has it.
        records_here=len(cases) > 1 or (mode == "lockstep" and link != "serial"),
    )
