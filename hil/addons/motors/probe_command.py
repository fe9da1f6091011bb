"""``hil probe``: finds the motor controllers on a bus or a port. Nothing moves, and no parameter is written.

First it only listens, because this project's firmware and most controllers send by themselves. Then it queries those
that were heard, this project's firmware first; on a silent line it queries each kind in turn. If there is traffic that
no driver understands, it queries none: a query in one protocol may be a command in another.
"""

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import typer
from typer import Option

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.cli.options import Json, PortOrBus
from hil.cli.output import print_result, say
from hil.core.errors import BadInputError
from hil.core.extensions import Extensions
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Framing, Link
from hil.robot import handshake
from hil.robot.driver import Found, Probe
from hil.robot.driver_registry import OUR_DRIVER, dialect, driver_names
from hil.robot.handshake import Greeting, RobotInfo
from hil.wire.device_lock import device_held
from hil.wire.framed import StreamLink
from hil.wire.link import DEFAULT_BAUD, LinkUrl
from hil.wire.url import parse_link

_LISTEN_S = 0.6  # longer than the slowest status that a controller sends by itself
_ROUNDS = 5
_GREETINGS = 2
_WIRING = (
    "which wheel each motor turns, and which way, cannot be queried: see hil commission; a base that takes velocities "
    "of the body knows it itself"
)
_REMEDY = (
    "check power, cable, and the link's bit rate or baud; on a CAN bus, moteus are found only with fd=1 in the link, "
    "and all others only without"
)


def probe(
    link: PortOrBus,
    driver: Annotated[str | None, Option(metavar="NAME", help="look for this one only")] = None,
    as_json: Json = False,
) -> None:
    """Find the motor controllers on a bus or a port, and print a robot file for them.

    Nothing moves and nothing is written: it listens, and asks for versions. Exit 1 when nothing was found.
    """
    with device_held(parse_link(link), f"hil probe {link}"):
        result = find_motors(link, driver, lambda sentence: None if as_json else say(f"# {sentence}"))
    print_result(as_json, result.record(), result.lines())
    raise typer.Exit(0 if result.answers else 1)


@dataclass(frozen=True, slots=True)
class Answer:
    """The controllers found of one driver, and the link that reaches them."""

    driver: str
    link: str
    found: Found

    @property
    def robot_file(self) -> str | None:
        """A robot file for the controllers; None when they are not a whole robot."""
        if self.found.motors is None:
            return None
        robot_text = Extensions("hil.robot_files").load("probe", "the robot file of hil probe")
        return str(robot_text(self.found, self.driver, self.link))


@dataclass(slots=True)
class Result:
    """The result of a probe.

    Attributes:
        answers: the controllers that were found.
        strangers: number of frames of unknown senders on a bus, by id.
        not_queried: why third-party controllers were not queried, or None.
    """

    answers: list[Answer] = field(default_factory=list)
    strangers: Counter[int] = field(default_factory=Counter)
    not_queried: str | None = None

    def record(self) -> dict[str, object]:
        """Return the result for JSON."""
        found = []
        for answer in self.answers:
            facts = answer.found._asdict() | {"known": dict(answer.found.known)}
            found.append({"driver": answer.driver, "link": answer.link, "what": facts.pop("sentences"), **facts})
        strangers = {f"{number:#x}": count for number, count in self.strangers.items()}
        return {"found": found, "strangers": strangers, "not_asked": self.not_queried}

    def lines(self) -> Iterator[str]:
        """Yield a robot file for each answer; the sentences of the result are its comments."""
        if self.not_queried is not None:
            yield f"# {self.not_queried}"
        for answer in self.answers:
            yield from (f"# {sentence}" for sentence in answer.found.sentences)
            if (text := answer.robot_file) is None:
                where = f"see DRIVERS.md for [device.motors] of {answer.driver!r}"
                yield f"# this is not a whole robot with four motors; {where}"
            else:
                yield from (f"# {_WIRING}", text)
        if self.strangers:
            ids = ", ".join(f"{number:#x}" for number in sorted(self.strangers))
            yield f"# {self.strangers.total()} frames are of unknown senders, with the ids {ids}"
        if not self.answers:
            yield f"# no motor controllers were found; {_REMEDY}"


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A kind of controller to look for. ``claimed`` are the ids of received frames that may be of this kind."""

    driver: str
    title: str
    probe: Probe
    make_framing: Callable[[], Framing] | None
    url: LinkUrl
    claimed: set[int] = field(default_factory=set)


class _OurProbe(Probe):
    """Queries HELLO: every version of this project's firmware answers its first page."""

    def __init__(self) -> None:
        self._greeting = Greeting()
        self._queries = 0
        self._info: RobotInfo | None = None

    @property
    def patience_s(self) -> float:
        is_done = self._info is not None and self._info.reset_cause is not None
        return 0.0 if is_done else handshake.RETRY_NS * 1e-9

    def ask(self) -> Sequence[Frame]:
        if self._info is not None or self._queries == _GREETINGS:
            return ()
        self._queries += 1
        return (codec.encode(m.HelloRequest(m.PROTOCOL_VERSION)),)

    def feed(self, frame: Frame) -> bool:
        if WHEEL_DBC.refusal(frame.id, len(frame.payload), "ROBOT") is not None:
            return False
        if self._queries:
            self._info = self._greeting.feed(codec.decode(frame)) or self._info
        return True

    def found(self) -> Found | None:
        if self._info is None:
            return None
        geometry = self._info.geometry
        known: dict[str, float] = {
            f"robot.{name}": round(getattr(geometry, name), 4)  # a frame's resolution is 0.12 mm
            for name in ("wheel_radius_m", "half_length_m", "half_width_m")
        }
        known["firmware.counts_per_revolution"] = geometry.counts_per_revolution
        return Found([f"our own firmware: {self._info.describe()}"], {}, known)


def find_motors(link: str, driver: str | None = None, say: Callable[[str], None] = lambda _sentence: None) -> Result:
    """Return the controllers on a link, only those of ``driver`` if one is given. ``say`` gets progress sentences.

    Raises BadInputError for a link within the process, LinkError when it cannot be opened.
    """
    url = parse_link(link)
    if url.is_within_process:
        raise BadInputError(f"link {link!r} reaches nothing outside this process; name a port or a bus")
    names = [driver] if driver is not None else driver_names()
    candidates = [one for name in names if (one := _candidate(name, link)) is not None]
    if not candidates:
        raise BadInputError(
            f"{driver!r} cannot be looked for over {link!r}; see its wires in DRIVERS.md, and fd=1 for CAN FD"
        )
    result = Result()
    look = _probe_bus if url.is_bus else _probe_port
    look(candidates, driver is not None, result, say)
    return result


def _candidate(name: str, link: str) -> _Candidate | None:
    """Return a driver as a candidate; None when its controllers cannot be on such a link, or it has no probe."""
    if name == OUR_DRIVER:
        return _Candidate(name, "our own firmware", _OurProbe(), WHEEL_DBC.make_framing, parse_link(link))
    made = dialect(name)
    url = parse_link(link, baud=made.baud or DEFAULT_BAUD)
    make_probe = made.serial_probe if url.wire == "serial" and made.serial_probe is not None else made.probe
    if make_probe is None or url.wire not in made.wires:
        return None
    return _Candidate(name, made.title, make_probe(), made.make_framing, url)


def _probe_bus(candidates: Sequence[_Candidate], is_chosen: bool, result: Result, say: Callable[[str], None]) -> None:
    with contextlib.closing(candidates[0].url.open_host(protocol=LinkProtocol())) as link:
        say(f"listening for {_LISTEN_S:g} s")
        counts = _listen(link, candidates, lambda: _LISTEN_S)
        for one in _to_query(candidates, is_silent=is_chosen or not counts):
            _query(link, one, say)
            if one.driver == OUR_DRIVER and one.probe.found() is not None:
                candidates = [one]  # its frames may look like those of others
                break
    for one in candidates:
        if _add(result, one):
            for number in one.claimed:
                counts.pop(number, None)
    result.strangers = counts
    if counts and not result.answers and not is_chosen:
        result.not_queried = _why_not_queried(f"{counts.total()} frames")


def _probe_port(candidates: Sequence[_Candidate], is_chosen: bool, result: Result, say: Callable[[str], None]) -> None:
    """Listen in each framing and at each baud rate until one is understood; send nothing before that."""
    came = 0
    for one in candidates:
        say(f"listening for {one.title} on {one.url}")
        with _line(one) as link:
            _listen(link, [one], lambda: _LISTEN_S)
            came += link.received_bytes
        if one.claimed:
            break
    for one in _to_query(candidates, is_silent=is_chosen or not came):
        with _line(one) as link:
            _query(link, one, say)
        if _add(result, one):
            return
    if came and not is_chosen:
        result.not_queried = _why_not_queried(f"{came} bytes")


def _line(one: _Candidate) -> contextlib.closing[StreamLink]:
    link = one.url.open_host(protocol=LinkProtocol(one.make_framing))
    assert isinstance(link, StreamLink)
    return contextlib.closing(link)


def _to_query(candidates: Sequence[_Candidate], *, is_silent: bool) -> Sequence[_Candidate]:
    """Return the candidates to query: our firmware if it may be there, and the makers that were heard.

    If none was identified, those that may be there; if there are none of those either, all on a silent line. A maker
    that only may be there is not queried where another was identified: its ids are equal by chance.
    """
    ours = [one for one in candidates if one.driver == OUR_DRIVER and one.claimed]
    makers = [one for one in candidates if one.driver != OUR_DRIVER]
    speak = [one for one in makers if one.probe.found() is not None] or [one for one in makers if one.claimed]
    return [*ours, *speak] or (candidates if is_silent else ())


def _why_not_queried(what: str) -> str:
    return (
        f"{what} came of unknown senders, so no motor controller was queried: a query in one protocol may be a command "
        "in another; name the one to query with --driver"
    )


def _query(link: Link, one: _Candidate, say: Callable[[str], None]) -> None:
    """Query a candidate, in rounds: the next query may depend on the answers."""
    say(f"asking for {one.title}")
    for _ in range(_ROUNDS):
        frames = one.probe.ask()
        if not frames:
            return
        for frame in frames:
            link.send(frame)
        _listen(link, [one], lambda: one.probe.patience_s)


def _listen(link: Link, candidates: Iterable[_Candidate], patience_s: Callable[[], float]) -> Counter[int]:
    """Feed received frames to the candidates until ``patience_s`` is over; return the number of frames by id."""
    candidates, counts = list(candidates), Counter[int]()
    begin_ns = time.monotonic_ns()
    while (left_ns := begin_ns + round(patience_s() * 1e9) - time.monotonic_ns()) > 0:
        if (received := link.receive(left_ns)) is not None:
            for frame in received.frames:
                counts[frame.id] += 1
                for one in candidates:
                    if one.probe.feed(frame):
                        one.claimed.add(frame.id)
    return counts


def _add(result: Result, one: _Candidate) -> bool:
    found = one.probe.found()
    if found is not None:
        result.answers.append(Answer(one.driver, str(one.url), found))
    return found is not None
