"""A comparison: laws with their gains, each under each condition on each robot, and the results as rows."""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from hil.addons.batch.columns import shown_columns
from hil.addons.batch.job import PASSED, REFUSED, Job, Outcome, Signals, saved_signals
from hil.addons.batch.keys import make_job
from hil.addons.batch.pool import OnProgress, run_jobs
from hil.core.errors import BadInputError, nearest
from hil.core.options import build
from hil.core.scratch import scratch_folder
from hil.core.types import CommandMode
from hil.laws.law_registry import LAWS, load_law
from hil.runtime.robots import plant_start
from hil.scenario import SHIPPED_FMUS, Scenario, StartValue, format_value, load, read, set_texts, shipped_scenarios
from hil.scenario.tables import LimiterTable
from hil.scenario.toml_text import parse_value
from plant_fmu.shipped import variable_names

Sets = Mapping[str, StartValue]
Gains = dict[str, object]

MODE, LINK = "lockstep", "memory:"
TORQUES_N_M = (5.0, 1.8)
"""Limits of one wheel: what the paper's times need, and what a wheel carries without slip, 0.7 m g r / (4 √2)."""
MASS_FACTORS = (0.8, 1.2)
"""Factors on the plant's mass; its inertia and the law's model stay."""
FRICTIONS = (0.03, 0.08)
"""Coefficients of the plant's rolling friction; the law's model stays."""
OVER = ("nominal", "worst_over_mass", "worst")
"""Over which runs the worst of a figure is taken (``Row.worst``)."""
_OURS = ("loop.mode", "link.url")
_START = "plant.start."
_CURVES = ("loop.t_s", "error.planar_m", "truth.x_m", "truth.y_m", "reference.x_m", "reference.y_m")
_MOST_POINTS = 3000


class Drive(NamedTuple):
    """How wheels are driven; ``sets`` are keys of the scenario."""

    words: str
    mode: CommandMode
    sets: Sets


DRIVES = {
    "ideal": Drive("ideal torque", CommandMode.TORQUE, {"plant.start.drive": "torque"}),
    # 4 A of 1.25 N·m/A each are the 5 N·m; resistance and inductance are what [firmware] says.
    "motors": Drive(
        "motors, speed commands",
        CommandMode.SPEED,
        {"plant.start.drive": "current", "plant.start.current_limit_a": 4.0, "firmware.current_limit_a": 4.0},
    ),
}
ESTIMATORS: Mapping[str | None, Sets] = {
    None: {},
    "truth": {"estimator.source": "truth"},
    "truth-wheels": {"estimator.source": "truth", "estimator.twist": "wheels"},
    "odometry": {"estimator.source": "odometry"},
    "fused": {"estimator.source": "fused"},
}
"""Where a law's state comes from; ``truth-wheels`` is the true pose with the twist of wheels and gyro."""
CONTACTS: Mapping[str | None, Sets] = {None: {}} | {one: {"plant.start.contact": one} for one in ("rigid", "slip")}


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


class Condition(NamedTuple):
    """The condition of one table; ``estimator`` and ``contact`` are the scenario's own when None."""

    torque_n_m: float
    drive: str
    estimator: str | None
    contact: str | None

    @property
    def words(self) -> str:
        """The heading of its table."""
        estimator = "" if self.estimator is None else f", state from {self.estimator}"
        contact = "" if self.contact is None else f", {self.contact} contact"
        return f"{self.torque_n_m:g} N·m, {DRIVES[self.drive].words}{estimator}{contact}"

    @property
    def slug(self) -> str:
        """The name of its files."""
        return "-".join(filter(None, (f"{self.torque_n_m:g}nm", self.drive, self.estimator, self.contact)))

    @property
    def mode(self) -> CommandMode:
        """Whether the wheels get speed or torque commands."""
        return DRIVES[self.drive].mode

    def sets(self) -> Sets:
        """Return the keys of the scenario that make this condition."""
        return {
            "robot.torque_limit_n_m": self.torque_n_m,
            "firmware.torque_limit_n_m": self.torque_n_m,
            "controller.command": self.mode.name.lower(),
            **DRIVES[self.drive].sets,
            **ESTIMATORS[self.estimator],
            **CONTACTS[self.contact],
        }


class Variation(NamedTuple):
    """A robot that differs from the law's model: its mass over the nominal one, its friction (None: nominal)."""

    mass_factor: float = 1.0
    friction: float | None = None

    @property
    def words(self) -> str:
        """What differs, in words."""
        mass = "" if self.mass_factor == 1.0 else f"mass x {self.mass_factor:g}"
        friction = "" if self.friction is None else f"friction {self.friction:g}"
        return ", ".join(filter(None, (mass, friction))) or "nominal"

    def sets(self, mass_kg: float) -> Sets:
        """Return the keys of the scenario that make it; ``mass_kg`` is the nominal mass."""
        mass = {} if self.mass_factor == 1.0 else {"plant.start.mass_kg": self.mass_factor * mass_kg}
        return mass | ({} if self.friction is None else {"plant.start.friction_coefficient": self.friction})


def variations(*, quick: bool) -> list[Variation]:
    """Return the robots to run, the nominal one first; with ``quick`` only that one."""
    every = [Variation(*one) for one in itertools.product((1.0, *MASS_FACTORS), (None, *FRICTIONS))]
    return every[:1] if quick else every


class Entry(NamedTuple):
    """A law with its gains in either mode; ``law`` is as a scenario would have it, ``label`` as the user wrote it.

    ``hidden`` are gains of the scenario that differ from the law's defaults and that the label does not name.
    """

    label: str
    law: str
    gains: Mapping[CommandMode, Gains]
    hidden: Mapping[CommandMode, Gains]

    def title(self, mode: CommandMode) -> str:
        """Return its name in a table: the label, and in brackets the gains by which the law differs beyond it."""
        hidden = ", ".join(f"{name} = {format_value(value)}" for name, value in self.hidden[mode].items())
        return f"{self.label} ({hidden})" if hidden else self.label

    def scenario(self, scenario: Scenario) -> Scenario:
        """Return a scenario under this law, without expectations: laws are judged by their figures alone."""
        controller = replace(scenario.controller, law=self.law, gains=dict(self.gains[scenario.controller.mode]))
        return replace(scenario, controller=controller, expect=())


class Compared(NamedTuple):
    """One run of a row."""

    variation: Variation
    outcome: Outcome

    @property
    def figures(self) -> Mapping[str, float | None] | None:
        """The figures of the tables by name; None for a run that was refused or failed."""
        if self.outcome.status != PASSED:
            return None
        return {column.name: self.outcome.figures[column.name] for column in shown_columns()}

    @property
    def reasons(self) -> Mapping[str, str]:
        """For each figure that is None, one sentence."""
        why = self.outcome.details.get("reasons", {})
        return {name: why.get(name, "there is none") for name, value in (self.figures or {}).items() if value is None}

    @property
    def refused(self) -> str | None:
        """Why the run could not begin, such as a law that does not support the mode."""
        return self.outcome.reason if self.outcome.status == REFUSED else None

    @property
    def failed(self) -> str | None:
        """What ended the run, or why its figures do not describe the law."""
        return None if self.outcome.status in (PASSED, REFUSED) else self.outcome.reason


class Row(NamedTuple):
    """A law under a condition with all its runs, the nominal one first, and that one's curves if they were wanted."""

    entry: Entry
    condition: Condition
    runs: Sequence[Compared]
    curves: Signals | None = None

    def worst(self, name: str, over: str = "worst") -> float | None:
        """Return the worst value of a figure in some of the runs; None if one of these lacks it, which is worse still.

        ``over`` says which: ``nominal`` (that run), ``worst_over_mass`` (those with nominal friction), ``worst`` (all).
        """
        some = self.runs[:1] if over == "nominal" else self.runs
        if over == "worst_over_mass":
            some = [run for run in self.runs if run.variation.friction is None]
        values = [None if run.figures is None else run.figures[name] for run in some]
        known = [value for value in values if value is not None]
        return max(known) if len(known) == len(values) else None

    def notes(self) -> Iterator[str]:
        """Yield why figures are missing: one sentence for a law that refuses, or for each thing that went wrong."""
        if self.runs[0].refused is not None:
            yield f"refused: {self.runs[0].refused}"
            return
        troubles: dict[str, str] = {}
        for run in self.runs:
            if (trouble := run.failed or run.refused) is not None:
                troubles.setdefault(trouble, run.variation.words)
        yield from (f"failed ({words}): {trouble}" for trouble, words in troubles.items())
        first: dict[str, tuple[list[str], list[Compared]]] = {}  # by the reason of the first run that lacks a figure
        for column in shown_columns():
            if without := [run for run in self.runs if column.name in run.reasons]:
                first.setdefault(without[0].reasons[column.name], ([], without))[0].append(column.head)
        for reason, (heads, without) in first.items():
            of_runs = f" in {len(without)} of {len(self.runs)} runs, first with {without[0].variation.words}"
            among = of_runs if len(self.runs) > 1 else ""
            yield f"no {', '.join(heads)}{among}: {reason}"

    def plain(self) -> dict[str, Any]:
        """Return everything but the curves as plain values, for JSON."""
        of_run = ("figures", "reasons", "refused", "failed")
        return {
            "law": self.entry.label,
            "title": self.entry.title(self.condition.mode),
            "gains": self.entry.gains[self.condition.mode],
            "condition": self.condition._asdict(),
            "refused": self.runs[0].refused,
            **{over: {one.name: self.worst(one.name, over) for one in shown_columns()} for over in OVER},
            "notes": list(self.notes()),
            "runs": [run.variation._asdict() | {name: getattr(run, name) for name in of_run} for run in self.runs],
        }


class Comparison(NamedTuple):
    """All rows, condition by condition, the laws in the order in which they were named.

    ``limiter`` names the limit of torques beyond the law, and the cases without it.
    """

    scenario: str
    seed: int
    rows: Sequence[Row]
    limiter: str = ""

    def by_condition(self) -> dict[Condition, list[Row]]:
        """Return the rows of each condition, in order."""
        found: dict[Condition, list[Row]] = {}
        for row in self.rows:
            found.setdefault(row.condition, []).append(row)
        return found

    @property
    def failed(self) -> int:
        """How many runs failed, other than by the law refusing the mode."""
        return sum(run.failed is not None for row in self.rows for run in row.runs)

    def plain(self) -> dict[str, Any]:
        """Return everything but the curves as plain values, for JSON."""
        of_all = {"scenario": self.scenario, "seed": self.seed, "limiter": self.limiter, "passed": not self.failed}
        return {**of_all, "rows": [row.plain() for row in self.rows]}


def compare(
    request: Request, *, workers: int | None = None, limit_s: float = 120.0, on_progress: OnProgress | None = None
) -> Comparison:
    """Run the comparison and return its results, which do not depend on the number of ``workers``.

    Raises BadInputError, before anything is run, for a law, a gain, a scenario or a condition that does not exist.
    """
    check_laws(request.scenario, request.sets)
    tables = conditions(request)
    base = load(request.scenario, set=request.sets, mode=MODE, link=LINK, seed=request.seed)
    robots = variations(quick=request.quick)
    scenarios = {table: _scenarios(request, base, table, robots) for table in tables}
    named = entries(request.laws or list(LAWS.shipped), request.scenario, request.sets)
    rows = list(itertools.product(tables, named))
    done = []
    with scratch_folder("compare") as scratch:
        curved: dict[str, Any] = {"signals": _CURVES, "scratch": scratch} if request.curves else {}
        jobs = [
            make_job(entry.scenario(scenario), limit_s=limit_s, **(curved if number == 0 else {}))
            for table, entry in rows
            for number, scenario in enumerate(scenarios[table])
        ]
        outcomes = zip(jobs, run_jobs(jobs, workers, on_progress), strict=True)
        for table, entry in rows:
            some = list(itertools.islice(outcomes, len(robots)))
            runs = [Compared(robot, outcome) for robot, (_, outcome) in zip(robots, some, strict=True)]
            curves = None if runs[0].figures is None else _curves(some[0][0])
            done.append(Row(entry, table, runs, curves))
    limiter = _limiter_words(base.limiter)
    sources = [table.estimator or base.estimator.source for table in tables]
    if any(base.limiter.most_slip_m_s(source) != base.limiter.slip_m_s for source in sources):
        limiter += " With odometry, which takes the wheels' word, slip is not limited."
    return Comparison(base.name, base.loop.seed, done, limiter)


def _limiter_words(table: LimiterTable) -> str:
    kept = {
        "protection": "torques fade before the robot's overspeed",
        "limit": "torques fade before robot.speed_limit_rad_s",
        "off": "no wheel speed is kept (limiter.torque_speed is off)",
    }[table.torque_speed]
    slip = f"wheels slip at most {table.slip_m_s:g} m/s" if math.isfinite(table.slip_m_s) else "slip is not limited"
    return f"The limiter between law and wheels: {kept}, and {slip}."


def _curves(job: Job) -> Signals | None:
    """Return the signals that a job left, thinned to the resolution of a picture."""
    signals = saved_signals(job)
    return {name: values[:: -(-len(values) // _MOST_POINTS) or 1] for name, values in signals.items()} or None


def _scenarios(request: Request, base: Scenario, table: Condition, robots: Sequence[Variation]) -> list[Scenario]:
    """Return the scenario of each robot under a condition. Raises BadInputError for what the plant does not have."""
    known = variable_names(base.plant.fmu) if base.plant.fmu in SHIPPED_FMUS else ()
    mass_kg = float(plant_start(base, {"mass_kg"})["mass_kg"]) if known else 0.0
    sources = read(request.scenario)
    scenarios = []
    for robot in robots:
        changes = {**table.sets(), **robot.sets(mass_kg)}
        if missing := [key for key in changes if key.startswith(_START) and key.removeprefix(_START) not in known]:
            raise BadInputError(
                f"scenario {request.scenario}: plant.fmu = {base.plant.fmu!r} has no "
                f"{missing[0].removeprefix(_START)}, which a comparison under {table.words} needs; use the plant "
                "'mecanum'"
            )
        sets = [*request.sets, *set_texts(changes)]
        scenarios.append(sources.scenario(set=sets, mode=MODE, link=LINK, seed=request.seed))
    return scenarios


def check_laws(scenario: str, sets: Sequence[str]) -> None:
    """Raise BadInputError for a law in the place of the scenario, which was forgotten, and for a law among ``sets``."""
    law = scenario.partition(",")[0]
    if scenario not in shipped_scenarios() and (LAWS.is_shipped(law) or ":" in law):
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


def conditions(request: Request) -> list[Condition]:
    """Return the conditions. Raises BadInputError for unknown ones, and for ``sets`` that would make them wrong."""
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
                raise BadInputError(f"{option} {name}: unknown{nearest(str(name), map(str, filter(None, known)))}")
        if len(set(values)) != len(values):
            raise BadInputError(f"{option}: one is named twice in {', '.join(map(str, values))}; name each once")
    each = (request.torques_n_m, request.drives, request.estimators or (None,), request.contacts or (None,))
    tables = [Condition(*one) for one in itertools.product(*each)]
    reserved = {key for table in tables for key in table.sets()}
    for text in request.sets:
        if (key := text.partition("=")[0].strip()) in reserved:
            raise BadInputError(
                f"--set {text}: a comparison sets {key} itself, under --torque, --drive, --estimator and --contact"
            )
    return tables


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
