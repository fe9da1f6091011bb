"""Feedback and report of a robot with makers' motors, made of the samples of their driver."""

import math
from typing import NamedTuple

from firmware_protocol.generated.messages import State
from hil.core.types import FourWheels, Wheels
from hil.drivers.port import Driver, Sample, four
from hil.robot.robot_report import Health
from hil.robot.snapshot import Feedback
from hil.robot.wheel_map import WheelMap

# A longer gap is a lost link or a stall of this process: the mean of two speeds is not the speed between them.
_LONGEST_S = 0.25


class Angles:
    """Makes encoder counts of reported positions, or of integrated speeds where no position is reported.

    After a loss the angles continue from their old values: a controller that was reset counts from zero again, and how
    far the wheels rolled meanwhile is unknown. So it is over a gap of more than 0.25 s where only speeds are reported.
    """

    def __init__(self, counts_per_revolution: int) -> None:
        self._per_rad = counts_per_revolution / math.tau
        self._angle_rad: FourWheels = (0.0, 0.0, 0.0, 0.0)
        self._last: Sample | None = None

    def take(self, sample: Sample) -> tuple[int, int, int, int]:
        """Take the newest sample and return the counts of the four channels, which wrap at 16 bits."""
        last, self._last = self._last, sample
        if last is not None and last is not sample:
            self._angle_rad = self._next_angles(last, sample)
        return four(round(angle * self._per_rad) & 0xFFFF for angle in self._angle_rad)

    def restart(self) -> None:
        """Continue with controllers that may have been reset."""
        self._last = None

    def _next_angles(self, last: Sample, sample: Sample) -> FourWheels:
        dt_s = max(0.0, (sample.stamp_ns - last.stamp_ns) * 1e-9)
        integrated_s = dt_s if dt_s <= _LONGEST_S else 0.0
        return four(
            turned + (0.5 * (slow + fast) * integrated_s if math.isnan(now - before) else now - before)
            for turned, before, now, slow, fast in zip(
                self._angle_rad,
                last.position_rad,
                sample.position_rad,
                last.speed_rad_s,
                sample.speed_rad_s,
                strict=True,
            )
        )


_MOVES_RAD_S = 0.5  # one encoder count in 10 ms, which is how some makers measure a speed
_LASTS_NS = 500_000_000


class UnaskedMotion:
    """Detects wheels that turn for more than half a second though the base was not armed."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def lasts(self, sample: Sample | None) -> bool:
        """Take the newest sample; return whether the motion has lasted. None stands for a base that may move."""
        if sample is None or max(map(abs, sample.speed_rad_s)) < _MOVES_RAD_S:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = sample.stamp_ns
        return sample.stamp_ns - self._since_ns > _LASTS_NS


_AGE_UNKNOWN_MS = 255  # as TICK.command_age_ms: this and more


class MotorFeedback:
    """Turns samples, in the order of the channels, into feedback, in the order of the wheels.

    No first feedback is made of a sample older than ``stale_s``: it may hold a speed of long ago, from before the
    others answered.

    Attributes:
        stale_s: as given.
        newest: None before the first sample of all four that is no older than ``stale_s``.
        health: battery and motor temperatures.
    """

    def __init__(self, driver: Driver, wheel_map: WheelMap, counts_per_revolution: int, stale_s: float) -> None:
        self._driver = driver
        self._map = wheel_map
        self._angles = Angles(counts_per_revolution)
        self.stale_s = stale_s
        self.newest: Feedback | None = None
        self.health = Health()

    def forget(self) -> None:
        """Have no feedback until the next sample: the link was lost."""
        self.newest = None

    def restart(self) -> None:
        """Continue with controllers that may have been reset."""
        self.newest = None
        self._angles.restart()

    def is_fresh(self, now_ns: int) -> bool:
        """Return whether the oldest of the four speeds is no older than ``stale_s``."""
        sample = self._driver.sample
        return sample is not None and now_ns - sample.stamp_ns <= self.stale_s * 1e9

    def renew(self, now_ns: int, state: State, sequence: int) -> None:
        """Make feedback of the newest sample. Its time is that of the oldest speed, on the clock of the run."""
        sample = self._driver.sample
        if sample is None or (self.newest is None and not self.is_fresh(now_ns)):
            return
        self.health = Health(
            sample.battery_v, sample.battery_a, self._map.temperatures_from_wire(Wheels(*sample.temperature_degc))
        )
        self.newest = self._map.feedback_from_wire(
            Feedback(
                sample.stamp_ns,
                state,
                sequence,
                _AGE_UNKNOWN_MS,
                self._angles.take(sample),
                Wheels(*sample.speed_rad_s),
                Wheels(*sample.current_a),
                sample.acceleration_m_s2,
                sample.yaw_rate_rad_s,
            )
        )


class MotorsInfo(NamedTuple):
    """The controllers' identity, as they report it."""

    words: str
    has_power_stage: bool = True

    def describe(self) -> str:
        """Return the same in words."""
        return self.words


class MakersReport:
    """What is known of the controllers beside the feedback. ``why``: the cause of their stop, None if the host's."""

    def __init__(self, feedback: MotorFeedback) -> None:
        self._feedback = feedback
        self.why: str | None = None
        self.trouble: str | None = None
        self._unasked_motion = UnaskedMotion()

    def set_trouble(self, stop_problem: str | None, sample: Sample | None) -> None:
        """Set ``trouble``. ``stop_problem``: why a stop was not sent; ``sample``: of a base that should stand."""
        is_unasked = self._unasked_motion.lasts(sample)
        self.trouble = None
        if stop_problem is not None:
            self.trouble = f"the stop could not be sent: {stop_problem}"
        elif is_unasked:
            self.trouble = "the wheels turn, and not by us: an e-stop stops them"

    @property
    def health(self) -> Health:
        """Battery and motors as they measure them."""
        return self._feedback.health

    def stop_reason(self) -> str:
        """Return why the robot last stopped, in words that follow on "because of"."""
        return f"this: {self.why}" if self.why else "no error that it tells"

    def why_not_active(self, state: State, missing: str, now_ns: int) -> str:
        """Return what keeps the robot from being driven, and what to do. ``missing`` is the driver's."""
        if state is State.ESTOP:
            return "an e-stop is latched; clear it when the robot may be armed again"
        if state is State.FAULT:
            return (
                f"the motor controllers reported {self.why}; find the cause, then clear it with their maker's "
                "tool, or with hil serve and hil ctl clear"
            )
        if not self._feedback.is_fresh(now_ns):
            return missing or (
                "the motor controllers send no feedback of all four wheels that is younger than the "
                f"{self._feedback.stale_s:g} s of firmware.watchdog_s; look at its rate, and whether all four send it"
            )
        return "the motor controllers did not go into closed loop within 4 s; look at them with their maker's tool"

    def explains(self, state: State) -> bool:
        """Return whether the cause is known; an error is reported before the motors are stopped for it."""
        return state is not State.FAULT or self.why is not None

    @property
    def last_reset(self) -> str:
        """Empty: they do not report it."""
        return ""

    @property
    def knows_no_reason(self) -> bool:
        """False: that nothing has stopped them is never reported."""
        return False
