"""Feedback as the loop takes it, of what the driver of a maker's controllers has measured."""

from firmware_protocol.generated.messages import State
from hil.core.types import Wheels
from hil.drivers.angles import Angles
from hil.drivers.port import Driver
from hil.robot.robot_report import Health
from hil.robot.snapshot import Feedback
from hil.robot.wheel_map import WheelMap

_AGE_UNKNOWN_MS = 255  # as TICK.command_age_ms: this and more


class MotorFeedback:
    """Turns samples in the order of the channels into feedback of the wheels.

    Older than ``stale_s`` nothing begins: a first sample may rest on a speed of long ago, from before the greeting of
    the others.

    Attributes:
        newest: None before all four were heard of late.
        health: what they say of battery and motors.
    """

    def __init__(self, driver: Driver, wheel_map: WheelMap, counts_per_revolution: int, stale_s: float) -> None:
        self._driver = driver
        self._map = wheel_map
        self._angles = Angles(counts_per_revolution)
        self._stale_ns = round(stale_s * 1e9)
        self.newest: Feedback | None = None
        self.health = Health()

    def forget(self) -> None:
        """Know nothing until the next sample: the link was lost."""
        self.newest = None

    def restart(self) -> None:
        """Go on with controllers that may have been reset."""
        self.newest = None
        self._angles.restart()

    def is_fresh(self, now_ns: int) -> bool:
        """Tell whether the oldest of the four speeds is no older than ``stale_s``."""
        sample = self._driver.sample
        return sample is not None and now_ns - sample.stamp_ns <= self._stale_ns

    def renew(self, now_ns: int, state: State, sequence: int) -> None:
        """Make feedback of the newest sample. Its time is that of the oldest speed, by the clock of the run."""
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
