"""A session begins with nothing of the one before, and arms by the rules only."""

from typing import Any

import pytest

from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import State
from tests.support.bare_node import BareNode
from tests.support.wheel_rig import REST_TICKS, WheelRig


def fault_and_clear(node: BareNode) -> None:
    node.lib.wheel_node_fail(node.node)
    assert node.state is State.FAULT
    node.heartbeat(m.Request.CLEAR, 0x77)
    assert node.state is State.IDLE


@pytest.mark.proves("R-RESET-2")
def test_a_node_begins_the_same_whatever_its_memory_held() -> None:
    fresh, used = BareNode(), BareNode()
    used.activate()
    used.tick(100)
    used.ffi.buffer(used.node)[:] = b"\xa5" * used.ffi.sizeof("wheel_node")
    used.lib.wheel_node_init(used.node, used.ffi.addressof(fresh.node, "built_in"), used.ffi.NULL, used.identity)
    fresh.lib.wheel_node_init(fresh.node, fresh.ffi.addressof(used.node, "built_in"), fresh.ffi.NULL, fresh.identity)
    assert bytes(used.ffi.buffer(used.node)) == bytes(fresh.ffi.buffer(fresh.node))


@pytest.mark.proves("R-SES-2")
def test_a_staged_feedforward_does_not_wait_for_the_next_session() -> None:
    node = BareNode()
    node.activate(nonce=0x1231)
    node.send(m.TorqueFeedforward(1.0, 1.0, 1.0, 1.0, 5, 1))
    assert node.node.staged.present
    fault_and_clear(node)
    node.heartbeat(m.Request.IDLE, 0x1232)
    node.heartbeat(m.Request.ARM, 0x1232)
    node.send(m.WheelCommand(0, 0, 0, 0, 5, 2))
    assert node.state is State.ACTIVE
    node.tick()
    assert list(node.drive.torque_n_m) == [0.0] * 4
    assert node.node.rejections.feedforward_unmatched == 0


@pytest.mark.proves("R-SES-2")
@pytest.mark.parametrize("leftover", ["speed_loop", "current_loop"])
def test_no_integral_outlives_its_session(leftover: str) -> None:
    node = BareNode()
    node.activate(nonce=0x1231)
    name = "integral_n_m" if leftover == "speed_loop" else "integral_v"
    setattr(getattr(node.node, leftover), name, [1.0, -2.0, 3.0, 4.0])
    fault_and_clear(node)
    node.activate(nonce=0x1232)
    assert list(getattr(getattr(node.node, leftover), name)) == [0.0] * 4
    node.tick()
    assert list(node.drive.torque_n_m) == list(node.drive.duty) == [0.0] * 4


@pytest.mark.proves("R-SES-2")
def test_what_was_seen_of_an_encoder_does_not_count_in_the_next_session() -> None:
    node = BareNode()
    node.activate(nonce=0x1231)
    for watch in node.node.encoder:
        watch.still_ticks = watch.backward_ticks = 99
    fault_and_clear(node)
    node.activate(nonce=0x1232)
    assert [(w.still_ticks, w.backward_ticks) for w in node.node.encoder] == [(0, 0)] * 4


@pytest.mark.proves("R-SES-2", "R-STATE-13")
def test_a_wheel_that_rolls_when_it_is_armed_has_not_gained_that_speed() -> None:
    node = BareNode()
    node.node.speed_rad_s = [1.0, -2.0, 3.0, -4.0]
    node.activate()
    assert [watch.slowest_rad_s for watch in node.node.encoder] == [1.0, 2.0, 3.0, 4.0]


@pytest.mark.proves("R-SES-2", "R-SNAP-11")
def test_a_session_begins_without_a_command() -> None:
    rig = WheelRig(feedback_period_s=0.001)
    rig.activate()
    rig.drive(10.0, 100)
    rig.run(2000)
    rig.heard()
    rig.arm()
    rig.run(1)
    assert [(x.sequence, x.command_age_ms) for x in rig.heard() if isinstance(x, m.Tick)] == [(0, 255)]


@pytest.mark.proves("R-RAMP-3")
def test_a_stop_begins_with_an_empty_integral() -> None:
    """An e-stop and a stop alike: what was wound up must not drive on."""
    for end in (m.Estop(0, 0), m.HostHeartbeat(0x99, m.SCHEMA_HASH, m.Request.IDLE, m.Mode.SPEED, 0)):
        node = BareNode()
        node.activate()
        node.node.speed_loop.integral_n_m = [3.0] * 4
        node.send(end)
        assert list(node.node.speed_loop.integral_n_m) == [0.0] * 4


@pytest.mark.proves("R-RAMP-1")
@pytest.mark.parametrize(
    ("set_point", "speed", "begins_at"),
    [
        (8.0, 3.0, 3.0),
        (3.0, 8.0, 3.0),
        (-8.0, -3.0, -3.0),
        (-3.0, -8.0, -3.0),
        (8.0, -3.0, 0.0),
        (-3.0, 8.0, 0.0),
        (0.375, -0.5, 0.0),
        (0.375, 0.5, 0.375),
    ],
)
def test_a_stop_begins_at_whichever_is_nearer_to_zero(set_point: float, speed: float, begins_at: float) -> None:
    node = BareNode()
    node.activate()
    node.node.set_point_rad_s = [set_point] * 4
    node.node.speed_rad_s = [speed] * 4
    node.heartbeat(m.Request.IDLE, 0x99)
    assert list(node.node.ramp_from_rad_s) == [begins_at] * 4
    for n in range(1, 201):
        node.lib.wheel_node_drive(node.node, node.drive)
        assert list(node.node.set_point_rad_s) == pytest.approx([begins_at * (200 - n) / 200] * 4, abs=1e-5)


def refusal(node: BareNode) -> m.ArmRefusal:
    return m.ArmRefusal(node.node.arm_refusal)


@pytest.mark.proves("R-ARM-2", "R-REF-3")
def test_an_announcement_is_used_up_by_any_arming() -> None:
    """Also by a refused one."""
    node = BareNode()
    node.heartbeat(m.Request.IDLE, 0x51)
    node.send(m.HostHeartbeat(0x51, m.SCHEMA_HASH ^ 1, m.Request.ARM, m.Mode.SPEED, 0))
    assert (node.state, refusal(node)) == (State.IDLE, m.ArmRefusal.SCHEMA)
    for nonce in (1, 2, 0x50, 0x52):  # nor is another announced by it
        node.heartbeat(m.Request.ARM, nonce)
        assert refusal(node) is m.ArmRefusal.NOT_ANNOUNCED
    node.heartbeat(m.Request.ARM, 0x51)
    assert (node.state, refusal(node)) == (State.IDLE, m.ArmRefusal.NOT_ANNOUNCED)
    node.heartbeat(m.Request.IDLE, 0x51)
    node.heartbeat(m.Request.ARM, 0x51)
    assert (node.state, refusal(node)) == (State.ARMED, m.ArmRefusal.NONE)


@pytest.mark.proves("R-ARM-1")
def test_the_last_announcement_holds() -> None:
    node = BareNode()
    for nonce in (0x51, 0x62, 0x73):
        node.heartbeat(m.Request.IDLE, nonce)
    node.heartbeat(m.Request.ARM, 0x62)
    assert refusal(node) is m.ArmRefusal.NOT_ANNOUNCED
    node.heartbeat(m.Request.IDLE, 0x73)
    node.heartbeat(m.Request.ARM, 0x73)
    assert node.state is State.ARMED


@pytest.mark.proves("R-REF-2", "R-ARM-8")
@pytest.mark.parametrize("state", [State.ARMED, State.ACTIVE])
def test_another_host_cannot_take_a_session_over(state: State) -> None:
    node = BareNode()
    node.heartbeat(m.Request.IDLE, 0x51)
    node.heartbeat(m.Request.ARM, 0x51)
    if state is State.ACTIVE:
        node.send(m.WheelCommand(0, 0, 0, 0, 0, 1))
    node.heartbeat(m.Request.ARM, 0x62)
    assert (node.state, refusal(node), node.node.session_nonce) == (state, m.ArmRefusal.NOT_IDLE, 0x51)
    node.heartbeat(m.Request.ARM, 0x51)
    assert refusal(node) is m.ArmRefusal.NOT_IDLE, "the heartbeat of the session is no wish to arm, and changes nothing"


@pytest.mark.proves("R-ARM-7", "R-REF-1")
@pytest.mark.parametrize("state", [State.STOPPING, State.IDLE, State.FAULT, State.ESTOP])
def test_the_nonce_of_a_session_that_has_ended_is_told_as_used_whatever_else_holds(state: State) -> None:
    """PROTOCOL.md: NONCE_USED comes before NOT_IDLE; in ARMED and ACTIVE the same ARM is the session's heartbeat."""
    node = BareNode()
    node.activate(nonce=0x51)
    if state is State.FAULT:
        node.lib.wheel_node_fail(node.node)
    elif state is State.ESTOP:
        node.send(m.Estop(0, 0))
    else:
        node.heartbeat(m.Request.IDLE, 0x51)
        node.tick(1 if state is State.STOPPING else 400)
    assert node.state is state
    node.heartbeat(m.Request.ARM, 0x51)
    assert (node.state, refusal(node)) == (state, m.ArmRefusal.NONCE_USED)


@pytest.mark.proves("R-STAT-2")
def test_a_refusal_is_told_once_and_again_when_it_changes() -> None:
    node = BareNode()
    node.heard()

    def told(nonce: int, **changes: Any) -> list[m.ArmRefusal]:
        node.send(m.HostHeartbeat(nonce, m.SCHEMA_HASH, m.Request.ARM, m.Mode.SPEED, 0)._replace(**changes))
        return [x.arm_refusal for x in node.heard() if isinstance(x, m.Status)]

    assert told(0x51) == [m.ArmRefusal.NOT_ANNOUNCED]
    assert told(0x52) == []
    node.heartbeat(m.Request.IDLE, 0x52)
    assert told(0x52, schema_hash=5) == [m.ArmRefusal.SCHEMA]
    assert told(0x52) == [m.ArmRefusal.NOT_ANNOUNCED]


@pytest.mark.proves("R-HELLO-2")
def test_a_host_that_greets_is_not_told_what_was_refused_to_another() -> None:
    node = BareNode()
    node.heartbeat(m.Request.ARM, 0x51)
    node.send(m.HelloRequest(1))
    assert refusal(node) is m.ArmRefusal.NONE


@pytest.mark.proves("R-REF-4", "R-SES-1")
@pytest.mark.parametrize("nonce", [0x1231, 0x4321, 0xFFF1])
def test_the_last_sessions_number_is_refused_but_the_first_session_is_free(nonce: int) -> None:
    fresh = BareNode()
    fresh.activate(nonce=0x0010)  # its number is 0, and so was the nonce of no session
    node = BareNode()
    node.activate(nonce=0x7771)
    fault_and_clear(node)
    node.heartbeat(m.Request.IDLE, nonce)
    node.heartbeat(m.Request.ARM, nonce)
    assert (node.state, refusal(node)) == (State.IDLE, m.ArmRefusal.SESSION_USED)


@pytest.mark.proves("R-REF-6")
def test_the_parameter_check_is_the_low_byte_of_the_hash() -> None:
    node = BareNode()
    wanted = node.lib.wheel_parameters_hash(node.ffi.addressof(node.node, "parameters")) & 0xFF
    accepted = []
    for check in range(256):
        probe = BareNode()
        probe.heartbeat(m.Request.IDLE, 0x51)
        probe.send(m.HostHeartbeat(0x51, m.SCHEMA_HASH, m.Request.ARM, m.Mode.SPEED, check))
        accepted += [check] if probe.state is State.ARMED else []
    assert accepted == [wanted]


@pytest.mark.proves("R-FAULT-10", "R-GEN-5")
def test_a_fault_does_not_hide_the_one_before_and_switches_off_in_the_same_tick() -> None:
    node = BareNode()
    node.activate()
    node.send(m.WheelCommand(10, 10, 10, 10, 1, 1))
    node.tick(20)
    assert node.drive.enabled == 1
    node.sense.temperature_degc[1] = 130.0
    node.tick()
    node.sense.current_a[0] = float("nan")
    node.tick()
    assert (node.drive.enabled, node.node.fault) == (0, m.Fault.OVERTEMPERATURE)
    assert list(node.node.set_point_rad_s) == [0.0] * 4


@pytest.mark.proves("R-CLEAR-1", "R-CLEAR-2")
def test_clearing_needs_an_unused_nonce_and_works_on_a_latched_state_only() -> None:
    node = BareNode()
    node.heartbeat(m.Request.CLEAR, 0x50)
    node.activate()
    node.heartbeat(m.Request.CLEAR, 0x51)
    assert node.state is State.ACTIVE
    node.send(m.Estop(0, 0))
    node.tick(REST_TICKS)
    for nonce, expected in ((0x51, State.ESTOP), (0x50, State.IDLE)):
        node.heartbeat(m.Request.CLEAR, nonce)
        assert node.state is expected
    for _ in range(2):
        node.send(m.Estop(0, 0))
        node.heartbeat(m.Request.CLEAR, 0x50)
        assert node.state is State.ESTOP


@pytest.mark.proves("R-CLEAR-3")
def test_an_estop_that_brakes_is_not_cleared_before_the_wheels_rest() -> None:
    rig = WheelRig()
    rig.activate()
    for n in range(300):
        rig.command(8.0, n + 1)
        rig.run(1)
    rig.send(m.Estop(0, 0))
    rolled = 0
    while rig.enabled:
        rig.heartbeat(m.Request.CLEAR, 0x1000 + rolled)
        rig.run(1)
        rolled += 1
        assert rig.state is State.ESTOP
    assert rolled > 100
    assert max(map(abs, rig.speed_rad_s)) < 0.2
    rig.heartbeat(m.Request.CLEAR, 0x1000)
    assert rig.state is State.IDLE, "a wish that was not heard has not used up its nonce"


@pytest.mark.proves("R-CMD-2", "R-CNT-10")
@pytest.mark.parametrize("mode", [m.Mode.SPEED, m.Mode.TORQUE])
@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize("value", [1 / 64, -1 / 64])
def test_the_first_command_is_zero_in_every_wheel(mode: m.Mode, wheel: int, value: float) -> None:
    node = BareNode()
    node.heartbeat(m.Request.IDLE, 0x51, mode)
    node.heartbeat(m.Request.ARM, 0x51, mode)
    kind = m.WheelCommand if mode is m.Mode.SPEED else m.TorqueCommand
    node.send(kind(*(value if i == wheel else 0.0 for i in range(4)), 0, 1))
    assert (node.state, node.node.rejections.state) == (State.ARMED, 1)
    assert node.node.setting.age_ticks == 0xFFFF_FFFF


@pytest.mark.proves("R-FF-2", "R-CNT-10")
@pytest.mark.parametrize("state", [State.IDLE, State.ARMED, State.STOPPING, State.ESTOP, State.FAULT])
def test_a_feedforward_outside_of_active_is_refused_and_counted(state: State) -> None:
    node = BareNode()
    node.activate()
    node.node.state = state
    node.send(m.TorqueFeedforward(1.0, 1.0, 1.0, 1.0, 1, 1))
    assert (node.node.rejections.state, node.node.staged.present) == (1, False)


@pytest.mark.proves("R-FF-1", "R-FF-2")
def test_a_feedforward_that_is_replaced_is_counted_and_the_newer_one_acts() -> None:
    node = BareNode()
    node.activate()
    for torque_n_m, sequence in ((1.0, 1), (2.0, 2)):
        node.send(m.TorqueFeedforward(torque_n_m, torque_n_m, torque_n_m, torque_n_m, sequence, 1))
    node.send(m.WheelCommand(0, 0, 0, 0, 2, 1))
    node.tick()
    assert list(node.drive.torque_n_m) == [2.0] * 4
    rejections = node.node.rejections
    counts = {name: getattr(rejections, name) for name, _ in node.ffi.typeof("wheel_rejections").fields}
    assert counts == dict.fromkeys(counts, 0) | {"feedforward_unmatched": 1}
