"""How laws hold in random cases: ``hil compare --robust N``. Each run gets one verdict, from its last third."""

import itertools
import math
import random
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hil.addons.batch.comparison.comparison import LINK, MODE, Entry, check_laws, entries
from hil.addons.batch.job import ENDED, PASSED, REFUSED, Job, Outcome
from hil.addons.batch.keys import make_job
from hil.addons.batch.pool import OnProgress, run_jobs
from hil.addons.batch.results_page import Results, Table
from hil.addons.batch.run import attempt, kept_robot
from hil.cli.output import next_command
from hil.core.model import GRAVITY_M_S2, RobotModel
from hil.core.types import WHEEL_NAMES, Pose
from hil.faults.kinds import BATTERY_V, BATTERY_VARIABLE
from hil.judge.effort import Effort
from hil.judge.measure import NoFigureError, RunSetup, Series
from hil.judge.result import RunResult
from hil.laws.law_registry import LAWS
from hil.references import feasibility, make_reference
from hil.robot.driver_registry import OUR_DRIVER
from hil.runtime.assembly import RunOptions
from hil.runtime.run_parts import RunParts
from hil.scenario import Scenario, read, set_texts

KIND = f"{__name__}:run"
"""The kind of job that runs a case and measures its last third."""
FAILED = "failed"
VERDICTS = ("held", "over 3 mm", "limit cycle", "diverged", "stopped", FAILED)
"""From best to worst; a run has the worst that fits.

Over 3 mm: the error, rms over the last third. Limit cycle: the torque varies by more than 20 N·m/s a wheel, and twice
what the reference itself needs. Diverged: more than 100 mm away, rms. Stopped: the robot, or the link, ended the run.
Failed: the law raised an error, or the run hung.
"""
_DIVERGED_M, _OFF_M = 0.1, 0.003
_VARIATION_N_M_S, _TIMES = 20.0, 2.0
_CURRENTS = tuple(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES)
_VARIATION = "torque_variation_n_m_per_s"

RATES_HZ = (100, 200, 250, 500, 1000)
CURRENT_DRIVES = ("current", "voltage")
MAKERS = ("odrive", "vesc")
"""Motors of other makers, half of the cases: each does its speed loop by itself, and acknowledges no command."""
_TORQUE_N_M = 1.5, 5.0
_MASS = 0.5, 2.0
_FRICTION = 0.2, 4.0
_GRIP = 0.3, 1.0
_FAR_M, _LATENCY_S = 1.5, 0.01
_HIDDEN_S = 0.001, 0.02
_SPEED_M_S = 0.1, 0.6
_SIZE_M = 0.5, 1.5
_YAW_RATE_RAD_S = 0.8
_OF_NO_LOAD = 0.9
_SHARE = 0.8
"""Of torque, speed and grip: a reference that needs no more of the true robot can be followed."""

# Way around a Gerono eight over its half length, and around a square over its side.
_EIGHT, _SQUARE = 6.097, 4.0


class RandomCase(NamedTuple):
    """A case: the keys of the scenario that make it, and whether the true robot's wheels can follow its reference."""

    number: int
    sets: Mapping[str, Any]
    can_follow: bool


class _Draw:
    def __init__(self, seed: int, number: int) -> None:
        self._random = random.Random(f"{seed} case {number}").random

    def within(self, low: float, high: float, digits: int = 4) -> float:
        return round(low + (high - low) * self._random(), digits)

    def factor(self, low: float, high: float) -> float:
        """Return a factor whose logarithm is uniform, so that a half is as likely as twice."""
        return math.exp(self.within(math.log(low), math.log(high), 12))

    def one_of(self, values: Sequence[Any]) -> Any:
        return values[int(len(values) * self._random())]

    def half(self) -> bool:
        return self._random() < 0.5


def cases(base: Scenario, count: int, seed: int, given: Sequence[str]) -> list[RandomCase]:
    """Return the first ``count`` cases of a seed over a scenario; keys in ``given`` stay as the scenario has them.

    Mass, inertia and friction are times what ``[robot]`` believes, which stays. Half of the cases have a command mode
    each, half of them a slippery floor, and half of them an unreported latency of commands.
    """
    return [_case(base, number, _Draw(seed, number), given) for number in range(count)]


def _case(base: Scenario, number: int, draw: _Draw, given: Sequence[str]) -> RandomCase:
    torque_n_m = draw.within(*_TORQUE_N_M, 2)
    is_torque = draw.half()
    drive = draw.one_of(("torque", *CURRENT_DRIVES))
    mass, friction = draw.factor(*_MASS), draw.factor(*_FRICTION)
    slips, grip = draw.half(), draw.within(*_GRIP, 2)
    is_hidden, hidden_s = draw.half(), draw.within(*_HIDDEN_S, 3)
    rate_hz = draw.one_of(RATES_HZ)
    driver = draw.one_of((OUR_DRIVER, OUR_DRIVER, *MAKERS))
    told_s = draw.within(0.0, _LATENCY_S, 3), draw.within(0.0, _LATENCY_S, 3)
    reference = _reference(draw)
    robot = base.robot
    sets: dict[str, Any] = {
        "controller.command": "torque" if is_torque else "speed",
        "robot.torque_limit_n_m": torque_n_m,
        "firmware.torque_limit_n_m": torque_n_m,
        "plant.start.drive": drive,
        "plant.start.mass_kg": round(mass * robot.mass_kg, 3),
        "plant.start.inertia_kg_m2": round(mass * robot.inertia_kg_m2, 4),
        "plant.start.friction_coefficient": round(friction * robot.friction_coefficient, 4),
        "plant.start.contact": "slip" if slips else "rigid",
        "loop.rate_hz": rate_hz,
        "link.command_latency_s": told_s[0],
        "link.feedback_latency_s": told_s[1],
        "reference": reference,
    }
    if driver != OUR_DRIVER:
        sets["device.driver"] = driver
    if slips:
        sets["plant.start.grip_coefficient"] = grip
    if drive in CURRENT_DRIVES:
        limit_a = round(torque_n_m / base.firmware.torque_constant_n_m_a, 3)
        sets |= {"plant.start.current_limit_a": limit_a, "firmware.current_limit_a": limit_a}
        sets["robot.speed_limit_rad_s"] = _motor_speed_rad_s(base)
    if is_hidden:
        sets["fault"] = [{"kind": "delay", "target": "command", "value": hidden_s}]
    if any(_covers(key, "reference") for key in given):
        reference = {"kind": base.reference.kind, **base.reference.options}
    kind = dict(reference)
    source = make_reference(str(kind.pop("kind")), kind, base.directory)
    sets |= _start(draw, source.at(0.0).pose)
    sets = {key: value for key, value in sets.items() if not any(_covers(one, key) for one in given)}
    true = _true_robot(base, sets)
    needs = feasibility(source, true, base.loop.duration_s, base.loop.period_ns * 1e-9)
    return RandomCase(number, sets, not needs.sentences)


def _motor_speed_rad_s(base: Scenario) -> float:
    """Return the speed limit of a robot whose motors have a battery: beyond their no-load speed they only brake."""
    battery_v = float(base.plant.start.get(BATTERY_VARIABLE, BATTERY_V))
    no_load_rad_s = battery_v / base.firmware.torque_constant_n_m_a
    return min(base.robot.speed_limit_rad_s, round(_OF_NO_LOAD * no_load_rad_s, 2))


def _covers(given: str, key: str) -> bool:
    return given == key or given.startswith(f"{key}.") or key.startswith(f"{given}.")


def _reference(draw: _Draw) -> dict[str, Any]:
    """Return a ``[reference]``: a circle, an eight, a square, or a circle on which the robot turns by itself."""
    kind = draw.one_of(("circle", "figure_eight", "rounded_square", "spin"))
    size_m, speed_m_s = draw.within(*_SIZE_M, 2), draw.within(*_SPEED_M_S, 2)
    heading = {"heading": draw.one_of(("fixed", "path")), "heading_rad": draw.within(-math.pi, math.pi, 3)}
    yaw_rate = draw.within(-_YAW_RATE_RAD_S, _YAW_RATE_RAD_S, 2)
    if kind == "circle":
        return {"kind": kind, "radius_m": size_m, "period_s": round(2.0 * math.pi * size_m / speed_m_s, 2), **heading}
    if kind == "figure_eight":
        return {"kind": kind, "half_length_m": size_m, "period_s": round(_EIGHT * size_m / speed_m_s, 2), **heading}
    if kind == "rounded_square":
        square = {"side_m": 2.0 * size_m, "corner_m": round(0.6 * size_m, 3)}
        return {"kind": kind, **square, "period_s": round(_SQUARE * 2.0 * size_m / speed_m_s, 2), **heading}
    return {"kind": kind, "path": "circle", "radius_m": size_m, "speed_m_s": speed_m_s, "yaw_rate_rad_s": yaw_rate}


def _start(draw: _Draw, first: Pose) -> dict[str, float]:
    """Return a start up to 1.5 m from the reference's, and turned by any angle."""
    far_m, way_rad = draw.within(0.0, _FAR_M), draw.within(-math.pi, math.pi)
    turned_rad = draw.within(-math.pi, math.pi)
    return {
        "plant.start.start_x_m": round(first.x_m + far_m * math.cos(way_rad), 4),
        "plant.start.start_y_m": round(first.y_m + far_m * math.sin(way_rad), 4),
        "plant.start.start_heading_rad": round(math.remainder(first.heading_rad + turned_rad, 2.0 * math.pi), 4),
    }


def _true_robot(base: Scenario, sets: Mapping[str, Any]) -> RobotModel:
    """Return the robot as it is, with the part of its limits that a reference may need."""
    start = {**base.plant.start, **{key.removeprefix("plant.start."): value for key, value in sets.items()}}
    robot = base.robot
    mass_kg = float(start.get("mass_kg", robot.mass_kg))
    torque_n_m = float(sets.get("robot.torque_limit_n_m", robot.torque_limit_n_m))
    if start.get("contact") == "slip":
        # A wheel holds along its roller's axis, at 45 degrees, up to the grip times its load.
        grip = float(start.get("grip_coefficient", 0.7))
        torque_n_m = min(torque_n_m, grip * mass_kg * GRAVITY_M_S2 * robot.wheel_radius_m / (4.0 * math.sqrt(2.0)))
    return replace(
        robot,
        mass_kg=mass_kg,
        inertia_kg_m2=float(start.get("inertia_kg_m2", robot.inertia_kg_m2)),
        friction_coefficient=float(start.get("friction_coefficient", robot.friction_coefficient)),
        torque_limit_n_m=_SHARE * torque_n_m,
        speed_limit_rad_s=_SHARE * float(sets.get("robot.speed_limit_rad_s", robot.speed_limit_rad_s)),
    )


class Tried(NamedTuple):
    """A law in a case; ``command`` repeats it."""

    entry: Entry
    case: RandomCase
    outcome: Outcome
    command: Sequence[str]

    @property
    def error_m(self) -> float | None:
        """The planar error, rms over the last third."""
        return self.outcome.figures.get("error_m")

    @property
    def verdict(self) -> str:
        """One of ``VERDICTS``, or ``refused``."""
        status, figures = self.outcome.status, self.outcome.figures
        if status == REFUSED:
            return REFUSED
        if status != PASSED:
            return "stopped" if status == ENDED else FAILED
        if not figures["error_m"] <= _DIVERGED_M:  # NaN is far too
            return "diverged"
        if figures["variation"] > max(_VARIATION_N_M_S, _TIMES * figures["needed"]):
            return "limit cycle"
        return "over 3 mm" if figures["error_m"] > _OFF_M else "held"

    def plain(self) -> dict[str, Any]:
        """Return it as plain values, for JSON."""
        return {
            "law": self.entry.label,
            "case": self.case.number,
            "can_follow": self.case.can_follow,
            "verdict": self.verdict,
            "reason": self.outcome.reason,
            "figures": dict(self.outcome.figures),
            "command": list(self.command),
        }

    def lines(self) -> Iterator[str]:
        """Yield the verdict, and the command that repeats the run."""
        reason = f": {self.outcome.reason}" if self.outcome.reason else ""
        follows = "" if self.case.can_follow else " (which wheels cannot follow)"
        yield f"{self.entry.label}, case {self.case.number}{follows}, {self.verdict}{reason}"
        yield f"  {next_command(*self.command)}"


def try_laws(
    laws: Sequence[str],
    scenario: str,
    count: int,
    sets: Sequence[str],
    seed: int | None = None,
    *,
    workers: int | None = None,
    limit_s: float = 120.0,
    on_progress: OnProgress | None = None,
) -> tuple[Scenario, list[Tried]]:
    """Run laws (without any, all shipped ones) in the same ``count`` cases; workers and limits as in ``compare``.

    A key among ``sets`` is not drawn. Returns the base scenario, and the runs, law by law. Raises BadInputError as
    ``compare`` does.
    """
    check_laws(scenario, sets)
    sources = read(scenario)
    base = sources.scenario(set=sets, mode=MODE, link=LINK, seed=seed)
    given = [text.partition("=")[0].strip() for text in sets]
    drawn = cases(base, count, base.loop.seed, given)
    scenarios = [
        sources.scenario(set=[*sets, *set_texts(case.sets)], mode=MODE, link=LINK, seed=seed) for case in drawn
    ]
    named = entries(laws or list(LAWS.shipped), scenario, sets)
    pairs = [(entry, case, one) for entry in named for case, one in zip(drawn, scenarios, strict=True)]
    jobs = [make_job(entry.scenario(one), KIND, limit_s=limit_s) for entry, _, one in pairs]
    outcomes = run_jobs(jobs, workers, on_progress)
    seeds = () if seed is None else ("--seed", str(seed))
    return base, [
        Tried(entry, case, outcome, (*_command(scenario, sets, case, entry), *seeds))
        for (entry, case, _), outcome in zip(pairs, outcomes, strict=True)
    ]


def results(base: Scenario, tries: Sequence[Tried]) -> Results:
    """Return what laws did in random cases: how often each held, and what repeats each other run."""
    failed = sum(one.verdict == FAILED for one in tries)
    about = [line for one in tries if one.verdict != "held" for line in one.lines()]
    name, seed = base.name, base.loop.seed
    return Results(
        f"Laws in random cases of {name}, seed {seed}",
        not failed,
        f"{failed} of {len(tries)} runs failed" if failed else f"{len(tries)} runs, none of which failed",
        about,
        [Table("Random cases", list(_rows(tries)), numbers=range(2, 5 + len(VERDICTS)))],
        [],
        {"scenario": name, "seed": seed, "passed": not failed, "trials": [one.plain() for one in tries]},
    )


def _rows(tries: Sequence[Tried]) -> Iterator[tuple[str, ...]]:
    """Yield a table: how often each verdict was given, with the references that wheels can follow and the rest."""
    yield ("law", "the wheels", "cases", *VERDICTS, REFUSED, "rms mm, median", "worst")
    words = {True: "can follow", False: "cannot"}
    for label, follows in itertools.product(dict.fromkeys(one.entry.label for one in tries), words):
        some = [one for one in tries if (one.entry.label, one.case.can_follow) == (label, follows)]
        if some:
            count = Counter(one.verdict for one in some)
            errors = [1e3 * one.error_m for one in some if one.error_m is not None and math.isfinite(one.error_m)]
            spread = (f"{np.median(errors):.3f}", f"{max(errors):.3g}") if errors else ("-", "-")
            yield (label, words[follows], str(len(some)), *(str(count[one]) for one in (*VERDICTS, REFUSED)), *spread)


def _command(scenario: str, sets: Sequence[str], case: RandomCase, entry: Entry) -> list[str]:
    law = {"controller.law": entry.label.partition(",")[0]}
    mode = case.sets.get("controller.command")
    gains = {
        f"controller.gains.{name}": value
        for of, own in entry.gains.items()
        if mode is None or of.name.lower() == mode
        for name, value in own.items()
    }
    texts = [*sets, *set_texts({**case.sets, **law, **gains})]
    return ["hil", "run", scenario, "--lenient", *(word for text in texts for word in ("--set", text))]


def run(job: Job, scenario: Scenario) -> Outcome:
    """Run a case and measure its last third: the kind of job of this module, for worker processes.

    Figures are ``error_m``, the planar error (rms); ``variation``, the torque's [N·m/s a wheel]; and ``needed``, that
    of the torques that the reference takes by the true mass and friction.
    """

    def judge(result: RunResult) -> Outcome:
        if result.failure is not None:
            return Outcome(job.key, ENDED, str(result.failure))
        t_s = result.signals["loop.t_s"]
        last = t_s >= t_s[-1] * 2.0 / 3.0
        error_m = result.signals["error.planar_m"][last]
        constant = scenario.firmware.torque_constant_n_m_a
        currents = {name: result.signals[name][last] for name in _CURRENTS}
        figures = {
            "error_m": float(np.sqrt(np.mean(error_m**2))),
            "variation": _variation(t_s[last], currents, constant),
            "needed": _variation(t_s[last], _needed_a(scenario, t_s[last], constant), constant),
        }
        return Outcome(job.key, PASSED, None, figures)

    return attempt(job, scenario, judge, RunOptions(make_robot=kept_robot(), keep_signals=True))


def _variation(t_s: Series, currents_a: Mapping[str, Series], torque_constant_n_m_a: float) -> float:
    measure = Effort(RunSetup(torque_constant_n_m_a))
    measure.add({"loop.t_s": t_s, **currents_a})
    try:
        return measure.value(_VARIATION)
    except NoFigureError:  # a board that measures no currents
        return math.nan


def _needed_a(scenario: Scenario, t_s: Series, torque_constant_n_m_a: float) -> dict[str, Series]:
    """Return the currents with which the true robot would follow its reference without an error."""
    start = scenario.plant.start
    names = ("mass_kg", "inertia_kg_m2", "friction_coefficient")
    true = replace(scenario.robot, **{name: float(start[name]) for name in names if name in start})
    source = RunParts(scenario).reference
    torques = []
    for one in t_s:
        pose, twist, acceleration = source.at(float(one))
        torques.append(true.wheel_torques(acceleration, twist, pose.heading_rad, twist))
    return dict(zip(_CURRENTS, np.array(torques).T / torque_constant_n_m_a, strict=True))
