"""What the robot says of itself beside its feedback: why it stopped or was reset, its battery, frames it refused."""

from typing import NamedTuple

from firmware_protocol.codec import Message
from firmware_protocol.generated import messages as m
from hil.core.types import NAN, NAN_WHEELS, WHEEL_NAMES, Wheels
from hil.robot.wheel_map import WheelMap

_WORDS = {
    m.ResetCause.UNKNOWN: "it does not know why",
    m.ResetCause.POWER_ON: "its power came on",
    m.ResetCause.BROWN_OUT: "its supply sank below what the chip works with",
    m.ResetCause.PIN: "its reset pin was pulled",
    m.ResetCause.SOFTWARE: "its firmware or a debugger asked for it",
    m.ResetCause.WATCHDOG: "its watchdog reset it, as the firmware did not go on",
    m.ResetCause.LOW_POWER: "it was told to sleep",
    m.ResetCause.PROCESSOR_FAULT: "its processor met a fault",
}

# ARMv7-M architecture reference manual, B3.2.15.
_CFSR = {
    0: "instruction fetched where none may be",
    1: "data access where none may be",
    3: "memory management fault on leaving an exception",
    4: "memory management fault on entering an exception: has the stack overflowed?",
    5: "memory management fault while floating-point registers were saved",
    8: "bus fault on fetching an instruction",
    9: "bus fault on reading or writing",
    10: "bus fault on a write some instructions before",
    11: "bus fault on leaving an exception",
    12: "bus fault on entering an exception: has the stack overflowed?",
    13: "bus fault while floating-point registers were saved",
    16: "undefined instruction",
    17: "instruction set state that the processor does not have",
    18: "wrong return from an exception",
    19: "coprocessor that is off or not there",
    24: "unaligned access",
    25: "division by zero",
}
_MMFAR_HOLDS, _BFAR_HOLDS = 1 << 7, 1 << 15


class ProcessorFault(NamedTuple):
    """The record of the processor fault that reset a robot; all zero when none did."""

    cfsr: int = 0
    hfsr: int = 0
    pc: int = 0
    lr: int = 0
    mmfar: int = 0
    bfar: int = 0

    def describe(self) -> str:
        """Return it in words; an address is one to look up in the ELF file of this build (addr2line)."""
        kinds = [words for bit, words in _CFSR.items() if self.cfsr >> bit & 1]
        where = [f"at {self.pc:#010x}, called from {self.lr:#010x}"] if self.pc or self.lr else []
        where += [f"for address {self.mmfar:#010x}"] if self.cfsr & _MMFAR_HOLDS else []
        where += [f"for address {self.bfar:#010x}"] if self.cfsr & _BFAR_HOLDS else []
        registers = f"(CFSR {self.cfsr:08x}, HFSR {self.hfsr:08x})"
        return " ".join([" and ".join(kinds) or "a fault without a cause in CFSR", *where, registers])


NO_FAULT = ProcessorFault()


def reset_words(cause: m.ResetCause, fault: ProcessorFault = NO_FAULT) -> str:
    """Return the cause of a reset in words, with the fault where it is one."""
    return _WORDS[cause] + (f": {fault.describe()}" if fault != NO_FAULT else "")


class Health(NamedTuple):
    """Battery and motors, as the robot reports them at 10 Hz; NaN before the first report and without such a sensor."""

    battery_v: float = NAN
    battery_a: float = NAN
    temperature_degc: Wheels = NAN_WHEELS


class RobotReport:
    """Keeps the newest of each. Pure.

    ``status`` is the last STATUS, None before the first. ``rejected`` counts by cause the frames that the robot
    dropped between the first and the last LINK_COUNTERS and PORT_COUNTERS of each session.
    """

    def __init__(self, wheel_map: WheelMap) -> None:
        self._map = wheel_map
        self._last_counters: dict[type, m.LinkCounters | m.PortCounters] = {}
        self.status: m.Status | None = None
        self.health = Health()
        self.rejected: dict[str, int] = {}

    def restart(self) -> None:
        """Begin with a robot that may have been reset: its counters may begin at 0."""
        self._last_counters.clear()

    def feed(self, message: Message) -> None:
        """Add a message; one of another kind changes nothing."""
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
        """Return why the robot last stopped, in words of the DBC (STATUS.stop_reason, STATUS.fault)."""
        if self.status is None:
            return "a reason that it has not reported yet"
        reason = m.StopReason(self.status.stop_reason).name
        fault = self._fault()
        return f"{reason} ({fault})" if fault else reason

    def _fault(self) -> str:
        """Return the fault in STATUS, with the wheel where it is one wheel's; empty without a fault."""
        if self.status is None or not self.status.fault:
            return ""
        fault = m.Fault(self.status.fault).name
        if not self.status.fault_wheel:
            return fault
        wheel = self._map.wheel_of_channel[self.status.fault_wheel - m.FaultWheel.FL]
        return f"{fault} of wheel {WHEEL_NAMES[wheel]}"

    def explains(self, state: m.State) -> bool:
        """Return whether STATUS has reported this state, which may come after the feedback."""
        return self.status is not None and self.status.state == state

    @property
    def knows_no_reason(self) -> bool:
        """Whether the robot says that nothing has stopped it since it was armed, or since its power came on."""
        return self.status is not None and self.status.stop_reason == m.StopReason.NONE

    @property
    def last_reset(self) -> str:
        """The cause of its last reset (STATUS.reset_cause) in words; empty before the first STATUS."""
        return "" if self.status is None else reset_words(m.ResetCause(self.status.reset_cause))

    @property
    def trouble(self) -> str | None:
        """None: our firmware stops by itself when its host falls silent."""
        return None

    def why_not_active(self, state: m.State | None) -> str:
        """Return what keeps a robot in this state, None without feedback, from being driven, and what to do."""
        if state is None:
            return "the robot answered HELLO but sends no feedback; reset it and try again"
        clear = 'restart the robot, or have its own host send CLEAR (PROTOCOL.md, "States")'
        advice = {
            m.State.ACTIVE: "another controller drives it; stop that one first",
            m.State.ESTOP: f"it is latched; release the e-stop, then {clear}",
            m.State.FAULT: f"it is latched; find the cause, then {clear}",
        }.get(state, "restart the robot and look at its link counters")
        fault = self._fault()
        because = f" because of {fault}" if fault else ""
        return f"the robot did not become ACTIVE: it is {state.name}{because}; {advice}"
