"""Encodes and decodes the messages of the wheel-command protocol, by the fields of their classes."""

from enum import IntEnum
from operator import index
from typing import Any, ClassVar, NamedTuple, Self

_new: Any = tuple.__new__  # of a named tuple: half the time that calling its class takes


class Field(NamedTuple):
    """A field of a payload, little-endian: ``length`` bits from bit ``start`` on.

    ``minimum`` and ``maximum`` limit the raw value. With a ``scale`` that is two's complement, and the value is
    raw * scale, in ``unit``; without one both are the same unsigned integer. ``values`` are its names, if it has any.
    """

    start: int
    length: int
    minimum: int
    maximum: int
    scale: float | None = None
    unit: str = ""
    values: type[IntEnum] | None = None

    def encode(self, message: str, name: str, value: float) -> int:
        """Return the bits of a value at their place. Raises as ``Message.encode``."""
        scale = self.scale
        low, high = (self.minimum, self.maximum) if scale is None else (self.minimum * scale, self.maximum * scale)
        if not low <= value <= high:
            unit = f" {self.unit}" if self.unit else ""
            raise ValueError(f"{message}.{name} = {value}{unit}: expected {low} to {high}{unit}")
        if scale is None:
            return index(value) << self.start  # type: ignore[arg-type]  # a float raises TypeError
        twice = int(value * (2.0 / scale))  # half of a truncated double: the nearest step, halves away from zero
        return ((twice + (twice > 0) >> 1) & ((1 << self.length) - 1)) << self.start


class Message:
    """A message: a named tuple of its fields. Scaled values are rounded to the nearest step, exactly as in C.

    Attributes:
        ID: its identifier. LENGTH: bytes of its payload. NAME: as in wheel.dbc. SENDER: ``HOST`` or ``ROBOT``.
        FIELDS: its fields by name, in the order of the tuple.
    """

    __slots__ = ()
    ID: ClassVar[int]
    LENGTH: ClassVar[int]
    NAME: ClassVar[str]
    SENDER: ClassVar[str]
    FIELDS: ClassVar[dict[str, Field]]
    _LAYOUT: ClassVar[tuple[tuple[int, int, int, int, int, float | None], ...]]  # for ``decode``

    def __init_subclass__(cls, number: int, length: int, name: str, sender: str) -> None:
        cls.ID, cls.LENGTH, cls.NAME, cls.SENDER = number, length, name, sender
        cls.FIELDS = {field: hint.__metadata__[0] for field, hint in cls.__bases__[0].__annotations__.items()}
        cls._LAYOUT = tuple(
            (f.start, (1 << f.length) - 1, 0 if f.scale is None else 1 << f.length - 1, f.minimum, f.maximum, f.scale)
            for f in cls.FIELDS.values()
        )

    def encode(self) -> bytes:
        """Return the payload.

        Raises ValueError when a value is out of its range or not a number, TypeError when an integer field is not an
        integer.
        """
        bits = sum(field.encode(self.NAME, name, getattr(self, name)) for name, field in self.FIELDS.items())
        return bits.to_bytes(self.LENGTH, "little")

    @classmethod
    def decode(cls, payload: bytes) -> Self | None:
        """Return the message of a payload; None for one of the wrong length, or with a value out of its range."""
        if len(payload) != cls.LENGTH:
            return None
        bits = int.from_bytes(payload, "little")
        values: list[float] = []
        for start, mask, sign, low, high, scale in cls._LAYOUT:
            raw = (bits >> start & mask ^ sign) - sign
            if not low <= raw <= high:
                return None
            values.append(raw if scale is None else raw * scale)
        made: Self = _new(cls, values)
        return made
