"""What an FMU has to do when it is used as the standard allows. Each part yields what it finds, one sentence each."""

import ctypes
import math
from collections.abc import Callable, Generator, Iterator

from fmpy.fmi1 import FMICallException

from hil.addons.fmu_check import Finding, need, note, violation
from hil.addons.fmu_check.slave import (
    DISCARD,
    Model,
    NotTestedError,
    Outputs,
    Slave,
    close,
    same,
    same_time,
    start,
)
from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError
from hil.plant.communication import communication_step
from hil.plant.instance import lacking_here
from hil.plant.mapping import FLOATS
from hil.plant.start import count

_STEPS = 20
_MOST_NAMED = 5  # variables that are wrong after a reset
_GUARD = b"\xa5" * 64


def functions(model: Model) -> Iterator[Finding]:
    """Every function of the interface is exported: FMI 2.0.5 section 2.3, FMI 3.0.1 section 2.2.1."""
    model.report(doing="while its library is loaded")
    try:
        library = ctypes.CDLL(str(model.library_path))
    except OSError as error:
        if (lacking := lacking_here(error, model.library_path)) is not None:
            raise BadInputError(lacking) from error
        yield violation(f"the library cannot be loaded ({error})")
        return
    missing = [n for n in dir(model.fmpy_class) if n.startswith(model.prefix) and not hasattr(library, n)]
    yield from (violation(f"{name} is not exported") for name in missing)


def life_cycle(model: Model) -> Iterator[Finding]:
    """Two instances, one after another, can be stepped: only what each run does."""
    for _ in range(2):
        with model.instance() as slave:
            for step in range(_STEPS):
                slave.drive(step)
                slave.step(model.time_s(step), model.step_s)
    yield from ()


def version(model: Model) -> Iterator[Finding]:
    """GetVersion gives the version of the description: FMI 2.0 section 2.1.4, FMI 3.0 section 2.3.2."""
    name, expected = f"{model.prefix}GetVersion", "2.0" if model.is_fmi2 else "3."
    given = (getattr(model.library, name)() or b"").decode(errors="replace")
    if not given.startswith(expected):
        yield violation(f"{name} gives {given!r}; expected {expected}")


def debug_logging(model: Model) -> Iterator[Finding]:
    """Logging is switched on for all categories of the description, and off: FMI 2.0 section 2.1.5, 3.0 2.3.1."""
    categories = [category.name for category in model.description.logCategories if category.name]
    with model.instance(initialised=False) as slave:
        slave.fmu.setDebugLogging(True, categories)
        slave.initialise()
        slave.step(model.start_s, model.step_s)
        slave.fmu.setDebugLogging(False, [])
    yield from ()


def start_values(model: Model) -> Iterator[Finding]:
    """Parameters, inputs and constants have the start values of the description."""
    with model.instance() as slave:
        for variable in model.variables:
            has_start = variable.causality in ("parameter", "input") or variable.variability == "constant"
            expected = start(variable) if has_start else None
            if expected is not None and not close(values := slave.get(variable), expected):
                yield violation(
                    f"{variable.name} reads {_text(values)} at the start; modelDescription.xml says {_text(expected)}"
                )


def variables(model: Model) -> Iterator[Finding]:
    """Inputs keep what they were set to over a step; outputs are finite at the start and after each step."""
    with model.instance() as slave:
        yield from _not_finite(model, slave, "at the start")
        for step in range(_STEPS):
            slave.drive(step)
            slave.step(model.time_s(step), model.step_s)
            for place, variable in enumerate(model.inputs):
                expected = [model.input_value(variable, step, place)] * count(variable)
                if not close(values := slave.get(variable), expected):
                    yield violation(
                        f"input {variable.name} reads {_text(values)} after it was set to {_text(expected)}"
                    )
                    return
            problems = [*_not_finite(model, slave, f"after {step + 1} steps")]
            yield from problems
            if problems:
                return


def initialization(model: Model) -> Iterator[Finding]:
    """In initialization mode outputs follow the inputs, whatever these were when outputs were read before."""
    _require(model.inputs, "there are no floating-point inputs")
    with model.instance(initialised=False) as slave:
        slave.enter_initialization()
        slave.drive(1)
        direct = slave.sample()
    with model.instance(initialised=False) as slave:
        slave.enter_initialization()
        slave.drive(0)
        slave.sample()
        slave.drive(1)
        for name, value, expected in zip(_output_names(model), slave.sample(), direct, strict=True):
            if not close([value], [expected]):
                yield violation(
                    f"output {name} is {value!r} after inputs were set twice; set once, they give {expected!r}"
                )


def time(model: Model) -> Iterator[Finding]:
    """The FMU's own time is the communication point that it has reached.

    In FMI 2.0 (section 4.2.1) that is the end of the step. In FMI 3.0 (section 4.2.1) the FMU may report another.
    """
    clock = next((v for v in model.variables if v.causality == "independent"), None)
    _require(clock is not None or not model.is_fmi2, "no variable is the time")
    with model.instance() as slave:
        reached_s = model.start_s
        for step in range(_STEPS + 1):
            if clock is not None:
                (value,) = slave.get(clock)
                if not same_time(value, reached_s):
                    yield violation(
                        f"the time {clock.name} is {value!r} s; expected {reached_s!r} s, to where it was stepped"
                    )
                    return
            reached_s, finding = slave.step(model.time_s(step), model.step_s)
            if finding is not None:
                yield finding
                return


def step_size(model: Model) -> Iterator[Finding]:
    """When claimed: communication steps of any size are done, and a short one goes less far."""
    _require(model.claims.canHandleVariableCommunicationStepSize, "variable communication step sizes are not claimed")
    with model.instance() as slave:
        time_s = model.start_s
        for size_s in (*(factor * model.step_s for factor in (1.0, 0.5, 3.0, 0.1, 1.7)), TICK_NS / 1e9):
            try:
                slave.step(time_s, size_s)
            except FMICallException as error:
                if error.status != DISCARD:
                    raise
                yield need(f"a step of {size_s:g} s is not done: {model.explain(error)}")
                return
            time_s += size_s
        yield from _not_finite(model, slave, "after steps of various sizes")
    size_s = model.step_s
    half, whole = (_held(model, size_s, steps) for steps in (_STEPS // 2, _STEPS))
    if same(_held(model, 0.5 * size_s, _STEPS), whole) and not same(half, whole):
        yield violation(f"{_STEPS} steps of half the size bring the outputs as far as {_STEPS} whole ones")


def bridge_step(model: Model) -> Iterator[Finding]:
    """The FMU is stepped as a run does, which another part tests where any size is claimed."""
    try:
        step = communication_step(model.fmu, model.description)
    except BadInputError as error:
        yield need(str(error))
        return
    if step.notice:
        yield (note if step.size_ns == TICK_NS else need)(step.notice)
    if model.claims.canHandleVariableCommunicationStepSize:
        return
    size_s = step.size_ns / 1e9
    with model.instance() as slave:
        for number in range(_STEPS):
            slave.drive(number)
            try:
                slave.step(model.start_s + number * size_s, size_s)
            except FMICallException as error:
                yield need(f"a step of {size_s:g} s, which a run does, is not done: {model.explain(error)}")
                return


def saved_state(model: Model) -> Iterator[Finding]:
    """When claimed: a restored state, also one that was bytes, continues with the same bits."""
    _require(model.claims.canGetAndSetFMUstate, "saved states are not claimed")
    with model.instance() as slave:
        slave.simulate(0, _STEPS)
        state = slave.fmu.getFMUState()
        here = slave.sample()
        onward = slave.simulate(_STEPS, 2 * _STEPS)
        yield from _continues(slave, "a restored state", state, here, onward)
        slave.fmu.setFMUState(state)
        slave.call("GetFMUstate" if model.is_fmi2 else "GetFMUState", ctypes.byref(state))
        yield from _continues(slave, "a state that was saved over an older one", state, here, onward)
        octets = (yield from _to_bytes(slave, state)) if model.claims.canSerializeFMUstate else None
        slave.fmu.freeFMUState(state)
    if octets is not None:
        with model.instance() as slave:
            state = slave.fmu.deserializeFMUState(octets)
            yield from _continues(slave, "a state from bytes, in another instance,", state, here, onward)
            slave.fmu.freeFMUState(state)


def termination(model: Model) -> Iterator[Finding]:
    """After terminate, outputs can be read and are what they were."""
    with model.instance() as slave:
        *_, last = slave.simulate(0, _STEPS)
        slave.fmu.terminate()
        if not same(last, slave.sample()):
            yield violation("outputs are other after terminate than before")


def reset(model: Model) -> Iterator[Finding]:
    """After a reset, before or after terminate, an instance is as new: same parameters, same outputs."""
    parameters = [v for v in model.variables if v.causality in ("parameter", "input")]
    with model.instance() as slave:
        before = [slave.get(variable) for variable in parameters]
        first = slave.simulate(0, _STEPS)
        for ending in ("reset", "terminate and reset"):
            if ending != "reset":
                slave.fmu.terminate()
            slave.fmu.reset()
            slave.initialise()
            now = [slave.get(variable) for variable in parameters]
            others = [row for row in zip(parameters, before, now, strict=True) if not same(row[1], row[2])]
            for variable, value, other in others[:_MOST_NAMED]:
                yield violation(
                    f"after {ending} {variable.name} is {_text(other)}; it was {_text(value)} in the new instance"
                )
            if more := len(others[_MOST_NAMED:]):
                yield violation(f"after {ending} {more} more are other than in the new instance")
            if not same(first, slave.simulate(0, _STEPS)):
                yield violation(f"after {ending} the same inputs give other outputs")


def two_instances(model: Model) -> Iterator[Finding]:
    """Stepping one instance does not move another, unless only one is allowed."""
    _require(not model.claims.canBeInstantiatedOnlyOncePerProcess, "more than one instance in a process is not claimed")
    with model.instance() as alone:
        expected = alone.simulate(0, _STEPS)
    with model.instance() as one, model.instance() as two:
        rest = two.sample()
        if not same(one.simulate(0, _STEPS), expected):
            yield violation("an instance gives other outputs when a second one exists")
        if not same(rest, two.sample()):
            yield violation("stepping one instance changes the outputs of another")
        if not same(expected, two.simulate(0, _STEPS)):
            yield violation("an instance does not start where it should after another was stepped")


GATES = (functions, life_cycle)  # where these fail, no other part can run
PARTS: tuple[Callable[[Model], Iterator[Finding]], ...] = (
    *(*GATES, version, debug_logging, start_values, variables, initialization, time, step_size),
    *(bridge_step, saved_state, termination, reset, two_instances),
)
"""The parts in their order."""


def title(part: Callable[[Model], Iterator[Finding]]) -> str:
    """Return the part's name as a user reads it."""
    return part.__name__.replace("_", " ")


def _require(condition: object, reason: str) -> None:
    if not condition:
        raise NotTestedError(reason)


def _held(model: Model, size_s: float, steps: int) -> Outputs:
    """Return the outputs after so many steps of a size [s], with inputs that stay."""
    with model.instance() as slave:
        slave.drive(1)
        for step in range(steps):
            slave.step(model.start_s + step * size_s, size_s)
        return [value for variable in model.outputs if variable.type in FLOATS for value in slave.get(variable)]


def _continues(slave: Slave, name: str, state: object, here: Outputs, onward: list[Outputs]) -> Iterator[Finding]:
    slave.fmu.setFMUState(state)
    if not same(here, slave.sample()):
        yield violation(f"{name} gives other outputs than when it was saved")
    elif not same(onward, slave.simulate(_STEPS, 2 * _STEPS)):
        yield violation(f"{name} continues with other outputs")


def _to_bytes(slave: Slave, state: object) -> Generator[Finding, None, bytes | None]:
    """Return the state as bytes; yield a problem when its size is not what the FMU says."""
    needed, word = ctypes.c_size_t(), "state" if slave.model.is_fmi2 else "State"
    slave.call(f"SerializedFMU{word}Size", state, ctypes.byref(needed))
    size = needed.value
    buffer = ctypes.create_string_buffer(b"\0" * size + _GUARD, size + len(_GUARD))
    octets = buffer if slave.model.is_fmi2 else ctypes.cast(buffer, ctypes.POINTER(ctypes.c_uint8))
    slave.call(f"SerializeFMU{word}", state, octets, size)
    if buffer.raw[size:] != _GUARD:
        yield violation(f"serializing a state writes past the {size} bytes that it claims to need")
        return None
    return buffer.raw[:size]


def _not_finite(model: Model, slave: Slave, when: str) -> Iterator[Finding]:
    for name, value in zip(_output_names(model), slave.sample(), strict=True):
        if not math.isfinite(value):
            yield need(f"output {name} is {value!r} {when}; a run of this importer ends where one is not finite")


def _output_names(model: Model) -> list[str]:
    """Return a name for each value of a sample."""
    return [variable.name for variable in model.outputs for _ in range(count(variable))]


def _text(values: list[float | int | bool]) -> str:
    return repr(values[0]) if len(values) == 1 else repr(values)
