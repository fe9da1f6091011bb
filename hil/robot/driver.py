"""The interface of a driver for another maker's motors: frames in and out, no I/O; times come as arguments.

Quantities are those of the wheels' axles, in the order of the robot's channels (``[device] wheels`` says which wheel
each channel drives). A driver knows its maker's units, gear ratio and node ids, and nothing of the robot's wiring.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar

from firmware_protocol.framing import Frame
from hil.core.errors import DeviceError
from hil.core.ports import EXTENDED as EXTENDED
from hil.core.ports import REMOTE as REMOTE
from hil.core.ports import Framing as Framing
from hil.core.types import NAN, CommandMode, FourWheels

Wire = Literal["can", "can_fd", "serial"]
Sensor = Literal["position", "current", "temperature", "battery_voltage", "battery_current", "gyro", "accelerometer"]
"""What controllers may measure beside the wheels' speeds."""

NO_CHANNELS: FourWheels = (NAN, NAN, NAN, NAN)


class Capabilities(NamedTuple):
    """What a maker's controllers can do.

    Attributes:
        feedback_hz: the lowest rate of the measurements that odometry uses.
        sensors: their measurements in addition to the speeds.
        modes: the commands that they take.
        is_twist: they take a velocity of the body, and close the wheels' loops themselves.
        adds_torque: they add a torque to a speed.
        watchdog: whether the wheels stop by themselves when commands end. "set": the driver sets it and reads it back.
            "fixed": it is as the maker's tool has set it. "none": no watchdog is known.
        latches_estop: they have a stop that later commands do not end.
    """

    feedback_hz: float
    sensors: frozenset[Sensor]
    modes: frozenset[CommandMode] = frozenset(CommandMode)
    is_twist: bool = False
    adds_torque: bool = False
    watchdog: Literal["set", "fixed", "none"] = "none"
    latches_estop: bool = False


class RobotFacts(NamedTuple):
    """The robot's data that a driver gets in addition to its settings: of [robot], [firmware], [loop] and the link.

    ``wire`` is the kind of the link, one of ``Dialect.wires``. ``turning_share`` is the inertia that a wheel
    accelerates when the robot turns, over that when it is pushed.
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
    turning_share: float = 1.0


class Sample(NamedTuple):
    """The measurements of the four channels; NaN for one that the maker does not have, or that is too old.

    ``stamp_ns`` is when the oldest of the four speeds arrived, so that one silent channel makes the whole sample old.
    So does a silent position that has messages of its own. ``position_rad`` is not wrapped and may begin anywhere.
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


class DriverError(DeviceError):
    """A driver of another package has failed during a run; the message names the package and the line of its code."""


class Driver(ABC):
    """Drives four motors, or a base, of one maker. A maker's class derives from it.

    The order of a session: ``ask`` until ``identity`` is known, and later while nothing is commanded; ``arm`` once a
    tick until ``is_armed``; ``command`` once a tick; ``disarm``. ``feed`` may come at any time. Only ``arm`` may lead
    to motion, and ``arm`` itself commands standstill. The caller checks how old the speeds are before it arms.
    """

    _capabilities: Capabilities  # for ``capabilities``, of a class that does not define it
    _warnings: Sequence[str] = ()
    _is_armed = False

    @property
    def capabilities(self) -> Capabilities:
        """What the controllers can do. What only some firmwares can is included until the firmware is known."""
        return self._capabilities

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences for the user before anything moves, such as that nothing stops the wheels when the host dies."""
        return self._warnings

    def ask(self) -> Sequence[Frame]:
        """Return frames that ask for identity and version; once these are known, frames that ask for the state.

        They move nothing. A controller that sends its state unasked is not asked: that may feed its watchdog.
        """
        return ()

    @property
    @abstractmethod
    def identity(self) -> str | None:
        """The devices that answered, as text, with the firmware if known; None until all have answered.

        Raises BadInputError for something that this driver cannot drive, with what to do.
        """

    @property
    def missing(self) -> str:
        """The devices that have not answered ``ask`` yet; then after a semicolon what to check. Empty if all have.

        If frames arrived that do not fit, the user reads these in place of what to check.
        """
        return ""

    @abstractmethod
    def arm(self, now_ns: int) -> Sequence[Frame]:
        """Return the frames of the next step towards closed loop at standstill; called once a tick until ``is_armed``.

        Errors from before are not cleared. A watchdog is set first, and read back.
        """

    @property
    def is_armed(self) -> bool:
        """Whether all four follow commands, as far as they report; ends as soon as one reports that it does not."""
        return self._is_armed

    @abstractmethod
    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        """Return the frames of a command: in mode SPEED with torques to be added, in mode TORQUE torques alone."""

    @abstractmethod
    def disarm(self) -> Sequence[Frame]:
        """Return frames that stop the motors and leave closed loop; valid in any state, and repeatedly."""

    def estop(self) -> Sequence[Frame]:
        """Return the frames of the quickest stop, latched where the maker can do that."""
        return self.disarm()

    def last_stop(self) -> Sequence[Frame]:
        """Return what the guardian sends on a serial line when the host has died.

        It stops the motors in any state, and also in the middle of an unfinished frame.
        """
        return self.disarm()

    def clear(self) -> Sequence[Frame]:
        """Return frames that clear the maker's latched errors; they move nothing."""
        return ()

    @abstractmethod
    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        """Take a frame that arrived at ``stamp_ns``. A foreign or damaged frame changes nothing.

        Return why it was not used, in words such as "7 bytes, expected 8"; empty words for a frame of somebody else,
        and None for one that was used. The user reads them where something is ``missing``.
        """

    @property
    @abstractmethod
    def sample(self) -> Sample | None:
        """The newest measurement of all four channels, None before the first."""

    @property
    def errors(self) -> Sequence[str]:
        """The errors reported now, in the maker's terms, with the wheel's name; empty for none."""
        return ()

    def restart(self) -> None:
        """Forget what was received: the link was lost, and the controllers may have been reset or exchanged."""
        self._is_armed = False


class Found(NamedTuple):
    """The result of a probe: a sentence for each device, and the [device.motors] that would drive them.

    ``motors`` is None if the devices found do not make a robot. ``known`` are values of a robot's file that the devices
    reported. ``unknown`` are keys that the motion depends on and no device can report. Both use dotted names, such as
    ``robot.wheel_radius_m`` and ``device.motors.gear_ratio``.
    """

    sentences: Sequence[str]
    motors: Mapping[str, Any] | None
    known: Mapping[str, float] = MappingProxyType({})
    unknown: Sequence[str] = ()


ANSWER_S = 0.1
"""``Probe.patience_s`` of devices that answer at once."""


class Probe(ABC):
    """Finds one maker's devices without moving anything. It also gets frames that came before its first ``ask``."""

    @property
    def patience_s(self) -> float:
        """How long after the newest ``ask`` an answer may still come [s]; 0 when no answer is expected."""
        return 0.0

    def ask(self) -> Sequence[Frame]:
        """Return the questions that are left. They read, and write nothing; none for devices that speak unasked."""
        return ()

    @abstractmethod
    def feed(self, frame: Frame) -> bool:
        """Take a frame that arrived, and return whether it may be one of this maker's."""

    @abstractmethod
    def found(self) -> Found | None:
        """Return what answered so far, None while nothing of this maker's has."""


@dataclass(frozen=True)
class Dialect:
    """One maker's protocol: all that ``[device] driver = "NAME"`` brings. Others register one in ``hil.drivers``.

    Attributes:
        title: what messages call the motors.
        wires: the kinds of link that it is spoken over.
        settings: a dataclass of options for [device.motors], checked by ``hil.core.options.build``. An option ``file``
            is a path, made absolute before a driver sees it.
        make: makes the driver of the settings and the robot. Raises BadInputError if they contradict each other.
        emulated: the emulated device, as "package.module:Class" of an ``hil.robot.virtual.ClockedNode``, such as a
            subclass of ``hil.addons.motors.emulated_motors.EmulatedMotors``; it is imported when used.
        make_framing: the framing of a serial line, None without one. baud: its rate as delivered.
        probe: finds the devices, None if that cannot be done without risk. serial_probe: the probe for a serial line,
            where the questions differ from those on a bus.
        description: of the devices, for ``hil list drivers``; empty if the title is enough.
    """

    facts: ClassVar[type[RobotFacts]] = RobotFacts

    title: str
    wires: frozenset[Wire]
    settings: type[Any]
    make: Callable[[Any, RobotFacts], Driver]
    emulated: str
    make_framing: Callable[[], Framing] | None = None
    probe: Callable[[], Probe] | None = None
    serial_probe: Callable[[], Probe] | None = None
    baud: int | None = None
    description: str = ""

    def wire_of(self, wire: Wire | None) -> Wire:
        """Return the kind of wire of a link; None is a link within the process, which can be any of ours."""
        return wire or ("serial" if "serial" in self.wires else min(self.wires))


# Helpers of the drivers

_Any = TypeVar("_Any")
_Number = TypeVar("_Number", int, float)


def four(values: Iterable[_Any]) -> tuple[_Any, _Any, _Any, _Any]:
    """Return the values, one for each channel or wheel, as a tuple. Raises ValueError unless there are four."""
    a, b, c, d = values
    return a, b, c, d


def clamp(value: _Number, most: _Number, least: _Number | None = None) -> _Number:
    """Return a value limited to the range from ``least``, by default -``most``, to ``most``. NaN stays NaN."""
    return min(max(value, -most if least is None else least), most)
