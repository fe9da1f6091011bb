"""A twin of the library's session of the host, in Python from PROTOCOL.md, "States": what the C one is held against."""

from collections.abc import Callable, Iterator

from firmware_protocol.generated import messages as m

HEARTBEAT_NS = 100_000_000
HELLO_NS = 200_000_000
_ANOTHER_NONCE_HELPS = (
    m.ArmRefusal.NONCE_USED,
    m.ArmRefusal.SESSION_USED,
    m.ArmRefusal.NOT_IDLE,
    m.ArmRefusal.NOT_ANNOUNCED,
)


class SessionTwin:
    """The host's session. ``out`` are the messages that it has sent, without HELLO."""

    def __init__(self, mode: m.Mode, parameter_check: int, nonce: int) -> None:
        self._mode = mode
        self._check = parameter_check
        self._heartbeat_ns: int | None = None
        self._hello_ns: int | None = None
        self._sequence = 0
        self.nonce = nonce
        self.request = m.Request.IDLE
        self.is_greeted = False
        self.state: m.State | None = None
        self.status: m.Status | None = None
        self.out: list[m.Message] = []
        self.hellos = 0

    def leave(self) -> None:
        self.request, self.is_greeted = m.Request.IDLE, False
        self._heartbeat_ns = self._hello_ns = self.state = self.status = None

    def begin(self, nonce: int) -> None:
        self.leave()
        self.nonce, self._hello_ns = nonce, 0

    def renew(self, nonce: int) -> None:
        self.nonce, self.request = nonce, m.Request.IDLE

    def send(self, request: m.Request, now_ns: int) -> None:
        self.request = request
        if now_ns >= 0:
            self._heartbeat_ns = now_ns + HEARTBEAT_NS
        self.out.append(m.HostHeartbeat(self.nonce, m.SCHEMA_HASH, request, self._mode, self._check))

    def estop(self) -> None:
        self.request = m.Request.IDLE
        self.out.append(m.Estop(1, 0))

    def poll(self, now_ns: int) -> None:
        if self._hello_ns is not None and not self.is_greeted and now_ns >= self._hello_ns:
            self._hello_ns = now_ns + HELLO_NS
            self.hellos += 1
        if self._heartbeat_ns is not None and now_ns >= self._heartbeat_ns:
            self.send(self.request, now_ns)

    def arm(self, now_ns: int) -> str:
        step = next((step for of, holds, step in _TO_ACTIVE if of is self.state and holds(self)), "WAIT")
        if step == "HOLD":
            self._sequence = (self._sequence + 1) & 0xFF
            kind = m.TorqueCommand if self._mode is m.Mode.TORQUE else m.WheelCommand
            self.out.append(kind(0.0, 0.0, 0.0, 0.0, self._sequence, self.nonce & 0xF))
        elif step == "ASKED":
            self.send(m.Request.IDLE, now_ns)
            self.send(m.Request.ARM, now_ns)
        elif step == "NEW_NONCE":
            self.status = None
        return step

    def is_ours(self) -> bool:
        return self.status is not None and self.status.nonce == self.nonce

    def refusal(self) -> int:
        return m.ArmRefusal.NONE if self.status is None else self.status.arm_refusal


def _reports(state: m.State) -> Callable[[SessionTwin], bool]:
    return lambda twin: twin.status is not None and twin.status.state == state


# (robot's state, condition, step of the host): the first row that applies decides; without one the host waits.
_TO_ACTIVE: tuple[tuple[m.State, Callable[[SessionTwin], bool], str], ...] = (
    (m.State.ACTIVE, SessionTwin.is_ours, "DONE"),
    (m.State.ARMED, SessionTwin.is_ours, "HOLD"),
    (m.State.IDLE, lambda twin: not twin.is_greeted, "STRANGER"),
    (m.State.IDLE, lambda twin: twin.request is m.Request.IDLE, "ASKED"),
    (m.State.IDLE, lambda twin: twin.refusal() in _ANOTHER_NONCE_HELPS, "NEW_NONCE"),
    (m.State.IDLE, lambda twin: twin.refusal() != m.ArmRefusal.NONE, "REFUSED"),
    (m.State.FAULT, _reports(m.State.FAULT), "LATCHED"),
    (m.State.ESTOP, _reports(m.State.ESTOP), "LATCHED"),
)


def hello_pages(version: int = m.PROTOCOL_VERSION, schema: int = m.SCHEMA_HASH) -> Iterator[m.Message]:
    """Yield the robot's answer to HELLO."""
    yield m.HelloIdentity(version, 7, 0, schema)
    yield m.HelloFirmware(1, 2, 3, 4, 5)
    yield m.HelloParameters(0x5A, 100, 5)
    yield m.HelloGeometry(0.05, 0.2, 0.15, 4096)
    yield m.HelloLimits(40.0, 50.0, 5.0)
    yield m.HelloFaultStatus(0, 0)
    yield m.HelloFaultPlace(0, 0)
    yield m.HelloFaultAddress(0, 0)
