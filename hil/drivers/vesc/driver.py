"""VESC: takes an electrical speed or a current, over CAN, or over UART through one VESC that forwards to the others.

Over CAN the VESCs broadcast their state (STATUS 1, 4 and 5, switched on in VESC Tool), and are asked for their fault
codes in turn. Over UART they send nothing unasked: every tick asks the VESC at the line and one of the others.
A VESC has no arming: it obeys every command, and when commands end its own timeout stops the motor. The timeout is read
at the start; the driver warns if it is missing, too long or too short.
Source: see hil/drivers/vesc/frames.py.
"""

import math
from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES, CommandMode, FourWheels
from hil.drivers.port import (
    EXTENDED,
    Capabilities,
    Dialect,
    Driver,
    RobotFacts,
    Sample,
    chosen,
    four,
    holds_back,
    late_ns,
    lowest,
    oldest,
    torques_dropped,
)
from hil.drivers.vesc import frames
from hil.drivers.vesc.channel import Channel
from hil.drivers.vesc.probe import BusProbe, LineProbe
from hil.drivers.vesc.settings import Settings
from hil.drivers.vesc.timeout import has_timeout, timeout_warnings
from hil.drivers.vesc.wires import Bus, Line, repeated_past_packet

_OLDEST_MAJOR = 5
_MAX_CALLS = 2  # of ``ask``, in which one VESC may answer its questions
_UNANSWERED_NS = 1_000_000_000  # a VESC that leaves the question for its fault unanswered so long is in error
_STILL: FourWheels = (0.0, 0.0, 0.0, 0.0)
_BAUD = 115_200


class Vesc(Driver):
    """Drives four VESCs."""

    def __init__(self, settings: Settings, robot: RobotFacts) -> None:
        self._settings = settings
        self._robot = robot
        self._channels = tuple(Channel() for _ in settings.ids)
        self._by_id = dict(zip(settings.ids, self._channels, strict=True))
        self._is_bus = robot.wire == "can"
        self._wire = Bus(settings.ids, settings.host_id) if self._is_bus else Line(settings.ids, settings.serial_id)
        self._messages = frames.CanMessages(settings.host_id)
        self._rounds = self._wire.rounds
        self._round = 0
        self._asked: int | None = None  # the VESC whose answers are awaited
        self._may_wait = not self._is_bus  # the VESC at the line may wait for the rest of an unfinished packet
        self._unassigned: Sequence[frames.Version] = ()  # versions on a serial line, until values with an id follow
        self._turn = 0
        self._calls = 0  # of ``ask`` since the newest questions
        self._is_armed = self._is_arming = False
        self._has_commanded = False
        self._to_erpm = settings.gear_ratio * settings.pole_pairs * 60.0 / math.tau
        self._to_current = 1.0 / robot.torque_constant_n_m_a
        self._brake_a = settings.brake_current_a or robot.torque_limit_n_m * self._to_current
        rate_hz = settings.status_hz if self._is_bus else 1.0 / (robot.period_s * len(self._rounds))
        self._late_ns = late_ns(1.0 / rate_hz)
        self._now_ns = 0
        self._capabilities = Capabilities(
            modes=frozenset(CommandMode),
            is_twist=False,
            feedback_hz=rate_hz,
            sensors=frozenset({"position", "current", "temperature", "battery_voltage", "battery_current"}),
            adds_torque=False,
            watchdog="none",
            latches_estop=False,
        )

    @property
    def capabilities(self) -> Capabilities:
        """See ``Driver``. There is a watchdog when all four have reported a timeout of at most ``watchdog_s``."""
        if all(has_timeout(channel, self._robot) for channel in self._channels):
            return self._capabilities._replace(watchdog="fixed")
        return self._capabilities

    def ask(self) -> Sequence[Frame]:
        """See ``Driver``. Ask one VESC at a time; the next one after an answer, or after ``_MAX_CALLS`` calls.

        A missing timeout does not delay the others. When the first question over a line stays unanswered, the VESC at
        the line may be waiting for the rest of a packet, and hold old commands. Then stops go before the next question,
        so many of them that a stop is the last command that it executes when its wait ends.
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
                before = repeated_past_packet(self._all(frames.SET_CURRENT, _STILL))
                self._may_wait = False
                self._has_commanded = True
        open_ids = [vesc for vesc, channel in self._by_id.items() if not channel.has_answered]
        if not open_ids:
            self._asked = None
            return self._poll()
        later = [vesc for vesc in open_ids if self._settings.ids.index(vesc) >= self._turn]
        self._asked, self._calls = (later or open_ids)[0], 0
        self._turn = self._settings.ids.index(self._asked) + 1
        channel = self._by_id[self._asked]
        questions = [] if channel.is_identified else [*self._wire.questions]
        if channel.needs_timeout:
            questions.append(bytes((frames.GET_APPCONF,)))
        return [*before, *(self._wire.message(self._asked, question) for question in questions)]

    def _poll(self, now_ns: int | None = None) -> Sequence[Frame]:
        """Ask the next VESC. ``asked_ns`` is for CAN only: over a line the fault comes with the speed."""
        self._round = (self._round + 1) % len(self._rounds)
        if self._is_bus and now_ns is not None:
            self._now_ns = now_ns
            channel = self._channels[self._round]
            channel.asked_ns = now_ns if channel.asked_ns is None else channel.asked_ns
        return self._rounds[self._round]

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
        words = [
            f"{vesc} ({version.hardware or 'unnamed'}, firmware {version.major}.{version.minor:02})"
            for vesc, channel in self._by_id.items()
            if (version := channel.version) is not None
        ]
        return f"four VESCs with the ids {', '.join(words)}"

    @property
    def missing(self) -> str:
        rate = "bit rate" if self._is_bus else f"baud= in the link, {_BAUD} as delivered"
        silent = chosen(self._by_id, (not channel.is_identified for channel in self._channels))
        if silent:
            return (
                f"no answer from the VESC {silent}; check power, wiring and {rate}, and in VESC Tool App "
                "Settings > General: VESC ID (device.motors.ids) and CAN Mode VESC"
            )
        awaited = chosen(self._by_id, (not channel.has_answered for channel in self._channels))
        if awaited:
            return (
                f"no app configuration from the VESC {awaited} yet, which has its timeout; a long message was lost: "
                f"check wiring and {rate}, and start again"
            )
        mute = chosen(self._by_id, (not channel.has_measured for channel in self._channels))
        if mute:
            return (
                f"no status messages 1, 4 and 5 from the VESC {mute}; switch them on in VESC Tool, App "
                "Settings > General > CAN Status Messages, at the rate of device.motors.status_hz"
            )
        return ""

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
        self._has_commanded = True
        if self._robot.mode is CommandMode.SPEED:
            settings = self._all(frames.SET_RPM, [speed * self._to_erpm for speed in speed_rad_s])
        else:
            settings = self._all(frames.SET_CURRENT, [torque * self._to_current for torque in torque_n_m])
        return [*settings, *self._poll(now_ns)]

    def _all(self, setting: frames.Setting, values: Sequence[float]) -> list[Frame]:
        return [
            self._wire.setting(setting, vesc, value) for vesc, value in zip(self._settings.ids, values, strict=True)
        ]

    def disarm(self) -> Sequence[Frame]:
        self._stand_down()
        return self._all(frames.SET_CURRENT, _STILL)

    def _stand_down(self) -> None:
        """Note that questions for faults end here, and that a stop is sent, which is a command for the timeout too."""
        self._is_armed = self._is_arming = False
        self._has_commanded = True
        for channel in self._channels:
            channel.asked_ns = None

    def estop(self) -> Sequence[Frame]:
        self._stand_down()
        return self._brakes()

    def last_stop(self) -> Sequence[Frame]:
        """See ``Driver``. Brake, and repeat it past the rest of an unfinished packet: no command follows."""
        return repeated_past_packet(self._brakes())

    def _brakes(self) -> list[Frame]:
        return self._all(frames.SET_CURRENT_BRAKE, (self._brake_a,) * 4)

    def clear(self) -> Sequence[Frame]:
        """See ``Driver``. A fault ends by itself, by default 0.5 s after its cause, so it is only asked for again."""
        self._forget_faults()
        return ()

    def feed(self, frame: Frame, stamp_ns: int) -> None:
        if not self._is_bus:
            self._may_wait = False
            self._feed_message(None, bytes((frame.id & 0xFF,)) + frame.payload, stamp_ns)
        elif (received := self._messages.feed(frame)) is not None:
            self._feed_message(*received, stamp_ns)
        elif frame.id & EXTENDED and (channel := self._by_id.get(frame.id & 0xFF)) is not None:
            channel.feed_status((frame.id & ~EXTENDED) >> 8, frame.payload, stamp_ns)
            channel.forget_late(stamp_ns, self._late_ns)

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
                channel.feed_values(values, stamp_ns, self._has_commanded)
                self._is_armed = self._is_armed and channel.is_healthy
            self._unassigned = ()
        elif (timeout := frames.parse_timeout(message)) is not None:
            vesc = self._asked
            if vesc is not None and sender in (None, vesc) and self._by_id[vesc].accepts_timeout:
                self._by_id[vesc].feed_timeout(timeout, vesc)

    @property
    def sample(self) -> Sample | None:
        channels = self._channels
        stamp_ns = oldest(channel.stamp_ns for channel in channels)
        if stamp_ns is None:
            return None
        to_speed = 1.0 / self._to_erpm
        to_angle = math.tau / (frames.STEPS * self._settings.pole_pairs * self._settings.gear_ratio)
        steps_ns = min(channel.steps_ns for channel in channels)
        return Sample(
            holds_back(stamp_ns, steps_ns, self._late_ns),
            four(channel.erpm * to_speed for channel in channels),
            four(channel.position * to_angle for channel in channels),
            four(channel.motor_a for channel in channels),
            four(channel.fet_degc for channel in channels),
            lowest(channel.input_v for channel in channels),
            math.fsum(channel.input_a for channel in channels),
        )

    @property
    def errors(self) -> Sequence[str]:
        errors = []
        for vesc, channel, wheel in zip(self._settings.ids, self._channels, self._robot.wheel_of_channel, strict=True):
            name = f"VESC {vesc} of wheel {WHEEL_NAMES[wheel]}"
            if code := channel.fault:
                words = (
                    frames.FAULTS[code] if code < len(frames.FAULTS) else "see mc_fault_code in the maker's datatypes.h"
                )
                errors.append(f"{name} has the fault {code}: {words}")
            if (channel.status or 0) & frames.KILL_SWITCH:
                errors.append(f"{name} is stopped by its kill switch")
            if channel.asked_ns is not None and self._now_ns - channel.asked_ns > _UNANSWERED_NS:
                errors.append(f"{name} has not answered for a second which fault it has")
        return errors

    def restart(self) -> None:
        self._is_armed = self._is_arming = self._has_commanded = False
        self._asked = None
        self._may_wait = not self._is_bus
        self._unassigned = ()
        for channel in self._channels:
            channel.forget()


DIALECT = Dialect(
    title="VESC",
    wires=frozenset({"can", "serial"}),
    settings=Settings,
    make=Vesc,
    emulated="hil.drivers.vesc.emulated:EmulatedVesc",
    make_framing=frames.SerialFraming,
    probe=BusProbe,
    serial_probe=LineProbe,
    baud=_BAUD,
    watchdog_setting="a Timeout of at most firmware.watchdog_s, set in VESC Tool",
)
