"""The emulated moteus as a device of the maker's own package: a frame takes some milliseconds of the plant."""

from typing import Any

import moteus
from moteus.transport_device import Frame as MakersFrame
from moteus.transport_device import TransportDevice

from firmware_protocol.framing import Frame
from hil.robot.driver import EXTENDED
from tests.support.dialect_testbed import Rig


class EmulatedBus(TransportDevice):  # type: ignore[misc]
    """Hands the package's frames to a rig's device, and the answers back."""

    def __init__(self, rig: Rig, ticks: int = 5) -> None:
        super().__init__()
        self._rig, self._ticks = rig, ticks

    def empty_bus_tx_safe(self) -> bool:
        return True

    async def send_frame(self, frame: MakersFrame) -> None:
        """Send one, and keep what comes for whoever asks."""
        for answer in self._exchange(frame):
            await self._handle_received_frame(answer)

    async def transaction(self, requests: list[TransportDevice.Request], **_: Any) -> None:
        """Send all, and give each what its filter lets through."""
        for request in requests:
            answers = self._exchange(request.frame)
            if request.frame_filter is not None:
                request.responses += filter(request.frame_filter, answers)

    def _exchange(self, frame: MakersFrame) -> list[MakersFrame]:
        extended = EXTENDED if frame.is_extended_id else 0
        before = len(self._rig.heard)
        self._rig.step([Frame(extended | frame.arbitration_id, bytes(frame.data))], ticks=self._ticks)
        return [
            MakersFrame(one.id & ~EXTENDED, one.payload, len(one.payload), bool(one.id & EXTENDED), True, channel=self)
            for one in self._rig.heard[before:]
        ]


def controller(rig: Rig, number: int = 1, ticks: int = 5) -> moteus.Controller:
    """Return the package's controller of one of a rig's moteus."""
    return moteus.Controller(id=number, transport=moteus.Transport([EmulatedBus(rig, ticks)]))
