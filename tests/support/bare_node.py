"""The firmware core without the host library's port: every structure of its headers, and time in the test's hand.

Tests of a port's work and of inner state use this; tests of the host's view use ``tests.support.wheel_rig``.
"""

import functools
import math
import re
from collections.abc import Mapping
from typing import Any

from firmware_protocol import codec
from firmware_protocol.built import HERE, OTHER, WHEEL_HOST
from firmware_protocol.capabilities import Capability
from firmware_protocol.declarations import HEADERS, TABLE, read_headers
from firmware_protocol.extension import library
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameter_hash
from tests.support.wheel_rig import INERTIA_KG_M2, PARAMETERS

_HEADERS = ("cobs.h", "framing.h", "parameters.h", "states.h", "control.h", "plant_port.h", "node.h")
_DEFINE = re.compile(r"^#define (WP_PAYLOAD_MAX|WHEEL_\w+) +([^/\n]+)", re.MULTILINE)
_FOR_CPP = re.compile(r"^#ifdef __cplusplus\n.*?^#endif\n", re.MULTILINE | re.DOTALL)
_DIRECTIVE = re.compile(r"^#(.*\\\n)*.*\n", re.MULTILINE)
_DECLARED = re.compile(r"/\* cffi: begin \*/.*?/\* cffi: end \*/|extern const wheel_parameter_info [^;]*;", re.DOTALL)

ALL = Capability((1 << 11) - 1) & ~(Capability.LOCKSTEP | Capability.POWER_STAGE)


@functools.cache
def core() -> tuple[Any, Any]:
    """Return cffi's (ffi, library) with all that the core's headers declare."""
    library()  # up to date
    ffi = read_headers(HEADERS, TABLE)
    generated = ("wheel_messages.h", "wheel_parameters.h")
    files = [*(HERE / "generated" / name for name in generated), *(HERE / "firmware" / name for name in _HEADERS)]
    files.append(HERE / "client" / "wheel_client.h")
    text = "".join(file.read_text(encoding="utf-8") for file in files)
    constants = dict(_DEFINE.findall(text)) | {"WHEEL_FRAME_MAX": "15"}
    text = _DIRECTIVE.sub("", _DECLARED.sub("", _FOR_CPP.sub("", text)))
    while found := re.search(rf"\b({'|'.join(constants)})\b", text):
        text = re.sub(rf"\b{found[1]}\b", f"({constants[found[1]].strip()})", text)
    ffi.cdef(text)
    return ffi, ffi.dlopen(str(WHEEL_HOST.path if OTHER is None else OTHER))


class BareNode:
    """A core, and four free wheels whose sensors give the values set for ``sense``."""

    def __init__(
        self,
        *,
        capabilities: int = ALL,
        stored: bytes | None = None,
        changes: Mapping[str, float] = PARAMETERS,
        maximum: Any = None,
    ) -> None:
        self.ffi, self.lib = core()
        self.values = PARAMETERS | dict(changes)
        block = self.ffi.new("wheel_parameters *", self.values)
        fields = {"capabilities": capabilities, "version": [1, 2, 3], "build": 7}
        self.identity = identity = self.ffi.new("wheel_identity *", fields)
        self._maximum = identity.maximum = self.ffi.NULL if maximum is None else maximum
        self.node = self.ffi.new("wheel_node *")
        self.drive = self.ffi.new("wheel_drive *")
        self.sense = self.ffi.new("wheel_sense *")
        self.sense.battery_v = 24.0
        self.sense.temperature_degc = [25.0] * 4
        self.angle_rad = [0.0] * 4
        self.speed_rad_s = [0.0] * 4
        self.lib.wheel_node_init(self.node, block, self.ffi.NULL if stored is None else stored, identity)

    @property
    def state(self) -> m.State:
        return m.State(self.node.state)

    def receive(self, frame: Frame, now_us: int = 0) -> None:
        block = self.ffi.new("wheel_frame *", {"id": frame.id, "length": len(frame.payload), "payload": frame.payload})
        self.lib.wheel_node_receive(self.node, block, now_us & 0xFFFF_FFFF)

    def send(self, message: codec.Message, now_us: int = 0) -> None:
        self.receive(codec.encode(message), now_us)

    def heard(self, now_us: int = 0) -> list[codec.Message]:
        """Take the messages that the core has to send, as a port does at ``now_us``."""
        block = self.ffi.new("wheel_frame *")
        messages = []
        while self.lib.wheel_node_transmit(self.node, block, now_us & 0xFFFF_FFFF):
            message = codec.decode(Frame(block.id, bytes(block.payload)[: block.length]))
            assert message is not None
            messages.append(message)
        return messages

    def tick(self, ticks: int = 1) -> None:
        """Let the wheels turn under the torques, and count."""
        for _ in range(ticks):
            self.lib.wheel_node_drive(self.node, self.drive)
            for i, torque_n_m in enumerate(self.drive.torque_n_m):
                self.speed_rad_s[i] += torque_n_m / INERTIA_KG_M2 * 1e-3
                self.angle_rad[i] += self.speed_rad_s[i] * 1e-3
                self.sense.count[i] = math.floor(self.angle_rad[i] / math.tau * 4096) & 0xFFFF
            self.lib.wheel_node_sense(self.node, self.sense)

    def heartbeat(self, request: m.Request, nonce: int, mode: m.Mode = m.Mode.SPEED) -> None:
        check = parameter_hash(self.values) & 0xFF
        self.send(m.HostHeartbeat(nonce, m.SCHEMA_HASH, request, mode, check))

    def activate(self, mode: m.Mode = m.Mode.SPEED, nonce: int = 0x1231) -> None:
        self.heartbeat(m.Request.IDLE, nonce, mode)
        self.heartbeat(m.Request.ARM, nonce, mode)
        kind = m.WheelCommand if mode is m.Mode.SPEED else m.TorqueCommand
        self.send(kind(0.0, 0.0, 0.0, 0.0, 0, nonce & 0xF))
        assert self.state is m.State.ACTIVE
