"""Latency and faults act on robot time, and leave lockstep and handshake alone."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.links.delay import DelayedLink
from hil.links.faults import Fault, FaultLink
from hil.ports import Received


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
        return Received(self.to_give.pop(0), self.now) if self.to_give else None

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
    link = DelayedLink(robot, robot, latency, 0)
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
    link = DelayedLink(robot, robot, 0, latency)
    robot.to_give = [command(1), command(2)]
    assert link.receive(0) is None
    robot.now = wait
    heard = [r.frame for r in iter(lambda: link.receive(0), None)]
    assert heard == ([command(1), command(2)] if wait >= latency else [])


def test_step_is_not_delayed():
    robot = Robot()
    link = DelayedLink(robot, robot, 10, 10)
    link.send(command(1))
    link.send(STEP)
    assert robot.sent == [(0, STEP)]
    robot.to_give = [command(1), Frame(m.StepDone.ID, bytes(4)), command(2)]
    assert link.receive(0).frame.id == m.StepDone.ID
    assert link.receive(0) is None
    robot.now = 10
    assert link.receive(0).frame == command(1)


def fault(kind, **fields):
    row = {"direction": "command", "message": None, "start_ns": 100, "end_ns": 200, "probability": 1.0}
    return Fault(kind=kind, **(row | fields))


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        (fault("drop"), [0, 99, 200]),
        (fault("duplicate"), [0, 99, 100, 100, 199, 199, 200]),
        (fault("mute", direction=None, message="WHEEL_COMMAND"), [0, 99, 200]),
        (fault("mute", direction=None, message="ESTOP"), [0, 99, 100, 199, 200]),
        (fault("drop", direction="feedback"), [0, 99, 100, 199, 200]),
    ],
)
def test_faults_act_in_their_window_and_count(row, expected):
    robot = Robot()
    link = FaultLink(robot, robot, [row], seed=1)
    link.send(command(0))
    link.begin(0)
    robot.sent.clear()
    for robot.now in (0, 99, 100, 199, 200):
        link.send(command(0))
        link.send(STEP)
    commands = [t for t, frame in robot.sent if frame.id == m.WheelCommand.ID]
    assert commands == expected
    assert len(robot.sent) - len(commands) == 5
    assert link.applied == [2 if sorted(expected) != [0, 99, 100, 199, 200] else 0]


def test_feedback_faults():
    robot = Robot()
    link = FaultLink(robot, robot, [fault("duplicate", direction="feedback")], seed=1)
    link.begin(0)
    robot.now = 150
    robot.to_give = [command(1), command(2)]
    heard = [r.frame for r in iter(lambda: link.receive(0), None)]
    assert heard == [command(1), command(1), command(2), command(2)]


@given(seed=st.integers(0, 2**32), probability=st.floats(0.2, 0.8))
def test_chance_comes_from_the_seed(seed, probability):
    def run():
        robot = Robot()
        link = FaultLink(robot, robot, [fault("drop", probability=probability)], seed)
        link.begin(0)
        robot.now = 150
        for number in range(200):
            link.send(command(number))
        return robot.sent, link.applied[0]

    sent, applied = run()
    assert (sent, applied) == run()
    assert len(sent) + applied == 200
    assert 0 < applied < 200
