"""RoboMaster C620 with M3508, and C610 with M2006. They take currents; the speed loops are closed in this driver.

CAN 1 Mbit/s, standard identifiers, big-endian. 0x200 carries the currents of motors 1 to 4, 0x1FF those of 5 to 8.
Each motor sends 0x200 + its id at 1 kHz: rotor angle (8192 steps a turn), rotor speed [rpm], current, temperature.
Source: RoboMaster C620 user guide; RoboRTS-Firmware, components/devices/motor.c.

The controllers have no arming, version or error message. A controller is present when its feedback arrives.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Annotated, Literal, NamedTuple

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import Channel, FourMotors, IdProbe, expected_length, four_ids
from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.types import CommandMode, FourWheels
from hil.robot.driver import Capabilities, Dialect, RobotFacts, Sample, clamp, four

_CURRENTS = Struct(">4h")
_FEEDBACK = Struct(">HhhB")
_FEEDBACK_BASE = 0x200
_LOW, _HIGH = 0x200, 0x1FF
_ANGLES = 8192
_RPM = math.tau / 60.0
_FEEDBACK_NS = 1_000_000
_FRONT = (1.0, 1.0, -1.0, -1.0)
_AGREE = 1e-6  # Wheels of a robot that moves turn as much at the front as at the rear, but for rounding.


class Motor(NamedTuple):
    """A controller and its motor: current of one count [A], the largest count, rotor turns per turn of the wheel."""

    amperes: float
    max_count: int
    gear_ratio: float


MOTORS = {"c620": Motor(20.0 / 16384, 16384, 3591 / 187), "c610": Motor(10.0 / 10000, 10000, 36.0)}


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``ids``: controller ids in channel order, as set with the button of each controller.

    ``gear_ratio``: 0 means that of the motor's own gearbox. The gains turn a wheel's speed error into its torque.
    ``temperature_limit_degc``: the robot is stopped when a motor is hotter.
    """

    controller: Literal["c620", "c610"] = "c620"
    ids: Annotated[tuple[int, ...], four_ids(1, 8)] = (1, 2, 3, 4)
    gear_ratio: Annotated[float, NOT_NEGATIVE] = 0.0
    kp_n_m_s_rad: Annotated[float, NOT_NEGATIVE] = 0.4
    ki_n_m_rad: Annotated[float, NOT_NEGATIVE] = 2.0
    temperature_limit_degc: Annotated[float, POSITIVE] = 100.0


class _Channel(Channel):
    """The feedback of one motor, and the integral of its speed loop. Speed [rpm] and position [steps]: of the rotor."""

    def __init__(self, amperes: float) -> None:
        self._amperes = amperes
        super().__init__()

    def forget(self) -> None:
        super().forget()
        self.integral_n_m = 0.0
        self._angle = 0
        self._batch: list[tuple[int, int]] = []  # angles and speeds of the frames with the newest stamp
        self._before_ns: int | None = None  # the stamp before that

    def feed(self, payload: bytes, stamp_ns: int) -> None:
        angle, rpm, current, self.temperature_degc = _FEEDBACK.unpack_from(payload)
        if stamp_ns != self.stamp_ns:
            self.unwrap()
            self._before_ns, self.stamp_ns = self.stamp_ns, stamp_ns
        self._batch.append((angle, rpm))
        self.speed, self.current_a = rpm, current * self._amperes

    def unwrap(self) -> None:
        """Add to the position the turns of the frames with the newest stamp, after all of them were fed.

        Frames that were read together were sent 1 ms apart; the rest of the time since the last stamp lies before the
        first of them. The rotor may have turned more than half a turn in that time, if frames were lost: the number of
        whole turns follows from the speed.
        """
        batch, self._batch = self._batch, []
        for i, (angle, rpm) in enumerate(batch):
            if self._before_ns is not None and self.stamp_ns is not None:
                before_ns = self.stamp_ns - self._before_ns - (len(batch) - 1) * _FEEDBACK_NS
                apart_ns = _FEEDBACK_NS if i else max(before_ns, _FEEDBACK_NS)
                step = angle - self._angle
                self.position += step + _ANGLES * round((rpm / 60.0 * _ANGLES * apart_ns * 1e-9 - step) / _ANGLES)
            self._angle = angle
        self._before_ns = self.stamp_ns


class C620(FourMotors[Settings, _Channel]):
    """Drives four controllers on one bus."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        motor, self._title = MOTORS[settings.controller], settings.controller.upper()
        gear_ratio = settings.gear_ratio or motor.gear_ratio
        capabilities = Capabilities(1000.0, frozenset({"position", "current", "temperature"}), adds_torque=True)
        channels = [_Channel(motor.amperes) for _ in settings.ids]
        to_rad_s, to_rad = _RPM / gear_ratio, math.tau / _ANGLES / gear_ratio
        super().__init__(settings, robot, capabilities, "motor", settings.ids, channels, to_rad_s, to_rad)
        self._counts_per_n_m = 1.0 / (robot.torque_constant_n_m_a * motor.amperes)
        self._max_count = motor.max_count
        self._commanded_ns: int | None = None
        wheels = robot.wheel_of_channel
        opposite = [wheels.index((wheel + 2) % 4) for wheel in wheels]
        self._places = list(zip(wheels, robot.sign_of_channel, opposite, strict=True))
        self._warnings = (
            f"it is not known what a {self._title} does when commands end: keep an e-stop that cuts the motors' power "
            "within reach",
            f"a stopped {self._title} lets its wheel coast and does not brake it",
        )

    @property
    def identity(self) -> str | None:
        return None if self.missing else f"four {self._title} with the ids {', '.join(map(str, self._ids))}"

    @property
    def missing(self) -> str:
        silent = self._with(channel.stamp_ns is None for channel in self._channels)
        return silent and (
            f"no feedback of the motors {silent}; check their power, the bus, and the ids that their lamps blink "
            "(device.motors.ids)"
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
        return self._currents([clamp(round(torque * self._counts_per_n_m), self._max_count) for torque in torque_n_m])

    def _speed_loops(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> FourWheels:
        settings, limit = self._settings, self._robot.torque_limit_n_m
        dt_s = self._robot.period_s if self._commanded_ns is None else (now_ns - self._commanded_ns) * 1e-9
        dt_s = min(dt_s, 2.0 * self._robot.period_s)  # the loop was open during a stall: do not integrate over it
        outdated_ns = self._robot.watchdog_s * 1e9
        heard = [one.stamp_ns is not None and now_ns - one.stamp_ns < outdated_ns for one in self._channels]
        errors = [
            target - channel.speed * self._to_rad_s if is_heard else 0.0
            for channel, target, is_heard in zip(self._channels, speed_rad_s, heard, strict=True)
        ]
        torques = []
        for channel, error, feedforward, is_heard in zip(
            self._channels, self._weighted(errors, speed_rad_s), torque_n_m, heard, strict=True
        ):
            if not is_heard:
                channel.integral_n_m = 0.0
                torques.append(0.0)  # no torque on an outdated speed
                continue
            torque = feedforward + settings.kp_n_m_s_rad * error + channel.integral_n_m
            limited = clamp(torque, limit)
            if torque == limited or error * torque < 0.0:  # no windup at the limit
                channel.integral_n_m = clamp(channel.integral_n_m + settings.ki_n_m_rad * error * dt_s, limit)
            torques.append(limited)
        return four(torques)

    def _weighted(self, errors: Sequence[float], targets: FourWheels) -> Sequence[float]:
        """Return the speed errors of the channels, with less weight on what turns the robot than on what pushes it.

        FL and RR, and FR and RL, push with what they have in common and turn with the difference. A wheel has less to
        accelerate when the robot turns. So with one gain the loop around yaw would be as many times faster, and
        unstable by the delays of wire and host. Wheels that no motion of the robot turns like this are on blocks: each
        is by itself then.
        """
        places = zip(self._places, targets, strict=True)
        against = sum(sign * _FRONT[wheel] * target for (wheel, sign, _), target in places)
        if abs(against) > _AGREE * sum(map(abs, targets)):
            return errors
        share = self._robot.turning_share
        return [
            share * error + 0.5 * (1.0 - share) * (error + sign * errors[opposite] * self._places[opposite][1])
            for error, (_, sign, opposite) in zip(errors, self._places, strict=True)
        ]

    def _currents(self, counts: Sequence[int]) -> Sequence[Frame]:
        """Return the one or two frames that carry the currents. The other motors of these frames get no current."""
        slots: dict[int, list[int]] = {}
        for number, count in zip(self._ids, counts, strict=True):
            slots.setdefault(_LOW if number <= 4 else _HIGH, [0, 0, 0, 0])[(number - 1) % 4] = count
        return [Frame(number, _CURRENTS.pack(*slots[number])) for number in sorted(slots, reverse=True)]

    def disarm(self) -> Sequence[Frame]:
        self._is_armed = False
        return self._currents(_NO_CURRENT)

    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        channel = self._by_id.get(frame.id - _FEEDBACK_BASE)
        if channel is None:
            return ""
        if (why := expected_length(frame.payload, 8)) is None:
            channel.feed(frame.payload, stamp_ns)
        return why

    @property
    def sample(self) -> Sample | None:
        for channel in self._channels:
            channel.unwrap()
        return super().sample

    def _problems(self, channel: _Channel) -> Iterable[str]:
        if channel.temperature_degc > (limit := self._settings.temperature_limit_degc):
            yield f"has {channel.temperature_degc} °C, more than device.motors.temperature_limit_degc = {limit:g}"


class _Probe(IdProbe):
    """Listens only: each motor sends its feedback without being asked."""

    unknown = ("device.motors.controller", "device.motors.gear_ratio", "firmware.torque_constant_n_m_a")

    def feed(self, frame: Frame) -> bool:
        number = frame.id - _FEEDBACK_BASE
        if not 1 <= number <= 8 or len(frame.payload) != 8 or _FEEDBACK.unpack_from(frame.payload)[0] >= _ANGLES:
            return False
        self._sentences[number] = f"a C620 or C610 with the id {number}"
        return True


_NO_CURRENT = (0, 0, 0, 0)
DIALECT = Dialect(
    title="RoboMaster C620 and C610",
    wires=frozenset({"can"}),
    settings=Settings,
    make=C620,
    emulated="hil.addons.motors.c620.emulated_c620:EmulatedC620",
    probe=_Probe,
    description="RoboMaster C620 with M3508, or C610 with M2006",
)
