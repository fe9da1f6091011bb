"""The plant FMU in this process, stepped from C through the firmware's plant port.

FMPy reads the description, loads and initialises the FMU. From then on the shim ``plant/cosim.c`` calls the
FMU's functions by their addresses: one C call a tick, where FMPy's own methods cost about 30 times as much.
"""

import contextlib
import ctypes
import math
import shutil
import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from hil.errors import BadInputError, DeviceError, nearest
from hil.plant import archive
from hil.plant.shim import shim
from hil.types import WHEEL_NAMES, Pose, PoseFix, Twist, Wheels

_TORQUES = tuple(f"wheel.{wheel}.torque_n_m" for wheel in WHEEL_NAMES)
_COUNTS = tuple(f"wheel.{wheel}.count" for wheel in WHEEL_NAMES)
_REALS = (  # the order of the enumeration in cosim.h
    *(f"pose.{name}" for name in Pose._fields),
    *(f"twist.{name}" for name in Twist._fields),
    *(f"wheel.{wheel}.speed_rad_s" for wheel in WHEEL_NAMES),
    *(f"wheel.{wheel}.current_a" for wheel in WHEEL_NAMES),
    *(f"gyro.{axis}_rad_s" for axis in "xyz"),
)
_CALLS = {
    "set_real": "fmi2SetReal",
    "get_real": "fmi2GetReal",
    "get_integer": "fmi2GetInteger",
    "do_step": "fmi2DoStep",
}
_LOADING = threading.Lock()  # FMPy changes the working directory while it loads


class FmuPlant:
    """An instance of the shipped FMU behind the plant port, at its start until it is stepped.

    ``start`` gives parameters of the FMU by name, in the FMU's units; the others keep the FMU's defaults. A
    tick lasts ``step_ns``. ``exchange_address`` is a C function of the type ``wheel_plant_exchange``,
    ``context_address`` its context; both hold only as long as this object lives, and fail after ``close``.

    Raises BadInputError when the file is not an FMU that can run here, when a name is unknown or a value out
    of its range.
    """

    def __init__(
        self,
        fmu: Path,
        start: Mapping[str, float],
        step_ns: int = 1_000_000,
        mapping: Mapping[str, Mapping[str, object]] | None = None,
    ) -> None:
        if mapping:
            raise BadInputError("plant.map is for the importer of the next change")
        library = archive.library_of(fmu)
        if step_ns <= 0:
            raise BadInputError(f"plant step {step_ns} ns; expected a positive number")
        ffi, self._lib = shim()
        self._ffi = ffi
        self._context = ffi.new("cosim *", {"step_ns": step_ns})
        self.wire((0, 1, 2, 3), (1, 1, 1, 1))
        with contextlib.ExitStack() as resources:
            folder = archive.extract(fmu)
            resources.callback(shutil.rmtree, folder, ignore_errors=True)
            self._fmu, variables = _load(fmu, folder, folder / library)
            resources.callback(self._fmu.freeLibrary)
            # Where a loaded library's file may go, it goes now: a killed run then leaves nothing behind.
            shutil.rmtree(folder, ignore_errors=True)
            self._connect(variables)
            self._start = _parameters(fmu, start, variables)
            self._instantiate()
            resources.callback(self._free)
            self._initialise()
            self._resources = resources.pop_all()

    @property
    def exchange(self) -> Any:
        """The C function that exchanges one tick, as cffi sees it."""
        return self._ffi.addressof(self._lib, "cosim_exchange")

    @property
    def context(self) -> Any:
        """The context of ``exchange``, as cffi sees it."""
        return self._context

    @property
    def exchange_address(self) -> int:
        """Address of the C function of the type ``wheel_plant_exchange``."""
        return int(self._ffi.cast("uintptr_t", self.exchange))

    @property
    def context_address(self) -> int:
        """Address of the context that belongs to ``exchange_address``."""
        return int(self._ffi.cast("uintptr_t", self._context))

    def wire(self, wheel_of_channel: Sequence[int], sign_of_channel: Sequence[int]) -> None:
        """Say which wheel (0 to 3: FL, FR, RR, RL) each channel of the plant port drives, and in which sense.

        Raises BadInputError unless that is a permutation with signs 1 and -1.
        """
        if sorted(wheel_of_channel) != [0, 1, 2, 3] or [abs(sign) for sign in sign_of_channel] != [1] * 4:
            raise BadInputError(
                f"wheels {tuple(wheel_of_channel)} with signs {tuple(sign_of_channel)} on the channels; "
                "expected each of 0 to 3 once, and signs of 1 or -1"
            )
        self._context.wheel_of_channel = list(wheel_of_channel)
        self._context.sign_of_channel = list(sign_of_channel)

    def step(self, torque_n_m: Wheels, ticks: int = 1) -> None:
        """Hold the torques of the channels, in single precision as on the plant port, for so many ticks.

        Raises DeviceError when the FMU fails.
        """
        if self._lib.cosim_run(self._context, list(torque_n_m), ticks) != 0:
            raise DeviceError(f"the plant stopped at {self._seconds():g} s: {self.message}")

    def truth(self) -> PoseFix:
        """Return pose and twist, world frame, with the time since the start."""
        x, y, heading, vx, vy, yaw_rate = self._ffi.unpack(self._context.real, 6)
        return PoseFix(self._lib.cosim_time_ns(self._context), Pose(x, y, heading), Twist(vx, vy, yaw_rate))

    def wheel_speeds(self) -> Wheels:
        """Return the true wheel speeds [rad/s]."""
        return Wheels(*self._ffi.unpack(self._context.real + self._lib.COSIM_WHEEL_SPEED, 4))

    @property
    def message(self) -> str:
        """Why the newest exchange failed, in the FMU's words where it gave some; empty when it did not."""
        return str(self._ffi.string(self._context.text).decode(errors="replace"))

    def reset(self) -> None:
        """Go back to the start, also after a failure. Raises DeviceError when the plant is closed."""
        if self._context.component == self._ffi.NULL:
            raise DeviceError("the plant is closed; make a new one")
        self._fmu.reset()
        self._initialise()

    def close(self) -> None:
        """Free the instance, unload the library and remove the unpacked files. Closing twice is allowed."""
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _connect(self, variables: Mapping[str, Any]) -> None:
        """Hand addresses and value references to the shim."""
        context, ffi = self._context, self._ffi
        for member, name in _CALLS.items():
            address = ctypes.cast(getattr(self._fmu.dll, name), ctypes.c_void_p).value
            setattr(context, member, ffi.cast(ffi.typeof(getattr(context, member)), address))
        context.torque_reference = _references(variables, _TORQUES)
        context.real_reference = _references(variables, _REALS)
        context.count_reference = _references(variables, _COUNTS)

    def _instantiate(self) -> None:
        """Make the FMU's instance with the shim's logger: its messages need no call into Python."""
        from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

        logger = int(self._ffi.cast("uintptr_t", self._ffi.addressof(self._lib, "cosim_log")))
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = ctypes.cast(logger, fmi2CallbackLoggerTYPE)
        callbacks.componentEnvironment = self.context_address
        self._fmu.instantiate(callbacks=callbacks)
        self._context.component = self._ffi.cast("void *", self._fmu.component)

    def _initialise(self) -> None:
        from fmpy.fmi1 import FMICallException

        self._context.steps = 0
        self._context.failed = 0
        self._fmu.setupExperiment(startTime=0.0)
        for reference, value in self._start:
            setter = self._fmu.setInteger if isinstance(value, int) else self._fmu.setReal
            try:
                setter([reference], [value])
            except FMICallException as error:
                raise BadInputError(f"plant.start: {self.message}") from error
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()
        sense = self._ffi.new("wheel_sense *")
        if self._lib.cosim_exchange(self._context, self._ffi.NULL, sense) != 0:
            raise DeviceError(f"the plant has no outputs at its start: {self.message}")

    def _free(self) -> None:
        self._context.component = self._ffi.NULL
        self._fmu.fmi2FreeInstance(self._fmu.component)

    def _seconds(self) -> float:
        return float(self._lib.cosim_time_ns(self._context)) / 1e9


def _load(fmu: Path, folder: Path, library: Path) -> tuple[Any, dict[str, Any]]:
    """Load the unpacked FMU with FMPy; return it, and its variables by name."""
    import fmpy
    from fmpy.fmi2 import FMU2Slave
    from fmpy.model_description import read_model_description

    try:
        # FMPy raises a plain Exception for this; asked first, the loader tells what is wrong.
        probe = ctypes.CDLL(str(library))
    except OSError as error:
        raise BadInputError(f"FMU {fmu}: its library cannot be loaded ({error}); run: hil fmu build") from error
    description = read_model_description(folder, validate=False)
    with _LOADING:
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="plant",
        )
    fmpy.freeLibrary(probe._handle)
    return slave, {variable.name: variable for variable in description.modelVariables}


def _references(variables: Mapping[str, Any], names: Iterable[str]) -> list[int]:
    return [variables[name].valueReference for name in names]


def _parameters(fmu: Path, start: Mapping[str, float], variables: Mapping[str, Any]) -> list[tuple[int, int | float]]:
    """Return value references and values of the start; integers for Integer and Enumeration."""
    parameters = {name: v for name, v in variables.items() if v.causality == "parameter"}
    values: list[tuple[int, int | float]] = []
    for name, value in start.items():
        if name not in parameters:
            raise BadInputError(f"plant.start.{name}: {fmu.name} has no such parameter{nearest(name, parameters)}")
        if not math.isfinite(value):
            raise BadInputError(f"plant.start.{name} = {value}; expected a finite number")
        variable = parameters[name]
        if variable.type == "Real":
            values.append((variable.valueReference, float(value)))
        elif value == int(value) and abs(value) < 2**31:
            values.append((variable.valueReference, int(value)))
        else:
            raise BadInputError(f"plant.start.{name} = {value:g}; expected a whole number of 32 bits")
    return values
