"""Who answers the questions of commissioning: a person at a terminal, or the truth of a virtual robot."""

import math
import sys
from collections.abc import Sequence
from typing import Any, Protocol

from hil.addons.identify.commission.wirings import named_direction
from hil.core.errors import RunInterruptedError
from hil.core.kinematics import BodyTwist, to_body
from hil.core.types import WHEEL_NAMES, Pose, Twist
from hil.core.wheel_map import Wiring


class Person(Protocol):
    """Answers questions; each has a key."""

    def confirm(self, key: str, sentence: str) -> None:
        """Return once the person agrees. Raises RunInterruptedError when they do not: nothing was moved then."""

    def choose(self, key: str, question: str, choices: Sequence[str]) -> str:
        """Return one of the choices."""

    def measure(self, key: str, question: str) -> float | None:
        """Return a number; None when the person leaves it out."""


class Terminal:
    """A person who types: prompts go to stderr, so that stdout holds the result alone."""

    def confirm(self, key: str, sentence: str) -> None:
        if self._ask(f"{sentence}\nType yes to go on: ").lower() not in ("y", "yes"):
            raise RunInterruptedError(
                f"stopped before the step {key}; nothing was moved for it. Go on with the same command"
            )

    def choose(self, key: str, question: str, choices: Sequence[str]) -> str:
        while True:
            answer = self._ask(f"{question} ({', '.join(choices)}): ").lower()
            if answer in choices:
                return answer
            print(f"{answer!r}: expected one of {', '.join(choices)}", file=sys.stderr)

    def measure(self, key: str, question: str) -> float | None:
        while True:
            answer = self._ask(f"{question} (Enter to leave it out): ")
            if not answer:
                return None
            try:
                value = float(answer.replace(",", "."))
            except ValueError:
                value = math.nan
            if value > 0.0:
                return value
            print(f"{answer!r}: expected a number above 0", file=sys.stderr)

    def _ask(self, prompt: str) -> str:
        print(prompt, end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line:
            raise RunInterruptedError("the input has ended; go on with the same command")
        return line.strip()


class Onlooker:
    """Answers for a virtual robot in this process, at which nobody can look: from its wiring and its true pose.

    ``truth`` returns the true pose; call ``look`` before the robot moves.
    """

    def __init__(self, wiring: Wiring, pose: Any) -> None:
        self._wiring, self._pose = wiring, pose
        self._before: Pose = pose()

    def confirm(self, key: str, sentence: str) -> None:
        self._before = self._pose()

    def choose(self, key: str, question: str, choices: Sequence[str]) -> str:
        motors = self._wiring.motors
        if key == "first_wheel":
            return WHEEL_NAMES[motors.wheel_of_channel[0]]
        if key == "first_way":
            return "forward" if motors.sign_of_channel[0] > 0 else "backward"
        x_m, y_m, turned_rad = self._moved()
        return named_direction((x_m, y_m, 0.2 * turned_rad))

    def measure(self, key: str, question: str) -> float | None:
        x_m, y_m, turned_rad = self._moved()
        return abs(turned_rad) / math.tau if key == "pushed_turns" else math.hypot(x_m, y_m)

    def _moved(self) -> BodyTwist:
        """Return how far the robot moved since the last confirmation, in the frame that its body had then."""
        now, before = self._pose(), self._before
        way = Twist(now.x_m - before.x_m, now.y_m - before.y_m, now.heading_rad - before.heading_rad)
        return to_body(way, before.heading_rad)
