"""A virtual robot's firmware with the safety judge around it: on the frames that go in, and on its drives."""

from collections.abc import Mapping
from typing import Any

from firmware_protocol.framing import Deframer, Frame
from firmware_protocol.host import HostNode, library
from hil.catalogue.judge import SafetyJudge, Tick


class WatchedNode(HostNode):
    """``HostNode`` for one life of the firmware, from power on to power off. Takes and raises what that does.

    Bytes are passed on frame by frame, so that the judge knows each before the ticks that a STEP behind it brings;
    the firmware gets the same bytes.
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
        judge.power_on(round(values["watchdog_s"] * 1000.0), round(values["ramp_s"] * 1000.0))
        super().__init__(values, int(ffi.cast("uintptr_t", self._watch)), 0, **options)

    def feed(self, data: bytes) -> None:
        start = 0
        while start < len(data):
            end = data.find(b"\0", start) + 1 or len(data)
            piece = data[start:end]
            for frame in self._deframer.feed(piece):
                self._judge.hear(frame)
            super().feed(piece)
            self._check()
            start = end

    def receive(self, frame: Frame) -> None:
        self._judge.hear(frame)
        super().receive(frame)
        self._check()

    def run(self, ticks: int) -> None:
        super().run(ticks)
        self._check()

    def _exchange(self, _context: object, drive: Any, sense: Any) -> int:
        failed: int = self._plant(self._plant_context, drive, sense)
        if drive != self._no_drive:
            set_point = self.look().set_point_rad_s
            self._judge.hold(Tick(bool(drive.enabled), set_point, tuple(drive.torque_n_m), tuple(drive.duty)))
        return failed

    def _fail(self, _kind: type[BaseException], error: BaseException, _trace: object) -> None:
        """Keep what went wrong where C cannot raise it."""
        self._error = error

    def _check(self) -> None:
        if self._error is not None:
            raise self._error
