"""The questions about a robot, in order. Proposed answers come from the paper's robot and from earlier answers."""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from hil.core.options import Option, OptionsError, build, options_of
from hil.scenario.tables import Tables

Value = float | int | str
Answers = Mapping[str, Value]

_GRAVITY_M_S2 = 9.81
_GRIP = 0.7
_SPEED_M_S = 1.5
_WHEEL_SHARE = 0.09
"""Share of the robot's mass in one wheel with its rollers and motor, taken as a disc."""


class Question(NamedTuple):
    """A key of a robot's file, and its proposed value, a function of the earlier answers."""

    key: str
    proposed: Callable[[Answers], Value]
    option: str = ""

    @property
    def flag(self) -> str:
        """The option of the command line."""
        return self.option or f"--{self.key.partition('.')[2].replace('_', '-')}"

    @property
    def description(self) -> str:
        """The key's meaning in the scenario's table."""
        return option_of(self.key).meaning

    def read(self, text: str) -> Value:
        """Return the value of a text; a number if the option is one. Raises ValueError."""
        kind = option_of(self.key).type
        if kind is int:
            return int(text)
        return float(text) if kind is float else text


def _number(answers: Answers, name: str) -> float:
    return float(answers[f"robot.{name}"])


def _rounded(value: float) -> float:
    """Return a value rounded to three digits."""
    return float(f"{value:.3g}")


def _box_inertia(answers: Answers) -> float:
    """Return the yaw inertia of a plate between the wheels, m (l1² + l2²) / 3."""
    length_m, width_m = _number(answers, "half_length_m"), _number(answers, "half_width_m")
    return _rounded(_number(answers, "mass_kg") * (length_m**2 + width_m**2) / 3)


def _wheel_inertia(answers: Answers) -> float:
    return _rounded(_WHEEL_SHARE * _number(answers, "mass_kg") * _number(answers, "wheel_radius_m") ** 2 / 2)


def _gripping_torque(answers: Answers) -> float:
    """Return the torque at which the rollers begin to slip with a friction of 0.7: mu m g / 4 r / sqrt(2)."""
    weight_n = _number(answers, "mass_kg") * _GRAVITY_M_S2
    return min(15.0, _rounded(_GRIP * weight_n / 4 * _number(answers, "wheel_radius_m") / math.sqrt(2)))


def _walking_speed(answers: Answers) -> float:
    return min(60.0, _rounded(_SPEED_M_S / _number(answers, "wheel_radius_m")))


def _torque_constant(answers: Answers) -> float:
    """Return a torque constant at which the torque limit takes about 1.4 A."""
    return max(0.001, _rounded(0.7 * _number(answers, "torque_limit_n_m")))


QUESTIONS = (
    Question("robot.mass_kg", lambda _: 20.0),
    Question("robot.wheel_radius_m", lambda _: 0.075),
    Question("robot.half_length_m", lambda _: 0.3),
    Question("robot.half_width_m", lambda _: 0.3),
    Question("robot.inertia_kg_m2", _box_inertia),
    Question("robot.wheel_inertia_kg_m2", _wheel_inertia),
    Question("robot.torque_limit_n_m", _gripping_torque),
    Question("robot.speed_limit_rad_s", _walking_speed),
    Question("firmware.counts_per_revolution", lambda _: 4096),
    Question("firmware.torque_constant_n_m_a", _torque_constant),
    Question("link.url", lambda _: "memory:", "--link"),
)


def option_of(key: str) -> Option:
    """Return the option of a dotted key of a scenario."""
    table, _, name = key.partition(".")
    return options_of(options_of(Tables)[table].type)[name]


def problem_with(question: Question, value: Value) -> str | None:
    """Return the scenario's error sentence for a bad answer; None for a good one."""
    table, _, name = question.key.partition(".")
    try:
        build(options_of(Tables)[table].type, {name: value}, table)
    except OptionsError as error:
        return next((problem.sentence for problem in error.problems if problem.kind == "value"), None)
    return None
