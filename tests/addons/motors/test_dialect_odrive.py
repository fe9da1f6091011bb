"""ODrive CANSimple: the driver before its emulated axes, of firmware 0.5 and 0.6, and what is wrong with either."""

import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.framing import Frame
from hil.addons.motors.odrive.emulated_odrive import EmulatedODrive
from hil.addons.motors.odrive.odrive_tables import Endpoint
from hil.core.errors import BadInputError
from hil.core.options import build
from hil.core.types import CommandMode
from hil.robot.driver import EXTENDED, REMOTE
from hil.robot.driver_registry import dialect
from tests.support.dialect_testbed import STILL, Rig, assert_near, assert_position_follows, assert_told, ramp_to

FORWARD = (8.0, 8.0, 8.0, 8.0)
WATCHED = {"watchdog_endpoints": [311, 312], "endpoints_firmware": "0.6.11", "endpoints_hardware": "4.4.58"}


def armed(settings: dict[str, Any], **keywords: Any) -> Rig:
    rig = Rig("odrive", settings, **keywords)
    rig.greet()
    rig.arm()
    return rig


def emulated(rig: Rig) -> EmulatedODrive:
    assert isinstance(rig.node, EmulatedODrive)
    return rig.node


def until_told(rig: Rig) -> str:
    """Go on with standstill until an error is told."""
    for _ in range(60):
        if rig.driver.errors:
            return "; ".join(rig.driver.errors)
        rig.step(rig.driver.command(STILL, STILL, rig.now_ns))
    raise AssertionError("nothing was told")


def test_the_worked_frame_of_two_and_a_half_turns_a_second() -> None:
    """Node 3, motor 2.5 rev/s: 06D # 00002040 00000000; behind a gear of 5 the wheel turns at a fifth of that."""
    rig = Rig("odrive", {"node_ids": [3, 0, 1, 2], "gear_ratio": 5.0})
    wheel = 2.5 / 5.0 * 2 * 3.141592653589793
    first, *_ = rig.driver.command((wheel, 0.0, 0.0, 0.0), STILL, 0)
    assert first == Frame(0x06D, bytes.fromhex("0000204000000000"))


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
@pytest.mark.parametrize("more", [{}, {"feedback_hz": 0, "gear_ratio": 9.0, "node_ids": [62, 0, 17, 5]}])
def test_wheels_reach_their_speeds_and_the_position_follows(firmware: str, more: dict[str, Any]) -> None:
    rig = armed({"firmware": firmware, **more})
    rig.drive(1.0, ramp_to(FORWARD))
    assert_told(rig, FORWARD, 0.1)
    assert_position_follows(rig, FORWARD, 0.1)
    assert rig.driver.is_armed
    assert abs(rig.driver.sample.battery_v - rig.node.battery_v) < 0.1


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_torques_are_those_at_the_wheel(firmware: str) -> None:
    rig = armed({"firmware": firmware, "gear_ratio": 4.0}, mode=CommandMode.TORQUE)
    rig.drive(0.02, lambda _t: (STILL, (0.2, -0.1, 0.05, 0.0)))
    assert_near(rig.node.torque_n_m, (0.2, -0.1, 0.05, 0.0), 1e-6)


def test_a_torque_is_added_to_the_speed_loops() -> None:
    rig = armed({})
    rig.step(rig.driver.command(STILL, (0.3, 0.0, 0.0, -0.3), rig.now_ns), ticks=1)
    assert_near(rig.node.torque_n_m, (0.3, 0.0, 0.0, -0.3), 0.05)


def test_the_temperature_is_known_of_0_6_alone() -> None:
    for firmware, is_known in (("0.5", False), ("0.6", True)):
        rig = Rig("odrive", emulated_settings={"firmware": firmware})
        assert "temperature" in rig.driver.capabilities.sensors, "as long as it may be 0.6"
        rig.greet()
        assert ("temperature" in rig.driver.capabilities.sensors) is is_known
        rig.arm()
        rig.drive(0.2, lambda _t: (STILL, STILL))
        assert rig.driver.sample is not None
        assert all((t == t) is is_known for t in rig.driver.sample.temperature_degc)


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_the_input_that_another_host_left_is_never_driven(firmware: str) -> None:
    """Inputs survive idle: without the standstill that is sent before it, closed loop would take them up."""
    rig = Rig("odrive", {"firmware": firmware})
    rig.greet()
    for axis in emulated(rig).axes:
        axis.control_mode, axis.input_vel_rev_s = 2, 5.0
    for _ in range(60):
        rig.step(rig.driver.arm(rig.now_ns))
        assert_near(rig.speeds(), STILL, 1e-3)
    assert rig.driver.is_armed


def test_an_idle_axis_has_no_error_while_another_one_is_driven() -> None:
    rig = Rig("odrive")
    first, *others = emulated(rig).axes
    first.control_mode = 2
    first.request(8, rig.node.ticks)
    rig.step(ticks=5)
    assert emulated(rig).is_driving
    assert not any(axis.has_errors for axis in others)


def test_axes_that_another_host_left_turning_are_stopped() -> None:
    rig = armed({})
    rig.drive(1.0, ramp_to(FORWARD))
    rig.driver.restart()
    rig.greet()
    assert emulated(rig).is_driving
    rig.arm()
    assert any(frame.payload[:4] == b"\1\0\0\0" for frame in rig.sent if frame.id == 0x007)
    rig.drive(0.5, lambda _t: (STILL, STILL))
    assert rig.is_still()


# Watchdog


def test_the_watchdog_of_0_6_is_set_and_read_back_before_arming_and_stops_the_wheels() -> None:
    rig = armed(WATCHED)
    assert rig.driver.capabilities.watchdog == "set"
    assert len(rig.driver.warnings) == 1
    assert all(axis.enable_watchdog and abs(axis.watchdog_timeout_s - 0.1) < 1e-6 for axis in emulated(rig).axes)
    sent = [frame.id & 0x1F for frame in rig.sent if frame.id >> 5 == 0]
    assert max(n for n, command in enumerate(sent) if command == 0x04) < sent.index(0x07)
    rig.drive(0.5, ramp_to(FORWARD))
    rig.step(ticks=1000)
    assert not rig.driver.is_armed
    assert all("WATCHDOG_TIMER_EXPIRED" in error for error in rig.driver.errors)
    assert rig.node.torque_n_m == STILL


def test_the_watchdog_that_odrivetool_set_stops_the_wheels_of_0_5() -> None:
    rig = Rig("odrive", {"firmware": "0.5"})
    rig.greet()
    for axis in emulated(rig).axes:
        axis.enable_watchdog, axis.watchdog_timeout_s, axis.fed_tick = True, 0.2, rig.node.ticks
    rig.arm()
    rig.drive(0.5, ramp_to(FORWARD))
    rig.step(ticks=1000)
    assert "ODrive node 0 of wheel fl: axis error WATCHDOG_TIMER_EXPIRED" in rig.driver.errors[0]
    assert rig.node.torque_n_m == STILL


@pytest.mark.parametrize(
    ("firmware", "remedy"),
    [
        (
            "0.5",
            "firmware 0.5 does not report it over CAN, set enable_watchdog and watchdog_timeout with odrivetool",
        ),
        ("0.6", "give device.motors.watchdog_endpoints, or set enable_watchdog with odrivetool"),
    ],
)
def test_without_a_watchdog_the_wheels_turn_on_and_that_is_said_before(firmware: str, remedy: str) -> None:
    rig = armed({"firmware": firmware})
    assert rig.driver.capabilities.watchdog == "none"
    assert rig.driver.warnings[1:] == [
        "it is not known whether the ODrives have a watchdog; without one the wheels turn on when this computer dies: "
        f"{remedy}"
    ]
    rig.drive(0.5, ramp_to(FORWARD))
    rig.step(ticks=1000)
    assert_near(rig.speeds(), FORWARD, 0.1)


@pytest.mark.parametrize(
    ("theirs", "told"),
    [
        ({"watchdog_endpoints": [400, 401]}, "endpoint 311) could not be set and read back"),
        ({"watchdog_endpoints": [500, 311]}, "endpoint 311 is not axis0.config.watchdog_timeout"),
    ],
)
def test_endpoints_that_are_others_are_not_written_to_and_nothing_is_armed(theirs: dict[str, Any], told: str) -> None:
    rig = Rig("odrive", WATCHED, emulated_settings=WATCHED | theirs)
    rig.greet()
    with pytest.raises(AssertionError, match="not armed"):
        rig.arm()
    assert told in rig.driver.errors[0]
    assert not any(axis.enable_watchdog for axis in emulated(rig).axes)


def test_the_confirmation_of_a_write_is_not_taken_for_what_was_read_back() -> None:
    """What 0.6.11 puts into it is not known: here it says zero, and comes a period late."""
    rig = Rig("odrive", WATCHED | {"endpoints_firmware": "0.6.10"})
    rig.greet()
    late: list[Frame] = []
    writes = 0
    for _ in range(200):
        frames = rig.driver.arm(rig.now_ns)
        rig.step()
        for frame in late:
            rig.driver.feed(frame, rig.now_ns)
        rig.step(frames, ticks=0)  # they are answered in the next period
        written = [frame for frame in frames if frame.id & 0x1F == 0x04 and frame.payload[0] == 1]
        late = [Frame(frame.id + 1, b"\0" + frame.payload[1:4] + bytes(4)) for frame in written]
        writes += len(written)
    assert rig.driver.is_armed
    assert writes == 8


# Errors


@pytest.mark.parametrize(
    ("firmware", "fault", "words"),
    [
        ("0.5", {"axis": 0x4000}, "axis error ESTOP_REQUESTED"),
        ("0.5", {"motor": 1 << 32 | 8}, "motor error DRV_FAULT, UNKNOWN_VOLTAGE_COMMAND"),
        ("0.5", {"encoder": 4}, "encoder error NO_RESPONSE"),
        ("0.5", {"controller": 1}, "controller error OVERSPEED"),
        ("0.6", {"axis": 0x0400_0020}, "axis error DRV_FAULT, SPINOUT_DETECTED"),
        ("0.6", {"axis": 0x8000_0000}, "axis error 0x80000000"),
    ],
)
def test_an_error_is_decoded_by_its_wheel_ends_closed_loop_and_stays_until_cleared(
    firmware: str, fault: dict[str, int], words: str
) -> None:
    rig = armed({"firmware": firmware})
    emulated(rig).axes[1].fail(**fault)
    assert "node 1 of wheel fr" in until_told(rig)
    assert not rig.driver.is_armed
    for _ in range(40):
        rig.step(rig.driver.arm(rig.now_ns))
    assert not rig.driver.is_armed
    assert words in rig.driver.errors[0]
    assert rig.driver.errors[0].count(words.split()[-1]) == 1  # though 0.6 says it in three places
    rig.step(rig.driver.clear())
    rig.arm()
    assert not rig.driver.errors


def test_an_error_that_another_host_cleared_is_there_no_longer() -> None:
    rig = armed({"firmware": "0.5"})
    emulated(rig).axes[1].fail(motor=8)
    rig.step(rig.driver.arm(rig.now_ns), ticks=100)
    for _ in range(40):
        rig.step(rig.driver.arm(rig.now_ns))
    assert "motor error DRV_FAULT" in rig.driver.errors[0]
    emulated(rig).axes[1].clear()
    rig.driver.disarm()
    rig.step(ticks=100)
    assert not rig.driver.errors


def test_an_error_of_before_is_known_once_it_is_known_who_is_there() -> None:
    """The heartbeats that came before the version could not be understood."""
    rig = Rig("odrive")
    emulated(rig).axes[1].fail(axis=0x20)
    rig.step()
    rig.greet()
    assert rig.driver.errors == ["ODrive node 1 of wheel fr: axis error DRV_FAULT"]


def test_what_the_heartbeat_of_0_5_only_hints_at_is_read_when_all_are_stopped() -> None:
    rig = armed({"firmware": "0.5"})
    rig.driver.feed(Frame(0x041, bytes.fromhex("0000000001010000")), rig.now_ns)
    assert rig.driver.errors == [
        "ODrive node 2 of wheel rr: motor error, not read yet; left closed loop by itself",
    ]
    emulated(rig).axes[2].fail(motor=0x8)
    rig.step(rig.driver.disarm(), ticks=1)
    assert rig.driver.errors == ["ODrive node 2 of wheel rr: motor error DRV_FAULT"]


def test_a_silent_axis_makes_the_whole_sample_old() -> None:
    rig = armed({})
    for node in (0, 1, 3):
        rig.driver.feed(Frame(node << 5 | 0x09, bytes(8)), rig.now_ns + 1_000_000_000)
    assert rig.driver.sample is not None
    assert rig.driver.sample.stamp_ns <= rig.now_ns


def test_what_an_axis_answers_no_longer_is_not_known() -> None:
    """All that is asked for comes round within 100 ms at 200 Hz, and counts for five times as long."""
    rig = armed({})
    rig.drive(0.3, lambda _t: (STILL, STILL))
    begin_ns = rig.now_ns
    for late_s, are_known in ((0.35, True), (0.65, False)):
        for node in range(4):
            rig.driver.feed(Frame(node << 5 | 0x09, bytes(8)), begin_ns + round(late_s * 1e9))
        sample = rig.driver.sample
        assert sample is not None
        told = (*sample.current_a, *sample.temperature_degc, sample.battery_v, sample.battery_a)
        assert [value == value for value in told] == [are_known] * 10
        assert sample.speed_rad_s == STILL


def test_a_heartbeat_on_its_way_when_errors_were_cleared_is_no_new_error() -> None:
    rig = armed({})
    emulated(rig).axes[1].fail(axis=0x20)
    until_told(rig)
    late = Frame(0x021, bytes.fromhex("2000000001030000"))
    rig.step(rig.driver.clear(), ticks=1)
    rig.driver.feed(late, rig.now_ns)
    assert not rig.driver.errors
    rig.driver.feed(late, rig.now_ns)
    assert rig.driver.errors


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_an_estop_is_latched_and_commands_do_not_end_it(firmware: str) -> None:
    rig = armed({"firmware": firmware})
    rig.drive(0.5, ramp_to(FORWARD))
    rig.step(rig.driver.estop())
    assert not rig.driver.is_armed
    rig.drive(0.3, lambda _t: (FORWARD, STILL))
    assert rig.node.torque_n_m == STILL
    assert all("ESTOP_REQUESTED" in error for error in rig.driver.errors)


def test_an_axis_that_goes_idle_by_itself_is_named() -> None:
    rig = armed({})
    emulated(rig).axes[2].fail()
    assert until_told(rig) == "ODrive node 2 of wheel rr: left closed loop by itself: its procedure result is 3"
    assert not rig.driver.is_armed


@pytest.mark.parametrize(("firmware", "why"), [("0.5", "INVALID_STATE"), ("0.6", "its procedure result is 14")])
def test_an_axis_that_is_not_calibrated_refuses_closed_loop_and_says_so(firmware: str, why: str) -> None:
    rig = Rig("odrive", {"firmware": firmware})
    rig.greet()
    emulated(rig).axes[3].is_calibrated = False
    with pytest.raises(AssertionError, match="not armed"):
        rig.arm()
    assert "node 3 of wheel rl" in rig.driver.errors[0]
    assert why in rig.driver.errors[0]


def test_an_axis_that_another_host_drives_on_is_not_armed() -> None:
    """It is asked three times to become idle, and stays in closed loop."""
    rig = Rig("odrive")
    rig.greet()
    axis = emulated(rig).axes[1]
    axis.control_mode = 2
    axis.request(8, rig.node.ticks)
    rig.step(ticks=100)
    asked: list[Frame] = []
    for _ in range(400):
        frames = rig.driver.arm(rig.now_ns)
        asked += [frame for frame in frames if frame.id == 0x027]
        rig.step([frame for frame in frames if frame.id != 0x027])
    assert rig.driver.errors == ["ODrive node 1 of wheel fr: does not become idle"]
    assert asked == 3 * [Frame(0x027, b"\1" + bytes(7))]


def test_an_axis_without_heartbeats_is_in_closed_loop_as_far_as_nobody_knows() -> None:
    rig = armed({})
    for frame in rig.driver.command(STILL, STILL, rig.now_ns + 1_200_000_000):
        assert not frame.id & EXTENDED
    assert not rig.driver.is_armed
    assert all(error.endswith("no heartbeat for more than a second") for error in rig.driver.errors)


def test_disarming_leaves_closed_loop_and_twice_is_right_too() -> None:
    rig = armed({})
    rig.drive(0.5, ramp_to(FORWARD))
    rig.step(rig.driver.disarm())
    rig.step(rig.driver.disarm())
    assert not rig.driver.is_armed
    assert not rig.node.is_driving


# Who is there


def told_of(rig: Rig) -> str:
    """Ask for a while, and return what is missing."""
    for _ in range(30):
        assert rig.driver.identity is None
        rig.step(rig.driver.ask())
    return rig.driver.missing


def test_both_firmwares_are_told_apart_on_one_bus() -> None:
    rig = Rig("odrive")
    assert rig.greet() == "ODrive axes: nodes 0, 1, 2, 3 with firmware 0.6.10 on hardware 4.4.58"
    rig = Rig("odrive", emulated_settings={"firmware": "0.5"})
    assert rig.greet() == "ODrive axes: nodes 0, 1, 2, 3 with firmware 0.5.4 or newer of 0.5"


def test_a_lost_answer_to_get_version_does_not_make_0_6_a_0_5() -> None:
    """0.6 answers with powers where 0.5 reports its controller's errors; one late answer with the version counts."""
    rig = Rig("odrive")
    for _ in range(10):
        for frame in rig.driver.ask():
            if frame.id & 0x1F:
                rig.node.receive(frame)
        rig.step()
    rig.step(rig.driver.ask())
    assert "0.6.10" in rig.greet()


@pytest.mark.parametrize(("firmware", "expected"), [((0, 7, 1), "0.7.1"), ((1, 0, 0), "1.0.0")])
def test_a_firmware_that_nobody_knows_is_refused(firmware: tuple[int, int, int], expected: str) -> None:
    rig = Rig("odrive")
    emulated(rig).firmware = firmware
    said = f"^ODrive node 0 has firmware {expected}: expected 0.5 or 0.6; install one of these with odrivetool$"
    with pytest.raises(BadInputError, match=said):
        rig.greet()


def test_a_firmware_before_0_5_4_cannot_be_known_and_is_to_be_updated() -> None:
    rig = Rig("odrive", {"firmware": "0.5"})
    emulated(rig).firmware = (0, 5, 1)
    assert "answer neither Get_Version nor Get_Controller_Error" in told_of(rig)


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ({"firmware": "0.5"}, {}, "has firmware 0.6, but device.motors.firmware is 0.5"),
        (
            WATCHED,
            {"firmware": "0.5"},
            "has firmware 0.5 on hardware unknown: device.motors.watchdog_endpoints are",
        ),
        (WATCHED, {}, "has firmware 0.6.10 on hardware 4.4.58: device.motors.watchdog_endpoints are those of 0.6.11"),
    ],
)
def test_what_is_not_as_the_settings_say_is_refused(ours: Any, theirs: Any, expected: str) -> None:
    rig = Rig("odrive", ours, emulated_settings=theirs)
    with pytest.raises(BadInputError, match=expected):
        rig.greet()


def test_what_is_missing_is_named() -> None:
    assert told_of(Rig("odrive", {"node_ids": [0, 1, 7, 9]}, emulated_settings={})).startswith(
        "no heartbeat from the nodes 7, 9;"
    )
    rig = Rig("odrive", emulated_settings={"feedback_hz": 0})
    assert "set config.can.encoder_msg_rate_ms (0.5: encoder_rate_ms) with odrivetool" in told_of(rig)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"node_ids": [0, 1, 2]}, "expected four different ones, each 0 to 62"),
        ({"node_ids": [0, 1, 2, 63]}, "expected four different ones, each 0 to 62"),
        ({"feedback_hz": 2000}, "from 0 to 1000"),
        ({"gear_ratio": 0}, "greater than 0"),
        (WATCHED | {"watchdog_endpoints": [311]}, "expected the ids of axis0.config.watchdog_timeout and"),
        (WATCHED | {"endpoints_hardware": "S1"}, "endpoints_hardware = 'S1': expected what the flat_endpoints.json"),
        (WATCHED | {"firmware": "0.5"}, "firmware 0.5 has no endpoints"),
        ({"endpoints_firmware": "0.6.10"}, "expected the ids"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any], expected: str) -> None:
    with pytest.raises(BadInputError, match=expected):
        build(dialect("odrive").settings, settings, "device.motors")


@pytest.mark.parametrize("firmware", ["0.5", "0.6"])
def test_a_probe_finds_axes_by_remote_frames_of_two_kinds_alone(firmware: str) -> None:
    rig = Rig("odrive", {"firmware": firmware, "node_ids": [3, 9, 16, 40]})
    made = dialect("odrive").probe
    assert made is not None
    probe = made()
    assert probe.ask() == []
    for _ in range(25):
        asked = probe.ask()
        assert all(frame.id & REMOTE and frame.id & 0x1F in (0x00, 0x1D) for frame in asked)
        rig.step(asked)
        for frame in rig.heard:
            probe.feed(frame)
        rig.heard.clear()
    found = probe.found()
    assert found is not None
    assert found.motors == {"node_ids": [3, 9, 16, 40]}
    assert all(f"firmware {firmware}" in sentence for sentence in found.sentences)


def test_a_probe_takes_no_frame_that_looks_like_a_heartbeat_for_an_axis() -> None:
    """A C620 of id 1 sends 0x201: node 16's heartbeat, by the identifier."""
    made = dialect("odrive").probe
    assert made is not None
    probe = made()
    probe.feed(Frame(0x201, bytes.fromhex("080003E8FCCD2800")))
    probe.feed(Frame(0x201, bytes.fromhex("080003E801CD2800")))
    assert [frame.id for frame in probe.ask()] == [REMOTE | 0x200, REMOTE | 0x21D]
    assert probe.found() is None


@pytest.mark.parametrize(
    ("when", "payload"), [("before", "0204043A00060A00"), ("after", "0200043A00060A00"), ("after", "0204043A00B10A00")]
)
def test_a_probe_takes_no_version_that_was_not_asked_for_or_cannot_be(when: str, payload: str) -> None:
    """Our own robot's 0x080 and 0x081 are node 4's version and heartbeat, by the identifiers."""
    made = dialect("odrive").probe
    assert made is not None
    probe = made()
    assert probe.feed(Frame(0x081, bytes.fromhex("0000000001000000")))
    asked = probe.ask() if when == "after" else ()
    probe.feed(Frame(0x080, bytes.fromhex(payload)))
    assert probe.found() is None
    asked = asked or probe.ask()
    assert [frame.id for frame in asked] == [REMOTE | 0x080, REMOTE | 0x09D]
    probe.feed(Frame(0x080, bytes.fromhex("0204043A00060A00")))
    assert probe.found() is not None


RIGS = [Rig("odrive", {"firmware": firmware}) for firmware in ("0.5", "0.6")]
COMMANDS = st.one_of(st.integers(0, 0x7F), st.integers(0, 2**32 - 1))


@given(st.lists(st.tuples(COMMANDS, st.binary(max_size=8) | st.binary(min_size=8, max_size=8)), max_size=8))
def test_no_frame_is_too_strange(frames: list[tuple[int, bytes]]) -> None:
    for rig in RIGS:
        for number, payload in frames:
            rig.driver.feed(Frame(number, payload), 0)
            sample = rig.driver.sample
            assert sample is None or all(abs(speed) <= 3.4028235e38 * 6.3 for speed in sample.speed_rad_s)
            assert len(rig.driver.errors) <= 4
            assert rig.driver.missing or rig.driver.is_armed in (False, True)
        rig.driver.restart()


@given(st.floats(width=32, allow_nan=False, allow_infinity=False), st.floats(width=32))
def test_estimates_are_taken_as_they_are_or_not_at_all(position: float, speed: float) -> None:
    driver = RIGS[1].driver
    driver.restart()
    for node in range(4):
        refused = driver.feed(Frame(node << 5 | 0x09, struct.pack("<ff", position, speed)), 3)
    sample = driver.sample
    assert refused == (None if speed - speed == 0.0 else "a position or speed that is not finite")
    if speed - speed != 0.0:
        assert sample is None
    else:
        assert sample is not None
        assert sample.position_rad == (position * 2 * 3.141592653589793,) * 4
        assert sample.speed_rad_s == (speed * 2 * 3.141592653589793,) * 4


@pytest.mark.parametrize(
    ("target", "value", "is_plausible"),
    [
        (b"\x01", b"\x00", True),
        (b"\x01", b"\x01", True),
        (b"\x01", b"\x02", False),
        *[
            (struct.pack("<f", 0.05), struct.pack("<f", value), value in (0.0, 0.5, 3e38))
            for value in (0.0, 0.5, 3e38, -1e-9, -1.0, math.inf, math.nan)
        ],
        (struct.pack("<f", 0.05), b"\x00\x00\x00", False),
        (struct.pack("<f", 0.05), bytes(8), False),
    ],
)
def test_a_parameter_that_can_be_no_such_one_is_not_written(target: bytes, value: bytes, is_plausible: bool) -> None:
    assert Endpoint("axis0.config.watchdog_timeout", 311, target).is_plausible(value) is is_plausible
