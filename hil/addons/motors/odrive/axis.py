"""One ODrive axis: its newest messages, its errors in words, and the steps that bring it into closed loop."""

import math
from collections.abc import Callable, Generator, Sequence

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import Channel, expected_length
from hil.addons.motors.odrive import odrive_tables as can
from hil.addons.motors.odrive.odrive_tables import FIRMWARE_05, FIRMWARE_06, Endpoint, ErrorField, Firmware, Setup
from hil.core.types import NAN
from hil.robot.driver import REMOTE

_SILENT_NS = 1_000_000_000
_STATE_NS = 500_000_000  # heartbeats, which carry the state, come at 10 Hz by default
_REPLY_NS = 200_000_000
_CONFIRMATION_NS = 50_000_000
_TRIES = 3

Steps = Generator[Sequence[Frame], None, bool]


class Axis(Channel):
    """A node on the bus. Quantities are the motor's [rev, rev/s, A, V, °C], NaN if not known.

    A polled value becomes unknown when its newest answer is more than ``late_ns`` old. This is checked at each encoder
    estimate, because these arrive more often.

    Attributes:
        firmware: None while it is unknown, or if it is not supported.
        version, hardware: from Get_Version; None until then.
        trouble: why arming failed or closed loop ended; empty if neither happened.
    """

    def __init__(self, node: int, setup: Setup, late_ns: int) -> None:
        self.node = node
        self._setup = setup
        self._late_ns = late_ns
        self._base = node << can.NODE_SHIFT
        self._standstill = self.frame(*setup.standstill)
        super().__init__()

    def forget(self) -> None:
        super().forget()
        self.firmware: Firmware | None = None
        self.version: tuple[int, int, int] | None = None
        self.hardware: tuple[int, int, int] | None = None
        self._questions = self._answers = 0
        self._is_answer_new = False
        self.heartbeat_ns: int | None = None
        self.state = self._result = 0
        self._registers: dict[str, int] = {}
        self._flags = (0, 0, 0)
        self._is_cleared = self.is_silent = False
        self._current_ns = self._supply_ns = self._temperature_ns = 0
        self.stand_down()

    @property
    def firmware_words(self) -> str:
        """Firmware and hardware in words; call it when one of ``firmware`` and ``version`` is known."""
        if self.version is None or self.hardware is None:
            return "firmware 0.5.4 or newer of 0.5"
        return f"firmware {can.dotted(self.version)} on hardware {can.dotted(self.hardware)}"

    def stand_down(self) -> None:
        """Return to the state before arming, and forget why arming or closed loop ended."""
        self.trouble = ""
        self._arming: Steps | None = None
        self._is_followed = False
        self._awaited: int | None = None
        self._answer: bytes | None = None

    # Frames

    def frame(self, command: int, payload: bytes = b"") -> Frame:
        """Return the frame of a command."""
        return Frame(self._base | command, payload)

    def remote(self, command: int) -> Frame:
        """Return the remote frame that asks for the message with this command id."""
        return Frame(REMOTE | self._base | command, b"")

    def ask(self) -> Sequence[Frame]:
        """Ask what tells the firmware: 0.6 answers Get_Version, 0.5 only Get_Controller_Error."""
        self._questions += 1
        self._answers += self._is_answer_new
        self._is_answer_new = False
        if self.version is None and self._questions > _TRIES and self._answers >= _TRIES:
            self._set_firmware(FIRMWARE_05)
        return self.remote(can.GET_VERSION), self.remote(can.GET_CONTROLLER_ERROR)

    def poll(self, turn: int) -> Sequence[Frame]:
        """Ask for one of the messages that are not sent unasked; ``turn`` counts the calls."""
        if self.firmware is None:
            return self.ask()
        return (self.remote(self.firmware.polled[turn % len(self.firmware.polled)]),)

    # Received frames

    def feed(self, command: int, payload: bytes, stamp_ns: int) -> str | None:
        """Take a frame of this node. A frame of a wrong length, or with an impossible content, changes nothing.

        Return why not, as ``Driver.feed``.
        """
        if command == can.READ_SDO:
            if len(payload) > can.SDO.size and self.firmware is FIRMWARE_06:
                self._feed_sdo(payload)
        elif (why := expected_length(payload, 8)) is not None:
            return why
        elif command == can.GET_ESTIMATES:
            position, speed = can.TWO_FLOATS.unpack(payload)
            if not (math.isfinite(position) and math.isfinite(speed)):
                return "a position or speed that is not finite"
            self.position, self.speed, self.stamp_ns = position, speed, stamp_ns
            self._forget_late(stamp_ns)
        elif command == can.HEARTBEAT:
            self._feed_heartbeat(payload, stamp_ns)
        elif command == can.GET_VERSION:
            *hardware, major, minor, revision, _ = can.VERSION.unpack(payload)
            self.hardware = (hardware[0], hardware[1], hardware[2])
            self.version = (major, minor, revision)
            self._set_firmware(FIRMWARE_06 if self.version[:2] == (0, 6) else None)
        else:
            self._feed_polled(command, payload, stamp_ns)
        return None

    def _forget_late(self, now_ns: int) -> None:
        begin_ns = now_ns - self._late_ns
        if self._current_ns < begin_ns:
            self.current_a = NAN
        if self._supply_ns < begin_ns:
            self.supply_v = self.supply_a = NAN
        if self._temperature_ns < begin_ns:
            self.temperature_degc = NAN

    def _feed_heartbeat(self, payload: bytes, stamp_ns: int) -> None:
        error, self.state, *flags = can.BEAT.unpack(payload)
        self._result = flags[0]
        was_cleared, self._is_cleared = self._is_cleared, False
        if self._is_followed and self.state != can.CLOSED_LOOP:
            self.trouble = f"left closed loop by itself{self._procedure_result()}"
        if was_cleared and error:
            return  # it may have been sent before the errors were cleared: wait for the next one
        # 0.6 has other values there.
        self._flags = (flags[0] & 1, flags[1] & 1, flags[2] & 1) if self.firmware is FIRMWARE_05 else (0, 0, 0)
        self.heartbeat_ns, self.is_silent = stamp_ns, False
        self._feed_errors(can.HEARTBEAT, payload)

    def clear(self) -> Sequence[Frame]:
        """Return the frame that clears the errors. Forget the known errors, until the next heartbeat."""
        self.stand_down()
        if self.firmware is None:
            return ()
        self._registers.clear()
        self._flags = (0, 0, 0)
        self._is_cleared, self.heartbeat_ns = True, None
        return (self.frame(can.CLEAR_ERRORS, self.firmware.clear),)

    def _set_firmware(self, firmware: Firmware | None) -> None:
        if firmware is not self.firmware:
            self.firmware = firmware
            self.heartbeat_ns, self._flags = None, (0, 0, 0)  # the last one was not decoded with this firmware

    def _feed_polled(self, command: int, payload: bytes, stamp_ns: int) -> None:
        first, second = (value if math.isfinite(value) else NAN for value in can.TWO_FLOATS.unpack(payload))
        if command == can.GET_CONTROLLER_ERROR:
            self._is_answer_new = True
        if command == can.GET_IQ:
            self.current_a, self._current_ns = second, stamp_ns
        elif command == can.GET_BUS:
            self.supply_v, self._supply_ns = first, stamp_ns
            self.supply_a = second if self.firmware is FIRMWARE_06 else NAN  # on 0.5 two axes report the same board
        elif command == can.GET_TEMPERATURE and self.firmware is FIRMWARE_06:
            # The hotter of inverter and motor; a motor without a sensor reports NaN.
            self.temperature_degc = max((t for t in (first, second) if t == t), default=NAN)
            self._temperature_ns = stamp_ns
        self._feed_errors(command, payload)

    def _feed_errors(self, command: int, payload: bytes) -> None:
        if self.firmware is None or self.heartbeat_ns is None:
            return
        for field in self.firmware.errors:
            if field.command == command:
                self._registers[field.name] = field.layout.unpack(payload)[field.position]
            elif command == can.HEARTBEAT and field.flag is not None and not self._flags[field.flag]:
                self._registers.pop(field.name, None)

    def _feed_sdo(self, payload: bytes) -> None:
        _, number, _ = can.SDO.unpack_from(payload)
        if number == self._awaited:
            self._answer = payload[can.SDO.size :]

    def check_heartbeat(self, now_ns: int) -> None:
        """Set ``is_silent`` if no heartbeat came for a second: the axis does not count as in closed loop then."""
        self.is_silent = self.heartbeat_ns is not None and now_ns - self.heartbeat_ns > _SILENT_NS

    @property
    def has_errors(self) -> bool:
        """Whether ``errors`` is not empty."""
        return self.is_silent or bool(self.trouble) or any(self._flags) or any(self._registers.values())

    @property
    def is_closed_loop(self) -> bool:
        """Whether it follows commands: it was armed from here, reports closed loop, and has no errors."""
        return self._is_followed and self.state == can.CLOSED_LOOP and not self.has_errors

    @property
    def errors(self) -> str:
        """The errors in the makers' terms; empty without errors."""
        reasons: list[str] = []
        seen = set()  # firmware 0.6 has the same error in up to three registers
        for field in self.firmware.errors if self.firmware is not None else ():
            value = self._registers.get(field.name, 0)
            if value and (id(field.bits), value) not in seen:
                seen.add((id(field.bits), value))
                reasons.append(f"{field.name} {can.bit_names(value, field.bits)}")
        reasons += [f"{field.name}, not read yet" for field in self._pending_errors()]
        if self.is_silent:
            reasons.append("no heartbeat for more than a second")
        if self.trouble:
            reasons.append(self.trouble)
        return "; ".join(reasons)

    def ask_for_errors(self) -> Sequence[Frame]:
        """Ask for the error registers that the heartbeat of 0.5 flags and that have not been read."""
        return [self.remote(field.command) for field in self._pending_errors()]

    def _pending_errors(self) -> Sequence[ErrorField]:
        fields = FIRMWARE_05.errors
        return [f for f in fields if f.flag is not None and self._flags[f.flag] and not self._registers.get(f.name)]

    # Arming

    def arm(self, now_ns: int) -> Sequence[Frame]:
        """Return the frames of the next step of arming; in closed loop, the command of standstill."""
        self._now_ns = now_ns
        if self._arming is None:
            self._arming = self._steps()
        return next(self._arming, ())

    def _steps(self) -> Steps:
        if not (yield from self._reach(can.IDLE, ())):
            self.trouble = "does not become idle"
            return False
        for endpoint in self._setup.watchdog:
            self.trouble = yield from self._write(endpoint)
            if self.trouble:
                return False
        # Inputs survive idle: set them to standstill before closed loop would follow old ones.
        modes = self.frame(can.SET_MODES, can.TWO_WORDS.pack(self._setup.control_mode, can.PASSTHROUGH))
        if not (yield from self._reach(can.CLOSED_LOOP, (modes, self._standstill))):
            self.trouble = f"does not enter closed loop{self._procedure_result()}; look at it with odrivetool"
            return False
        self._is_followed = True
        while True:
            yield (self._standstill,)

    def _procedure_result(self) -> str:
        if self.firmware is not FIRMWARE_06:
            return ""
        return f": its procedure result is {self._result}"

    def _reach(self, state: int, before: Sequence[Frame]) -> Steps:
        """Request a state up to three times, and return whether it is reached. In that state nothing is requested."""
        for _ in range(_TRIES):
            if self.state == state:
                return True
            yield (*before, self.frame(can.SET_AXIS_STATE, can.STATE.pack(state)))
            yield from self._until(lambda: self.state == state, _STATE_NS)
        return self.state == state

    def _write(self, endpoint: Endpoint) -> Generator[Sequence[Frame], None, str]:
        """Write a value to an endpoint and read it back; return the problem in words, empty for none."""
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
            # From 0.6.11 on a write is confirmed by a frame that looks like the answer to a read.
            yield from self._until(lambda: False, _CONFIRMATION_NS)
        return f"{endpoint.name} (endpoint {endpoint.number}) could not be set and read back"

    def _until(self, condition: Callable[[], bool], within_ns: int) -> Steps:
        """Wait for a condition; return whether it came true in time. Standstill commands feed a running watchdog."""
        begin_ns = self._now_ns
        while not condition():
            if self._now_ns - begin_ns > within_ns:
                return False
            yield (self._standstill,)
        return True
