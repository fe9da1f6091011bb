"""``hil probe``: which motor controllers are on a bus or a port. Nothing moves, and nothing is written.

First it only listens: most controllers speak by themselves. Then those makers' devices that were heard are asked what
they are; where nobody was heard, each maker's in turn. On a bus where somebody speaks whom nobody here knows, nobody is
asked: what reads in one protocol may be a command in another.
"""

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from firmware_protocol import codec
from firmware_protocol.generated import messages as m
from hil.devices import handshake
from hil.devices.handshake import Greeting
from hil.dialects.port import Dialect, Found, Probe
from hil.dialects.registry import DIALECTS, OUR_DRIVER, dialect
from hil.errors import BadInputError
from hil.init.questions import QUESTIONS, Value
from hil.init.texts import robot_text
from hil.links.language import WHEEL_DBC, Language
from hil.links.opening import is_within_process, open_host
from hil.links.url import CanUrl, LinkUrl, SerialUrl, format_link, parse_link
from hil.ports import Link
from hil.scenario.motors import wire_of

_LISTEN_S = 0.6  # longer than the slowest status that a controller sends by itself
_ROUNDS = 5
_ANSWER_S = 0.1
_DEFAULT_BAUD = SerialUrl("any").baud


@dataclass(frozen=True, slots=True)
class Answer:
    """What was found of one driver's, and the link that reaches it."""

    driver: str
    link: str
    sentences: tuple[str, ...]
    motors: Mapping[str, Any] | None

    @property
    def robot_file(self) -> str | None:
        """A robot's file that drives what was found; None where that is no whole robot."""
        if self.motors is None and self.driver != OUR_DRIVER:
            return None
        answers: dict[str, Value] = {}
        for question in QUESTIONS:
            answers[question.key] = self.link if question.key == "link.url" else question.proposed(answers)
        return robot_text(answers, self.driver, self.motors or {})


@dataclass(slots=True)
class Result:
    """``strangers`` counts frames of nobody who is known, by id; ``not_asked`` says why makers were left out."""

    answers: list[Answer] = field(default_factory=list)
    strangers: Counter[int] = field(default_factory=Counter)
    not_asked: str | None = None


def probe(link: str, driver: str | None = None, say: Callable[[str], None] = lambda _sentence: None) -> Result:
    """Return who is on a link; ``driver`` is the only one to look for. ``say`` is told what is being done.

    Raises BadInputError for a link within the process, LinkError when it cannot be opened.
    """
    url = parse_link(link)
    if is_within_process(url):
        raise BadInputError(f"link {link!r} reaches nobody outside this process; name a port or a bus")
    names = [driver] if driver is not None else [OUR_DRIVER, *DIALECTS]
    made = {name: dialect(name) for name in names if name != OUR_DRIVER}
    wire = wire_of(url, ())
    if wire == "serial":
        made = {name: one._replace(probe=one.serial_probe or one.probe) for name, one in made.items()}
    found = {name: one for name, one in made.items() if one.probe is not None and wire in one.wires}
    if driver is not None and driver != OUR_DRIVER and not found:
        raise BadInputError(f"a probe for {driver!r} over {link!r} does not exist; see DIALECTS.md")
    result = Result()
    if isinstance(url, CanUrl):
        _probe_bus(url, found, OUR_DRIVER in names, driver is not None, result, say)
    else:
        _probe_port(url, found, OUR_DRIVER in names, result, say)
    return result


def _probe_bus(
    url: CanUrl,
    makers: Mapping[str, Dialect],
    ours: bool,
    is_chosen: bool,
    result: Result,
    say: Callable[[str], None],
) -> None:
    probes = {name: made.probe() for name, made in makers.items() if made.probe is not None}
    with contextlib.closing(open_host(url, language=Language())) as link:
        say(f"listening for {_LISTEN_S:g} s")
        heard = _listen(link, probes.values(), _LISTEN_S)
        speaks = [name for name, one in probes.items() if one.found() is not None]
        speaks = speaks or [name for name, one in probes.items() if one.suspects]
        result.strangers = heard
        if not speaks and heard and not is_chosen:
            result.not_asked = (
                f"{sum(heard.values())} frames came of nobody who is known here, so nobody was asked: a question in "
                "one protocol may be a command in another; name the only one to ask with --driver"
            )
            return
        for name in speaks or probes:
            say(f"asking {makers[name].title}")
            _ask(link, probes[name])
    for name, one in probes.items():
        _add(result, name, url, one.found())
    if ours and not result.answers:
        say("asking for our own firmware")
        _greet(url, result)


def _probe_port(
    url: LinkUrl, makers: Mapping[str, Dialect], ours: bool, result: Result, say: Callable[[str], None]
) -> None:
    """Try each maker's framing at its rate, one after the other, until one is understood."""
    assert isinstance(url, SerialUrl)
    if ours:
        say("asking for our own firmware")
        _greet(url, result)
    for name, made in makers.items():
        if result.answers or made.make_framing is None or made.probe is None:
            continue
        at = SerialUrl(url.port, made.baud) if url.baud == _DEFAULT_BAUD else url
        one = made.probe()
        say(f"listening for {made.title} at {at.baud} baud")
        with contextlib.closing(open_host(at, language=Language(made.make_framing))) as link:
            _listen(link, [one], _LISTEN_S)
            _ask(link, one)
        _add(result, name, at, one.found())


def _ask(link: Link, one: Probe) -> None:
    """Ask, and ask what follows from the answers."""
    for _ in range(_ROUNDS):
        frames = one.ask()
        for frame in frames:
            link.send(frame)
        if frames:
            _listen(link, [one], _ANSWER_S)


def _listen(link: Link, probes: Iterable[Probe], seconds: float) -> Counter[int]:
    """Show the probes what comes; return how many frames of each id came."""
    probes, heard = list(probes), Counter[int]()
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    while (left_ns := end_ns - time.monotonic_ns()) > 0:
        if (received := link.receive(left_ns)) is not None:
            heard[received.frame.id] += 1
            for one in probes:
                one.feed(received.frame)
    return heard


def _add(result: Result, name: str, url: LinkUrl, found: Found | None) -> None:
    if found is not None:
        result.answers.append(Answer(name, format_link(url), tuple(found.sentences), found.motors))


def _greet(url: LinkUrl, result: Result) -> None:
    """Ask for HELLO, of which every version of our firmware answers the first page."""
    greeting = Greeting()
    with contextlib.closing(open_host(url, language=WHEEL_DBC)) as link:
        link.send(codec.encode(m.HelloRequest(m.PROTOCOL_VERSION)))
        end_ns = time.monotonic_ns() + handshake.RETRY_NS * 2
        while (left_ns := end_ns - time.monotonic_ns()) > 0:
            received = link.receive(left_ns)
            info = greeting.feed(codec.decode(received.frame)) if received is not None else None
            if info is not None:
                words = f"our own firmware: {info.describe()}"
                result.answers.append(Answer(OUR_DRIVER, format_link(url), (words,), {}))
                return
