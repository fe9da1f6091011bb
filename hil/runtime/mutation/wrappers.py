"""Wrappers of the parts of a tick: what goes in or comes out is changed, all else passes through."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from hil.core.types import WHEEL_NAMES, Applied, MeasuredPose, Pose, PoseFix, Reference, State, Twist, WheelCommand
from hil.core.types import Wheels as WheelValues
from hil.runtime.mutation.change import Change

POSE, TWIST, ACCELERATION = ("x", "y", "heading"), ("vx", "vy", "yaw_rate"), ("ax", "ay", "yaw")
_VALUE = ("value",)
_NS = 1e-9
_LAW_INPUTS = {"pose": POSE, "twist": TWIST, "reference_pose": POSE, "reference_twist": TWIST,
               "reference_acceleration": ACCELERATION, "dt": _VALUE, "latency": _VALUE}  # fmt: skip
_COMMAND = {"speed": WHEEL_NAMES, "torque": WHEEL_NAMES}
_MEASURED = {"count": WHEEL_NAMES, "speed": WHEEL_NAMES, "current": WHEEL_NAMES, "acceleration": ("x", "y", "z"),
             "yaw_rate": _VALUE, "time": _VALUE}  # fmt: skip


class Part:
    """Passes all calls to a part; a subclass changes some of them."""

    def __init__(self, part: Any, of: str, change: Change) -> None:
        self._part, self._of, self._change = part, of, change

    def __getattr__(self, name: str) -> Any:
        return getattr(self._part, name)


def _changed_command(command: WheelCommand, of: str, change: Change) -> WheelCommand:
    if of == "speed":
        return command._replace(speed_rad_s=WheelValues(*change(command.speed_rad_s)))
    return command._replace(torque_n_m=WheelValues(*change(command.torque_n_m)))


def _changed_measurement(measured: Any, of: str, change: Change) -> Any:
    """Return a measurement with one quantity changed. Its time is in seconds, its counts are without wraps."""
    match of:
        case "count":
            return measured._replace(encoder_count=tuple(round(v) & 0xFFFF for v in change(measured.encoder_count)))
        case "time":
            return measured._replace(robot_time_ns=round(change((measured.robot_time_ns * _NS,))[0] / _NS))
        case "yaw_rate":
            return measured._replace(yaw_rate_rad_s=change((measured.yaw_rate_rad_s,))[0])
        case "acceleration":
            return measured._replace(acceleration_m_s2=change(measured.acceleration_m_s2))
    field = f"{of}_rad_s" if of == "speed" else "current_a"
    return measured._replace(**{field: WheelValues(*change(getattr(measured, field)))})


class _Law(Part):
    """A law whose inputs or outputs are changed; a reset has what its caller gives."""

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        of, change = self._of, self._change
        state, reference = self._inputs(state, reference)
        if of == "dt":
            dt_s = change((dt_s,))[0]
        elif of == "latency":
            applied = applied._replace(latency_s=change((applied.latency_s,))[0])
        command: WheelCommand = self._part.update(reference, state, applied, dt_s)
        return _changed_command(command, of, change) if of in _COMMAND else command

    def _inputs(self, state: State, reference: Reference) -> tuple[State, Reference]:
        """Return the inputs as the law sees them."""
        of, change = self._of, self._change
        match of:
            case "pose":
                return state._replace(pose=Pose(*change(state.pose))), reference
            case "twist":
                return state._replace(twist=Twist(*change(state.twist))), reference
            case "reference_pose" | "reference_twist" | "reference_acceleration":
                return state, _changed_reference(reference, of.removeprefix("reference_"), change)
        return state, reference


def _changed_reference(reference: Reference, of: str, change: Change) -> Reference:
    value = getattr(reference, of)
    return reference._replace(**{of: type(value)(*change(value))})


class _Guard(Part):
    """A limiter whose commands are changed after it."""

    def apply(self, command: WheelCommand) -> tuple[WheelCommand, bool]:
        limited, saturated = self._part.apply(command)
        return _changed_command(limited, self._of, self._change), saturated


class _Estimator(Part):
    """An estimator whose state, or whose measurements, are changed."""

    def update(self, measurement: Any, truth: PoseFix | None, fixes: Sequence[MeasuredPose] = ()) -> State | None:
        of, change = self._of, self._change
        if of in _MEASURED:
            measurement = _changed_measurement(measurement, of, change)
        state: State | None = self._part.update(measurement, truth, fixes)
        if state is None or of in _MEASURED:
            return state
        if of == "pose":
            return state._replace(pose=Pose(*change(state.pose)))
        return state._replace(twist=Twist(*change(state.twist)))


class _Device(Part):
    """A robot whose feedback, or whose commands, are changed on the host."""

    _seen: Any = None
    _given: Any = None

    def poll(self) -> Any:
        return self._changed(self._part.poll())

    @property
    def feedback(self) -> Any:
        return self._changed(self._part.feedback)

    def send(self, command: WheelCommand) -> int:
        of, change = self._of, self._change
        changed = (
            _changed_command(command, of.removeprefix("command_"), change) if of.startswith("command_") else command
        )
        sequence: int = self._part.send(changed)
        return sequence

    def _changed(self, feedback: Any) -> Any:
        """Return the feedback as the loop sees it. Each snapshot passes the change once."""
        if feedback is None or self._of not in _MEASURED:
            return feedback
        stamp = feedback.robot_time_ns, feedback.command_sequence
        if stamp != self._seen:
            self._seen, self._given = stamp, _changed_measurement(feedback, self._of, self._change)
        return self._given


class _Reference(Part):
    """A reference that is changed, or evaluated at another time [s]."""

    def at(self, t_s: float) -> Reference:
        if self._of == "time":
            changed: Reference = self._part.at(max(0.0, self._change((t_s,))[0]))
            return changed
        return _changed_reference(self._part.at(t_s), self._of, self._change)


class _Truth(Part):
    """A source of true poses that gives others."""

    _seen: Any = None
    _given: Any = None

    def poll(self) -> PoseFix | None:
        fix: PoseFix | None = self._part.poll()
        if fix is None or fix.time_ns == self._seen:
            return self._given if fix is not None else None
        self._seen, self._given = fix.time_ns, _changed_fix(fix, self._of, self._change)
        return self._given  # type: ignore[no-any-return]


class _Fixes(Part):
    """A localisation whose pose fixes are changed."""

    def poll(self, now_ns: int, truth: PoseFix | None) -> Sequence[MeasuredPose]:
        fixes = self._part.poll(now_ns, truth)
        if self._of == "covariance":
            return [fix._replace(covariance=type(fix.covariance)(*self._change(fix.covariance))) for fix in fixes]
        return [_changed_fix(fix, self._of, self._change) for fix in fixes]


def _changed_fix(fix: Any, of: str, change: Change) -> Any:
    if of == "time":
        return fix._replace(time_ns=round(change((fix.time_ns * _NS,))[0] / _NS))
    value = getattr(fix, of)
    return fix._replace(**{of: type(value)(*change(value))})


class Port(NamedTuple):
    """A part of a tick: its attribute in ``TickParts``, its wrapper, and what of it can be changed, with elements."""

    attribute: str
    wrapper: Callable[[Any, str, Change], Any]
    of: Mapping[str, tuple[str, ...]]


_COVARIANCE = ("xx", "xy", "xh", "yy", "yh", "hh")
PORTS: Mapping[str, Port] = {
    "law": Port("controller", _Law, {**_LAW_INPUTS, **_COMMAND}),
    "guard": Port("guard", _Guard, _COMMAND),
    "estimator": Port("estimator", _Estimator, {"pose": POSE, "twist": TWIST, **_MEASURED}),
    "robot": Port(
        "device", _Device, {**_MEASURED, **{f"command_{name}": elements for name, elements in _COMMAND.items()}}
    ),
    "reference": Port(
        "reference", _Reference, {"pose": POSE, "twist": TWIST, "acceleration": ACCELERATION, "time": _VALUE}
    ),
    "truth": Port("truth", _Truth, {"pose": POSE, "twist": TWIST, "time": _VALUE}),
    "fixes": Port("fixes", _Fixes, {"pose": POSE, "time": _VALUE, "covariance": _COVARIANCE}),
}
"""The ports that can be wrapped, by name."""
