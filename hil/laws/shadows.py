"""Shadows: laws that are computed in parallel to the active law, from the same inputs, but do not drive the robot.

Each gets the reference, the state and the command that was really applied. A shadow shows what the law would command
at this tick, not how the robot would move under it: the active law moves the robot. A shadow with an integral
integrates an error that it cannot remove.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Any

from hil.core.errors import HilError
from hil.core.guard import Guard
from hil.core.model import RobotModel
from hil.core.ports import Controller
from hil.core.types import NAN_WHEELS, WHEEL_NAMES, Applied, CommandMode, Reference, State, Wheels

QUANTITY = {CommandMode.SPEED: "speed_command_rad_s", CommandMode.TORQUE: "torque_command_n_m"}
"""What the signals of set points are called."""


def short_name(spec: str) -> str:
    """Return the prefix of a law's signals: its name, or the class name of a law like ``./my_law.py:MyLaw``."""
    return re.sub(r"\W", "_", spec.rpartition(":")[2])


def command_names(prefix: str, mode: CommandMode) -> tuple[str, ...]:
    """Return the names of a law's four set points, such as ``shadow.dsc.wheel.fl.torque_command_n_m``."""
    return tuple(f"{prefix}.wheel.{wheel}.{QUANTITY[mode]}" for wheel in WHEEL_NAMES)


class Shadows:
    """Laws by name, in the mode of the run. They have ``OwnSignals``: their set points after a guard of their own.

    A shadow that raises an exception is dropped and has no values from then on; ``dropped`` holds when and why.
    """

    def __init__(self, laws: Mapping[str, Controller], mode: CommandMode, model: RobotModel) -> None:
        self._laws = dict(laws)
        self._mode = mode
        self._guards = {name: Guard(model.speed_limit_rad_s, model.torque_limit_n_m) for name in laws}
        self._commands: dict[str, Wheels] = dict.fromkeys(laws, NAN_WHEELS)
        self._updates = dict.fromkeys(laws, 0)
        self.dropped: dict[str, tuple[float, str]] = {}
        self.signals = tuple(one for name in laws for one in command_names(f"shadow.{name}", mode))

    @property
    def telemetry(self) -> tuple[float, ...]:
        """Four set points per shadow; NaN if it was not called or was dropped."""
        return tuple(itertools.chain.from_iterable(self._commands.values()))

    def limit_to(self, robot_speed_limit_rad_s: float) -> None:
        """Limit the set points to the robot's own speed limit, like those of the active law."""
        for guard in self._guards.values():
            guard.limit_to(robot_speed_limit_rad_s)

    def hold(self) -> None:
        """Do one tick in which no law is called."""
        self._commands = dict.fromkeys(self._commands, NAN_WHEELS)

    def update(
        self, t_s: float, reference: Reference, state: State, applied: Applied, dt_s: float, *, begins: bool
    ) -> Sequence[str]:
        """Compute each shadow's command for the tick at ``t_s``. If the run ``begins`` or restarts, reset it first.

        Return a sentence for each shadow that was dropped because it raised an exception.
        """
        dropped: list[str] = []
        for name, law in list(self._laws.items()):
            try:
                if begins:
                    law.reset(state, reference)
                requested = law.update(reference, state, applied, dt_s)
            except Exception as error:  # noqa: BLE001 - the run continues after any error, and reports it
                why = str(error) if isinstance(error, HilError) else f"{type(error).__name__}: {error}"
                sentence = f"shadow {name} dropped at t = {t_s:.3f} s: {why}"
                self.dropped[name] = (t_s, sentence)
                dropped.append(sentence)
                self._commands[name] = NAN_WHEELS
                del self._laws[name]
                continue
            command, _ = self._guards[name].apply(requested)
            self._updates[name] += 1
            self._commands[name] = command.speed_rad_s if self._mode is CommandMode.SPEED else command.torque_n_m
        return dropped

    def figures(self) -> list[dict[str, Any]]:
        """Return for each shadow its number of updates and of invalid commands, and when and why it was dropped."""
        return [
            {
                "name": name,
                "asked": self._updates[name],
                "commands_refused": guard.refused,
                "dropped_s": self.dropped[name][0] if name in self.dropped else None,
                "dropped": self.dropped[name][1] if name in self.dropped else None,
            }
            for name, guard in self._guards.items()
        ]
