"""Latency acts on robot time, and leaves lockstep and handshake alone."""

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.ports import Received
from hil.faults.kinds import link_faults
from hil.faults.rows import FaultRow, ScenarioTime
from hil.wire.byte_faults import BusFaults
from hil.wire.conditions import ConditionedLink
from tests.support.heard import everything


class Robot:
    """The other end: keeps the sent data, and gives the data put into it."""

    def __init__(self):
        self.sent: list[tuple[int, Frame]] = []
        self.to_give: list[Frame] = []
        self.now = 0

    def now_ns(self):
        return self.now

    def send(self, frame):
        self.sent.append((self.now, frame))

    def receive(self, _timeout_ns):
        return Received((self.to_give.pop(0),), self.now) if self.to_give else None

    def rejected(self):
        return {}

    def close(self):
        pass


def command(sequence):
    return Frame(m.WheelCommand.ID, m.WheelCommand(0, 0, 0, 0, sequence & 0xFF, 0).encode())


STEP = Frame(m.Step.ID, m.Step(0, 1).encode())


@given(gaps=st.lists(st.integers(0, 10), min_size=1, max_size=30), latency=st.integers(0, 25))
def test_commands_arrive_in_order_after_exactly_the_latency(gaps, latency):
    robot = Robot()
    link = ConditionedLink(robot, robot, command_latency_ns=latency)
    sent_at = []
    for number, gap in enumerate(gaps):
        end = robot.now + gap
        while (due := link.next_due_ns()) is not None and due <= end:
            robot.now = due
            link.service()
        robot.now = end
        sent_at.append(robot.now)
        link.send(command(number))
        link.service()
    while (due := link.next_due_ns()) is not None:
        robot.now = due
        link.service()
    assert robot.sent == [(t + latency, command(n)) for n, t in enumerate(sent_at)]


@given(latency=st.integers(1, 25), wait=st.integers(0, 40))
def test_feedback_arrives_after_exactly_the_latency(latency, wait):
    robot = Robot()
    link = ConditionedLink(robot, robot, feedback_latency_ns=latency)
    robot.to_give = [command(1), command(2)]
    assert link.receive(0) is None
    robot.now = wait
    heard = everything(link)
    assert heard == ([command(1), command(2)] if wait >= latency else [])


def test_step_is_not_delayed():
    robot = Robot()
    link = ConditionedLink(robot, robot, command_latency_ns=10, feedback_latency_ns=10)
    link.send(command(1))
    link.send(STEP)
    assert robot.sent == [(0, STEP)]
    robot.to_give = [command(1), Frame(m.StepDone.ID, bytes(4)), command(2)]
    assert [frame.id for frame in link.receive(0).frames] == [m.StepDone.ID]
    assert link.receive(0) is None
    robot.now = 10
    assert list(link.receive(0).frames) == [command(1)]


def test_of_frames_sent_together_those_without_lockstep_wait_and_keep_their_order():
    robot = Robot()
    link = ConditionedLink(robot, robot, command_latency_ns=10)
    link.send_all([command(1), STEP, command(2)])
    assert robot.sent == [(0, STEP)]
    robot.now = 10
    link.service()
    assert robot.sent == [(0, STEP), (10, command(1)), (10, command(2))]


FEEDBACK = Frame(m.WheelSpeeds.ID, bytes(8))
FOR_EVER_NS = 1 << 62


def delayed(robot, time):
    return ConditionedLink(robot, robot, feedback_latency_ns=1_000)


def dropping(robot, time):
    faults = link_faults([FaultRow("drop", "link", "feedback", 0, FOR_EVER_NS, 1.0)], 1)
    return ConditionedLink(robot, robot, faults=faults, scenario_time=time)


def cutting(robot, time):
    bus = BusFaults(link_faults([FaultRow("truncation", "link", "feedback", 0, FOR_EVER_NS, 1.0)], 1), None)
    return ConditionedLink(robot, robot, bus=bus, scenario_time=time)


@pytest.mark.parametrize("make", [delayed, dropping, cutting])
def test_a_frame_that_is_held_or_lost_does_not_begin_the_wait_again(make):
    class Patient(Robot):
        def receive(self, timeout_ns):
            waits_ns.append(timeout_ns)
            return super().receive(timeout_ns)

    waits_ns = []
    robot = Patient()
    robot.to_give = [FEEDBACK] * 3
    time = ScenarioTime(robot)
    time.begin(0)
    assert make(robot, time).receive(3_600_000_000_000) is None
    assert len(waits_ns) == 4
    assert all(later < earlier for earlier, later in itertools.pairwise(waits_ns))


def test_what_a_fault_holds_back_is_forgotten_with_the_session():
    robot = Robot()
    time = ScenarioTime(robot)
    time.begin(0)
    rows = [FaultRow("delay", "link", way, 0, FOR_EVER_NS, 0.01) for way in ("command", "feedback")]
    link = ConditionedLink(robot, robot, faults=link_faults(rows, 1), scenario_time=time)
    link.send(command(1))
    robot.to_give = [FEEDBACK]
    assert link.receive(0) is None
    link.discard()
    robot.now = 20_000_000
    link.service()
    assert robot.sent == []
    assert link.receive(0) is None


def test_latency_is_a_condition_as_any_other_and_faults_act_behind_it() -> None:
    """A command meets the rows when it has had its latency; feedback has its latency when it has met the rows."""
    robot = Robot()
    time = ScenarioTime(robot)
    time.begin(0)
    rows = [FaultRow("drop", "link", way, 10, 20, 1.0) for way in ("command", "feedback")]
    faults = link_faults(rows, 1)
    link = ConditionedLink(
        robot, robot, command_latency_ns=10, feedback_latency_ns=10, faults=faults, scenario_time=time
    )
    for robot.now in (0, 9, 10, 19):  # leave the latency at 10, 19, 20 and 29
        link.send(command(robot.now))
    for end in (10, 19, 20, 29):
        link.hand_over_until(JumpingClock(robot), end + 1)
    assert robot.sent == [(20, command(10)), (29, command(19))]
    heard = []
    for robot.now in (9, 10, 19, 20, 30):
        robot.to_give = [command(robot.now)]
        heard += [(robot.now, frame) for frame in everything(link)]
    assert heard == [(19, command(9)), (30, command(20))]
    assert [fault.applied for fault in faults] == [2, 2]


def test_an_observer_sees_what_crosses_the_wire_and_not_what_waits_or_is_lost() -> None:
    class Seen:
        def __init__(self) -> None:
            self.frames: list[Frame] = []

        def sent(self, frames: Sequence[Frame]) -> None:
            self.frames += frames

        def received(self, received: Received | None) -> None:
            self.frames += received.frames if received is not None else ()

    robot, seen = Robot(), Seen()
    time = ScenarioTime(robot)
    time.begin(0)
    faults = link_faults([FaultRow("drop", "link", way, 0, 5, 1.0) for way in ("command", "feedback")], 1)
    link = ConditionedLink(
        robot, robot, command_latency_ns=3, feedback_latency_ns=3, faults=faults, scenario_time=time, observer=seen
    )
    for robot.now in (0, 4):
        link.send(command(robot.now))
    assert seen.frames == []
    link.hand_over_until(JumpingClock(robot), 8)
    assert seen.frames == [command(4)]  # the other one was dropped before it got there
    robot.now = 2
    robot.to_give = [FEEDBACK]
    assert link.receive(0) is None  # dropped behind the observer
    assert seen.frames == [command(4), FEEDBACK]


class JumpingClock:
    """A clock that jumps to the time it is asked to wait for."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def now_ns(self) -> int:
        return self._robot.now

    def wait_until(self, t_ns: int) -> int:
        self._robot.now = t_ns
        return 0
