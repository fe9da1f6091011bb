"""A mutant: a known defect of the robot, the link, or a part of a tick; and the changes of frames on a link."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, NamedTuple

from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages
from hil.addons.verify.mutation import wrappers
from hil.addons.verify.mutation.change import Change
from hil.core.ports import Link, Received
from hil.plant.description import start_defaults
from hil.robot.virtual import MakeNode, MakeRobot, VirtualRobot, VirtualStm32
from hil.runtime.run_options import RunOptions
from hil.runtime.tick import TickParts
from hil.scenario import Scenario
from hil.scenario.laws import make_laws

MODEL, GAINS = "model", "gains"
_NOT_CHANGES = ("port", "of")


def moved(value: Any, change: Any) -> Any:
    """Return a value after a change: "*1.2" is a factor, "+0.1" and "-0.1" are added, all else replaces it."""
    if not (isinstance(change, str) and change[:1] in "*+-"):
        return change
    return float(value) * float(change[1:]) if change[0] == "*" else float(value) + float(change)


class Mutant(NamedTuple):
    """A known defect. It is the instrument of the runs in which it is (``hil.runtime.run_options.Instrument``).

    Attributes:
        id: its name in the catalogue.
        start: changes of the FMU's start values, by name: a number, a text, or "*1.2", "+0.1" or "-0.1".
        wrap: which part of the run is wrapped, and how; empty for none.
    """

    id: str
    start: Mapping[str, Any] = {}
    wrap: Mapping[str, Any] = {}

    def to_text(self) -> str:
        """Return it as JSON, which ``from_text`` reads."""
        return json.dumps(self._asdict(), sort_keys=True)

    @property
    def _port(self) -> str:
        return str(self.wrap.get("port"))

    @property
    def properties(self) -> dict[str, str]:
        return {"mutant": self.id, "mutant_sha256": hashlib.sha256(self.to_text().encode()).hexdigest()}

    def put_into(self, options: RunOptions) -> RunOptions:
        """Return the options of a run that has the mutant."""
        return replace(options, make_robot=self._robot(options.make_robot), instrument=self)

    def _robot(self, make_robot: MakeRobot) -> MakeRobot:
        def make(made_of: VirtualRobot, make_node: MakeNode) -> AbstractContextManager[VirtualStm32]:
            node = wrappers.changed_node(make_node, self.wrap) if self._port == "plant" else make_node
            return make_robot(self._made_of(made_of), node)

        return make

    def _made_of(self, made_of: VirtualRobot) -> VirtualRobot:
        """Return a robot's configuration with the mutant's start values; values that an FMU lacks are left out."""
        if not self.start:
            return made_of
        plant = made_of.plant
        defaults = start_defaults(plant.fmu)
        known = {name: change for name, change in self.start.items() if name in defaults}
        now = {name: moved(plant.start.get(name, defaults[name]), change) for name, change in known.items()}
        return made_of._replace(plant=plant._replace(start={**plant.start, **now}))

    def link(self, link: Link) -> Link:
        return ChangedLink(link, self.wrap) if self._port == "link" else link

    def parts(self, scenario: Scenario, parts: TickParts) -> TickParts:
        if self._port not in wrappers.PORTS:
            return parts
        of, port = self.wrap["of"], wrappers.PORTS[self._port]
        if self._port == "law" and of in (MODEL, GAINS):
            changed = _with_other_law(scenario, of, _changes(self.wrap))
            return parts._replace(controller=make_laws(changed, scenario.directory).controller)
        part = getattr(parts, port.attribute)
        if part is None:
            return parts
        wrapped = port.wrapper(part, of, Change(port.of[of], _changes(self.wrap)))
        return parts._replace(**{port.attribute: wrapped})


def from_text(text: str) -> Mutant:
    """Return the mutant that ``to_text`` gave."""
    return Mutant(**json.loads(text))


def _changes(wrap: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in wrap.items() if name not in _NOT_CHANGES}


def _with_other_law(scenario: Scenario, of: str, changes: Mapping[str, Any]) -> Scenario:
    """Return the scenario with which the law is made: its model of the robot, or its options, are changed.

    An option that this law does not have is left out.
    """
    if of == MODEL:
        model = scenario.robot
        now = {name: moved(getattr(model, name), change) for name, change in changes.items()}
        return replace(scenario, robot=replace(model, **now))
    from hil.laws.law_registry import gains_in_force

    table = scenario.controller
    there = gains_in_force(table.law, scenario.directory, table.gains)
    now = {name: moved(there[name], change) for name, change in changes.items() if name in there}
    return replace(scenario, controller=replace(table, gains={**table.gains, **now}))


IDS: Mapping[str, int] = {name: value.ID for name, value in vars(messages).items() if hasattr(value, "LENGTH")}
"""The identifiers of our protocol's messages, by the names of their classes."""
_Flow = Callable[[int, int, Frame, list[Frame]], Iterator[Frame]]
"""Changes the frames of one direction: given the size of the change, the frame's number from 1, it, and those kept."""


def _lose(every: int, number: int, frame: Frame, _kept: list[Frame]) -> Iterator[Frame]:
    """Lose one in so many frames."""
    if number % every:
        yield frame


def _repeat(every: int, number: int, frame: Frame, _kept: list[Frame]) -> Iterator[Frame]:
    """Pass one in so many frames twice."""
    yield frame
    if number % every == 0:
        yield frame


def _late(frames: int, _number: int, frame: Frame, kept: list[Frame]) -> Iterator[Frame]:
    """Pass each frame when the one so many after it comes."""
    kept.append(frame)
    if len(kept) > frames:
        yield kept.pop(0)


def _swap(every: int, number: int, frame: Frame, kept: list[Frame]) -> Iterator[Frame]:
    """Hold one in so many frames until the next one has passed."""
    if number % every == 0 and not kept:
        kept.append(frame)
        return
    yield frame
    yield from kept
    kept.clear()


def _flip(bit: int, _number: int, frame: Frame, _kept: list[Frame]) -> Iterator[Frame]:
    """Invert a bit of the payload, 0 to 63, in every frame."""
    payload = bytearray(frame.payload)
    if bit // 8 < len(payload):
        payload[bit // 8] ^= 1 << bit % 8
    yield frame._replace(payload=bytes(payload))


def _stale(every: int, number: int, frame: Frame, kept: list[Frame]) -> Iterator[Frame]:
    """Pass one in so many frames with the payload of the frame before it."""
    yield frame._replace(payload=kept[0].payload) if number % every == 0 and kept else frame
    kept[:] = [frame]


FLOWS: Mapping[str, _Flow] = {
    "lose": _lose, "repeat": _repeat, "late": _late, "swap": _swap, "flip": _flip, "stale": _stale,
}  # fmt: skip
"""The changes of a stream of frames by name; their size is a whole number."""


class ChangedLink:
    """A link on which frames of one direction are changed: those of a message ``id``.

    ``options``: ``of`` (``sent`` or ``received``), ``id`` and one of ``FLOWS``.
    """

    def __init__(self, link: Link, options: Mapping[str, Any]) -> None:
        [(change, self._size)] = [one for one in options.items() if one[0] not in ("port", "of", "id")]
        self._link = link
        self._id = IDS[options["id"]]
        self._flow = FLOWS[change]
        self._is_sent = options["of"] == "sent"
        self._number = 0
        self._kept: list[Frame] = []

    def _changed(self, frame: Frame) -> Iterator[Frame]:
        if frame.id != self._id:
            return iter((frame,))
        self._number += 1
        return self._flow(self._size, self._number, frame, self._kept)

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
