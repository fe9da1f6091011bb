"""Feedback and report of a robot with makers' motors, made of the samples of their driver."""

import math
from collections.abc import Callable
from typing import NamedTuple

from firmware_protocol.generated.messages import State
from hil.core.types import FourWheels, Wheels
from hil.core.wheel_map import ImuMount, WheelMap
from hil.robot.driver import Driver, Sample, four
from hil.robot.robot_report import Health
from hil.robot.snapshot import Feedback

# A longer gap is a lost link or a stall of this process: the mean of two speeds is not the speed between them.
_LONGEST_S = 0.25
_MOVES_RAD_S = 0.5  # one encoder count in 10 ms, which is how some makers measure a speed
_LASTS_NS = 500_000_000
_AGE_UNKNOWN_MS = 255  # as TICK.command_age_ms: this and more


class Angles:
    """Makes encoder counts of reported positions, or of integrated speeds where no position is reported.

    After a loss the angles continue from their old values: a controller that was reset counts from zero again, and how
    far the wheels rolled meanwhile is unknown. So it is over a gap of more than 0.25 s where only speeds are reported.
    """

    def __init__(self, counts_per_revolution: int) -> None:
        self._per_rad = counts_per_revolution / math.tau
        self._angle_rad: FourWheels = (0.0, 0.0, 0.0, 0.0)
        self._last: Sample | None = None

    def add(self, sample: Sample) -> tuple[int, int, int, int]:
        """Add the newest sample and return the counts of the four channels, which wrap at 16 bits."""
        if self._last is not None:
            last = self._last
            dt_s = max(0.0, (sample.stamp_ns - last.stamp_ns) * 1e-9)
            integrated_s = dt_s if dt_s <= _LONGEST_S else 0.0
            speeds = zip(last.speed_rad_s, sample.speed_rad_s, strict=True)
            integrated = (0.5 * (slow + fast) * integrated_s for slow, fast in speeds)
            moved = (now - before for before, now in zip(last.position_rad, sample.position_rad, strict=True))
            self._angle_rad = four(
                angle + (by_speed if math.isnan(by_position) else by_position)
                for angle, by_speed, by_position in zip(self._angle_rad, integrated, moved, strict=True)
            )
        self._last = sample
        return four(round(angle * self._per_rad) & 0xFFFF for angle in self._angle_rad)

    def restart(self) -> None:
        """Continue with controllers that may have been reset."""
        self._last = None


class MotorsInfo(NamedTuple):
    """The controllers' identity, as they report it."""

    words: str
    has_power_stage: bool = True

    def describe(self) -> str:
        """Return the same in words."""
        return self.words


class MakersReport:
    """What the controllers report: feedback in the order of the wheels, health, and why they stopped.

    The first feedback needs a sample no older than ``stale_s``: an older one may hold the speed of a controller that
    answered long before the others.

    Attributes:
        newest: the newest feedback; None before the first sample of all four that is no older than ``stale_s``.
        health: battery and motor temperatures as the controllers measure them.
        why: the cause of their stop, None if the host stopped them.
        trouble: a warning that the user must see at once; None without one.
    """

    def __init__(
        self, driver: Driver, wheel_map: WheelMap, imu: ImuMount, counts_per_revolution: int, stale_s: float
    ) -> None:
        self._driver = driver
        self._map, self._imu = wheel_map, imu
        self._angles = Angles(counts_per_revolution)
        self._stale_s = stale_s
        self._moving_since_ns: int | None = None
        self.newest: Feedback | None = None
        self.health = Health()
        self.why: str | None = None
        self.trouble: str | None = None

    # Feedback

    def restart(self) -> None:
        """Continue with controllers that may have been reset."""
        self.newest = None
        self._angles.restart()

    def is_fresh(self, now_ns: int) -> bool:
        """Return whether the oldest of the four speeds is no older than ``stale_s``."""
        sample = self._driver.sample
        return sample is not None and now_ns - sample.stamp_ns <= self._stale_s * 1e9

    def renew(self, now_ns: int, state: State, sequence: int) -> None:
        """Make feedback of the newest sample. Its time is that of the oldest speed, on the clock of the run."""
        sample = self._driver.sample
        if sample is None or (self.newest is None and not self.is_fresh(now_ns)):
            return
        temperatures = self._map.temperatures_from_wire(Wheels(*sample.temperature_degc))
        self.health = Health(sample.battery_v, sample.battery_a, temperatures)
        self.newest = Feedback(
            sample.stamp_ns,
            state,
            sequence,
            _AGE_UNKNOWN_MS,
            self._map.counts_from_wire(self._angles.add(sample)),
            self._map.from_wire(sample.speed_rad_s),
            self._map.from_wire(sample.current_a),
            self._imu.to_body(sample.acceleration_m_s2),
            self._imu.yaw_rate(sample.yaw_rate_rad_s),
        )

    # Reasons

    def set_trouble(self, stop_problem: str | None, sample: Sample | None) -> None:
        """Set ``trouble``. ``stop_problem``: why a stop was not sent; ``sample``: of a base that should stand."""
        if sample is None or max(map(abs, sample.speed_rad_s)) < _MOVES_RAD_S:
            self._moving_since_ns = None
        elif self._moving_since_ns is None:
            self._moving_since_ns = sample.stamp_ns
        self.trouble = None
        if stop_problem is not None:
            self.trouble = f"the stop could not be sent: {stop_problem}"
        elif (
            sample is not None
            and self._moving_since_ns is not None
            and sample.stamp_ns - self._moving_since_ns > _LASTS_NS
        ):
            self.trouble = "the wheels turn, but this program has not armed them: an e-stop stops them"

    def stop_reason(self) -> str:
        """Return why the robot last stopped, in words that follow on "because of"."""
        return f"this: {self.why}" if self.why else "no error that it reports"

    def why_not_active(self, state: State, now_ns: int, explain: Callable[[str, int], str]) -> str:
        """Return why the robot cannot be driven, and the remedy; ``explain`` is that of ``MotorLine``."""
        if state is State.ESTOP:
            return "an e-stop is latched; clear it when the robot may be armed again"
        if state is State.FAULT:
            return (
                f"the motor controllers reported {self.why}; find the cause, then clear it with their maker's "
                "tool, or with hil serve and hil ctl clear"
            )
        if not self.is_fresh(now_ns):
            silent = (
                "the motor controllers send no feedback of all four wheels that is younger than the "
                f"{self._stale_s:g} s of firmware.watchdog_s; look at its rate, and whether all four send it"
            )
            return explain(self._driver.missing or silent, now_ns)
        return "the motor controllers did not go into closed loop within 4 s; look at them with their maker's tool"

    def explains(self, state: State) -> bool:
        """Return whether the cause is known; an error is reported before the motors are stopped for it."""
        return state is not State.FAULT or self.why is not None

    last_reset = ""  # they do not report it
    knows_no_reason = False  # that nothing has stopped them is never reported
