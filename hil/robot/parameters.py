"""Reads, writes and stores the firmware's parameters over the link (PROTOCOL.md, "Parameters")."""

import ctypes
import math
import struct
import time
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameters
from hil.core.errors import BadInputError, DeviceError, LinkError, nearest
from hil.core.ports import Link
from hil.robot import handshake

_RETRY_NS = 200_000_000
_SILENCE_NS = 4_000_000_000  # a board may erase its flash for 2 s before it answers a STORE
_WHY_NOT = {
    m.Result.PARAMETER: "it has no such parameter",
    m.Result.STATE: "it is not in IDLE; stop its controller first",
    m.Result.STORAGE: "it cannot store parameters",
}


def assignments(texts: Iterable[str]) -> dict[str, float]:
    """Return the values of texts like ``name=value``, by name. Raises BadInputError, also for a repeated name."""
    values: dict[str, float] = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not name or not math.isfinite(value):
            raise BadInputError(f"{text!r}: expected NAME=NUMBER, for example speed_kp_n_m_s_rad=1.2")
        if name in values:
            raise BadInputError(f"{name} is given twice, as {values[name]:g} and as {value:g}; keep one of them")
        values[name] = value
    return values


class Held(NamedTuple):
    """A parameter with its value and range in the robot."""

    name: str
    type: m.Type
    value: float
    minimum: float
    maximum: float


class Change(NamedTuple):
    """A checked change: the parameter's ``number``, and the ``bits`` of its new value on the wire."""

    name: str
    number: int
    bits: int


class ParameterClient:
    """Reads and changes the parameters of the robot at the other end of a link.

    Raises DeviceError when it does not answer, BadInputError when it uses another version of the protocol.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._transaction = 0
        self._changed: list[str] = []
        self._table = parameters()
        self._reset_cause = self._identify(status=True).reset_cause

    def greet(self) -> handshake.RobotInfo:
        """Return the robot's info now; its hash is that of the parameters in use."""
        return self._identify()._replace(reset_cause=self._reset_cause)

    def _identify(self, *, status: bool = False) -> handshake.RobotInfo:
        return handshake.greet(self._link, handshake.Greeting(), status=status)

    def read(self) -> list[Held]:
        """Return every parameter, in the firmware's order."""
        operations = (m.Operation.READ, m.Operation.READ_MINIMUM, m.Operation.READ_MAXIMUM)
        return [
            Held(row.name, row.type, *(self._value(self._request(number, operation)) for operation in operations))
            for number, row in enumerate(self._table)
        ]

    def check(self, values: Mapping[str, float]) -> list[Change]:
        """Check values by name and return the changes for ``write``. Nothing is changed yet.

        Raises BadInputError with a line for each unknown name and each value outside the robot's own range.
        """
        changes: list[Change] = []
        problems: list[str] = []
        for name, value in values.items():
            try:
                changes.append(self._change_to(name, value))
            except BadInputError as error:
                problems.append(str(error))
        if problems:
            raise BadInputError("\n".join(problems))
        return changes

    def _change_to(self, name: str, value: float) -> Change:
        names = [row.name for row in self._table]
        if name not in names:
            raise BadInputError(f"the firmware has no parameter {name!r}{nearest(name, names)}")
        number = names.index(name)
        whole = self._table[number].type is m.Type.UINT32
        if whole and value != int(value):
            raise BadInputError(f"{name} = {value:g}; expected a whole number")
        # Rounded to single precision, as in the robot: a rounded bound is in the range. Overflow gives infinity.
        held = value if whole else ctypes.c_float(value).value
        # The range of a board may be smaller than the table's.
        least, most = (
            self._value(self._request(number, limit)) for limit in (m.Operation.READ_MINIMUM, m.Operation.READ_MAXIMUM)
        )
        if not least <= held <= most:
            raise BadInputError(f"{name} = {value:g}; expected a number from {least:g} to {most:g}")
        return Change(name, number, int(value) if whole else struct.unpack("<I", struct.pack("<f", held))[0])

    def write(self, changes: Iterable[Change]) -> None:
        """Write changes; they last until a reset. Raises DeviceError if one is refused, with those made before."""
        for change in changes:
            answer = self._order(change.number, m.Operation.WRITE, change.bits)
            if answer.result == m.Result.RANGE:
                raise DeviceError(self._with_changes(f"the robot refused {change.name}: its range has changed"))
            self._changed.append(change.name)

    def store(self) -> None:
        """Make the robot keep its parameters across resets. Raises DeviceError when it refuses."""
        self._order(0, m.Operation.STORE)

    def restore(self) -> None:
        """Restore the values that the firmware was built with. Raises DeviceError when the robot refuses."""
        self._order(0, m.Operation.RESTORE)
        self._changed.append("all to those of the build")

    def _order(self, number: int, operation: m.Operation, value: int = 0) -> m.ParameterResponse:
        try:
            return self._request(number, operation, value)
        except (DeviceError, LinkError) as error:
            raise type(error)(self._with_changes(str(error))) from error

    def _with_changes(self, sentence: str) -> str:
        if not self._changed:
            return f"{sentence}; nothing was changed"
        return f"{sentence}; changed before that, until the next reset: {', '.join(self._changed)}"

    def _request(self, number: int, operation: m.Operation, value: int = 0) -> m.ParameterResponse:
        self._transaction = (self._transaction + 1) & 0xFF
        request = m.ParameterRequest(number, operation, self._transaction, value)
        deadline_ns = time.monotonic_ns() + _SILENCE_NS
        retry_ns = 0
        while (now_ns := time.monotonic_ns()) < deadline_ns:
            if now_ns >= retry_ns:  # repeating a request does no harm
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
        raise DeviceError("the robot did not answer a parameter request within 4 s; check its power and the link")

    @staticmethod
    def _value(answer: m.ParameterResponse) -> float:
        if answer.type == m.Type.UINT32:
            return float(answer.value)
        value: float = struct.unpack("<f", struct.pack("<I", answer.value))[0]
        return value
