"""moteus: the maker's package drives the emulated ones; what they do not emulate moves nothing."""

import asyncio
import math
import struct
from typing import Any

import moteus
import pytest
from hypothesis import given
from hypothesis import strategies as st
from moteus import Mode, Register

from firmware_protocol.framing import Frame
from hil.robot.driver import EXTENDED
from tests.support.dialect_testbed import Rig
from tests.support.moteus_bus import EmulatedBus, controller

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


def test_what_the_package_asks_for_by_default_is_told(rig: Rig) -> None:
    query = moteus.QueryResolution()
    query.q_current = moteus.F32
    one = moteus.Controller(id=1, query_resolution=query, transport=moteus.Transport([EmulatedBus(rig)]))
    told = values(asyncio.run(one.query()))
    assert set(told) == {0x00, 0x01, 0x02, 0x03, 0x04, 0x0D, 0x0E, 0x0F}
    assert (told[Register.MODE], told[Register.FAULT]) == (Mode.STOPPED, 0)
    assert told[Register.VOLTAGE] == pytest.approx(rig.node.battery_v, abs=0.3)


def test_a_position_is_held_until_the_watchdog_ends_it_and_a_stop_releases_it(rig: Rig) -> None:
    one = controller(rig)
    told = asyncio.run(repeat(100, one.set_position, position=0.04, watchdog_timeout=0.1))
    assert told[Register.MODE] == Mode.POSITION
    assert told[Register.POSITION] == pytest.approx(0.04, abs=0.01)
    told = asyncio.run(repeat(100, one.set_position, position=NAN, velocity=1.0, maximum_torque=0.5))
    assert abs(rig.node.torque_n_m[0]) <= 0.5
    rig.step(ticks=110)
    assert values(asyncio.run(one.query()))[Register.MODE] == Mode.TIMEOUT
    stopped = asyncio.run(repeat(2, one.set_stop))
    assert stopped[Register.MODE] == Mode.STOPPED
    assert not rig.node.is_driving


def test_another_mode_or_an_option_that_is_not_emulated_moves_nothing(rig: Rig) -> None:
    one = controller(rig)
    for command, settings in (
        (one.set_position, {"fixed_voltage_override": 1.0}),
        (one.set_position, {"velocity": 1.0, "stop_position": 1.0}),
        (one.set_position, {"velocity": 1.0, "accel_limit": 1.0}),
        (one.set_current, {"d_A": 0.0, "q_A": 1.0}),
        (one.set_stay_within, {"lower_bound": 0.5, "upper_bound": 1.0}),
    ):
        told = asyncio.run(repeat(5, command, **settings))
        assert told[Register.MODE] == Mode.STOPPED


@given(st.sampled_from((9, 10, 15)), st.binary(max_size=3))
def test_a_command_that_is_cut_off_moves_nothing(mode: int, rest: bytes) -> None:
    """A mode, and a number behind it of which bytes are missing."""
    FUZZED.node.receive(Frame(EXTENDED | 0x8001, bytes((0x01, 0x00, mode, 0x0D, 0x22)) + rest))
    FUZZED.node.run(15)
    assert not FUZZED.node.is_driving
    FUZZED.node.take_frames()


@given(st.lists(st.tuples(st.sampled_from((0x1C, 0x20, 0x21, 0x22, 0x23, 0x24, 0x25, 0x28)), st.floats(width=32))))
def test_no_number_of_a_command_makes_a_torque_beyond_the_limit(writes: list[tuple[int, float]]) -> None:
    limit = FUZZED.node.values["torque_limit_n_m"] * (1.0 + 1e-9)
    payload = b"\x01\x00\x0a"
    payload += b"".join(bytes((0x0D, register)) + struct.pack("<f", value) for register, value in writes[:8])
    FUZZED.node.receive(Frame(EXTENDED | 0x0001, payload))
    for _ in range(20):
        FUZZED.node.run(1)
        assert all(abs(torque) <= limit for torque in FUZZED.node.torque_n_m)
    FUZZED.node.receive(Frame(EXTENDED | 0x0001, b"\x01\x00\x00"))
    FUZZED.node.run(1)


FUZZED = Rig("moteus")
