"""What the paper leaves out and what we assume instead: values come from the scenarios, reasons are written here."""

from dataclasses import asdict
from typing import Any, NamedTuple

from hil.batch.reproduction.plan import CIRCLE, EXPERIMENT
from hil.laws.registry import SHIPPED
from hil.scenario import format_value, load, resolved


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
        law: Any = SHIPPED[scenario.controller.law]
        options = law.Options(**scenario.controller.gains)
        values: dict[str, object] = {_GAINS + name: value for name, value in asdict(options).items()}
        values |= {key: value for key, value, _ in resolved(scenario)}
        for row in rows:
            stated = (f"{key.removeprefix(_GAINS)} = {format_value(values[key])}" for key in row.keys)
            found.append({"place": place, "what": row.what, "value": row.words or ", ".join(stated), "why": row.why})
    return found
