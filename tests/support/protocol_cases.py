"""What the tests of the protocol share: the golden vectors, and values of every message by cantools.

Ranges and scales come from cantools' own reading of wheel.dbc, not from the generator under test.
"""

import csv
from pathlib import Path
from typing import Any, NamedTuple

import cantools
from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage
from hypothesis import strategies as st

from firmware_protocol.codec import MESSAGES, Message
from firmware_protocol.framing import Frame

VECTORS = Path(__file__).parents[1] / "vectors"
PROTOCOL = Path(__file__).parents[2] / "firmware_protocol"


def database() -> Database:
    loaded = cantools.database.load_file(PROTOCOL / "wheel.dbc")
    assert isinstance(loaded, Database)
    return loaded


DBC: dict[int, DbcMessage] = {m.frame_id: m for m in database().messages}
IDS = sorted(DBC)


class Vector(NamedTuple):
    """A row of frames.csv: a message, its payload, and its frame on the serial line."""

    message: Message
    sequence: int
    frame: Frame
    serial: bytes


def _number(text: str) -> float:
    return float(text) if "." in text else int(text)


def vectors() -> list[Vector]:
    rows = []
    with (VECTORS / "frames.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            number = int(row["id"], 16)
            fields: dict[str, Any] = {
                name: _number(value) for name, _, value in (f.partition("=") for f in row["fields"].split())
            }
            frame = Frame(number, bytes.fromhex(row["payload"]))
            message = MESSAGES[number](**fields)
            rows.append(Vector(message, int(row["sequence"]), frame, bytes.fromhex(row["serial"])))
    return rows


def rejected() -> list[tuple[str, bytes]]:
    """Return the rows of rejected.csv: the cause, and the bytes with their zero."""
    with (VECTORS / "rejected.csv").open(encoding="utf-8", newline="") as file:
        return [(row["cause"], bytes.fromhex(row["serial"])) for row in csv.DictReader(file)]


class Limits(NamedTuple):
    """A signal as cantools reads it: its scale, and its smallest and largest raw value."""

    name: str
    scale: float
    raw_minimum: int
    raw_maximum: int

    @property
    def scaled(self) -> bool:
        return self.scale != 1


def limits(number: int) -> list[Limits]:
    """Return the signals of a message by start bit."""
    signals = sorted(DBC[number].signals, key=lambda s: s.start)
    found = []
    for s in signals:
        assert s.minimum is not None
        assert s.maximum is not None
        found.append(Limits(s.name, s.scale, round(s.minimum / s.scale), round(s.maximum / s.scale)))
    return found


def grid_values(number: int) -> st.SearchStrategy[dict[str, Any]]:
    """Values that lie on the grid of a message's steps, both ends of each range included."""
    return st.fixed_dictionaries({s.name: _on_grid(s) for s in limits(number)})


def _on_grid(s: Limits) -> st.SearchStrategy[float]:
    raw = st.integers(s.raw_minimum, s.raw_maximum)
    return raw.map(lambda n: n * s.scale) if s.scaled else raw


def any_values(number: int) -> st.SearchStrategy[dict[str, Any]]:
    """Any allowed values, as binary32 holds them."""
    return st.fixed_dictionaries(
        {
            s.name: (
                st.floats(s.raw_minimum * s.scale, s.raw_maximum * s.scale, width=32)
                if s.scaled
                else st.integers(s.raw_minimum, s.raw_maximum)
            )
            for s in limits(number)
        }
    )


def out_of_range_payloads(number: int) -> list[tuple[str, bytes]]:
    """Return, for each signal, payloads with its raw value just outside its limits, all others inside."""
    bits = {s.name: (s.start, s.length) for s in DBC[number].signals}
    good = sum(max(s.raw_minimum, 0) << bits[s.name][0] for s in limits(number))
    found = []
    for s in limits(number):
        start, length = bits[s.name]
        mask = (1 << length) - 1
        lowest = -(1 << (length - 1)) if s.raw_minimum < 0 else 0
        outside = (n for n in (s.raw_minimum - 1, s.raw_maximum + 1) if lowest <= n <= lowest + mask)
        for raw in outside:
            payload = (good & ~(mask << start)) | (raw & mask) << start
            found.append((s.name, payload.to_bytes(DBC[number].length, "little")))
    return found


frames = st.sampled_from(IDS).flatmap(
    lambda number: st.binary(min_size=DBC[number].length, max_size=DBC[number].length).map(
        lambda payload: Frame(number, payload)
    )
)
"""Frames that the serial line takes: a known id with the right length, any payload."""
