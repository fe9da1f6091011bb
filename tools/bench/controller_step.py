"""What one step of each control law costs: ``python -m tools.bench.controller_step``.

Each law drives a robot some centimetres off the paper's circle, 500 steps a repetition, and gets back what it asks;
what going round takes, found by a law that does nothing, is taken off.
The measure is AFDSC as one would write it first, in NumPy with matrices and the rules one by one. All take turns, again
and again; the numbers are CPU time a step, the median and the least of them: the least is what others at work on the
machine disturb least. The ratio, of the medians, is what can be compared between machines.
"""

import argparse
import itertools
import json
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from hil.core.errors import BadInputError
from hil.core.model import FRICTION_SPEED_RAD_S, RobotModel
from hil.core.types import ZERO_WHEELS, Applied, CommandMode, Pose, Reference, State, Twist, WheelCommand
from hil.laws.afdsc import K1_1_S, K2_1_S, RULES, Afdsc
from hil.laws.law_registry import shipped_laws
from hil.references import make_reference

Array = NDArray[np.float64]

STEPS = 500
DT_S = 0.005
LATENCY_S = 0.005
ROBOT = RobotModel(
    mass_kg=20.0,
    inertia_kg_m2=0.56,
    wheel_radius_m=0.075,
    half_length_m=0.3,
    half_width_m=0.3,
    wheel_inertia_kg_m2=0.005,
    friction_coefficient=0.03,
    torque_limit_n_m=5.0,
    speed_limit_rad_s=20.0,
)


class NumpyAfdsc:
    """AFDSC in TORQUE mode as its equations stand in the paper."""

    def __init__(self, model: RobotModel, options: Afdsc.Options) -> None:
        self.model = model
        self.filter_s = options.filter_s
        self.ranges = [
            (options.error_range_m, options.error_rate_range_m_s),
            (options.error_range_m, options.error_rate_range_m_s),
            (options.heading_error_range_rad, options.heading_rate_range_rad_s),
        ]
        lever = model.lever_m
        self.h = np.array([[1, -1, -lever], [1, 1, lever], [1, -1, lever], [1, 1, -lever]])
        self.mass = np.diag([model.effective_mass_kg, model.effective_mass_kg, model.effective_inertia_kg_m2])
        self.virtual = np.zeros(3)

    def memberships(self, value: float, span: float) -> Array:
        """Return how much a value is NB, NS, Z, PS and PB."""
        scaled = np.clip(value / span, -1.0, 1.0)
        found: Array = np.maximum(0.0, 1.0 - np.abs(scaled - np.linspace(-1.0, 1.0, 5)) / 0.5)
        return found

    def gains(self, error: Array, rate: Array) -> tuple[Array, Array]:
        """Return K1 and K2 by product inference and weighted average."""
        k1, k2 = np.zeros(3), np.zeros(3)
        k1_levels = np.array([[K1_1_S[level] for level in row] for row in RULES["printed"][0]])
        k2_levels = np.array([[K2_1_S[level] for level in row] for row in RULES["printed"][1]])
        for axis, (error_range, rate_range) in enumerate(self.ranges):
            weights = np.outer(self.memberships(rate[axis], rate_range), self.memberships(error[axis], error_range))
            k1[axis] = np.sum(weights * k1_levels) / np.sum(weights)
            k2[axis] = np.sum(weights * k2_levels) / np.sum(weights)
        return k1, k2

    def begin(self, reference: Reference, state: State) -> None:
        """Start the filter at rest on its input."""
        self.virtual, _ = self.virtual_control(reference, state)

    def virtual_control(self, reference: Reference, state: State) -> tuple[Array, Array]:
        """Return the virtual control and K2."""
        wanted_dot = np.array(reference.twist)
        error = np.array(state.pose) - np.array(reference.pose)
        error[2] = math.remainder(error[2], math.tau)
        k1, k2 = self.gains(error, np.array(state.twist) - wanted_dot)
        virtual: Array = wanted_dot - k1 * error
        return virtual, k2

    def update(self, reference: Reference, state: State, dt_s: float) -> Array:
        """Return the torques of the wheels."""
        model = self.model
        q, q_dot, wanted_dot = np.array(state.pose), np.array(state.twist), np.array(reference.twist)
        virtual, k2 = self.virtual_control(reference, state)
        change = (1.0 - np.exp(-dt_s / self.filter_s)) * (virtual - self.virtual)
        acceleration = change / dt_s - k2 * (q_dot - self.virtual)
        self.virtual = self.virtual + change
        c, s = np.cos(q[2]), np.sin(q[2])
        rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        coupling = model.wheels_mass_kg * q_dot[2] * np.array([q_dot[1], -q_dot[0], 0.0])
        to_wheels = model.wheel_radius_m / 4 * self.h @ np.diag([1, 1, 1 / model.lever_m**2]) @ rotation.T
        speeds = self.h @ rotation.T @ wanted_dot / model.wheel_radius_m
        friction = model.wheel_friction_n_m * np.tanh(speeds / FRICTION_SPEED_RAD_S)
        torque: Array = to_wheels @ (self.mass @ acceleration + coupling) + friction
        return torque


class Nothing:
    """A law that always gives the same command: its time is the bench's own."""

    @dataclass(frozen=True)
    class Options:
        """None."""

    def __init__(self, model: RobotModel, mode: CommandMode, options: Options) -> None:
        self._command = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)

    def reset(self, state: State, reference: Reference) -> None:
        """Do nothing."""

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return no motion."""
        return self._command


def motion() -> tuple[list[Reference], list[State]]:
    """Return the circle, and a robot that is beside it."""
    circle = make_reference("circle", {"heading_rad": math.pi / 4})
    references = [circle.at(number * DT_S) for number in range(STEPS)]
    states = []
    for number, ((x, y, heading), (vx, vy, yaw_rate), _) in enumerate(references):
        off = 0.05 * math.sin(0.05 * number)
        states.append(State(Pose(x + off, y - off, heading + off), Twist(vx + off, vy - off, yaw_rate + off)))
    return references, states


def of_law(law: type, mode: CommandMode, references: list[Reference], states: list[State]) -> Callable[[], None]:
    """Return what does all steps of a law. Raises BadInputError for a mode that it refuses."""
    options = law.Options()  # type: ignore[attr-defined]
    controller = law(ROBOT, mode, options)

    def steps() -> None:
        applied = Applied(WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS), False, LATENCY_S)
        controller.reset(states[0], references[0])
        for reference, state in zip(references, states, strict=True):
            applied = Applied(controller.update(reference, state, applied, DT_S), False, LATENCY_S)

    return steps


def of_numpy(references: list[Reference], states: list[State]) -> Callable[[], None]:
    """Return what does all steps of AFDSC in NumPy, checked against the law's own."""
    naive, law = NumpyAfdsc(ROBOT, Afdsc.Options()), Afdsc(ROBOT, CommandMode.TORQUE, Afdsc.Options())
    law.reset(states[0], references[0])
    naive.begin(references[0], states[0])
    applied = Applied(WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, ZERO_WHEELS), False, LATENCY_S)
    expected, found = ZERO_WHEELS, np.zeros(4)
    for reference, state in zip(references, states, strict=True):
        expected = law.update(reference, state, applied, DT_S).torque_n_m
        found = naive.update(reference, state, DT_S)
    if not np.allclose(found, expected, atol=1e-6):
        raise SystemExit(f"AFDSC in NumPy gives {found}, the law {expected}: one of them is wrong")

    def steps() -> None:
        for reference, state in zip(references, states, strict=True):
            naive.update(reference, state, DT_S)

    return steps


def _ratio(times: float) -> str:
    return f"1/{1.0 / times:.0f}" if times < 1.0 else f"{times:.1f}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tools.bench.controller_step", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--repeats", type=int, default=21, help="repetitions, of which median and least count")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args()
    references, states = motion()
    ways = {("AFDSC in NumPy", "torque"): of_numpy(references, states)}
    for (name, law), mode in itertools.product(shipped_laws().items(), CommandMode):
        try:
            ways[name, mode.name.lower()] = of_law(law, mode, references, states)
        except BadInputError:
            continue  # it makes no sense in this mode, and says so
    going_round = of_law(Nothing, CommandMode.TORQUE, references, states)
    taken: dict[tuple[str, str], list[float]] = {way: [] for way in ways}
    for _ in range(options.repeats):
        for way, steps in ways.items():
            begin_ns = time.process_time_ns()
            steps()
            middle_ns = time.process_time_ns()
            going_round()
            end_ns = time.process_time_ns()
            taken[way].append((2 * middle_ns - begin_ns - end_ns) * 1e-3 / STEPS)
    table = Table("law", "command", "µs a step", "least", "of NumPy's", title="a step of a law, CPU time")
    measure = statistics.median(taken["AFDSC in NumPy", "torque"])
    figures = {}
    for (name, mode_name), values in taken.items():
        median = statistics.median(values)
        figures[f"{name}, {mode_name}"] = {"cpu_us": median, "numpy_times": measure / median}
        table.add_row(name, mode_name, f"{median:.2f}", f"{min(values):.2f}", _ratio(median / measure))
    Console().print(table)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
