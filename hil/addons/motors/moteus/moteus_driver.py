"""mjbots moteus: every command has a speed, a torque, and a timeout within which the next command must come.

CAN FD at 1 Mbit/s, data at 5 Mbit/s. Identifier: prefix << 16 | source << 8 | destination; bit 15 asks for a reply. A
commanded position of NaN stands for the current one, which makes a velocity mode. After its timeout a controller brakes
and stays in mode 11 until a stop.
Source: mjbots moteus, docs/protocol/can.md, docs/protocol/registers.md, docs/guides/control-modes.md.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import Channel, FourMotors, IdProbe, four_ids
from hil.addons.motors.moteus import moteus_frames as frames
from hil.core.errors import BadInputError
from hil.core.options import POSITIVE, Range
from hil.core.types import NAN, CommandMode, FourWheels
from hil.robot.driver import ANSWER_S, EXTENDED, Capabilities, Dialect, RobotFacts

_STOPPED, _FAULT, _POSITION, _TIMEOUT = 0, 1, 10, 11
_REGISTER_MAPS = (4, 5)  # velocities have these units since 4; 5 changed only the report of homing
_REPLY_BIT = 0x8000
_ESTOP_S = 0.001
_ALL_IDS = range(1, 127)  # 127 is the broadcast id

_STATE = (
    frames.read(frames.INT8, frames.MODE)
    + frames.read(frames.FLOAT, frames.POSITION, 2)
    + frames.read(frames.FLOAT, frames.Q_CURRENT)
    + frames.read(frames.INT16, frames.VOLTAGE, 3)
)
_READ_TIMEOUT = frames.read(frames.FLOAT, frames.COMMAND_TIMEOUT)
_IDENTITY = frames.read(frames.INT32, frames.MODEL, 3)


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``ids``: ``id.id`` of the channels in order. ``can_prefix``: ``can.prefix`` of all four.

    ``gear_ratio``: turns of the controller's output per turn of the wheel. It is 1 where the controller's own
    ``motor_position.rotor_to_output_ratio`` covers the whole gear.
    """

    ids: Annotated[tuple[int, ...], four_ids(_ALL_IDS[0], _ALL_IDS[-1])] = (1, 2, 3, 4)
    can_prefix: Annotated[int, Range(ge=0, le=0x1FFF)] = 0
    gear_ratio: Annotated[float, POSITIVE] = 1.0


class _Channel(Channel):
    """The newest answers of one controller. Quantities are at its output: revolutions, and revolutions per second."""

    def forget(self) -> None:
        super().forget()
        self.mode: int | None = None
        self.fault = 0
        self.timeout_s = NAN
        self.version: tuple[int, int, int] | None = None  # model, firmware, register map

    def feed(self, values: Mapping[int, float], stamp_ns: int) -> None:
        get = values.get
        if frames.REGISTER_MAP in values:
            self.version = int(get(frames.MODEL, 0)), int(get(frames.FIRMWARE, 0)), int(values[frames.REGISTER_MAP])
        if not math.isnan(mode := get(frames.MODE, NAN)):
            self.mode, self.fault = int(mode), int(get(frames.FAULT, 0))
        self.timeout_s = get(frames.COMMAND_TIMEOUT, self.timeout_s)
        position, velocity = get(frames.POSITION, NAN), get(frames.VELOCITY, NAN)
        if math.isfinite(position) and math.isfinite(velocity):  # otherwise the speed gets too old and the robot stops
            self.position, self.speed, self.stamp_ns = position, velocity, stamp_ns
        self.current_a = get(frames.Q_CURRENT, self.current_a)
        self.supply_v = get(frames.VOLTAGE, self.supply_v)
        self.temperature_degc = get(frames.TEMPERATURE, self.temperature_degc)


class Moteus(FourMotors[Settings, _Channel]):
    """Drives four controllers on one bus."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        self._per_rad = settings.gear_ratio / math.tau  # revolutions of the output
        capabilities = Capabilities(
            1.0 / robot.period_s,
            frozenset({"position", "current", "temperature", "battery_voltage"}),
            adds_torque=True,
            watchdog="set",
            latches_estop=True,
        )
        channels = [_Channel() for _ in settings.ids]
        to_rad = 1.0 / self._per_rad
        super().__init__(settings, robot, capabilities, "moteus", settings.ids, channels, to_rad, to_rad)
        self._max_torque_n_m = robot.torque_limit_n_m / settings.gear_ratio
        if robot.mode is CommandMode.TORQUE:
            self._warnings = (
                "with torque commands a moteus lets its wheel coast when commands end, unless its servo.timeout_mode "
                "is 15: its brake in mode 12 uses the gains of the last command, which are 0",
            )
        self._has_armed = False  # armed from here: a controller in mode 11 may be there because our commands ended
        self._is_ending = False  # a stop was sent, and not all controllers have confirmed it yet
        self._was_lost = False  # the link was lost while armed, so mode 11 is no error

    def _frames(self, payloads: Iterable[bytes]) -> list[Frame]:
        """Return the frames with these payloads, one for each controller; each asks for an answer."""
        first = EXTENDED | self._settings.can_prefix << 16 | _REPLY_BIT
        return [Frame(first | n, frames.padded(payload)) for n, payload in zip(self._ids, payloads, strict=True)]

    def ask(self) -> Sequence[Frame]:
        return self._frames(_STATE if channel.version else _STATE + _IDENTITY for channel in self._channels)

    @property
    def identity(self) -> str | None:
        known = {number: channel.version for number, channel in self._by_id.items() if channel.version is not None}
        for number, (_, firmware, register_map) in known.items():
            if register_map not in _REGISTER_MAPS:
                raise BadInputError(
                    f"moteus {number} (firmware {firmware:#x}) has the register map {register_map}, and this driver "
                    f"knows {' and '.join(map(str, _REGISTER_MAPS))}; flash a firmware that has one of these "
                    "(moteus_tool --flash)"
                )
        if len(known) < len(self._ids):
            return None
        words = [f"{n} (model {model:#x}, firmware {firmware:#x})" for n, (model, firmware, _) in known.items()]
        return f"four moteus with the ids {', '.join(words)}"

    @property
    def missing(self) -> str:
        silent = self._with(channel.version is None for channel in self._channels)
        return silent and (
            f"no answer from the moteus {silent}; check their power, the bus's termination and its bit rates of 1 and "
            "5 Mbit/s, and their id.id (device.motors.ids) and can.prefix with moteus_tool --info"
        )

    def arm(self, now_ns: int) -> Sequence[Frame]:
        """See ``Driver``. Each command sets the watchdog, also the one that closes the loop."""
        watchdog = self._robot.watchdog_s
        if any(channel.mode in (None, _FAULT, _TIMEOUT) for channel in self._channels):
            return self.ask()
        self._has_armed, self._is_ending, self._was_lost = True, False, False
        self._is_armed = all(
            channel.mode == _POSITION and math.isclose(channel.timeout_s, watchdog, rel_tol=1e-6)
            for channel in self._channels
        )
        return self._frames([self._position(0.0, 0.0, watchdog) + _STATE + _READ_TIMEOUT] * 4)

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        watchdog = self._robot.watchdog_s
        make = self._position if self._robot.mode is CommandMode.SPEED else self._torque
        commands = zip(speed_rad_s, torque_n_m, strict=True)
        return self._frames(make(speed, torque, watchdog) + _STATE for speed, torque in commands)

    def _position(self, speed_rad_s: float, torque_n_m: float, timeout_s: float) -> bytes:
        torque = torque_n_m / self._settings.gear_ratio
        return (
            frames.write_mode(_POSITION)
            + frames.write_floats(frames.COMMAND_POSITION, NAN, speed_rad_s * self._per_rad, torque)
            + frames.write_floats(frames.COMMAND_MAX_TORQUE, self._max_torque_n_m)
            + frames.write_floats(frames.COMMAND_TIMEOUT, timeout_s)
        )

    def _torque(self, _speed_rad_s: float, torque_n_m: float, timeout_s: float) -> bytes:
        """Return a command of torque alone: the gains of the position loop are scaled to 0."""
        torque = torque_n_m / self._settings.gear_ratio
        return (
            frames.write_mode(_POSITION)
            + frames.write_floats(frames.COMMAND_POSITION, NAN, 0.0, torque, 0.0, 0.0, self._max_torque_n_m)
            + frames.write_floats(frames.COMMAND_TIMEOUT, timeout_s)
            + frames.write_floats(frames.COMMAND_ILIMIT_SCALE, 0.0)
        )

    def disarm(self) -> Sequence[Frame]:
        """See ``Driver``. A controller is only asked for its state, and not stopped, in three cases.

        A stop would clear its fault. It would also end a mode 11 that did not follow from our commands. And after a
        loss of the link its mode is unknown until it answers; it brakes by its watchdog meanwhile.
        """
        self._end()
        kept = (None, _FAULT) if self._has_armed else (None, _FAULT, _TIMEOUT)
        stop = frames.write_mode(_STOPPED) + _STATE
        return self._frames(_STATE if channel.mode in kept else stop for channel in self._channels)

    def estop(self) -> Sequence[Frame]:
        """See ``Driver``. The command has a timeout of 1 ms: then the controller brakes in mode 11 until a stop."""
        self._end()
        self._has_armed = self._was_lost = False
        return self._frames([self._position(0.0, 0.0, _ESTOP_S) + _STATE] * 4)

    def clear(self) -> Sequence[Frame]:
        """See ``Driver``. Separate frames ask for the state: the answer to the stop has the state before it."""
        self._end()
        return self._frames([frames.write_mode(_STOPPED)] * 4) + self._frames([_STATE] * 4)

    def _end(self) -> None:
        self._is_armed, self._is_ending = False, True
        for channel in self._channels:
            channel.timeout_s = NAN

    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        number = (frame.id & ~EXTENDED) - (self._settings.can_prefix << 16)
        channel = self._by_id.get(number >> 8) if not number & 0xFF else None
        if channel is None:
            return ""
        if (values := frames.parse_reply(frame.payload)) is None:
            return f"{len(frame.payload)} bytes that are no answer of a moteus"
        channel.feed(values, stamp_ns)
        self._is_armed = self._is_armed and channel.mode == _POSITION
        if self._is_ending and all(channel.mode == _STOPPED for channel in self._channels):
            self._has_armed = self._is_ending = self._was_lost = False
        return None

    def _problems(self, channel: _Channel) -> Iterable[str]:
        if channel.mode == _FAULT:
            reference = "see the fault codes of register 0x00f in the maker's reference"
            yield f"has the fault {channel.fault}: {frames.FAULTS.get(channel.fault, reference)}"
        elif channel.mode == _TIMEOUT and not self._was_lost:
            yield (
                "is in mode 11, position timeout: no command came in time, or an e-stop was sent; it stays there until "
                "it is cleared"
            )

    def restart(self) -> None:
        super().restart()
        self._was_lost = self._has_armed


class _Probe(IdProbe):
    """Asks every id for model, firmware and register map."""

    patience_s = ANSWER_S
    unknown = ("device.motors.gear_ratio",)

    def ask(self) -> Sequence[Frame]:
        return [Frame(EXTENDED | _REPLY_BIT | number, _IDENTITY) for number in _ALL_IDS]

    def feed(self, frame: Frame) -> bool:
        number = (frame.id & ~EXTENDED) >> 8
        if frame.id & 0xFF or number not in _ALL_IDS:
            return False
        values = frames.parse_reply(frame.payload) or {}
        if frames.MODEL in values and frames.FIRMWARE in values:
            model, firmware = int(values[frames.MODEL]), int(values[frames.FIRMWARE])
            self._sentences[number] = f"a moteus with the id {number}, model {model:#x}, firmware {firmware:#x}"
        return number in self._sentences


DIALECT = Dialect(
    title="mjbots moteus",
    wires=frozenset({"can_fd"}),
    settings=Settings,
    make=Moteus,
    emulated="hil.addons.motors.moteus.emulated_moteus:EmulatedMoteus",
    probe=_Probe,
    description="mjbots moteus, over CAN FD",
)
