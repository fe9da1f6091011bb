"""Conversations beyond all scenarios: long ones of each end of the wire alone with a partner that is mostly right.

The firmware is held against a model of a robot by PROTOCOL.md, tick by
tick and message by message, and the host against a model of a host, call by call; the first difference is named.
"""

import random
import struct
import zlib
from typing import Any

import pytest

from firmware_protocol.capabilities import Capability
from firmware_protocol.codec import Message, encode
from firmware_protocol.extension import library
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import HostLine, split
from tests.suite.host_bench import HostBench
from tests.suite.host_talk import HostTalk
from tests.suite.robot_bench import Bench
from tests.suite.robot_parameters import INDEX, TABLE, as_bits, ends_of, random_values
from tests.suite.robot_talk import Talk
from tests.suite.robot_trouble import BEYOND, UNMEASURED

TICKS, TURNS = 3000, 400
NOTHING = Capability(0)
LACKS = (
    *(NOTHING, Capability.GYRO, NOTHING, Capability.CURRENTS, NOTHING, Capability.ACCELEROMETER, NOTHING),
    *(Capability.POWER | Capability.TORQUE, NOTHING, Capability.TEMPERATURES | Capability.STORAGE, NOTHING, NOTHING),
)


def quick_and_slow(count: int, quick: int) -> list[Any]:
    """Return so many seeds, of which only the first belong to ``make test``."""
    return [pytest.param(seed, marks=() if seed < quick else pytest.mark.slow) for seed in range(count)]


@pytest.mark.parametrize("seed", quick_and_slow(len(LACKS), quick=4))
def test_a_robot_does_in_each_tick_what_the_protocol_says(seed: int) -> None:
    """In the middle it is reset, and begins with its stored data, unless they are damaged."""
    steps = (Capability.LOCKSTEP, Capability.LOCKSTEP, NOTHING, Capability.LOCKSTEP | Capability.POWER_STAGE)
    lacks, also = LACKS[seed], steps[seed // 2 % 4]
    bench = Bench(random_values(seed), serial=bool(seed % 2), count=65_000, lacks=lacks, also=also)
    talk = Talk(bench, seed)
    talk.store()
    talk.until(TICKS // 2)
    stored, kept = bench.node.stored(), bench.robot.parameters.kept
    assert (stored is None) == (kept is None), "what a STORE keeps"
    if stored is not None and kept is not None:
        values = struct.pack(f"<{len(TABLE)}f", *(kept[row["name"]] for row in TABLE))
        assert stored.endswith(values + zlib.crc32(stored[:-4]).to_bytes(4, "little"))
    if stored is not None and seed % 4 == 0:
        place = random.Random(seed).randrange(len(stored))
        stored, kept = stored[:place] + bytes([stored[place] ^ 0x10]) + stored[place + 1 :], None
    bench.begin(stored, kept, m.ResetCause(seed % 8))
    talk = Talk(bench, ~seed)
    talk.until(TICKS // 2)
    bench.plant.fails = seed % 3 == 0
    talk.until(TICKS // 2 + 100)


def test_a_robot_tells_what_its_wire_cannot_carry_as_the_most_and_no_number_not_at_all() -> None:
    bench = Bench(random_values(0) | {"feedback_period_s": 0.005}, serial=False)
    for clear, override in enumerate((*BEYOND, *UNMEASURED), start=1):
        bench.plant.override = override
        bench.run(100 if override in BEYOND else 2)
        bench.plant.override = None
        bench.send(m.HostHeartbeat(clear, 0, m.Request.CLEAR, m.Mode.SPEED, 0))
        bench.run(1)
    for wheel in range(4):
        for speed_rad_s in (150.0, -150.0):
            bench.plant.speed_rad_s[wheel] = speed_rad_s
            bench.run(60)
        bench.plant.speed_rad_s[wheel] = 0.0


def test_a_robot_takes_each_value_of_a_message_within_its_range_only() -> None:
    bench, chance = Bench(random_values(0), serial=False, also=Capability.LOCKSTEP), random.Random(0)
    for index, row in enumerate(TABLE):
        low, high = ends_of(index)
        below = low - 1 if low else 0x8000_0001
        for bits in (below, high + 1, 0x7FC0_0000, 0x7F80_0000, low, high, as_bits(index, bench.values[row["name"]])):
            bench.send(m.ParameterRequest(index, m.Operation.WRITE, bits & 0xFF, bits))
    for kind in (m.HostHeartbeat, m.ParameterRequest, m.Step, m.WheelCommand, m.TorqueCommand, m.TorqueFeedforward):
        for _ in range(40):
            length = m.LENGTHS[kind.ID]
            payload = chance.choice((chance.randbytes(length), bytes(length), b"\1" * length))
            place = chance.randrange(length)
            bench.send_frame(
                Frame(kind.ID, payload[:place] + chance.choice((b"\x10", b"\6", b"\2")) + payload[place + 1 :])
            )
        for wheel in range(4):
            bench.send_frame(Frame(kind.ID, (0x1000 << 13 * wheel).to_bytes(8, "little")[: m.LENGTHS[kind.ID]]))
    bench.run(100)


def test_a_build_with_a_parameter_out_of_its_range_never_drives() -> None:
    bench = Bench(random_values(1), serial=False)
    ffi, lib = library()
    block = ffi.new("wheel_parameters *", bench.values | {"ramp_s": 5.0})
    exchange = ffi.cast("wheel_plant_exchange", bench.node.plant_address)
    lib.wheel_host_init(bench.node.handle, block, ffi.NULL, 0x7FC, m.ResetCause.PIN, exchange, ffi.NULL)
    for nonce, message, state in (
        (1, m.TimeSyncRequest(1), m.State.FAULT),
        (2, m.TimeSyncRequest(1), m.State.FAULT),
        (3, m.Estop(0, 0), m.State.ESTOP),
    ):
        bench.node.receive(encode(message))
        bench.node.receive(encode(m.HostHeartbeat(nonce, m.SCHEMA_HASH, m.Request.CLEAR, m.Mode.SPEED, 0)))
        assert (bench.node.look().state, bench.node.look().fault) == (state, m.Fault.PARAMETERS)
    assert lib.wheel_parameters_invalid(block) == INDEX["ramp_s"]


@pytest.mark.parametrize("seed", quick_and_slow(10, quick=4))
def test_a_host_does_with_each_call_what_the_protocol_says(seed: int) -> None:
    mode = m.Mode.TORQUE if seed % 4 == 3 else m.Mode.SPEED
    talk = HostTalk(HostBench(mode, 0x5A, 0x1230 + seed, logs=seed != 1), seed)
    talk.hold(TURNS)
    if seed < 3:
        talk.ride(300)


@pytest.mark.parametrize("seed", range(3))
def test_a_serial_line_drops_what_is_no_frame_and_counts_it(seed: int) -> None:
    """The host's end of a line, in C, beside ``firmware_protocol.framer``, on bytes that noise has changed."""
    chance = random.Random(seed)
    line, framer, deframer = HostLine(), Framer(), Deframer()
    for _ in range(400):
        number = chance.choice((m.Tick.ID, m.Status.ID, m.Estop.ID, m.Power.ID, m.StepDone.ID, m.HelloRequest.ID))
        frames = [Frame(number, chance.randbytes(m.LENGTHS[number])) for _ in range(chance.randrange(4))]
        data = b"".join(map(framer.encode, frames))
        assert b"".join(map(line.encode, frames)) == data
        noisy = bytearray(data if chance.random() < 0.9 else b"")
        if noisy and chance.random() < 0.4:
            place = chance.randrange(len(noisy))
            change = chance.choice((b"", b"\0", b"\1", chance.randbytes(chance.choice((1, 2, 20)))))
            noisy[place : place + chance.randrange(3)] = change
        cut = chance.randrange(len(noisy) + 1)
        for piece in (bytes(noisy[:cut]), bytes(noisy[cut:])):
            heard = line.feed(piece)
            assert [*heard] == deframer.feed(piece)
            below, others = split(heard, m.HelloRequest.ID)
            assert [*(below or ())] == [frame for frame in heard if frame.id < m.HelloRequest.ID]
            assert [*(others or ())] == [frame for frame in heard if frame.id >= m.HelloRequest.ID]
        assert line.encode_packed(b"\x80\0\3abc") == line.encode_packed(b"\x80\0\x08cut") == b"", "it is not sent"
        assert line.rejected == deframer.rejected | {"lost": deframer.lost}


def test_a_host_on_a_serial_line_hears_and_says_what_it_does_without() -> None:
    line, robot = HostLine(), Framer()
    bench, twin = HostBench(m.Mode.SPEED, 0x5A, 0x1231), HostBench(m.Mode.SPEED, 0x5A, 0x1231)
    for one in (bench, twin):
        one.call("begin", one.model.begin, 0x1231)
    for number in range(60):
        now_ns = number * 50_000_000
        bench.take_logs()  # a log that fills up asks for it, and nothing is polled before
        told: list[Message] = [m.Tick(number * 5000, number, 0, m.State.IDLE, 3, number), m.Encoders(1, 2, 3, number)]
        frames = [*map(encode, [*told, m.WheelSpeeds(0.5, 0.0, -1.0, number / 4), m.StepDone(number)])]
        heard = line.receive_for(bench.client, b"".join(map(robot.encode, frames)), now_ns)
        bench.model.take(frames, now_ns)
        was_due = bench.model.poll(now_ns)
        assert heard == len(frames) if not was_due else isinstance(heard, tuple), heard
        twin.take(frames, now_ns)
        twin.call("poll", twin.model.poll, now_ns)
        said = Deframer().feed(line.encode_for(bench.client))
        assert said == [*twin.send()]
        assert said == [*bench.send()]
        if number % 5 == 0:
            bench.wish(m.Request.ARM, now_ns)
            twin.wish(m.Request.ARM, now_ns)
