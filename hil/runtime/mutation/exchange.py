"""Changes between firmware and plant: what the drives are told, and what the sensors give, at 1 kHz."""

from collections.abc import Mapping
from typing import Any

from firmware_protocol.host import library
from hil.core.types import WHEEL_NAMES
from hil.robot.virtual import ClockedNode, MakeNode
from hil.runtime.mutation.change import Change

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
        node = make_node(values, exchange.address, 0, **further)
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
