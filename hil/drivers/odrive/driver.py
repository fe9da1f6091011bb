"""ODrive over CANSimple, with firmware 0.5 or 0.6, which the answers tell apart. Each wheel has one axis.

The axes close the speed loops, or take torques. They send only what a remote frame asks for, and what the makers' tool
has set up to be sent cyclically. See ODRIVE.md for wiring, set-up, and what was never tried.
"""

import math
from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.types import NAN, WHEEL_NAMES, CommandMode, FourWheels
from hil.drivers.odrive import tables as can
from hil.drivers.odrive.axis import Axis
from hil.drivers.odrive.probe import OdriveProbe
from hil.drivers.odrive.settings import Settings, setup
from hil.drivers.odrive.tables import FIRMWARE_05, FIRMWARE_06
from hil.drivers.port import (
    EXTENDED,
    REMOTE,
    Capabilities,
    Dialect,
    Driver,
    RobotFacts,
    Sample,
    Sensor,
    four,
    late_ns,
    lowest,
    oldest,
)


class ODrive(Driver):
    """Drives four axes on one bus, in the order of the channels."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        self._settings = settings
        self._robot = robot
        self._is_speed = robot.mode is CommandMode.SPEED
        self._to_rad = math.tau / settings.gear_ratio
        self._setup = setup(settings, robot.mode, robot.watchdog_s)
        polled_ns = late_ns(4 * max(len(known.polled) for known in (FIRMWARE_05, FIRMWARE_06)) * robot.period_s)
        self._axes = tuple(
            Axis(node, WHEEL_NAMES[wheel], self._setup, polled_ns)
            for node, wheel in zip(settings.node_ids, robot.wheel_of_channel, strict=True)
        )
        self._by_node = {axis.node: axis for axis in self._axes}
        self._turn = 0
        self._is_armed = False

    @property
    def capabilities(self) -> Capabilities:
        sensors: set[Sensor] = {"position", "current", "battery_voltage"}
        if self._settings.firmware != "0.5" and not any(axis.firmware is FIRMWARE_05 for axis in self._axes):
            sensors |= {"battery_current", "temperature"}
        return Capabilities(
            modes=frozenset(CommandMode),
            is_twist=False,
            feedback_hz=self._settings.feedback_hz or 1.0 / self._robot.period_s,
            sensors=frozenset(sensors),
            adds_torque=True,
            watchdog="set" if self._settings.watchdog_endpoints else "none",
            latches_estop=True,
        )

    # Identification

    def ask(self) -> Sequence[Frame]:
        if self.missing:
            frames = [frame for axis in self._axes for frame in axis.ask()]
        else:  # the state comes with the heartbeats
            frames = [frame for axis in self._axes for frame in axis.ask_for_errors()]
        if not self._settings.feedback_hz:
            frames += [axis.remote(can.GET_ESTIMATES) for axis in self._axes]
        return frames

    @property
    def identity(self) -> str | None:
        for axis in self._axes:
            self._check_firmware(axis)
        if self.missing:
            return None
        groups: dict[str, list[Axis]] = {}
        for axis in self._axes:
            groups.setdefault(_described(axis), []).append(axis)
        return "ODrive axes: " + "; ".join(f"nodes {_nodes(axes)} {words}" for words, axes in groups.items())

    def _check_firmware(self, axis: Axis) -> None:
        """Raise BadInputError for a firmware or hardware that the settings or this driver do not support."""
        settings = self._settings
        if axis.version is not None and axis.firmware is None:
            raise BadInputError(
                f"ODrive node {axis.node} has firmware {_dotted(axis.version)}: expected 0.5 or 0.6; install one of "
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
        if axis.version is None or axis.hardware is None:
            raise BadInputError(
                f"ODrive node {axis.node} has firmware 0.5, which has no endpoints on the bus; leave out "
                "device.motors.watchdog_endpoints"
            )
        found = (_dotted(axis.version), _dotted(axis.hardware))
        if found != (settings.endpoints_firmware, settings.endpoints_hardware):
            raise BadInputError(
                f"ODrive node {axis.node} has firmware {found[0]} on hardware {found[1]}: "
                f"device.motors.watchdog_endpoints are those of {settings.endpoints_firmware} on "
                f"{settings.endpoints_hardware}; take them from the flat_endpoints.json of what is there"
            )

    @property
    def missing(self) -> str:
        if silent := [axis for axis in self._axes if axis.heartbeat_ns is None]:
            return (
                f"no heartbeat from the nodes {_nodes(silent)}; check power, wiring and bit rate, and "
                "device.motors.node_ids against axis.config.can.node_id"
            )
        if unknown := [axis for axis in self._axes if axis.firmware is None and axis.version is None]:
            return (
                f"the nodes {_nodes(unknown)} answer neither Get_Version nor Get_Controller_Error; their firmware is "
                "older than 0.5.4 and is to be updated with odrivetool, or the CAN adapter sends no remote frames"
            )
        if quiet := [axis for axis in self._axes if axis.estimates_ns is None]:
            option = quiet[0].firmware.estimates_option if quiet[0].firmware is not None else "their rate"
            return (
                f"no encoder estimates from the nodes {_nodes(quiet)}; set {option} with odrivetool, or "
                "device.motors.feedback_hz = 0 to ask for them"
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
        gear_ratio, to_rad = self._settings.gear_ratio, self._to_rad
        frames = []
        for axis, speed, torque in zip(self._axes, speed_rad_s, torque_n_m, strict=True):
            axis.check_heartbeat(now_ns)
            if self._is_speed:
                payload = can.TWO_FLOATS.pack(speed / to_rad, torque / gear_ratio)
                frames.append(axis.frame(can.SET_INPUT_VEL, payload))
            else:
                frames.append(axis.frame(can.SET_INPUT_TORQUE, can.TORQUE.pack(torque / gear_ratio)))
            self._is_armed = self._is_armed and axis.is_closed_loop
        frames += self._poll()
        return frames

    def _poll(self) -> Sequence[Frame]:
        """Ask one axis, in turn, for one message; ask all for their estimates if these are not sent unasked."""
        self._turn += 1
        frames = list(self._axes[self._turn % 4].poll(self._turn // 4))
        if not self._settings.feedback_hz:
            frames += [axis.remote(can.GET_ESTIMATES) for axis in self._axes]
        return frames

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
        return frames + [frame for axis in self._axes for frame in axis.ask_for_errors()]

    def estop(self) -> Sequence[Frame]:
        self._stand_down()
        return [axis.frame(can.ESTOP) for axis in self._axes]

    def clear(self) -> Sequence[Frame]:
        self._is_armed = False
        return [frame for axis in self._axes for frame in axis.clear()]

    # Received frames

    def feed(self, frame: Frame, stamp_ns: int) -> None:
        if frame.id & (EXTENDED | REMOTE):
            return
        axis = self._by_node.get(frame.id >> can.NODE_SHIFT)
        if axis is not None:
            axis.feed(frame.id & can.COMMAND_MASK, frame.payload, stamp_ns)
            self._is_armed = self._is_armed and axis.is_closed_loop

    @property
    def sample(self) -> Sample | None:
        axes = self._axes
        stamp_ns = oldest(axis.estimates_ns for axis in axes)
        if stamp_ns is None:
            return None
        to_rad = self._to_rad
        return Sample(
            stamp_ns,
            four(axis.speed_rev_s * to_rad for axis in axes),
            four(axis.position_rev * to_rad for axis in axes),
            four(axis.current_a for axis in axes),
            four(axis.temperature_degc for axis in axes),
            lowest(axis.bus_v for axis in axes),
            self._battery_a(),
        )

    def _battery_a(self) -> float:
        """Return the sum over the boards of firmware 0.6, one axis each. On 0.5 two axes report the same board: NaN."""
        if all(axis.firmware is FIRMWARE_06 for axis in self._axes):
            return math.fsum(axis.bus_a for axis in self._axes)
        return NAN

    @property
    def errors(self) -> Sequence[str]:
        return [axis.errors for axis in self._axes if axis.has_errors]

    def restart(self) -> None:
        self._is_armed = False
        for axis in self._axes:
            axis.forget()


def _dotted(version: tuple[int, int, int]) -> str:
    return ".".join(map(str, version))


def _described(axis: Axis) -> str:
    if axis.version is None or axis.hardware is None:
        return "with firmware 0.5.4 or newer of 0.5"
    return f"with firmware {_dotted(axis.version)} on hardware {_dotted(axis.hardware)}"


def _nodes(axes: Sequence[Axis]) -> str:
    return ", ".join(str(axis.node) for axis in axes)


DIALECT = Dialect(
    title="ODrive",
    wires=frozenset({"can"}),
    settings=Settings,
    make=ODrive,
    emulated="hil.drivers.odrive.emulated:EmulatedODrive",
    probe=OdriveProbe,
    watchdog_setting="device.motors.watchdog_endpoints",
)
