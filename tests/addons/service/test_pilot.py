"""A served robot, tick by tick, with firmware and FMU behind the wire; in lockstep, so that all repeats."""

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from firmware_protocol.generated.messages import State as RobotState
from hil.addons.service.control_process import ServeOptions, _Service
from hil.addons.service.messages import Phase, Task
from hil.addons.service.records import Records
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError, RobotStoppedError
from hil.core.kinematics import BodyTwist
from hil.core.types import Pose
from hil.references import make_reference
from hil.runtime.run_parts import RunParts
from hil.scenario import load
from tests.support.pilot_bench import OPTIONS, PilotBench, armed_pilot


def is_still(bench: PilotBench) -> bool:
    return all(abs(bench.last(f"wheel.{wheel}.speed_rad_s")) < 0.05 for wheel in ("fl", "fr", "rr", "rl"))


def test_a_service_connects_and_then_waits_disarmed() -> None:
    with PilotBench() as bench:
        bench.run(1.0)
        assert bench.phases == [Phase.AWAY, Phase.STOPPING, Phase.DISARMED]
        assert bench.last("robot.state") == RobotState.IDLE
        assert math.isnan(bench.last("wheel.fl.speed_command_rad_s"))
        assert bench.pilot.why is None


@pytest.mark.parametrize("order", ["stop", "go", "twist", "track"])
def test_nothing_moves_before_it_was_armed(order: str) -> None:
    with PilotBench() as bench:
        bench.run_until(Phase.DISARMED)
        do = {
            "stop": lambda: bench.pilot.active().stop(),
            "go": lambda: bench.pilot.active().go(Pose(1.0, 0.0, 0.0)),
            "twist": lambda: bench.pilot.active().twist(BodyTwist(0.1, 0.0, 0.0)),
            "track": lambda: bench.pilot.active().track(bench.made.reference, here=True),
        }[order]
        with pytest.raises(BadInputError, match="the robot is disarmed; arm it first"):
            do()
        bench.run(0.3)
        assert is_still(bench)


def test_an_armed_robot_is_held_where_it_stands() -> None:
    with armed_pilot() as bench:
        before = bench.pilot.state
        bench.run(1.0)
        assert bench.pilot.tasks.task is Task.HOLD
        assert before is not None
        assert bench.last("truth.x_m") == pytest.approx(before.pose.x_m, abs=1e-4)
        assert is_still(bench)


def test_it_goes_to_a_pose_by_the_shorter_turn_and_within_the_limits() -> None:
    with armed_pilot() as bench:
        begin = bench.last("truth.heading_rad")
        bench.pilot.active().go(Pose(0.9, 0.3, begin + math.tau - 0.5))
        bench.run(4.0)
        end = [bench.last(f"truth.{name}") for name in ("x_m", "y_m", "heading_rad")]
        assert end == pytest.approx([0.9, 0.3, begin - 0.5], abs=2e-3)
        speeds = [math.hypot(*v) for v in bench.pairs("reference.vx_m_s", "reference.vy_m_s")]
        assert max(speed for speed in speeds if speed == speed) <= OPTIONS.speed_m_s + 1e-9
        assert is_still(bench)


def test_a_twist_drives_in_the_body_frame_as_long_as_it_is_repeated() -> None:
    with armed_pilot() as bench:
        for _ in range(20):
            bench.pilot.active().twist(BodyTwist(0.2, 0.0, 0.0))
            bench.run(0.1)
        heading = bench.last("truth.heading_rad")
        vx, vy = bench.pilot.state.twist[:2]  # type: ignore[union-attr]
        assert (vx, vy) == pytest.approx((0.2 * math.cos(heading), 0.2 * math.sin(heading)), abs=0.01)
        bench.run(0.25)  # nobody asks any more
        assert bench.pilot.tasks.task is Task.HOLD
        bench.run(0.75)
        assert is_still(bench)
        assert bench.pilot.phase is Phase.ACTIVE


def test_a_law_elsewhere_commands_the_wheels_until_it_falls_silent_and_ours_takes_over() -> None:
    with armed_pilot() as bench:
        for sequence in range(60):
            bench.pilot.active().command_wheels((3.0, 3.0, 3.0, 3.0), sequence)
            bench.run(0.01)
        assert bench.pilot.tasks.task is Task.WHEELS
        assert bench.pilot.tasks.sequence == 59
        assert bench.last("wheel.fl.speed_rad_s") == pytest.approx(3.0, abs=0.3)
        for late in (59, 3):
            with pytest.raises(BadInputError, match=f"sequence = {late}: it came after 59"):
                bench.pilot.active().command_wheels((30.0, 3.0, 3.0, 3.0), late)
        bench.run(OPTIONS.twist_timeout_s + 0.02)
        assert bench.pilot.tasks.task is Task.HOLD
        bench.run(1.0)
        assert is_still(bench)
        bench.pilot.active().command_wheels((1.0, 1.0, 1.0, 1.0), None)
        assert bench.pilot.tasks.wheels is not None, "a command without a number is newer than all"


def test_a_twist_beyond_the_limits_is_scaled_and_keeps_its_direction() -> None:
    with armed_pilot() as bench:
        wanted = BodyTwist(3.0, 4.0, 0.5)
        got = bench.pilot.active().twist(wanted)
        assert math.hypot(got.forward_m_s, got.left_m_s) == pytest.approx(OPTIONS.speed_m_s)
        assert [a / b for a, b in zip(got, wanted, strict=True)] == pytest.approx([0.1, 0.1, 0.1])


def test_a_path_begins_where_the_robot_stands() -> None:
    with armed_pilot() as bench:
        bench.pilot.active().go(Pose(3.0, 2.0, 1.0))
        bench.run(9.0)
        bench.pilot.active().track(
            make_reference("circle", {"radius_m": 0.5, "period_s": 8.0, "ramp_s": 1.0}, None), here=True
        )
        bench.run(9.0)
        distance = [math.dist(place, (3.0, 2.0)) for place in bench.pairs("truth.x_m", "truth.y_m")]
        assert max(distance[-900:]) == pytest.approx(1.0, abs=0.02)  # the circle's other side
        assert min(distance[-900:]) < 0.02


def test_a_path_in_the_world_begins_at_its_own_begin_after_a_way_there() -> None:
    path = make_reference("circle", {"radius_m": 0.5, "period_s": 8.0, "ramp_s": 1.0}, None)
    with armed_pilot() as bench:
        bench.pilot.active().go(Pose(1.5, 1.0, 0.0))
        bench.run(5.0)
        bench.pilot.active().track(path, here=False)
        bench.run(12.0)
        radius = [math.hypot(*place) for place in bench.pairs("truth.x_m", "truth.y_m")]
        assert radius[-800:] == pytest.approx([0.5] * 800, abs=0.02)
        assert bench.pilot.tasks.task is Task.TRACK


def test_stop_ramps_down_and_holds_and_a_moving_task_rests_before_the_next() -> None:
    with armed_pilot() as bench:
        bench.pilot.active().track(bench.made.reference, here=True)
        bench.run(3.0)
        bench.pilot.active().stop()
        bench.run(1.5)
        assert is_still(bench)
        assert bench.pilot.tasks.task is Task.HOLD
        bench.pilot.active().track(bench.made.reference, here=True)
        bench.run(2.0)
        bench.pilot.active().go(Pose(0.0, 0.0, 0.0))
        bench.run(8.0)
        assert [bench.last(f"truth.{name}") for name in ("x_m", "y_m")] == pytest.approx([0.0, 0.0], abs=2e-3)
        acceleration = [abs(a) for a in bench.series("reference.ax_m_s2") if a == a]
        assert max(acceleration) <= OPTIONS.acceleration_m_s2 + 1e-6


def test_disarming_in_motion_ramps_down_and_ends_in_idle() -> None:
    with armed_pilot() as bench:
        bench.pilot.active().track(bench.made.reference, here=True)
        bench.run(3.0)
        bench.pilot.disarm()
        bench.run_until(Phase.DISARMED)
        assert bench.last("robot.state") == RobotState.IDLE
        bench.pilot.disarm()  # changes nothing
        bench.run(0.5)
        assert bench.pilot.phase is Phase.DISARMED
        assert is_still(bench)


@pytest.mark.proves("R-STOP-3", "R-CLEAR-2")
def test_an_emergency_stop_latches_until_it_is_cleared_and_clearing_arms_nothing() -> None:
    with armed_pilot() as bench:
        bench.pilot.active().track(bench.made.reference, here=True)
        bench.run(3.0)
        bench.pilot.estop()
        bench.run(1.5)
        assert bench.last("robot.state") == RobotState.ESTOP
        assert is_still(bench)
        with pytest.raises(BadInputError, match="the robot is estop; it can be armed when it is disarmed"):
            bench.pilot.arm()
        bench.pilot.clear()
        bench.run_until(Phase.DISARMED)
        bench.run(0.5)
        assert bench.pilot.phase is Phase.DISARMED
        bench.armed()


def test_clearing_waits_for_the_emergency_stop_confirmed_and_another_one_ends_that() -> None:
    with armed_pilot() as bench:
        bench.pilot.estop()
        bench.pilot.clear()
        bench.run(0.1)
        assert bench.last("robot.state") == RobotState.ESTOP
        bench.run_until(Phase.DISARMED)
        bench.pilot.estop()
        bench.pilot.clear()
        bench.pilot.estop()
        bench.run(2.0)
        assert bench.pilot.phase is Phase.ESTOP


def test_a_robot_that_left_active_by_itself_is_disarmed_and_says_why() -> None:
    with armed_pilot() as bench:
        bench.pilot.active().track(bench.made.reference, here=True)
        bench.run(1.0)
        bench.stand_still(0.3)  # nobody commands
        bench.run_until(Phase.DISARMED)
        assert bench.pilot.why is not None
        assert "COMMAND_TIMEOUT" in bench.pilot.why
        bench.run(1.0)
        assert bench.pilot.phase is Phase.DISARMED
        assert is_still(bench)


def fault(kind: str, start_s: float, **more: object) -> dict[str, object]:
    return {"kind": kind, "start_s": start_s, **more}


def test_a_lost_link_is_reopened_and_only_who_asks_arms_again() -> None:
    with PilotBench(fault=[fault("disconnect", 2.0, end_s=3.0)]) as bench:
        bench.armed()
        bench.pilot.active().track(bench.made.reference, here=True)
        bench.run_until(Phase.AWAY)
        assert bench.pilot.state is None
        bench.run_until(Phase.DISARMED)
        assert bench.pilot.recoveries == 1
        assert "disconnect" in str(bench.pilot.why)
        bench.run(1.0)
        assert is_still(bench)
        bench.armed()
        assert bench.pilot.tasks.task is Task.HOLD


@pytest.mark.proves("R-STOP-2")
def test_an_emergency_stop_reaches_a_robot_that_was_away() -> None:
    with PilotBench(fault=[fault("disconnect", 2.0, end_s=3.0)]) as bench:
        bench.armed()
        bench.run_until(Phase.AWAY)
        bench.pilot.estop()
        bench.run_until(Phase.ESTOP)
        bench.run(0.1)
        assert bench.last("robot.state") == RobotState.ESTOP


@pytest.mark.proves("R-STOP-2")
def test_an_emergency_stop_outlasts_a_reset_of_the_robot_and_any_earlier_clear() -> None:
    with PilotBench(fault=[fault("reset", 1.5, target="robot")]) as bench:
        bench.armed()
        bench.run(0.5)
        bench.pilot.estop()
        bench.run_until(Phase.AWAY)
        bench.run_until(Phase.ESTOP)
        bench.run(0.5)
        assert (bench.pilot.phase, bench.last("robot.state")) == (Phase.ESTOP, RobotState.ESTOP)
        bench.pilot.clear()
        bench.run_until(Phase.DISARMED)
    with PilotBench(fault=[fault("disconnect", 2.0, end_s=3.0)]) as bench:
        bench.armed()
        bench.run(2.0 - len(bench.rows) * 0.01 - 0.1)
        bench.pilot.estop()
        bench.pilot.clear()
        bench.run_until(Phase.AWAY)
        bench.run_until(Phase.ESTOP)
        bench.run(1.0)
        assert bench.pilot.phase is Phase.ESTOP


@pytest.mark.parametrize("armed", [False, True])
def test_a_robot_that_was_reset_is_greeted_again_and_stays_disarmed(armed: bool) -> None:
    with PilotBench(fault=[fault("reset", 2.0, target="robot")]) as bench:
        bench.run_until(Phase.DISARMED)
        if armed:
            bench.armed()
            bench.pilot.active().go(Pose(1.0, 0.0, 0.0))
        bench.run(1.9)
        bench.run_until(Phase.AWAY)
        bench.run_until(Phase.DISARMED)
        bench.run(0.5)
        assert bench.pilot.phase is Phase.DISARMED
        bench.armed()


def test_a_fault_of_the_robot_is_reported_and_cleared() -> None:
    rows = [fault("stuck_encoder", 2.0, target="fl", end_s=3.0)]
    with PilotBench(fault=rows) as bench:
        bench.armed()
        bench.pilot.active().track(bench.made.reference, here=True)
        bench.run_until(Phase.FAULT)
        bench.run(0.2)
        assert "of wheel fl" in str(bench.pilot.why)
        with pytest.raises(BadInputError, match="the robot is fault"):
            bench.pilot.active().stop()
        bench.run(1.5)
        bench.pilot.clear()
        bench.run_until(Phase.DISARMED)
        bench.armed()


def test_a_pose_that_leaps_does_not_make_a_held_robot_move() -> None:
    with PilotBench(fault=[fault("bias", 2.0, end_s=3.0, target="truth.x_m", value=5.0)]) as bench:
        bench.armed()
        bench.run(3.5)
        assert bench.pilot.phase is Phase.ACTIVE
        speeds = [
            abs(v) for wheel in ("fl", "fr") for v in bench.series(f"wheel.{wheel}.speed_command_rad_s") if v == v
        ]
        assert max(speeds) < 0.1


def test_a_robot_that_cannot_follow_is_held_instead_of_pushing_on() -> None:
    options = replace(OPTIONS, error_limit_m=0.05)
    push = fault("push", 2.0, end_s=2.25, target="force_x_n", value=-150.0)  # more than all four wheels together
    with PilotBench(options=options, fault=[push]) as bench:
        bench.armed()
        bench.run(1.0)
        bench.pilot.active().go(Pose(2.5, 0.0, 0.0))
        bench.run(3.0)
        assert bench.pilot.tasks.task is Task.HOLD
        assert bench.pilot.why == "the robot is more than 0.05 m from where it should be"


def test_other_gains_take_over_in_motion() -> None:
    with armed_pilot() as bench:
        bench.pilot.active().track(bench.made.reference, here=True)
        bench.run(3.0)
        softer = RunParts(load("circle_speed", set={"controller.gains.k1_1_s": 4.0})).laws
        bench.pilot.use(softer)
        bench.run(2.0)
        assert bench.last("gain.k1_x_1_s") == 4.0
        assert bench.pilot.tasks.task is Task.TRACK
        assert max(v for v in bench.series("error.planar_m")[-100:]) < 0.1


_FAILS_TO_TELL = """
from hil.core.types import CommandMode, WheelCommand, Wheels

class FailsToTell:
    signals = ("own.number",)
    asked = 0

    def reset(self, state, reference):
        pass

    def update(self, reference, state, applied, dt_s):
        self.asked += 1
        return WheelCommand(CommandMode.SPEED, Wheels(0.0, 0.0, 0.0, 0.0), Wheels(0.0, 0.0, 0.0, 0.0))

    @property
    def telemetry(self):
        return (1.0 / (self.asked < 20),)
"""
_RAISED = (LinkError("the line broke"), RobotStoppedError("it stopped"), DeviceError("it refused"))


@pytest.mark.parametrize("name", ["poll", "send", "armed", "estop", "clear", "greeted", "reopen", "begin_again"])
def test_each_tick_has_one_row_whatever_call_of_the_device_fails(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with PilotBench() as bench:
        device, raised = bench.bench.device, 0

        def failing(works: Callable[..., object], every: int, kinds: Iterator[HilError]) -> Callable[..., object]:
            calls = count(1)

            def call(*arguments: object) -> object:
                nonlocal raised
                if next(calls) % every == 0 and (failure := next(kinds, None)) is not None:
                    raised += 1
                    raise failure
                return works(*arguments)

            return call

        works = failing(getattr(device, name), {"poll": 37, "send": 31}.get(name, 2), iter(_RAISED))
        monkeypatch.setattr(device, name, works)
        # A line that breaks now and then, so that the way back is gone too.
        monkeypatch.setattr(device, "poll", failing(device.poll, 83, iter(_RAISED[:1] * 4)))
        for _ in range(10):
            bench.run(0.2)
            with contextlib.suppress(BadInputError):
                bench.pilot.arm()
            bench.run(0.3)
            bench.pilot.estop()
            bench.run(0.2)
            with contextlib.suppress(BadInputError, DeviceError, LinkError):
                bench.pilot.clear()
        assert raised == len(_RAISED) + 4
        assert bench.series("loop.tick") == list(range(len(bench.rows)))
        assert len(bench.rows) == 700


def test_each_tick_has_one_row_when_the_law_fails_in_its_own_signals(tmp_path: Path) -> None:
    law = tmp_path / "own_signals.py"
    law.write_text(_FAILS_TO_TELL)
    with PilotBench(**{"controller.law": f"{law}:FailsToTell", "controller.gains": {}}) as bench:
        bench.run(2.0)
        bench.pilot.arm()
        bench.run(1.0)
        assert "telemetry failed" in str(bench.pilot.why)
        assert bench.pilot.phase is Phase.DISARMED
        bench.pilot.lose(LinkError("feedback lay unread"))
        assert "telemetry failed" in str(bench.pilot.why), "what follows does not take the place of the cause"
        bench.run_until(Phase.DISARMED)
        assert bench.series("loop.tick") == list(range(len(bench.rows)))


def test_a_service_waits_seven_seconds_for_its_robot_to_come_to_rest_and_then_ends(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    clock, unused = SimpleNamespace(monotonic=count().__next__), cast(Any, None)
    monkeypatch.setattr("hil.addons.service.control_process.time", clock)
    with armed_pilot() as bench:
        parts, ending = (unused, ServeOptions(), bench.made, Records(None)), cast(Any, SimpleNamespace(requests=1))
        service = _Service(load("circle_speed"), *parts, unused, unused, ending)
        assert len(list(service._until_stopped(bench.pilot, unused))) == 7
        assert bench.pilot.phase is Phase.STOPPING, "it was told to disarm, and no tick came"
    assert caplog.messages == ["robot did not come to rest in time; its watchdog stops it"]
