"""An FMU under test and its instances, of FMI 2.0 (sections 2.1 and 4.2) and of FMI 3.0 (sections 2.2 and 4.2)."""

import contextlib
import copy
import ctypes
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, defaultCallbacks, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import ModelDescription, ModelVariable

from hil.addons.fmu_check import Finding, need, violation
from hil.plant.child_output import one_line
from hil.plant.description import read_description
from hil.plant.mapping import FLOATS
from hil.plant.start import count, elements_at_start, limits

Value = float | int | bool
Outputs = list[Value]

_NOT_NUMERIC = ("String", "Binary", "Clock")
_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
DISCARD, FATAL = _STATUS.index("discard"), _STATUS.index("fatal")
_CLOSE = 1e-6  # relative, as of numbers that an FMU holds in single precision
_ROUNDING = 1e-9  # relative to the time, at least to 1 s

# FMPy's proxy has the address of the logger that it was given last, and gives it the messages of all instances.
_NEWEST_LOGGER: list[fmi2CallbackFunctions] = []


class InstantiationError(Exception):
    """The FMU gave no instance. ``is_need``: it says that it needs the tool which made it."""

    def __init__(self, sentence: str, *, is_need: bool) -> None:
        super().__init__(sentence)
        self.is_need = is_need


class NotTestedError(Exception):
    """A part cannot be tested; says why, such as that the FMU does not claim it."""


class Slave:
    """One instance of an FMU. A call that the FMU answers with discard or worse raises FMICallException.

    An FMI 3.0 instance is made without event mode, early return and intermediate update.
    """

    def __init__(self, model: "Model") -> None:
        self.model = model
        self.fmu: Any = copy.copy(model.library)  # loaded once: the copies share the C functions
        try:
            if model.is_fmi2:
                self.fmu.instantiate(callbacks=model.callbacks, loggingOn=True)
            else:
                self.fmu.instantiate(loggingOn=True, logMessage=model.log)
        except Exception as error:  # FMPy raises a plain Exception
            name = "fmi2Instantiate" if model.is_fmi2 else "fmi3InstantiateCoSimulation"
            tool = " without its tool" if (needs_tool := bool(model.claims.needsExecutionTool)) else ""
            raise InstantiationError(
                f"{name} returns no instance{tool}{model.last_message()}", is_need=needs_tool
            ) from error

    def call(self, name: str, *arguments: Any) -> None:
        """Call a C function of the FMU, given its name without the prefix."""
        getattr(self.fmu, self.model.prefix + name)(self.fmu.component, *arguments)

    def enter_initialization(self) -> None:
        """Go to initialization mode, with the start time of the model."""
        if self.model.is_fmi2:
            self.fmu.setupExperiment(startTime=self.model.start_s)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=self.model.start_s)

    def initialise(self) -> None:
        """Bring a new or reset instance to where it can be stepped."""
        self.enter_initialization()
        self.fmu.exitInitializationMode()

    def get(self, variable: ModelVariable) -> list[Value]:
        """Return the variable's value, or values."""
        kind, size = self.model.kind(variable), {} if self.model.is_fmi2 else {"nValues": count(variable)}
        values: list[Value] = getattr(self.fmu, f"get{kind}")([variable.valueReference], **size)
        return [bool(value) for value in values] if kind == "Boolean" else values

    def set(self, variable: ModelVariable, value: Value) -> None:
        """Set the variable, each element of an array, to ``value``."""
        getattr(self.fmu, f"set{self.model.kind(variable)}")([variable.valueReference], [value] * count(variable))

    def step(self, time_s: float, size_s: float) -> tuple[float, Finding | None]:
        """Step from ``time_s``; return the time that the FMU has reached, and the error in its answer if any."""
        end_s = time_s + size_s
        if self.model.is_fmi2:
            self.fmu.doStep(time_s, size_s)
            return end_s, None
        event, terminate, early, reached_s = self.fmu.doStep(time_s, size_s)
        finding = None
        if terminate:
            finding = need(f"doStep from {time_s:g} s asks to end the simulation, and a run of this importer with it")
        elif event:
            finding = violation(f"doStep from {time_s:g} s asks for event mode, which was not agreed on")
        elif early:
            finding = violation(f"doStep from {time_s:g} s returns early, which was not agreed on")
        elif not same_time(reached_s, end_s):
            finding = need(
                f"doStep to {end_s:g} s gives the last successful time {reached_s:g} s; this importer takes "
                "the outputs for those of its own time"
            )
        return reached_s, finding

    def drive(self, step: int) -> None:
        """Set every floating-point input to a value of this step, within its range."""
        for place, variable in enumerate(self.model.inputs):
            self.set(variable, self.model.input_value(variable, step, place))

    def sample(self) -> Outputs:
        """Return every numeric output."""
        return [value for variable in self.model.outputs for value in self.get(variable)]

    def simulate(self, first: int, last: int) -> list[Outputs]:
        """Do the steps from ``first`` to ``last`` - 1, and return the outputs after each."""
        rows = []
        for step in range(first, last):
            self.drive(step)
            self.step(self.model.time_s(step), self.model.step_s)
            rows.append(self.sample())
        return rows


class Model:
    """An unpacked FMU of one FMI version ("2.0" or "3.0"): its description, its library, and instances of it.

    ``report`` is called with each attempt and each call before it is made: the FMU may not survive it.
    """

    def __init__(self, fmu: Path, folder: Path, library: Path, version: str, report: Callable[..., None]) -> None:
        self.fmu, self.folder, self.library_path, self.report = fmu, folder, library, report
        self.is_fmi2 = version == "2.0"
        self.prefix = "fmi2" if self.is_fmi2 else "fmi3"  # of the names of the C functions
        self.fmpy_class: type = FMU2Slave if self.is_fmi2 else FMU3Slave
        self.description: ModelDescription = read_description(fmu)
        self.claims = self.description.coSimulation
        self.is_fatal = False  # then no function of the library may be called
        self._message, self._severity = "", 0  # the newest of the FMU's most severe messages in a call
        experiment = self.description.defaultExperiment
        suggested, begin = (None, None) if experiment is None else (experiment.stepSize, experiment.startTime)
        sizes_s = map(_number, (self.claims.fixedInternalStepSize, suggested, 1e-3))
        self.step_s = next(size_s for size_s in sizes_s if size_s > 0.0)
        self.start_s = _number(begin)
        self.variables = [v for v in self.description.modelVariables if v.type not in _NOT_NUMERIC and not v.clocks]
        self.inputs = [v for v in self.variables if v.causality == "input" and v.type in FLOATS]
        self.outputs = [v for v in self.variables if v.causality == "output"]

    @functools.cached_property
    def library(self) -> Any:
        """The loaded library as FMPy's object, without an instance."""
        library: Any = self.fmpy_class(
            guid=self.description.guid,
            unzipDirectory=str(self.folder),
            modelIdentifier=self.claims.modelIdentifier,
            instanceName="check",
            libraryPath=str(self.library_path),
        )
        call = library._call  # by which FMPy calls every function, whatever the copy of the library

        def report_and_call(name: str, *arguments: Any) -> Any:
            self.report(doing=f"in {name}")
            self._message, self._severity = "", 0
            try:
                return call(name, *arguments)
            except FMICallException as error:
                error.add_note(self.last_message())  # now: whoever handles it calls other functions first
                self.is_fatal = self.is_fatal or error.status == FATAL
                raise

        library._call = report_and_call
        return library

    @functools.cached_property
    def callbacks(self) -> fmi2CallbackFunctions:
        """The callbacks of FMI 2.0, which keep the newest message."""
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(lambda *given: self.log(*given[1:]))
        callbacks.allocateMemory, callbacks.freeMemory = defaultCallbacks.allocateMemory, defaultCallbacks.freeMemory
        with contextlib.suppress(OSError):  # without a library of FMPy for this machine messages keep their %s
            from fmpy.logging import addLoggerProxy

            addLoggerProxy(ctypes.byref(callbacks))
            _NEWEST_LOGGER[:] = [callbacks]
        return callbacks

    def log(self, _environment: Any, status: int, _category: bytes, message: bytes | None) -> None:
        """Keep a message of the FMU: the logger of FMI 3.0."""
        if message and status >= self._severity:
            self._message, self._severity = message.decode(errors="replace"), status

    @contextlib.contextmanager
    def instance(self, *, initialised: bool = True) -> Iterator[Slave]:
        """Yield an instance, and free it at the end; the library stays loaded. Raises InstantiationError."""
        slave = Slave(self)
        try:
            if initialised:
                slave.initialise()
            yield slave
        finally:
            if not self.is_fatal:
                slave.call("FreeInstance")

    def kind(self, variable: ModelVariable) -> str:
        """Return the name of the variable's getters and setters: an enumeration is Integer, or Int64 in FMI 3.0."""
        if variable.type == "Enumeration":
            return "Integer" if self.is_fmi2 else "Int64"
        return str(variable.type)

    def time_s(self, step: int) -> float:
        """Return the communication point at which a step begins."""
        return self.start_s + step * self.step_s

    def input_value(self, variable: ModelVariable, step: int, place: int) -> float:
        """Return the value of an input in a step: near its start value, and not that of the step before."""
        low, high = limits(variable)
        value = min(max(float((start(variable) or [0.0])[0]) + 0.1 * ((step + place) % 5 - 2), low), high)
        return ctypes.c_float(value).value if variable.type == "Float32" else value

    def explain(self, error: FMICallException) -> str:
        """Return a failed call in words, with the FMU's message."""
        status = _STATUS[error.status] if error.status in range(len(_STATUS)) else f"the unknown status {error.status}"
        return f"{error.function} returns {status}{''.join(error.__notes__)}"

    def last_message(self) -> str:
        """Return the FMU's newest message in parentheses, as the end of a sentence; empty without one."""
        return f" ({one_line(self._message)[:300]})" if self._message else ""


def _number(declared: object) -> float:
    """Return a declared number; 0 for one that is not there, or that FMPy's validator complains about."""
    try:
        number = float(str(declared))
    except ValueError:
        return 0.0
    return number if math.isfinite(number) else 0.0


def start(variable: ModelVariable) -> list[Value] | None:
    """Return the start of a numeric variable as the FMU holds it, all elements of it; None when there is none."""
    values = elements_at_start(variable)
    if values is not None and variable.type == "Float32":
        return [ctypes.c_float(value).value for value in values]
    return values


def close(values: Sequence[Value], expected: Sequence[Value]) -> bool:
    """Return whether values are equal, floating-point numbers but for rounding. Those of NaN are not."""

    def is_close(one: Value, other: Value) -> bool:
        if isinstance(one, float) and isinstance(other, float):
            return math.isclose(one, other, rel_tol=_CLOSE)
        return one == other

    return len(values) == len(expected) and all(map(is_close, values, expected))


def same_time(time_s: float, expected_s: float) -> bool:
    """Return whether two times are equal but for rounding."""
    return math.isclose(time_s, expected_s, rel_tol=_ROUNDING, abs_tol=_ROUNDING)


def same(left: object, right: object) -> bool:
    """Return whether two results are equal bit for bit, NaN included."""
    return repr(left) == repr(right)
