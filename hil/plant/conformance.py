"""Runs an unpacked FMI 2.0 co-simulation FMU through every call and claim; the child of ``hil.plant.tools``.

``python -m hil.plant.conformance FOLDER RESULTS`` appends one JSON line to RESULTS when a part begins and one a
problem, so that a crash tells where it happened.
"""

import contextlib
import json
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from fmpy.model_description import ModelDescription, read_model_description

_STEPS = 20
_UNUSED_REFERENCE = 0xFFFFFFF0
Outputs = list[float]


class Model:
    """An unpacked FMU: its description, and instances of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.description: ModelDescription = read_model_description(folder, validate=False)
        experiment = self.description.defaultExperiment
        size = None if experiment is None else experiment.stepSize
        self.step_s = float(size) if size else 1e-3
        variables = self.description.modelVariables
        self.inputs = [v for v in variables if v.causality == "input" and v.type == "Real"]
        self.outputs = [v for v in variables if v.causality == "output" and v.type in _GETTERS]

    @contextlib.contextmanager
    def instance(self, *, initialised: bool = True) -> Iterator[FMU2Slave]:
        """Give an instance, freed at the end."""
        slave = FMU2Slave(
            guid=self.description.guid,
            unzipDirectory=str(self.folder),
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="check",
        )
        slave.instantiate()
        try:
            if initialised:
                initialise(slave)
            yield slave
        finally:
            slave.freeInstance()

    def drive(self, slave: FMU2Slave, step: int) -> None:
        """Set every real input to a value of this step, within its range."""
        for place, variable in enumerate(self.inputs):
            value = float(variable.start or 0.0) + 0.1 * ((step + place) % 5 - 2)
            low, high = float(variable.min or -math.inf), float(variable.max or math.inf)
            slave.setReal([variable.valueReference], [min(max(value, low), high)])

    def sample(self, slave: FMU2Slave) -> Outputs:
        """Return every numeric output."""
        return [
            value
            for variable in self.outputs
            for value in getattr(slave, _GETTERS[variable.type])([variable.valueReference])
        ]

    def simulate(self, slave: FMU2Slave, first: int, last: int) -> list[Outputs]:
        """Take the steps from ``first`` to ``last`` - 1, and return the outputs after each."""
        rows = []
        for step in range(first, last):
            self.drive(slave, step)
            slave.doStep(step * self.step_s, self.step_s)
            rows.append(self.sample(slave))
        return rows


_GETTERS = {
    "Real": "getReal",
    "Integer": "getInteger",
    "Enumeration": "getInteger",
    "Boolean": "getBoolean",
}


def initialise(slave: FMU2Slave) -> None:
    """Bring a new or reset instance to where it can be stepped."""
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def same(left: object, right: object) -> bool:
    """Tell whether two results are equal bit for bit, NaN included."""
    return repr(left) == repr(right)


def variables(model: Model) -> Iterator[str]:
    """Every input can be set and read back, every output read; all are finite."""
    with model.instance() as slave:
        model.drive(slave, 0)
        for place, variable in enumerate(model.inputs):
            wanted = float(variable.start or 0.0) + 0.1 * (place % 5 - 2)
            inside = float(variable.min or -math.inf) <= wanted <= float(variable.max or math.inf)
            (value,) = slave.getReal([variable.valueReference])
            if inside and value != wanted:
                yield f"input {variable.name} reads {value!r} after it was set to {wanted!r}"
        model.simulate(slave, 0, 1)
        for variable, value in zip(model.outputs, model.sample(slave), strict=True):
            if not math.isfinite(value):
                yield f"output {variable.name} is {value!r} after one step"


def terminate_and_reset(model: Model) -> Iterator[str]:
    """The whole life of an instance; after a reset the same inputs give the same outputs."""
    with model.instance() as slave:
        first = model.simulate(slave, 0, _STEPS)
        slave.terminate()
        model.sample(slave)
        slave.reset()
        initialise(slave)
        if not same(first, model.simulate(slave, 0, _STEPS)):
            yield "after a reset the same inputs give other outputs"


def variable_step(model: Model) -> Iterator[str]:
    """Communication steps of any size, when claimed."""
    if not model.description.coSimulation.canHandleVariableCommunicationStepSize:
        return
    with model.instance() as slave:
        time_s = 0.0
        for factor in (1.0, 0.5, 3.0, 0.1, 1.7):
            slave.doStep(time_s, factor * model.step_s)
            time_s += factor * model.step_s
        if not all(math.isfinite(value) for value in model.sample(slave)):
            yield "an output is not finite after steps of various sizes"


def saved_state(model: Model) -> Iterator[str]:
    """A restored state, also one that was bytes, continues with the same bits, when claimed."""
    claims = model.description.coSimulation
    if not claims.canGetAndSetFMUstate:
        return
    with model.instance() as slave:
        model.simulate(slave, 0, _STEPS)
        state = slave.getFMUstate()
        here = model.sample(slave)
        onward = model.simulate(slave, _STEPS, 2 * _STEPS)
        states = [("a restored state", state)]
        if claims.canSerializeFMUstate:
            from_bytes = slave.deSerializeFMUstate(slave.serializeFMUstate(state))
            states.append(("a state from bytes", from_bytes))
        for name, saved in states:
            slave.setFMUstate(saved)
            if not same(here, model.sample(slave)):
                yield f"{name} gives other outputs than when it was saved"
            if not same(onward, model.simulate(slave, _STEPS, 2 * _STEPS)):
                yield f"{name} continues with other outputs"
        for _, saved in states:
            slave.freeFMUstate(saved)


def illegal_calls(model: Model) -> Iterator[str]:
    """What the standard forbids is refused with an error, not done."""

    def step_too_early(slave: FMU2Slave) -> None:
        slave.doStep(0.0, model.step_s)

    def unknown_reference(slave: FMU2Slave) -> None:
        slave.getReal([_UNUSED_REFERENCE])

    def negative_step(slave: FMU2Slave) -> None:
        slave.doStep(0.0, -model.step_s)

    cases: list[tuple[str, bool, Callable[[FMU2Slave], None]]] = [
        ("doStep before initialization", False, step_too_early),
        ("getReal of an unknown value reference", True, unknown_reference),
        ("doStep with a negative step", True, negative_step),
    ]
    for name, initialised, call in cases:
        with model.instance(initialised=initialised) as slave:
            try:
                call(slave)
            except FMICallException:
                continue
            yield f"{name} is accepted"


def two_instances(model: Model) -> Iterator[str]:
    """Stepping one instance does not move another, unless only one is allowed."""
    if model.description.coSimulation.canBeInstantiatedOnlyOncePerProcess:
        return
    with model.instance() as alone:
        expected = model.simulate(alone, 0, _STEPS)
    with model.instance() as one, model.instance() as two:
        rest = model.sample(two)
        for step in range(_STEPS):
            row = model.simulate(one, step, step + 1)
            if not same(row, expected[step : step + 1]):
                yield "an instance gives other outputs when a second one exists"
                return
        if not same(rest, model.sample(two)):
            yield "stepping one instance changes the outputs of another"
        if not same(expected, model.simulate(two, 0, _STEPS)):
            yield "an instance does not start where it should after another was stepped"


PARTS: tuple[Callable[[Model], Iterator[str]], ...] = (
    variables,
    terminate_and_reset,
    variable_step,
    saved_state,
    illegal_calls,
    two_instances,
)


def main(folder: Path, results: Path) -> None:
    """Run every part; problems go to ``results``."""

    def write(**entry: Any) -> None:
        with results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")

    write(part="load")
    model = Model(folder)
    for part in PARTS:
        name = part.__name__.replace("_", " ")
        write(part=name)
        try:
            for problem in part(model):
                write(part=name, problem=problem)
        except FMICallException as error:
            write(part=name, problem=str(error))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
