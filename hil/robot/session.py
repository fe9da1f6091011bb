"""The state machine of the host's session with a robot that runs our firmware. No I/O.

The robot's own states are in PROTOCOL.md, "States". The host's state is what ``Session`` holds:

    known      whether the robot has answered HELLO since the link was opened, and matches the scenario
    request    what each heartbeat requests: IDLE, ARM or CLEAR
    heartbeat  when the next one is due; none before the first request, so that a host that only reads disarms nobody
    nonce      the number of this session; a robot refuses a number that it has seen before

    event (``Stm32``)            known       request          heartbeat      nonce
    HELLO answered               yes         -                -              -
    link lost: leave             no          IDLE             none           -
    back again: begin_again      no          IDLE             none           next
    disarm, stop                 -           IDLE             every 0.1 s    -
    estop                        -           IDLE             as before      -
    clear                        -           CLEAR            every 0.1 s    next
    armed: ARM, ARM_ANEW         -           IDLE, then ARM   every 0.1 s    next for ARM_ANEW

``_TO_ACTIVE`` below lists the rules for arming. The robot arms on a change from IDLE to ARM, so IDLE is sent first.
"""

from collections.abc import Callable, Iterator
from enum import Enum

from firmware_protocol.codec import Message
from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError
from hil.core.types import CommandMode
from hil.robot import handshake
from hil.robot.handshake import RETRY_NS, Expected, Greeting, RobotInfo

_HEARTBEAT_NS = 100_000_000
_ANOTHER_NONCE_HELPS = (
    m.ArmRefusal.NONCE_USED,
    m.ArmRefusal.SESSION_USED,
    m.ArmRefusal.NOT_IDLE,
    m.ArmRefusal.NOT_ANNOUNCED,
)


class Step(Enum):
    """What the host does in one tick while it arms the robot."""

    DONE = "the robot is ACTIVE in our session"
    HOLD = "send zero commands: the first one makes the robot ACTIVE"
    ARM = "announce IDLE, then ask to arm"
    ARM_ANEW = "the same with the next nonce"
    WAIT = "wait for the robot, or for the end of another host's session"
    STRANGER = "give up: the robot has not answered HELLO since the link was lost"
    REFUSED = "give up: the robot refuses to arm, and another nonce would not help"
    LATCHED = "give up: FAULT or ESTOP is latched, and STATUS has the cause"


class Session:
    """The state of the host's session. ``nonces`` are used in order.

    Attributes:
        nonce, request: see the module's docstring.
        info: the robot's answer to HELLO; None before the first.
    """

    def __init__(self, nonces: Iterator[int], mode: CommandMode, expected: Expected) -> None:
        self._nonces = nonces
        self._mode = m.Mode.TORQUE if mode is CommandMode.TORQUE else m.Mode.SPEED
        self._expected = expected
        self._is_known = False
        self._greeting: Greeting | None = None
        self._greet_again_ns = 0
        self._heartbeat_ns: int | None = None
        self.nonce = next(nonces)
        self.request = m.Request.IDLE
        self.info: RobotInfo | None = None

    # Identity of the robot

    def accept(self, info: RobotInfo) -> None:
        """Accept the robot's answer to HELLO. Raises BadInputError when it does not match the scenario, or is not the
        robot with which the run began."""
        handshake.check(info, self._expected)
        if self.info is not None and not self.info.is_same_robot(info):
            raise BadInputError(
                f"another robot answers on the link: {info.describe()}; the run began with {self.info.describe()}; "
                "plug in the first one, or start a new run"
            )
        self.info = info  # the fault record and reset cause may be new
        self._is_known = True

    def leave(self) -> None:
        """Stop all requests and heartbeats, because the link or the robot was lost."""
        self.request, self._is_known, self._heartbeat_ns = m.Request.IDLE, False, None

    def begin_again(self) -> None:
        """Start a new session. The robot may be another one, so it must answer HELLO first."""
        self.leave()
        self.renew()
        self._greeting, self._greet_again_ns = Greeting(), 0

    @property
    def is_greeted(self) -> bool:
        """Whether the robot has answered HELLO since ``begin_again``."""
        return self._greeting is None

    def hello(self, now_ns: int) -> Message | None:
        """Return the HELLO request if it is due, else None."""
        if self._greeting is None or now_ns < self._greet_again_ns:
            return None
        self._greet_again_ns = now_ns + RETRY_NS
        return m.HelloRequest(m.PROTOCOL_VERSION)

    def feed(self, message: Message) -> bool:
        """Add a message; return whether it completed the answer to HELLO. Raises BadInputError as ``accept`` does."""
        if self._greeting is None or (info := self._greeting.feed(message)) is None:
            return False
        self.accept(info)
        self._greeting = None
        return True

    # Requests

    def renew(self) -> None:
        """Start a session with the next nonce."""
        self.nonce = next(self._nonces)

    def heartbeat(self, request: m.Request, now_ns: int | None) -> m.HostHeartbeat:
        """Set the request that heartbeats carry and return the first one. ``now_ns`` is None without a clock."""
        self.request = request
        if now_ns is not None:
            self._heartbeat_ns = now_ns + _HEARTBEAT_NS
        check = self._expected.parameter_hash & 0xFF
        return m.HostHeartbeat(self.nonce, m.SCHEMA_HASH, request, self._mode, check)

    def is_heartbeat_due(self, now_ns: int) -> bool:
        """Return whether the next heartbeat is due."""
        return self._heartbeat_ns is not None and now_ns >= self._heartbeat_ns

    # Arming

    def next_step(self, state: m.State | None, status: m.Status | None) -> Step:
        """Return the next step for the robot's state (None without feedback) and its newest STATUS."""
        fitting = (step for of, holds, step in _TO_ACTIVE if of is state and holds(self, status))
        return next(fitting, Step.WAIT)

    def is_ours(self, status: m.Status | None) -> bool:
        """Return whether STATUS reports our session. Another host may have armed the robot meanwhile."""
        return status is not None and status.nonce == self.nonce

    def _is_stranger(self, _status: m.Status | None) -> bool:
        return not self._is_known

    def _has_no_request(self, _status: m.Status | None) -> bool:
        return self.request is m.Request.IDLE


def _nonce_is_spent(_: Session, status: m.Status | None) -> bool:
    return status is not None and status.arm_refusal in _ANOTHER_NONCE_HELPS


def _is_refused(_: Session, status: m.Status | None) -> bool:
    return status is not None and status.arm_refusal != m.ArmRefusal.NONE


def _reports(state: m.State) -> Callable[[Session, m.Status | None], bool]:
    """Return the condition that STATUS reports this state. Feedback may report the state earlier."""
    return lambda _, status: status is not None and status.state == state


# (robot's state, condition, step of the host): the first row that applies decides; without one the host waits.
_TO_ACTIVE: tuple[tuple[m.State, Callable[[Session, m.Status | None], bool], Step], ...] = (
    (m.State.ACTIVE, Session.is_ours, Step.DONE),
    (m.State.ARMED, Session.is_ours, Step.HOLD),
    (m.State.IDLE, Session._is_stranger, Step.STRANGER),
    (m.State.IDLE, Session._has_no_request, Step.ARM),
    (m.State.IDLE, _nonce_is_spent, Step.ARM_ANEW),
    (m.State.IDLE, _is_refused, Step.REFUSED),
    (m.State.FAULT, _reports(m.State.FAULT), Step.LATCHED),
    (m.State.ESTOP, _reports(m.State.ESTOP), Step.LATCHED),
)
