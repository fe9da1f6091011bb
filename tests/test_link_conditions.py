"""Latency acts on robot time, and leaves lockstep and handshake alone."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.ports import Received
from hil.faults.kind import FaultRow
from hil.wire.bus_faults import FaultBus
from hil.wire.delay import DelayedLink
from hil.wire.fault_rows import ScenarioTime, link_faults
from hil.wire.faults import FaultLink
from tests.heard import everything


class Robot:
    """The other end: keeps what is sent, and gives what is put."""

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
    link = DelayedLink(FaultLink(robot, ScenarioTime(robot), ()), robot, latency, 0)
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
    link = DelayedLink(FaultLink(robot, ScenarioTime(robot), ()), robot, 0, latency)
    robot.to_give = [command(1), command(2)]
    assert link.receive(0) is None
    robot.now = wait
    heard = everything(link)
    assert heard == ([command(1), command(2)] if wait >= latency else [])


def test_step_is_not_delayed():
    robot = Robot()
    link = DelayedLink(FaultLink(robot, ScenarioTime(robot), ()), robot, 10, 10)
    link.send(command(1))
    link.send(STEP)
    assert robot.sent == [(0, STEP)]
    robot.to_give = [command(1), Frame(m.StepDone.ID, bytes(4)), command(2)]
    assert [frame.id for frame in link.receive(0).frames] == [m.StepDone.ID]
    assert link.receive(0) is None
    robot.now = 10
    assert list(link.receive(0).frames) == [command(1)]


FEEDBACK = Frame(m.WheelSpeeds.ID, bytes(8))
FOR_EVER_NS = 1 << 62


def delayed(robot, time):
    return DelayedLink(FaultLink(robot, time, ()), robot, 0, 1_000)


def dropping(robot, time):
    return FaultLink(robot, time, link_faults([FaultRow("drop", "link", "feedback", 0, FOR_EVER_NS, 1.0)], 1))


def cutting(robot, time):
    return FaultBus(
        robot, time, link_faults([FaultRow("truncation", "link", "feedback", 0, FOR_EVER_NS, 1.0)], 1), None
    )


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
    link = DelayedLink(FaultLink(robot, time, link_faults(rows, 1)), robot, 0, 0)
    link.send(command(1))
    robot.to_give = [FEEDBACK]
    assert link.receive(0) is None
    link.discard()
    robot.now = 20_000_000
    link.service()
    assert robot.sent == []
    assert link.receive(0) is None
