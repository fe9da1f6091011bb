"""An FMU in this process as the plant, stepped from C through the firmware's plant port.

FMPy reads the description, loads and initialises the FMU. After that the C code cosim.c calls the FMU's functions by
their addresses, with one C call per tick. A step through FMPy's own methods takes about 25 times as long.
"""

import contextlib
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError, DeviceError
from hil.core.plant_signals import OUTPUTS, SENSORS
from hil.core.types import Wheels
from hil.plant import archive, shim
from hil.plant.communication import communication_step
from hil.plant.instance import Instance
from hil.plant.mapping import SignalMap, Wiring, resolve
from hil.plant.start import Settable, Value, limits, resize, settable_variables, start_values


class FmuPlant(shim.PlantPort):
    """An instance of an FMU that is connected to the plant port, in its start state until it is stepped.

    ``start`` gives start values of variables by name, in the FMU's units; the others keep the FMU's defaults.
    ``mapping`` gives the variable of each signal for which the names differ.

    With ``prints_log`` every log message of the FMU is printed on stderr, one per line. A tick lasts ``tick_ns``.
    The FMU's code runs in this process: if it crashes or hangs, so does this process.

    Raises BadInputError when the file is not an FMU that can run here, when a name is unknown or a value out of its
    range, and DeviceError when the FMU fails at its start.
    """

    _functions = "cosim"

    def __init__(
        self,
        fmu: Path,
        start: Mapping[str, Value],
        mapping: SignalMap | None = None,
        *,
        prints_log: bool = False,
        tick_ns: int = TICK_NS,
    ) -> None:
        mapping = mapping or SignalMap()
        library = archive.library_of(fmu)
        self._ffi, self._lib = shim.load()
        self._context = self._ffi.new("cosim *", {"tick_ns": tick_ns, "prints_log": prints_log})
        # Looked up once: a look-up takes longer than a call.
        self._run = self._lib.cosim_run
        assert (self._lib.COSIM_POSE, self._lib.COSIM_TWIST) == (0, 3)
        self._read_truth(self._ffi.addressof(self._context, "time_ns"))
        self._torque = self._ffi.new("float[4]")
        self._speeds = self._context.signal + self._lib.COSIM_WHEEL_SPEED
        self.wire((0, 1, 2, 3), (1, 1, 1, 1))
        with contextlib.ExitStack() as resources:
            archive.check_may_load(fmu)
            folder = resources.enter_context(archive.extract(fmu, only=_may_be_read))
            self.instance = instance = Instance(fmu, folder, library, self._context)
            resources.callback(instance.unload)
            if not _is_needed(folder, library.member):
                # Where the system allows it: a killed run then leaves no files behind.
                shutil.rmtree(folder, ignore_errors=True)
            self._fmu = fmu
            step = communication_step(fmu, instance.description, wanted_s=mapping.step_s, tick_ns=tick_ns)
            self._context.step_ns = step.size_ns
            self._start = start_values(start, fmu, instance.variables)
            wiring = self._wired(fmu, mapping)
            self.notices = (*((step.notice,) if step.notice else ()), *wiring.notices)
            self._wiring_memory = shim.connect(self._context, wiring, instance.access)
            instance.instantiate()
            resources.callback(instance.free)
            self._initialise()
            self.settable = self._offer_variables()
            self._resources = resources.pop_all()

    @property
    def context(self) -> Any:
        """The context of the shim's functions, as cffi sees it."""
        return self._context

    @property
    def pose_address(self) -> int:
        return int(self._ffi.cast("uintptr_t", self._context.signal))

    def wire(self, wheel_of_channel: Sequence[int], sign_of_channel: Sequence[int]) -> None:
        if sorted(wheel_of_channel) != [0, 1, 2, 3] or [abs(sign) for sign in sign_of_channel] != [1] * 4:
            raise BadInputError(
                f"wheels {tuple(wheel_of_channel)} with signs {tuple(sign_of_channel)} on the channels; "
                "expected each of 0 to 3 once, and signs of 1 or -1"
            )
        self._context.wheel_of_channel = list(wheel_of_channel)
        self._context.sign_of_channel = list(sign_of_channel)

    def step(self, torque_n_m: Wheels, ticks: int = 1) -> None:
        self._torque[0:4] = torque_n_m
        if self._run(self._context, self._torque, ticks) != 0:
            raise DeviceError(f"the plant stopped at {self.truth().time_ns / 1e9:g} s: {self.message}")

    def wheel_speeds(self) -> Wheels:
        return Wheels(*self._ffi.unpack(self._speeds, 4))

    @property
    def message(self) -> str:
        return self.instance.message

    def reset(self) -> None:
        if self._context.component == self._ffi.NULL:
            raise DeviceError("the plant is closed; make a new one")
        self.instance.reset()
        self._initialise()

    def restart(self, start: Mapping[str, Value]) -> None:
        """Return to the start state with other start values, as if the plant had been made with them.

        Raises BadInputError as the constructor does, also for a structural parameter, which needs a new instance, and
        DeviceError as ``reset`` does.
        """
        variables = self.instance.variables
        values = start_values(start, self._fmu, variables)
        for value in (*values, *self._start):
            if value.variable.causality == "structuralParameter":
                raise BadInputError(f"plant.start.{value.variable.name} shapes the FMU; open it anew")
        self._start = values
        self.reset()
        starts = self.instance.values_of([variables[name] for name in self.settable])
        rows = zip(self.settable.items(), starts, strict=True)
        self.settable = {name: row._replace(start=value) for (name, row), value in rows}

    def close(self) -> None:
        self._resources.close()

    def _wired(self, fmu: Path, mapping: SignalMap) -> Wiring:
        instance, context = self.instance, self._context
        resize(self._start, instance.variables)
        wiring = resolve(mapping, fmu, instance.variables, instance.units)
        self._driven = {connection.variable.name for connection in wiring.inputs}
        missing = {OUTPUTS[place] for place in wiring.derived}
        self.lacks = frozenset(name for name, signals in SENSORS.items() if missing & set(signals))
        context.counts_per_revolution = mapping.counts_per_revolution or 0.0
        context.torque_constant_n_m_a = mapping.torque_constant_n_m_a or 0.0
        return wiring

    def _offer_variables(self) -> dict[str, Settable]:
        """Pass the variables that may be set between ticks to the C shim; return them with their index there."""
        offered = settable_variables(self.instance.variables, self._driven)
        rows = [(v.valueReference, *shim.setter(self.instance.access, v.type)) for v in offered.values()]
        memory = self._ffi.new("cosim_variable[]", rows)
        self._wiring_memory.append(memory)
        self._context.settable, self._context.settables = memory, len(rows)
        starts = self.instance.values_of(list(offered.values()))
        return {
            name: Settable(place, start, *limits(offered[name]))
            for place, (name, start) in enumerate(zip(offered, starts, strict=True))
        }

    def _initialise(self) -> None:
        self.instance.initialise(self._start)
        if self._lib.cosim_start(self._context) != 0:
            raise DeviceError(f"the plant has no outputs at its start: {self.message}")


def _may_be_read(name: str) -> bool:
    """Return whether an entry may be read while the FMU runs; what these folders hold is for people and for tools."""
    return not name.startswith(("documentation/", "extra/", "sources/"))


def _is_needed(folder: Path, member: str) -> bool:
    """Return whether a loaded FMU may need more of its files: resources, or libraries beside its own."""
    return (folder / "resources").is_dir() or len(list((folder / member).parent.iterdir())) > 1
