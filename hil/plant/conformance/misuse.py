"""Illegal calls and values, which an FMU should refuse: what is found here is advice.

FMI 3.0.1 section 2.2.3 asks for an error where the FMU detects an illegal call or argument, not that it detects each.
The FMU may crash here: each attempt is announced first.
"""

import ctypes
import math
from collections.abc import Callable, Iterator
from functools import partial

from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelVariable

from hil.plant.conformance import Finding, advice
from hil.plant.conformance.slave import Model, Slave, is_float, start
from hil.plant.start import count, items_of, limits

_UNUSED_REFERENCE = 0xFFFFFFF0

Misuse = tuple[str, str, Callable[[Slave], object]]
"""Name, state of the instance, and a call that is forbidden in that state.

The states are instantiated, initialization mode, step mode and terminated.
"""


def illegal_calls(model: Model) -> Iterator[Finding]:
    """What an importer must not call is refused with an error: FMI 3.0 section 2.2.3, FMI 2.0 section 4.2.4."""
    for name, state, call in (*_misuses(model), *_misuses_of_variables(model)):
        model.report(trying=name)
        with model.instance(initialised=False) as slave:
            if state != "instantiated":
                slave.enter_initialization()
            if state in ("step mode", "terminated"):
                slave.fmu.exitInitializationMode()
            if state == "terminated":
                slave.simulate(0, 1)
                slave.fmu.terminate()
            try:
                call(slave)
            except FMICallException:
                continue
            yield advice(f"{name} is accepted")


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


def _misuses(model: Model) -> Iterator[Misuse]:
    here_s, size_s = model.start_s, model.step_s
    real, ready = "Real" if model.is_fmi2 else "Float64", "step mode"
    yield "doStep before initialization", "instantiated", lambda slave: slave.step(here_s, size_s)
    yield "exitInitializationMode without enter", "instantiated", lambda slave: slave.fmu.exitInitializationMode()
    yield "doStep in initialization mode", "initialization mode", lambda slave: slave.step(here_s, size_s)
    yield "enterInitializationMode a second time", ready, lambda slave: slave.fmu.enterInitializationMode()
    if model.is_fmi2:
        yield "setupExperiment after initialization", ready, lambda slave: slave.fmu.setupExperiment()
    yield "doStep with a negative step", ready, lambda slave: slave.step(here_s, -size_s)
    yield "doStep after terminate", "terminated", lambda slave: slave.step(here_s + size_s, size_s)
    unknown = "of an unknown value reference"
    yield f"get{real} {unknown}", ready, lambda slave: slave.get_as(real, _UNUSED_REFERENCE)
    yield f"set{real} {unknown}", ready, lambda slave: slave.set_as(real, _UNUSED_REFERENCE, [0.0])


def _misuses_of_variables(model: Model) -> Iterator[Misuse]:
    """Yield misuses of the first output, the first fixed parameter and the first enumeration."""
    real, integer = ("Real", "Integer") if model.is_fmi2 else ("Float64", "Int32")
    output = next((v for v in model.outputs if is_float(v)), None)
    if output is not None:
        yield "setting an output", "step mode", lambda slave: slave.set(output, 0.0)
        if _is_free(model, output.valueReference, integer):
            read = partial(Slave.get_as, kind=integer, reference=output.valueReference)
            yield f"get{integer} of a floating-point output", "step mode", read
        if not model.is_fmi2:
            name = "reading a variable into no room (nValues = 0)"
            yield name, "step mode", lambda slave: _read_nothing(slave, output)
    parameters = [v for v in model.variables if v.causality == "parameter"]
    fixed = next((v for v in parameters if v.variability == "fixed" and is_float(v)), None)
    if fixed is not None:
        name = "setting a fixed parameter after initialization"
        yield name, "step mode", lambda slave: slave.set(fixed, (start(fixed) or [0.0])[0])
    items = [v for v in model.variables if v.type == "Enumeration" and v.causality in ("parameter", "output", "input")]
    for item in items[:1]:
        for kind in (real,) if model.is_fmi2 else (real, integer):  # in FMI 2.0 an enumeration is an Integer
            if _is_free(model, item.valueReference, kind):
                read = partial(Slave.get_as, kind=kind, reference=item.valueReference)
                yield f"get{kind} of an enumeration", "step mode", read


def _is_free(model: Model, reference: int, kind: str) -> bool:
    """Return whether no variable with this getter has the value reference: FMI 2.0 gives it out once a type."""
    return all(v.valueReference != reference or model.kind(v) != kind for v in model.variables)


def _read_nothing(slave: Slave, variable: ModelVariable) -> None:
    kind = slave.model.kind(variable)
    number = ctypes.c_double if kind == "Float64" else ctypes.c_float
    references = (ctypes.c_uint32 * 1)(variable.valueReference)
    values = (number * count(variable))()  # large enough, but the call says that its size is 0
    slave.call(f"Get{kind}", references, 1, values, 0)


def _outside(variable: ModelVariable) -> list[float | int]:
    """Return a value on either side of the range, where there is one."""
    if variable.type == "Enumeration":
        values = items_of(variable).values()
        return [min(values) - 1, max(values) + 1] if values else []
    if variable.type == "Boolean":
        return []
    low, high = limits(variable)
    known = [value for value in (low - 1.0, high + 1.0) if math.isfinite(value)]
    if is_float(variable):
        return known
    return [int(value) for value in known if 0 <= value < 2**7]  # in the range of every integer type
