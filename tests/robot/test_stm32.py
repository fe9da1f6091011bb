"""The host's side against real firmware: the cases that it refuses, and those that it leaves alone."""

import itertools
import socket
import threading
from types import SimpleNamespace

import pytest

from firmware_protocol import codec
from firmware_protocol.framer import Framer
from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameter_hash
from hil.core.clock import LockstepClock
from hil.core.errors import BadInputError, DeviceError, RobotStoppedError
from hil.core.ports import Received
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand
from hil.core.wheel_map import WheelMap
from hil.robot import channel
from hil.robot.handshake import Expected
from hil.robot.stm32 import Stm32
from hil.robot.truth_client import TruthClient
from hil.wire.conditions import ConditionedLink
from hil.wire.framed import StreamLink
from hil.wire.streams import DirectStream, memory_pair
from tests.support.wheel_rig import PARAMETERS, WheelRig

PERIOD_NS = 5_000_000


class Line(DirectStream):
    """A line to the rig's firmware, on which another robot may say something first."""

    def __init__(self, rig: WheelRig) -> None:
        super().__init__(self._ask)
        self._rig = rig
        self._said = b""

    def says(self, message: codec.Message) -> None:
        """Let another robot send something."""
        self._said += Framer().encode(codec.encode(message))

    def read(self, timeout_ns: int) -> bytes:
        said, self._said = self._said, b""
        return said or super().read(timeout_ns)

    def _ask(self, data: bytes) -> bytes:
        self._rig.node.feed(data)
        return self._rig.node.take_bytes()


class SlowLine(Line):
    """A line on which an answer is only once it is waited for, as where the robot's thread has not run until then."""

    def read(self, timeout_ns: int) -> bytes:
        return super().read(timeout_ns) if timeout_ns > 0 else b""


def driver(
    rig: WheelRig, *, lockstep=True, allow_motion=False, values=PARAMETERS, nonces=None, line=None, latencies=(0, 0)
) -> tuple[Stm32, LockstepClock]:
    link = StreamLink(line or Line(rig))
    expected = Expected(parameter_hash(values), lockstep, allow_motion, 20.0)
    nonces = itertools.count(0x2341) if nonces is None else iter(nonces)
    clock = LockstepClock()
    clock.step = lambda ticks: device.step(ticks)
    device = Stm32(
        ConditionedLink(link, clock, command_latency_ns=latencies[0], feedback_latency_ns=latencies[1]),
        CommandMode.SPEED,
        expected,
        nonces,
        WheelMap(),
    )
    return device, clock


def test_connects_arms_and_stops():
    rig = WheelRig(lockstep=True)
    device, clock = driver(rig)
    info = device.connect()
    assert info.watchdog_ms == 50
    device.start(clock, PERIOD_NS)
    assert rig.state is m.State.ACTIVE
    assert device.stop(PERIOD_NS, 2_000_000_000)
    assert rig.state is m.State.IDLE
    assert device.report.stop_reason() == "HOST_REQUEST"


def test_a_stop_is_waited_for_up_to_its_limit_and_no_period_longer():
    stopped_ns = []
    for limit_ns in (2_000_000_000, None, None):
        rig = WheelRig(lockstep=True)
        device, clock = driver(rig)
        device.connect()
        device.start(clock, PERIOD_NS)
        begin_ns = clock.now_ns()
        if limit_ns is None:
            limit_ns = stopped_ns[0] - PERIOD_NS * (len(stopped_ns) - 1)
        assert device.stop(PERIOD_NS, limit_ns) is (len(stopped_ns) < 2)
        stopped_ns.append(clock.now_ns() - begin_ns)
    assert stopped_ns == [stopped_ns[0], stopped_ns[0], stopped_ns[0] - PERIOD_NS]


@pytest.mark.proves("R-HELLO-8")
def test_a_power_stage_needs_a_yes():
    refused, _ = driver(WheelRig(power_stage=True), lockstep=False)
    with pytest.raises(BadInputError, match="--allow-motion"):
        refused.connect()
    allowed, _ = driver(WheelRig(power_stage=True), lockstep=False, allow_motion=True)
    assert allowed.connect().capabilities & 1


@pytest.mark.proves("R-HELLO-7")
def test_other_parameters_are_refused_with_both_hashes():
    other = PARAMETERS | {"speed_kp_n_m_s_rad": 1.0}
    device, _ = driver(WheelRig(lockstep=True), values=other)
    with pytest.raises(BadInputError, match=f"{parameter_hash(PARAMETERS):08x}.*{parameter_hash(other):08x}"):
        device.connect()


def test_the_modes_must_agree():
    device, _ = driver(WheelRig(lockstep=True), lockstep=False)
    with pytest.raises(BadInputError, match="same --mode"):
        device.connect()


@pytest.mark.proves("R-ARM-6")
def test_nonces_that_were_used_are_followed_by_others():
    rig = WheelRig(lockstep=True)
    first, clock = driver(rig, nonces=[0x1111, 0x2222])
    first.connect()
    first.start(clock, PERIOD_NS)
    first.stop(PERIOD_NS, 2_000_000_000)
    # The nonce itself, and another with the same low bits, are refused; the third is not.
    second, clock = driver(rig, nonces=[0x1111, 0x3331, 0x4445])
    second.connect()
    second.start(clock, PERIOD_NS)
    assert rig.state is m.State.ACTIVE


def test_a_second_host_does_not_disarm_the_first_ones_robot():
    rig = WheelRig(lockstep=True)
    first, clock = driver(rig)
    first.connect()
    first.start(clock, PERIOD_NS)
    second, _ = driver(rig)
    second.connect()

    class WhileTheFirstDrives:
        """Time passes as the first host commands it."""

        def now_ns(self) -> int:
            return clock.now_ns()

        def wait_until(self, t_ns: int) -> int:
            while clock.now_ns() < t_ns:
                first.poll()
                first.send(WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS))
                first.wait_until(clock.now_ns() + PERIOD_NS)
            return 0

    with pytest.raises(DeviceError):
        second.start(WhileTheFirstDrives(), PERIOD_NS)
    assert rig.state is m.State.ACTIVE


def test_the_second_answer_to_a_step_sent_twice_is_ignored():
    def run(twice: bool) -> str:
        rig = WheelRig(lockstep=True)
        line = Line(rig)
        device, _ = driver(rig, line=line)
        device.connect()
        for tick in range(0, 50, 5):
            device.step(5)
            if twice:
                line.says(m.StepDone(tick + 5))
                device.poll()
            assert device.tick == tick + 5
            if twice:
                line.says(m.StepDone(tick + 5))
        return device.wire_sha256()

    assert run(twice=True) == run(twice=False)


@pytest.mark.proves("R-HELLO-7")
def test_a_robot_that_was_refused_is_not_armed() -> None:
    rig = WheelRig(lockstep=True)
    device, clock = driver(rig, allow_motion=True)
    device.connect()
    device.attend(clock)
    device._expected = device._expected._replace(parameter_hash=1)
    device.begin_again()
    with pytest.raises(BadInputError, match="firmware parameters"):
        device.greeted()
    clock.wait_until(clock.now_ns() + PERIOD_NS)
    with pytest.raises(RobotStoppedError, match="it is not armed"):
        device.armed()
    assert rig.node.look().state is m.State.IDLE


def test_feedback_from_before_a_loss_does_not_come_back() -> None:
    line = Line(rig := WheelRig(lockstep=True))
    device, clock = driver(rig, line=line)
    device.connect()
    device.attend(clock)
    clock.wait_until(PERIOD_NS)
    for message in (m.Tick(7000, 0, 0, m.State.ACTIVE, 1, 9), m.Encoders(1, 2, 3, 4), m.StepDone(7)):
        line.says(message)
    with pytest.raises(RobotStoppedError, match="at tick 7"):
        clock.wait_until(2 * PERIOD_NS)
    assert device.feedback is not None
    assert device.feedback.encoder_count == (1, 2, 3, 4)
    device.leave()
    device._channel.take(Received([codec.encode(m.Power(12.0, 1.0))], 0))
    assert device.feedback is None


def test_a_round_trip_ends_with_the_tick_that_says_so_even_without_its_snapshot():
    class Clock:
        now = 0

        def now_ns(self) -> int:
            return self.now

        def wait_until(self, t_ns: int) -> int:
            return 0

    (here, there), framer, clock = memory_pair(), Framer(), Clock()
    link = StreamLink(here)
    link.now_ns = clock.now_ns
    line = ConditionedLink(link, clock)
    device = Stm32(line, CommandMode.SPEED, Expected(0, False, True, 20.0), itertools.count(1), WheelMap())
    device.attend(clock)
    sent = [device.send(WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS)) for clock.now in (0, 1_000_000)]
    for number, sequence in enumerate(sent):
        there.write(framer.encode(codec.encode(m.Tick(number * 1000, sequence, 0, m.State.ACTIVE, 3, number))))
    clock.now = 3_000_000
    device.poll()
    assert device.round_trip.figures() == {"p50": 2.5, "p99": pytest.approx(2.99), "count": 2}
    assert (device.received, device.snapshots_lost) == (2, 1)


def test_what_came_with_a_wrong_answer_to_a_step_is_counted():
    rig = WheelRig(lockstep=True)
    line = Line(rig)
    device, _ = driver(rig, line=line)
    device.connect()
    device.step(5)
    before = device.received
    line.says(m.StepDone(99))
    with pytest.raises(DeviceError, match="was reset"):
        device.step(5)
    assert device.received == before + 1


@pytest.mark.parametrize("latencies", [(0, 0), (3_000_000, 0), (0, 7_000_000), (3_000_000, 7_000_000)])
def test_in_lockstep_it_changes_nothing_when_an_answer_is_on_the_line(latencies):
    def run(line: type[Line]) -> tuple[str, int, int]:
        rig = WheelRig(lockstep=True)
        device, clock = driver(rig, line=line(rig), latencies=latencies)
        device.connect()
        device.start(clock, 1_000_000)  # polls when a held TIME_SYNC_REQUEST has just been handed over
        device.begin_again()
        while not device.greeted():
            device.wait_until(clock.now_ns() + 1_000_000)
        greeted_ns = clock.now_ns()
        while not device.armed():
            device.wait_until(clock.now_ns() + 1_000_000)
        return device.wire_sha256(), greeted_ns, clock.now_ns()

    assert run(Line) == run(SlowLine)


@pytest.mark.proves("R-STEP-6")
def test_a_robot_that_was_reset_is_noticed():
    rig, another = WheelRig(lockstep=True), WheelRig(lockstep=True)
    device, _ = driver(rig)
    device.connect()
    device.step(5)
    rig.node = another.node
    with pytest.raises(DeviceError, match="was reset"):
        device.step(5)


def test_another_hosts_session_is_not_taken_for_ours():
    rig = WheelRig(lockstep=True)
    device, clock = driver(rig)
    device.connect()

    class WhileAnotherArms:
        """Between our looking and our arming, another host arms the robot and drives it."""

        sequence = 0

        def now_ns(self) -> int:
            return clock.now_ns()

        def wait_until(self, t_ns: int) -> int:
            if rig.state is m.State.IDLE and self.sequence == 0:
                rig.arm(nonce=0x7771)
            rig.command(0.0, self.sequence)
            self.sequence += 1
            return clock.wait_until(t_ns)

    with pytest.raises(DeviceError, match="another controller drives it"):
        device.start(WhileAnotherArms(), PERIOD_NS)
    assert rig.state is m.State.ACTIVE


def test_a_stop_does_not_wait_for_the_links_latency():
    rig = WheelRig(lockstep=True)
    link = StreamLink(Line(rig))
    clock = LockstepClock()
    clock.step = lambda ticks: device.step(ticks)
    expected = Expected(parameter_hash(PARAMETERS), lockstep=True, allow_motion=False, speed_limit_rad_s=20.0)
    delayed = ConditionedLink(link, clock, command_latency_ns=20_000_000)
    device = Stm32(delayed, CommandMode.SPEED, expected, itertools.count(0x2341), WheelMap())
    device.connect()
    device.start(clock, PERIOD_NS)
    device.disarm()
    link.receive(0)
    assert rig.state is m.State.STOPPING


def test_every_command_is_sent_once_with_the_next_number():
    rig = WheelRig(lockstep=True)
    device, clock = driver(rig)
    device.connect()
    device.start(clock, PERIOD_NS)
    sequences = []
    for _ in range(300):
        sequences.append(device.send(WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS)))
        clock.wait_until(clock.now_ns() + PERIOD_NS)
        device.poll()
    assert sequences == [(sequences[0] + number) % 256 for number in range(300)]
    assert rig.state is m.State.ACTIVE


@pytest.mark.proves("R-STATE-10")
def test_latched_states_are_said_with_what_to_do():
    rig = WheelRig(lockstep=True)
    rig.send(m.Estop(0, 0))
    device, clock = driver(rig)
    device.connect()
    with pytest.raises(DeviceError, match="ESTOP; it is latched"):
        device.start(clock, PERIOD_NS)


def test_a_robot_that_refuses_to_arm_says_why() -> None:
    """After the greeting a robot with other parameters takes the place of the first."""
    line = Line(WheelRig(lockstep=True))
    device, clock = driver(line._rig, line=line)
    device.connect()
    line._rig = WheelRig(lockstep=True, speed_kp_n_m_s_rad=1.0)
    with pytest.raises(DeviceError) as refused:
        device.start(clock, PERIOD_NS)
    assert str(refused.value) == "the robot refused to arm: PARAMETERS; see the arming rules in PROTOCOL.md"


def test_a_truth_socket_of_something_else():
    with socket.create_server(("127.0.0.1", 0)) as server:

        def greet() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(b"SSH-2.0-OpenSSH_9.2\r\n")

        threading.Thread(target=greet, daemon=True).start()
        with pytest.raises(DeviceError, match="something else listens there"):
            TruthClient(f"tcp://127.0.0.1:{server.getsockname()[1]}", "0" * 64, reset=False)


def test_a_robot_that_does_not_arm_is_given_up_after_4_s_of_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    device, clock = driver(WheelRig(lockstep=True))
    device.connect()
    begin_ns = clock.now_ns()
    monkeypatch.setattr(device, "armed", lambda: False)
    with pytest.raises(DeviceError, match="the robot did not become ACTIVE: it is IDLE; restart the robot"):
        device.start(clock, PERIOD_NS)
    assert clock.now_ns() - begin_ns == 4_000_000_000


class Mute(Line):
    """A line that says nothing from a time on, and counts what it is given."""

    is_mute, writes = False, 0

    def read(self, timeout_ns: int) -> bytes:
        return b"" if self.is_mute else super().read(timeout_ns)

    def write(self, data: bytes) -> None:
        self.writes += 1
        super().write(data)


def test_a_robot_that_is_mute_in_lockstep_is_asked_again_and_then_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Mute(WheelRig(lockstep=True))
    device, _ = driver(WheelRig(lockstep=True), line=line)
    device.connect()
    monkeypatch.setattr(channel, "SILENCE_NS", 20_000_000)
    monkeypatch.setattr(channel, "RETRY_NS", 2_000_000)
    monkeypatch.setattr(channel, "time", SimpleNamespace(monotonic_ns=itertools.count(0, 1_000_000).__next__))
    before, line.is_mute = line.writes, True
    with pytest.raises(RobotStoppedError, match="the robot did not answer STEP within 2 s of wall-clock time; it was"):
        device.step(5)
    assert line.writes - before == 1 + 6, "each 3 ms within 20 ms"
