"""A bench for one robot alone: the firmware with a simple plant, next to the model of its rules.

Each tick and each message of the firmware is compared with the model's. Four values are those of FL, FR, RR, RL.
"""

import math
from typing import Any

from cobs import cobs

from firmware_protocol.capabilities import Capability
from firmware_protocol.codec import Message, decode, encode
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import Frame, crc16
from firmware_protocol.generated import messages as m
from tests.suite.plant_node import PlantNode
from tests.suite.robot_feedback import Sense
from tests.suite.robot_model import RobotModel
from tests.suite.robot_parameters import binary32

_NONE, _ALL = Capability(0), Capability(0x7FC)  # but a power stage, and lockstep
_INERTIA_KG_M2, _DRAG_N_M_S = 0.03, 0.01
_TORQUE_N_M, _SET_POINT_RAD_S, _DUTY = 1e-5, 1e-5, 1e-4  # by how much rounding may differ, at most
_STEPS: dict[type, float] = {  # of the scaled numbers, wheel.dbc
    m.WheelSpeeds: 1 / 256,
    m.Currents: 1 / 1024,
    m.Accelerometer: 1 / 256,
    m.Gyro: 1 / 1024,
    m.Power: 1 / 128,
    m.Temperatures: 1 / 128,
    m.HelloGeometry: 1 / 8192,
    m.HelloLimits: 1 / 256,
}


def framed(body: bytes) -> bytes:
    """Return the bytes on a serial line of a body of id, sequence and payload, whatever its length."""
    return bytes(cobs.encode(body + crc16(body).to_bytes(2, "little"))) + b"\0"


class Plant:
    """Four wheels with their motors, encoders and sensors; what is public may be set from outside, to disturb it."""

    def __init__(self, values: dict[str, float], count: int) -> None:
        self.motors = values  # the firmware's parameters say what they are
        self._start, self._counts = count, values["counts_per_revolution"]
        self.load_n_m = [0.0] * 4  # pushes the wheels, as a slope does
        self.held = [False] * 4  # wheels that keep the speed that they have
        self._sign, self._from = [1] * 4, [0] * 4  # of the encoders
        self.temperature_degc, self.offset_a = [25.0] * 4, [0.0] * 4
        self.battery_v, self.sag_ohm = 24.0, 0.01
        self.override: tuple[str, int, float] | None = None  # a sensor's field, place and value
        self.fails = False
        self.speed_rad_s, self._angle_rad, self._count = [0.0] * 4, [0.0] * 4, [0] * 4
        self._current_a = [0.0] * 4
        self._tick = 0

    def reverse(self, wheel: int, sign: int = -1) -> None:
        """Let an encoder count backward from now on, with sign 1 forward again, with 0 stand still."""
        self._from[wheel] += (self._sign[wheel] - sign) * self._turned(wheel)
        self._sign[wheel] = sign

    def stop(self, wheel: int) -> None:
        """Let an encoder stand still."""
        self.reverse(wheel, 0)

    def _turned(self, wheel: int) -> int:
        return math.floor(self._angle_rad[wheel] * self._counts / math.tau)

    def step(self, torque: list[float], duty: list[float]) -> None:
        """Let a tick pass with these torques at the wheels, and these duties on the windings."""
        p = self.motors
        resistance, constant = p["motor_resistance_ohm"], p["torque_constant_n_m_a"]
        part = -math.expm1(-resistance * 1e-3 / p["motor_inductance_h"])
        for i, speed in enumerate(self.speed_rad_s):
            if not self.held[i]:
                turning = torque[i] + self.load_n_m[i] - _DRAG_N_M_S * speed
                self.speed_rad_s[i] += turning / _INERTIA_KG_M2 * 1e-3
            self._angle_rad[i] += self.speed_rad_s[i] * 1e-3
            settled = (duty[i] * self.battery_v - constant * speed) / resistance if duty[i] else 0.0
            self._current_a[i] += (settled - self._current_a[i]) * part
        self._tick += 1

    def sample(self, sense: Any) -> Sense:
        """Write what the sensors say, and return it as written."""
        for i in range(4):
            turned = self._from[i] + self._sign[i] * self._turned(i)
            self._count[i] = (self._start + 9000 * i + turned) & 0xFFFF
        speed, wave = self.speed_rad_s, [((self._tick * k) % 31 - 15) / 15 for k in (1, 3, 7)]
        current = [a + b for a, b in zip(self._current_a, self.offset_a, strict=True)]
        sense.count, sense.current_a = self._count, current
        sense.gyro_rad_s = [0.1 * wave[0], 0.2 * wave[1], (speed[1] + speed[2] - speed[0] - speed[3]) * 0.07]
        sense.acceleration_m_s2 = [3.0 * wave[2] + 0.05 * speed[0], 2.0 * wave[1], 9.81 + wave[0]]
        sense.battery_v = self.battery_v - self.sag_ohm * sum(map(abs, current)) + 0.05 * wave[1]
        sense.battery_a = sum(current) * 0.5 + wave[2]
        sense.temperature_degc = self.temperature_degc
        if self.override is not None:
            name, place, value = self.override
            if name.startswith("battery"):
                setattr(sense, name, value)
            else:
                getattr(sense, name)[place] = value
        return Sense(tuple(sense.count), *(_read(getattr(sense, name)) for name in Sense._fields[1:]))


class Bench:
    """Holds firmware and model against each other.

    ``serial``: frames go as bytes of a line, otherwise as CAN frames. ``values`` gives each parameter. Every method
    raises AssertionError that names the tick and the first difference.
    """

    robot: RobotModel
    node: PlantNode

    def __init__(
        self,
        values: dict[str, float],
        *,
        serial: bool,
        count: int = 0,
        lacks: Capability = _NONE,
        also: Capability = _NONE,
    ) -> None:
        self.values = {name: binary32(value) for name, value in values.items()}
        self.plant = Plant(self.values, count)
        self.serial, self._capabilities = serial, _ALL & ~lacks | also
        self.begin(None)

    def begin(
        self,
        stored: bytes | None,
        kept: dict[str, float] | None = None,
        reset_cause: m.ResetCause = m.ResetCause.POWER_ON,
    ) -> None:
        """Power the robot on, with its stored data; ``kept`` is the model's form of them."""
        self._wrong: str | None = None
        self._end = 0  # the tick at which the requested run ends
        self._first: Sense | None = None
        self.model: RobotModel | None = None
        self._framer, self._line, self._answers = Framer(), Deframer(), Deframer()
        has = self._capabilities
        self.node = PlantNode(
            self._tick,
            self.values,
            lockstep=bool(has & Capability.LOCKSTEP),
            power_stage=bool(has & Capability.POWER_STAGE),
            lacks=_ALL & ~has,
            stored=stored,
            reset_cause=reset_cause,
        )
        assert self._first is not None, "the firmware samples its plant when it begins"
        self.robot = RobotModel(self.values, self._capabilities, self._first, kept, reset_cause)
        self.model = self.robot
        self.compare()

    # What happens to it

    def run(self, ticks: int) -> None:
        """Let ticks pass."""
        self._end = self.robot.tick + ticks
        self.node.run(ticks)
        self.compare()

    def send(self, message: Message) -> None:
        """Send a message."""
        self.send_frame(encode(message))

    def send_frame(self, frame: Frame) -> None:
        """Send a frame, which need not be one of a message."""
        if self.serial:
            is_one = m.LENGTHS.get(frame.id) == len(frame.payload)
            self.send_bytes(
                self._framer.encode(frame) if is_one else framed(frame.id.to_bytes(2, "little") + b"\0" + frame.payload)
            )
        else:
            self.robot.receive(frame)
            self.node.receive(frame)
            self.compare()

    def send_bytes(self, data: bytes) -> None:
        """Send bytes of a line; only their last may be a zero."""
        before, lost = dict(self._line.rejected), self._line.lost
        for frame in self._line.feed(data):
            self.robot.receive(frame)
        for cause, count in self._line.rejected.items():
            self.robot.counts[cause] += count - before[cause]
        self.robot.counts["serial_lost"] += self._line.lost - lost
        self.node.feed(data)
        self.compare()

    # The comparison

    def _tick(self, _context: Any, drive: Any, sense: Any) -> int:
        plant, model = self.plant, self.model
        if not drive:
            self._first = plant.sample(sense)
            return 0
        torque, duty = list(drive.torque_n_m), list(drive.duty)
        plant.step(torque, duty)
        sensed = plant.sample(sense)
        if model is None:
            self._wrong = self._wrong or "time passes before the robot has begun"
            return 0
        tick, wanted = model.tick, model.drive()
        must = wanted.torque_n_m.tolist()
        if (drive.tick, bool(drive.enabled)) != (tick, wanted.enabled):
            self._note(tick, f"drives: {drive.tick, drive.enabled} instead of {tick, wanted.enabled}")
        if not _close(torque, must, _TORQUE_N_M):
            self._note(tick, f"torques: {torque} instead of {must} N·m")
        if not _close(duty, wanted.duty, _DUTY):
            self._note(tick, f"duties: {duty} instead of {wanted.duty}")
        model.sense(sensed, plant_failed=plant.fails)
        plant.motors = model.values
        return int(plant.fails)

    def _note(self, tick: int, what: str) -> None:
        self._wrong = self._wrong or f"tick {tick}, {what}"

    def compare(self) -> None:
        """Compare the firmware's messages and state with the model."""
        robot, look = self.robot, self.node.look()
        end = max(self._end, robot.step_to or 0)
        while self.plant.fails and robot.tick < end:  # the firmware asks it no more
            robot.drive()
            robot.sense(robot.sensed, plant_failed=True)
        if robot.step_to is not None:
            robot.out.append(m.StepDone(robot.tick))
            if robot.step_to != robot.tick:
                self._note(robot.tick, f"a STEP led here instead of to tick {robot.step_to}")
            robot.step_to = None
        assert self._wrong is None, self._wrong
        frames = self._answers.feed(self.node.take_bytes()) if self.serial else self.node.take_frames()
        wanted, robot.out = robot.out, []
        for frame, expected in zip(frames, wanted, strict=False):
            said = decode(frame)
            assert _agree(said, expected), f"tick {robot.tick}: {said or frame} instead of {expected}"
        assert len(frames) == len(wanted), f"tick {robot.tick}: {len(frames)} messages, expected {len(wanted)}"
        assert not any(self._answers.rejected.values()), self._answers.rejected
        assert self._answers.lost == 0, "the firmware numbers its frames"
        is_, must = look.set_point_rad_s, robot.set_point.tolist()
        assert _close(is_, must, _SET_POINT_RAD_S), f"tick {robot.tick}: set points {is_} instead of {must} rad/s"
        age = 0xFFFF_FFFF if robot.age is None else robot.age
        now = (look.tick, look.state, look.mode, look.fault, look.fault_wheel, look.stop_reason, look.command_age_ticks)
        then = (robot.tick, robot.state, robot.mode, robot.fault, robot.fault_wheel, robot.stop_reason, age)
        assert now == then, f"{now} instead of {then}"


def _read(value: Any) -> Any:
    return value if isinstance(value, float) else tuple(value)


def _close(some: Any, others: Any, limit: float) -> bool:
    return all(abs(a - b) <= limit for a, b in zip(some, others, strict=True))


def _agree(said: Message | None, expected: Message) -> bool:
    step = _STEPS.get(type(expected))
    if type(said) is not type(expected) or said is None:
        return False
    return said == expected if step is None else _close(said, expected, 0.75 * step)
