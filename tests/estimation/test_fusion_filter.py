"""The filter against oracles of its own: NumPy in order, SciPy over the whole past, chi-square; and late fixes."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.stats import chi2

from hil.core.types import MeasuredPose, Pose, PoseCovariance
from hil.estimation.fused import History
from hil.estimation.kalman import (
    Acceptance,
    Belief,
    Covariance,
    Step,
    corrected,
    gate_of,
    moved,
    position_sigma_m,
    start,
)
from tests.support.examples import share_of_examples

Array = npt.NDArray[np.float64]

TICK_NS = 20_000_000
TICK_S = TICK_NS * 1e-9
FIX_EVERY = 5
TICKS = 50
START = Pose(0.5, -0.3, 2.5)
FIX_COVARIANCE = PoseCovariance(4e-4, 1e-4, 2e-5, 3e-4, -1e-5, 1e-4)
OPEN_GATE = math.inf
STATES = 5
TRIANGLE = np.triu_indices(STATES)


def matrix(covariance: Sequence[float], size: int) -> Array:
    full = np.zeros((size, size))
    full[np.triu_indices(size)] = covariance
    return full + np.triu(full, 1).T


class World:
    """A drive: true poses, the steps and fixes that a robot measures of it, all from one seed."""

    def __init__(self, seed: int, *, gyro: bool = True, ticks: int = TICKS) -> None:
        chance = np.random.default_rng(seed)
        self.first = start(0, START, 0.05, 0.05, 0.05, 0.02)
        prior = np.linalg.cholesky(matrix(self.first.covariance, STATES)) @ chance.standard_normal(STATES)
        x, y, heading, bias, scale = np.array([*START, 0.0, 1.0]) + prior
        fix_root = np.linalg.cholesky(matrix(FIX_COVARIANCE, 3))
        self.steps: list[Step] = []
        self.fixes: list[MeasuredPose] = []
        for tick in range(1, ticks + 1):
            way = 0.02, 0.01 * math.sin(tick / 9), 0.03, TICK_S if gyro else 0.0
            step = Step(*way, 1e-6, 4e-6, 1e-8, is_rolled=tick % 10 != 0)
            size = scale if step.is_rolled else 1.0
            forward, left = size * np.array([step.forward_m, step.left_m]) + chance.normal(0.0, 1e-3, 2)
            turned = step.turned_rad - bias * step.biased_s
            middle = heading + turned / 2
            x += math.cos(middle) * forward - math.sin(middle) * left
            y += math.sin(middle) * forward + math.cos(middle) * left
            heading += turned + chance.normal(0.0, 2e-3)
            bias += chance.normal(0.0, 1e-4)
            self.steps.append(step)
            if tick % FIX_EVERY == 0:
                noise = fix_root @ chance.standard_normal(3)
                wrapped = math.remainder(heading + noise[2], math.tau)
                self.fixes.append(
                    MeasuredPose(tick * TICK_NS, Pose(x + noise[0], y + noise[1], wrapped), FIX_COVARIANCE)
                )
        self.truth = np.array([x, y, heading, bias, scale])


def history_of(first: Belief, gate: float = OPEN_GATE, streak: int = 1000) -> History:
    return History(first, 10**10, Acceptance(gate, streak, 0.0, 1.0))


def believed(
    world: World, arrivals: Sequence[tuple[int, MeasuredPose]], gate: float = OPEN_GATE, streak: int = 1000
) -> Belief:
    """Return what is believed at the end of a drive when each fix arrives at its tick."""
    history = history_of(world.first, gate, streak)
    for tick, step in enumerate(world.steps, 1):
        history.append(step, tick * TICK_NS)
        if due := [fix for at, fix in arrivals if at == tick]:
            history.insert(due)
    return history.newest


def in_time(world: World) -> list[tuple[int, MeasuredPose]]:
    return [(-(-fix.time_ns // TICK_NS), fix) for fix in world.fixes]


def numbers(belief: Belief) -> Array:
    return np.array([belief.x_m, belief.y_m, belief.heading_rad, belief.bias_rad_s, belief.scale])


def step_by_matrix(state: Array, step: Step) -> Array:
    x, y, heading, bias, scale = state
    size = scale if step.is_rolled else 1.0
    turned = step.turned_rad - bias * step.biased_s
    middle = heading + turned / 2
    c, s = size * math.cos(middle), size * math.sin(middle)
    dx, dy = c * step.forward_m - s * step.left_m, s * step.forward_m + c * step.left_m
    return np.array([x + dx, y + dy, heading + turned, bias, scale])


def in_order_by_numpy(world: World) -> tuple[Array, Array]:
    """A textbook extended Kalman filter: Jacobians by differences, full matrices, Joseph's form."""
    state, p = numbers(world.first), matrix(world.first.covariance, STATES)
    fixes = {fix.time_ns // TICK_NS: fix for fix in world.fixes}
    h, width = np.eye(3, STATES), 1e-6
    for tick, step in enumerate(world.steps, 1):
        columns = [(step_by_matrix(state + e, step) - step_by_matrix(state - e, step)) for e in width * np.eye(STATES)]
        f = np.array(columns).T / (2 * width)
        q = np.diag([step.position_m2, step.position_m2, step.heading_rad2, step.bias_rad2_s2, 0.0])
        state, p = step_by_matrix(state, step), f @ p @ f.T + q
        if tick in fixes:
            r = matrix(fixes[tick].covariance, 3)
            innovation = np.array(fixes[tick].pose) - state[:3]
            innovation[2] = math.remainder(innovation[2], math.tau)
            k = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
            rest = np.eye(STATES) - k @ h
            state, p = state + k @ innovation, rest @ p @ rest.T + k @ r @ k.T
    return state, p


@pytest.mark.parametrize("gyro", [True, False])
def test_the_filter_is_the_textbooks(gyro):
    world = World(1, gyro=gyro)
    state, p = in_order_by_numpy(world)
    end = believed(world, in_time(world))
    assert numbers(end) == pytest.approx(state, abs=1e-7)
    assert np.array(end.covariance) == pytest.approx(p[TRIANGLE], rel=1e-5, abs=1e-10)


def test_the_filter_is_near_the_most_likely_past_of_all():
    """SciPy finds all states at once from all measurements; the filter, which linearises as it goes, ends beside it.

    The unknowns are the scale, which does not change, and then four numbers of each tick.
    """
    world = World(2)
    roots = [np.sqrt([s.position_m2, s.position_m2, s.heading_rad2, s.bias_rad2_s2]) for s in world.steps]
    whitener = np.linalg.inv(np.linalg.cholesky(matrix(FIX_COVARIANCE, 3)))
    prior = np.sqrt(np.diag(matrix(world.first.covariance, STATES)))

    def residuals(flat: Array) -> Array:
        states = np.column_stack([flat[1:].reshape(TICKS + 1, 4), np.full(TICKS + 1, flat[0])])
        parts = [(states[0] - numbers(world.first)) / prior]
        for before, after, step, root in zip(states, states[1:], world.steps, roots, strict=False):
            parts.append((after - step_by_matrix(before, step))[:4] / root)
        for fix in world.fixes:
            miss = states[fix.time_ns // TICK_NS][:3] - np.array(fix.pose)
            miss[2] = math.remainder(miss[2], math.tau)
            parts.append(whitener @ miss)
        return np.concatenate(parts)

    guess = [numbers(world.first)]
    for step in world.steps:
        guess.append(step_by_matrix(guess[-1], step))
    band = np.zeros((5 + 4 * TICKS + 3 * len(world.fixes), 1 + 4 * (TICKS + 1)))
    band[: 5 + 4 * TICKS, 0] = 1
    band[:5, 1:5] = 1
    for tick in range(TICKS):
        band[5 + 4 * tick : 9 + 4 * tick, 1 + 4 * tick : 9 + 4 * tick] = 1
    for row, fix in enumerate(world.fixes):
        at = 1 + 4 * (fix.time_ns // TICK_NS)
        band[5 + 4 * TICKS + 3 * row :, at : at + 4][:3] = 1
    first = np.concatenate([[1.0], np.array(guess)[:, :4].ravel()])
    found = least_squares(residuals, first, jac_sparsity=band, x_scale="jac").x
    best = np.array([*found[-4:], found[0]])
    end = believed(world, in_time(world))
    sigma = np.sqrt(np.diag(matrix(end.covariance, STATES)))
    assert abs(numbers(end) - best) / sigma == pytest.approx(np.zeros(STATES), abs=0.05)


def test_the_errors_are_as_large_as_the_covariance_says():
    """Normalised squared errors over 60 seeds: their sum is chi-square distributed with 5 degrees of freedom each."""
    total, seeds = 0.0, 60
    for seed in range(seeds):
        world = World(seed)
        end = believed(world, in_time(world))
        error = numbers(end) - world.truth
        total += error @ np.linalg.solve(matrix(end.covariance, STATES), error)
    assert chi2.ppf(0.001, STATES * seeds) < total < chi2.ppf(0.999, STATES * seeds)


@share_of_examples(0.3)
@given(st.lists(st.integers(0, 40), min_size=10, max_size=10), st.integers(0, TICK_NS - 1), st.randoms())
def test_late_and_out_of_order_is_exactly_in_order(delays, apart_ns, chance):
    """Bit for bit, with gate and streak of rejections: fixes between the ticks, two of one instant, outliers."""
    world = World(3)
    wrong = world.fixes[4]
    world.fixes[4] = wrong._replace(pose=wrong.pose._replace(x_m=wrong.pose.x_m + 3.0))
    world.fixes = [fix._replace(time_ns=fix.time_ns - apart_ns) for fix in world.fixes]
    world.fixes[7] = world.fixes[7]._replace(time_ns=world.fixes[6].time_ns)
    late = [(min(at + delay, TICKS), fix) for (at, fix), delay in zip(in_time(world), delays, strict=True)]
    chance.shuffle(late)
    expected = believed(world, in_time(world), gate_of(0.999), 3)
    assert expected.rejected >= 1
    assert believed(world, late, gate_of(0.999), 3) == expected


def test_a_fix_between_two_measurements_is_taken_at_its_own_instant():
    """Driving at 1 m/s without turning, a perfect fix half way through the step says where the robot is at its end."""
    history = history_of(start(0, Pose(0.0, 0.0, 0.0), 1.0, 1e-6, 1e-6, 1e-9))
    history.append(Step(0.02, 0.0, 0.0, TICK_S, 1e-12, 1e-12, 0.0), TICK_NS)
    fix = MeasuredPose(TICK_NS // 2, Pose(5.0, 1.0, 0.0), PoseCovariance(1e-10, 0.0, 0.0, 1e-10, 0.0, 1e-10))
    assert history.insert([fix]) == 0
    assert (history.newest.x_m, history.newest.y_m) == pytest.approx((5.01, 1.0), abs=1e-6)
    assert history.insert([fix]) == 1, "the same fix again is no news"


def test_the_past_is_no_longer_than_asked_for():
    history = History(start(0, START, 0.1, 0.1, 0.1, 0.1), 100 * TICK_NS, Acceptance(OPEN_GATE, 1000, 0.0, 1.0))
    for tick in range(1, 1000):
        history.append(Step(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), tick * TICK_NS)
        assert history.begin_ns == max(0, tick - 100) * TICK_NS


@given(st.floats(0.5, 0.999999))
def test_the_gate_is_chi_squares(probability):
    assert gate_of(probability) == pytest.approx(chi2.ppf(probability, 3), rel=1e-6)


def test_the_gate_lets_through_as_many_right_fixes_as_it_says():
    """Of first fixes: a right one that is rejected leaves an error behind, and makes the next rejection likelier."""
    made, taken = 300, 0
    for seed in range(made):
        world = World(seed, ticks=FIX_EVERY)
        taken += believed(world, in_time(world), gate_of(0.9)).accepted
    assert abs(taken - 0.9 * made) < 4 * math.sqrt(made * 0.9 * 0.1)


def test_outliers_are_rejected_and_change_nothing():
    world = World(5)
    clean = believed(world, in_time(world), gate_of(0.9999))
    wrong = [
        fix._replace(time_ns=fix.time_ns + 1, pose=Pose(fix.pose.x_m + dx, fix.pose.y_m, fix.pose.heading_rad))
        for fix, dx in zip(world.fixes, itertools.cycle((1.0, -1.0, 2.0)))
    ]
    arrivals = in_time(world) + [(fix.time_ns // TICK_NS + 1, fix) for fix in wrong[:-1]]
    fouled = believed(world, arrivals, gate_of(0.9999), streak=3)
    assert (clean.rejected, fouled.rejected, fouled.restarts) == (0, len(wrong) - 1, 0)
    assert fouled.accepted == clean.accepted
    # A rejected fix splits its step in two, so the numbers differ by what the midpoint rule leaves.
    assert numbers(fouled) == pytest.approx(numbers(clean), abs=1e-6)


@given(st.floats(0.5, 20.0), st.floats(-3.0, 3.0), st.floats(-2.5, 2.5))
@share_of_examples(0.3)
def test_a_robot_that_was_carried_away_is_found_after_the_streak(dx, dy, turned):
    """Fixes of another place that agree with one another and with the motion are believed, at any heading."""
    world = World(6)
    c, s = math.cos(turned), math.sin(turned)
    elsewhere = [
        fix._replace(
            pose=Pose(
                dx + c * fix.pose.x_m - s * fix.pose.y_m, dy + s * fix.pose.x_m + c * fix.pose.y_m,
                fix.pose.heading_rad + turned,
            ),
            covariance=PoseCovariance(4e-4, 0.0, 0.0, 4e-4, 0.0, 1e-4),
        )
        for fix in world.fixes
    ]  # fmt: skip
    world.fixes[4:] = elsewhere[4:]
    end = believed(world, in_time(world), gate_of(0.999), streak=4)
    assert end.restarts == 1
    assert (end.rejected, end.streak) == (3, 0)
    x, y, heading, _, _ = world.truth
    assert (end.x_m, end.y_m) == pytest.approx((dx + c * x - s * y, dy + s * x + c * y), abs=0.1)
    assert math.remainder(end.heading_rad - heading - turned, math.tau) == pytest.approx(0.0, abs=0.05)


def test_fixes_that_disagree_with_one_another_are_never_believed():
    world = World(7)
    world.fixes = [
        fix._replace(pose=fix.pose._replace(x_m=fix.pose.x_m + 3.0 + number))
        for number, fix in enumerate(world.fixes)
    ]  # fmt: skip
    end = believed(world, in_time(world), gate_of(0.999), streak=2)
    assert (end.accepted, end.restarts, end.streak) == (0, 0, 1)


@given(st.lists(st.floats(-1, 1), min_size=25, max_size=25), st.floats(-4, 4), st.floats(-0.1, 0.1))
def test_a_covariance_stays_one(entries, heading, turned):
    root = np.array(entries).reshape(STATES, STATES)
    p = root @ root.T + 1e-6 * np.eye(STATES)
    belief = start(0, Pose(0.0, 0.0, heading), 1.0, 1.0, 1.0, 1.0)._replace(covariance=Covariance(*p[TRIANGLE]))
    after = moved(belief, Step(0.05, -0.02, turned, TICK_S, 1e-6, 1e-6, 1e-8), TICK_NS)
    fix = MeasuredPose(TICK_NS, Pose(after.x_m, after.y_m, after.heading_rad), FIX_COVARIANCE)
    for one in (after, corrected(after, fix, Acceptance(OPEN_GATE, 2, 0.0, 1.0))):
        assert np.linalg.eigvalsh(matrix(one.covariance, STATES)).min() > 0.0
        worst = np.linalg.eigvalsh(matrix(one.covariance, STATES)[:2, :2]).max()
        assert position_sigma_m(one.covariance) == pytest.approx(math.sqrt(worst))


EXPONENTS = st.floats(-10.0, 6.0)
COVARIANCES = st.builds(
    lambda x, y, h, c, d, e: PoseCovariance(
        10**x, c * 10 ** ((x + y) / 2), d * 10 ** ((x + h) / 2), 10**y, e * 10 ** ((y + h) / 2), 10**h
    ),
    *[EXPONENTS] * 3,
    *[st.floats(-1.0, 1.0)] * 3,
)
ADVERSE = [
    PoseCovariance(1.147, 0, 0, 2.418e-9, 0.006976, 20124.4),
    PoseCovariance(1e-10, 0, 0, 1e-10, 0, 1e-10),
    PoseCovariance(724.25, 0, 0, 1.058e-10, -0.0037205, 130810.8),
]


@given(st.lists(COVARIANCES, min_size=1, max_size=8), st.booleans())
@example(ADVERSE, False)
@example(ADVERSE, True)
@example([PoseCovariance(0.1, 0.09843750000000001, 0.01976423537605237, 0.1, -0.05929270612815711, 1.0)] * 2, True)
def test_no_sequence_of_covariances_makes_a_variance_negative_or_ends_the_run(covariances, moves):
    """Singular and impossible ones among them, which a message is refused for: the filter rejects them all the same."""
    belief = start(0, START, 0.05, 0.05, 0.05, 0.02)
    for number, covariance in enumerate(covariances, 1):
        if moves:
            belief = moved(belief, Step(0.5, 0.1, 0.3, 0.01, 1e-6, 1e-6, 1e-8), number * TICK_NS)
        pose = Pose(belief.x_m, belief.y_m, belief.heading_rad + 1e-3 * (-1) ** number)
        belief = corrected(belief, MeasuredPose(belief.time_ns, pose, covariance), Acceptance(16.0, 3, 0.0, 16.0))
        p = belief.covariance
        assert all(math.isfinite(entry) for entry in (*belief[1:6], *p))
        assert min(p.xx, p.yy, p.hh, p.bb, p.ss) > 0.0


def learning(world: World) -> Belief:
    """Return what is believed at the end when each fix comes in time, and their noise is learnt."""
    acceptance = Acceptance(gate_of(0.999), 1000, 0.0, 16.0)
    history = History(world.first, 10**9, acceptance)
    fixes = iter(world.fixes)
    for tick, step in enumerate(world.steps, 1):
        history.append(step, tick * TICK_NS)
        if tick % FIX_EVERY == 0:
            history.insert([next(fixes)])
    return history.newest


@pytest.mark.parametrize("times", [1.0, 2.0, 3.0])
def test_how_noisy_fixes_are_is_learnt_from_them(times):
    """The noise is this factor times the reported one, in each of 300 fixes; the reported one is the least believed."""
    for seed in range(3):
        world, chance = World(seed, ticks=300 * FIX_EVERY), np.random.default_rng(seed + 1000)
        more = math.sqrt(times**2 - 1.0) * np.linalg.cholesky(matrix(FIX_COVARIANCE, 3))
        world.fixes = [
            fix._replace(pose=Pose(*(np.array(fix.pose) + more @ chance.standard_normal(3)).tolist()))
            for fix in world.fixes
        ]
        end = learning(world)
        assert math.sqrt(end.noise) == pytest.approx(times, rel=0.2)
        assert end.rejected < 30


def squared_distance(last: MeasuredPose, then: Belief, fix: MeasuredPose, now: Belief) -> float:
    """Return how far two fixes are apart, by the motion that is believed and all their noise, in matrices."""
    angle = last.pose.heading_rad - then.heading_rad
    c, s = math.cos(angle), math.sin(angle)
    moved_by = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ (numbers(now) - numbers(then))[:3]
    off = np.array(fix.pose) - np.array(last.pose) - moved_by
    off[2] = math.remainder(off[2], math.tau)
    turn = np.eye(3)  # how the new pose follows from the last fix
    turn[:2, 2] = -moved_by[1], moved_by[0]
    noise = matrix(fix.covariance, 3) + turn @ matrix(last.covariance, 3) @ turn.T
    before, grown = (np.diag(matrix(one.covariance, STATES))[:3] for one in (then, now))
    return float(off @ np.linalg.inv(now.noise * noise + np.diag(np.maximum(grown - before, 0.0))) @ off)


def test_what_two_fixes_tell_of_their_noise_is_that_of_matrices():
    world, chance = World(10), np.random.default_rng(10)
    now, told = world.first, []
    for tick, step in enumerate(world.steps, 1):
        now = moved(now, step._replace(forward_m=0.2), tick * TICK_NS)
        if tick % FIX_EVERY == 0:
            root = chance.normal(0.0, 0.05, (3, 3))
            pose = np.array([now.x_m, now.y_m, now.heading_rad]) + 1.5 * root @ chance.standard_normal(3)
            fix = MeasuredPose(tick * TICK_NS, Pose(*pose), PoseCovariance(*(root @ root.T)[np.triu_indices(3)]))
            after = corrected(now, fix, Acceptance(OPEN_GATE, 1000, 0.0, 16.0))
            if now.last_fix is not None and now.last_belief is not None:
                apart = squared_distance(now.last_fix, now.last_belief, fix, now)
                told.append(math.log(after.noise / now.noise) * (20 + len(told)) - (apart / 3.0 - 1.0))
            now = after
    assert told == pytest.approx([0.0] * (TICKS // FIX_EVERY - 1), abs=1e-9)


def test_outliers_do_not_make_fixes_look_noisy():
    world = World(8, ticks=120 * FIX_EVERY)
    world.fixes[10::5] = [fix._replace(pose=fix.pose._replace(x_m=fix.pose.x_m + 1.0)) for fix in world.fixes[10::5]]
    end = learning(world)
    assert end.rejected == len(world.fixes[10::5])
    assert math.sqrt(end.noise) < 1.2


@given(st.integers(1, 12), st.integers(1, 40))
def test_steps_that_are_replaced_are_as_if_they_had_been_there_at_first(replaced, ticks):
    """With fixes among them, bit for bit; more steps than there are change those that are."""
    world = World(9)
    ticks = min(ticks, TICKS)
    at_first, replacing = history_of(world.first), history_of(world.first)
    other = [step._replace(forward_m=2.0 * step.forward_m, is_rolled=False) for step in world.steps[:ticks]]
    begin = max(0, ticks - replaced)
    for tick, step in enumerate(world.steps[:ticks], 1):
        at_first.append(step if tick <= begin else other[tick - 1], tick * TICK_NS)
        replacing.append(step, tick * TICK_NS)
        if tick % FIX_EVERY == 0:
            for history in (at_first, replacing):
                history.insert([world.fixes[tick // FIX_EVERY - 1]])
    surplus = [world.steps[0]] * max(0, replaced - ticks)
    replacing.replace([*surplus, *other[begin:]])
    assert replacing.newest == at_first.newest
