"""The law `mpc`: against SciPy where limits bind and where none does, and over the wire on the circle of comparison."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.core import extras
from hil.core.errors import BadInputError
from hil.core.types import CommandMode, Pose, Reference, State, Twist, Wheels
from hil.laws.mpc import Mpc
from hil.references.shapes import Hold
from tests.support.closed_loop import AT_REST, PAPER_CIRCLE, PAPER_ROBOT, after, derivative
from tests.support.examples import share_of_examples

DT_S = 0.005
ROBOT = dataclasses.replace(PAPER_ROBOT, torque_limit_n_m=1.8, speed_limit_rad_s=20.0)
GOAL = Hold(0.0, 0.0, 0.0).at(0.0)

near = st.floats(-0.02, 0.02)
far = st.floats(-0.6, 0.6)
speed = st.floats(-0.8, 0.8)
FEW = {"horizon_s": 0.12, "steps": 4, "most_iterations": 20_000}


def law(robot=ROBOT, **options):
    return Mpc(robot, CommandMode.TORQUE, Mpc.Options(**options))


def first_command(controller: Mpc, error: tuple[float, ...]) -> Wheels:
    """Return the torques of the first tick on the way to a pose at rest, its axes along the world's."""
    x, y, heading, *twist = error
    # Turned by the heading as a whole, so that the body's axes are the world's and the error stays.
    goal = Reference(Pose(-x, -y, -heading), GOAL.twist, GOAL.acceleration)
    state = State(Pose(0.0, 0.0, 0.0), Twist(*twist))
    controller.reset(state, goal)
    return controller.update(goal, state, AT_REST, DT_S).torque_n_m


def horizon(options: Mpc.Options) -> tuple[np.ndarray, ...]:
    """Return A, B, Q of the plan, and SciPy's cost from the last step on."""
    h = options.horizon_s / options.steps
    axis = scipy.linalg.expm(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]) * h)
    a, b = np.kron(axis[:2, :2], np.eye(3)), np.kron(axis[:2, 2:], np.eye(3))
    q = np.kron(np.diag([options.error_1_s4, options.rate_1_s2]), np.eye(3))
    return a, b, q, scipy.linalg.solve_discrete_are(a, b, q, np.eye(3))


@given(st.tuples(near, near, near, near, near, near))
def test_where_no_limit_binds_the_plan_is_scipys_lqr(error):
    a, b, _, cost = horizon(Mpc.Options())
    controller = law(dataclasses.replace(ROBOT, torque_limit_n_m=15.0))
    torque = first_command(controller, error)
    assert controller.iterations == 0
    expected = -np.linalg.solve(np.eye(3) + b.T @ cost @ b, b.T @ cost @ a) @ error
    found = derivative(ROBOT, (0.0, 0.0, 0.0, *error[3:]), torque)[3:]
    assert found == pytest.approx(tuple(expected), rel=1e-6, abs=1e-9)


@share_of_examples(0.1)
@given(st.tuples(far, far, st.floats(-1.5, 1.5), speed, speed, speed))
def test_where_limits_bind_the_plan_is_scipys_too(error):
    """The moves alone, by sequential quadratic programming; what wheels exceed their speed by costs its square."""
    options = Mpc.Options(**FEW)
    a, b, q, end = horizon(options)
    radius, lever = ROBOT.wheel_radius_m, ROBOT.lever_m
    rims = np.array([[1.0, -1.0, -lever], [1.0, 1.0, lever], [1.0, -1.0, lever], [1.0, 1.0, -lever]])
    inertias = np.diag([ROBOT.effective_mass_kg] * 2 + [ROBOT.effective_inertia_kg_m2])
    to_torques = radius / 4.0 * rims @ np.diag([1.0, 1.0, 1.0 / lever**2]) @ inertias
    known = np.array(ROBOT.wheel_torques((0.0, 0.0, 0.0), error[3:], 0.0, (0.0, 0.0, 0.0)))
    limits = ROBOT.torque_limit_n_m * np.array([1.0, *[options.later_share] * (options.steps - 1)])

    def states(moves):
        x = np.array(error)
        for u in moves.reshape(-1, 3):
            x = a @ x + b @ u
            yield x

    # What states are, and how they depend on moves, column by column.
    free = np.concatenate(list(states(np.zeros(3 * options.steps))))
    effect = np.array([np.concatenate(list(states(one))) - free for one in np.eye(3 * options.steps)]).T
    weights = scipy.linalg.block_diag(*[q] * (options.steps - 1), end)
    turning = np.kron(np.eye(options.steps), np.hstack([np.zeros((4, 3)), rims / radius]))

    def cost(moves):
        x = free + effect @ moves
        excess = turning @ x
        excess -= np.clip(excess, -ROBOT.speed_limit_rad_s, ROBOT.speed_limit_rad_s)
        value = x @ weights @ x + moves @ moves + 1e5 * excess @ excess
        slope = 2.0 * (effect.T @ (weights @ x + 1e5 * turning.T @ excess) + moves)
        return 1e-4 * value, 1e-4 * slope

    pushed = np.kron(np.eye(options.steps), to_torques)
    low, high = (np.repeat(side * limits, 4) - np.tile(known, options.steps) for side in (-1.0, 1.0))
    rows = {
        "type": "ineq",
        "fun": lambda moves: np.concatenate([high - pushed @ moves, pushed @ moves - low]),
        "jac": lambda _: np.vstack([-pushed, pushed]),
    }
    found = scipy.optimize.minimize(
        cost, np.zeros(3 * options.steps), jac=True, constraints=[rows], method="SLSQP",
        options={"maxiter": 1000, "ftol": 1e-12},
    )  # fmt: skip
    expected = to_torques @ found.x[:3] + known
    # The law's own tolerance, for 50 in place of 200 iterations, leaves up to 0.08 N·m; the plan itself is scipy's.
    assert first_command(law(**FEW), error) == pytest.approx(tuple(expected), abs=0.1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hil.laws.mpc._ACCURACY", 1e-6)
        patch.setattr("hil.laws.mpc._GRADIENT_SHARE", 1e-7)
        assert first_command(law(**FEW), error) == pytest.approx(tuple(expected), abs=0.01)


def drive(controller: Mpc, start: Pose, ticks: int) -> tuple[list[Wheels], list[float], list[int]]:
    """Drive the paper's robot onto the circle; return torques, the fastest wheel, and the iterations of each tick."""
    motion = (*start, 0.0, 0.0, 0.0)
    torques, fastest, iterations = [], [], []
    for number in range(ticks):
        reference = PAPER_CIRCLE.at(number * DT_S)
        state = State(Pose(*motion[:3]), Twist(*motion[3:]))
        if number == 0:
            controller.reset(state, reference)
        applied = AT_REST._replace(command=AT_REST.command._replace(torque_n_m=torques[-1])) if torques else AT_REST
        torques.append(controller.update(reference, state, applied, DT_S).torque_n_m)
        iterations.append(controller.iterations)
        motion = after(ROBOT, motion, torques[-1], DT_S)
        fastest.append(max(map(abs, ROBOT.wheel_speeds(motion[3:], motion[2]))))
    assert math.hypot(motion[0] - reference.pose.x_m, motion[1] - reference.pose.y_m) < 5e-3
    return torques, fastest, iterations


def test_the_wheels_are_kept_within_torque_and_speed_without_a_guard():
    """From 1.2 m away the way is long enough to be as fast as the wheels can; the solver has the time that it needs."""
    torques, fastest, iterations = drive(law(most_iterations=4000), Pose(-0.2, 0.3, 2.0), 500)
    assert max(map(abs, itertools.chain(*torques))) <= 1.005 * ROBOT.torque_limit_n_m
    assert 0.97 * ROBOT.speed_limit_rad_s < max(fastest) <= 1.025 * ROBOT.speed_limit_rad_s
    assert iterations[0] > 0
    assert iterations[-1] == 0


def test_after_a_reset_everything_is_as_it_was():
    """The solver too: it begins with nothing, so the same run gives the same torques to the last bit."""
    controller = law()
    first, second = (drive(controller, Pose(0.4, 0.3, 0.0), 250)[0] for _ in range(2))
    assert first == second


@pytest.mark.parametrize("place", range(6))
def test_a_state_that_is_no_number_raises_nothing(place):
    values = [0.7] * 6
    controller = law()
    before = first_command(controller, tuple(values))
    values[place] = math.nan
    command = controller.update(GOAL, State(Pose(*values[:3]), Twist(*values[3:])), AT_REST, DT_S)
    assert any(map(math.isnan, command.torque_n_m))
    assert first_command(controller, (0.7,) * 6) == before


def test_a_wheel_whose_friction_is_beyond_its_torque_is_no_error():
    stuck = dataclasses.replace(ROBOT, torque_limit_n_m=0.2, friction_coefficient=0.1)
    controller, moving = law(stuck), PAPER_CIRCLE.at(1.0)
    state = State(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0))
    controller.reset(state, moving)
    assert all(map(math.isfinite, controller.update(moving, state, AT_REST, DT_S).torque_n_m))


def test_without_its_extra_the_law_names_it(monkeypatch):
    monkeypatch.setitem(extras.EXTRAS, "mpc", ("no_such_module",))
    with pytest.raises(BadInputError, match=r"controller\.law = 'mpc' needs no_such_module, .*\[mpc\]"):
        law()


@pytest.mark.parametrize(("torque_n_m", "t10_s"), [(5.0, 0.62), (1.8, 0.83)])
def test_over_the_wire_the_robot_is_on_the_circle_in_time_and_stays_there(torque_n_m, t10_s):
    limits = {"robot.torque_limit_n_m": torque_n_m, "firmware.torque_limit_n_m": torque_n_m}
    run = {"controller.law": "mpc", "controller.gains": {}, "loop.duration_s": 8.0, "expect": []}
    result = hil.run("compare_circle", set=limits | run)
    assert result.metrics["t10_s"] <= t10_s
    assert result.metrics["steady_rms_m"] <= 0.1e-3
    for wheel in Wheels._fields:
        assert np.abs(result.signals[f"wheel.{wheel}.speed_rad_s"]).max() < 1.05 * ROBOT.speed_limit_rad_s
