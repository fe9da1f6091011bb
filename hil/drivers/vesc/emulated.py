"""Four emulated VESCs, after their published firmware: on one CAN bus, one of them also at a serial line.

They have the maker's defaults: a timeout of 1 s without brake current, and faults that keep a motor off for 0.5 s. The
app configuration has real values only at its beginning, where firmware 5 and 6 have the timeout; it is as long as that
of 6.00 or 6.05. The minimum ERPM of the speed controller is 0, as hil/drivers/vesc/VESC.md requires. Status messages
are sent at ``status_hz``.
"""

import math
from functools import partial

from firmware_protocol.framing import Frame
from hil.core.types import FourWheels
from hil.drivers.emulated import EmulatedMotors
from hil.drivers.port import four
from hil.drivers.vesc.driver import Settings
from hil.drivers.vesc.emulated_controller import VescController, can_parts, first_packet, packet

_EXTENDED = 0x8000_0000
_UNDER_VOLTAGE, _HOT_MOTOR = 2, 6
_MIN_V = 8.0
_IDS, _PING_TICKS = 255, 10
_SET_CURRENT, _SHORT_MESSAGE, _PING, _PONG = 1, 8, 17, 18
# A current with a switch-off delay is ignored: the maker's page has the current first, the firmware reads it last, and
# a misread current would drive the motor.
_WITH_DELAY_BYTES = 6


class EmulatedVesc(EmulatedMotors[Settings]):
    """Emulates four VESCs.

    Attributes:
        vescs: the four controllers, for tests that change one of them.
    """

    def power_on(self) -> None:
        settings = self.settings
        self._open = b""
        self._bytes = bytearray()
        self._scan_left = 0
        to_erpm = settings.gear_ratio * settings.pole_pairs * 60.0 / math.tau
        self._steps_per_rad = 6 * settings.pole_pairs * settings.gear_ratio / math.tau
        constant, resistance = self.values["torque_constant_n_m_a"], self.values["motor_resistance_ohm"]
        limit = self.values["torque_limit_n_m"]
        self.vescs = tuple(
            VescController(number, to_erpm, constant, resistance, limit, loop)
            for number, loop in zip(settings.ids, self.loops, strict=True)
        )
        self._by_id = {vesc.number: vesc for vesc in self.vescs}
        self._measure()

    @property
    def is_driving(self) -> bool:
        return any(vesc.is_driving for vesc in self.vescs)

    def tick(self) -> FourWheels | None:
        self._measure()
        if self._scan_left:
            self._scan_left -= 1
            if not self._scan_left:
                self._serial_reply(bytes((62, *self._behind())))
        period = max(round(1000.0 / self.settings.status_hz), 1)
        for channel, vesc in enumerate(self.vescs):
            if self.ticks % period == channel * period // 4:
                for command, data in vesc.statuses():
                    self.send(Frame(_EXTENDED | command << 8 | vesc.number, data))
            if vesc.is_driving and self.battery_v < _MIN_V:
                vesc.fail(_UNDER_VOLTAGE)
            elif vesc.is_driving and self.temperature_degc[channel] > self.values["temperature_limit_degc"]:
                vesc.fail(_HOT_MOTOR)
        torques = [vesc.torque() for vesc in self.vescs]
        if all(torque is None for torque in torques):
            return None
        return four(torque or 0.0 for torque in torques)

    def _measure(self) -> None:
        for channel, vesc in enumerate(self.vescs):
            vesc.measure(self.shafts[channel], self._steps_per_rad)
            vesc.current_a, vesc.degc = self.current_a[channel], self.temperature_degc[channel]
            vesc.input_v, vesc.input_a = self.battery_v, self.battery_a / 4.0

    # CAN

    def receive(self, frame: Frame) -> None:
        command, number, data = (frame.id & 0x1FFF_FFFF) >> 8, frame.id & 0xFF, frame.payload
        if not frame.id & _EXTENDED:
            return
        for vesc in self.vescs:
            if number not in (vesc.number, 255) or (command == _SET_CURRENT and len(data) >= _WITH_DELAY_BYTES):
                continue
            if vesc.obey(command, data):
                continue
            if command == _SHORT_MESSAGE and len(data) > 2 and data[1] in (0, 2):
                vesc.process(data[2:], partial(self._can_reply, vesc.number, data[0], data[1] == 0))
            elif command == _PING and data:
                self.send(Frame(_EXTENDED | _PONG << 8 | data[0], bytes((vesc.number, 0))))

    def _can_reply(self, sender: int, to: int, is_wanted: bool, message: bytes) -> None:
        for command, data in can_parts(sender, message) if is_wanted else ():
            self.send(Frame(_EXTENDED | command << 8 | to, data))

    # The serial line

    def feed(self, data: bytes) -> None:
        self._open += data
        while self._open:
            size, message = first_packet(self._open)
            if size == 0:
                return
            self._open = self._open[size:]
            if message:
                self._process(message)

    def _process(self, message: bytes) -> None:
        near = self.settings.serial_id
        if message[0] == 62:
            # Existing ids answer at once; the others take time. A request during a scan does not restart it.
            self._scan_left = self._scan_left or _PING_TICKS * (_IDS - len(self._behind()))
        elif message[0] == 34:
            if len(message) > 2 and message[1] != near and (behind := self._by_id.get(message[1])) is not None:
                behind.process(message[2:], self._serial_reply)
        elif (here := self._by_id.get(near)) is not None:
            here.process(message, self._serial_reply)

    def _behind(self) -> list[int]:
        return sorted(number for number in self._by_id if number != self.settings.serial_id)

    def _serial_reply(self, message: bytes) -> None:
        self._bytes += packet(message)

    def take_bytes(self) -> bytes:
        """Return the answers of the near VESC. Broadcasts on the bus behind it are discarded."""
        self.take_frames()
        data = bytes(self._bytes)
        self._bytes.clear()
        return data
