"""What an importer must not do, and an FMU had better refuse: what is found here is advice.

FMI 3.0.1 section 2.2.3 asks for an error where the FMU detects an illegal call or argument, not that it detects each.
The FMU may crash here: each attempt is announced first.
"""

import ctypes
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelVariable

from hil.plant.conformance.findings import Finding, advice
from hil.plant.conformance.slave import Model, Slave, count, is_float, limits, start

_UNUSED_REFERENCE = 0xFFFFFFF0
_FLOAT_GETTER = {"fmi2": "Real", "fmi3": "Float64"}
_INTEGER_GETTER = {"fmi2": "Integer", "fmi3": "Int32"}


class Misuse(NamedTuple):
    """A call that the standard forbids in a state of the instance."""

    name: str
    state: str  # instantiated, initialization mode, step mode or terminated
    call: Callable[[Slave], object]


def illegal_calls(model: Model) -> Iterator[Finding]:
    """What an importer must not call is refused with an error: FMI 3.0 section 2.2.3, FMI 2.0 section 4.2.4."""
    for misuse in _misuses(model):
        model.report(trying=misuse.name)
        with model.instance(initialised=False) as slave:
            _bring_to(slave, misuse.state)
            try:
                misuse.call(slave)
            except FMICallException:
                continue
            yield advice(f"{misuse.name} is accepted")


def values_out_of_range(model: Model) -> Iterator[Finding]:
    """A value outside its range is refused or dealt with; it does not give outputs that are not finite.

    Ranges say what a model was made for; an FMU need not refuse what is outside (FMI 2.0 section 2.2.7, FMI 3.0 section
    2.2.6).
    """
    for variable in model.variables:
        if variable.causality not in ("parameter", "input"):
            continue
        for value in _outside(variable):
            model.report(trying=f"{variable.name} = {value!r}")
            with model.instance(initialised=False) as slave:
                try:
                    if variable.causality == "parameter":
                        slave.set(variable, value)
                    slave.initialise()
                    if variable.causality == "input":
                        slave.set(variable, value)
                    slave.step(model.start_s, model.step_s)
                    outputs = slave.sample()
                except FMICallException:
                    continue
                if not all(math.isfinite(output) for output in outputs):
                    yield advice(f"{variable.name} = {value!r} is accepted and gives outputs that are not finite")


def _bring_to(slave: Slave, state: str) -> None:
    if state == "instantiated":
        return
    slave.enter_initialization()
    if state == "initialization mode":
        return
    slave.exit_initialization()
    if state == "terminated":
        slave.simulate(0, 1)
        slave.fmu.terminate()


def _misuses(model: Model) -> Iterator[Misuse]:
    here_s, size_s = model.start_s, model.step_s
    real = _FLOAT_GETTER[model.slave.prefix]
    ready = "step mode"
    yield Misuse("doStep before initialization", "instantiated", lambda slave: slave.step(here_s, size_s))
    yield Misuse("exitInitializationMode without enter", "instantiated", lambda slave: slave.exit_initialization())
    yield Misuse("doStep in initialization mode", "initialization mode", lambda slave: slave.step(here_s, size_s))
    yield Misuse("enterInitializationMode a second time", ready, lambda slave: slave.fmu.enterInitializationMode())
    if model.slave.prefix == "fmi2":
        yield Misuse("setupExperiment after initialization", ready, lambda slave: slave.fmu.setupExperiment())
    yield Misuse("doStep with a negative step", ready, lambda slave: slave.step(here_s, -size_s))
    yield Misuse("doStep after terminate", "terminated", lambda slave: slave.step(here_s + size_s, size_s))
    unknown = "of an unknown value reference"
    yield Misuse(f"get{real} {unknown}", ready, lambda slave: slave.get_as(real, _UNUSED_REFERENCE))
    yield Misuse(f"set{real} {unknown}", ready, lambda slave: slave.set_as(real, _UNUSED_REFERENCE, [0.0]))
    for output in _first(model, lambda v: v.causality == "output" and is_float(v)):
        yield from _misuses_of_output(model, output)
    for fixed in _first(model, lambda v: v.causality == "parameter" and v.variability == "fixed" and is_float(v)):
        yield _misuse_of_fixed(fixed)
    for item in _first(model, lambda v: v.type == "Enumeration" and v.causality in ("parameter", "output", "input")):
        yield from _misuses_of_enumeration(model, item)


def _misuses_of_output(model: Model, output: ModelVariable) -> Iterator[Misuse]:
    yield Misuse("setting an output", "step mode", lambda slave: slave.set(output, 0.0))
    integer = _INTEGER_GETTER[model.slave.prefix]
    if _is_free(model, output.valueReference, integer):
        name = f"get{integer} of a floating-point output"
        yield Misuse(name, "step mode", lambda slave: slave.get_as(integer, output.valueReference))
    if model.slave.prefix == "fmi3":
        name = "reading a variable into no room (nValues = 0)"
        yield Misuse(name, "step mode", lambda slave: _read_nothing(slave, output))


def _misuse_of_fixed(fixed: ModelVariable) -> Misuse:
    values = start(fixed) or [0.0]
    name = "setting a fixed parameter after initialization"
    return Misuse(name, "step mode", lambda slave: slave.set(fixed, values[0]))


def _misuses_of_enumeration(model: Model, item: ModelVariable) -> Iterator[Misuse]:
    kinds = [_FLOAT_GETTER[model.slave.prefix]]
    if model.slave.prefix == "fmi3":  # in FMI 2.0 an enumeration is an Integer
        kinds.append(_INTEGER_GETTER["fmi3"])
    for kind in kinds:
        if _is_free(model, item.valueReference, kind):
            name = f"get{kind} of an enumeration"
            yield Misuse(name, "step mode", partial(_get_as, kind, item.valueReference))


def _get_as(kind: str, reference: int, slave: Slave) -> object:
    return slave.get_as(kind, reference)


def _first(model: Model, fits: Callable[[ModelVariable], bool]) -> list[ModelVariable]:
    """Return the first variable that fits, or none."""
    return [variable for variable in model.variables if fits(variable)][:1]


def _is_free(model: Model, reference: int, kind: str) -> bool:
    """Return whether no variable with this getter has the value reference: FMI 2.0 gives it out once a type."""
    kinds = model.slave.kinds
    return all(v.valueReference != reference or kinds.get(v.type, v.type) != kind for v in model.variables)


def _read_nothing(slave: Slave, variable: ModelVariable) -> None:
    kind = slave.kind(variable)
    number = ctypes.c_double if kind == "Float64" else ctypes.c_float
    references = (ctypes.c_uint32 * 1)(variable.valueReference)
    room = (number * count(variable))()  # there is room, but the call says that there is none
    getattr(slave.fmu, f"fmi3Get{kind}")(slave.fmu.component, references, 1, room, 0)


def _outside(variable: ModelVariable) -> list[float | int]:
    """Return a value on either side of the range, where there is one."""
    if variable.type == "Enumeration":
        declared = variable.declaredType
        values = [int(item.value) for item in declared.items] if declared is not None else []
        return [min(values) - 1, max(values) + 1] if values else []
    if variable.type == "Boolean":
        return []
    low, high = limits(variable)
    outside = [low - 1.0, high + 1.0]
    known = [value for value in outside if math.isfinite(value)]
    if is_float(variable):
        return known
    return [int(value) for value in known if 0 <= value < 2**7]  # in the range of every integer type
