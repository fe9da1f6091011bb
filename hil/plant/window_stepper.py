"""Steps an FMU through many windows of recorded torques with many sets of start values: one C call for all of them.

    with WindowStepper(fmu, {"contact": "rigid"}, varied=("mass_kg", "start_vx_m_s"), outputs=SPEEDS) as stepper:
        speeds = stepper.run(torque_n_m, window=[0, 0, 1], start=[[20, 0.1], [21, 0.1], [20, 0.3]])

For co-simulation FMUs of 2.0 and 3.0. Its cost is that of the FMU and little more (``tools.bench.window_stepper``).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError, DeviceError, nearest
from hil.core.plant_signals import OUTPUTS
from hil.plant import shim
from hil.plant.fmu import FmuPlant
from hil.plant.mapping import FLOATS, SignalMap
from hil.plant.start import Start, Value, start_of, start_values

_C_TYPES = {"Boolean": ("int", "bool"), "String": ("char *", "char *"), "Enumeration": ("int", "int64_t")}
_SHOWN = 4  # start values in a message


class WindowStepper:
    """An FMU that is reset, given start values and stepped through a window of torques, case after case.

    ``start`` gives start values that all cases share, ``varied`` names the floating-point variables whose start
    differs from case to case, and ``outputs`` the signals to return (``hil.core.plant_signals.OUTPUTS``). Each row of a
    window lasts a tick of ``step_ns``, in which the FMU is stepped as in a run. A context manager.

    The FMU's code runs in this process: if it crashes or hangs, so does this process.

    Raises BadInputError as ``FmuPlant``, and for an unknown signal, or a varied variable that is no floating-point
    number or has no start.
    """

    def __init__(
        self,
        fmu: Path,
        start: Mapping[str, Value],
        mapping: SignalMap | None = None,
        *,
        varied: Sequence[str],
        outputs: Sequence[str],
        step_ns: int = TICK_NS,
    ) -> None:
        for name in outputs:
            if name not in OUTPUTS:
                raise BadInputError(f"{name!r}: the plant has no such signal{nearest(name, OUTPUTS)}")
        self._ffi, self._lib = shim.load()
        self._fmu, self.varied, self.outputs = fmu, tuple(varied), tuple(outputs)
        self._plant = plant = FmuPlant(fmu, start, mapping, tick_ns=step_ns)
        try:
            instance = plant.instance
            self._memory: list[Any] = []
            self._batch = self._ffi.new("cosim_windows *")
            self._take_functions()
            self._take_settings(start_values(start, fmu, instance.variables))
            self._take_varied()
        except BaseException:
            plant.close()
            raise

    def run(
        self, torque_n_m: npt.ArrayLike, window: Sequence[int] | npt.NDArray[np.int_], start: npt.ArrayLike
    ) -> npt.NDArray[np.float64]:
        """Step all cases and return the outputs, of shape (cases, rows + 1, outputs).

        ``torque_n_m`` has the windows, of shape (windows, rows, 4): FL, FR, RR, RL, in single precision as on the plant
        port. ``window`` is the window of each case; ``start`` has its values of ``varied``, of shape (cases, varied).
        The first of the returned rows is the start, each other one the end of a row of the window.

        Raises DeviceError, which names the case's start values, when the FMU refuses one or fails; ValueError for
        arrays that do not fit together.
        """
        torque = np.ascontiguousarray(torque_n_m, dtype=np.float32)
        places = np.ascontiguousarray(window, dtype=np.uintp)
        starts = np.ascontiguousarray(start, dtype=np.float64)
        if torque.ndim != 3 or torque.shape[2] != 4:
            raise ValueError(f"torque_n_m has shape {torque.shape}; expected (windows, rows, 4)")
        if starts.shape != (len(places), len(self.varied)):
            raise ValueError(f"start has shape {starts.shape}; expected {(len(places), len(self.varied))}")
        if len(places) and places.max() >= len(torque):
            raise ValueError(f"window {places.max()} of {len(torque)}; they are counted from 0")
        if self._plant.context.component == self._ffi.NULL:
            raise DeviceError("the FMU is closed; make a new stepper")
        if self._plant.context.fatal:
            raise DeviceError(
                f"FMU {self._fmu} has reported a fatal error and cannot be stepped: {self._plant.message}"
            )
        result = np.empty((len(places), torque.shape[1] + 1, len(self.outputs)))
        batch, pointer = self._batch, self._ffi.from_buffer
        batch.rows, batch.cases = torque.shape[1], len(places)
        batch.torque_n_m = pointer("float[]", torque)
        batch.window, batch.start = pointer("size_t[]", places), pointer("double[]", starts)
        batch.result = pointer("double[]", result)
        if self._lib.cosim_run_windows(self._plant.context, batch) != 0:
            raise DeviceError(self._failure(starts[batch.failed_case]))
        return result

    def close(self) -> None:
        self._plant.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _failure(self, starts: npt.NDArray[np.float64]) -> str:
        given = [f"{name} = {value:.6g}" for name, value in zip(self.varied, starts, strict=True)]
        more = ", ..." if len(given) > _SHOWN else ""
        at = f"with {', '.join(given[:_SHOWN])}{more}" if given else "from its start"
        return f"FMU {self._fmu} failed {at}: {self._plant.message}"

    def _take_functions(self) -> None:
        instance, batch = self._plant.instance, self._batch
        prefix = f"fmi{instance.version}"
        batch.reset = instance.function(f"{prefix}Reset")
        batch.enter_initialization = instance.function(f"{prefix}EnterInitializationMode")
        batch.exit_initialization = instance.function(f"{prefix}ExitInitializationMode")
        if instance.version == 2:
            batch.setup_experiment = instance.function("fmi2SetupExperiment")

    def _take_settings(self, starts: Sequence[Start]) -> None:
        for start in starts:
            if start.variable.causality == "structuralParameter":
                raise BadInputError(f"plant.start.{start.variable.name} shapes the FMU; windows cannot set it")
        settings = [self._setting(start) for start in starts if start.variable.name not in self.varied]
        self._batch.setting = self._keep(self._ffi.new("cosim_setting[]", settings))
        self._batch.settings = len(settings)
        self._batch.output = self._keep(self._ffi.new("size_t[]", [OUTPUTS.index(name) for name in self.outputs]))
        self._batch.outputs = len(self.outputs)

    def _setting(self, start: Start) -> tuple[Any, Any, int, Any]:
        variable, value, version = start.variable, start.value, self._plant.instance.version
        name = variable.type
        c_type = _C_TYPES[name][version - 2] if name in _C_TYPES else shim.c_type(name)
        call = ("Integer" if version == 2 else "Int64") if name == "Enumeration" else name
        if isinstance(value, str):
            value = self._keep(self._ffi.new("char[]", value.encode()))
        reference = self._keep(self._ffi.new("unsigned[]", [variable.valueReference]))
        return self._plant.instance.access("Set", call), reference, 1, self._keep(self._ffi.new(f"{c_type}[]", [value]))

    def _take_varied(self) -> None:
        variables, rows = self._plant.instance.variables, []
        for name in self.varied:
            variable = variables.get(name)
            if variable is not None and variable.type not in FLOATS:
                raise BadInputError(f"{name!r} of {self._fmu.name} is of type {variable.type}; expected a float")
            # It is a start value like any other, so the same words refuse it.
            usual = 0.0 if variable is None else start_of(variable) or 0.0
            start_values({name: usual}, self._fmu, variables)
            assert variable is not None
            rows.append((variable.valueReference, *shim.setter(self._plant.instance.access, variable.type)))
        self._batch.varied = self._keep(self._ffi.new("cosim_variable[]", rows))
        self._batch.varieds = len(rows)

    def _keep(self, memory: Any) -> Any:
        """Keep memory alive as long as C may read it."""
        self._memory.append(memory)
        return memory
