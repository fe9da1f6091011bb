"""Finds ODrive axes: listens for heartbeats, and asks only the nodes that sent one for their version."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.drivers.four_motors import found_by_id
from hil.drivers.odrive import tables as can
from hil.drivers.odrive.axis import Axis
from hil.drivers.odrive.tables import Setup
from hil.drivers.port import ANSWER_S, EXTENDED, REMOTE, Found, Probe

_NOTHING = Setup(0, (0, b""), ())
_STATES = 15  # 0 to 14 are in use


class OdriveProbe(Probe):
    """Accepts a node as an ODrive after it has answered, because frames of other devices may have the same ids.

    A frame before the first question is no answer, and neither is an impossible version. Only version and controller
    error are asked for: firmware 0.5 would take a remote frame of Set_Axis_Node_ID for a new id.
    """

    patience_s = ANSWER_S

    def __init__(self) -> None:
        self._axes: dict[int, Axis] = {}
        self._has_asked = False

    def ask(self) -> Sequence[Frame]:
        self._has_asked = True
        return [frame for _, axis in sorted(self._axes.items()) for frame in axis.ask()]

    def feed(self, frame: Frame) -> bool:
        if frame.id & (EXTENDED | REMOTE):
            return False
        node, command = frame.id >> can.NODE_SHIFT, frame.id & can.COMMAND_MASK
        if command == can.HEARTBEAT and len(frame.payload) == 8 and node < can.BROADCAST and frame.payload[4] < _STATES:
            self._axes.setdefault(node, Axis(node, _NOTHING, late_ns=0))
        if node not in self._axes:
            return False
        if command == can.GET_VERSION and not _is_version(frame.payload):
            return False
        if self._has_asked or command == can.HEARTBEAT:
            self._axes[node].feed(command, frame.payload, 0)
        return True

    def found(self) -> Found | None:
        known = [axis for axis in self._axes.values() if axis.firmware is not None or axis.version is not None]
        sentences = {axis.node: f"an ODrive axis, node {axis.node}, of {axis.firmware_words}" for axis in known}
        found = found_by_id(sentences, ("device.motors.gear_ratio",), key="node_ids")
        return found and (found if all(axis.firmware is not None for axis in known) else found._replace(motors=None))


def _is_version(payload: bytes) -> bool:
    """Return whether this can be an answer to Get_Version, which exists since firmware 0.6."""
    if len(payload) != can.VERSION.size:
        return False
    line, _, _, major, minor, _, unreleased = can.VERSION.unpack(payload)
    return line > 0 and major <= 1 and minor < 32 and (major, minor) >= (0, 6) and unreleased <= 1
