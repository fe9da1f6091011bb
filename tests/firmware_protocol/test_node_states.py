"""The state table, transition by transition: what PROTOCOL.md allows happens, and nothing else does."""

from collections.abc import Callable

import pytest

from firmware_protocol.capabilities import Capability
from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import State
from firmware_protocol.host import parameters
from tests.support.bare_node import ALL, BareNode, core
from tests.support.wheel_rig import WheelRig

EVENTS = ("READY", "ARM", "COMMAND", "DISARM", "TIMEOUT", "STOPPED", "ESTOP", "FAULT", "CLEAR")

ALLOWED = {
    (State.BOOT, "READY"): State.IDLE,
    (State.BOOT, "FAULT"): State.FAULT,
    (State.IDLE, "ARM"): State.ARMED,
    (State.IDLE, "ESTOP"): State.ESTOP,
    (State.IDLE, "FAULT"): State.FAULT,
    (State.ARMED, "COMMAND"): State.ACTIVE,
    (State.ARMED, "DISARM"): State.IDLE,
    (State.ARMED, "TIMEOUT"): State.IDLE,
    (State.ARMED, "ESTOP"): State.ESTOP,
    (State.ARMED, "FAULT"): State.FAULT,
    (State.ACTIVE, "DISARM"): State.STOPPING,
    (State.ACTIVE, "TIMEOUT"): State.STOPPING,
    (State.ACTIVE, "ESTOP"): State.ESTOP,
    (State.ACTIVE, "FAULT"): State.FAULT,
    (State.STOPPING, "STOPPED"): State.IDLE,
    (State.STOPPING, "ESTOP"): State.ESTOP,
    (State.STOPPING, "FAULT"): State.FAULT,
    (State.FAULT, "ESTOP"): State.ESTOP,
    (State.FAULT, "CLEAR"): State.IDLE,
    (State.ESTOP, "CLEAR"): State.IDLE,
}
"""What PROTOCOL.md says of each state; where it says nothing, an event does nothing."""


@pytest.mark.proves(
    "R-STATE-1",
    "R-STATE-2",
    "R-STATE-3",
    "R-STATE-4",
    "R-STATE-5",
    "R-STATE-6",
    "R-STATE-7",
    "R-STATE-8",
    "R-STATE-9",
    "R-STATE-11",
)
@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("state", State)
def test_the_table_says_what_the_document_says(state: State, event: str) -> None:
    _, lib = core()
    number = getattr(lib, f"WHEEL_EVENT_{event}")
    assert lib.wheel_next_state(state, number) == ALLOWED.get((state, event), state)


@pytest.mark.proves("R-STATE-11")
def test_the_table_has_no_row_that_is_not_tested() -> None:
    ffi, lib = core()
    assert ffi.sizeof(lib.wheel_transitions) == len(ALLOWED) * ffi.sizeof("wheel_transition")
    rows = {(getattr(row, "from"), row.event): row.to for row in lib.wheel_transitions}
    assert rows == {(s, getattr(lib, f"WHEEL_EVENT_{e}")): to for (s, e), to in ALLOWED.items()}


@pytest.mark.proves("R-STATE-11", "R-ARM-2")
@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("state", State)
def test_an_event_that_the_table_does_not_know_changes_not_one_byte_of_the_robot(state: State, event: str) -> None:
    """All states by all events, the ones too that no host and no plant can bring about."""
    node = BareNode()
    node.activate()
    node.send(m.WheelCommand(5, 5, 5, 5, 1, 1))
    node.tick(30)
    node.node.state = state
    node.node.announced_nonce, node.node.braking = 0x51, True
    before = bytes(node.ffi.buffer(node.node))
    to = ALLOWED.get((state, event), state)
    node.lib.wheel_node_stop(node.node, getattr(node.lib, f"WHEEL_EVENT_{event}"), m.StopReason.HOST_REQUEST)
    assert node.state is to
    if to is state:
        assert bytes(node.ffi.buffer(node.node)) == before
    else:
        assert (node.node.state_ticks, node.node.announced_nonce) == (0, 0)
        assert node.node.braking == (to is State.ESTOP and state in (State.ACTIVE, State.STOPPING))


@pytest.mark.parametrize("state", [7, 8, 127, 128, 255])
def test_a_state_that_is_none_is_left_by_no_event_and_drives_nothing(state: int) -> None:
    """A bit of memory that turned over."""
    node = BareNode()
    node.activate()
    node.node.state = state
    for event in EVENTS:
        assert node.lib.wheel_next_state(state, getattr(node.lib, f"WHEEL_EVENT_{event}")) == state
    node.send(m.WheelCommand(5, 5, 5, 5, 1, 1))
    node.heard()
    for _ in range(100):
        node.tick()
        assert (node.drive.enabled, list(node.drive.torque_n_m)) == (0, [0.0] * 4)
        assert not [x for x in node.heard() if isinstance(x, m.Tick | m.Status)], "which cannot be said"


def spin_up(rig: WheelRig) -> None:
    rig.activate()
    rig.drive(10.0, 300)


def into_estop(rig: WheelRig) -> None:
    spin_up(rig)
    rig.send(m.Estop(1, 2))


def into_stopping(rig: WheelRig) -> None:
    spin_up(rig)
    rig.run(60)


def into_fault(rig: WheelRig) -> None:
    spin_up(rig)
    rig.temperature_degc[0] = 130.0
    rig.run(1)
    rig.temperature_degc[0] = 25.0
    rig.run(1)


INTO: dict[State, Callable[[WheelRig], None]] = {
    State.IDLE: lambda rig: None,
    State.ARMED: lambda rig: rig.arm(),
    State.ACTIVE: spin_up,
    State.STOPPING: into_stopping,
    State.FAULT: into_fault,
    State.ESTOP: into_estop,
}


def clear(rig: WheelRig) -> None:
    if rig.state is State.ESTOP:
        rig.run(1000)  # while it brakes it does not hear
    rig.heartbeat(m.Request.CLEAR, 0x99)


def overheat(rig: WheelRig) -> None:
    rig.temperature_degc[3] = 130.0
    rig.run(1)


def stand_still(rig: WheelRig) -> None:
    rig.speed_rad_s = [0.0] * 4
    rig.held = [True] * 4
    rig.run(300)


def fresh_zero(rig: WheelRig) -> None:
    last = [x for x in rig.heard() if isinstance(x, m.Tick)][-1].sequence
    rig.command(0.0, last + 1)


DO: dict[str, Callable[[WheelRig], None]] = {
    "ARM": lambda rig: rig.heartbeat(m.Request.ARM, 0x4321),
    "COMMAND": fresh_zero,
    "DISARM": lambda rig: rig.heartbeat(m.Request.IDLE, 0x4321),
    "TIMEOUT": lambda rig: rig.run(51 if rig.state is State.ACTIVE else 1001 if rig.state is State.ARMED else 30),
    "STOPPED": stand_still,
    "ESTOP": lambda rig: rig.send(m.Estop(0, 0)),
    "FAULT": overheat,
    "CLEAR": clear,
}


@pytest.mark.proves(
    "R-STATE-2", "R-STATE-3", "R-STATE-4", "R-STATE-5", "R-STATE-6", "R-STATE-7", "R-STATE-8", "R-STATE-9", "R-SES-4"
)
@pytest.mark.parametrize("event", DO)
@pytest.mark.parametrize("state", INTO)
def test_each_event_in_each_state_from_outside(state: State, event: str) -> None:
    """Every event from host or plant, in every state it can meet; ARM is announced only where it is allowed."""
    rig = WheelRig()
    INTO[state](rig)
    rig.run(1)
    assert rig.state is state
    if (state, event) == (State.IDLE, "ARM"):
        DO["DISARM"](rig)
    if (state, event) == (State.ACTIVE, "STOPPED"):
        rig.speed_rad_s, rig.held = [0.0] * 4, [True] * 4
        rig.drive(0.0, 300, 61)
    else:
        DO[event](rig)
    assert rig.state is ALLOWED.get((state, event), state)


@pytest.mark.proves("R-STATE-2", "R-STATE-3", "R-STATE-4", "R-STATE-5", "R-STATE-6", "R-STATE-7")
@pytest.mark.parametrize(("state", "drives"), [(s, s in (State.ACTIVE, State.STOPPING, State.ESTOP)) for s in INTO])
def test_the_drives_are_on_in_the_states_that_drive_only(state: State, drives: bool) -> None:
    rig = WheelRig()
    INTO[state](rig)
    rig.speed_rad_s = [5.0] * 4
    rig.run(2)
    assert rig.state is state
    assert rig.enabled == drives
    assert any(rig.torque_n_m) == any(rig.duty) == drives


@pytest.mark.proves("R-STAT-2")
@pytest.mark.parametrize("state", INTO)
def test_each_change_of_state_is_told_at_once(state: State) -> None:
    rig = WheelRig()
    INTO[state](rig)
    rig.run(3)
    rig.heard()
    before = rig.state
    rig.send(m.Estop(0, 0))
    told = [x.state for x in rig.heard() if isinstance(x, m.Status)]
    assert told == ([] if before is State.ESTOP else [State.ESTOP])


REASONS = {
    State.ARMED: {"TIMEOUT": m.StopReason.ARM_TIMEOUT, "DISARM": m.StopReason.HOST_REQUEST},
    State.ACTIVE: {
        "TIMEOUT": m.StopReason.COMMAND_TIMEOUT,
        "DISARM": m.StopReason.HOST_REQUEST,
        "ESTOP": m.StopReason.ESTOP,
        "FAULT": m.StopReason.FAULT,
    },
}


@pytest.mark.proves("R-STAT-1", "R-WD-2")
@pytest.mark.parametrize(("state", "event"), [(s, e) for s, events in REASONS.items() for e in events])
def test_the_reason_of_a_stop_is_kept_until_the_next_session(state: State, event: str) -> None:
    rig = WheelRig()
    INTO[state](rig)
    DO[event](rig)
    assert rig.node.look().stop_reason is REASONS[state][event]
    DO["DISARM"](rig)  # where it does nothing
    rig.temperature_degc = [25.0] * 4
    rig.run(1500)
    assert rig.node.look().stop_reason is REASONS[state][event]
    rig.heartbeat(m.Request.CLEAR, 0x98)
    rig.arm()
    assert (rig.state, rig.node.look().stop_reason) == (State.ARMED, m.StopReason.NONE)


@pytest.mark.proves("R-FAULT-3", "R-STATE-1", "R-STATE-6")
@pytest.mark.parametrize("value", [1e9, 0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["counts_per_revolution", "tracking_bandwidth_rad_s", "watchdog_s", "ramp_s"])
def test_a_robot_of_a_wrong_build_boots_into_a_fault_that_nothing_clears(name: str, value: float) -> None:
    good = BareNode(changes={"torque_limit_n_m": 1.0})
    stored = good.ffi.new("uint8_t[]", 96)
    (minimum,) = (pytest.approx(row.minimum) for row in parameters() if row.name == name)
    good.lib.wheel_parameters_store(good.ffi.addressof(good.node, "parameters"), 0, stored)
    for node in (BareNode(changes={name: value}), BareNode(changes={name: value}, stored=bytes(stored))):
        assert (node.state, node.node.fault) == (State.FAULT, m.Fault.PARAMETERS)
        assert getattr(node.node.built_in, name) == minimum, "a number that all may compute with"
        for nonce in range(1, 5):
            node.heartbeat(m.Request.CLEAR, nonce)
            node.send(m.ParameterRequest(0, m.Operation.RESTORE, 0, 0))
            node.heartbeat(m.Request.IDLE, 0x1000 + nonce)
            node.heartbeat(m.Request.ARM, 0x1000 + nonce)
            node.tick()
            assert (node.state, node.drive.enabled) == (State.FAULT, 0)
        node.send(m.Estop(0, 0))
        node.heartbeat(m.Request.CLEAR, 0x77)
        assert node.state is State.ESTOP, "a way round the fault"


@pytest.mark.proves("R-REF-7", "R-HELLO-5")
def test_a_mode_that_the_robot_cannot_do_is_refused() -> None:
    for mode, capability in ((m.Mode.SPEED, Capability.SPEED), (m.Mode.TORQUE, Capability.TORQUE)):
        for has in (True, False):
            node = BareNode(capabilities=capability if has else ALL & ~capability)
            node.heartbeat(m.Request.IDLE, 0x55, mode)
            node.heartbeat(m.Request.ARM, 0x55, mode)
            refusal = m.ArmRefusal.NONE if has else m.ArmRefusal.MODE
            assert (node.state, node.node.arm_refusal) == (State.ARMED if has else State.IDLE, refusal)


def test_time_in_a_state_and_since_a_command_does_not_wrap() -> None:
    """After 49 days in ESTOP the drives must not come on again."""
    node = BareNode()
    node.activate()
    node.send(m.Estop(0, 0))
    node.node.state_ticks = node.node.setting.age_ticks = 0xFFFF_FFFE
    node.tick(5)
    assert (node.node.state_ticks, node.node.setting.age_ticks) == (0xFFFF_FFFF, 0xFFFF_FFFF)


@pytest.mark.proves("R-WD-2", "R-RAMP-1", "R-RAMP-4")
def test_the_watchdog_and_the_ramp_take_exactly_their_time() -> None:
    for watchdog_s, ramp_s in ((0.02, 0.001), (0.05, 0.2), (0.1, 2.0)):
        rig = WheelRig(watchdog_s=watchdog_s, ramp_s=ramp_s)
        rig.activate()
        sequence = rig.drive(10.0, 500)
        rig.command(10.0, sequence)
        watchdog, ramp = round(watchdog_s * 1000), round(ramp_s * 1000)
        rig.run(watchdog - 1)
        assert rig.state is State.ACTIVE
        rig.run(1)
        assert rig.state is State.STOPPING
        set_points = []
        for _ in range(ramp):
            rig.run(1)
            set_points.append(rig.node.look().set_point_rad_s[0])
        begins_at = set_points[0] * ramp / (ramp - 1) if ramp > 1 else 0.0
        assert set_points == pytest.approx([begins_at * (1 - n / ramp) for n in range(1, ramp + 1)], abs=1e-4)
        assert set_points[-1] == 0.0


@pytest.mark.proves("R-RAMP-1")
@pytest.mark.parametrize("speed_rad_s", [10.0, -10.0])
def test_a_stop_begins_at_the_speed_when_that_is_nearer_to_zero(speed_rad_s: float) -> None:
    """The wheels have just begun to follow a far set point: no jump towards it."""
    rig = WheelRig()
    rig.activate()
    rig.drive(4 * speed_rad_s, 50)
    rig.heartbeat(m.Request.IDLE, 0x99)
    before = rig.node.look()
    assert before.state is State.STOPPING
    rig.run(1)
    after = rig.node.look().set_point_rad_s
    assert 0.0 < after[0] / speed_rad_s < 1.2


@pytest.mark.proves("R-RAMP-1")
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stop_of_wheels_that_still_turn_the_other_way_begins_at_zero(sign: float) -> None:
    rig = WheelRig()
    rig.activate()
    sequence = rig.drive(sign * 20.0, 500)
    rig.drive(sign * -20.0, 5, sequence)
    rig.heartbeat(m.Request.IDLE, 0x99)
    rig.run(1)
    assert rig.node.look().set_point_rad_s == (0.0,) * 4


@pytest.mark.proves("R-STATE-5")
def test_a_robot_that_rests_only_for_a_moment_is_not_stopped() -> None:
    """Fifty ticks at rest; a passing through zero is none."""
    rig = WheelRig(ramp_s=0.001)
    spin_up(rig)
    rig.run(51)
    rig.held = [True] * 4
    for _ in range(12):
        rig.speed_rad_s = [0.0] * 4
        rig.run(40)
        rig.speed_rad_s = [0.0, 2.0, 0.0, 0.0]
        rig.run(40)
        assert rig.state is State.STOPPING
    rig.speed_rad_s = [0.0] * 4
    rig.run(100)
    assert rig.state is State.IDLE


@pytest.mark.proves("R-STATE-7")
def test_a_robot_at_rest_ends_an_estop_at_once() -> None:
    rig = WheelRig()
    rig.activate()
    rig.drive(0.0, 100)
    rig.send(m.Estop(0, 0))
    rig.run(1)
    assert not rig.enabled
