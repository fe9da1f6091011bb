"""VESC: takes an electrical speed or a current, over CAN, or over UART through one VESC that forwards to the others.

Over CAN the VESCs broadcast their state (STATUS 1, 4 and 5, switched on in VESC Tool), and are asked for their fault
codes in turn. Over UART they send nothing unasked: every tick asks the VESC at the line and one of the others.
A VESC has no arming: it obeys every command, and when commands end its own timeout stops the motor. The timeout is read
at the start; the driver warns if it is missing, too long or too short.
Source: see hil/addons/motors/vesc/vesc_frames.py.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import FourMotors, IdProbe, four_ids, holds_back, late_ns, torques_dropped
from hil.addons.motors.vesc import vesc_frames as frames
from hil.addons.motors.vesc.vesc_channel import Channel, has_timeout, timeout_warnings
from hil.core.errors import BadInputError
from hil.core.options import POSITIVE, Range
from hil.core.types import CommandMode, FourWheels
from hil.robot.driver import ANSWER_S, EXTENDED, Capabilities, Dialect, Found, Probe, RobotFacts, Sample

_OLDEST_MAJOR = 5
_MAX_CALLS = 2  # calls of ``ask`` that one VESC has to answer its questions
_UNANSWERED_NS = 1_000_000_000  # a VESC that does not report its fault code for this long is in error
_STILL: FourWheels = (0.0, 0.0, 0.0, 0.0)
_BAUD = 115_200
# The probes
_IS_VESC = 0  # the hardware type; other types are battery managers and modules
_UNKNOWN = ("device.motors.pole_pairs", "device.motors.gear_ratio", "firmware.torque_constant_n_m_a")


@dataclass(frozen=True, slots=True)
class Settings:
    """``[device.motors]``. ``ids``: controller ids in channel order. ``pole_pairs``: half the magnets of a motor.

    ``gear_ratio``: motor turns per turn of the wheel. ``status_hz``: rate of the status messages, as set in VESC Tool.
    ``serial_id``: id of the VESC at the serial line.
    """

    ids: Annotated[tuple[int, ...], four_ids(0, frames.MAX_ID)] = (1, 2, 3, 4)
    pole_pairs: Annotated[int, Range(ge=1)] = 7
    gear_ratio: Annotated[float, POSITIVE] = 1.0
    status_hz: Annotated[float, POSITIVE] = 50.0
    serial_id: Annotated[int, Range(ge=0, le=frames.MAX_ID)] = 1

    def __post_init__(self) -> None:
        if frames.HOST in self.ids:
            raise ValueError(f"ids: {frames.HOST} is the id of this computer on the bus; give the VESC another one")


class Vesc(FourMotors[Settings, Channel]):
    """Drives four VESCs."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        self._is_bus = robot.wire == "can"
        ids = settings.ids
        self._wire = frames.Bus(ids) if self._is_bus else frames.Line(ids, settings.serial_id)
        rate_hz = settings.status_hz if self._is_bus else 1.0 / (robot.period_s * len(self._wire.rounds))
        self._to_erpm = settings.gear_ratio * settings.pole_pairs * 60.0 / math.tau
        to_rad = math.tau / (frames.STEPS * settings.pole_pairs * settings.gear_ratio)
        channels = [Channel() for _ in ids]
        capabilities = Capabilities(
            rate_hz, frozenset({"position", "current", "temperature", "battery_voltage", "battery_current"})
        )
        super().__init__(settings, robot, capabilities, "VESC", ids, channels, 1.0 / self._to_erpm, to_rad)
        self._messages = frames.CanMessages()
        self._asked: int | None = None  # the VESC whose answers are awaited
        self._may_wait = not self._is_bus  # the VESC at the line may wait for the rest of an unfinished packet
        self._unassigned: Sequence[frames.Version] = ()  # versions on a serial line, until values with an id follow
        self._round = self._turn = 0
        self._calls = 0  # of ``ask`` since the newest questions
        self._is_arming = False
        self._to_current = 1.0 / robot.torque_constant_n_m_a
        self._brake_a = robot.torque_limit_n_m * self._to_current
        self._late_ns = late_ns(1.0 / rate_hz)
        self._now_ns = 0

    @property
    def capabilities(self) -> Capabilities:
        """See ``Driver``. There is a watchdog when all four have reported a timeout of at most ``watchdog_s``."""
        if all(has_timeout(channel, self._robot) for channel in self._channels):
            return self._capabilities._replace(watchdog="fixed")
        return self._capabilities

    def ask(self) -> Sequence[Frame]:
        """See ``Driver``. Ask one VESC at a time; the next one after an answer, or after ``_MAX_CALLS`` calls.

        When the first question over a line stays unanswered, the VESC at the line may be waiting for the rest of a
        packet, and hold old commands. Enough stops go before the next question that its last command is a stop.
        """
        before: Sequence[Frame] = ()
        if self._asked is not None:
            self._calls += 1
            channel = self._by_id[self._asked]
            if not channel.is_identified and self._calls < _MAX_CALLS:
                return ()
            # Its values were lost, or its firmware has none: the version must not be assigned to the next VESC.
            if len(self._unassigned) == 1 and channel.version is None:
                channel.version = self._unassigned[0]
            self._unassigned = ()
            channel.count_unanswered_timeout()
            if self._may_wait:
                before = frames.repeated_past_packet(self._all(frames.SET_CURRENT, _STILL))
                self._may_wait = False
        open_ids = [vesc for vesc, channel in self._by_id.items() if not channel.has_answered]
        if not open_ids:
            self._asked = None
            return self._poll()
        self._asked, self._calls = min(open_ids, key=lambda vesc: (self._ids.index(vesc) - self._turn) % 4), 0
        self._turn = self._ids.index(self._asked) + 1
        channel = self._by_id[self._asked]
        questions = [] if channel.is_identified else [*self._wire.questions]
        if channel.needs_timeout:
            questions.append(bytes((frames.GET_APPCONF,)))
        return [*before, *(self._wire.message(self._asked, question) for question in questions)]

    def _poll(self, now_ns: int | None = None) -> Sequence[Frame]:
        """Ask the next VESC. ``asked_ns`` is for CAN only: over a line the fault comes with the speed."""
        self._round = (self._round + 1) % len(self._wire.rounds)
        if self._is_bus and now_ns is not None:
            self._now_ns = now_ns
            channel = self._channels[self._round]
            channel.asked_ns = now_ns if channel.asked_ns is None else channel.asked_ns
        return self._wire.rounds[self._round]

    @property
    def identity(self) -> str | None:
        for vesc, channel in self._by_id.items():
            version = channel.version
            if version is not None and version.major < _OLDEST_MAJOR:
                raise BadInputError(
                    f"VESC {vesc} has the firmware {version.major}.{version.minor:02}, and this driver knows "
                    f"{_OLDEST_MAJOR}.00 and newer; update it in VESC Tool"
                )
        if self.missing:
            return None
        words = ", ".join(f"{vesc} ({channel.version})" for vesc, channel in self._by_id.items())
        return f"four VESCs with the ids {words}"

    @property
    def missing(self) -> str:
        rate = "bit rate" if self._is_bus else f"baud= in the link, {_BAUD} as delivered"
        if silent := self._with(not channel.is_identified for channel in self._channels):
            return (
                f"no answer from the VESC {silent}; check power, wiring and {rate}, and in VESC Tool App "
                "Settings > General: VESC ID (device.motors.ids) and CAN Mode VESC"
            )
        if awaited := self._with(not channel.has_answered for channel in self._channels):
            return (
                f"no app configuration from the VESC {awaited} yet, which has its timeout; a long message was lost: "
                f"check wiring and {rate}, and start again"
            )
        mute = self._with(not channel.has_measured for channel in self._channels)
        return mute and (
            f"no status messages 1, 4 and 5 from the VESC {mute}; switch them on in VESC Tool, App Settings > General "
            "> CAN Status Messages, at the rate of device.motors.status_hz"
        )

    @property
    def warnings(self) -> Sequence[str]:
        dropped = [torques_dropped("a VESC")] if self._robot.mode is CommandMode.SPEED else []
        return [*timeout_warnings(self._by_id, self._robot), *dropped]

    def arm(self, now_ns: int) -> Sequence[Frame]:
        """See ``Driver``. A VESC needs no arming. It counts as armed when it reports no fault and no kill switch.

        Faults are asked for again at the start of arming: the last answers may be hours old.
        """
        if not self._is_arming:
            self._is_arming = True
            self._forget_faults()
        self._is_armed = all(channel.is_healthy for channel in self._channels)
        return self.command(_STILL, _STILL, now_ns) if self._is_armed else self._poll(now_ns)

    def _forget_faults(self) -> None:
        for channel in self._channels:
            channel.fault = channel.status = channel.asked_ns = None

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        """See ``Driver``. A VESC takes a speed or a current: in mode SPEED the torques are dropped."""
        if self._robot.mode is CommandMode.SPEED:
            settings = self._all(frames.SET_RPM, [speed * self._to_erpm for speed in speed_rad_s])
        else:
            settings = self._all(frames.SET_CURRENT, [torque * self._to_current for torque in torque_n_m])
        return [*settings, *self._poll(now_ns)]

    def _all(self, setting: frames.Setting, values: Sequence[float]) -> list[Frame]:
        return [self._wire.setting(setting, vesc, value) for vesc, value in zip(self._ids, values, strict=True)]

    def disarm(self) -> Sequence[Frame]:
        self._stand_down()
        return self._all(frames.SET_CURRENT, _STILL)

    def _stand_down(self) -> None:
        self._is_armed = self._is_arming = False
        for channel in self._channels:
            channel.asked_ns = None

    def estop(self) -> Sequence[Frame]:
        self._stand_down()
        return self._brakes()

    def last_stop(self) -> Sequence[Frame]:
        """See ``Driver``. Brake, and repeat it past the rest of an unfinished packet: no command follows."""
        return frames.repeated_past_packet(self._brakes())

    def _brakes(self) -> list[Frame]:
        return self._all(frames.SET_CURRENT_BRAKE, (self._brake_a,) * 4)

    def clear(self) -> Sequence[Frame]:
        """See ``Driver``. A fault ends by itself, by default 0.5 s after its cause, so it is only asked for again."""
        self._forget_faults()
        return ()

    def feed(self, frame: Frame, stamp_ns: int) -> str | None:
        if not self._is_bus:
            self._may_wait = False
            self._feed_message(None, bytes((frame.id & 0xFF,)) + frame.payload, stamp_ns)
        elif (received := self._messages.feed(frame)) is not None:
            self._feed_message(*received, stamp_ns)
        elif frame.id & EXTENDED and (channel := self._by_id.get(frame.id & 0xFF)) is not None:
            why = channel.feed_status((frame.id & ~EXTENDED) >> 8, frame.payload, stamp_ns)
            channel.forget_late(stamp_ns, self._late_ns)
            return why
        elif frame.id & 0xFF != frames.HOST:
            return ""
        return None

    def _feed_message(self, sender: int | None, message: bytes, stamp_ns: int) -> None:
        """Take a message. On a serial line (``sender`` None) only messages with values contain the sender's id.

        A version there belongs to the VESC whose values come next; two versions without values between them are
        dropped. A timeout is accepted only from the VESC that is asked for it and has identified itself.
        """
        if (version := frames.parse_version(message)) is not None:
            if sender is None:
                self._unassigned = (*self._unassigned[-1:], version)
            elif sender in self._by_id:
                self._by_id[sender].version = version
        elif (values := frames.parse_values(message)) is not None:
            channel = self._by_id.get(int(values.get("id", -1)) if sender is None else sender)
            if channel is not None:
                if len(self._unassigned) == 1:
                    channel.version = self._unassigned[0]
                channel.feed_values(values, stamp_ns)
                self._is_armed = self._is_armed and channel.is_healthy
            self._unassigned = ()
        elif (timeout := frames.parse_timeout(message)) is not None:
            vesc = self._asked
            if vesc is not None and sender in (None, vesc):
                self._by_id[vesc].feed_timeout(timeout, vesc)

    @property
    def sample(self) -> Sample | None:
        sample = super().sample
        steps_ns = min(channel.steps_ns for channel in self._channels)
        return sample and sample._replace(stamp_ns=holds_back(sample.stamp_ns, steps_ns, self._late_ns))

    def _problems(self, channel: Channel) -> Iterable[str]:
        if code := channel.fault:
            unknown = "see mc_fault_code in the maker's datatypes.h"
            yield f"has the fault {code}: {frames.FAULTS[code] if code < len(frames.FAULTS) else unknown}"
        if (channel.status or 0) & frames.KILL_SWITCH:
            yield "is stopped by its kill switch"
        if channel.asked_ns is not None and self._now_ns - channel.asked_ns > _UNANSWERED_NS:
            yield "has not answered for a second which fault it has"

    def restart(self) -> None:
        super().restart()
        self._is_arming = False
        self._asked = None
        self._may_wait = not self._is_bus
        self._unassigned = ()


class BusProbe(IdProbe):
    """Pings every id, and listens for status messages."""

    patience_s = ANSWER_S
    unknown = _UNKNOWN

    def ask(self) -> Sequence[Frame]:
        return [
            Frame(EXTENDED | frames.CAN_PING << 8 | number, bytes((frames.HOST,)))
            for number in range(frames.MAX_ID + 1)
            if number != frames.HOST
        ]

    def feed(self, frame: Frame) -> bool:
        command, number = (frame.id & ~EXTENDED) >> 8, frame.id & 0xFF
        if not frame.id & EXTENDED:
            return False
        found = b""
        if command == frames.CAN_STATUS and len(frame.payload) == frames.STATUS.size:
            found = bytes((number,))
        elif command == frames.CAN_PONG and number == frames.HOST and frame.payload[1:2] in (b"", bytes((_IS_VESC,))):
            found = frame.payload[:1]
        self._sentences |= {one: f"a VESC with the id {one}" for one in found}
        return number in self._sentences


class LineProbe(Probe):
    """Asks the VESC at the line for firmware and id. Those behind it are not looked for."""

    patience_s = ANSWER_S

    def __init__(self) -> None:
        self._version: frames.Version | None = None
        self._near: int | None = None

    def ask(self) -> Sequence[Frame]:
        if self._version is not None and self._near is not None:
            return ()
        request = frames.request_values(frames.ID_BIT)
        return [Frame(frames.FW_VERSION, b""), Frame(request[0], request[1:])]

    def feed(self, frame: Frame) -> bool:
        message = bytes((frame.id & 0xFF,)) + frame.payload
        self._version = frames.parse_version(message) or self._version
        if (values := frames.parse_values(message)) is not None and "id" in values:
            self._near = int(values["id"])
        return True  # other makers' packets fail the checksum

    def found(self) -> Found | None:
        if self._version is None or self._near is None:
            return None
        near = f"a VESC ({self._version}) with the id {self._near} at the line: write that as serial_id"
        return Found([near, "the ids of all four are in VESC Tool: write them as ids"], None, unknown=_UNKNOWN)


DIALECT = Dialect(
    title="VESC",
    wires=frozenset({"can", "serial"}),
    settings=Settings,
    make=Vesc,
    emulated="hil.addons.motors.vesc.emulated_vesc:EmulatedVesc",
    make_framing=frames.SerialFraming,
    probe=BusProbe,
    serial_probe=LineProbe,
    baud=_BAUD,
    description="VESC, over CAN or UART",
)
