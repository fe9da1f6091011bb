"""Motors of other makers: the stops they get when something goes wrong, and no stop for motors that others drive."""

import contextlib
import os
import signal
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest

import hil.runtime.robots
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import State
from hil.addons.motors.c620.emulated_c620 import EmulatedC620
from hil.addons.motors.guardian import Guardian
from hil.addons.motors.makers import MakersRobot
from hil.addons.motors.rosmaster.rosmaster_driver import MOTION, RosmasterFraming
from hil.addons.service.control_process import ServeOptions, _Service
from hil.addons.service.messages import Phase
from hil.addons.service.records import Records
from hil.core.errors import BadInputError, DeviceError, LinkError
from hil.core.kinematics import BodyTwist
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand, Wheels
from hil.robot.driver import Wire
from hil.runtime.assembly import run_scenario
from hil.runtime.bench import Bench
from hil.runtime.run_parts import RunParts
from hil.scenario import load
from hil.wire.streams import ByteStream
from tests.support.dbc_mappings import motors
from tests.support.dialect_testbed import Rig, ramp_to
from tests.support.pilot_bench import PilotBench
from tests.support.processes import wait_for

PERIOD_NS = 10_000_000
PATIENCE_NS = 60_000_000_000
ROSMASTER = {"device.driver": "rosmaster", "plant.start.battery_voltage_v": 12.0}
FORWARD = WheelCommand(CommandMode.SPEED, Wheels(5.0, 5.0, 5.0, 5.0), ZERO_WHEELS)


def robot_of(bench: Bench) -> MakersRobot:
    assert isinstance(bench.device, MakersRobot)
    return bench.device


def node_of(bench: Bench) -> Any:
    assert bench.local is not None
    return bench.local.robot.node


@contextlib.contextmanager
def nothing_goes_out(bench: Bench) -> Iterator[None]:
    """As when the queue of a CAN controller stays full: incoming frames are still received."""

    def send(_frame: Frame) -> None:
        raise LinkError("the transmit queue stays full")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robot_of(bench)._line.link, "send", send)
        yield


@contextlib.contextmanager
def on_bench(driver: str, **changes: Any) -> Iterator[Bench]:
    short = {"loop.rate_hz": 100, "device.driver": driver} | changes
    with Bench(load("circle_speed", mode="lockstep", set=short), None, allow_motion=True) as bench:
        yield bench


def let_pass(bench: Bench, time_s: float) -> None:
    bench.device.wait_until(bench.clock.now_ns() + round(time_s * 1e9))


def drive(bench: Bench, ticks: int) -> None:
    for _ in range(ticks):
        let_pass(bench, 0.01)
        bench.device.poll()
        bench.device.send(FORWARD)


def come_back(bench: Bench) -> None:
    bench.device.begin_again()
    while not bench.device.greeted():
        let_pass(bench, 0.01)


# What did not go out is not done


def driven(**changes: Any) -> PilotBench:
    bench = PilotBench(**{"device.driver": "c620"} | changes).armed()
    bench.pilot.active().twist(BodyTwist(0.3, 0.0, 0.0))
    bench.run(0.15)
    return bench


def test_an_emergency_stop_that_did_not_go_out_is_told_and_not_confirmed_or_cleared() -> None:
    with driven() as bench:
        with nothing_goes_out(bench.bench):
            bench.pilot.estop()
            bench.run(0.3)
            assert bench.pilot.emergency.pending
            assert "the stop could not be sent: the transmit queue stays full" in str(bench.pilot.why)
            assert "the stop could not be sent: the transmit queue stays full" in bench.notes
            bench.pilot.clear()
            bench.run(0.5)
            assert bench.pilot.phase is Phase.ESTOP
            assert bench.last("robot.state") != State.ESTOP
            bench.run(3.0)
            assert bench.pilot.emergency.pending
            assert "the stop could not be sent" in str(bench.pilot.why)
            bench.pilot.estop()  # takes the clear back
        bench.run_until(Phase.ESTOP)
        bench.run(0.5)
        assert not bench.pilot.emergency.pending
        assert "could not be sent" not in str(bench.pilot.why)
        assert bench.last("robot.state") == State.ESTOP


def test_a_robot_whose_stop_did_not_go_out_is_not_disarmed() -> None:
    with driven() as bench:
        with nothing_goes_out(bench.bench):
            for _ in range(40):
                bench.run(0.1)
                assert bench.pilot.phase in (Phase.AWAY, Phase.STOPPING)
                assert "the stop could not be sent" in str(bench.pilot.why)
        assert bench.phases.count(Phase.AWAY) > 2, "the link is opened anew"
        bench.run_until(Phase.DISARMED)
        assert not node_of(bench.bench).is_driving


def test_a_run_whose_stop_did_not_go_out_says_so() -> None:
    with on_bench("c620") as bench:
        bench.connect()
        bench.device.start(bench.clock, PERIOD_NS)
        drive(bench, 5)
        with nothing_goes_out(bench):
            bench.device.estop()
            with pytest.raises(LinkError, match="the stop could not be sent: the transmit queue stays full"):
                bench.device.stop(PERIOD_NS, 500_000_000)


class LosesTheFirstStop(EmulatedC620):
    """Gets hot in motion; the first command without currents from then on is lost on the way."""

    is_lost = False

    @property
    def is_hot(self) -> bool:
        return self.ticks > 800

    def receive(self, frame: Frame) -> None:
        if self.is_hot and frame.id == 0x200 and not any(frame.payload) and not self.is_lost:
            self.is_lost = True
            return
        super().receive(frame)

    def _sample(self, drive: Any) -> None:
        super()._sample(drive)
        if self.is_hot:
            self.temperature_degc = (120.0,) * 4


def test_one_stop_that_is_lost_at_the_end_of_a_run_leaves_no_motor_on(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[LosesTheFirstStop] = []

    def kind(*arguments: Any, **more: Any) -> LosesTheFirstStop:
        made.append(LosesTheFirstStop(*arguments, **more))
        return made[-1]

    monkeypatch.setattr(hil.runtime.robots, "emulated", lambda _name: kind)
    changes = {"loop.rate_hz": 100, "loop.duration_s": 2, "expect": [], "device.driver": "c620"}
    result = run_scenario(load("circle_speed", mode="lockstep", set=changes))
    assert "120 °C" in str(result.failure)
    [robot] = made
    assert robot.is_lost
    assert not robot.is_driving


@pytest.mark.parametrize("presses", [1, 3, 6])
def test_a_stop_goes_out_however_often_ctrl_c_is_pressed(monkeypatch: pytest.MonkeyPatch, presses: int) -> None:
    with on_bench("odrive") as bench:
        bench.connect()
        bench.device.start(bench.clock, PERIOD_NS)
        drive(bench, 20)
        link = robot_of(bench)._line.link
        send, left = link.send, [presses]

        def interrupted(frame: Frame) -> None:
            if left[0]:
                left[0] -= 1
                raise KeyboardInterrupt
            send(frame)

        monkeypatch.setattr(link, "send", interrupted)
        with contextlib.suppress(KeyboardInterrupt):
            bench.device.stop(PERIOD_NS, 1_000_000_000)
        bench.device.close()
        let_pass(bench, 0.5)
        assert not left[0]
        assert all(abs(shaft.speed_rad_s) < 0.2 for shaft in node_of(bench).shafts)


def test_a_service_that_a_stuck_law_ends_stops_the_motors_first() -> None:
    scenario = load("circle_speed", mode="realtime", set={"loop.rate_hz": 100} | ROSMASTER)
    unused: Any = None  # the API, systemd and the signals, which the end does not wait for
    options, parts = ServeOptions(allow_motion=True), RunParts(scenario)
    service = _Service(scenario, {}, options, parts, Records(None), unused, unused, unused)
    with service._opened() as bench:
        bench.connect()
        bench.device.start(bench.clock, PERIOD_NS)
        drive(bench, 30)
        assert node_of(bench).is_driving
        service._last_words("a law that does not return?")
        assert not node_of(bench).is_driving


# Who speaks only when spoken to


WIRED = [
    {"device.driver": "moteus"},
    {"device.driver": "odrive"},
    {"device.driver": "odrive", "device.motors.feedback_hz": 0},
    {"device.driver": "vesc"},
    {"device.driver": "vesc", "link.url": "can:virtual/disarmed"},
    {"device.driver": "c620"},
    {"device.driver": "wheeltec"},
    {"device.driver": "wheeltec", "link.url": "can:virtual/disarmed"},
    ROSMASTER,
]


@pytest.mark.parametrize("changes", WIRED, ids=lambda changes: "-".join(map(str, changes.values())))
def test_a_robot_that_is_not_driven_stays_with_the_service(changes: dict[str, Any]) -> None:
    with PilotBench(**changes) as bench:
        bench.run_until(Phase.DISARMED)
        bench.run(0.6)
        bench.armed()
        bench.run(0.1)
        bench.pilot.estop()
        bench.run(1.0)
        assert not bench.pilot.emergency.pending
        assert not robot_of(bench.bench)._stop.is_pending
        bench.pilot.clear()
        bench.run_until(Phase.DISARMED)
        bench.run(0.6)
        way = [Phase.AWAY, Phase.STOPPING, Phase.DISARMED, Phase.ACTIVE, Phase.ESTOP, Phase.DISARMED]
        assert [phase for phase in bench.phases if phase is not Phase.ARMING] == way


@pytest.mark.parametrize(("driver", "wire"), [("moteus", None), ("vesc", "can"), ("vesc", "serial"), ("dbc", None)])
def test_questions_keep_no_watchdog_alive(driver: str, wire: Wire | None) -> None:
    rig = Rig(driver, motors("wheel_drives") if driver == "dbc" else None, wire=wire)
    rig.step(ticks=110)
    rig.greet()
    rig.arm()
    rig.drive(0.3, ramp_to((8.0, 8.0, 8.0, 8.0), 0.2))
    assert not rig.is_still()
    for _ in range(400):
        rig.step(rig.driver.ask())
    assert rig.is_still() or not rig.node.is_driving  # a VESC lets its motor roll


@pytest.mark.parametrize("link", ["memory:", "can:virtual/fault"])
def test_a_fault_of_a_vesc_is_seen_while_disarmed_and_not_cleared_while_it_is_there(link: str) -> None:
    with PilotBench(**{"device.driver": "vesc", "link.url": link}) as bench:
        bench.run_until(Phase.DISARMED)
        vesc = node_of(bench.bench).vescs[2]
        vesc.fail(3)
        vesc._fault_left = 10**6
        bench.run_until(Phase.FAULT, 0.5)
        assert "VESC 3 of wheel rr has the fault 3" in str(bench.pilot.why)
        bench.pilot.clear()
        bench.run(2.2)
        assert bench.pilot.phase is Phase.FAULT
        assert "clearing was refused" in str(bench.pilot.why)


def test_nobody_is_armed_by_a_speed_of_long_ago(monkeypatch: pytest.MonkeyPatch) -> None:
    with on_bench("c620") as bench:
        bench.connect()
        node = node_of(bench)
        send = node.send
        monkeypatch.setattr(node, "send", lambda frame: None if frame.id == 0x203 else send(frame))
        let_pass(bench, 0.5)
        with pytest.raises(DeviceError, match="no feedback of all four wheels that is younger"):
            bench.device.start(bench.clock, PERIOD_NS)


# What others drive, and what happened while nobody looked


def test_a_host_that_has_armed_nothing_leaves_motors_in_error_alone() -> None:
    with on_bench("moteus") as bench:
        servos = node_of(bench).servos
        for servo in servos:
            servo.mode = 11  # the e-stop of a host before
        bench.connect()
        for _ in range(2):
            with pytest.raises(DeviceError, match="is in mode 11, position timeout"):
                bench.device.start(bench.clock, PERIOD_NS)
            let_pass(bench, 0.1)
            assert [servo.mode for servo in servos] == [11] * 4


@pytest.mark.parametrize("fails", [False, True])
def test_a_fault_that_arose_while_the_link_was_away_is_not_cleared_by_our_own_stop(fails: bool) -> None:
    """Without one the robot comes back from mode 11, where our silence has led it."""
    with on_bench("moteus", **{"loop.rearm": True}) as bench:
        device, servos = bench.device, node_of(bench).servos
        bench.connect()
        device.start(bench.clock, PERIOD_NS)
        drive(bench, 20)
        device.leave()
        with nothing_goes_out(bench):
            let_pass(bench, 0.3)
            for servo in servos:
                servo.mode = 11
            if fails:
                servos[1].fail(38)
        come_back(bench)
        with pytest.raises(DeviceError, match="over temperature") if fails else contextlib.nullcontext():
            for _ in range(100):
                let_pass(bench, 0.01)
                if device.armed():
                    break
        assert [servo.mode for servo in servos] == ([11, 1, 11, 11] if fails else [10] * 4)


@pytest.mark.parametrize(("link", "timeout_ms"), [("memory:", 0), ("can:virtual/app", 1000)])
def test_vescs_without_a_watchdog_that_another_app_of_theirs_drives_are_told_of(link: str, timeout_ms: int) -> None:
    with PilotBench(**{"device.driver": "vesc", "link.url": link}) as bench:
        for vesc in node_of(bench.bench).vescs:
            vesc.timeout_ticks = timeout_ms
        bench.run_until(Phase.DISARMED)
        for vesc in node_of(bench.bench).vescs:
            vesc.command("rpm", 400)
        bench.run(0.8)
        assert bench.pilot.why == "the wheels turn, but this program has not armed them: an e-stop stops them"
        bench.pilot.estop()
        bench.run(0.5)
        assert node_of(bench.bench).shafts[0].speed_rad_s == pytest.approx(0.0, abs=0.2)


def test_a_base_that_drives_on_is_told_of_and_an_emergency_stop_stops_it() -> None:
    with PilotBench(**ROSMASTER) as bench:
        bench.run_until(Phase.DISARMED)
        node = node_of(bench.bench)
        node.feed(RosmasterFraming().encode(Frame(MOTION, bytes([1]) + (300).to_bytes(2, "little") + bytes(4))))
        bench.run(1.0)
        assert bench.pilot.phase is Phase.DISARMED
        assert bench.pilot.why == "the wheels turn, but this program has not armed them: an e-stop stops them"
        assert bench.notes.count(bench.pilot.why) == 1
        assert node.is_driving
        bench.pilot.estop()
        bench.run(1.0)
        assert not node.is_driving
        assert bench.pilot.why == "an e-stop was asked for"


# The guardian: a real one, that watches over a pseudo-terminal beside the robot in this process


@contextlib.contextmanager
def guarded_bench(silence_s: float) -> Iterator[tuple[Bench, Guardian, ByteStream]]:
    pty = pytest.importorskip("hil.wire.pty", reason="pseudo-terminals need a POSIX system")
    with contextlib.ExitStack() as resources:
        line = resources.enter_context(contextlib.closing(pty.PtyStream()))
        guardian = Guardian(line.port, 115200, b"stop", silence_s=silence_s)
        resources.callback(guardian.release)
        bench = resources.enter_context(on_bench("rosmaster", **{"plant.start.battery_voltage_v": 12.0}))
        robot_of(bench)._watch = guardian
        bench.connect()
        yield bench, guardian, line


def arm(bench: Bench) -> None:
    """Arm by the wall clock, by which the guardian answers."""

    def step() -> bool:
        let_pass(bench, 0.01)
        return bench.device.armed()

    wait_for(step)


def state_of(bench: Bench) -> State | None:
    feedback = bench.device.feedback
    return None if feedback is None else feedback.state


def come_to_rest(bench: Bench) -> None:
    """Let time pass until the motors are disarmed; commands that come meanwhile change nothing."""
    for _ in range(300):
        let_pass(bench, 0.01)
        bench.device.poll()
        bench.device.send(FORWARD)
    assert state_of(bench) is State.IDLE
    assert not node_of(bench).is_driving


def test_a_robot_whose_guardian_dies_is_stopped_and_armed_again_with_the_next_one_alone() -> None:
    with guarded_bench(60.0) as (bench, guardian, _):
        arm(bench)
        drive(bench, 50)
        assert node_of(bench).is_driving
        first = guardian.pid
        assert first is not None
        os.kill(first, signal.SIGKILL)

        def is_stopped() -> bool:
            drive(bench, 1)
            return state_of(bench) is not State.ACTIVE

        wait_for(is_stopped)
        assert "the guardian died" in bench.device.report.stop_reason()
        come_to_rest(bench)
        arm(bench)
        assert guardian.pid not in (None, first)
        drive(bench, 50)
        assert node_of(bench).is_driving


def test_a_host_that_was_silent_sends_no_command_but_the_stop() -> None:
    """It does not wait for the guardian to tell it: its own clock does."""
    with guarded_bench(0.1) as (bench, guardian, _):
        arm(bench)
        drive(bench, 50)
        wait_for(lambda: time.monotonic_ns() - guardian._beat_ns > 200_000_000)
        bench.device.send(FORWARD)
        assert "no command went out for" in bench.device.report.stop_reason()
        let_pass(bench, 0.01)
        bench.device.poll()
        assert state_of(bench) is State.STOPPING
        come_to_rest(bench)
        arm(bench)
        bench.device.disarm()
        come_to_rest(bench)
        wait_for(lambda: guardian._phase.name == "REST")


@pytest.mark.parametrize("ramped", [0, 5])
def test_after_a_silence_no_ramp_begins_or_goes_on(monkeypatch: pytest.MonkeyPatch, ramped: int) -> None:
    """The guardian has stopped the robot, and a step of the ramp would drive it again."""
    with guarded_bench(0.2) as (bench, guardian, line):
        arm(bench)
        drive(bench, 50)
        if ramped:
            bench.device.disarm()
        for _ in range(ramped):
            let_pass(bench, 0.01)
            bench.device.poll()
        assert line.read(PATIENCE_NS).startswith(b"stop")
        wait_for(lambda: guardian._stopped)
        link, sent = robot_of(bench)._line.link, list[Frame]()
        send = link.send
        monkeypatch.setattr(link, "send", lambda frame: (sent.append(frame), send(frame)))
        bench.device.disarm()
        come_to_rest(bench)
        motions = [frame for frame in sent if frame.id == MOTION]
        assert motions
        assert not any(any(frame.payload[1:]) for frame in motions)


def test_a_stop_that_did_not_go_out_when_the_link_was_lost_is_the_guardians_too() -> None:
    with guarded_bench(0.3) as (bench, guardian, line):
        arm(bench)
        bench.device.leave()
        assert guardian._phase.name == "HELD", "the stop went out"
        come_back(bench)
        arm(bench)
        with nothing_goes_out(bench):
            bench.device.leave()
            assert line.read(PATIENCE_NS).startswith(b"stop")
        come_back(bench)
        arm(bench)


@pytest.mark.parametrize("ended_by", ["leave", "estop"])
def test_an_arming_that_ends_before_the_guardian_answers_leaves_nothing_to_be_stopped(ended_by: str) -> None:
    with guarded_bench(0.1) as (bench, guardian, line):
        assert guardian.pid is not None
        os.kill(guardian.pid, signal.SIGSTOP)
        assert not bench.device.armed()
        assert "nothing is armed, has not answered within 4 s (GUARDIAN.md)" in bench.device.why_not_active()
        getattr(bench.device, ended_by)()
        os.kill(guardian.pid, signal.SIGCONT)
        assert line.read(300_000_000) == b""


def test_a_service_that_was_silent_is_disarmed_until_somebody_arms_it() -> None:
    pty = pytest.importorskip("hil.wire.pty", reason="pseudo-terminals need a POSIX system")
    with contextlib.closing(pty.PtyStream()) as line, PilotBench(**ROSMASTER) as bench:
        guardian = Guardian(line.port, 115200, b"stop", silence_s=0.5)
        try:
            robot_of(bench.bench)._watch = guardian
            bench.run_until(Phase.DISARMED)

            def is_active() -> bool:
                bench.run(0.01)
                return bench.pilot.phase is Phase.ACTIVE

            bench.pilot.arm()
            wait_for(is_active)
            assert guardian._session == 1
            wait_for(lambda: guardian._stopped)
            bench.run_until(Phase.DISARMED)
            bench.run(1.0)
            assert bench.phases[-3:] == [Phase.AWAY, Phase.STOPPING, Phase.DISARMED]
            assert "no command went out for" in str(bench.pilot.why)
            assert not node_of(bench.bench).is_driving
            bench.pilot.arm()
            wait_for(is_active)
            bench.pilot.disarm()
            bench.run_until(Phase.DISARMED)
            bench.run(1.0)
            assert guardian._phase.name == "REST"
            bench.pilot.arm()
            bench.run(0.01)
            bench.pilot.disarm()
            bench.run(1.0)
            assert guardian._phase.name == "REST"
        finally:
            guardian.release()


def test_arming_is_refused_while_no_guardian_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    with guarded_bench(60.0) as (bench, guardian, _):
        monkeypatch.setattr(sys, "executable", "/no/such/python")
        assert guardian.pid is not None
        os.kill(guardian.pid, signal.SIGKILL)
        wait_for(lambda: guardian.pid is None)
        with pytest.raises(DeviceError, match=r"the guardian of serial port .* could not be started"):
            arm(bench)
        assert not node_of(bench).is_driving


def test_a_claim_of_a_stop_watches_these_motors_too() -> None:
    empty = {"kind": "low_battery", "start_s": 0.5, "value": 6.0}
    stops = {"stops": "under voltage", "after_fault": "low_battery", "within_s": 0.1}
    coasts = {"signal": "wheel.fl.current_a", "from_s": 0.6, "equals": 0.0}
    sets = {"device.driver": "vesc", "loop.duration_s": 1.5, "expect": [stops, coasts]}
    result = hil.run("circle_speed", set=sets | {"fault": [empty]})
    assert result.passed, result
    with pytest.raises(BadInputError, match=r"fault\.1\.kind.*ESTOP is a message of our firmware"):
        hil.run("circle_speed", set=sets | {"fault": [{"kind": "estop", "start_s": 0.5}]})
