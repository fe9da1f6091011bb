"""The firmware before a plant that is written in Python, as a test needs it."""

from collections.abc import Callable, Mapping
from typing import Any

from firmware_protocol.extension import library
from firmware_protocol.framing import Frame
from firmware_protocol.host import HostNode


class PlantNode(HostNode):
    """A ``HostNode`` that calls ``exchange(context, drive, sense)`` each tick; ``drive`` is false when it begins.

    What ``exchange`` raises is raised by the call that let time pass, since C would swallow it.

    Attributes:
        plant_address: of the C function, for other nodes; valid as long as this object.
    """

    def __init__(
        self, exchange: Callable[[Any, Any, Any], int], values: Mapping[str, float], *, lockstep: bool, **options: Any
    ) -> None:
        ffi, _ = library()
        self._raised: BaseException | None = None
        self._exchange = ffi.callback("wheel_plant_exchange", exchange, error=1, onerror=self._keep)
        self.plant_address = int(ffi.cast("uintptr_t", self._exchange))
        super().__init__(values, self.plant_address, 0, lockstep=lockstep, **options)
        self._check()

    def feed(self, data: bytes) -> None:
        super().feed(data)
        self._check()

    def receive(self, frame: Frame) -> None:
        super().receive(frame)
        self._check()

    def run(self, ticks: int) -> None:
        super().run(ticks)
        self._check()

    def _keep(self, _kind: type[BaseException], error: BaseException, _trace: object) -> None:
        self._raised = self._raised or error

    def _check(self) -> None:
        if self._raised is not None:
            raise self._raised
