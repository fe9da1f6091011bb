"""The messages that the controllers send: their newest values, and the quantities and conditions from them."""

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

from hil.core.types import NAN
from hil.drivers.dbc.coding import Reading, Unpacker
from hil.drivers.dbc.file import Message, Signal
from hil.drivers.dbc.mapping import Condition, ErrorSignal
from hil.drivers.dbc.robot import Gain
from hil.drivers.dbc.settings import Plan
from hil.drivers.port import holds_back


class ReceivedMessage:
    """One message: its newest values, NaN before the first, and their stamp.

    ``late_ns``: time after which the values are too old; None if they are valid until the next ones.
    """

    def __init__(self, message: Message, late_ns: int | None) -> None:
        self.message = message
        self.late_ns = late_ns
        self.stamp_ns: int | None = None
        self.values: list[float] = []
        self.turns: list[_Turns] = []
        self._readings: list[Reading] = []
        self._unpacker = Unpacker(message, ())

    def read(self, reading: Reading) -> "Place":
        """Add a signal to read, and return the place of its value."""
        self._readings.append(reading)
        self.values.append(NAN)
        self._unpacker = Unpacker(self.message, self._readings)
        return Place(self, len(self.values) - 1)

    def is_silent(self, now_ns: int) -> bool:
        """Return whether the message came at least once, and its values are too old now."""
        return self.late_ns is not None and self.stamp_ns is not None and now_ns - self.stamp_ns > self.late_ns

    def feed(self, payload: bytes, stamp_ns: int) -> None:
        """Take a payload. It changes nothing if it is too short or has a value that is not finite."""
        values = self._unpacker.values(payload)
        if values is None:
            return
        self.values, self.stamp_ns = values, stamp_ns
        for one in self.turns:
            one.follow(stamp_ns)


class Place(NamedTuple):
    """The place of a value: its message, and its index in ``values``."""

    source: ReceivedMessage
    number: int

    @property
    def value(self) -> float:
        """The newest value, NaN before the first."""
        return self.source.values[self.number]


class _Turns:
    """Unwraps a position whose signal wraps after ``span``.

    Between two frames a motor may turn more than half a span; the number of wraps follows from its ``speed``, if known.
    """

    def __init__(self, position: Place, speed: Place | None, span: float) -> None:
        self._position, self._speed = position, speed
        self._span = span
        self._last: tuple[int, float, float] | None = None
        self._turned = 0.0

    def follow(self, stamp_ns: int) -> None:
        value = self._position.value
        speed = NAN if self._speed is None else self._speed.value
        if self._last is not None:
            last_ns, last, last_speed = self._last
            expected = 0.5 * (speed + last_speed) * (stamp_ns - last_ns) * 1e-9
            if math.isnan(expected):
                expected = 0.0
            self._turned += self._span * round((expected - (value - last)) / self._span)
        self._last = stamp_ns, value, speed
        self._position.source.values[self._position.number] = value + self._turned


class Received:
    """All messages of a mapping that the controllers send. ``stamp_ns`` has the age of speeds and positions."""

    def __init__(self, plan: Plan, gain: Gain) -> None:
        self._messages = {
            name: ReceivedMessage(message, plan.late_ns(message)) for name, message in plan.received().items()
        }
        self._by_id = {one.message.id: one for one in self._messages.values()}
        self._now_ns = 0  # stamp of the newest frame
        self._quantities: Mapping[str, Sequence[Place]] = {
            name: [self._place(bound.signal, gain(bound)) for bound in quantity.bounds]
            for name, quantity in plan.feedback.items()
        }
        if positions := plan.feedback.get("position"):
            speeds = self._quantities.get("speed", [None] * 4)
            for bound, place, speed in zip(positions.bounds, self._quantities["position"], speeds, strict=True):
                if span := abs(gain(bound)) * (positions.wraps_at or _span(bound.signal)):
                    place.source.turns.append(_Turns(place, speed, span))
        self._armed_when = [(self._place(one.signal), one) for one in plan.armed_when]
        self._identity = [(self._place(one.signal), one) for one in plan.identity]
        self._errors = [(self._place(one.signal), one) for one in plan.errors]
        watched = _sources([place for place, _ in chain(self._armed_when, self._errors)])
        self._watched = [(one, one.late_ns) for one in watched if one.late_ns is not None]
        self._sound: dict[int, list[tuple[int, Collection[float]]]] = {one.message.id: [] for one in watched}
        for place, sound in chain(
            ((place, condition.raws) for place, condition in self._armed_when),
            ((place, error.none) for place, error in self._errors),
        ):
            self._sound[place.source.message.id].append((place.number, sound))
        read = plan.watchdog.read
        self._watchdog = None if read is None else self._place(read.signal, gain(read))
        self._measured = _sources(self._quantities[plan.measured])
        self._positions = [one for one in _sources(self._quantities.get("position", ())) if one not in self._measured]

    def feed(self, identifier: int, payload: bytes, stamp_ns: int) -> bool:
        """Take a frame's payload. Return False if its message reports an error or a state that ``armed_when`` excludes.

        A frame that belongs to no message of the mapping changes nothing.
        """
        source = self._by_id.get(identifier)
        if source is None:
            return True
        self._now_ns = max(self._now_ns, stamp_ns)
        source.feed(payload, stamp_ns)
        if source.stamp_ns is None:
            return True  # it was none, and there is nothing yet
        return all(source.values[index] in sound for index, sound in self._sound.get(identifier, ()))

    def _place(self, signal: Signal, gain: float | None = None) -> Place:
        """Add a signal to read. Without a gain its raw value is read, which conditions compare exactly."""
        source = self._messages[signal.message]
        if gain is None:
            return source.read(Reading(signal))
        return source.read(Reading(signal, gain * signal.factor, gain * signal.offset))

    def quantity(self, name: str) -> Sequence[float] | None:
        """Return the newest values of a quantity [SI], NaN for what did not come, or is too old; None if not mapped."""
        places = self._quantities.get(name)
        if places is None:
            return None
        if name == "position":  # kept for odometry; if the positions no longer come, stamp_ns stands still
            return [place.value for place in places]
        now_ns = self._now_ns
        return [NAN if source.is_silent(now_ns) else source.values[index] for source, index in places]

    def stamp_ns(self) -> int | None:
        """Return the stamp of the oldest message with speeds; None until all speeds and positions have come.

        It stands still when the positions no longer come.
        """
        oldest: int | None = None
        for source in self._measured:
            stamp_ns = source.stamp_ns
            if stamp_ns is None:
                return None
            if oldest is None or stamp_ns < oldest:
                oldest = stamp_ns
        for source in self._positions:
            if oldest is None or source.stamp_ns is None:
                return None
            if source.late_ns is not None:
                oldest = holds_back(oldest, source.stamp_ns, source.late_ns)
        return oldest

    def missing(self) -> list[Message]:
        """Return the messages that the driver needs and that have not come yet."""
        needed = [place.source for place, _ in chain(self._armed_when, self._identity)]
        needed += [place.source for place, _ in self._errors if place.source.late_ns is not None]
        needed += self._measured + self._positions
        return list({source.message.name: source.message for source in needed if source.stamp_ns is None}.values())

    def silent(self) -> list[tuple[Message, float]]:
        """Return the messages with states and errors that are too old, each with its limit of age [s]."""
        now_ns = self._now_ns
        return [(one.message, late_ns * 1e-9) for one, late_ns in self._watched if one.is_silent(now_ns)]

    def follows(self) -> bool:
        """Return whether all conditions of [device.motors.armed_when] are met by values that are not too old."""
        now_ns = self._now_ns
        return all(
            place.value in condition.raws and not place.source.is_silent(now_ns)
            for place, condition in self._armed_when
        )

    def identity(self) -> list[tuple[Condition, float]]:
        """Return the conditions that identify the device, with the raw values received."""
        return [(condition, place.value) for place, condition in self._identity]

    def errors(self) -> list[tuple[ErrorSignal, float]]:
        """Return the reported errors with their raw values."""
        return [
            (error, place.value)
            for place, error in self._errors
            if place.source.stamp_ns is not None and place.value not in error.none
        ]

    def watchdog_s(self, since_ns: int) -> float:
        """Return the watchdog's time [s] as read back after ``since_ns``; NaN if it did not come or is too old."""
        place = self._watchdog
        if place is None or place.source.stamp_ns is None or place.source.stamp_ns <= since_ns:
            return NAN
        return NAN if place.source.is_silent(self._now_ns) else place.value


def _sources(places: Sequence[Place]) -> list[ReceivedMessage]:
    """Return the messages of these places, each once."""
    return list({place.source.message.id: place.source for place in places}.values())


def _span(signal: Signal) -> float:
    """Return the span after which a position wraps, in the signal's unit; 0 for floats, which do not wrap."""
    return 0.0 if signal.is_float else abs(signal.factor) * (signal.high - signal.low + 1)
