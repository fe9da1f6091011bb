"""Makes the golden vectors from wheel.dbc by libraries that are not ours: cantools packs, cobs stuffs, binascii sums.

``python tests/vectors/make.py`` writes both tables. It keeps the frames that are still right, and makes four
for each message that has none: all smallest, all largest, in turns, and random from a fixed seed.
"""

import binascii
import csv
import io
import random
from pathlib import Path
from typing import Any

import cantools
from cobs import cobs

HERE = Path(__file__).parent
HEAD = ["message", "id", "sequence", "fields", "payload", "serial"]
SEQUENCES = (0, 1, 127, 128, 254, 255)


def text(value: float) -> str:
    """Return a value as the vectors have it: a float with its point, an integer without."""
    return repr(value)


def limits(signal: Any) -> tuple[float, float]:
    """Return the smallest and largest value of a signal, as a float where it is scaled."""
    return (signal.minimum, signal.maximum) if signal.scale == 1 else (float(signal.minimum), float(signal.maximum))


def checked(body: bytes) -> bytes:
    """Return the body with its CRC."""
    return body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")


def wire(body: bytes) -> bytes:
    """Return the body as it crosses the line."""
    return cobs.encode(body) + b"\0"


def row(message: Any, sequence: int, values: dict[str, float]) -> list[str]:
    """Return a row of the table."""
    # Whole numbers go past cantools' float arithmetic, which loses bits of 32-bit ones.
    raw = {s.name: round(values[s.name] / s.scale) for s in message.signals}
    payload = message.encode(raw, scaling=False)
    body = checked(message.frame_id.to_bytes(2, "little") + bytes([sequence]) + payload)
    fields = " ".join(f"{s.name}={text(values[s.name])}" for s in sorted(message.signals, key=lambda s: s.start))
    return [message.name, f"{message.frame_id:03X}", str(sequence), fields, payload.hex(), wire(body).hex()]


def rows(message: Any, place: int) -> list[list[str]]:
    """Return the four rows of a message."""
    generator = random.Random(message.frame_id)
    both = {s.name: limits(s) for s in message.signals}
    cases = [
        {name: low for name, (low, _) in both.items()},
        {name: high for name, (_, high) in both.items()},
        {name: pair[i % 2] for i, (name, pair) in enumerate(both.items())},
        {
            s.name: generator.randint(round(s.minimum / s.scale), round(s.maximum / s.scale)) * s.scale
            for s in message.signals
        },
    ]
    return [row(message, SEQUENCES[(4 * place + i) % len(SEQUENCES)], case) for i, case in enumerate(cases)]


def written(table: list[list[str]]) -> str:
    """Return a table as the text of its file."""
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerows(table)
    return file.getvalue()


def frames(before: str) -> str:
    """Return the text of frames.csv, with the rows of the one before that are still right."""
    database: Any = cantools.database.load_file(HERE.parents[1] / "firmware_protocol" / "wheel.dbc")
    old = list(csv.reader(io.StringIO(before)))[1:]
    result = []
    for place, message in enumerate(sorted(database.messages, key=lambda m: m.frame_id)):
        mine = [r for r in old if r[1] == f"{message.frame_id:03X}"]
        names = {s.name for s in message.signals}
        good = []
        for r in mine:
            values = {k: float(v) if "." in v else int(v) for k, _, v in (f.partition("=") for f in r[3].split())}
            if set(values) == names and row(message, int(r[2]), values) == r:
                good.append(r)
        result += good if len(good) >= 4 else rows(message, place)
    return written([HEAD, *result])


def rejected() -> str:
    """Return the text of rejected.csv: lines that a receiver drops, and the cause that it counts for each."""
    seven = b"\x07"  # the sequence of all
    step_done = (0x301).to_bytes(2, "little") + seven
    good = checked(step_done + bytes([1, 2, 3, 4]))
    swapped = good[:-2] + good[:-3:-1]
    cases = [
        ("crc", wire(good[:-1] + bytes([good[-1] ^ 1])), "a CRC with one wrong bit"),
        ("crc", wire(swapped), "the CRC most significant byte first"),
        ("cobs", b"\x0c" + good[:-2] + b"\0", "a code byte beyond the end of the frame"),
        ("cobs", b"\x02\0", "a code byte alone, promising one byte"),
        ("length", wire(checked(step_done + bytes([1, 2, 3]))), "STEP_DONE with three bytes"),
        ("length", wire(checked(step_done + bytes([1, 2, 3, 4, 5]))), "STEP_DONE with five bytes"),
        ("length", wire(checked(b"\x40\0" + seven)), "WHEEL_COMMAND without a payload"),
        ("length", wire(step_done + b"\x09"), "an id and a sequence, no room for a CRC"),
        ("length", wire(b"\0"), "one zero byte"),
        ("unknown_id", wire(checked(b"\xff\x07" + seven + bytes(8))), "id 7FF, eight bytes"),
        ("unknown_id", wire(checked(b"\x40\x80" + seven + bytes(8))), "id 8040: WHEEL_COMMAND with bit 15 set"),
        ("unknown_id", wire(checked(b"\0\0" + seven)), "id 0, no payload"),
        ("overrun", bytes([15, *range(1, 15)]) + b"\0", "fifteen bytes without a zero"),
        ("overrun", b"\x2a" * 40 + b"\0", "forty bytes without a zero"),
    ]
    return written([["cause", "serial", "what"], *([cause, serial.hex(), what] for cause, serial, what in cases)])


def main() -> None:
    """Write both tables."""
    table = HERE / "frames.csv"
    text = frames(table.read_text(encoding="utf-8"))
    table.write_text(text, encoding="utf-8", newline="\n")
    (HERE / "rejected.csv").write_text(rejected(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
