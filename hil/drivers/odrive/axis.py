"""One ODrive axis as its host sees it: what it said, its errors in words, and its way into closed loop."""

import math
from collections.abc import Callable, Generator, Sequence

from firmware_protocol.framing import Frame
from hil.core.types import NAN
from hil.drivers.odrive import tables as can
from hil.drivers.odrive.settings import Endpoint, Setup
from hil.drivers.odrive.tables import FIRMWARE_05, FIRMWARE_06, ErrorField, Firmware
from hil.drivers.port import REMOTE

_SILENT_NS = 1_000_000_000
_PATIENCE_NS = 500_000_000  # heartbeats, which tell the state, come ten times a second as the makers set them
_REPLY_NS = 200_000_000
_CONFIRMATION_NS = 50_000_000
_TRIES = 3

Steps = Generator[Sequence[Frame], None, bool]


class Axis:
    """A node on the bus. Quantities are the motor's: revolutions, amperes, volts, degrees Celsius, NaN if not known.

    ``firmware`` is None until it is known, and for one that is not known here; ``version`` and ``hardware`` are what
    Get_Version said. What is asked for in turn is not known any more ``late_ns`` after the newest answer, by the time
    of the estimates, which come more often. ``trouble`` says why arming or closed loop ended, empty while it did not.
    """

    def __init__(self, node: int, wheel: str, setup: Setup, late_ns: int) -> None:
        self.node = node
        self.wheel = wheel
        self._setup = setup
        self._late_ns = late_ns
        self._base = node << can.NODE_SHIFT
        self._standstill = self.frame(*setup.standstill)
        self.forget()

    def forget(self) -> None:
        """Begin as if nothing had been heard."""
        self.firmware: Firmware | None = None
        self.version: tuple[int, int, int] | None = None
        self.hardware: tuple[int, int, int] | None = None
        self._asked = 0
        self._answered = 0
        self._is_answer_new = False
        self.heartbeat_ns: int | None = None
        self.state = 0
        self._result = 0
        self._words: dict[str, int] = {}
        self._flags = (0, 0, 0)
        self._is_cleared = False
        self.is_silent = False
        self.estimates_ns: int | None = None
        self.position_rev = NAN
        self.speed_rev_s = NAN
        self.current_a = NAN
        self.temperature_degc = NAN
        self.bus_v = NAN
        self.bus_a = NAN
        self._current_ns = self._bus_ns = self._temperature_ns = 0
        self.stand_down()

    def stand_down(self) -> None:
        """Forget how far arming was, and why it ended."""
        self.trouble = ""
        self._arming: Steps | None = None
        self._is_followed = False
        self._awaited: int | None = None
        self._answer: bytes | None = None

    # Frames

    def frame(self, command: int, payload: bytes = b"") -> Frame:
        """Return a command."""
        return Frame(self._base | command, payload)

    def remote(self, command: int) -> Frame:
        """Return the request for what this command's id carries."""
        return Frame(REMOTE | self._base | command, b"")

    def ask(self) -> Sequence[Frame]:
        """Ask for the version, in both ways: 0.5 has no Get_Version, and answers Get_Controller_Error."""
        self._asked += 1
        self._answered += self._is_answer_new
        self._is_answer_new = False
        if self.version is None and self._asked > _TRIES and self._answered >= _TRIES:
            self._take_firmware(FIRMWARE_05)
        return self.remote(can.GET_VERSION), self.remote(can.GET_CONTROLLER_ERROR)

    def poll(self, turn: int) -> Sequence[Frame]:
        """Ask for one of what is not sent by itself, in turn."""
        if self.firmware is None:
            return self.ask()
        return (self.remote(self.firmware.polled[turn % len(self.firmware.polled)]),)

    # What it says

    def feed(self, command: int, payload: bytes, stamp_ns: int) -> None:
        """Take a frame of this node; one of a length or content that cannot be changes nothing."""
        if command == can.READ_SDO:
            if len(payload) > can.SDO.size and self.firmware is FIRMWARE_06:
                self._take_sdo(payload)
        elif len(payload) != 8:
            return
        elif command == can.GET_ESTIMATES:
            position, speed = can.TWO_FLOATS.unpack(payload)
            if math.isfinite(position) and math.isfinite(speed):
                self.position_rev, self.speed_rev_s, self.estimates_ns = position, speed, stamp_ns
                self._forget_late(stamp_ns)
        elif command == can.HEARTBEAT:
            self._take_heartbeat(payload, stamp_ns)
        elif command == can.GET_VERSION:
            *hardware, major, minor, revision, _ = can.VERSION.unpack(payload)
            self.hardware = (hardware[0], hardware[1], hardware[2])
            self.version = (major, minor, revision)
            self._take_firmware(FIRMWARE_06 if self.version[:2] == (0, 6) else None)
        else:
            self._take_polled(command, payload, stamp_ns)

    def _forget_late(self, now_ns: int) -> None:
        begin_ns = now_ns - self._late_ns
        if self._current_ns < begin_ns:
            self.current_a = NAN
        if self._bus_ns < begin_ns:
            self.bus_v = self.bus_a = NAN
        if self._temperature_ns < begin_ns:
            self.temperature_degc = NAN

    def _take_heartbeat(self, payload: bytes, stamp_ns: int) -> None:
        error, self.state, *flags = can.BEAT.unpack(payload)
        self._result = flags[0]
        was_cleared, self._is_cleared = self._is_cleared, False
        if self._is_followed and self.state != can.CLOSED_LOOP:
            self.trouble = f"left closed loop by itself{self._said()}"
        if was_cleared and error:
            return  # it may have been on its way when the errors were cleared: the next one counts
        self._flags = (flags[0] & 1, flags[1] & 1, flags[2] & 1)
        self.heartbeat_ns, self.is_silent = stamp_ns, False
        self._take_errors(can.HEARTBEAT, payload)

    def clear(self) -> Sequence[Frame]:
        """Return what clears the errors; what was known of them is forgotten, and the next heartbeat awaited."""
        self.stand_down()
        if self.firmware is None:
            return ()
        self._words.clear()
        self._flags = (0, 0, 0)
        self._is_cleared, self.heartbeat_ns = True, None
        return (self.frame(can.CLEAR_ERRORS, self.firmware.clear),)

    def _take_firmware(self, firmware: Firmware | None) -> None:
        if firmware is not self.firmware:
            self.firmware = firmware
            self.heartbeat_ns = None  # the next one can be understood

    def _take_polled(self, command: int, payload: bytes, stamp_ns: int) -> None:
        first, second = (value if math.isfinite(value) else NAN for value in can.TWO_FLOATS.unpack(payload))
        if command == can.GET_CONTROLLER_ERROR:
            self._is_answer_new = True
        if command == can.GET_IQ:
            self.current_a, self._current_ns = second, stamp_ns
        elif command == can.GET_BUS:
            self.bus_v, self.bus_a, self._bus_ns = first, second, stamp_ns
        elif command == can.GET_TEMPERATURE and self.firmware is FIRMWARE_06:
            # A motor without a sensor says NaN or nothing: the hotter of inverter and motor is told.
            self.temperature_degc = max((t for t in (first, second) if t == t), default=NAN)
            self._temperature_ns = stamp_ns
        self._take_errors(command, payload)

    def _take_errors(self, command: int, payload: bytes) -> None:
        if self.firmware is None or self.heartbeat_ns is None:
            return
        for field in self.firmware.errors:
            if field.command == command:
                self._words[field.name] = field.layout.unpack(payload)[field.place]
            elif command == can.HEARTBEAT and field.flag is not None and not self._flags[field.flag]:
                self._words.pop(field.name, None)

    def _take_sdo(self, payload: bytes) -> None:
        _, number, _ = can.SDO.unpack_from(payload)
        if number == self._awaited:
            self._answer = payload[can.SDO.size :]

    def listen(self, now_ns: int) -> None:
        """Take note of the time: an axis without heartbeats is not in closed loop as far as anyone knows."""
        self.is_silent = self.heartbeat_ns is not None and now_ns - self.heartbeat_ns > _SILENT_NS

    @property
    def has_errors(self) -> bool:
        """Whether ``errors`` would say anything."""
        return self.is_silent or bool(self.trouble) or any(self._flags_05()) or any(self._words.values())

    @property
    def is_closed_loop(self) -> bool:
        """Whether it follows commands, as far as it says: in the closed loop that it was armed for here."""
        return self._is_followed and self.state == can.CLOSED_LOOP and not self.has_errors

    @property
    def errors(self) -> str:
        """What it reports, in the makers' terms; empty for nothing."""
        reasons: list[str] = []
        told = set()  # firmware 0.6 says the same in up to three places
        for field in self.firmware.errors if self.firmware is not None else ():
            word = self._words.get(field.name, 0)
            if word and (id(field.bits), word) not in told:
                told.add((id(field.bits), word))
                reasons.append(f"{field.name} {can.bit_names(word, field.bits)}")
        reasons += [f"{field.name}, not read yet" for field in self._unread()]
        if self.is_silent:
            reasons.append("no heartbeat for more than a second")
        if self.trouble:
            reasons.append(self.trouble)
        return f"ODrive node {self.node} of wheel {self.wheel}: {'; '.join(reasons)}" if reasons else ""

    def ask_for_unread(self) -> Sequence[Frame]:
        """Ask for those errors of which the heartbeat of 0.5 only says that there are some."""
        return [self.remote(field.command) for field in self._unread()]

    def _unread(self) -> Sequence[ErrorField]:
        if not any(self._flags_05()):
            return ()
        fields = FIRMWARE_05.errors
        return [f for f in fields if f.flag is not None and self._flags[f.flag] and not self._words.get(f.name)]

    def _flags_05(self) -> tuple[int, int, int]:
        return self._flags if self.firmware is FIRMWARE_05 else (0, 0, 0)

    # Arming

    def arm(self, now_ns: int) -> Sequence[Frame]:
        """Return the frames of the next step; once closed loop is there, those that hold the standstill."""
        self._now_ns = now_ns
        if self._arming is None:
            self._arming = self._steps()
        return next(self._arming, ())

    def _request(self, state: int) -> Frame:
        return self.frame(can.SET_AXIS_STATE, can.STATE.pack(state))

    def _steps(self) -> Steps:
        if not (yield from self._told(can.IDLE, ())):
            self.trouble = "does not become idle"
            return False
        for endpoint in self._setup.watchdog:
            self.trouble = yield from self._write(endpoint)
            if self.trouble:
                return False
        # Inputs survive idle: those of whoever drove before are set to standstill before closed loop takes them up.
        modes = self.frame(can.SET_MODES, can.TWO_WORDS.pack(self._setup.control_mode, can.PASSTHROUGH))
        if not (yield from self._told(can.CLOSED_LOOP, (modes, self._standstill))):
            self.trouble = f"does not enter closed loop{self._said()}; look at it with odrivetool"
            return False
        self._is_followed = True
        while True:
            yield (self._standstill,)

    def _said(self) -> str:
        if self.firmware is not FIRMWARE_06:
            return ""
        return f": it says {can.PROCEDURE_RESULTS.get(self._result, str(self._result))}"

    def _told(self, state: int, before: Sequence[Frame]) -> Steps:
        """Request a state, again if that seems lost, until it is there. A request in that state would restart it."""
        for _ in range(_TRIES):
            if self.state == state:
                return True
            yield (*before, self._request(state))
            yield from self._until(lambda: self.state == state, _PATIENCE_NS)
        return self.state == state

    def _write(self, endpoint: Endpoint) -> Generator[Sequence[Frame], None, str]:
        """Let an endpoint hold its value, and read that back; return why that is not so, empty if it is."""
        head = can.SDO.pack(0, endpoint.number, 0)[1:]
        for _ in range(_TRIES):
            self._answer, self._awaited = None, endpoint.number
            yield (self.frame(can.WRITE_SDO, can.READ + head),)
            if not (yield from self._until(lambda: self._answer is not None, _REPLY_NS)):
                continue
            value = self._answer or b""
            if value[: len(endpoint.target)] == endpoint.target:
                return ""
            if not endpoint.is_plausible(value):
                return f"endpoint {endpoint.number} is not {endpoint.name}; check device.motors.watchdog_endpoints"
            yield (self.frame(can.WRITE_SDO, can.WRITE + head + endpoint.target),)
            # From 0.6.11 on a write is confirmed by a frame like that of a read.
            yield from self._until(lambda: False, _CONFIRMATION_NS)
        return f"{endpoint.name} (endpoint {endpoint.number}) could not be set and read back"

    def _until(self, condition: Callable[[], bool], within_ns: int) -> Steps:
        """Wait, with a standstill in each tick: an axis whose watchdog already runs is fed by it."""
        begin_ns = self._now_ns
        while not condition():
            if self._now_ns - begin_ns > within_ns:
                return False
            yield (self._standstill,)
        return True
