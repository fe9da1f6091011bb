"""What the robot reports besides its feedback: why it stopped or was reset, its battery, dropped frames."""

from typing import NamedTuple

from firmware_protocol.codec import Message
from firmware_protocol.generated import messages as m
from hil.core.types import NAN, NAN_WHEELS, WHEEL_NAMES, Wheels
from hil.core.wheel_map import WheelMap

_WORDS = {
    m.ResetCause.UNKNOWN: "the cause is unknown",
    m.ResetCause.POWER_ON: "it was powered on",
    m.ResetCause.BROWN_OUT: "its supply voltage was too low for the chip",
    m.ResetCause.PIN: "its reset pin was pulled low",
    m.ResetCause.SOFTWARE: "its firmware or a debugger requested it",
    m.ResetCause.WATCHDOG: "its watchdog expired because the firmware hung",
    m.ResetCause.LOW_POWER: "it entered a low-power mode",
    m.ResetCause.PROCESSOR_FAULT: "its processor had a fault",
}

_MMFAR_HOLDS, _BFAR_HOLDS = 1 << 7, 1 << 15  # of CFSR; ARMv7-M architecture reference manual, B3.2.15


class ProcessorFault(NamedTuple):
    """The record of the processor fault that reset a robot; all zero when none did."""

    cfsr: int = 0
    hfsr: int = 0
    pc: int = 0
    lr: int = 0
    mmfar: int = 0
    bfar: int = 0

    def describe(self) -> str:
        """Return a description. Its addresses can be looked up in the ELF file of this build (addr2line)."""
        where = [f"at {self.pc:#010x}, called from {self.lr:#010x}"] if self.pc or self.lr else []
        where += [f"for address {self.mmfar:#010x}"] if self.cfsr & _MMFAR_HOLDS else []
        where += [f"for address {self.bfar:#010x}"] if self.cfsr & _BFAR_HOLDS else []
        return " ".join([*where, f"(CFSR {self.cfsr:08x}, HFSR {self.hfsr:08x})"])


NO_FAULT = ProcessorFault()


def reset_words(cause: m.ResetCause, fault: ProcessorFault = NO_FAULT) -> str:
    """Return the cause of a reset in words, with the processor fault if there was one."""
    return _WORDS[cause] + (f": {fault.describe()}" if fault != NO_FAULT else "")


class Health(NamedTuple):
    """Battery and motor temperatures, reported at 10 Hz; NaN before the first report or without a sensor."""

    battery_v: float = NAN
    battery_a: float = NAN
    temperature_degc: Wheels = NAN_WHEELS


class RobotReport:
    """Keeps the newest STATUS, battery and temperature values and counters. No I/O.

    ``status`` is the last STATUS, None before the first. ``rejected`` is the number of frames that the robot dropped,
    by cause, between the first and the last LINK_COUNTERS and PORT_COUNTERS of each session.
    """

    def __init__(self, wheel_map: WheelMap) -> None:
        self._map = wheel_map
        self._last_counters: dict[type, m.LinkCounters | m.PortCounters] = {}
        self.status: m.Status | None = None
        self.health = Health()
        self.rejected: dict[str, int] = {}

    def restart(self) -> None:
        """Start again with a robot that may have been reset, so that its counters may start at 0."""
        self._last_counters.clear()

    def feed(self, message: Message) -> None:
        """Add a message; messages of other kinds are ignored."""
        if isinstance(message, m.Status):
            self.status = message
        elif isinstance(message, m.LinkCounters | m.PortCounters):
            self._count(message)
        elif isinstance(message, m.Power):
            self.health = self.health._replace(battery_v=message.battery_v, battery_a=message.battery_a)
        elif isinstance(message, m.Temperatures):
            self.health = self.health._replace(temperature_degc=self._map.temperatures_from_wire(Wheels(*message)))

    def _count(self, counters: m.LinkCounters | m.PortCounters) -> None:
        last = self._last_counters.get(type(counters))
        if last is not None:
            for cause, new, old in zip(counters._fields, counters, last, strict=True):
                self.rejected[cause] = self.rejected.get(cause, 0) + ((new - old) & 0xFF)
        self._last_counters[type(counters)] = counters

    def stop_reason(self) -> str:
        """Return why the robot last stopped, with the names of the DBC (STATUS.stop_reason, STATUS.fault)."""
        if self.status is None:
            return "a reason that it has not reported yet"
        reason = m.StopReason(self.status.stop_reason).name
        fault = self._fault()
        return f"{reason} ({fault})" if fault else reason

    def _fault(self) -> str:
        if self.status is None or not self.status.fault:
            return ""
        fault = m.Fault(self.status.fault).name
        if not self.status.fault_wheel:
            return fault
        wheel = self._map.wheel_of_channel[self.status.fault_wheel - m.FaultWheel.FL]
        return f"{fault} of wheel {WHEEL_NAMES[wheel]}"

    def explains(self, state: m.State) -> bool:
        """Return whether STATUS has reported this state. It may come after the feedback."""
        return self.status is not None and self.status.state == state

    @property
    def knows_no_reason(self) -> bool:
        """Whether the robot reports that nothing has stopped it since it was armed or powered on."""
        return self.status is not None and self.status.stop_reason == m.StopReason.NONE

    @property
    def last_reset(self) -> str:
        """The cause of the last reset (STATUS.reset_cause) in words; empty before the first STATUS."""
        return "" if self.status is None else reset_words(m.ResetCause(self.status.reset_cause))

    @property
    def trouble(self) -> str | None:
        """Always None: our firmware stops on its own when its host is silent."""
        return None

    def why_not_active(self, state: m.State | None) -> str:
        """Return why a robot in this state (None without feedback) does not become ACTIVE, and what to do."""
        if state is None:
            return "the robot answered HELLO but sends no feedback; reset it and try again"
        clear = 'restart the robot, or have its own host send CLEAR (PROTOCOL.md, "States")'
        advice = {
            m.State.ACTIVE: "another controller drives it; stop that controller first",
            m.State.ESTOP: f"it is latched; release the e-stop, then {clear}",
            m.State.FAULT: f"it is latched; find the cause, then {clear}",
        }.get(state, "restart the robot and look at its link counters")
        fault = self._fault()
        because = f" because of {fault}" if fault else ""
        return f"the robot did not become ACTIVE: it is {state.name}{because}; {advice}"
