"""How far the fused estimate is from the truth: ``python -m tools.fused_errors --page``.

Each row of the tables is one condition, driven in closed loop over the wire once for each seed. ``--page`` writes the
tables into docs/results/estimation.md, with the best that any filter could make of the same data (``fused_oracle``).
"""

import argparse
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from hil.addons.batch.comparison.random_cases import FIXES
from hil.core.model import RobotModel
from hil.core.outputs import write_whole
from hil.core.types import MeasuredPose, Pose, PoseFix, State
from hil.estimation.estimators import EstimatorOptions, make_estimator
from hil.estimation.fused import FusedEstimator
from hil.estimation.measurement import Measurement
from hil.runtime import run_parts
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tools.fused_oracle import Given, Noises, best, slip_bound_m
from tools.plants import PLANTS

Array = npt.NDArray[np.float64]
Sets = Mapping[str, Any]

PAGE = Path(__file__).parents[1] / "docs" / "results" / "estimation.md"
BEGIN, END = "<!-- fused errors: begin -->", "<!-- fused errors: end -->"
SENSORS = {
    "plant.start.gyro_noise_rad_s": 0.01,
    "plant.start.gyro_bias_z_rad_s": 0.02,
    "plant.start.accelerometer_noise_m_s2": 0.2,
}
NOISES = Noises(start=(0.01, 0.01, 0.01, 0.02, 0.005), rolled_m=1e-4, gyro_rad_s=0.01)
"""Those of these runs: how well the start is known, the drift of wheels that do not slip, and the gyro."""
OUTSIDE = -2.0 * math.log(1.0 - 0.99)
"""Squared Mahalanobis distance of the 99 % ellipse in the plane (chi-square, 2 degrees)."""
FIX, START = "estimator.simulated_fix.", "plant.start."
LEARNT_S, DURATION_S = 20.0, 40.0
SETTLED_S = 5.0


class Condition(NamedTuple):
    """A row: its words, what its runs set, on which plants, of which scenario, and from when errors count."""

    words: str
    sets: Sets
    plants: Sequence[str] = tuple(PLANTS)
    scenario: str = "circle_speed"
    from_s: float = LEARNT_S
    duration_s: float | None = DURATION_S


def reach() -> Iterator[Condition]:
    """Yield a robot as the filter believes it to be, robots that are not, and fixes that err otherwise."""
    yield Condition("as told", {})
    yield Condition("as told, figure of eight", {}, scenario="figure_eight")
    for percent in (-5.0, 5.0):
        yield Condition(f"sideways {percent:+g} %", {f"{START}sideways_loss": -0.01 * percent})
    for percent in (-2.0, 2.0):
        factor = {f"{START}wheel.fl.radius_factor": 1.0 + 0.01 * percent}
        yield Condition(f"radius of one wheel {percent:+g} %", factor)
    for percent in (-1.0, 1.0):
        scale = {f"{START}gyro_scale": 1.0 + 0.01 * percent}
        yield Condition(f"gyro {percent:+g} %, figure of eight", scale, scenario="figure_eight")
    for words, name in (
        ("noise of fixes lasts 2 s, told", "lasting"),
        ("map off by 20 mm, otherwise in each room, told", "of two maps"),
        ("twice as noisy as told", "twice as noisy"),
        ("10 % outliers by 1 m, in bursts of 1.5 s", "outliers in bursts"),
        ("corridor: 5 times the noise along it, told", "in a corridor"),
        ("300 ms late", "300 ms late"),
    ):
        yield Condition(words, FIXES[name])
    yield Condition("none from 20 s to 30 s", {f"{FIX}gap_start_s": 20.0, f"{FIX}gap_end_s": 30.0})


def others() -> Iterator[Condition]:
    """Yield wheels of another size, wheels that slip, and accelerometers that are wrong."""
    for percent in (0.5, -0.5):
        radius = {f"{START}wheel_radius_m": 0.075 * (1.0 + 0.01 * percent)}
        yield Condition(f"circle, radius {percent:+g} %", radius, ("rigid",), from_s=SETTLED_S, duration_s=None)
    torque = {
        "robot.torque_limit_n_m": 5.0,
        "firmware.torque_limit_n_m": 5.0,
        "firmware.overspeed_rad_s": 127.0,
        "limiter.slip_m_s": math.inf,
    }
    leans = {f"{START}accelerometer_bias_x_m_s2": 0.05, f"{START}accelerometer_bias_y_m_s2": 0.05}
    shove = {"kind": "push", "target": "force_x_n", "value": 100.0, "start_s": 6.0, "end_s": 6.5}
    slippery = {"kind": "slip_patch", "target": "floor", "value": 0.3, "start_s": 6.0, "end_s": 7.0}
    at_200, faults = torque | {"loop.rate_hz": 200}, {"fault": [shove, slippery]}
    for words, sets, from_s in (
        ("heavy slip, 200 Hz, whole run", at_200, 0.0),
        ("heavy slip, 1000 Hz, whole run", torque | {"loop.rate_hz": 1000}, 0.0),
        ("the same at 200 Hz, accelerometer off by 0.07 m/s²", at_200 | leans, 0.0),
        (
            "the same, from 5 s on: shoved by 100 N for 0.5 s, with 0.3 of the grip for 1 s",
            at_200 | leans | faults,
            5.0,
        ),
    ):
        yield Condition(words, sets, ("slip",), "circle_slip", from_s, None)
    for off in (1.0, 3.0):
        wrong = {"kind": "bias", "target": "robot.acceleration_x_m_s2", "value": off, "start_s": 6.0}
        words = f"circle, accelerometer off by {off:g} m/s² from 6 s on"
        yield Condition(words, {"fault": [wrong]}, ("slip",), from_s=SETTLED_S, duration_s=None)


class Kept(NamedTuple):
    """Of a run: what its estimator was made with and given, and after each update what it believed (``_believed``)."""

    model: RobotModel
    start: Pose
    counts: int
    given: list[Given]
    believed: list[tuple[float, ...]]


def _believed(estimator: FusedEstimator) -> tuple[float, ...]:
    """Return x, y and their covariance xx, xy, yy, before they are released; nothing else here looks into a filter."""
    assert estimator._history is not None
    belief = estimator._history.newest
    (xx, xy), (_, yy) = belief.covariance[:2, :2].tolist()
    return belief.pose.x_m, belief.pose.y_m, xx, xy, yy


class Outcome(NamedTuple):
    """Of the counted ticks of a run: errors [m] of robot and estimate, and squared Mahalanobis distances."""

    tracking_m: Array
    estimate_m: Array
    squared: Array


def drive(condition: Condition, plant: str, seed: int) -> tuple[Outcome, Kept, Array]:
    """Drive once; also return what the estimator saw, and the truth (x, y) of each tick. Raises as the run does."""
    made: list[Kept] = []

    def make(options: EstimatorOptions, model: RobotModel, start: Pose, counts: int) -> FusedEstimator:
        estimator = make_estimator(options, model, start, counts)
        assert isinstance(estimator, FusedEstimator)
        kept, update = Kept(model, start, counts, [], []), estimator.update
        made.append(kept)

        def keeping(
            measurement: Measurement, truth: PoseFix | None, fixes: Sequence[MeasuredPose] = ()
        ) -> State | None:
            kept.given.append((measurement, list(fixes)))
            state = update(measurement, truth, fixes)
            kept.believed.append(_believed(estimator))
            return state

        estimator.update = keeping  # type: ignore[method-assign]
        return estimator

    fmu, start = PLANTS[plant]
    sets = {"plant.fmu": fmu, **{START + name: value for name, value in start.items()}, **SENSORS, **condition.sets}
    if condition.duration_s is not None:
        sets["loop.duration_s"] = condition.duration_s
    loaded = load(condition.scenario, set={"estimator.source": "fused", **sets, "expect": []}, seed=seed)
    with patch.object(run_parts, "make_estimator", make):
        result = run_scenario(replace(loaded, expect=()), RunOptions(lenient=True))
    if result.failure is not None:
        raise result.failure
    signals, (kept,) = result.signals, made
    counted = signals["loop.t_s"] >= condition.from_s
    truth = np.array([signals["truth.x_m"], signals["truth.y_m"]])
    told = np.array([signals["pose.x_m"], signals["pose.y_m"]])
    believed = np.array(kept.believed[-len(counted) :])
    errors = signals["error.planar_m"][counted], np.hypot(*(told - truth))[counted]
    return Outcome(*errors, mahalanobis(believed, truth.T)[counted]), kept, truth.T


def mahalanobis(believed: Array, truth: Array) -> Array:
    """Return (x, y) - truth, squared and normalised by xx, xy, yy, of each row: 2 on average if they are honest."""
    x, y = (believed[:, :2] - truth).T
    xx, xy, yy = believed[:, 2:].T
    squared: Array = (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / (xx * yy - xy**2)
    return squared


def _outcome(condition: Condition, plant: str, seed: int) -> Outcome:
    return drive(condition, plant, seed)[0]


def _rms(errors: Sequence[Array]) -> str:
    each = [1e3 * float(np.sqrt(np.mean(one**2))) for one in errors]
    return f"{np.sqrt(np.mean(np.square(each))):.1f} ({max(each):.1f})"


def _n(outcomes: Sequence[Outcome]) -> str:
    return f"{len(outcomes)} x {len(outcomes[0].squared)}"


def reach_row(condition: Condition, driven: Callable[[Condition, str], Sequence[Outcome]]) -> str:
    """Return a row with the estimate's figures on each plant."""
    cells = [condition.words]
    for plant in condition.plants:
        outcomes = driven(condition, plant)
        if plant == condition.plants[0]:
            cells.append(_n(outcomes))
        squared = np.concatenate([one.squared for one in outcomes])
        nees, outside = 0.5 * squared.mean(), 100.0 * (squared > OUTSIDE).mean()
        cells += [_rms([one.estimate_m for one in outcomes]), f"{nees:.2f}", f"{outside:.1f}"]
    return f"| {' | '.join(cells)} |"


def other_row(condition: Condition, driven: Callable[[Condition, str], Sequence[Outcome]]) -> str:
    """Return a row with the figures of robot and estimate on the condition's one plant."""
    (plant,) = condition.plants
    outcomes = driven(condition, plant)
    tracking = _rms([one.tracking_m for one in outcomes]) if condition.from_s else ""
    estimate, largest = [one.estimate_m for one in outcomes], 1e3 * max(one.estimate_m.max() for one in outcomes)
    nees = 0.5 * np.mean(np.concatenate([one.squared for one in outcomes]))
    return (
        f"| {condition.words} | {plant} | {_n(outcomes)} | {tracking} | {_rms(estimate)} | {largest:.0f} | {nees:.2f} |"
    )


def bounds(seeds: Sequence[int]) -> str:
    """Return the sentence on the best that can be made of the data of the first row on the rigid plant."""
    condition = next(reach())
    variances, smoothed_m = [], []
    for seed in seeds:
        outcome, kept, truth = drive(condition, "rigid", seed)
        found = best(kept.model, kept.start, kept.counts, kept.given, NOISES)
        variances.append(found.causal_m2[-len(outcome.squared) :])
        smoothed_m.append(np.hypot(*(found.smoothed[-len(truth) :, :2] - truth).T)[-len(outcome.squared) :])
    causal_mm = 1e3 * np.sqrt(np.mean(variances))
    return (
        f"Of the first row on the rigid plant ({len(seeds)} seeds), a filter that knows every noise, but the wheels' "
        f"size only to 0.5 %, could reach {causal_mm:.2f} mm, and a smoother that sees all data of a run at once "
        f"reaches {1e3 * np.sqrt(np.mean(np.square(smoothed_m))):.2f} mm."
    )


def beyond(seeds: int, limit_m: float = 0.03) -> str:
    """Return the sentence on how often the worst of so many seeds must be beyond a limit when slip ends."""
    sigma_m = slip_bound_m(SENSORS[f"{START}accelerometer_noise_m_s2"])
    share = 1.0 - (1.0 - math.exp(-0.5 * (limit_m / sigma_m) ** 2)) ** seeds
    return (
        f"When 0.88 s of slip end, a filter that knows start and noises, and the accelerometer's bias to 0.05 m/s² an "
        f"axis, is ±{1e3 * sigma_m:.1f} mm an axis: with {seeds} seeds one is beyond {1e3 * limit_m:.0f} mm at that "
        f"moment with a probability of {share:.2f}."
    )


_PLANTS = " | ".join(f"{plant}, rms mm | NEES/2 | outside %" for plant in PLANTS)
REACH_HEAD = f"| | n | {_PLANTS} |\n|{'---|' * (2 + 3 * len(PLANTS))}"
OTHER_HEAD = "| | plant | n | robot, rms mm | estimate, rms mm | largest | NEES/2 |\n|---|---|---|---|---|---|---|"


def main() -> None:
    """Drive all conditions and print the tables, or write them into the page."""
    parser = argparse.ArgumentParser(prog="tools.fused_errors", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=10, help="runs of each condition")
    parser.add_argument("--first-seed", type=int, default=1, help="the others follow it")
    parser.add_argument("--only", default="", help="rows whose words contain this text alone")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    parser.add_argument("--page", action="store_true", help="write the tables into docs/results/estimation.md")
    options = parser.parse_args()
    if options.page and options.only:
        parser.error("--page needs every row: leave out --only")
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    lines: list[str] = []

    def say(text: str) -> None:
        lines.extend(text.split("\n"))
        print(text, flush=True)

    with ProcessPoolExecutor(options.workers) as pool:

        def driven(condition: Condition, plant: str) -> list[Outcome]:
            return list(pool.map(_outcome, [condition] * len(seeds), [plant] * len(seeds), seeds))

        for head, conditions, row in ((REACH_HEAD, reach, reach_row), (OTHER_HEAD, others, other_row)):
            say(head)
            for condition in conditions():
                if options.only in condition.words:
                    say(row(condition, driven))
            say("")
        if not options.only:
            say(f"{bounds(seeds[:5])}\n\n{beyond(options.seeds)}")
    if options.page:
        before, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
        text, after = "\n".join(lines), rest.partition(END)[2]
        write_whole(PAGE, f"{before}{BEGIN}\n{text}\n{END}{after}".encode(), "page", "replace")


if __name__ == "__main__":
    main()
