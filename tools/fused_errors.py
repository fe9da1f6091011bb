"""How far the fused estimate is from the truth: ``python -m tools.fused_errors --page``.

Each row of the table is one condition, driven in closed loop over the wire once for each seed. ``--page`` writes the
table into docs/results/estimation.md. It also has the best result of any causal filter (the filter's own covariance
when it knows all noises) and that of a smoother that knows the whole run (Rauch, Tung and Striebel).
"""

import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from hil.core.model import RobotModel
from hil.core.outputs import write_whole
from hil.core.types import MeasuredPose, Pose, PoseFix, State
from hil.estimation.estimators import EstimatorOptions, FilterOptions
from hil.estimation.fused import FusedEstimator
from hil.estimation.measurement import Measurement
from hil.runtime import run_parts
from hil.runtime.assembly import RunOptions, run_scenario
from hil.scenario import load
from tools.fused_oracle import Noises, best, slip_bound_m

Array = npt.NDArray[np.float64]

PAGE = Path(__file__).parents[1] / "docs" / "results" / "estimation.md"
BEGIN, END = "<!-- fused errors: begin -->", "<!-- fused errors: end -->"
SETTLED_S = 5.0
ORACLE_SEEDS = 5
RADIUS_M = 0.075
SENSORS = {
    "plant.start.gyro_noise_rad_s": 0.01,
    "plant.start.gyro_bias_z_rad_s": 0.02,
    "plant.start.accelerometer_noise_m_s2": 0.2,
}
NOISES = Noises(start=(0.01, 0.01, 0.01, 0.02, 0.005), rolled_m=1e-4, gyro_rad_s=0.01)
"""Those of these runs: how well the start is known, the drift of wheels that do not slip, and the gyro."""


class Condition(NamedTuple):
    """A row: its words, the scenario and its keys, from when errors count, and whether it has bound and smoother."""

    words: str
    scenario: str
    sets: Mapping[str, object]
    from_s: float = SETTLED_S
    has_oracle: bool = True


def conditions() -> Iterator[Condition]:
    """Yield the rows of the table."""
    for name, scenario in (("circle", "circle_speed"), ("eight", "figure_eight")):
        for contact in ("rigid", "slip"):
            for percent in (0.0, 0.5, -0.5):
                words = f"{name}, {contact}" + (f", radius {percent:+g} %" if percent else "")
                radius_m = RADIUS_M * (1.0 + 0.01 * percent)
                start = {"plant.start.contact": contact, "plant.start.wheel_radius_m": radius_m}
                yield Condition(words, scenario, start, has_oracle=contact == "rigid" and not percent)
        noise = {"estimator.simulated_fix.noisier": 2.0}
        yield Condition(f"{name}, fixes twice as noisy as told", scenario, noise, has_oracle=False)
    torque = {
        "robot.torque_limit_n_m": 5.0,
        "firmware.torque_limit_n_m": 5.0,
        "firmware.overspeed_rad_s": 127.0,
        "limiter.slip_m_s": math.inf,
    }
    leans = {"plant.start.accelerometer_bias_x_m_s2": 0.05, "plant.start.accelerometer_bias_y_m_s2": 0.05}
    for rate_hz in (200, 1000):
        words = f"heavy slip, {rate_hz} Hz, whole run"
        sets = torque | {"loop.rate_hz": rate_hz}
        yield Condition(words, "circle_slip", sets, from_s=0.0, has_oracle=False)
    torque |= {"loop.rate_hz": 200}
    words = "the same at 200 Hz, accelerometer off by 0.07 m/s²"
    yield Condition(words, "circle_slip", torque | leans, from_s=0.0, has_oracle=False)
    shove = {"kind": "push", "target": "force_x_n", "value": 100.0, "start_s": 6.0, "end_s": 6.5}
    patch = {"kind": "slip_patch", "target": "floor", "value": 0.3, "start_s": 6.0, "end_s": 7.0}
    words = "the same, from 5 s on: shoved by 100 N for 0.5 s, with 0.3 of the grip for 1 s"
    yield Condition(words, "circle_slip", torque | leans | {"fault": [shove, patch]}, has_oracle=False)
    for off in (1.0, 3.0):
        wrong = {"kind": "bias", "target": "robot.acceleration_x_m_s2", "value": off, "start_s": 6.0}
        words = f"circle, slip, accelerometer off by {off:g} m/s² from 6 s on"
        yield Condition(words, "circle_speed", {"plant.start.contact": "slip", "fault": [wrong]}, has_oracle=False)


class Believed(NamedTuple):
    """The position that the filter believes in, before it is released to the law, and its covariance [m²]."""

    x_m: float
    y_m: float
    xx: float
    xy: float
    yy: float


class Kept(FusedEstimator):
    """A fused estimator that keeps its inputs, and its belief after each update."""

    def __init__(self, model: RobotModel, start_pose: Pose, counts: int, slip_m_s: float, options: FilterOptions):
        super().__init__(model, start_pose, counts, slip_m_s, options)
        self.made_with = model, start_pose, counts
        self.given: list[tuple[Measurement, list[MeasuredPose]]] = []
        self.beliefs: list[Believed] = []

    def update(
        self, measurement: Measurement, truth: PoseFix | None, fixes: Sequence[MeasuredPose] = ()
    ) -> State | None:
        """Update, and keep what was given and is believed."""
        self.given.append((measurement, list(fixes)))
        state = super().update(measurement, truth, fixes)
        self.beliefs.append(self._believed())
        return state

    def _believed(self) -> Believed:
        """The only place here that looks into the filter."""
        assert self._history is not None
        belief = self._history.newest
        covariance = belief.covariance
        return Believed(belief.x_m, belief.y_m, covariance.xx, covariance.xy, covariance.yy)


class Outcome(NamedTuple):
    """Of one run: errors [m] of robot and estimate, NEES / 2, and of the first seeds bound and smoother [m]."""

    tracking_m: Array
    estimate_m: Array
    nees: float
    bound_m2: float
    smoothed_m: Array


def outcome(condition: Condition, seed: int) -> Outcome:
    """Drive once."""
    kept: list[Kept] = []

    def make(options: EstimatorOptions, model: RobotModel, start_pose: Pose, counts: int) -> Kept:
        kept.append(Kept(model, start_pose, counts, options.slip_threshold_m_s, options.filter))
        return kept[-1]

    sets = {**SENSORS, "estimator.source": "fused", **condition.sets}
    scenario = replace(load(condition.scenario, set=sets, seed=seed), expect=())
    with patch.object(run_parts, "make_estimator", make):
        result = run_scenario(scenario, RunOptions(lenient=True))
    if result.failure is not None:
        raise result.failure
    signals, (estimator,) = result.signals, kept
    count = len(signals["loop.t_s"])
    counts = signals["loop.t_s"] >= condition.from_s
    truth = np.array([signals["truth.x_m"], signals["truth.y_m"]])
    told = np.array([signals["pose.x_m"], signals["pose.y_m"]])
    bound_m2, smoothed_m = np.nan, np.array([])
    if condition.has_oracle and seed <= ORACLE_SEEDS:
        bounds = best(*estimator.made_with, estimator.given, NOISES)
        bound_m2 = float(np.mean(bounds.causal_m2[-count:][counts]))
        smoothed_m = np.hypot(*(bounds.smoothed.T[:2, -count:] - truth))[counts]
    return Outcome(
        signals["error.planar_m"][counts],
        np.hypot(*(told - truth))[counts],
        float(np.mean(_nees(estimator.beliefs[-count:], truth)[counts])),
        bound_m2,
        smoothed_m,
    )


def _nees(beliefs: Sequence[Believed], truth: Array) -> Array:
    """Return half of the normalised squared error of the position in each tick: 1 on average for an honest filter."""
    x_m, y_m, xx, xy, yy = np.array(beliefs).T
    x, y = x_m - truth[0], y_m - truth[1]
    squared: Array = (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / (xx * yy - xy**2)
    return squared / 2.0


def beyond(seeds: int, limit_m: float = 0.03) -> str:
    """Return the sentence on how often the worst of so many seeds must be beyond a limit when slip ends."""
    sigma_m = slip_bound_m(SENSORS["plant.start.accelerometer_noise_m_s2"])
    share = 1.0 - (1.0 - math.exp(-0.5 * (limit_m / sigma_m) ** 2)) ** seeds
    return (
        f"When 0.88 s of slip end, a filter that knows start and noises, and the accelerometer's bias to 0.05 m/s² an "
        f"axis, is ±{1e3 * sigma_m:.1f} mm an axis: with {seeds} seeds one is beyond {1e3 * limit_m:.0f} mm at that "
        f"moment with a probability of {share:.2f}."
    )


def row(condition: Condition, seeds: int) -> str:
    """Return a condition's row: root mean squares over all seeds, and the worst of the seeds."""
    runs = [outcome(condition, seed) for seed in range(1, seeds + 1)]

    def rms(errors: Sequence[Array]) -> str:
        each = [1e3 * float(np.sqrt(np.mean(one**2))) for one in errors]
        return f"{np.sqrt(np.mean(np.square(each))):.2f} ({max(each):.1f})"

    largest = 1e3 * max(float(run.estimate_m.max()) for run in runs)
    nees = np.mean([run.nees for run in runs])
    with_oracle = [run for run in runs if len(run.smoothed_m)]
    oracle = " | "
    if with_oracle:
        smoothed = np.sqrt(np.mean(np.concatenate([run.smoothed_m for run in with_oracle]) ** 2))
        oracle = f"{1e3 * np.sqrt(np.mean([run.bound_m2 for run in with_oracle])):.2f} | {1e3 * smoothed:.2f}"
    tracking = rms([run.tracking_m for run in runs]) if condition.from_s else ""
    return (
        f"| {condition.words} | {tracking} | {rms([run.estimate_m for run in runs])} | {largest:.0f} | {nees:.2f} "
        f"| {oracle} |"
    )


HEAD = """\
| | robot, rms | estimate, rms | largest | NEES/2 | causal bound | smoother |
|---|---|---|---|---|---|---|"""


def main() -> None:
    """Drive all conditions and print the table, or write it into the page."""
    parser = argparse.ArgumentParser(prog="tools.fused_errors", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20, help="runs of each condition")
    parser.add_argument("--page", action="store_true", help="write the table into docs/results/estimation.md")
    options = parser.parse_args()
    lines = HEAD.split("\n")
    print(HEAD)
    for condition in conditions():
        lines.append(row(condition, options.seeds))
        print(lines[-1], flush=True)
    lines += ["", beyond(options.seeds)]
    print(lines[-1])
    if options.page:
        before, _, rest = PAGE.read_text("utf-8").partition(BEGIN)
        text, after = "\n".join(lines), rest.partition(END)[2]
        write_whole(PAGE, f"{before}{BEGIN}\n{text}\n{END}{after}".encode(), "page", "replace")


if __name__ == "__main__":
    main()
