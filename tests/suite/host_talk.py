"""A robot that talks to one host at random, from a seed, and the calls that the host's program may make meanwhile.

Most of its messages are right: pages, snapshots, states that follow the host's wishes. Often a part is missing, comes
twice or too late, or is of another instant, another session or another robot.
"""

import math
import random
from collections.abc import Sequence

from firmware_protocol.codec import Message, encode
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import ArmRefusal, Request, State
from tests.suite.host_bench import HostBench
from tests.suite.host_model import NEW_NONCE

_VERSION = m.PROTOCOL_VERSION, m.SCHEMA_HASH
_STRANGE = ((m.PROTOCOL_VERSION + 1, m.SCHEMA_HASH), (m.PROTOCOL_VERSION, m.SCHEMA_HASH ^ 1))
_SPEED, _TORQUE = 63.984375, 15.99609375


class HostTalk:
    """A conversation with the host on a bench."""

    def __init__(self, bench: HostBench, seed: int) -> None:
        self.bench, self.random = bench, random.Random(seed)
        self.now_ns = 0
        self._state, self._nonce, self._refusal = State.IDLE, 0, ArmRefusal.NONE
        self._time_us = self.random.choice((0, 5_000_000, 2**32 - 60_000))
        self._snapshot, self._sequence = self.random.randrange(256), 0
        self._tick = 0
        self._held: list[Frame] = []

    def hold(self, turns: int) -> None:
        """Hold so many turns of the conversation."""
        bench, chance = self.bench, self.random
        client, model = bench.client, bench.model
        assert client.view.nonce == model.nonce
        bench.call("begin", model.begin, model.nonce)
        for _ in range(turns):
            self.now_ns += chance.choice((0, 1_000_000, 5_000_000, 5_000_000, 99_999_999, 200_000_000))
            self._call()
            self._hear()
            if chance.random() < 0.7:
                self._obey(bench.send())
            if model.log_is_due and chance.random() < 0.1:
                self._obey(bench.send())
                bench.take_logs()

    def ride(self, turns: int) -> None:
        """Drive on, each command answered by a snapshot that tells it: round trips and numbers wrap."""
        bench = self.bench
        for _ in range(turns):
            self.now_ns += 5_000_000
            bench.command(self._four(20.0), [0.0] * 4, self.now_ns)
            self._obey(bench.send())
            self._snapshot, self._time_us = (self._snapshot + 1) & 0xFF, (self._time_us + 5000) % 2**32
            told: list[Message] = [
                m.Tick(self._time_us, self._sequence, 0, State.ACTIVE, 1, self._snapshot),
                m.Encoders(1, 2, 3, 4),
            ]
            bench.take([*map(encode, told)], self.now_ns + self.random.randrange(9_000_000))

    # What its program calls

    def _call(self) -> None:
        bench, model, chance, now_ns = self.bench, self.bench.model, self.random, self.now_ns
        match chance.choices(range(14), (9, 9, 10, 1, 0.7, 3, 1, 0.3, 0.5, 0.7, 0.5, 0.5, 1, 0.5))[0]:
            case 0:
                bench.call("poll", model.poll, now_ns)
            case 1:
                if bench.call("arm", model.arm, now_ns) == NEW_NONCE:
                    bench.call(
                        "renew", model.renew, chance.choice((0, *(chance.randrange(1, 0x10000) for _ in range(9))))
                    )
            case 2:
                speeds, torques = self._four(_SPEED), self._four(_TORQUE)
                bench.command(speeds, chance.choice((torques, [0.0] * 4)), chance.choice((now_ns, now_ns, -1)))
            case 3:
                bench.wish(chance.choice((*Request,)), chance.choice((now_ns, now_ns, -1)))
            case 4:
                bench.call("estop", model.estop)
            case 5:
                bench.call("step", model.ask, chance.choice((0, 1, 5, 1000, 1001)))
            case 6:
                bench.call("step_again", model.ask_again)
            case 7:
                bench.call("leave", model.leave)
            case 8:
                self._begin_anew()
            case 9:
                bench.call("unsent", model.unsend)
            case 10:
                wheels, signs = chance.sample(range(4), 4), [chance.choice((1, -1)) for _ in range(4)]
                if chance.random() < 0.3:
                    wheels[0], signs[1] = chance.choice(((wheels[1], 1), (4, 1), (wheels[0], 0), (wheels[0], 2)))
                bench.wire([*zip(wheels, signs, strict=True)])
            case 11:
                bench.expect(chance.randrange(256))
            case 12:
                frame = encode(m.TimeSyncRequest(chance.randrange(256)))
                payload = frame.payload if chance.random() < 0.8 else frame.payload + b"\0"
                bench.add(chance.choice((Frame(frame.id, payload), encode(m.HelloRequest(1)))))
            case _:  # until there is no more room
                for _ in range(chance.choice((3, 60))):
                    bench.command(self._four(10.0), self._four(1.0), now_ns)
                chance.choice((lambda: bench.call("estop", model.estop), lambda: bench.wish(Request.IDLE, now_ns)))()

    def _begin_anew(self) -> None:
        """Leave the robot, perhaps in the middle of a snapshot, for one that was reset or is another."""
        self.bench.call("begin", self.bench.model.begin, self.random.randrange(1, 0x10000))
        if self.random.random() < 0.5:
            self._state, self._nonce, self._time_us, self._tick = State.IDLE, 0, 0, 0
            self._snapshot = self.random.choice((0, self._snapshot))

    def _four(self, most: float) -> list[float]:
        """Return four numbers; at times one is at the edge of the range, half a step, or no number."""
        chance = self.random
        values = [chance.uniform(-most, most) for _ in range(4)]
        if chance.random() < 0.4:
            edges = (most, -most, most * 1.0001, -most * 1.0001, math.nan, math.inf, 1 / 512, -1 / 128, 3 / 512, 0.0)
            values[chance.randrange(4)] = chance.choice(edges)
        return values

    # What the robot says

    def _obey(self, sent: Sequence[Frame]) -> None:
        """Do as a robot does with what the host has sent; now and then something else."""
        chance = self.random
        for frame in sent:
            if frame.id == m.HostHeartbeat.ID:
                beat = m.HostHeartbeat.decode(frame.payload)
                if beat is not None and beat.request == Request.ARM and self._state is State.IDLE:
                    self._refusal = chance.choice((ArmRefusal.NONE,) * 6 + (*ArmRefusal,))
                    if self._refusal is ArmRefusal.NONE:
                        self._state, self._nonce = State.ARMED, beat.nonce
                elif beat is not None and beat.request == Request.IDLE and self._state is not State.IDLE:
                    self._state = State.IDLE
            elif frame.id in (m.WheelCommand.ID, m.TorqueCommand.ID):
                self._state = State.ACTIVE if self._state is State.ARMED else self._state
                self._sequence = frame.payload[6] >> 4 | (frame.payload[7] & 0xF) << 4
            elif frame.id == m.Step.ID and (step := m.Step.decode(frame.payload)) is not None:
                self._tick = (step.tick + step.substeps) & 0xFFFF_FFFF
        if chance.random() < 0.03:
            self._state = chance.choice((*State,))

    def _hear(self) -> None:
        chance, messages = self.random, list[Message]()
        for _ in range(chance.choice((0, 1, 1, 2))):
            messages += self._snapshot_parts()
        if chance.random() < 0.3:
            nonce = chance.choice((self._nonce, self._nonce, self._nonce ^ 1))
            messages.append(m.Status(self._state, 0, 0, 0, 0, 1, nonce, self._refusal, chance.randrange(65536)))
        if chance.random() < 0.2:
            messages += self._pages()
        if chance.random() < 0.1:
            messages.append(chance.choice((m.Power(24.0, -3.0), m.LinkCounters(*range(8)), m.TimeSyncRequest(3))))
        if chance.random() < 0.3:
            wrong = chance.choice((0, 0, 0, 0, 1, -5, -1000))
            messages.append(m.StepDone((self._tick + wrong) & 0xFFFF_FFFF))
        frames = [*self._held, *map(encode, messages)]
        self._held = []
        if chance.random() < 0.1 and frames:
            cut = chance.randrange(len(frames))
            frames, self._held = frames[:cut], frames[cut:]
        if chance.random() < 0.1:
            kind = chance.choice((m.Tick, m.Status, m.Currents, m.StepDone, m.HelloIdentity, m.Gyro))
            payload = b"\xff" * (m.LENGTHS[kind.ID] - chance.choice((0, 1)))
            rubbish = chance.choice((Frame(kind.ID, payload), Frame(0x7F, b"\x01\x02")))
            frames.insert(chance.randrange(len(frames) + 1), rubbish)
        self.bench.take(frames, self.now_ns, chance.choice((b"", b"", b"\x80", b"\x80\x00\x08\x00\x00")))

    def _pages(self) -> list[Message]:
        chance = self.random
        version, schema = chance.choice((_VERSION, _VERSION, _VERSION, *_STRANGE))
        pages: list[Message] = [
            m.HelloIdentity(version, 8, 0x7FC, schema),
            m.HelloFirmware(0, 1, 0, 0, 0),
            m.HelloParameters(chance.randrange(2**32), 100, 5),
            m.HelloGeometry(0.075, 0.3, 0.3, 4096),
            m.HelloLimits(32.0, 40.0, 1.8),
            m.HelloFaultStatus(0, 0),
            m.HelloFaultPlace(0, 0),
            m.HelloFaultAddress(0, 0),
        ]
        del pages[slice(0) if chance.random() < 0.6 else slice(chance.randrange(8), 8)]
        return pages

    def _snapshot_parts(self) -> list[Message]:
        chance, step = self.random, self.random.choice((1, 1, 1, 1, 1, 2, 6, 0, 127, 128, 129))
        self._snapshot = (self._snapshot + step) & 0xFF
        self._time_us = (self._time_us + chance.choice((1000, 5000, 20_000, 3_000_000_000))) % 2**32
        bits = chance.choice((31, 31, 31, 3, 3, 7, 1, 0, 19, 24, 25))
        millisecond = self._time_us // 1000 & 0xFFFF
        values = [chance.randrange(-8000, 8000) / 256 for _ in range(7)]
        current = [value / 1.0 for value in values[:4]]
        parts: list[Message] = [
            m.Encoders(*(chance.randrange(0x10000) for _ in range(4))),
            m.WheelSpeeds(*values[:4]),
            m.Currents(*current),
            m.Accelerometer._make((*values[4:], millisecond)),
            m.Gyro(0.5, values[5] / 2, values[6] / 2, millisecond),
        ]
        told = [part for place, part in enumerate(parts) if bits & 1 << place]
        ages = (self._sequence, chance.choice((0, 5, 255)))
        found = [m.Tick(self._time_us, *ages, self._state, bits, self._snapshot), *told]
        if chance.random() < 0.35:
            place = chance.randrange(len(found))
            match chance.randrange(5):
                case 0:
                    del found[place]
                case 1:
                    found.insert(place, found[place])
                case 2:
                    found.insert(chance.randrange(len(found)), found.pop(place))
                case 3:
                    found.insert(place, chance.choice(parts))
                case _:
                    late = (millisecond + chance.choice((1, 5, 65535))) & 0xFFFF
                    found = [
                        one._replace(tick=late) if isinstance(one, m.Accelerometer | m.Gyro) and i >= place else one
                        for i, one in enumerate(found)
                    ]
        return found
