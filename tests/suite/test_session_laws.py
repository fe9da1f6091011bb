"""Sessions with robots: driven, stopped and armed again; faults of each signal, and which undriven ticks they explain.

FAULTS.md describes the kinds.
"""

import contextlib
import math
from array import array
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import hil
from firmware_protocol.generated.messages import State
from hil.core.errors import DeviceError, RobotLatchedError
from hil.core.signals import SIGNAL_NAMES, ReferenceSignals, pack_row
from hil.core.types import ZERO_WHEELS, Acceleration, CommandMode, Pose, PoseFix, Reference, Twist, WheelCommand, Wheels
from hil.core.types import State as Estimate
from hil.faults.rows import FaultRow
from hil.robot.snapshot import Feedback
from hil.runtime.bench import Bench
from hil.runtime.sampling import Timing
from hil.runtime.signal_faults import SignalFaults, can_hold
from hil.runtime.unexplained import NotDriven
from hil.scenario import load

MS = 1_000_000
SPEED = CommandMode.SPEED
SOME = Wheels(1.0, -2.0, 3.0, -4.0)
TWIST = Twist(4, 5, 6)
RAMP_S = 0.2
WIRED = {"device.wheels": ["rr", "fl", "rl", "fr"], "device.reversed": ["fl", "rr"]}
TURNING = Wheels(6.0, 10.0, 4.0, 12.0)  # forward, to the left, and round
ASIDE = Wheels(8.0, 12.0, 8.0, 12.0)
DRIVERS: list[tuple[str, dict[str, Any], Wheels]] = [
    ("stm32", WIRED, TURNING),
    ("c620", WIRED, ASIDE),  # at 100 Hz its speed loops ring when it turns
    ("wheeltec", {}, TURNING),
]


class Session:
    """A robot in this process, and what a loop does with it each 10 ms."""

    def __init__(self, bench: Bench) -> None:
        self.bench, self.device = bench, bench.device

    def pass_ms(self, ms: int = 10) -> Feedback:
        self.device.wait_until(self.bench.clock.now_ns() + ms * MS)
        feedback = self.device.poll()
        assert feedback is not None
        return feedback

    def wait(self, is_so: Callable[[], bool], limit: int = 300) -> None:
        for _ in range(limit):
            if is_so():
                return
            self.device.wait_until(self.bench.clock.now_ns() + 10 * MS)
        raise AssertionError(self.device.why_not_active())

    def arm(self, limit: int = 300) -> None:
        self.wait(self.device.armed, limit)

    def drive(self, seconds: float, command: WheelCommand) -> Feedback:
        for _ in range(round(seconds * 100)):
            feedback = self.pass_ms()
            self.device.send(command)
        return feedback

    def until(self, state: State, limit_s: float = 3.0) -> float:
        """Return how long it took until the robot was in this state [s]; nothing is commanded meanwhile."""
        for step in range(round(limit_s * 100)):
            if self.pass_ms().state == state:
                return step * 0.01
        raise AssertionError(f"it did not come to {state.name}")


@contextlib.contextmanager
def session(driver: str, **changes: Any) -> Iterator[Session]:
    settings = {"device.driver": driver, "loop.rate_hz": 100, "firmware.ramp_s": RAMP_S} | changes
    with Bench(load("circle_speed", mode="lockstep", set=settings), None, allow_motion=True) as bench:
        bench.connect()
        bench.device.attend(bench.clock)
        found = Session(bench)
        found.arm()
        bench.begin(bench.clock.now_ns())
        yield found


def fastest(feedback: Feedback) -> float:
    return max(map(abs, feedback.speed_rad_s))


@pytest.mark.parametrize(("driver", "changes", "speeds"), DRIVERS)
def test_a_robot_follows_is_stopped_by_a_ramp_latches_an_emergency_stop_and_is_armed_again(
    driver: str, changes: dict[str, Any], speeds: Wheels
) -> None:
    drive = WheelCommand(SPEED, speeds, ZERO_WHEELS)
    with session(driver, **changes) as robot:
        device = robot.device
        before = robot.drive(1.0, drive)
        assert list(before.speed_rad_s) == pytest.approx(list(speeds), abs=0.6)
        after = robot.drive(0.3, drive)
        counts = zip(before.encoder_count, after.encoder_count, strict=True)
        turned = [((b - a + 2**15) % 2**16 - 2**15) / 4096 * math.tau for a, b in counts]
        elapsed_s = (after.robot_time_ns - before.robot_time_ns) * 1e-9
        assert turned == pytest.approx([elapsed_s * one for one in speeds], abs=0.4)
        device.disarm()
        assert robot.until(State.STOPPING, 0.3) <= 0.2
        assert 0.25 * 12.0 < fastest(robot.drive(0.11, drive)) < 0.8 * 12.0, "half of the ramp is over"
        assert robot.until(State.IDLE) < RAMP_S + 0.75
        assert fastest(robot.pass_ms(50)) < 0.3
        device.send(drive)
        assert fastest(robot.drive(0.2, drive)) < 0.3, "it is not armed"
        robot.arm()
        assert robot.pass_ms().state == State.ACTIVE
        assert fastest(robot.drive(0.4, drive)) > 3.0
        device.estop()
        robot.until(State.ESTOP, 1.5)
        fast = fastest(robot.pass_ms())
        slow = fastest(robot.drive(0.5, drive))
        assert slow < (fast if driver == "c620" else 0.3), "a C620 lets its wheels coast"
        with pytest.raises((DeviceError, RobotLatchedError)):
            robot.arm(5)
        assert "e-stop" in device.why_not_active()
        if driver != "stm32":
            device.clear()
            robot.until(State.IDLE)
            robot.arm()
            assert fastest(robot.drive(0.4, drive)) > 3.0
            assert device.stop(10 * MS, 3_000 * MS)


def test_a_robot_with_torques_is_braked_when_it_is_disarmed_and_can_be_left_and_met_again() -> None:
    forward = WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, Wheels(0.6, 0.6, 0.6, 0.6))
    with session("c620", **{"controller.command": "torque", "estimator.source": "truth"}) as robot:
        device = robot.device
        fast = robot.drive(0.8, forward)
        assert min(fast.speed_rad_s) > 2.0
        device.disarm()
        for _ in range(15):
            soon = robot.pass_ms()
        assert 0.0 < min(soon.speed_rad_s) < 0.9 * min(fast.speed_rad_s), "it is braked, and not thrown back"
        robot.until(State.IDLE)
        robot.arm()
        count = robot.drive(0.3, forward).encoder_count[0]
        device.leave()
        device.begin_again()
        robot.wait(device.greeted)
        robot.arm()
        gone = (robot.pass_ms().encoder_count[0] - count + 2**15) % 2**16 - 2**15
        assert abs(gone) < 4096, "the angles go on from where they were"
        assert fastest(robot.drive(0.3, forward)) > 0.5


def test_a_robot_in_the_same_thread_says_what_it_says_over_a_line() -> None:
    """A reset, here after the end, makes the link a line whose bytes are framed and read."""
    late: dict[str, Any] = {"fault": [{"kind": "reset", "target": "robot", "start_s": 9.0}]}
    short: dict[str, Any] = {"loop.duration_s": 0.5}
    direct, line = (hil.run("circle_speed", record=None, set=short | more).metrics for more in ({}, late))
    assert direct["wire_sha256"] == line["wire_sha256"]
    for name in ("sent", "received", "load", "lasted_s"):
        assert direct["link_statistics"][name] == line["link_statistics"][name], name
    assert direct["link_statistics"]["sent"]["frames"] > 100


# Faults of signals, and what they explain


def signal_row(kind: str, target: str, value: float, from_ms: int = 100, to_ms: int = 200) -> FaultRow:
    return FaultRow(kind, "signal", target, from_ms * MS, to_ms * MS, value)


FEEDBACK = Feedback(7 * MS, State.ACTIVE, 1, 5, (1, 2, 3, 4), SOME, SOME, (0.1, 0.2, 9.8), 0.5)
REFERENCE = Reference(Pose(1, 2, 3), Twist(4, 5, 6), Acceleration(7, 8, 9))


def seen(faults: SignalFaults, row: bytes) -> dict[str, float]:
    """Return every signal as it is behind its faults."""
    feedback, fix = faults.feedback(FEEDBACK), faults.truth(PoseFix(0, Pose(1, 2, 3), TWIST))
    state, reference = faults.state(Estimate(Pose(1, 2, 3), Twist(4, 5, 6))), faults.reference(REFERENCE)
    command = faults.command(WheelCommand(SPEED, SOME, SOME))
    assert fix is not None
    assert state is not None
    numbers = [feedback.robot_time_ns * 1e-9, feedback.state, feedback.command_age_ms, feedback.yaw_rate_rad_s]
    names = ["robot.time_s", "robot.state", "robot.command_age_ms", "robot.yaw_rate_rad_s"]
    wheels = {"speed_rad_s": feedback.speed_rad_s, "current_a": feedback.current_a}
    wheels |= {"speed_command_rad_s": command.speed_rad_s, "torque_command_n_m": command.torque_n_m}
    groups: dict[str, Any] = {"truth": fix.pose, "pose": state.pose, "twist": state.twist}
    groups["reference"] = ReferenceSignals(*reference.pose, *reference.twist, *reference.acceleration)
    found = dict(zip(names, map(float, numbers), strict=True))
    found |= {f"robot.acceleration_{axis}_m_s2": a for axis, a in zip("xyz", feedback.acceleration_m_s2, strict=True)}
    for group, values in groups.items():
        found |= {f"{group}.{part}": float(value) for part, value in values._asdict().items()}
    for name, four in wheels.items():
        found |= {f"wheel.{wheel}.{name}": value for wheel, value in four._asdict().items()}
    recorded = dict(zip(SIGNAL_NAMES, array("d", faults.recorded(row)), strict=True))
    return recorded | found


def test_a_fault_of_a_signal_changes_that_one_alone_in_its_window() -> None:
    row = pack_row([0.25] * len(SIGNAL_NAMES))
    plain = seen(SignalFaults([]), row)
    for name in SIGNAL_NAMES:
        if name == "loop.t_s":
            continue
        value = 77.0 if name != "robot.state" else float(State.IDLE)
        faults = SignalFaults([signal_row("override", name, value)])
        for t_ms, is_changed in ((99, False), (100, True), (199, True), (200, False)):
            faults.at(t_ms * MS)
            assert seen(faults, row) == (plain | {name: value} if is_changed else plain), name
        assert faults.applied() == [2]


def test_rows_of_a_signal_act_in_order_and_a_reset_ends_those_before_it() -> None:
    rows = [signal_row("bias", "truth.x_m", 0.5), signal_row("override", "truth.x_m", 4.0, 120, 140),
            signal_row("bias", "truth.x_m", 0.25, 110, 200), signal_row("reset", "truth.x_m", 0.0, 150, 150),
            signal_row("bias", "truth.x_m", 2.0, 150, 200), signal_row("bias", "truth.y_m", 1.0)]  # fmt: skip
    faults = SignalFaults(rows)
    found = {}
    for t_ms in (105, 115, 125, 145, 155, 205):
        faults.at(t_ms * MS)
        fix = faults.truth(PoseFix(0, Pose(1.0, 2.0, 3.0), TWIST))
        assert fix is not None
        found[t_ms] = fix.pose.x_m
    assert found == {105: 1.5, 115: 1.75, 125: 4.25, 145: 1.75, 155: 3.0, 205: 1.0}
    assert faults.applied() == [4, 1, 3, 2, 1, 5]


def test_ticks_are_explained_from_a_faults_first_effect_until_the_robot_drives_again() -> None:
    timing = Timing(10 * MS, 3 * MS, 7 * MS, 100 * MS)
    link = FaultRow("drop", "link", "feedback", 1000 * MS, 1200 * MS, 1.0)
    late = FaultRow("delay", "link", "command", 1000 * MS, 1200 * MS, 0.05)
    assert can_hold(link)
    assert can_hold(signal_row("bias", "truth.x_m", 1.0))
    assert not can_hold(signal_row("bias", "pose.x_m", 1.0))
    assert not can_hold(FaultRow("push", "plant", "force_x_n", 0, 1, 1.0))
    for row, last_ms in ((link, 1330), (late, 1380)):
        for t_ms, explained in ((992, False), (993, True), (last_ms, True), (last_ms + 1, False)):
            not_driven = NotDriven([row], timing)
            not_driven.hold(t_ms * MS, is_stale=True)
            not_driven.hold(9000 * MS, is_stale=False)
            assert not_driven.counts(100) == {"stale_ticks": (1, 1 - explained), "held_ticks": (1, 1 - explained)}
            assert not_driven.counts(2)["held_ticks"] == (1, 1), "a run that never drives is explained by nothing"
            not_driven.drive()
            not_driven.hold(9001 * MS, is_stale=False)
            assert not_driven.counts(100)["held_ticks"] == (2, 2 - explained)
