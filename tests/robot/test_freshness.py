"""The age limit of feedback for driving, with real firmware, on a clock that runs on while nobody looks."""

import itertools

import pytest

from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameter_hash
from hil.core.errors import LinkError, RobotStoppedError
from hil.core.types import NAN_POSE, ZERO_WHEELS, CommandMode, Pose, PoseFix, Twist, WheelCommand
from hil.core.wheel_map import WheelMap
from hil.robot.handshake import Expected
from hil.robot.snapshot import Feedback
from hil.robot.stm32 import Stm32
from hil.runtime.freshness import Freshness
from hil.runtime.sampling import Timing
from hil.wire.conditions import ConditionedLink
from hil.wire.framed import StreamLink
from hil.wire.robot_end import SerialWire
from hil.wire.streams import MemoryStream, memory_pair
from tests.support.wheel_rig import WheelRig

TICK_NS = 1_000_000
STALE_NS = 50_000_000
REST = WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS)


class Terminal:
    """A stream whose reads return at most 2 KiB, as those of a terminal return what its buffer holds."""

    def __init__(self, stream: MemoryStream) -> None:
        self._stream = stream
        self._rest = b""
        self.write, self.close, self.reopen = stream.write, stream.close, stream.reopen
        self.describe = stream.describe

    def read(self, timeout_ns: int) -> bytes:
        data = self._rest + self._stream.read(0 if self._rest else timeout_ns)
        self._rest = data[2048:]
        return data[:2048]


class Robot:
    """Firmware behind a line that keeps unread data; a clock whose time passes with it."""

    def __init__(self, watchdog_s: float = 0.05, feedback_period_s: float = 0.005) -> None:
        self.rig = WheelRig(watchdog_s=watchdog_s, feedback_period_s=feedback_period_s)
        host, robot = memory_pair()
        self._wire = SerialWire(robot)
        self._now_ns = 0
        self.device = Stm32(
            ConditionedLink(StreamLink(Terminal(host)), self),
            CommandMode.SPEED,
            Expected(parameter_hash(self.rig.values), False, False, 20.0),
            itertools.count(0x2341),
            WheelMap(),
        )
        self.device.attend(self)
        self.device.begin_again()
        self.freshness = Freshness(self, self.device, None, Timing(5 * TICK_NS, 0, 0, STALE_NS))

    def now_ns(self) -> int:
        return self._now_ns

    def wait_until(self, t_ns: int) -> int:
        while self._now_ns < t_ns:
            self._wire.receive_into(self.rig.node, 0)
            self.rig.run(1)
            self._wire.send_from(self.rig.node)
            self._now_ns += TICK_NS
        return 0

    def tick(self, ms: int = 5, *, active: bool = True) -> bool:
        """Let so much time pass, and be driven once; return whether the feedback is too old to be driven by."""
        self.wait_until(self._now_ns + ms * TICK_NS)
        self.freshness.poll(0.0, active=active)
        self.device.send(REST)
        return self.freshness.is_stale

    def armed(self) -> "Robot":
        while not self.device.greeted() or not self.device.armed():
            self.wait_until(self._now_ns + 5 * TICK_NS)
        return self


def test_what_came_while_the_host_stalled_drives_nothing_and_what_comes_next_does() -> None:
    robot = Robot(watchdog_s=0.1).armed()
    assert not any(robot.tick() for _ in range(10))
    assert robot.tick(60), "the newest of it may be as old as the first"
    assert not any(robot.tick() for _ in range(10))


def test_while_a_backlog_is_read_away_nothing_is_driven_by_it() -> None:
    """At 1 kHz, 85 ms of feedback are more than is read in a tick."""
    robot = Robot(watchdog_s=0.1, feedback_period_s=0.001).armed()
    assert not robot.tick()
    robot.wait_until(robot.now_ns() + 85 * TICK_NS)
    assert robot.tick()
    newest = robot.device.feedback
    assert newest is not None
    assert robot.now_ns() - newest.robot_time_ns > 10 * TICK_NS, "the rest has not been read yet"
    assert robot.tick(), "and what has been read now was sent long ago, for all that is known"
    assert not robot.tick()


def test_a_long_standstill_is_a_lost_link_and_no_reset_of_the_robot() -> None:
    driven = Robot(watchdog_s=0.1, feedback_period_s=0.001).armed()
    assert not driven.tick()
    with pytest.raises(LinkError, match=r"lay unread for 260 ms .* this process stood still"):
        driven.tick(260)
    idle = Robot()
    idle.wait_until(20 * TICK_NS)
    assert idle.rig.state is m.State.IDLE
    assert not idle.tick(active=False)
    assert idle.tick(900, active=False), "who only looks on is not reconnected so soon"
    assert not [idle.tick(active=False) for _ in range(8)][-1]
    with pytest.raises(LinkError, match="lay unread for 1100 ms"):
        idle.tick(1100, active=False)


def test_of_a_host_that_stands_still_just_after_it_has_read_the_robots_reason_is_told() -> None:
    robot = Robot(watchdog_s=0.1, feedback_period_s=0.02).armed()
    while robot.tick() or robot.freshness.silent_ns:
        pass  # until there is news, so that the next tick has none
    poll = robot.device.poll

    def stall() -> Feedback | None:
        robot.device.poll = poll
        feedback = poll()
        robot.wait_until(robot.now_ns() + 260 * TICK_NS)
        return feedback

    robot.device.poll = stall
    with pytest.raises(RobotStoppedError, match=r"it is \w+ because of COMMAND_TIMEOUT"):
        robot.tick()


def test_a_robot_that_was_reset_while_it_was_driven_says_why() -> None:
    robot = Robot().armed()
    assert not robot.tick()
    robot.rig = WheelRig(watchdog_s=0.05)
    with pytest.raises(RobotStoppedError, match=r"left ACTIVE at t = 0.000 s: it was reset \(it was powered on\)"):
        robot.tick()


def test_a_truth_ages_on_while_the_host_stands_still_within_a_tick() -> None:
    robot = Robot(watchdog_s=0.1).armed()
    assert not robot.tick()
    assert not robot.freshness.truth_has_aged(), "no truth is no old one"
    for pose in (Pose(0.0, 0.0, 0.0), NAN_POSE):
        robot.freshness.poll(0.0, PoseFix(robot.now_ns(), pose, Twist(0.0, 0.0, 0.0)))
        assert not robot.freshness.is_stale
        assert not robot.freshness.truth_has_aged()
        robot.wait_until(robot.now_ns() + 30 * TICK_NS)
    assert robot.freshness.truth_has_aged(), "by the first: the second makes nothing newer"
