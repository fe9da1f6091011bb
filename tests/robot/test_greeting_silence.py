"""What is said of a robot that does not answer HELLO, or answers as another one."""

from collections.abc import Mapping

import pytest

from firmware_protocol import codec
from firmware_protocol.capabilities import Capability
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError, DeviceError
from hil.core.ports import Received
from hil.robot import handshake
from hil.robot.handshake import Expected, Greeting, RobotInfo
from hil.robot.robot_report import NO_FAULT, ProcessorFault
from tests.support.wheel_rig import WheelRig


class Silent:
    """A link over which comes what the test says, once, and on which ``rejected`` are counted meanwhile."""

    def __init__(self, frames: int, rejected: Mapping[str, int]) -> None:
        self._frames = [Frame(m.Tick.ID, bytes(8))] * frames
        self._rejected = {"crc": 5}
        self._more = rejected
        self.sent: list[Frame] = []

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)

    def receive(self, timeout_ns: int) -> Received | None:
        self._rejected = {"crc": 5} | {cause: count + (cause == "crc") * 5 for cause, count in self._more.items()}
        frames, self._frames = self._frames, []
        return Received(frames, 0) if frames else None

    def rejected(self) -> Mapping[str, int]:
        return self._rejected

    def describe(self) -> str:
        return "a line"


@pytest.mark.parametrize(
    ("frames", "rejected", "words"),
    [
        (0, {}, "check that it is powered, that the link is the right one, that no other program uses it, and the"),
        (3, {"crc": 4}, "3 frames of a robot came, but not its HELLO; reset the robot and try again"),
        (0, {"error_acknowledgement": 7}, "no device on the bus acknowledges our frames; check the robot's power"),
        (
            0,
            {"error_acknowledgement": 7, "error_stuff": 2},
            "9 error frames came and no valid one: the bit rate is wrong, or a terminator is missing; set bitrate=",
        ),
        (0, {"error_form": 1, "crc": 2}, "1 error frames came and no valid one: the bit rate is wrong"),
        (0, {"cobs": 1, "crc": 2, "overrun": 4}, "bytes came, but 7 frames were damaged: set baud= in the link"),
        (0, {"error_stuff": 1, "foreign": 2, "unknown_id": 3}, "5 frames of other devices came, so the bus works"),
        (0, {"foreign": 2, "crc": 1}, "bytes came, but 1 frames were damaged"),
    ],
)
def test_what_came_instead_tells_why_a_robot_is_silent(
    frames: int, rejected: Mapping[str, int], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(handshake, "SILENCE_NS", 0)
    link = Silent(frames, rejected)
    now = iter(range(2))
    monkeypatch.setattr("hil.robot.handshake.time.monotonic_ns", lambda: 0 if next(now, 9) < 2 else 1)
    with pytest.raises(DeviceError) as failed:
        handshake.greet(link, Greeting())  # type: ignore[arg-type]
    assert str(failed.value).startswith(f"the robot did not answer HELLO within 2 s (a line); {words}")
    assert len(link.sent) == 1


class Robot:
    """A link to a firmware that says its HELLO pages and, only after ``status_ms`` on a clock of its own, a STATUS."""

    def __init__(self, status_ms: float) -> None:
        self.rig = WheelRig()
        self.now_ns = 0
        self.hellos_ms: list[float] = []
        self._status_ms = status_ms

    def send(self, frame: Frame) -> None:
        self.hellos_ms.append(self.now_ns / 1e6)
        self.rig.node.receive(frame)

    def receive(self, timeout_ns: int) -> Received | None:
        frames = [frame for frame in self.rig.frames() if frame.id != m.Status.ID]
        if not frames:
            status_ns, until_ns = round(self._status_ms * 1e6), self.now_ns + timeout_ns
            if self.now_ns < status_ns <= until_ns:
                until_ns = status_ns
                frames = [codec.encode(m.Status(*[0] * len(m.Status._fields))._replace(reset_cause=2))]
            self.now_ns = until_ns
        return Received(frames, self.now_ns)

    def rejected(self) -> Mapping[str, int]:
        return {}


@pytest.mark.parametrize(("status_ms", "is_asked", "told_ms", "cause"), [
    (50.0, True, 50.0, 2), (1e6, True, 200.0, None), (50.0, False, 0.0, None),
])  # fmt: skip
def test_a_status_is_waited_for_0_2_s_where_it_is_asked_for(
    status_ms: float, is_asked: bool, told_ms: float, cause: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(status_ms)
    monkeypatch.setattr("hil.robot.handshake.time.monotonic_ns", lambda: robot.now_ns)
    info = handshake.greet(robot, Greeting(), status=is_asked)  # type: ignore[arg-type]
    assert (robot.now_ns / 1e6, info.reset_cause) == (told_ms, cause)
    assert robot.hellos_ms == [0.0]


GEOMETRY = m.HelloGeometry(*([0] * len(m.HelloGeometry._fields)))._replace(
    wheel_radius_m=0.075, half_length_m=0.25, half_width_m=0.35
)
LIMITS = m.HelloLimits(*([0] * len(m.HelloLimits._fields)))._replace(speed_limit_rad_s=20.5, overspeed_rad_s=40.25)
INFO = RobotInfo(0, "1.2.3", 0xAB, 0xCD, 50, GEOMETRY, LIMITS)
EXPECTED = Expected(0xCD, False, False, 20.0)


def test_a_robot_is_described_with_its_figures() -> None:
    assert INFO.describe() == (
        "firmware 1.2.3 (build 000000ab), capabilities 0x0000, parameters 000000cd, watchdog 50 ms, wheels of 0.075 m "
        "at ±0.250, ±0.350 m, speeds up to 20.5 rad/s"
    )
    told = INFO._replace(processor_fault=ProcessorFault(cfsr=1))
    assert told.describe().endswith("; last reset PROCESSOR_FAULT: its processor had a fault: (CFSR 00000001, HFSR 000"
                                    "00000)")  # fmt: skip


@pytest.mark.parametrize(
    ("robot", "expected", "words"),
    [
        ({"capabilities": Capability.POWER_STAGE}, {}, "the robot reports a power stage: real motors would move"),
        ({}, {"lockstep": True}, "this run is in mode lockstep and the robot in mode realtime; start both"),
        (
            {"capabilities": Capability.LOCKSTEP},
            {},
            "this run is in mode realtime and the robot in mode lockstep; start both with the same --mode",
        ),
        (
            {"parameter_hash": 0xCE},
            {},
            "the robot's firmware parameters (hash 000000ce) are not the scenario's [firmware] (hash 000000cd); start",
        ),
    ],
)
def test_a_robot_that_does_not_match_is_refused(robot: dict, expected: dict, words: str) -> None:
    with pytest.raises(BadInputError) as refused:
        handshake.check(INFO._replace(**robot), EXPECTED._replace(**expected))
    assert str(refused.value).startswith(words)


def test_a_robot_that_matches_is_taken() -> None:
    handshake.check(INFO, EXPECTED)
    handshake.check(INFO._replace(capabilities=Capability.POWER_STAGE), EXPECTED._replace(allow_motion=True))
    handshake.check(INFO._replace(capabilities=Capability.LOCKSTEP), EXPECTED._replace(lockstep=True))


def test_a_robot_warns_of_a_reset_of_trouble_and_of_a_limit_below_ours() -> None:
    assert INFO.warnings(None, 20.5) == ()
    assert INFO.warnings(m.ResetCause.PIN, 0.0) == ()
    slow = (
        "the robot accepts wheel speeds of at most 20.5 rad/s, because 40.25 rad/s are a fault there; commands are "
        "limited to that and not to robot.speed_limit_rad_s = 20.6"
    )
    assert INFO.warnings(None, 20.6) == (slow,)
    hung = "the robot was reset since it was powered on (WATCHDOG): its watchdog expired because the firmware hung"
    (told, limited) = INFO._replace(reset_cause=m.ResetCause.WATCHDOG).warnings(None, 20.6)
    assert (told, limited) == (f"{hung}; find the cause", slow)
    newer = INFO._replace(reset_cause=m.ResetCause.WATCHDOG).warnings(m.ResetCause.POWER_ON, 0.0)
    assert newer == (), "what it has said since counts"
    assert INFO.processor_fault is NO_FAULT
