"""Rules of PROTOCOL.md that no test of one part proves: in every state, whatever a field says, at an exact rate."""

from collections import Counter

import pytest

from firmware_protocol import codec
from firmware_protocol.capabilities import Capability
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import State
from firmware_protocol.host import parameter_hash, parameters
from hil.core.errors import BadInputError
from hil.core.types import ZERO_WHEELS, CommandMode, WheelCommand
from hil.robot.handshake import Greeting
from tests.robot.test_stm32 import PERIOD_NS, Line, driver
from tests.support.bare_node import ALL, BareNode
from tests.support.client_rig import new_client, take
from tests.support.session_twin import hello_pages
from tests.support.wheel_rig import PARAMETERS, WheelRig

PAGES = [kind.ID for kind in (m.HelloIdentity, m.HelloFirmware, m.HelloParameters, m.HelloGeometry, m.HelloLimits)]
PAGES += [kind.ID for kind in (m.HelloFaultStatus, m.HelloFaultPlace, m.HelloFaultAddress)]


def in_state(state: State) -> BareNode:
    node = BareNode()
    node.activate()
    node.node.state = state
    node.heard()
    return node


# Handshake


@pytest.mark.proves("R-HELLO-1", "R-HELLO-10", "R-TIME-3")
@pytest.mark.parametrize("state", State)
def test_hello_and_time_sync_are_answered_in_every_state_whatever_the_version(state: State) -> None:
    node = in_state(state)
    for version in (0, 1, m.PROTOCOL_VERSION, 255):
        node.send(m.HelloRequest(version))
        assert [x.ID for x in node.heard()] == PAGES
    node.send(m.TimeSyncRequest(3), 123)
    assert node.heard(125) == [m.TimeSyncResponse(123, 2, 3)]
    assert node.state is state


@pytest.mark.proves("R-HELLO-4")
def test_a_page_that_the_host_does_not_know_is_ignored() -> None:
    known = [codec.encode(page) for page in hello_pages()]
    stranger = Frame(m.HelloFaultAddress.ID + 1, bytes(8))
    client = new_client()
    assert take(client, [stranger, *known, stranger]) == PAGES
    assert client.view.is_greeted
    greeting = Greeting()
    found = [greeting.feed(codec.decode(frame)) for frame in (stranger, *known, stranger)]
    assert [info is not None for info in found] == [False] * len(known) + [True, False]


@pytest.mark.proves("R-HELLO-6")
@pytest.mark.parametrize(("version", "schema"), [(9, m.SCHEMA_HASH), (m.PROTOCOL_VERSION, 0x0123_4567)])
def test_a_robot_of_another_version_is_refused_with_both_versions(version: int, schema: int) -> None:
    (identity, *_) = hello_pages(version, schema)
    words = f"protocol {version} with schema {schema:08x}, this host {m.PROTOCOL_VERSION} with {m.SCHEMA_HASH:08x}"
    with pytest.raises(BadInputError, match=words):
        Greeting().feed(identity)


@pytest.mark.proves("R-HELLO-9")
def test_what_is_frozen_has_the_bytes_that_it_had() -> None:
    """Literals: a change of the protocol must not change these with it."""
    assert Framer().encode(codec.encode(m.HelloRequest(2))).hex() == "0102070402122100"
    identity = m.HelloIdentity(2, 8, 0x1234, 0x89AB_CDEF)
    assert (identity.ID, identity.encode().hex()) == (0x701, "02083412efcdab89")
    assert {number for number in m.LENGTHS if number >= 0x700} <= set(range(0x700, 0x710))


# Parameters


@pytest.mark.proves("R-PAR-8")
def test_store_restore_and_reading_look_only_at_what_they_need() -> None:
    node = BareNode()
    for operation in (m.Operation.RESTORE, m.Operation.STORE):
        node.heard()
        node.send(m.ParameterRequest(255, operation, 4, 0xFFFF_FFFF))
        node.lib.wheel_node_stored(node.node, True)
        (answer,) = node.heard()
        assert isinstance(answer, m.ParameterResponse)
        assert (answer.result, answer.value) == (m.Result.OK, parameter_hash(PARAMETERS))
    for operation in (m.Operation.READ, m.Operation.READ_MINIMUM, m.Operation.READ_MAXIMUM):
        answers = []
        for value in (0, 0xFFFF_FFFF):
            node.send(m.ParameterRequest(17, operation, 4, value))
            answers += node.heard()
        assert answers[0] == answers[1]


@pytest.mark.proves("R-PAR-6")
def test_a_store_after_a_restore_keeps_what_was_built_in() -> None:
    def ask(rig: WheelRig, operation: m.Operation, value: int = 0) -> None:
        rig.send(m.ParameterRequest(0, operation, 1, value))
        assert [x.result for x in rig.heard() if isinstance(x, m.ParameterResponse)] == [m.Result.OK]

    def hash_after_a_reset(rig: WheelRig) -> int:
        again = WheelRig(stored=rig.node.stored())
        again.send(m.HelloRequest(m.PROTOCOL_VERSION))
        (held,) = (x for x in again.heard() if isinstance(x, m.HelloParameters))
        return held.parameter_hash

    rig = WheelRig()
    for operation, value in ((m.Operation.WRITE, 1000), (m.Operation.STORE, 0), (m.Operation.RESTORE, 0)):
        ask(rig, operation, value)
    assert hash_after_a_reset(rig) == parameter_hash(PARAMETERS | {"counts_per_revolution": 1000.0})
    ask(rig, m.Operation.STORE)
    assert hash_after_a_reset(rig) == parameter_hash(PARAMETERS)


@pytest.mark.proves("R-WD-1")
def test_the_watchdog_has_its_range() -> None:
    (row,) = (p for p in parameters() if p.name == "watchdog_s")
    assert (row.minimum, row.maximum) == pytest.approx((0.02, 0.1))


# Arming and commands


@pytest.mark.proves("R-BEAT-3")
@pytest.mark.parametrize("request_", [m.Request.IDLE, m.Request.CLEAR])
def test_idle_and_clear_do_what_they_do_whatever_else_the_heartbeat_says(request_: m.Request) -> None:
    node = BareNode(capabilities=ALL & ~Capability.TORQUE)
    if request_ is m.Request.CLEAR:
        node.lib.wheel_node_fail(node.node)
    node.send(m.HostHeartbeat(0x51, m.SCHEMA_HASH ^ 1, request_, m.Mode.TORQUE, 0))
    assert (node.state, node.node.arm_refusal) == (State.IDLE, m.ArmRefusal.NONE)
    assert node.node.announced_nonce == (0x51 if request_ is m.Request.IDLE else 0)


@pytest.mark.proves("R-SES-3", "R-ARM-8")
def test_the_mode_of_a_session_is_the_one_that_armed_it() -> None:
    node = BareNode()
    node.activate(nonce=0x51)
    node.heartbeat(m.Request.ARM, 0x51, m.Mode.TORQUE)
    node.send(m.TorqueCommand(1, 1, 1, 1, 1, 1))
    assert (node.node.mode, node.node.rejections.state) == (m.Mode.SPEED, 1)
    node.send(m.WheelCommand(1, 1, 1, 1, 1, 1))
    assert node.node.setting.sequence == 1


@pytest.mark.proves("R-CMD-3")
@pytest.mark.parametrize("sequence", [0, 1, 21, 128, 255])
def test_the_first_command_has_any_sequence_and_the_next_counts_from_it(sequence: int) -> None:
    node = BareNode()
    node.heartbeat(m.Request.IDLE, 0x51)
    node.heartbeat(m.Request.ARM, 0x51)
    for ahead in (0, 20):
        node.send(m.WheelCommand(0, 0, 0, 0, (sequence + ahead) & 0xFF, 1))
    assert (node.state, node.node.setting.sequence) == (State.ACTIVE, (sequence + 20) & 0xFF)


@pytest.mark.proves("R-STATE-13")
def test_a_robot_that_rolls_is_armed_and_the_first_command_brakes_it() -> None:
    rig = WheelRig()
    rig.speed_rad_s = [5.0, -5.0, 5.0, -5.0]
    rig.run(200)
    rig.activate()
    rig.drive(0.0, 300)
    assert rig.state is State.ACTIVE
    assert max(map(abs, rig.speed_rad_s)) < 0.1


@pytest.mark.proves("R-STOP-1")
@pytest.mark.parametrize("state", [state for state in State if state is not State.BOOT])
def test_an_estop_is_obeyed_whatever_it_says_of_source_and_reason(state: State) -> None:
    for source, reason in ((0, 0), (1, 255), (255, 1)):
        node = in_state(state)
        node.send(m.Estop(source, reason))
        assert node.state is State.ESTOP


# Feedback


@pytest.mark.proves("R-SNAP-1", "R-SNAP-4", "R-SNAP-9", "R-TIME-1")
@pytest.mark.parametrize("period", [1, 5, 7])
def test_a_snapshot_is_its_tick_and_the_announced_parts_of_that_instant_in_order(period: int) -> None:
    node = BareNode(changes={"feedback_period_s": period / 1000})
    node.heard()
    parts = (m.Encoders, m.WheelSpeeds, m.Currents, m.Accelerometer, m.Gyro)
    for tick in range(2 * 35 + 1):
        node.sense.count = [tick, tick + 1, tick + 2, tick + 3]
        if tick:
            node.lib.wheel_node_drive(node.node, node.drive)
        node.lib.wheel_node_sense(node.node, node.sense)
        heard = [x for x in node.heard() if isinstance(x, m.Tick | m.Encoders | m.WheelSpeeds) or type(x) in parts]
        if tick % period:
            assert heard == []
            continue
        opening, encoders, *_ = heard
        assert isinstance(opening, m.Tick)
        assert (opening.time_us, opening.snapshot) == (1000 * tick, tick // period)
        assert [type(x) for x in heard[1:]] == [kind for n, kind in enumerate(parts) if opening.parts >> n & 1]
        assert encoders == m.Encoders(tick, tick + 1, tick + 2, tick + 3)


@pytest.mark.proves("R-STAT-2", "R-CNT-11", "R-POW-1", "R-ABS-1", "R-RESET-1")
def test_what_is_told_ten_times_a_second_and_once_a_second() -> None:
    node = BareNode()
    node.node.identity.reset_cause = m.ResetCause.WATCHDOG
    node.heard()
    counted: Counter[type] = Counter()
    causes = set()
    for _ in range(2000):
        node.tick()
        heard = node.heard()
        counted.update(type(x) for x in heard)
        causes |= {x.reset_cause for x in heard if isinstance(x, m.Status)}
    tenth = (m.Status, m.LinkCounters, m.PortCounters, m.Power, m.Temperatures)
    assert [counted[kind] for kind in tenth] == [20] * 5
    assert [counted[kind] for kind in (m.AbsoluteFront, m.AbsoluteRear)] == [2, 2]
    assert causes == {m.ResetCause.WATCHDOG}


# Lockstep


@pytest.mark.proves("R-STEP-1")
@pytest.mark.parametrize("lockstep", [True, False])
def test_hello_reports_lockstep(lockstep: bool) -> None:
    rig = WheelRig(lockstep=lockstep)
    rig.heard()
    rig.send(m.HelloRequest(m.PROTOCOL_VERSION))
    (identity, *_) = rig.heard()
    assert isinstance(identity, m.HelloIdentity)
    assert bool(identity.capabilities & Capability.LOCKSTEP) == lockstep


@pytest.mark.proves("R-STEP-3", "R-STEP-8", "R-TIME-5")
def test_in_lockstep_requests_are_answered_at_once_at_the_time_of_the_tick() -> None:
    rig = WheelRig(lockstep=True)
    rig.send(m.Step(0, 7))
    rig.heard()
    for _ in range(2):
        rig.send(m.TimeSyncRequest(9))
        assert rig.heard() == [m.TimeSyncResponse(7000, 0, 9)]
    rig.send(m.ParameterRequest(0, m.Operation.READ, 1, 0))
    rig.send(m.HelloRequest(m.PROTOCOL_VERSION))
    assert [x.ID for x in rig.heard()] == [m.ParameterResponse.ID, *PAGES]
    rig.arm()
    rig.command(0.0, 0)
    assert (rig.state, rig.node.look().tick) == (State.ACTIVE, 7)
    rig.heard()
    rig.send(m.Step(3, 0))
    assert rig.heard() == [m.StepDone(7)]
    rig.node.receive(Frame(m.Step.ID, bytes([7, 0, 0, 0, 0xE9, 0x03])))  # 1001 substeps
    assert rig.heard() == []
    assert (rig.node.look().tick, rig.node.look().rejected["range"]) == (7, 1)
    rig.send(m.Step(7, 1000))
    assert rig.node.look().tick == 1007


@pytest.mark.proves("R-STEP-10")
def test_in_lockstep_the_watchdog_counts_robot_time() -> None:
    rig = WheelRig(lockstep=True)
    rig.activate()
    rig.send(m.Step(0, 49))
    for _ in range(100):
        rig.send(m.Step(49, 0))
    assert rig.state is State.ACTIVE
    rig.send(m.Step(49, 1))
    assert rig.state is State.STOPPING


class Overheard(Line):
    """A line to the firmware that keeps the host's frames, and may swallow the answer to a STEP."""

    def __init__(self, rig: WheelRig) -> None:
        super().__init__(rig)
        self._ear = Deframer()
        self.said: list[Frame] = []
        self.swallows = 0

    def _ask(self, data: bytes) -> bytes:
        heard = self._ear.feed(data)
        self.said += heard
        answer = super()._ask(data)
        if self.swallows and any(frame.id == m.Step.ID for frame in heard):
            self.swallows -= 1
            return b""
        return answer


@pytest.mark.proves("R-STEP-7")
def test_a_host_that_lost_the_answer_repeats_the_step_and_nothing_runs_twice() -> None:
    rig = WheelRig(lockstep=True)
    line = Overheard(rig)
    device, _ = driver(rig, line=line)
    device.connect()
    line.said.clear()
    line.swallows = 1
    device.step(5)
    assert line.said == [codec.encode(m.Step(0, 5))] * 2
    assert device.tick == rig.node.look().tick == 5


@pytest.mark.proves("R-TIME-2", "R-BEAT-1", "R-BEAT-2")
def test_a_host_that_drives_sends_heartbeats_at_10_hz_and_time_syncs_at_4_hz() -> None:
    rig = WheelRig(lockstep=True)
    line = Overheard(rig)
    device, clock = driver(rig, line=line, nonces=[0x51])
    device.connect()
    device.start(clock, PERIOD_NS)
    line.said.clear()
    for _ in range(400):  # 2 s
        device.poll()
        device.send(WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS))
        clock.wait_until(clock.now_ns() + PERIOD_NS)
    wishes = [m.HostHeartbeat.decode(frame.payload) for frame in line.said if frame.id == m.HostHeartbeat.ID]
    assert len(wishes) == pytest.approx(20, abs=1)
    assert {(wish.request, wish.nonce) for wish in wishes if wish is not None} == {(m.Request.ARM, 0x51)}
    assert sum(frame.id == m.TimeSyncRequest.ID for frame in line.said) == pytest.approx(8, abs=1)
