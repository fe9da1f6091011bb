"""Access to the C shim cosim.[ch] through cffi, and the layout of a wiring for it: one group of variables per type."""

import functools
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Self

from firmware_protocol.built import BuildError
from firmware_protocol.extension import Loaded, load_library
from hil.core.errors import BadInputError, DeviceError, nearest
from hil.core.plant_signals import INPUTS, OUTPUTS
from hil.core.tuples import make_pose_fix
from hil.core.types import PoseFix, Wheels
from hil.plant.built import COSIM, HEADERS
from hil.plant.child_output import ChildOutput
from hil.plant.mapping import Connection, Wiring
from hil.plant.start import Settable, count, elements_at_start, limits

_NO_RANGE = (-math.inf, math.inf)
_FMI2_TYPES = {"Real": "Float64", "Integer": "Int32"}
_C_TYPES = {"Float64": "double", "Float32": "float"}


def load() -> tuple[Any, Any]:
    """Return cffi's (ffi, library) of the shim, with the declarations taken from the C headers themselves.

    Raises BadInputError when it does not match its sources and cannot be rebuilt.
    """
    return loaded()[:2]


@functools.cache
def loaded() -> Loaded:
    """Return the result of ``load``, and the library that it loaded. Raises as ``load``."""
    try:
        COSIM.make_current()
    except BuildError as error:
        raise BadInputError(str(error)) from error
    return load_library(COSIM.path, HEADERS)


def address(name: str) -> int:
    ffi, library = load()
    return int(ffi.cast("uintptr_t", ffi.addressof(library, name)))


class PlantPort(ABC):
    """What both plants offer to C: the addresses of functions, and the context argument for them.

    The addresses hold as long as the object lives; the functions fail after ``close``. A context manager.

    Attributes:
        truth: returns pose and twist, world frame, with the time since the start.
        settable: the variables that may be set between two ticks, by name.
        output: what the plant's own process prints; None for a plant in this process.
        lacks: the sensors (keys of ``plant_signals.SENSORS``) that the FMU does not have.
        notices: remarks for the user on how the FMU is used.
    """

    _functions: ClassVar[str]
    """With what the names of the shim's functions begin."""
    _context: Any
    truth: Callable[[], PoseFix]
    settable: Mapping[str, Settable]
    output: ChildOutput | None = None
    lacks: frozenset[str]
    notices: tuple[str, ...]

    @property
    def exchange_address(self) -> int:
        """Address of a C function of the type ``wheel_plant_exchange``, which exchanges one tick."""
        return address(f"{self._functions}_exchange")

    @property
    def set_address(self) -> int:
        """Address of a C function that sets a variable of ``settable`` by its place, with the same context."""
        return address(f"{self._functions}_set")

    @property
    def context_address(self) -> int:
        """Address of the context of both functions."""
        return int(load()[0].cast("uintptr_t", self._context))

    def _read_truth(self, time_ns: Any) -> None:
        """Set where in memory the time is, an integer of 64 bits; the six doubles of pose and twist are behind it."""
        self.truth = functools.partial(make_pose_fix, load()[0].buffer(time_ns, 7 * 8))

    def set_variable(self, name: str, value: float) -> None:
        """Set a tunable parameter or free input, from the next tick on.

        Raises BadInputError when the FMU has none of this name, DeviceError when it refuses the value.
        """
        if name not in self.settable:
            raise BadInputError(
                f"the FMU has no tunable parameter or free input {name!r}{nearest(name, self.settable)}"
            )
        ffi, _ = load()
        call = ffi.cast("int (*)(void *, size_t, double)", self.set_address)
        if call(self._context, self.settable[name].place, value) != 0:
            raise DeviceError(f"the plant refused {name} = {value:g}: {self.message}")

    @property
    @abstractmethod
    def pose_address(self) -> int:
        """Address of the newest pose: three doubles."""

    @abstractmethod
    def wire(self, wheel_of_channel: Sequence[int], sign_of_channel: Sequence[int]) -> None:
        """Set the wheel (0 to 3: FL, FR, RR, RL) and the direction that each channel of the plant port drives.

        Raises BadInputError unless that is a permutation with signs 1 and -1, DeviceError when the FMU fails.
        """

    @abstractmethod
    def step(self, torque_n_m: Wheels, ticks: int = 1) -> None:
        """Apply the torques of the channels, in single precision as on the plant port, for a number of ticks.

        Raises DeviceError when the FMU fails.
        """

    @abstractmethod
    def wheel_speeds(self) -> Wheels:
        """Return the true wheel speeds [rad/s]."""

    @property
    @abstractmethod
    def message(self) -> str:
        """Why the plant failed, with the FMU's message if there is one; empty while it has not failed."""

    @abstractmethod
    def reset(self) -> None:
        """Return to the start state, also after a failure. Raises DeviceError when the plant is closed or cannot."""

    @abstractmethod
    def close(self) -> None:
        """Free the FMU. Closing twice is allowed."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(context: Any, wiring: Wiring, access: Callable[[str, str], Any]) -> list[object]:
    """Write a wiring into a ``cosim``; return the objects that must live as long as it.

    ``access`` gives a getter or setter of the FMU: that of ("Set", "Real") for example.
    """
    kept: list[object] = []
    sides = (("input", "Set", context.input_value, wiring.inputs), ("output", "Get", context.fresh, wiring.outputs))
    for direction, call, signals, connections in sides:
        types = list(dict.fromkeys(connection.variable.type for connection in connections))
        for group, kind in zip(getattr(context, direction), types, strict=False):
            chosen = [c for c in connections if c.variable.type == kind]
            kept += _fill(group, kind, chosen)
            group.call = access(call, kind)
            _leave_in_place(group, signals, chosen)
        setattr(context, f"{direction}s", len(types))
    names, input_names = _names(OUTPUTS, wiring.outputs), _names(INPUTS, wiring.inputs)
    context.name, context.input_name = names, input_names
    ranges = {
        signal: sorted(factor * end + offset for end in limits(variable))
        for signal, variable, _, factor, offset in wiring.inputs
    }
    context.is_bounded = any(map(math.isfinite, itertools.chain(*ranges.values())))
    context.low, context.high = zip(*(ranges.get(place, _NO_RANGE) for place in range(len(INPUTS))), strict=True)
    context.derives = bool(wiring.derived)
    context.derived = [place in wiring.derived for place in range(len(OUTPUTS))]
    return [*kept, *names, *input_names]


def _names(signals: Sequence[str], connections: Sequence[Connection]) -> list[Any]:
    names = list(signals)
    for connection in connections:
        signal, variable = signals[connection.signal], connection.variable.name
        if signal != variable:
            names[connection.signal] = f"{signal} ({variable} in the FMU)"
    return [load()[0].new("char[]", name.encode()) for name in names]


def setter(access: Callable[[str, str], Any], kind: str) -> tuple[int, Any]:
    """Return the shim's number of a floating-point type and the FMU's function that sets a variable of it."""
    return getattr(load()[1], f"COSIM_{_FMI2_TYPES.get(kind, kind).upper()}"), access("Set", kind)


def c_type(kind: str) -> str:
    name = _FMI2_TYPES.get(kind, kind)
    return _C_TYPES.get(name, f"{name.lower()}_t")


def _fill(group: Any, kind: str, connections: list[Connection]) -> list[object]:
    """Lay out the variables of one type: each once, an array's elements one after the other."""
    ffi, library = load()
    name = _FMI2_TYPES.get(kind, kind)
    variables = list({c.variable.valueReference: c.variable for c in connections}.values())
    place_of, values = {}, 0
    for variable in variables:
        place_of[variable.valueReference] = values
        values += count(variable)
    rows = [(c.signal, place_of[c.variable.valueReference] + c.element, c.factor, c.offset) for c in connections]
    reference = ffi.new("unsigned[]", [variable.valueReference for variable in variables])
    # An element of an input that no signal drives keeps its start.
    starts: list[float] = []
    for variable in variables:
        given = elements_at_start(variable) or [0]
        starts += given if len(given) == count(variable) else given[:1] * count(variable)
    value = ffi.new(f"{c_type(kind)}[]", starts)
    row = ffi.new("cosim_row[]", rows)
    group.type = getattr(library, f"COSIM_{name.upper()}")
    group.reference, group.references = reference, len(variables)
    group.value, group.values = value, values
    group.row, group.rows = row, len(rows)
    group.is_identity = all((c.factor, c.offset) == (1.0, 0.0) for c in connections)
    return [reference, value, row]


def _leave_in_place(group: Any, signals: Any, connections: list[Connection]) -> None:
    """Let the FMU use the shim's own signals where they are doubles, one after the other and as they are."""
    first = connections[0].signal
    in_order = [c.signal for c in connections] == list(range(first, first + len(connections)))
    if group.type == load()[1].COSIM_FLOAT64 and group.is_identity and in_order and group.values == len(connections):
        group.value = signals + first
        group.is_in_place = 1
