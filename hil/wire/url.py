"""Link URLs: text to a frozen value and back, without opening anything.

    memory:                                       both sides in one process
    serial:PATH?baud=921600                       PATH is any port name or URL that pyserial takes
    serial:pty?symlink=PATH                       makes a pseudo-terminal, with a fixed name if one is given
    can:INTERFACE/CHANNEL?bitrate=1000000&fd=1    an interface and a channel of python-can

The address ends at the first ``?``, and the CAN interface at the first ``/``; every later slash belongs to
the channel. ``%XX`` stands for one byte of UTF-8 in an address and in a value. So ``?`` is written %3F, ``%``
is written %25 and, in a value, ``&`` is written %26. A slash in a channel may be written as it is or as %2F.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import assert_never

from hil.core.errors import BadInputError, nearest

LINK_FORMS: Mapping[str, str] = {
    "memory:": "both sides in one process; the bytes are the same as on a serial line",
    "serial:PATH?baud=921600": "a serial port by name, or a URL of pyserial such as socket://127.0.0.1:5000",
    "serial:pty?symlink=PATH": "a new pseudo-terminal; symlink gives it a fixed name",
    "can:INTERFACE/CHANNEL?bitrate=1000000&fd=1&data_bitrate=4000000": "a CAN bus through python-can",
}
"""Every form of link URL, with what it is for."""

_SETTINGS = {"memory": (), "serial": ("baud", "symlink"), "can": ("bitrate", "fd", "data_bitrate")}
_EXAMPLES = {"memory": "memory:", "serial": "serial:/dev/ttyACM0", "can": "can:socketcan/can0"}
_PSEUDO_TERMINAL = "pty"
DEFAULT_BAUD = 921_600
"""Of our own firmware's serial line."""


@dataclass(frozen=True, slots=True)
class MemoryUrl:
    """Both sides in one process."""


@dataclass(frozen=True, slots=True)
class SerialUrl:
    """A serial line: pyserial's name or URL of the port, and its speed [baud].

    The port ``pty`` asks for a new pseudo-terminal, and ``symlink`` for a fixed name for it. Raises
    BadInputError when a field is out of its range.
    """

    port: str
    baud: int = DEFAULT_BAUD
    symlink: str | None = None

    def __post_init__(self) -> None:
        _check_text("the port", self.port)
        _check_range("baud", self.baud, 1_200, 12_000_000)
        if self.symlink is not None:
            _check_text("symlink", self.symlink)
            if not self.is_pty:
                raise BadInputError("symlink belongs to serial:pty only; remove it, or write serial:pty")

    @property
    def is_pty(self) -> bool:
        """Whether a pseudo-terminal is to be made."""
        return self.port == _PSEUDO_TERMINAL


@dataclass(frozen=True, slots=True)
class CanUrl:
    """A CAN bus as python-can names it, with its bit rates [bit/s]; ``data_bitrate`` is for FD's data phase.

    Raises BadInputError when a field is out of its range (ISO 11898-2: 1 Mbit/s; data phase 8 Mbit/s).
    """

    interface: str
    channel: str
    bitrate: int = 1_000_000
    fd: bool = False
    data_bitrate: int | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_.-]+", self.interface):
            raise BadInputError(
                f"{self.interface!r} is no name of a CAN interface; write can:INTERFACE/CHANNEL, "
                f"such as {_EXAMPLES['can']}"
            )
        _check_text("the CAN channel", self.channel)
        _check_range("bitrate", self.bitrate, 10_000, 1_000_000)
        if self.data_bitrate is not None:
            _check_range("data_bitrate", self.data_bitrate, self.bitrate, 8_000_000)
            if not self.fd:
                raise BadInputError("data_bitrate is for CAN FD only; add fd=1 or remove it")


LinkUrl = MemoryUrl | SerialUrl | CanUrl


def parse_link(url: str, *, baud: int = DEFAULT_BAUD) -> LinkUrl:
    """Return what a link URL says; ``baud`` is that of a serial line of which it says nothing.

    Raises BadInputError naming the URL, the wrong part and the remedy.
    """
    try:
        return _parse(url, baud)
    except BadInputError as error:
        raise BadInputError(f"link {url!r}: {error}") from None


def format_link(link: LinkUrl) -> str:
    """Return the shortest URL that ``parse_link`` reads as this link: no defaults, no needless escapes."""
    match link:
        case MemoryUrl():
            return "memory:"
        case SerialUrl():
            settings = {"baud": _unless(link.baud, DEFAULT_BAUD), "symlink": link.symlink}
            return _join(f"serial:{_escape(link.port)}", settings)
        case CanUrl():
            settings = {
                "bitrate": _unless(link.bitrate, 1_000_000),
                "fd": "1" if link.fd else None,
                "data_bitrate": _unless(link.data_bitrate, None),
            }
            return _join(f"can:{link.interface}/{_escape(link.channel)}", settings)
        case _:
            assert_never(link)


def _parse(url: str, baud: int) -> LinkUrl:
    scheme, colon, rest = url.partition(":")
    if scheme not in _SETTINGS or not colon:
        raise BadInputError(_unknown_scheme(url))
    address, question_mark, query = rest.partition("?")
    settings = _settings(query, _SETTINGS[scheme]) if question_mark else {}
    if scheme == "memory":
        if address:
            raise BadInputError("memory: takes no address; write memory:")
        return MemoryUrl()
    if scheme == "serial":
        return SerialUrl(
            port=_unescape(address),
            baud=_number(settings, "baud", baud),
            symlink=settings.get("symlink"),
        )
    interface, _, channel = address.partition("/")
    return CanUrl(
        interface=interface,
        channel=_unescape(channel),
        bitrate=_number(settings, "bitrate", 1_000_000),
        fd=_flag(settings, "fd"),
        data_bitrate=_number(settings, "data_bitrate", 0) if "data_bitrate" in settings else None,
    )


def _unknown_scheme(url: str) -> str:
    if re.match(r"/dev/|COM[0-9]|\\\\", url):
        return f"the kind of link is missing; for a serial port write serial:{url}"
    scheme, colon, _ = url.partition(":")
    if not colon and scheme in _SETTINGS:
        return f"the colon is missing; write {_EXAMPLES[scheme]}"
    return f"unknown kind of link {scheme!r}{nearest(scheme, _SETTINGS)}; an example: {_EXAMPLES['serial']}"


def _settings(query: str, known: tuple[str, ...]) -> dict[str, str]:
    """Return the settings behind the question mark, each given once, as key=value, and known."""
    settings: dict[str, str] = {}
    for item in query.split("&"):
        key, equals, value = item.partition("=")
        if not known:
            raise BadInputError("memory: takes no settings; write memory:")
        if key not in known:
            raise BadInputError(f"unknown setting {key!r}{nearest(key, known)}")
        if not equals or not value:
            raise BadInputError(f"the setting {key!r} has no value; write {key}=VALUE")
        if key in settings:
            raise BadInputError(f"the setting {key!r} is given twice; keep one of them")
        settings[key] = _unescape(value)
    return settings


def _number(settings: Mapping[str, str], key: str, default: int) -> int:
    if key not in settings:
        return default
    # int() would also take "1_000", " 5" and digits of other scripts.
    if not re.fullmatch("[0-9]{1,9}", settings[key]):
        raise BadInputError(f"{key} = {settings[key]!r}; expected a whole number of at most 9 digits")
    return int(settings[key])


def _flag(settings: Mapping[str, str], key: str) -> bool:
    value = settings.get(key, "0")
    if value not in ("0", "1"):
        raise BadInputError(f"{key} = {value!r}; expected 0 or 1")
    return value == "1"


def _check_range(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise BadInputError(f"{name} = {value}; expected {low} to {high}")


def _check_text(name: str, text: str) -> None:
    if not text:
        raise BadInputError(f"{name} is missing; write a link such as {_EXAMPLES['serial']} or {_EXAMPLES['can']}")
    if re.search(r"[\x00-\x1f\x7f]", text):
        raise BadInputError(f"{name} = {text!r}; a control character has no place in it")


def _unless(value: int | None, default: int | None) -> str | None:
    return None if value == default else str(value)


def _join(address: str, settings: Mapping[str, str | None]) -> str:
    given = [f"{key}={_escape(value)}" for key, value in settings.items() if value is not None]
    return f"{address}?{'&'.join(given)}" if given else address


def _escape(text: str) -> str:
    def percent(match: re.Match[str]) -> str:
        return "".join(f"%{byte:02X}" for byte in match.group().encode("utf-8", "surrogateescape"))

    return re.sub("[%?& \\udc80-\\udcff]", percent, text)


def _unescape(text: str) -> str:
    """Decode %XX. Bytes that are not UTF-8 become surrogates, as Python keeps them in paths (PEP 383)."""
    if bad := re.search("%(?![0-9A-Fa-f]{2}).{0,2}", text):
        raise BadInputError(f"{bad.group()!r} is no escape; write a percent sign as %25")
    data = text.encode("utf-8", "surrogateescape")
    data = re.sub(rb"%(..)", lambda match: bytes.fromhex(match.group(1).decode("ascii")), data)
    return data.decode("utf-8", "surrogateescape")
