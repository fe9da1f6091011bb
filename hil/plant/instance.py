"""An FMU in this process: loads it with FMPy and takes it through the states of the FMI standard.

All differences between FMI 2.0 and 3.0 on the Python side are handled here.
"""

import contextlib
import ctypes
import os
import re
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, DeviceError, HilError
from hil.plant.archive import Library
from hil.plant.child_output import one_line
from hil.plant.description import import_fmpy, read_description, variables_of
from hil.plant.shim import address, load
from hil.plant.start import Start

_LOADING = threading.Lock()  # FMPy changes the working directory while it loads
_ALIVE: set[str] = set()  # GUIDs of those FMUs of which a process may hold but one instance
_NAME = "plant"
_FATAL = 4  # fmi2Fatal and fmi3Fatal: no function of the FMU may be called any more
_LACKING = re.compile(  # as the loaders of glibc, musl and macOS say it
    r"(\S+): cannot open shared object file|Error loading shared library (\S+):|Library not loaded: (\S+)"
)


def lacking_here(error: OSError, library: Path) -> str | None:
    """Return what this machine lacks for a library that cannot be loaded; None when the fault is the library's own."""
    found = _LACKING.search(str(error))
    name = Path(next(filter(None, found.groups()))).name if found else library.name
    return None if name == library.name else f"its library needs {name}, which the system does not find; install it"


class Instance:
    """One instance of an FMU; ``context`` is the shim's ``cosim``, whose logger the FMU uses.

    Raises BadInputError when the library cannot be loaded or used.
    """

    def __init__(self, fmu: Path, folder: Path, library: Library, context: Any) -> None:
        self._file, self._folder, self._context, self._library = fmu, folder, context, library
        self._is_running = False
        self.description = read_description(fmu)
        self.version = int(library.fmi_version[0])
        self._interface = self.description.coSimulation
        self.fmu = self._load(library)
        context.fmi_version = self.version
        self.variables = variables_of(self.description)
        """FMPy's variables by name, and by alias."""
        self.units = {unit.name: unit for unit in self.description.unitDefinitions}
        """FMPy's unit definitions by name."""
        context.do_step = self.function(f"fmi{self.version}DoStep")
        if self.version == 2:
            context.get_boolean_status = self.function("fmi2GetBooleanStatus")

    @property
    def message(self) -> str:
        """The newest FMU message that is a warning or worse, or the reason why the shim stopped."""
        return one_line(load()[0].string(self._context.text).decode(errors="replace"))

    def access(self, call: str, kind: str) -> Any:
        """Return a getter or setter as a ``cosim_function``: of ("Get", "Real") for example."""
        return self.function(f"fmi{self.version}{call}{kind}")

    def function(self, name: str) -> Any:
        """Return any function of the FMU as a ``cosim_function``."""
        address = ctypes.cast(getattr(self.fmu.dll, name), ctypes.c_void_p).value
        return load()[0].cast("cosim_function", address)

    def values_of(self, variables: Sequence[Any]) -> list[float]:
        """Return the values of floating-point scalars. Raises DeviceError when the FMU refuses to give one."""
        found: dict[int, float] = {}
        for kind in dict.fromkeys(variable.type for variable in variables):
            some = [variable for variable in variables if variable.type == kind]
            references = [variable.valueReference for variable in some]
            names = ", ".join(variable.name for variable in some)
            with self._answering(DeviceError, f"FMU {self._file}: one of {names} cannot be read"):
                values = getattr(self.fmu, f"get{kind}")(references)
            found |= zip(references, map(float, values), strict=True)
        return [found[variable.valueReference] for variable in variables]

    def instantiate(self) -> None:
        """Make the instance. Raises BadInputError when only one is allowed per process, or the FMU refuses."""
        if self._interface.canBeInstantiatedOnlyOncePerProcess:
            if self.description.guid in _ALIVE:
                raise BadInputError(
                    f"FMU {self._file}: a process can have only one instance of it; close the other first, or run one "
                    "of them in its own process"
                )
            _ALIVE.add(self.description.guid)
        (self._instantiate2 if self.version == 2 else self._instantiate3)()
        if not self.fmu.component:
            _ALIVE.discard(self.description.guid)
            maker = one_line(self.description.generationTool or "the tool that made it")
            tool = f", it needs {maker}" if self._interface.needsExecutionTool else ""
            raise BadInputError(f"FMU {self._file}: it made no instance{tool}: {self.message or 'it did not say why'}")
        self._context.component = load()[0].cast("void *", self.fmu.component)

    def initialise(self, starts: Sequence[Start]) -> None:
        """Set the start values of a new or reset instance and initialise it, so that it can be stepped.

        Raises BadInputError when the FMU refuses a start value, DeviceError when it fails otherwise.
        """
        self._forget()
        # No log categories are chosen, so all stay on. A choice would lose messages without a category, such as those
        # in which pythonfmu reports a fatal exception.
        with self._answering(DeviceError, f"FMU {self._file} failed at its start"):
            if self.version == 2:
                self.fmu.setupExperiment(startTime=0.0)
        self._set_starts(starts)
        with self._answering(DeviceError, f"FMU {self._file} failed to initialise"):
            if self.version == 2:
                self.fmu.enterInitializationMode()
            else:
                self.fmu.enterInitializationMode(startTime=0.0)
            self.fmu.exitInitializationMode()
        self._is_running = True

    def reset(self) -> None:
        """Reset the instance to its state after ``instantiate``. Raises DeviceError when the FMU cannot."""
        if self._context.fatal:
            raise DeviceError(f"FMU {self._file} has reported a fatal error and cannot be reset: {self.message}")
        self._is_running = False
        self._forget()
        with self._answering(DeviceError, f"FMU {self._file} failed to reset"):
            self.fmu.reset()

    def free(self) -> None:
        """End the simulation and free the instance."""
        from fmpy.fmi1 import FMICallException

        self._context.component = load()[0].NULL
        if self._context.fatal:
            return
        if self._is_running and not self._context.failed:
            # The instance is freed, whatever it answers.
            with contextlib.suppress(FMICallException):
                self.fmu.terminate()
        (self.fmu.fmi2FreeInstance if self.version == 2 else self.fmu.fmi3FreeInstance)(self.fmu.component)
        _ALIVE.discard(self.description.guid)

    def unload(self) -> None:
        """Unload the library, unless the FMU has reported a fatal error: then none of its functions may be called."""
        if not self._context.fatal:
            self.fmu.freeLibrary()

    def _set_starts(self, starts: Sequence[Start]) -> None:
        """Set values before the initialization mode, structural parameters in configuration mode (FMI 3.0, 2.3.3)."""
        structural = [start for start in starts if start.variable.causality == "structuralParameter"]
        if structural:
            with self._answering(DeviceError, f"FMU {self._file} refused its configuration mode"):
                self.fmu.enterConfigurationMode()
            self._set(structural)
            with self._answering(DeviceError, f"FMU {self._file} failed to leave its configuration mode"):
                self.fmu.exitConfigurationMode()
        self._set([start for start in starts if start not in structural])

    def _set(self, starts: Sequence[Start]) -> None:
        enumeration = "Integer" if self.version == 2 else "Int64"
        for variable, value in starts:
            kind = enumeration if variable.type == "Enumeration" else variable.type
            with self._answering(BadInputError, f"plant.start.{variable.name}"):
                getattr(self.fmu, f"set{kind}")([variable.valueReference], [value])

    @contextlib.contextmanager
    def _answering(self, error_class: type[HilError], what: str) -> Iterator[None]:
        """Turn a status worse than a warning into ``error_class``, with the FMU's message."""
        from fmpy.fmi1 import FMICallException

        try:
            yield
        except FMICallException as error:
            self._context.failed = 1
            self._context.fatal = error.status == _FATAL
            raise error_class(f"{what}: {self.message or error}") from error

    def _forget(self) -> None:
        self._context.failed = self._context.text_status = 0
        self._context.text = b""

    def _load(self, library: Library) -> Any:
        import_fmpy()
        from fmpy import freeLibrary
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        path = str(self._folder / library.member)
        try:
            probe = ctypes.CDLL(path)  # FMPy raises a plain Exception without the reason
        except OSError as error:
            why = lacking_here(error, Path(path)) or f"its library cannot be loaded ({error}); export the FMU again"
            raise BadInputError(f"FMU {self._file}: {why}") from error
        slave = FMU2Slave if self.version == 2 else FMU3Slave
        try:
            with _LOADING:
                return slave(
                    guid=self.description.guid,
                    unzipDirectory=str(self._folder),
                    modelIdentifier=library.model_identifier,
                    instanceName=_NAME,
                    libraryPath=path,
                )
        except AttributeError as error:
            raise BadInputError(
                f"FMU {self._file}: its library lacks a function of the standard ({error}); export the FMU anew"
            ) from error
        finally:
            freeLibrary(probe._handle)

    def _instantiate2(self) -> None:
        """Make the instance with the shim's logger and memory, so that no call of the FMU enters Python."""
        from fmpy import fmi2

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = ctypes.cast(address("cosim_log2"), fmi2.fmi2CallbackLoggerTYPE)
        callbacks.allocateMemory = ctypes.cast(address("cosim_allocate"), fmi2.fmi2CallbackAllocateMemoryTYPE)
        callbacks.freeMemory = ctypes.cast(address("cosim_free"), fmi2.fmi2CallbackFreeMemoryTYPE)
        callbacks.componentEnvironment = self._environment
        self.fmu.callbacks = callbacks  # must live as long as the instance
        resources = (self._folder / "resources").as_uri().encode()
        named = (_NAME.encode(), fmi2.fmi2CoSimulation, self.description.guid.encode(), resources)
        self.fmu.component = self.fmu.fmi2Instantiate(*named, ctypes.byref(callbacks), fmi2.fmi2False, fmi2.fmi2True)

    def _instantiate3(self) -> None:
        from fmpy import fmi3

        resources = self._folder / "resources"
        # Section 2.3.1: with a separator at its end, and NULL where there is no such folder.
        path = (str(resources) + os.sep).encode() if resources.is_dir() else None
        named = (_NAME.encode(), self.description.guid.encode(), path, False, True)
        logger = ctypes.cast(address("cosim_log3"), fmi3.fmi3LogMessageCallback)
        # No event mode, no early return, no intermediate update: the shim needs none of them.
        modes = (False, False, None, 0)
        update = fmi3.fmi3IntermediateUpdateCallback()
        self.fmu.component = self.fmu.fmi3InstantiateCoSimulation(*named, *modes, self._environment, logger, update)

    @property
    def _environment(self) -> int:
        return int(load()[0].cast("uintptr_t", self._context))
