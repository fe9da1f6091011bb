"""Writes the codecs and the tables of PROTOCOL.md from wheel.dbc.

``python -m firmware_protocol.generate`` writes them; with ``--check`` it writes nothing, names the files that
are not what it would write, and exits 1. The output holds no time stamp and no version of any tool.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from firmware_protocol import emit_c, emit_python
from firmware_protocol.schema import Message, Schema, SchemaError, Signal, read_schema

ROOT = Path(__file__).parent
BEGIN = "<!-- generated -->"
END = "<!-- /generated -->"


def outputs(schema: Schema, root: Path) -> dict[Path, str]:
    """Return the text of each generated file. Raises SchemaError when PROTOCOL.md lacks the markers."""
    generated = root / "generated"
    document = root / "PROTOCOL.md"
    return {
        generated / "__init__.py": emit_python.INIT,
        generated / "messages.py": emit_python.messages(schema),
        generated / "wheel_messages.h": emit_c.header(schema),
        generated / "wheel_messages.c": emit_c.source(schema),
        document: _between_markers(document.read_text(encoding="utf-8"), "\n".join(_tables(schema))),
    }


def _between_markers(document: str, tables: str) -> str:
    before, begin, rest = document.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise SchemaError(f"PROTOCOL.md: expected {BEGIN} and {END} around the generated tables")
    return f"{before}{BEGIN}\n\n{tables}\n\n{END}{after}"


def _tables(schema: Schema) -> Iterator[str]:
    yield f"Protocol version {schema.version}, schema hash `0x{schema.hash():08X}`."
    yield ""
    yield "| id | message | from | bytes | meaning |"
    yield "|---|---|---|---|---|"
    for m in schema.messages:
        yield f"| `{m.id:03X}` | {m.name} | {m.sender} | {m.length} | {m.comment} |"
    for m in schema.messages:
        yield ""
        yield from _message_table(m)


def _message_table(m: Message) -> Iterator[str]:
    yield f"### `{m.id:03X}` {m.name}"
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
        print(f"wheel.dbc: {error}", file=sys.stderr)
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
