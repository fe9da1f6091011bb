"""A virtual robot at its end of a link: how it follows the wall clock, and when it may be put back to its start."""

from types import SimpleNamespace
from typing import Any

import pytest

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import State
from hil.core.types import Pose, PoseFix, Twist
from hil.robot import virtual_server
from hil.robot.virtual_server import VirtualServer, WallClockNode

MS = 1_000_000
START_NS = 5000 * MS


class Robot:
    """Robot, node, plant, wire and truth at once: they note what they are told. ``extra`` are ticks of a slow clock."""

    needs_view = False

    def __init__(self) -> None:
        self.now = START_NS
        self.told: list[Any] = []
        self.state = State.IDLE
        self.time_ns = 0
        self.node = self.plant = self
        self.faults = SimpleNamespace(extra_ticks=0, ahead=0)
        self.slow_each = 0
        self.comes = 0

    def monotonic_ns(self) -> int:
        return self.now

    def run(self, ticks: int) -> None:
        self.told.append(("run", ticks))
        self.faults.extra_ticks += self.slow_each

    def look(self) -> Any:
        return SimpleNamespace(state=self.state)

    def truth(self) -> PoseFix:
        return PoseFix(self.time_ns, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0))

    def publish(self, fix: PoseFix, view: object) -> None:
        self.told.append(("published", fix.time_ns // MS))

    def receive_into(self, node: object, timeout_ns: int) -> bool:
        self.told.append(("received", timeout_ns))
        self.comes -= 1
        return self.comes >= 0

    def send_from(self, node: object) -> None:
        self.told.append("sent")

    def awake(self) -> "Robot":
        return self

    def power_cycle(self) -> None:
        self.told.append("power cycle")


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    robot = Robot()
    monkeypatch.setattr(virtual_server, "time", robot)
    return robot


def served(robot: Robot, *, lockstep: bool = False) -> VirtualServer:
    server = VirtualServer(robot, robot, robot, lockstep=lockstep)  # type: ignore[arg-type]
    robot.told.clear()
    return server


def step(robot: Robot, server: VirtualServer, at_ms: float) -> list[Any]:
    """Serve at this time after the start; return what was done."""
    robot.now = START_NS + round(at_ms * MS)
    robot.told.clear()
    server.service(20 * MS)
    return list(robot.told)


def test_in_real_time_each_tick_runs_when_its_time_has_come_and_a_long_stall_is_lost(robot: Robot) -> None:
    server = served(robot)
    ran = [("received", 0), ("published", 0), "sent"]

    def run_of(ticks: int) -> list[Any]:
        return [ran[0], ("run", ticks), *ran[1:]]

    assert step(robot, server, 0.25) == [("received", 750_000)]
    robot.comes = 1
    assert step(robot, server, 0.5) == [("received", 500_000), "sent"], "an answer waits for no tick"
    assert step(robot, server, 1.0) == run_of(1)
    assert step(robot, server, 1.999) == [("received", 1000)]
    assert step(robot, server, 4.5) == run_of(3)
    assert step(robot, server, 54.9) == run_of(50)
    assert server.slipped_ticks == 0
    assert step(robot, server, 134.9) == run_of(50)
    assert server.slipped_ticks == 30
    assert step(robot, server, 135.0) == run_of(1), "it goes on by its own time, 30 ms later"
    assert server.slipped_ticks == 30


def test_a_slow_clock_runs_more_ticks_than_it_counts(robot: Robot) -> None:
    server = served(robot)
    robot.slow_each = 2
    assert ("run", 3) in step(robot, server, 3.0)
    robot.slow_each = 0
    assert step(robot, server, 5.5) == [("received", 500_000)], "five were run"
    assert ("run", 1) in step(robot, server, 6.0)
    robot.faults.ahead, robot.time_ns = 7, 6 * MS
    assert ("published", 13) in step(robot, server, 7.0)


@pytest.mark.parametrize(
    ("lockstep", "state", "silent_ms", "is_done"),
    [
        (False, State.IDLE, 0, True),
        (False, State.FAULT, 0, True),
        (False, State.ARMED, 5000, False),
        (False, State.ACTIVE, 5000, False),
        (False, State.STOPPING, 5000, False),
        (True, State.ACTIVE, 2000, False),
        (True, State.ACTIVE, 2001, True),
        (True, State.ESTOP, 0, True),
    ],
)
def test_a_robot_is_put_back_to_its_start_unless_a_host_may_drive_it(
    lockstep: bool, state: State, silent_ms: int, is_done: bool, robot: Robot
) -> None:
    server = served(robot, lockstep=lockstep)
    robot.state = state
    answers: list[bool] = []
    server.request_reset(answers.append)
    server.run_between_exchanges(lambda: robot.told.append("between"))
    told = step(robot, server, silent_ms)
    assert answers == [is_done]
    assert told[: 3 if is_done else 1] == (["power cycle", ("published", 0), "between"] if is_done else ["between"])
    if is_done and not lockstep:
        assert told[3:] == [("received", MS)], "its time begins anew"
    step(robot, server, silent_ms)
    assert answers == [is_done], "once"


def test_in_lockstep_time_passes_with_what_the_host_sends_alone(robot: Robot) -> None:
    server = served(robot, lockstep=True)
    assert step(robot, server, 50.0) == [("received", 20 * MS)]
    robot.comes = 1
    assert step(robot, server, 51.0) == [("received", 20 * MS), ("published", 0), "sent"]
    robot.told.clear()
    robot.comes = 2
    server.advance(2)
    received = [("received", 0)] * 3
    assert robot.told == [*received, ("run", 1), "sent", ("run", 1), "sent", ("published", 0)]


def test_a_firmware_by_the_wall_clock_reads_it_before_each_use(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []

    class Node:
        def __getattr__(self, name: str) -> Any:
            return lambda *words: calls.append((name, *words)) or name

    now_ns = iter(range(5_003_000, 10_000_000, 1_000_500))
    monkeypatch.setattr(virtual_server, "time", SimpleNamespace(monotonic_ns=lambda: next(now_ns)))
    node = WallClockNode(Node(), 3_000_000)  # type: ignore[arg-type]
    frame = Frame(0x100, b"")
    node.feed(b"x")
    node.receive(frame)
    assert (node.take_bytes(), node.take_frames()) == ("take_bytes", "take_frames")
    node.count_unsent(7)
    used = [("feed", b"x"), ("receive", frame), ("take_bytes",), ("take_frames",)]
    times_us = (2003, 3003, 4004, 5004)
    expected = [call for time_us, use in zip(times_us, used, strict=True) for call in (("set_clock", time_us), use)]
    assert calls == [*expected, ("count_unsent", 7)]
