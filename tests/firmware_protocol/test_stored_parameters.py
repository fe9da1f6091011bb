"""Parameters that are kept: over a reset, against damage, and while they are being written."""

import math
import re
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.built import HERE
from firmware_protocol.capabilities import Capability
from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import Operation, Result, State
from firmware_protocol.host import parameter_hash, stored_parameters
from tests.support.bare_node import ALL, BareNode, core
from tests.support.parameter_rig import ROWS, ask, bits, single
from tests.support.wheel_rig import PARAMETERS, WheelRig


def stored_after(changes: dict[str, float]) -> bytes:
    rig = WheelRig()
    for index, row in enumerate(ROWS):
        if row.name in changes:
            assert ask(rig, Operation.WRITE, index, bits(row, changes[row.name])).result == Result.OK
    answer = ask(rig, Operation.STORE)
    assert (answer.result, answer.value) == (Result.OK, parameter_hash(PARAMETERS | changes))
    kept = rig.node.stored()
    assert kept is not None
    return kept


@pytest.mark.proves("R-PAR-5")
@given(
    st.fixed_dictionaries(
        {}, optional={p.name: st.floats(single(p.minimum), single(p.maximum), width=32) for p in ROWS[1:]}
    )
)
def test_what_is_stored_is_in_force_after_a_reset(changes: dict[str, float]) -> None:
    kept = stored_after(changes)
    again = WheelRig(stored=kept)
    read = [ask(again, Operation.READ, i).value for i in range(len(ROWS))]
    assert read == [bits(p, (PARAMETERS | changes)[p.name]) for p in ROWS]


@pytest.mark.proves("R-PAR-5")
def test_without_a_store_a_reset_forgets() -> None:
    rig = WheelRig()
    ask(rig, Operation.WRITE, 18, bits(ROWS[18], 0.5))
    assert rig.node.stored() is None


@pytest.mark.proves("R-PAR-6", "R-PAR-9")
def test_restore_goes_back_to_the_build_also_after_a_reset() -> None:
    rig = WheelRig(stored=stored_after({"ramp_s": 0.5, "watchdog_s": 0.1}))
    answer = ask(rig, Operation.RESTORE)
    assert (answer.result, answer.value) == (Result.OK, parameter_hash(PARAMETERS))
    assert [ask(rig, Operation.READ, i).value for i in range(len(ROWS))] == [bits(p, PARAMETERS[p.name]) for p in ROWS]


KEPT = stored_after({"ramp_s": 0.5})


def ramp_with(stored: bytes) -> float:
    rig = WheelRig(stored=stored)
    assert rig.state is State.IDLE
    (raw,) = [ask(rig, Operation.READ, i).value for i, p in enumerate(ROWS) if p.name == "ramp_s"]
    return float(struct.unpack("<f", struct.pack("<I", raw))[0])


def sealed(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


@pytest.mark.proves("R-PAR-13")
def test_what_is_stored_begins_with_its_layout_table_board_and_number_and_ends_with_a_crc_32() -> None:
    values = struct.pack(f"<{len(ROWS)}f", *((PARAMETERS | {"ramp_s": 0.5})[row.name] for row in ROWS))
    table = re.search(r"TABLE_HASH (0x\w+)u", (HERE / "generated" / "wheel_parameters.h").read_text(encoding="utf-8"))
    assert table is not None
    for board in (0, 0x1234):
        header = struct.pack("<4sIHH", b"WHP2", int(table[1], 16), board, len(ROWS))
        assert stored_parameters(PARAMETERS | {"ramp_s": 0.5}, board) == sealed(header + values)


@pytest.mark.proves("R-PAR-13")
def test_any_one_wrong_bit_of_what_was_stored_is_noticed() -> None:
    assert ramp_with(KEPT) == 0.5
    assert sealed(KEPT[:-4]) == KEPT, "the checksum is the usual CRC-32"
    whole = int.from_bytes(KEPT, "little")
    for bit in range(8 * len(KEPT)):
        damaged = (whole ^ 1 << bit).to_bytes(len(KEPT), "little")
        assert ramp_with(damaged) == single(PARAMETERS["ramp_s"]), bit


@pytest.mark.proves("R-PAR-13")
@given(cut=st.integers(0, len(KEPT) - 1), fill=st.sampled_from([b"\0", b"\xff"]))
def test_a_power_cut_while_storing_leaves_the_build_in_force(cut: int, fill: bytes) -> None:
    """The port wrote the first bytes, and the rest is as the flash was erased."""
    assert ramp_with(KEPT[:cut] + fill * (len(KEPT) - cut)) == single(PARAMETERS["ramp_s"])


@pytest.mark.proves("R-PAR-13")
@pytest.mark.parametrize(
    "foreign",
    [
        sealed(b"WHP1" + KEPT[4:-4]),
        sealed(KEPT[:4] + struct.pack("<I", 19) + KEPT[8:-4]),
        stored_parameters(PARAMETERS | {"ramp_s": 0.5}, 3),
        sealed(KEPT[:-8] + struct.pack("<f", 5.0)),
        sealed(KEPT[:12] + struct.pack("<f", math.nan) + KEPT[16:-4]),
    ],
    ids=["another layout", "another table", "another board", "out of range", "no number"],
)
def test_what_another_firmware_stored_is_ignored_as_a_whole(foreign: bytes) -> None:
    ffi, lib = core()
    block = ffi.new("wheel_parameters *")
    assert not lib.wheel_parameters_load(block, ffi.NULL, 0, foreign)
    assert bytes(ffi.buffer(block)) == bytes(ffi.sizeof(block[0]))
    assert lib.wheel_parameters_load(block, ffi.NULL, 0, KEPT)
    assert ramp_with(foreign) == single(PARAMETERS["ramp_s"])


@pytest.mark.proves("R-PAR-12")
def test_a_robot_without_storage_says_so() -> None:
    node = BareNode(capabilities=ALL & ~Capability.STORAGE)
    refused = ask(node, Operation.STORE)
    assert (refused.result, refused.value) == (Result.STORAGE, parameter_hash(PARAMETERS))
    assert ask(node, Operation.RESTORE).result == Result.OK


@pytest.mark.proves("R-PAR-3", "R-PAR-11")
@pytest.mark.parametrize("kept", [True, False])
def test_a_store_is_answered_when_the_port_is_done_and_bars_changes_until_then(kept: bool) -> None:
    node = BareNode()
    block = node.ffi.new("uint8_t[]", len(KEPT))
    assert not node.lib.wheel_node_store_pending(node.node, block)
    node.lib.wheel_node_stored(node.node, True)  # nobody asked
    node.heard()
    node.send(m.ParameterRequest(0, Operation.STORE, 9, 0))
    assert node.heard() == []
    assert node.lib.wheel_node_store_pending(node.node, block)
    assert bytes(block) == sealed(bytes(block)[:-4])
    for operation in (Operation.WRITE, Operation.STORE, Operation.RESTORE):
        assert ask(node, operation, 0, 4096).result == Result.STATE
    assert ask(node, Operation.READ, 0).result == Result.OK
    node.lib.wheel_node_stored(node.node, kept)
    (answer,) = node.heard()
    assert isinstance(answer, m.ParameterResponse)
    assert (answer.operation, answer.transaction) == (Operation.STORE, 9)
    assert (answer.result, answer.value) == (Result.OK if kept else Result.STORAGE, parameter_hash(PARAMETERS))
    assert not node.lib.wheel_node_store_pending(node.node, block)
    assert ask(node, Operation.WRITE, 0, 2048).result == Result.OK


@pytest.mark.proves("R-REF-2")
def test_a_robot_does_not_arm_while_its_parameters_are_being_kept() -> None:
    """Writing flash may stop a processor for longer than a watchdog: the drives would hold what they had."""
    node = BareNode()
    node.send(m.ParameterRequest(0, Operation.STORE, 9, 0))
    node.heartbeat(m.Request.IDLE, 0x51)
    node.heartbeat(m.Request.ARM, 0x51)
    assert (node.state, node.node.arm_refusal) == (m.State.IDLE, m.ArmRefusal.NOT_IDLE)
    node.lib.wheel_node_stored(node.node, True)
    node.heartbeat(m.Request.ARM, 0x51)
    assert node.state is m.State.IDLE, "a refusal uses up the announcement"
    node.heartbeat(m.Request.IDLE, 0x52)
    node.heartbeat(m.Request.ARM, 0x52)
    assert node.state is m.State.ARMED
