"""A hand that pushes a virtual robot in this process, where a person pushes a real one."""

import math

from hil.commission.session import Session
from hil.core.model import GRAVITY_M_S2
from hil.drivers.port import clamp

_PUSHES = ("push.force_x_n", "push.force_y_n", "push.moment_n_m")
_HAND_M, _HAND_RAD, _HAND_SPEED, _HAND_STEPS = 0.6, math.tau, 0.4, 1200


def push_by_hand(session: Session, axis: int) -> None:
    """Push a virtual robot in this process forward, to the left or round (axis 0 to 2), as a hand would.

    A real robot is pushed by the person. Raises BadInputError for a plant that cannot be pushed.
    """
    local, truth = session.bench.local, session.bench.truth
    if local is None or truth is None:
        return
    robot = session.scenario.robot
    start = truth.poll()
    assert start is not None
    begin, wanted, force = start.pose, _HAND_M if axis < 2 else _HAND_RAD, 0.0
    c, s = math.cos(begin.heading_rad), math.sin(begin.heading_rad)
    along = ((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0))[axis]
    heavy = (robot.effective_mass_kg, robot.effective_mass_kg, robot.effective_inertia_kg_m2)[axis]
    arm_m = 1.0 if axis < 2 else robot.lever_m
    for _ in range(_HAND_STEPS):
        fix = truth.poll()
        assert fix is not None
        way = sum(part * (now - then) for part, now, then in zip(along, fix.pose, begin, strict=True))
        speed = sum(part * now for part, now in zip(along, fix.twist, strict=True))
        if way >= wanted and abs(speed) < 0.02:
            break
        target = _HAND_SPEED if way < wanted else 0.0
        # A hand pushes harder until it moves: the friction is not known.
        force += heavy * (target - speed) * (1.0 if target > speed else 0.0)
        push = heavy * (target - speed) * 4.0 + (force if target else 0.0)
        limit = robot.mass_kg * GRAVITY_M_S2 * arm_m * 0.3
        push = clamp(push, limit)
        local.set_variables(dict(zip(_PUSHES, (push * part for part in along), strict=True)))
        session.listen(0.05)
    local.set_variables(dict.fromkeys(_PUSHES, 0.0))
    session.listen(1.0)
