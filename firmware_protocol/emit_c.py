"""Generates the C codec: one header and one source, formatted by the rules of .clang-format.

C11, freestanding: no libm, no double, no allocation, no dependence on the byte order of the machine.
"""

import textwrap
from collections.abc import Iterable, Iterator

from firmware_protocol.schema import MAX_PAYLOAD, Message, Schema, Signal

_NOTICE = "/* Generated from wheel.dbc by `python -m firmware_protocol.generate`; do not edit. */"

_HELPERS = """\
/* False for a NaN as well. */
static bool within(float value, float minimum, float maximum) {
    return value >= minimum && value <= maximum;
}

/* Half of a truncated double: the nearest integer, halves away from zero. */
static uint32_t nearest(float doubled) {
    const int32_t twice = (int32_t)doubled;
    return (uint32_t)(twice < 0 ? (twice - 1) / 2 : (twice + 1) / 2);
}

/* Byte by byte: the same on a machine of either byte order. */
static void store(uint8_t *payload, size_t length, uint64_t bits) {
    for (size_t i = 0; i < length; i++) {
        payload[i] = (uint8_t)((bits >> (8 * i)) & 0xFFu);
    }
}

static uint64_t load(const uint8_t *payload, size_t length) {
    uint64_t bits = 0;
    for (size_t i = 0; i < length; i++) {
        bits |= (uint64_t)payload[i] << (8 * i);
    }
    return bits;
}

static uint32_t field(uint64_t bits, unsigned start, unsigned length) {
    return (uint32_t)(bits >> start) & (0xFFFFFFFFu >> (32 - length));
}

/* Two's complement. */
static int32_t signed_field(uint64_t bits, unsigned start, unsigned length) {
    const uint32_t sign = 1u << (length - 1);
    return (int32_t)(field(bits, start, length) ^ sign) - (int32_t)sign;
}
"""


def header(schema: Schema) -> str:
    """Return wheel_messages.h."""
    return "\n".join(_header_lines(schema)) + "\n"


def source(schema: Schema) -> str:
    """Return wheel_messages.c."""
    blocks = [
        _NOTICE,
        '#include "wheel_messages.h"',
        _HELPERS.rstrip("\n"),
        "\n".join(_payload_length(schema)),
    ]
    for m in schema.messages:
        blocks += ["\n".join(_encode(m)), "\n".join(_decode(m))]
    return "\n\n".join(blocks) + "\n"


def parameters(schema: Schema) -> str:
    """Return wheel_parameters.h: the structure, and its table as a macro over macros."""
    return "\n".join(_parameter_lines(schema)) + "\n"


def _parameter_lines(schema: Schema) -> Iterator[str]:
    yield _NOTICE.replace("wheel.dbc", "parameters.toml")
    yield "#ifndef WHEEL_PARAMETERS_GENERATED_H"
    yield "#define WHEEL_PARAMETERS_GENERATED_H"
    yield ""
    yield f"#define WP_PARAMETER_TABLE_HASH 0x{schema.parameter_table_hash():08X}u"
    yield ""
    yield "/* X(name, type, minimum, maximum) for every parameter. */"
    rows = ((p.name, p.type, _number(p.minimum), _number(p.maximum)) for p in schema.parameters)
    yield from _list_macro("WP_PARAMETERS", rows)
    yield ""
    yield "/* cffi: begin */"
    yield "typedef struct {"
    for p in schema.parameters:
        yield f"    float {p.name}; /* {p.meaning} */"
    yield "} wheel_parameters;"
    yield ""
    yield f"#define WHEEL_PARAMETER_COUNT {len(schema.parameters)}"
    yield "/* cffi: end */"
    yield "/* clang-format on */"
    yield ""
    yield "#endif"


def _list_macro(name: str, rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    """Yield a macro that calls its argument X with each row. clang-format is off there, because it cannot format such
    lists.
    """
    yield "/* clang-format off */"
    yield f"#define {name}(X) \\"
    yield " \\\n".join(f"    X({', '.join(row)})" for row in rows)


def _number(value: float) -> str:
    return f"{float(value)!r}f"


def _header_lines(schema: Schema) -> Iterator[str]:
    yield _NOTICE
    yield "#ifndef WHEEL_MESSAGES_H"
    yield "#define WHEEL_MESSAGES_H"
    yield ""
    yield from ("#include <stdbool.h>", "#include <stddef.h>", "#include <stdint.h>", "")
    yield from ("#ifdef __cplusplus", 'extern "C" {', "#endif", "")
    yield f"#define WP_PROTOCOL_VERSION {schema.version}u"
    yield f"#define WP_SCHEMA_HASH 0x{schema.hash():08X}u"
    yield f"#define WP_PAYLOAD_MAX {MAX_PAYLOAD}u"
    for name, values in schema.values.items():
        yield ""
        yield f"enum wp_{name} {{"
        for number, value in values:
            yield f"    WP_{name.upper()}_{value} = {number},"
        yield "};"
    yield ""
    yield "/* Payload bytes of the message with this id, or -1 when no message has it. */"
    yield "int wp_payload_length(uint16_t id);"
    yield ""
    yield "/* X(NAME, name) for every message. */"
    yield from _list_macro("WP_MESSAGES", ((m.name, m.name.lower()) for m in schema.messages))
    yield "/* clang-format on */"
    yield ""
    yield from _comment(
        "Encoders return false, with the payload untouched, when a value is out of its range or not finite. "
        "Decoders return false, with the message untouched, for a wrong length or a value out of its range."
    )
    for m in schema.messages:
        stem = m.name.lower()
        yield ""
        yield f"#define WP_{m.name}_ID 0x{m.id:03X}u"
        yield f"#define WP_{m.name}_LENGTH {m.length}u"
        # A host computes in double precision, and rounds once: it needs the step and the largest value.
        if len(scales := {(s.scale, s.maximum) for s in m.signals if s.scaled and m.sender == "HOST"}) == 1:
            ((step, maximum),) = scales
            yield f"#define WP_{m.name}_STEP {step!r}"
            yield f"#define WP_{m.name}_MAX {maximum!r}"
        yield ""
        yield from _comment(m.comment)
        yield "typedef struct {"
        for s in m.signals:
            yield from (f"    {line}" for line in _comment(s.comment))
            yield f"    {_ctype(s)} {s.name};"
        yield f"}} wp_{stem};"
        yield ""
        yield f"{_encode_signature(m)};"
        yield f"{_decode_signature(m)};"
    yield ""
    yield from ("#ifdef __cplusplus", "}", "#endif", "", "#endif")


def _comment(text: str) -> list[str]:
    lines = textwrap.wrap(text, 100)
    if not lines:
        return []
    return [f"{'/*' if i == 0 else ' *'} {line}" for i, line in enumerate(lines[:-1])] + [
        f"{'/*' if len(lines) == 1 else ' *'} {lines[-1]} */"
    ]


def _ctype(s: Signal) -> str:
    if s.scaled:
        return "float"
    return next(f"uint{bits}_t" for bits in (8, 16, 32) if s.length <= bits)


def _encode_signature(m: Message) -> str:
    stem = m.name.lower()
    return f"bool wp_{stem}_encode(const wp_{stem} *message, uint8_t *payload)"


def _decode_signature(m: Message) -> str:
    stem = m.name.lower()
    return f"bool wp_{stem}_decode(const uint8_t *payload, size_t length, wp_{stem} *message)"


def _payload_length(schema: Schema) -> Iterator[str]:
    yield "int wp_payload_length(uint16_t id) {"
    yield "    switch (id) {"
    for m in schema.messages:
        yield f"    case WP_{m.name}_ID:"
        yield f"        return (int)WP_{m.name}_LENGTH;"
    yield "    default:"
    yield "        return -1;"
    yield "    }"
    yield "}"


def _unless(condition: str) -> Iterator[str]:
    yield f"    if ({condition}) {{"
    yield "        return false;"
    yield "    }"


def _encode(m: Message) -> Iterator[str]:
    yield f"{_encode_signature(m)} {{"
    for s in m.signals:
        if s.scaled:
            yield from _unless(f"!within(message->{s.name}, {s.minimum!r}f, {s.maximum!r}f)")
            continue
        storage = int(_ctype(s).removeprefix("uint").removesuffix("_t"))
        if s.raw_minimum > 0:
            yield from _unless(f"message->{s.name} < {s.raw_minimum}u")
        if s.raw_maximum < (1 << storage) - 1:
            yield from _unless(f"message->{s.name} > {s.raw_maximum}u")
    yield "    uint64_t bits = 0;"
    for s in m.signals:
        value = f"message->{s.name}"
        if s.scaled:
            value = f"(nearest({value} * {2 / s.scale!r}f) & 0x{s.mask:X}u)"
        yield f"    bits |= (uint64_t){value}" + (f" << {s.start};" if s.start else ";")
    yield f"    store(payload, WP_{m.name}_LENGTH, bits);"
    yield "    return true;"
    yield "}"


def _decode(m: Message) -> Iterator[str]:
    yield f"{_decode_signature(m)} {{"
    yield from _unless(f"length != WP_{m.name}_LENGTH")
    yield "    const uint64_t bits = load(payload, length);"
    for s in m.signals:
        kind, read = ("int32_t", "signed_field") if s.scaled else ("uint32_t", "field")
        yield f"    const {kind} raw_{s.name} = {read}(bits, {s.start}, {s.length});"
    for s in m.signals:
        suffix = "" if s.scaled else "u"
        lowest = -(1 << (s.length - 1)) if s.scaled else 0
        if s.raw_minimum > lowest:
            yield from _unless(f"raw_{s.name} < {s.raw_minimum}{suffix}")
        if s.raw_maximum < lowest + s.mask:
            yield from _unless(f"raw_{s.name} > {s.raw_maximum}{suffix}")
    for s in m.signals:
        if s.scaled:
            yield f"    message->{s.name} = (float)raw_{s.name} * {s.scale!r}f;"
        else:
            cast = "" if s.length > 16 else f"({_ctype(s)})"
            yield f"    message->{s.name} = {cast}raw_{s.name};"
    yield "    return true;"
    yield "}"
