"""Instances of co-simulation FMUs of FMI 2.0 and FMI 3.0."""

import ctypes
import functools
from typing import Any, ClassVar

from fmpy.fmi2 import FMU2Slave, defaultCallbacks, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave

from hil.plant.conformance.findings import need, violation
from hil.plant.conformance.slave import InstantiationError, Model, Slave, Step, Value


class Slave2(Slave):
    """FMI 2.0, sections 2.1 and 4.2."""

    fmpy_class = FMU2Slave
    prefix = "fmi2"
    version = "2.0"
    kinds: ClassVar[dict[str, str]] = {"Enumeration": "Integer"}

    def instantiate(self) -> None:
        """Make the instance, with logging on."""
        try:
            self.fmu.instantiate(callbacks=_callbacks(self.model)[0], loggingOn=True)
        except Exception as error:  # FMPy raises a plain Exception
            raise InstantiationError(f"fmi2Instantiate returns no instance{self.model.words()}") from error

    def enter_initialization(self) -> None:
        """Set up the experiment and go to initialization mode."""
        self.fmu.setupExperiment(startTime=self.model.start_s)
        self.fmu.enterInitializationMode()

    def get_as(self, kind: str, reference: int, count: int = 1) -> list[Value]:
        """Read a scalar: there are no arrays."""
        values: list[Value] = getattr(self.fmu, f"get{kind}")([reference])
        return [bool(value) for value in values] if kind == "Boolean" else values

    def step(self, time_s: float, size_s: float) -> Step:
        """Step; there is nothing in the answer but the status."""
        self.fmu.doStep(time_s, size_s)
        return Step(time_s + size_s)

    def serialized_size(self, state: Any) -> int:
        """Return the number of bytes that the state needs."""
        size = ctypes.c_size_t()
        self.fmu.fmi2SerializedFMUstateSize(self.fmu.component, state, ctypes.byref(size))
        return size.value

    def serialize_into(self, state: Any, buffer: Any, size: int) -> None:
        """Write the state as ``size`` bytes into a buffer."""
        self.fmu.fmi2SerializeFMUstate(self.fmu.component, state, buffer, size)

    def save_into(self, state: Any) -> None:
        """Save the state into an existing one, or a null pointer."""
        self.fmu.fmi2GetFMUstate(self.fmu.component, ctypes.byref(state))


@functools.cache
def _callbacks(model: Model) -> tuple[fmi2CallbackFunctions, Any]:
    """Return callbacks that keep the newest message, and the Python function, which must live as long."""

    def log(_environment: Any, _name: bytes, _status: int, _category: bytes, message: bytes | None) -> None:
        model.message = (message or b"").decode(errors="replace")

    logger = fmi2CallbackLoggerTYPE(log)
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = logger
    callbacks.allocateMemory, callbacks.freeMemory = defaultCallbacks.allocateMemory, defaultCallbacks.freeMemory
    try:
        from fmpy.logging import addLoggerProxy
    except OSError:
        return callbacks, logger  # FMPy has no such library for this machine: messages keep their %s
    addLoggerProxy(ctypes.byref(callbacks))
    return callbacks, logger


_ROUNDING = 1e-9  # relative to the time, at least to 1 s


class Slave3(Slave):
    """FMI 3.0, sections 2.2 and 4.2; without event mode, early return and intermediate update."""

    fmpy_class = FMU3Slave
    prefix = "fmi3"
    version = "3."
    kinds: ClassVar[dict[str, str]] = {"Enumeration": "Int64"}

    def instantiate(self) -> None:
        """Make the instance, with logging on."""
        try:
            self.fmu.instantiate(loggingOn=True, logMessage=self._log)
        except Exception as error:  # FMPy raises a plain Exception
            raise InstantiationError(f"fmi3InstantiateCoSimulation returns no instance{self.model.words()}") from error

    def _log(self, _environment: Any, _status: int, _category: bytes, message: bytes | None) -> None:
        self.model.message = (message or b"").decode(errors="replace")

    def enter_initialization(self) -> None:
        """Go to initialization mode, with the start time of the model."""
        self.fmu.enterInitializationMode(startTime=self.model.start_s)

    def get_as(self, kind: str, reference: int, count: int = 1) -> list[Value]:
        """Read the values of one variable, ``count`` of them."""
        values: list[Value] = getattr(self.fmu, f"get{kind}")([reference], nValues=count)
        return values

    def step(self, time_s: float, size_s: float) -> Step:
        """Step, and look at what doStep returns: events and an early return were not agreed on."""
        event, terminate, early, reached_s = self.fmu.doStep(time_s, size_s)
        end_s = time_s + size_s
        finding = None
        if terminate:
            finding = need(f"doStep from {time_s:g} s asks to end the simulation, and a run of this importer with it")
        elif event:
            finding = violation(f"doStep from {time_s:g} s asks for event mode, which was not agreed on")
        elif early:
            finding = violation(f"doStep from {time_s:g} s returns early, which was not agreed on")
        elif not abs(reached_s - end_s) <= _ROUNDING * max(1.0, abs(end_s)):
            finding = need(
                f"doStep to {end_s:g} s gives the last successful time {reached_s:g} s; this importer takes "
                "the outputs for those of its own time"
            )
        return Step(reached_s, finding)

    def serialized_size(self, state: Any) -> int:
        """Return the number of bytes that the state needs."""
        size = ctypes.c_size_t()
        self.fmu.fmi3SerializedFMUStateSize(self.fmu.component, state, ctypes.byref(size))
        return size.value

    def serialize_into(self, state: Any, buffer: Any, size: int) -> None:
        """Write the state as ``size`` bytes into a buffer."""
        octets = ctypes.cast(buffer, ctypes.POINTER(ctypes.c_uint8))
        self.fmu.fmi3SerializeFMUState(self.fmu.component, state, octets, size)

    def save_into(self, state: Any) -> None:
        """Save the state into an existing one, or a null pointer."""
        self.fmu.fmi3GetFMUState(self.fmu.component, ctypes.byref(state))
