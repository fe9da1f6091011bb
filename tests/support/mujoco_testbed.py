"""What the tests of the MuJoCo plant share: the FMU, instances of it and of the rigid one, and its model in process."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

import tools.build.fmu

mujoco = pytest.importorskip("mujoco", reason='MuJoCo is not installed; run: pip install "mecanum-hil[mujoco]"')

from plant_fmu.mujoco import model  # noqa: E402
from tools.build import mujoco_fmu as build  # noqa: E402  # its tests need MuJoCo

FMU = build.build()
RIGID = tools.build.fmu.build()
WHEELS = ("fl", "fr", "rr", "rl")
FORWARD, LEFT, TURN = np.array([[1, 1, 1, 1], [-1, 1, -1, 1], [-1, 1, 1, -1]], dtype=float)
DIRECTIONS = {"forward": FORWARD, "left": LEFT, "turn": TURN}
FIRST_WHEEL, WHEEL_JOINTS = 6, 13  # places in MuJoCo's velocities

Row = np.ndarray[Any, np.dtype[np.float64]]


class Robot:
    """An FMU's instance after initialization; velocities in the world frame, wheels FL, FR, RR, RL."""

    def __init__(self, slave: FMU2Slave, references: dict[str, Any]) -> None:
        self.slave, self.variables, self.time_s = slave, references, 0.0

    def set(self, **values: float) -> None:
        for name, value in values.items():
            variable = self.variables[name]
            setter = self.slave.setReal if variable.type == "Real" else self.slave.setInteger
            setter([variable.valueReference], [value])

    def get(self, *names: str) -> Row:
        return np.array(self.slave.getReal([self.variables[name].valueReference for name in names]))

    def wheels(self, signal: str) -> Row:
        return self.get(*(f"wheel.{wheel}.{signal}" for wheel in WHEELS))

    def torque(self, torque_n_m: Row) -> None:
        references = [self.variables[f"wheel.{wheel}.torque_n_m"].valueReference for wheel in WHEELS]
        self.slave.setReal(references, list(torque_n_m))

    def step(self, steps: int = 1, step_s: float = 0.001) -> None:
        for _ in range(steps):
            self.slave.doStep(self.time_s, step_s)
            self.time_s += step_s

    @property
    def pose(self) -> Row:
        return self.get("pose.x_m", "pose.y_m", "pose.heading_rad")

    @property
    def twist(self) -> Row:
        return self.get("twist.vx_m_s", "twist.vy_m_s", "twist.yaw_rate_rad_s")

    @property
    def everything(self) -> list[float]:
        """Every output, as it is bit for bit."""
        outputs = [v for v in self.variables.values() if v.causality == "output"]
        reals = [v.valueReference for v in outputs if v.type == "Real"]
        whole = [v.valueReference for v in outputs if v.type == "Integer"]
        return [*self.slave.getReal(reals), *self.slave.getInteger(whole)]


@contextlib.contextmanager
def robot(fmu: Path = FMU, **start: float) -> Iterator[Robot]:
    """Give an instance with these parameters."""
    description = read_model_description(str(fmu))
    with tempfile.TemporaryDirectory() as folder:
        extract(str(fmu), folder)
        identifier = description.coSimulation.modelIdentifier
        slave = FMU2Slave(guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier, instanceName="test")
        slave.instantiate()
        try:
            instance = Robot(slave, {v.name: v for v in description.modelVariables})
            slave.setupExperiment(startTime=0.0)
            instance.set(**start)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            yield instance
        finally:
            slave.freeInstance()


def compiled(folder: Path, **parameters: float) -> Any:
    """Return the robot of these parameters as MuJoCo's own compiled model."""
    file = folder / "robot.mjb"
    model.save(FMU, file, parameters)
    return mujoco.MjModel.from_binary_path(str(file))


def wheel_speeds(twist: Row, rollers: int = 1, half_length: float = 0.3, half_width: float = 0.3) -> Row:
    """Return the speeds of wheels of 0.075 m that roll with a twist of the body frame."""
    ahead, left = np.array([1, 1, -1, -1]), np.array([1, -1, -1, 1])
    across = ahead * left * (-1 if rollers == 1 else 1)
    vx, vy, yaw_rate = twist
    return (vx - yaw_rate * left * half_width + across * (vy + yaw_rate * ahead * half_length)) / 0.075
