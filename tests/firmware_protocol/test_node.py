"""The firmware core: what makes it move, and above all what does not."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.extension import library
from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import HostNode, parameter_hash, parameters, stored_size
from tests.support.client_rig import feed, new_client
from tests.support.examples import share_of_examples
from tests.support.wheel_rig import PARAMETERS, REST_TICKS, WheelRig


@pytest.mark.proves("R-STATE-4")
def test_drives_the_wheels_to_the_commanded_speed():
    rig = WheelRig()
    rig.activate()
    rig.drive(10.0, 1500)
    assert rig.speed_rad_s == pytest.approx([10.0] * 4, abs=0.05)
    feedback = [x for x in rig.heard() if isinstance(x, m.WheelSpeeds)][-1]
    assert feedback.fl_rad_s == pytest.approx(rig.speed_rad_s[0], abs=0.3)


@pytest.mark.proves("R-STATE-2", "R-CNT-10")
def test_starts_idle_and_does_not_move_on_commands_there():
    rig = WheelRig()
    assert rig.state is m.State.IDLE
    rig.drive(10.0, 100)
    assert rig.speed_rad_s == [0.0] * 4
    assert rig.node.look().rejected["state"] == 20


@pytest.mark.proves("R-CMD-2", "R-FF-2")
def test_first_command_must_be_zero():
    rig = WheelRig()
    rig.arm()
    rig.command(1.0, 0)
    assert rig.state is m.State.ARMED
    rig.send(m.TorqueFeedforward(1.0, 1.0, 1.0, 1.0, 1, rig.nonce & 0xF))
    rig.command(0.0, 1)
    assert rig.state is m.State.ACTIVE
    rig.run(10)
    assert rig.speed_rad_s == [0.0] * 4


@pytest.mark.proves("R-WD-2", "R-RAMP-4", "R-GEN-4")
def test_silence_ramps_the_set_point_to_zero_and_latches():
    rig = WheelRig()
    rig.activate()
    sequence = rig.drive(10.0, 1000)
    watchdog, ramp = 50, 200
    rig.run(watchdog - 5 - 1)  # 5 ticks have passed since the last command
    assert rig.state is m.State.ACTIVE
    rig.run(1)
    assert rig.state is m.State.STOPPING
    rig.command(10.0, sequence)
    rig.run(ramp)
    view = rig.node.look()
    assert view.set_point_rad_s == (0.0,) * 4
    rig.run(1000)
    view = rig.node.look()
    assert (view.state, view.stop_reason) == (m.State.IDLE, m.StopReason.COMMAND_TIMEOUT)
    rig.drive(10.0, 100, sequence + 1)
    assert rig.state is m.State.IDLE
    assert max(map(abs, rig.speed_rad_s)) < 0.5


@pytest.mark.proves("R-GEN-2", "R-GEN-3", "R-FF-3")
@pytest.mark.parametrize(
    "feed",
    [
        lambda rig, n: rig.heartbeat(m.Request.ARM, rig.nonce),
        lambda rig, n: rig.send(m.HelloRequest(1)),
        lambda rig, n: rig.command(10.0, n, session=(rig.nonce + 1) & 0xF),
        lambda rig, n: rig.command(10.0, 5),
        lambda rig, n: rig.command(10.0, 5 - n),
        lambda rig, n: rig.torque(1.0, n),
        lambda rig, n: rig.send(m.TorqueFeedforward(1, 1, 1, 1, n & 0xFF, rig.nonce & 0xF)),
        lambda rig, n: rig.node.receive(Frame(m.WheelCommand.ID, b"\0" * 7)),
        lambda rig, n: rig.node.receive(Frame(m.WheelCommand.ID, b"\x00\x10" + bytes([0, 0, 0, 0, 0, n & 0xFF]))),
        lambda rig, n: rig.node.receive(Frame(m.TorqueFeedforward.ID, b"\x00\x10" + bytes([0, 0, 0, 0, 0, n & 0xFF]))),
        lambda rig, n: rig.send(m.TimeSyncRequest(n)),
        lambda rig, n: rig.send(m.ParameterRequest(0, m.Operation.READ, n, 0)),
    ],
    ids=[
        "heartbeat",
        "hello",
        "session",
        "same",
        "backward",
        "mode",
        "feedforward",
        "short",
        "out of range",
        "feedforward out of range",
        "time sync",
        "parameter",
    ],
)
def test_nothing_but_a_fresh_command_feeds_the_watchdog(feed):
    rig = WheelRig()
    rig.activate()
    for sequence in range(1, 6):
        rig.command(0.0, sequence)
    for n in range(60):
        feed(rig, n)
        rig.run(1)
    assert rig.state is m.State.STOPPING


@pytest.mark.proves("R-CMD-4")
@given(distance=st.integers(0, 255))
def test_sequence_window(distance):
    rig = WheelRig()
    rig.activate()
    for last in range(0, 256, 20):
        rig.command(0.0, last)
    before = rig.node.look().rejected["stale"]
    rig.command(0.0, 240 + distance)
    assert (rig.node.look().rejected["stale"] == before) == (1 <= distance <= 20)


@pytest.mark.proves("R-ARM-3", "R-GEN-4")
def test_a_repeated_wish_never_rearms():
    rig = WheelRig()
    rig.activate()
    rig.run(60)
    assert rig.state is m.State.STOPPING
    for _ in range(200):
        rig.heartbeat(m.Request.ARM, rig.nonce)
        rig.run(10)
    assert rig.state is m.State.IDLE
    assert rig.node.look().stop_reason is m.StopReason.COMMAND_TIMEOUT
    rig.arm()
    assert rig.state is m.State.ARMED


@pytest.mark.proves("R-ARM-1", "R-ARM-3")
def test_a_wish_that_was_held_never_arms():
    """Through a stop, an e-stop and its clearing, and a reset: only an announced nonce arms, and only once."""
    rig = WheelRig()
    rig.activate()
    rig.heartbeat(m.Request.ARM, 0x5555)
    rig.send(m.Estop(0, 0))
    rig.heartbeat(m.Request.ARM, 0x5555)
    rig.run(REST_TICKS)
    rig.heartbeat(m.Request.CLEAR, 0x777)
    assert rig.state is m.State.IDLE
    for nonce in (0x5555, rig.nonce, 0x6666, 0x5555):
        rig.heartbeat(m.Request.ARM, nonce)
        assert rig.state is m.State.IDLE
    assert [x for x in rig.heard() if isinstance(x, m.Status)][-1].arm_refusal in (
        m.ArmRefusal.NOT_ANNOUNCED,
        m.ArmRefusal.NONCE_USED,
    )
    reset = WheelRig()
    reset.heartbeat(m.Request.ARM, rig.nonce)
    reset.command(0.0, 0)
    assert reset.state is m.State.IDLE
    reset.arm()
    assert reset.state is m.State.ARMED


@pytest.mark.proves("R-ARM-2")
def test_an_announcement_holds_for_the_state_in_which_it_was_made():
    rig = WheelRig()
    rig.heartbeat(m.Request.IDLE, 0x1234)
    rig.send(m.Estop(0, 0))
    rig.heartbeat(m.Request.CLEAR, 0x1)
    rig.heartbeat(m.Request.ARM, 0x1234)
    assert rig.state is m.State.IDLE


@pytest.mark.proves("R-REF-5", "R-REF-6", "R-ARM-7")
@pytest.mark.parametrize(
    ("change", "refusal"),
    [
        ({"schema_hash": m.SCHEMA_HASH ^ 1}, m.ArmRefusal.SCHEMA),
        ({"parameter_check": (parameter_hash(PARAMETERS) + 1) & 0xFF}, m.ArmRefusal.PARAMETERS),
    ],
)
def test_arming_is_refused_with_a_reason(change, refusal):
    rig = WheelRig()
    wish = m.HostHeartbeat(7, m.SCHEMA_HASH, m.Request.ARM, m.Mode.SPEED, parameter_hash(PARAMETERS) & 0xFF)
    rig.heartbeat(m.Request.IDLE, 7)
    rig.send(wish._replace(**change))
    assert rig.state is m.State.IDLE
    assert [x for x in rig.heard() if isinstance(x, m.Status)][-1].arm_refusal == refusal


@pytest.mark.proves("R-REF-4", "R-SES-1")
def test_a_session_number_is_not_used_twice_in_a_row():
    rig = WheelRig()
    rig.arm(nonce=0x0017)
    rig.arm(nonce=0x0027)
    assert rig.state is m.State.IDLE
    assert [x for x in rig.heard() if isinstance(x, m.Status)][-1].arm_refusal == m.ArmRefusal.SESSION_USED


@pytest.mark.proves("R-STATE-3")
def test_armed_without_a_command_falls_back():
    rig = WheelRig()
    rig.arm()
    rig.run(999)
    assert rig.state is m.State.ARMED
    rig.run(1)
    assert (rig.state, rig.node.look().stop_reason) == (m.State.IDLE, m.StopReason.ARM_TIMEOUT)


@pytest.mark.proves("R-STATE-7", "R-STATE-10", "R-STOP-3", "R-CLEAR-1")
@pytest.mark.parametrize("mode", [m.Mode.SPEED, m.Mode.TORQUE])
def test_estop_brakes_at_once_and_latches(mode):
    rig = WheelRig()
    rig.activate(mode)
    for sequence in range(1, 101):
        if mode is m.Mode.SPEED:
            rig.command(10.0, sequence)
        else:
            rig.torque(1.0, sequence)
        rig.run(3)
    assert min(rig.speed_rad_s) > 5.0
    rig.send(m.Estop(0, 0))
    rig.run(1)
    assert rig.node.look().set_point_rad_s == (0.0,) * 4
    rig.run(1200)
    assert rig.state is m.State.ESTOP
    assert max(map(abs, rig.speed_rad_s)) < 0.5
    assert rig.node.look().torque_n_m == (0.0,) * 4
    rig.arm()
    assert rig.state is m.State.ESTOP
    rig.heartbeat(m.Request.CLEAR, 0x777)
    assert rig.state is m.State.IDLE
    rig.send(m.Estop(0, 0))
    rig.heartbeat(m.Request.CLEAR, 0x777)
    assert rig.state is m.State.ESTOP, "a repeated wish does not clear the next e-stop"
    rig.heartbeat(m.Request.CLEAR, 0x778)
    assert rig.state is m.State.IDLE


@pytest.mark.proves("R-RAMP-3")
@pytest.mark.parametrize("end", ["estop", "silence"])
def test_a_stop_does_not_drive_with_what_was_wound_up(end):
    """Wheels blocked under a command, then stopped, then free: they must not start."""
    rig = WheelRig()
    rig.activate()
    rig.held = [True] * 4
    rig.drive(2.0, 2000)
    assert max(rig.torque_n_m) == 5.0
    if end == "estop":
        rig.send(m.Estop(0, 0))
    rig.run(51)
    rig.held = [False] * 4
    rig.run(1500)
    assert max(map(abs, rig.speed_rad_s)) < 0.2


@pytest.mark.proves("R-STOP-4", "R-GEN-6")
@pytest.mark.parametrize("end", ["idle", "fault"])
def test_estop_never_switches_drives_on(end):
    rig = WheelRig()
    rig.activate()
    rig.drive(5.0, 500)
    if end == "idle":
        rig.run(2000)
        assert rig.state is m.State.IDLE
        rig.speed_rad_s = [3.0] * 4  # pushed by hand
        rig.run(100)
    else:
        rig.send(m.Estop(0, 0))
        rig.run(5)
        assert max(map(abs, rig.torque_n_m)) > 0.0
        rig.current_a[0] = float("nan")
        rig.run(2)
    rig.send(m.Estop(0, 0))
    for _ in range(100):
        rig.run(1)
        assert rig.torque_n_m == [0.0] * 4
    assert rig.state is m.State.ESTOP


@pytest.mark.proves("R-STATE-12")
def test_a_plant_that_is_gone_is_not_cleared():
    rig = WheelRig()
    rig.fail = True
    rig.run(1)
    rig.fail = False
    rig.heartbeat(m.Request.CLEAR, 0x1)
    rig.run(1)
    rig.arm()
    assert rig.state is m.State.FAULT


@pytest.mark.proves("R-STAT-1", "R-GEN-6")
def test_estop_of_a_faulty_robot_latches_and_keeps_its_reason():
    rig = WheelRig(overspeed_rad_s=8.0)
    rig.activate()
    push(rig, 9.0)
    assert (rig.state, rig.node.look().stop_reason) == (m.State.FAULT, m.StopReason.FAULT)
    rig.send(m.Estop(0, 0))
    rig.current_a[0] = float("nan")
    for _ in range(10):
        rig.run(1)
        assert rig.torque_n_m == [0.0] * 4
    assert (rig.state, rig.node.look().stop_reason) == (m.State.ESTOP, m.StopReason.ESTOP)


@pytest.mark.proves("R-SNAP-3", "R-FAULT-1")
def test_a_sensor_fault_is_still_told():
    rig = WheelRig()
    rig.activate()
    rig.drive(5.0, 100)
    rig.heard()
    rig.current_a[0] = float("nan")
    rig.run(20)
    client = new_client()
    assert feed(client, rig.heard())[-1].state is m.State.FAULT
    assert client.view.incomplete == 0


@pytest.mark.proves("R-GEN-1", "R-GEN-2", "R-GEN-8", "R-CNT-7", "R-STEP-8")
@pytest.mark.parametrize("kind", [m.HostHeartbeat, m.TorqueFeedforward, m.WheelCommand, m.TorqueCommand, m.Step])
def test_a_payload_out_of_range_does_nothing_and_is_counted(kind):
    rig = WheelRig(lockstep=True)
    rig.activate(m.Mode.TORQUE if kind is m.TorqueCommand else m.Mode.SPEED)
    rig.heard()
    bad = b"\0" * 6 if kind in (m.HostHeartbeat,) else b"\0\x10" + b"\0" * 4
    rig.node.receive(Frame(kind.ID, (bad if kind is not m.Step else b"\0" * 4 + b"\xff\xff").ljust(kind.LENGTH, b"\0")))
    assert rig.heard() == []
    assert (rig.state, rig.node.look().tick) == (m.State.ACTIVE, 0)
    assert rig.node.look().rejected["range"] == 1


@pytest.mark.proves("R-RAMP-2")
def test_torque_mode_stops_by_the_speed_loop():
    rig = WheelRig()
    rig.activate(m.Mode.TORQUE)
    for sequence in range(1, 51):
        rig.torque(1.0, sequence)
        rig.run(5)
    speed = rig.speed_rad_s[0]
    assert speed == pytest.approx(250 * 1e-3 / 0.033, rel=1e-3)
    rig.run(50 + 200 + 300)
    assert max(map(abs, rig.speed_rad_s)) < 0.5
    assert rig.state is m.State.IDLE


@pytest.mark.proves("R-FF-1", "R-FF-2")
def test_feedforward_needs_the_command_of_its_sequence():
    rig = WheelRig()
    rig.activate()
    session = rig.nonce & 0xF
    rig.send(m.TorqueFeedforward(1.0, 0.5, -0.5, 0.25, 1, session))
    rig.command(0.0, 1)
    rig.run(1)
    assert rig.torque_n_m == [1.0, 0.5, -0.5, 0.25]
    rig.send(m.TorqueFeedforward(1.0, 1.0, 1.0, 1.0, 2, session))
    rig.command(0.0, 3)
    rig.run(1)
    assert max(map(abs, rig.torque_n_m)) < 0.5
    assert rig.node.look().rejected["feedforward_unmatched"] == 1


@pytest.mark.proves("R-LIM-1")
def test_all_four_are_scaled_together_at_the_limit():
    rig = WheelRig(torque_limit_n_m=2.0)
    rig.activate(m.Mode.TORQUE)
    rig.send(m.TorqueCommand(4.0, -2.0, 1.0, 0.0, 1, rig.nonce & 0xF))
    rig.run(1)
    assert rig.torque_n_m == [2.0, -1.0, 0.5, 0.0]


@pytest.mark.proves("R-FAULT-1", "R-GEN-5")
def test_a_failed_plant_and_a_sensor_that_is_no_number_are_faults():
    rig = WheelRig()
    rig.activate()
    rig.drive(5.0, 100)
    rig.current_a[0] = float("nan")
    rig.run(1)
    assert (rig.state, rig.node.look().fault) == (m.State.FAULT, m.Fault.SENSOR)
    rig.run(1)
    assert rig.node.look().torque_n_m == (0.0,) * 4

    rig = WheelRig()
    rig.activate()
    rig.fail = True
    rig.run(5)
    assert (rig.state, rig.node.look().plant_failed) == (m.State.FAULT, True)


@pytest.mark.proves("R-FAULT-2")
def test_overspeed_is_a_fault():
    rig = WheelRig(overspeed_rad_s=8.0)
    rig.activate()
    push(rig, 9.0)
    assert (rig.state, rig.node.look().fault) == (m.State.FAULT, m.Fault.OVERSPEED)


def push(rig, speed_rad_s):
    """Somebody pushes all wheels, against whatever the drives do."""
    rig.speed_rad_s, rig.held = [speed_rad_s] * 4, [True] * 4
    rig.drive(0.0, 200)


@pytest.mark.proves("R-LIM-2", "R-LIM-3", "R-LIM-4")
@pytest.mark.parametrize(("overspeed_rad_s", "limit_rad_s"), [(8.0, 6.390625), (10.0, 8.0), (100.0, 63.984375)])
def test_a_command_beyond_the_speed_limit_is_scaled_and_keeps_its_direction(overspeed_rad_s, limit_rad_s):
    """The limit is 0.8 times the overspeed fault, in steps of 1/64; below it a robot drives as commanded."""
    rig = WheelRig(overspeed_rad_s=overspeed_rad_s)
    rig.activate()
    rig.held = [True] * 4
    asked = (63.984375, -32.0, 16.0, 0.0)
    for sequence in range(1, 20):
        rig.send(m.WheelCommand(*asked, sequence, rig.nonce & 0xF))
        rig.run(5)
    view = rig.node.look()
    assert view.set_point_rad_s == pytest.approx([limit_rad_s * x / asked[0] for x in asked], rel=1e-6)
    assert max(view.set_point_rad_s) <= limit_rad_s
    assert view.state is m.State.ACTIVE, "without a fault"
    assert view.rejected["range"] == 0


@pytest.mark.proves("R-LIM-7")
@pytest.mark.parametrize(("asked_rad_s", "is_counted"), [(8.0, False), (-8.0, False), (8.015625, True)])
def test_a_scaled_speed_is_counted_and_the_end_of_the_limit_is_not(asked_rad_s, is_counted):
    rig = WheelRig(overspeed_rad_s=10.0)
    rig.speed_rad_s, rig.held = [asked_rad_s] * 4, [True] * 4  # nothing to gain, so that no torque is limited
    rig.run(200)
    rig.activate()
    rig.heard()
    rig.drive(asked_rad_s, 300)
    *_, first, second = (x.limited for x in rig.heard() if isinstance(x, m.Status))
    assert second - first == (100 if is_counted else 0)


@pytest.mark.proves("R-STEP-4", "R-STEP-5", "R-STEP-6", "R-TIME-1")
def test_step_is_idempotent_and_answers_after_the_feedback():
    rig = WheelRig(lockstep=True)
    rig.heard()
    rig.send(m.Step(0, 5))
    heard = rig.heard()
    assert heard[-1] == m.StepDone(5)
    assert any(isinstance(x, m.Tick) and x.time_us == 5000 for x in heard)
    rig.send(m.Step(0, 5))
    assert rig.heard() == [m.StepDone(5)]
    assert rig.node.look().tick == 5


@pytest.mark.proves("R-STEP-2")
@pytest.mark.parametrize("kind", [{"lockstep": False}, {"lockstep": True, "power_stage": True}])
def test_step_is_refused_outside_lockstep_and_by_motors(kind):
    rig = WheelRig(**kind)
    rig.heard()
    rig.send(m.Step(0, 5))
    assert rig.heard() == []
    view = rig.node.look()
    assert (view.tick, {cause: count for cause, count in view.rejected.items() if count}) == (0, {"state": 1})


@pytest.mark.proves("R-HELLO-1", "R-HASH-3")
def test_hello_reports_identity_and_parameter_hash():
    rig = WheelRig(overspeed_rad_s=40.0)
    rig.heard()
    rig.send(m.HelloRequest(1))
    identity, _firmware, held, size, limits, *fault = rig.heard()
    assert identity.schema_hash == m.SCHEMA_HASH
    assert size == m.HelloGeometry(614 / 8192, 2458 / 8192, 2458 / 8192, 4096), "0.075, 0.3 and 0.3 m"
    assert held == m.HelloParameters(parameter_hash(PARAMETERS | {"overspeed_rad_s": 40.0}), 50, 5)
    assert limits == m.HelloLimits(32.0, 40.0, 5.0)
    assert fault == [m.HelloFaultStatus(0, 0), m.HelloFaultPlace(0, 0), m.HelloFaultAddress(0, 0)]


@pytest.mark.parametrize("name", [p.name for p in parameters()])
def test_parameters_are_checked_and_named(name):
    row = next(p for p in parameters() if p.name == name)
    with pytest.raises(ValueError, match=name):
        WheelRig(**{name: row.maximum * 2 + 1})
    with pytest.raises(ValueError, match=name):
        WheelRig(**{name: float("nan")})
    others = {k: v for k, v in PARAMETERS.items() if k != name} | {"colour": 1.0}
    names = re.escape(str(sorted({name, "colour"})))
    with pytest.raises(ValueError, match=f"^firmware parameters {names} are missing or unknown$"):
        HostNode(others, 0, 0, lockstep=False)


def test_what_another_length_was_stored_with_is_refused():
    length = stored_size()
    with pytest.raises(ValueError, match=f"^{length - 1} stored bytes; expected {length}$"):
        WheelRig(stored=bytes(length - 1))


def test_parameters_match_their_structure():
    ffi, _ = library()
    assert [name for name, _ in ffi.typeof("wheel_parameters").fields] == [p.name for p in parameters()]


@pytest.mark.proves("R-CNT-1", "R-CNT-2", "R-CNT-10", "R-CNT-12")
def test_counters_of_the_link_reach_the_host_and_wrap():
    rig = WheelRig()
    for _ in range(300):
        rig.node.feed(bytes(range(1, 40)) + b"\0")
        rig.command(0.0, 0)
    rig.run(100)
    heard = rig.heard()
    counters = [x for x in heard if isinstance(x, m.LinkCounters)][-1]
    ports = [x for x in heard if isinstance(x, m.PortCounters)][-1]
    assert (counters.length, counters.state, ports.overrun) == (0, 300 & 0xFF, 300 & 0xFF)


_ANY_FRAME = st.builds(
    lambda kind, payload: Frame(kind, payload[: m.LENGTHS[kind]]),
    st.sampled_from(sorted(set(m.LENGTHS) - {m.Step.ID})),
    st.binary(min_size=8, max_size=8),
)


@pytest.mark.proves("R-GEN-2")
@share_of_examples(3.0)
@given(data=st.lists(st.binary(max_size=40) | _ANY_FRAME, max_size=40))
def test_neither_bytes_nor_valid_frames_move_an_idle_robot(data):
    """Frames of any content with a right CRC: none of them arms, commands first at rest, and then drives."""
    rig = WheelRig()
    framer = Framer()
    for item in data:
        rig.node.feed(framer.encode(item) if isinstance(item, Frame) else item)
        rig.run(3)
    assert rig.speed_rad_s == [0.0] * 4


_PLAUSIBLE = st.builds(Frame, st.sampled_from(sorted(set(m.LENGTHS) - {m.Step.ID})), st.binary(min_size=8, max_size=8))


@pytest.mark.proves("R-GEN-3")
@share_of_examples(3.0)
@given(frames=st.lists(_PLAUSIBLE, max_size=60))
def test_no_stale_frames_keep_an_active_robot_going(frames):
    """Valid frames with any content, none with a fresh command: the robot stops in time."""
    rig = WheelRig()
    rig.activate()
    framer = Framer()
    rig.drive(5.0, 200)
    session = rig.nonce & 0xF
    for frame in frames:
        payload = frame.payload[: m.LENGTHS[frame.id]]
        if frame.id in (m.WheelCommand.ID, m.TorqueCommand.ID):
            fresh = m.WheelCommand.decode(payload) if frame.id == m.WheelCommand.ID else None
            if fresh is not None and fresh.session == session:
                continue
        rig.node.feed(framer.encode(Frame(frame.id, payload)))
        rig.run(5)
    rig.run(50 + 200 + 1000)
    assert rig.state in (m.State.IDLE, m.State.FAULT, m.State.ESTOP)
    assert max(map(abs, rig.speed_rad_s)) < 0.5


def test_the_same_input_gives_the_same_bytes():
    def run() -> bytes:
        rig = WheelRig()
        rig.activate()
        rig.drive(7.0, 500)
        return rig.node.take_bytes()

    first = run()
    assert first == run()
    assert len(first) > 5000


def test_codec_refuses_what_the_node_would():
    with pytest.raises(ValueError, match="WHEEL_COMMAND"):
        codec.encode(m.WheelCommand(64.0, 0.0, 0.0, 0.0, 0, 0))


def test_what_a_plant_in_python_raises_is_raised_by_the_call_that_let_time_pass():
    rig = WheelRig()
    rig.current_a = []
    for pass_time in (lambda: rig.run(1), lambda: rig.send(m.Estop(0, 0))):
        with pytest.raises(IndexError):
            pass_time()
