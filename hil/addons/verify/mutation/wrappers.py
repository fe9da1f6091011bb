"""Wrappers of the parts of a tick, and of the exchange of firmware and plant at 1 kHz.

What goes in or comes out is changed, all else passes through.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from firmware_protocol.extension import library
from hil.addons.verify.mutation.change import Change
from hil.core.types import WHEEL_NAMES, Applied, MeasuredPose, Pose, PoseFix, Reference, State, Twist, WheelCommand
from hil.core.types import Wheels as WheelValues
from hil.robot.virtual import ClockedNode, MakeNode

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


_AXES = ("x", "y", "z")
DRIVE: Mapping[str, tuple[str, ...]] = {"torque_n_m": WHEEL_NAMES, "duty": WHEEL_NAMES, "enabled": ("value",)}
SENSE: Mapping[str, tuple[str, ...]] = {
    "count": WHEEL_NAMES,
    "current_a": WHEEL_NAMES,
    "temperature_degc": WHEEL_NAMES,
    "gyro_rad_s": _AXES,
    "acceleration_m_s2": _AXES,
    "battery_v": ("value",),
    "battery_a": ("value",),
}
"""The fields of ``firmware/plant_port.h`` by name, with their elements. The wheels are the robot's channels."""


def changed_node(make_node: MakeNode, options: Mapping[str, Any]) -> MakeNode:
    """Return what makes firmware whose exchange with the plant is changed: ``of`` names a field of drive or sense."""

    def make(values: Mapping[str, float], exchange_address: int, context_address: int, **further: Any) -> ClockedNode:
        exchange = _Exchange(exchange_address, context_address, options)
        node = make_node(values, exchange.address, context_address, **further)
        node.changed_exchange = exchange  # type: ignore[attr-defined]  # it must live as long as the node
        return node

    return make


class _Exchange:
    def __init__(self, exchange_address: int, context_address: int, options: Mapping[str, Any]) -> None:
        ffi, _ = library()
        changes = {name: value for name, value in options.items() if name not in ("port", "of")}
        self._field = field = options["of"]
        self._is_drive = field in DRIVE
        self._change = Change((DRIVE if self._is_drive else SENSE)[field], changes)
        self._plant = ffi.cast("wheel_plant_exchange", exchange_address)
        self._context = ffi.cast("void *", context_address)
        self._null = ffi.NULL
        self._drive = ffi.new("wheel_drive *")
        self._callback = ffi.callback("int(void *, const wheel_drive *, wheel_sense *)", self._exchange, error=1)
        self.address = int(ffi.cast("uintptr_t", self._callback))
        self._counted: list[float] | None = None

    def _exchange(self, _context: object, drive: Any, sense: Any) -> int:
        if self._is_drive and drive != self._null:
            self._drive[0] = drive[0]
            self._write(self._drive)
            drive = self._drive
        failed: int = self._plant(self._context, drive, sense)
        if not self._is_drive:
            self._write(sense)
        return failed

    def _write(self, block: Any) -> None:
        field = self._field
        values = getattr(block, field)
        if isinstance(values, int | float):
            [changed] = self._change((float(values),))
            setattr(block, field, type(values)(changed))
        elif field == "count":
            for place, value in enumerate(self._change(self._unwrapped(values))):
                values[place] = round(value) & 0xFFFF
        else:
            for place, value in enumerate(self._change(tuple(values))):
                values[place] = value

    def _unwrapped(self, counts: Any) -> tuple[float, ...]:
        """Return the counts since the start without their wraps at 16 bits, so that a factor means one."""
        now = list(counts)
        before = self._counted
        if before is None:
            self._counted = [float(count) for count in now]
        else:
            turned = ((count - round(last) + 0x8000 & 0xFFFF) - 0x8000 for count, last in zip(now, before, strict=True))
            self._counted = [last + turn for last, turn in zip(before, turned, strict=True)]
        return tuple(self._counted or ())
