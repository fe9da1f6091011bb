"""Writes the codecs and the tables of PROTOCOL.md from wheel.dbc and parameters.toml.

The fields of each message go to the documentation site (``message_page``).

``python -m firmware_protocol.generate`` writes them; with ``--check`` it writes nothing, names the stale files, and
exits 1. The output contains no time stamp and no tool version.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from firmware_protocol import emit_c, emit_python
from firmware_protocol.schema import Message, Schema, SchemaError, Signal, read_schema

ROOT = Path(__file__).parent
BEGIN = "<!-- generated -->"
END = "<!-- /generated -->"
FRAME_OVERHEAD = 7  # bytes of a serial frame beside its payload: id, sequence, CRC, COBS, zero


def outputs(schema: Schema, root: Path) -> dict[Path, str]:
    """Return the text of each generated file. Raises SchemaError when PROTOCOL.md lacks the markers."""
    generated = root / "generated"
    document = root / "PROTOCOL.md"
    return {
        generated / "__init__.py": emit_python.INIT,
        generated / "messages.py": emit_python.messages(schema),
        generated / "wheel_messages.h": emit_c.header(schema),
        generated / "wheel_messages.c": emit_c.source(schema),
        generated / "wheel_parameters.h": emit_c.parameters(schema),
        document: _document(document.read_text(encoding="utf-8"), schema),
    }


def _document(document: str, schema: Schema) -> str:
    """Return PROTOCOL.md with its generated parts renewed: the load of the links, the parameters, the messages."""
    parts = document.split(BEGIN)
    tables = (_load_table(schema), _parameter_table(schema), _tables(schema))
    if len(parts) != 1 + len(tables) or not all(END in part for part in parts[1:]):
        raise SchemaError(f"PROTOCOL.md: expected {BEGIN} and {END} around its load table, parameters, messages")
    text = parts[0]
    for part, lines in zip(parts[1:], tables, strict=True):
        text += f"{BEGIN}\n\n" + "\n".join(lines) + f"\n\n{END}{part.partition(END)[2]}"
    return text


def _tables(schema: Schema) -> Iterator[str]:
    yield f"Protocol version {schema.version}, schema hash `0x{schema.hash():08X}`."
    yield ""
    yield "| id | message | from | bytes | rate |"
    yield "|---|---|---|---|---|"
    for m in schema.messages:
        yield f"| `{m.id:03X}` | {m.name} | {m.sender} | {m.length} | {m.rate} |"


def message_page(schema: Schema) -> str:
    """Return the page of docs/reference with the fields of every message."""
    text = (
        "# Messages\n\nThe fields of every message of [`wheel.dbc`](../../firmware_protocol/wheel.dbc). "
        "[PROTOCOL.md](../../firmware_protocol/PROTOCOL.md) has the rules.\n"
    )
    return text + "".join("\n" + "\n".join(_message_table(m)) + "\n" for m in schema.messages)


def _parameter_table(schema: Schema) -> Iterator[str]:
    yield "| index | parameter | type | range | meaning |"
    yield "|---|---|---|---|---|"
    for index, p in enumerate(schema.parameters):
        yield f"| {index} | {p.name} | {p.type} | {p.minimum:.10g} to {p.maximum:.10g} | {p.meaning} |"


def _frames_s(m: Message, loop_hz: int) -> int:
    """Return how often a message is sent [1/s] in a run with a speed loop on the robot; 0 for messages sent on
    request.
    """
    if m.rate == "loop":
        return loop_hz
    if match := re.fullmatch(r"loop, at most (\d+) Hz", m.rate):
        return min(loop_hz, int(match[1]))
    match = re.fullmatch(r"(\d+) Hz", m.rate)
    return int(match[1]) if match else 0


def _load_table(schema: Schema) -> Iterator[str]:
    """Yield a table of each link's load by the messages at their rates; a CAN frame has 47 bits besides its payload."""
    baud_rates = (115_200, 921_600, 2_000_000)
    heads = [f"{baud} baud, up / down" for baud in baud_rates]
    yield "| loop | robot to host | host to robot | " + " | ".join(heads) + " | CAN 1 Mbit/s |"
    yield "|---" * (4 + len(baud_rates)) + "|"
    for loop_hz in (50, 100, 200, 1000):
        up, down = (
            sum((m.length + FRAME_OVERHEAD) * _frames_s(m, loop_hz) for m in schema.messages if m.sender == sender)
            for sender in ("ROBOT", "HOST")
        )
        shares = [tuple(1000 * side / baud for side in (up, down)) for baud in baud_rates]
        cells = ["too slow" if max(share) > 100 else f"{share[0]:.0f} % / {share[1]:.0f} %" for share in shares]
        frames = [(8 * m.length, _frames_s(m, loop_hz)) for m in schema.messages]
        least = sum((47 + bits) * often for bits, often in frames)
        most = sum((47 + bits + (33 + bits) // 4) * often for bits, often in frames)
        can = f"{least / 1e4:.0f} to {most / 1e4:.0f} %"
        yield f"| {loop_hz} Hz | {up / 1e3:.1f} kB/s | {down / 1e3:.1f} kB/s | " + " | ".join(cells) + f" | {can} |"


def _message_table(m: Message) -> Iterator[str]:
    yield f"## {m.name}"
    yield ""
    yield f"Id `{m.id:03X}`, {m.length} bytes, from {m.sender}. {m.comment}"
    yield ""
    yield "| bits | signal | step | range | unit | meaning |"
    yield "|---|---|---|---|---|---|"
    for s in m.signals:
        step = f"1/{2**-s.exponent}" if s.exponent < 0 else str(2**s.exponent)
        limits = f"{s.minimum!r} to {s.maximum!r}"
        yield (
            f"| {s.start}-{s.start + s.length - 1} | {s.name} | {step} | {limits} | {s.unit or '-'} | {_meaning(s)} |"
        )


def _meaning(s: Signal) -> str:
    values = ", ".join(f"{number} {name}" for number, name in s.values)
    return " ".join(part for part in (s.comment, values) if part) or "-"


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m firmware_protocol.generate", description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when a file is stale")
    check = parser.parse_args(arguments).check
    try:
        texts = outputs(read_schema(ROOT / "wheel.dbc"), ROOT)
    except SchemaError as error:
        print(error, file=sys.stderr)
        return 2
    stale = [p for p, text in texts.items() if not p.exists() or p.read_text(encoding="utf-8") != text]
    for path in stale:
        if check:
            print(f"stale: {path.relative_to(ROOT.parent)}; run python -m firmware_protocol.generate")
        else:
            path.parent.mkdir(exist_ok=True)
            path.write_text(texts[path], encoding="utf-8", newline="\n")
            print(f"wrote {path.relative_to(ROOT.parent)}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
