"""moteus: what the maker's package and moteus_tool send, before the emulated ones; the package itself drives here."""

import asyncio
import math
import struct
from typing import Any

import moteus
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moteus import Mode, Register
from moteus.moteus_tool import Stream as ToolStream

from firmware_protocol.framing import Frame
from hil.drivers.port import EXTENDED
from tests.dialect_testbed import Rig
from tests.moteus_bus import EmulatedBus, controller

NAN = math.nan


@pytest.fixture
def rig() -> Rig:
    return Rig("moteus")


def values(result: Any) -> dict[int, float]:
    """Return the registers of an answer of the package."""
    assert result is not None
    found: dict[int, float] = result.values
    return found


async def repeat(times: int, command: Any, **settings: Any) -> dict[int, float]:
    """Command so often, each with a query; return the last answer."""
    answer: dict[int, float] = {}
    for _ in range(times):
        answer = values(await command(query=True, **settings))
    return answer


def test_what_the_package_asks_for_by_default_and_beyond_is_told(rig: Rig) -> None:
    query = moteus.QueryResolution()
    for name in ("q_current", "d_current", "power", "motor_temperature", "trajectory_complete", "home_state"):
        setattr(query, name, moteus.F32)
    one = moteus.Controller(id=1, query_resolution=query, transport=moteus.Transport([EmulatedBus(rig)]))
    told = values(asyncio.run(one.query()))
    default = values(asyncio.run(controller(rig).query()))
    assert set(default) == {0x00, 0x01, 0x02, 0x03, 0x0D, 0x0E, 0x0F}
    assert set(told) == set(default) | {0x04, 0x05, 0x07, 0x0A, 0x0B, 0x0C}
    assert (told[Register.MODE], told[Register.FAULT]) == (Mode.STOPPED, 0)
    assert told[Register.VOLTAGE] == pytest.approx(rig.node.battery_v, abs=0.3)


def test_all_four_are_found_by_their_uuids(rig: Rig) -> None:
    bus = EmulatedBus(rig)
    found = asyncio.run(moteus.Transport([bus]).discover(timeout=0.01))
    assert [device.can_id for device in found] == [1, 2, 3, 4]
    assert [device.uuid for device in found] == [servo.uuid for servo in rig.node.servos]
    by_uuid = moteus.Controller(
        id=moteus.DeviceAddress(uuid=found[2].uuid, transport_device=bus), transport=moteus.Transport([bus])
    )
    asyncio.run(by_uuid.set_current(d_A=0.0, q_A=1.0))
    rig.step(ticks=20)
    assert [servo.mode for servo in rig.node.servos] == [0, 0, 9, 0]


def test_a_current_makes_its_torque_and_nothing_ends_it_but_a_stop(rig: Rig) -> None:
    one = controller(rig)
    asyncio.run(repeat(5, one.set_current, d_A=0.0, q_A=0.5))
    assert rig.node.torque_n_m[0] == pytest.approx(0.5 * rig.node.values["torque_constant_n_m_a"])
    rig.step(ticks=1000)
    assert rig.node.servos[0].mode == Mode.CURRENT, "the watchdog is of position mode and of stay within"
    assert rig.speeds()[0] > 1.0
    asyncio.run(repeat(2, one.set_current, d_A=0.0, q_A=1e6))
    assert rig.node.torque_n_m[0] == pytest.approx(rig.node.values["torque_limit_n_m"])
    stopped = asyncio.run(repeat(2, one.set_stop))
    assert stopped[Register.MODE] == Mode.STOPPED
    assert not rig.node.is_driving


def test_a_brake_shorts_the_windings(rig: Rig) -> None:
    one = controller(rig, ticks=20)
    asyncio.run(repeat(30, one.set_position, position=NAN, velocity=1.0))
    turning = rig.speeds()[0]
    assert turning == pytest.approx(math.tau, rel=0.1)
    asyncio.run(repeat(1, one.set_brake))
    assert rig.node.servos[0].mode == Mode.BRAKE
    assert rig.node.torque_n_m[0] < 0.0
    rig.step(ticks=200)
    assert abs(rig.speeds()[0]) < 0.5 * turning


def test_a_voltage_turns_the_field_and_the_wheel_behind_it(rig: Rig) -> None:
    one = controller(rig)
    poles = rig.node.servos[0].config["motor.poles"]
    asyncio.run(repeat(20, one.set_vfoc, theta=0.0, voltage=2.0))
    begin = values(asyncio.run(one.query()))[Register.POSITION]
    for step in range(1, 41):
        asyncio.run(repeat(10, one.set_vfoc, theta=math.remainder(0.1 * math.pi * step, math.tau), voltage=2.0))
    end = values(asyncio.run(one.query()))[Register.POSITION]
    assert end - begin == pytest.approx(2.0 * 2.0 / poles, abs=0.25 / poles)  # 4 half turns of the field
    asyncio.run(repeat(3, one.set_vfoc, theta=0.0, voltage=2.0, theta_rate=math.pi))
    rig.step(ticks=2000)
    after = values(asyncio.run(one.query()))
    assert after[Register.POSITION] > end + 1.0 / poles
    assert after[Register.MODE] == Mode.VOLTAGE_FOC


def test_within_its_bounds_a_wheel_is_free_and_beyond_them_held_until_the_watchdog(rig: Rig) -> None:
    one = controller(rig)
    begin = values(asyncio.run(one.query()))[Register.POSITION]
    bounds = {"lower_bound": begin - 0.1, "upper_bound": begin + 0.1, "watchdog_timeout": 0.1}
    asyncio.run(repeat(10, one.set_stay_within, **bounds))
    assert rig.node.torque_n_m[0] == 0.0
    held = asyncio.run(repeat(150, one.set_stay_within, feedforward_torque=0.2, **bounds))
    assert held[Register.MODE] == Mode.STAY_WITHIN
    assert begin + 0.1 < held[Register.POSITION] < begin + 0.2
    asyncio.run(repeat(20, one.set_stay_within, feedforward_torque=-5.0, maximum_torque=0.05, **bounds))
    assert rig.node.torque_n_m[0] == pytest.approx(-0.05)
    rig.step(ticks=110)
    assert values(asyncio.run(one.query()))[Register.MODE] == Mode.TIMEOUT


def test_a_position_is_reached_within_the_limits_of_speed_and_acceleration(rig: Rig) -> None:
    one = controller(rig)
    begin = values(asyncio.run(one.query()))[Register.POSITION]
    fastest = 0.0

    async def go() -> dict[int, float]:
        nonlocal fastest
        limits = {"velocity_limit": 0.5, "accel_limit": 2.0, "maximum_torque": 3.0}
        query = moteus.QueryResolution()
        query.trajectory_complete = moteus.INT8
        for _ in range(600):
            told = values(await one.set_position(position=begin + 0.7, query_override=query, **limits))
            fastest = max(fastest, told[Register.VELOCITY])
            if told[Register.TRAJECTORY_COMPLETE]:
                return told
        raise AssertionError("the trajectory was not completed in 3 s")

    begin_ns = rig.now_ns
    told = asyncio.run(go())
    assert (rig.now_ns - begin_ns) * 1e-9 == pytest.approx(0.7 / 0.5 + 0.5 / 2.0, abs=0.1)
    assert fastest == pytest.approx(0.5, abs=0.1)
    assert told[Register.POSITION] == pytest.approx(begin + 0.7, abs=0.05)


def test_the_package_waits_for_its_trajectories_and_moves_several_at_once(rig: Rig) -> None:
    first, second = controller(rig, 1, ticks=20), controller(rig, 2, ticks=20)
    limits = {"velocity_limit": 1.0, "accel_limit": 5.0}
    told = asyncio.run(first.set_position_wait_complete(position=0.3, period_s=0.0, watchdog_timeout=0.1, **limits))
    assert values(told)[Register.POSITION] == pytest.approx(0.3, abs=0.05)
    asyncio.run(
        moteus.move_to([(first, 0.0), (second, -0.3)], transport=first.transport, period_s=0.0, timeout=5.0, **limits)
    )
    assert values(asyncio.run(first.query()))[Register.POSITION] == pytest.approx(0.0, abs=0.05)
    assert values(asyncio.run(second.query()))[Register.POSITION] == pytest.approx(-0.3, abs=0.05)


def test_a_stop_position_ends_a_speed_and_is_a_fault_beside_limits(rig: Rig) -> None:
    one = controller(rig)
    settings = {"position": NAN, "velocity": 0.5, "stop_position": 0.2}
    told = asyncio.run(repeat(150, one.set_position, **settings))
    assert told[Register.POSITION] == pytest.approx(0.2, abs=0.05)
    assert abs(rig.speeds()[0]) < 0.2
    told = asyncio.run(repeat(2, one.set_position, accel_limit=1.0, **settings))
    assert (told[Register.MODE], told[Register.FAULT]) == (Mode.FAULT, 45)


def test_zero_velocity_and_set_output_are_as_the_package_means_them(rig: Rig) -> None:
    one = controller(rig)
    asyncio.run(repeat(60, one.set_position, position=NAN, velocity=1.0))
    told = asyncio.run(repeat(60, one.set_zero_velocity))
    assert told[Register.MODE] == Mode.ZERO_VELOCITY
    assert abs(told[Register.VELOCITY]) < 0.05
    asyncio.run(one.set_output_exact(position=0.25))
    assert values(asyncio.run(one.query()))[Register.POSITION] == pytest.approx(0.25, abs=0.01)
    asyncio.run(one.set_output_nearest(position=7.0))
    assert values(asyncio.run(one.query()))[Register.POSITION] == pytest.approx(7.25, abs=0.01)


def test_an_override_of_the_control_moves_nothing(rig: Rig) -> None:
    one = controller(rig)
    for override in ({"fixed_voltage_override": 1.0}, {"fixed_current_override": 1.0}):
        told = asyncio.run(repeat(5, one.set_position, position=NAN, velocity=1.0, **override))
        assert told[Register.MODE] == Mode.STOPPED


class Tool:
    """What moteus_tool does once its arguments are read."""

    def __init__(self, rig: Rig) -> None:
        arguments = type("Arguments", (), {"can_prefix": 0, "verbose": False, "diagnostic_channel": 1})
        self.stream = ToolStream(arguments, 1, moteus.Transport([EmulatedBus(rig)]))

    async def begin(self) -> None:
        """As before every action but a stop: silence telemetry, and discard what is on its way."""
        await self.stream.write_message("tel stop")
        await self.stream.flush_read(timeout=0.05)


def test_moteus_tool_begins_reads_and_sets_the_configuration(rig: Rig) -> None:
    tool = Tool(rig)

    async def session() -> list[bytes]:
        await tool.begin()
        dump = await tool.stream.command("conf enumerate")
        assert await tool.stream.read_config_int("motor.poles") == 14
        assert await tool.stream.read_config_double("servo.default_timeout_s") == pytest.approx(0.1)
        assert await tool.stream.is_config_supported("servo.max_position_slip")
        assert not await tool.stream.is_config_supported("servo.nothing")
        assert (await tool.stream.read_uuid()).bytes == rig.node.servos[0].uuid
        await tool.stream.command("conf set servo.default_timeout_s 0.3")
        await tool.stream.conf_write()
        await tool.stream.command("conf set servo.default_timeout_s 0.7")
        await tool.stream.command("conf load")
        assert await tool.stream.read_config_double("servo.default_timeout_s") == pytest.approx(0.3)
        for refused in ("id.id 9", "servo.timeout_mode 10", "servo.pid_position.kp nan", "servo.max_current_A 1e6"):
            with pytest.raises(moteus.CommandError, match="ERR error setting"):
                await tool.stream.command(f"conf set {refused}")
        found: list[bytes] = dump.splitlines()
        return found

    lines = asyncio.run(session())
    assert {line.split()[0].decode() for line in lines} == set(rig.node.servos[0].config)
    assert not rig.node.is_driving


def test_moteus_tool_tells_who_it_is_and_how_it_is(rig: Rig) -> None:
    asyncio.run(repeat(60, controller(rig).set_position, position=NAN, velocity=1.0))
    tool = Tool(rig)
    info = asyncio.run(tool.stream.get_device_info())
    assert info["model"] == "500"
    assert info["uuid"].replace("-", "") == rig.node.servos[0].uuid.hex()
    stats = asyncio.run(tool.stream.read_servo_stats())
    assert stats.mode == Mode.TIMEOUT, "the tool has taken longer than the watchdog"
    assert stats.bus_V == pytest.approx(rig.node.battery_v, abs=0.3)
    assert stats.position > 0.1
    assert asyncio.run(tool.stream.command("tel list")).split() == [b"firmware", b"git", b"servo_stats"]
    with pytest.raises(moteus.CommandError, match="ERR unknown command"):
        asyncio.run(tool.stream.command("tel rate servo_stats 100"))
    asyncio.run(tool.stream.command("d stop"))


def test_a_configured_timeout_is_the_one_that_ends_a_position_command(rig: Rig) -> None:
    tool, one = Tool(rig), controller(rig)
    asyncio.run(tool.stream.command("conf set servo.default_timeout_s 0.3"))
    asyncio.run(tool.stream.command("conf set servo.timeout_mode 0"))
    asyncio.run(repeat(10, one.set_position, position=NAN, velocity=1.0))
    rig.step(ticks=250)
    assert rig.node.servos[0].mode == Mode.POSITION
    rig.step(ticks=60)
    assert rig.node.servos[0].mode == Mode.TIMEOUT
    assert not rig.node.is_driving, "mode 0 lets the wheel roll"


def test_moteus_tool_stops_a_motor(rig: Rig) -> None:
    asyncio.run(repeat(5, controller(rig).set_current, d_A=0.0, q_A=0.5))
    asyncio.run(Tool(rig).stream.command("d stop"))
    assert not rig.node.is_driving


@pytest.mark.parametrize(
    ("line", "mode"),
    [
        ("d pos nan 0.5 2 a4", Mode.POSITION),
        ("d within -1 1 2 f0.1", Mode.STAY_WITHIN),
        ("d zero nan 0 1", Mode.ZERO_VELOCITY),
        ("d tmt nan 0 1", Mode.TIMEOUT),
        ("d brake", Mode.BRAKE),
        ("d dq 0 0.2", Mode.CURRENT),
        ("d vdq 0 1", Mode.VOLTAGE_DQ),
        ("d pwm 0 1", Mode.VOLTAGE_FOC),
    ],
)
def test_a_line_of_the_console_begins_a_mode(rig: Rig, line: str, mode: int) -> None:
    asyncio.run(Tool(rig).stream.command(line))
    rig.step(ticks=500)
    assert rig.node.servos[0].mode == mode, "a line of the console has no watchdog"


def test_numbers_that_a_float_cannot_hold_are_told_as_the_largest(rig: Rig) -> None:
    one, tool = controller(rig), Tool(rig)
    asyncio.run(tool.stream.command("conf set servo.max_position_slip nan"))
    asyncio.run(tool.stream.command("d pos 1e300 1e300 1e300"))
    rig.step(ticks=30)
    told = values(asyncio.run(one.custom_query({0x21: moteus.F32, 0x25: moteus.F32, 0x38: moteus.F32})))
    assert all(value > 3e38 for value in told.values())
    assert abs(rig.node.torque_n_m[0]) <= rig.node.values["torque_limit_n_m"]


def test_an_option_of_the_console_gives_it_a_watchdog(rig: Rig) -> None:
    asyncio.run(Tool(rig).stream.command("d pos nan 0.5 2 t0.2"))
    rig.step(ticks=300)
    assert rig.node.servos[0].mode == Mode.TIMEOUT


WORDS = st.sampled_from(
    [
        "d",
        "conf",
        "tel",
        "pos",
        "within",
        "stop",
        "set",
        "get",
        "nan",
        "1",
        "t0.1",
        "x0",
        "servo.pid_position.kp",
        "raw",
    ]
)


@given(st.lists(WORDS, max_size=7))
def test_a_line_that_is_not_known_is_an_error_and_moves_nothing(words: list[str]) -> None:
    console = FUZZED.node._consoles[0]
    console.feed(" ".join(words).encode() + b"\n")
    answer = console.take(4096)
    if not answer.startswith((b"OK", b"ERR")):
        assert words[:2] == ["conf", "get"] or not words
    if not answer.startswith(b"OK"):
        FUZZED.node.run(1)
        assert not FUZZED.node.is_driving
    else:
        console.feed(b"d stop\nconf default\n")
        FUZZED.node.run(20)
        console.take(4096)


@given(st.binary(max_size=200), st.integers(0, 255))
def test_no_bytes_of_the_stream_are_too_strange(data: bytes, channel: int) -> None:
    for at in range(0, len(data), 40):
        part = data[at : at + 40]
        FUZZED.node.receive(Frame(EXTENDED | 0x8001, bytes((0x40, channel & 0x7F, len(part))) + part))
        FUZZED.node.receive(Frame(EXTENDED | 0x8001, bytes((0x42, 1, channel & 0x7F))))
    assert all(len(frame.payload) <= 64 for frame in FUZZED.node.take_frames())


@given(st.sampled_from((7, 8, 9, 10, 12, 13, 15)), st.binary(max_size=3))
def test_a_command_that_is_cut_off_moves_nothing(mode: int, rest: bytes) -> None:
    """A mode, and a number behind it of which bytes are missing."""
    FUZZED.node.receive(Frame(EXTENDED | 0x8001, bytes((0x01, 0x00, mode, 0x0D, 0x22)) + rest))
    FUZZED.node.run(15)
    assert not FUZZED.node.is_driving
    FUZZED.node.take_frames()


@given(
    st.lists(st.tuples(st.sampled_from((0x18, 0x1B, 0x1C, 0x20, 0x21, 0x22, 0x23, 0x25, 0x28)), st.floats(width=32)))
)
def test_no_number_of_a_command_makes_a_torque_beyond_the_limit(writes: list[tuple[int, float]]) -> None:
    limit = FUZZED.node.values["torque_limit_n_m"] * (1.0 + 1e-9)
    for mode in (7, 8, 9, 10, 12, 13):
        payload = bytes((0x01, 0x00, mode))
        payload += b"".join(bytes((0x0D, register)) + struct.pack("<f", value) for register, value in writes[:8])
        FUZZED.node.receive(Frame(EXTENDED | 0x0001, payload))
        FUZZED.node.run(1)
        assert all(abs(torque) <= limit for torque in FUZZED.node.torque_n_m)
    FUZZED.node.receive(Frame(EXTENDED | 0x0001, b"\x01\x00\x00"))
    FUZZED.node.run(1)


FUZZED = Rig("moteus")
