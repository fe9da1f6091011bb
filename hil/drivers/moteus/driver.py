"""mjbots moteus: every command has a speed, a torque, and a timeout within which the next command must come.

CAN FD at 1 Mbit/s, data at 5 Mbit/s. Identifier: prefix << 16 | source << 8 | destination; bit 15 asks for a reply. A
commanded position of NaN stands for the current one, which makes a velocity mode. After its timeout a controller brakes
and stays in mode 11 until a stop.
Source: mjbots moteus, docs/protocol/can.md, docs/protocol/registers.md, docs/guides/control-modes.md.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.options import POSITIVE, Range
from hil.core.types import NAN, WHEEL_NAMES, CommandMode, FourWheels
from hil.drivers.moteus import frames
from hil.drivers.port import (
    ANSWER_S,
    EXTENDED,
    Capabilities,
    Dialect,
    Driver,
    Found,
    Probe,
    RobotFacts,
    Sample,
    chosen,
    four,
    four_ids,
    lowest,
    oldest,
)

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


class _Channel:
    """The newest answers of one controller. Quantities are at its output."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        self.stamp_ns: int | None = None
        self.mode: int | None = None
        self.fault = 0
        self.position_rev = self.velocity_rev_s = 0.0
        self.current_a = self.voltage_v = self.temperature_degc = NAN
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
            self.position_rev, self.velocity_rev_s, self.stamp_ns = position, velocity, stamp_ns
        self.current_a = get(frames.Q_CURRENT, self.current_a)
        self.voltage_v = get(frames.VOLTAGE, self.voltage_v)
        self.temperature_degc = get(frames.TEMPERATURE, self.temperature_degc)


class Moteus(Driver):
    """Drives four controllers on one bus."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        self._settings = settings
        self._robot = robot
        self._ids = [EXTENDED | settings.can_prefix << 16 | _REPLY_BIT | number for number in settings.ids]
        self._channels = tuple(_Channel() for _ in settings.ids)
        self._by_id = {
            settings.can_prefix << 16 | number << 8: channel
            for number, channel in zip(settings.ids, self._channels, strict=True)
        }
        self._to_output = settings.gear_ratio / math.tau
        self._is_armed = False
        self._has_armed = False  # armed from here: a controller in mode 11 may be there because our commands ended
        self._is_ending = False  # a stop was sent, and not all controllers have confirmed it yet
        self._was_lost = False  # the link was lost while armed, so mode 11 is no error
        self._capabilities = Capabilities(
            modes=frozenset(CommandMode),
            is_twist=False,
            feedback_hz=1.0 / robot.period_s,
            sensors=frozenset({"position", "current", "temperature", "battery_voltage"}),
            adds_torque=True,
            watchdog="set",
            latches_estop=True,
        )

    def ask(self) -> Sequence[Frame]:
        return [
            Frame(number, frames.padded(_STATE if channel.version else _STATE + _IDENTITY))
            for number, channel in zip(self._ids, self._channels, strict=True)
        ]

    @property
    def identity(self) -> str | None:
        versions = [channel.version for channel in self._channels]
        known = [
            (number, version)
            for number, version in zip(self._settings.ids, versions, strict=True)
            if version is not None
        ]
        for number, (_, firmware, register_map) in known:
            if register_map not in _REGISTER_MAPS:
                raise BadInputError(
                    f"moteus {number} (firmware {firmware:#x}) has the register map {register_map}, and this driver "
                    f"knows {' and '.join(map(str, _REGISTER_MAPS))}; flash a firmware that has one of these "
                    "(moteus_tool --flash)"
                )
        if len(known) < len(versions):
            return None
        words = [f"{number} (model {model:#x}, firmware {firmware:#x})" for number, (model, firmware, _) in known]
        return f"four moteus with the ids {', '.join(words)}"

    @property
    def missing(self) -> str:
        silent = chosen(self._settings.ids, (channel.version is None for channel in self._channels))
        if not silent:
            return ""
        return (
            f"no answer from the moteus {silent}; check their power, the bus's termination and its bit rates of 1 and "
            "5 Mbit/s, and their id.id (device.motors.ids) and can.prefix with moteus_tool --info"
        )

    def arm(self, now_ns: int) -> Sequence[Frame]:
        """See ``Driver``. Each command sets the watchdog, also the one that closes the loop."""
        watchdog = self._robot.watchdog_s
        modes = [channel.mode for channel in self._channels]
        if any(mode in (None, _FAULT, _TIMEOUT) for mode in modes):
            return self.ask()
        self._has_armed, self._is_ending, self._was_lost = True, False, False
        self._is_armed = all(
            channel.mode == _POSITION and math.isclose(channel.timeout_s, watchdog, rel_tol=1e-6)
            for channel in self._channels
        )
        still = self._position(0.0, 0.0, watchdog)
        return [Frame(number, frames.padded(still + _STATE + _READ_TIMEOUT)) for number in self._ids]

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        watchdog, is_speed = self._robot.watchdog_s, self._robot.mode is CommandMode.SPEED
        make = self._position if is_speed else self._torque
        return [
            Frame(number, frames.padded(make(speed, torque, watchdog) + _STATE))
            for number, speed, torque in zip(self._ids, speed_rad_s, torque_n_m, strict=True)
        ]

    def _position(self, speed_rad_s: float, torque_n_m: float, timeout_s: float) -> bytes:
        gear_ratio, limit = self._settings.gear_ratio, self._robot.torque_limit_n_m
        return (
            frames.write_mode(_POSITION)
            + frames.write_floats(frames.COMMAND_POSITION, NAN, speed_rad_s * self._to_output, torque_n_m / gear_ratio)
            + frames.write_floats(frames.COMMAND_MAX_TORQUE, limit / gear_ratio)
            + frames.write_floats(frames.COMMAND_TIMEOUT, timeout_s)
        )

    def _torque(self, _speed_rad_s: float, torque_n_m: float, timeout_s: float) -> bytes:
        """Return a command of torque alone: the gains of the position loop are scaled to 0."""
        gear_ratio, limit = self._settings.gear_ratio, self._robot.torque_limit_n_m
        torque, most = torque_n_m / gear_ratio, limit / gear_ratio
        return (
            frames.write_mode(_POSITION)
            + frames.write_floats(frames.COMMAND_POSITION, NAN, 0.0, torque, 0.0, 0.0, most)
            + frames.write_floats(frames.COMMAND_TIMEOUT, timeout_s)
            + frames.write_floats(frames.COMMAND_ILIMIT_SCALE, 0.0)
        )

    def disarm(self) -> Sequence[Frame]:
        """See ``Driver``. A controller is only asked for its state, and not stopped, in three cases.

        A stop would clear its fault. It would also end a mode 11 that did not follow from our commands. And after a
        loss of the link its mode is unknown until it answers; it brakes by its watchdog meanwhile.
        """
        self._end()
        stop = frames.write_mode(_STOPPED) + _STATE
        return [
            Frame(number, frames.padded(stop if self._may_be_stopped(channel) else _STATE))
            for number, channel in zip(self._ids, self._channels, strict=True)
        ]

    def _may_be_stopped(self, channel: _Channel) -> bool:
        if channel.mode == _TIMEOUT:
            return self._has_armed
        return channel.mode not in (None, _FAULT)

    def estop(self) -> Sequence[Frame]:
        """See ``Driver``. The command has a timeout of 1 ms: then the controller brakes in mode 11 until a stop."""
        self._end()
        self._has_armed = self._was_lost = False
        payload = frames.padded(self._position(0.0, 0.0, _ESTOP_S) + _STATE)
        return [Frame(number, payload) for number in self._ids]

    def clear(self) -> Sequence[Frame]:
        """See ``Driver``. Separate frames ask for the state: the answer to the stop has the state before it."""
        self._end()
        stop = frames.write_mode(_STOPPED)
        return [Frame(number, payload) for payload in (stop, frames.padded(_STATE)) for number in self._ids]

    def _end(self) -> None:
        self._is_armed, self._is_ending = False, True
        for channel in self._channels:
            channel.timeout_s = NAN

    def feed(self, frame: Frame, stamp_ns: int) -> None:
        channel = self._by_id.get(frame.id & ~EXTENDED)
        if channel is None or (values := frames.parse_reply(frame.payload)) is None:
            return
        channel.feed(values, stamp_ns)
        self._is_armed = self._is_armed and channel.mode == _POSITION
        if self._is_ending and all(channel.mode == _STOPPED for channel in self._channels):
            self._has_armed = self._is_ending = self._was_lost = False

    @property
    def sample(self) -> Sample | None:
        channels = self._channels
        stamp_ns = oldest(channel.stamp_ns for channel in channels)
        if stamp_ns is None:
            return None
        scale = 1.0 / self._to_output
        return Sample(
            stamp_ns,
            four(channel.velocity_rev_s * scale for channel in channels),
            four(channel.position_rev * scale for channel in channels),
            four(channel.current_a for channel in channels),
            four(channel.temperature_degc for channel in channels),
            lowest(channel.voltage_v for channel in channels),
        )

    @property
    def errors(self) -> Sequence[str]:
        found = []
        for number, channel, wheel in zip(
            self._settings.ids, self._channels, self._robot.wheel_of_channel, strict=True
        ):
            if channel.mode == _FAULT:
                words = frames.FAULTS.get(
                    channel.fault, "see the fault codes of register 0x00f in the maker's reference"
                )
                found.append(f"moteus {number} of wheel {WHEEL_NAMES[wheel]} has the fault {channel.fault}: {words}")
            elif channel.mode == _TIMEOUT and not self._was_lost:
                found.append(
                    f"moteus {number} of wheel {WHEEL_NAMES[wheel]} is in mode 11, position timeout: no command came "
                    "in time, or an e-stop was sent; it stays there until it is cleared"
                )
        return found

    def restart(self) -> None:
        self._is_armed = False
        self._was_lost = self._has_armed
        for channel in self._channels:
            channel.forget()


class _Probe(Probe):
    """Asks every id for model, firmware and register map."""

    def __init__(self) -> None:
        self._versions: dict[int, Mapping[int, float]] = {}

    @property
    def patience_s(self) -> float:
        return ANSWER_S

    def ask(self) -> Sequence[Frame]:
        return [Frame(EXTENDED | _REPLY_BIT | number, _IDENTITY) for number in _ALL_IDS]

    def feed(self, frame: Frame) -> bool:
        number = (frame.id & ~EXTENDED) >> 8
        if frame.id & 0xFF or number not in _ALL_IDS:
            return False
        values = frames.parse_reply(frame.payload)
        if values is not None and all(register in values for register in (frames.MODEL, frames.FIRMWARE)):
            self._versions[number] = values
        return number in self._versions

    def found(self) -> Found | None:
        if not self._versions:
            return None
        ids = sorted(self._versions)
        sentences = [
            f"a moteus with the id {number}, model {int(values[frames.MODEL]):#x}, firmware "
            f"{int(values[frames.FIRMWARE]):#x}"
            for number, values in sorted(self._versions.items())
        ]
        motors: dict[str, Any] | None = {"ids": ids} if len(ids) == 4 else None
        return Found(sentences, motors, unknown=("device.motors.gear_ratio",))


DIALECT = Dialect(
    title="mjbots moteus",
    wires=frozenset({"can_fd"}),
    settings=Settings,
    make=Moteus,
    emulated="hil.drivers.moteus.emulated:EmulatedMoteus",
    probe=_Probe,
)
