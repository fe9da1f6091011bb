"""The URL of a serial line, or of a pseudo-terminal."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from hil.core.errors import BadInputError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Link
from hil.wire import link
from hil.wire.link import DEFAULT_BAUD, Line, LinkUrl, Pair, check_text, closed_on_failure, port_name, unchanged

if TYPE_CHECKING:
    from hil.wire.link_statistics import Meter
    from hil.wire.pty import PtyStream
    from hil.wire.robot_end import Wire

# Transports are imported only when opened: a machine may lack some of their packages, and pseudo-terminals need POSIX.

_PSEUDO_TERMINAL = "pty"


@dataclass(frozen=True, slots=True)
class SerialUrl(LinkUrl):
    """A serial line: pyserial's name or URL of the port, and its speed [baud].

    The port ``pty`` makes a new pseudo-terminal; ``symlink`` gives it a fixed name. Raises BadInputError for a field
    out of range.
    """

    example: ClassVar[str] = link.EXAMPLE
    forms: ClassVar[Mapping[str, str]] = {
        "serial:PATH?baud=921600": "a serial port by name, or a URL of pyserial such as socket://127.0.0.1:5000",
        "serial:pty?symlink=PATH": "a new pseudo-terminal; symlink gives it a fixed name",
    }
    settings: ClassVar[tuple[str, ...]] = ("baud", "symlink")

    port: str
    baud: int = DEFAULT_BAUD
    symlink: str | None = None

    def __post_init__(self) -> None:
        check_text("the port", self.port)
        link.check_range("baud", self.baud, 1_200, 12_000_000)
        if self.symlink is not None:
            check_text("symlink", self.symlink)
            if not self.is_within_process:
                raise BadInputError("symlink belongs to serial:pty only; remove it, or write serial:pty")

    @classmethod
    def read(cls, address: str, settings: Mapping[str, str], baud: int) -> "SerialUrl":
        return cls(link.unescape(address), link.number(settings, "baud", baud), settings.get("symlink"))

    def __str__(self) -> str:
        baud = None if self.baud == DEFAULT_BAUD else self.baud
        return link.join(f"serial:{link.escape(self.port)}", {"baud": baud, "symlink": self.symlink})

    @property
    def is_within_process(self) -> bool:
        return self.port == _PSEUDO_TERMINAL

    @property
    def serial_port(self) -> tuple[str, int]:
        return self.port, self.baud

    def device_name(self) -> str | None:
        return None if self.is_within_process else port_name(self.port)

    def open_host(self, line: Line = unchanged, protocol: LinkProtocol = WHEEL_DBC) -> Link:
        from hil.wire.framed import StreamLink
        from hil.wire.serial_port import SerialStream

        return StreamLink(line(SerialStream(self.port, self.baud)), protocol)

    def open_pair(self, line: Line = unchanged, *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC) -> Pair:
        from hil.wire.robot_end import SerialWire

        pty = self._open_pty(protocol, lockstep=lockstep)
        with closed_on_failure(pty):
            return Pair(SerialUrl(pty.port, self.baud).open_host(line, protocol), SerialWire(pty))

    def open_robot(
        self, say: Callable[[str], None], *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC
    ) -> tuple["Wire", str]:
        from hil.wire.robot_end import ReopeningWire, SerialWire
        from hil.wire.serial_port import SerialStream

        if self.is_within_process:
            pty = self._open_pty(protocol, lockstep=lockstep)
            return SerialWire(pty), str(SerialUrl(self.symlink or pty.port, self.baud))
        stream = SerialStream(self.port, self.baud)
        return ReopeningWire(SerialWire(stream), stream.reopen, say), str(self)

    def _open_pty(self, protocol: LinkProtocol, *, lockstep: bool) -> "PtyStream":
        try:
            from hil.wire.pty import PtyStream
        except ImportError as error:
            raise BadInputError(
                "serial:pty needs a POSIX system; on Windows use memory:, or a pair of virtual COM ports"
            ) from error
        return PtyStream(Path(self.symlink) if self.symlink else None, waits=lockstep, protocol=protocol)

    def meter(self, link: Any) -> "Meter":
        from hil.wire.link_statistics import LineMeter

        return LineMeter(link, self.baud)
