"""The firmware's parameters over the link: read, written, kept (PROTOCOL.md, "Parameters")."""

import ctypes
import math
import struct
import time
from typing import NamedTuple

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameters
from hil.devices import handshake
from hil.errors import BadInputError, DeviceError, nearest
from hil.ports import Link

_RETRY_NS = 200_000_000
_SILENCE_NS = 2_000_000_000
_WHY_NOT = {
    m.Result.PARAMETER: "it knows no such parameter",
    m.Result.STATE: "it is not in IDLE; stop its controller first",
    m.Result.STORAGE: "it cannot keep parameters",
}


def assignment(text: str) -> tuple[str, float]:
    """Return name and value of ``name=value``. Raises BadInputError."""
    name, equals, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not (name and equals and math.isfinite(value)):
        raise BadInputError(f"{text!r}: expected NAME=NUMBER, for example speed_kp_n_m_s_rad=1.2")
    return name, value


class Held(NamedTuple):
    """A parameter as the robot holds it."""

    name: str
    value: float
    minimum: float
    maximum: float


class ParameterClient:
    """Asks the robot at the other end of a link for its parameters.

    Raises DeviceError when it does not answer, BadInputError when it speaks another version of the protocol.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._transaction = 0
        self.info = handshake.greet(link, lambda message: link.send(codec.encode(message)))
        self._table = parameters()

    def read(self) -> list[Held]:
        """Return every parameter in the firmware's order."""
        operations = (m.Operation.READ, m.Operation.READ_MINIMUM, m.Operation.READ_MAXIMUM)
        return [
            Held(row.name, *(self._value(self._ask(number, operation)) for operation in operations))
            for number, row in enumerate(self._table)
        ]

    def write(self, name: str, value: float) -> None:
        """Change one parameter until the robot is reset.

        Raises BadInputError for an unknown name or a value out of range, DeviceError when the robot refuses.
        """
        names = [row.name for row in self._table]
        if name not in names:
            raise BadInputError(f"the firmware has no parameter {name!r}{nearest(name, names)}")
        number = names.index(name)
        row = self._table[number]
        whole = row.type is m.Type.UINT32
        if whole and value != int(value):
            raise BadInputError(f"{name} = {value:g}; expected a whole number")
        # As the robot will hold it: a bound that single precision rounds is in the range. Infinity stands for too much.
        held = value if whole else ctypes.c_float(value).value
        if row.minimum <= held <= row.maximum:
            bits = int(value) if whole else struct.unpack("<I", struct.pack("<f", held))[0]
            if self._ask(number, m.Operation.WRITE, bits).result != m.Result.RANGE:
                return
        raise BadInputError(f"{name} = {value:g}; expected a number from {row.minimum:g} to {row.maximum:g}")

    def store(self) -> None:
        """Have the robot keep its parameters across a reset. Raises DeviceError when it refuses."""
        self._ask(0, m.Operation.STORE)

    def restore(self) -> None:
        """Go back to the values that the firmware was built with. Raises DeviceError when the robot refuses."""
        self._ask(0, m.Operation.RESTORE)

    def _ask(self, number: int, operation: m.Operation, value: int = 0) -> m.ParameterResponse:
        self._transaction = (self._transaction + 1) & 0xFF
        request = m.ParameterRequest(number, operation, self._transaction, value)
        deadline_ns = time.monotonic_ns() + _SILENCE_NS
        retry_ns = 0
        while (now_ns := time.monotonic_ns()) < deadline_ns:
            if now_ns >= retry_ns:  # a request that was answered twice has done the same twice
                self._link.send(codec.encode(request))
                retry_ns = now_ns + _RETRY_NS
            received = self._link.receive(_RETRY_NS)
            for frame in received.frames if received is not None else ():
                answer = codec.decode(frame)
                if not isinstance(answer, m.ParameterResponse) or answer[:3] != request[:3]:
                    continue
                if answer.result in _WHY_NOT:
                    raise DeviceError(
                        f"the robot refused to {operation.name} a parameter: {_WHY_NOT[m.Result(answer.result)]}"
                    )
                return answer
        raise DeviceError("the robot did not answer a parameter request within 2 s; it was lost")

    @staticmethod
    def _value(answer: m.ParameterResponse) -> float:
        if answer.type == m.Type.UINT32:
            return float(answer.value)
        value: float = struct.unpack("<f", struct.pack("<I", answer.value))[0]
        return value
