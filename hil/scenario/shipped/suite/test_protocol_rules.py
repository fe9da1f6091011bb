"""What no scenario shows, because both ends keep the protocol: each end alone, against one that does not.

A member of the shipped suite of ``hil verify``. PROTOCOL.md has the rules.
"""

import math
from collections.abc import Iterable
from typing import Any

import pytest
from cobs import cobs

from firmware_protocol import codec
from firmware_protocol.client import Client
from firmware_protocol.codec import Message
from firmware_protocol.framing import Framer, crc16, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host import HostNode, library, parameter_hash, parameters
from hil.robot.robot_report import RobotReport
from hil.robot.wheel_map import WheelMap
from hil.runtime.robots import firmware_values
from hil.scenario import load

VALUES = firmware_values(load("circle_speed")) | {"undervoltage_v": 18.0}
CHECK = parameter_hash(VALUES) & 0xFF
A, B = 0x1231, 0x4562  # nonces of two sessions


class Robot:
    """A robot on blocks: the firmware, and four wheels that follow their torque."""

    def __init__(self) -> None:
        self.battery_v, self.current_a = 24.0, 0.0
        self.held = False
        self._speed_rad_s, self._angle_rad = [0.0] * 4, [0.0] * 4
        ffi, _ = library()
        self._exchange = ffi.callback("wheel_plant_exchange", self._tick)
        self.node = HostNode(VALUES, int(ffi.cast("uintptr_t", self._exchange)), 0, lockstep=False)
        self.node.run(10)

    def _tick(self, _context: Any, drive: Any, sense: Any) -> int:
        for wheel in range(4):
            if drive and not self.held:
                self._speed_rad_s[wheel] += drive.torque_n_m[wheel] / 0.03 * 1e-3
            self._angle_rad[wheel] += self._speed_rad_s[wheel] * 1e-3
            sense.count[wheel] = math.floor(self._angle_rad[wheel] / math.tau * 4096) & 0xFFFF
            sense.temperature_degc[wheel] = 25.0
            sense.current_a[wheel] = self.current_a
        sense.battery_v = self.battery_v
        return 0

    @property
    def state(self) -> int:
        return self.node.look().state

    def send(self, message: Message) -> None:
        self.node.receive(codec.encode(message))

    def wish(self, request: m.Request, nonce: int) -> None:
        self.send(m.HostHeartbeat(nonce, m.SCHEMA_HASH, request, m.Mode.SPEED, CHECK))

    def command(self, speed_rad_s: float, sequence: int, nonce: int) -> None:
        speed = speed_rad_s
        self.send(m.WheelCommand(speed, speed, speed, speed, sequence, nonce & 0xF))

    def arm(self, nonce: int) -> None:
        self.wish(m.Request.IDLE, nonce)
        self.wish(m.Request.ARM, nonce)

    def activate(self, nonce: int) -> None:
        self.arm(nonce)
        self.command(0.0, 0, nonce)
        assert self.state == m.State.ACTIVE

    def fail(self, nonce: int) -> None:
        """Drive with a flat battery until the robot is in FAULT."""
        self.activate(nonce)
        self.battery_v = 10.0
        self.node.run(30)
        self.battery_v = 24.0
        self.node.run(1)
        assert self.state == m.State.FAULT

    def spin(self, speed_rad_s: float) -> None:
        """Turn the wheels by hand."""
        self._speed_rad_s = [speed_rad_s] * 4

    def heard(self) -> list[Message]:
        return [message for frame in self.node.take_frames() if (message := codec.decode(frame)) is not None]


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_a_command_of_another_session_is_not_obeyed(robot: Robot) -> None:
    robot.activate(A)
    robot.command(5.0, 1, B)
    assert robot.node.look().rejected["session"] == 1
    robot.node.run(20)
    assert robot.node.look().set_point_rad_s == (0.0,) * 4


def test_the_first_command_of_a_session_must_be_zero(robot: Robot) -> None:
    robot.arm(A)
    robot.command(5.0, 0, A)
    assert robot.state == m.State.ARMED


def test_a_wish_to_arm_that_is_repeated_arms_no_second_time(robot: Robot) -> None:
    robot.activate(A)
    robot.node.run(2000)  # the watchdog, the ramp, rest
    assert robot.state == m.State.IDLE
    robot.wish(m.Request.ARM, A)
    assert robot.state == m.State.IDLE
    robot.wish(m.Request.ARM, B)  # never announced
    assert robot.state == m.State.IDLE


def test_a_used_nonce_arms_no_second_time(robot: Robot) -> None:
    robot.activate(A)
    robot.node.run(2000)
    robot.heard()
    robot.arm(A)
    assert robot.state == m.State.IDLE
    robot.node.run(110)
    assert [one for one in robot.heard() if isinstance(one, m.Status)][-1].arm_refusal == m.ArmRefusal.NONCE_USED
    robot.arm(B)
    assert robot.state == m.State.ARMED


def test_a_refused_wish_to_arm_uses_up_its_announcement(robot: Robot) -> None:
    robot.wish(m.Request.IDLE, A)
    robot.send(m.HostHeartbeat(A, m.SCHEMA_HASH, m.Request.ARM, m.Mode.SPEED, CHECK ^ 1))
    robot.wish(m.Request.ARM, A)
    assert robot.state == m.State.IDLE


def test_a_command_is_taken_up_to_20_ahead(robot: Robot) -> None:
    robot.activate(A)
    for speed_rad_s, sequence, taken in ((1.0, 20, 1.0), (2.0, 41, 1.0), (3.0, 40, 3.0)):
        robot.command(speed_rad_s, sequence, A)
        robot.node.run(1)
        assert robot.node.look().set_point_rad_s[0] == taken


def test_a_wish_to_clear_clears_one_fault_only(robot: Robot) -> None:
    robot.fail(A)
    robot.wish(m.Request.CLEAR, 0x77)
    assert robot.state == m.State.IDLE
    robot.fail(B)
    robot.wish(m.Request.CLEAR, 0x77)
    assert robot.state == m.State.FAULT
    robot.wish(m.Request.CLEAR, 0x78)
    assert robot.state == m.State.IDLE


def test_a_set_point_is_limited_to_the_robots_own_speed(robot: Robot) -> None:
    robot.activate(A)
    robot.command(60.0, 1, A)
    robot.node.run(1)
    assert max(robot.node.look().set_point_rad_s) <= 0.8 * VALUES["overspeed_rad_s"]


def test_the_integral_of_the_speed_loop_has_a_limit(robot: Robot) -> None:
    """The wheels are held, and a feedforward works against the speed loop: their sum stays small."""
    robot.activate(A)
    robot.held = True
    against, sequence = -VALUES["torque_limit_n_m"], 0
    for speed_rad_s, ticks in ((1.0, 80), (0.05, 400)):
        for _ in range(0, ticks, 10):
            sequence += 1
            robot.send(m.TorqueFeedforward(against, against, against, against, sequence, A & 0xF))
            robot.command(speed_rad_s, sequence, A)
            robot.node.run(10)
    assert max(map(abs, robot.node.look().torque_n_m)) < -0.1 * against


def test_no_parameter_changes_while_the_robot_drives(robot: Robot) -> None:
    place = next(i for i, one in enumerate(parameters()) if one.name == "ramp_s")
    write = m.ParameterRequest(place, m.Operation.WRITE, 1, 0x3F000000)  # 0.5
    for result in (m.Result.OK, m.Result.STATE):
        robot.heard()
        robot.send(write)
        robot.node.run(2)
        (answer,) = (one for one in robot.heard() if isinstance(one, m.ParameterResponse))
        assert answer.result == result
        if result is m.Result.OK:
            robot.send(write._replace(transaction=2, value=0x3E4CCCCD))  # 0.2 again
            robot.activate(A)


def test_an_emergency_stop_is_heard_in_every_state_but_boot(robot: Robot) -> None:
    robot.fail(A)
    robot.send(m.Estop(0, 0))
    assert robot.state == m.State.ESTOP
    robot.wish(m.Request.ARM, B)
    assert robot.state == m.State.ESTOP


def test_the_first_cause_of_a_fault_stays(robot: Robot) -> None:
    robot.fail(A)
    robot.spin(2.0 * VALUES["overspeed_rad_s"])
    robot.node.run(100)
    assert robot.node.look().fault is m.Fault.UNDERVOLTAGE
    robot.wish(m.Request.CLEAR, 0x77)
    robot.node.run(1)
    assert robot.node.look().fault is m.Fault.OVERSPEED, "which still lasts"


def test_an_emergency_stop_is_heard_while_the_robot_stops(robot: Robot) -> None:
    robot.activate(A)
    robot.command(5.0, 1, A)
    robot.node.run(20)
    robot.wish(m.Request.IDLE, B)
    assert robot.state == m.State.STOPPING
    robot.send(m.Estop(0, 0))
    assert robot.state == m.State.ESTOP


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_overcurrent_of_either_sign_is_a_fault(robot: Robot, sign: float) -> None:
    robot.activate(A)
    robot.current_a = 1.6 * sign * VALUES["current_limit_a"]
    robot.node.run(10)
    assert robot.node.look().fault is m.Fault.OVERCURRENT


def test_short_dips_of_the_battery_are_no_fault(robot: Robot) -> None:
    robot.activate(A)
    for sequence in range(1, 8):
        robot.command(0.0, sequence, A)
        for volts in (10.0, 24.0):
            robot.battery_v = volts
            robot.node.run(10)
    assert robot.state == m.State.ACTIVE


def framed(body: bytes) -> bytes:
    return bytes(cobs.encode(body + crc16(body).to_bytes(2, "little"))) + b"\0"


def test_a_frame_of_another_length_than_its_messages_is_not_obeyed(robot: Robot) -> None:
    frame = codec.encode(m.Estop(0, 0))
    for payload in (frame.payload + b"\0", frame.payload[:-1]):
        robot.node.feed(framed(frame.id.to_bytes(2, "little") + b"\0" + payload))
        assert robot.state == m.State.IDLE
    assert robot.node.look().rejected["length"] == 2


def test_after_too_long_a_frame_the_next_one_is_heard(robot: Robot) -> None:
    robot.node.feed(b"\x01" * 300 + b"\0" + Framer().encode(codec.encode(m.Estop(0, 0))))
    assert robot.state == m.State.ESTOP


# The host

DONE, WAIT, LATCHED = 0, 1, 7  # WHEEL_ARMING_... of wheel_client.h


def linked(nonce: int, messages: Iterable[Message]) -> Client:
    """Return a host that has taken these messages."""
    client = Client(m.Mode.SPEED, CHECK, nonce)
    packed, at = pack([codec.encode(message) for message in messages]), 0
    while at < len(packed):
        at = client.take(packed, at, 0)
    return client


def greeting(robot: Robot) -> list[Message]:
    robot.send(m.HelloRequest(0))
    robot.node.run(60)
    return robot.heard()


def test_a_host_does_not_drive_a_robot_that_another_has_armed(robot: Robot) -> None:
    robot.activate(A)
    heard = greeting(robot)
    for nonce, step in ((A, DONE), (B, WAIT)):
        assert linked(nonce, heard).arm(0) == step


def test_a_host_says_that_a_robot_is_latched(robot: Robot) -> None:
    robot.fail(A)
    assert linked(B, greeting(robot)).arm(0) == LATCHED


def test_a_host_greets_no_robot_of_another_schema(robot: Robot) -> None:
    heard = greeting(robot)
    other = [
        one._replace(schema_hash=one.schema_hash ^ 1) if isinstance(one, m.HelloIdentity) else one for one in heard
    ]
    assert linked(A, heard).view.is_greeted
    assert not linked(A, other).view.is_greeted


def test_a_host_that_begins_anew_uses_its_new_nonce() -> None:
    client = Client(m.Mode.SPEED, CHECK, A)
    for renew in (client.begin, client.renew):
        renew(B)
        client.request(m.Request.ARM, 0)
        wishes = [one for frame in client.out() if isinstance(one := codec.decode(frame), m.HostHeartbeat)]
        assert wishes[-1].nonce == B
        client.sent()
        renew(A)


def test_a_host_takes_parts_of_a_snapshot_in_their_order_only(robot: Robot) -> None:
    robot.heard()
    robot.node.run(30)
    heard = robot.heard()
    whole = linked(A, heard).view.snapshots
    place = next(i for i, one in enumerate(heard) if isinstance(one, m.Encoders))
    heard[place], heard[place + 1] = heard[place + 1], heard[place]
    assert linked(A, heard).view.snapshots == whole - 1


def test_a_host_takes_no_part_of_another_instant(robot: Robot) -> None:
    robot.arm(A)
    robot.heard()
    robot.node.run(30)
    heard = robot.heard()
    whole = linked(A, heard).view.snapshots
    for kind in (m.Accelerometer, m.Gyro):
        changed = [one._replace(tick=one.tick + 5) if isinstance(one, kind) else one for one in heard]
        assert linked(A, changed).view.snapshots < whole


def test_a_host_counts_on_where_a_counter_of_the_robot_wraps() -> None:
    report = RobotReport(WheelMap())
    for crc in (250, 3):
        report.feed(m.LinkCounters(*(crc if name == "crc" else 0 for name in m.LinkCounters._fields)))
    assert report.rejected["crc"] == 9
