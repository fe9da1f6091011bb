"""Finds ODrive axes: listens for heartbeats, and asks only those nodes who they are."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.dialects import odrive_tables as can
from hil.dialects.odrive_axis import Axis
from hil.dialects.odrive_settings import Setup
from hil.dialects.odrive_tables import FIRMWARE_05
from hil.dialects.port import EXTENDED, REMOTE, Found

_NOTHING = Setup(0, (0, b""), ())
_STATES = 15  # 0 to 14 are in use


class OdriveProbe:
    """A node is one of these once it has answered: the ids alone are also those of other makers' frames.

    No other command is asked for: 0.5 takes a remote frame of Set_Axis_Node_ID for a new id.
    """

    def __init__(self) -> None:
        self._axes: dict[int, Axis] = {}

    def ask(self) -> Sequence[Frame]:
        return [frame for _, axis in sorted(self._axes.items()) for frame in axis.ask()]

    def feed(self, frame: Frame) -> None:
        if frame.id & (EXTENDED | REMOTE):
            return
        node, command = frame.id >> can.NODE_SHIFT, frame.id & can.COMMAND_MASK
        if command == can.HEARTBEAT and len(frame.payload) == 8 and node < can.BROADCAST and frame.payload[4] < _STATES:
            self._axes.setdefault(node, Axis(node, "", _NOTHING, late_ns=0))
        if node in self._axes:
            self._axes[node].feed(command, frame.payload, 0)

    @property
    def suspects(self) -> bool:
        return bool(self._axes)

    def found(self) -> Found | None:
        known = [
            axis for _, axis in sorted(self._axes.items()) if axis.firmware is not None or axis.version is not None
        ]
        if not known:
            return None
        nodes = [axis.node for axis in known]
        drivable = all(axis.firmware is not None for axis in known)
        return Found([_sentence(axis) for axis in known], {"node_ids": nodes} if drivable and len(nodes) == 4 else None)


def _sentence(axis: Axis) -> str:
    if axis.firmware is FIRMWARE_05:
        return f"an ODrive axis, node {axis.node}, of firmware 0.5.4 or newer of 0.5"
    firmware, hardware = (".".join(map(str, version or ())) for version in (axis.version, axis.hardware))
    return f"an ODrive axis, node {axis.node}, of firmware {firmware} on hardware {hardware}"
