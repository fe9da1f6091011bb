"""The same conversation with the host library and with an emulated board, each in front of four free wheels."""

import importlib.util
import random
import shutil
from pathlib import Path

import pytest

from firmware_protocol import codec
from firmware_protocol.arm_build import TARGETS
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import parameter_hash, stored_parameters
from firmware_protocol.stm32_flash import HIL_BOARD
from hil.core.ports import Node
from tests.support import arm_firmwares
from tests.support.arm_programs import HAS_COMPILER, NEEDS_COMPILER
from tests.support.wheel_rig import PARAMETERS, WheelRig

NONCE = 0x1234
# Board number and hash of the sources: facts that a board has and the host library lacks.
IDENTITY = m.HelloFirmware.ID

needs_compiler = pytest.mark.skipif(not HAS_COMPILER, reason=NEEDS_COMPILER)
needs_unicorn = pytest.mark.skipif(
    importlib.util.find_spec("unicorn") is None, reason="needs Unicorn; run: pip install 'mecanum-hil[targets]'"
)
needs_qemu = pytest.mark.skipif(
    shutil.which("qemu-system-arm") is None, reason="needs qemu-system-arm; install the package of this name"
)


def firmware(link: str) -> Path:
    """Return the firmware of the emulated targets."""
    target = next(t for t in TARGETS if t.variant == "hil-emulated" and t.link == link)
    return arm_firmwares.firmware(*target).elf


def plant_of(rig: WheelRig) -> tuple[int, int]:
    """Return the addresses of the rig's exchange and of its context."""
    return rig.node.plant_address, 0


def stored() -> bytes:
    """Return the rig's parameters as a board finds them in its flash."""
    return stored_parameters(PARAMETERS, HIL_BOARD)


class Host:
    """Speaks to a node over one kind of link; ``heard`` is every frame that came back."""

    def __init__(self, node: Node, link: str) -> None:
        self._node = node
        self._is_serial = link == "serial"
        self._framer, self._deframer = Framer(), Deframer()
        self.heard: list[Frame] = []

    def say(self, message: codec.Message) -> None:
        frame = codec.encode(message)
        if self._is_serial:
            self.say_bytes(self._framer.encode(frame))
        else:
            self._node.receive(frame)
            self.heard += self._node.take_frames()

    def say_bytes(self, data: bytes) -> None:
        self._node.feed(data)
        self.heard += self._deframer.feed(self._node.take_bytes())

    def newest(self, kind: type) -> codec.Message:
        """Return the newest message of a kind that was heard."""
        return next(found for frame in reversed(self.heard) if isinstance(found := codec.decode(frame), kind))

    def wish(self, request: m.Request, nonce: int = NONCE, mode: m.Mode = m.Mode.SPEED) -> None:
        self.say(m.HostHeartbeat(nonce, m.SCHEMA_HASH, request, mode, parameter_hash(PARAMETERS) & 0xFF))

    def step(self, tick: int, ticks: int) -> int:
        """Let the robot run so many ticks; return the tick that it has reached."""
        self.say(m.Step(tick, ticks))
        return tick + ticks

    def activate(self) -> None:
        """Arm with NONCE and send the zero command, sequence 0."""
        self.wish(m.Request.IDLE)
        self.wish(m.Request.ARM)
        self.say(m.WheelCommand(0.0, 0.0, 0.0, 0.0, 0, NONCE & 0xF))

    def without_identity(self) -> list[Frame]:
        return [frame for frame in self.heard if frame.id != IDENTITY]


def converse(host: Host, seed: int, rounds: int) -> None:
    """Say hello, arm, drive at random with all that a host can send, let the watchdog end it, stop by ESTOP."""
    draw = random.Random(seed)
    session = NONCE & 0xF
    host.say(m.HelloRequest(m.PROTOCOL_VERSION))
    for parameter in range(len(PARAMETERS) + 1):
        host.say(m.ParameterRequest(parameter, m.Operation.READ, parameter, 0))
    host.activate()
    tick = 0
    for n in range(1, rounds + 1):
        if draw.random() < 0.2:
            host.say(m.TimeSyncRequest(n & 0xFF))
        if draw.random() < 0.3:
            host.say(m.TorqueFeedforward(*(draw.uniform(-3, 3) for _ in range(4)), n & 0xFF, session))
        host.say(m.WheelCommand(*(draw.uniform(-30, 30) for _ in range(4)), n & 0xFF, session))
        if draw.random() < 0.1:
            host.say(m.WheelCommand(1.0, 1.0, 1.0, 1.0, n - 3 & 0xFF, session))  # stale
        if draw.random() < 0.2:
            host.wish(m.Request.ARM)
        tick = host.step(tick, draw.randrange(1, 12))
    tick = host.step(tick, 400)  # nobody commands
    host.wish(m.Request.IDLE, NONCE + 1)
    host.wish(m.Request.ARM, NONCE + 1)
    host.say(m.WheelCommand(0.0, 0.0, 0.0, 0.0, 0, NONCE + 1 & 0xF))
    tick = host.step(tick, 5)
    host.say(m.Estop(1, 2))
    host.step(tick, 50)
