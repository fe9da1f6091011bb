"""Generates the Python codec: one NamedTuple per message, straight-line code, standard library only."""

import textwrap
from collections.abc import Iterator, Sequence

from firmware_protocol.schema import Message, Schema, Signal

INIT = '''\
"""The codecs made from wheel.dbc by `python -m firmware_protocol.generate`; do not edit."""
'''

_PREAMBLE = '''\
"""The messages of the wheel-command protocol: generated from wheel.dbc; do not edit.

Made by `python -m firmware_protocol.generate`. One class a message, with the fields of the DBC, units in
their names. ``encode`` returns the payload and raises ValueError when a value is out of its range or not a
number, TypeError when an integer field is not an integer. ``decode`` returns None when the payload has the
wrong length or holds a value out of its range. Scaled values are rounded to the nearest step, halves away
from zero, exactly as in the generated C.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum
from operator import index as _index
from struct import Struct
from typing import ClassVar, NamedTuple, Self, TypeAlias

_Range: TypeAlias = tuple[str, float, float, str]

_new = tuple.__new__  # of a named tuple: half the time that calling its class takes


def _out_of_range(message: str, values: Sequence[float], ranges: Sequence[_Range]) -> ValueError:
    for value, (field, minimum, maximum, unit) in zip(values, ranges, strict=True):
        if not minimum <= value <= maximum:
            return ValueError(f"{message}.{field} = {value}{unit}: expected {minimum} to {maximum}{unit}")
    raise AssertionError(f"{message}: all values are in range")
'''

_LETTERS = {8: "B", 16: "H", 32: "I"}  # of struct, by bits
_ROUNDING = "        # Half of a truncated double: the nearest step, halves away from zero."


def messages(schema: Schema) -> str:
    """Return messages.py."""
    blocks = [_PREAMBLE.rstrip("\n")]
    blocks.append(f"PROTOCOL_VERSION = {schema.version}\nSCHEMA_HASH = 0x{schema.hash():08X}")
    for name, values in schema.values.items():
        users = " and ".join(
            f"{m.name}.{s.name}" for m in schema.messages for s in m.signals if s.name == name and s.values
        )
        lines = [f"class {camel(name)}(IntEnum):", f'    """Values of {users}."""', ""]
        lines += [f"    {value} = {number}" for number, value in values]
        blocks.append("\n".join(lines))
    blocks += ["\n".join(_class(m)) for m in schema.messages]
    blocks.append("\n".join(_tables(schema)))
    return "\n\n\n".join(blocks) + "\n"


def camel(name: str) -> str:
    """Return the class name of a message or of a value table.

    >>> camel("WHEEL_COMMAND")
    'WheelCommand'
    """
    return "".join(word.capitalize() for word in name.split("_"))


def _class(m: Message) -> Iterator[str]:
    name = camel(m.name)
    form = _struct_format(m)
    if form:
        yield f'_{m.name} = Struct("{form}")'
    elif words := _words(m):
        yield f'_{m.name}_WORDS = Struct("<{"".join(_LETTERS[_bits(word)] for word in words)}")'
    yield f"_{m.name}_RANGES: tuple[_Range, ...] = ("
    for s in m.signals:
        unit = f" {s.unit}" if s.unit else ""
        yield f'    ("{s.name}", {s.minimum!r}, {s.maximum!r}, "{unit}"),'
    yield ")"
    yield ""
    yield ""
    # A NamedTuple cannot hold class variables of its own.
    yield f"class _{name}Fields(NamedTuple):"
    for s in m.signals:
        yield f"    {s.name}: {'float' if s.scaled else 'int'}"
    yield ""
    yield ""
    yield f"class {name}(_{name}Fields):"
    yield from _docstring(m)
    yield ""
    yield "    __slots__ = ()"
    yield f"    ID: ClassVar[int] = 0x{m.id:03X}"
    yield f"    LENGTH: ClassVar[int] = {m.length}"
    yield f'    NAME: ClassVar[str] = "{m.name}"'
    yield ""
    yield from _encode(m, form)
    yield ""
    yield from _decode(m, form)


def _docstring(m: Message) -> Iterator[str]:
    lines = textwrap.wrap(f'"""{m.name}: {m.comment}', 105)
    for s in m.signals:
        if s.comment:
            lines += textwrap.wrap(f"{s.name}: {s.comment}", 105, subsequent_indent="    ")
    if len(lines) == 1 and len(lines[0]) < 103:
        lines[0] += '"""'
    else:
        lines.append('"""')
    yield from (f"    {line}" for line in lines)


def _struct_format(m: Message) -> str:
    """Return the struct format of a message whose fields are whole bytes; otherwise an empty string."""
    if not all(s.byte_aligned for s in m.signals):
        return ""
    return "<" + "".join(_LETTERS[s.length].lower() if s.scaled else _LETTERS[s.length] for s in m.signals)


def _words(m: Message) -> list[list[Signal]]:
    """Group a message's signals into words of 8, 16 or 32 bits; return an empty list if that is not possible."""
    words: list[list[Signal]] = [[]]
    end = 0
    for s in m.signals:
        if s.start != end or s.scaled:
            return []
        end += s.length
        words[-1].append(s)
        if end % 8 == 0:
            words.append([])
    words.pop()
    return words if end == 8 * m.length and all(_bits(word) in _LETTERS for word in words) else []


def _bits(word: Sequence[Signal]) -> int:
    return sum(s.length for s in word)


def _word_name(word: Sequence[Signal]) -> str:
    return word[0].name if len(word) == 1 else f"word_{word[0].start // 8}"


def _part(s: Signal, word: Sequence[Signal]) -> str:
    shift = s.start - word[0].start
    shifted = f"{_word_name(word)} >> {shift}" if shift else _word_name(word)
    return shifted if s is word[-1] else f"{shifted} & 0x{s.mask:X}"


def _names(m: Message) -> str:
    return ", ".join(s.name for s in m.signals) + ("," if len(m.signals) == 1 else "")


def _encode(m: Message, form: str) -> Iterator[str]:
    yield "    def encode(self) -> bytes:"
    yield f"        {_names(m)} = self"
    yield "        if not ("
    for i, s in enumerate(m.signals):
        yield f"            {'and ' if i else ''}{s.minimum!r} <= {s.name} <= {s.maximum!r}"
    yield "        ):"
    yield f"            raise _out_of_range(self.NAME, self, _{m.name}_RANGES)"
    if any(s.scaled for s in m.signals):
        yield _ROUNDING
    for s in m.signals:
        if s.scaled:
            yield f"        {s.name}_twice = int({s.name} * {2 / s.scale!r})"
    values = [_nearest(s) if s.scaled else f"_index({s.name})" for s in m.signals]
    if form:
        yield f"        return _{m.name}.pack("
        yield from (f"            {value}," for value in values)
        yield "        )"
        return
    yield "        return ("
    for i, (s, value) in enumerate(zip(m.signals, values, strict=True)):
        bits = f"({value} & 0x{s.mask:X})" if s.scaled else value
        yield f"            {'| ' if i else ''}{bits}" + (f" << {s.start}" if s.start else "")
    yield f'        ).to_bytes({m.length}, "little")'


def _nearest(s: Signal) -> str:
    return f"({s.name}_twice + ({s.name}_twice > 0) >> 1)"


def _decode(m: Message, form: str) -> Iterator[str]:
    yield "    @classmethod"
    yield "    def decode(cls, payload: bytes) -> Self | None:"
    yield f"        if len(payload) != {m.length}:"
    yield "            return None"
    checks = [check for s in m.signals if (check := _raw_check(s))]
    if form and not checks and not any(s.scaled for s in m.signals):
        yield f"        return _new(cls, _{m.name}.unpack(payload))"
        return
    if form:
        yield f"        {_names(m)} = _{m.name}.unpack(payload)"
    elif words := _words(m):
        yield f"        {', '.join(_word_name(word) for word in words)} = _{m.name}_WORDS.unpack(payload)"
        for word in words:
            if len(word) > 1:
                yield from (f"        {s.name} = {_part(s, word)}" for s in word)
    else:
        yield '        bits = int.from_bytes(payload, "little")'
        yield from (f"        {s.name} = {_raw(s)}" for s in m.signals)
    if checks:
        yield "        if not ("
        yield from (f"            {'and ' if i else ''}{check}" for i, check in enumerate(checks))
        yield "        ):"
        yield "            return None"
    yield "        return _new(cls, ("
    yield from (f"            {s.name} * {s.scale!r}," if s.scaled else f"            {s.name}," for s in m.signals)
    yield "        ))"


def _raw(s: Signal) -> str:
    field = f"bits >> {s.start} & 0x{s.mask:X}" if s.start else f"bits & 0x{s.mask:X}"
    sign = 1 << (s.length - 1)
    return f"({field} ^ 0x{sign:X}) - 0x{sign:X}" if s.scaled else field


def _raw_check(s: Signal) -> str:
    lowest = -(1 << (s.length - 1)) if s.scaled else 0
    low = f"{s.raw_minimum} <= " if s.raw_minimum > lowest else ""
    high = f" <= {s.raw_maximum}" if s.raw_maximum < lowest + s.mask else ""
    return f"{low}{s.name}{high}" if low or high else ""


def _tables(schema: Schema) -> Iterator[str]:
    classes = [camel(m.name) for m in schema.messages]
    yield "Message: TypeAlias = ("
    yield from (f"    {'| ' if i else ''}{name}" for i, name in enumerate(classes))
    yield ")"
    yield ""
    yield "MESSAGES: dict[int, type[Message]] = {"
    yield from (f"    0x{m.id:03X}: {camel(m.name)}," for m in schema.messages)
    yield "}"
    yield "DECODERS: dict[int, Callable[[bytes], Message | None]] = {"
    yield from (f"    0x{m.id:03X}: {camel(m.name)}.decode," for m in schema.messages)
    yield "}"
    yield "LENGTHS: dict[int, int] = {number: message.LENGTH for number, message in MESSAGES.items()}"
    yield "NAMES: dict[int, str] = {number: message.NAME for number, message in MESSAGES.items()}"
    yield "SENDERS: dict[int, str] = {"
    yield from (f'    0x{m.id:03X}: "{m.sender}",' for m in schema.messages)
    yield "}"
    yield "UNITS: dict[int, dict[str, str]] = {"
    for m in schema.messages:
        units = ", ".join(f'"{s.name}": "{s.unit}"' for s in m.signals if s.unit)
        yield from ([f"    0x{m.id:03X}: {{{units}}},"] if units else [])
    yield "}"
    yield "NAMED_VALUES: dict[int, dict[str, type[IntEnum]]] = {"
    for m in schema.messages:
        kinds = ", ".join(f'"{s.name}": {camel(s.name)}' for s in m.signals if s.values)
        yield from ([f"    0x{m.id:03X}: {{{kinds}}},"] if kinds else [])
    yield "}"
