"""What the controllers say: the messages of a mapping as they arrive, and quantities and conditions from them."""

import math
from collections.abc import Mapping, Sequence
from itertools import chain

from hil.dialects.dbc.coding import Reading, Unpacker
from hil.dialects.dbc.file import Message, Signal
from hil.dialects.dbc.mapping import Condition, ErrorSignal, Quantity
from hil.dialects.dbc.robot import Gain
from hil.dialects.dbc.settings import Plan
from hil.types import NAN


class _Turns:
    """Makes one value of a list go on where the signal wraps, each frame by the shorter way."""

    def __init__(self, place: int, span: float) -> None:
        self.place = place
        self._span = span
        self._last: float | None = None
        self._turned = 0.0

    def follow(self, values: list[float]) -> None:
        value = values[self.place]
        if self._last is not None:
            self._turned -= self._span * round((value - self._last) / self._span)
        self._last = value
        values[self.place] = value + self._turned


class Hearing:
    """One message: its newest values, NaN before the first, and when they came."""

    def __init__(self, message: Message, readings: Sequence[Reading], turns: Sequence[_Turns]) -> None:
        self.message = message
        self.stamp_ns: int | None = None
        self.values: list[float] = [NAN] * len(readings)
        self._unpacker = Unpacker(message, readings)
        self._turns = turns

    def feed(self, payload: bytes, stamp_ns: int) -> None:
        """Take a payload; one that is too short, or has an infinite number or none, changes nothing."""
        values = self._unpacker.values(payload)
        if values is None:
            return
        for one in self._turns:
            one.follow(values)
        self.values, self.stamp_ns = values, stamp_ns


Place = tuple[Hearing, int]


class Heard:
    """All messages of a mapping that the controllers send."""

    def __init__(self, plan: Plan, gain: Gain) -> None:
        self._plan = plan
        readings: dict[str, list[Reading]] = {name: [] for name in plan.heard()}
        turns: dict[str, list[_Turns]] = {name: [] for name in readings}

        def place(signal: Signal, factor: float | None) -> tuple[str, int]:
            mine = readings[signal.message]
            # Raw for what is compared, which a rounding must not touch.
            mine.append(
                Reading(signal) if factor is None else Reading(signal, factor * signal.factor, factor * signal.offset)
            )
            return signal.message, len(mine) - 1

        def quantity(given: Quantity, *, turning: bool) -> list[tuple[str, int]]:
            places = []
            for bound in given.bounds:
                factor = gain(bound)
                at = place(bound.signal, factor)
                places.append(at)
                if turning and (span := abs(factor) * (given.wraps_at or _span(bound.signal))):
                    turns[at[0]].append(_Turns(at[1], span))
            return places

        quantities = {name: quantity(given, turning=name == "position") for name, given in plan.feedback.items()}
        signals = [one.signal for one in (*plan.armed_when, *plan.identity)] + [one.signal for one in plan.errors]
        raws = [place(signal, None) for signal in signals]
        watchdog = plan.watchdog.read
        read = None if watchdog is None else place(watchdog.signal, gain(watchdog))

        self._messages = {name: Hearing(message, readings[name], turns[name]) for name, message in plan.heard().items()}
        self.by_id = {one.message.id: one for one in self._messages.values()}

        def there(at: tuple[str, int]) -> Place:
            return self._messages[at[0]], at[1]

        self._quantities: Mapping[str, Sequence[Place]] = {
            name: [there(at) for at in places] for name, places in quantities.items()
        }
        found = iter(map(there, raws))
        self._armed_when = [(next(found), one) for one in plan.armed_when]
        self._identity = [(next(found), one) for one in plan.identity]
        self._errors = [(next(found), one) for one in plan.errors]
        self._watchdog = None if read is None else there(read)
        self._measured = list({id(hearing): hearing for hearing, _ in self._quantities[plan.measured]}.values())

    def quantity(self, name: str) -> Sequence[float] | None:
        """Return the newest values of a quantity [SI], NaN for what did not come yet; None where it is not mapped."""
        places = self._quantities.get(name)
        return None if places is None else [hearing.values[place] for hearing, place in places]

    def stamp_ns(self) -> int | None:
        """Return when the oldest of the messages that carry the speeds came, None before all have."""
        oldest: int | None = None
        for hearing in self._measured:
            stamp_ns = hearing.stamp_ns
            if stamp_ns is None:
                return None
            if oldest is None or stamp_ns < oldest:
                oldest = stamp_ns
        return oldest

    def silent(self) -> list[Message]:
        """Return the messages that the driver cannot do without, and that did not come yet."""
        needed = [hearing for (hearing, _), _ in chain(self._armed_when, self._identity)] + self._measured
        return list({hearing.message.name: hearing.message for hearing in needed if hearing.stamp_ns is None}.values())

    def follows(self) -> bool:
        """Tell whether all that [device.motors.armed_when] asks for is so."""
        return all(hearing.values[place] in condition.raws for (hearing, place), condition in self._armed_when)

    def identity(self) -> list[tuple[Condition, float]]:
        """Return what identifies the device, with the raw values that came."""
        return [(condition, hearing.values[place]) for (hearing, place), condition in self._identity]

    def errors(self) -> list[tuple[ErrorSignal, float]]:
        """Return the errors that are reported, with their raw values."""
        return [
            (error, hearing.values[place])
            for (hearing, place), error in self._errors
            if hearing.stamp_ns is not None and hearing.values[place] not in error.none
        ]

    def watchdog_s(self) -> float:
        """Return the time that the watchdog was read back with, NaN before it was."""
        if self._watchdog is None:
            return math.nan
        hearing, place = self._watchdog
        return hearing.values[place]


def _span(signal: Signal) -> float:
    """Return after how much a position begins anew, in the signal's unit: beyond its highest number is its lowest."""
    return 0.0 if signal.is_float else abs(signal.factor) * (signal.high - signal.low + 1)
