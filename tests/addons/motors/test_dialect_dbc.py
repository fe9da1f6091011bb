"""A user's DBC and mapping: worked frames by hand, the driver with its emulated device, and received frames."""

import math
import struct
from collections.abc import Callable, Mapping
from pathlib import Path

import can
import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import State
from hil.addons.motors.dbc.dbc_driver import DIALECT
from hil.addons.service.messages import Phase
from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist
from hil.core.options import build
from hil.core.types import CommandMode, FourWheels
from hil.robot.driver import EXTENDED, Driver, Sample
from tests.support.dbc_mappings import EXAMPLES, edited_dbc, motors
from tests.support.dialect_testbed import STILL, Rig, assert_near, ramp_to
from tests.support.pilot_bench import PilotBench

MOTION, IMU = EXTENDED | 0x18FF0200, EXTENDED | 0x18FF0300
DBC = cantools.database.load_file(EXAMPLES / "wheel_drives.dbc")
INFO = DBC.get_message_by_name("DRIVES_INFO").frame_id
FORWARD = (8.0, 8.0, 8.0, 8.0)
SIDEWAYS = (-6.0, 6.0, -6.0, 6.0)
RPM_AT_MOTOR = 20.0 * 60.0 / math.tau
SLOW = {"robot.speed_limit_rad_s": 40.0}


def drives(**changes: object) -> Rig:
    return Rig("dbc", motors("wheel_drives", changes))


def base(**changes: object) -> Rig:
    return Rig("dbc", motors("twist_base", changes), **SLOW)


FACTS = drives().facts


def driver_of(name: str, changes: Mapping[str, object] | None = None) -> Driver:
    """Make a driver alone, without anything behind it."""
    facts = FACTS._replace(speed_limit_rad_s=40.0) if name == "twist_base" else FACTS
    made: Driver = DIALECT.make(build(DIALECT.settings, motors(name, changes), "device.motors"), facts)
    return made


def armed(rig: Rig) -> Rig:
    rig.step(ticks=100)
    rig.greet()
    rig.arm()
    return rig


def test_a_worked_command_has_each_field_where_the_dbc_says() -> None:
    """Enable in bit 0, the mode "speed" = 2 in 1 to 3, the counter in 4 to 7, then half rpm and mNm, little-endian."""
    driver = driver_of("wheel_drives")
    for count in (0, 1):
        frames = driver.command((1.0, -2.0, 3.0, 0.0), (0.5, 0.0, 0.0, -0.5), 0)
        head = 1 | 2 << 1 | count << 4
        speeds = [round(2 * speed * RPM_AT_MOTOR) for speed in (1.0, -2.0, 3.0, 0.0)]
        torques = [round(1000 * torque / 20.0) for torque in (0.5, 0.0, 0.0, -0.5)]
        assert frames == [Frame(0x110 + i, struct.pack("<Bhh3x", head, speeds[i], torques[i])) for i in range(4)]


def test_the_frame_of_the_page_is_what_is_sent() -> None:
    assert driver_of("wheel_drives").command((1.0, 0.0, 0.0, 0.0), STILL, 0)[0].payload.hex() == "057e010000000000"


def test_a_twist_is_big_endian_in_an_extended_frame() -> None:
    """0.075 m × (1, 1, 1, 1) is 75 mm/s forward; ± for the turn: 0.075 / 0.6 × 4 / 4 = 0.125 rad/s."""
    driver = driver_of("twist_base")
    assert list(driver.command((0.0, 2.0, 0.0, 2.0), STILL, 0)) == [
        Frame(EXTENDED | 0x18FF0100, struct.pack(">3hB", 75, 75, 0, 0))
    ]
    assert list(driver.command((-1.0, 1.0, 1.0, -1.0), STILL, 0)) == [
        Frame(EXTENDED | 0x18FF0100, struct.pack(">3hB", 0, 0, 125, 1))
    ]


def test_a_worked_status_is_read() -> None:
    """3000 rpm of the motor, a quarter of its turn, -2 A in 12 bits with the state "run" above, 60 °C, no error."""
    driver = driver_of("wheel_drives")
    for i in range(4):
        packed = (-40 & 0xFFF) | 2 << 12
        driver.feed(Frame(0x120 + i, struct.pack("<hHHBB", 6000, 1024, packed, 100, 0)), 7 + i)
    driver.feed(Frame(0x130, struct.pack("<BHHh", 3, 100, 0, 0)[:3] + struct.pack("<Hhx", 2413, -150)), 9)
    sample = driver.sample
    assert sample is not None
    assert sample.stamp_ns == 7
    assert_near(sample.speed_rad_s, (3000 / RPM_AT_MOTOR,) * 4, 1e-9)
    assert_near(sample.position_rad, (math.pi / 2 / 20.0,) * 4, 1e-9)
    assert_near(sample.current_a, (-2.0,) * 4, 1e-9)
    assert sample.temperature_degc == (60.0,) * 4
    assert (sample.battery_v, sample.battery_a) == pytest.approx((24.13, -1.5))
    assert driver.identity == "controllers of wheel_drives.dbc with DRIVES_INFO.Protocol 3"


@pytest.mark.parametrize(("make", "target"), [(drives, FORWARD), (base, SIDEWAYS)])
def test_wheels_reach_their_speeds(make: Callable[[], Rig], target: FourWheels) -> None:
    rig = armed(make())
    rig.drive(1.0, ramp_to(target))
    assert rig.driver.is_armed
    assert rig.driver.sample is not None
    assert_near(rig.speeds(), target, 0.2)
    assert_near(rig.driver.sample.speed_rad_s, rig.speeds(), 0.2)


def test_an_angle_of_one_motor_turn_becomes_a_position_that_goes_on() -> None:
    rig = armed(drives())
    assert rig.driver.sample is not None
    begin = rig.driver.sample.position_rad
    true = [shaft.position_rad for shaft in rig.node.shafts]
    rig.drive(1.0, ramp_to((30.0, -30.0, 30.0, -30.0)))  # 95 motor turns a second, half a turn a frame
    rig.drive(0.5, lambda _t: (STILL, STILL))
    turned = [b - a for a, b in zip(begin, rig.driver.sample.position_rad, strict=True)]
    expected = [shaft.position_rad - a for shaft, a in zip(rig.node.shafts, true, strict=True)]
    assert expected[0] > 10.0
    assert_near(turned, expected, 0.02)


ANGLE = ' Angle : 16|16@1+ (1,0) [0|4095] ""'


@pytest.mark.parametrize(
    ("field", "changes", "turn"),
    [
        ('16|16@1+ (1,0) [0|359] "deg"', {"wraps_at": 360}, 360.0),
        ('16|16@1- (0.1,0) [-180|180] "deg"', {"wraps_at": 360}, 360.0),
        ('16|16@1+ (0.01,0) [0|6.28] "rad"', {"wraps_at": math.tau}, math.tau),
        ('16|16@1+ (0.0054931640625,0) [0|0] "deg"', {}, 360.0),
        ('16|16@1+ (1,0) [0|0] ""', {"scale": math.tau / 65536 / 20.0}, 65536.0),
        ('16|16@1+ (1,0) [0|3600] ""', {"scale": math.tau / 3600 / 20.0, "wraps_at": 3600}, 3600.0),
    ],
)
def test_a_position_that_begins_again_does_not_drift(
    field: str, changes: dict[str, float], turn: float, tmp_path: Path
) -> None:
    """A motor that turns by 0.3 of a turn a frame: a hundred turns of the motor are five of the wheel."""
    file = edited_dbc(tmp_path, "wheel_drives", (ANGLE, f" Angle : {field}"))
    scale: dict[str, object] = {"feedback.position.scale": None, "feedback.position.wraps_at": None}
    driver = driver_of(
        "wheel_drives", {"file": file} | scale | {f"feedback.position.{k}": v for k, v in changes.items()}
    )
    database, begin = cantools.database.load_file(file), 0.0
    for n in range(1000):
        for wheel in ("FL", "FR", "RR", "RL"):
            message = database.get_message_by_name(f"STATUS_{wheel}")
            angle = message.get_signal_by_name("Angle")
            physical = (0.3 * n % 1.0) * turn + (angle.minimum or 0.0)
            raw = round((physical - angle.offset) / angle.scale)
            values = {one.name: 0 for one in message.signals} | {"Angle": raw, "Speed": 2 * 0.3 * 60.0 / 0.005}
            payload = message.encode(values, scaling=False, strict=False)
            driver.feed(Frame(message.frame_id, payload), n * 5_000_000)
        assert driver.sample is not None
        begin = driver.sample.position_rad[0] if n == 0 else begin
    assert_near(driver.sample.position_rad, (begin + 999 * 0.3 / 20.0 * math.tau,) * 4, 0.005)


def test_after_how_much_a_position_begins_again_is_asked_for_where_the_dbc_has_limits() -> None:
    with pytest.raises(BadInputError, match=r"STATUS_FL.Angle goes from 0 to 4095, .* begins again; give wraps_at"):
        driver_of("wheel_drives", {"feedback.position.wraps_at": None})


def test_torques_are_currents_by_the_torque_constant_where_the_dbc_says_ampere(tmp_path: Path) -> None:
    file = edited_dbc(tmp_path, "wheel_drives", ('[-20|20] "Nm"', '[-20|20] "A"'))
    changes: dict[str, object] = {"file": file, "command.speed": None, "command.feedforward": None}
    for wheel in ("FL", "FR", "RR", "RL"):
        changes[f"command.torque.{wheel.lower()}"] = ("-" if wheel == "RR" else "") + f"DRIVE_{wheel}.Feedforward"
    rig = Rig("dbc", motors("wheel_drives", changes), mode=CommandMode.TORQUE)
    assert rig.driver.capabilities.modes == {CommandMode.TORQUE}
    constant = rig.facts.torque_constant_n_m_a
    frames = rig.driver.command(STILL, (constant, 2 * constant, constant, 0.0), 0)
    assert [struct.unpack_from("<h", frame.payload, 3)[0] for frame in frames] == [1000, 2000, -1000, 0]
    armed(rig)
    rig.drive(0.5, lambda _t: (STILL, (0.5, 0.5, 0.5, 0.5)))
    assert_near(rig.node.torque_n_m, (0.5,) * 4, 0.01)
    assert min(rig.speeds()) > 1.0


def test_the_watchdog_is_set_read_back_and_stops_the_wheels_when_commands_end() -> None:
    rig = drives()
    rig.step(ticks=100)
    assert rig.driver.capabilities.watchdog == "set"
    [first] = rig.driver.arm(rig.now_ns)
    assert first == Frame(0x100, struct.pack("<HBx", 100 << 8, 0))  # 100 ms, and off
    assert not rig.driver.is_armed
    armed(rig)
    rig.drive(0.5, ramp_to(FORWARD, 0.2))
    rig.step(ticks=90)
    assert rig.driver.is_armed
    rig.step(ticks=600)
    assert not rig.driver.is_armed
    assert rig.is_still()


def test_a_watchdog_that_does_not_answer_as_it_was_set_keeps_the_wheels_disarmed() -> None:
    rig = drives()
    rig.node.overrides["DRIVES_INFO.Timeout"] = 2000
    rig.step(ticks=100)
    for _ in range(60):
        rig.step(rig.driver.arm(rig.now_ns))
    assert not rig.driver.is_armed
    assert not rig.node.is_on


def test_a_watchdog_that_was_read_back_in_a_session_before_is_set_and_read_anew() -> None:
    rig = armed(drives())
    rig.step(rig.driver.disarm())
    feed = rig.driver.feed
    rig.driver.feed = lambda frame, t_ns: None if frame.id == INFO else feed(frame, t_ns)  # type: ignore[method-assign]
    rig.sent.clear()
    for _ in range(100):
        rig.step(rig.driver.arm(rig.now_ns))
        assert not rig.driver.is_armed
    assert {frame.id for frame in rig.sent} == {0x100}
    rig.driver.feed = feed  # type: ignore[method-assign]
    rig.arm()


def test_no_watchdog_and_a_slow_one_are_said() -> None:
    slow, unknown, dropped = driver_of("twist_base").warnings
    assert slow.startswith("when commands end the wheels go on for 0.5 s")
    assert unknown.startswith("device.motors.armed_when is empty")
    assert dropped.startswith("a base of twist_base.dbc takes no torque beside a speed")
    assert driver_of("wheel_drives").warnings == ()
    none = driver_of("twist_base", {"watchdog": None})
    assert none.capabilities.watchdog == "none"
    assert "nothing that is known stops the wheels" in none.warnings[0]


def test_arming_sends_the_steps_in_order_and_once_more_when_one_was_lost() -> None:
    rig = drives(watchdog=None)
    rig.step(ticks=100)
    states = []
    for number in range(120):
        frames = rig.driver.arm(rig.now_ns)
        states += [frame.payload[0] for frame in frames if frame.id == 0x100]
        rig.step([] if number < 40 else frames)  # the first ones are lost
    assert states == [1, 2, 1, 2]
    assert rig.driver.is_armed


def test_an_error_is_told_in_the_words_of_the_value_table_ends_arming_and_is_cleared() -> None:
    rig = armed(drives())
    rig.node.fail("STATUS_FR.Error", 3)
    rig.node.fail("STATUS_RL.Error", 77)
    rig.step()
    assert list(rig.driver.errors) == ["wheel fr: STATUS_FR.Error is 'encoder lost'", "wheel rl: STATUS_RL.Error is 77"]
    assert not rig.driver.is_armed
    for _ in range(60):
        rig.step(rig.driver.arm(rig.now_ns))
    assert not rig.driver.is_armed  # errors that were there are not cleared by arming
    rig.step(rig.driver.clear(), ticks=20)
    assert not rig.node.is_on
    assert rig.driver.errors == []
    rig.arm()


@pytest.mark.parametrize(
    ("changed", "told"), [({"Error": 1}, ["wheel fl: STATUS_FL.Error is 'overcurrent'"]), ({"State": 0}, [])]
)
def test_what_was_told_for_one_message_ends_closed_loop_also_where_the_next_is_well(
    changed: dict[str, int], told: list[str]
) -> None:
    rig = armed(drives())
    message = DBC.get_message_by_name("STATUS_FL")
    [*_, well] = [frame for frame in rig.heard if frame.id == message.frame_id]
    values = message.decode(well.payload, decode_choices=False)
    rig.driver.feed(Frame(well.id, message.encode(values | changed, strict=False)), rig.now_ns)
    rig.driver.feed(well, rig.now_ns)
    assert not rig.driver.is_armed
    assert rig.driver.errors == told
    rig.driver.disarm()
    assert rig.driver.errors == []


def test_flags_of_the_robot_are_errors_too() -> None:
    rig = base()
    rig.node.fail("BASE_MOTION.EmergencyStop", 1)
    rig.step(ticks=30)
    assert list(rig.driver.errors) == ["the robot: BASE_MOTION.EmergencyStop is 1"]


def test_an_estop_that_latches_is_ended_by_clear_alone() -> None:
    rig = armed(drives())
    assert rig.driver.capabilities.latches_estop
    rig.drive(0.3, ramp_to(FORWARD, 0.2))
    assert rig.driver.estop() == [Frame(0x100, struct.pack("<HBx", 100 << 8 | 3, 0))]
    rig.step(rig.driver.estop(), ticks=600)
    assert rig.is_still()
    for _ in range(60):
        rig.step(rig.driver.arm(rig.now_ns))
    assert not rig.node.is_on
    rig.step(rig.driver.clear())
    rig.arm()


def test_an_estop_without_signals_goes_out_on_the_bus_and_stops_the_wheels(tmp_path: Path) -> None:
    """As in ODrive's own DBC. python-can receives frames of no bytes."""
    file = edited_dbc(tmp_path, "wheel_drives", ("BO_ 256 ", "BO_ 2 STOP: 0 HOST\n\nBO_ 256 "))
    table = motors("wheel_drives", {"file": file, "estop": {"STOP": {}}})
    link = "can:virtual/dbc-estop"
    overrides = {"device.driver": "dbc", "device.motors": table, "link.url": link}
    with (
        can.Bus(interface="virtual", channel="dbc-estop") as bus,
        PilotBench(**overrides).armed() as bench,
    ):
        bench.pilot.active().twist(BodyTwist(0.3, 0.0, 0.0))
        bench.run(0.3)
        assert not [message for message in iter(lambda: bus.recv(0), None) if message.arbitration_id == 2]
        bench.pilot.estop()
        bench.run_until(Phase.ESTOP)
        [first, *_] = [message for message in iter(lambda: bus.recv(0), None) if message.arbitration_id == 2]
        assert (first.dlc, bytes(first.data), first.is_extended_id, first.is_remote_frame) == (0, b"", False, False)
        bench.run(1.0)
        assert bench.last("robot.state") == State.ESTOP


@pytest.mark.parametrize("phase", ["ask", "enable", "disable", "estop", "clear"])
def test_a_message_without_signals_is_sent_in_each_phase(phase: str, tmp_path: Path) -> None:
    file = edited_dbc(tmp_path, "wheel_drives", ("BO_ 256 ", "BO_ 2 BARE: 0 HOST\n\nBO_ 256 "))
    driver = driver_of("wheel_drives", {"file": file, "watchdog": None, f"{phase}.BARE": {}})
    sent = {
        "ask": lambda: driver.ask(),
        "enable": lambda: [*driver.arm(0), *driver.arm(0)],
        "disable": lambda: driver.disarm(),
        "estop": lambda: driver.estop(),
        "clear": lambda: driver.clear(),
    }[phase]()
    assert sent.count(Frame(2, b"")) == (2 if phase == "enable" else 1)  # an array of two steps is beside it


def test_disarming_asks_for_standstill_switches_off_and_may_be_said_twice() -> None:
    rig = drives()
    rig.step(rig.driver.disarm())
    armed(rig)
    rig.drive(0.3, ramp_to(FORWARD, 0.2))
    frames = rig.driver.disarm()
    assert [(frame.id, frame.payload[0] & 1, frame.payload[1:3]) for frame in frames] == [
        *((0x110 + i, 0, bytes(2)) for i in range(4)),
        (0x100, 0, struct.pack("<H", 100)),
    ]
    rig.step(frames)
    rig.step(rig.driver.disarm(), ticks=500)
    assert not rig.driver.is_armed
    assert rig.is_still()


def test_nothing_but_arming_and_commands_has_the_enable_bit() -> None:
    """Also if the signal for clearing errors is in the command's message, whose constants enable the drive."""
    driver = driver_of("wheel_drives", {"clear": {"DRIVE_FL": {"Mode": "off"}}})
    assert [frame.payload[0] & 0xF for frame in driver.clear()] == [0]
    assert all(frame.payload[0] & 1 == 0 for frame in driver.disarm() if frame.id != 0x100)


@pytest.mark.parametrize(
    "enable",
    [
        {"DRIVES_CONTROL": {"State": ["off", "ready", "run"]}},
        {f"DRIVE_{wheel}": {"Enable": [0, 1]} for wheel in ("FL", "FR", "RR", "RL")},
    ],
)
def test_what_switches_off_may_be_the_first_step_to_on(enable: object) -> None:
    """As in CiA 402, whose "shutdown" is both."""
    rig = armed(drives(enable=enable))
    rig.drive(0.3, ramp_to(FORWARD, 0.2))
    assert not rig.is_still()
    rig.step(rig.driver.disarm(), ticks=500)
    assert not rig.node.is_on
    assert rig.is_still()


def test_the_steps_of_enable_are_sent_in_their_order() -> None:
    """With commands of standstill, in whatever order the emulated drives would take them."""
    driver = driver_of("wheel_drives", {"watchdog": None, "enable.DRIVES_CONTROL.State": ["off", "ready", "run"]})
    ticks = [driver.arm(number) for number in range(4)]
    assert [frame.payload[0] for frames in ticks for frame in frames if frame.id == 0x100] == [0, 1, 2]
    assert [[frame.id for frame in frames] for frames in ticks[::3]] == [
        [*range(0x110, 0x114), 0x100],
        [*range(0x110, 0x114)],
    ]
    assert all(frame.payload[1:5] == bytes(4) for frames in ticks for frame in frames if frame.id != 0x100)


def test_a_device_of_another_version_is_refused() -> None:
    rig = drives()
    rig.node.overrides["DRIVES_INFO.Protocol"] = 9
    rig.step(ticks=101)
    with pytest.raises(BadInputError, match=r"DRIVES_INFO.Protocol of the device is 9, and this mapping is for 2, 3"):
        rig.greet()


def test_what_was_not_heard_is_named_and_forgotten_with_the_link() -> None:
    rig = drives()
    assert rig.driver.identity is None
    assert rig.driver.missing == (
        "nothing received of STATUS_FL (0x120), STATUS_FR (0x121), STATUS_RR (0x122), STATUS_RL (0x123), DRIVES_INFO "
        "(0x130); check power, wiring and bit rate, and the identifiers in wheel_drives.dbc"
    )
    armed(rig)
    assert rig.driver.missing == ""
    rig.driver.restart()
    assert rig.driver.sample is None
    assert not rig.driver.is_armed
    assert rig.driver.missing


def test_one_silent_wheel_makes_the_sample_old() -> None:
    rig = armed(drives())
    stamp_ns = rig.driver.sample.stamp_ns if rig.driver.sample else 0
    for number in (0x120, 0x121, 0x123):
        rig.driver.feed(Frame(number, bytes(8)), rig.now_ns + 10**9)
    assert rig.driver.sample is not None
    assert rig.driver.sample.stamp_ns == stamp_ns


def told(driver: Driver, number: int, seconds: float, payload: bytes = bytes(8)) -> Sample:
    """Feed a frame that came then, and return the sample."""
    driver.feed(Frame(number, payload), round(seconds * 1e9))
    assert driver.sample is not None
    return driver.sample


def test_a_gyro_that_fell_silent_is_known_no_longer() -> None:
    """One BASE_IMU of 10 deg/s, and then BASE_MOTION alone: odometry would turn for ever by the one frame."""
    driver = driver_of("twist_base")
    told(driver, MOTION, 0.0)
    sample = told(driver, IMU, 0.0, struct.pack(">4h", 1000, 0, 0, 1000))
    assert sample.yaw_rate_rad_s == pytest.approx(math.radians(10.0))
    assert told(driver, MOTION, 0.25).acceleration_m_s2[2] == pytest.approx(9.80665)
    sample = told(driver, MOTION, 0.26)
    assert math.isnan(sample.yaw_rate_rad_s)
    assert all(map(math.isnan, sample.acceleration_m_s2))
    assert told(driver, IMU, 0.3).yaw_rate_rad_s == 0.0


def test_positions_that_fell_silent_make_the_sample_old_and_never_take_it_back() -> None:
    signals = {"fl": "BASE_IMU.TurnRate", "fr": "BASE_IMU.X", "rr": "BASE_IMU.Y", "rl": "BASE_IMU.Z"}
    gone = {"feedback.yaw_rate": None, "feedback.acceleration": None}
    driver = driver_of("twist_base", {"feedback.position": signals | {"scale": 1.0, "wraps_at": 1e9}} | gone)
    driver.feed(Frame(MOTION, bytes(8)), 0)
    assert driver.sample is None
    assert driver.missing.startswith("nothing received of BASE_IMU (0x18ff0300)")
    told(driver, IMU, 0.0)
    stamps = [told(driver, MOTION, seconds).stamp_ns for seconds in (0.1, 0.2, 0.3, 0.4)]
    assert stamps == [100_000_000, 200_000_000, 250_000_000, 250_000_000]
    told(driver, IMU, 0.5)
    assert told(driver, MOTION, 0.5).stamp_ns == 500_000_000


@pytest.mark.parametrize("table", ["armed_when", "errors"])
def test_a_state_and_an_error_that_are_told_no_longer_stop_the_robot(table: str) -> None:
    """DRIVES_INFO, every 100 ms by the DBC, has it: half a second of silence is none."""
    rule = {"DRIVES_INFO": {"Protocol": 3}} if table == "armed_when" else {"robot": "DRIVES_INFO.Protocol", "none": 3}
    rig = armed(drives(**{"identity": None, table: rule}))
    end_ns = rig.now_ns
    for late_ns in (450_000_000, 650_000_000):
        for number in range(0x120, 0x124):
            rig.driver.feed(Frame(number, bytes.fromhex("0000000000200000")), end_ns + late_ns)
        assert rig.driver.is_armed is (table == "errors" or late_ns < 500_000_000)
    [error] = rig.driver.errors
    assert error == (
        "nothing received of DRIVES_INFO (0x130), which reports errors or states, for more than 0.5 s (its period is "
        "GenMsgCycleTime in the DBC)"
    )


def test_an_error_that_is_told_no_longer_and_has_no_period_is_too_old_after_a_quarter_of_a_second() -> None:
    changes = {"errors": {"robot": "BASE_IMU.TurnRate"}, "feedback.yaw_rate": None}
    driver = driver_of("twist_base", changes)
    told(driver, MOTION, 0.0)
    driver.feed(Frame(IMU, bytes(8)), 0)
    told(driver, MOTION, 0.25)
    assert driver.errors == []
    told(driver, MOTION, 0.26)
    assert driver.errors == [
        "nothing received of BASE_IMU (0x18ff0300), which reports errors or states, for more than 0.25 s (the DBC "
        "gives it no period: add GenMsgCycleTime, a long one if it is sent on changes alone)"
    ]


DRIVERS = {name: driver_of(name) for name in ("wheel_drives", "twist_base")}


@given(st.sampled_from(sorted(DRIVERS)), st.integers(0, 0xFFFF_FFFF), st.binary(max_size=64), st.data())
def test_no_frame_is_too_strange(name: str, number: int, payload: bytes, data: st.DataObject) -> None:
    driver = DRIVERS[name]
    known = data.draw(st.sampled_from([0x120, 0x121, 0x122, 0x123, 0x130, EXTENDED | 0x18FF0200, number]))
    driver.feed(Frame(known, payload), 0)
    sample = driver.sample
    assert sample is None or all(map(math.isfinite, sample.speed_rad_s))
    assert all(isinstance(error, str) for error in driver.errors)
    assert driver.is_armed is False


@given(st.tuples(*[st.floats(-60.0, 60.0)] * 4), st.tuples(*[st.floats(-5.0, 5.0)] * 4))
def test_every_command_arrives_within_half_a_step(speed: FourWheels, torque: FourWheels) -> None:
    frames = DRIVERS["wheel_drives"].command(speed, torque, 0)
    for frame, speed_rad_s, torque_n_m in zip(frames, speed, torque, strict=True):
        rpm, newton_metres = struct.unpack_from("<hh", frame.payload, 1)
        assert abs(0.5 * rpm - speed_rad_s * RPM_AT_MOTOR) <= 0.2501
        assert abs(0.001 * newton_metres - torque_n_m / 20.0) <= 0.000501


def test_what_is_beyond_a_signal_is_sent_as_its_limit() -> None:
    frames = DRIVERS["wheel_drives"].command((1e9, -1e9, math.inf, 0.0), (1e9, 0.0, 0.0, 0.0), 0)
    assert [struct.unpack_from("<h", frame.payload, 1)[0] for frame in frames] == [24000, -24000, 24000, 0]


def test_a_command_that_cannot_say_zero_is_refused(tmp_path: Path) -> None:
    speed = 'TargetSpeed : 8|16@1- (0.5,0) [-12000|12000] "rpm"'
    file = edited_dbc(tmp_path, "wheel_drives", (speed, 'TargetSpeed : 8|16@1+ (0.7,-20000) [-12000|12000] "rpm"'))
    with pytest.raises(BadInputError, match=r"TargetSpeed goes in steps of 0.7 from an offset of -20000, .* is -0.3,"):
        driver_of("wheel_drives", {"file": file})
    file = edited_dbc(tmp_path, "wheel_drives", (speed, 'TargetSpeed : 8|16@1+ (0.7,-21000) [-12000|12000] "rpm"'))
    assert driver_of("wheel_drives", {"file": file}).disarm()


def test_numbers_that_are_none_are_not_heard(tmp_path: Path) -> None:
    file = edited_dbc(
        tmp_path,
        "twist_base",
        ('SG_ TurnRate : 7|16@0- (0.01,0) [-300|300] "deg/s"', 'SG_ TurnRate : 7|32@0- (1,0) [0|0] "deg/s"'),
        (' SG_ X : 23|16@0- (0.001,0) [-16|16] "g" HOST\n', ""),
        (' SG_ Y : 39|16@0- (0.001,0) [-16|16] "g" HOST\n', ""),
        (' SG_ Z : 55|16@0- (0.001,0) [-16|16] "g" HOST\n', "\nSIG_VALTYPE_ 2566849280 TurnRate : 1;\n"),
    )
    driver = driver_of("twist_base", {"file": file, "feedback.acceleration": None})
    driver.feed(Frame(EXTENDED | 0x18FF0200, bytes(8)), 0)
    for degrees, expected in (
        (90.0, math.pi / 2),
        (math.nan, math.pi / 2),
        (math.inf, math.pi / 2),
        (-90.0, -math.pi / 2),
    ):
        driver.feed(Frame(EXTENDED | 0x18FF0300, struct.pack(">f4x", degrees)), 0)
        assert driver.sample is not None
        assert driver.sample.yaw_rate_rad_s == pytest.approx(expected)


@pytest.mark.parametrize("rpm", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_not_obeyed_by_the_emulated_drives(tmp_path: Path, rpm: float) -> None:
    types = "".join(f"SIG_VALTYPE_ {number} TargetSpeed : 1;\n" for number in (272, 273, 274, 275))
    file = edited_dbc(
        tmp_path,
        "wheel_drives",
        ("TargetSpeed : 8|16@1- (0.5,0)", "TargetSpeed : 8|32@1- (1,0)"),
        ("Feedforward : 24|16", "Feedforward : 40|16"),
        ("VAL_ 256 State", f"{types}VAL_ 256 State"),
    )
    rig = armed(Rig("dbc", motors("wheel_drives", {"file": file})))
    rig.drive(0.5, ramp_to(FORWARD, 0.3))
    command = next(iter(rig.driver.command(FORWARD, STILL, rig.now_ns)))
    rig.step([Frame(command.id, command.payload[:1] + struct.pack("<f", rpm) + command.payload[5:])], ticks=1)
    assert all(math.isfinite(torque) for torque in rig.node.torque_n_m)
    rig.drive(0.2, lambda _t: (FORWARD, STILL))
    assert_near(rig.speeds(), FORWARD, 0.2)
