"""What a driver of a maker's motor controllers is: pure, frames in and frames out, told the time and asked no clock.

Quantities are those of the wheels' axles, in the order of the robot's channels (``[device] wheels`` says which wheel
each of them drives): a driver knows its maker's units, gear ratio and node ids, and nothing of how the robot is wired.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol

from firmware_protocol.framing import Frame
from hil.core.ports import EXTENDED, REMOTE, Framing
from hil.core.types import NAN, CommandMode, FourWheels

__all__ = [
    "ANSWER_S",
    "EXTENDED",
    "REMOTE",
    "Capabilities",
    "Dialect",
    "Driver",
    "Found",
    "Framing",
    "Probe",
    "RobotFacts",
    "Sample",
    "Sensor",
    "Wire",
    "torques_dropped",
]

Wire = Literal["can", "can_fd", "serial"]
"""What a dialect may be spoken over."""

Sensor = Literal["position", "current", "temperature", "battery_voltage", "battery_current", "gyro", "accelerometer"]
"""What they may measure beside the wheels' speeds."""

NO_CHANNELS: FourWheels = (NAN, NAN, NAN, NAN)


class Capabilities(NamedTuple):
    """What a maker's controllers can do. ``feedback_hz`` is the lowest rate of what odometry rests on.

    ``is_twist``: they take a velocity of the body and close the loop of the wheels themselves. ``adds_torque``: they
    add a torque to a speed. ``watchdog``: whether the wheels stop by themselves when commands end: set and read back by
    the driver, there as the maker's tool has set it, or not as far as is known. ``latches_estop``: a stop of its own,
    that commands do not end.
    """

    modes: frozenset[CommandMode]
    is_twist: bool
    feedback_hz: float
    sensors: frozenset[Sensor]
    adds_torque: bool
    watchdog: Literal["set", "fixed", "none"]
    latches_estop: bool


class RobotFacts(NamedTuple):
    """What a driver is told of the robot beside its own settings, from [robot], [firmware], [loop] and the link.

    ``wire`` is that of ``Dialect.wires`` which the link is, for a maker that speaks differently on each.
    """

    wheel_radius_m: float
    lever_m: float
    wheel_of_channel: tuple[int, ...]
    sign_of_channel: tuple[int, ...]
    torque_limit_n_m: float
    speed_limit_rad_s: float
    torque_constant_n_m_a: float
    watchdog_s: float
    period_s: float
    mode: CommandMode
    wire: Wire = "can"


class Sample(NamedTuple):
    """What the channels measured, NaN where the maker does not say.

    ``stamp_ns`` is when the oldest of the four speeds arrived: a channel that has gone silent makes all of it old, and
    so does a position that comes in messages of its own. Other values are NaN once theirs have fallen silent.
    ``position_rad`` is not wrapped and counts from anywhere.
    """

    stamp_ns: int
    speed_rad_s: FourWheels
    position_rad: FourWheels = NO_CHANNELS
    current_a: FourWheels = NO_CHANNELS
    temperature_degc: FourWheels = NO_CHANNELS
    battery_v: float = NAN
    battery_a: float = NAN
    acceleration_m_s2: tuple[float, float, float] = (NAN, NAN, NAN)
    yaw_rate_rad_s: float = NAN


class Driver(Protocol):
    """Drives four motors, or a base, of one maker.

    The order of a session: ``ask`` until ``identity`` is known, and then while nothing is commanded; ``arm`` once a
    tick until ``is_armed``, ``command`` once a tick, ``disarm``. ``feed`` takes all that arrives, at any time. Nothing
    but ``arm`` may lead to motion, and ``arm`` itself asks for standstill. How old speeds may be to arm by is not the
    driver's business.
    """

    @property
    def capabilities(self) -> Capabilities:
        """What they can do; what only some firmwares can is there until another firmware is known."""

    def ask(self) -> Sequence[Frame]:
        """Return frames that ask who is there and in which version; once that is known, those that ask for the state.

        Nothing moves by them. Who tells the state by itself is not asked for it: a question may feed a watchdog.
        """

    @property
    def identity(self) -> str | None:
        """What answered, in words, with its firmware where it says; None until all that has to answer has.

        Raises BadInputError when it is nothing that this driver can drive, with what to do.
        """

    @property
    def missing(self) -> str:
        """What has not answered ``ask`` yet, in words, and what to check; empty when nothing is missing."""

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences to be said before anything moves, such as that nothing stops the wheels when the host dies."""

    def arm(self, now_ns: int) -> Sequence[Frame]:
        """Return what the next step towards closed loop at standstill needs; called once a tick until ``is_armed``.

        Errors that were there before are not cleared. A watchdog is set first, and read back.
        """

    @property
    def is_armed(self) -> bool:
        """Whether all four follow commands, as far as they say; True ends when one says that it does not."""

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        """Return the frames of a command: in mode SPEED with torques to be added, in mode TORQUE torques alone."""

    def disarm(self) -> Sequence[Frame]:
        """Return what stops the motors and leaves closed loop; also right in any other state, and twice."""

    def estop(self) -> Sequence[Frame]:
        """Return the quickest stop that there is, latched where the maker can."""

    def clear(self) -> Sequence[Frame]:
        """Return what clears the latched errors of the maker's; moves nothing."""

    def feed(self, frame: Frame, stamp_ns: int) -> None:
        """Take a frame that arrived then. One that is not of this maker's, or damaged, changes nothing."""

    @property
    def sample(self) -> Sample | None:
        """The newest measurement of all four channels, None before there is one."""

    @property
    def errors(self) -> Sequence[str]:
        """The errors that the controllers report now, in the maker's terms, with the wheel's name; empty for none."""

    def restart(self) -> None:
        """Forget what was heard: the link was lost, and what answers next may have been reset or exchanged."""


def torques_dropped(title: str) -> str:
    """Return the warning of a driver in mode SPEED whose controllers do not add torques."""
    return (
        f"{title} takes no torque beside a speed: the torques that a law gives ahead of the motion are dropped, and "
        "the wheels follow by their speed loops alone"
    )


class Found(NamedTuple):
    """What a probe has found: a sentence for each device, and the [device.motors] that would drive them.

    ``motors`` is None where what was found is not enough for a robot. ``known`` are values of a robot's file that the
    devices told, ``unknown`` the keys on which the motion depends and that nobody can be asked for; both by their
    dotted names, such as ``robot.wheel_radius_m`` and ``device.motors.gear_ratio``.
    """

    sentences: Sequence[str]
    motors: Mapping[str, Any] | None
    known: Mapping[str, float] = MappingProxyType({})
    unknown: Sequence[str] = ()


ANSWER_S = 0.1
"""``Probe.patience_s`` of devices that answer at once."""


class Probe(Protocol):
    """Finds one maker's devices without moving anything; it hears what comes before its first ``ask`` too."""

    def ask(self) -> Sequence[Frame]:
        """Return what is still to be asked; it reads, and writes nothing. Empty for who speaks by itself."""

    @property
    def patience_s(self) -> float:
        """How long after the newest ``ask`` an answer may still come; 0 when nothing is awaited."""

    def feed(self, frame: Frame) -> bool:
        """Take a frame that arrived, and return whether it may be one of this maker's."""

    def found(self) -> Found | None:
        """Return what answered so far, None while nothing of this maker's has."""


def by_disarming(driver: Driver) -> Sequence[Frame]:
    """Return the last stop of controllers whose disarming is right for that."""
    return driver.disarm()


class Dialect(NamedTuple):
    """One maker's protocol as the registry has it.

    ``settings`` is a dataclass: the options of [device.motors], checked by ``hil.core.options.build``. ``wires`` says
    what it is spoken over: ``can``, ``can_fd`` or ``serial``; ``baud`` is the rate of a serial line as delivered, None
    where there is no such line. ``probe`` is None where nothing can be found without a risk; ``serial_probe`` takes its
    place on a serial line where a dialect that is spoken on a bus too has other questions there. ``watchdog_setting``
    says in words what a driver that has no watchdog without it needs for one, None where nothing gives it one.
    ``last_stop`` returns, of a driver of this dialect, what the guardian sends on a serial line when the host has died:
    it stops them whatever they were told last, and in the middle of a frame too. A setting ``file`` is a path, and an
    absolute one by the time that a driver sees it.
    """

    title: str
    wires: frozenset[Wire]
    settings: type[Any]
    make: Callable[[Any, RobotFacts], Driver]
    make_framing: Callable[[], Framing] | None = None
    probe: Callable[[], Probe] | None = None
    serial_probe: Callable[[], Probe] | None = None
    baud: int | None = None
    watchdog_setting: str | None = None
    last_stop: Callable[[Any], Sequence[Frame]] = by_disarming
