"""What the controllers say: the messages of a mapping as they arrive, and quantities and conditions from them."""

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


class Hearing:
    """One message: its newest values, NaN before the first, and when they came.

    ``late_ns`` is after how long they count no more, None where they hold until the next.
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
        """Have a signal read, and return where its value will be."""
        self._readings.append(reading)
        self.values.append(NAN)
        self._unpacker = Unpacker(self.message, self._readings)
        return Place(self, len(self.values) - 1)

    def is_silent(self, now_ns: int) -> bool:
        """Tell whether it has come, and then no more for too long."""
        return self.late_ns is not None and self.stamp_ns is not None and now_ns - self.stamp_ns > self.late_ns

    def feed(self, payload: bytes, stamp_ns: int) -> None:
        """Take a payload; one that is too short, or has an infinite number or none, changes nothing."""
        values = self._unpacker.values(payload)
        if values is None:
            return
        self.values, self.stamp_ns = values, stamp_ns
        for one in self.turns:
            one.follow(stamp_ns)


class Place(NamedTuple):
    """Where a value is."""

    hearing: Hearing
    number: int

    @property
    def value(self) -> float:
        """The newest, NaN before there is one."""
        return self.hearing.values[self.number]


class _Turns:
    """Makes a position go on where its signal wraps after ``span``.

    Between two frames a motor may turn more than half a span: its ``speed``, where it is told, says how often.
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
        self._position.hearing.values[self._position.number] = value + self._turned


class Heard:
    """All messages of a mapping that the controllers send. Speeds and positions are as old as ``stamp_ns`` says."""

    def __init__(self, plan: Plan, gain: Gain) -> None:
        self._messages = {name: Hearing(message, plan.late_ns(message)) for name, message in plan.heard().items()}
        self._by_id = {one.message.id: one for one in self._messages.values()}
        self._now_ns = 0  # as far as is known: when the newest of them came
        self._quantities: Mapping[str, Sequence[Place]] = {
            name: [self._place(bound.signal, gain(bound)) for bound in quantity.bounds]
            for name, quantity in plan.feedback.items()
        }
        if positions := plan.feedback.get("position"):
            speeds = self._quantities.get("speed", [None] * 4)
            for bound, place, speed in zip(positions.bounds, self._quantities["position"], speeds, strict=True):
                if span := abs(gain(bound)) * (positions.wraps_at or _span(bound.signal)):
                    place.hearing.turns.append(_Turns(place, speed, span))
        self._armed_when = [(self._place(one.signal), one) for one in plan.armed_when]
        self._identity = [(self._place(one.signal), one) for one in plan.identity]
        self._errors = [(self._place(one.signal), one) for one in plan.errors]
        watched = _hearings([place for place, _ in chain(self._armed_when, self._errors)])
        self._watched = [(one, one.late_ns) for one in watched if one.late_ns is not None]
        self._sound: dict[int, list[tuple[int, Collection[float]]]] = {one.message.id: [] for one in watched}
        for place, sound in chain(
            ((place, condition.raws) for place, condition in self._armed_when),
            ((place, error.none) for place, error in self._errors),
        ):
            self._sound[place.hearing.message.id].append((place.number, sound))
        read = plan.watchdog.read
        self._watchdog = None if read is None else self._place(read.signal, gain(read))
        self._measured = _hearings(self._quantities[plan.measured])
        self._positions = [one for one in _hearings(self._quantities.get("position", ())) if one not in self._measured]

    def feed(self, identifier: int, payload: bytes, stamp_ns: int) -> bool:
        """Take a frame's payload, and tell whether it is well; it is not with an error, or a state not to be armed in.

        One of no message of the mapping changes nothing.
        """
        hearing = self._by_id.get(identifier)
        if hearing is None:
            return True
        self._now_ns = max(self._now_ns, stamp_ns)
        hearing.feed(payload, stamp_ns)
        if hearing.stamp_ns is None:
            return True  # it was none, and there is nothing yet
        return all(hearing.values[index] in sound for index, sound in self._sound.get(identifier, ()))

    def _place(self, signal: Signal, gain: float | None = None) -> Place:
        """Have a signal read, raw without a gain: what is compared must not be rounded."""
        hearing = self._messages[signal.message]
        if gain is None:
            return hearing.read(Reading(signal))
        return hearing.read(Reading(signal, gain * signal.factor, gain * signal.offset))

    def quantity(self, name: str) -> Sequence[float] | None:
        """Return the newest values of a quantity [SI], NaN for what did not come, or is too old; None if not mapped."""
        places = self._quantities.get(name)
        if places is None:
            return None
        if name == "position":  # odometry counts on from it: where it stands still, stamp_ns does
            return [place.value for place in places]
        now_ns = self._now_ns
        return [NAN if hearing.is_silent(now_ns) else hearing.values[index] for hearing, index in places]

    def stamp_ns(self) -> int | None:
        """Return when the oldest of the messages that carry the speeds came, None before all and the positions have.

        It goes on no longer when a position has fallen silent.
        """
        oldest: int | None = None
        for hearing in self._measured:
            stamp_ns = hearing.stamp_ns
            if stamp_ns is None:
                return None
            if oldest is None or stamp_ns < oldest:
                oldest = stamp_ns
        for hearing in self._positions:
            if oldest is None or hearing.stamp_ns is None:
                return None
            if hearing.late_ns is not None:
                oldest = holds_back(oldest, hearing.stamp_ns, hearing.late_ns)
        return oldest

    def missing(self) -> list[Message]:
        """Return the messages that the driver cannot do without, and that did not come yet."""
        needed = [place.hearing for place, _ in chain(self._armed_when, self._identity)]
        needed += [place.hearing for place, _ in self._errors if place.hearing.late_ns is not None]
        needed += self._measured + self._positions
        return list({hearing.message.name: hearing.message for hearing in needed if hearing.stamp_ns is None}.values())

    def silent(self) -> list[tuple[Message, float]]:
        """Return the messages of states and errors that came once, and no more for a time [s], while others did."""
        now_ns = self._now_ns
        return [(one.message, late_ns * 1e-9) for one, late_ns in self._watched if one.is_silent(now_ns)]

    def follows(self) -> bool:
        """Tell whether all that [device.motors.armed_when] asks for is so, as far as was said of late."""
        now_ns = self._now_ns
        return all(
            place.value in condition.raws and not place.hearing.is_silent(now_ns)
            for place, condition in self._armed_when
        )

    def identity(self) -> list[tuple[Condition, float]]:
        """Return what identifies the device, with the raw values that came."""
        return [(condition, place.value) for place, condition in self._identity]

    def errors(self) -> list[tuple[ErrorSignal, float]]:
        """Return the errors that are reported, with their raw values."""
        return [
            (error, place.value)
            for place, error in self._errors
            if place.hearing.stamp_ns is not None and place.value not in error.none
        ]

    def watchdog_s(self, since_ns: int) -> float:
        """Return the time that the watchdog was read back with; NaN where that was not after an instant, or of late."""
        place = self._watchdog
        if place is None or place.hearing.stamp_ns is None or place.hearing.stamp_ns <= since_ns:
            return NAN
        return NAN if place.hearing.is_silent(self._now_ns) else place.value


def _hearings(places: Sequence[Place]) -> list[Hearing]:
    """Return the messages of these places, each once."""
    return list({place.hearing.message.id: place.hearing for place in places}.values())


def _span(signal: Signal) -> float:
    """Return after how much a position begins anew, in the signal's unit: beyond its highest number is its lowest."""
    return 0.0 if signal.is_float else abs(signal.factor) * (signal.high - signal.low + 1)
