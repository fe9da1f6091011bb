"""The newest answers and measurements of one VESC, in the motor's electrical quantities."""

import math
from collections.abc import Mapping

from hil.core.types import NAN
from hil.drivers.port import clamp
from hil.drivers.vesc import frames

_MAX_UNANSWERED = 2  # questions for a timeout; two for each of four VESCs fit into the time that a start waits
_GAP_NS = 500_000_000  # over a longer gap no angle is integrated from speeds

_CORRECTION_PER_STEP = 0.15  # tuned with odometry on a circle: with less it drifts, with more the steps are visible


class Channel:
    """One VESC.

    Attributes:
        stamp_ns: time of the newest speed. steps_ns: time of the newest tachometer value.
        steps: the newest tachometer value. turned: the same without wraps.
        position: in steps, smoothed by the speed, as a step may be 10 degrees of a wheel.
        motor_a: positive for a torque forwards.
        fault, status: values of GET_VALUES_SELECTIVE; None until they are answered.
        asked_ns: time of the first unanswered question for the fault; None without one.
        is_running: whether its timeout had not run out although nothing was commanded; None while unknown.
        timeout: None while unknown. foreign_id: id in an app configuration that is not its own, else None.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Return to the state before the first answer."""
        self.version: frames.Version | None = None
        self.stamp_ns: int | None = None
        self.erpm = 0
        self.steps: int | None = None
        self.steps_ns = 0
        self.turned = 0
        self.position = 0.0
        self.motor_a = self.input_a = self.input_v = self.fet_degc = NAN
        self.fault: int | None = None
        self._has_answered_fault = False
        self.status: int | None = None
        self._fet_ns = 0
        self.asked_ns: int | None = None
        self.is_running: bool | None = None
        self.timeout: frames.Timeout | None = None
        self.foreign_id: int | None = None
        self._unanswered = 0

    @property
    def is_identified(self) -> bool:
        """Whether it has reported its version and, at least once, its fault."""
        return self.version is not None and self._has_answered_fault

    @property
    def needs_timeout(self) -> bool:
        """Whether to ask for its timeout. After two unanswered questions not: a bridge may drop such long messages."""
        return self.timeout is None and self.foreign_id is None and self._unanswered < _MAX_UNANSWERED

    @property
    def accepts_timeout(self) -> bool:
        """Whether an answer with a timeout is accepted: only after those that identify the VESC."""
        return self.is_identified and self.needs_timeout

    @property
    def has_answered(self) -> bool:
        """Whether it is identified, and its timeout is known or no longer asked for."""
        return self.is_identified and not self.needs_timeout

    @property
    def has_measured(self) -> bool:
        """Whether speed, position and temperature have arrived."""
        return self.stamp_ns is not None and self.steps is not None and not math.isnan(self.fet_degc)

    @property
    def is_healthy(self) -> bool:
        """Whether it has reported that it has no fault, and has not reported a pressed kill switch."""
        return self.fault == 0 and not (self.status or 0) & frames.KILL_SWITCH

    def feed_status(self, command: int, payload: bytes, stamp_ns: int) -> None:
        """Take a status message from CAN."""
        if command == frames.CAN_STATUS and len(payload) == frames.STATUS.size:
            erpm, current, duty = frames.STATUS.unpack(payload)
            self._feed_motion(erpm, current * 0.1, (erpm or duty) < 0, stamp_ns)
        elif command == frames.CAN_STATUS_4 and len(payload) == frames.STATUS_4.size:
            fet, _, current, _ = frames.STATUS_4.unpack(payload)
            self.fet_degc, self.input_a, self._fet_ns = fet * 0.1, current * 0.1, stamp_ns
        elif command == frames.CAN_STATUS_5 and len(payload) >= frames.STATUS_5.size:
            steps, voltage = frames.STATUS_5.unpack_from(payload)
            self._feed_tachometer(steps, stamp_ns)
            self.input_v = voltage * 0.1

    def feed_values(self, values: Mapping[str, float], stamp_ns: int, has_commanded: bool) -> None:
        """Take the values of an answer."""
        if "fault" in values:
            self.fault, self._has_answered_fault = int(values["fault"]), True
            self.asked_ns = None
        if "status" in values:
            self.status = int(values["status"])
            if not has_commanded:
                self.is_running = not self.status & frames.HAS_TIMED_OUT
        if {"erpm", "motor_a", "tachometer", "fet_degc", "input_a", "input_v"} <= values.keys():
            erpm = int(values["erpm"])
            self._feed_motion(erpm, values["motor_a"], erpm < 0, stamp_ns)
            self._feed_tachometer(int(values["tachometer"]), stamp_ns)
            self.fet_degc, self.input_a, self.input_v = values["fet_degc"], values["input_a"], values["input_v"]
            self._fet_ns = stamp_ns

    def feed_timeout(self, timeout: frames.Timeout, vesc: int) -> None:
        """Take the timeout that the VESC with the id ``vesc`` answered; it is ignored if it contains another id."""
        if timeout.vesc == vesc:
            self.timeout = timeout
        else:
            self.foreign_id = timeout.vesc

    def count_unanswered_timeout(self) -> None:
        """Count a question for the timeout that an identified VESC has not answered."""
        if self.is_identified:
            self._unanswered += 1

    def forget_late(self, now_ns: int, late_ns: int) -> None:
        """Forget temperature, input current and input voltage if their status messages no longer come."""
        if now_ns - self._fet_ns > late_ns:
            self.fet_degc = self.input_a = NAN
        if now_ns - self.steps_ns > late_ns:
            self.input_v = NAN

    def _feed_motion(self, erpm: int, current_a: float, is_backwards: bool, stamp_ns: int) -> None:
        """Take speed and current. A VESC's current is positive when it drives; here it gets the sign of the torque."""
        if self.stamp_ns is not None and stamp_ns - self.stamp_ns < _GAP_NS:
            mean_erpm = 0.5 * (erpm + self.erpm)
            self.position += mean_erpm / 60.0 * frames.STEPS * (stamp_ns - self.stamp_ns) * 1e-9
        self.erpm, self.stamp_ns = erpm, stamp_ns
        self.motor_a = -current_a if is_backwards else current_a

    def _feed_tachometer(self, steps: int, stamp_ns: int) -> None:
        """Correct the position by the tachometer: a bit with each step, and always to within one step of it."""
        moved = 0 if self.steps is None else (steps - self.steps + 2**31) % 2**32 - 2**31
        self.steps, self.steps_ns = steps, stamp_ns
        self.turned += moved
        self.position += (self.turned - self.position) * min(_CORRECTION_PER_STEP * abs(moved), 1.0)
        self.position = clamp(self.position, self.turned + 1.0, self.turned - 1.0)
