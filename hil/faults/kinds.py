"""Every kind of fault as data: where and on what it acts, its unit and range, and its effect.

Scenarios, the page and ``hil list`` use this table. Other packages add kinds that act on signals or frames: each is a
``Kind``, registered as an entry point of the group ``hil.faults``.
"""

import random
from collections.abc import Callable

from firmware_protocol.codec import encode
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.errors import BadInputError, nearest
from hil.core.extensions import Extensions
from hil.core.link_protocol import WHEEL_DBC
from hil.core.signals import SIGNAL_NAMES
from hil.core.types import WHEEL_NAMES
from hil.faults.kind import FaultRow, FrameEffect, Kind, Quantity

DIRECTIONS = ("command", "feedback")
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
         on_frames=_bursts),
    Kind("delay", "link", _FRAMES, _FRAMES_WORDS, "Frames arrive later, in order, by whole milliseconds, rounded up.",
         "frames delayed", {"target": "command", "start_s": 1.0, "value": 0.01},
         Quantity("value", "s", "delay", 0.0, 10.0, excludes_low=True), explains=True),
    Kind("jitter", "link", _FRAMES, _FRAMES_WORDS,
         "Each frame arrives later by a random delay, uniform from 0 to the value and rounded up to whole "
         "milliseconds. The order of the frames stays.", "frames delayed", {"target": "feedback", "value": 0.004},
         Quantity("value", "s", "longest delay", 0.0, 10.0, excludes_low=True), explains=True),
    Kind("duplicate", "link", _FRAMES, _FRAMES_WORDS, "Frames arrive twice, the second right after the first.",
         "frames doubled", {"target": "command", "value": 0.5}, _probability("doubled"), explains=True,
         on_frames=_by_chance(lambda frames: frames * 2)),
    Kind("reorder", "link", _FRAMES, _FRAMES_WORDS,
         "A frame is overtaken by the next one of the target. If none follows, it arrives when the window ends.",
         "frames overtaken", {"target": "command", "value": 0.1}, _probability("overtaken"), explains=True),
    Kind("bit_errors", "link", _FRAMES, _FRAMES_WORDS,
         "Serial and memory: bits of the encoded frames flip; by COBS, CRC and length the receiver drops nearly all of "
         "these. CAN: a frame with a wrong bit is destroyed by an error frame, which is counted, and the controller "
         "sends it again until it arrives whole. The time that this takes, about 0.15 ms at 1 Mbit/s, is not modelled. "
         "The transmit error counter of a controller rises by 8 for a destroyed frame and falls by 1 for a whole one. "
         "At 256 the controller is bus-off: the host then loses its link; the robot loses the frame and recovers.",
         "frames with a wrong bit; on CAN the error frames", {"target": "feedback", "value": 0.0005},
         Quantity("value", "", "bit error rate", 0.0, 0.5, excludes_low=True), explains=True),
    Kind("truncation", "link", _FRAMES, _FRAMES_WORDS,
         "Serial and memory: the end of the encoded frame is missing, with the zero byte that ends it. The next frame "
         "is then spoilt too, except a lockstep message. CAN: the frame has a DLC that is too small.", "frames cut",
         {"target": "command", "value": 0.05}, _probability("cut"), explains=True),
    Kind("disconnect", "link", ("link",), "`link`, the default",
         "The link is lost: commands cannot be sent, no feedback arrives, and delayed frames are discarded. By default "
         "this ends the run. With loop.rearm = true the link is opened again, which fails until the window is over. In "
         "lockstep STEP still passes, so robot time goes on.", "attempts to use the link",
         {"start_s": 2.0, "end_s": 2.5}, explains=True),
    Kind("mute", "link", MESSAGES, _MESSAGE_WORDS, "Every frame of one message is lost.", "frames lost",
         {"target": "TICK", "start_s": 2.0, "end_s": 2.02}, explains=True,
         on_frames=lambda _row, _chance: lambda _direction, _frames: []),
    Kind("freeze", "link", _FRAMES, _FRAMES_WORDS,
         "Frames carry old content: of the newest frame of their message before the window.", "frames with old content",
         {"target": "feedback", "start_s": 3.0, "end_s": 3.05}, explains=True),
    Kind("estop", "link", ("command",), "`command`, the default",
         "Somebody presses the emergency stop: another program or board on the wire sends ESTOP to the robot, once.",
         "ESTOP messages", {"start_s": 2.0}, is_instant=True, explains=True, on_frames=_estop),
    Kind("babble", "link", DIRECTIONS, "`command` (towards the robot) or `feedback`; on CAN both ends hear either",
         "Another sender is on the wire. Serial and memory: alternately garbage bytes, which spoil the next frame, and "
         "whole frames with foreign ids. CAN: frames with foreign ids from another node on the bus.",
         "foreign frames and pieces of garbage", {"target": "command", "value": 200.0},
         Quantity("value", "1/s", "number per second", 0.0, 100_000.0, excludes_low=True), explains=True),
    Kind("reset", "device", ("robot",), "`robot`",
         "The firmware is powered off at start_s and on again. The plant goes on moving, with the drives off. STATUS "
         "reports POWER_ON as the cause.", "resets", {"target": "robot", "start_s": 4.0}, is_instant=True,
         explains=True),
    Kind("stuck_encoder", "device", WHEEL_NAMES, _WHEEL_WORDS,
         "The encoder stops counting. Counts that it misses stay missing.", "ticks of 1 ms in which counts were lost",
         {"target": "fl", "start_s": 2.0, "end_s": 2.05}, explains=True),
    Kind("dead_motor", "device", WHEEL_NAMES, _WHEEL_WORDS, "The motor gets neither torque nor duty.",
         "ticks of 1 ms in which it would have got some", {"target": "rr", "start_s": 2.0}),
    Kind("low_battery", "device", ("battery",), "`battery`, the default",
         f"The battery has this voltage without load, set by the FMU's tunable parameter {BATTERY_VARIABLE}. If "
         "`plant.start.drive` is `torque`, the default, only the measured voltage falls.", "ticks of 1 ms",
         {"start_s": 2.0, "value": 17.0}, Quantity("value", "V", "voltage without load", 0.0, 10_000.0), explains=True),
    Kind("gyro_bias", "device", ("gyro",), "`gyro`, the default", "A constant is added to the gyro's yaw rate.",
         "ticks of 1 ms", {"start_s": 1.0, "value": 0.05}, Quantity("value", "rad/s", "bias", -100.0, 100.0),
         explains=True),
    Kind("slow_clock", "device", ("clock",), "`clock`, the default",
         "The robot's clock runs slow: at intervals it does not count 1 ms of the time that passes.",
         "milliseconds that it missed", {"value": 1000.0},
         Quantity("value", "ppm", "how slow", 0.0, 100_000.0, excludes_low=True), explains=True),
    Kind("parameter", "plant", (), "a tunable parameter, or an unused input, of the FMU (`hil fmu info`)",
         "A variable of the plant has this value.", "ticks of 1 ms",
         {"target": "friction_coefficient", "start_s": 3.0, "value": 0.1},
         Quantity("value", "the variable's", "value", -_ANY, _ANY)),
    Kind("push", "plant", PUSHES, "`force_x_n`, `force_y_n` or `moment_n_m`",
         "The robot is pushed at its centre: by a force in the world frame, or by a moment about the vertical axis.",
         "ticks of 1 ms", {"target": "force_y_n", "start_s": 3.0, "end_s": 3.2, "value": 40.0},
         Quantity("value", "N or N·m", "force or moment", -1e6, 1e6)),
    Kind("slip_patch", "plant", ("floor",), "`floor`, the default",
         "The floor has less grip: everywhere or, if a circle is given, for each wheel whose centre is inside. Needs "
         'an FMU with wheel.*.grip_factor; the shipped one has it with contact = "slip".',
         "ticks of 1 ms in which a wheel was on the patch", {"value": 0.2, "x_m": 1.0, "y_m": 0.5, "radius_m": 0.4},
         Quantity("value", "", "factor of the grip", 0.0, 1.0),
         (Quantity("x_m", "m", "centre, world frame", -_ANY, _ANY),
          Quantity("y_m", "m", "centre, world frame", -_ANY, _ANY),
          Quantity("radius_m", "m", "radius", 0.0, _ANY, excludes_low=True))),
    Kind("bias", "signal", FAULTY_SIGNALS, _SIGNAL_WORDS, "A constant is added to the signal.",
         "ticks in which the value changed", {"target": "truth.x_m", "start_s": 2.0, "end_s": 3.0, "value": 0.05},
         Quantity("value", "the signal's", "value that is added", -_ANY, _ANY), explains=True,
         on_signal=lambda row, _chance: lambda value, _t_ns: value + row.value),
    Kind("override", "signal", FAULTY_SIGNALS, _SIGNAL_WORDS, "The signal is replaced by this value.",
         "ticks in which the value changed",
         {"target": "wheel.fl.speed_command_rad_s", "start_s": 2.0, "end_s": 2.1, "value": 3.0},
         Quantity("value", "the signal's", "value", -_ANY, _ANY), explains=True,
         on_signal=lambda row, _chance: lambda _value, _t_ns: row.value),
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
            raise BadInputError(f"{named}: {point.value!r} is {kind!r}; expected a hil.faults.kind.Kind of this name")
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

    Raises ValueError when there is none of this name; its text is a part of a message.
    """
    same = [kind for kind in kinds() if kind.name == name]
    if not same:
        raise ValueError(f"kind = {name!r} is not a kind of fault{nearest(name, names())}")
    return next((kind for kind in same if target in kind.targets), same[-1])
