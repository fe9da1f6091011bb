"""What one VESC has said of itself and its motor, in the motor's electrical quantities."""

import math
from collections.abc import Mapping

from hil.core.types import NAN
from hil.drivers.vesc import frames

_MOST_IN_VAIN = 2  # of the questions for a timeout; two for each of four fit into the time that a start waits
_GAP_NS = 500_000_000  # a speed says nothing of a time as long

_TRUST_A_STEP = 0.15  # measured on the circle by odometry: with less it drifts, with more the steps are felt


class Channel:
    """One VESC.

    Attributes:
        stamp_ns: when its speed was heard. steps_ns: when its tachometer was.
        steps: of the tachometer as heard last; turned: without its wraps.
        position: in such steps, smoothed between them by the speed, as a step may be 10 degrees of a wheel.
        motor_a: positive for a torque forwards.
        fault, status: as of GET_VALUES_SELECTIVE, None where they have to be asked for.
        asked_ns: since when it has not answered what its fault is, None while nothing is asked.
        runs_on: whether its timeout had not run out while nothing was commanded.
        timeout: as it was read, None while it is not known; strange_id: of whom what it told is, if not its own.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Be as before anything was heard."""
        self.version: frames.Version | None = None
        self.stamp_ns: int | None = None
        self.erpm = 0
        self.steps: int | None = None
        self.steps_ns = 0
        self.turned = 0
        self.position = 0.0
        self.motor_a = self.input_a = self.input_v = self.fet_degc = NAN
        self.fault: int | None = None
        self._has_told_fault = False
        self.status: int | None = None
        self._fet_ns = 0
        self.asked_ns: int | None = None
        self.runs_on: bool | None = None
        self.timeout: frames.Timeout | None = None
        self.strange_id: int | None = None
        self._in_vain = 0

    @property
    def has_said_who(self) -> bool:
        """Whether it has said its version and, at some time, its fault."""
        return self.version is not None and self._has_told_fault

    @property
    def is_asked_for_timeout(self) -> bool:
        """Whether its timeout may still be told: some bridge may pass on no message as long as that."""
        return self.timeout is None and self.strange_id is None and self._in_vain < _MOST_IN_VAIN

    @property
    def awaits_timeout(self) -> bool:
        """Whether an answer with a timeout is believed: it comes behind those of who it is."""
        return self.has_said_who and self.is_asked_for_timeout

    @property
    def has_answered(self) -> bool:
        """Whether it has said who it is, and its timeout is known or asked for no more."""
        return self.has_said_who and not self.is_asked_for_timeout

    @property
    def has_measured(self) -> bool:
        """Whether speed, position, temperature and voltage have been heard."""
        return self.stamp_ns is not None and self.steps is not None and not math.isnan(self.fet_degc)

    @property
    def is_fit(self) -> bool:
        """Whether it has no fault and no kill switch is pressed, as far as it says."""
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
            self.fault, self._has_told_fault = int(values["fault"]), True
            self.asked_ns = None
        if "status" in values:
            self.status = int(values["status"])
            if not has_commanded:
                self.runs_on = not self.status & frames.HAS_TIMED_OUT
        if {"erpm", "motor_a", "tachometer", "fet_degc", "input_a", "input_v"} <= values.keys():
            erpm = int(values["erpm"])
            self._feed_motion(erpm, values["motor_a"], erpm < 0, stamp_ns)
            self._feed_tachometer(int(values["tachometer"]), stamp_ns)
            self.fet_degc, self.input_a, self.input_v = values["fet_degc"], values["input_a"], values["input_v"]
            self._fet_ns = stamp_ns

    def feed_timeout(self, timeout: frames.Timeout, vesc: int) -> None:
        """Take the answer of the VESC with this id; with another id in it, it is not believed."""
        if timeout.vesc == vesc:
            self.timeout = timeout
        else:
            self.strange_id = timeout.vesc

    def miss_timeout(self) -> None:
        """Take note that who answers has not answered this."""
        if self.has_said_who:
            self._in_vain += 1

    def forget_late(self, now_ns: int, late_ns: int) -> None:
        """Forget temperature, current and voltage of the battery where their status messages have fallen silent."""
        if now_ns - self._fet_ns > late_ns:
            self.fet_degc = self.input_a = NAN
        if now_ns - self.steps_ns > late_ns:
            self.input_v = NAN

    def _feed_motion(self, erpm: int, current_a: float, is_backwards: bool, stamp_ns: int) -> None:
        """Take speed and current; theirs is positive when it drives, and is made into a direction here."""
        if self.stamp_ns is not None and stamp_ns - self.stamp_ns < _GAP_NS:
            mean_erpm = 0.5 * (erpm + self.erpm)
            self.position += mean_erpm / 60.0 * frames.STEPS * (stamp_ns - self.stamp_ns) * 1e-9
        self.erpm, self.stamp_ns = erpm, stamp_ns
        self.motor_a = -current_a if is_backwards else current_a

    def _feed_tachometer(self, steps: int, stamp_ns: int) -> None:
        """Take the tachometer: the truth in the long run, while it moves, and within a step at any time."""
        moved = 0 if self.steps is None else (steps - self.steps + 2**31) % 2**32 - 2**31
        self.steps, self.steps_ns = steps, stamp_ns
        self.turned += moved
        self.position += (self.turned - self.position) * min(_TRUST_A_STEP * abs(moved), 1.0)
        self.position = min(max(self.position, self.turned - 1.0), self.turned + 1.0)
