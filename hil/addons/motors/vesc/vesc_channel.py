"""The newest answers and measurements of one VESC, and the warnings about its timeout."""

import math
from collections.abc import Iterable, Mapping

from hil.addons.motors import driver_parts
from hil.addons.motors.driver_parts import expected_length
from hil.addons.motors.vesc import vesc_frames as frames
from hil.core.types import NAN
from hil.robot.driver import RobotFacts, clamp

_MAX_UNANSWERED = 2  # questions for a timeout; two for each of four VESCs fit into the time that a start waits
_GAP_NS = 500_000_000  # over a longer gap no angle is integrated from speeds

_CORRECTION_PER_STEP = 0.15  # tuned with odometry on a circle: with less it drifts, with more the steps are visible


class Channel(driver_parts.Channel):
    """One VESC. The speed is in ERPM, the position in steps of the tachometer.

    A step may be 10° of a wheel, so the position follows the speed between steps.

    Attributes:
        steps: the newest tachometer value. steps_ns: its time of arrival.
        turned: the steps counted since the first value, without the tachometer's overflow.
        current_a: positive for a torque forwards. temperature_degc: of the MOSFETs.
        fault, status: values of GET_VALUES_SELECTIVE; None until they are answered.
        asked_ns: time of the first unanswered question for the fault; None without one.
        timeout: None while unknown.
    """

    def forget(self) -> None:
        super().forget()
        self.version: frames.Version | None = None
        self.steps: int | None = None
        self.steps_ns = self._fet_ns = self.turned = 0
        self.fault: int | None = None
        self._has_answered_fault = False
        self.status: int | None = None
        self.asked_ns: int | None = None
        self.timeout: frames.Timeout | None = None
        self._unanswered = 0

    @property
    def is_identified(self) -> bool:
        """Whether it has reported its version and, at least once, its fault."""
        return self.version is not None and self._has_answered_fault

    @property
    def needs_timeout(self) -> bool:
        """Whether to ask for its timeout. After two unanswered questions not: a bridge may drop such long messages."""
        return self.timeout is None and self._unanswered < _MAX_UNANSWERED

    @property
    def has_answered(self) -> bool:
        """Whether it is identified, and its timeout is known or no longer asked for."""
        return self.is_identified and not self.needs_timeout

    @property
    def has_measured(self) -> bool:
        """Whether speed, position and temperature have arrived."""
        return self.stamp_ns is not None and self.steps is not None and not math.isnan(self.temperature_degc)

    @property
    def is_healthy(self) -> bool:
        """Whether it has reported that it has no fault, and has not reported a pressed kill switch."""
        return self.fault == 0 and not (self.status or 0) & frames.KILL_SWITCH

    def feed_status(self, command: int, payload: bytes, stamp_ns: int) -> str | None:
        """Take a status message from CAN. Return why it was not used, as ``Driver.feed``."""
        if command == frames.CAN_STATUS and len(payload) == frames.STATUS.size:
            erpm, current, duty = frames.STATUS.unpack(payload)
            self._feed_motion(erpm, current * 0.1, (erpm or duty) < 0, stamp_ns)
        elif command == frames.CAN_STATUS_4 and len(payload) == frames.STATUS_4.size:
            fet, _, current, _ = frames.STATUS_4.unpack(payload)
            self.temperature_degc, self.supply_a, self._fet_ns = fet * 0.1, current * 0.1, stamp_ns
        elif command == frames.CAN_STATUS_5 and len(payload) >= frames.STATUS_5.size:
            steps, voltage = frames.STATUS_5.unpack_from(payload)
            self._feed_tachometer(steps, stamp_ns)
            self.supply_v = voltage * 0.1
        elif command in frames.STATUS_BYTES:
            return expected_length(payload, frames.STATUS_BYTES[command])
        else:
            return ""
        return None

    def feed_values(self, values: Mapping[str, float], stamp_ns: int) -> None:
        """Take the values of an answer."""
        if "fault" in values:
            self.fault, self._has_answered_fault = int(values["fault"]), True
            self.asked_ns = None
        if "status" in values:
            self.status = int(values["status"])
        if {"erpm", "motor_a", "tachometer", "fet_degc", "input_a", "input_v"} <= values.keys():
            erpm = int(values["erpm"])
            self._feed_motion(erpm, values["motor_a"], erpm < 0, stamp_ns)
            self._feed_tachometer(int(values["tachometer"]), stamp_ns)
            self.temperature_degc, self._fet_ns = values["fet_degc"], stamp_ns
            self.supply_a, self.supply_v = values["input_a"], values["input_v"]

    def feed_timeout(self, timeout: frames.Timeout, vesc: int) -> None:
        """Take the timeout that the VESC with the id ``vesc`` answered.

        One with another id is ignored, and so is one before the VESC is identified or when none is awaited.
        """
        if self.is_identified and self.needs_timeout and timeout.vesc == vesc:
            self.timeout = timeout

    def count_unanswered_timeout(self) -> None:
        """Count a question for the timeout that an identified VESC has not answered."""
        self._unanswered += self.is_identified

    def forget_late(self, now_ns: int, late_ns: int) -> None:
        """Forget temperature, input current and input voltage if their status messages no longer come."""
        if now_ns - self._fet_ns > late_ns:
            self.temperature_degc = self.supply_a = NAN
        if now_ns - self.steps_ns > late_ns:
            self.supply_v = NAN

    def _feed_motion(self, erpm: int, current_a: float, is_backwards: bool, stamp_ns: int) -> None:
        """Take speed and current. A VESC's current is positive when it drives; here it gets the sign of the torque."""
        if self.stamp_ns is not None and stamp_ns - self.stamp_ns < _GAP_NS:
            mean_erpm = 0.5 * (erpm + self.speed)
            self.position += mean_erpm / 60.0 * frames.STEPS * (stamp_ns - self.stamp_ns) * 1e-9
        self.speed, self.stamp_ns = erpm, stamp_ns
        self.current_a = -current_a if is_backwards else current_a

    def _feed_tachometer(self, steps: int, stamp_ns: int) -> None:
        """Correct the position by the tachometer: a bit with each step, and always to within one step of it."""
        moved = 0 if self.steps is None else (steps - self.steps + 2**31) % 2**32 - 2**31
        self.steps, self.steps_ns = steps, stamp_ns
        self.turned += moved
        self.position += (self.turned - self.position) * min(_CORRECTION_PER_STEP * abs(moved), 1.0)
        self.position = clamp(self.position, self.turned + 1.0, self.turned - 1.0)


_WHERE = "App Settings > General > Timeout in VESC Tool"
_END = "when commands end"
_SECONDS_FROM_S = 10.0


def has_timeout(channel: Channel, robot: RobotFacts) -> bool:
    """Return whether the VESC is known to release or brake its wheel within ``watchdog_s`` after the last command."""
    return channel.timeout is not None and 0.0 < channel.timeout.timeout_s <= robot.watchdog_s


def timeout_warnings(by_id: Mapping[int, Channel], robot: RobotFacts) -> Iterable[str]:
    """Yield a sentence for each problem with the timeouts, with the ids concerned.

    Nothing but the timeouts stops the wheels when commands end. On a serial line the guardian outlives the run.
    """
    required = f"{robot.watchdog_s * 1e3:g} ms"
    killed = "" if robot.wire == "serial" else "this program is killed, or "
    failures = f"{killed}this computer loses its power, hangs, or loses the cable"
    known = {vesc: channel.timeout for vesc, channel in by_id.items() if channel.timeout is not None}
    if unknown := _ids(vesc for vesc in by_id if vesc not in known):
        yield (
            f"the timeout of the VESC {unknown} is not known: {_END} its wheel turns on for that time (by "
            "default 1 s, with 0 for ever), and then rolls if there is no brake current; so it does if "
            f"{failures}; keep the robot's power switch within reach, and set {_WHERE} to {required}, with a "
            "Timeout Brake Current"
        )
    for timeout_s in sorted({timeout.timeout_s for timeout in known.values()}):
        vescs = _ids(vesc for vesc, timeout in known.items() if timeout.timeout_s == timeout_s)
        words = f"{timeout_s:.0f} s" if timeout_s >= _SECONDS_FROM_S else f"{timeout_s * 1e3:g} ms"
        if timeout_s == 0.0:
            yield (
                f"the timeout of the VESC {vescs} is 0: {_END} its wheel turns on with the last one, and nothing stops "
                f"it if {failures}; keep the robot's power switch within reach, and set {_WHERE} to {required}"
            )
        elif timeout_s > robot.watchdog_s:
            yield (
                f"the timeout of the VESC {vescs} is {words}, longer than firmware.watchdog_s: its wheel turns on for "
                f"that time {_END}; set {_WHERE} to {required}"
            )
        elif timeout_s <= robot.period_s:
            yield (
                f"the timeout of the VESC {vescs} is {words}, no longer than the {robot.period_s * 1e3:g} ms between "
                f"two commands: it runs out between them, and its wheel jerks; set {_WHERE} to {required}"
            )
    ending = {vesc: timeout for vesc, timeout in known.items() if timeout.timeout_s > 0.0}
    if rolling := _ids(vesc for vesc, timeout in ending.items() if timeout.brake_current_a < frames.MIN_CURRENT_A):
        yield (
            f"the VESC {rolling} brakes with no current after its timeout: {_END} its wheel rolls; set Timeout Brake "
            "Current, beside the Timeout in VESC Tool"
        )


def _ids(vescs: Iterable[int]) -> str:
    return ", ".join(map(str, vescs))
