"""Generates the messages in Python: a named tuple for each, with the bits of its fields."""

import textwrap
from collections.abc import Iterator

from firmware_protocol.schema import Message, Schema, Signal

INIT = '''\
"""The codecs made from wheel.dbc by `python -m firmware_protocol.generate`; do not edit."""
'''

_PREAMBLE = '''\
"""The messages of the wheel-command protocol: generated from wheel.dbc; do not edit.

Made by `python -m firmware_protocol.generate`. One class a message, with the fields of the DBC, units in
their names; ``firmware_protocol.message`` encodes and decodes them.
"""

from enum import IntEnum
from typing import Annotated, NamedTuple

from firmware_protocol.message import Field, Message
'''


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
    # A NamedTuple takes no other base and no arguments of its class.
    yield f"class _{name}Fields(NamedTuple):"
    for s in m.signals:
        yield f"    {s.name}: Annotated[{'float' if s.scaled else 'int'}, {_field(s)}]"
    yield ""
    yield ""
    about = f'number=0x{m.id:03X}, length={m.length}, name="{m.name}", sender="{m.sender}"'
    yield f"class {name}(_{name}Fields, Message, {about}):"
    yield from _docstring(m)
    yield ""
    yield "    __slots__ = ()"


def _field(s: Signal) -> str:
    given = [s.start, s.length, s.raw_minimum, s.raw_maximum] + ([s.scale] if s.scaled else [])
    further = ([f'unit="{s.unit}"'] if s.unit else []) + ([f"values={camel(s.name)}"] if s.values else [])
    return f"Field({', '.join([*map(repr, given), *further])})"


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


def _tables(schema: Schema) -> Iterator[str]:
    yield "MESSAGES: dict[int, type[Message]] = {"
    yield "    kind.ID: kind"
    yield "    for kind in ("
    yield from (f"        {camel(m.name)}," for m in schema.messages)
    yield "    )"
    yield "}"
    yield "LENGTHS: dict[int, int] = {number: message.LENGTH for number, message in MESSAGES.items()}"
    yield "NAMES: dict[int, str] = {number: message.NAME for number, message in MESSAGES.items()}"
    yield "SENDERS: dict[int, str] = {number: message.SENDER for number, message in MESSAGES.items()}"
