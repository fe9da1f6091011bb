"""A virtual robot's firmware with the safety judge around it: on the frames that go in, and on its plant port."""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

from firmware_protocol.framing import Deframer, Frame
from firmware_protocol.host import HostNode, library
from hil.batch.catalogue.judge import Limits, SafetyJudge, Tick

# Long enough to measure a speed by counts: with 4096 a turn, one in 10 ms is 0.15 rad/s.
_SPEED_TICKS = 10


class WatchedNode(HostNode):
    """A ``HostNode`` for one life of the firmware, from power on to power off, with the same arguments and errors.

    Bytes are passed on frame by frame: the judge gets each frame before the ticks that a following STEP starts. The
    firmware gets the same bytes.
    """

    def __init__(
        self,
        judge: SafetyJudge,
        values: Mapping[str, float],
        exchange_address: int,
        context_address: int,
        **options: Any,
    ) -> None:
        ffi, _ = library()
        self._judge = judge
        self._deframer = Deframer()
        self._plant = ffi.cast("wheel_plant_exchange", exchange_address)
        self._plant_context = ffi.cast("void *", context_address)
        self._no_drive = ffi.NULL
        self._watch = ffi.callback(
            "int(void *, const wheel_drive *, wheel_sense *)", self._exchange, error=1, onerror=self._fail
        )
        self._error: BaseException | None = None
        self._rad_s_a_count = 2.0 * math.pi / values["counts_per_revolution"] * 1000.0
        self._n_m_a = values["torque_constant_n_m_a"]
        self._counts: deque[tuple[int, ...]] = deque(maxlen=_SPEED_TICKS + 1)
        self._motor_n_m = (0.0,) * 4
        watchdog_ticks, ramp_ticks = (round(values[name] * 1000.0) for name in ("watchdog_s", "ramp_s"))
        judge.power_on(Limits(watchdog_ticks, ramp_ticks, values["torque_limit_n_m"]))
        super().__init__(values, int(ffi.cast("uintptr_t", self._watch)), 0, **options)

    def feed(self, data: bytes) -> None:
        start = 0
        while start < len(data):
            end = data.find(b"\0", start) + 1 or len(data)
            piece = data[start:end]
            for frame in self._deframer.feed(piece):
                self._judge.observe(frame)
            super().feed(piece)
            self._check()
            start = end

    def receive(self, frame: Frame) -> None:
        self._judge.observe(frame)
        super().receive(frame)
        self._check()

    def run(self, ticks: int) -> None:
        super().run(ticks)
        self._check()

    def _exchange(self, _context: object, drive: Any, sense: Any) -> int:
        failed: int = self._plant(self._plant_context, drive, sense)
        if drive != self._no_drive:
            given = (self.look().set_point_rad_s, tuple(drive.torque_n_m), tuple(drive.duty))
            self._judge.hold(Tick(bool(drive.enabled), *given, self._speeds_rad_s(), self._motor_n_m))
        self._counts.append(tuple(sense.count))
        self._motor_n_m = tuple(self._n_m_a * current_a for current_a in sense.current_a)
        return failed

    def _speeds_rad_s(self) -> tuple[float, ...]:
        """Return the mean speeds over the newest ticks from the encoders' counts, which wrap at 16 bits."""
        if len(self._counts) < 2:
            return (0.0,) * 4
        factor = self._rad_s_a_count / (len(self._counts) - 1)
        pairs = zip(self._counts[0], self._counts[-1], strict=True)
        return tuple(((new - old + 0x8000 & 0xFFFF) - 0x8000) * factor for old, new in pairs)

    def _fail(self, _kind: type[BaseException], error: BaseException, _trace: object) -> None:
        """Keep an error of the callback, which C cannot raise."""
        self._error = error

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
