"""ODrive: the emulated axes before other programs. The package odrive-can drives one; strange frames move nothing."""

import asyncio
import math
import struct
import threading
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, distribution
from typing import Any

import can
import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.robot.driver import REMOTE
from tests.support.dialect_testbed import Rig

try:
    DBC_FILES = distribution("odrive-can")
except PackageNotFoundError:
    pytest.skip("no DBC of the makers: pip install odrive-can", allow_module_level=True)

from odrive_can.odrive import ODriveCAN

DBC: Mapping[str, Any] = {
    firmware: cantools.database.load_file(str(DBC_FILES.locate_file(f"odrive_can/dbc/odrive-cansimple-{version}.dbc")))
    for firmware, version in (("0.5", "0.5.6"), ("0.6", "0.6.10"))
}
IDLE, CLOSED_LOOP = 1, 8


class Axis:
    """One axis of a rig, spoken to by the names of the DBC."""

    def __init__(self, firmware: str = "0.6", node: int = 0, **settings: Any) -> None:
        self.firmware, self.node = firmware, node
        self.rig = Rig("odrive", {"firmware": firmware, **settings})
        self.axis = self.rig.node.axes[node]

    def send(self, name: str, ticks: int = 1, **signals: float) -> None:
        message = DBC[self.firmware].get_message_by_name(f"Axis{self.node}_{name}")
        payload = message.encode({signal.name: 0 for signal in message.signals} | signals)
        self.rig.step([Frame(message.frame_id, payload)], ticks=ticks)

    def ask(self, name: str) -> dict[str, Any]:
        message = DBC[self.firmware].get_message_by_name(f"Axis{self.node}_{name}")
        self.rig.step([Frame(message.frame_id | REMOTE, b"")], ticks=1)
        answer = next(frame for frame in reversed(self.rig.heard) if frame.id == message.frame_id)
        assert len(answer.payload) == message.length
        told: dict[str, Any] = message.decode(answer.payload, decode_choices=False)
        return told


def test_a_parameter_is_written_and_read_back() -> None:
    endpoints = {"watchdog_endpoints": [311, 312], "endpoints_firmware": "0.6.10", "endpoints_hardware": "4.4.58"}
    axis = Axis(**endpoints)
    axis.rig.step([Frame(0x000 | REMOTE, b"")], ticks=1)
    assert [frame.payload[1:] for frame in axis.rig.heard if frame.id == 0] == [bytes((4, 4, 58, 0, 6, 10, 0))]
    axis.rig.step([Frame(0x004, struct.pack("<BHBf", 1, 311, 0, 0.25))], ticks=1)
    axis.rig.step([Frame(0x004, struct.pack("<BHB", 0, 311, 0))], ticks=1)
    assert struct.unpack("<BHBf", axis.rig.heard[-1].payload) == (0, 311, 0, 0.25)
    heard = len(axis.rig.heard)
    axis.rig.step([Frame(0x004, struct.pack("<BHB", 0, 999, 0))], ticks=1)
    assert len(axis.rig.heard) == heard, "an endpoint that is not there has no answer"


@pytest.mark.parametrize(("control_mode", "input_mode"), [(2, 2), (3, 3), (0, 1), (7, 1)])
def test_a_mode_that_is_not_there_disarms_instead_of_driving(control_mode: int, input_mode: int) -> None:
    axis = Axis()
    axis.send("Set_Controller_Mode", Control_Mode=control_mode, Input_Mode=input_mode)
    axis.send("Set_Input_Vel", Input_Vel=5.0)
    axis.send("Set_Axis_State", Axis_Requested_State=CLOSED_LOOP)
    assert axis.axis.state == IDLE
    assert axis.ask("Get_Error")["Disarm_Reason"] == 0x10  # BAD_CONFIG
    assert axis.rig.node.torque_n_m == (0.0,) * 4


class Bus:
    """A bus of python-can as far as odrive_can looks at one; each look for a message is a millisecond of the plant."""

    channel_info = "emulated"

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._lock = threading.Lock()
        self._waiting: list[Frame] = []

    def send(self, message: can.Message) -> None:
        with self._lock:
            remote = REMOTE if message.is_remote_frame else 0
            self._rig.node.receive(Frame(message.arbitration_id | remote, bytes(message.data)))

    def recv(self, _timeout: float) -> can.Message:
        with self._lock:
            while not self._waiting:  # a heartbeat comes every 100 ms
                self._rig.node.run(1)
                self._waiting += self._rig.node.take_frames()
            frame = self._waiting.pop(0)
            return can.Message(arbitration_id=frame.id, data=frame.payload, is_extended_id=False)

    def shutdown(self) -> None:
        """Nothing is open."""


def test_the_package_odrive_can_drives_an_axis() -> None:
    rig = Rig("odrive", {"firmware": "0.5"})

    async def session() -> tuple[dict[str, Any], float]:
        drive = ODriveCAN(axis_id=1, can_bus=Bus(rig))
        await drive.start()
        try:
            drive.clear_errors()
            drive.check_errors()
            drive.set_controller_mode("VELOCITY_CONTROL", "PASSTHROUGH")
            await drive.set_axis_state("CLOSED_LOOP_CONTROL")
            for _ in range(20):
                drive.set_input_vel(1.0, 0.0)
                await drive.wait_for_heartbeat()
            assert drive.axis_state == "CLOSED_LOOP_CONTROL"
            bus = await drive.get_bus_voltage_current()
            estimate: float = rig.node.shafts[1].speed_rad_s / math.tau
            return bus, estimate
        finally:
            drive.stop()

    bus, turns_a_second = asyncio.run(session())
    assert bus["Bus_Voltage"] == pytest.approx(rig.node.battery_v, abs=0.5)
    assert turns_a_second == pytest.approx(1.0, abs=0.1)
    assert rig.node.axes[1].state == IDLE, "the package sets idle when it stops"


COMMANDS = st.sampled_from((0x06, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F, 0x16, 0x18, 0x1B))


@given(st.lists(st.tuples(COMMANDS, st.integers(0, 3), st.binary(max_size=8)), max_size=8), st.booleans())
def test_no_bytes_make_a_torque_beyond_the_limit_or_drive_an_idle_axis(
    frames: list[tuple[int, int, bytes]], is_armed: bool
) -> None:
    rig = FUZZED
    for axis in rig.node.axes:
        axis.clear()
        axis.request(CLOSED_LOOP if is_armed else IDLE, rig.node.ticks)
    limit = rig.node.values["torque_limit_n_m"] * (1.0 + 1e-9)
    for command, node, payload in frames:
        rig.node.receive(Frame(node << 5 | command, payload))
        rig.node.run(1)
        assert all(abs(torque) <= limit for torque in rig.node.torque_n_m)
        assert is_armed or not rig.node.is_driving
    rig.node.take_frames()


@given(st.binary(max_size=3), st.integers(0, 3))
def test_a_state_that_is_cut_off_is_not_gone_to(payload: bytes, node: int) -> None:
    CUT.node.receive(Frame(node << 5 | 0x07, b"\x08" + payload[:2]))
    assert not CUT.node.is_driving


CUT = Rig("odrive")
FUZZED = Rig("odrive")
