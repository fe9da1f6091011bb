"""Writes the robot inside the FMU as a MuJoCo file, to view it and to run it without the FMU."""

import ctypes
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

# FMPy's proxy keeps the address of the logger that it was given last, so that none of ours may go away.
_CALLBACKS: list[Any] = []


class ModelError(Exception):
    """The model could not be written; the message says what to do."""


def save(fmu: Path, file: Path, parameters: Mapping[str, float]) -> None:
    """Write the robot with these parameters, by name and in SI units, as it stands at its start.

    A name that ends in ``.xml`` gives MJCF, rounded for reading; ``.mjb`` a binary model with every bit. The key
    frame "start" holds the state. Raises ModelError for an unknown name, a value out of its range and a file that
    cannot be written.
    """
    from fmpy import extract, instantiate_fmu, read_model_description
    from fmpy.fmi1 import FMICallException
    from fmpy.simulation import apply_start_values

    if file.suffix not in (".xml", ".mjb"):
        raise ModelError(f"{file}: the name of a model ends in .xml or .mjb")
    description = read_model_description(fmu)
    known = {v.name: v for v in description.modelVariables if v.causality == "parameter"}
    for name, value in parameters.items():
        if name not in known:
            raise ModelError(f"{name} is not a parameter; expected one of {', '.join(known)}")
        if known[name].type != "Real" and value != int(value):
            raise ModelError(f"{name} = {value:g}; expected a whole number")
    words: list[str] = []

    def keep(environment: Any, instance: Any, status: int, category: Any, message: bytes) -> None:
        words.append(message.decode(errors="replace"))

    with tempfile.TemporaryDirectory(prefix="plant_fmu_mujoco_", ignore_cleanup_errors=True) as folder:
        extract(fmu, folder)
        slave = instantiate_fmu(folder, description, "CoSimulation", logger=keep)
        _CALLBACKS.append(slave.callbacks)
        try:
            slave.setupExperiment(startTime=0.0)
            apply_start_values(slave, description, dict(parameters))
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            write(slave, file)
        except FMICallException as error:
            raise ModelError(words[-1] if words else str(error)) from error
        finally:
            slave.freeInstance()


def write(slave: Any, file: Path) -> None:
    """Write the robot of FMPy's instance ``slave`` with the state that it has now.

    Raises ModelError when the file cannot be written.
    """
    call = slave.dll.mecanum_mujoco_save
    call.argtypes = [ctypes.c_void_p, ctypes.c_char_p]
    try:
        file.open("ab").close()
    except OSError as error:
        raise ModelError(f"{file} cannot be written ({error.strerror}); choose another file") from error
    if call(slave.component, str(file).encode()) != 0:
        raise ModelError(f"{file}: the FMU could not write its model")
