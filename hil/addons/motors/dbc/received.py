"""The messages that the controllers send: their newest values, and the quantities and conditions from them."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from firmware_protocol.framing import Frame
from hil.addons.motors.dbc.dbc_file import Message, Signal
from hil.addons.motors.dbc.dbc_settings import Gain, Plan
from hil.addons.motors.driver_parts import holds_back, oldest
from hil.core.errors import BadInputError
from hil.core.types import NAN

_PERIOD = "its period is GenMsgCycleTime in the DBC"
_NO_PERIOD = "the DBC gives it no period: add GenMsgCycleTime, a long one if it is sent on changes alone"


class _Source:
    """One message that is received.

    Attributes:
        late_ns: age after which its values are too old; None if they are valid until the next ones.
        stamp_ns: when the newest values arrived; None before the first.
        raws: the newest raw values of its signals, empty before the first.
        floats: the names of its floating-point signals that are read. A frame with one that is not finite is ignored.
        good: name and good raw values of each signal that reports an error, or a state of ``armed_when``.
        positions: its positions that wrap.
    """

    def __init__(self, message: Message, late_ns: int | None) -> None:
        self.message = message
        self.late_ns = late_ns
        self.stamp_ns: int | None = None
        self.raws: Mapping[str, float] = {}
        self.floats: set[str] = set()
        self.good: list[tuple[str, Collection[float]]] = []
        self.positions: list[_WrappingPosition] = []

    def is_silent(self, now_ns: int) -> bool:
        """Return whether the message came at least once, and its values are too old now."""
        return self.late_ns is not None and self.stamp_ns is not None and now_ns - self.stamp_ns > self.late_ns

    @property
    def is_healthy(self) -> bool:
        """Whether it reports no error, and no state that ``armed_when`` excludes; also before the first frame."""
        return self.stamp_ns is None or all(self.raws[name] in good for name, good in self.good)

    def feed(self, payload: bytes, stamp_ns: int) -> str | None:
        """Take a payload. It changes nothing if it is too short or has a value that is not finite; return why not."""
        length = self.message.length
        if len(payload) < length:
            return f"{len(payload)} bytes, and {self.message.name} has {length} in the DBC"
        # cantools' own scaling, checks and value-table texts would double the time.
        raws = self.message.codec.decode_simple(payload[:length], decode_choices=False, scaling=False)
        for name in self.floats:
            if not math.isfinite(raws[name]):
                return f"{self.message.name}.{name} is {raws[name]}"
        self.raws, self.stamp_ns = raws, stamp_ns
        for position in self.positions:
            position.follow(stamp_ns)
        return None


@dataclass(slots=True)
class _Reading:
    """A signal that is read. Its value is ``gain`` × raw + ``bias``."""

    source: _Source
    name: str
    gain: float
    bias: float

    @property
    def value(self) -> float:
        """The newest value, NaN before the first."""
        return self.source.raws.get(self.name, NAN) * self.gain + self.bias


class _WrappingPosition(_Reading):
    """A position whose signal wraps after ``span``; whole spans are added, so that its value does not wrap.

    Between two frames a motor may turn more than half a span; the number of wraps follows from its ``speed``, if known.
    """

    def __init__(self, wrapped: _Reading, speed: _Reading | None, span: float) -> None:
        super().__init__(wrapped.source, wrapped.name, wrapped.gain, wrapped.bias)
        self._wrapped, self._speed, self._span = wrapped, speed, span
        self._last: tuple[int, float, float] | None = None
        self._added = 0.0
        self.source.positions.append(self)

    @property
    def value(self) -> float:
        """The newest value, NaN before the first."""
        return self._wrapped.value + self._added

    def follow(self, stamp_ns: int) -> None:
        """Count the wraps up to the newest frame."""
        value, speed = self._wrapped.value, self._speed.value if self._speed else NAN
        if self._last is not None:
            last_ns, last, last_speed = self._last
            expected = 0.5 * (speed + last_speed) * (stamp_ns - last_ns) * 1e-9
            turned = (0.0 if math.isnan(expected) else expected) - (value - last)
            self._added += self._span * round(turned / self._span)
        self._last = stamp_ns, value, speed


class Received:
    """All messages of a mapping that the controllers send.

    ``is_healthy``: whether the message of the newest frame reports no error, and no state that ``armed_when`` excludes.
    """

    def __init__(self, plan: Plan, gain: Gain) -> None:
        self._sources = {name: _Source(message, plan.late_ns(message)) for name, message in plan.received.items()}
        self._by_id = {source.message.id: source for source in self._sources.values()}
        self.is_healthy = True
        self._now_ns = 0  # stamp of the newest frame
        self._quantities: dict[str, Sequence[_Reading]] = {
            name: [self._read(bound.signal, gain(bound)) for bound in quantity.bounds]
            for name, quantity in plan.feedback.items()
        }
        if positions := plan.feedback.get("position"):
            spans = [abs(gain(one)) * span for one, span in zip(positions.bounds, positions.spans, strict=True)]
            speeds = self._quantities.get("speed", [None] * 4)
            self._quantities["position"] = [
                _WrappingPosition(reading, speed, span) if span else reading
                for reading, speed, span in zip(self._quantities["position"], speeds, spans, strict=True)
            ]
        self._armed_when, self._identity, self._errors = (
            [(self._read(one.signal), one) for one in conditions]
            for conditions in (plan.armed_when, plan.identity, plan.errors)
        )
        for reading, condition in self._armed_when + self._errors:
            reading.source.good.append((reading.name, condition.raws))
        read = plan.watchdog.read
        self._watchdog = None if read is None else self._read(read.signal, gain(read))
        self._measured = {signal.message: self._sources[signal.message] for signal in plan.measured}
        self._positions = {one.source.message.name: one.source for one in self._quantities.get("position", ())}
        needed = [one for one in self._errors if one[0].source.late_ns is not None]
        needed += self._armed_when + self._identity
        self._needed = {one.source.message.name: one.source for one, _ in needed} | self._measured | self._positions

    def _read(self, signal: Signal, gain: float | None = None) -> _Reading:
        """Return a signal to read. Without a gain its raw value is read, which conditions compare exactly."""
        source = self._sources[signal.message]
        if signal.is_float:
            source.floats.add(signal.name)
        if gain is None:
            return _Reading(source, signal.name, 1, 0)
        return _Reading(source, signal.name, gain * signal.factor, gain * signal.offset)

    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        """Take a frame. Return why it was not used, as ``Driver.feed``."""
        source = self._by_id.get(frame.id)
        if source is None:
            self.is_healthy = True
            return ""
        self._now_ns = max(self._now_ns, stamp_ns)
        why = source.feed(frame.payload, stamp_ns)
        self.is_healthy = source.is_healthy
        return why

    def quantity(self, name: str) -> Sequence[float] | None:
        """Return the newest values of a quantity [SI], NaN for what did not come, or is too old; None if not mapped."""
        readings = self._quantities.get(name)
        if readings is None:
            return None
        if name == "position":  # kept for odometry; if the positions no longer come, stamp_ns stands still
            return [reading.value for reading in readings]
        return [NAN if reading.source.is_silent(self._now_ns) else reading.value for reading in readings]

    def stamp_ns(self) -> int | None:
        """Return the stamp of the oldest message with speeds; None until all speeds and positions have come.

        It stands still when the positions no longer come.
        """
        stamp_ns = oldest(source.stamp_ns for source in self._measured.values())
        for name, source in self._positions.items():
            if stamp_ns is None or source.stamp_ns is None:
                return None
            if source.late_ns is not None and name not in self._measured:
                stamp_ns = holds_back(stamp_ns, source.stamp_ns, source.late_ns)
        return stamp_ns

    def missing(self) -> str:
        """Return the names of the needed messages that have not come yet, as text; empty for none."""
        return ", ".join(str(source.message) for source in self._needed.values() if source.stamp_ns is None)

    def follows(self) -> bool:
        """Return whether all conditions of [device.motors.armed_when] are met by values that are not too old."""
        return all(
            reading.value in condition.raws and not reading.source.is_silent(self._now_ns)
            for reading, condition in self._armed_when
        )

    def identity(self) -> str:
        """Return the values that identify the device, as text. Raises BadInputError for those of another device."""
        for reading, (signal, raws, _) in self._identity:
            if reading.value not in raws:
                known = ", ".join(sorted(map(signal.word, raws)))
                raise BadInputError(
                    f"{signal} of the device is {signal.word(reading.value)}, and this mapping is for {known} "
                    "(device.motors.identity); take the DBC of the device's firmware, or the firmware of the DBC"
                )
        return ", ".join(f"{one.signal} {one.signal.word(reading.value)}" for reading, one in self._identity)

    def errors(self) -> list[str]:
        """Return the reported errors as texts."""
        return [
            f"{'the robot' if where == 'robot' else f'wheel {where}'}: {signal} is {signal.word(reading.value)}"
            for reading, (signal, none, where) in self._errors
            if reading.source.raws and reading.value not in none
        ]

    def silent(self) -> list[str]:
        """Return texts about messages with states and errors that are too old."""
        return [
            f"nothing received of {source.message}, which reports errors or states, for more than "
            f"{(source.late_ns or 0) * 1e-9:g} s ({_PERIOD if source.message.period_s else _NO_PERIOD})"
            for source in self._sources.values()
            if source.good and source.is_silent(self._now_ns)
        ]

    def watchdog_s(self, since_ns: int) -> float:
        """Return the watchdog's time [s] as read back after ``since_ns``; NaN if it did not come or is too old."""
        reading = self._watchdog
        if reading is None or reading.source.stamp_ns is None or reading.source.stamp_ns <= since_ns:
            return NAN
        return NAN if reading.source.is_silent(self._now_ns) else reading.value
