"""A host that talks to one robot at random, from a seed: most of the time rightly, and often at the edge of a rule.

The likely events depend on the robot's state, so that conversations go deep: sessions that drive, disturbed stops,
cleared faults, and the leftovers of a session for the next one.
"""

import math
import random
from typing import Any, ClassVar

from cobs import cobs

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.generated.messages import Mode, Operation, Request, State
from tests.suite.robot_bench import Bench, framed
from tests.suite.robot_parameters import INDEX, SENSIBLE, TABLE, as_bits, binary32, ends_of
from tests.suite.robot_trouble import Trouble
from tests.suite.wheel_model import speed_limit, ticks

Choice = tuple[Any, ...]  # weight, method, arguments
_MOST_SPEED, _MOST_TORQUE = 63.984375, 15.99609375
_HOST = (m.Estop, m.HostHeartbeat, m.TorqueFeedforward, m.WheelCommand, m.TorqueCommand, m.TimeSyncRequest)
_COMMANDS = (m.WheelCommand, m.TorqueCommand, m.TorqueFeedforward)
_RAW = (*_HOST, m.ParameterRequest, m.Step, m.HelloRequest)
_PATTERNS = ((1, 1, 1, 1), (1, -1, 1, -1), (-1, 1, 1, -1), (1, 0, 0, 0), (1, 0.5, -0.5, 0.25), (0, 0, 0, 1))


class Talk:
    """A conversation with the robot on a bench."""

    def __init__(self, bench: Bench, seed: int) -> None:
        self.bench, self.random = bench, random.Random(seed)
        self._nonce, self._used = self.random.randrange(1, 0x10000), 0
        self._sequence = self._left = 0
        self._speeds = [0.0] * 4
        self._trouble = Trouble(bench, self.random)

    def store(self) -> None:
        """Change some parameters, and have the robot keep them."""
        for _ in range(4):
            self._write()
        self._ask(Operation.STORE)

    def until(self, tick: int) -> None:
        """Talk until the robot is at this tick."""
        robot = self.bench.robot
        while robot.tick < tick:
            if robot.tick >= self._trouble.until:
                self._trouble.end()
            choices = [*self._IN_STATE[robot.state], *self._ANYWHERE, (0.8 * self.bench.serial, Talk._noise)]
            _, action, *arguments = self.random.choices(choices, [one[0] for one in choices])[0]
            action(self, *arguments)

    # How it is said

    def _pass(self, least: int, most: int) -> None:
        self.bench.run(self.random.randint(least, most))

    def _wish(self, request: Request, nonce: int, schema: int = m.SCHEMA_HASH, check: int = 0) -> None:
        hashed = self.bench.robot.parameters.hash() & 0xFF
        mode = self.random.choice((Mode.SPEED, Mode.SPEED, Mode.TORQUE))
        self.bench.send(m.HostHeartbeat(nonce & 0xFFFF or 1, schema, request, mode, hashed ^ check))

    def _arm(self) -> None:
        self._nonce = self.random.choice((self._nonce + 1, self._nonce + 1, self.random.randrange(1, 0x10000)))
        self._wish(Request.IDLE, self._nonce)
        if self.random.random() < 0.1:
            self._pass(1, 5)
        self._wish(Request.ARM, self._nonce)

    def _arm_wrongly(self) -> None:
        """Ask to arm with one thing wrong: announced otherwise, used, of the same session, another schema or check."""
        nonce, chance, used = self._nonce + 1, self.random, self.bench.robot.session
        announced = chance.choice((nonce, nonce, nonce, nonce, used, used + 16, used ^ 0x10))
        armed = announced + chance.choice((0, 0, 0, 1, 256))
        schema, check = chance.choice(((0, 0), (1, 0), (1 << 31, 0), (0, 1), (0, 128)))
        self._wish(Request.IDLE, announced)
        self._wish(Request.ARM, armed, m.SCHEMA_HASH ^ schema, check)
        if chance.random() < 0.5:
            self._wish(Request.ARM, announced)

    def _arm_after_clear(self) -> None:
        """Announce a nonce, and arm with it after an emergency stop or a fault was cleared."""
        self._nonce += 1
        self._wish(Request.IDLE, self._nonce)
        if self.random.random() < 0.5:
            self.bench.send(m.Estop(1, 2))
        else:
            self._fail_for_a_tick()
        self._used += 1
        self._wish(Request.CLEAR, self._used)
        self._wish(Request.ARM, self._nonce)

    def _fail_for_a_tick(self) -> None:
        self.bench.plant.override = ("gyro_rad_s", 2, math.nan)
        self.bench.run(1)
        self.bench.plant.override = None
        self.bench.run(1)

    def _again_at_once(self) -> None:
        """Let the session end by a fault of a tick, and begin another while the wheels still roll."""
        self._fail_for_a_tick()
        self._used += 1
        self._wish(Request.CLEAR, self._used)
        self._arm()
        self._activate()

    def _disarm(self) -> None:
        """Disarm; often a torque ahead is left that waits for its command."""
        if self.bench.robot.mode is Mode.SPEED and self.random.random() < 0.5:
            self._ahead()
            self._left = (self.bench.robot.sequence + 1) & 0xFF
        self._wish(Request.IDLE, self.random.choice((self._nonce, self._nonce + 1)))

    def _clear(self) -> None:
        if self.random.random() < 0.6:
            self._trouble.end()
            self.bench.run(80)  # the filter comes to rest
        self._used += 1
        self._wish(Request.CLEAR, self._used)
        self.bench.run(1)  # a cause that lasts is found again at the next tick

    def _values(self, most: float) -> list[float]:
        pattern = self.random.choice(_PATTERNS)
        size = most * self.random.choice((1.0, 0.05, self.random.random(), self.random.random()))
        return [size * one for one in pattern]

    def _command(self, move: float) -> None:
        """Send a command of the mode, of the next sequence, with a speed or torque unless ``move`` is 0."""
        robot = self.bench.robot
        self._sequence = (robot.sequence + 1) & 0xFF
        if robot.mode is Mode.SPEED:
            speeds = [move * one for one in self._speeds]
            self.bench.send(m.WheelCommand._make((*speeds, self._sequence, robot.session & 0xF)))
        else:
            torques = [min(_MOST_TORQUE, max(-_MOST_TORQUE, 0.2 * move * one)) for one in self._speeds]
            self.bench.send(m.TorqueCommand._make((*torques, self._sequence, robot.session & 0xF)))

    def _ahead(self, distance: int = 1) -> None:
        robot = self.bench.robot
        torques = self._values(min(_MOST_TORQUE, 2.0 * robot.values["torque_limit_n_m"]))
        ends = (robot.sequence + distance) & 0xFF, robot.session & 0xF
        self.bench.send(m.TorqueFeedforward._make((*torques, *ends)))

    def _activate(self) -> None:
        robot = self.bench.robot
        kind = m.WheelCommand if robot.mode is Mode.SPEED else m.TorqueCommand
        self._speeds = [0.0] * 4
        sequence = self.random.choice((self._left, self.random.randrange(256)))
        self.bench.send(kind(0.0, 0.0, 0.0, 0.0, sequence, robot.session & 0xF))

    def _drive(self) -> None:
        """Drive on for a while, towards other speeds, with torques ahead or without."""
        robot, chance = self.bench.robot, self.random
        limit = speed_limit(robot.values)
        most = min(_MOST_SPEED, chance.choice((0.5 * limit, 0.5 * limit, limit, 1.3 * limit)))
        self._speeds, ahead = self._values(most), chance.choice((0, 0, 1, 2))
        period = chance.choice((1, 5, 10, ticks(robot.values["watchdog_s"]) - 1))
        if chance.random() < 0.15:
            self._trouble.begin()
        for _ in range(max(1, chance.randint(10, 120) // period)):
            if ahead and robot.mode is Mode.SPEED:
                for _ in range(chance.choice((1, 1, 1, 2))):
                    self._ahead(ahead if chance.random() < 0.2 else 1)
            self._command(1.0)
            self.bench.run(period)
            if robot.state is not State.ACTIVE:
                return

    def _drive_late(self) -> None:
        """Let the watchdog almost fire, or fire."""
        self._command(1.0)
        self.bench.run(ticks(self.bench.robot.values["watchdog_s"]) - 1)
        self.bench.run(self.random.choice((0, 1)))
        self._command(1.0)

    def _break_encoder(self) -> None:
        """Drive fast enough that the other wheels reveal an encoder that stands still or counts backward."""
        plant, chance = self.bench.plant, self.random
        self._trouble.end()
        speed = chance.choice((1, -1)) * min(speed_limit(self.bench.robot.values), chance.choice((1.9, 3.0, 6.0, 12.0)))
        self._speeds = [speed * one for one in chance.choice(_PATTERNS[:3])]
        wheel, before, ticks_left = chance.randrange(4), chance.randrange(60), 400
        while self.bench.robot.state is State.ACTIVE and ticks_left > 0:
            self._command(1.0)
            self.bench.run(10)
            before, ticks_left = before - 10, ticks_left - 10
            if -10 <= before < 0:
                chance.choice((lambda: plant.stop(wheel), lambda: plant.reverse(wheel), lambda: plant.reverse(wheel)))()
            elif before < 0 and chance.random() < 0.1:
                self._again_at_once()
        self._trouble.end()

    def _command_wrongly(self) -> None:
        robot, chance = self.bench.robot, self.random
        sequence = (robot.sequence + chance.choice((0, 20, 20, 21, 21, 255, 128, 2))) & 0xFF
        session = robot.session + chance.choice((0, 0, 0, 1, 8)) & 0xF
        if chance.random() < 0.4:
            self.bench.send(m.TorqueFeedforward(0.5, -0.5, 0.25, 1.0, sequence, session))
        own = m.WheelCommand if robot.mode is Mode.SPEED else m.TorqueCommand
        kind = chance.choice((own, own, own, m.WheelCommand, m.TorqueCommand))
        self.bench.send(kind._make((0.5, -0.25, 0.75, 1.0, sequence, session)))
        self._pass(0, 3)

    def _sync(self) -> None:
        now_us = self.bench.robot.tick * 1000 + self.random.randrange(1000)
        self.bench.node.set_clock(now_us)
        self.bench.robot.now_us = now_us & 0xFFFF_FFFF
        self.bench.send(m.TimeSyncRequest(self.random.randrange(256)))

    def _ask(self, operation: Operation) -> None:
        chance = self.random
        index = chance.choice((chance.randrange(len(TABLE)), chance.randrange(len(TABLE)), len(TABLE), 255))
        self.bench.send(m.ParameterRequest(index, operation, chance.randrange(256), chance.choice((0, 7))))

    def _write(self) -> None:
        """Write a parameter: at, just beyond or between the ends of its range, or no number; sensible ones mostly."""
        chance = self.random
        name = chance.choice([*SENSIBLE, *INDEX])
        index = INDEX[name]
        sensible = binary32(self.bench.robot.values[name])
        if name in SENSIBLE and name != "counts_per_revolution":
            sensible = chance.choice(SENSIBLE[name])
        low, high = ends_of(index)
        beyond = (low - 1 if low else 0x8000_0001, high + 1, 0x7FC0_0000, 0x7F80_0000, 0xFF80_0000)
        for bits in (*chance.choice(((), (low,), (high,), beyond)), as_bits(index, sensible)):
            self.bench.send(m.ParameterRequest(index, Operation.WRITE, chance.randrange(256), bits))

    def _raw(self) -> None:
        """Send a frame that may be invalid: random bits, a length of another message, an id that no robot receives."""
        chance, robot = self.random, self.bench.robot
        kind = chance.choice(_RAW)
        number = chance.choice((kind.ID, kind.ID, kind.ID, m.Tick.ID, 0x7F))
        length = m.LENGTHS.get(number, m.LENGTHS[kind.ID]) + chance.choice((0, 0, 0, -1, 1))
        payload = chance.randbytes(length)
        if kind in _COMMANDS and length == 8 and chance.random() < 0.5:  # one value below its least
            payload = (0x1000 << 13 * chance.randrange(4) | robot.session << 60 & 0xF << 60).to_bytes(8, "little")
        if kind is m.Step and length == 6:  # at the robot's tick, but too many ticks or none
            payload = robot.tick.to_bytes(4, "little") + chance.choice((0, 1001, 0xFFFF)).to_bytes(2, "little")
        self.bench.send_frame(Frame(number, payload))

    def _noise(self) -> None:
        """Send a frame that the line has damaged, or bytes that are none; then the line is clear again."""
        chance, number = self.random, self.random.choice((0, 5, 127, 128, 200, 255))
        good = framed(m.Estop.ID.to_bytes(2, "little") + bytes([number]) + b"\x01\x02")
        short = framed(bytes(chance.randbytes(chance.randrange(5))))
        body = bytearray(good[:-1])
        body[chance.randrange(len(body))] ^= 1 << chance.randrange(8)
        long = chance.randbytes(chance.choice((14, 15, 40))).replace(b"\0", b"\1")
        wrong_crc = cobs.encode(m.Estop.ID.to_bytes(2, "little") + b"\0\1\2\3\4") + b"\0"
        for data in (*bytes(body).split(b"\0"), chance.choice((short, long, long[:6], wrong_crc, b"", b"\5\1"))):
            self.bench.send_bytes(data.rstrip(b"\0") + b"\0")
        if chance.random() < 0.5:  # a frame with a number of its own, of an id that no robot hears
            self.bench.send_bytes(framed(b"\x80\0" + bytes([number]) + bytes(8)))

    def _lose(self) -> None:
        """Let some frames of the robot be lost at its port."""
        count = self.random.choice((1, 100))
        self.bench.node.count_unsent(count)
        self.bench.robot.counts["transmit_overrun"] += count

    def _step(self) -> None:
        wrong = self.random.choice((0, 0, 0, 1, -1))
        self.bench.send(m.Step((self.bench.robot.tick + wrong) & 0xFFFF_FFFF, self.random.choice((0, 1, 7, 20))))

    def _any(self, *operations: Operation) -> None:
        self._ask(self.random.choice(operations))

    def _disturb(self) -> None:
        self._trouble.begin()

    # Choices in each state, and in all: their likelihood and arguments

    _KEPT = Operation.STORE, Operation.RESTORE
    _LATCHED = (
        (3.0, _clear), (2.0, _pass, 1, 90), (0.5, lambda s: s._wish(Request.CLEAR, s.bench.robot.cleared or 1)),
        (0.5, _arm), (0.3, _disturb),
    )  # fmt: skip
    _IN_STATE: ClassVar[dict[State, tuple[Choice, ...]]] = {
        State.IDLE: (
            (8.0, _arm), (6.0, _arm_wrongly), (0.7, _arm_after_clear), (3.0, _write), (0.6, _any, *_KEPT),
            (1.0, _pass, 1, 120), (0.5, _command, 0), (0.5, _disturb),
        ),
        State.ARMED: (
            (6.0, _activate), (1.0, _command, 1), (0.5, _ahead), (0.3, _pass, 995, 1001), (0.5, _disarm),
            (0.5, _pass, 1, 20), (0.3, _disturb),
        ),
        State.ACTIVE: (
            (8.0, _drive), (1.0, _drive_late), (1.5, _break_encoder), (6.0, _command_wrongly), (0.7, _disarm),
            (0.5, _disturb), (0.3, _pass, 1, 150),
        ),
        State.STOPPING: ((4.0, _pass, 1, 60), (0.5, _disturb), (0.5, _command, 1), (0.5, _disarm), (0.4, _arm)),
        State.FAULT: _LATCHED,
        State.ESTOP: _LATCHED,
    }  # fmt: skip
    _ANYWHERE: ClassVar[tuple[Choice, ...]] = (
        (0.25, lambda s: s.bench.send(m.HelloRequest(s.random.randrange(256)))),
        (0.25, _sync),
        (0.3, _any, Operation.READ, Operation.READ_MINIMUM, Operation.READ_MAXIMUM),
        (0.2, _write),
        (0.1, lambda s: s.bench.send(m.Estop(s.random.randrange(256), s.random.randrange(256)))),
        (1.5, _raw), (0.15, _any, *_KEPT), (0.5, _step), (0.1, _lose),
        (0.3, lambda s: s._wish(Request.ARM, s.bench.robot.session or 1)),
        (0.2, lambda s: s._wish(Request.CLEAR, s.random.randrange(1, 0x10000))),
    )  # fmt: skip
