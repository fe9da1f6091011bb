"""Makes frames.csv from wheel.dbc by libraries that are not ours: cantools packs, cobs stuffs, binascii sums.

``python tests/vectors/make.py`` keeps the rows that are still right and makes four for each message that has none:
all smallest, all largest, in turns, and random from a fixed seed.
"""

import binascii
import csv
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


def row(message: Any, sequence: int, values: dict[str, float]) -> list[str]:
    """Return a row of the table."""
    # Whole numbers go past cantools' float arithmetic, which loses bits of 32-bit ones.
    raw = {s.name: round(values[s.name] / s.scale) for s in message.signals}
    payload = message.encode(raw, scaling=False)
    body = message.frame_id.to_bytes(2, "little") + bytes([sequence]) + payload
    body += binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")
    fields = " ".join(f"{s.name}={text(values[s.name])}" for s in sorted(message.signals, key=lambda s: s.start))
    serial = cobs.encode(body) + b"\0"
    return [message.name, f"{message.frame_id:03X}", str(sequence), fields, payload.hex(), serial.hex()]


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


def main() -> None:
    """Rewrite frames.csv."""
    database: Any = cantools.database.load_file(HERE.parents[1] / "firmware_protocol" / "wheel.dbc")
    table = HERE / "frames.csv"
    with table.open(encoding="utf-8", newline="") as file:
        old = list(csv.reader(file))[1:]
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
    with table.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEAD, *result])


if __name__ == "__main__":
    main()
