"""Decodes a terminal's input: characters, classic escape sequences, and those of kitty's keyboard protocol. Pure.

Sources: ECMA-48, 5.4 (control sequences); https://sw.kovidgoyal.net/kitty/keyboard-protocol (press, repeat, release).
"""

import enum
import re
from typing import NamedTuple


class Change(enum.Enum):
    """An event of a key. A terminal without the protocol sends a press for each repeat, and no release."""

    PRESS = 1
    REPEAT = 2
    RELEASE = 3


class Key(NamedTuple):
    """A key by its name: a lower-case character or one of ``_NAMED``. ``other``: Alt or another modifier is held."""

    name: str
    change: Change = Change.PRESS
    ctrl: bool = False
    other: bool = False


class Flags(NamedTuple):
    """The terminal's answer to ``CSI ? u``: the protocol's options in force."""

    flags: int


class Attributes(NamedTuple):
    """The terminal's answer to ``CSI c``. Every terminal sends it, after its answers to earlier queries."""


class Focus(NamedTuple):
    """The terminal's window has gained or lost the focus."""

    gained: bool


Event = Key | Flags | Attributes | Focus

_ESC = 0x1B
_ARROWS = {"A": Key("up"), "B": Key("down"), "C": Key("right"), "D": Key("left")}
_NAMED = {9: "tab", 10: "enter", 13: "enter", 27: "escape", 32: "space", 127: "backspace"}
_SHIFT, _CTRL, _LOCKS = 1, 4, 64 | 128
# Parameters, intermediates and the final character.
_CSI = re.compile(rb"\x1b\[([0-?]*)([ -/]*)([@-~])")
_LONGEST_SEQUENCE = 64


class KeyDecoder:
    """Turns bytes, in chunks of any size, into events. Keys that teleop does not use give no event."""

    def __init__(self) -> None:
        self._rest = b""

    @property
    def waits(self) -> bool:
        """Whether a sequence has begun. It may be the Esc key alone: see ``settle``."""
        return bool(self._rest)

    def feed(self, data: bytes) -> list[Event]:
        """Return the events that these bytes complete."""
        self._rest += data
        events: list[Event] = []
        while self._rest:
            length, event = _first(self._rest)
            if not length:
                break
            self._rest = self._rest[length:]
            if event is not None:
                events.append(event)
        return events

    def settle(self) -> list[Event]:
        """End a sequence that has begun but got no more bytes: it was the Esc key."""
        self._rest = b""
        return [Key("escape")]


def _first(data: bytes) -> tuple[int, Event | None]:
    """Return the length of the first event, 0 when it is incomplete, and the event, None if teleop does not use it."""
    if data[0] != _ESC:
        return 1, _character(data[0])
    if len(data) == 1:
        return 0, None
    if data[1] == ord("["):
        return _control_sequence(data)
    if data[1] == ord("O"):  # arrows in the keypad's application mode
        return (3, _ARROWS.get(chr(data[2]))) if len(data) > 2 else (0, None)
    if data[1] == _ESC:
        return 1, Key("escape")
    key = _character(data[1])
    return 2, None if key is None else key._replace(other=True)


def _control_sequence(data: bytes) -> tuple[int, Event | None]:
    found = _CSI.match(data)
    if found is None:
        is_begun = re.fullmatch(rb"\x1b\[[0-?]*[ -/]*", data) is not None
        # Line noise must not swallow the Esc key.
        return (0, None) if is_begun and len(data) < _LONGEST_SEQUENCE else (1, Key("escape"))
    if found[2] or found.end() > _LONGEST_SEQUENCE:
        return found.end(), None
    return found.end(), _meaning(found[1].decode(), found[3].decode())


def _meaning(parameters: str, final: str) -> Event | None:
    if final in "IO" and not parameters:
        return Focus(final == "I")
    if final == "c" and parameters.startswith("?"):
        return Attributes()
    if final == "u" and parameters.startswith("?"):
        return Flags(int(parameters[1:])) if parameters[1:].isdecimal() else None
    if re.fullmatch(r"[0-9:;]*", parameters) is None or final not in "uABCD":
        return None
    fields = [[int(part or 1) for part in field.split(":")] for field in f"{parameters};".split(";")]
    code, (modifiers, change) = fields[0][0], (*fields[1], 1)[:2]
    if change not in (1, 2, 3):
        return None
    key = _ARROWS[final] if final != "u" else _character(code)
    if key is None:
        return None
    bits = (modifiers - 1) & ~_LOCKS
    return Key(key.name, Change(change), bool(bits & _CTRL), bool(bits & ~(_CTRL | _SHIFT)))


def _character(code: int) -> Key | None:
    """Return the key of a character; codes 1 to 26 are letters with Ctrl."""
    if code in _NAMED:
        return Key(_NAMED[code])
    if 1 <= code <= 26:
        return Key(chr(code + 96), ctrl=True)
    return Key(chr(code).lower()) if 33 <= code <= 126 else None
