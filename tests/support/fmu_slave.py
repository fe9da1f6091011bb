"""One set of calls for the instances of both FMI versions, over FMPy's own classes; variables go by name."""

import contextlib
import functools
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from fmpy import extract, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import ModelDescription, ScalarVariable

import tools.build.fmu

VERSIONS = (2, 3)
FMUS = {fmi: tools.build.fmu.build(fmi=fmi) for fmi in VERSIONS}
DESCRIPTIONS: dict[int, ModelDescription] = {fmi: read_model_description(str(FMUS[fmi])) for fmi in VERSIONS}
VARIABLES: dict[int, dict[str, ScalarVariable]] = {
    fmi: {variable.name: variable for variable in DESCRIPTIONS[fmi].modelVariables} for fmi in VERSIONS
}
WHEELS = ("fl", "fr", "rr", "rl")
TORQUES = [f"wheel.{wheel}.torque_n_m" for wheel in WHEELS]
OUTPUTS = [variable.name for variable in DESCRIPTIONS[2].modelVariables if variable.causality == "output"]
# What the getters and setters of a type are called: in FMI 2.0 an enumeration goes as an integer.
ACCESS = {
    2: {"Real": "Real", "Integer": "Integer", "Enumeration": "Integer"},
    3: {"Float64": "Float64", "Int32": "Int32", "Enumeration": "Int64"},
}


@functools.cache
def _unpacked(fmi: int) -> tempfile.TemporaryDirectory[str]:
    folder = tempfile.TemporaryDirectory(prefix=f"plant_fmi{fmi}_")
    extract(str(FMUS[fmi]), folder.name)
    return folder


def library_folder(fmi: int) -> str:
    """Return where the FMU of this version is unpacked, once for all tests."""
    return _unpacked(fmi).name


def fmpy_slave(fmi: int, token: str | None = None, name: str = "test") -> Any:
    """Return FMPy's object for an instance, not yet instantiated."""
    description = DESCRIPTIONS[fmi]
    return {2: FMU2Slave, 3: FMU3Slave}[fmi](
        guid=description.guid if token is None else token,
        unzipDirectory=library_folder(fmi),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName=name,
    )


class Slave:
    """An instance. ``raw`` is FMPy's object, ``time_s`` the instance's time, ``log`` its messages (FMI 3 only)."""

    def __init__(self, fmi: int) -> None:
        self.fmi = fmi
        self.time_s = 0.0
        self.log: list[tuple[int, str, str]] = []
        self.raw = fmpy_slave(fmi)
        if fmi == 2:
            self.raw.instantiate()
        else:
            self.raw.instantiate(loggingOn=True, logMessage=self._hear)

    def _hear(self, _environment: object, status: int, category: bytes, message: bytes) -> None:
        self.log.append((status, category.decode(), message.decode()))

    def enter_initialization(self, start_s: float = 0.0, stop_s: float | None = None) -> None:
        if self.fmi == 2:
            self.raw.setupExperiment(startTime=start_s, stopTime=stop_s)
            self.raw.enterInitializationMode()
        else:
            self.raw.enterInitializationMode(startTime=start_s, stopTime=stop_s)
        self.time_s = start_s

    def initialize(self, start: dict[str, float] | None = None) -> None:
        self.set(start or {})
        self.enter_initialization()
        self.raw.exitInitializationMode()

    def get(self, names: list[str]) -> list[float]:
        return [value for name in names for value in self._call("get", name)]

    def set(self, values: dict[str, float]) -> None:
        for name, value in values.items():
            self._call("set", name, [value])

    def set_together(self, values: dict[str, float]) -> None:
        """Set floating-point variables by one call."""
        references = [VARIABLES[self.fmi][name].valueReference for name in values]
        getattr(self.raw, "setReal" if self.fmi == 2 else "setFloat64")(references, list(values.values()))

    def _call(self, verb: str, name: str, *values: list[float]) -> list[float]:
        variable = VARIABLES[self.fmi][name]
        call: Callable[..., list[float]] = getattr(self.raw, verb + ACCESS[self.fmi][variable.type])
        return call([variable.valueReference], *values)

    def step(self, step_s: float = 1e-3) -> None:
        self.raw.doStep(self.time_s, step_s)
        self.time_s += step_s

    def drive(self, first: int, last: int) -> list[list[float]]:
        """Step from one number of a millisecond to another under torques that follow from it; return all outputs."""
        rows = []
        for n in range(first, last):
            self.set(dict(zip(TORQUES, [0.1 * (n % 7), -0.2, 0.3, 0.05 * (n % 3)], strict=True)))
            self.raw.doStep(n / 1000, 1e-3)
            self.time_s = (n + 1) / 1000
            rows.append(self.get(OUTPUTS))
        return rows

    def serialized(self) -> bytes:
        """Return the present state as bytes."""
        state = self.raw.getFMUState()
        try:
            data: bytes = self.raw.serializeFMUState(state)
            return data
        finally:
            self.raw.freeFMUState(state)

    def restore(self, data: bytes) -> None:
        """Take over a state from bytes."""
        deserialize = self.raw.deSerializeFMUstate if self.fmi == 2 else self.raw.deserializeFMUState
        state = deserialize(data)
        self.raw.setFMUState(state)
        self.raw.freeFMUState(state)


@contextlib.contextmanager
def slave(fmi: int, start: dict[str, float] | None = None, *, initialized: bool = True) -> Iterator[Slave]:
    """Give an instance, freed at the end."""
    instance = Slave(fmi)
    try:
        if initialized:
            instance.initialize(start)
        yield instance
    finally:
        instance.raw.freeInstance()


def refused(call: Callable[[], object]) -> None:
    """Expect the status fmi2Error or fmi3Error."""
    with pytest.raises(FMICallException) as caught:
        call()
    assert caught.value.status == 3


def discarded(call: Callable[[], object]) -> None:
    """Expect the status fmi2Discard or fmi3Discard."""
    with pytest.raises(FMICallException) as caught:
        call()
    assert caught.value.status == 2
