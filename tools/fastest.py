"""The least time to the reference that torque and wheel speeds allow, and the time that ``profile`` takes.

``python -m tools.fastest`` prints a table; with ``--write`` it puts it into ``docs/results/laws.md``. The optimum is
that of compare_circle's robot with its heading free on the way: no friction, no latency, wheels at most at 20 rad/s,
the error below 10 mm from T on, and 0.2 s later with the reference, its heading within 5 mrad. For a time T a sequence
of linear programs (SciPy, HiGHS) looks for torques that get there, each linearised about the motion that the torques of
the last one really cause, and a bisection looks for the least T. A motion counts if that, and not the program's own,
is there.

An optimum takes some seconds and does not depend on the law, so those that were found are kept in a file of the tree,
one a line, which is continued. Remove it to find them again.
"""

import argparse
import json
import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog
from scipy.sparse import lil_matrix

import hil
from hil.addons.batch.results_page import markdown_table
from hil.core.model import RobotModel
from hil.references import ReferenceSource, make_reference
from hil.scenario import load

Array = npt.NDArray[np.float64]
SCENARIO = "compare_circle"
PAGE = Path("docs/results/laws.md")
OPTIMA = Path("tools/fastest_optima.jsonl")
BEGIN, END = "<!-- fastest begin -->\n", "<!-- fastest end -->\n"
MASSES_KG, TORQUES_N_M = (16.0, 20.0, 24.0), (5.0, 1.8)
WITHIN_M, AFTER_S, HEADING_RAD = 0.01, 0.2, 0.005
_ON_WAY, _AFTER = 36, 10  # steps until T, and after it
_SIDES = 24  # of the polygon within the circle of 10 mm
_TRUST_RAD = 0.2
_ROUNDS = 16
_SLACK_M = 2e-4  # by how much the end may be missed, so that a bisection has an edge
_RESOLUTION_S = 0.004
_GROW, _LONGEST_S = 1.06, 10.0
_HOPELESS = 5, 0.003  # rounds after which a program that misses by so much is given up
_FAR_M, _TURNED_RAD = (0.2, 1.0), 0.6  # of random starts


class Start(NamedTuple):
    x_m: float
    y_m: float
    heading_rad: float


class Motion(NamedTuple):
    """A motion from rest: states (n + 1, 6), torques (n, 4) that act for a step each, and the steps (n) [s]."""

    states: Array
    torques_n_m: Array
    steps_s: Array


def advance(model: RobotModel, state: Array, torque_n_m: Array, step_s: Array) -> Array:
    """Return states (..., 6) after steps under constant torques (..., 4): M q̈ + C = B τ at the middle of the step."""
    heading = state[..., 2] + 0.5 * step_s * state[..., 5]
    c, s = np.cos(heading), np.sin(heading)
    fl, fr, rr, rl = np.moveaxis(torque_n_m, -1, 0) / model.wheel_radius_m
    forward, left, turn = fl + fr + rr + rl, fr - fl + rl - rr, model.lever_m * (fr - fl + rr - rl)
    coupling = model.wheels_mass_kg * state[..., 5]
    rate = state[..., 3:] + 0.0
    gained = np.stack(
        [
            (c * forward - s * left - coupling * rate[..., 1]) / model.effective_mass_kg,
            (s * forward + c * left + coupling * rate[..., 0]) / model.effective_mass_kg,
            turn / model.effective_inertia_kg_m2,
        ],
        axis=-1,
    )
    after = rate + step_s[..., None] * gained
    return np.concatenate([state[..., :3] + 0.5 * step_s[..., None] * (rate + after), after], axis=-1)


def wheel_speeds(model: RobotModel, state: Array) -> Array:
    """Return the wheel speeds (..., 4) [rad/s] of states."""
    c, s = np.cos(state[..., 2]), np.sin(state[..., 2])
    forward, left = c * state[..., 3] + s * state[..., 4], c * state[..., 4] - s * state[..., 3]
    turn = model.lever_m * state[..., 5]
    wheels = forward - left - turn, forward + left + turn, forward - left + turn, forward + left - turn
    return np.stack(wheels, axis=-1) / model.wheel_radius_m


def _slopes(function: Any, at: Array) -> Array:
    """Return the derivatives (n, outputs, inputs) of a function of (n, inputs) by central differences."""
    small = 1e-6
    shifts = small * np.eye(at.shape[-1])
    return np.stack([(function(at + one) - function(at - one)) / (2.0 * small) for one in shifts], axis=-1)


def motion_within(
    model: RobotModel, reference: ReferenceSource, start: Start, time_s: float, guess: Motion | None = None
) -> tuple[Motion, float]:
    """Return the motion that comes nearest to being there at ``time_s``, and by how much it misses [m]."""
    steps = np.concatenate([np.full(_ON_WAY, time_s / _ON_WAY), np.full(_AFTER, AFTER_S / _AFTER)])
    count = len(steps)
    at_s = np.concatenate([[0.0], np.cumsum(steps)])
    aims = np.array([[*one.pose, *one.twist] for one in map(reference.at, at_s)])
    aims[:, 2] = start.heading_rad + math.remainder(aims[0, 2] - start.heading_rad, math.tau) + aims[:, 2] - aims[0, 2]
    first = np.array([*start, 0.0, 0.0, 0.0])
    states = np.linspace(first, aims[-1], count + 1) if guess is None else guess.states
    torques = np.zeros((count, 4)) if guess is None else guess.torques_n_m
    missed, best = math.inf, Motion(states, torques, steps)
    trust = _TRUST_RAD
    for number in range(_ROUNDS):
        states, torques = _program(model, first, aims, Motion(states, torques, steps), trust)
        if number >= _HOPELESS[0] and np.hypot(*(states - aims)[_ON_WAY:, :2].T).max() - WITHIN_M > _HOPELESS[1]:
            break
        rolled = [first]
        for torque, step in zip(torques, steps, strict=True):
            rolled.append(advance(model, rolled[-1], torque, np.array(step)))
        found = np.array(rolled)
        off = np.hypot(*(found - aims)[_ON_WAY:, :2].T).max() - WITHIN_M
        fast = np.abs(wheel_speeds(model, found)).max() / model.speed_limit_rad_s - 1.0
        turned = abs(found[-1, 2] - aims[-1, 2]) - HEADING_RAD
        worst = max(off, 0.1 * fast, 0.1 * turned, 0.0)
        if worst < missed:
            missed, best = worst, Motion(found, torques, steps)
        if missed <= _SLACK_M:
            break
        states, trust = found, 0.6 * trust
    return best, float(missed)


def _program(model: RobotModel, first: Array, aims: Array, about: Motion, trust_rad: float) -> tuple[Array, Array]:
    """Solve the linear program about a motion: states and torques with the least sum of what the end is missed by."""
    states, torques, steps = about
    count = len(steps)
    size = 6 * (count + 1) + 4 * count + 2  # and two slacks: position, and the rest

    def of_state(k: int) -> int:
        return 6 * k

    def of_torque(k: int) -> int:
        return 6 * (count + 1) + 4 * k

    both = np.concatenate([states[:-1], torques], axis=1)
    slopes = _slopes(lambda one: advance(model, one[:, :6], one[:, 6:], steps), both)
    after = advance(model, states[:-1], torques, steps)
    equal, equal_to = lil_matrix((6 * count, size)), np.zeros(6 * count)
    for k in range(count):
        rows = slice(6 * k, 6 * k + 6)
        equal[rows, of_state(k) : of_state(k) + 6] = slopes[k, :, :6]
        equal[rows, of_torque(k) : of_torque(k) + 4] = slopes[k, :, 6:]
        equal[rows, of_state(k + 1) : of_state(k + 1) + 6] = -np.eye(6)
        equal_to[rows] = slopes[k] @ both[k] - after[k]
    most = model.speed_limit_rad_s
    turning, speeds = _slopes(lambda one: wheel_speeds(model, one), states), wheel_speeds(model, states)
    angles = np.arange(_SIDES) * math.tau / _SIDES
    sides, reach_m = np.stack([np.cos(angles), np.sin(angles)], axis=1), WITHIN_M * math.cos(math.pi / _SIDES)
    within = lil_matrix((8 * count + _SIDES * (_AFTER + 1) + 8, size))
    limit = np.zeros(within.shape[0])
    row = 0
    for k in range(1, count + 1):
        offset = turning[k] @ states[k] - speeds[k]
        for sign in (1.0, -1.0):
            within[row : row + 4, of_state(k) : of_state(k) + 6] = sign * turning[k]
            limit[row : row + 4] = most + sign * offset
            row += 4
    for k in range(_ON_WAY, count + 1):
        within[row : row + _SIDES, of_state(k) : of_state(k) + 2] = sides
        within[row : row + _SIDES, size - 2] = -1.0
        limit[row : row + _SIDES] = reach_m + sides @ aims[k, :2]
        row += _SIDES
    for axis, allowed in ((2, HEADING_RAD), (3, 1e-3), (4, 1e-3), (5, 1e-2)):
        for sign in (1.0, -1.0):
            within[row, of_state(count) + axis] = sign
            within[row, size - 1] = -1.0
            limit[row] = allowed + sign * aims[-1, axis]
            row += 1
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    low[:6] = high[:6] = first
    turns = slice(of_state(1) + 2, of_torque(0), 6)
    low[turns], high[turns] = states[1:, 2] - trust_rad, states[1:, 2] + trust_rad
    low[of_torque(0) :], high[of_torque(0) : size - 2] = -model.torque_limit_n_m, model.torque_limit_n_m
    low[-2:] = 0.0
    cost = np.zeros(size)
    cost[-2:] = 1.0, 0.1
    solve: Any = linprog  # SciPy takes sparse matrices, which its annotations do not say
    bounds = np.stack([low, high], axis=1)
    solved = solve(cost, within.tocsr(), limit, equal.tocsr(), equal_to, bounds, method="highs")
    if solved.x is None:
        raise RuntimeError(f"a linear program of {size} variables has no solution: {solved.message}")
    split = 6 * (count + 1)
    return solved.x[:split].reshape(-1, 6), solved.x[split:-2].reshape(-1, 4)


def least_time_s(model: RobotModel, reference: ReferenceSource, start: Start) -> float:
    """Return the least time to the reference [s], to 4 ms.

    It is looked for from below, as a motion with time to spare is one of many, and programs wander among those.
    """
    away_m = math.dist(start[:2], reference.at(0.0).pose[:2])
    push_m_s2 = 2.0 * math.sqrt(2.0) * model.torque_limit_n_m / model.wheel_radius_m / model.effective_mass_kg
    low = high = 1.2 * math.sqrt(away_m / push_m_s2)
    while (found := motion_within(model, reference, start, high))[1] > _SLACK_M:
        low, high = high, _GROW * high
        if high > _LONGEST_S:
            raise RuntimeError(f"from {start} no motion was found that is there within {low:.1f} s")
    motion = found[0]
    while high - low > _RESOLUTION_S:
        middle = 0.5 * (low + high)
        tried, missed = motion_within(model, reference, start, middle, motion)
        if missed <= _SLACK_M:
            high, motion = middle, tried
        else:
            low = middle
    return high


class Optima:
    """The least times that are known, in a file that is continued: for each robot and start one JSON object a line."""

    def __init__(self, file: Path) -> None:
        self._file = file
        lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
        self._known = {tuple(row["key"]): float(row["least_s"]) for row in map(json.loads, lines)}

    def least_time_s(self, model: RobotModel, reference: ReferenceSource, start: Start) -> float:
        """Return the least time to the reference [s] from the file, or find it and add it there."""
        key = (model.torque_limit_n_m, model.mass_kg, *(round(one, 6) for one in start))
        if key not in self._known:
            self._known[key] = least_time_s(model, reference, start)
            with self._file.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"key": key, "least_s": self._known[key]}) + "\n")
        return self._known[key]


def taken_s(start: Start, mass_kg: float, torque_n_m: float) -> float | None:
    """Return the time that ``profile`` takes to 10 mm, through wire and plant; None if it is not there in 4 s."""
    sets = {
        "plant.start.mass_kg": mass_kg,
        **dict(zip((f"plant.start.start_{one}" for one in ("x_m", "y_m", "heading_rad")), start, strict=True)),
        "robot.torque_limit_n_m": torque_n_m,
        "firmware.torque_limit_n_m": torque_n_m,
        "controller.gains.keeps_speed_limit": True,
        "loop.duration_s": 4.0,
        "expect": [],
    }
    result = hil.run(SCENARIO, set=sets, lenient=True)
    if result.failure is not None:
        raise result.failure
    t10_s: float | None = result.metrics["t10_s"]
    return t10_s


def random_starts(reference: ReferenceSource, count: int) -> list[Start]:
    """Return starts around the reference's, the same ones each time."""
    draw, (x, y, heading) = random.Random("fastest").random, reference.at(0.0).pose
    starts = []
    for _ in range(count):
        far, way = _FAR_M[0] + (_FAR_M[1] - _FAR_M[0]) * draw(), math.tau * draw()
        turned = _TURNED_RAD * (2.0 * draw() - 1.0)
        starts.append(Start(x + far * math.cos(way), y + far * math.sin(way), heading + turned))
    return starts


def rows(starts: int, optima: Optima) -> Iterator[tuple[str, ...]]:
    """Yield the table: times from compare_circle's start, then what is taken over the optimum from random starts."""
    scenario = load(SCENARIO)
    kind = scenario.reference
    reference = make_reference(kind.kind, kind.options, scenario.directory)
    own = Start(*(float(scenario.plant.start[f"start_{one}"]) for one in ("x_m", "y_m", "heading_rad")))
    around = random_starts(reference, starts)
    times = "optimum, s", "`profile`, s"
    yield "torque, N·m", "mass, kg", *times, f"`profile` over the optimum, {starts} starts: median", "worst"
    for torque_n_m in TORQUES_N_M:
        for mass_kg in MASSES_KG:
            model = replace(scenario.robot, mass_kg=mass_kg, torque_limit_n_m=torque_n_m)
            ratios = []
            for start in around:
                took_s = taken_s(start, mass_kg, torque_n_m)
                ratios.append(math.inf if took_s is None else took_s / optima.least_time_s(model, reference, start))
            took_s = taken_s(own, mass_kg, torque_n_m)
            spread = (f"{np.median(ratios):.2f}", f"{max(ratios):.2f}") if ratios else ("-", "-")
            best, took = f"{optima.least_time_s(model, reference, own):.3f}", "-" if took_s is None else f"{took_s:.3f}"
            yield f"{torque_n_m:g}", f"{mass_kg:g}", best, took, *spread


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.fastest", description=__doc__)
    parser.add_argument("--starts", type=int, default=50, help="random starts for each mass and torque; 0 for none")
    parser.add_argument("--write", action="store_true", help=f"put the table into {PAGE}")
    given = parser.parse_args(arguments)
    text = markdown_table(list(rows(given.starts, Optima(OPTIMA))))
    print(text, end="")
    if given.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n{text}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
