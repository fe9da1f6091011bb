"""An FMU under test and its instances: what FMI 2.0 and FMI 3.0 have in common."""

import abc
import contextlib
import copy
import ctypes
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ModelVariable

from hil.plant.child_output import one_line
from hil.plant.conformance.findings import Finding
from hil.plant.description import read_description

Value = float | int | bool
Outputs = list[Value]

_FLOATS = ("Real", "Float64", "Float32")
_NOT_NUMERIC = ("String", "Binary", "Clock")
_STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
DISCARD = _STATUS.index("discard")


class InstantiationError(Exception):
    """The FMU gave no instance."""


class NotTestedError(Exception):
    """A part cannot be tested; says why, such as that the FMU does not claim it."""


class Step(NamedTuple):
    """What came of a step that succeeded: the time that the FMU has reached, and a finding, if there is one."""

    reached_s: float
    finding: Finding | None = None


class Slave(abc.ABC):
    """One instance. Calls that the FMU answers with discard or worse raise FMICallException."""

    fmpy_class: ClassVar[type]
    prefix: ClassVar[str]  # of the names of the C functions
    version: ClassVar[str]  # what GetVersion has to begin with
    kinds: ClassVar[dict[str, str]]  # the types with a getter of another name

    def __init__(self, model: "Model") -> None:
        self.model = model
        self.fmu: Any = copy.copy(model.library)  # loaded once: the copies share the C functions

    @abc.abstractmethod
    def instantiate(self) -> None:
        """Make the instance. Raises InstantiationError."""

    @abc.abstractmethod
    def enter_initialization(self) -> None:
        """Go to initialization mode, with the start time of the model."""

    @abc.abstractmethod
    def get_as(self, kind: str, reference: int, count: int = 1) -> list[Value]:
        """Read with the function for ``kind`` (Real, Float64, ...)."""

    @abc.abstractmethod
    def step(self, time_s: float, size_s: float) -> Step:
        """Step from ``time_s``."""

    @abc.abstractmethod
    def serialized_size(self, state: Any) -> int:
        """Return the number of bytes that the state needs."""

    @abc.abstractmethod
    def serialize_into(self, state: Any, buffer: Any, size: int) -> None:
        """Write the state as ``size`` bytes into a buffer."""

    @abc.abstractmethod
    def save_into(self, state: Any) -> None:
        """Save the state into an existing one, which is reused, or into a null pointer."""

    def exit_initialization(self) -> None:
        """Leave initialization mode: the instance can be stepped."""
        self.fmu.exitInitializationMode()

    def initialise(self) -> None:
        """Bring a new or reset instance to where it can be stepped."""
        self.enter_initialization()
        self.exit_initialization()

    def free(self) -> None:
        """Free the instance; the library stays loaded."""
        getattr(self.fmu, f"{self.prefix}FreeInstance")(self.fmu.component)

    def set_as(self, kind: str, reference: int, values: Sequence[Value]) -> None:
        """Write with the function for ``kind`` (Real, Float64, ...)."""
        getattr(self.fmu, f"set{kind}")([reference], values)

    def kind(self, variable: ModelVariable) -> str:
        """Return the name of the variable's getters and setters: an enumeration is Integer, or Int64 in FMI 3.0."""
        return self.kinds.get(variable.type, str(variable.type))

    def get(self, variable: ModelVariable) -> list[Value]:
        """Return the variable's value, or values."""
        return self.get_as(self.kind(variable), variable.valueReference, count(variable))

    def set(self, variable: ModelVariable, value: Value) -> None:
        """Set the variable, each element of an array, to ``value``."""
        self.set_as(self.kind(variable), variable.valueReference, [value] * count(variable))

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
    """An unpacked FMU: its description, its library, and instances of it.

    ``report`` is told each attempt and each call before it is made: the FMU may not survive it.
    """

    def __init__(self, fmu: Path, folder: Path, library: Path, slave: type[Slave], report: Callable[..., None]) -> None:
        self.folder, self.library_path, self.slave, self.report = folder, library, slave, report
        self.description: ModelDescription = read_description(fmu)
        self.claims = self.description.coSimulation
        self.message = ""  # the FMU's newest message
        experiment = self.description.defaultExperiment
        suggested_s = None if experiment is None else experiment.stepSize
        begin = None if experiment is None else experiment.startTime
        self.step_s = float(self.claims.fixedInternalStepSize or suggested_s or 1e-3)
        self.start_s = float(begin or 0.0)
        variables = [v for v in self.description.modelVariables if v.type not in _NOT_NUMERIC and not v.clocks]
        self.variables = variables
        self.inputs = [v for v in variables if v.causality == "input" and v.type in _FLOATS]
        self.outputs = [v for v in variables if v.causality == "output"]

    @functools.cached_property
    def library(self) -> Any:
        """The loaded library as FMPy's object, without an instance."""
        library: Any = self.slave.fmpy_class(
            guid=self.description.guid,
            unzipDirectory=str(self.folder),
            modelIdentifier=self.claims.modelIdentifier,
            instanceName="check",
            libraryPath=str(self.library_path),
        )
        call = library._call  # by which FMPy calls every function, whatever the copy of the library

        def said_and_called(name: str, *arguments: Any) -> Any:
            self.report(doing=f"in {name}")
            return call(name, *arguments)

        library._call = said_and_called
        return library

    @contextlib.contextmanager
    def instance(self, *, initialised: bool = True) -> Iterator[Slave]:
        """Yield an instance, and free it at the end."""
        self.message = ""
        slave = self.slave(self)
        slave.instantiate()
        try:
            if initialised:
                slave.initialise()
            yield slave
        finally:
            slave.free()

    def time_s(self, step: int) -> float:
        """Return the communication point at which a step begins."""
        return self.start_s + step * self.step_s

    def input_value(self, variable: ModelVariable, step: int, place: int) -> float:
        """Return the value of an input in a step: near its start value, other than in the step before."""
        low, high = limits(variable)
        value = min(max(float((start(variable) or [0.0])[0]) + 0.1 * ((step + place) % 5 - 2), low), high)
        return ctypes.c_float(value).value if variable.type == "Float32" else value

    def explain(self, error: FMICallException) -> str:
        """Return what a failed call means, with the FMU's own words."""
        status = _STATUS[error.status] if error.status in range(len(_STATUS)) else f"the unknown status {error.status}"
        return f"{error.function} returns {status}{self.words()}"

    def words(self) -> str:
        """Return the FMU's newest message as the end of a sentence."""
        return f" ({one_line(self.message)[:300]})" if self.message else ""


def count(variable: ModelVariable) -> int:
    """Return how many values a variable has: 1 unless it is an array."""
    return math.prod(variable.shape or ())


def limits(variable: ModelVariable) -> tuple[float, float]:
    """Return the range of a variable, its own or its type's; infinite where there is none."""
    declared = variable.declaredType
    low = variable.min or (declared and declared.min)
    high = variable.max or (declared and declared.max)
    return float(low or -math.inf), float(high or math.inf)


def start(variable: ModelVariable) -> list[Value] | None:
    """Return the start value of a numeric variable, all elements of it; None when there is none."""
    if variable.start is None:
        return None
    words = variable.start.split()
    if variable.type == "Boolean":
        values: list[Value] = [word in ("true", "1") for word in words]
    elif variable.type == "Float32":
        values = [ctypes.c_float(float(word)).value for word in words]
    else:
        values = [float(word) if variable.type in _FLOATS else int(word) for word in words]
    return values * count(variable) if len(values) == 1 else values


def is_float(variable: ModelVariable) -> bool:
    """Return whether the variable is of a floating-point type."""
    return variable.type in _FLOATS


def same(left: object, right: object) -> bool:
    """Return whether two results are equal bit for bit, NaN included."""
    return repr(left) == repr(right)
