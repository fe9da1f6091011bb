"""RoboMaster C620 with M3508, and C610 with M2006. They take currents; the speed loops are closed in this driver.

CAN 1 Mbit/s, standard identifiers, big-endian. 0x200 carries the currents of motors 1 to 4, 0x1FF those of 5 to 8.
Each motor sends 0x200 + its id at 1 kHz: rotor angle (8192 steps a turn), rotor speed [rpm], current, temperature.
Source: RoboMaster C620 user guide; RoboRTS-Firmware, components/devices/motor.c.

The controllers have no arming, version or error message. A controller is present when its feedback arrives.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Annotated, Literal, NamedTuple

from firmware_protocol.framing import Frame
from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.types import WHEEL_NAMES, CommandMode, FourWheels
from hil.drivers.port import (
    Capabilities,
    Dialect,
    Driver,
    Found,
    Probe,
    RobotFacts,
    Sample,
    chosen,
    clamp,
    four,
    four_ids,
    oldest,
)

_CURRENTS = Struct(">4h")
_FEEDBACK = Struct(">HhhB")
_FEEDBACK_BASE = 0x200
_LOW, _HIGH = 0x200, 0x1FF
_ANGLES = 8192
_RPM = math.tau / 60.0
_FEEDBACK_NS = 1_000_000


class Motor(NamedTuple):
    """A controller and its motor: current of one count [A], the largest count, rotor turns per turn of the wheel."""

    amperes: float
    max_count: int
    gear_ratio: float


MOTORS = {
    "c620": Motor(20.0 / 16384, 16384, 3591 / 187),
    "c610": Motor(10.0 / 10000, 10000, 36.0),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``ids``: controller ids in channel order, as set with each one's button.

    ``gear_ratio``: 0 means that of the motor's own gearbox. The gains turn a wheel's speed error into its torque.
    ``temperature_limit_degc``: the robot is stopped when a motor is hotter.
    """

    controller: Literal["c620", "c610"] = "c620"
    ids: Annotated[tuple[int, ...], four_ids(1, 8)] = (1, 2, 3, 4)
    gear_ratio: Annotated[float, NOT_NEGATIVE] = 0.0
    kp_n_m_s_rad: Annotated[float, NOT_NEGATIVE] = 0.6
    ki_n_m_rad: Annotated[float, NOT_NEGATIVE] = 8.0
    temperature_limit_degc: Annotated[float, POSITIVE] = 100.0


class _Channel:
    """The feedback of one motor, and the integral of its speed loop."""

    def __init__(self) -> None:
        self.stamp_ns: int | None = None
        self.rpm = 0
        self.current = 0
        self.temperature_degc = 0
        self.integral_n_m = 0.0
        self._angle = 0
        self._turned = 0  # angle steps since the first frame
        self._batch: list[tuple[int, int]] = []  # angles and speeds of the frames with the newest stamp
        self._before_ns: int | None = None  # the stamp before that

    def feed(self, payload: bytes, stamp_ns: int) -> None:
        angle, rpm, self.current, self.temperature_degc = _FEEDBACK.unpack_from(payload)
        if stamp_ns != self.stamp_ns:
            self._unwrap()
            self._before_ns, self.stamp_ns = self.stamp_ns, stamp_ns
        self._batch.append((angle, rpm))
        self.rpm = rpm

    def turned(self) -> int:
        """Return the angle steps since the first frame. Call it after all frames that have arrived were fed."""
        self._unwrap()
        return self._turned

    def _unwrap(self) -> None:
        """Add the turns of the frames with the newest stamp.

        Frames that were read together were sent 1 ms apart; the rest of the time since the last stamp lies before the
        first of them. The rotor may have turned more than half a turn in that time, if frames were lost: the number of
        whole turns follows from the speed.
        """
        batch, self._batch = self._batch, []
        for i, (angle, rpm) in enumerate(batch):
            if self._before_ns is None or self.stamp_ns is None:
                step = 0
            else:
                apart_ns = _FEEDBACK_NS
                if i == 0:
                    apart_ns = max(self.stamp_ns - self._before_ns - (len(batch) - 1) * _FEEDBACK_NS, _FEEDBACK_NS)
                expected = rpm / 60.0 * _ANGLES * apart_ns * 1e-9
                step = angle - self._angle
                step += _ANGLES * round((expected - step) / _ANGLES)
            self._angle = angle
            self._turned += step
        self._before_ns = self.stamp_ns


class C620(Driver):
    """Drives four controllers on one bus."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        motor = MOTORS[settings.controller]
        self._settings = settings
        self._robot = robot
        self._amperes = motor.amperes
        self._max_count = motor.max_count
        self._gear_ratio = settings.gear_ratio or motor.gear_ratio
        self._channels = tuple(_Channel() for _ in settings.ids)
        self._by_id = {_FEEDBACK_BASE + number: self._channels[i] for i, number in enumerate(settings.ids)}
        self._is_armed = False
        self._commanded_ns: int | None = None
        self._capabilities = Capabilities(
            modes=frozenset(CommandMode),
            is_twist=False,
            feedback_hz=1000.0,
            sensors=frozenset({"position", "current", "temperature"}),
            adds_torque=True,
            watchdog="none",
            latches_estop=False,
        )
        self._warnings = (
            f"it is not known what a {settings.controller.upper()} does when commands end: keep an e-stop that cuts "
            "the motors' power within reach",
            f"a stopped {settings.controller.upper()} lets its wheel coast and does not brake it",
        )

    @property
    def identity(self) -> str | None:
        if self.missing:
            return None
        ids = ", ".join(map(str, self._settings.ids))
        return f"four {self._settings.controller.upper()} with the ids {ids}"

    @property
    def missing(self) -> str:
        silent = chosen(self._settings.ids, (channel.stamp_ns is None for channel in self._channels))
        if not silent:
            return ""
        return (
            f"no feedback of the motors {silent}; check their power, the bus, and the ids that their lamps "
            "blink (device.motors.ids)"
        )

    def arm(self, now_ns: int) -> Sequence[Frame]:
        for channel in self._channels:
            channel.integral_n_m = 0.0
        self._commanded_ns = None
        self._is_armed = not self.missing
        return self._currents(_NO_CURRENT)

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        if self._robot.mode is CommandMode.SPEED:
            torque_n_m = self._speed_loops(speed_rad_s, torque_n_m, now_ns)
        self._commanded_ns = now_ns
        scale = 1.0 / (self._robot.torque_constant_n_m_a * self._amperes)
        most = self._max_count
        return self._currents([clamp(round(torque * scale), most) for torque in torque_n_m])

    def _is_fresh(self, channel: _Channel, now_ns: int) -> bool:
        return channel.stamp_ns is not None and now_ns - channel.stamp_ns < self._robot.watchdog_s * 1e9

    def _speed_loops(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> FourWheels:
        settings, limit = self._settings, self._robot.torque_limit_n_m
        dt_s = self._robot.period_s if self._commanded_ns is None else (now_ns - self._commanded_ns) * 1e-9
        dt_s = min(dt_s, 2.0 * self._robot.period_s)  # the loop was open during a stall: do not integrate over it
        torques = []
        for channel, target, feedforward in zip(self._channels, speed_rad_s, torque_n_m, strict=True):
            if not self._is_fresh(channel, now_ns):
                channel.integral_n_m = 0.0
                torques.append(0.0)  # no torque on an outdated speed
                continue
            error = target - channel.rpm * _RPM / self._gear_ratio
            torque = feedforward + settings.kp_n_m_s_rad * error + channel.integral_n_m
            limited = clamp(torque, limit)
            if torque == limited or error * torque < 0.0:  # no windup at the limit
                integral = channel.integral_n_m + settings.ki_n_m_rad * error * dt_s
                channel.integral_n_m = clamp(integral, limit)
            torques.append(limited)
        return four(torques)

    def _currents(self, counts: Sequence[int]) -> Sequence[Frame]:
        """Return the one or two frames that carry the currents. The other motors of these frames get no current."""
        slots = {_LOW: [0, 0, 0, 0], _HIGH: [0, 0, 0, 0]}
        used = set()
        for number, count in zip(self._settings.ids, counts, strict=True):
            frame = _LOW if number <= 4 else _HIGH
            slots[frame][(number - 1) % 4] = count
            used.add(frame)
        return [Frame(number, _CURRENTS.pack(*slots[number])) for number in sorted(used, reverse=True)]

    def disarm(self) -> Sequence[Frame]:
        self._is_armed = False
        return self._currents(_NO_CURRENT)

    def feed(self, frame: Frame, stamp_ns: int) -> None:
        channel = self._by_id.get(frame.id)
        if channel is not None and len(frame.payload) == 8:
            channel.feed(frame.payload, stamp_ns)

    @property
    def sample(self) -> Sample | None:
        channels = self._channels
        stamp_ns = oldest(channel.stamp_ns for channel in channels)
        if stamp_ns is None:
            return None
        to_speed = _RPM / self._gear_ratio
        to_angle = math.tau / _ANGLES / self._gear_ratio
        return Sample(
            stamp_ns,
            four(channel.rpm * to_speed for channel in channels),
            four(channel.turned() * to_angle for channel in channels),
            four(channel.current * self._amperes for channel in channels),
            four(channel.temperature_degc for channel in channels),
        )

    @property
    def errors(self) -> Sequence[str]:
        limit = self._settings.temperature_limit_degc
        return [
            f"motor {number} of wheel {WHEEL_NAMES[wheel]} has {channel.temperature_degc} °C, more than "
            f"device.motors.temperature_limit_degc = {limit:g}"
            for number, channel, wheel in zip(
                self._settings.ids, self._channels, self._robot.wheel_of_channel, strict=True
            )
            if channel.temperature_degc > limit
        ]

    def restart(self) -> None:
        super().restart()
        for channel in self._channels:
            channel.stamp_ns = None


class _Probe(Probe):
    """Listens only: each motor sends its feedback without being asked."""

    def __init__(self) -> None:
        self._ids: set[int] = set()

    def feed(self, frame: Frame) -> bool:
        number = frame.id - _FEEDBACK_BASE
        if not 1 <= number <= 8 or len(frame.payload) != 8 or _FEEDBACK.unpack_from(frame.payload)[0] >= _ANGLES:
            return False
        self._ids.add(number)
        return True

    def found(self) -> Found | None:
        if not self._ids:
            return None
        ids = sorted(self._ids)
        sentences = [f"a C620 or C610 with the id {number}" for number in ids]
        unknown = ("device.motors.controller", "device.motors.gear_ratio", "firmware.torque_constant_n_m_a")
        return Found(sentences, {"ids": ids} if len(ids) == 4 else None, unknown=unknown)


_NO_CURRENT = (0, 0, 0, 0)
DIALECT = Dialect(
    title="RoboMaster C620 and C610",
    wires=frozenset({"can"}),
    settings=Settings,
    make=C620,
    emulated="hil.drivers.c620.emulated:EmulatedC620",
    probe=_Probe,
)
