"""What the tests of the plant share: the built FMU, FMPy's own instances of it, and an independent model."""

import contextlib
import ctypes
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from scipy.integrate import solve_ivp

import hil.plant.build
import plant_fmu.build

FMU = plant_fmu.build.build()
if not hil.plant.build.is_fresh():
    hil.plant.build.build()

DESCRIPTION = read_model_description(str(FMU))
REFERENCE = {variable.name: variable.valueReference for variable in DESCRIPTION.modelVariables}
WHEELS = ("fl", "fr", "rr", "rl")
TORQUES = [REFERENCE[f"wheel.{wheel}.torque_n_m"] for wheel in WHEELS]
MOTION = [
    REFERENCE[name]
    for name in (
        "pose.x_m",
        "pose.y_m",
        "pose.heading_rad",
        "twist.vx_m_s",
        "twist.vy_m_s",
        "twist.yaw_rate_rad_s",
        *(f"wheel.{wheel}.angle_rad" for wheel in WHEELS),
    )
]


@contextlib.contextmanager
def slave(start: dict[str, float] | None = None, *, initialised: bool = True) -> Iterator[FMU2Slave]:
    """Give an instance through FMPy's own class, from a fresh extraction."""
    with tempfile.TemporaryDirectory() as folder:
        extract(str(FMU), folder)
        fmu = FMU2Slave(guid=DESCRIPTION.guid, unzipDirectory=folder, modelIdentifier="mecanum", instanceName="test")
        fmu.instantiate()
        try:
            if initialised:
                initialise(fmu, start or {})
            yield fmu
        finally:
            fmu.freeInstance()


def initialise(fmu: FMU2Slave, start: dict[str, float]) -> None:
    """Bring a new instance to its start."""
    fmu.setupExperiment(startTime=0.0)
    for name, value in start.items():
        fmu.setReal([REFERENCE[name]], [value])
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()


def last_successful_time_s(fmu: FMU2Slave) -> float:
    """Return the time that the instance itself has reached (FMI 2.0 section 4.2.3)."""
    value = ctypes.c_double()
    fmu.fmi2GetRealStatus(fmu.component, 2, ctypes.byref(value))
    return value.value


ROBOT = {
    "mass_kg": 20.0,
    "inertia_kg_m2": 0.56,
    "wheel_radius_m": 0.075,
    "half_length_m": 0.3,
    "half_width_m": 0.3,
    "wheel_inertia_kg_m2": 0.005,
    "friction_coefficient": 0.0,
    "friction_speed_rad_s": 0.1,
    "viscous_n_m_s_rad": 0.0,
}


class Oracle:
    """The robot from first principles: d'Alembert in the body frame, wheels from where they stand.

    Wheel i stands at (px, py). The roller on the ground rolls freely, but not along its own axis a, so that
    the contact has no velocity along a: a . (v + yaw_rate x p - omega r ex) = 0. That gives omega from the
    body twist, one row of J.
    """

    def __init__(self, robot: dict[str, float]) -> None:
        self.robot = robot
        length, width, r = robot["half_length_m"], robot["half_width_m"], robot["wheel_radius_m"]
        stands = [(length, width), (length, -width), (-length, -width), (-length, width)]
        rollers = [np.deg2rad(angle) for angle in (-45, 45, -45, 45)]
        rows = []
        for (px, py), angle in zip(stands, rollers, strict=True):
            ax, ay = np.cos(angle), np.sin(angle)
            rows.append([ax / (ax * r), ay / (ax * r), (ay * px - ax * py) / (ax * r)])
        self.jacobian = np.array(rows)
        body = np.diag([robot["mass_kg"], robot["mass_kg"], robot["inertia_kg_m2"]])
        self.mass = body + robot["wheel_inertia_kg_m2"] * self.jacobian.T @ self.jacobian

    def _rate(self, y: np.ndarray, torque: np.ndarray) -> np.ndarray:
        heading, forward, left, yaw_rate = y[2], *y[3:6]
        omega = self.jacobian @ [forward, left, yaw_rate]
        robot = self.robot
        coulomb = robot["friction_coefficient"] * robot["mass_kg"] * 9.81 * robot["wheel_radius_m"] / 4
        friction = coulomb * np.tanh(omega / robot["friction_speed_rad_s"]) + robot["viscous_n_m_s_rad"] * omega
        force = self.jacobian.T @ (torque - friction)
        force += robot["mass_kg"] * yaw_rate * np.array([left, -forward, 0.0])  # the body frame turns
        c, s = np.cos(heading), np.sin(heading)
        velocity = [c * forward - s * left, s * forward + c * left, yaw_rate]
        return np.concatenate([velocity, np.linalg.solve(self.mass, force), omega])

    def run(self, pose: np.ndarray, twist: np.ndarray, torques: np.ndarray, hold_s: float) -> np.ndarray:
        """Return pose, world twist and wheel angles after holding each row of ``torques`` for ``hold_s``."""
        c, s = np.cos(pose[2]), np.sin(pose[2])
        body = [c * twist[0] + s * twist[1], -s * twist[0] + c * twist[1], twist[2]]
        y = np.concatenate([pose, body, np.zeros(4)])
        for torque in torques:
            done = solve_ivp(
                lambda _, state, held=torque: self._rate(state, held),
                (0.0, hold_s),
                y,
                method="DOP853",
                rtol=1e-12,
                atol=1e-13,
            )
            y = done.y[:, -1]
        c, s = np.cos(y[2]), np.sin(y[2])
        y[3:5] = c * y[3] - s * y[4], s * y[3] + c * y[4]
        return y


def patched_fmu(folder: Path, *patches: tuple[str, str, str]) -> Path:
    """Build an FMU from a copy of the sources in which (file, old text, new text) were replaced."""
    copy = folder / "plant_fmu"
    shutil.copytree(plant_fmu.path().parent, copy, ignore=shutil.ignore_patterns("*.fmu", "__pycache__"))
    for name, old, new in patches:
        text = (copy / name).read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{name}: {old!r} is there {text.count(old)} times"
        (copy / name).write_text(text.replace(old, new), encoding="utf-8")
    subprocess.run([sys.executable, "-m", "plant_fmu.build"], cwd=folder, check=True, capture_output=True)
    return copy / "mecanum.fmu"
