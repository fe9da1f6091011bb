"""What a comparison runs: laws with their gains, each under each condition on each robot, as jobs."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.batch.comparison.conditions import CONTACTS, DRIVES, ESTIMATORS, Condition, Variation, conditions, variations
from hil.batch.comparison.result import Comparison, Curves, Entry, Gains, Row, Run
from hil.batch.job import Job
from hil.batch.keys import make_job
from hil.batch.plan import OnProgress, run_jobs
from hil.core.errors import BadInputError, nearest
from hil.core.options import build
from hil.core.scratch import scratch_folder
from hil.core.types import WHEEL_NAMES, CommandMode
from hil.laws.registry import SHIPPED, load_law
from hil.runtime.robots import plant_start
from hil.scenario import SHIPPED_FMUS, Scenario, format_value, load, read, set_texts, shipped_scenarios
from hil.scenario.toml_text import parse_value
from plant_fmu.shipped import variable_names

MODE, LINK = "lockstep", "memory:"
_OURS = ("loop.mode", "link.url")
_START = "plant.start."
_CURVES = ("loop.t_s", "error.planar_m", "truth.x_m", "truth.y_m", "reference.x_m", "reference.y_m")
_CURRENTS = tuple(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES)
_MOST_POINTS = 3000


class Request(NamedTuple):
    """What the user wants to compare; without ``laws`` all shipped laws.

    ``estimators`` and ``contacts`` are the scenario's own when empty. ``quick`` leaves out the robots other than
    nominal, ``curves`` asks for the signals that pictures need.
    """

    laws: Sequence[str]
    scenario: str
    sets: Sequence[str]
    seed: int | None
    torques_n_m: Sequence[float]
    drives: Sequence[str]
    estimators: Sequence[str] = ()
    contacts: Sequence[str] = ()
    quick: bool = False
    curves: bool = False


def compare(
    request: Request, *, workers: int | None = None, limit_s: float = 120.0, on_progress: OnProgress | None = None
) -> Comparison:
    """Run the comparison and return its results.

    ``workers`` is the number of processes, by default one per processor; the figures do not depend on it. A run that
    takes more than ``limit_s`` of wall-clock time is ended and counts as failed, as does one whose process ends.
    ``on_progress`` is called as ``hil.batch.plan.run_jobs`` does.

    Raises BadInputError, before anything is run, for a law, a gain, a scenario or a condition that does not exist.
    """
    check_laws(request.scenario, request.sets)
    _check_request(request)
    tables = conditions(request.torques_n_m, request.drives, request.estimators, request.contacts)
    _check_sets(request.sets, tables)
    base = load(request.scenario, set=request.sets, mode=MODE, link=LINK, seed=request.seed)
    robots = variations(quick=request.quick)
    scenarios = {table: _scenarios(request, base, table, robots) for table in tables}
    named = entries(request.laws or list(SHIPPED), request.scenario, request.sets)
    rows = list(itertools.product(tables, named))
    done = []
    with scratch_folder("compare") as scratch:
        jobs = [
            _job(scenario, entry, table, limit_s, scratch if request.curves and number == 0 else None)
            for table, entry in rows
            for number, scenario in enumerate(scenarios[table])
        ]
        outcomes = zip(jobs, run_jobs(jobs, workers, on_progress), strict=True)
        for table, entry in rows:
            some = list(itertools.islice(outcomes, len(robots)))
            runs = [Run(robot, outcome) for robot, (_, outcome) in zip(robots, some, strict=True)]
            curves = None if runs[0].figures is None else _curves(some[0][0], base.firmware.torque_constant_n_m_a)
            done.append(Row(entry, table, runs, curves))
    limiter = base.limiter.words
    sources = [table.estimator or base.estimator.source for table in tables]
    if any(base.limiter.most_slip_m_s(source) != base.limiter.slip_m_s for source in sources):
        limiter += " With odometry, which takes the wheels' word, slip is not limited."
    return Comparison(base.name, base.loop.seed, base.loop.duration_s, done, limiter)


def _job(scenario: Scenario, entry: Entry, table: Condition, limit_s: float, scratch: Path | None) -> Job:
    """Return a law's job in a scenario; with a scratch folder it leaves there the signals that pictures need.

    The scenario's expectations are left out, because laws are judged by their figures alone.
    """
    controller = replace(scenario.controller, law=entry.law, gains=dict(entry.gains[table.mode]))
    options = {} if scratch is None else {"signals": [*_CURVES, *_CURRENTS]}
    job = make_job(replace(scenario, controller=controller, expect=()), options=options, limit_s=limit_s)
    return job._replace(signals_file="" if scratch is None else str(scratch / f"{job.key}.npz"))


def _curves(job: Job, torque_constant_n_m_a: float) -> Curves | None:
    """Return the signals that a job left, thinned to what a picture can show, and the wheels' torques; None without."""
    if not job.signals_file:
        return None
    with np.load(job.signals_file) as signals:
        every = -(-len(signals["loop.t_s"]) // _MOST_POINTS) or 1
        curves = {name: signals[name][::every] for name in _CURVES}
        for wheel, current in zip(WHEEL_NAMES, _CURRENTS, strict=True):
            curves[f"torque.{wheel}"] = torque_constant_n_m_a * signals[current][::every]
    return curves


def _scenarios(request: Request, base: Scenario, table: Condition, robots: Sequence[Variation]) -> list[Scenario]:
    """Return the scenario of each robot under a condition. Raises BadInputError for what the plant does not have."""
    if base.plant.fmu not in SHIPPED_FMUS:
        raise BadInputError(
            f"scenario {base.name}: plant.fmu = {base.plant.fmu!r} is no plant of which is known how to change mass, "
            "friction and drive; compare laws on the plant 'mecanum'"
        )
    known = variable_names(base.plant.fmu)
    mass_kg = float(plant_start(base, {"mass_kg"})["mass_kg"])
    sources = read(request.scenario)
    scenarios = []
    for robot in robots:
        changes = {**table.sets(), **robot.sets(mass_kg)}
        for key in changes:
            name = key.removeprefix(_START)
            if name != key and name not in known:
                raise BadInputError(
                    f"scenario {request.scenario}: plant.fmu = {base.plant.fmu!r} has no {name}, which a comparison "
                    f"under {table.words} needs; use the plant 'mecanum'"
                )
        sets = [*request.sets, *set_texts(changes)]
        scenarios.append(sources.scenario(set=sets, mode=MODE, link=LINK, seed=request.seed))
    return scenarios


def check_laws(scenario: str, sets: Sequence[str]) -> None:
    """Raise BadInputError for a law in the place of the scenario, which was forgotten, and for a law among ``sets``."""
    law = scenario.partition(",")[0]
    if scenario not in shipped_scenarios() and (law in SHIPPED or ":" in law):
        raise BadInputError(
            f"scenario {scenario}: this is a law; the last argument is the scenario: one of hil list scenarios, or "
            "a file"
        )
    for text in sets:
        key = text.partition("=")[0].strip()
        if key in _OURS:
            raise BadInputError(f"--set {text}: a comparison sets {key} itself; it runs in lockstep over memory:")
        if key.startswith("controller.") and key != "controller.command":
            raise BadInputError(f"--set {text}: laws and gains are named together, as in: hil compare dsc,k1_1_s=8 ...")


def _check_request(request: Request) -> None:
    """Raise BadInputError for unknown conditions."""
    for torque_n_m in request.torques_n_m:
        if not torque_n_m > 0.0:
            raise BadInputError(f"--torque {torque_n_m:g}: expected the limit of a wheel in N·m, more than 0")
    for option, values, known in (
        ("--torque", request.torques_n_m, request.torques_n_m),
        ("--drive", request.drives, DRIVES),
        ("--estimator", request.estimators, ESTIMATORS),
        ("--contact", request.contacts, CONTACTS),
    ):
        for name in values:
            if name not in known:
                raise BadInputError(f"{option} {name}: unknown{nearest(str(name), map(str, known))}")
        if len(set(values)) != len(values):
            raise BadInputError(f"{option}: one is named twice in {', '.join(map(str, values))}; name each once")


def _check_sets(sets: Sequence[str], tables: Sequence[Condition]) -> None:
    """Refuse to change what the comparison itself sets, because its tables would then be wrong."""
    reserved = {key for table in tables for key in table.sets()}
    for text in sets:
        key = text.partition("=")[0].strip()
        if key in reserved:
            raise BadInputError(
                f"--set {text}: a comparison sets {key} itself, under --torque, --drive, --estimator and --contact"
            )


def entries(texts: Sequence[str], scenario: str, sets: Sequence[str]) -> list[Entry]:
    """Return the laws with gains that texts such as ``dsc,k1_1_s=8`` or ``./my_law.py:MyLaw,speed.gain=3`` name.

    In the scenario's mode the scenario's own law starts from the scenario's gains; otherwise a law starts from its
    defaults. The text's gains override these: for both modes or, after ``torque.`` or ``speed.``, for one. Raises
    BadInputError for a law that does not exist or is named twice, and for gains that it does not take.
    """
    for text in texts:
        if texts.count(text) > 1:
            raise BadInputError(f"law {text}: it is named twice; name it once, or with other gains, as in {text},key=1")
    return [_entry(text, scenario, sets) for text in texts]


def _entry(text: str, scenario: str, sets: Sequence[str]) -> Entry:
    law, *assignments = text.split(",")
    given = _given(text, assignments)
    base = load(scenario, set=[*sets, f"controller.law={format_value(law)}"])
    kind = getattr(load_law(base.controller.law, base.directory), "Options", None)
    own = {mode: dict(base.controller.gains) if base.controller.mode is mode else {} for mode in CommandMode}
    gains = {mode: own[mode] | given[mode] for mode in CommandMode}
    for mode in CommandMode:
        if kind is not None:
            build(kind, gains[mode], law)
        elif gains[mode]:
            raise BadInputError(f"law {text}: it has no dataclass Options, so it takes no gains; leave them out")
    defaults = {field.name: field.default for field in dataclasses.fields(kind)} if kind is not None else {}
    hidden = {
        mode: {name: value for name, value in own[mode].items() if name not in given[mode] and value != defaults[name]}
        for mode in CommandMode
    }
    return Entry(text, base.controller.law, gains, hidden)


def _given(text: str, assignments: Sequence[str]) -> Mapping[CommandMode, Gains]:
    """Return the gains that a text gives, for each mode."""
    given: dict[CommandMode, Gains] = {mode: {} for mode in CommandMode}
    for assignment in assignments:
        key, equals, value = assignment.partition("=")
        scope, dot, name = key.strip().rpartition(".")
        modes = [mode for mode in CommandMode if not dot or mode.name.lower() == scope]
        if not (equals and name and modes):
            raise BadInputError(
                f"law {text}: {assignment!r} is not a gain; expected key=value, torque.key=value or speed.key=value, "
                "as in dsc,k1_1_s=8"
            )
        for mode in modes:
            given[mode][name] = parse_value(value.strip())
    return given
