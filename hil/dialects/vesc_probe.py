"""Finding VESCs: by a ping to every id on a bus, by the scan that one at a serial line makes of the bus behind it."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.dialects import vesc_frames as frames
from hil.dialects.port import EXTENDED, Found

_HOST = 253
_IS_VESC = 0  # the hardware type; others are batteries' managers and modules
_UNTOLD = "pole_pairs and gear_ratio cannot be asked for: add them"


class BusProbe:
    """Pings, and hears status messages."""

    def __init__(self) -> None:
        self._ids: set[int] = set()

    def ask(self) -> Sequence[Frame]:
        return [
            Frame(EXTENDED | frames.CAN_PING << 8 | number, bytes((_HOST,)))
            for number in range(frames.MOST_IDS + 1)
            if number != _HOST
        ]

    def feed(self, frame: Frame) -> None:
        command, number = (frame.id & ~EXTENDED) >> 8, frame.id & 0xFF
        if not frame.id & EXTENDED:
            return
        if command == frames.CAN_STATUS and len(frame.payload) == frames.STATUS.size:
            self._ids.add(number)
        elif command == frames.CAN_PONG and number == _HOST and frame.payload[1:2] in (b"", bytes((_IS_VESC,))):
            self._ids.update(frame.payload[:1])

    suspects = False

    def found(self) -> Found | None:
        if not self._ids:
            return None
        ids = sorted(self._ids)
        sentences = [f"a VESC with the id {number}" for number in ids]
        return Found([*sentences, _UNTOLD], {"ids": ids} if len(ids) == 4 else None)


class LineProbe:
    """Asks the one at the line for its firmware and id, and to ping those behind it, which takes it 3 s."""

    def __init__(self) -> None:
        self._version: frames.Version | None = None
        self._near: int | None = None
        self._behind: set[int] = set()

    def ask(self) -> Sequence[Frame]:
        wanted = frames.values_wanted(frames.ID_BIT)
        return [Frame(frames.FW_VERSION, b""), Frame(wanted[0], wanted[1:]), Frame(frames.PING_CAN, b"")]

    def feed(self, frame: Frame) -> None:
        message = bytes((frame.id & 0xFF,)) + frame.payload
        self._version = frames.parse_version(message) or self._version
        if (values := frames.parse_values(message)) is not None and "id" in values:
            self._near = int(values["id"])
        if frame.id == frames.PING_CAN:
            self._behind.update(frame.payload)

    suspects = False

    def found(self) -> Found | None:
        if self._version is None or self._near is None:
            return None
        major, minor, hardware = self._version
        sentences = [f"a VESC ({hardware}, firmware {major}.{minor:02}) with the id {self._near} at the line"]
        sentences += [f"a VESC behind it with the id {number}" for number in sorted(self._behind)]
        ids = sorted(self._behind | {self._near})
        motors = {"ids": ids, "serial_id": self._near} if len(ids) == 4 else None
        return Found([*sentences, _UNTOLD], motors)
