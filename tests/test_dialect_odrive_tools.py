"""ODrive: what the makers' CAN scripts and the package odrive-can send, and what the emulated axes answer.

The frames are those that can_enumerate.py and can_restore_config.py of ODriveResources make, coded by the makers' DBC
files; ``odrive_can`` itself drives an axis.
"""

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
from hil.drivers.port import REMOTE
from tests.dialect_testbed import Rig

try:
    DBC_FILES = distribution("odrive-can")
except PackageNotFoundError:
    pytest.skip("no DBC of the makers: pip install odrive-can", allow_module_level=True)

from odrive_can.odrive import ODriveCAN

DBC: Mapping[str, Any] = {
    firmware: cantools.database.load_file(str(DBC_FILES.locate_file(f"odrive_can/dbc/odrive-cansimple-{version}.dbc")))
    for firmware, version in (("0.5", "0.5.6"), ("0.6", "0.6.10"))
}
ALL, ADDRESS, REBOOT, CLEAR = 0x3F, 0x06, 0x16, 0x18
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

    def arm(self, control_mode: int, input_mode: int = 1) -> None:
        self.send("Set_Controller_Mode", Control_Mode=control_mode, Input_Mode=input_mode)
        self.send("Set_Axis_State", Axis_Requested_State=CLOSED_LOOP)
        assert self.axis.state == CLOSED_LOOP


@pytest.fixture
def rig() -> Rig:
    return Rig("odrive")


def addresses(rig: Rig) -> dict[int, int]:
    """Ask all for their addresses, as can_enumerate.py does; return the node id by serial number."""
    rig.heard.clear()
    rig.step([Frame(ALL << 5 | ADDRESS | REMOTE, b"")], ticks=1)
    frames = [frame for frame in rig.heard if frame.id & 0x1F == ADDRESS]
    message = DBC["0.6"].get_message_by_name("Axis0_Address")
    told = [message.decode(frame.payload) for frame in frames]
    assert all(frame.id >> 5 == one["Node_ID"] for frame, one in zip(frames, told, strict=True))
    return {one["Serial_Number"]: one["Node_ID"] for one in told}


def assign(serial: int, node: int) -> Frame:
    """Return can_enumerate.py's frame, which leaves the connection out."""
    return Frame(ALL << 5 | ADDRESS, bytes((node,)) + serial.to_bytes(6, "little"))


def test_all_are_found_and_given_addresses_by_their_serial_numbers(rig: Rig) -> None:
    found = addresses(rig)
    assert sorted(found.values()) == [0, 1, 2, 3]
    first, second, *_ = found
    rig.step([assign(first, found[second])])
    assert addresses(rig) == found | {first: found[second], second: ALL}, "who had the id has none now"
    rig.heard.clear()
    rig.step(ticks=200)
    assert {frame.id >> 5 for frame in rig.heard} == {1, 2, 3}, "without an address nothing is sent"
    rig.step([assign(second, 40)])
    assert addresses(rig)[second] == 40
    rig.step([Frame(40 << 5 | CLEAR, b"\x01")])
    assert [axis.is_identified for axis in rig.node.axes] == [False, True, False, False]


@pytest.mark.parametrize(("action", "kept"), [(0, False), (1, True)])
def test_an_address_outlasts_a_reboot_when_it_was_saved(rig: Rig, action: int, kept: bool) -> None:
    serial, node = next(iter(addresses(rig).items()))
    rig.step([assign(serial, 40)])
    rig.step([Frame(40 << 5 | REBOOT, bytes((action,)))])
    if action:
        rig.step(ticks=600)
        rig.step([Frame(40 << 5 | REBOOT, b"\x00")])
    assert serial not in addresses(rig), "nobody answers while it starts"
    rig.step(ticks=600)
    assert addresses(rig)[serial] == (40 if kept else node)


def test_who_was_erased_has_no_address_until_it_is_given_one(rig: Rig) -> None:
    rig.step([Frame(ALL << 5 | REBOOT, b"\x02")], ticks=600)
    found = addresses(rig)
    assert set(found.values()) == {ALL}
    rig.step([assign(serial, node) for node, serial in enumerate(found)])
    assert sorted(addresses(rig).values()) == [0, 1, 2, 3]
    rig.greet()


def test_a_reboot_disarms_and_ends_errors_and_a_save_waits_for_idle() -> None:
    axis = Axis()
    axis.arm(2)
    axis.send("Reboot", Action=1)
    assert axis.axis.state == CLOSED_LOOP, "nothing is saved while the motor is driven"
    axis.send("Reboot", Action=0)
    assert axis.axis.state == IDLE
    assert not axis.rig.node.is_driving
    axis.rig.step(ticks=600)
    axis.send("Estop")
    assert axis.axis.has_errors
    axis.send("Reboot", Action=0)
    axis.rig.step(ticks=600)
    assert not axis.axis.has_errors


def test_a_parameter_is_written_and_verified_as_can_restore_config_does() -> None:
    endpoints = {"watchdog_endpoints": [311, 312], "endpoints_firmware": "0.6.10", "endpoints_hardware": "4.4.58"}
    axis = Axis(**endpoints)
    axis.rig.step([Frame(0x000, b"")], ticks=1)
    assert [frame.payload[1:] for frame in axis.rig.heard if frame.id == 0] == [bytes((4, 4, 58, 0, 6, 10, 0))]
    axis.rig.step([Frame(0x004, struct.pack("<BHBf", 1, 311, 0, 0.25))], ticks=1)
    axis.rig.step([Frame(0x004, struct.pack("<BHB", 0, 311, 0))], ticks=1)
    assert struct.unpack("<BHBf", axis.rig.heard[-1].payload) == (0, 311, 0, 0.25)
    heard = len(axis.rig.heard)
    axis.rig.step([Frame(0x004, struct.pack("<BHB", 0, 999, 0))], ticks=1)
    assert len(axis.rig.heard) == heard, "an endpoint that is not there has no answer"


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_a_speed_is_kept_below_the_limit_and_one_beyond_it_is_an_error(firmware: str) -> None:
    axis = Axis(firmware, gear_ratio=2.0)
    axis.send("Set_Limits", Velocity_Limit=1.0, Current_Limit=40.0)
    axis.arm(2)
    for step in range(200):
        axis.send("Set_Input_Vel", ticks=5, Input_Vel=step / 40.0)
    assert axis.ask("Get_Encoder_Estimates")["Vel_Estimate"] == pytest.approx(1.0, abs=0.05)
    axis.send("Set_Limits", Velocity_Limit=0.5, Current_Limit=40.0)
    axis.rig.step(ticks=5)
    assert axis.axis.state == IDLE
    if firmware == "0.6":
        assert axis.ask("Get_Error")["Disarm_Reason"] == 0x8000  # VELOCITY_LIMIT_VIOLATION
    else:
        assert axis.ask("Get_Controller_Error")["Controller_Error"] == 1  # OVERSPEED


@pytest.mark.parametrize("control_mode", [1, 2, 3])
def test_a_current_limit_cuts_the_torque_of_every_control_mode(control_mode: int) -> None:
    axis = Axis(gear_ratio=2.0)
    axis.send("Set_Limits", Velocity_Limit=50.0, Current_Limit=0.5)
    axis.arm(control_mode)
    axis.send("Set_Input_Pos", Input_Pos=100.0)
    axis.send("Set_Input_Vel", Input_Vel=40.0)
    axis.send("Set_Input_Torque", Input_Torque=100.0)
    axis.rig.step(ticks=20)
    most = 0.5 * axis.rig.node.values["torque_constant_n_m_a"]
    assert axis.rig.node.torque_n_m[0] == pytest.approx(most)
    told = axis.ask("Get_Torques")
    assert told["Torque_Target"] == pytest.approx(most / 2.0)
    assert told["Torque_Estimate"] == pytest.approx(most / 2.0, rel=0.3)
    assert axis.ask("Get_Powers")["Mechanical_Power"] > 0.0


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_a_trapezoidal_trajectory_takes_its_time_and_says_when_it_is_done(firmware: str) -> None:
    axis = Axis(firmware)
    axis.send("Set_Traj_Vel_Limit", Traj_Vel_Limit=1.0)
    axis.send("Set_Traj_Accel_Limits", Traj_Accel_Limit=2.0, Traj_Decel_Limit=2.0)
    axis.arm(3, input_mode=5)
    begin = axis.ask("Get_Encoder_Estimates")["Pos_Estimate"]
    axis.send("Set_Input_Pos", Input_Pos=begin + 1.0)
    times = []
    for _ in range(40):
        axis.rig.step(ticks=50)
        beat = next(frame for frame in reversed(axis.rig.heard) if frame.id == 0x001)
        is_done = beat.payload[7] >> 7 if firmware == "0.5" else beat.payload[6]
        times.append(bool(is_done))
    seconds = times.index(True, times.index(False)) * 0.05
    assert seconds == pytest.approx(1.0 / 1.0 + 1.0 / 2.0, abs=0.2)
    assert axis.ask("Get_Encoder_Estimates")["Pos_Estimate"] == pytest.approx(begin + 1.0, abs=0.05)


@pytest.mark.parametrize(("control_mode", "input_mode"), [(2, 2), (3, 3), (0, 1), (7, 1)])
def test_a_mode_that_is_not_there_disarms_instead_of_driving(control_mode: int, input_mode: int) -> None:
    axis = Axis()
    axis.send("Set_Controller_Mode", Control_Mode=control_mode, Input_Mode=input_mode)
    axis.send("Set_Input_Vel", Input_Vel=5.0)
    axis.send("Set_Axis_State", Axis_Requested_State=CLOSED_LOOP)
    assert axis.axis.state == IDLE
    assert axis.ask("Get_Error")["Disarm_Reason"] == 0x10  # BAD_CONFIG
    assert axis.rig.node.torque_n_m == (0.0,) * 4


def test_what_is_only_in_the_older_firmware() -> None:
    axis = Axis("0.5")
    axis.send("Set_Linear_Count", Position=4096)
    assert axis.ask("Get_Encoder_Count") == {"Shadow_Count": 4096, "Count_in_CPR": 4096}
    assert axis.ask("Get_Encoder_Estimates")["Pos_Estimate"] == pytest.approx(0.5)
    assert set(axis.ask("Get_Sensorless_Estimates").values()) == {0.0}
    axis.send("Set_Axis_Node_ID", Axis_Node_ID=20)
    assert axis.axis.node == 20


def test_a_position_is_called_as_it_is_set() -> None:
    axis = Axis()
    axis.send("Set_Absolute_Position", Position=-2.5)
    assert axis.ask("Get_Encoder_Estimates")["Pos_Estimate"] == pytest.approx(-2.5)
    axis.arm(3)
    axis.rig.step(ticks=100)
    assert axis.rig.is_still()


def test_gains_are_those_that_are_sent() -> None:
    soft, stiff = Axis(), Axis()
    for axis, gain in ((soft, 0.05), (stiff, 1.0)):
        axis.send("Set_Vel_Gains", Vel_Gain=gain, Vel_Integrator_Gain=0.0)
        axis.arm(2)
        axis.send("Set_Input_Vel", Input_Vel=0.5)
        axis.rig.step(ticks=1)
    assert stiff.rig.node.torque_n_m[0] == pytest.approx(20.0 * soft.rig.node.torque_n_m[0], rel=0.05)


UNASKED = {"0.5": {"Heartbeat", "Get_ADC_Voltage"}, "0.6": {"TxSdo"}}
"""What an axis sends by itself, is asked for otherwise, or, as ODRIVE.md says, is left out."""


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_every_message_of_an_axis_in_the_dbc_is_an_answer(firmware: str) -> None:
    axis = Axis(firmware)
    said = [message for message in DBC[firmware].messages if "ODrive_Axis0" in message.senders]
    names = {message.name.partition("_")[2] for message in said}
    assert len(names) > 8
    for name in names - UNASKED[firmware]:
        axis.ask(name)


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


COMMANDS = st.sampled_from((0x06, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F, 0x11, 0x12, 0x16, 0x18, 0x19, 0x1A, 0x1B))


@given(st.lists(st.tuples(COMMANDS, st.integers(0, 4), st.binary(max_size=8)), max_size=8), st.booleans())
def test_no_bytes_make_a_torque_beyond_the_limit_or_drive_an_idle_axis(
    frames: list[tuple[int, int, bytes]], is_armed: bool
) -> None:
    rig = FUZZED
    for axis in rig.node.axes:
        axis.boot_left = 0
        axis.clear()
        axis.set_defaults()
        axis.request(CLOSED_LOOP if is_armed else IDLE, rig.node.ticks)
    limit = rig.node.values["torque_limit_n_m"] * (1.0 + 1e-9)
    for command, node, payload in frames:
        rig.node.receive(Frame((ALL if node == 4 else rig.node.axes[node].node) << 5 | command, payload))
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
