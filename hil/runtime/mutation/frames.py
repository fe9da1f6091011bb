"""Changes of the frames on a link, in one direction: lost, repeated, late, out of order, damaged or held ones."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages
from hil.core.errors import nearest
from hil.core.ports import Link, Received

WAYS = ("sent", "received")
IDS: Mapping[str, int] = {name: value.ID for name, value in vars(messages).items() if hasattr(value, "LENGTH")}
"""The identifiers of our protocol's messages, by the names of their classes; other identifiers are given as numbers."""
_Flow = Callable[[Frame], Iterator[Frame]]


def _lose(every: int) -> _Flow:
    """Lose one in so many frames."""
    count = 0

    def flow(frame: Frame) -> Iterator[Frame]:
        nonlocal count
        count += 1
        if count % every:
            yield frame

    return flow


def _repeat(every: int) -> _Flow:
    """Pass one in so many frames twice."""
    count = 0

    def flow(frame: Frame) -> Iterator[Frame]:
        nonlocal count
        count += 1
        yield frame
        if count % every == 0:
            yield frame

    return flow


def _late(frames: int) -> _Flow:
    """Pass each frame when the one so many after it comes."""
    held: list[Frame] = []

    def flow(frame: Frame) -> Iterator[Frame]:
        held.append(frame)
        if len(held) > frames:
            yield held.pop(0)

    return flow


def _swap(every: int) -> _Flow:
    """Hold one in so many frames until the next one has passed."""
    count, held = 0, list[Frame]()

    def flow(frame: Frame) -> Iterator[Frame]:
        nonlocal count
        count += 1
        if count % every == 0 and not held:
            held.append(frame)
            return
        yield frame
        yield from held
        held.clear()

    return flow


def _flip(bit: int) -> _Flow:
    """Invert a bit of the payload, 0 to 63, in every frame."""

    def flow(frame: Frame) -> Iterator[Frame]:
        payload = bytearray(frame.payload)
        if bit // 8 < len(payload):
            payload[bit // 8] ^= 1 << bit % 8
        yield frame._replace(payload=bytes(payload))

    return flow


def _stale(every: int) -> _Flow:
    """Pass one in so many frames with the payload of the frame before it."""
    count, last = 0, b""

    def flow(frame: Frame) -> Iterator[Frame]:
        nonlocal count, last
        count += 1
        yield frame._replace(payload=last) if count % every == 0 and last else frame
        last = frame.payload

    return flow


FLOWS: Mapping[str, Callable[[int], _Flow]] = {
    "lose": _lose, "repeat": _repeat, "late": _late, "swap": _swap, "flip": _flip, "stale": _stale,
}  # fmt: skip
"""The changes of a stream of frames by name, each made of a whole number."""


class ChangedLink:
    """A link on which frames of one direction are changed: those of a message ``id``, or all with an identifier.

    ``options``: ``of``, ``id`` and one of ``FLOWS``. Raises ValueError for any other.
    """

    def __init__(self, link: Link, options: Mapping[str, Any]) -> None:
        given = {name: value for name, value in options.items() if name not in ("port", "of", "id")}
        if len(given) != 1 or not given.keys() <= FLOWS.keys():
            raise ValueError(f"{sorted(given)}: expected one of {', '.join(FLOWS)}")
        name: Any = options.get("id")
        if name not in IDS and not isinstance(name, int):
            raise ValueError(f"id {name!r}: expected a number, or the name of a message{nearest(str(name), IDS)}")
        [(change, size)] = given.items()
        self._link = link
        self._id = IDS.get(name, name)
        self._flow = FLOWS[change](int(size))
        self._is_sent = options["of"] == "sent"

    def _changed(self, frame: Frame) -> Iterator[Frame]:
        return self._flow(frame) if frame.id == self._id else iter((frame,))

    def send(self, frame: Frame) -> None:
        """Send what becomes of a frame."""
        for one in self._changed(frame) if self._is_sent else (frame,):
            self._link.send(one)

    def receive(self, timeout_ns: int) -> Received | None:
        """Return what becomes of the frames that have arrived; None also when nothing is left of them."""
        received = self._link.receive(timeout_ns)
        if received is None or self._is_sent:
            return received
        frames = [one for frame in received.frames for one in self._changed(frame)]
        return received._replace(frames=frames) if frames else self.receive(0)

    def rejected(self) -> dict[str, int]:
        """Return what the link has dropped."""
        return self._link.rejected()

    def reopen(self) -> None:
        """Reopen the link."""
        self._link.reopen()

    def describe(self) -> str:
        """Return a description of the link."""
        return self._link.describe()

    def close(self) -> None:
        """Close the link."""
        self._link.close()
