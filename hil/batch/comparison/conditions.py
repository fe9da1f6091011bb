"""The conditions of a comparison: torque limits, drives, estimators, floors, and robots unlike the law's model."""

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hil.core.types import CommandMode
from hil.scenario import StartValue

Sets = Mapping[str, StartValue]

TORQUES_N_M = (5.0, 1.8)
"""Limits of one wheel: what the paper's times need, and what a wheel carries without slip, 0.7 m g r / (4 √2)."""

MASS_FACTORS = (0.8, 1.2)
"""Factors on the plant's mass; its inertia and the law's model stay."""

FRICTIONS = (0.03, 0.08)
"""Coefficients of the plant's rolling friction; the law's model stays."""


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

ESTIMATORS: Mapping[str, Sets] = {
    "truth": {"estimator.source": "truth"},
    "truth-wheels": {"estimator.source": "truth", "estimator.twist": "wheels"},
    "odometry": {"estimator.source": "odometry"},
    "fused": {"estimator.source": "fused"},
}
"""Where a law's state comes from; ``truth-wheels`` is the true pose with the twist of wheels and gyro."""

CONTACTS: Mapping[str, Sets] = {"rigid": {"plant.start.contact": "rigid"}, "slip": {"plant.start.contact": "slip"}}
"""The contact between wheels and floor."""


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
            **(ESTIMATORS[self.estimator] if self.estimator is not None else {}),
            **(CONTACTS[self.contact] if self.contact is not None else {}),
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


def conditions(
    torques_n_m: Sequence[float], drives: Sequence[str], estimators: Sequence[str], contacts: Sequence[str]
) -> list[Condition]:
    """Return all combinations; without estimators or contacts they are None, the scenario's own."""
    each = itertools.product(torques_n_m, drives, estimators or (None,), contacts or (None,))
    return [Condition(*one) for one in each]


def variations(*, quick: bool) -> list[Variation]:
    """Return the robots to run, the nominal one first; with ``quick`` only that one."""
    every = [Variation(*one) for one in itertools.product((1.0, *MASS_FACTORS), (None, *FRICTIONS))]
    return every[:1] if quick else every
