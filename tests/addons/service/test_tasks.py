"""The tasks of an armed robot, without a robot: when each ends, and what its figures say."""

import math
from dataclasses import replace

import pytest

from hil.addons.service.messages import Task
from hil.addons.service.tasks import NOWHERE, LawElsewhere, Tasks
from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist
from hil.core.types import NO_GAINS, ZERO_WHEELS, Applied, CommandMode, Pose, Reference, State, Twist, WheelCommand
from hil.scenario import ServiceTable

OPTIONS = replace(ServiceTable(), twist_timeout_s=0.25, error_limit_m=0.5)
STATE = State(Pose(1.0, -2.0, 0.5), Twist(0.1, -0.2, 0.3))


def begun(t_s: float = 10.0) -> Tasks:
    tasks = Tasks(OPTIONS)
    tasks.begin()
    tasks.at(t_s, STATE)
    return tasks


def test_a_twist_has_an_age_and_times_out_to_rest() -> None:
    tasks = begun()
    assert (tasks.task, tasks.twist_age_s) == (Task.HOLD, None)
    assert tasks.twist(BodyTwist(0.2, -0.1, 0.3)) == (0.2, -0.1, 0.3)
    assert (tasks.task, tasks.twist_age_s) == (Task.TWIST, pytest.approx(0.0))
    tasks.at(10.125, STATE)
    assert tasks.twist_age_s == pytest.approx(0.125)
    tasks.at(10.25, STATE)
    assert tasks.task is Task.TWIST
    tasks.at(10.2501, STATE)
    assert (tasks.task, tasks.twist_age_s) == (Task.HOLD, None)


def test_a_twist_that_is_renewed_goes_on_from_its_speed() -> None:
    tasks = begun()
    speeds = []
    for number in range(1, 6):
        tasks.twist(BodyTwist(0.4, 0.0, 0.0))
        speeds.append(math.hypot(*tasks.at(10.0 + 0.1 * number, STATE).twist[:2]))
    assert speeds == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.4])


def test_a_robot_too_far_from_its_reference_is_held_where_it_is() -> None:
    tasks = begun()
    tasks.twist(BodyTwist(0.2, 0.0, 0.0))
    tasks.go(Pose(9.0, 9.0, 0.0))
    for _ in range(2):  # at rest first, then on its way
        tasks.at(10.1, STATE)
    where = tasks.at(10.1, STATE).pose
    off = State(Pose(where.x_m + 0.29, where.y_m - 0.4, 0.5), STATE.twist)  # by 0.494 m
    tasks.at(10.1, off)
    assert (tasks.task, tasks.gave_up) == (Task.GO, None)
    off = State(Pose(where.x_m - 0.31, where.y_m + 0.4, 0.5), STATE.twist)  # by 0.506 m
    found = tasks.at(10.1, off)
    assert (tasks.task, tasks.gave_up) == (Task.HOLD, "the robot is more than 0.5 m from where it should be")
    assert found.pose == off.pose
    assert found.twist == (0.0, 0.0, 0.0)


def test_where_a_robot_was_held_its_task_is_given_up_but_rest_needs_none() -> None:
    tasks = Tasks(OPTIONS)
    tasks.begin()
    tasks.held()
    assert tasks.gave_up is None, "there was no motion yet"
    tasks = begun()
    tasks.twist(BodyTwist(0.2, 0.0, 0.0))
    tasks.held()
    said = "the robot was stopped: its feedback or pose is too old, or the estimate not sure enough"
    assert (tasks.task, tasks.gave_up, tasks.reference) == (Task.HOLD, said, None)


def test_without_a_pose_nothing_begins() -> None:
    tasks = Tasks(OPTIONS)
    tasks.begin()
    assert tasks.at(1.0, None) is NOWHERE
    for order in (tasks.stop, lambda: tasks.twist(BodyTwist(0.1, 0.0, 0.0)), lambda: tasks.go(Pose(1.0, 0.0, 0.0))):
        with pytest.raises(BadInputError, match="the robot's pose is not known; wait until the status has a pose"):
            order()


def test_wheel_commands_count_on_and_begin_anew_with_each_arming() -> None:
    tasks = begun()
    tasks.command_wheels((1.0, 2.0, 3.0, 4.0), 0)
    assert (tasks.task, tasks.wheels, tasks.sequence) == (Task.WHEELS, (1.0, 2.0, 3.0, 4.0), 0)
    reference = tasks.at(10.25, STATE)
    assert (reference.pose, reference.twist, reference.acceleration) == (*STATE, (0.0, 0.0, 0.0))
    with pytest.raises(BadInputError, match="sequence = 0: it came after 0; count on, or disarm and arm"):
        tasks.command_wheels((9.0, 9.0, 9.0, 9.0), 0)
    tasks.command_wheels((4.0, 3.0, 2.0, 1.0), None)
    assert (tasks.wheels, tasks.sequence) == ((4.0, 3.0, 2.0, 1.0), None)
    with pytest.raises(BadInputError, match="it came after 0"):
        tasks.command_wheels((9.0, 9.0, 9.0, 9.0), 0)
    tasks.at(10.5, STATE)
    assert tasks.task is Task.WHEELS
    tasks.at(10.51, STATE)
    assert (tasks.task, tasks.wheels) == (Task.HOLD, None)
    tasks.end()
    assert (tasks.task, tasks.reference) == (None, None)
    tasks.begin()
    tasks.at(11.0, STATE)
    tasks.command_wheels((1.0, 1.0, 1.0, 1.0), 0)


class Law:
    """A law that tells how it was called."""

    gains = NO_GAINS

    def __init__(self) -> None:
        self.calls: list[str] = []

    def reset(self, state: State, reference: Reference) -> None:
        assert (state, reference) == (STATE, NOWHERE)
        self.calls.append("reset")

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        assert (state, reference, dt_s) == (STATE, NOWHERE, 0.01)
        self.calls.append("update")
        return WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS)


@pytest.mark.parametrize("mode", list(CommandMode))
def test_a_law_elsewhere_takes_the_place_of_ours_which_starts_anew_after_it(mode: CommandMode) -> None:
    tasks, law = begun(), Law()
    both = LawElsewhere(law, tasks, mode)
    applied = Applied(WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS), False, 0.0)

    def asked() -> WheelCommand:
        return both.update(NOWHERE, STATE, applied, 0.01)

    asked()
    tasks.command_wheels((1.0, 2.0, 3.0, 4.0), None)
    command = asked()
    speeds, torques = (1.0, 2.0, 3.0, 4.0), (0.0, 0.0, 0.0, 0.0)
    if mode is CommandMode.TORQUE:
        speeds, torques = torques, speeds
    assert (command.mode, command.speed_rad_s, command.torque_n_m) == (mode, speeds, torques)
    tasks.stop()
    asked()
    asked()
    assert law.calls == ["update", "reset", "update", "update"]
