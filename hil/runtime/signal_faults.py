"""Faults of the signals of a tick: bias, override and reset, each applied where its signal is produced.

Sensor faults act before the estimator, reference faults before the law, command faults before the guard: all later
stages see them, and the guard limits them. A fault of a signal that nothing reads changes only recording and judging.
"""

import random
from array import array
from collections.abc import Callable, Sequence
from typing import TypeVar

from firmware_protocol.generated.messages import State as RobotState
from hil.core.signals import SIGNAL_NAMES, ReferenceSignals, pack_row
from hil.core.types import WHEEL_NAMES, Acceleration, Pose, PoseFix, Reference, State, Twist, WheelCommand, Wheels
from hil.faults.kinds import find
from hil.faults.rows import FaultRow, generators
from hil.robot.snapshot import Feedback

_PER_WHEEL = {
    "speed_rad_s": "speed",
    "current_a": "current",
    "speed_command_rad_s": "speed_command",
    "torque_command_n_m": "torque_command",
}
_FEEDBACK = ("speed", "current", "robot")
_MAKES_THE_STATE = ("speed", "robot", "truth")
_ROBOT = ("time_s", "state", "command_age_ms", "yaw_rate_rad_s")
_AXES = tuple(f"acceleration_{axis}_m_s2" for axis in "xyz")
_NS = 1e9


class _Fault:
    def __init__(self, row: FaultRow, chance: random.Random) -> None:
        self.row = row
        make = find(row.kind, row.target).on_signal
        self._effect = None if make is None else make(row, chance)
        self.ends_others = make is None  # of kind reset
        self.applied = 0
        self.is_over = False  # ended by a reset

    def changed(self, value: float, t_ns: int) -> float:
        assert self._effect is not None, "a kind of signal that happens in a window"
        new = self._effect(value, t_ns)
        self.applied += new != value and not (new != new and value != value)
        return new


def _place(signal: str, names: Sequence[str]) -> tuple[str, int]:
    group, *wheel, name = signal.split(".")
    if wheel and name in _PER_WHEEL:
        return _PER_WHEEL[name], WHEEL_NAMES.index(wheel[0])
    if group == "robot":
        return group, (*_ROBOT, *_AXES).index(name)
    if group == "reference":
        return group, ReferenceSignals._fields.index(name)
    if group in ("truth", "pose"):
        return group, Pose._fields.index(name)
    if group == "twist":
        return "pose", len(Pose._fields) + Twist._fields.index(name)
    return "recorded", names.index(signal)


def can_hold(row: FaultRow) -> bool:
    """Whether a fault can keep a tick from being driven: it cuts off feedback, state or robot."""
    kind = find(row.kind, row.target)
    return kind.explains and (kind.acts_on != "signal" or _place(row.target, (row.target,))[0] in _MAKES_THE_STATE)


Made = TypeVar("Made")


class SignalFaults:
    """The faults of a run that act on signals. ``at`` begins a tick; then each method is called once with its group.

    Rows act in the order of the scenario, each on the result of the one before. ``names`` are the names of the run's
    signals; ``seed`` is that of the random faults.
    """

    def __init__(self, rows: Sequence[FaultRow], names: Sequence[str] = SIGNAL_NAMES, seed: int = 1) -> None:
        self._faults = [_Fault(*one) for one in zip(rows, generators(rows, seed), strict=True)]
        self._groups: dict[str, list[tuple[int, _Fault]]] = {}
        for fault in self._faults:
            if not fault.ends_others:
                group, index = _place(fault.row.target, names)
                self._groups.setdefault(group, []).append((index, fault))
        self._resets = sorted((f for f in self._faults if f.ends_others), key=lambda f: f.row.start_ns)
        self._t_ns = 0

    def applied(self) -> list[int]:
        return [fault.applied for fault in self._faults]

    def at(self, t_ns: int) -> None:
        self._t_ns = t_ns
        while self._resets and self._resets[0].row.start_ns <= t_ns:
            reset = self._resets.pop(0)
            for fault in self._faults:
                row = fault.row
                if fault.ends_others or row.target != reset.row.target or row.start_ns >= reset.row.start_ns:
                    continue
                reset.applied += not fault.is_over and row.is_in_force(reset.row.start_ns)
                fault.is_over = True

    def feedback(self, feedback: Feedback) -> Feedback:
        """Return the feedback with its faults, before anything is computed from it."""
        if not any(group in self._groups for group in _FEEDBACK):
            return feedback
        numbers = (
            feedback.robot_time_ns / _NS,
            float(feedback.state),
            float(feedback.command_age_ms),
            feedback.yaw_rate_rad_s,
            *feedback.acceleration_m_s2,
        )
        time_s, state, age_ms, yaw_rate_rad_s, *acceleration = self._passed("robot", numbers, list)
        forward, left, up = acceleration
        return feedback._replace(
            # An unchanged time stays an exact integer: a double cannot hold its nanoseconds.
            robot_time_ns=feedback.robot_time_ns if time_s == numbers[0] else round(time_s * _NS),
            state=RobotState(int(state)),
            command_age_ms=round(age_ms),
            yaw_rate_rad_s=yaw_rate_rad_s,
            acceleration_m_s2=(forward, left, up),
            speed_rad_s=self._passed("speed", feedback.speed_rad_s, Wheels._make),
            current_a=self._passed("current", feedback.current_a, Wheels._make),
        )

    def truth(self, fix: PoseFix | None) -> PoseFix | None:
        if fix is None or "truth" not in self._groups:
            return fix
        return fix._replace(pose=self._passed("truth", fix.pose, Pose._make))

    def state(self, state: State | None) -> State | None:
        """Return the estimated state with its faults, as input of the law."""
        if state is None or "pose" not in self._groups:
            return state
        numbers = self._passed("pose", (*state.pose, *state.twist), list)
        return State(Pose._make(numbers[:3]), Twist._make(numbers[3:]))

    def reference(self, reference: Reference) -> Reference:
        """Return the reference with its faults, as input of the law."""
        if "reference" not in self._groups:
            return reference
        numbers = self._passed("reference", (*reference.pose, *reference.twist, *reference.acceleration), list)
        return Reference(Pose._make(numbers[:3]), Twist._make(numbers[3:6]), Acceleration._make(numbers[6:]))

    def command(self, command: WheelCommand) -> WheelCommand:
        """Return the law's command with its faults, as input of the guard."""
        if "speed_command" not in self._groups and "torque_command" not in self._groups:
            return command
        return command._replace(
            speed_rad_s=self._passed("speed_command", command.speed_rad_s, Wheels._make),
            torque_n_m=self._passed("torque_command", command.torque_n_m, Wheels._make),
        )

    def recorded(self, row: bytes) -> bytes:
        """Return the row with the faults of signals that nothing reads."""
        return self._passed("recorded", array("d", row), pack_row) if "recorded" in self._groups else row

    def _passed(self, group: str, numbers: Sequence[float], make: Callable[[list[float]], Made]) -> Made:
        values = list(numbers)
        for index, fault in self._groups.get(group, ()):
            if fault.row.is_in_force(self._t_ns) and not fault.is_over:
                values[index] = fault.changed(values[index], self._t_ns)
        return make(values)
