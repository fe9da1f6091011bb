"""Reads wheel.dbc and parameters.toml, checks that the codecs support them, and hashes them.

A development-time module: the generated codecs need neither this file nor cantools.
"""

import hashlib
import keyword
import math
import re
import struct
import tomllib
from dataclasses import dataclass
from pathlib import Path

import cantools
from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage
from cantools.database.can import Signal as DbcSignal

PARAMETERS = Path(__file__).with_name("parameters.toml")
FRAMING_VERSION = 1
"""Version of the serial framing; part of the schema hash (PROTOCOL.md, "Serial framing")."""

MAX_PAYLOAD = 8  # classic CAN
MAX_ID = 0x7FF  # 11-bit identifiers
MAX_WHOLE = 1 << 24  # whole numbers up to here are binary32 too

# Fixed layouts: with them a host and a robot of any two versions can find out that they differ.
FROZEN = {
    0x700: [("protocol_version", 0, 8)],
    0x701: [("protocol_version", 0, 8), ("pages", 8, 8), ("capabilities", 16, 16), ("schema_hash", 32, 32)],
}

_C_KEYWORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long
register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
"""
_PYTHON_NAMES = "self cls bits payload count index encode decode"  # locals of the codec, members of a tuple
_TAKEN_NAMES = frozenset([*_C_KEYWORDS.split(), *keyword.kwlist, *_PYTHON_NAMES.split()])


class SchemaError(Exception):
    """wheel.dbc or parameters.toml holds something that the codecs do not support. The text gives place, value and
    remedy.
    """


@dataclass(frozen=True, slots=True)
class Signal:
    """A field of a payload, little-endian, ``length`` bits from bit ``start`` on.

    Unscaled signals are unsigned integers. Scaled ones are two's complement; their value is ``raw * scale``,
    ``scale`` being ``2 ** exponent``. ``raw_minimum`` and ``raw_maximum`` are the allowed raw values.
    """

    name: str
    start: int
    length: int
    exponent: int
    raw_minimum: int
    raw_maximum: int
    unit: str
    comment: str
    values: tuple[tuple[int, str], ...]

    @property
    def scaled(self) -> bool:
        """True for a two's-complement number with a scale, false for an unsigned integer."""
        return self.exponent != 0

    @property
    def scale(self) -> float:
        return math.ldexp(1.0, self.exponent)

    @property
    def minimum(self) -> float:
        """Smallest allowed physical value, an int if the signal is not scaled."""
        return self.raw_minimum * self.scale if self.scaled else self.raw_minimum

    @property
    def maximum(self) -> float:
        """Largest allowed physical value, an int if the signal is not scaled."""
        return self.raw_maximum * self.scale if self.scaled else self.raw_maximum

    @property
    def mask(self) -> int:
        return (1 << self.length) - 1


@dataclass(frozen=True, slots=True)
class Message:
    """One message: its id, its exact payload length in bytes, and its signals by start bit."""

    id: int
    name: str
    length: int
    sender: str
    comment: str
    rate: str  # how often it is sent, as in PROTOCOL.md's table; not part of the schema
    signals: tuple[Signal, ...]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One of the firmware's parameters; ``type`` is ``UINT32`` or ``FLOAT32``, as its value crosses the wire."""

    name: str
    type: str
    minimum: float
    maximum: float
    meaning: str

    def wire(self, value: float) -> int:
        """Return the 32 bits of a value in PARAMETER_REQUEST and PARAMETER_RESPONSE."""
        return int(value) if self.type == "UINT32" else int.from_bytes(struct.pack(">f", value), "big")


@dataclass(frozen=True, slots=True)
class Schema:
    """All messages by id, the named values by signal name, the parameters by index, and the protocol's version."""

    version: int
    comment: str
    messages: tuple[Message, ...]
    values: dict[str, tuple[tuple[int, str], ...]]
    parameters: tuple[Parameter, ...]

    def canonical(self) -> str:
        """Return the list that the schema hash covers: one line each, LF-terminated, numbers exact.

        Limits are raw integers and scales powers of two, so that no formatting of a fraction can change it.
        """
        lines = [f"framing {FRAMING_VERSION}"]
        for m in self.messages:
            lines.append(f"message {m.id} {m.name} {m.length}")
            for s in m.signals:
                sign = "signed" if s.scaled else "unsigned"
                lines.append(
                    f"signal {s.name} {s.start} {s.length} {sign} 2^{s.exponent} {s.unit or '-'} "
                    f"{s.raw_minimum} {s.raw_maximum}"
                )
                lines += [f"value {number} {name}" for number, name in s.values]
        return "".join(line + "\n" for line in lines) + self.canonical_parameters()

    def canonical_parameters(self) -> str:
        """Return the last part of that list, the firmware's parameters; limits are the bits of the wire."""
        rows = enumerate(self.parameters)
        return "".join(f"parameter {i} {p.name} {p.type} {p.wire(p.minimum)} {p.wire(p.maximum)}\n" for i, p in rows)

    def hash(self) -> int:
        """Return the hash of a schema; a host and a robot compare theirs."""
        return _first_bits(self.canonical())

    def parameter_table_hash(self) -> int:
        """Return the hash that is stored with parameters, so that those of another table are not used."""
        return _first_bits(self.canonical_parameters())


def _first_bits(text: str) -> int:
    """Return the first 32 bits, big-endian, of SHA-256 over a text in UTF-8."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def read_schema(path: Path, parameters: Path = PARAMETERS) -> Schema:
    """Read a DBC file, and the file of the firmware's parameters.

    Raises SchemaError with the message and the signal, or the parameter, when a file holds something that the codecs do
    not support.
    """
    try:
        version, comment, messages = _read_messages(path)
        values = _named_values(messages)
    except SchemaError as error:
        raise SchemaError(f"{path.name}: {error}") from error
    return Schema(version, comment, messages, values, _parameters(parameters))


def _read_messages(path: Path) -> tuple[int, str, tuple[Message, ...]]:
    try:
        database = cantools.database.load_file(path, database_format="dbc")
    except cantools.Error as error:
        raise SchemaError(str(error)) from error
    assert isinstance(database, Database)
    messages = tuple(_message(m) for m in sorted(database.messages, key=lambda m: m.frame_id))
    version = database.version or ""
    if not version.isdecimal() or not 0 < int(version) < 256:
        raise SchemaError(f'VERSION "{version}": expected a number from 1 to 255')
    _check_frozen(messages)
    comment = database.dbc.attributes.get("comment", "") if database.dbc else ""
    return int(version), str(comment), messages


def _message(dbc: DbcMessage) -> Message:
    multiplexed = any(s.is_multiplexer or s.multiplexer_ids for s in dbc.signals)
    if multiplexed or dbc.is_extended_frame or dbc.frame_id > MAX_ID or dbc.length > MAX_PAYLOAD:
        raise SchemaError(
            f"{dbc.name}: expected an 11-bit id, at most {MAX_PAYLOAD} bytes and no multiplexing; "
            f"id {dbc.frame_id:#x}, {dbc.length} bytes"
        )
    signals = tuple(sorted((_signal(dbc.name, s) for s in dbc.signals), key=lambda s: s.start))
    end = 0
    for s in signals:
        if s.start != end:
            raise SchemaError(
                f"{dbc.name}.{s.name} starts at bit {s.start}, expected {end}: "
                "signals must fill the payload without gaps or overlaps"
            )
        end = s.start + s.length
    if end != 8 * dbc.length:
        raise SchemaError(f"{dbc.name}: its signals end at bit {end}, its payload at bit {8 * dbc.length}")
    senders = dbc.senders or ["?"]
    attributes = dbc.dbc.attributes if dbc.dbc else {}
    rate = str(attributes["Rate"].value) if "Rate" in attributes else "connect"
    return Message(dbc.frame_id, dbc.name, dbc.length, senders[0], dbc.comment or "", rate, signals)


def _signal(message: str, dbc: DbcSignal) -> Signal:
    where = f"{message}.{dbc.name}"
    if dbc.name in _TAKEN_NAMES or dbc.name != dbc.name.lower() or dbc.name.startswith("_"):
        raise SchemaError(f"{where}: the name is taken in C or Python, or not lower case; choose another")
    if dbc.byte_order != "little_endian" or dbc.is_float or dbc.offset != 0:
        raise SchemaError(f"{where}: expected little-endian (@1), an integer type and offset 0")
    mantissa, exponent = math.frexp(dbc.scale)
    if mantissa != 0.5:
        raise SchemaError(f"{where}: scale {dbc.scale} is not a power of two, which C and Python would round alike")
    exponent -= 1
    if dbc.is_signed != (exponent != 0):
        raise SchemaError(f"{where}: expected an unsigned integer with scale 1, or a signed one with another scale")
    longest = 24 if dbc.is_signed else 32  # 24 bits are exact in binary32
    if dbc.length > longest:
        raise SchemaError(f"{where}: {dbc.length} bits, at most {longest} are supported")
    if dbc.minimum is None or dbc.maximum is None:
        raise SchemaError(f"{where}: give its limits as [minimum|maximum]")
    low, high = math.ldexp(dbc.minimum, -exponent), math.ldexp(dbc.maximum, -exponent)
    floor = -(1 << (dbc.length - 1)) if dbc.is_signed else 0
    if not (low.is_integer() and high.is_integer() and floor <= low <= high < floor + (1 << dbc.length)):
        raise SchemaError(f"{where}: limits [{dbc.minimum}|{dbc.maximum}] are not raw values of {dbc.length} bits")
    values = tuple(sorted((int(number), str(name)) for number, name in (dbc.choices or {}).items()))
    if values and [number for number, _ in values] != list(range(int(low), int(high) + 1)):
        raise SchemaError(f"{where}: VAL_ must name every value from {int(low)} to {int(high)}, and no other")
    return Signal(
        name=dbc.name,
        start=dbc.start,
        length=dbc.length,
        exponent=exponent,
        raw_minimum=int(low),
        raw_maximum=int(high),
        unit=dbc.unit or "",
        comment=dbc.comment or "",
        values=values,
    )


def _named_values(messages: tuple[Message, ...]) -> dict[str, tuple[tuple[int, str], ...]]:
    tables: dict[str, tuple[tuple[int, str], ...]] = {}
    for m in messages:
        for s in m.signals:
            if s.values and tables.setdefault(s.name, s.values) != s.values:
                raise SchemaError(f"{m.name}.{s.name}: its VAL_ table differs from another message's {s.name}")
    return tables


def _check_frozen(messages: tuple[Message, ...]) -> None:
    layout = {m.id: [(s.name, s.start, s.length) for s in m.signals] for m in messages}
    for number, frozen in FROZEN.items():
        if layout.get(number) != frozen:
            raise SchemaError(f"id {number:#x}: its layout is frozen for ever as {frozen}, found {layout.get(number)}")


def _parameters(path: Path) -> tuple[Parameter, ...]:
    try:
        rows = tomllib.loads(path.read_text(encoding="utf-8"))["parameter"]
        parameters = tuple(Parameter(**row) for row in rows)
    except (tomllib.TOMLDecodeError, KeyError, TypeError) as error:
        raise SchemaError(f"{path.name}: expected rows [[parameter]] of five keys each ({error})") from error
    names: set[str] = set()
    for p in parameters:
        whole = p.type == "UINT32"
        if not re.fullmatch("[a-z][a-z0-9_]*", p.name) or p.name in names | _TAKEN_NAMES:
            raise SchemaError(f"{path.name}: {p.name!r}: expected a name of its own in lower case")
        if p.type not in ("UINT32", "FLOAT32"):
            raise SchemaError(f"{path.name}: {p.name}: type {p.type!r}; expected UINT32 or FLOAT32")
        if not p.minimum < p.maximum or (whole and not 0 <= p.minimum < p.maximum <= MAX_WHOLE):
            raise SchemaError(f"{path.name}: {p.name}: a range from {p.minimum} to {p.maximum} cannot be")
        names.add(p.name)
    return parameters
