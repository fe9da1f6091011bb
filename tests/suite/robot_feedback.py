"""Messages of a robot by PROTOCOL.md: HELLO, snapshots with their means, and those sent ten times a second."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from firmware_protocol.capabilities import Capability
from firmware_protocol.generated import messages as m
from tests.suite.wheel_model import speed_limit, ticks

if TYPE_CHECKING:
    from tests.suite.robot_model import RobotModel

_PAGES = 8
_SLOW = {Capability.CURRENTS: 4, Capability.ACCELEROMETER: 8, Capability.GYRO: 16}  # and their bit in TICK.parts
_COLDEST_DEGC, _PLAUSIBLE = -45.0, 1e6


class Sense(NamedTuple):
    """What the sensors say at the beginning of a tick; binary32, as the plant gives it."""

    counts: tuple[int, ...]
    current_a: tuple[float, ...]
    gyro_rad_s: tuple[float, ...]
    acceleration_m_s2: tuple[float, ...]
    battery_v: float
    battery_a: float
    temperature_degc: tuple[float, ...]

    def is_plausible(self) -> bool:
        """Tell whether each value is one that a sensor can measure."""
        inertial = (*self.gyro_rad_s, *self.acceleration_m_s2)
        values = (*self.current_a, *inertial, *self.temperature_degc, self.battery_v, self.battery_a)
        is_number = not math.isnan(sum(values))  # a thermistor without its wire is as cold as nothing is
        return is_number and max(map(abs, values)) <= _PLAUSIBLE and min(self.temperature_degc) >= _COLDEST_DEGC


def _within(values: Sequence[float], limit: float) -> list[float]:
    return [min(limit, max(-limit, value)) for value in values]


class Feedback:
    """The messages that a robot sends by itself, into its ``out``."""

    def __init__(self, robot: "RobotModel") -> None:
        self._robot = robot
        self._samples: list[Sense] = []  # of the feedback period so far
        self._period: list[Sense] = []  # of the newest one that has ended
        self._snapshot = 0

    def hello(self) -> None:
        """Tell the pages of HELLO."""
        robot, p = self._robot, self._robot.values
        size = (p["wheel_radius_m"], p["half_length_m"], p["half_width_m"], int(p["counts_per_revolution"]))
        periods = ticks(p["watchdog_s"]), ticks(p["feedback_period_s"])
        robot.out += [
            m.HelloIdentity(m.PROTOCOL_VERSION, _PAGES, robot.capabilities, m.SCHEMA_HASH),
            m.HelloFirmware(0, 1, 0, 0, 0),
            m.HelloParameters(robot.parameters.hash(), *periods),
            m.HelloGeometry(*size),
            m.HelloLimits(speed_limit(p), p["overspeed_rad_s"], p["torque_limit_n_m"]),
            m.HelloFaultStatus(0, 0),
            m.HelloFaultPlace(0, 0),
            m.HelloFaultAddress(0, 0),
        ]

    def status(self) -> None:
        """Tell the state, and why."""
        r = self._robot
        causes = (r.fault, r.fault_wheel, r.stop_reason, r.reset_cause)
        r.out.append(m.Status(r.state, r.mode, *causes, r.session, r.refusal, r.limited & 0xFFFF))

    def tell(self) -> None:
        """Tell what is due in this tick."""
        robot, period = self._robot, ticks(self._robot.values["feedback_period_s"])
        plausible = robot.is_plausible
        if plausible:
            self._samples.append(robot.sensed)
        if robot.tick % period == 0:
            self._period, self._samples = self._samples, []
            self._tell_snapshot(plausible and (period >= 5 or robot.tick % 5 == 0))
        if robot.tick % 100 == 0:
            self.status()
            counts = robot.counts
            robot.out.append(m.LinkCounters(*(counts[name] & 0xFF for name in m.LinkCounters._fields)))
            robot.out.append(m.PortCounters(*(counts[name] & 0xFF for name in m.PortCounters._fields)))
            if plausible:
                self._tell_power()
        if robot.tick % 1000 == 0:
            absolute = [count & 0xFFFF_FFFF for count in robot.trackers.absolute.tolist()]
            robot.out += [m.AbsoluteFront(*absolute[:2]), m.AbsoluteRear(*absolute[2:])]

    def _mean(self, name: str) -> tuple[float, ...]:
        values = [getattr(sample, name) for sample in self._period]
        return tuple(sum(column) / len(values) for column in zip(*values, strict=True))

    def _tell_power(self) -> None:
        robot = self._robot
        if robot.capabilities & Capability.POWER and self._period:
            volts = sum(one.battery_v for one in self._period) / len(self._period)
            amperes = sum(one.battery_a for one in self._period) / len(self._period)
            robot.out.append(m.Power(*_within((volts, amperes), 255.9921875)))
        if robot.capabilities & Capability.TEMPERATURES:
            robot.out.append(m.Temperatures(*_within(robot.sensed.temperature_degc, 255.9921875)))

    def _tell_snapshot(self, with_slow: bool) -> None:
        robot = self._robot
        has = {part: with_slow and bool(robot.capabilities & one) for one, part in _SLOW.items()}
        parts = 3 + sum(part for part, there in has.items() if there)
        age = 255 if robot.age is None else min(robot.age, 255)
        millisecond = robot.tick & 0xFFFF
        time_us = robot.tick * 1000 & 0xFFFF_FFFF
        robot.out.append(m.Tick(time_us, robot.sequence, age, robot.state, parts, self._snapshot))
        self._snapshot = (self._snapshot + 1) & 0xFF
        robot.out.append(m.Encoders(*robot.sensed.counts))
        robot.out.append(m.WheelSpeeds(*_within(robot.speed.tolist(), 127.99609375)))
        if has[4]:
            robot.out.append(m.Currents(*_within(self._mean("current_a"), 31.9990234375)))
        if has[8]:
            mean = _within(self._mean("acceleration_m_s2"), 127.99609375)
            robot.out.append(m.Accelerometer._make((*mean, millisecond)))
        if has[16]:
            robot.out.append(m.Gyro._make((*_within(robot.sensed.gyro_rad_s, 31.9990234375), millisecond)))
