"""ODrive CANSimple against the makers' own DBC files of 0.5.6 and 0.6.10, read by cantools."""

import math
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, distribution
from typing import Any

import cantools
import pytest

from firmware_protocol.framing import Frame
from hil.addons.motors.odrive import odrive_tables as tables
from hil.core.types import CommandMode
from hil.robot.driver import REMOTE
from tests.support.dialect_testbed import STILL, Rig, assert_near, ramp_to

try:
    DBC_FILES = distribution("odrive-can")  # which has them as the makers publish them
except PackageNotFoundError:
    pytest.skip("no DBC of the makers: pip install odrive-can", allow_module_level=True)

DBC: Mapping[str, Any] = {
    firmware: cantools.database.load_file(str(DBC_FILES.locate_file(f"odrive_can/dbc/odrive-cansimple-{version}.dbc")))
    for firmware, version in (("0.5", "0.5.6"), ("0.6", "0.6.10"))
}
FIRMWARES = tuple(DBC)


def meaning(firmware: str, frame: Frame) -> tuple[str, dict[str, Any]]:
    """Return a frame's name without the axis, and its signals."""
    message = DBC[firmware].get_message_by_frame_id(frame.id & ~REMOTE)
    name = message.name.partition("_")[2]
    if frame.id & REMOTE:
        return name, {}
    assert len(frame.payload) == message.length, name
    return name, message.decode(frame.payload, decode_choices=False)


def said_by(firmware: str, node: int, name: str, **signals: float) -> Frame:
    """Return a message with these signals, and zero in the others."""
    message = DBC[firmware].get_message_by_name(f"Axis{node}_{name}")
    return Frame(message.frame_id, message.encode({s.name: 0 for s in message.signals} | signals))


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("mode", CommandMode)
def test_what_is_sent_means_to_the_makers_what_it_should(firmware: str, mode: CommandMode) -> None:
    rig = Rig("odrive", {"firmware": firmware, "gear_ratio": 2.0}, mode=mode)
    rig.greet()
    rig.sent.clear()
    rig.arm()
    rig.step(rig.driver.command((0.0, 0.0, 0.0, -math.tau), (0.0, 0.0, 0.0, -0.25), rig.now_ns))
    rig.step([*rig.driver.clear(), *rig.driver.disarm()])
    frames = [frame for frame in rig.sent if frame.id >> 5 & 0x3F == 3]
    said = [meaning(firmware, frame) for frame in frames]
    assert {name for name, signals in said if not signals} <= POLLED[firmware] | {"Clear_Errors"}
    speed = mode is CommandMode.SPEED
    still = ("Set_Input_Vel", {"Input_Vel": 0.0, "Input_Torque_FF": 0.0}), ("Set_Input_Torque", {"Input_Torque": 0.0})
    driven = (
        ("Set_Input_Vel", {"Input_Vel": -2.0, "Input_Torque_FF": -0.125}),
        ("Set_Input_Torque", {"Input_Torque": -0.125}),
    )
    commands = [what for what in said if what[1] and what != still[not speed]]
    assert commands == [
        ("Set_Controller_Mode", {"Control_Mode": 2 if speed else 1, "Input_Mode": 1}),
        ("Set_Axis_State", {"Axis_Requested_State": 8}),
        driven[not speed],
        *([("Clear_Errors", {"Identify": 0})] if firmware == "0.6" else []),
        ("Set_Axis_State", {"Axis_Requested_State": 1}),
    ]


def test_an_estop_is_the_makers() -> None:
    """The DBC of 0.5 leaves it out; its documents and its firmware have the same."""
    rig = Rig("odrive")
    assert [meaning("0.6", frame) for frame in rig.driver.estop()] == [("Estop", {})] * 4


def test_the_watchdog_is_set_by_the_makers_parameter_messages() -> None:
    watched = {"watchdog_endpoints": [311, 312], "endpoints_firmware": "0.6.10", "endpoints_hardware": "4.4.58"}
    rig = Rig("odrive", watched)
    rig.greet()
    rig.arm()
    sent = [frame.payload.ljust(8, b"\0") for frame in rig.sent if frame.id == 0x004]
    message = DBC["0.6"].get_message_by_frame_id(0x004)
    said = [message.decode(payload, decode_choices=False) for payload in sent]
    tenth = 0x3DCCCCCD  # 0.1 as a float32
    assert [(one["Opcode"], one["Endpoint_ID"], one["Value"]) for one in said] == [
        (0, 311, 0), (1, 311, tenth), (0, 311, 0), (0, 312, 0), (1, 312, 1), (0, 312, 0)
    ]  # fmt: skip


def test_the_makers_dbc_drives_them_without_this_driver() -> None:
    """By the driver ``dbc`` and a mapping. Their Estop is a message without signals."""

    def of_all(name: str, **fields: object) -> dict[str, object]:
        return {f"Axis{node}_{name}": fields for node in range(4)}

    def wheels(signal: str) -> dict[str, str]:
        return {wheel: f"Axis{node}_{signal}" for node, wheel in enumerate(("fl", "fr", "rr", "rl"))}

    mapping: dict[str, object] = {
        "file": str(DBC_FILES.locate_file("odrive_can/dbc/odrive-cansimple-0.6.10.dbc")),
        "command": {"speed": wheels("Set_Input_Vel.Input_Vel"), "feedforward": wheels("Set_Input_Vel.Input_Torque_FF")},
        "feedback": {
            "rate_hz": 100,
            "speed": wheels("Get_Encoder_Estimates.Vel_Estimate"),
            "position": wheels("Get_Encoder_Estimates.Pos_Estimate"),
        },
        "enable": of_all("Set_Controller_Mode", Control_Mode=2, Input_Mode=1)
        | of_all("Set_Axis_State", Axis_Requested_State="CLOSED_LOOP_CONTROL"),
        "armed_when": of_all("Heartbeat", Axis_State="CLOSED_LOOP_CONTROL"),
        "disable": of_all("Set_Axis_State", Axis_Requested_State="IDLE"),
        "estop": of_all("Estop"),
        "estop_latches": True,
        "clear": of_all("Clear_Errors", Identify=0),
    }
    rig = Rig("dbc", mapping)
    rig.greet()
    rig.arm()
    rig.drive(1.0, ramp_to((6.0, -6.0, 6.0, -6.0)))
    assert_near(rig.speeds(), (6.0, -6.0, 6.0, -6.0), 0.2)
    rig.step(rig.driver.estop(), ticks=600)
    assert rig.sent[-4:] == [Frame(node << 5 | 0x02, b"") for node in range(4)]
    assert rig.is_still()
    for _ in range(60):
        rig.step(rig.driver.arm(rig.now_ns))
    assert not rig.driver.is_armed
    rig.step(rig.driver.clear())
    rig.arm()


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_what_the_makers_say_is_understood(firmware: str) -> None:
    rig = Rig("odrive", {"firmware": firmware, "gear_ratio": 2.0})
    rig.greet()
    driver = rig.driver
    for node in range(4):
        for frame in (
            said_by(firmware, node, "Get_Encoder_Estimates", Pos_Estimate=3.0 + node, Vel_Estimate=-1.5),
            said_by(firmware, node, "Get_Iq", Iq_Setpoint=9.0, Iq_Measured=0.25 * node),
            said_by(firmware, node, "Get_Bus_Voltage_Current", Bus_Voltage=24.5 - node, Bus_Current=0.5),
        ):
            driver.feed(frame, 17)
        if firmware == "0.6":
            driver.feed(said_by(firmware, node, "Get_Temperature", FET_Temperature=41.0, Motor_Temperature=60.0), 17)
    sample = driver.sample
    assert sample is not None
    assert_near(sample.speed_rad_s, (-0.75 * math.tau,) * 4, 1e-6)
    assert_near(sample.position_rad, [(3.0 + node) / 2.0 * math.tau for node in range(4)], 1e-6)
    assert sample.current_a == (0.0, 0.25, 0.5, 0.75)
    assert sample.battery_v == 21.5
    if firmware == "0.6":
        assert sample.temperature_degc == (60.0,) * 4
        assert sample.battery_a == 2.0


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_what_the_emulated_axes_say_means_to_the_makers_what_they_do(firmware: str) -> None:
    rig = Rig("odrive", {"firmware": firmware, "gear_ratio": 2.0})
    rig.greet()
    rig.arm()
    rig.drive(1.0, ramp_to((4.0, 5.0, 6.0, 7.0)))
    rig.heard.clear()
    rig.drive(0.2, lambda _t: ((4.0, 5.0, 6.0, 7.0), STILL))
    newest = {frame.id: meaning(firmware, frame) for frame in rig.heard}
    for node, speed in enumerate(rig.speeds()):
        name, signals = newest[node << 5 | 0x09]
        assert name == "Get_Encoder_Estimates"
        assert abs(signals["Vel_Estimate"] * math.tau / 2.0 - speed) < 0.1
        name, signals = newest[node << 5 | 0x01]
        assert (name, signals["Axis_State"], signals["Axis_Error"]) == ("Heartbeat", 8, 0)
        assert signals["Trajectory_Done_Flag"] == 1
        assert newest[node << 5 | 0x17][0] == "Get_Bus_Voltage_Current"
    assert {name for name, _ in newest.values()} == POLLED[firmware] | {"Get_Encoder_Estimates", "Heartbeat"}


POLLED = {
    "0.5": {"Get_Motor_Error", "Get_Encoder_Error", "Get_Controller_Error", "Get_Iq", "Get_Bus_Voltage_Current"},
    "0.6": {"Get_Error", "Get_Temperature", "Get_Iq", "Get_Bus_Voltage_Current"},
}


@pytest.mark.parametrize(
    ("bits", "firmware", "message", "signal"),
    [
        (tables.AXIS_ERRORS_05, "0.5", "Heartbeat", "Axis_Error"),
        (tables.MOTOR_ERRORS_05, "0.5", "Get_Motor_Error", "Motor_Error"),
        (tables.ENCODER_ERRORS_05, "0.5", "Get_Encoder_Error", "Encoder_Error"),
        (tables.CONTROLLER_ERRORS_05, "0.5", "Get_Controller_Error", "Controller_Error"),
        (tables.ERRORS_06, "0.6", "Heartbeat", "Axis_Error"),
        (tables.ERRORS_06, "0.6", "Get_Error", "Active_Errors"),
        (tables.ERRORS_06, "0.6", "Get_Error", "Disarm_Reason"),
    ],
)
def test_every_error_has_the_makers_name(bits: Mapping[int, str], firmware: str, message: str, signal: str) -> None:
    choices = DBC[firmware].get_message_by_name(f"Axis0_{message}").get_signal_by_name(signal).choices
    theirs = {value: str(name) for value, name in choices.items()}
    ours = {value: name for value, name in bits.items() if name != "REQUESTED_CURRENT_TOO_HIGH"}  # newer than the file
    assert ours == {value: name for value, name in theirs.items() if value or 0 in bits}
