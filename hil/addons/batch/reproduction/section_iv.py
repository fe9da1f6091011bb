"""The runs that reproduce section IV, and our assumptions where the paper says nothing."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, NamedTuple

from hil.addons.batch.reproduction import published
from hil.laws.law_registry import load_law
from hil.scenario import format_value, load, resolved

CIRCLE = "paper_circle"
CIRCLE_DSC = "paper_circle_dsc"
EXPERIMENT = "paper_experiment"
EXPERIMENT_PERIOD_S = 0.005
"""Command period of the experiment."""

Settings = Mapping[str, object]


class PaperRun(NamedTuple):
    """A run to do: a shipped scenario and the values that are set in it.

    ``group`` is the table of results that it belongs to. ``row`` has the values that tell it from the table's other
    rows. ``records`` asks for a recording.
    """

    name: str
    group: str
    row: Mapping[str, str | float]
    scenario: str
    sets: Settings
    records: bool = False


class Result(NamedTuple):
    """The result of a case: its figures, and what ended the run early or prevented it."""

    case: PaperRun
    figures: Mapping[str, float | None]
    failure: str | None


class Choice(NamedTuple):
    """One of several ways to run the circle: its text for the tables, and its settings."""

    words: str
    sets: Settings


LAWS: dict[str, tuple[str, Choice]] = {
    "dsc": (CIRCLE_DSC, Choice("DSC, K1 = 15, K2 = 40", {})),
    "afdsc": (CIRCLE, Choice("AFDSC, tables as printed", {})),
    "corrected": (CIRCLE, Choice("AFDSC, tables corrected", {"controller.law": "afdsc_corrected"})),
    "constant": (
        CIRCLE_DSC,
        Choice("constant K1 = 10, K2 = 20", {"controller.gains.k1_1_s": 10.0, "controller.gains.k2_1_s": 20.0}),
    ),
}
"""By name: the scenario, and what is set in it. ``constant`` has the gains that the tables give at zero error."""

FILTERS: dict[str, Choice] = {
    "common": Choice(f"{published.COMMON_FILTER_S:g} s", {"controller.gains.filter_s": published.COMMON_FILTER_S}),
    "short": Choice(f"{published.SHORT_FILTER_S:g} s", {"controller.gains.filter_s": published.SHORT_FILTER_S}),
}

# More than any law asks for in these runs, so that the motors' own limit is the only one.
_NO_COMMON_LIMIT = {"robot.torque_limit_n_m": 15.99, "firmware.torque_limit_n_m": 15.99}
LIMITS: dict[str, Choice] = {
    "together": Choice("5 N·m, four wheels scaled together", {}),
    "each": Choice(
        "5 N·m, each motor by itself",
        {
            **_NO_COMMON_LIMIT,
            "plant.start.drive": "current",
            "plant.start.current_limit_a": 4.0,  # of 1.25 N·m each
            "plant.start.battery_voltage_v": 200.0,  # no limit of its own, as the paper has none
        },
    ),
    "grip": Choice(
        "1.8 N·m, four wheels scaled together", {"robot.torque_limit_n_m": 1.8, "firmware.torque_limit_n_m": 1.8}
    ),
}
"""``grip`` is what a wheel carries without slip on a floor of 0.7: grip m g / 4 r / √2."""

DRIVEN: dict[str, Choice] = {
    "afdsc torque": Choice("AFDSC, torque", {}),
    "dsc torque": Choice("DSC, torque", {"controller.law": "dsc"}),
    "afdsc speed": Choice("AFDSC, speed", {"controller.command": "speed"}),
}
LATENCIES_MS: dict[str, tuple[int, ...]] = {
    "afdsc torque": (0, 10, 20, 30, 40, 50, 60, 70),
    "dsc torque": (0, 20, 30, 40, 60),
    "afdsc speed": (0, 20, 40, 60),
}
STARTS_X_M = (0.0, 1.0, 2.0)
"""The reference is at the far left of the circle when the host comes, so that these are 1, 2 and 3 m away."""
TOP_SPEEDS_RAD_S = (20.0, 12.0, 9.0)
"""The circle itself needs 7.9 rad/s, at 45 degrees to the wheels."""

VARIANT_S, QUICK_S = 10.0, 7.0
"""Durations for the circle: long enough to be on the path, and for 5 s of steady error after that."""
QUICK_DELAY_S = 18.0
"""Duration of the experiment without its silent time: a lap after AFDSC is on the path; DSC takes longer."""
TRANSITION_S = 17.0
"""Duration of runs that only show how long the robot takes to the path: 10 s from the first command on."""
_NO_LIMITER: Settings = {"limiter.torque_speed": "off", "limiter.slip_m_s": math.inf}
"""The paper has no limiter between law and wheels."""
_UNJUDGED: Settings = {"expect": []}
"""A scenario's own expectations do not apply to its variants."""
_RECORDED = ("dsc common together", "afdsc common together", "afdsc short together")


def cases(*, quick: bool = False) -> list[PaperRun]:
    """Return the runs in the order of the tables; with ``quick`` only a few for each table."""
    each = (*circle(quick=quick), *experiment(quick=quick))
    found = [case._replace(sets={**_NO_LIMITER, **case.sets}) for case in each]
    assert len({case.name for case in found}) == len(found)
    return found


def circle(*, quick: bool = False) -> Iterator[PaperRun]:
    """Section IV.A: each law with each filter at each limit."""
    for limit_name, limit in LIMITS.items():
        for filter_name, filter_s in FILTERS.items():
            for law_name, (scenario, law) in LAWS.items():
                name = f"{law_name} {filter_name} {limit_name}"
                if quick and name not in _RECORDED:
                    continue
                records = name in (_RECORDED[1:2] if quick else _RECORDED)
                sets = {**limit.sets, **filter_s.sets, **law.sets}
                if quick or name not in _RECORDED:
                    sets |= {"loop.duration_s": QUICK_S if quick else VARIANT_S, **_UNJUDGED}
                row = {"law": law_name, "filter": filter_name, "limit": limit_name}
                yield PaperRun(name, "circle", row, scenario, sets, records)


def experiment(*, quick: bool = False) -> Iterator[PaperRun]:
    """Section IV.B: the experiment over latency, and from where and how fast the robot comes to the path."""
    brief = {"loop.duration_s": TRANSITION_S, **_UNJUDGED}
    yield PaperRun("experiment", "experiment", {}, EXPERIMENT, brief if quick else {}, records=True)
    for driven_name, latencies_ms in LATENCIES_MS.items():
        for latency_ms in latencies_ms:
            if quick and (driven_name != "afdsc torque" or latency_ms not in (latencies_ms[0], latencies_ms[-1])):
                continue
            back_ms = latency_ms // 2  # divided between the two ways, in whole ticks of the robot
            ways = {"command": latency_ms - back_ms, "feedback": back_ms}
            latencies = {f"link.{way}_latency_s": ms / 1000.0 for way, ms in ways.items()}
            sets = {**DRIVEN[driven_name].sets, **latencies, **_UNJUDGED}
            if quick:
                sets |= {"loop.duration_s": QUICK_DELAY_S, "fault": []}
            row: dict[str, str | float] = {"driven": driven_name, "latency_ms": float(latency_ms)}
            yield PaperRun(f"{driven_name} {latency_ms} ms", "delay", row, EXPERIMENT, sets)
    if quick:
        return
    for start_x_m in STARTS_X_M:
        row = {"driven": "afdsc torque", "start_x_m": start_x_m}
        sets = {"plant.start.start_x_m": start_x_m, **brief}
        yield PaperRun(f"from x = {start_x_m:g} m", "transition", row, EXPERIMENT, sets)
    for top_rad_s in TOP_SPEEDS_RAD_S:
        row = {"driven": "afdsc speed", "start_x_m": STARTS_X_M[0], "top_speed_rad_s": top_rad_s}
        sets = {**DRIVEN["afdsc speed"].sets, "robot.speed_limit_rad_s": top_rad_s, **brief}
        yield PaperRun(f"at most {top_rad_s:g} rad/s", "transition", row, EXPERIMENT, sets)


class _Row(NamedTuple):
    """``keys`` of the scenario hold the value; ``words`` describe it where no key does."""

    what: str
    keys: tuple[str, ...]
    why: str
    words: str = ""


_GAINS = "controller.gains."
_START = tuple(f"plant.start.start_{axis}" for axis in ("x_m", "y_m", "heading_rad"))
_CIRCLE = (
    _Row(
        "the filter constant",
        (_GAINS + "filter_s",),
        "DSC's steady error is ς ω² r0 / K1, and the paper's 0.79 mm at K1 = 15 1/s gives this; AFDSC has the same, "
        "and once the one that its own 0.38 mm asks for",
    ),
    _Row(
        "the initial pose",
        _START,
        'only "not on the desired path" is said; from here the times are the paper\'s, at the torque limit below',
    ),
    _Row("the torque limit", ("robot.torque_limit_n_m",), "without one both laws are on the path far sooner"),
    _Row(
        "what happens at the limit",
        (),
        "to keep the direction of the force; run too with each motor limited by itself",
        "the guard scales all four wheels together",
    ),
    _Row(
        "a limiter of the wheels' speed and slip",
        (),
        "ours would keep the robot from its overspeed and from slip; it is off in section IV.B too",
        'off: limiter.torque_speed = "off", limiter.slip_m_s = inf',
    ),
    _Row("the wheels' inertia", ("robot.wheel_inertia_kg_m2",), "a wheel of 1.8 kg with its rollers"),
    _Row("friction", ("robot.friction_coefficient",), "the simulation's errors show none"),
    _Row("the top speed", ("robot.speed_limit_rad_s",), "none: this is what a command can carry"),
    _Row(
        "the ranges of the fuzzy inputs",
        tuple(
            _GAINS + name
            for name in ("error_range_m", "error_rate_range_m_s", "heading_error_range_rad", "heading_rate_range_rad_s")
        ),
        "figures 6 and 7 have no numbers in the text; those of a start 0.3 m and 0.8 rad away",
    ),
    _Row(
        "how the rules are weighed",
        (),
        "triangular sets that overlap to 1; any other choice gives the same gains at zero error",
        "product and weighted average: bilinear between the rules",
    ),
    _Row(
        "Tables III and IV",
        (),
        "VS and VB stand the other way round at a big error with rate zero; run too with them corrected",
        "as printed",
    ),
    _Row("when it has tracked", (), "the usual settling time", "the planar error stays below 2 % of its first value"),
    _Row("the rate of the controller", ("loop.rate_hz",), "near to its continuous time"),
    _Row(
        "the Coriolis term",
        (),
        "the printed m + k in place of k is wrong (PAPER.md, equation 14)",
        "k θ̇ (ẏ, -ẋ, 0), k = 4 Ib / r²",
    ),
)
_EXPERIMENT = (
    _Row("the reference", ("reference.kind", "reference.radius_m", "reference.period_s"), "that of section IV.A"),
    _Row("the initial pose", _START, "the origin of Fig. 10: SLAM's map begins where the robot does"),
    _Row(
        "how nothing is commanded",
        ("fault.1.kind", "fault.1.start_s", "fault.1.end_s"),
        "its 30 s are our 0 s; nobody is on the line, the robot stops by itself, and the host that comes at 7 s "
        "connects and arms anew",
    ),
    _Row("where the pose comes from", ("estimator.source",), "its SLAM is not described; ours is the true pose"),
    _Row("the floor", ("plant.start.contact", "robot.torque_limit_n_m"), "wheels may slip, and at this do not"),
    _Row("the motors", ("plant.start.drive",), "a current loop with 4 A and 1.25 N·m/A each"),
    _Row(
        "friction",
        ("plant.start.friction_coefficient", "robot.friction_coefficient"),
        "in the robot, and what the law knows of it",
    ),
    _Row("what is commanded", ("controller.command",), "equation 18; run too with speeds, as ROS robots are"),
    _Row("the rate of the controller", ("loop.rate_hz",), "as circle_speed"),
    _Row(
        "the delay",
        ("link.command_latency_s", "link.feedback_latency_s"),
        'a word without a number ("the delay time of the controller"), so it is swept',
    ),
)


def assumptions() -> list[dict[str, str]]:
    """Return every assumption of the shipped scenarios, section IV.A first.

    ``place`` is the part of section IV, ``what`` the paper leaves out, ``value`` ours, ``why`` the reason.
    """
    found = []
    for place, scenario, rows in (("IV.A", load(CIRCLE), _CIRCLE), ("IV.B", load(EXPERIMENT), _EXPERIMENT)):
        law: Any = load_law(scenario.controller.law, scenario.directory)
        options = law.Options(**scenario.controller.gains)
        values: dict[str, object] = {_GAINS + name: value for name, value in asdict(options).items()}
        values |= {key: value for key, value, _ in resolved(scenario)}
        for row in rows:
            stated = (f"{key.removeprefix(_GAINS)} = {format_value(values[key])}" for key in row.keys)
            found.append({"place": place, "what": row.what, "value": row.words or ", ".join(stated), "why": row.why})
    return found
