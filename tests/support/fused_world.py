"""Drives with a known truth for tests of the fused filter, and a textbook's filter in plain NumPy."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hil.core.types import MeasuredPose, Pose, PoseCovariance
from hil.estimation.history import History
from hil.estimation.kalman import Belief, Lasting, Model, Priors, matrix, start
from hil.estimation.motion_sums import Step

Array = npt.NDArray[np.float64]

TICK_NS = 10_000_000
TICK_S = TICK_NS * 1e-9
FIX_EVERY = 10
TICKS = 100
LEG_NS = 100_000_000
START = Pose(0.5, -0.3, 2.5)
FIX_COVARIANCE = PoseCovariance(4e-4, 1e-4, 2e-5, 3e-4, -1e-5, 1e-4)
OPEN_GATE = math.inf
PRIORS = Priors(0.05, 0.05, 0.02, 0.01, 0.02, 0.05, 0.02)
STATES = 10
"""Without errors that last: x, y, heading, bias, scales of gyro, forward and left, and how the wheels differ."""
COUNTED_M2 = 1e-8
ROLLED_M = 3e-3
"""Wheels that roll disagree by this share of their way."""


def model(gate: float = OPEN_GATE, streak: int = 1000, lasting: Sequence[Lasting] = (), noise: float = 1.0) -> Model:
    return Model(gate, streak, 0.0, noise, 0.6, COUNTED_M2, tuple(lasting))


class World:
    """A drive: true states, the steps and fixes that a robot measures of it, all from one seed."""

    def __init__(
        self, seed: int, *, gyro: bool = True, ticks: int = TICKS, lasting: Sequence[Lasting] = (), slips: bool = True
    ) -> None:
        chance = np.random.default_rng(seed)
        self.model = model(lasting=lasting)
        self.first = start(0, START, PRIORS, self.model)
        deviations = np.sqrt(self.first.covariance.diagonal())
        state = np.array(self.first.mean) + deviations * chance.standard_normal(len(deviations))
        root = np.linalg.cholesky(matrix(FIX_COVARIANCE))
        white = math.sqrt(1.0 - sum(one.share for one in lasting))
        self.steps: list[Step] = []
        self.fixes: list[MeasuredPose] = []
        bend, sway = chance.uniform(0.5, 2.0, 2)
        at_ms = state[:2]
        for tick in range(1, ticks + 1):
            way = 0.012, 0.008 * math.sin(sway * tick / 9), 0.02 * math.cos(bend * tick / 17)
            is_rolled = not slips or tick % 20 != 0
            yaw_m = 0.6 * way[2]
            if (tick - 1) * TICK_NS % LEG_NS == 0:
                creep, counted_m = chance.standard_normal(2) * (ROLLED_M, 1e-4 * TICK_NS / LEG_NS)
            crept_m = creep * (abs(yaw_m) + abs(way[1]) + abs(way[0])) + counted_m
            told = -state[7:10] @ (yaw_m, way[1], way[0]) + crept_m
            step = Step(
                *way, TICK_S if gyro else 0.0, 1e-6, 4e-6, 1e-8, is_rolled, yaw_m if is_rolled else 0.0,
                told if is_rolled else math.nan, 1e-4,
            )  # fmt: skip
            state = moved_by(state, step)
            state[:3] += chance.normal(0.0, 1.0, 3) * (1e-3, 1e-3, 2e-3)
            state[3] += chance.normal(0.0, 1e-4)
            self.steps.append(step)
            if tick % FIX_EVERY == 0:
                way_m = float(np.hypot(*(state[:2] - at_ms)))
                at_ms = state[:2].copy()
                noise = white * root @ chance.standard_normal(3)
                for kind, one in enumerate(lasting):
                    kept, place = one.kept(FIX_EVERY * TICK_S, way_m), slice(STATES + 3 * kind, STATES + 3 * kind + 3)
                    state[place] = kept * state[place] + math.sqrt(1.0 - kept**2) * chance.standard_normal(3)
                    noise += math.sqrt(one.share) * root @ state[place]
                x, y, heading = state[:3] + noise
                pose = Pose(float(x), float(y), math.remainder(heading, math.tau))
                self.fixes.append(MeasuredPose(tick * TICK_NS, pose, FIX_COVARIANCE))
        self.truth = state


def moved_by(state: Array, step: Step) -> Array:
    """The motion of one step, by the equations of ESTIMATORS.md."""
    x, y, heading, bias, gyro, ahead, aside, cross, yaw, front, *lasting = state
    forward, left, turned = step.forward_m, step.left_m, step.turned_rad
    if step.is_rolled:
        true_forward = ahead * forward + cross * left + yaw * step.yaw_m
        left = aside * left + cross * forward + front * step.yaw_m
        forward = true_forward
    if step.biased_s:
        turned = gyro * turned - bias * step.biased_s
    middle = heading + turned / 2
    c, s = math.cos(middle), math.sin(middle)
    return np.array([
        x + c * forward - s * left, y + s * forward + c * left, heading + turned, bias, gyro, ahead, aside, cross, yaw,
        front, *lasting,
    ])  # fmt: skip


class Textbook:
    """An extended Kalman filter step by step: Jacobians by differences, full matrices, Joseph's form."""

    def __init__(self, first: Belief, lasting: Sequence[Lasting]) -> None:
        self.state, self.p, self.lasting = np.array(first.mean), first.covariance, lasting
        self.leg = np.zeros(4)  # yaw, left and forward of the wheels, and their disagreement
        self.from_place = self.state[:2]
        self.from_ns = 0

    def move(self, step: Step) -> None:
        width, size = 1e-6, len(self.state)
        columns = [moved_by(self.state + e, step) - moved_by(self.state - e, step) for e in width * np.eye(size)]
        f = np.array(columns).T / (2 * width)
        q = np.zeros(size)
        q[:4] = step.position_m2, step.position_m2, step.heading_rad2, step.bias_rad2_s2
        self.state, self.p = moved_by(self.state, step), f @ self.p @ f.T + np.diag(q)
        rolled = (step.yaw_m, step.left_m, step.forward_m) if step.is_rolled else (0.0, 0.0, 0.0)
        self.leg += (*rolled, step.disagreement_m)

    def end_leg(self, time_ns: int) -> None:
        """Let errors that last fade, and learn from the wheels whether they roll alike."""
        seconds, way_m = (time_ns - self.from_ns) * 1e-9, float(np.hypot(*(self.state[:2] - self.from_place)))
        for kind, one in enumerate(self.lasting):
            place, kept = slice(STATES + 3 * kind, STATES + 3 * kind + 3), one.kept(seconds, way_m)
            self.state[place] *= kept
            self.p[place] *= kept
            self.p[:, place] *= kept
            self.p[place, place] += (1.0 - kept**2) * np.eye(3)
        way = np.abs(self.leg[:3]).sum()
        if way > 1e-3 and not math.isnan(self.leg[3]):
            h = np.zeros((1, len(self.state)))
            h[0, 7:10] = self.leg[:3]
            off, noise = -self.leg[3] - h @ self.state, np.array([[COUNTED_M2 + (ROLLED_M * way) ** 2]])
            if off[0] ** 2 <= 16.0 * (h @ self.p @ h.T + noise)[0, 0]:  # else the wheels slip
                self._measure(h, off, noise)
        self.leg, self.from_place, self.from_ns = np.zeros(4), self.state[:2].copy(), time_ns

    def fix(self, fix: MeasuredPose) -> None:
        noise = matrix(fix.covariance)
        h = np.eye(3, len(self.state))
        for kind, one in enumerate(self.lasting):
            h[:, STATES + 3 * kind : STATES + 3 * kind + 3] = math.sqrt(one.share) * np.linalg.cholesky(noise)
        off = np.array(fix.pose) - h @ self.state
        off[2] = math.remainder(off[2], math.tau)
        self._measure(h, off, (1.0 - sum(one.share for one in self.lasting)) * noise)

    def _measure(self, h: Array, off: Array, r: Array) -> None:
        k = self.p @ h.T @ np.linalg.inv(h @ self.p @ h.T + r)
        rest = np.eye(len(self.state)) - k @ h
        self.state, self.p = self.state + k @ off, rest @ self.p @ rest.T + k @ r @ k.T


def by_textbook(world: World) -> Textbook:
    """Run over all data in order, the fixes at ends of legs."""
    book = Textbook(world.first, world.model.lasting)
    fixes = {fix.time_ns: fix for fix in world.fixes}
    for tick, step in enumerate(world.steps, 1):
        book.move(step)
        now_ns = tick * TICK_NS
        if now_ns % LEG_NS == 0 or now_ns in fixes:
            book.end_leg(now_ns)
        if now_ns in fixes:
            book.fix(fixes[now_ns])
    return book


def history_of(world: World, like: Model | None = None, length_ns: int = 10**10) -> History:
    return History(world.first, length_ns, like or world.model)


def believed(world: World, arrivals: Sequence[tuple[int, MeasuredPose]], like: Model | None = None) -> Belief:
    """Return what is believed at the end of a drive when each fix arrives at its tick."""
    history = history_of(world, like)
    for tick, step in enumerate(world.steps, 1):
        history.append(step, tick * TICK_NS)
        if due := [fix for at, fix in arrivals if at == tick]:
            history.insert(due)
    return history.newest


def in_time(world: World) -> list[tuple[int, MeasuredPose]]:
    return [(-(-fix.time_ns // TICK_NS), fix) for fix in world.fixes]


def numbers(belief: Belief) -> Array:
    return np.array(belief.mean)


def same(one: Belief, other: Belief) -> bool:
    """Whether two beliefs are equal, bit for bit."""
    parts = [belief._replace(covariance=one.covariance, last_belief=None) for belief in (one, other)]
    return parts[0] == parts[1] and np.array_equal(one.covariance, other.covariance)
