"""Snapshots of feedback by PROTOCOL.md: which parts belong together, losses, and the wheels' motion then."""

from collections.abc import Sequence
from typing import Any

from firmware_protocol.codec import Message
from firmware_protocol.generated import messages as m

_PARTS: dict[type, int] = {m.Encoders: 1, m.WheelSpeeds: 2, m.Currents: 4, m.Accelerometer: 8, m.Gyro: 16}
_NAN = float("nan")


class Snapshots:
    """The newest whole snapshot; the attributes are named as those of ``wheel_view``.

    ``wires``: of each channel of the robot, its wheel and its sign.
    """

    def __init__(self) -> None:
        self.wires = [(wheel, 1) for wheel in range(4)]
        self.state = 0
        self.command_sequence = self.command_age_ms = 0
        self.robot_time_us = 0
        self.encoder_count = [0] * 4
        self.speed_rad_s, self.current_a, self.acceleration_m_s2 = [_NAN] * 4, [_NAN] * 4, [_NAN] * 3
        self.yaw_rate_rad_s = _NAN
        self.has_feedback = False
        self.snapshots = self.lost = self.incomplete = 0
        self._open: m.Tick | None = None
        self._came: list[Message] = []
        self._number: int | None = None
        self._time_us: int | None = None

    def restart(self) -> None:
        """Forget half a snapshot, and numbers and clock of a robot that may have been reset."""
        self._open = self._number = self._time_us = None

    def take(self, message: Message) -> bool:
        """Take a message; return whether it belongs to snapshots at all."""
        if isinstance(message, m.Tick):
            self._begin(message)
        elif type(message) in _PARTS:
            self._take_part(message)
        else:
            return False
        return True

    def _begin(self, tick: m.Tick) -> None:
        self.incomplete += self._open is not None
        if self._number is not None:
            missing = (tick.snapshot - self._number - 1) & 0xFF
            self.lost += missing if missing < 128 else 0
        self._number, self._came = tick.snapshot, []
        self._open = tick if tick.parts else None

    def _take_part(self, message: Message) -> None:
        tick = self._open
        if tick is None:
            return
        turns = [part for part in _PARTS.values() if tick.parts & part]
        belongs = not isinstance(message, m.Accelerometer | m.Gyro) or message.tick == tick.time_us // 1000 & 0xFFFF
        if _PARTS[type(message)] != turns[len(self._came)] or not belongs:
            self._open = None
            self.incomplete += 1
            return
        self._came.append(message)
        if len(self._came) == len(turns):
            self._open = None
            self._keep(tick)

    def _keep(self, tick: m.Tick) -> None:
        for part in self._came:
            if isinstance(part, m.Encoders):
                self.encoder_count = [count & 0xFFFF for count in self._of_wheels(part)]
            elif isinstance(part, m.WheelSpeeds):
                self.speed_rad_s = self._of_wheels(part)
            elif isinstance(part, m.Currents):
                self.current_a = self._of_wheels(part)
            elif isinstance(part, m.Accelerometer):
                self.acceleration_m_s2 = list(part[:3])
            elif isinstance(part, m.Gyro):
                self.yaw_rate_rad_s = part.z_rad_s
        before = self._time_us
        self.robot_time_us = tick.time_us if before is None else self.robot_time_us + (tick.time_us - before) % 2**32
        self._time_us = tick.time_us
        self.state, self.command_sequence, self.command_age_ms = tick.state, tick.sequence, tick.command_age_ms
        self.has_feedback = True
        self.snapshots += 1

    def _of_wheels(self, channels: Sequence[Any]) -> list[Any]:
        wheels = list(channels)
        for (wheel, sign), value in zip(self.wires, channels, strict=True):
            wheels[wheel] = sign * value
        return wheels
