"""Robot files for ``hil init`` and ``hil probe``: the questions about a robot, and the texts of its files.

Proposed answers come from the paper's robot and from earlier answers. In the files each value has a comment.
"""

import inspect
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING
from typing import Any, NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.core.model import GRAVITY_M_S2
from hil.core.options import Option, OptionsError, build, options_of
from hil.core.wheel_speed import slower
from hil.faults.kinds import BATTERY_V, BATTERY_VARIABLE
from hil.robot.driver import Found
from hil.robot.driver_registry import OUR_DRIVER, dialect, driver_names
from hil.scenario import BASE, format_value, load
from hil.scenario.motor_checks import make_driver
from hil.scenario.tables import Tables

Value = float | int | str
Answers = Mapping[str, Value]

_GRIP = 0.7
_RATES_HZ = (200, 100, 50, 20)
_SPEED_M_S = 1.5
_WHEEL_SHARE = 0.09
"""Share of the robot's mass in one wheel with its rollers and motor, taken as a disc."""
_RADIUS_M = 1.0
_SPEED_SHARE = 0.3
_TORQUE_SHARE = 0.3
_SHORTEST_S = 5.0
_OFF_M = 0.1
_LOOP_RAD_S = 33.0
"""Bandwidth of the firmware's speed loop on the paper's robot; its gains were chosen for it."""
_INTEGRAL_1_S = 11.0
_OVERSPEED = 2.0
_COMMENT_COLUMN = 40
_WIDEST_COMMENT = 116
_BATTERY_LIMITS = ("battery_low_v", "battery_high_v")
"""Settings of a driver whose motors are switched off outside."""


class Question(NamedTuple):
    """A key of a robot's file, and its proposed value; None if that follows from earlier answers."""

    key: str
    default: Value | None = None

    @property
    def parameter(self) -> str:
        """The parameter of ``hil init``."""
        return "link" if self.key == "link.url" else self.key.partition(".")[2]

    @property
    def flag(self) -> str:
        """The option of the command line."""
        return f"--{self.parameter.replace('_', '-')}"

    def proposed(self, answers: Answers) -> Value:
        """Return the proposed value, which may follow from the earlier answers."""
        if self.default is not None:
            return self.default
        known = {key.partition(".")[2]: value for key, value in answers.items()}
        mass_kg, radius_m, length_m, width_m = (float(known[question.parameter]) for question in QUESTIONS[:4])
        match self.parameter:
            case "inertia_kg_m2":  # of a plate between the wheels
                value = mass_kg * (length_m**2 + width_m**2) / 3
            case "wheel_inertia_kg_m2":
                value = _WHEEL_SHARE * mass_kg * radius_m**2 / 2
            case "torque_limit_n_m":  # at which the rollers begin to slip: mu m g / 4 r / sqrt(2)
                value = min(15.0, _GRIP * mass_kg * GRAVITY_M_S2 / 4 * radius_m / math.sqrt(2))
            case "speed_limit_rad_s":
                value = min(60.0, _SPEED_M_S / radius_m)
            case "rate_hz":  # as fast as the driver's feedback allows
                return _fastest(str(known["driver"]))
            case _:  # the torque constant at which the torque limit takes about 1.4 A
                value = max(0.001, 0.7 * float(known["torque_limit_n_m"]))
        return _rounded(value)

    def read(self, text: str) -> Value:
        """Return the value of a text; a number if the option is one. Raises ValueError."""
        kind = option_of(self.key).type
        if kind is int:
            return int(text)
        return float(text) if kind is float else text


QUESTIONS = (
    Question("robot.mass_kg", 20.0),
    Question("robot.wheel_radius_m", 0.075),
    Question("robot.half_length_m", 0.3),
    Question("robot.half_width_m", 0.3),
    Question("robot.inertia_kg_m2"),
    Question("robot.wheel_inertia_kg_m2"),
    Question("robot.torque_limit_n_m"),
    Question("robot.speed_limit_rad_s"),
    Question("firmware.counts_per_revolution", 4096),
    Question("firmware.torque_constant_n_m_a"),
    Question("link.url", "memory:"),
)
PROJECT_QUESTIONS = (*QUESTIONS, Question("device.driver", OUR_DRIVER), Question("loop.rate_hz"))
"""Those of a repository of one's own: with the driver, and the rate of the commands."""


def _rounded(value: float) -> float:
    """Return a value rounded to three digits."""
    return float(f"{value:.3g}")


def _fastest(driver: str) -> int:
    """Return the highest of the usual rates that a driver can hold [Hz]. Raises BadInputError if it can hold none."""
    for rate_hz in _RATES_HZ:
        try:
            load(BASE, set=_of_driver(driver, rate_hz))
        except BadInputError as error:
            problem = error
        else:
            return rate_hz
    raise problem


def _of_driver(driver: str, rate_hz: int) -> dict[str, object]:
    """Return what a first circle with a driver sets; the watchdog is as it has by default."""
    watchdog_s = min(max(5.0 / rate_hz, 0.02), 0.1)
    return {"device.driver": driver, "loop.rate_hz": rate_hz, "firmware.watchdog_s": watchdog_s}


def option_of(key: str) -> Option:
    """Return the option of a dotted key of a scenario."""
    table, _, name = key.partition(".")
    return options_of(options_of(Tables)[table].type)[name]


def problem_with(question: Question, value: Value) -> str | None:
    """Return the scenario's error sentence for a bad answer; None for a good one."""
    if question.key == "device.driver":
        return _problem_with_driver(str(value))
    table, _, name = question.key.partition(".")
    try:
        build(options_of(Tables)[table].type, {name: value}, table)
    except OptionsError as error:
        return next((problem.sentence for problem in error.problems if problem.kind == "value"), None)
    return None


def _settings(driver: str) -> Mapping[str, Option]:
    """Return the options of [device.motors] by name; our firmware has none."""
    if driver == OUR_DRIVER:
        return {}
    kind: Any = dialect(driver).settings
    return options_of(kind)


def _problem_with_driver(name: str) -> str | None:
    """Return why a robot's file cannot be written for a driver; None if it can."""
    if name == OUR_DRIVER:
        return None
    if name not in driver_names():
        return f"there is no driver {name!r}{nearest(name, driver_names())}"
    missing = [f"device.motors.{option.name}" for option in _settings(name).values() if option.default is MISSING]
    if not missing:
        return None
    return (
        f"hil init cannot write a robot for {name!r}, because nothing can be proposed for {', '.join(missing)}; write "
        f"the robot's file by the driver's page (hil/addons/motors/DRIVERS.md) "
        f"and try hil run {BASE} --lenient --robot FILE"
    )


def _battery_text(driver: str) -> str:
    """Return a line with the plant's battery, if the driver's motors stand no such voltage as it has by default."""
    settings = _settings(driver)
    low_v, high_v = (settings[name].default if name in settings else None for name in _BATTERY_LIMITS)
    if low_v is None or high_v is None or low_v < BATTERY_V < high_v:
        return ""
    return f"{f'{BATTERY_VARIABLE} = {(low_v + high_v) / 2:.3g}':<{_COMMENT_COLUMN - 1}} # what its controllers stand\n"


def found_text(found: Found, driver: str, link: str) -> str:
    """Return the robot's file for the devices that a probe has found; other values are the proposed ones."""
    answers: dict[str, Value] = {}
    for question in QUESTIONS:
        answers[question.key] = question.proposed(answers)
        if question.key in found.known:
            answers[question.key] = question.read(f"{found.known[question.key]:.6g}")
    return robot_text({**answers, "link.url": link}, driver, found)


def robot_text(answers: Answers, driver: str | None = None, found: Found | None = None) -> str:
    """Return the robot's file; ``answers`` has every question's key.

    ``driver`` and ``found`` describe motor controllers from a probe; the file then marks what was not measured.
    """
    factor = slower(int(answers["firmware.counts_per_revolution"]))
    speed_kp = min(100.0, _rounded(factor * _LOOP_RAD_S * _inertia_at_a_wheel(answers)))
    motors = _settings(driver or str(answers.get("device.driver", OUR_DRIVER)))
    gains = {"kp_n_m_s_rad": speed_kp, "ki_n_m_rad": _rounded(factor * _INTEGRAL_1_S * speed_kp)}
    more: dict[str, Value | list[str]] = {
        "firmware.torque_limit_n_m": answers["robot.torque_limit_n_m"],
        # A driver that closes the loops itself has the gains among its settings.
        **{f"firmware.speed_{name}": value for name, value in gains.items() if name not in motors},
        "firmware.overspeed_rad_s": max(1.0, _OVERSPEED * float(answers["robot.speed_limit_rad_s"])),
        **({} if driver is None else {"device.driver": driver}),
        "device.wheels": ["fl", "fr", "rr", "rl"],
        "device.reversed": [],
    }
    values = {**answers, **more}
    head = "# A robot. Runs any scenario on it: hil run SCENARIO --robot FILE\n"
    notes = (
        {} if found is None else {name: _not_reported(name, found) for name in ("robot", "firmware", "device.motors")}
    )
    tables = [_table(name, values, notes.get(name, ())) for name in ("robot", "firmware", "device", "link")]
    if found is None and motors:
        tables.insert(-1, _motors_text(str(answers["device.driver"]), motors))
    elif found is not None and (found.motors or notes["device.motors"]):
        tables.insert(-1, "\n" + _head("device.motors", notes["device.motors"]))
        tables[-1:-1] = [f"{name} = {format_value(value)}\n" for name, value in (found.motors or {}).items()]
    return head + "".join(tables)


def _motors_text(driver: str, settings: Mapping[str, Option]) -> str:
    """Return [device.motors] with the default of each setting, below what the driver says of them."""
    kind: Any = dialect(driver).settings
    said = " ".join((inspect.getdoc(kind) or "").replace("``[device.motors]``", dialect(driver).title).split())
    notes = textwrap.wrap(said.replace("``", ""), _WIDEST_COMMENT, break_long_words=False)
    rows = [
        f"{'' if one.default or isinstance(one.default, int | float) else '# '}{name} = {format_value(one.default)}\n"
        for name, one in settings.items()
    ]
    return "".join(["\n", _head("device.motors", notes), *rows])


def _has_gyro(answers: Answers) -> bool:
    driver = str(answers["device.driver"])
    if driver == OUR_DRIVER:
        return True
    rate_hz = answers["loop.rate_hz"]
    return "gyro" in make_driver(load(BASE, set=_of_driver(driver, int(rate_hz)))).capabilities.sensors


def scenario_text(answers: Answers, slowness: float) -> str:
    """Return a scenario with a circle; with ``slowness`` 1 it should be well within the robot's limits."""
    period_s = math.ceil(_period_s(answers) * slowness * 2) / 2
    sensors = "the wheels and the gyro" if _has_gyro(answers) else "the wheels"
    return f"""\
# A first circle: from {_OFF_M:g} m beside it, by {sensors} alone, as a real robot begins

extends = "robot.toml"

[plant.start]                           # where the virtual robot stands; a real one is put there by hand
start_x_m = {_RADIUS_M - _OFF_M:g}
start_y_m = 0.0
start_heading_rad = 0.0
{_battery_text(str(answers["device.driver"]))}
[controller]
law = "pid"                             # `hil list laws` prints them all
command = "speed"

[reference]
kind = "circle"                         # `hil list references` prints them all
radius_m = {_RADIUS_M:g}
period_s = {period_s:g}
heading_rad = 0.0

[estimator]
source = "odometry"                     # "truth" where it is measured; "fused" with pose fixes

[link]
url = "memory:"                         # the virtual robot; the real one: --mode realtime --robot robot.toml

[loop]
rate_hz = {answers["loop.rate_hz"]}
duration_s = {period_s:g}

[[expect]]                              # needs the truth, which the virtual robot has
signal = "error.planar_m"
from_s = {period_s / 2:g}
below = 0.05
"""


def _not_reported(table: str, found: Found) -> Sequence[str]:
    """Return comment lines on the values of a table that are not measured, to stand above it."""
    known, unknown = (
        ", ".join(key.removeprefix(f"{table}.") for key in keys if key.rpartition(".")[0] == table)
        for keys in (found.known, found.unknown)
    )
    sentences = [f"cannot be asked for: {unknown}"] if unknown else []
    if table == "device.motors":
        return [f"{sentence}; write them here, or the defaults hold" for sentence in sentences]
    exceptions = f", except {known}" if known else ""
    return [f"not measured{exceptions}: the paper's robot; replace before anything moves", *sentences]


def _head(name: str, notes: Sequence[str]) -> str:
    return "".join([*(f"# {note}\n" for note in notes), f"[{name}]\n"])


def _table(name: str, values: Mapping[str, Value | list[str]], notes: Sequence[str]) -> str:
    rows = [(key.partition(".")[2], value) for key, value in values.items() if key.startswith(f"{name}.")]
    return "".join(["\n", _head(name, notes), *_lines(name, rows)])


def _lines(table: str, rows: list[tuple[str, Value | list[str]]]) -> Iterator[str]:
    for name, value in rows:
        line = f"{name} = {format_value(value)}"
        yield f"{line:<{_COMMENT_COLUMN - 1}} # {option_of(f'{table}.{name}').meaning}\n"


def _inertia_at_a_wheel(answers: Answers) -> float:
    """Return the inertia that one wheel feels in straight motion [kg·m²]: its own, and a quarter of the robot's."""
    mass_kg, radius_m, wheel_kg_m2 = (
        float(answers[f"robot.{name}"]) for name in ("mass_kg", "wheel_radius_m", "wheel_inertia_kg_m2")
    )
    return mass_kg * radius_m**2 / 4 + wheel_kg_m2


def _period_s(answers: Answers) -> float:
    """Return the period of a circle that uses fixed shares of the wheels' speed and torque limits."""
    radius_m, speed_rad_s, torque_n_m = (
        float(answers[f"robot.{name}"]) for name in ("wheel_radius_m", "speed_limit_rad_s", "torque_limit_n_m")
    )
    by_speed = _SPEED_SHARE * speed_rad_s * radius_m / math.sqrt(2) / _RADIUS_M
    acceleration_m_s2 = _TORQUE_SHARE * torque_n_m * radius_m / math.sqrt(2) / _inertia_at_a_wheel(answers)
    by_torque = math.sqrt(acceleration_m_s2 / _RADIUS_M)
    return max(_SHORTEST_S, math.tau / min(by_speed, by_torque))
