"""What the catalogue runs: every case alone over each link, all pairs, and a part of them in real time."""

import contextlib
import itertools
import random
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hil.addons.batch.catalogue.fault_cases import (
    CASES,
    DURATION_S,
    MOTORS_CASES,
    MOTORS_CAUSES,
    NO_FEEDBACK,
    PAIRS,
    SILENCE,
    Case,
    Ending,
    Row,
)
from hil.addons.batch.job import ENDED, PASSED, REFUSED, Job, Outcome
from hil.addons.batch.keys import make_job
from hil.addons.batch.pool import OnProgress, run_jobs
from hil.addons.batch.results_page import Plot, Results, Table
from hil.cli.output import next_command
from hil.core.errors import BadInputError, nearest
from hil.core.types import CommandMode
from hil.faults.kinds import KINDS
from hil.pages.plots import colour_of, rgb
from hil.robot.driver_registry import dialect
from hil.scenario import Scenario, format_value, load, read
from hil.scenario.motor_checks import make_driver

LINKS = {"memory": "memory:", "serial": "serial:pty", "can": "can:virtual/catalogue"}
MOTORS_WIRES = {
    "can": "can:virtual/catalogue",
    "can_fd": "can:virtual/catalogue?fd=1&data_bitrate=5000000",
    "serial": "memory:",
}
if TYPE_CHECKING:
    from matplotlib.axes import Axes

KIND = "hil.addons.batch.catalogue.trial_run:run"
OK = "ok"
_FIGURES = ("applied", "recoveries", "silent_rad_s", "silent_ticks")
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
    ``causes_of_end``. Its recording is judged too; with ``records_here`` the process of the run writes it itself.
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

    def job(self, scenario: Scenario, **how: Any) -> Job:
        """Return the job of the trial in its scenario; ``how`` as for ``make_job``."""
        names = ("rearm", "allowed", "causes", "causes_of_end", "records_here")
        options = {name: getattr(self, name) for name in names}
        return make_job(scenario, KIND, options, recording=self.recording, **how)


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


def in_pairs(request: Request) -> list[Trial]:
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
    sensors = {kind.name: kind.sensor for kind in KINDS}
    cases = [(case, outcomes) for case, outcomes in MOTORS_CASES if sensors[case.kind] in ("", *can.sensors)]
    for kind in request.kinds:
        if kind not in (case.kind for case, _ in cases):
            driver = base.device.driver
            raise BadInputError(f"--kind {kind}: this fault cannot act on {driver!r} as it is set up; leave it out")
    trials = []
    for case, outcomes in cases:
        if not request.kinds or case.kind in request.kinds:
            # A fixed watchdog may be longer than the window; a reset controller may obey at once.
            allowed = {*outcomes, *([Ending.GOES_ON] if can.watchdog == "fixed" else [])}
            trial = _trial(request, (case,), MOTORS_WIRES[wire], "lockstep", True, allowed)
            trials.append(trial._replace(causes=MOTORS_CAUSES, causes_of_end=MOTORS_CAUSES))
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


class JudgedTrial(NamedTuple):
    """A trial and its outcome."""

    trial: Trial
    done: Outcome

    @property
    def verdict(self) -> str:
        """What is wrong, or "ok"."""
        if self.done.status == PASSED:
            return OK
        return f"refused: {self.done.reason}" if self.done.status in (REFUSED, ENDED) else str(self.done.reason)

    @property
    def is_ok(self) -> bool:
        """Whether the run was as it should be."""
        return self.done.status == PASSED

    @property
    def where(self) -> str:
        """The link, and the mode where it is real time."""
        return self.trial.link + (", real time" if self.trial.mode == "realtime" else "")

    @property
    def words(self) -> str:
        """The trial with its verdict."""
        return f"{self.trial.fault} over {self.trial.link}: {self.verdict}"

    def plain(self) -> dict[str, Any]:
        """Return it as plain values, for JSON.

        ``silent_rad_s`` is the greatest set point in the ``silent_ticks`` ticks in which it has to be zero. The figures
        of a lost run are None.
        """
        done, trial = self.done, self.trial
        return {
            **{name: getattr(trial, name) for name in ("fault", "link", "mode", "rearm")},
            "verdict": self.verdict,
            "outcome": done.details.get("ending"),
            **{name: done.figures.get(name) for name in _FIGURES},
            "wall_s": done.wall_s,
            "recording": done.recording,
        }

    def row(self) -> tuple[str, ...]:
        """Return the row of a table."""
        found = self.plain()
        return (
            found["fault"],
            self.where,
            "yes" if found["rearm"] else "no",
            found["outcome"] or "-",
            "-" if found["applied"] is None else " ".join(map(str, found["applied"])),
            "-" if found["recoveries"] is None else str(found["recoveries"]),
            "-" if found["silent_rad_s"] is None else f"{found['silent_rad_s']:g} rad/s",
            f"{found['wall_s']:.1f}",
            self.verdict.partition(":")[0],
        )


def catalogue(
    request: Request,
    *,
    pairs: bool = False,
    realtime: bool = False,
    workers: int | None = None,
    limit_s: float = 60.0,
    on_progress: OnProgress | None = None,
) -> list[JudgedTrial]:
    """Run the catalogue and return a verdict on each run; what runs in real time runs alone, after all else.

    Raises BadInputError for a link or kind that does not exist, and for a base scenario that cannot be used.
    """
    check(request, pairs=pairs, realtime=realtime)
    lockstep = alone(request) + (in_pairs(request) if pairs else [])
    in_real_time = alone(request, "realtime") if realtime else []
    request.recordings.mkdir(parents=True, exist_ok=True)
    verdicts = run_trials(request, lockstep, workers, limit_s, on_progress)
    verdicts += run_trials(request, in_real_time, 1, limit_s, on_progress)
    with contextlib.suppress(OSError):  # what is not empty has recordings to look at
        request.recordings.rmdir()
    return verdicts


def run_trials(
    request: Request,
    trials: Sequence[Trial],
    workers: int | None,
    limit_s: float,
    on_progress: OnProgress | None = None,
) -> list[JudgedTrial]:
    """Do trials and return a verdict on each. A trial whose scenario is not valid is refused.

    Raises BadInputError when the first one is not valid, because then the base scenario is wrong.
    """
    jobs: dict[int, Job] = {}
    outcomes: dict[int, Outcome] = {}
    for number, scenario in enumerate(scenarios(request, trials)):
        if isinstance(scenario, Scenario):
            jobs[number] = trials[number].job(scenario, limit_s=limit_s)
        elif number == 0:
            raise scenario
        else:
            outcomes[number] = Outcome("", REFUSED, str(scenario))
    by_key = {job.key: trials[number] for number, job in jobs.items()}

    def trouble(outcome: Outcome) -> str | None:
        judged = JudgedTrial(by_key[outcome.key], outcome)
        return None if judged.is_ok else judged.words

    outcomes |= dict(zip(jobs, run_jobs(list(jobs.values()), workers, on_progress, trouble), strict=True))
    return [JudgedTrial(trial, outcomes[number]) for number, trial in enumerate(trials)]


def results(request: Request, judged: Sequence[JudgedTrial]) -> Results:
    """Return what the catalogue gave."""
    head = ("fault", "link", "re-arm", "outcome", "applied", "recoveries", "after silence", "wall s", "verdict")
    failed = [one for one in judged if not one.is_ok]
    wall_s = sum(one.done.wall_s for one in judged)
    about = []
    for one in failed:
        where = "" if (file := one.done.recording) is None else f" ({next_command('hil', 'view', Path(file))})"
        about.append(f"  {one.words}{where}")
    return Results(
        f"The fault catalogue on {request.scenario}",
        not failed,
        f"{len(judged) - len(failed)} of {len(judged)} runs are as they should be, {wall_s:.0f} s of runs",
        about,
        [Table("Runs", [head, *(one.row() for one in judged)], numbers=(5, 6, 7))],
        [Plot("outcomes", partial(_draw_outcomes, judged=judged), size_in=(7.2, 3.0), title="How the runs came out")],
        {"passed": not failed, "runs": [one.plain() for one in judged]},
    )


def _draw_outcomes(axes: "list[Axes]", judged: Sequence[JudgedTrial]) -> None:
    came_out = [(one.where, str(one.done.details.get("ending", one.done.status))) for one in judged]
    links, outcomes = (list(dict.fromkeys(each)) for each in zip(*came_out, strict=True))
    for number, outcome in enumerate(outcomes):
        counts = [came_out.count((link, outcome)) for link in links]
        places = [place + 0.8 * number / len(outcomes) for place in range(len(links))]
        axes[0].bar(places, counts, 0.7 / len(outcomes), label=outcome, color=rgb(colour_of(number)))
    middle = 0.4 * (len(outcomes) - 1) / len(outcomes)
    axes[0].set_xticks([place + middle for place in range(len(links))], links)
    axes[0].set(ylabel="runs", xlim=(-1.0, len(links)))
    axes[0].locator_params("y", integer=True)
