"""A twin of the library's reader of snapshots, in Python from PROTOCOL.md: what the C one is held against."""

from firmware_protocol.codec import Message
from firmware_protocol.generated.messages import Accelerometer, Currents, Encoders, Gyro, State, Tick, WheelSpeeds
from hil.core.types import NAN, NAN_WHEELS, Wheels
from hil.robot.snapshot import Feedback

_PARTS: dict[type, int] = {Encoders: 1, WheelSpeeds: 2, Currents: 4, Accelerometer: 8, Gyro: 16}
_INERTIAL = _PARTS[Accelerometer]  # and above
_NO_ACCELERATION = (NAN, NAN, NAN)


class SnapshotAssembler:
    """Puts snapshots together; pure. ``incomplete`` counts what was dropped, ``lost`` gaps in their numbers;
    128 and more in a row go unseen."""

    def __init__(self) -> None:
        self._tick: Tick | None = None
        self._missing = 0
        self._pending: list[Message] = []
        self._last_number: int | None = None
        self._last_us: int | None = None
        self._time_us = 0
        self._count = (0, 0, 0, 0)
        self._speed = NAN_WHEELS
        self._current = NAN_WHEELS
        self._acceleration = _NO_ACCELERATION
        self._yaw_rate = NAN
        self.incomplete = 0
        self.lost = 0

    def restart(self) -> None:
        """Begin anew with a robot that was lost or reset: its numbers and its clock may have begun anew too."""
        self._missing = 0
        self._last_number = None
        self._last_us = None

    def feed(self, message: Message) -> Feedback | None:
        """Take a message; return the snapshot that it completes, if it does."""
        part = _PARTS.get(type(message))
        if part is None:
            if isinstance(message, Tick):
                self._open(message)
            return None
        missing = self._missing
        if not missing:
            return None
        if part != missing & -missing or (part >= _INERTIAL and not self._belongs(message)):
            self._missing = 0
            self.incomplete += 1
            return None
        self._pending.append(message)
        self._missing = missing & ~part
        return None if self._missing else self._commit()

    def _belongs(self, message: Message) -> bool:
        """The parts of the inertial sensors say themselves when they were sampled."""
        tick = self._tick
        if tick is None or not isinstance(message, Accelerometer | Gyro):
            return True
        return message.tick == tick.time_us // 1000 & 0xFFFF

    def _open(self, tick: Tick) -> None:
        self.incomplete += self._missing != 0
        if self._last_number is not None:
            missing = (tick.snapshot - self._last_number - 1) & 0xFF
            # Half the circle or more means a repeated TICK, an overtaken one, or a robot that began again.
            self.lost += missing if missing < 128 else 0
        self._last_number = tick.snapshot
        self._tick = tick
        self._missing = tick.parts
        self._pending.clear()

    def _commit(self) -> Feedback | None:
        tick = self._tick
        if tick is None:
            return None
        for message in self._pending:
            if isinstance(message, Encoders):
                self._count = (*message,)
            elif isinstance(message, WheelSpeeds):
                self._speed = Wheels._make(message)
            elif isinstance(message, Currents):
                self._current = Wheels._make(message)
            elif isinstance(message, Accelerometer):
                self._acceleration = message[:3]
            elif isinstance(message, Gyro):
                self._yaw_rate = message.z_rad_s
        if self._last_us is None:
            self._time_us = tick.time_us
        else:
            self._time_us += (tick.time_us - self._last_us) & 0xFFFF_FFFF
        self._last_us = tick.time_us
        return Feedback(
            self._time_us * 1000,
            State(tick.state),
            tick.sequence,
            tick.command_age_ms,
            self._count,
            self._speed,
            self._current,
            self._acceleration,
            self._yaw_rate,
        )
