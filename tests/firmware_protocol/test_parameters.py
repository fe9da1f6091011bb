"""Parameters by index: every one read and written, refused out of range or out of IDLE."""

import math
import struct

import pytest

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import Operation, Result, State, Type
from firmware_protocol.host import parameter_hash, stored_parameters
from tests.support.bare_node import BareNode
from tests.support.parameter_rig import ROWS, ask, bits, single
from tests.support.wheel_rig import PARAMETERS, WheelRig

each = pytest.mark.parametrize("index", range(len(ROWS)), ids=[p.name for p in ROWS])


def next_single(value: float, towards: float) -> float:
    """The neighbour of a binary32 number."""
    if value == 0.0:
        return math.copysign(2.0**-149, towards)
    (raw,) = struct.unpack("<i", struct.pack("<f", value))
    raw += 1 if (towards > value) == (value > 0.0) else -1
    return float(struct.unpack("<f", struct.pack("<i", raw))[0])


@pytest.mark.proves("R-PAR-1", "R-PAR-2")
@each
def test_every_parameter_is_read_with_its_type_and_range(index: int) -> None:
    row, rig = ROWS[index], WheelRig()
    for operation, value in (
        (Operation.READ, PARAMETERS[row.name]),
        (Operation.READ_MINIMUM, row.minimum),
        (Operation.READ_MAXIMUM, row.maximum),
    ):
        answer = ask(rig, operation, index)
        assert (answer.result, answer.type, answer.value) == (Result.OK, row.type, bits(row, value))


@pytest.mark.proves("R-PAR-2", "R-PAR-4", "R-PAR-9")
@each
def test_every_parameter_takes_its_range_and_nothing_else(index: int) -> None:
    row, rig = ROWS[index], WheelRig()
    for good in (row.minimum, row.maximum):
        answer = ask(rig, Operation.WRITE, index, bits(row, good))
        assert (answer.result, answer.value) == (Result.OK, bits(row, good))
        assert ask(rig, Operation.READ, index).value == bits(row, good)
    if row.type is Type.UINT32:
        bad = [int(row.minimum) - 1, int(row.maximum) + 1, 0x0100_0001, 0xFFFF_FFFF]
    else:
        outside = [next_single(row.minimum, -math.inf), next_single(row.maximum, math.inf)]
        bad = [bits(row, v) for v in (*outside, math.nan, -math.nan, math.inf, -math.inf)] + [0xFFFF_FFFF]
    for value in bad:
        answer = ask(rig, Operation.WRITE, index, value)
        assert (answer.result, answer.value) == (Result.RANGE, bits(row, row.maximum)), hex(value)
    assert ask(rig, Operation.READ, index).value == bits(row, row.maximum)


@pytest.mark.proves("R-PAR-5", "R-HASH-3")
@each
def test_a_write_changes_that_parameter_and_the_hash_only(index: int) -> None:
    row, rig = ROWS[index], WheelRig()
    value = row.minimum if PARAMETERS[row.name] != row.minimum else row.maximum
    ask(rig, Operation.WRITE, index, bits(row, value))
    changed = PARAMETERS | {row.name: value}
    read = [ask(rig, Operation.READ, i).value for i in range(len(ROWS))]
    assert read == [bits(p, changed[p.name]) for p in ROWS]
    rig.send(m.HelloRequest(1))
    (told,) = [x for x in rig.heard() if isinstance(x, m.HelloParameters)]
    assert told.parameter_hash == parameter_hash(changed) != parameter_hash(PARAMETERS)


@pytest.mark.proves("R-PAR-10")
@pytest.mark.parametrize("index", [len(ROWS), 100, 255])
@pytest.mark.parametrize("operation", [Operation.READ, Operation.READ_MINIMUM, Operation.READ_MAXIMUM, Operation.WRITE])
def test_a_parameter_that_does_not_exist_is_refused(index: int, operation: Operation) -> None:
    answer = ask(WheelRig(), operation, index, 1)
    assert (answer.result, answer.value, answer.type) == (Result.PARAMETER, 0, Type.FLOAT32)


@pytest.mark.proves("R-CNT-7")
def test_an_operation_that_does_not_exist_is_counted_as_out_of_range() -> None:
    rig = WheelRig()
    good = bytearray(m.ParameterRequest(0, Operation.RESTORE, 0, 0).encode())
    good[1] = 6
    rig.heard()
    rig.node.receive(Frame(m.ParameterRequest.ID, bytes(good)))
    assert rig.heard() == []
    assert rig.node.look().rejected["range"] == 1


def armed(rig: WheelRig) -> None:
    rig.arm()


def stopping(rig: WheelRig) -> None:
    rig.activate()
    rig.drive(10.0, 200)
    rig.run(60)


def faulty(rig: WheelRig) -> None:
    rig.temperature_degc[0] = 130.0
    rig.run(1)


BUSY = {
    State.ARMED: armed,
    State.ACTIVE: lambda rig: rig.activate(),
    State.STOPPING: stopping,
    State.FAULT: faulty,
    State.ESTOP: lambda rig: rig.send(m.Estop(0, 0)),
}


@pytest.mark.proves("R-PAR-3", "R-PAR-9")
@pytest.mark.parametrize("state", BUSY)
def test_parameters_are_read_in_every_state_and_change_in_idle_only(state: State) -> None:
    rig = WheelRig()
    BUSY[state](rig)
    assert rig.state is state
    for index, row in enumerate(ROWS):
        value = bits(row, PARAMETERS[row.name])
        answer = ask(rig, Operation.WRITE, index, bits(row, row.minimum))
        assert (answer.result, answer.value) == (Result.STATE, value)
        assert ask(rig, Operation.READ, index)[3:] == (Result.OK, row.type, value)
    for operation in (Operation.STORE, Operation.RESTORE):
        refused = ask(rig, operation)
        assert (refused.result, refused.value) == (Result.STATE, parameter_hash(PARAMETERS))
    assert rig.node.stored() is None


@pytest.mark.proves("R-REF-6")
def test_a_host_with_the_old_parameters_does_not_arm() -> None:
    """One in 256 changes has the same check; this is not one of them."""
    rig = WheelRig()
    index = [p.name for p in ROWS].index("ramp_s")
    ask(rig, Operation.WRITE, index, bits(ROWS[index], 0.5))
    changed = PARAMETERS | {"ramp_s": 0.5}
    assert parameter_hash(changed) & 0xFF != parameter_hash(PARAMETERS) & 0xFF
    rig.arm()
    assert rig.state is State.IDLE
    assert [x for x in rig.heard() if isinstance(x, m.Status)][-1].arm_refusal == m.ArmRefusal.PARAMETERS
    rig.values = changed
    rig.arm()
    assert rig.state is State.ARMED


@pytest.mark.proves("R-PAR-5")
def test_a_change_takes_effect() -> None:
    rig = WheelRig()
    index = [p.name for p in ROWS].index("watchdog_s")
    ask(rig, Operation.WRITE, index, bits(ROWS[index], 0.02))
    rig.values = PARAMETERS | {"watchdog_s": 0.02}
    rig.activate()
    rig.run(19)
    assert rig.state is State.ACTIVE
    rig.run(1)
    assert rig.state is State.STOPPING


@pytest.mark.proves("R-PAR-7")
def test_a_board_ends_a_range_where_its_hardware_does() -> None:
    ffi = BareNode().ffi
    maximum = ffi.new("wheel_parameters *", {p.name: p.maximum for p in ROWS} | {"ramp_s": 0.4})
    (index,) = [i for i, p in enumerate(ROWS) if p.name == "ramp_s"]
    node = BareNode(maximum=maximum)
    assert ask(node, Operation.READ_MAXIMUM, index).value == bits(ROWS[index], 0.4)
    assert ask(node, Operation.READ_MINIMUM, index).value == bits(ROWS[index], ROWS[index].minimum), "no board's"
    assert ask(node, Operation.WRITE, index, bits(ROWS[index], 0.5)).result == Result.RANGE
    assert ask(node, Operation.WRITE, index, bits(ROWS[index], 0.4)).result == Result.OK
    assert single(node.node.parameters.ramp_s) == single(0.4)
    kept = BareNode(stored=stored_parameters(PARAMETERS | {"ramp_s": 0.5}, 0), maximum=maximum)
    assert single(kept.node.parameters.ramp_s) == single(PARAMETERS["ramp_s"])
    wrong = BareNode(changes={"ramp_s": 0.5}, maximum=maximum)
    assert (wrong.state, wrong.node.fault) == (State.FAULT, m.Fault.PARAMETERS)
