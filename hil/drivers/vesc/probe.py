"""Finds VESCs: on a bus by a ping to every id; at a serial line by the scan that the VESC there makes of its bus."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.drivers.four_motors import found_by_id
from hil.drivers.port import ANSWER_S, EXTENDED, Found, Probe
from hil.drivers.vesc import frames
from hil.drivers.vesc.frames import MAX_ID

_HOST = 253
_IS_VESC = 0  # the hardware type; other types are battery managers and modules
_SCAN_S = 4.0  # the VESC waits 10 ms for each of 255 ids
_UNKNOWN = ("device.motors.pole_pairs", "device.motors.gear_ratio", "firmware.torque_constant_n_m_a")


class BusProbe(Probe):
    """Pings every id, and listens for status messages."""

    patience_s = ANSWER_S

    def __init__(self) -> None:
        self._ids: set[int] = set()

    def ask(self) -> Sequence[Frame]:
        return [
            Frame(EXTENDED | frames.CAN_PING << 8 | number, bytes((_HOST,)))
            for number in range(MAX_ID + 1)
            if number != _HOST
        ]

    def feed(self, frame: Frame) -> bool:
        command, number = (frame.id & ~EXTENDED) >> 8, frame.id & 0xFF
        if not frame.id & EXTENDED:
            return False
        if command == frames.CAN_STATUS and len(frame.payload) == frames.STATUS.size:
            self._ids.add(number)
        elif command == frames.CAN_PONG and number == _HOST and frame.payload[1:2] in (b"", bytes((_IS_VESC,))):
            self._ids.update(frame.payload[:1])
        return number in self._ids

    def found(self) -> Found | None:
        return found_by_id({number: f"a VESC with the id {number}" for number in self._ids}, _UNKNOWN)


class LineProbe(Probe):
    """Asks the VESC at the line for firmware and id, and then, once, to ping those behind it, which takes 3 s."""

    def __init__(self) -> None:
        self._version: frames.Version | None = None
        self._near: int | None = None
        self._behind: set[int] | None = None
        self._has_asked_for_scan = False

    @property
    def _is_known(self) -> bool:
        return self._version is not None and self._near is not None

    def ask(self) -> Sequence[Frame]:
        if not self._is_known:
            request = frames.request_values(frames.ID_BIT)
            return [Frame(frames.FW_VERSION, b""), Frame(request[0], request[1:])]
        if self._has_asked_for_scan:
            return ()
        self._has_asked_for_scan = True
        return [Frame(frames.PING_CAN, b"")]

    @property
    def patience_s(self) -> float:
        if not self._is_known:
            return ANSWER_S
        return _SCAN_S if self._has_asked_for_scan and self._behind is None else 0.0

    def feed(self, frame: Frame) -> bool:
        message = bytes((frame.id & 0xFF,)) + frame.payload
        self._version = frames.parse_version(message) or self._version
        if (values := frames.parse_values(message)) is not None and "id" in values:
            self._near = int(values["id"])
        if frame.id == frames.PING_CAN:
            self._behind = set(frame.payload)
        return True  # other makers' packets fail the checksum

    def found(self) -> Found | None:
        if self._version is None or self._near is None:
            return None
        near = f"a VESC ({self._version}) with the id {self._near} at the line"
        if self._behind is None:
            silent = f"it has not reported within {_SCAN_S:g} s which others are on its CAN bus"
            return Found([near, silent], None, unknown=_UNKNOWN)
        behind = {number: f"a VESC behind it with the id {number}" for number in self._behind}
        return found_by_id({self._near: near} | behind, _UNKNOWN, serial_id=self._near)
