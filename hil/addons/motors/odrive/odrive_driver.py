"""ODrive over CANSimple, with firmware 0.5 or 0.6, which the answers tell apart. Each wheel has one axis.

The axes close the speed loops, or take torques. They send only answers to remote frames, and the cyclic messages that
the maker's tool has set up. See ODRIVE.md for wiring, set-up, and untested parts.
"""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import FourMotors, four_ids, late_ns
from hil.addons.motors.odrive import odrive_tables as can
from hil.addons.motors.odrive.axis import Axis
from hil.addons.motors.odrive.odrive_tables import FIRMWARE_05, FIRMWARE_06, Setup, setup
from hil.core.errors import BadInputError
from hil.core.options import POSITIVE, Range
from hil.core.types import CommandMode, FourWheels
from hil.robot.driver import ANSWER_S, EXTENDED, REMOTE, Capabilities, Dialect, Found, Probe, RobotFacts

_VERSION = re.compile(r"\d+\.\d+\.\d+")
_NOTHING = Setup(0, (0, b""), ())
_STATES = 15  # 0 to 14 are in use


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``node_ids``: of the channels in order. ``gear_ratio``: motor turns per turn of the wheel.

    ``feedback_hz``: rate at which the axes send their encoder estimates; 0 asks for them with each command.
    ``firmware``: the only firmware that is accepted. ``watchdog_endpoints``: ids of axis0.config.watchdog_timeout and
    axis0.config.enable_watchdog, from the flat_endpoints.json of exactly ``endpoints_firmware`` and
    ``endpoints_hardware``; without them the watchdog is neither set nor read.
    """

    node_ids: Annotated[tuple[int, ...], four_ids(0, can.BROADCAST - 1)] = (0, 1, 2, 3)
    gear_ratio: Annotated[float, POSITIVE] = 1.0
    feedback_hz: Annotated[float, Range(ge=0, le=1000)] = 100.0
    firmware: Literal["any", "0.5", "0.6"] = "any"
    watchdog_endpoints: tuple[int, ...] = ()
    endpoints_firmware: str = ""
    endpoints_hardware: str = ""

    def __post_init__(self) -> None:
        endpoints = self.watchdog_endpoints
        if not endpoints and not self.endpoints_firmware and not self.endpoints_hardware:
            return
        if len(endpoints) != 2 or len(set(endpoints)) != 2 or not all(0 < number <= 0xFFFF for number in endpoints):
            raise ValueError(
                f"watchdog_endpoints = {list(endpoints)}: expected the ids of axis0.config.watchdog_timeout and "
                "axis0.config.enable_watchdog"
            )
        if self.firmware == "0.5":
            raise ValueError("watchdog_endpoints: firmware 0.5 has no endpoints on the bus; leave them out")
        for name, example in (("endpoints_firmware", "0.6.10"), ("endpoints_hardware", "4.4.58")):
            if not _VERSION.fullmatch(getattr(self, name)):
                raise ValueError(
                    f"{name} = {getattr(self, name)!r}: expected what the flat_endpoints.json of watchdog_endpoints "
                    f"says, such as {example!r}"
                )


class ODrive(FourMotors[Settings, Axis]):
    """Drives four axes on one bus, in the order of the channels."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        capabilities = Capabilities(
            settings.feedback_hz or 1.0 / robot.period_s,
            frozenset({"position", "current", "temperature", "battery_voltage", "battery_current"}),
            adds_torque=True,
            watchdog="set" if settings.watchdog_endpoints else "none",
            latches_estop=True,
        )
        self._setup = setup(settings.watchdog_endpoints, robot.mode, robot.watchdog_s)
        polled_ns = late_ns(4 * max(len(known.polled) for known in (FIRMWARE_05, FIRMWARE_06)) * robot.period_s)
        axes = [Axis(node, self._setup, polled_ns) for node in settings.node_ids]
        to_rad = math.tau / settings.gear_ratio
        super().__init__(settings, robot, capabilities, "ODrive node", settings.node_ids, axes, to_rad, to_rad)
        self._axes = self._channels
        self._turn = 0

    @property
    def capabilities(self) -> Capabilities:
        """See ``Driver``. With firmware 0.5 the temperature and the battery's current are not known."""
        known = self._capabilities
        if self._settings.firmware == "0.5" or any(axis.firmware is FIRMWARE_05 for axis in self._axes):
            return known._replace(sensors=known.sensors - {"temperature", "battery_current"})
        return known

    # Identification

    def ask(self) -> Sequence[Frame]:
        is_missing = bool(self.missing)  # if not, the state comes with the heartbeats
        return self._of_all(Axis.ask if is_missing else Axis.ask_for_errors) + self._ask_for_estimates()

    def _of_all(self, frames_of: Callable[[Axis], Iterable[Frame]]) -> list[Frame]:
        return [frame for axis in self._axes for frame in frames_of(axis)]

    def _ask_for_estimates(self) -> list[Frame]:
        return [] if self._settings.feedback_hz else [axis.remote(can.GET_ESTIMATES) for axis in self._axes]

    @property
    def identity(self) -> str | None:
        for axis in self._axes:
            self._check_firmware(axis)
        if self.missing:
            return None
        groups: dict[str, list[str]] = {}
        for axis in self._axes:
            groups.setdefault(axis.firmware_words, []).append(str(axis.node))
        return "ODrive axes: " + "; ".join(f"nodes {', '.join(nodes)} with {words}" for words, nodes in groups.items())

    def _check_firmware(self, axis: Axis) -> None:
        """Raise BadInputError for a firmware or hardware that the settings or this driver do not support."""
        settings = self._settings
        if axis.version is not None and axis.firmware is None:
            raise BadInputError(
                f"ODrive node {axis.node} has firmware {can.dotted(axis.version)}: expected 0.5 or 0.6; install one of "
                "these with odrivetool"
            )
        if axis.firmware is None:
            return
        if settings.firmware not in ("any", axis.firmware.name):
            raise BadInputError(
                f"ODrive node {axis.node} has firmware {axis.firmware.name}, but device.motors.firmware is "
                f"{settings.firmware}; correct one of them"
            )
        if not settings.watchdog_endpoints:
            return
        found = can.dotted(axis.version or (0, 5)), can.dotted(axis.hardware or ("unknown",))
        if found != (settings.endpoints_firmware, settings.endpoints_hardware):
            raise BadInputError(
                f"ODrive node {axis.node} has firmware {found[0]} on hardware {found[1]}: "
                f"device.motors.watchdog_endpoints are those of {settings.endpoints_firmware} on "
                f"{settings.endpoints_hardware}; take them from the flat_endpoints.json of what is there"
            )

    @property
    def missing(self) -> str:
        axes = self._axes
        if silent := self._with(axis.heartbeat_ns is None for axis in axes):
            return (
                f"no heartbeat from the nodes {silent}; check power, wiring and bit rate, and device.motors.node_ids "
                "against axis.config.can.node_id"
            )
        if unknown := self._with(axis.firmware is None and axis.version is None for axis in axes):
            return (
                f"the nodes {unknown} answer neither Get_Version nor Get_Controller_Error; their firmware is older "
                "than 0.5.4 and is to be updated with odrivetool, or the CAN adapter sends no remote frames"
            )
        if quiet := self._with(axis.stamp_ns is None for axis in axes):
            return (
                f"no encoder estimates from the nodes {quiet}; set config.can.encoder_msg_rate_ms (0.5: "
                "encoder_rate_ms) with odrivetool, or device.motors.feedback_hz = 0 to ask for them"
            )
        return ""

    @property
    def warnings(self) -> Sequence[str]:
        warnings = ["after an e-stop an ODrive lets its wheels coast and does not brake them"]
        if not self._settings.watchdog_endpoints:
            remedy = (
                "firmware 0.5 does not report it over CAN, set enable_watchdog and watchdog_timeout with odrivetool"
                if any(axis.firmware is FIRMWARE_05 for axis in self._axes)
                else "give device.motors.watchdog_endpoints, or set enable_watchdog with odrivetool"
            )
            warnings.append(
                "it is not known whether the ODrives have a watchdog; without one the wheels turn on when this "
                f"computer dies: {remedy}"
            )
        return warnings

    # Motion

    def arm(self, now_ns: int) -> Sequence[Frame]:
        frames = list(self._poll())
        for axis in self._axes:
            axis.check_heartbeat(now_ns)
        if self.missing or any(axis.has_errors for axis in self._axes):
            return frames
        for axis in self._axes:
            frames += axis.arm(now_ns)
        self._is_armed = all(axis.is_closed_loop for axis in self._axes)
        return frames

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        gear_ratio = self._settings.gear_ratio
        frames = []
        for axis, speed, torque in zip(self._axes, speed_rad_s, torque_n_m, strict=True):
            axis.check_heartbeat(now_ns)
            if self._robot.mode is CommandMode.SPEED:
                payload = can.TWO_FLOATS.pack(speed / self._to_rad, torque / gear_ratio)
                frames.append(axis.frame(can.SET_INPUT_VEL, payload))
            else:
                frames.append(axis.frame(can.SET_INPUT_TORQUE, can.TORQUE.pack(torque / gear_ratio)))
            self._is_armed = self._is_armed and axis.is_closed_loop
        return [*frames, *self._poll()]

    def _poll(self) -> Sequence[Frame]:
        """Ask one axis, in turn, for one message; ask all for their estimates if these are not sent unasked."""
        self._turn += 1
        return [*self._axes[self._turn % 4].poll(self._turn // 4), *self._ask_for_estimates()]

    def _stand_down(self) -> None:
        self._is_armed = False
        for axis in self._axes:
            axis.stand_down()

    def disarm(self) -> Sequence[Frame]:
        self._stand_down()
        standstill, idle = self._setup.standstill, can.STATE.pack(can.IDLE)
        frames = [axis.frame(*standstill) for axis in self._axes]
        frames += [axis.frame(can.SET_AXIS_STATE, idle) for axis in self._axes]
        # If an error is the cause of this stop, its register may not have been read yet.
        return frames + self._of_all(Axis.ask_for_errors)

    def estop(self) -> Sequence[Frame]:
        self._stand_down()
        return [axis.frame(can.ESTOP) for axis in self._axes]

    def clear(self) -> Sequence[Frame]:
        self._is_armed = False
        return self._of_all(Axis.clear)

    # Received frames

    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        axis = self._by_id.get((frame.id & ~EXTENDED) >> can.NODE_SHIFT)
        if axis is None:  # a remote frame is a question, and so of somebody else
            return ""
        if frame.id & EXTENDED:
            return "an identifier of 29 bits, expected one of 11"
        why = axis.feed(frame.id & can.COMMAND_MASK, frame.payload, stamp_ns)
        self._is_armed = self._is_armed and axis.is_closed_loop
        return why

    @property
    def errors(self) -> Sequence[str]:
        axes = zip(self._names, self._axes, strict=True)
        return [f"{name}: {axis.errors}" for name, axis in axes if axis.has_errors]


class _Probe(Probe):
    """Accepts a node as an ODrive after it has answered, because frames of other devices may have the same ids.

    A frame before the first question is no answer, and neither is an impossible version. Only version and controller
    error are asked for: firmware 0.5 would take a remote frame of Set_Axis_Node_ID for a new id.
    """

    patience_s = ANSWER_S

    def __init__(self) -> None:
        self._axes: dict[int, Axis] = {}
        self._has_asked = False

    def ask(self) -> Sequence[Frame]:
        self._has_asked = True
        return [frame for _, axis in sorted(self._axes.items()) for frame in axis.ask()]

    def feed(self, frame: Frame) -> bool:
        if frame.id & (EXTENDED | REMOTE):
            return False
        node, command = frame.id >> can.NODE_SHIFT, frame.id & can.COMMAND_MASK
        if command == can.HEARTBEAT and len(frame.payload) == 8 and node < can.BROADCAST and frame.payload[4] < _STATES:
            self._axes.setdefault(node, Axis(node, _NOTHING, late_ns=0))
        if node not in self._axes:
            return False
        if command == can.GET_VERSION and not _is_version(frame.payload):
            return False
        if self._has_asked or command == can.HEARTBEAT:
            self._axes[node].feed(command, frame.payload, 0)
        return True

    def found(self) -> Found | None:
        known = [axis for axis in self._axes.values() if axis.firmware is not None or axis.version is not None]
        known.sort(key=lambda axis: axis.node)
        sentences = [f"an ODrive axis, node {axis.node}, of {axis.firmware_words}" for axis in known]
        is_robot = len(known) == 4 and all(axis.firmware is not None for axis in known)
        motors = {"node_ids": [axis.node for axis in known]} if is_robot else None
        return Found(sentences, motors, unknown=("device.motors.gear_ratio",)) if known else None


def _is_version(payload: bytes) -> bool:
    """Return whether this can be an answer to Get_Version, which exists since firmware 0.6."""
    if len(payload) != can.VERSION.size:
        return False
    line, _, _, major, minor, _, unreleased = can.VERSION.unpack(payload)
    return line > 0 and major <= 1 and minor < 32 and (major, minor) >= (0, 6) and unreleased <= 1


DIALECT = Dialect(
    title="ODrive",
    wires=frozenset({"can"}),
    settings=Settings,
    make=ODrive,
    emulated="hil.addons.motors.odrive.emulated_odrive:EmulatedODrive",
    probe=_Probe,
    description="ODrive, CANSimple of firmware 0.5 and 0.6",
)
