"""What the tests of the plant share: the built FMU, and FMPy's own instances of it with variables by name."""

import contextlib
import ctypes
import functools
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import (
    FMU2Slave,
    calloc,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    free,
)
from fmpy.logging import addLoggerProxy

import plant_fmu
import tools.build.cosim
import tools.build.fmu
from hil.plant.built import COSIM

FMU = tools.build.fmu.build()
if not COSIM.is_current():
    tools.build.cosim.build()

DESCRIPTION = read_model_description(str(FMU))
VARIABLES = {variable.name: variable for variable in DESCRIPTION.modelVariables}
REFERENCE = {name: variable.valueReference for name, variable in VARIABLES.items()}
DEFAULTS = {name: float(v.start) for name, v in VARIABLES.items() if v.causality == "parameter"}
WHEELS = ("fl", "fr", "rr", "rl")

RIGID, SLIP = 1, 2
X, O = 1, 2  # noqa: E741  the arrangements' own names
TORQUE, CURRENT, VOLTAGE = 1, 2, 3

POSE = ("pose.x_m", "pose.y_m", "pose.heading_rad")
TWIST = ("twist.vx_m_s", "twist.vy_m_s", "twist.yaw_rate_rad_s")
START = ("start_x_m", "start_y_m", "start_heading_rad", "start_vx_m_s", "start_vy_m_s", "start_yaw_rate_rad_s")
PUSH = ("push.force_x_n", "push.force_y_n", "push.moment_n_m")
ENERGY = ("energy.supplied_j", "energy.stored_j", "energy.lost_j")


def wheels(quantity: str) -> tuple[str, ...]:
    """Name one quantity of the four wheels: ``wheels("speed_rad_s")``."""
    return tuple(f"wheel.{wheel}.{quantity}" for wheel in WHEELS)


SPEEDS, ANGLES, CURRENTS = wheels("speed_rad_s"), wheels("angle_rad"), wheels("current_a")
AXLE_TORQUES, LOADS, SLIPS, GRIPS = (
    wheels("axle_torque_n_m"),
    wheels("load_n"),
    wheels("slip_m_s"),
    wheels("grip_factor"),
)
TORQUES = [REFERENCE[name] for name in wheels("torque_n_m")]
MOTION = [REFERENCE[name] for name in (*POSE, *TWIST, *ANGLES)]
OUTPUTS = tuple(name for name, variable in VARIABLES.items() if variable.causality == "output")


@functools.cache
def _extracted() -> tempfile.TemporaryDirectory[str]:
    """Extract the FMU once: its instances then share one library, as they do in any importer."""
    folder = tempfile.TemporaryDirectory()
    extract(str(FMU), folder.name)
    return folder


MESSAGES: list[str] = []  # of all instances, oldest first


def _note(_environment: Any, _instance: bytes, _status: int, _category: bytes, message: bytes) -> None:
    MESSAGES.append(message.decode())


_LOGGER = fmi2CallbackLoggerTYPE(_note)


def _callbacks() -> fmi2CallbackFunctions:
    """Return callbacks whose logger FMPy's proxy formats. It knows one logger alone, that of whoever came last."""
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = _LOGGER
    callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(free)
    addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


@contextlib.contextmanager
def slave(start: Mapping[str, float] | None = None, *, initialised: bool = True) -> Iterator[FMU2Slave]:
    """Give an instance through FMPy's own class; its messages go to MESSAGES."""
    folder = _extracted().name
    fmu = FMU2Slave(guid=DESCRIPTION.guid, unzipDirectory=folder, modelIdentifier="mecanum", instanceName="test")
    fmu.instantiate(callbacks=_callbacks())
    try:
        if initialised:
            initialise(fmu, start or {})
        yield fmu
    finally:
        fmu.freeInstance()


def initialise(fmu: FMU2Slave, start: Mapping[str, float]) -> None:
    """Bring a new instance to its start."""
    fmu.setupExperiment(startTime=0.0)
    assign(fmu, start)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()


def assign(fmu: FMU2Slave, values: Mapping[str, float]) -> None:
    """Set variables by name, each with its own type."""
    for name, value in values.items():
        if VARIABLES[name].type == "Real":
            fmu.setReal([REFERENCE[name]], [float(value)])
        else:
            fmu.setInteger([REFERENCE[name]], [int(value)])


def last_successful_time_s(fmu: FMU2Slave) -> float:
    """Return the time that the instance itself has reached (FMI 2.0 section 4.2.3)."""
    value = ctypes.c_double()
    fmu.fmi2GetRealStatus(fmu.component, 2, ctypes.byref(value))
    return value.value


class Robot:
    """One instance of the plant: variables by name, and the time that it has reached."""

    def __init__(self, fmu: FMU2Slave, start_s: float = 0.0) -> None:
        self.fmu = fmu
        self.time_s = start_s

    def set(self, values: Mapping[str, float]) -> None:
        """Set inputs or tunable parameters."""
        assign(self.fmu, values)

    def torque(self, torque_n_m: Iterable[float]) -> None:
        """Set the torques of the four wheels."""
        self.fmu.setReal(TORQUES, [float(t) for t in torque_n_m])

    def duty(self, duty: Iterable[float]) -> None:
        """Set the duties of the four motors."""
        self.set(dict(zip(wheels("duty"), duty, strict=True)))

    def push(self, *push: float) -> None:
        """Set the push: force x, force y in the world frame [N], moment [N m]."""
        self.set(dict(zip(PUSH, push, strict=True)))

    def step(self, step_s: float = 1e-3, count: int = 1) -> None:
        """Take ``count`` communication steps of ``step_s``."""
        begin_s = self.time_s
        for n in range(count):
            self.fmu.doStep(begin_s + n * step_s, begin_s + (n + 1) * step_s - (begin_s + n * step_s))
        self.time_s = begin_s + count * step_s

    def read(self, names: Iterable[str]) -> np.ndarray:
        """Return outputs or parameters by name."""
        return np.array([self[name] for name in names])

    def __getitem__(self, name: str) -> float:
        get = self.fmu.getReal if VARIABLES[name].type == "Real" else self.fmu.getInteger
        return get([REFERENCE[name]])[0]

    def bits(self) -> bytes:
        """Return all outputs, so that two instances can be compared bit for bit."""
        return self.read(OUTPUTS).tobytes()

    def save(self) -> Any:
        """Return the state of the instance."""
        return self.fmu.getFMUState()

    def restore(self, state: Any, time_s: float) -> None:
        """Go back to a saved state and the time at which it was saved."""
        self.fmu.setFMUState(state)
        self.time_s = time_s


@contextlib.contextmanager
def robot(start: Mapping[str, float] | None = None, /, **more: float) -> Iterator[Robot]:
    """Give a robot at its start, with the default of every parameter that is not given."""
    with slave({**(start or {}), **more}) as fmu:
        yield Robot(fmu)


def patched_fmu(folder: Path, *patches: tuple[str, str, str]) -> Path:
    """Build an FMU from a copy of the sources in which (file, old text, new text) were replaced."""
    copy = folder / "plant_fmu"
    shutil.copytree(plant_fmu.path().parent, copy, ignore=shutil.ignore_patterns("*.fmu", "__pycache__"))
    for name, old, new in patches:
        text = (copy / name).read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{name}: {old!r} is there {text.count(old)} times"
        (copy / name).write_text(text.replace(old, new), encoding="utf-8")
    subprocess.run([sys.executable, "-m", "tools.build.fmu"], cwd=folder, check=True, capture_output=True)
    return copy / "mecanum.fmu"
