"""Every kind of fault: its place, targets, numbers and effect.

Scenarios, the page and ``hil list`` use this table. Other packages add kinds that act on signals or frames: each is a
``Kind``, registered as an entry point of the group ``hil.faults``.
"""

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol, TypeAlias

from firmware_protocol.codec import encode
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError, nearest
from hil.core.extensions import Extensions
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.options import Range, in_another_unit
from hil.core.signals import SIGNAL_NAMES
from hil.core.types import WHEEL_NAMES
from hil.faults.link_faults import (
    DIRECTIONS,
    Babble,
    BitErrors,
    Delay,
    Disconnect,
    FrameEffect,
    Freeze,
    Jitter,
    LinkFault,
    Reorder,
    Truncation,
)
from hil.faults.rows import FaultRow, generators

Numbers: TypeAlias = Mapping[str, float | None]
"""The numbers of a row by name; None: not given."""
SignalEffect: TypeAlias = Callable[[float, int], float]
"""Takes a signal's value and the scenario's time [ns] inside the window; returns the value that is seen instead."""
ShimRows: TypeAlias = Iterable[Mapping[str, object]]
"""Rows of the C shim between firmware and plant, without their times."""


class FaultyRobot(Protocol):
    """A virtual robot with its plant. Each method returns rows of its shim, or raises BadInputError."""

    def reset(self) -> ShimRows:
        """Switch the firmware off and on."""

    def add_to_gyro(self, bias_rad_s: float) -> ShimRows:
        """Add a constant to the yaw rate."""

    def slow_clock(self, ppm: float) -> ShimRows:
        """Let the firmware's clock run slow."""

    def lose_counts(self, wheel: str, part: float) -> ShimRows:
        """Let the encoder of a wheel miss a part of its counts; 1: all."""

    def stop_motor(self, wheel: str) -> ShimRows:
        """Give the motor of a wheel neither torque nor duty."""

    def set(self, variable: str, value: float) -> ShimRows:
        """Give a variable of the FMU this value."""

    def load(self, row: FaultRow) -> ShimRows:
        """Put the row's payload on the robot."""

    def scale_grip(self, row: FaultRow) -> ShimRows:
        """Multiply the grip of wheels, everywhere or inside the row's circle."""


class Quantity(NamedTuple):
    """A number of a row: its name, unit, range and default; None if the row must give it."""

    name: str
    unit: str
    meaning: str
    low: float
    high: float
    default: float | None = None
    excludes_low: bool = False

    @property
    def range(self) -> str:
        """The range in words."""
        if self.low == -self.high:
            return f"-{self.high:g} to {self.high:g}"
        return (
            f"more than {self.low:g}, at most {self.high:g}" if self.excludes_low else f"{self.low:g} to {self.high:g}"
        )

    def holds(self, value: float) -> bool:
        """Tell whether a value is in range."""
        return self.low <= value <= self.high and not (self.excludes_low and value == self.low)


class Kind(NamedTuple):
    """A kind of fault.

    Attributes:
        acts_on: "link", "device", "plant" or "signal".
        targets: the targets that a row may name; empty where only the FMU knows them.
        target_words: the targets in words, for the page.
        meaning: what happens.
        counts: what the number ``applied`` in reports counts.
        example: the rest of a row, for the page.
        value: the row's ``value``, None for a kind without one.
        further: its other numbers, of which a row gives all or none.
        is_instant: it happens at start_s and has no end.
        explains: it can interrupt feedback, state or robot, so ticks in which the robot is not driven are put down to
            it.
        on_signal: for a kind that changes a value: called as ``on_signal(row, chance)`` once for each row, returns its
            effect. ``applied`` then counts the changed values.
        on_frames: the same for a kind that loses, doubles or replaces frames.
        on_link: for a kind that does something else to a link: the class of its rows.
        on_robot: for a kind of the robot or its plant: called as ``on_robot(robot, row)``, returns rows of its shim.
        fits: raises ValueError, with part of a message, for a target and numbers that do not fit together.
        message: the message of our protocol that it sends, so that motors of other makers refuse it; empty for none.
        sensor: the sensor on which it acts, so that a robot without it refuses it; empty for none.
    """

    name: str
    acts_on: str
    targets: tuple[str, ...]
    target_words: str
    meaning: str
    counts: str
    example: Mapping[str, str | float]
    value: Quantity | None = None
    further: tuple[Quantity, ...] = ()
    is_instant: bool = False
    explains: bool = False
    on_signal: Callable[[FaultRow, random.Random], SignalEffect] | None = None
    on_frames: Callable[[FaultRow, random.Random], FrameEffect] | None = None
    on_link: type[LinkFault] | None = None
    on_robot: Callable[[FaultyRobot, FaultRow], ShimRows] | None = None
    fits: Callable[[str, Numbers], None] | None = None
    message: str = ""
    sensor: str = ""

    @property
    def unit(self) -> str:
        """The unit of ``value`` in words."""
        return "-" if self.value is None else self.value.unit or self.value.meaning

    @property
    def delays(self) -> bool:
        """Whether frames arrive later by at most ``value`` [s]."""
        return self.on_link is not None and self.on_link.delays

    def check(self, target: str, given: Numbers) -> None:
        """Raise ValueError, with part of a message, unless a row's target and numbers fit the kind.

        Whether the run has a signal of this name is checked with the scenario.
        """
        self._check_target(target)
        self._check_numbers(given)
        if self.fits is not None:
            self.fits(target, given)

    def _check_target(self, target: str) -> None:
        if self.acts_on == "signal":
            if target in SIGNAL_NAMES and target not in self.targets:
                raise ValueError(f"target = {target!r} is not a target of {self.name}; it is the time of the run")
        elif self.targets and target not in self.targets:
            expected = f"; expected {self.target_words.replace('`', '')}" if len(self.targets) > 12 else None
            hint = nearest(target, self.targets, expected)
            raise ValueError(f"target = {target!r} is not a target of {self.name}{hint}")

    def _check_numbers(self, given: Numbers) -> None:
        known = {q.name: q for q in (self.value, *self.further) if q is not None}
        for name, value in given.items():
            quantity = known.get(name)
            if quantity is None:
                if value is not None:
                    raise ValueError(f"{name} = {value:g}: {self.name} takes no {name}; remove it")
            elif value is not None and not quantity.holds(value):
                unit = f" {quantity.unit}" if quantity.unit else ""
                hint = in_another_unit(f"value_{quantity.unit}", value, Range(ge=quantity.low, le=quantity.high))
                raise ValueError(f"{name} = {value:g}: expected {quantity.range}{unit}, the {quantity.meaning}{hint}")
        if self.value is not None and given["value"] is None:
            raise ValueError(f"value is missing: {self.value.meaning}, {self.value.range} {self.value.unit}".rstrip())
        further = [quantity.name for quantity in self.further]
        if len({given[name] is None for name in further}) > 1:
            raise ValueError(f"{', '.join(further)} belong together; give all or none")


MESSAGES = tuple(name for number, name in WHEEL_DBC.names.items() if number < WHEEL_DBC.exempt_from)
PUSHES = ("force_x_n", "force_y_n", "moment_n_m")
# loop.t_s is the time axis by which faults and expectations are placed, so no fault may change it.
FAULTY_SIGNALS = tuple(name for name in SIGNAL_NAMES if name != "loop.t_s")
BATTERY_VARIABLE = "battery_voltage_v"
BATTERY_V = 24.0
"""What the shipped plant's battery has where a scenario names no other."""
GRIP_VARIABLES = tuple(f"wheel.{wheel}.grip_factor" for wheel in WHEEL_NAMES)


_FRAMES = (*DIRECTIONS, *MESSAGES)
_FRAMES_WORDS = "`command` (to the robot), `feedback` (from it), or one message such as `WHEEL_COMMAND`"
_MESSAGE_WORDS = "one message such as `WHEEL_COMMAND` or `TICK`"
_WHEEL_WORDS = "a wheel: `fl`, `fr`, `rr` or `rl`"
_SIGNAL_WORDS = "any signal of `hil list signals` except `loop.t_s`"
_ANY = 1e9


def _by_chance(change: Callable[[list[Frame]], list[Frame]]) -> Callable[[FaultRow, random.Random], FrameEffect]:
    """Return an effect on frames that applies ``change`` to each frame with the probability ``value``."""

    def make(row: FaultRow, chance: random.Random) -> FrameEffect:
        return lambda _direction, frames: change(frames) if chance.random() < row.value else frames

    return make


def _bursts(row: FaultRow, chance: random.Random) -> FrameEffect:
    """Lose each frame in the bad state of a Gilbert-Elliott chain; each direction has its own chain."""
    bad: set[str] = set()

    def effect(direction: str, frames: list[Frame]) -> list[Frame]:
        share, length = row.value, row.burst_frames
        probability = 1.0 - 1.0 / length if direction in bad else share / (length * (1.0 - share))
        if chance.random() < probability:
            bad.add(direction)
            return []
        bad.discard(direction)
        return frames

    return effect


def _estop(_row: FaultRow, _chance: random.Random) -> FrameEffect:
    """Put one ESTOP before the next frame to the robot."""
    pressed = [encode(m.Estop(source=0, reason=0))]

    def effect(_direction: str, frames: list[Frame]) -> list[Frame]:
        return [pressed.pop(), *frames] if pressed else frames

    return effect


def _check_burst(_target: str, given: Numbers) -> None:
    share, burst = given["value"], given["burst_frames"]
    if share is not None and burst is not None and share > burst / (burst + 1.0):
        raise ValueError(
            f"value = {share:g}: bursts of {burst:g} frames with one whole frame between them lose "
            f"{burst / (burst + 1.0):.3g}; lower value, or raise burst_frames"
        )


def _check_quantity(target: str, _given: Numbers) -> None:
    if target == "robot.state":
        raise ValueError("target = 'robot.state' is not a quantity; use override with the number of a state")


def _check_state(target: str, given: Numbers) -> None:
    value = given["value"]
    if target == "robot.state" and value not in list(m.State):
        known = ", ".join(f"{state.value} {state.name}" for state in m.State)
        raise ValueError(f"value = {value} is not a state of the firmware; expected one of {known}")


def _probability(of: str) -> Quantity:
    return Quantity("value", "", f"probability that a frame is {of}", 0.0, 1.0, 1.0, excludes_low=True)


KINDS: tuple[Kind, ...] = (
    Kind("drop", "link", _FRAMES, _FRAMES_WORDS, "Frames are lost, independently of each other.", "frames lost",
         {"target": "command", "start_s": 1.0, "end_s": 2.0, "value": 0.2}, _probability("lost"), explains=True,
         on_frames=_by_chance(lambda _frames: [])),
    Kind("burst_loss", "link", _FRAMES, _FRAMES_WORDS,
         "Frames are lost in bursts (Gilbert-Elliott model): every frame in the bad state, none in the good state.",
         "frames lost", {"target": "feedback", "value": 0.1, "burst_frames": 8.0},
         Quantity("value", "", "share of the frames that is lost on average", 0.0, 0.99, excludes_low=True),
         (Quantity("burst_frames", "frames", "mean length of a burst", 1.0, 10_000.0, 5.0),), explains=True,
         on_frames=_bursts, fits=_check_burst),
    Kind("delay", "link", _FRAMES, _FRAMES_WORDS, "Frames arrive later, in order, by whole milliseconds, rounded up.",
         "frames delayed", {"target": "command", "start_s": 1.0, "value": 0.01},
         Quantity("value", "s", "delay", 0.0, 10.0, excludes_low=True), explains=True, on_link=Delay),
    Kind("jitter", "link", _FRAMES, _FRAMES_WORDS,
         "Each frame arrives later by a random delay, uniform from 0 to the value and rounded up to whole "
         "milliseconds. The order of the frames stays.", "frames delayed", {"target": "feedback", "value": 0.004},
         Quantity("value", "s", "longest delay", 0.0, 10.0, excludes_low=True), explains=True, on_link=Jitter),
    Kind("duplicate", "link", _FRAMES, _FRAMES_WORDS, "Frames arrive twice, the second right after the first.",
         "frames doubled", {"target": "command", "value": 0.5}, _probability("doubled"), explains=True,
         on_frames=_by_chance(lambda frames: frames * 2)),
    Kind("reorder", "link", _FRAMES, _FRAMES_WORDS,
         "A frame is overtaken by the next one of the target. If none follows, it arrives when the window ends.",
         "frames overtaken", {"target": "command", "value": 0.1}, _probability("overtaken"), explains=True,
         on_link=Reorder),
    Kind("bit_errors", "link", _FRAMES, _FRAMES_WORDS,
         "Serial and memory: bits of the encoded frames flip; by COBS, CRC and length the receiver drops nearly all of "
         "these. CAN: a frame with a wrong bit is destroyed by an error frame, which is counted, and the controller "
         "sends it again until it arrives whole. The time that this takes, about 0.15 ms at 1 Mbit/s, is not modelled. "
         "The transmit error counter of a controller rises by 8 for a destroyed frame and falls by 1 for a whole one. "
         "At 256 the controller is bus-off: the host then loses its link; the robot loses the frame and recovers.",
         "frames with a wrong bit; on CAN the error frames", {"target": "feedback", "value": 0.0005},
         Quantity("value", "", "bit error rate", 0.0, 0.5, excludes_low=True), explains=True, on_link=BitErrors),
    Kind("truncation", "link", _FRAMES, _FRAMES_WORDS,
         "Serial and memory: the end of the encoded frame is missing, with the zero byte that ends it. The next frame "
         "is then spoilt too, except a lockstep message. CAN: the frame has a DLC that is too small.", "frames cut",
         {"target": "command", "value": 0.05}, _probability("cut"), explains=True, on_link=Truncation),
    Kind("disconnect", "link", ("link",), "`link`, the default",
         "The link is lost: commands cannot be sent, no feedback arrives, and delayed frames are discarded. By default "
         "this ends the run. With loop.rearm = true the link is opened again, which fails until the window is over. In "
         "lockstep STEP still passes, so robot time goes on.", "attempts to use the link",
         {"start_s": 2.0, "end_s": 2.5}, explains=True, on_link=Disconnect),
    Kind("mute", "link", MESSAGES, _MESSAGE_WORDS, "Every frame of one message is lost.", "frames lost",
         {"target": "TICK", "start_s": 2.0, "end_s": 2.02}, explains=True,
         on_frames=lambda _row, _chance: lambda _direction, _frames: []),
    Kind("freeze", "link", _FRAMES, _FRAMES_WORDS,
         "Frames carry old content: of the newest frame of their message before the window.", "frames with old content",
         {"target": "feedback", "start_s": 3.0, "end_s": 3.05}, explains=True, on_link=Freeze),
    Kind("estop", "link", ("command",), "`command`, the default",
         "Somebody presses the emergency stop: another program or board on the wire sends ESTOP to the robot, once.",
         "ESTOP messages", {"start_s": 2.0}, is_instant=True, explains=True, on_frames=_estop, message="ESTOP"),
    Kind("babble", "link", DIRECTIONS, "`command` (towards the robot) or `feedback`; on CAN both ends hear either",
         "Another sender is on the wire. Serial and memory: alternately garbage bytes, which spoil the next frame, and "
         "whole frames with foreign ids. CAN: frames with foreign ids from another node on the bus.",
         "foreign frames and pieces of garbage", {"target": "command", "value": 200.0},
         Quantity("value", "1/s", "number per second", 0.0, 100_000.0, excludes_low=True), explains=True,
         on_link=Babble),
    Kind("reset", "device", ("robot",), "`robot`",
         "The firmware is powered off at start_s and on again. The plant goes on moving, with the drives off. STATUS "
         "reports POWER_ON as the cause.", "resets", {"target": "robot", "start_s": 4.0}, is_instant=True,
         explains=True, on_robot=lambda robot, _row: robot.reset()),
    Kind("stuck_encoder", "device", WHEEL_NAMES, _WHEEL_WORDS,
         "The encoder stops counting. Counts that it misses stay missing.", "ticks of 1 ms in which counts were lost",
         {"target": "fl", "start_s": 2.0, "end_s": 2.05}, explains=True,
         on_robot=lambda robot, row: robot.lose_counts(row.target, 1.0)),
    Kind("lost_counts", "device", WHEEL_NAMES, _WHEEL_WORDS,
         "The encoder misses a part of its counts, evenly. They stay missing.",
         "ticks of 1 ms in which the wheel's count changed",
         {"target": "rl", "start_s": 2.0, "end_s": 4.0, "value": 0.02},
         Quantity("value", "", "part of the counts that is lost", 0.0, 1.0, excludes_low=True), explains=True,
         on_robot=lambda robot, row: robot.lose_counts(row.target, row.value)),
    Kind("dead_motor", "device", WHEEL_NAMES, _WHEEL_WORDS, "The motor gets neither torque nor duty.",
         "ticks of 1 ms in which it would have got some", {"target": "rr", "start_s": 2.0},
         on_robot=lambda robot, row: robot.stop_motor(row.target)),
    Kind("low_battery", "device", ("battery",), "`battery`, the default",
         f"The battery has this voltage without load, set by the FMU's tunable parameter {BATTERY_VARIABLE}. If "
         "`plant.start.drive` is `torque`, the default, only the measured voltage falls.", "ticks of 1 ms",
         {"start_s": 2.0, "value": 17.0}, Quantity("value", "V", "voltage without load", 0.0, 10_000.0), explains=True,
         on_robot=lambda robot, row: robot.set(BATTERY_VARIABLE, row.value)),
    Kind("gyro_bias", "device", ("gyro",), "`gyro`, the default", "A constant is added to the gyro's yaw rate.",
         "ticks of 1 ms", {"start_s": 1.0, "value": 0.05}, Quantity("value", "rad/s", "bias", -100.0, 100.0),
         explains=True, on_robot=lambda robot, row: robot.add_to_gyro(row.value), sensor="gyro"),
    Kind("slow_clock", "device", ("clock",), "`clock`, the default",
         "The robot's clock runs slow: at intervals it does not count 1 ms of the time that passes.",
         "milliseconds that it missed", {"value": 1000.0},
         Quantity("value", "ppm", "how slow", 0.0, 100_000.0, excludes_low=True), explains=True,
         on_robot=lambda robot, row: robot.slow_clock(row.value)),
    Kind("parameter", "plant", (), "a tunable parameter, or an unused input, of the FMU (`hil fmu info`)",
         "A variable of the plant has this value.", "ticks of 1 ms",
         {"target": "friction_coefficient", "start_s": 3.0, "value": 0.1},
         Quantity("value", "the variable's", "value", -_ANY, _ANY),
         on_robot=lambda robot, row: robot.set(row.target, row.value)),
    Kind("push", "plant", PUSHES, "`force_x_n`, `force_y_n` or `moment_n_m`",
         "The robot is pushed at its centre: by a force in the world frame, or by a moment about the vertical axis.",
         "ticks of 1 ms", {"target": "force_y_n", "start_s": 3.0, "end_s": 3.2, "value": 40.0},
         Quantity("value", "N or N·m", "force or moment", -1e6, 1e6),
         on_robot=lambda robot, row: robot.set(f"push.{row.target}", row.value)),
    Kind("payload", "plant", ("robot",), "`robot`, the default",
         "A mass lies on the robot, at a point of the body frame (ahead of its centre, to the left of it) and as high "
         "as its centre of mass. It changes mass_kg, inertia_kg_m2, com_x_m and com_y_m of the FMU. A second row, "
         "whose window follows, has moved it.", "ticks of 1 ms",
         {"start_s": 2.0, "end_s": 4.0, "value": 5.0, "x_m": 0.1, "y_m": -0.05},
         Quantity("value", "kg", "mass", 0.0, 10_000.0, excludes_low=True),
         (Quantity("x_m", "m", "ahead of the robot's centre", -10.0, 10.0, 0.0),
          Quantity("y_m", "m", "to the left of the robot's centre", -10.0, 10.0, 0.0)),
         on_robot=lambda robot, row: robot.load(row)),
    Kind("lifted_wheel", "plant", WHEEL_NAMES, _WHEEL_WORDS,
         "The ground does not reach the wheel, and the others carry all. Needs an FMU with wheel.*.lifted and blocks.",
         "ticks of 1 ms", {"target": "fr", "start_s": 2.0, "end_s": 2.5},
         on_robot=lambda robot, row: (*robot.set(f"wheel.{row.target}.lifted", 1.0), *robot.set("blocks", 0.0))),
    Kind("slip_patch", "plant", ("floor",), "`floor`, the default",
         "The floor has less grip: everywhere or, if a circle is given, for each wheel whose centre is inside. Needs "
         'an FMU with wheel.*.grip_factor; the shipped one has it with contact = "slip".',
         "ticks of 1 ms in which a wheel was on the patch", {"value": 0.2, "x_m": 1.0, "y_m": 0.5, "radius_m": 0.4},
         Quantity("value", "", "factor of the grip", 0.0, 1.0),
         (Quantity("x_m", "m", "centre, world frame", -_ANY, _ANY),
          Quantity("y_m", "m", "centre, world frame", -_ANY, _ANY),
          Quantity("radius_m", "m", "radius", 0.0, _ANY, excludes_low=True)),
         on_robot=lambda robot, row: robot.scale_grip(row)),
    Kind("bias", "signal", FAULTY_SIGNALS, _SIGNAL_WORDS, "A constant is added to the signal.",
         "ticks in which the value changed", {"target": "truth.x_m", "start_s": 2.0, "end_s": 3.0, "value": 0.05},
         Quantity("value", "the signal's", "value that is added", -_ANY, _ANY), explains=True,
         on_signal=lambda row, _chance: lambda value, _t_ns: value + row.value, fits=_check_quantity),
    Kind("override", "signal", FAULTY_SIGNALS, _SIGNAL_WORDS, "The signal is replaced by this value.",
         "ticks in which the value changed",
         {"target": "wheel.fl.speed_command_rad_s", "start_s": 2.0, "end_s": 2.1, "value": 3.0},
         Quantity("value", "the signal's", "value", -_ANY, _ANY), explains=True,
         on_signal=lambda row, _chance: lambda _value, _t_ns: row.value, fits=_check_state),
    Kind("reset", "signal", FAULTY_SIGNALS, _SIGNAL_WORDS,
         "Ends every bias and override of the signal that began before start_s. They do not resume.",
         "biases and overrides in force that it ended", {"target": "truth.x_m", "start_s": 2.5}, is_instant=True,
         explains=True),
)  # fmt: skip

_EXTENSIONS = Extensions("hil.faults", [kind.name for kind in KINDS])


def kinds() -> tuple[Kind, ...]:
    """Return every kind: the shipped ones, then those of other packages.

    Raises BadInputError when another package's kind cannot be loaded, or does not act on signals or frames.
    """
    found = list(KINDS)
    for named, point, kind in _EXTENSIONS.load_all("fault"):
        if not isinstance(kind, Kind) or kind.name != point.name:
            raise BadInputError(f"{named}: {point.value!r} is {kind!r}; expected a hil.faults.kinds.Kind of this name")
        if kind.name in names(KINDS):
            raise BadInputError(f"{named}: the name is already in use; choose another")
        effects = {"signal": kind.on_signal, "link": kind.on_frames}
        if effects.get(kind.acts_on) is None or kind.is_instant:
            expected = "expected 'signal' with on_signal, or 'link' with on_frames, and a window"
            raise BadInputError(f"{named}: acts_on = {kind.acts_on!r}; {expected}")
        found.append(kind)
    return tuple(found)


def names(some: tuple[Kind, ...] | None = None) -> tuple[str, ...]:
    """Return the names of the kinds, by default of all, each once."""
    return tuple(dict.fromkeys(kind.name for kind in (kinds() if some is None else some)))


def is_instant(name: str, target: str) -> bool:
    """Return whether a fault only happens, at its beginning. Of other packages' kinds none does."""
    return any(kind.is_instant and kind.name == name and target in kind.targets for kind in KINDS)


def find(name: str, target: str | None) -> Kind:
    """Return the kind of fault with this name; if there are several, the one that can act on the target.

    Raises ValueError for an unknown name; its text is a part of a message.
    """
    same = [kind for kind in kinds() if kind.name == name]
    if not same:
        raise ValueError(f"kind = {name!r} is not a kind of fault{nearest(name, names())}")
    return next((kind for kind in same if target in kind.targets), same[-1])


def link_faults(rows: Sequence[FaultRow], seed: int, protocol: LinkProtocol = WHEEL_DBC) -> list[LinkFault]:
    """Return rows that act on a link, each with a random generator and a count."""
    return [_link_fault(*one, protocol) for one in zip(rows, generators(rows, seed), strict=True)]


def _link_fault(row: FaultRow, chance: random.Random, protocol: LinkProtocol) -> LinkFault:
    kind = find(row.kind, row.target)
    if kind.on_link is not None:
        return kind.on_link(row, chance, protocol)
    assert kind.on_frames is not None, "a kind of the link"
    return LinkFault(row, chance, protocol, kind.on_frames(row, chance))
