"""A law knows no left and no right, no forward and no backward: mirrored inputs give mirrored commands.

Each reflection is that of the world and the robot in it. To the left and right: y, the heading and all that follows
from them change sign, and the wheels of the two sides change places. To the front and rear: x and the heading change
sign, and the wheels of the two ends change places and turn the other way.
"""

import dataclasses
from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.guard import Guard
from hil.core.types import (
    ZERO_WHEELS,
    Acceleration,
    Applied,
    CommandMode,
    Pose,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.laws.law_registry import shipped_laws
from tests.support.closed_loop import PAPER_ROBOT
from tests.support.examples import share_of_examples

SHIPPED = shipped_laws()

ROBOT = dataclasses.replace(PAPER_ROBOT, friction_coefficient=0.03, speed_limit_rad_s=20.0)
PERIOD_S = 0.005

# Beyond what wheels can do: a law is asked with whatever the estimator and the reference say.
coordinate = st.floats(-4.0, 4.0)
poses = st.builds(Pose, coordinate, coordinate, st.floats(-7.0, 7.0))
twists = st.builds(Twist, coordinate, coordinate, st.floats(-8.0, 8.0))
states = st.builds(State, poses, twists)
references = st.builds(Reference, poses, twists, st.builds(Acceleration, coordinate, coordinate, coordinate))
ticks = st.lists(
    st.tuples(references, states, st.sampled_from([1, 1, 3]), st.booleans(), st.sampled_from([0.0, 0.004, 0.02])),
    min_size=1,
    max_size=4,
)

# The robot turns away faster than any limit, by more than the wheels can change within the tick.
FASTER_THAN_ITS_LIMIT = (
    Reference(Pose(0.0, 0.0, -6.5), Twist(0.0, 0.0, 0.0), Acceleration(0.0, 0.0, 0.0)),
    State(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, -7.0)),
    1,
    False,
    0.0,
)


def made(law: str, mode: CommandMode):
    kind = SHIPPED[law]
    return kind(ROBOT, mode, kind.Options())


def modes_of(law: str):
    for mode in CommandMode:
        try:
            made(law, mode)
        except BadInputError:
            continue  # it makes no sense in this mode, and says so
        yield law, mode


LAWS = [pair for law in SHIPPED for pair in modes_of(law)]


class Reflection:
    """Signs of x, y and heading, and what becomes of the wheels FL, FR, RR, RL."""

    def __init__(self, x: float, y: float, heading: float, wheels: Callable[..., Wheels]) -> None:
        self._signs = x, y, heading
        self._wheels = wheels

    def axes(self, kind, axes):
        return kind(*(sign * value for sign, value in zip(self._signs, axes, strict=True)))

    def state(self, state: State) -> State:
        return State(self.axes(Pose, state.pose), self.axes(Twist, state.twist))

    def reference(self, reference: Reference) -> Reference:
        pose, twist, acceleration = reference
        return Reference(self.axes(Pose, pose), self.axes(Twist, twist), self.axes(Acceleration, acceleration))

    def command(self, command: WheelCommand) -> WheelCommand:
        return WheelCommand(command.mode, self._wheels(*command.speed_rad_s), self._wheels(*command.torque_n_m))


LEFT_RIGHT = Reflection(1.0, -1.0, -1.0, lambda fl, fr, rr, rl: Wheels(fr, fl, rl, rr))
FRONT_REAR = Reflection(-1.0, 1.0, -1.0, lambda fl, fr, rr, rl: Wheels(-rl, -rr, -fr, -fl))


@pytest.mark.parametrize("reflection", [LEFT_RIGHT, FRONT_REAR], ids=["left_right", "front_rear"])
@pytest.mark.parametrize(("law", "mode"), LAWS)
@share_of_examples(0.15)
@given(ticks=ticks)
@example(ticks=[FASTER_THAN_ITS_LIMIT])
def test_mirrored_inputs_give_mirrored_commands(law, mode, reflection, ticks):
    one, other = made(law, mode), made(law, mode)
    guard = Guard(ROBOT.speed_limit_rad_s, ROBOT.torque_limit_n_m)
    first_reference, first_state, *_ = ticks[0]
    one.reset(first_state, first_reference)
    other.reset(reflection.state(first_state), reflection.reference(first_reference))
    rest = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
    applied = mirrored = (rest, False)
    for reference, state, periods, is_limited, latency_s in ticks:
        dt_s = periods * PERIOD_S
        wanted = one.update(reference, state, Applied(*applied, latency_s), dt_s)
        found = other.update(
            reflection.reference(reference), reflection.state(state), Applied(*mirrored, latency_s), dt_s
        )
        expected = reflection.command(wanted)
        for quantity in ("speed_rad_s", "torque_n_m"):
            assert [*getattr(found, quantity)] == pytest.approx([*getattr(expected, quantity)], rel=1e-9, abs=1e-7)
        applied, mirrored = (guard.apply(said) if is_limited else (said, False) for said in (wanted, found))
