"""The diagnostic stream of an emulated moteus: the lines of text that moteus_tool, tview and a user's console send.

It has the commands stop, list, schema, fmt and get of ``tel``, the last three for the binary channels; the ``conf``
commands; and of ``d``: stop, pos, tmt, zero, within, brake, dq, vdq, pwm, nearest, rezero, exact and recapture. An
unknown line, or one with too few numbers, is answered with ERR and changes nothing. As in the firmware, a motion that a
line begins has no watchdog, unless its option t sets one.
Source: mjbots moteus, docs/protocol/diagnostic.md; for the binary channels the reader of the maker's package.
"""

import math
import struct
from collections.abc import Mapping, Sequence

from hil.drivers.moteus import emulated_servo as servos
from hil.drivers.moteus.frames import FIRMWARE, INT32, MODEL, varuint

_MAX_LINE, _MAX_OUTPUT = 256, 8192
_OK, _UNKNOWN = "OK", "ERR unknown command"
_OPTIONS: Mapping[str, int] = {"p": 0x23, "d": 0x24, "i": 0x2B, "s": 0x26, "f": 0x22, "t": 0x27, "v": 0x28, "a": 0x29}
_ALLOWED_OPTIONS: Mapping[str, str] = {"within": "pditf", **dict.fromkeys(("pos", "tmt", "zero"), "".join(_OPTIONS))}
_MOTIONS: Mapping[str, tuple[int, tuple[int, ...]]] = {  # mode, and the registers for the numbers of the line
    "pos": (servos.POSITION, (0x20, 0x21, 0x25)),
    "tmt": (servos.TIMEOUT, (0x20, 0x21, 0x25)),
    "zero": (servos.ZERO_VELOCITY, (0x20, 0x21, 0x25)),
    "within": (servos.STAY_WITHIN, (0x40, 0x41, 0x25)),
    "dq": (servos.CURRENT, (0x1D, 0x1C)),
    "vdq": (servos.VOLTAGE_DQ, (0x1A, 0x1B)),
    "pwm": (servos.VOLTAGE_FOC, (0x18, 0x19)),
    "brake": (servos.BRAKE, ()),
    "stop": (servos.STOPPED, ()),
}


class Console:
    """The stream of one controller: ``feed`` takes commands, ``take`` returns the output."""

    def __init__(self, servo: servos.Servo) -> None:
        self._servo = servo
        self._line = b""
        self._output = b""
        self._defaults = dict(servo.config)
        self._stored = dict(servo.config)

    def feed(self, data: bytes) -> None:
        """Take bytes, and execute each line that they complete."""
        self._line += data
        *lines, self._line = self._line.replace(b"\r", b"\n").split(b"\n")
        if len(self._line) > _MAX_LINE:
            self._line = b""
        for line in lines:
            words = line.decode("latin1").split()
            if words:
                self._output = (self._output + self._answer(words))[:_MAX_OUTPUT]

    def take(self, most: int) -> bytes:
        """Remove at most ``most`` bytes from the output, and return them."""
        first, self._output = self._output[:most], self._output[most:]
        return first

    def _answer(self, words: Sequence[str]) -> bytes:
        if words[0] == "tel" and len(words) == 3 and words[1] in ("schema", "get"):
            fields = _channels(self._servo).get(words[2])
            if fields is None:
                return b"ERR unknown channel\r\n"
            head, blob = ("schema", _schema(fields)) if words[1] == "schema" else ("emit", _data(fields))
            return f"{head} {words[2]}\r\n".encode("latin1") + len(blob).to_bytes(4, "little") + blob
        return "".join(f"{line}\r\n" for line in self._execute(words)).encode("latin1")

    def _execute(self, words: Sequence[str]) -> Sequence[str]:
        names = _channels(self._servo)
        if words == ["tel", "list"]:
            return [*names, _OK]
        if words[:2] == ["tel", "fmt"] and len(words) == 4 and words[2] in names and words[3] == "0":
            return [_OK]
        if words[0] == "conf":
            return self._configure(words[1:])
        if words[0] == "d":
            return [self._drive(words[1:])]
        return [_OK if words == ["tel", "stop"] else _UNKNOWN]

    # conf

    def _configure(self, words: Sequence[str]) -> Sequence[str]:
        config = self._servo.config
        if words[:1] == ["enumerate"] and len(words) <= 2:
            group = f"{words[1]}." if len(words) == 2 else ""
            lines = [f"{name} {_text(value)}" for name, value in config.items() if name.startswith(group)]
            return [*lines, _OK] if lines else ["ERR unknown group"]
        if words[:1] == ["get"] and len(words) == 2:
            return [_text(config[words[1]]) if words[1] in config else "ERR error reading"]
        if words[:1] == ["set"] and len(words) == 3:
            return [self._set(words[1], words[2])]
        if words == ["write"]:
            self._stored = dict(config)
        elif words == ["load"]:
            config.update(self._stored)
        elif words == ["default"]:
            config.update(self._defaults)
        else:
            return ["ERR unknown subcommand"]
        return [_OK]

    def _set(self, name: str, text: str) -> str:
        value = _number(text)
        if name not in servos.SETTABLE or value is None:
            return "ERR error setting"
        if math.isnan(value):
            is_valid = name in servos.OPTIONAL
        elif name == "servo.timeout_mode":
            is_valid = value in servos.TIMEOUT_MODES
        else:  # the current is limited to that of the motor
            is_valid = 0.0 <= value <= (self._defaults[name] if name == "servo.max_current_A" else math.inf)
        if not is_valid:
            return "ERR error setting"
        self._servo.config[name] = value
        return _OK

    # d

    def _drive(self, words: Sequence[str]) -> str:
        servo = self._servo
        if len(words) == 2 and words[0] in ("exact", "nearest", "rezero"):
            position = _number(words[1])
            if position is None or not math.isfinite(position):
                return "ERR missing index value"
            servo.set_output(position, nearest=words[0] != "exact")
            return _OK
        if words == ["recapture"]:
            servo.recapture()
            return _OK
        if not words or words[0] not in _MOTIONS:
            return _UNKNOWN
        mode, registers = _MOTIONS[words[0]]
        numbers = [_number(text) for text in words[1 : 1 + len(registers)]]
        valid = [number for number in numbers if number is not None]
        if len(valid) < len(registers):
            return "ERR missing numbers"
        values = dict(zip(registers, valid, strict=True))
        if words[0] == "pwm":
            values[0x18] /= math.pi  # the unit of the register is half a turn
        for text in words[1 + len(registers) :]:
            value = _number(text[1:])
            if text[0] not in _ALLOWED_OPTIONS.get(words[0], "") or value is None:
                return "ERR unknown option"
            values[_OPTIONS[text[0]]] = value
        servo.begin(mode)
        servo.command.update({0x27: math.nan} | values)
        servo.obey()
        return _OK


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _text(value: float) -> str:
    """Return a value as text; an int has no decimal point."""
    return str(value) if isinstance(value, int) else f"{value:.9g}" if math.isfinite(value) else str(value)


# The binary channels. A schema is an object: for each field it lists flags, name, aliases, type, and whether it has a
# default; a field of type 0 ends it. Numbers are little-endian.

_Field = tuple[str, str, float | Sequence[int]]  # name, format letter of ``struct``, value
_OBJECT, _END, _FIXED_ARRAY = 16, 0, 19
_TYPES: Mapping[str, bytes] = {
    "?": b"\x02", "b": b"\x03\x01", "i": b"\x03\x04", "B": b"\x04\x01", "I": b"\x04\x04", "Q": b"\x04\x08",
    "f": b"\x07",
}  # fmt: skip
_MEASURED: Mapping[str, int] = {  # registers, by the name of the field
    "position": 0x01, "velocity": 0x02, "torque_Nm": 0x03, "q_A": 0x04, "d_A": 0x05, "bus_V": 0x0D,
    "fet_temp_C": 0x0E, "motor_temp_C": 0x0A,
}  # fmt: skip


def _channels(servo: servos.Servo) -> Mapping[str, Sequence[_Field]]:
    """Return the current fields of each channel, by its name."""
    serial = [int(servo.read(0x120 + i, INT32) or 0) for i in range(3)]
    version, model = (servo.read(register, INT32) or 0 for register in (FIRMWARE, MODEL))
    measured = servo.measured
    return {
        "firmware": [("version", "I", version), ("serial_number", "I", serial), ("model", "I", model)],
        "git": [("hash", "B", bytes(20)), ("dirty", "?", 0), ("timestamp", "Q", 0)],
        "servo_stats": [
            ("mode", "b", servo.mode),
            ("fault", "i", servo.fault),
            *((name, "f", measured[register]) for name, register in _MEASURED.items()),
            ("timeout_s", "f", servo.timeout_s),
            ("trajectory_done", "?", measured[0x0B]),
        ],
    }


def _schema(fields: Sequence[_Field]) -> bytes:
    encoded = [bytes((_OBJECT, 0))]
    for name, letter, value in fields:
        array = bytes((_FIXED_ARRAY,)) + varuint(len(value)) if isinstance(value, Sequence) else b""
        encoded.append(_named(name) + array + _TYPES[letter] + b"\0")
    return b"".join([*encoded, _named(""), bytes((_END, 0))])


def _data(fields: Sequence[_Field]) -> bytes:
    values = ((letter, value if isinstance(value, Sequence) else [value]) for _, letter, value in fields)
    return b"".join(
        struct.pack(f"<{letter}", one if letter == "f" else int(one)) for letter, ones in values for one in ones
    )


def _named(name: str) -> bytes:
    return b"\0" + varuint(len(name)) + name.encode("ascii") + b"\0"
