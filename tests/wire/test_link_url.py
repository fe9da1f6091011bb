"""Link URLs: reading and writing are inverse, escapes are defined, and every mistake has its own sentence."""

import string
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.runtime.assembly import run
from hil.wire.can_url import CanUrl
from hil.wire.link import LinkUrl
from hil.wire.serial_url import SerialUrl
from hil.wire.url import MemoryUrl, link_forms, parse_link
from tests.support.outside import outside_package

# Reserved characters and percent signs far more often than chance would have them.
addresses = st.text(st.one_of(st.sampled_from("%?&/=:# "), st.characters(exclude_categories=["Cc", "Cs"])), min_size=1)
serial_urls = st.one_of(
    st.builds(SerialUrl, addresses, st.integers(1_200, 12_000_000)),
    st.builds(SerialUrl, st.just("pty"), st.just(921_600), st.none() | addresses),
)


@st.composite
def can_urls(draw: st.DrawFn) -> CanUrl:
    bitrate = draw(st.integers(10_000, 1_000_000))
    fd = draw(st.booleans())
    data_bitrate = draw(st.none() | st.integers(bitrate, 8_000_000)) if fd else None
    interface = draw(st.text(string.ascii_letters + string.digits + "_.-", min_size=1))
    return CanUrl(interface, draw(addresses), bitrate, fd, data_bitrate)


@given(st.one_of(st.just(MemoryUrl()), serial_urls, can_urls()))
def test_reading_what_was_written_gives_the_same_link(link: LinkUrl) -> None:
    assert parse_link(str(link)) == link


@given(st.text(max_size=60))
def test_any_text_is_a_link_or_bad_input(text: str) -> None:
    for url in (text, f"serial:{text}", f"can:{text}", f"can:virtual/{text}", f"serial:pty?{text}"):
        try:
            link = parse_link(url)
        except BadInputError:
            continue
        assert parse_link(str(link)) == link


@pytest.mark.parametrize(
    ("url", "link"),
    [
        ("memory:", MemoryUrl()),
        ("serial:COM3", SerialUrl("COM3")),
        (r"serial:\\.\COM10?baud=115200", SerialUrl(r"\\.\COM10", 115_200)),
        ("serial:/dev/ttyACM0?baud=2000000", SerialUrl("/dev/ttyACM0", 2_000_000)),
        ("serial:socket://127.0.0.1:5000", SerialUrl("socket://127.0.0.1:5000")),
        ("serial:socket://host:1%3Flogging=debug", SerialUrl("socket://host:1?logging=debug")),
        ("serial:pty", SerialUrl("pty")),
        ("serial:pty?symlink=/tmp/a%26b", SerialUrl("pty", symlink="/tmp/a&b")),
        ("can:socketcan/can0", CanUrl("socketcan", "can0")),
        ("can:virtual/a?bitrate=500000&fd=0", CanUrl("virtual", "a", 500_000)),
        ("can:pcan/x?fd=1&data_bitrate=4000000", CanUrl("pcan", "x", fd=True, data_bitrate=4_000_000)),
    ],
)
def test_forms(url: str, link: LinkUrl) -> None:
    assert parse_link(url) == link


def test_a_slash_in_a_channel_may_be_escaped_or_not() -> None:
    plain, escaped = parse_link("can:slcan//dev/ttyUSB0"), parse_link("can:slcan/%2Fdev%2fttyUSB0")
    assert plain == escaped == CanUrl("slcan", "/dev/ttyUSB0")


def test_escapes_are_decoded_once() -> None:
    assert parse_link("can:virtual/%253F") == CanUrl("virtual", "%3F")


def test_bytes_that_are_not_utf_8_survive() -> None:
    link = parse_link("serial:/tmp/%FF")
    assert link == SerialUrl("/tmp/\udcff")
    assert str(link) == "serial:/tmp/%FF"


def test_defaults_are_not_written() -> None:
    assert str(parse_link("serial:pty?baud=921600")) == "serial:pty"


def test_a_rate_that_the_url_says_is_kept_whatever_is_usual() -> None:
    assert parse_link("serial:COM3", baud=115_200) == SerialUrl("COM3", 115_200)
    assert parse_link("serial:COM3?baud=921600", baud=115_200) == SerialUrl("COM3", 921_600)
    assert str(parse_link("can:virtual/a?bitrate=1000000&fd=0")) == "can:virtual/a"


def test_every_listed_form_is_readable() -> None:
    for form in link_forms():
        parse_link(form)


@pytest.mark.parametrize(
    ("url", "sentence"),
    [
        ("serail:/dev/ttyACM0", "unknown kind of link 'serail'; did you mean 'serial'?"),
        ("/dev/ttyACM0", "the kind of link is missing; for a serial port write serial:/dev/ttyACM0"),
        ("COM3", "write serial:COM3"),
        ("memory", "the colon is missing; write memory:"),
        ("memory:x", "takes no address"),
        ("memory:?baud=1", "takes no settings"),
        ("serial:", "the port is missing; write a link such as serial:/dev/ttyACM0 or can:socketcan/can0"),
        ("serial:/x?baut=9600", "unknown setting 'baut'; did you mean 'baud'?"),
        ("serial:/x?baud=fast", "baud = 'fast'; expected a whole number"),
        ("serial:/x?baud=1_000_000", "baud = '1_000_000'; expected a whole number"),
        ("serial:/x?baud=99999999999", "expected a whole number of at most 9 digits"),
        ("serial:/x?baud=12", "baud = 12; expected 1200 to 12000000"),
        ("serial:/x?baud=9600&baud=9600", "the setting 'baud' is given twice; keep one of them"),
        ("serial:/x?baud", "'baud' has no value"),
        ("serial:/x?symlink=/y", "symlink belongs to serial:pty only"),
        ("serial:/100%", "'%' is not an escape sequence; write a percent sign as %25"),
        ("serial:/a%00b", "remove the control character"),
        ("can:virtual", "the CAN channel is missing"),
        ("can:/a", "is no CAN interface"),
        ("can:virtual/a?fd=yes", "fd = 'yes'; expected 0 or 1"),
        ("can:virtual/a?bitrate=2000000", "bitrate = 2000000; expected 10000 to 1000000"),
        ("can:virtual/a?data_bitrate=2000000", "data_bitrate is for CAN FD only; add fd=1"),
        ("can:virtual/a?fd=1&data_bitrate=9", "data_bitrate = 9; expected 1000000 to 8000000"),
    ],
)
def test_mistakes(url: str, sentence: str) -> None:
    with pytest.raises(BadInputError) as caught:
        parse_link(url)
    assert str(caught.value).startswith(f"link {url!r}: ")
    assert sentence in str(caught.value)


def test_a_system_without_pseudo_terminals_is_told_what_to_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "hil.wire.pty", None)
    with pytest.raises(BadInputError) as refused:
        run("circle_speed", link="serial:pty")
    assert str(refused.value) == (
        "serial:pty needs a POSIX system; on Windows use memory:, or a pair of virtual COM ports"
    )


PIPE = """
    from dataclasses import dataclass

    from hil.core.errors import BadInputError
    from hil.core.link_protocol import WHEEL_DBC
    from hil.wire.framed import StreamLink
    from hil.wire.link import LinkUrl, Pair, unchanged
    from hil.wire.robot_end import SerialWire
    from hil.wire.streams import memory_pair

    @dataclass(frozen=True)
    class PipeUrl(LinkUrl):
        settings = ("name",)
        is_within_process = True
        name: str

        @classmethod
        def read(cls, address, settings, baud):
            if address:
                raise BadInputError("pipe: takes no address")
            return cls(settings.get("name", "nameless"))

        def __str__(self):
            return f"pipe:?name={self.name}"

        def open_pair(self, line=unchanged, *, lockstep, protocol=WHEEL_DBC):
            host, robot = memory_pair()
            return Pair(StreamLink(line(host), protocol), SerialWire(robot))

    class HalfUrl(PipeUrl):
        open_pair = LinkUrl.open_pair

        def __str__(self):
            return "half:"

    NO_LINK = 3
"""


def test_another_package_s_link_is_one_class_and_a_run_goes_over_it(tmp_path, monkeypatch) -> None:
    points = {"pipe": "outside_package:PipeUrl", "memory": "outside_package:PipeUrl", "no": "outside_package:NO_LINK"}
    points["half"] = "outside_package:HalfUrl"
    outside_package(tmp_path, monkeypatch, PIPE, {"hil.links": points})
    assert str(parse_link("pipe:?name=x")) == "pipe:?name=x"
    assert parse_link("memory:") == MemoryUrl(), "a shipped kind keeps its name"
    assert "outside-package" in link_forms()["pipe:"]
    for url, sentence in (
        ("pipe:?nam=x", "unknown setting 'nam'; did you mean 'name'?"),
        ("pipe:x", "takes no address"),
        ("pip:", "did you mean 'pipe'?"),
        ("pipe", "the colon is missing; write pipe:"),
        ("no:", "expected a subclass of hil.wire.link.LinkUrl"),
    ):
        with pytest.raises(BadInputError) as caught:
            parse_link(url)
        assert sentence in str(caught.value)
    with pytest.raises(BadInputError, match=r"^pipe:\?name=x has no other end outside this process; use serial:"):
        parse_link("pipe:?name=x").open_host()
    with pytest.raises(BadInputError, match=r"^pipe:\?name=x does not reach another process; use --link serial:pty"):
        parse_link("pipe:?name=x").open_robot(print, lockstep=True)
    with pytest.raises(BadInputError, match=r"^half: does not stay within this process$"):
        run("circle_speed", link="half:")
    error = {"kind": "bit_errors", "target": "command", "value": 0.0005}
    options = {"loop.duration_s": 0.3, "expect": [], "fault": [error]}
    over_memory, over_it = (run("circle_speed", set=options, link=link).metrics for link in ("memory:", "pipe:"))
    assert over_it["wire_sha256"] == over_memory["wire_sha256"]
    assert over_it["fault"][0]["applied"] > 0
    assert over_it["link"] == "pipe:"
